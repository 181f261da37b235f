//! The robot's side of URRCP: machines that decide, and a thin real world round them.
//!
//! `device` and `robot` are machines without I/O and without a clock: messages and the time in, answers and values out.
//! Something surrounds each: hardware behind a driver (`edge`, `driver`), or a simulated world with a clock, delays and
//! faults of its own (`simulated`), still without touching the real one. `host` runs both kinds in real time on one
//! precise thread (`precise_wait`, `scheduling`, `clock`), `wake_up` measures it, and `serve` puts TCP round it.

mod answers;
pub mod clock;
mod device;
pub mod driver;
mod edge;
mod hardware;
mod held;
mod host;
#[cfg(any(test, feature = "invariants"))]
pub mod invariants;
mod lease;
mod outgoing;
mod parties;
mod precise_wait;
mod robot;
mod scheduling;
mod serve;
mod set_log;
mod signal;
pub mod simulated;
mod wake_up;

pub use device::Motion;
pub use hardware::ReadingId;
pub use host::{Host, HostError, HostHandle, HostOptions, Hosted, LinkEvent, NotAtRest, RobotLink};
pub use precise_wait::{PreciseWait, Woken};
pub use robot::{Input, LinkId, Output, Robot, SetValue};
pub use scheduling::{Realtime, Scheduling};
pub use serve::serve;
pub use set_log::{Kept, LogEntry};
pub use wake_up::WakeUp;

/// The examples of the README are compiled with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
