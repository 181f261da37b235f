//! The route of one body: a straight line with a time law, or an arc above or below the other bodies.

use crate::formation::Point;
use downbeat_motion::motion::Easing;

/// Largest slope of the time law, which is minimum jerk.
pub const SLOPE: f64 = 1.875;
/// Largest second derivative of the time law: 10/sqrt(3).
pub const CURVATURE: f64 = 5.773_502_691_896_258;

/// A route: from + (to - from) u + lift 4 u (1 - u) upwards. Here, u is the minimum jerk law at the share of the duration that has
/// passed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Route {
    /// Start of the route, in metres.
    pub from: Point,
    /// End of the route, in metres.
    pub to: Point,
    /// Start time, in seconds.
    pub begin: f64,
    /// Duration in seconds, above 0.
    pub length: f64,
    /// Height of the arc at its middle, in metres; negative for a downward arc.
    pub lift: f64,
}

impl Route {
    /// Creates a route without an arc; times are in seconds.
    pub const fn straight(from: Point, to: Point, begin: f64, length: f64) -> Self {
        Self { from, to, begin, length, lift: 0.0 }
    }

    /// Returns the time at which the route ends, in seconds.
    pub fn end(&self) -> f64 {
        self.begin + self.length
    }

    /// Returns the vector from the route's start to its end, in metres.
    pub fn vector(&self) -> Point {
        std::array::from_fn(|axis| self.to[axis] - self.from[axis])
    }

    /// Returns the place of the body at a time, in seconds.
    pub fn at(&self, time: f64) -> Point {
        let u = Easing::Smooth.at(((time - self.begin) / self.length).clamp(0.0, 1.0));
        let vector = self.vector();
        let mut at: Point = std::array::from_fn(|axis| self.from[axis] + vector[axis] * u);
        at[2] += self.lift * 4.0 * u * (1.0 - u);
        at
    }

    /// Returns an upper bound on the body's movement per unit of the time law, which rises from 0 to 1, in metres.
    pub fn reach(&self) -> f64 {
        let [x, y, z] = self.vector();
        x.hypot(y).hypot(z.abs() + 4.0 * self.lift.abs())
    }

    /// Returns an upper bound on the body's speed between two times, in m/s; the time law is fastest in its middle.
    pub(super) fn speed_max(&self, from: f64, to: f64) -> f64 {
        let share = |time: f64| ((time - self.begin) / self.length).clamp(0.0, 1.0);
        let s = 0.5f64.clamp(share(from), share(to));
        self.reach() * 30.0 * (s * (1.0 - s)).powi(2) / self.length
    }

    /// Returns the least and the largest x, y and z of the route.
    pub(super) fn bounds(&self) -> [Point; 2] {
        let mut least: Point = std::array::from_fn(|axis| self.from[axis].min(self.to[axis]));
        let mut most: Point = std::array::from_fn(|axis| self.from[axis].max(self.to[axis]));
        least[2] += self.lift.min(0.0);
        most[2] += self.lift.max(0.0);
        [least, most]
    }

    /// Whether both routes are straight and have the same time law (start and duration).
    pub(super) fn is_even_with(&self, other: &Self) -> bool {
        (self.begin, self.length) == (other.begin, other.length) && self.lift == 0.0 && other.lift == 0.0
    }
}
