//! The closest approach of two bodies on their routes.

use super::way::Route;
use crate::formation::{Point, metres_between};
use downbeat_motion::motion::Easing;

/// Amount in metres by which the true distance may exceed the reported one, if no formula gives the distance.
pub const SLACK: f64 = 1e-3;
/// Maximum number of times at which two routes are sampled.
const LOOKS_MAX: u32 = 50_000;

/// The closest approach of the middles of two bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Approach {
    /// Distance in metres; the true distance is not smaller.
    pub distance: f64,
    /// Time of the approach, in seconds.
    pub at: f64,
}

/// Returns the closest approach of two routes if it is below `enough`, in metres. `None` means that the routes are no closer than
/// `enough`, except for [`SLACK`].
pub fn closest(a: &Route, b: &Route, enough: f64) -> Option<Approach> {
    if !may_meet(a, b, enough) {
        return None;
    }
    if a.is_even_with(b) { Some(together(a, b)) } else { searched(a, b, enough) }
}

/// Whether [`closest`] may find an approach. The test is cheap; it is exact for straight routes with the same time law (start and
/// duration).
pub fn may_meet(a: &Route, b: &Route, enough: f64) -> bool {
    if a.is_even_with(b) {
        Line::between(a, b).nearest().0 < enough
    } else {
        apart(&a.bounds(), &b.bounds()) < enough
    }
}

/// Whether [`closest`] finds an approach. If an approach exists, this is faster than calling [`closest`].
pub fn meet(a: &Route, b: &Route, enough: f64) -> bool {
    if a.is_even_with(b) || !may_meet(a, b, enough) {
        return may_meet(a, b, enough);
    }
    let (from, to) = (a.begin.min(b.begin), a.end().max(b.end()));
    let early = (0..=8).any(|i| {
        let at = from + (to - from) * f64::from(i) / 8.0;
        metres_between(a.at(at), b.at(at)) < enough
    });
    early || closest(a, b, enough).is_some()
}

/// Returns the distance between two boxes, given by their least and largest coordinates.
fn apart(a: &[Point; 2], b: &[Point; 2]) -> f64 {
    let gap = |axis: usize| (a[0][axis] - b[1][axis]).max(b[0][axis] - a[1][axis]).max(0.0);
    gap(0).hypot(gap(1)).hypot(gap(2))
}

/// The route of one body relative to another body, if both have the same time law (start and duration).
struct Line {
    from: Point,
    vector: Point,
}

impl Line {
    fn between(a: &Route, b: &Route) -> Self {
        let (va, vb) = (a.vector(), b.vector());
        Self {
            from: std::array::from_fn(|axis| b.from[axis] - a.from[axis]),
            vector: std::array::from_fn(|axis| vb[axis] - va[axis]),
        }
    }

    /// Returns the least distance of the line from the other body, in metres, and the share of the line at which it occurs.
    fn nearest(&self) -> (f64, f64) {
        let dot = |a: &Point, b: &Point| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let square = dot(&self.vector, &self.vector);
        let u = if square > 0.0 { (-dot(&self.from, &self.vector) / square).clamp(0.0, 1.0) } else { 0.0 };
        let between: Point = std::array::from_fn(|axis| self.from[axis] + u * self.vector[axis]);
        (dot(&between, &between).sqrt(), u)
    }
}

/// Computes the approach of straight routes with the same time law (start and duration): relative to one body, the other body moves along
/// a line.
fn together(a: &Route, b: &Route) -> Approach {
    let (distance, u) = Line::between(a, b).nearest();
    Approach { distance, at: a.begin + a.length * Easing::smooth_time(u) }
}

/// Computes the approach of any two routes. Halves the time wherever bounds on their speeds permit a closer approach.
fn searched(a: &Route, b: &Route, enough: f64) -> Option<Approach> {
    // Relative to a body with the same time law, the other body moves on a single route: bodies on equal arcs keep their distance.
    if (a.begin, a.length) == (b.begin, b.length) {
        let seen = |a: Point, b: Point| -> Point { std::array::from_fn(|axis| b[axis] - a[axis]) };
        let other = Route { from: seen(a.from, b.from), to: seen(a.to, b.to), lift: b.lift - a.lift, ..*a };
        let still = Route { from: [0.0; 3], to: [0.0; 3], lift: 0.0, ..*a };
        return halved(&other, &still, enough);
    }
    halved(a, b, enough)
}

fn halved(a: &Route, b: &Route, enough: f64) -> Option<Approach> {
    let (from, to) = (a.begin.min(b.begin), a.end().max(b.end()));
    let best = Approach { distance: f64::INFINITY, at: from };
    let mut search = Search { a, b, enough, best, left: LOOKS_MAX };
    search.at(from);
    search.at(to);
    search.between(from, to);
    let best = Some(search.best).filter(|best| best.distance < enough)?;
    Some(Approach { distance: (best.distance - SLACK).max(0.0), ..best })
}

struct Search<'a> {
    a: &'a Route,
    b: &'a Route,
    enough: f64,
    best: Approach,
    left: u32,
}

impl Search<'_> {
    fn at(&mut self, at: f64) -> f64 {
        let distance = metres_between(self.a.at(at), self.b.at(at));
        if distance < self.best.distance {
            self.best = Approach { distance, at };
        }
        distance
    }

    fn between(&mut self, from: f64, to: f64) {
        let middle = f64::midpoint(from, to);
        let distance = self.at(middle);
        let speed = self.a.speed_max(from, to) + self.b.speed_max(from, to);
        let least = distance - speed * (to - from) / 2.0;
        if least >= self.enough || least >= self.best.distance - SLACK {
            return;
        }
        self.left = self.left.saturating_sub(1);
        if self.left == 0 {
            // At times that remain unchecked, the bodies may be this close.
            self.best.distance = self.best.distance.min(least.max(0.0));
            return;
        }
        self.between(from, middle);
        self.between(middle, to);
    }
}
