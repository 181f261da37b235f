//! The robot's side of URRCP: machines that decide, and a thin real world round them.
//!
//! `device` and `robot` are machines without I/O and without a clock: messages and the time in, answers and values out.
//! Something surrounds each: hardware behind a driver (`edge`, `driver`), or a simulated world with a clock, delays and
//! faults of its own (`simulated`), still without touching the real one. `host` runs both kinds in real time on one
//! precise thread (`precise_wait`, `scheduling`, `clock`), `wake_up` measures it, and `serve` puts TCP round it.

mod answers;
pub mod clock;
mod device;
#[cfg(feature = "host")]
pub mod driver;
#[cfg(feature = "host")]
mod edge;
mod hardware;
mod held;
#[cfg(feature = "host")]
mod host;
#[cfg(any(test, feature = "invariants"))]
pub mod invariants;
mod lease;
mod outgoing;
mod parties;
#[cfg(feature = "host")]
mod precise_wait;
#[cfg(feature = "host")]
pub mod realtime;
mod robot;
#[cfg(feature = "host")]
mod scheduling;
#[cfg(feature = "host")]
mod serve;
pub mod set_log;
mod signal;
pub mod simulated;
#[cfg(feature = "host")]
mod wake_up;

pub use device::Motion;
pub use hardware::{AtEnd, ReadingId};
#[cfg(feature = "host")]
pub use host::{Host, HostError, HostHandle, HostOptions, Hosted, LinkEvent, NotAtRest, RobotLink};
pub use robot::{Input, LinkId, Output, Robot, SetValue};
#[cfg(feature = "host")]
pub use serve::serve;

/// The examples of the README are compiled with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
