//! The scenario language of Downbeat: read a fleet and a choreography, find everything that will not work, compile the rest.
//!
//! ```text
//!   fleet.yaml ── read_fleet ──▶ Fleet ─┐
//!                                       ├─ compile ──▶ Choreography: acts, each with a script for each device
//!   show.yaml ─── Source::read ─────────┘         └──▶ findings, each with its line, what is expected, how to fix it
//! ```
//!
//! [`compile`] returns a [`Choreography`] only if nothing is wrong; [`render`] shows findings with the lines that they concern. The
//! README has both in a few lines, and `examples/compile.rs` is a program to copy. [`import`] makes scenarios of the files of other
//! tools, and [`export`] writes what a scenario compiles to as theirs.
//!
//! The modules are layers: none imports one above it. From the bottom:
//!
//! 1. `finding`, `source`, `formats`, `locate`, `render`: files and their faults. Findings carry a path into the tree; `locate`
//!    turns it into line and column only when there is something to report.
//! 2. `exact`, `duration`, `music`, `expression`, `fit`, `motion`: times, values, and the steps of movements.
//! 3. `space`, `formation`, `transit`: bodies, places, and ways between them.
//! 4. `node`, `at`, `scope`, `identify`: text to tree.
//! 5. `fields`: reads values of a tree, with `slips` for hints.
//! 6. `init`, `import`, `fleet`: robots, and files of other tools.
//! 7. `plan`, `refill`: the result, and the time for sending it. `ensemble`: what groups do. `scenario`: tree to meaning.
//! 8. `compile`: robots, times (solved by `downbeat-timing`), movements.
//! 9. `approach`, `home`, `rehearse`, `inventory`, `world`, `export`: what else is made of a fleet and a scenario.

mod address;
mod aliases;
mod approach;
mod at;
mod budget;
mod chance;
mod clock_time;
mod compile;
mod composed;
mod duration;
mod ensemble;
mod events;
mod exact;
pub mod export;
mod expression;
mod fields;
mod files;
mod finding;
pub mod fit;
mod fleet;
mod formation;
mod formats;
mod home;
mod identify;
pub mod import;
mod init;
mod inventory;
mod keys;
#[cfg(test)]
mod known;
mod locate;
mod motion;
mod music;
mod node;
mod open;
mod plan;
mod project;
mod refill;
mod refusal;
mod rehearse;
mod render;
mod requirements;
mod sarif;
mod scenario;
mod schema;
mod scope;
mod sensor_range;
#[doc(hidden)]
pub mod shown;
mod slips;
mod source;
mod space;
mod syntax;
mod tags;
mod transit;
mod world;

pub use address::{Address, NoAddress, Protection};
pub use approach::Approach;
pub use compile::poses::Positions;
pub use compile::{
    Compiled, Gap, Moment, Outline, WrittenAct, WrittenCue, WrittenRelation, compile, outline,
};
pub use duration::parse_duration;
#[doc(hidden)]
pub use fields::tried as try_expression;
pub use files::{Files, Folder, NoFiles};
pub use finding::{Code, Finding, Related, Severity};
pub use fleet::{
    Calibration, ClockMode, DeviceLatency, Fault, Fleet, FleetRobot, Handshake, LAGS_MAX, Lag, LatencyFile,
    LatencySource, MeasuredLatency, MissionSettings, RateLimits, Requirement, SimulatedMoves,
    SimulationSettings, Taken, latency_file_of, latency_text, read_fleet, read_fleet_named,
    read_fleet_to_measure, read_fleet_within, read_latency_file,
};
#[doc(hidden)]
pub use formation::tried as try_formation;
pub use init::{init_of, init_text, read_init};
pub use inventory::{Offer, Parameter, inventory};
pub use open::open;
pub use plan::{
    Act, AllOrNone, Ceiling, Choreography, DeviceScript, DeviceUse, FailurePolicy, FirstUse, Floor, OnDoubt,
    OnFailure, Plan, PlannedCue, PlannedReading, Repetition, Requirements, RobotPlan, SensorRange, Share,
    Wait, Way, is_rate,
};
pub use project::Project;
pub use refill::{Freed, Refill, RefillKind, refills, refills_behind, refills_of_robots, tightest_refill};
pub use refusal::{Attempt, Refusal};
pub use render::render;
pub use sarif::sarif;
pub use scenario::{fleet_named_by, parse_time, place_at_fleet};
pub use schema::{Schema, schema};
pub use source::Source;
pub use space::{
    Body, BodyUse, Closest, Coordinate, Drive, DrivenPath, DrivenPoint, InSpace, Joint, JointKind, Shape,
    Space, Steering, Volume,
};
pub use world::{
    Between, ClockWorld, Delay, Incident, Interruptions, LinkWorld, OperatorWorld, QUANTILES, Reading,
    SensorWorld, Trouble, World, read_world,
};

/// Words for messages, shared with the program.
#[doc(hidden)]
pub use {address::address_fault, duration::written, finding::did_you_mean, import::scalar, render::counted};

#[cfg(test)]
mod tests;

/// The examples of the README are compiled with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
