//! The two places of a formation that are nearest to each other.

use super::Point;

/// Two places, by their indices, and how far apart they are in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pair {
    pub(crate) places: [usize; 2],
    pub(crate) distance: f64,
}

/// The two places that are nearest to each other; none if there are fewer than two.
pub(crate) fn nearest_pair(places: &[Point]) -> Option<Pair> {
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by(|a, b| places[*a][0].total_cmp(&places[*b][0]));
    let mut best: Option<Pair> = None;
    for (index, &a) in order.iter().enumerate() {
        for &b in &order[index + 1..] {
            let most = best.map_or(f64::INFINITY, |best| best.distance);
            // All that follow in this order are further along x.
            if places[b][0] - places[a][0] > most {
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

/// Metres between two points.
pub(crate) fn distance(a: Point, b: Point) -> f64 {
    let square = |axis: usize| (a[axis] - b[axis]).powi(2);
    (square(0) + square(1) + square(2)).sqrt()
}
