//! Steps of a device that holds its value: greedily finds the longest runs in order.
//!
//! A movement is divided into pieces in which its value rises, falls or stays constant. A run is a time during which the device holds one
//! value. Within a piece, a run ends when the movement leaves the range of values that the held value is close enough to. Runs are
//! therefore found from values alone, and only the time of each boundary is found by bisection. A value that is close enough for a run is
//! also close enough for every part of the run. Always taking the longest run therefore gives the fewest runs.

use super::lattice::Lattice;
use super::problem::{EXTREME, ROUNDING};
use super::{Ends, Fit, Grid};

/// Maximum number of samples into which one smooth part is bisected.
const SAMPLES_MAX: usize = 65_536;
/// Precision of the extremes of a movement, as a fraction of the tolerance.
const PRECISION: f64 = 1e-6;
/// Precision of the least error for a number of steps, as a fraction of the tolerance.
const LEAST_ERROR: f64 = 0.01;

/// A movement for a device that holds its value. Times are nanoseconds from the start of the movement.
pub struct Movement<'a> {
    /// Returns the value of the smooth part with the given index at a time in nanoseconds.
    value: &'a dyn Fn(usize, i64) -> f64,
    tolerance: f64,
    pieces: Vec<Piece>,
    end: i64,
}

/// Upper bounds of the absolute first and second derivative of a movement with respect to time in seconds.
#[derive(Clone, Copy)]
pub struct Rates {
    /// Upper bound of the absolute first derivative, in units per second.
    pub slope: f64,
    /// Upper bound of the absolute second derivative, in units per second squared.
    pub curvature: f64,
}

/// An interval in which the value rises, falls or stays constant. It ends at the beginning of the next piece.
#[derive(Clone, Copy, Debug)]
struct Piece {
    begin: i64,
    from: f64,
    to: f64,
    /// The index of the smooth part that contains the piece; `None` if the value is constant.
    part: Option<usize>,
}

/// A position in a movement: a value in a piece, or the end after the last piece.
#[derive(Clone, Copy, Debug)]
struct Place {
    piece: usize,
    value: f64,
}

/// A time during which the device holds one value, from the place `start` until the next run. `low` and `high` are the places at which
/// the movement has its lowest and its highest value during the run.
#[derive(Clone, Copy, Debug)]
struct Run {
    start: Place,
    held: f64,
    low: Place,
    high: Place,
}

/// The parameters of one search for the fewest runs (times during which the device holds one value).
struct Question<'a> {
    movement: &'a Movement<'a>,
    /// The values that the device accepts; `None` if it accepts every value.
    lattice: Option<Lattice>,
    first: Option<f64>,
    last: Option<f64>,
    /// The value of the movement at the end.
    end: f64,
    /// A small addition to the room (the largest allowed error), so that rounding does not exclude a movement that just meets its
    /// tolerance.
    dust: f64,
}

impl<'a> Movement<'a> {
    /// Creates an empty movement. `value` returns the value of a smooth part, given by its index, at a time in nanoseconds.
    pub fn new(value: &'a dyn Fn(usize, i64) -> f64, tolerance: f64) -> Self {
        Self { value, tolerance, pieces: Vec::new(), end: 0 }
    }

    /// Appends an interval with the constant value `level` that ends at `until`.
    pub fn stay(&mut self, level: f64, until: i64) {
        if self.pieces.last().is_none_or(|last| last.part.is_some() || last.to != level) {
            self.pieces.push(Piece { begin: self.end, from: level, to: level, part: None });
        }
        self.end = until;
    }

