//! Functions of s from 0 to 1 other than easings: polynomials, waves, parts of formulas, and coordinates of groups.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use super::Easing;
use super::path::{Along, Path};
use crate::expression::Formula;

/// A function of s from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub enum Function {
    /// The polynomial c0 + c1 s + c2 s^2 + ..., given by its coefficients.
    Polynomial(Box<[f64]>),
    /// The wave sin(2 pi (cycles s + phase)), with the phase in turns.
    Sine {
        /// The number of periods from 0 to 1.
        cycles: f64,
        /// The phase at the beginning, in turns.
        phase: f64,
    },
    /// Part of a formula over time; s runs from the start to the end of the part.
    Formula(Box<FormulaPart>),
    /// A coordinate of a body that moves with a group.
    Swept(Box<Swept>),
}

/// Number of samples of a movement without turns, and number of additional samples per turn (`IN_TURN`).
const SAMPLES: f64 = 1_024.0;
const IN_TURN: f64 = 128.0;
/// Distance from the end of a path's part at which samples on both sides of that end are taken. It is in u, the progress of the
/// movement from 0 to 1.
const BESIDE: f64 = 1e-9;
/// The ratio of the peak speed of the minimum jerk law to its mean speed.
const PEAK: f64 = 1.875;

/// A coordinate of a body that moves with a group: along a line or a parabola, around a centre, away from it, or all of these together.
/// The coordinate is a function of u, the minimum jerk law applied to s ([`Easing::Smooth`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Swept {
    /// The line or parabola: coefficients of 1, u and u^2.
    pub line: [f64; 3],
    /// The distance from the centre: coefficients of 1 and u.
    pub radius: [f64; 2],
    /// The angle around the centre at u = 0, in turns. The coordinate is the radius times the sine of the angle.
    pub phase: f64,
    /// The number of turns by which the angle increases from u = 0 to u = 1.
    pub turns: f64,
    /// A path along which the body is carried in addition, if any.
    pub carried: Option<Carried>,
}

/// A part of a path along which a coordinate is carried, relative to its position at u = 0. The progress of the movement, u, runs from 0
/// to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Carried {
    /// The path that carries the body.
    pub path: Arc<Path>,
    /// The coordinate of the path that the body's coordinate follows.
    pub along: Along,
    /// The factor by which the path's coordinate is multiplied, in units of the body's coordinate per metre.
    pub gain: f64,
    /// The distance along the path at u = 0, in metres.
    pub from: f64,
    /// The distance covered along the path from u = 0 to u = 1, in metres.
    pub length: f64,
    /// Whether the angle around the centre changes with the heading of the path.
    pub turning: bool,
}

impl Carried {
    /// Returns the value that the path adds, and its first two derivatives with respect to u (the progress of the movement, from 0 to 1).
    fn jet(&self, along: Along, u: f64) -> [f64; 3] {
        let [value, slope, bend] = self.path.jet(along, self.from + self.length * u);
        let [begin, ..] = self.path.jet(along, self.from);
        [value - begin, slope * self.length, bend * self.length * self.length]
    }

    fn bounds(&self, along: Along) -> (f64, f64) {
        let (slope, bend) = self.path.bounds(along);
        (slope * self.length, bend * self.length * self.length)
    }

    /// Returns the ends of the path's parts, in u (the progress of the movement, from 0 to 1). The path bends most sharply there.
    fn ends(&self) -> impl Iterator<Item = f64> {
        let ends = self.path.ends(self.from, self.from + self.length);
        ends.into_iter().map(|metres| ((metres - self.from) / self.length).clamp(0.0, 1.0))
    }
}

impl Swept {
    /// Returns the angle around the centre in radians, and its first two derivatives with respect to u (the progress of the movement).
    fn angle(&self, u: f64) -> [f64; 3] {
        let turning = self.carried.as_ref().filter(|carried| carried.turning);
        let [heading, first, second] = turning.map_or([0.0; 3], |carried| carried.jet(Along::Heading, u));
        [self.turns * u + self.phase + heading, self.turns + first, second].map(|turns| TAU * turns)
    }

