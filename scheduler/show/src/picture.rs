//! Draws a dry run as an SVG picture. Cues are bars. Below them, each device has a lane: a line shows the planned values, and dots show
//! the values that the robot set.

mod cues;
mod head;
mod lanes;
mod pen;
mod thinned;

use std::fmt::Write;

use downbeat_scripts::shown::within;
use downbeat_scripts::{Act, FleetRobot};

use self::cues::Cues;
use self::head::DrawingKind;
use self::lanes::Lanes;
use super::ruler::{Tick, length, ticks};
use downbeat_mission::report::ActReport;
use downbeat_rehearsal::dry_run::Played;

/// Space next to the time axis, in pixels: for names on its left, and for ranges of values on its right.
const LEFT: f64 = 170.0;
const RIGHT: f64 = 120.0;
/// Pixels per second of the act, unless the time axis would then be narrower than [`WIDTH_MIN`] or wider than [`WIDTH_MAX`].
const SECOND: f64 = 6.0;
const WIDTH_MIN: f64 = 760.0;
const WIDTH_MAX: f64 = 3_600.0;
/// Minimum distance between two ticks in pixels.
const TICK: f64 = 64.0;

/// Distances in pixels: from the top edge to the legend, from the top edge to the vertical lines at the ticks, and from the end of these
/// lines to the bottom edge.
const LEGEND: f64 = 62.0;
const TOP: f64 = 92.0;
const BOTTOM: f64 = 40.0;
/// Space above and below the cues in pixels.
const GAP: f64 = 8.0;

/// Maximum width of a name in columns.
const NAME_MAX: usize = 60;

/// The time axis of the picture, from left to right.
struct Frame {
    /// Duration of the act in milliseconds.
    total: f64,
    /// Width of the time axis in pixels, from the act's start to its end.
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

    /// Returns the distance in pixels from the act's start to an instant, which is given in milliseconds.
    fn offset(&self, millis: f64) -> f64 {
        self.width * millis / self.total
    }

    /// Returns the distance in pixels from the left edge of the picture to an instant, which is given in milliseconds.
    fn x(&self, millis: f64) -> f64 {
        LEFT + self.offset(millis)
    }

    /// Returns the position at which the names of cues must end, in pixels from the left edge.
    fn right(&self) -> f64 {
        self.full_width() - 6.0
    }

    fn full_width(&self) -> f64 {
        LEFT + self.width + RIGHT
    }
}

/// Draws the cues of an act. For each device, also draws the planned values and the values that were set in the simulation. `robots` are
/// the robots of the plan, in the plan's order; `reported` is the result of the act.
#[must_use]
pub fn draw(act: &Act, reported: &ActReport, robots: &[&FleetRobot], played: &Played) -> String {
    let frame = Frame::of(act);
    let (cues, lanes) = (Cues::place(act, &frame), Lanes::of(act, robots));
    let first_lane = TOP + GAP + cues.height() + GAP;
    let bottom = first_lane + lanes.height();
    let mut svg = String::new();
    head::open(&mut svg, &act.plan.scenario, played, frame.full_width(), bottom + BOTTOM);
    head::legend(&mut svg, LEGEND, &kinds(act, &lanes));
    head::grid(&mut svg, &frame, TOP, bottom);
    cues.draw(&mut svg, TOP + GAP);
    lanes.draw(&mut svg, first_lane, &frame, reported, played);
    if let Some(note) = lanes.note() {
        let _infallible = write!(svg, "<text x='{LEFT}' y='{}' class='small'>{note}</text>", bottom + 30.0);
    }
    svg.push_str("</svg>\n");
    svg
}

/// Returns the kinds of drawing, such as cues and planned values, that the picture of an act contains.
fn kinds(act: &Act, lanes: &Lanes<'_>) -> Vec<DrawingKind> {
    let occurs = [
        (DrawingKind::Cue, act.cues.iter().any(|cue| !cue.critical)),
        (DrawingKind::Critical, act.cues.iter().any(|cue| cue.critical)),
        (DrawingKind::Planned, true),
        (DrawingKind::Further, lanes.has_further_values()),
        (DrawingKind::Set, true),
    ];
    occurs.into_iter().filter(|(_, occurs)| *occurs).map(|(kind, _)| kind).collect()
}

fn escaped(text: &str, columns: usize) -> String {
    within(text, columns).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
