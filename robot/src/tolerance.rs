//! Maximum delays that a robot tolerates before it ends commands that are out of sync.

use std::time::Duration;

use urrcp::Span;

/// Maximum delay of a start. If a robot was delayed for longer, for example because its process was stopped, it drops the command, which
/// would be out of sync.
pub(crate) const START_LATE_MAX: Span = Span::from_millis(50);
/// Maximum delay of a value of a script. A value that is later is not set.
pub(crate) const STALE: Duration = Duration::from_millis(250);
/// Time within which a driver must report the start or the end of a script after it was due.
pub(crate) const REPORT_WAIT: Span = Span::from_millis(750);
/// Maximum silence of hardware that holds a command, in addition to twice the duration of a call of its driver.
pub(crate) const SILENCE_MAX: Duration = Duration::from_millis(150);

/// Maximum delays of a robot, of the thread that runs it, and of its hardware. Released programs use the defaults; a test on a slow
/// machine may use others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tolerance {
    /// Maximum delay of a start. A command that would start later is dropped.
    pub(crate) start: Span,
    /// Maximum delay of a value, or of a step that is not the first. A value that is later is not set.
    pub(crate) step: Span,
    /// Time within which a driver that times scripts by itself must report a start or an end after it was due.
    pub(crate) report: Span,
    /// Maximum silence of the hardware near a start. Hardware that is silent for longer is not ready.
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
    /// Limits of one hour, for tests that do not depend on delays. With them, nothing counts as late, however slow the machine is.
    pub(crate) const AN_HOUR: Self = Self {
        start: Span::from_millis(3_600_000),
        step: Span::from_millis(3_600_000),
        report: Span::from_millis(3_600_000),
        silence: Duration::from_secs(3_600),
    };
}
