//! Orders mutually exclusive tasks so that everything ends early: a job shop in a temporal network.

use urrcp::Span;

use super::network::{Event, Network, Schedule};
use super::tabu;

/// A task that needs a zone from its start to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task {
    /// Event at which it occupies the zone.
    pub start: Event,
    /// Event at which it leaves the zone.
    pub end: Event,
    /// Index of the zone, from 0.
    pub zone: usize,
}

/// Limits of the search. The result depends only on them and on the input, not on time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Maximum number of orders tried.
    pub moves: usize,
    /// Maximum number of bound inspections; ends the search in large networks.
    pub work: usize,
}

impl Default for Effort {
    /// Takes a few seconds at most.
    fn default() -> Self {
        Self { moves: 20_000, work: 400_000_000 }
    }
}

/// Result of the search.
#[derive(Clone, Debug, PartialEq)]
pub enum Ordering {
    /// An order that keeps every bound.
    Found(Found),
    /// No order was found, but one may exist.
    NotFound,
    /// No order exists: the network contradicts itself, one zone alone cannot meet its deadlines, or all orders were tried. Contains the
    /// index of that zone.
    Infeasible(Option<usize>),
}

/// An order that keeps every bound of the network.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// The indices of each zone's tasks, in order.
    pub sequences: Vec<Vec<usize>>,
    /// The latest end of all tasks.
    pub makespan: Span,
    /// Lower bound for the makespan of any order: the longest of the chains and of the single zones (Jackson's preemptive schedule).
    pub at_least: Span,
    /// The schedule of this order.
    pub schedule: Schedule,
}

/// Orders the tasks of each zone one after another.
///
/// Starts from dispatching rules and improves by tabu search over the swaps at the borders of critical blocks (Nowicki and Smutnicki,
/// Management Science 42, 1996). Missed deadlines are violations that the search reduces. If this does not reach the lower bound and
/// there are at most 720 orders in a network of at most 2,000 events, all of them are tried.
#[must_use]
pub fn order(network: &Network, tasks: &[Task], effort: Effort) -> Ordering {
    tabu::search(network, tasks, effort)
}
