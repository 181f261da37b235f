//! Formations: places in space for any number of bodies, in metres. `placing` moves a shape to its position.
//!
//! `scenario::formations` reads them from a scenario; the assignment of bodies to places is made elsewhere.

pub mod cloud;
mod crowd;
mod placing;
mod shapes;
mod spread;
mod strokes;
pub mod svg;
pub mod text;
mod tried;

#[cfg(test)]
mod tests;

use std::sync::Arc;

pub use crowd::{distance as metres_between, nearest_pair, pairs_within};
pub use placing::{Placing, middle_of};
pub use shapes::{Ball, Grid, Line, Ring, Vee};
pub use spread::Triangle;
pub use strokes::Strokes;
pub use tried::tried;

/// Maximum number of places of a formation.
pub const PLACES_MAX: usize = 10_000;

/// Places that are closer to each other, in metres, are equal.
pub const SAME: f64 = 1e-6;
/// Rounding error of the distance of two places, in metres.
pub const ROUNDING: f64 = 1e-9;

/// A place, or a vector: x, y, z in metres.
pub type Point = [f64; 3];

/// A set of places, for as many bodies as take part.
#[derive(Clone, Debug, PartialEq)]
pub struct Formation {
    /// The arrangement of the places.
    pub shape: Shape,
    /// The rotation and translation of the places.
    pub placing: Placing,
}

/// The arrangement of places before they are turned and moved.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Explicit places.
    Points(Arc<[Point]>),
    /// On a line.
    Line(Line),
    /// On a circle.
    Circle(Ring),
    /// On a grid.
    Grid(Grid),
    /// On the two sides of a V.
    Vee(Vee),
    /// On a sphere.
    Sphere(Ball),
    /// Along these strokes.
    Strokes(Arc<Strokes>),
    /// Some of these points, as far from each other as possible.
    Cloud(Arc<[Point]>),
    /// Spread over these triangles.
    Surface(Arc<[Triangle]>),
}

/// A file with an invalid content or format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unfit {
    /// The fault.
    pub message: String,
    /// What was expected.
    pub expected: &'static str,
}

/// More places than a formation may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyPlaces {
    /// The number of places that the formation would have.
    pub count: usize,
}

impl Formation {
    /// Returns the places for `count` bodies, in metres, in the order of the shape. A shape with its own places ([`Self::own_count`])
    /// returns all of them, regardless of `count`, and a cloud never has more places than points: the caller must compare the numbers.
    ///
    /// # Errors
    /// There are more than [`PLACES_MAX`] places.
    pub fn places(&self, count: usize) -> Result<Vec<Point>, TooManyPlaces> {
        let count = self.own_count().unwrap_or(count);
        if count > PLACES_MAX {
            return Err(TooManyPlaces { count });
        }
        let places = match &self.shape {
            Shape::Points(points) => points.to_vec(),
            Shape::Line(line) => line.places(count),
            Shape::Circle(ring) => ring.places(count),
            Shape::Grid(grid) => grid.places(count),
            Shape::Vee(vee) => vee.places(count),
            Shape::Sphere(ball) => ball.places(count),
            Shape::Strokes(strokes) => strokes.places(count),
            Shape::Cloud(points) => spread::thinned(points, count),
            Shape::Surface(surface) => spread::over(surface, count),
        };
        Ok(places.into_iter().map(|place| self.placing.of(place)).collect())
    }

    /// Returns its number of places, if that does not depend on the number of bodies.
    pub fn own_count(&self) -> Option<usize> {
        match &self.shape {
            Shape::Points(points) => Some(points.len()),
            _ => None,
        }
    }
}
