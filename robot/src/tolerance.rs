//! Maximum delays of a robot before it ends commands that are out of sync.

use std::time::Duration;

use urrcp::Span;

/// Maximum delay of a start. A robot that was delayed for longer, for example because its process was stopped, drops the command, which
/// would be out of sync.
pub(crate) const START_LATE_MAX: Span = Span::from_millis(50);
/// Maximum delay of a script's value. A later value is no longer set.
pub(crate) const STALE: Duration = Duration::from_millis(250);
/// Time within which a driver must report the start or end of a script.
pub(crate) const REPORT_WAIT: Span = Span::from_millis(750);
/// Maximum silence of the hardware while it holds a command, in addition to twice the duration of its calls.
pub(crate) const SILENCE_MAX: Duration = Duration::from_millis(150);

/// Maximum delays of a robot, of the thread that runs it, and of its hardware. Products use the defaults; a test on a slow machine may
/// use others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tolerance {
    /// Maximum delay of a start. A command that would start later is dropped.
    pub(crate) start: Span,
    /// Maximum delay of a later step or of a value. A later one is not set.
    pub(crate) step: Span,
    /// Time within which a driver that times scripts by itself must report a start or an end.
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
    /// Limits of an hour, for tests that do not depend on delays: however slow the machine is, nothing is too late.
    pub(crate) const AN_HOUR: Self = Self {
        start: Span::from_millis(3_600_000),
        step: Span::from_millis(3_600_000),
        report: Span::from_millis(3_600_000),
        silence: Duration::from_secs(3_600),
    };
}
