//! A function for `fuzz/`: reads arbitrary bytes as a file of a formation, and checks the invariants of the result.

use std::sync::Arc;

use super::cloud::{self, Cloud};
use super::{Formation, Placing, Point, Shape, Strokes, svg};

/// Reads the bytes as a PLY, an STL, a CSV or an SVG file, depending on `which`, and computes places of a formation.
///
/// # Panics
/// If a place is not finite, or the number of places is wrong.
pub fn tried(which: u8, bytes: &[u8]) {
    let name = ["a.ply", "a.stl", "a.csv", "a.svg"][usize::from(which) % 4];
    let most;
    let shape = if name == "a.svg" {
        let Ok(strokes) = svg::read(bytes) else { return };
        let lines: Vec<Vec<Point>> =
            strokes.iter().map(|line| line.iter().map(|[x, y]| [*x, 0.0, *y]).collect()).collect();
        most = usize::MAX;
        Shape::Strokes(Arc::new(Strokes::of(&lines)))
    } else {
        match cloud::read(name, bytes) {
            Ok(Cloud::Points(points)) => {
                most = points.len();
                Shape::Cloud(points.into())
            }
            Ok(Cloud::Surface(surface)) => {
                most = usize::MAX;
                Shape::Surface(surface.into())
            }
            Err(unfit) => {
                return assert!(!unfit.message.is_empty() && !unfit.expected.is_empty(), "{unfit:?}");
            }
        }
    };
    let formation = Formation { shape, placing: Placing::default() };
    for count in [0, 1, 2, 17] {
        let places = formation.places(count).unwrap_or_default();
        assert_eq!(places.len(), count.min(most));
        assert!(places.iter().flatten().all(|part| part.is_finite()), "{places:?}");
    }
}
