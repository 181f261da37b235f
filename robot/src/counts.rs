//! Counts of a robot's commands, based on the events that the robot has reported.

/// A robot's command counts. A command is a script or a single value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Counts {
    /// Number of commands that are waiting for their start, or are running.
    pub held: u64,
    /// Number of commands that have started.
    pub started: u64,
    /// Number of commands that have completed.
    pub ended: u64,
    /// Number of accepted commands that ended early, whether or not they had started.
    pub failed: u64,
    /// Number of steps that were more than a millisecond late, in all completed commands.
    pub late_steps: u64,
}
