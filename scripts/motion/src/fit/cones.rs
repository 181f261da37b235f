//! Lines from several values of one sample: the slopes at which the lines stay within the room at all passed samples.
//!
//! The room is the largest allowed distance from the curve; a gate is the range of values within the room at a sample. At a later time,
//! the lines from one value reach an interval. The lower the value, the higher the interval, because the lines have to pass the same
//! gates. The lowest and the highest value with remaining lines therefore bound the reached values. The values in between are only
//! examined if these two are not decisive.

use super::lattice::{Candidates, VALUES_MAX};

/// Straight lines that start at some values of a sample, and the later values that they reach.
pub(super) trait Sight {
    /// Starts with the lines from those candidates of a sample whose indices are in `set`, which is not empty.
    fn begin(&mut self, of: &Candidates, set: u64);

    /// Returns the candidates of the sample that is `duration` later that are in the set `wanted` and that at least one line reaches.
    fn reached(&mut self, of: &Candidates, wanted: u64, duration: f64) -> u64;

    /// Keeps only the lines whose values at a later sample are from `low` to `high`. Returns whether any remain.
    fn narrow(&mut self, duration: f64, low: f64, high: f64) -> bool;
}

/// The lines from each value of one sample, without approximation.
pub(super) struct Cones {
    /// The lines from each value, starting with the lowest value. Only the values in `first..end` have remaining lines.
    all: [Lines; VALUES_MAX],
    first: usize,
    end: usize,
    /// The lines from the lowest and from the highest value with remaining lines, updated for all passed gates (ranges of allowed
    /// values).
    lowest: Lines,
    highest: Lines,
    passed: Vec<Gate>,
}

/// The range of allowed values at a later sample.
#[derive(Clone, Copy)]
struct Gate {
    low: f64,
    high: f64,
    /// The inverse of the time from the start of the lines to the gate: multiplication is faster than division, and there may be many
    /// values.
    inverse: f64,
}

/// All lines from one value that pass the first `passed` gates (ranges of allowed values at later samples).
#[derive(Clone, Copy, Default)]
struct Lines {
    candidate: u8,
    value: f64,
    flattest: f64,
    steepest: f64,
    /// The number of gates, in order of time, that the lines are known to pass.
    passed: usize,
}

impl Lines {
    /// Keeps only the lines that pass the gate, which is the range of allowed values at a later sample.
    fn narrow(&mut self, gate: &Gate) {
        let (bottom, top) = ((gate.low - self.value) * gate.inverse, (gate.high - self.value) * gate.inverse);
        self.flattest = if bottom > self.flattest { bottom } else { self.flattest };
        self.steepest = if top < self.steepest { top } else { self.steepest };
    }

    /// Keeps only the lines that pass all gates (ranges of allowed values at later samples). Returns whether any remain.
    fn pass(&mut self, gates: &[Gate]) -> bool {
        gates[self.passed..].iter().for_each(|gate| self.narrow(gate));
        self.passed = gates.len();
        self.are_left()
    }

    fn are_left(&self) -> bool {
        self.flattest <= self.steepest
    }

    fn lowest(&self, duration: f64) -> f64 {
        self.value + self.flattest * duration
    }

    fn highest(&self, duration: f64) -> f64 {
        self.value + self.steepest * duration
    }

    fn reached(&self, of: &Candidates, duration: f64) -> u64 {
        if self.are_left() { of.between(self.lowest(duration), self.highest(duration)) } else { 0 }
    }
}

impl Default for Cones {
    fn default() -> Self {
        let none = Lines::default();
        let all = [none; VALUES_MAX];
        Self { all, first: 0, end: 0, lowest: none, highest: none, passed: Vec::new() }
    }
}

impl Sight for Cones {
    fn begin(&mut self, of: &Candidates, mut set: u64) {
        self.passed.clear();
        (self.first, self.end) = (0, 0);
        while set != 0 {
            #[expect(clippy::cast_possible_truncation, reason = "below 64")]
            let candidate = set.trailing_zeros() as u8;
            let (flattest, steepest) = (f64::NEG_INFINITY, f64::INFINITY);
            self.all[self.end] =
                Lines { candidate, value: of.value(candidate), flattest, steepest, passed: 0 };
            self.end += 1;
            set &= set - 1;
        }
        (self.lowest, self.highest) = (self.all[0], self.all[self.end - 1]);
    }

    fn reached(&mut self, of: &Candidates, wanted: u64, duration: f64) -> u64 {
        let wanted = wanted & self.reached_at_most(of, duration);
        if wanted == 0 || self.end - self.first == 1 {
            return wanted;
        }
        let both = self.lowest.reached(of, duration) | self.highest.reached(of, duration);
        let mut reached = wanted & both;
        for lines in self.all[self.first + 1..self.end - 1].iter_mut().rev() {
            if reached == wanted {
                break;
            }
            lines.pass(&self.passed);
            reached |= wanted & lines.reached(of, duration);
        }
        reached
    }

    #[inline]
    fn narrow(&mut self, duration: f64, low: f64, high: f64) -> bool {
        let gate = Gate { low, high, inverse: 1.0 / duration };
        self.passed.push(gate);
        self.lowest.narrow(&gate);
        self.highest.narrow(&gate);
        (self.lowest.are_left() && self.highest.are_left()) || self.drop_ended()
    }
}

impl Cones {
    /// Drops the lowest and the highest values for as long as no line from them remains. Returns whether any value remains.
    fn drop_ended(&mut self) -> bool {
        if self.first >= self.end {
            return false;
        }
        // The array contains outdated copies of these two.
        if !self.lowest.are_left() {
            self.first += 1;
        }
        if !self.highest.are_left() {
            self.end -= 1;
        }
        while self.first < self.end && !self.all[self.first].pass(&self.passed) {
            self.first += 1;
        }
        while self.first < self.end && !self.all[self.end - 1].pass(&self.passed) {
            self.end -= 1;
        }
        if self.first >= self.end {
            return false;
        }
        (self.lowest, self.highest) = (self.all[self.first], self.all[self.end - 1]);
        true
    }

    /// Returns all candidates from the lowest to the highest value that the lines reach: a superset of the reached candidates.
    fn reached_at_most(&self, of: &Candidates, duration: f64) -> u64 {
        of.between(self.highest.lowest(duration), self.lowest.highest(duration))
    }

    /// Removes and returns the values whose lines reach one of the candidates `wanted` of a later sample.
    pub(super) fn take(&mut self, of: &Candidates, wanted: u64, duration: f64) -> u64 {
        let mut taken = 0;
        if wanted & self.reached_at_most(of, duration) == 0 {
            return taken;
        }
        for lines in &mut self.all[self.first..self.end] {
            lines.pass(&self.passed);
            if lines.reached(of, duration) & wanted != 0 {
                taken |= 1 << lines.candidate;
                (lines.flattest, lines.steepest) = (f64::INFINITY, f64::NEG_INFINITY);
            }
        }
        (self.lowest, self.highest) = (self.all[self.first], self.all[self.end - 1]);
        if !self.lowest.are_left() || !self.highest.are_left() {
            self.drop_ended();
        }
        taken
    }
}
