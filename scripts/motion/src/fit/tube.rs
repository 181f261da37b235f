//! Straight lines through a tube around the curve. They need not be connected or lie on a grid, so their number is a lower bound for all
//! steps.

use std::cmp::Ordering;

use super::Samples;
use super::cones::Sight;
use super::lattice::Candidates;

/// A curve with precomputed data. The tube contains all values within the room, which is the largest allowed distance from the curve.
pub(super) struct Tubes<'a> {
    curve: Samples<'a>,
    /// The slope from each sample to the next.
    slopes: Vec<f64>,
    /// For each sample, the bend of the curve before it.
    bends: Vec<Bend>,
}

/// The bend of a curve before a sample.
#[derive(Clone, Copy)]
struct Bend {
    /// The earliest sample from which the curve bends to one side only, up to the sample that this bend belongs to.
    since: usize,
    /// The side to which the curve bends: above 0 if slopes increase, below 0 if they decrease.
    side: f64,
}

impl<'a> Tubes<'a> {
    pub(super) fn of(curve: &Samples<'a>) -> Self {
        let Samples { times, values, .. } = *curve;
        let slope = |i: usize| (values[i] - values[i - 1]) / (times[i] - times[i - 1]);
        let slopes: Vec<f64> = (1..times.len()).map(slope).collect();
        let (mut up, mut down) = (0, 0);
        let bend = |sample: usize| {
            if let Some(before) = sample.checked_sub(2) {
                match slopes[before + 1] - slopes[before] {
                    bend if bend > 0.0 => up = before + 1,
                    bend if bend < 0.0 => down = before + 1,
                    _ => {}
                }
            }
            let side = match up.cmp(&down) {
                Ordering::Greater => 1.0,
                Ordering::Less => -1.0,
                Ordering::Equal => 0.0,
            };
            Bend { since: up.min(down), side }
        };
        let bends = (0..times.len()).map(bend).collect();
        Self { curve: *curve, slopes, bends }
    }

    /// Whether at most `steps` steps, all at samples, suffice for a polyline whose distance from the curve is at most `room`.
    pub(super) fn is_enough(&self, room: f64, steps: usize) -> bool {
        let mut pieces = 0;
        self.backwards(room, |_, count| {
            pieces = count as usize;
            pieces < steps
        });
        pieces < steps
    }

    /// Returns the minimum number of steps, all at samples, of a polyline whose distance from the curve is at most `room`.
    pub(super) fn steps_at_least(&self, room: f64) -> usize {
        self.pieces_left(room).first().map_or(0, |pieces| *pieces as usize + 1)
    }

    /// For each sample, the fewest straight pieces from there to the last sample. Each piece starts and ends at a sample.
    pub(super) fn pieces_left(&self, room: f64) -> Vec<u32> {
        let mut left = vec![0; self.curve.times.len()];
        self.backwards(room, |sample, pieces| {
            left[sample] = pieces;
            true
        });
        left
    }

    /// Visits the samples from the last to the first, each with the fewest pieces from there to the end, while the visitor returns true.
    ///
    /// Greedily extends pieces backwards from the end: if one line can follow a section, it can also follow every part of it.
    fn backwards(&self, room: f64, mut visit: impl FnMut(usize, u32) -> bool) {
        let Some(last) = self.curve.times.len().checked_sub(1) else { return };
        let mut piece = Piece::new(self, room, last);
        let mut pieces = u32::from(last > 0);
        let mut wanted = visit(last, 0);
        for sample in (0..last).rev() {
            if !wanted {
                break;
            }
            if !piece.add(sample) {
                pieces += 1;
                piece.begin(sample + 1);
                piece.add(sample);
            }
            wanted = visit(sample, pieces);
        }
    }

    /// The fewest groups of consecutive samples such that one line can pass each group.
    pub(super) fn groups(&self, room: f64) -> usize {
        // A step at a jump only needs to be close to one side of it.
        let mut samples = (0..self.curve.times.len()).rev().filter(|sample| self.curve.gap(*sample) == 0.0);
        let Some(last) = samples.next() else { return 1 };
        let mut piece = Piece::new(self, room, last);
        let mut groups = 1;
        for sample in samples {
            if !piece.add(sample) {
                groups += 1;
                piece.begin(sample);
            }
        }
        groups
    }
}

