//! The scenario language of Downbeat: reads a fleet and a choreography, reports everything that would not work, and compiles the
//! choreography.
//!
//! ```text
//!   fleet.yaml ── read_fleet ──▶ Fleet ─┐
//!                                       ├─ compile ──▶ Choreography: acts, each with a script for each device
//!   show.yaml ─── Source::read ─────────┘         └──▶ findings, each with its line, what is expected, how to fix it
//! ```
//!
//! [`compile`] returns a [`Choreography`] only if there are no errors; [`render()`] shows findings with the affected lines. The README
//! demonstrates both in a few lines, and `examples/compile.rs` is a program to copy. The crate `downbeat-import` turns files of other
//! tools into scenarios, and `downbeat-export` writes compiled scenarios to files of other tools.
//!
//! The modules form layers: none imports from a layer above it. From the bottom:
//!
//! 1. `downbeat-yaml`, a crate: trees, places and findings.
//! 2. `downbeat-motion`, a crate: exact numbers, expressions, and the steps of movements.
//! 3. `downbeat-space`, a crate: bodies, places, and routes between them.
//! 4. `downbeat-reader`, a crate: reads values of a tree, with hints.
//! 5. `downbeat-import` and `downbeat-fleet`, crates: files of other tools; robots.
//! 6. `downbeat-plan`, a crate: the result. `ensemble`: the movements of groups. `scenario`: from tree to meaning.
//! 7. `compile`: robots, times (solved by `downbeat-timing`), movements.
//! 8. `approach`, `home`, `inventory`: other products of a fleet and a scenario.

mod approach;
mod compile;
mod ensemble;
mod home;
mod inventory;
mod pose_file;
mod scenario;
mod schema;

use downbeat_fleet::{fleet, sensor_range};
use downbeat_import as import;
pub use downbeat_motion::fit;
use downbeat_motion::{exact, expression, motion, music};
use downbeat_plan as plan;
use downbeat_reader::{clock_time, fields, keys, scope, slips};
use downbeat_space::{formation, space, transit};
#[doc(hidden)]
pub use downbeat_yaml::shown;
use downbeat_yaml::{
    budget, composed, duration, files, finding, identify, locate, node, render, source, syntax, tags,
};

pub use approach::{Approach, add_approach, plan_approach};
pub use compile::{
    Compiled, Gap, Moment, Outline, WrittenAct, WrittenCue, WrittenRelation, compile, outline,
};
pub use downbeat_fleet::address::{
    Address, DmxAddress, DmxProtocol, InvalidAddress, MavlinkAddress, OscAddress, Protection, VehicleEnd,
};
pub use downbeat_fleet::fleet::{
    Calibration, ClockMode, DeviceLatency, Fault, Fleet, FleetRobot, Handshake, LAGS_MAX, Lag, LatencyFile,
    LatencySource, MeasuredLatency, MissionSettings, RateLimits, Requirement, SimulatedMoves,
    SimulationSettings, Taken, fleet_keys, latency_file_of, latency_keys, latency_text, read_fleet,
    read_fleet_named, read_fleet_to_measure, read_fleet_within, read_latency_file, settable_limits,
};
pub use downbeat_fleet::init::{init_of, init_text, read_init};
pub use downbeat_fleet::sensor_range::SensorRange;
pub use downbeat_fleet::world::{
    Between, ClockWorld, Delay, Incident, Interruptions, LinkWorld, OperatorWorld, QUANTILES, Reading,
    SensorWorld, Trouble, World, read_world, world_keys, world_of,
};
pub use downbeat_plan::{
    Act, AllOrNone, Ceiling, Choreography, CueText, DeviceScript, DeviceUse, FailurePolicy, FirstUse, Floor,
    OnDoubt, OnFailure, Plan, PlannedCue, PlannedReading, Positions, Repetition, Requirements, RobotPlan,
    Share, Wait, Way,
};
#[doc(hidden)]
pub use downbeat_reader::fields::tried as try_expression;
#[doc(hidden)]
pub use downbeat_space::formation::tried as try_formation;
pub use downbeat_space::space::{
    Body, BodyUse, Closest, Coordinate, Drive, DrivenPath, DrivenPoint, InSpace, Joint, JointKind, Shape,
    Space, Steering, Volume,
};
pub use downbeat_yaml::duration::parse_duration;
pub use downbeat_yaml::files::{Files, Folder, NoFiles};
pub use downbeat_yaml::finding::{Code, Finding, Related, Severity};
pub use downbeat_yaml::home::{abbreviate_home, expand_home};
pub use downbeat_yaml::open::open;
pub use downbeat_yaml::project::Project;
pub use downbeat_yaml::refusal::{Attempt, Refusal};
pub use downbeat_yaml::render::render;
pub use downbeat_yaml::sarif::sarif;
pub use downbeat_yaml::source::Source;
pub use home::{plan_home, plan_jog};
pub use inventory::{Offer, Parameter, inventory};
pub use pose_file::{PoseDevice, PoseFileError, with_pose};
pub use scenario::{fleet_named_by, included_keys, parse_time, place_at_fleet, scenario_keys};
pub use schema::{Schema, all_maps, schema};

/// Functions for the wording of messages, shared with the program.
#[doc(hidden)]
pub use {
    downbeat_fleet::address::address_fault, downbeat_yaml::duration::written,
    downbeat_yaml::finding::did_you_mean, downbeat_yaml::finding::robots_named,
    downbeat_yaml::render::counted,
};

#[cfg(test)]
mod tests;

/// Compiles the examples in the README when the tests run.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
