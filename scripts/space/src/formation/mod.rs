//! Formations: places in space for any number of bodies, in metres. `placing` moves a shape to its position on the stage.
//!
//! `scenario::formations` reads formations from a scenario; [`crate::transit`] assigns bodies to places.

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

/// Distance in metres below which two places count as the same.
pub const SAME: f64 = 1e-6;
/// Rounding error of the distance between two places, in metres.
pub const ROUNDING: f64 = 1e-9;

/// A place or a vector: x, y and z in metres.
pub type Point = [f64; 3];

/// A set of places for any number of bodies.
#[derive(Clone, Debug, PartialEq)]
pub struct Formation {
    /// Arrangement of the places.
    pub shape: Shape,
    /// Scale, rotation and position of the arrangement.
    pub placing: Placing,
}

/// The arrangement of a formation's places, before they are scaled, turned and moved.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Explicit places, regardless of the number of bodies.
    Points(Arc<[Point]>),
    /// Places on a line.
    Line(Line),
    /// Places on a circle.
    Circle(Ring),
    /// Places on a grid.
    Grid(Grid),
    /// Places on the two sides of a V.
    Vee(Vee),
    /// Places on a sphere.
    Sphere(Ball),
    /// Places along strokes, such as those of letters.
    Strokes(Arc<Strokes>),
    /// Places at some of these points, as far from each other as possible.
    Cloud(Arc<[Point]>),
    /// Places spread over the surface of these triangles.
    Surface(Arc<[Triangle]>),
}

/// The reason why a file cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unfit {
    /// The fault of the file.
    pub message: String,
    /// The expected content.
    pub expected: &'static str,
}

/// A formation would have more places than [`PLACES_MAX`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyPlaces {
    /// Number of places that the formation would have.
    pub count: usize,
}

impl Formation {
    /// Returns the places for `count` bodies, in metres, in the order of the shape. Callers must compare the number of places with
    /// `count`: a shape with its own places ([`Self::own_count`]) returns all of them, and a cloud never has more places than points.
    ///
    /// # Errors
    /// Returns the number of places if it exceeds [`PLACES_MAX`].
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

    /// Returns the number of the formation's own places; `None` if the number depends on the number of bodies.
    pub fn own_count(&self) -> Option<usize> {
        match &self.shape {
            Shape::Points(points) => Some(points.len()),
            _ => None,
        }
    }
}