/// Consecutive samples that one line can pass within the room (the largest allowed distance from the curve). They are extended backwards
/// from the last one.
struct Piece<'a> {
    tubes: &'a Tubes<'a>,
    room: f64,
    last: usize,
    bend: Bend,
    /// The sample farthest from the line between the first and the last sample. Only used if the curve bends to one side only.
    farthest: usize,
    /// Whether the curve bends to both sides or jumps in this piece. Only then is the tube needed.
    is_winding: bool,
    tube: Tube,
}

impl<'a> Piece<'a> {
    fn new(tubes: &'a Tubes<'a>, room: f64, last: usize) -> Self {
        let (bend, tube) = (tubes.bends[last], Tube::default());
        let mut piece = Self { tubes, room, last, bend, farthest: last, is_winding: false, tube };
        piece.begin(last);
        piece
    }

    fn begin(&mut self, last: usize) {
        (self.last, self.farthest, self.bend) = (last, last, self.tubes.bends[last]);
        self.is_winding = false;
        if !self.tubes.curve.gaps.is_empty() {
            self.wind(last);
        }
    }

    /// Returns the negated time of a sample, and the lowest and highest value at which a line may pass it.
    fn gap(&self, sample: usize) -> Gap {
        let (low, high) = self.tubes.curve.gate(sample, self.room);
        Gap { x: -self.tubes.curve.times[sample], low, high }
    }

    fn wind(&mut self, first: usize) {
        self.is_winding = true;
        self.tube.clear();
        for sample in (first..=self.last).rev() {
            self.tube.add(self.gap(sample));
        }
    }

    /// Prepends a sample. Returns whether one line still passes all samples.
    #[inline]
    fn add(&mut self, first: usize) -> bool {
        if first < self.bend.since || self.is_winding {
            if !self.is_winding {
                self.wind(first + 1);
            }
            return self.tube.add(self.gap(first));
        }
        let (times, values) = (self.tubes.curve.times, self.tubes.curve.values);
        let slope = (values[self.last] - values[first]) / (times[self.last] - times[first]);
        let mut farthest = self.farthest;
        while farthest > first + 1 && (self.tubes.slopes[farthest - 1] - slope) * self.bend.side > 0.0 {
            farthest -= 1;
        }
        self.farthest = farthest;
        let chord = values[first] + slope * (times[farthest] - times[first]);
        // The best line is halfway between the chord and the parallel tangent.
        (chord - values[farthest]).abs() <= 2.0 * self.room
    }
}

/// The lines through a growing sequence of vertical gaps (O'Rourke 1981).
///
/// The steepest line touches the bottom of a gap and the top of a later gap; the flattest line touches a top and a later bottom. Only
/// corners of the convex hull of the bottoms so far, or of the tops so far, can be on the next steepest or flattest line.
#[derive(Default)]
struct Tube {
    steepest: Option<Line>,
    flattest: Option<Line>,
    tops: Hull,
    bottoms: Hull,
}

/// A vertical gap at `x`, from `low` to `high`.
#[derive(Clone, Copy)]
struct Gap {
    x: f64,
    low: f64,
    high: f64,
}

/// A line through a corner of the hull and a point to the right of the corner.
#[derive(Clone, Copy)]
struct Line {
    corner: (f64, f64),
    /// Horizontal and vertical distance from the corner to the point.
    run: f64,
    rise: f64,
}

impl Line {
    fn through(corner: (f64, f64), point: (f64, f64)) -> Self {
        Self { corner, run: point.0 - corner.0, rise: point.1 - corner.1 }
    }

    /// Returns the height of a point above the line, multiplied by `run` to avoid a division.
    fn below(&self, point: (f64, f64)) -> f64 {
        (point.1 - self.corner.1) * self.run - self.rise * (point.0 - self.corner.0)
    }

    fn at(&self, x: f64) -> f64 {
        self.corner.1 + self.rise / self.run * (x - self.corner.0)
    }

