//! Draws one lane per device, grouped by robot. A line shows the planned values, and dots show the values that the robot set.

use std::fmt::Write;

use downbeat_scripts::{Act, DeviceScript, FleetRobot, counted};
use urrcp::{DeviceId, Interpolation, RobotId, Span};

use super::pen::Pen;
use super::thinned::thinned;
use super::{Frame, LEFT, NAME_MAX, escaped};
use crate::busy::interpolation;
use downbeat_mission::report::ActReport;
use downbeat_rehearsal::dry_run::{Played, act_of};

const LANE: f64 = 34.0;
const HEADER: f64 = 22.0;
/// Distance, in pixels, from a lane's edge to its lowest or highest value.
const MARGIN: f64 = 6.0;
/// Maximum number of lanes. Further lanes are counted, not drawn.
const LANES_MAX: usize = 120;
/// Maximum width, in columns, of a device's name to the left of its lane.
const LABEL_MAX: usize = 22;
/// Width of a column in pixels. Dots within one column overlap, so only a few of them are drawn.
const DOTS: f64 = 2.0;
/// Distance in pixels. If more than half of a lane's dots are closer than this to the next dot, all its dots are smaller. The line then
/// stays visible.
const DOTS_APART: f64 = 5.0;

/// The lane of one device, with all its scripts.
struct Lane<'a> {
    robot: &'a RobotId,
    device: &'a DeviceId,
    scripts: Vec<&'a DeviceScript>,
    /// Milliseconds from a command to the resulting motion. The lane shows when motions happen, not when commands are sent.
    latency_ms: f64,
    holds: bool,
}

/// The lanes of an act in the picture.
pub(super) struct Lanes<'a> {
    /// The drawn lanes. Lanes of the same robot are adjacent.
    lanes: Vec<Lane<'a>>,
    left_out: usize,
}

impl<'a> Lanes<'a> {
    /// Creates the lanes in the order of the act's plan. `robots` are the robots of the plan, in the same order.
    pub(super) fn of(act: &'a Act, robots: &[&FleetRobot]) -> Self {
        let mut lanes: Vec<Lane<'a>> = Vec::new();
        for (index, plan) in act.plan.robots.iter().enumerate() {
            for of_device in plan.scripts.chunk_by(|a, b| a.device == b.device) {
                let device = &of_device[0].device;
                let holds = interpolation(robots.get(index).copied(), device) == Some(Interpolation::Hold);
                let latency_ms = act.latency_of(&plan.robot, device).as_millis_f64();
                let scripts = of_device.iter().collect();
                lanes.push(Lane { robot: &plan.robot, device, scripts, latency_ms, holds });
            }
        }
        let left_out = lanes.len().saturating_sub(LANES_MAX);
        lanes.truncate(LANES_MAX);
        Self { lanes, left_out }
    }

    fn groups(&self) -> impl Iterator<Item = &[Lane<'a>]> {
        self.lanes.chunk_by(|a, b| a.robot == b.robot)
    }

    pub(super) fn height(&self) -> f64 {
        HEADER * self.groups().count() as f64 + LANE * self.lanes.len() as f64
    }

    /// Whether the steps of any device have more than one value.
    pub(super) fn has_further_values(&self) -> bool {
        self.lanes.iter().any(|lane| lane.values() > 1)
    }

    /// Returns a note with the number of devices that are not drawn. `None` if all devices are drawn.
    pub(super) fn note(&self) -> Option<String> {
        (self.left_out > 0).then(|| format!("and {}", counted(self.left_out, "more device")))
    }

    pub(super) fn draw(
        &self,
        svg: &mut String,
        top: f64,
        frame: &Frame,
        reported: &ActReport,
        played: &Played,
    ) {
        let mut y = top;
        for group in self.groups() {
            header(svg, y, group, frame);
            y += HEADER;
            for lane in group {
                lane.draw(svg, y, frame, reported, played);
                y += LANE;
            }
        }
    }
}

