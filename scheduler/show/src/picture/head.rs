//! Draws the parts of the picture above and behind the cues and lanes: title, legend and rulers.

use std::fmt::Write;

use super::{Frame, LEFT, NAME_MAX, escaped};
use downbeat_rehearsal::dry_run::Played;

const STYLE: &str = "text{font:12px sans-serif;fill:#222}.small,.name{font-size:10px}.small{fill:#666}\
.title{font-size:16px;font-weight:bold}.head{font-weight:bold}\
.line{fill:none;stroke:#2a6fb0;stroke-width:1.4;stroke-linejoin:round}.further{stroke-dasharray:4 2}\
.dots{fill:none;stroke:#d9480f;stroke-width:3.6;stroke-linecap:round}.fine{stroke-width:2.6}\
.grid{stroke:#ddd}.lane{fill:#fff;fill-opacity:0;stroke:#eee}.robot{fill:#eef2f6}\
.cue{fill:#cfe3f5;stroke:#2a6fb0;stroke-width:.6}.critical{fill:#ffd8a8;stroke:#a85a00;stroke-width:1.2}";

/// Writes the start of the picture, with its title and the outcome of the act.
pub(super) fn open(svg: &mut String, title: &str, played: &Played, width: f64, height: f64) {
    let spread = played.report.true_spread.map_or_else(|| "-".to_owned(), |spread| spread.to_string());
    let _infallible = write!(
        svg,
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}' width='{width}' height='{height}'>\
         <style>{STYLE}</style><rect width='100%' height='100%' fill='white'/>\
         <text x='14' y='26' class='title'>{}</text>\
         <text x='14' y='44' class='small'>{}; true start spread {spread}</text>",
        escaped(title, NAME_MAX),
        escaped(&played.report.outcome.to_string(), NAME_MAX),
    );
}

/// Draws the legend: a sample of each kind of drawing in the picture, with its meaning.
pub(super) fn legend(svg: &mut String, y: f64, kinds: &[DrawingKind]) {
    let mut x = 14.0;
    for kind in kinds {
        let (sample, meaning, width) = kind.entry();
        let _infallible = write!(
            svg,
            "<g transform='translate({x} {y})'>{sample}<text x='28' y='4' class='small'>{meaning}</text></g>"
        );
        x += width;
    }
}

/// A kind of drawing that the legend explains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DrawingKind {
    Cue,
    Critical,
    Planned,
    Further,
    Set,
}

impl DrawingKind {
    /// Returns the entry of the legend for this kind: a sample in SVG, its meaning, and the width of both in pixels.
    const fn entry(self) -> (&'static str, &'static str, f64) {
        match self {
            Self::Cue => ("<rect y='-5' width='22' height='10' class='cue'/>", "cue", 62.0),
            Self::Critical => (
                "<rect y='-5' width='22' height='10' class='cue critical'/>",
                "cue that determines when the act ends",
                236.0,
            ),
            Self::Planned => ("<path d='M0 0h22' class='line'/>", "planned", 88.0),
            Self::Further => ("<path d='M0 0h22' class='line further'/>", "dashed: further values", 164.0),
            Self::Set => ("<path d='M4 0h0m7 0h0m7 0h0' class='dots'/>", "set by the robot", 120.0),
        }
    }
}

/// Draws vertical lines at the ticks, from the upper ruler to the lower one.
pub(super) fn grid(svg: &mut String, frame: &Frame, top: f64, bottom: f64) {
    for tick in &frame.ticks {
        let (x, label) = (LEFT + frame.offset(tick.millis), &tick.label);
        let _infallible = write!(
            svg,
            "<path d='M{x:.1} {top}V{bottom}' class='grid'/>\
             <text x='{x:.1}' y='{}' class='small' text-anchor='middle'>{label}</text>\
             <text x='{x:.1}' y='{}' class='small' text-anchor='middle'>{label}</text>",
            top - 5.0,
            bottom + 14.0,
        );
    }
}