    fn is_steeper_than(&self, other: &Self) -> bool {
        self.rise * other.run > other.rise * self.run
    }
}

impl Tube {
    /// Removes all gaps, but keeps the allocated memory.
    fn clear(&mut self) {
        (self.steepest, self.flattest) = (None, None);
        self.tops.clear();
        self.bottoms.clear();
    }

    /// Adds a gap. Returns whether one line still passes all gaps.
    fn add(&mut self, gap: Gap) -> bool {
        let Gap { x, low, high } = gap;
        let (bottom, top) = ((x, low), (x, high));
        let above = self.steepest.is_some_and(|line| line.below(bottom) > 0.0);
        let below = self.flattest.is_some_and(|line| line.below(top) < 0.0);
        if above || below {
            return false;
        }
        if self.steepest.is_none_or(|line| line.below(top) < 0.0) {
            self.steepest = self.bottoms.touch(top, |line, best| !line.is_steeper_than(best));
        }
        if self.flattest.is_none_or(|line| line.below(bottom) > 0.0) {
            self.flattest = self.tops.touch(bottom, |line, best| !best.is_steeper_than(line));
        }
        self.tops.push(top, |turn| turn > 0.0);
        self.bottoms.push(bottom, |turn| turn < 0.0);
        true
    }
}

/// The lines that start anywhere between the lowest and the highest of some values. They reach a superset of the values that lines from
/// these values reach.
pub(super) struct View {
    tube: Tube,
    /// Upper bound of the rounding error of values.
    dust: f64,
}

impl View {
    pub(super) fn new(dust: f64) -> Self {
        Self { tube: Tube::default(), dust }
    }
}

impl Sight for View {
    fn begin(&mut self, of: &Candidates, set: u64) {
        let [lowest, highest] = [set.trailing_zeros(), 63 - set.leading_zeros()];
        #[expect(clippy::cast_possible_truncation, reason = "below 64")]
        let [low, high] = [lowest, highest].map(|candidate| of.value(candidate as u8));
        self.tube.clear();
        self.tube.add(Gap { x: 0.0, low: low - self.dust, high: high + self.dust });
    }

    fn reached(&mut self, of: &Candidates, wanted: u64, duration: f64) -> u64 {
        match (self.tube.flattest, self.tube.steepest) {
            (Some(flattest), Some(steepest)) => {
                wanted & of.between(flattest.at(duration), steepest.at(duration))
            }
            _ => wanted,
        }
    }

    fn narrow(&mut self, duration: f64, low: f64, high: f64) -> bool {
        self.tube.add(Gap { x: duration, low: low - self.dust, high: high + self.dust })
    }
}

/// A convex hull: its corners from left to right. Lines can no longer touch the corners before index `touched`.
#[derive(Default)]
struct Hull {
    corners: Vec<(f64, f64)>,
    touched: usize,
}

impl Hull {
    fn clear(&mut self) {
        self.corners.clear();
        self.touched = 0;
    }

    /// Returns the best line through a corner of the hull and `point`. `no_worse` compares two lines. From left to right, lines get no
    /// worse up to the best one, and then worse.
    fn touch(&mut self, point: (f64, f64), no_worse: impl Fn(&Line, &Line) -> bool) -> Option<Line> {
        let (first, later) = self.corners.get(self.touched..)?.split_first()?;
        let mut best = Line::through(*first, point);
        for corner in later {
            let line = Line::through(*corner, point);
            if !no_worse(&line, &best) {
                break;
            }
            best = line;
            self.touched += 1;
        }
        Some(best)
    }

    /// Adds a corner on the right, and drops the corners that are then inside the hull.
    fn push(&mut self, point: (f64, f64), convex: impl Fn(f64) -> bool) {
        while self.corners.len() >= self.touched + 2 {
            let [.., a, b] = self.corners[..] else { break };
            let turn = (b.0 - a.0) * (point.1 - b.1) - (b.1 - a.1) * (point.0 - b.0);
            if convex(turn) {
                break;
            }
            self.corners.pop();
        }
        self.corners.push(point);
    }
}
