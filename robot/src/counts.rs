//! Counts of a robot's commands, by the events that the robot has reported about them.

/// A robot's command counts. A command is a script or a single value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Counts {
    /// Number of commands that wait for their start or run.
    pub held: u64,
    /// Number of commands that have started.
    pub started: u64,
    /// Number of commands that have completed.
    pub ended: u64,
    /// Number of commands that ended early, or that were held and never started.
    pub failed: u64,
    /// Number of steps of completed commands that were more than a millisecond late.
    pub late_steps: u64,
}
