//! A dry run as an SVG picture: a lane a device, planned values as a line, what the robot set as dots.

use std::fmt::Write;

use downbeat_scripts::shown::within;
use downbeat_scripts::{Act, DeviceScript, FleetRobot};
use urrcp::{DeviceId, Interpolation, RobotId};

use super::ActReport;
use crate::dry_run::{Played, act_of};

const LANE_HEIGHT: f64 = 34.0;
const CUE_HEIGHT: f64 = 18.0;
const LEFT: f64 = 170.0;
const WIDTH: f64 = 760.0;
const TOP: f64 = 64.0;
const RIGHT: f64 = 110.0;
/// Lanes beyond this are counted, not drawn.
const LANES_MAX: usize = 120;
/// Cues beyond this are not drawn.
const CUES_MAX: usize = 60;

/// Columns of a name that are shown.
const NAME_MAX: usize = 60;

/// Everything that one device does.
struct Track<'a> {
    /// Index of the robot among those that play.
    index: usize,
    robot: &'a RobotId,
    device: &'a DeviceId,
    scripts: Vec<&'a DeviceScript>,
    holds: bool,
}

/// Draws the cues of an act, and for each device the plan with what was set in virtual time. `robots` are those of the
/// plan, in its order; `reported` is what became of the act.
#[must_use]
pub fn draw(act: &Act, reported: &ActReport, robots: &[&FleetRobot], played: &Played) -> String {
    let tracks = tracks(act, robots);
    let shown = tracks.len().min(LANES_MAX);
    let cues = act.cues.len().min(CUES_MAX);
    let top = TOP + CUE_HEIGHT * cues as f64;
    let height = top + LANE_HEIGHT * shown as f64 + 46.0;
    let ends = act.cues.iter().map(|cue| cue.end).max().unwrap_or_default();
    let total = act.plan.duration().max(ends).as_millis_f64().max(1.0);
    let mut svg = String::new();
    let dashed = if tracks.iter().any(|track| values(track) > 1) { " (dashed: further values)" } else { "" };
    head(&mut svg, &act.plan.scenario, played, (height, total), dashed);
    draw_cues(&mut svg, act, total);
    for (row, track) in tracks.iter().take(LANES_MAX).enumerate() {
        let lane = Lane { top: top + LANE_HEIGHT * row as f64, total, range: range(track) };
        lane.draw(&mut svg, track);
        lane.dots(&mut svg, track, reported, played);
    }
    if tracks.len() > shown {
        let _infallible = write!(
            svg,
            "<text x='{LEFT}' y='{}' class='small'>and {} more devices</text>",
            height - 6.0,
            tracks.len() - shown
        );
    }
    svg.push_str("</svg>\n");
    svg
}

fn tracks<'a>(act: &'a Act, robots: &[&FleetRobot]) -> Vec<Track<'a>> {
    let mut tracks: Vec<Track<'a>> = Vec::new();
    for (index, robot) in act.plan.robots.iter().enumerate() {
        let block = robots.get(index).and_then(|robot| robot.init.as_ref());
        for script in &robot.scripts {
            match tracks.last_mut().filter(|track| track.index == index && *track.device == script.device) {
                Some(track) => track.scripts.push(script),
                None => {
                    let device = block.and_then(|block| block.device(script.device.as_str()));
                    let holds = device.is_some_and(|device| device.interpolation == Interpolation::Hold);
                    let (robot, device) = (&robot.robot, &script.device);
                    tracks.push(Track { index, robot, device, scripts: vec![script], holds });
                }
            }
        }
    }
    tracks
}

fn draw_cues(svg: &mut String, act: &Act, total: f64) {
    for (row, cue) in act.cues.iter().take(CUES_MAX).enumerate() {
        let x = LEFT + WIDTH * cue.start.as_millis_f64() / total;
        let width = (WIDTH * (cue.end - cue.start).as_millis_f64() / total).max(2.0);
        let y = TOP + CUE_HEIGHT * row as f64 - 8.0;
        // A name that would run out of the picture stands before its bar.
        let (at, anchor) = match x > LEFT + WIDTH * 0.7 {
            true => (x - 4.0, "end"),
            false => (x + 4.0, "start"),
        };
        let _infallible = write!(
            svg,
            "<rect x='{x:.2}' y='{y}' width='{width:.2}' height='{}' class='cue'/>\
             <text x='{at:.2}' y='{}' class='small' text-anchor='{anchor}'>{}</text>",
            CUE_HEIGHT - 4.0,
            y + 10.5,
            escaped(&cue.name)
        );
    }
}

