//! A dry run as an SVG picture: a lane a device, planned values as a line, what the robot set as dots.

use std::fmt::Write;

use downbeat_scripts::{DeviceScript, Plan};

use crate::dry_run::Played;

const LANE_HEIGHT: f64 = 34.0;
const LEFT: f64 = 170.0;
const WIDTH: f64 = 760.0;
const TOP: f64 = 64.0;
const RIGHT: f64 = 90.0;
/// Lanes beyond this are counted, not drawn.
const LANES_MAX: usize = 120;

/// Draws the plan with what was set in virtual time.
#[must_use]
pub fn draw(plan: &Plan, played: &Played) -> String {
    let lanes: Vec<_> = plan
        .robots
        .iter()
        .enumerate()
        .flat_map(|(index, robot)| robot.scripts.iter().map(move |script| (index, &robot.robot, script)))
        .collect();
    let shown = lanes.len().min(LANES_MAX);
    let height = TOP + LANE_HEIGHT * shown as f64 + 46.0;
    let total = plan.duration().as_millis_f64().max(1.0);
    let mut svg = String::new();
    head(&mut svg, plan, played, height, total, shown);
    for (row, (index, robot, script)) in lanes.iter().take(LANES_MAX).enumerate() {
        let lane = Lane { top: TOP + LANE_HEIGHT * row as f64, total };
        lane.draw(&mut svg, &robot.to_string(), script);
        lane.dots(&mut svg, script, played, *index);
    }
    if lanes.len() > shown {
        let _infallible = write!(
            svg,
            "<text x='{LEFT}' y='{}' class='small'>and {} more devices</text>",
            height - 6.0,
            lanes.len() - shown
        );
    }
    svg.push_str("</svg>\n");
    svg
}

fn head(svg: &mut String, plan: &Plan, played: &Played, height: f64, total: f64, lanes: usize) {
    let width = LEFT + WIDTH + RIGHT;
    let spread = played.report.true_spread.map_or_else(|| "-".to_owned(), |spread| spread.to_string());
    let _infallible = write!(
        svg,
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}' width='{width}' height='{height}'>\
         <style>text{{font:12px sans-serif;fill:#222}}.small{{font-size:10px;fill:#666}}.title{{font-size:16px;font-weight:bold}}\
         .line{{fill:none;stroke:#2a6fb0;stroke-width:1.4}}.dot{{fill:#d9480f}}.grid{{stroke:#ddd}}.lane{{stroke:#eee}}</style>\
         <rect width='100%' height='100%' fill='white'/>\
         <text x='14' y='26' class='title'>{}</text>\
         <text x='14' y='44' class='small'>{}; true start spread {spread}; line: planned, dots: set by the robot</text>",
        escaped(&plan.scenario),
        escaped(&played.report.outcome.to_string()),
    );
    let bottom = TOP + LANE_HEIGHT * lanes as f64;
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
}

impl Lane {
    fn x(&self, millis: f64) -> f64 {
        LEFT + WIDTH * millis / self.total
    }

    fn y(&self, value: f64, low: f64, high: f64) -> f64 {
        let part = if high > low { (value - low) / (high - low) } else { 0.5 };
        self.top + LANE_HEIGHT - 6.0 - (LANE_HEIGHT - 12.0) * part
    }

    fn draw(&self, svg: &mut String, robot: &str, script: &DeviceScript) {
        let (low, high) = range(script);
        let middle = self.top + LANE_HEIGHT / 2.0 + 4.0;
        let bottom = self.top + LANE_HEIGHT;
        let mut points = String::new();
        for step in script.script.steps() {
            let x = self.x(script.start.get() + step.offset.get());
            let _infallible = write!(points, "{x:.2},{:.2} ", self.y(step.setpoint.value, low, high));
        }
        let _infallible = write!(
            svg,
            "<line x1='0' y1='{bottom}' x2='{}' y2='{bottom}' class='lane'/>\
             <text x='14' y='{middle}'>{} <tspan class='small'>{}</tspan></text>\
             <text x='{}' y='{middle}' class='small'>{low} .. {high}</text><polyline points='{points}' class='line'/>",
            LEFT + WIDTH + RIGHT,
            escaped(robot),
            escaped(script.device.as_str()),
            LEFT + WIDTH + 8.0,
        );
    }

    /// What the robot set, at its true time.
    fn dots(&self, svg: &mut String, script: &DeviceScript, played: &Played, robot: usize) {
        let Some(start) = played.report.start else { return };
        let (low, high) = range(script);
        let set =
            played.logs[robot].iter().filter(|entry| entry.motion == "set" && entry.device == script.device);
        for entry in set {
            let millis = (entry.true_ns - start.as_nanos()) as f64 / 1e6;
            let (x, y) = (self.x(millis), self.y(entry.value, low, high));
            let _infallible = write!(svg, "<circle cx='{x:.2}' cy='{y:.2}' r='1.8' class='dot'/>");
        }
    }
}

fn range(script: &DeviceScript) -> (f64, f64) {
    let values = || script.script.steps().iter().map(|step| step.setpoint.value);
    (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
