//! Cuts a formula into smooth pieces. The bounds of slope and curvature of each piece determine the sampling density. Corners and jumps
//! between pieces are located to the nanosecond.

use urrcp::Span;

use super::Formula;
use super::interval::jet;

/// Maximum number of pieces of a formula.
const PIECES_MAX: usize = 4_096;
/// Maximum number of intervals that are examined to cut one formula.
const LOOKS_MAX: usize = 100_000;
/// Largest allowed ratio of a piece's bound on the curvature to the largest curvature that was sampled.
const LOOSE: f64 = 1.5;
/// Divisor of a formula's duration: a smooth piece that is shorter than the quotient is not cut to improve its bounds.
const SHORTEST_PART: i64 = 512;
/// Largest bending of a piece. The bending is the piece's length times the square root of the ratio of its curvature to its range of
/// values; one period of a sine has the bending 4.4. A piece with more bending would need more samples than are fitted together.
const BENDS_MAX: f64 = 40.0;
/// Largest bending ([`BENDS_MAX`]) of all pieces together: about ten thousand periods of a sine.
const BENDS_IN_ALL_MAX: f64 = 45_000.0;
/// Largest absolute value of a formula; larger ones are invalid.
const VALUE_MAX: f64 = 1e12;

/// A part of a formula from one time to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// The start of the piece, from the start of the formula.
    pub begin: Span,
    /// The end of the piece, from the start of the formula.
    pub end: Span,
    /// Upper bounds of the absolute slope, in units per second, and of the second derivative. `None` for a piece of one or two
    /// nanoseconds that contains a corner or a jump.
    pub rates: Option<(f64, f64)>,
    /// The lower and the upper bound of the piece's values.
    values: (f64, f64),
}

/// The reason why a formula cannot be used as a movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// The formula has no valid value at this time.
    NoValue(Span),
    /// The formula has more pieces than the limit.
    TooMany,
}

/// Cuts the first `length` of a formula into pieces, in order.
pub fn pieces(formula: &Formula, length: Span) -> Result<Vec<Piece>, Trouble> {
    let whole = length.as_nanos();
    let mut done: Vec<Piece> = Vec::new();
    let mut left = vec![(0, whole)];
    let mut looks = 0;
    while let Some((begin, end)) = left.pop() {
        looks += 1;
        if looks > LOOKS_MAX || done.len() > PIECES_MAX {
            return Err(Trouble::TooMany);
        }
        let (from, to) = (seconds(begin), seconds(end));
        let found = jet(formula, from, to).map(|jet| {
            ((jet.value.0, jet.value.1), jet.slope.largest(), jet.curvature.largest() * (1.0 + 1e-9))
        });
        let rates = found.filter(|(values, _, curvature)| {
            *curvature == 0.0
                || (bending(end - begin, *curvature, values.1 - values.0) <= BENDS_MAX
                    && (end - begin <= (whole / SHORTEST_PART).max(1)
                        || *curvature <= LOOSE * sampled_curvature(formula, from, to)))
        });
        let valued = |nanos: i64| formula.at(seconds(nanos)).abs() <= VALUE_MAX;
        for nanos in [begin, end] {
            if !valued(nanos) {
                return Err(Trouble::NoValue(Span::from_nanos(nanos)));
            }
        }
        if rates.is_none() && end - begin > 1 {
            let middle = begin + (end - begin) / 2;
            left.push((middle, end));
            left.push((begin, middle));
            continue;
        }
        let (begin, end) = (Span::from_nanos(begin), Span::from_nanos(end));
        let values = rates.map_or((0.0, 0.0), |(values, ..)| values);
        let rates = rates.map(|(_, slope, curvature)| (slope, curvature));
        join(&mut done, formula, whole, Piece { begin, end, rates, values });
    }
    if done.iter().map(Piece::bends).sum::<f64>() <= BENDS_IN_ALL_MAX {
        Ok(done)
    } else {
        Err(Trouble::TooMany)
    }
}

