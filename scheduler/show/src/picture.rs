//! A dry run as an SVG picture: cues as bars, below them a lane per device, with planned values as a line and the values that the robot
//! set as dots.

mod cues;
mod head;
mod lanes;
mod pen;
mod thinned;

use std::fmt::Write;

use downbeat_scripts::shown::within;
use downbeat_scripts::{Act, FleetRobot};

use self::cues::Cues;
use self::head::Kind;
use self::lanes::Lanes;
use super::ruler::{Tick, length, ticks};
use downbeat_mission::report::ActReport;
use downbeat_rehearsal::dry_run::Played;

/// Pixels to the left and right of the time axis, for names and ranges.
const LEFT: f64 = 170.0;
const RIGHT: f64 = 120.0;
/// Pixels per second, within the limits of the total width.
const SECOND: f64 = 6.0;
const WIDTH_MIN: f64 = 760.0;
const WIDTH_MAX: f64 = 3_600.0;
/// Minimum pixels between two ticks.
const TICK: f64 = 64.0;

/// Pixels from the top edge to the legend and to the lines of the upper ruler, and pixels below those lines.
const LEGEND: f64 = 62.0;
const TOP: f64 = 92.0;
const BOTTOM: f64 = 40.0;
/// Pixels above and below the cues.
const GAP: f64 = 8.0;

/// Maximum columns of a name.
const NAME_MAX: usize = 60;

/// The time axis, from left to right.
struct Frame {
    /// Duration of the act in milliseconds.
    total: f64,
    /// Width of the act in pixels.
    width: f64,
    ticks: Vec<Tick>,
}

impl Frame {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some thousand pixels")]
    fn of(act: &Act) -> Self {
        let total = length(act);
        let width = (total / 1_000.0 * SECOND).clamp(WIDTH_MIN, WIDTH_MAX).round();
        Self { total, width, ticks: ticks(total, (width / TICK) as usize) }
    }

    /// Pixels from the act's start.
    fn offset(&self, millis: f64) -> f64 {
        self.width * millis / self.total
    }

    /// Pixels from the picture's edge.
    fn x(&self, millis: f64) -> f64 {
        LEFT + self.offset(millis)
    }

    /// The limit to the right for names of cues.
    fn right(&self) -> f64 {
        self.full_width() - 6.0
    }

    fn full_width(&self) -> f64 {
        LEFT + self.width + RIGHT
    }
}

/// Draws the cues of an act, and for each device the plan and the values that were set in virtual time. `robots` are those of the plan,
/// in its order; `reported` is the result of the act.
#[must_use]
pub fn draw(act: &Act, reported: &ActReport, robots: &[&FleetRobot], played: &Played) -> String {
    let frame = Frame::of(act);
    let (cues, lanes) = (Cues::place(act, &frame), Lanes::of(act, robots));
    let first_lane = TOP + GAP + cues.height() + GAP;
    let bottom = first_lane + lanes.height();
    let mut svg = String::new();
    head::open(&mut svg, &act.plan.scenario, played, (frame.full_width(), bottom + BOTTOM));
    head::legend(&mut svg, LEGEND, &kinds(act, &lanes));
    head::grid(&mut svg, &frame, (TOP, bottom));
    cues.draw(&mut svg, TOP + GAP);
    lanes.draw(&mut svg, first_lane, &frame, reported, played);
    if let Some(note) = lanes.note() {
        let _infallible = write!(svg, "<text x='{LEFT}' y='{}' class='small'>{note}</text>", bottom + 30.0);
    }
    svg.push_str("</svg>\n");
    svg
}

/// The kinds of drawing in the picture of an act.
fn kinds(act: &Act, lanes: &Lanes<'_>) -> Vec<Kind> {
    let occurs = [
        (Kind::Cue, act.cues.iter().any(|cue| !cue.critical)),
        (Kind::Critical, act.cues.iter().any(|cue| cue.critical)),
        (Kind::Planned, true),
        (Kind::Further, lanes.has_further_values()),
        (Kind::Set, true),
    ];
    occurs.into_iter().filter(|(_, occurs)| *occurs).map(|(kind, _)| kind).collect()
}

fn escaped(text: &str, columns: usize) -> String {
    within(text, columns).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
