//! The cheapest assignment, by auction: rows bid for columns, whose prices rise (Bertsekas, Annals of Operations Research 14, 1988).
//!
//! Each row bids for the column that costs it least, and raises its price until the second best would cost as much, and by a step.
//! When each row has a column, the sum is above the least one by no more than a step per row. The steps get finer from phase to
//! phase, down to the resolution of costs. In a large group, the auction stops earlier after much work, when the prices prove
//! that the sum is close to the least one.

use std::collections::VecDeque;

use super::columns::{Columns, Cost, Row};

/// The steps of the first phase, and of the last one.
const STEPS: [f64; 2] = [1.0 / 16.0, 1e-10];
/// By how much the steps of a phase are finer than those of the one before.
const FINER: f64 = 6.0;
/// Cheapest columns that are kept for each row.
const KEPT: usize = 16;
/// In larger groups, an auction may stop before its last phase.
const EXACT_MAX: usize = 1_000;
/// Comparisons of rows with columns after which it does.
pub(super) const COMPARED_MAX: u64 = 50_000_000;
/// How far above the least one the sum may be then, as a share of it.
const EXCESS_MAX: f64 = 1e-3;
/// By how much a row raises the price of the only column that it can take.
const ONLY: f64 = 1.0;

/// Who has got what.
pub(super) struct Sold {
    /// The column of each row.
    pub(super) columns: Vec<usize>,
    /// The share of the sum of costs that no assignment is below.
    pub(super) proven: f64,
}

/// The cheapest columns of a row as they were when it last searched them. Prices never fall, so every other column still costs at least
/// `beyond`.
#[derive(Clone, Default)]
struct Known {
    /// Costs without prices, and positions.
    columns: Vec<(f64, usize)>,
    beyond: f64,
}

/// The column that costs a row least.
struct Best {
    position: usize,
    /// With its price.
    value: f64,
    /// That of the second best; infinite if it can take only one.
    second: f64,
}

struct Auction<'a> {
    rows: &'a [Row],
    columns: Columns,
    cost: Cost,
    known: Vec<Known>,
    /// The position of the column that each row has.
    of_row: Vec<Option<usize>>,
    /// The row that has the column at each position.
    of_column: Vec<Option<usize>>,
}

/// Sells the columns to as many rows, so that the sum of costs is least. There has to be a column for each row within the longest way.
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
    /// Sells all columns with this step. Rows keep a column that is worse than the best by no more than that.
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

    /// The share of the sum of costs that no assignment is below: if each row took the column that is best for it, and paid for all.
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