/// Returns the bending of a piece (see [`BENDS_MAX`]), given its length in nanoseconds, its curvature, and the difference
/// between its largest and its smallest value.
fn bending(length: i64, curvature: f64, range: f64) -> f64 {
    if curvature == 0.0 { 0.0 } else { seconds(length) * (curvature / range.max(f64::MIN_POSITIVE)).sqrt() }
}

impl Piece {
    fn bends(&self) -> f64 {
        let length = (self.end - self.begin).as_nanos();
        self.rates.map_or(0.0, |(_, curvature)| bending(length, curvature, self.values.1 - self.values.0))
    }
}

/// Appends a piece of a formula of `whole` nanoseconds to `done`. If the last piece of `done` is similar, extends that piece instead.
fn join(done: &mut Vec<Piece>, formula: &Formula, whole: i64, piece: Piece) {
    if let Some(last) = done.last_mut() {
        let values = (last.values.0.min(piece.values.0), last.values.1.max(piece.values.1));
        let joined = match (last.rates, piece.rates) {
            (None, None) => Some(None),
            (Some((slope, curvature)), Some((next_slope, next_curvature))) => {
                let (one, other) = (last.end - last.begin, piece.end - piece.begin);
                let bends = |length: Span, curvature: f64| length.as_millis_f64() * curvature.sqrt();
                let high = curvature.max(next_curvature);
                let most = bends(one, curvature).max(bends(other, next_curvature));
                // A short piece next to a corner does not need to be separate.
                let short = 4 * one.min(other).as_nanos() <= one.max(other).as_nanos()
                    || 64 * (one + other).as_nanos() <= whole;
                let alike = short
                    && bending((one + other).as_nanos(), high, values.1 - values.0) <= BENDS_MAX
                    && bends(one + other, high) <= 2.0 * most
                    && is_smooth(formula, last.end);
                alike.then_some(Some((slope.max(next_slope), high)))
            }
            _ => None,
        };
        if let Some(rates) = joined {
            (last.end, last.rates) = (piece.end, rates);
            last.values = values;
            return;
        }
    }
    done.push(piece);
}

/// Whether two pieces that meet at the time `at` join without a corner.
fn is_smooth(formula: &Formula, at: Span) -> bool {
    let nanos = at.as_nanos();
    let slope = |from: i64, to: i64| jet(formula, seconds(from), seconds(to)).map(|jet| jet.slope);
    let Some((before, after)) = slope(nanos - 1, nanos).zip(slope(nanos, nanos + 1)) else { return false };
    let dust = 1e-9 * before.largest().max(after.largest());
    before.0 <= after.1 + dust && after.0 <= before.1 + dust
}

/// The largest curvature among samples in an interval, given in seconds.
fn sampled_curvature(formula: &Formula, from: f64, to: f64) -> f64 {
    let at = |part: f64| {
        let time = from + (to - from) * part;
        jet(formula, time, time).map_or(0.0, |jet| jet.curvature.largest())
    };
    [0.0, 0.17, 0.34, 0.5, 0.63, 0.81, 1.0].into_iter().map(at).fold(0.0, f64::max)
}

#[expect(clippy::cast_precision_loss, reason = "a track is shorter than 2^53 ns")]
fn seconds(nanos: i64) -> f64 {
    nanos as f64 / 1e9
}

/// Converts a time to seconds. All users of a formula must use this conversion: a time that is rounded differently may be after a jump.
pub fn seconds_of(time: Span) -> f64 {
    seconds(time.as_nanos())
}

impl Formula {
    /// Returns the largest slope, per second, and the largest second derivative among many samples between two times in seconds.
    pub fn peak_rates(&self, from: f64, to: f64) -> (f64, f64) {
        let at = |part: u32| {
            let time = from + (to - from) * f64::from(part) / 256.0;
            jet(self, time, time).map_or((0.0, 0.0), |jet| (jet.slope.largest(), jet.curvature.largest()))
        };
        (0..=256).map(at).fold((0.0, 0.0), |most, found| (most.0.max(found.0), most.1.max(found.1)))
    }
}
