//! Interdependent times: a simple temporal network, its earliest schedule, its smallest contradiction, and an order for mutually
//! exclusive tasks. The crate is purely mathematical: it knows events and bounds, but not their meaning.
//!
//! A simple temporal network (Dechter, Meiri and Pearl, Artificial Intelligence 49, 1991) bounds differences of events: min <= to - from
//! <= max. It is consistent if and only if its graph has no positive cycle. The longest paths from the origin are its earliest schedule.

mod conflict;
mod network;
mod order;
mod paths;
mod shop;
mod solved;
mod tabu;

pub use conflict::{Bound, Conflict, Correction, Link};
pub use network::{ConstraintId, Event, Network, Schedule};
pub use order::{Effort, Found, Ordering, Task, order};
pub use solved::Solved;

/// Compiles the example of the README with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

#[cfg(test)]
mod real;
#[cfg(test)]
mod tests;
