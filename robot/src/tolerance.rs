//! How late a robot may be before it ends commands that are out of sync.

use std::time::Duration;

use urrcp::Span;

/// A robot that was delayed longer than this over a start, for example by a stopped process, drops the command, which would be out of
/// sync.
pub(crate) const START_LATE_MAX: Span = Span::from_millis(50);
/// A value of a script that is later than this is no longer set.
pub(crate) const STALE: Duration = Duration::from_millis(250);
/// The driver reports a start or an end within this time.
pub(crate) const REPORT_WAIT: Span = Span::from_millis(750);
/// Maximum silence of the hardware while it holds something, in addition to twice the duration of its calls.
pub(crate) const SILENCE_MAX: Duration = Duration::from_millis(150);

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
    /// For tests that do not depend on lateness: however slow the machine is, nothing is too late.
    pub(crate) const AN_HOUR: Self = Self {
        start: Span::from_millis(3_600_000),
        step: Span::from_millis(3_600_000),
        report: Span::from_millis(3_600_000),
        silence: Duration::from_secs(3_600),
    };
}
