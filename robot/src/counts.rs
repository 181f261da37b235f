//! Counts of the command events that a robot has reported.

/// Command counts of a robot: scripts, and single values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Counts {
    /// Currently held: waiting for their start, or running.
    pub held: u64,
    /// Started.
    pub started: u64,
    /// Completed.
    pub ended: u64,
    /// Ended early, or never started although they were held.
    pub failed: u64,
    /// Steps that were more than a millisecond late, of completed commands.
    pub late_steps: u64,
}
