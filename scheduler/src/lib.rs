//! Downbeat makes many robots start together and stay together. This is the library behind the program.
//!
//! ```text
//!   Choreography ──▶ Mission, a machine: events and the time in, actions out
//!                       │ events ▲ │ actions
//!                       │        │ ▼
//!                     drive, the one loop ──▶ World: real (run), virtual (dry_run), with faults (simulation)
//!                       │                       └─ links to robots, a journal, a recording, an operator
//!                       ▼
//!                     Report
//! ```
//!
//! [`run`](run::run) plays a [`Mission`](mission::Mission) on real robots, and [`dry_run`] in virtual time. `examples/scheduler.rs` is a
//! scheduler to copy. The crate `downbeat-scripts` compiles choreographies, and [`fleet`] turns a fleet file into the participants of a
//! mission.
//!
//! To drive the machine with your own loop, implement [`World`](drive::World) and call [`drive`](drive::drive()). If you call the machine
//! yourself, follow one rule: **[`advance`](mission::Mission::advance) follows every [`handle`](mission::Mission::handle)**, at the same
//! instant and once no further event of that instant is waiting. An event only updates the mission's knowledge; consequences, such as the
//! decision to start, may be left to `advance`. Perform the actions of both in order. Then wait until
//! [`next_wakeup`](mission::Mission::next_wakeup) or the next event, whichever comes first.
//!
//! | module | |
//! |---|---|
//! | [`mission`], [`drive`] | the machine, and the loop that drives it |
//! | [`run`], [`link`], [`server_clock`], [`stop_lane`] | a mission in real time |
//! | [`fleet`] | robots of a fleet file: participants, endpoints, simulated robots |
//! | [`journal`], [`recording`] | the files of a mission on the disk |
//! | [`report`], [`show`] | the outcome of a mission, also as text or a picture |
//! | [`certificate`] | the statement that a plan was played with faults |
//! | [`requirements`] | whether figures meet the requirements of a scenario |
//! | [`measured`] | the network and the clocks of a recorded mission, as a world file |
//! | [`dry_run`], [`trials`] | missions in virtual time |
//! | [`conformance`] | whether a robot meets the requirements of the protocol |
//! | [`calibrate`], [`downbeat_onset`] | the time from a command to visible motion of a device |
//! | [`session`] | the operator on whose behalf robots are driven |
//! | [`clock`], [`zone`], [`open_files`] | the error of a robot's clock; local times; the limit of open files, raised for many sockets |

pub mod calibrate;
mod cli;
mod operations;

pub use downbeat_conformance as conformance;
use downbeat_history::compare;
pub use downbeat_history::{history, measured, page};
pub use downbeat_mission as mission;
pub use downbeat_mission::{clock, drive, report, requirements, session, zone};
pub use downbeat_rehearsal::{certificate, dry_run, trials};
use downbeat_runtime::signals;
pub use downbeat_runtime::{fleet, journal, keys, link, open_files, recording, run, server_clock, stop_lane};

pub use downbeat_show as show;

#[doc(hidden)]
pub use cli::main;

/// Includes the README, so that its examples are compiled as documentation tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
