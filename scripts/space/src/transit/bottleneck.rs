//! The least longest distance of an assignment of rows (starts) to columns (places), by a search for the length within which each row can
//! have a column.
//!
//! A length is tested by augmenting paths from all rows without a column at once. A k-d tree returns the columns that no path has
//! reached yet, so each search reaches a column only once (Efrat, Itai and Katz, Algorithmica 31, 2001).

use super::assignment::Price;
use super::columns::{Columns, Cost, Row};

/// Price of a column that is already taken. It exceeds the cost of any distance, so that paths prefer free columns.
const TAKEN: f64 = 2.0;

/// Returns the least length, in metres, within which each row can have a column. There are as many columns as rows, and `unit` is at
/// least as long as any distance.
pub(super) fn shortest_longest(rows: &[Row], columns: Columns, unit: f64) -> f64 {
    assert_eq!(rows.len(), columns.count());
    let none = vec![None; rows.len()];
    let mut matching =
        Matching { rows, columns, unit, taken: Taken { of_row: none.clone(), of_column: none } };
    // Each row needs at least the distance to its nearest column.
    let nearest: Vec<f64> = (0..rows.len()).map(|row| matching.nearest(row)).collect();
    let mut least = nearest.into_iter().fold(0.0, f64::max);
    let (mut most, mut fitting) = (f64::INFINITY, matching.taken.clone());
    let mut tried = least;
    while least < most {
        match matching.complete(tried) {
            Ok(longest) => (most, fitting) = (longest, matching.taken.clone()),
            Err(needed) => (least, matching.taken) = (needed, fitting.clone()),
        }
        let middle = if most.is_finite() { f64::midpoint(least, most) } else { 2.0 * least };
        tried = if middle < most { middle } else { least };
    }
    most
}

/// The assignment of rows (starts) to columns (places) and vice versa; columns are given by their positions in the tree.
#[derive(Clone)]
struct Taken {
    of_row: Vec<Option<usize>>,
    of_column: Vec<Option<usize>>,
}

struct Matching<'a> {
    rows: &'a [Row],
    columns: Columns,
    unit: f64,
    taken: Taken,
}

impl Matching<'_> {
    /// Gives each row a column within `length`, and returns the longest distance. On failure, returns the least length that might
    /// suffice for one more row.
    fn complete(&mut self, length: f64) -> Result<f64, f64> {
        for row in 0..self.rows.len() {
            let too_far = |position: &usize| self.columns.way(&self.rows[row], *position) > length;
            if let Some(position) = self.taken.of_row[row].filter(too_far) {
                (self.taken.of_row[row], self.taken.of_column[position]) = (None, None);
            }
        }
        while self.taken.of_row.iter().any(Option::is_none) {
            self.augment(length)?;
        }
        let ways = self.taken.of_row.iter().zip(self.rows);
        let ways =
            ways.map(|(position, row)| position.map_or(0.0, |position| self.columns.way(row, position)));
        Ok(ways.fold(0.0, f64::max))
    }

    /// Searches for paths from rows without a column to free columns, and assigns columns along these paths. On failure, returns the
    /// least length that might suffice.
    fn augment(&mut self, length: f64) -> Result<(), f64> {
        let Self { columns, taken, .. } = self;
        columns.set_prices(|position| if taken.of_column[position].is_some() { TAKEN } else { 0.0 });
        // Rows that paths have reached, each with the row at the start of its path.
        let mut reached: Vec<(usize, usize)> = (0..self.rows.len())
            .filter(|row| self.taken.of_row[*row].is_none())
            .map(|row| (row, row))
            .collect();
        let mut from = vec![0; self.rows.len()];
        let mut is_done = vec![false; self.rows.len()];
        let (mut next, mut augmented) = (0, false);
        while let Some(&(row, first)) = reached.get(next) {
            next += 1;
            while !is_done[first]
                && let Some(position) = self.within(row, length)
            {
                self.columns.set_price(position, f64::INFINITY);
                from[position] = row;
                match self.taken.of_column[position] {
                    Some(owner) => reached.push((owner, first)),
                    None => {
                        self.taken.shift(&from, position);
                        (is_done[first], augmented) = (true, true);
                    }
                }
            }
        }
        if augmented {
            return Ok(());
        }
        let Self { columns, .. } = self;
        let is_reached: Vec<bool> =
            (0..columns.count()).map(|position| columns.price(position) == f64::INFINITY).collect();
        columns.set_prices(|position| if is_reached[position] { f64::INFINITY } else { 0.0 });
        Err(reached.into_iter().map(|(row, _)| self.nearest(row)).fold(f64::INFINITY, f64::min))
    }

    /// Returns the position of a column within `length` of a row, preferably a free column. Ignores removed columns.
    fn within(&mut self, row: usize, length: f64) -> Option<usize> {
        let cost = Cost::new(Price { sixteenths: 0, longest: length }, self.unit);
        let mut found = [(0.0, 0)];
        self.columns.cheapest(&self.rows[row], cost, &mut found);
        let [(value, position)] = found;
        value.is_finite().then_some(position)
    }

    /// Returns the distance of a row to its nearest column, in metres; infinite if all columns are removed.
    fn nearest(&mut self, row: usize) -> f64 {
        let found = self.within(row, f64::INFINITY);
        found.map_or(f64::INFINITY, |position| self.columns.way(&self.rows[row], position))
    }
}

impl Taken {
    /// Moves each row of a path to the path's next column, starting with the row that takes the free column.
    fn shift(&mut self, from: &[usize], free: usize) {
        let mut next = Some(free);
        while let Some(position) = next {
            let row = from[position];
            self.of_column[position] = Some(row);
            next = self.of_row[row].replace(position);
        }
    }
}
