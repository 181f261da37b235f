//! Straight lines through a tube around the curve, on no grid and not connected: what no steps can beat.

use super::Samples;

/// Steps at samples that a polyline within the room needs at least.
pub(super) fn steps_at_least(curve: &Samples, room: f64) -> usize {
    pieces_left(curve, room).first().map_or(0, |pieces| *pieces as usize + 1)
}

/// For each sample, the fewest straight pieces from it to the last sample, each from a sample to a sample.
///
/// Longest pieces from the end backwards: a part of what one line can follow, one line can follow.
pub(super) fn pieces_left(curve: &Samples, room: f64) -> Vec<u32> {
    let mut left = vec![0; curve.times.len()];
    let at = |i: usize| gap(curve, i, room);
    let mut tube = Tube::default();
    let mut pieces = 1;
    for i in (0..curve.times.len()).rev() {
        if !tube.add(at(i)) {
            pieces += 1;
            tube = Tube::default();
            tube.add(at(i + 1));
            tube.add(at(i));
        }
        left[i] = pieces;
    }
    if let Some(last) = left.last_mut() {
        *last = 0;
    }
    left
}

/// The fewest groups of samples that follow each other and each of which one line can pass.
pub(super) fn groups(curve: &Samples, room: f64) -> usize {
    let mut tube = Tube::default();
    let mut groups = 1;
    // A step right at a jump needs to be close to one side of it only.
    for i in (0..curve.times.len()).rev().filter(|i| curve.gap(*i) == 0.0) {
        if !tube.add(gap(curve, i, room)) {
            groups += 1;
            tube = Tube::default();
            tube.add(gap(curve, i, room));
        }
    }
    groups
}

/// Where a line may pass a sample, by time backwards.
fn gap(curve: &Samples, sample: usize, room: f64) -> (f64, f64, f64) {
    let (value, room) = (curve.values[sample], curve.room_at(sample, room));
    (-curve.times[sample], value - room, value + room)
}

/// The lines that pass through a growing sequence of vertical gaps (O'Rourke 1981).
///
/// The steepest line touches a gap's bottom and a later gap's top, the flattest a top and a later bottom. Only corners of
/// the convex hull of the bottoms so far, or of the tops, can carry the next such line.
#[derive(Default)]
struct Tube {
    steepest: Option<Line>,
    flattest: Option<Line>,
    tops: Hull,
    bottoms: Hull,
}

#[derive(Clone, Copy)]
struct Line {
    through: (f64, f64),
    slope: f64,
}

impl Line {
    fn at(&self, x: f64) -> f64 {
        self.through.1 + self.slope * (x - self.through.0)
    }
}

impl Tube {
    /// Adds the gap at `x` from `low` to `high`; false if no line passes any more.
    fn add(&mut self, (x, low, high): (f64, f64, f64)) -> bool {
        let (bottom, top) = ((x, low), (x, high));
        let above = self.steepest.is_some_and(|line| low > line.at(x));
        let below = self.flattest.is_some_and(|line| high < line.at(x));
        if above || below {
            return false;
        }
        if self.steepest.is_none_or(|line| high < line.at(x)) {
            self.steepest = self.bottoms.touch(top, |slope, best| slope < best);
        }
        if self.flattest.is_none_or(|line| low > line.at(x)) {
            self.flattest = self.tops.touch(bottom, |slope, best| slope > best);
        }
        self.tops.push(top, |turn| turn > 0.0);
        self.bottoms.push(bottom, |turn| turn < 0.0);
        true
    }
}

/// Corners from left to right; those ahead of the last touched one can no longer be touched.
#[derive(Default)]
struct Hull {
    corners: Vec<(f64, f64)>,
    touched: usize,
}

impl Hull {
    /// The line through the point and the corner whose slope is best; along the hull slopes get better, then worse.
    fn touch(&mut self, point: (f64, f64), better: impl Fn(f64, f64) -> bool) -> Option<Line> {
        let slope_to = |corner: &(f64, f64)| (point.1 - corner.1) / (point.0 - corner.0);
        let mut best = slope_to(self.corners.get(self.touched)?);
        while let Some(slope) = self.corners.get(self.touched + 1).map(slope_to) {
            if better(best, slope) {
                break;
            }
            best = slope;
            self.touched += 1;
        }
        Some(Line { through: self.corners[self.touched], slope: best })
    }

    /// Adds a corner on the right and drops those that it covers.
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
