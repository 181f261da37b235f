//! How many steps of a command were late, and by how much the latest of them.

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
    /// A step was done this long after its deadline.
    pub(crate) fn note(&mut self, by: Span) {
        if by > LATE {
            self.count += 1;
            self.max = self.max.max(by);
        }
    }

    /// `None` if no step was late.
    pub(crate) fn ms_max(self) -> Option<Millis> {
        (self.count > 0).then(|| Millis::from_span(self.max))
    }
}
