//! The way of one body: straight with one time law, or over the others in an arc.

use crate::formation::Point;
use downbeat_motion::motion::Easing;

/// The largest slope of the time law: minimum jerk.
pub const SLOPE: f64 = 1.875;
/// Its largest second derivative, 10/sqrt(3).
pub const CURVATURE: f64 = 5.773_502_691_896_258;

/// from + (to - from) u + lift 4 u (1 - u) upwards, where u is the time law of the time since the beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// The start of the way, in metres.
    pub from: Point,
    /// The end of the way, in metres.
    pub to: Point,
    /// In seconds.
    pub begin: f64,
    /// In seconds, above 0.
    pub length: f64,
    /// How high the arc is in its middle, in metres; below 0 it leads downwards.
    pub lift: f64,
}

impl Way {
    /// A way without an arc; times in seconds.
    pub const fn straight(from: Point, to: Point, begin: f64, length: f64) -> Self {
        Self { from, to, begin, length, lift: 0.0 }
    }

    /// The time at which the way ends, in seconds.
    pub fn end(&self) -> f64 {
        self.begin + self.length
    }

    /// Metres from its beginning to its end, along x, y and z.
    pub fn vector(&self) -> Point {
        std::array::from_fn(|axis| self.to[axis] - self.from[axis])
    }

    /// Where the body is at a time in seconds.
    pub fn at(&self, time: f64) -> Point {
        let u = Easing::Smooth.at(((time - self.begin) / self.length).clamp(0.0, 1.0));
        let vector = self.vector();
        let mut at: Point = std::array::from_fn(|axis| self.from[axis] + vector[axis] * u);
        at[2] += self.lift * 4.0 * u * (1.0 - u);
        at
    }

    /// How far the body moves at most for a whole unit of the time law, in metres.
    pub fn reach(&self) -> f64 {
        let [x, y, z] = self.vector();
        x.hypot(y).hypot(z.abs() + 4.0 * self.lift.abs())
    }

    /// A bound of its speed between two times, in metres a second: the time law is fastest in its middle.
    pub(super) fn speed_max(&self, from: f64, to: f64) -> f64 {
        let share = |time: f64| ((time - self.begin) / self.length).clamp(0.0, 1.0);
        let s = 0.5f64.clamp(share(from), share(to));
        self.reach() * 30.0 * (s * (1.0 - s)).powi(2) / self.length
    }

    /// The least and the largest x, y and z.
    pub(super) fn bounds(&self) -> [Point; 2] {
        let mut least: Point = std::array::from_fn(|axis| self.from[axis].min(self.to[axis]));
        let mut most: Point = std::array::from_fn(|axis| self.from[axis].max(self.to[axis]));
        least[2] += self.lift.min(0.0);
        most[2] += self.lift.max(0.0);
        [least, most]
    }

    /// Whether both are straight and have one time law.
    pub(super) fn is_even_with(&self, other: &Self) -> bool {
        (self.begin, self.length) == (other.begin, other.length) && self.lift == 0.0 && other.lift == 0.0
    }
}
