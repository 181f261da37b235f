//! What a robot has told of its commands, counted.

/// Commands of a robot: scripts, and single values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Counts {
    /// It holds these now: they wait for their start, or run.
    pub held: u64,
    /// Have started.
    pub started: u64,
    /// Have come to their end.
    pub ended: u64,
    /// Ended early, or never started although they were held.
    pub failed: u64,
    /// Steps that came more than a millisecond late, of commands that have come to their end.
    pub late_steps: u64,
}
