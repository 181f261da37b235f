//! Bounds of what one scenario may take, so that a slip of the pen neither fills the memory nor keeps anybody waiting.

use urrcp::Span;

/// Most knots of all movements of a scenario together: half a gigabyte.
pub const KNOTS_MAX: usize = 10_000_000;
/// Most steps of a scenario that are made, for all robots together.
pub const STEPS_MAX: usize = 25_000_000;
/// Most times that an act moves a device: robots of its cues, and the devices that they move.
pub const USES_MAX: usize = 5_000_000;

/// Most steps of expressions that are taken.
pub const EVALUATIONS_MAX: usize = 10_000_000;
/// Most moves that the movement of a cue plays, one within another or one after another.
pub const PLAYS_MAX: usize = 10_000;
/// Most moves that all movements of a scenario play.
pub const PLAYS_IN_ALL_MAX: usize = 2_000_000;
/// Most cues that all sequences of a scenario make.
pub const SEQUENCE_CUES_MAX: usize = 20_000;
/// Most moves, sequences or files within one another.
pub const DEPTH_MAX: usize = 32;
/// Most names that wrong ones are compared with.
pub const COMPARISONS_MAX: usize = 1_000_000;
/// Most errors that are reported, and as many warnings.
pub const FINDINGS_MAX: usize = 100_000;

/// Longest time that a message can carry.
pub fn longest() -> Span {
    Span::from_millis_f64(urrcp::OFFSET_MS_MAX)
}

/// Largest lead that a scenario may prescribe, and the one that is counted with where it prescribes none.
pub const LEADS: (Span, Span) = (Span::from_millis(10_000_000_000), Span::from_millis(3_600_000));

/// Something of which only a limited amount may exist.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    most: usize,
    left: usize,
    overdrawn: bool,
}

impl Budget {
    /// A full budget.
    pub const fn new(most: usize) -> Self {
        Self { most, left: most, overdrawn: false }
    }

    /// Of which nothing is left, and this has been told.
    pub const fn overdrawn(most: usize) -> Self {
        Self { most, left: 0, overdrawn: true }
    }

    /// The whole budget.
    pub const fn most(&self) -> usize {
        self.most
    }

    /// The part of the budget that is left.
    pub const fn left(&self) -> usize {
        self.left
    }

    /// Whether more was wanted than there was: it has been told then, and what follows is left out.
    pub const fn is_overdrawn(&self) -> bool {
        self.overdrawn
    }

    /// Takes this many, if there are.
    pub const fn take(&mut self, count: usize) -> bool {
        match self.left.checked_sub(count) {
            Some(left) => self.left = left,
            None => self.overdrawn = true,
        }
        !self.overdrawn
    }
}