    /// Returns the value of the coordinate, and its first two derivatives with respect to u (the progress of the movement).
    fn jet(&self, u: f64) -> [f64; 3] {
        let [a, b, c] = self.line;
        if self.radius == [0.0; 2] && self.carried.is_none() {
            return [a + (b + c * u) * u, b + 2.0 * c * u, 2.0 * c];
        }
        let [angle, rate, change] = self.angle(u);
        let (sine, cosine) = angle.sin_cos();
        let (radius, growth) = (self.radius[0] + self.radius[1] * u, self.radius[1]);
        let carried = self.carried.as_ref();
        let [way, speed, bend] =
            carried.map_or([0.0; 3], |carried| carried.jet(carried.along, u).map(|part| carried.gain * part));
        [
            a + (b + c * u) * u + radius * sine + way,
            b + 2.0 * c * u + growth * sine + radius * rate * cosine + speed,
            2.0 * c + 2.0 * growth * rate * cosine + radius * (change * cosine - rate * rate * sine) + bend,
        ]
    }

    /// Returns upper bounds of the coordinate's first two derivatives with respect to u (the progress of the movement).
    fn bounds(&self) -> (f64, f64) {
        let [_, b, c] = self.line.map(f64::abs);
        let (radius, growth) =
            (self.radius[0].abs().max((self.radius[0] + self.radius[1]).abs()), self.radius[1].abs());
        let carried = self.carried.as_ref();
        let turning = carried.filter(|carried| carried.turning);
        let (turns, change) = turning.map_or((0.0, 0.0), |carried| carried.bounds(Along::Heading));
        let (rate, change) = (TAU * (self.turns.abs() + turns), TAU * change);
        let (speed, bend) = carried.map_or((0.0, 0.0), |carried| {
            let (speed, bend) = carried.bounds(carried.along);
            (carried.gain.abs() * speed, carried.gain.abs() * bend)
        });
        (
            b + 2.0 * c + growth + radius * rate + speed,
            2.0 * c + 2.0 * growth * rate + radius * (rate * rate + change) + bend,
        )
    }

    /// Whether the coordinate does not change.
    pub fn is_still(&self) -> bool {
        self.bounds().0 == 0.0
    }

    /// All data that determines the coordinate, as a key for caches.
    pub(super) fn key(&self) -> impl Iterator<Item = u64> {
        let Self { line, radius, phase, turns, carried } = self;
        let numbers = line.iter().chain(radius).chain([phase, turns]).map(|number| number.to_bits());
        numbers.chain(carried.iter().flat_map(|carried| {
            let Carried { path, along, gain, from, length, turning } = carried;
            let numbers = [gain, from, length].map(|number| number.to_bits());
            numbers.into_iter().chain([*along as u64, u64::from(*turning)]).chain(path.key())
        }))
    }

    fn slope_max(&self) -> f64 {
        self.bounds().0 * Easing::Smooth.slope_max()
    }

    fn curvature_max(&self) -> f64 {
        let (slope, curvature) = self.bounds();
        slope * Easing::Smooth.curvature_max() + curvature * Easing::Smooth.slope_max().powi(2)
    }

    /// Converts the coordinate to other units, such that `offset + scale * new value` equals the present value.
    pub fn in_units(&self, scale: f64, offset: f64) -> Self {
        let [a, b, c] = self.line;
        Self {
            line: [(a - offset) / scale, b / scale, c / scale],
            radius: self.radius.map(|r| r / scale),
            carried: self.carried.clone().map(|carried| Carried { gain: carried.gain / scale, ..carried }),
            ..*self
        }
    }

    /// Upper bounds of the speed and acceleration of a point with the coordinates `axes`, with respect to s. With turns, the bounds are
    /// at most a thirtieth of a percent too large. Along a path, they are the largest values at the ends of its parts and at many
    /// samples.
    pub fn together(axes: &[Self]) -> (f64, f64) {
        let turns = axes.iter().map(|axis| axis.turns.abs()).fold(0.0, f64::max);
        let carried = axes.iter().find_map(|axis| axis.carried.as_ref());
        let samples = (SAMPLES + IN_TURN * PEAK * turns).ceil();
        // With N samples per turn, the largest sample is below a cosine's peak by a relative error of at most (pi / N)^2 / 2.
        let is_bent = turns > 0.0 || carried.is_some();
        let missed = if is_bent { 1.0 + (PI / IN_TURN).powi(2) / 2.0 } else { 1.0 };
        let at = |s: f64, u: f64| {
            let (slope, bend) = (30.0 * (s * (1.0 - s)).powi(2), 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s));
            let add = |(speed, acceleration): (f64, f64), axis: &Self| {
                let [_, first, second] = axis.jet(u);
                (speed.hypot(first * slope), acceleration.hypot(second * slope * slope + first * bend))
            };
            axes.iter().fold((0.0, 0.0), add)
        };
        let larger = |a: (f64, f64), b: (f64, f64)| (a.0.max(b.0), a.1.max(b.1));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most a thousand turns"
        )]
        let count = samples as u32;
        let even = (0..=count).map(|i| f64::from(i) / samples).map(|s| at(s, Easing::Smooth.at(s)));
        // Both sides of an end are sampled, because the second derivative may jump there.
        let ends = carried.into_iter().flat_map(Carried::ends);
        let ends = ends.map(|u| {
            let s = Easing::smooth_time(u);
            larger(at(s, (u - BESIDE).max(0.0)), at(s, (u + BESIDE).min(1.0)))
        });
        let (speed, acceleration) = even.chain(ends).fold((0.0, 0.0), larger);
        (speed * missed, acceleration * missed)
    }
}

