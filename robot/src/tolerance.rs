//! By how much a robot may be late before it ends what is out of sync.

#[cfg(feature = "host")]
use std::time::Duration;

use urrcp::Span;

use crate::device::START_LATE_MAX;
#[cfg(feature = "host")]
use crate::hardware::SILENCE_MAX;
use crate::hardware::STALE;
use crate::plans::REPORT_WAIT;

/// Limits of lateness, of the robot, the thread that runs it and its hardware. Products use the defaults; a test whose machine may be
/// slow sets its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tolerance {
    /// A command that starts later than this is dropped.
    pub(crate) start: Span,
    /// A later step or a value that is later than this is not set.
    pub(crate) step: Span,
    /// A driver that times scripts reports a start or an end within this time.
    pub(crate) report: Span,
    /// Hardware that is silent for longer than this near a start is not ready.
    #[cfg(feature = "host")]
    pub(crate) silence: Duration,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self {
            start: START_LATE_MAX,
            step: STALE.into(),
            report: REPORT_WAIT,
            #[cfg(feature = "host")]
            silence: SILENCE_MAX,
        }
    }
}

#[cfg(all(test, feature = "host"))]
impl Tolerance {
    /// Of a test that is not about lateness: however slow the machine is, nothing is too late.
    pub(crate) const AN_HOUR: Self = Self {
        start: Span::from_millis(3_600_000),
        step: Span::from_millis(3_600_000),
        report: Span::from_millis(3_600_000),
        silence: Duration::from_secs(3_600),
    };
}
