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

/// The assignment with the least sum. As many starts as possible get a place; each place is taken at most once.
pub(crate) fn cheapest(starts: &[Point], places: &[Point], price: Price) -> Assignment {
    let swapped = starts.len() > places.len();
    let (rows, columns) = if swapped { (places, starts) } else { (starts, places) };
    if rows.is_empty() {
        return vec![None; starts.len()];
    }
    let kept = within_reach(rows, columns);
    let columns: Vec<Point> = kept.iter().map(|column| columns[*column]).collect();
    let ways = rows.iter().flat_map(|row| columns.iter().map(|column| metres_between(*row, *column)));
    let ways: Vec<f64> = ways.collect();
    let longest = ways.iter().copied().filter(|way| *way <= price.longest).fold(f64::MIN_POSITIVE, f64::max);
    let price_of = |(row, column)| cost(ways[row * columns.len() + column], longest, price);
    let costs = Matrix::from_fn(rows.len(), columns.len(), price_of);
    let (_, column_of) = kuhn_munkres_min(&costs);
    let column_of = column_of.into_iter().map(|column| kept[column]);
    match swapped {
        false => column_of.map(Some).collect(),
        true => {
            let mut assignment = vec![None; starts.len()];
            column_of.enumerate().for_each(|(place, start)| assignment[start] = Some(place));
            assignment
        }
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

/// The least length, in metres, such that every start (or every place, if these are fewer) has a way no longer than that.
pub(crate) fn shortest_longest(starts: &[Point], places: &[Point]) -> f64 {
    let (rows, columns) = if starts.len() > places.len() { (places, starts) } else { (starts, places) };
    if rows.is_empty() {
        return 0.0;
    }
    let columns: Vec<Point> = within_reach(rows, columns).into_iter().map(|column| columns[column]).collect();
    let mut row_of: Vec<Option<usize>> = vec![None; columns.len()];
    let mut bound = 0.0f64;
    for first in 0..rows.len() {
        bound = augment(rows, &columns, &mut row_of, first, bound);
    }
    bound
}

/// Gives one more row a column, along the path whose longest edge is shortest: Dijkstra's search with maxima for sums.
fn augment(rows: &[Point], columns: &[Point], row_of: &mut [Option<usize>], first: usize, bound: f64) -> f64 {
    let mut reached = vec![f64::INFINITY; columns.len()];
    let mut from: Vec<Option<usize>> = vec![None; columns.len()];
    let mut done = vec![false; columns.len()];
    // The row that is looked at, the longest edge to it, and the column through which it was reached.
    let (mut row, mut longest, mut through) = (first, bound, None);
    loop {
        for (column, place) in columns.iter().enumerate().filter(|(column, _)| !done[*column]) {
            let way = metres_between(rows[row], *place).max(longest);
            if way < reached[column] {
                (reached[column], from[column]) = (way, through);
            }
        }
        let open = (0..columns.len()).filter(|column| !done[*column]);
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