/// The part of a formula between two times.
#[derive(Clone, Debug, PartialEq)]
pub struct FormulaPart {
    /// The whole formula.
    pub formula: Formula,
    /// The start of the part, in seconds from the start of the formula.
    pub from: f64,
    /// The end of the part, in seconds from the start of the formula.
    pub to: f64,
    /// Upper bound of the first derivative, per second.
    pub slope_max: f64,
    /// Upper bound of the second derivative, per second squared.
    pub curvature_max: f64,
}

impl FormulaPart {
    fn length(&self) -> f64 {
        self.to - self.from
    }
}

impl Function {
    /// The value of the function at s.
    pub fn at(&self, s: f64) -> f64 {
        match self {
            Self::Polynomial(coefficients) => horner(coefficients, s),
            Self::Sine { cycles, phase } => (TAU * (cycles * s + phase)).sin(),
            // The end is evaluated exactly, because the formula may jump after it.
            Self::Formula(part) if s >= 1.0 => part.formula.at(part.to),
            Self::Formula(part) => part.formula.at((part.from + part.length() * s).min(part.to)),
            Self::Swept(swept) => swept.jet(Easing::Smooth.at(s))[0],
        }
    }

    /// Upper bound of the first derivative with respect to s. For polynomials, it is the sum of |k c_k|, which may exceed the largest
    /// slope.
    pub fn slope_max(&self) -> f64 {
        match self {
            Self::Polynomial(coefficients) => weighted(coefficients, |k| k),
            Self::Sine { cycles, .. } => TAU * cycles,
            Self::Formula(part) => part.slope_max * part.length(),
            Self::Swept(swept) => swept.slope_max(),
        }
    }

    /// The largest first and second derivative with respect to s: exact for polynomials, the largest of many samples for formulas, and an
    /// upper bound for waves.
    pub fn peak_rates(&self) -> (f64, f64) {
        if let Self::Formula(part) = self {
            let (slope, curvature) = part.formula.peak_rates(part.from, part.to);
            return (slope * part.length(), curvature * part.length().powi(2));
        }
        if let Self::Swept(swept) = self {
            return Swept::together(std::slice::from_ref(swept));
        }
        let Self::Polynomial(coefficients) = self else { return (self.slope_max(), self.curvature_max()) };
        let slope = derivative(coefficients);
        let curvature = derivative(&slope);
        (largest(&slope), largest(&curvature))
    }

    /// Upper bound of the second derivative with respect to s.
    pub fn curvature_max(&self) -> f64 {
        match self {
            Self::Polynomial(coefficients) => weighted(coefficients, |k| k * (k - 1.0)),
            Self::Sine { cycles, .. } => (TAU * cycles).powi(2),
            Self::Formula(part) => part.curvature_max * part.length().powi(2),
            Self::Swept(swept) => swept.curvature_max(),
        }
    }
}

/// The largest absolute value of a polynomial from 0 to 1. It is at one of 257 points, or where the derivative changes sign between two
/// of them.
fn largest(coefficients: &[f64]) -> f64 {
    let slope = derivative(coefficients);
    let at = |i: u32| f64::from(i) / 256.0;
    let value = |s: f64| horner(coefficients, s).abs();
    let ends = (0..=256).map(|i| value(at(i)));
    let turns = (0..256).filter_map(|i| turning(&slope, at(i), at(i + 1))).map(value);
    ends.chain(turns).fold(0.0, f64::max)
}

/// Returns the zero of a polynomial between two points with different signs, found by bisection. `None` if the signs are equal.
fn turning(coefficients: &[f64], mut from: f64, mut to: f64) -> Option<f64> {
    let rises = horner(coefficients, to) > 0.0;
    if (horner(coefficients, from) > 0.0) == rises {
        return None;
    }
    for _ in 0..40 {
        let middle = f64::midpoint(from, to);
        if (horner(coefficients, middle) > 0.0) == rises { to = middle } else { from = middle }
    }
    Some(f64::midpoint(from, to))
}

