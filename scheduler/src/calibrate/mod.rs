//! Measuring how long devices take from a command to visible motion: each is moved by a small amount to and fro, as its fleet file
//! permits, while its sensor is read; [`downbeat_onset`] estimates when it began to move.
//!
//! ```text
//!   fleet ─▶ plan: what may be moved, how far, how fast
//!                └─▶ measure: readings at rest, then movements until the spread is known, then back
//!                       └─▶ talk: one link, one session, one question at a time
//! ```
//!
//! Robots are moved one after the other. A robot is claimed for a session as by a mission, every command has a lease, and whatever
//! happens, the devices are told to stay where they are before the robot is released.

mod measure;
mod plan;
mod talk;

use downbeat_onset::Unclear;

pub use measure::{Measured, Progress, measure};
pub use plan::{PlannedDevice, PlannedRobot, Unplanned, plan};
pub use talk::{Talk, TalkError};

/// Why a device was not measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NotMeasured {
    /// The robot does not answer, refuses, or is another one.
    #[error(transparent)]
    Talk(#[from] TalkError),
    /// Its sensor shows no motion that can be judged.
    #[error("{of} of {trials} movements cannot be judged: {why}")]
    Unclear {
        /// So many cannot be judged.
        of: usize,
        /// Of so many.
        trials: usize,
        /// Why most of them.
        why: Unclear,
    },
    /// The noise of the sensor at rest is too large.
    #[error(
        "its sensor `{sensor}` has a noise of {noise:.4} at rest, too much for a movement of {by}: declare a larger one if that is safe"
    )]
    Noise {
        /// The sensor.
        sensor: String,
        /// Standard deviation of its readings.
        noise: f64,
        /// The movement.
        by: f64,
    },
    /// It is not where the movement is to begin.
    #[error(
        "it is at {at:.4}, and the movement is to begin at {from}: move it there first, or correct `from`"
    )]
    Elsewhere {
        /// Where its sensor shows it.
        at: f64,
        /// Where the movement is to begin.
        from: f64,
    },
    /// The movement would leave its limits.
    #[error("the movement would lead from {from} to {to}, beyond its limits {least} to {largest}")]
    BeyondLimits {
        /// Where it would begin.
        from: f64,
        /// Where it would end.
        to: f64,
        /// The least position.
        least: f64,
        /// The largest position.
        largest: f64,
    },
}
