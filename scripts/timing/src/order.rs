//! An order for tasks that exclude each other, so that everything ends early: a job shop in a temporal network.

use urrcp::Span;

use super::network::{Event, Network, Schedule};
use super::tabu;

/// A task that needs a zone from its start to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task {
    /// When it takes the zone.
    pub start: Event,
    /// When it leaves it.
    pub end: Event,
    /// Which zone, counted from 0.
    pub zone: usize,
}

/// How long to search. The result depends on nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Most orders that are tried.
    pub moves: usize,
    /// Most looks at bounds; ends the search in large networks.
    pub work: usize,
}

impl Default for Effort {
    /// A few seconds at most.
    fn default() -> Self {
        Self { moves: 20_000, work: 400_000_000 }
    }
}

/// What became of the search.
#[derive(Clone, Debug, PartialEq)]
pub enum Ordering {
    /// An order that keeps every bound.
    Found(Found),
    /// None was found; there may be one.
    NotFound,
    /// There is none: the network contradicts itself, one zone alone cannot be in time, or all orders were tried.
    Infeasible(Option<usize>),
}

/// An order that keeps every bound of the network.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// For each zone the indices of its tasks, in order.
    pub sequences: Vec<Vec<usize>>,
    /// The latest end of all tasks.
    pub makespan: Span,
    /// No order is shorter: the longest of the chains and of the zones by themselves (Jackson's preemptive schedule).
    pub at_least: Span,
    /// The times that go with it.
    pub schedule: Schedule,
}

/// Orders the tasks of each zone one after another.
///
/// Starts from dispatching rules and improves by tabu search over the swaps at the borders of critical blocks (Nowicki and
/// Smutnicki, Management Science 42, 1996). Deadlines count as violations to be searched away. Few orders, up to 720 in a
/// network of up to 2,000 events, are all tried where that does not find the best that there can be.
#[must_use]
pub fn order(network: &Network, tasks: &[Task], effort: Effort) -> Ordering {
    tabu::search(network, tasks, effort)
}