    /// Appends a smooth part that ends at `until`. The part is bisected until the value is monotonic in every piece.
    pub fn follow(&mut self, part: usize, until: i64, rates: Rates) {
        let sample = |at: i64| (at, (self.value)(part, at));
        let mut samples = vec![sample(self.end), sample(until)];
        loop {
            let mut finer = Vec::with_capacity(samples.len() * 2);
            finer.push(samples[0]);
            for pair in samples.windows(2) {
                if !self.turns_nowhere(pair[0], pair[1], rates) {
                    finer.push(sample(pair[0].0.midpoint(pair[1].0)));
                }
                finer.push(pair[1]);
            }
            let is_fine = finer.len() == samples.len() || finer.len() > SAMPLES_MAX;
            samples = finer;
            if is_fine {
                break;
            }
        }
        let first = self.pieces.len();
        for pair in samples.windows(2) {
            let ((begin, from), (_, to)) = (pair[0], pair[1]);
            match self.pieces[first..].last_mut() {
                Some(last) if (last.to - last.from) * (to - from) >= 0.0 => last.to = to,
                _ => self.pieces.push(Piece { begin, from, to, part: Some(part) }),
            }
        }
        self.end = until;
    }

    /// Whether a smooth part is monotonic between two samples, except for negligible reversals. If the slope were 0 between the samples,
    /// the value could change by at most the bound of the curvature times the time squared. A larger change excludes that.
    fn turns_nowhere(&self, a: (i64, f64), b: (i64, f64), rates: Rates) -> bool {
        #[expect(clippy::cast_precision_loss, reason = "rounded far below what matters")]
        let seconds = (b.0 - a.0) as f64 * 1e-9;
        let (change, bend) = ((b.1 - a.1).abs(), rates.curvature * seconds * seconds);
        let beyond = (bend / 8.0).min((rates.slope * seconds - change) / 2.0);
        b.0 - a.0 <= 1 || change >= bend || beyond <= PRECISION * self.tolerance
    }

    /// Finds the fewest steps within the tolerance. Among the solutions with that number of steps, it finds one whose error is minimal to
    /// within 1 % of the tolerance. If more than `most` steps are needed, the search stops early, and the result lacks the remaining
    /// ones.
    ///
    /// `ends.first` is the value of the first step; if it is `None`, any value is allowed. If `ends.last` is given, the device has that
    /// value at the end, where the movement has the value `written`. The device takes a new value at the last nanosecond before the
    /// movement leaves the tolerance of the old one.
    ///
    /// # Errors
    /// Returns the smallest tolerance that can be met with any number of steps.
    pub fn fewest(&self, grid: Option<&Grid>, ends: Ends, written: f64, most: usize) -> Result<Fit, f64> {
        let lattice = grid.map(Lattice::new).transpose().map_err(|_| f64::INFINITY)?;
        let values = self.pieces.iter().flat_map(|piece| [piece.from, piece.to]);
        let values = values.chain(ends.first).chain(ends.last).chain([written]).map(f64::abs);
        if !values.clone().all(|value| value <= EXTREME) {
            return Err(f64::INFINITY);
        }
        let largest = values.fold(0.0, f64::max);
        let (Ends { first, last }, dust) = (ends, ROUNDING * largest);
        Question { movement: self, lattice, first, last, end: written, dust }.answer(most)
    }
}

/// Returns the places of the lowest and the highest value of a run after its extension by `place`.
fn widened(low: Place, high: Place, place: Place) -> (Place, Place) {
    (if place.value < low.value { place } else { low }, if place.value > high.value { place } else { high })
}

