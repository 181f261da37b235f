//! Which body takes which place: the least sum of ways, or the shortest longest way.
//!
//! Each problem is one of rows and as many columns: starts that are left over take columns of their own, places that are left free
//! take rows.

use super::auction::{COMPARED_MAX, Sold, sell};
use super::bottleneck;
use super::columns::{Columns, Cost, Row};
use crate::formation::{Point, metres_between};

/// What of the ways is made small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Least {
    /// Their sum.
    #[default]
    Total,
    /// The longest of them.
    Longest,
}

/// The place of each start; none for a start that is left over if there are fewer places.
pub type Assignment = Vec<Option<usize>>;

/// An assignment, and the share of its sum that no other is below.
pub struct Cheapest {
    pub assignment: Assignment,
    pub proven: f64,
}

/// Powers of the ways, the sum of which is made small.
#[derive(Clone, Copy, Debug)]
pub struct Price {
    /// By how much the exponent is above 1, in sixteenths: up to 16.
    pub sixteenths: u8,
    /// Longer ways are not taken, in metres.
    pub longest: f64,
}

/// The ways among which some are taken.
pub struct Ways<'a> {
    /// The starts, and behind them those that take the places that are left free.
    rows: Vec<Row>,
    places: &'a [Point],
    starts: usize,
    /// No way is longer, in metres.
    unit: f64,
}

impl<'a> Ways<'a> {
    /// Each start gets a place, and each place a start, as far as there are both. Starts that are left over go to their place in
    /// `spare`, in the order of `starts`.
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

    /// The assignment with the least sum. As many starts as possible get a place; each place is taken at most once.
    pub fn cheapest(&self, price: Price) -> Cheapest {
        self.cheapest_within(price, COMPARED_MAX)
    }

    /// The same, with another number of comparisons after which a large group may stop early.
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

    /// The starts moved to the middle of the places, if that changes no order of sums, with the longest way: near places are found sooner.
    /// Of squares, it adds the same to each sum.
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

    /// The least length, in metres, such that there is an assignment without a longer way.
    pub fn shortest_longest(&self) -> f64 {
        if self.rows.is_empty() {
            return 0.0;
        }
        bottleneck::shortest_longest(&self.rows, self.columns(), self.unit)
    }
}

/// The diagonal of the box around all points, in metres.
fn diagonal(starts: &[Point], places: &[Point]) -> f64 {
    let all = || starts.iter().chain(places);
    let extreme = |pick: fn(f64, f64) -> f64| -> Point {
        std::array::from_fn(|axis| all().map(|point| point[axis]).reduce(pick).unwrap_or(0.0))
    };
    metres_between(extreme(f64::min), extreme(f64::max))
}
