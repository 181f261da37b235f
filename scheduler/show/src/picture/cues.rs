//! Draws the cues of an act as bars, in as few rows as possible without overlapping names.

use std::fmt::Write;

use downbeat_scripts::shown::within;
use downbeat_scripts::{Act, PlannedCue, counted};
use unicode_width::UnicodeWidthStr;

use super::{Frame, NAME_MAX, escaped};

const ROW: f64 = 18.0;
const BAR: f64 = 14.0;
/// Maximum number of rows. Cues that would need more rows are counted, not drawn.
const ROWS_MAX: usize = 40;
/// Minimum distance between two cues in the same row, in pixels.
const GAP: f64 = 6.0;
/// Maximum width of a drawn name in columns. The bar's title contains the whole name.
const LABEL_MAX: usize = 32;
/// Maximum width of one character column of small text in common fonts, in pixels.
const COLUMN: f64 = 6.2;

/// The position of a name relative to its bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Label {
    Within,
    After,
    Before,
    LeftOut,
}

#[derive(Debug)]
struct Placed<'a> {
    cue: &'a PlannedCue,
    row: usize,
    x: f64,
    width: f64,
    label: Label,
}

/// A horizontal space, in pixels.
#[derive(Clone, Copy)]
struct Extent {
    start: f64,
    end: f64,
}

/// The cues of an act with their positions in the picture.
pub(super) struct Cues<'a> {
    placed: Vec<Placed<'a>>,
    rows: usize,
    left_out: usize,
}

impl<'a> Cues<'a> {
    /// Assigns a row to every cue and places its name. If this takes too many rows, only names that are narrower than their bars are
    /// drawn.
    pub(super) fn place(act: &'a Act, frame: &Frame) -> Self {
        let named = Self::in_rows(act, frame, label_of);
        if named.left_out == 0 { named } else { Self::in_rows(act, frame, label_within) }
    }

    /// Places cues in the order of their starts, each in the first row that has room for it and its name.
    fn in_rows(act: &'a Act, frame: &Frame, label: fn(&PlannedCue, Extent, &Frame) -> Label) -> Self {
        let mut cues: Vec<_> = act.cues.iter().collect();
        cues.sort_by_key(|cue| cue.start);
        // The right end of the last cue of each row, in pixels.
        let mut ends: Vec<f64> = Vec::new();
        let mut placed = Vec::new();
        for cue in cues {
            let bar = bar_of(cue, frame);
            let label = label(cue, bar, frame);
            let row = row(&mut ends, extent(cue, bar, label));
            placed.extend(row.map(|row| Placed {
                cue,
                row,
                x: bar.start,
                width: bar.end - bar.start,
                label,
            }));
        }
        let left_out = act.cues.len() - placed.len();
        Self { placed, rows: ends.len(), left_out }
    }

    pub(super) fn height(&self) -> f64 {
        ROW * (self.rows + usize::from(self.left_out > 0)) as f64
    }

    pub(super) fn draw(&self, svg: &mut String, top: f64) {
        self.placed.iter().for_each(|placed| placed.draw(svg, top));
        if self.left_out > 0 {
            let (y, left_out) = (top + ROW * self.rows as f64 + 10.5, counted(self.left_out, "more cue"));
            let _infallible =
                write!(svg, "<text x='{}' y='{y}' class='small'>and {left_out}</text>", super::LEFT);
        }
    }
}

impl Placed<'_> {
    fn draw(&self, svg: &mut String, top: f64) {
        let (cue, y) = (self.cue, top + ROW * self.row as f64);
        let class = if cue.critical { "cue critical" } else { "cue" };
        let critical = if cue.critical { ", on the critical path" } else { "" };
        let _infallible = write!(
            svg,
            "<g><title>{}: {} to {}, slack {}{critical}</title>\
             <rect x='{:.1}' y='{y:.1}' width='{:.1}' height='{BAR}' class='{class}'/>",
            escaped(&cue.name, NAME_MAX),
            cue.start,
            cue.end,
            cue.slack,
            self.x,
            self.width,
        );
        let (x, anchor) = match self.label {
            Label::Within => (self.x + 4.0, ""),
            Label::After => (self.x + self.width + 4.0, ""),
            Label::Before => (self.x - 4.0, " text-anchor='end'"),
            Label::LeftOut => return svg.push_str("</g>"),
        };
        let name = escaped(&cue.name, LABEL_MAX);
        let _infallible =
            write!(svg, "<text x='{x:.1}' y='{:.1}' class='name'{anchor}>{name}</text></g>", y + 10.5);
    }
}