fn header(svg: &mut String, y: f64, group: &[Lane<'_>], frame: &Frame) {
    let _infallible = write!(
        svg,
        "<rect y='{y}' width='{}' height='{HEADER}' class='robot'/><text x='14' y='{}' class='head'>{}</text>",
        frame.full_width(),
        y + 15.5,
        escaped(group[0].robot.as_str(), NAME_MAX),
    );
}

impl Lane<'_> {
    fn draw(&self, svg: &mut String, top: f64, frame: &Frame, reported: &ActReport, played: &Played) {
        let scale = Scale::of(self);
        self.label(svg, top, frame, &scale);
        for which in 0..self.values() {
            let points = thinned(&self.planned(which, frame, &scale), 1.0);
            let class = if which == 0 { "line" } else { "line further" };
            let _infallible = write!(svg, "<path class='{class}' d='{}'/>", Pen::line(&points));
        }
        let dots = thinned(&self.set(frame, &scale, reported, played), DOTS);
        if !dots.is_empty() {
            let class = if are_close(&dots) { "dots fine" } else { "dots" };
            let _infallible = write!(svg, "<path class='{class}' d='{}'/>", Pen::dots(&dots));
        }
        svg.push_str("</g>");
    }

    /// Writes the start of the lane's SVG group, and its labels. The origin of the group is at the start of the act and the top of the
    /// lane.
    fn label(&self, svg: &mut String, top: f64, frame: &Frame, scale: &Scale) {
        let range = format!("{} .. {}", rounded(scale.least), rounded(scale.largest));
        let steps: usize = self.scripts.iter().map(|script| script.script.steps().len()).sum();
        let _infallible = write!(
            svg,
            "<g transform='translate({LEFT} {top})'><title>{}, {}: {range}, {steps} steps</title>\
             <rect x='-{LEFT}' width='{}' height='{LANE}' class='lane'/>\
             <text x='{}' y='21'>{}</text><text x='{:.1}' y='21' class='small'>{range}</text>",
            escaped(self.robot.as_str(), NAME_MAX),
            escaped(self.device.as_str(), NAME_MAX),
            frame.full_width(),
            26.0 - LEFT,
            escaped(self.device.as_str(), LABEL_MAX),
            frame.width + 8.0,
        );
    }

    /// Returns the maximum number of values in a step of the lane.
    fn values(&self) -> usize {
        let steps = self.scripts.iter().flat_map(|script| script.script.steps());
        steps.map(|step| step.setpoint.values().count()).max().unwrap_or(0)
    }

    /// Returns a point for each planned value, up to the end of the movement. `which` is the index of the value in each step. A device
    /// that holds its values is drawn as a staircase.
    fn planned(&self, which: usize, frame: &Frame, scale: &Scale) -> Vec<(f64, f64)> {
        let mut points: Vec<(f64, f64)> = Vec::new();
        for script in &self.scripts {
            for step in script.script.steps() {
                let Some(value) = step.setpoint.values().nth(which) else { continue };
                let point =
                    (frame.offset(self.latency_ms + script.start.get() + step.offset.get()), scale.y(value));
                let held = points.last().filter(|_| self.holds).map(|before| (point.0, before.1));
                points.extend(held);
                points.push(point);
            }
            let end = self.latency_ms + script.start.get() + script.duration().as_millis_f64();
            let rests = points.last().filter(|_| script.rest > Span::ZERO);
            points.extend(rests.map(|last| (frame.offset(end), last.1)));
        }
        points
    }

    /// Returns a point for each value that the robot set, at the true time at which the value becomes visible.
    fn set(&self, frame: &Frame, scale: &Scale, reported: &ActReport, played: &Played) -> Vec<(f64, f64)> {
        let log = played.log_of(self.robot).unwrap_or_default().iter().filter(|entry| {
            let of_act = entry.request_id.as_deref().and_then(act_of) == Some(reported.number);
            of_act && entry.is_set() && entry.device == *self.device
        });
        let millis = |true_ns: i64| (true_ns - reported.start.as_nanos()) as f64 / 1e6;
        log.map(|entry| (frame.offset(self.latency_ms + millis(entry.true_ns)), scale.y(entry.value)))
            .collect()
    }
}

fn are_close(dots: &[(f64, f64)]) -> bool {
    let close = |pair: &&[(f64, f64)]| pair[1].0 - pair[0].0 < DOTS_APART;
    2 * dots.windows(2).filter(close).count() > dots.len()
}

/// The scale that maps values to vertical positions in a lane.
struct Scale {
    least: f64,
    largest: f64,
}

impl Scale {
    fn of(lane: &Lane<'_>) -> Self {
        let steps = || lane.scripts.iter().flat_map(|script| script.script.steps());
        let values = || steps().flat_map(|step| step.setpoint.values());
        Self {
            least: values().fold(f64::INFINITY, f64::min),
            largest: values().fold(f64::NEG_INFINITY, f64::max),
        }
    }

    fn y(&self, value: f64) -> f64 {
        let range = self.largest - self.least;
        let part = if range > 0.0 { (value - self.least) / range } else { 0.5 };
        LANE - MARGIN - (LANE - 2.0 * MARGIN) * part
    }
}

/// Rounds a value to four decimal places, for people.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
