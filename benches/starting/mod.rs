//! Parts of `start_spread`: a fleet of processes, missions on that fleet, other ways of waiting for a start, and evaluation of the
//! figures.

pub mod figures;
pub mod fleet;
pub mod missions;
pub mod waiters;
pub mod witness;

use std::time::{SystemTime, UNIX_EPOCH};

/// Number of robots that start together.
pub const ROBOTS: usize = 6;

/// Returns the time of the system clock, in nanoseconds since the Unix epoch.
pub fn epoch_nanos() -> i64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    i64::try_from(now.as_nanos()).unwrap()
}