fn head(svg: &mut String, title: &str, played: &Played, (height, total): (f64, f64), dashed: &str) {
    let width = LEFT + WIDTH + RIGHT;
    let spread = played.report.true_spread.map_or_else(|| "-".to_owned(), |spread| spread.to_string());
    let _infallible = write!(
        svg,
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}' width='{width}' height='{height}'>\
         <style>text{{font:12px sans-serif;fill:#222}}.small{{font-size:10px;fill:#666}}.title{{font-size:16px;font-weight:bold}}\
         .line{{fill:none;stroke:#2a6fb0;stroke-width:1.4}}.further{{stroke-dasharray:4 2}}.dot{{fill:#d9480f}}.grid{{stroke:#ddd}}.lane{{stroke:#eee}}.cue{{fill:#cfe3f5;stroke:#2a6fb0;stroke-width:0.6}}</style>\
         <rect width='100%' height='100%' fill='white'/>\
         <text x='14' y='26' class='title'>{}</text>\
         <text x='14' y='44' class='small'>{}; true start spread {spread}; line: planned{dashed}, dots: set by the robot</text>",
        escaped(title),
        escaped(&played.report.outcome.to_string()),
    );
    let bottom = height - 46.0;
    let every = tick_millis(total);
    for tick in 0..=(total / every) as u32 {
        let millis = f64::from(tick) * every;
        let x = LEFT + WIDTH * millis / total;
        let _infallible = write!(
            svg,
            "<line x1='{x}' y1='{TOP}' x2='{x}' y2='{bottom}' class='grid'/>\
             <text x='{x}' y='{}' class='small' text-anchor='middle'>{} s</text>",
            bottom + 16.0,
            millis / 1_000.0
        );
    }
}

/// A round time between two ticks, so that there are at most ten.
fn tick_millis(total: f64) -> f64 {
    let decade = 10_f64.powf((total / 10.0).log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|factor| factor * decade)
        .into_iter()
        .find(|every| total / every <= 10.0)
        .unwrap_or(total)
}

struct Lane {
    top: f64,
    total: f64,
    /// Least and largest value.
    range: (f64, f64),
}

impl Lane {
    fn x(&self, millis: f64) -> f64 {
        LEFT + WIDTH * millis / self.total
    }

    fn y(&self, value: f64) -> f64 {
        let (low, high) = self.range;
        let part = if high > low { (value - low) / (high - low) } else { 0.5 };
        self.top + LANE_HEIGHT - 6.0 - (LANE_HEIGHT - 12.0) * part
    }

    /// The planned values of a track as points, the first value of each step or a later one. A device that holds its values is
    /// drawn in steps, until its last one.
    fn points(&self, track: &Track<'_>, which: usize) -> String {
        let mut points = String::new();
        let mut before: Option<f64> = None;
        for script in &track.scripts {
            for step in script.script.steps() {
                let Some(value) = step.setpoint.values().nth(which) else { continue };
                let (x, y) = (self.x(script.start.get() + step.offset.get()), self.y(value));
                if let Some(held) = before.filter(|_| track.holds) {
                    let _infallible = write!(points, "{x:.2},{held:.2} ");
                }
                let _infallible = write!(points, "{x:.2},{y:.2} ");
                before = Some(y);
            }
        }
        points
    }

    fn draw(&self, svg: &mut String, track: &Track<'_>) {
        let middle = self.top + LANE_HEIGHT / 2.0 + 4.0;
        let bottom = self.top + LANE_HEIGHT;
        let (low, high) = self.range;
        let _infallible = write!(
            svg,
            "<line x1='0' y1='{bottom}' x2='{}' y2='{bottom}' class='lane'/>\
             <text x='14' y='{middle}'>{} <tspan class='small'>{}</tspan></text>\
             <text x='{}' y='{middle}' class='small'>{low} .. {high}</text>",
            LEFT + WIDTH + RIGHT,
            escaped(track.robot.as_str()),
            escaped(track.device.as_str()),
            LEFT + WIDTH + 8.0,
        );
        for which in 0..values(track) {
            let (points, class) =
                (self.points(track, which), if which == 0 { "line" } else { "line further" });
            let _infallible = write!(svg, "<polyline points='{points}' class='{class}'/>");
        }
    }

    /// What the robot set, at its true time.
    fn dots(&self, svg: &mut String, track: &Track<'_>, reported: &ActReport, played: &Played) {
        let start = reported.start;
        let Some(log) = played.log_of(track.robot) else { return };
        let set = log.iter().filter(|entry| {
            let of_act = entry.request_id.as_deref().and_then(act_of) == Some(reported.number);
            of_act && entry.motion == "set" && entry.device == *track.device
        });
        for entry in set {
            let millis = (entry.true_ns - start.as_nanos()) as f64 / 1e6;
            let (x, y) = (self.x(millis), self.y(entry.value));
            let _infallible = write!(svg, "<circle cx='{x:.2}' cy='{y:.2}' r='1.8' class='dot'/>");
        }
    }
}

/// How many values a step has, at most.
fn values(track: &Track<'_>) -> usize {
    let steps = track.scripts.iter().flat_map(|script| script.script.steps());
    steps.map(|step| step.setpoint.values().count()).max().unwrap_or(0)
}

fn range(track: &Track<'_>) -> (f64, f64) {
    let steps = || track.scripts.iter().flat_map(|script| script.script.steps());
    let values = || steps().flat_map(|step| step.setpoint.values());
    (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
}

fn escaped(text: &str) -> String {
    within(text, NAME_MAX).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