fn horner(coefficients: &[f64], s: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * s + c)
}

#[expect(clippy::cast_precision_loss, reason = "a polynomial has a handful of coefficients")]
fn derivative(coefficients: &[f64]) -> Vec<f64> {
    coefficients.iter().enumerate().skip(1).map(|(k, c)| k as f64 * c).collect()
}

#[expect(clippy::cast_precision_loss, reason = "a polynomial has a handful of coefficients")]
fn weighted(coefficients: &[f64], weight: impl Fn(f64) -> f64) -> f64 {
    coefficients.iter().enumerate().map(|(k, c)| (weight(k as f64) * c).abs()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peak_rates_of_a_polynomial_match_its_samples() {
        let coefficients = vec![1.0, -3.0, 40.0, -170.0, 290.0, -214.0, 57.0];
        let (slope, curvature) = Function::Polynomial(coefficients.clone().into()).peak_rates();
        let (first, second) = (derivative(&coefficients), derivative(&derivative(&coefficients)));
        let sampled = |coefficients: &[f64]| {
            (0..=1_000_000).map(|i| horner(coefficients, f64::from(i) / 1e6).abs()).fold(0.0, f64::max)
        };
        let (fastest, hardest) = (sampled(&first), sampled(&second));
        assert!(slope >= fastest && slope <= fastest * (1.0 + 1e-9), "{slope} {fastest}");
        assert!(curvature >= hardest && curvature <= hardest * (1.0 + 1e-9), "{curvature} {hardest}");
    }

    #[test]
    fn largest_speed_and_acceleration_on_path_occur_at_sharpest_bend() {
        let points = [[0.0; 3], [10.0, 0.0, 0.0], [10.02, 0.02, 0.0], [10.02, 20.0, 0.0]];
        let path = Arc::new(Path::through(&points, false).unwrap());
        let (from, length) = (0.0, path.length());
        let axes = [Along::X, Along::Y, Along::Z].map(|along| {
            let carried = Carried { path: path.clone(), along, gain: 1.0, from, length, turning: false };
            Swept { carried: Some(carried), ..Swept::default() }
        });
        for axes in [axes.as_slice(), &axes[..1], &axes[1..2]] {
            let (mut fastest, mut hardest) = (0.0_f64, 0.0_f64);
            for i in 0..=2_000_000 {
                let s = f64::from(i) / 2e6;
                let (slope, bend) = (30.0 * (s * (1.0 - s)).powi(2), 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s));
                let rates = axes.iter().map(|axis| {
                    let [_, first, second] = axis.jet(Easing::Smooth.at(s));
                    [first * slope, second * slope * slope + first * bend]
                });
                let sum = rates
                    .fold([0.0, 0.0], |sum: [f64; 2], rate| [sum[0].hypot(rate[0]), sum[1].hypot(rate[1])]);
                (fastest, hardest) = (fastest.max(sum[0]), hardest.max(sum[1]));
            }
            let (speed, acceleration) = Swept::together(axes);
            assert!(speed >= fastest && speed < fastest * 1.001, "{speed} {fastest}");
            assert!(acceleration >= hardest && acceleration < hardest * 1.01, "{acceleration} {hardest}");
        }
    }

    #[test]
    fn largest_speed_and_acceleration_with_turns_are_tight_bounds() {
        for turns in [0.0, 0.3, 1.0, 7.3, -25.0, 140.7] {
            let axis = Swept { line: [1.0, 2.0, -0.5], radius: [2.0, 1.0], phase: 0.1, turns, carried: None };
            let (speed, acceleration) = Swept::together(std::slice::from_ref(&axis));
            let value = |s: f64| axis.jet(Easing::Smooth.at(s))[0];
            let (mut fastest, mut hardest) = (0.0_f64, 0.0_f64);
            let step = 1e-6;
            for i in 1..400_000 {
                let s = f64::from(i) / 400_000.0;
                let [before, now, after] = [s - step, s, s + step].map(value);
                fastest = fastest.max(((after - before) / (2.0 * step)).abs());
                hardest = hardest.max(((after - 2.0 * now + before) / (step * step)).abs());
            }
            // The second difference of such small steps only has a few accurate digits.
            assert!(
                speed >= fastest * (1.0 - 1e-6) && speed <= fastest * 1.0004,
                "{turns}: {speed} {fastest}"
            );
            let doubt = 1e-3 * hardest + 0.02;
            assert!(
                acceleration >= hardest - doubt && acceleration <= hardest * 1.0004 + doubt,
                "{turns}: {acceleration} {hardest}"
            );
        }
    }
}
