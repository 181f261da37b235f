//! Number of late steps of a command, and the largest of their delays.

use urrcp::{Millis, Span};

/// Delay above which a step counts as late.
const LATE: Span = Span::from_millis(1);

/// Count and maximum delay of the late steps of one command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LateSteps {
    pub(crate) count: u32,
    max: Span,
}

impl LateSteps {
    /// Records that a step was done `by` after its deadline. Ignores a delay of at most [`LATE`].
    pub(crate) fn note(&mut self, by: Span) {
        if by > LATE {
            self.count += 1;
            self.max = self.max.max(by);
        }
    }

    /// Returns the largest delay of a late step, in milliseconds. `None` if no step was late.
    pub(crate) fn ms_max(self) -> Option<Millis> {
        (self.count > 0).then(|| Millis::from_span(self.max))
    }
}
