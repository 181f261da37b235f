//! Measures how long devices take from a command to visible motion. Each device is moved to and fro by a small amount, as the fleet file
//! permits, while its sensor is read. [`downbeat_onset`] estimates when the device began to move.
//!
//! ```text
//!   fleet ─▶ plan: what may be moved, how far, how fast
//!                └─▶ measure: readings at rest, then movements until the spread is known, then back
//!                       └─▶ talk: one link, one session, one question at a time
//! ```
//!
//! Robots are moved one after the other. A robot is claimed for a session as in a mission, and every command has a lease. Even after
//! an error, the devices are ordered to stay where they are before the robot is released.

mod measure;
mod plan;
mod talk;

use downbeat_onset::Unclear;

pub use measure::{Measured, Progress, measure};
pub use plan::{PlannedDevice, PlannedRobot, Unplanned, plan};
pub use talk::{DialogueError, RobotDialogue};

/// The reason why a device was not measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NotMeasured {
    /// The robot does not answer, refuses a request, or is not the expected robot.
    #[error(transparent)]
    Dialogue(#[from] DialogueError),
    /// Too many movements cannot be evaluated from the sensor's readings.
    #[error("{of} of {trials} movements cannot be evaluated: {why}")]
    Unclear {
        /// The number of movements that cannot be evaluated.
        of: usize,
        /// The number of all movements.
        trials: usize,
        /// The reason for the first movement that cannot be evaluated.
        why: Unclear,
    },
    /// The noise of the sensor at rest is too large for the movement.
    #[error(
        "sensor `{sensor}` has a noise of {noise:.4} at rest, too much for a movement of {by}; declare a larger movement if that is safe"
    )]
    Noise {
        /// The id of the sensor.
        sensor: String,
        /// The standard deviation of the sensor's readings at rest, in the sensor's unit.
        noise: f64,
        /// The size of the commanded movement, in the device's unit.
        by: f64,
    },
    /// The device is too far from the position at which the movement should start.
    #[error(
        "the device is at {at:.4}, but the movement starts at {from}; move the device there first, or correct `from`"
    )]
    Elsewhere {
        /// The position that the sensor shows.
        at: f64,
        /// The position at which the movement should start.
        from: f64,
    },
    /// The movement would exceed the device's limits.
    #[error(
        "the movement from {from} to {to} would exceed the limits {least} to {largest}; correct `from` or `by`"
    )]
    BeyondLimits {
        /// The position at which the movement would start.
        from: f64,
        /// The position at which the movement would end.
        to: f64,
        /// The lowest permitted position.
        least: f64,
        /// The highest permitted position.
        largest: f64,
    },
}
