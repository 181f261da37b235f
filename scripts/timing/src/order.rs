//! Orders mutually exclusive tasks so that the last one ends as early as possible: a job shop in a temporal network.

use urrcp::Span;

use super::network::{Event, Network, Schedule};
use super::tabu;

/// A task that occupies a zone from its start to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task {
    /// Event at which the task begins to occupy the zone.
    pub start: Event,
    /// Event at which the task leaves the zone.
    pub end: Event,
    /// Index of the zone, from 0.
    pub zone: usize,
}

/// Limits of the search for an order. The result depends only on these limits and on the input, not on elapsed time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Maximum number of orders tried.
    pub moves: usize,
    /// Maximum number of bound inspections. In large networks, this limit ends the search.
    pub work: usize,
}

impl Default for Effort {
    /// Limits with which a search takes a few seconds at most.
    fn default() -> Self {
        Self { moves: 20_000, work: 400_000_000 }
    }
}

/// Result of the search for an order.
#[derive(Clone, Debug, PartialEq)]
pub enum Ordering {
    /// An order that keeps every bound.
    Found(Found),
    /// The search found no order, but one may exist.
    NotFound,
    /// No order exists: the network contradicts itself, one zone alone cannot meet its deadlines, or all orders were tried. Contains the
    /// index of that zone, if it is a single zone.
    Infeasible(Option<usize>),
}

/// An order that keeps every bound of the network.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// For each zone, the indices of its tasks in their order.
    pub sequences: Vec<Vec<usize>>,
    /// The latest end of all tasks.
    pub makespan: Span,
    /// Lower bound on the makespan of any order: the maximum over all chains and all single zones (Jackson's preemptive schedule).
    pub at_least: Span,
    /// The schedule of this order.
    pub schedule: Schedule,
}

/// Orders the tasks of each zone so that they do not overlap.
///
/// Starts from dispatching rules and improves the order by tabu search. Its moves swap tasks at the borders of critical blocks (Nowicki
/// and Smutnicki, Management Science 42, 1996). Missed deadlines are violations that the search reduces. If the search does not reach
/// the lower bound, all orders are tried. This requires at most 720 orders and a network of at most 2,000 events.
#[must_use]
pub fn order(network: &Network, tasks: &[Task], effort: Effort) -> Ordering {
    tabu::search(network, tasks, effort)
}