/// Returns the start and end of a cue's bar in pixels. The bar is at least wide enough to be visible.
fn bar_of(cue: &PlannedCue, frame: &Frame) -> Extent {
    let [start, end] = [cue.start, cue.end].map(|at| frame.x(at.as_millis_f64()));
    Extent { start, end: end.max(start + 2.0) }
}

fn label_width(cue: &PlannedCue) -> f64 {
    within(&cue.name, LABEL_MAX).width() as f64 * COLUMN
}

fn label_of(cue: &PlannedCue, bar: Extent, frame: &Frame) -> Label {
    let width = label_width(cue) + 8.0;
    match (width <= bar.end - bar.start, bar.end + width <= frame.right()) {
        (true, _) => Label::Within,
        (false, true) => Label::After,
        (false, false) => Label::Before,
    }
}

fn label_within(cue: &PlannedCue, bar: Extent, frame: &Frame) -> Label {
    match label_of(cue, bar, frame) {
        Label::Within => Label::Within,
        Label::After | Label::Before | Label::LeftOut => Label::LeftOut,
    }
}

/// Returns the space that a cue and its name cover.
fn extent(cue: &PlannedCue, bar: Extent, label: Label) -> Extent {
    let width = label_width(cue) + 4.0;
    match label {
        Label::Within | Label::LeftOut => bar,
        Label::After => Extent { end: bar.end + width, ..bar },
        Label::Before => Extent { start: bar.start - width, ..bar },
    }
}

/// Reserves a space in the first row that has room for it, or else in a new row. Returns the index of
/// the row, or `None` if a new row would exceed the maximum number of rows.
fn row(ends: &mut Vec<f64>, space: Extent) -> Option<usize> {
    let free = ends.iter().position(|before| before + GAP <= space.start);
    let row = free.or_else(|| {
        ends.push(f64::NEG_INFINITY);
        Some(ends.len() - 1)
    });
    let row = row.filter(|row| *row < ROWS_MAX);
    ends.truncate(ROWS_MAX);
    if let Some(row) = row {
        ends[row] = space.end;
    }
    row
}

#[cfg(test)]
mod tests {
    use downbeat_scripts::{Choreography, Plan};
    use urrcp::{Span, StopCondition};

    use super::*;

    fn act(cues: impl Iterator<Item = (i64, i64)>) -> Act {
        let plan = Plan {
            scenario: "show".to_owned(),
            start_tolerance: Span::ZERO,
            lead: None,
            stop_condition: StopCondition::default(),
            robots: Vec::new(),
        };
        let mut act = Choreography::of_plan(plan).acts.remove(0);
        let cue = |(start, end)| PlannedCue {
            name: "a name as names are".to_owned(),
            start: Span::from_millis(start),
            end: Span::from_millis(end),
            slack: Span::ZERO,
            critical: false,
            repetition: None,
            text: Default::default(),
        };
        act.cues = cues.map(cue).collect();
        act
    }

    #[track_caller]
    fn check(cues: impl Iterator<Item = (i64, i64)>, rows: usize, labels: &[Label], left_out: usize) {
        let act = act(cues);
        let placed = Cues::place(&act, &Frame::of(&act));
        let mut found: Vec<_> = placed.placed.iter().map(|placed| placed.label).collect();
        found.dedup();
        assert_eq!((placed.rows, found.as_slice(), placed.left_out), (rows, labels, left_out));
    }

    #[test]
    fn cues_share_rows_and_names_are_placed_where_they_fit() {
        check([(0, 5_000), (5_100, 10_000)].into_iter(), 1, &[Label::Within], 0);
        check([(0, 100), (1_000, 1_100), (2_000, 10_000)].into_iter(), 2, &[Label::After, Label::Within], 0);
        check([(0, 5_000), (9_990, 10_000)].into_iter(), 1, &[Label::Within, Label::Before], 0);
    }

    #[test]
    fn names_are_omitted_before_cues_when_rows_run_out() {
        let burst = |at: i64, cues: usize| (0..cues).map(move |_| (at, at + 10));
        let last = [(5_000, 10_000)];
        check(burst(0, 30).chain(burst(300, 30)).chain(last), 30, &[Label::LeftOut, Label::Within], 0);
        check(burst(0, 45).chain(last), ROWS_MAX, &[Label::LeftOut, Label::Within], 5);
    }
}
