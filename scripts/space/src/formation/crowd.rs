//! Finds places that are close to each other.

use super::{Point, middle_of};

/// Indices of two places, and the distance between them in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    pub places: [usize; 2],
    pub distance: f64,
}

/// Returns the two places that are closest to each other; `None` if there are fewer than two places.
pub fn nearest_pair(places: &[Point]) -> Option<Pair> {
    let (axis, order) = along_longest_axis(places);
    let mut best: Option<Pair> = None;
    for (index, &a) in order.iter().enumerate() {
        for &b in &order[index + 1..] {
            let most = best.map_or(f64::INFINITY, |best| best.distance);
            // All further places in this order are even further away along the axis.
            if places[b][axis] - places[a][axis] > most {
                break;
            }
            let distance = distance(places[a], places[b]);
            if distance < most {
                best = Some(Pair { places: [a.min(b), a.max(b)], distance });
            }
        }
        if best.is_some_and(|best| best.distance == 0.0) {
            break;
        }
    }
    best
}

/// Returns the indices of all pairs of points that are closer to each other than `reach`, in metres.
pub fn pairs_within(points: &[Point], reach: f64) -> impl Iterator<Item = (usize, usize)> {
    let (axis, order) = along_longest_axis(points);
    (0..order.len()).flat_map(move |index| {
        let a = order[index];
        let near = order[index + 1..].iter().take_while(|b| points[**b][axis] - points[a][axis] < reach);
        let near = near.filter(|b| distance(points[a], points[**b]) < reach);
        near.map(|b| (a, *b)).collect::<Vec<_>>()
    })
}

/// Returns the axis along which the points extend furthest, and the indices of the points in order along this axis.
fn along_longest_axis(points: &[Point]) -> (usize, Vec<usize>) {
    let (_, lengths) = middle_of(points);
    let axis = (0..3).rev().max_by(|a, b| lengths[*a].total_cmp(&lengths[*b])).unwrap_or(0);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|a, b| points[*a][axis].total_cmp(&points[*b][axis]));
    (axis, order)
}

/// Returns the distance between two points, in metres.
pub fn distance(a: Point, b: Point) -> f64 {
    let square = |axis: usize| (a[axis] - b[axis]).powi(2);
    (square(0) + square(1) + square(2)).sqrt()
}
