//! Limits on the resources that one scenario may take, so that a typo neither exhausts memory nor takes very long to read.

use urrcp::Span;

/// Maximum number of knots (points of curves) in all movements of a scenario together. At this limit, they take half a gigabyte of
/// memory.
pub const KNOTS_MAX: usize = 10_000_000;
/// Maximum number of steps that the compiler generates for a scenario, for all robots together.
pub const STEPS_MAX: usize = 25_000_000;
/// Maximum number of times that the cues of a scenario move a device. Each device that a cue moves counts once per robot of the cue.
pub const USES_MAX: usize = 5_000_000;

/// Maximum number of steps in which all expressions of a scenario are evaluated.
pub const EVALUATIONS_MAX: usize = 10_000_000;
/// Maximum number of moves that the movement of one cue plays, nested or in sequence.
pub const PLAYS_MAX: usize = 10_000;
/// Maximum number of moves that all movements of a scenario play.
pub const PLAYS_IN_ALL_MAX: usize = 2_000_000;
/// Maximum number of cues that all sequences of a scenario generate.
pub const SEQUENCE_CUES_MAX: usize = 20_000;
/// Maximum nesting depth of moves, sequences or files.
pub const DEPTH_MAX: usize = 32;
/// Maximum number of comparisons between misspelt and known names in a scenario.
pub const COMPARISONS_MAX: usize = 1_000_000;
/// Maximum number of errors that are reported; the same maximum applies to warnings.
pub const FINDINGS_MAX: usize = 1_000;

/// Returns the longest time that a protocol message can carry.
pub fn longest() -> Span {
    Span::from_millis_f64(urrcp::OFFSET_MS_MAX)
}

/// The largest lead (time from the sending of scripts to the start) that a scenario may prescribe. The second value is the lead that is
/// assumed if the scenario prescribes a shorter one or none.
pub const LEADS: (Span, Span) = (Span::from_millis(10_000_000_000), Span::from_millis(3_600_000));

/// A resource of which only a limited amount may be used.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    most: usize,
    left: usize,
    overdrawn: bool,
}

impl Budget {
    /// Creates a budget of `most` from which nothing has been taken.
    pub const fn new(most: usize) -> Self {
        Self { most, left: most, overdrawn: false }
    }

    /// Creates an overdrawn budget with the initial amount `most`. Nothing remains, and the overdraft has already been reported.
    pub const fn overdrawn(most: usize) -> Self {
        Self { most, left: 0, overdrawn: true }
    }

    /// The initial amount.
    pub const fn most(&self) -> usize {
        self.most
    }

    /// The remaining amount.
    pub const fn left(&self) -> usize {
        self.left
    }

    /// Whether more was requested than remained. If so, this has already been reported, and everything that follows is left out.
    pub const fn is_overdrawn(&self) -> bool {
        self.overdrawn
    }

    /// Takes `count` from the budget. If fewer remain, takes nothing and marks the budget as overdrawn. Returns false if the budget is
    /// overdrawn, now or from before.
    pub const fn take(&mut self, count: usize) -> bool {
        match self.left.checked_sub(count) {
            Some(left) => self.left = left,
            None => self.overdrawn = true,
        }
        !self.overdrawn
    }
}
