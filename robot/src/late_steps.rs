//! The number of late steps of a command, and how late the latest of them was.

use urrcp::{Millis, Span};

/// A step that is done later than this after its deadline counts as late.
const LATE: Span = Span::from_millis(1);

/// The late steps of one command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LateSteps {
    pub(crate) count: u32,
    max: Span,
}

impl LateSteps {
    /// Records that a step was done this long after its deadline.
    pub(crate) fn note(&mut self, by: Span) {
        if by > LATE {
            self.count += 1;
            self.max = self.max.max(by);
        }
    }

    /// How late the latest step was; `None` if no step was late.
    pub(crate) fn ms_max(self) -> Option<Millis> {
        (self.count > 0).then(|| Millis::from_span(self.max))
    }
}