impl Question<'_> {
    fn answer(&self, most: usize) -> Result<Fit, f64> {
        let tolerance = self.movement.tolerance;
        let smallest = self.smallest();
        let found = Some(tolerance).filter(|tolerance| *tolerance + self.dust >= smallest);
        let found = found.and_then(|tolerance| self.runs(tolerance, most));
        let mut runs = found.ok_or(smallest.max(tolerance * (1.0 + 1e-9)))?;
        let steps = runs.len();
        if steps <= most {
            let (mut too_little, mut enough) = (smallest, self.worst(&runs).0);
            let mut room = smallest;
            while enough - too_little > tolerance * LEAST_ERROR + self.dust {
                match self.runs(room, steps).filter(|closer| closer.len() <= steps) {
                    None => too_little = room,
                    Some(closer) => {
                        enough = room.min(self.worst(&closer).0);
                        runs = closer;
                    }
                }
                room = f64::midpoint(too_little, enough);
            }
        }
        Ok(self.fit(&runs, most))
    }

    /// Returns a lower bound of the error of any steps, whatever their number.
    fn smallest(&self) -> f64 {
        let pieces = &self.movement.pieces;
        let first = self.first.zip(pieces.first()).map(|(first, piece)| (first - piece.from).abs());
        let ends = first.unwrap_or(0.0).max(self.off_at_end());
        let Some(lattice) = &self.lattice else { return ends };
        let off = |piece: &Piece| {
            let [from, to] = [piece.from, piece.to].map(|value| lattice.nearest(value));
            let between = if from == to { 0.0 } else { lattice.granularity / 2.0 };
            (from - piece.from).abs().max((to - piece.to).abs()).max(between)
        };
        pieces.iter().map(off).fold(ends, f64::max)
    }

    fn off_at_end(&self) -> f64 {
        self.last.map_or(0.0, |last| (last - self.end).abs())
    }

    /// Returns the fewest runs (times during which the device holds one value) whose error is at most `room`. If more than `most` runs
    /// are needed, returns only the first ones. `None` if no runs are close enough.
    fn runs(&self, room: f64, most: usize) -> Option<Vec<Run>> {
        let room = room + self.dust;
        let last_from = self.last_from(room);
        let mut prescribed = self.first;
        let mut place = self.place(0);
        let mut runs = Vec::new();
        while runs.len() <= most {
            // From here on, the last value is close enough for all remaining pieces.
            if self.reaches(place, last_from) && (prescribed.is_none() || prescribed == self.last) {
                runs.extend(self.last.map(|last| self.longest(place, Some(last), room).0));
                return Some(runs);
            }
            let (run, end) = self.longest(place, prescribed.take(), room);
            // The value would only be held for an instant.
            if end.piece == place.piece && (end.value - place.value).abs() <= 2.0 * self.dust {
                return None;
            }
            runs.push(run);
            place = end;
        }
        Some(runs)
    }

    /// Returns the place where the piece with this index starts. The index after the last piece stands for the end of the movement.
    fn place(&self, piece: usize) -> Place {
        let value = self.movement.pieces.get(piece).map_or(self.end, |piece| piece.from);
        Place { piece, value }
    }

    /// Whether `place` equals `other` or comes after it.
    fn reaches(&self, place: Place, other: Place) -> bool {
        let rises = self.movement.pieces.get(place.piece).is_none_or(|piece| piece.to >= piece.from);
        let further = if rises { place.value >= other.value } else { place.value <= other.value };
        place.piece > other.piece || place.piece == other.piece && further
    }

    /// Returns the first place from which the prescribed last value is close enough for the entire rest of the movement.
    fn last_from(&self, room: f64) -> Place {
        let pieces = &self.movement.pieces;
        let Some(last) = self.last else { return self.place(pieces.len()) };
        let serves = |value: f64| (value - last).abs() <= room;
        let is_served = |piece: &Piece| serves(piece.from) && serves(piece.to);
        let Some(piece) = pieces.iter().rposition(|piece| !is_served(piece)) else { return self.place(0) };
        match pieces[piece] {
            Piece { to, .. } if !serves(to) => self.place(piece + 1),
            Piece { from, .. } if from < last => Place { piece, value: last - room },
            _ => Place { piece, value: last + room },
        }
    }

    /// Returns the longest run from `start` with a single value, and the place where it ends. If `prescribed` is given, the run has that
    /// value.
    fn longest(&self, start: Place, prescribed: Option<f64>, room: f64) -> (Run, Place) {
        let (mut low, mut high) = (start, start);
        let mut place = start;
        while let Some(piece) = self.movement.pieces.get(place.piece) {
            let (least, greatest) = self.served(prescribed, low.value, high.value, room);
            // After a jump, the value may be out of reach.
            if !(place.value >= least && place.value <= greatest) {
                break;
            }
            (low, high) = widened(low, high, place);
            let (least, greatest) = self.served(prescribed, low.value, high.value, room);
            place.value = piece.to.clamp(least.min(place.value), greatest.max(place.value));
            (low, high) = widened(low, high, place);
            if place.value != piece.to {
                break;
            }
            place = self.place(place.piece + 1);
        }
        let middle = low.value + (high.value - low.value) / 2.0;
        let nearest = self.lattice.as_ref().map_or(middle, |lattice| lattice.nearest(middle));
        (Run { start, held: prescribed.unwrap_or(nearest), low, high }, place)
    }

    /// Returns the range of values that the movement may take without ending a run, given the lowest and the highest value of the run so
    /// far.
    fn served(&self, prescribed: Option<f64>, low: f64, high: f64, room: f64) -> (f64, f64) {
        let (least, greatest) = match (prescribed, &self.lattice) {
            (Some(value), _) => (value, value),
            (None, None) => (high - room, low + room),
            (None, Some(lattice)) => (lattice.above(high - room), lattice.below(low + room)),
        };
        (least - room, greatest + room)
    }

    /// Returns the largest error of the runs, and the place where it occurs.
    fn worst(&self, runs: &[Run]) -> (f64, Place) {
        let offs = runs
            .iter()
            .flat_map(|run| [(run.held - run.low.value, run.low), (run.high.value - run.held, run.high)]);
        let end = (self.off_at_end(), self.place(self.movement.pieces.len()));
        offs.fold(end, |worst, off| if off.0 > worst.0 { off } else { worst })
    }

    fn fit(&self, runs: &[Run], most: usize) -> Fit {
        let mut steps: Vec<(i64, f64)> = Vec::with_capacity(runs.len());
        for run in runs {
            let at = self.time(run.start);
            // If several values fall within one nanosecond, the last one applies, unless there are too many steps in any case.
            if runs.len() <= most && steps.last().is_some_and(|last| last.0 >= at) {
                steps.pop();
            }
            steps.push((at, run.held));
        }
        let (worst, place) = self.worst(runs);
        #[expect(clippy::cast_precision_loss, reason = "exact for a hundred days")]
        let millis = |nanos: i64| nanos as f64 / 1e6;
        Fit {
            at_least: steps.len(),
            steps: steps.into_iter().map(|(at, value)| (millis(at), value)).collect(),
            worst,
            worst_at: millis(self.time(place)),
        }
    }

    /// Returns the last nanosecond before the movement passes a place.
    fn time(&self, place: Place) -> i64 {
        let Movement { pieces, end, value, .. } = self.movement;
        let Some(piece) = pieces.get(place.piece) else { return *end };
        let until = pieces.get(place.piece + 1).map_or(*end, |next| next.begin);
        let Some(part) = piece.part.filter(|_| place.value != piece.from) else { return piece.begin };
        if place.value == piece.to {
            return until;
        }
        let sign = if piece.to > piece.from { 1.0 } else { -1.0 };
        let beyond = |at: i64| (value(part, at) - place.value) * sign;
        let (mut before, mut after) =
            ((piece.begin, (piece.from - place.value) * sign), (until, (piece.to - place.value) * sign));
        let narrow = |at: i64, before: &mut (i64, f64), after: &mut (i64, f64)| {
            if at > before.0 && at < after.0 {
                let off = beyond(at);
                *(if off > 0.0 { after } else { before }) = (at, off);
            }
        };
        while after.0 - before.0 > 1 {
            // Three guesses: the linear interpolation, its neighbour, and the middle.
            #[expect(
                clippy::cast_precision_loss,
                clippy::cast_possible_truncation,
                reason = "a guess between both"
            )]
            let straight =
                ((after.0 - before.0) as f64 * (before.1 / (before.1 - after.1))) as i64 + before.0;
            narrow(straight, &mut before, &mut after);
            narrow(if straight == before.0 { straight + 1 } else { straight - 1 }, &mut before, &mut after);
            narrow(before.0.midpoint(after.0), &mut before, &mut after);
        }
        before.0
    }
}

#[cfg(test)]
mod tests;
