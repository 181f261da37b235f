//! Which body takes which place: the least sum of ways, or the shortest longest way.
//!
//! The least sum is found by the Hungarian algorithm (Kuhn, Naval Research Logistics 2, 1955; Munkres, J. SIAM 5, 1957). The
//! shortest longest way is found by augmenting paths whose longest edge is as short as possible (Burkard, Dell'Amico and
//! Martello, Assignment Problems, 2009, section 6.2). Both take O(n^3) steps for n bodies.

use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;

use crate::formation::{Point, metres_between};

/// What of the ways is made small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Least {
    /// Their sum.
    #[default]
    Total,
    /// The longest of them.
    Longest,
}

/// Costs are whole numbers up to this: with 2^11 bodies, no sum overflows.
const COST_MAX: f64 = (1i64 << 38) as f64;
/// The cost of a way that is too long: more than all others together.
const TOO_LONG: i64 = 1 << 50;

/// The place of each start; none for a start that is left over if there are fewer places.
pub(crate) type Assignment = Vec<Option<usize>>;

/// Ways to the power `exponent`, the sum of which is made small; ways longer than `longest` metres are not taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Price {
    pub(crate) exponent: f64,
    pub(crate) longest: f64,
}

/// The ways among which some are taken, in metres: each row gets one column, and there are no fewer columns than rows.
pub(crate) struct Ways {
    metres: Matrix<f64>,
    /// The place of each column, or the start if rows are places.
    kept: Vec<usize>,
    starts: usize,
    places: usize,
    rows_are_places: bool,
}

impl Ways {
    /// Each start gets a place, and each place a start, as far as there are both. Starts that are left over go to their place in
    /// `spare`, in the order of `starts`.
    pub(crate) fn between(starts: &[Point], places: &[Point], spare: &[Point]) -> Self {
        let left_over: Vec<f64> =
            starts.iter().zip(spare).map(|(start, spare)| metres_between(*start, *spare)).collect();
        let square = starts.len() > places.len() && left_over.iter().any(|way| *way > 0.0);
        let rows_are_places = starts.len() > places.len() && !square;
        let (rows, columns) = if rows_are_places { (places, starts) } else { (starts, places) };
        let kept = if square { (0..starts.len()).collect() } else { within_reach(rows, columns) };
        let metres = Matrix::from_fn(rows.len(), kept.len(), |(row, column)| {
            columns
                .get(kept[column])
                .map_or_else(|| left_over[row], |column| metres_between(rows[row], *column))
        });
        Self { metres, kept, starts: starts.len(), places: places.len(), rows_are_places }
    }

    /// The assignment with the least sum. As many starts as possible get a place; each place is taken at most once.
    pub(crate) fn cheapest(&self, price: Price) -> Assignment {
        if self.metres.rows == 0 {
            return vec![None; self.starts];
        }
        let within = self.metres.values().copied().filter(|way| *way <= price.longest);
        let longest = within.fold(f64::MIN_POSITIVE, f64::max);
        let costs = self.metres.clone().map(|way| cost(way, longest, price));
        let (_, column_of) = kuhn_munkres_min(&costs);
        let column_of = column_of.into_iter().map(|column| self.kept[column]);
        match self.rows_are_places {
            false => column_of.map(|place| Some(place).filter(|place| *place < self.places)).collect(),
            true => {
                let mut assignment = vec![None; self.starts];
                column_of.enumerate().for_each(|(place, start)| assignment[start] = Some(place));
                assignment
            }
        }
    }

    /// The least length, in metres, such that there is an assignment without a longer way.
    pub(crate) fn shortest_longest(&self) -> f64 {
        let mut row_of: Vec<Option<usize>> = vec![None; self.metres.columns];
        let mut bound = 0.0f64;
        for first in 0..self.metres.rows {
            bound = augment(&self.metres, &mut row_of, first, bound);
        }
        bound
    }
}

/// The columns that a row may be given: one of as many as there are rows, those nearest to it. A farther one is never better, for
/// the other rows leave one of these free.
fn within_reach(rows: &[Point], columns: &[Point]) -> Vec<usize> {
    if rows.len() == columns.len() {
        return (0..columns.len()).collect();
    }
    let mut kept = vec![false; columns.len()];
    for row in rows {
        let mut nearest: Vec<(f64, usize)> = columns
            .iter()
            .enumerate()
            .map(|(column, place)| (metres_between(*row, *place), column))
            .collect();
        nearest.select_nth_unstable_by(rows.len() - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        nearest[..rows.len()].iter().for_each(|(_, column)| kept[*column] = true);
    }
    (0..columns.len()).filter(|column| kept[*column]).collect()
}

#[expect(clippy::cast_possible_truncation, reason = "at most COST_MAX, but for ways that are too long")]
fn cost(way: f64, longest: f64, price: Price) -> i64 {
    match way <= price.longest {
        true => ((way / longest).powf(price.exponent) * COST_MAX).round() as i64,
        false => TOO_LONG,
    }
}

/// Gives one more row a column, along the path whose longest edge is shortest: Dijkstra's search with maxima for sums.
fn augment(ways: &Matrix<f64>, row_of: &mut [Option<usize>], first: usize, bound: f64) -> f64 {
    let mut reached = vec![f64::INFINITY; ways.columns];
    let mut from: Vec<Option<usize>> = vec![None; ways.columns];
    let mut done = vec![false; ways.columns];
    // The row that is looked at, the longest edge to it, and the column through which it was reached.
    let (mut row, mut longest, mut through) = (first, bound, None);
    loop {
        for column in (0..ways.columns).filter(|column| !done[*column]) {
            let way = ways[(row, column)].max(longest);
            if way < reached[column] {
                (reached[column], from[column]) = (way, through);
            }
        }
        let open = (0..ways.columns).filter(|column| !done[*column]);
        let Some(next) = open.min_by(|a, b| reached[*a].total_cmp(&reached[*b])) else { return longest };
        (done[next], longest) = (true, reached[next]);
        match row_of[next] {
            Some(taken) => (row, through) = (taken, Some(next)),
            None => {
                shift(row_of, &from, next, first);
                return longest;
            }
        }
    }
}

/// Moves each row of the path to the next column, from the free one backwards.
fn shift(row_of: &mut [Option<usize>], from: &[Option<usize>], free: usize, first: usize) {
    let mut column = free;
    while let Some(before) = from[column] {
        row_of[column] = row_of[before];
        column = before;
    }
    row_of[column] = Some(first);
}
