//! The scenario language: read a fleet and a choreography, find everything that will not work, compile the rest.
//!
//! The way through this crate: `source` and `node` (text to tree), `fleet` and `scenario` (tree to meaning), `motion`
//! (keyframes to steps), `plan` (steps to one script a device, checked). Findings carry a path into the tree; `locate`
//! turns it into line and column only when there is something to report, and `render` shows it.

mod duration;
mod fields;
mod finding;
mod fleet;
pub mod import;
mod locate;
mod motion;
mod node;
mod plan;
mod render;
mod scenario;
mod source;

pub use duration::parse_duration;
pub use finding::{Code, Finding, Severity};
pub use fleet::{Address, Fault, Fleet, FleetRobot, Handshake, SimulationSettings, read_fleet, read_init};
pub use plan::{Compiled, DeviceScript, Plan, RobotPlan, compile};
pub use render::{counted, render};
pub use scenario::fleet_named_by;
pub use source::Source;

#[cfg(test)]
mod tests;
