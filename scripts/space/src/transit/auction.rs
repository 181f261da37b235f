//! The cheapest assignment by auction: rows bid for columns, whose prices rise (Bertsekas, Annals of Operations Research 14, 1988).
//!
//! Each row bids for its cheapest column, and raises its price until the second best column costs the same, plus a step. When each row
//! has a column, the sum exceeds the least sum by at most one step per row. The steps get finer from phase to phase, down to the
//! resolution of costs. In a large group, the auction may stop after much work, as soon as the prices prove that the sum is close to the
//! least one.

use std::collections::VecDeque;

use super::columns::{Columns, Cost, Row};

/// Steps of the first and of the last phase, in units of cost.
const STEPS: [f64; 2] = [1.0 / 16.0, 1e-10];
/// Factor by which the steps of a phase are finer than those of the previous one.
const FINER: f64 = 6.0;
/// Number of cheapest columns that are stored for each row.
const KEPT: usize = 16;
/// Largest group whose auction always runs to its last phase; with more rows, it may stop earlier.
const EXACT_MAX: usize = 1_000;
/// Number of comparisons of rows with columns after which the auction of a large group may stop early.
pub(super) const COMPARED_MAX: u64 = 50_000_000;
/// Permitted excess over the least sum if the auction stops early, as a share of the least sum.
const EXCESS_MAX: f64 = 1e-3;
/// Amount by which a row raises the price of the only column that it can take.
const ONLY: f64 = 1.0;

/// Result of an auction: which row has which column.
pub(super) struct Sold {
    /// Column of each row.
    pub(super) columns: Vec<usize>,
    /// A proven lower bound on the sum of costs of any assignment, as a share of this assignment's sum.
    pub(super) proven: f64,
}

/// The cheapest columns of a row at the row's last search. Prices never fall, so every other column still costs at least `beyond`.
#[derive(Clone, Default)]
struct Known {
    /// Costs without prices, and positions of the columns.
    columns: Vec<(f64, usize)>,
    beyond: f64,
}

/// The cheapest column for a row, and how much cheaper it is than the others.
struct Best {
    position: usize,
    /// Cost of the column including its price.
    value: f64,
    /// Value of the second best column; infinite if the row can take only one column.
    second: f64,
}

struct Auction<'a> {
    rows: &'a [Row],
    columns: Columns,
    cost: Cost,
    known: Vec<Known>,
    /// Position of each row's column; `None` if the row has none.
    of_row: Vec<Option<usize>>,
    /// Row that owns the column at each position; `None` if the column is free.
    of_column: Vec<Option<usize>>,
}

/// Sells the columns (places) to the same number of rows (starts), so that the sum of costs is minimal. An assignment within the longest
/// permitted distance must exist.
pub(super) fn sell(rows: &[Row], columns: Columns, cost: Cost, compared_max: u64) -> Sold {
    assert_eq!(rows.len(), columns.count());
    let known = Known { columns: Vec::new(), beyond: f64::NEG_INFINITY };
    let (known, none) = (vec![known; rows.len()], vec![None; rows.len()]);
    let mut auction = Auction { rows, columns, cost, known, of_row: none.clone(), of_column: none };
    let [mut step, last] = STEPS;
    loop {
        auction.phase(step);
        let proven = auction.proven();
        let is_enough = rows.len() > EXACT_MAX
            && auction.columns.compared > compared_max
            && proven >= 1.0 / (1.0 + EXCESS_MAX);
        if step <= last || is_enough {
            let columns = auction.of_row.iter().flatten().map(|position| auction.columns.column(*position));
            return Sold { columns: columns.collect(), proven };
        }
        step = (step / FINER).max(last);
    }
}

impl Auction<'_> {
    /// Sells all columns with the given step. Rows keep a column whose value exceeds that of their best column by at most the step.
    fn phase(&mut self, step: f64) {
        let mut waiting = VecDeque::new();
        for row in 0..self.rows.len() {
            if let Some(position) = self.of_row[row] {
                if self.value(row, position) - self.best(row).value <= step {
                    continue;
                }
                (self.of_row[row], self.of_column[position]) = (None, None);
            }
            waiting.push_back(row);
        }
        while let Some(row) = waiting.pop_front() {
            let Best { position, value, second } = self.best(row);
            let more = if second.is_finite() { second - value } else { ONLY };
            self.columns.set_price(position, self.columns.price(position) + more + step);
            self.of_row[row] = Some(position);
            if let Some(outbid) = self.of_column[position].replace(row) {
                self.of_row[outbid] = None;
                waiting.push_back(outbid);
            }
        }
    }

    fn value(&self, row: usize, position: usize) -> f64 {
        self.cost.of(self.columns.way(&self.rows[row], position)) + self.columns.price(position)
    }

    fn best(&mut self, row: usize) -> Best {
        let known = &self.known[row];
        let mut best = Best { position: 0, value: f64::INFINITY, second: f64::INFINITY };
        for (cost, position) in &known.columns {
            let value = cost + self.columns.price(*position);
            if value < best.value {
                best = Best { position: *position, value, second: best.value };
            } else {
                best.second = best.second.min(value);
            }
        }
        if best.second <= known.beyond && !known.columns.is_empty() {
            return best;
        }
        let mut found = [(0.0, 0); KEPT + 1];
        self.columns.cheapest(&self.rows[row], self.cost, &mut found);
        let finite = found[..KEPT].iter().filter(|(value, _)| value.is_finite());
        let costs = finite.map(|(value, position)| (value - self.columns.price(*position), *position));
        let known = &mut self.known[row];
        known.columns.clear();
        known.columns.extend(costs);
        known.beyond = found[KEPT].0;
        Best { position: found[0].1, value: found[0].0, second: found[1].0 }
    }

    /// Returns a proven lower bound on the sum of costs of any assignment, as a share of the present sum. The bound is the sum of each
    /// row's best value, minus all prices.
    fn proven(&mut self) -> f64 {
        let (mut sum, mut excess) = (0.0, 0.0);
        for row in 0..self.rows.len() {
            let Some(position) = self.of_row[row] else { continue };
            let value = self.value(row, position);
            sum += value - self.columns.price(position);
            excess += (value - self.best(row).value).max(0.0);
        }
        if sum > excess {
            1.0 - excess / sum
        } else if sum > 0.0 {
            0.0
        } else {
            1.0
        }
    }
}
