//! Assigns places to bodies with the least sum of distances, or with the least longest distance.
//!
//! Each problem has as many rows (starts) as columns (places): surplus starts have their own columns, and unused places have their own
//! rows.

use super::auction::{COMPARED_MAX, Sold, sell};
use super::bottleneck;
use super::columns::{Columns, Cost, Row};
use crate::formation::{Point, metres_between};

/// The quantity that an assignment minimizes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Least {
    /// The sum of the distances.
    #[default]
    Total,
    /// The longest distance.
    Longest,
}

/// For each start, the index of its place; `None` for a surplus start without a place.
pub type Assignment = Vec<Option<usize>>;

/// An assignment with its quality: `proven` times its sum of prices is a proven lower bound on the sum of any assignment.
pub struct Cheapest {
    pub assignment: Assignment,
    pub proven: f64,
}

/// The price of a distance: a power of the distance. An assignment minimizes the sum of prices.
#[derive(Clone, Copy, Debug)]
pub struct Price {
    /// The exponent of the power minus 1, in sixteenths: from 0 for the distance itself to 16 for its square.
    pub sixteenths: u8,
    /// Longest permitted distance, in metres.
    pub longest: f64,
}

/// An assignment problem: starts and places, with the distances between them.
pub struct Ways<'a> {
    /// Starts, followed by rows for unused places.
    rows: Vec<Row>,
    places: &'a [Point],
    starts: usize,
    /// Upper bound on all distances, in metres.
    unit: f64,
}

impl<'a> Ways<'a> {
    /// Creates the problem of giving each start a place or, if there are fewer places, each place a start. Surplus starts move to their
    /// place in `spare`, which is in the order of `starts`.
    pub fn between(starts: &[Point], places: &'a [Point], spare: &[Point]) -> Self {
        let row = |(start, spare): (&Point, &Point)| Row {
            at: Some(*start),
            left_over: if starts.len() > places.len() { metres_between(*start, *spare) } else { 0.0 },
        };
        let mut rows: Vec<Row> = starts.iter().zip(spare).map(row).collect();
        let left_over = rows.iter().map(|row| row.left_over);
        let unit = left_over.fold(diagonal(starts, places), f64::max);
        rows.resize(starts.len().max(places.len()), Row { at: None, left_over: 0.0 });
        Self { rows, places, starts: starts.len(), unit }
    }

    fn columns(&self) -> Columns {
        Columns::new(self.places, self.rows.len() - self.places.len())
    }

    /// Returns the assignment with the least sum of prices. As many starts as possible get a place; each place is taken at most once.
    pub fn cheapest(&self, price: Price) -> Cheapest {
        self.cheapest_within(price, COMPARED_MAX)
    }

    /// Like [`Self::cheapest`], but a large group may stop early after `compared_max` comparisons.
    pub(super) fn cheapest_within(&self, price: Price, compared_max: u64) -> Cheapest {
        if self.rows.is_empty() {
            return Cheapest { assignment: Vec::new(), proven: 1.0 };
        }
        let (rows, unit) = self.centred(price).unwrap_or_else(|| (self.rows.clone(), self.unit));
        let cost = Cost::new(price, unit.min(price.longest));
        let Sold { columns, proven } = sell(&rows, self.columns(), cost, compared_max);
        let places = columns.into_iter().take(self.starts);
        let assignment = places.map(|column| Some(column).filter(|place| *place < self.places.len()));
        Cheapest { assignment: assignment.collect(), proven }
    }

    /// Moves all starts by the same vector to the middle of the places, where near places are found faster. Also returns the longest
    /// possible distance. `None` if the move could change the order of the sums. With squares as prices, it adds the same amount to each
    /// sum.
    #[expect(clippy::cast_precision_loss, reason = "there are few points")]
    fn centred(&self, price: Price) -> Option<(Vec<Row>, f64)> {
        if price.sixteenths < 16 || price.longest.is_finite() || self.starts != self.places.len() {
            return None;
        }
        let starts: Vec<Point> = self.rows.iter().filter_map(|row| row.at).collect();
        let mean = |points: &[Point], axis: usize| {
            points.iter().map(|point| point[axis]).sum::<f64>() / points.len() as f64
        };
        let offset: Point = std::array::from_fn(|axis| mean(self.places, axis) - mean(&starts, axis));
        let moved = |start: &Point| -> Point { std::array::from_fn(|axis| start[axis] + offset[axis]) };
        let starts: Vec<Point> = starts.iter().map(moved).collect();
        let unit = diagonal(&starts, self.places);
        Some((starts.into_iter().map(|start| Row { at: Some(start), left_over: 0.0 }).collect(), unit))
    }

    /// Returns the least length, in metres, for which an assignment without a longer distance exists.
    pub fn shortest_longest(&self) -> f64 {
        if self.rows.is_empty() {
            return 0.0;
        }
        bottleneck::shortest_longest(&self.rows, self.columns(), self.unit)
    }
}

/// Returns the diagonal of the bounding box of all points, in metres.
fn diagonal(starts: &[Point], places: &[Point]) -> f64 {
    let all = || starts.iter().chain(places);
    let extreme = |pick: fn(f64, f64) -> f64| -> Point {
        std::array::from_fn(|axis| all().map(|point| point[axis]).reduce(pick).unwrap_or(0.0))
    };
    metres_between(extreme(f64::min), extreme(f64::max))
}
