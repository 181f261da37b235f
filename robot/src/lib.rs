//! The robot side of URRCP. If you describe a robot and write a driver for its hardware, a scheduler can play shows on it.
//!
//! ```text
//!   scheduler ──TCP──▶ serve ──▶ Host, one precise thread                  Driver, a thread of its own
//!                                 └─ Robot, a machine for each robot ──▶    └─ your hardware
//!                                     holds scripts, starts and steps        connect, set, read, ping
//!                                     them in time, answers, obeys leases
//! ```
//!
//! # A robot of your own
//!
//! 1. Describe it: an [`InitializationBlock`](urrcp::InitializationBlock) of [`Device`](urrcp::Device)s with their limits.
//! 2. Implement [`Driver`](driver::Driver): four calls from one thread, which may block for up to a second.
//! 3. Join both with [`Hosted::driven`] and [`run()`] it on a port.
//!
//! ```no_run
//! use downbeat_robot::driver::{Driver, DriverError, DriverOptions};
//! use downbeat_robot::{HostOptions, Hosted, run};
//! use downbeat_robot::urrcp::{Device, DeviceId, InitializationBlock, Limits, ScriptParameters, Setpoint};
//!
//! struct Lamp;
//!
//! impl Driver for Lamp {
//!     fn connect(&mut self) -> Result<(), DriverError> {
//!         Ok(()) // open the port, and make sure that the lamp answers
//!     }
//!     fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
//!         println!("{device} {}", setpoint.value);
//!         Ok(())
//!     }
//!     fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
//!         Err(DriverError::Refused(format!("no sensor `{sensor}`")))
//!     }
//!     fn ping(&mut self) -> Result<(), DriverError> {
//!         Ok(()) // ask the hardware itself
//!     }
//! }
//!
//! fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     let percent = Limits::new(0.0, 100.0, 1.0)?;
//!     let lamp = Device::new(DeviceId::new("lamp")?)
//!         .with_position(percent.clone())
//!         .with_scripts(ScriptParameters::new(percent, 1_000));
//!     let description = InitializationBlock::new("stage-1".parse()?, vec![lamp])?;
//!     let robot = Hosted::driven(description, Box::new(Lamp), DriverOptions::default());
//!     Ok(run(robot, "127.0.0.1:7401", HostOptions::default())?)
//! }
//! ```
//!
//! The crate handles everything else. The command `downbeat conformance tcp://127.0.0.1:7401` checks a running robot. A fleet file refers
//! to the robot by `address: tcp://127.0.0.1:7401`. For several robots in one program, or a robot next to other tasks, use
//! [`Host::start`], and [`serve()`] to make them available on ports.
//!
//! # The machine alone
//!
//! [`Robot`] decides everything, without I/O and without a clock: it receives messages and the time, and returns responses and values.
//! Two rules apply: times that you pass must never go back; and after every call, sleep until [`Robot::next_wakeup`] or the next message.
//! [`simulated`] adds a simulated clock, delays and faults.
//!
//! # Features
//!
//! | feature | adds |
//! |---|---|
//! | `host`, on by default | [`run()`], [`Host`], [`serve()`], [`driver`], [`realtime`]: Linux only, with tokio |
//! | `thrift` | a driver for robots that speak the early Thrift form of the protocol |
//! | `sealed` | [`sealed`]: a secret shared with the robot, and a code for each message, for microcontrollers |
//! | `tls` | [`tls`]: TLS 1.3, with certificates on both sides |
//! | `zenoh` | [`zenoh`](mod@zenoh): makes the robot available at a key of a Zenoh network |
//!
//! With `default-features = false`, only the machine and [`simulated`] remain.
#![cfg_attr(
    not(all(feature = "host", feature = "sealed", feature = "tls", feature = "zenoh")),
    allow(rustdoc::broken_intra_doc_links, reason = "links to what features add")
)]

mod answers;
#[cfg(feature = "host")]
pub mod audit;
#[cfg(feature = "host")]
mod budget;
pub mod clock;
mod confirmation;
mod counts;
mod device;
#[cfg(feature = "host")]
pub mod driver;
#[cfg(feature = "host")]
mod edge;
#[cfg(feature = "host")]
pub mod figures;
mod hardware;
mod held;
#[cfg(feature = "host")]
mod host;
mod ids;
mod late_steps;
mod lease;
#[cfg(feature = "host")]
mod newcomers;
mod outgoing;
mod parties;
mod peer;
mod plans;
mod reach;
#[cfg(feature = "host")]
mod refusals;
mod robot;
#[cfg(feature = "host")]
mod run;
#[cfg(feature = "host")]
mod serve;
pub mod set_log;
mod signal;
pub mod simulated;
#[cfg(feature = "tls")]
pub mod tls;
mod tolerance;
#[cfg(feature = "zenoh")]
pub mod zenoh;

pub use confirmation::Ticket;
pub use counts::Counts;
pub use device::{Motion, MotionLimits};
#[cfg(any(feature = "sealed", feature = "tls"))]
pub use downbeat_key_file::{KeyFileError, replace};
#[cfg(feature = "host")]
pub use downbeat_realtime as realtime;
#[cfg(feature = "sealed")]
pub use downbeat_sealed as sealed;
pub use hardware::ReadingId;
#[cfg(feature = "host")]
pub use host::{
    Host, HostError, HostHandle, HostOptions, Hosted, LinkEvent, NotAtRest, RobotLink, audit_file,
};
pub use ids::LinkId;
pub use peer::Peer;
pub use plans::{ImpossibleReport, Lookahead, PlanCancel, PlanEvent, PlanId, PlanPart, PlanStep, Then};
#[cfg(feature = "host")]
pub use refusals::{Reason, Refusals};
pub use robot::{Input, Output, PlanReportError, Robot, SetValue};
#[cfg(feature = "host")]
pub use run::{RunError, run};
#[cfg(feature = "host")]
pub use serve::serve;
#[cfg(feature = "zenoh")]
pub use serve::serve_zenoh;
#[cfg(feature = "host")]
pub use serve::{Door, serve_behind};
/// The protocol's types, in the version that this crate uses.
pub use urrcp;
pub use urrcp::{Proof, Role, Roles};

/// Makes the documentation tests compile the README's examples.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
