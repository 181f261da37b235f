//! Measures how long devices take from a command to visible motion. Each device is moved by a small amount to and fro, as its fleet file
//! permits, while its sensor is read. [`downbeat_onset`] estimates when it began to move.
//!
//! ```text
//!   fleet ─▶ plan: what may be moved, how far, how fast
//!                └─▶ measure: readings at rest, then movements until the spread is known, then back
//!                       └─▶ talk: one link, one session, one question at a time
//! ```
//!
//! Robots are moved one after the other. A robot is claimed for a session as in a mission, and every command has a lease. In any case,
//! the devices are ordered to stay where they are before the robot is released.

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
    /// The robot does not answer, refuses, or is a different one.
    #[error(transparent)]
    Dialogue(#[from] DialogueError),
    /// The sensor shows no motion that can be judged.
    #[error("{of} of {trials} movements cannot be evaluated: {why}")]
    Unclear {
        /// The number of movements that cannot be judged.
        of: usize,
        /// The number of all movements.
        trials: usize,
        /// The first reason.
        why: Unclear,
    },
    /// The noise of the sensor at rest is too large for the movement.
    #[error(
        "sensor `{sensor}` has a noise of {noise:.4} at rest, too much for a movement of {by}; declare a larger movement if that is safe"
    )]
    Noise {
        /// The sensor.
        sensor: String,
        /// The standard deviation of its readings.
        noise: f64,
        /// The movement.
        by: f64,
    },
    /// The device is not where the movement should begin.
    #[error(
        "the device is at {at:.4}, but the movement starts at {from}; move the device there first, or correct `from`"
    )]
    Elsewhere {
        /// The position that the sensor shows.
        at: f64,
        /// Where the movement should begin.
        from: f64,
    },
    /// The movement would exceed the device's limits.
    #[error("the movement from {from} to {to} would exceed the limits {least} to {largest}")]
    BeyondLimits {
        /// Where it would begin.
        from: f64,
        /// Where it would end.
        to: f64,
        /// The lowest permitted position.
        least: f64,
        /// The highest permitted position.
        largest: f64,
    },
}
