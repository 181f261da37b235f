//! How far a command may reach into the future: one line must not occupy a robot for years.

use urrcp::{ControlError, ErrorCode, Millis, Robot, Span, StopCondition, Timestamp};

use crate::held::Steps;

/// A command starts no later than this from its receipt. Without a `running` limit it also ends within it.
pub(crate) const REACH_MAX: Span = Span::from_millis(24 * 3_600_000);
/// No limit of a `stop_condition` is longer: it would be none.
pub(crate) const SILENCE_MAX: Span = REACH_MAX;
/// The first command of a device that starts later than this from its receipt needs a `pending` limit.
pub(crate) const START_WITHOUT_LEASE_MAX: Span = Span::from_millis(3_600_000);

/// What reaches into the future.
pub(crate) struct Reach<'a> {
    pub(crate) start: Timestamp<Robot>,
    pub(crate) end: Timestamp<Robot>,
    pub(crate) stop_condition: Option<StopCondition>,
    pub(crate) steps: &'a Steps,
    /// Whether the device holds nothing else, on which it would depend.
    pub(crate) is_first: bool,
}

impl Reach<'_> {
    /// Whether it stays within bounds, for a command that comes now.
    ///
    /// # Errors
    /// `out_of_range`, with what is too far and how far it may be.
    pub(crate) fn check(&self, now: Timestamp<Robot>) -> Result<(), ControlError> {
        let silence = self.limits().map(Millis::span).max().filter(|silence| *silence > SILENCE_MAX);
        let (ahead, until_end) = (self.start - now, self.end - now);
        let lease = self.stop_condition.unwrap_or_default();
        let message = if let Some(silence) = silence {
            format!("a limit of its stop_condition is {silence}, expected at most {SILENCE_MAX}")
        } else if ahead > REACH_MAX {
            format!("the start lies {ahead} ahead, expected at most {REACH_MAX}")
        } else if ahead > START_WITHOUT_LEASE_MAX && self.is_first && lease.pending.is_none() {
            format!(
                "the start lies {ahead} ahead; more than {START_WITHOUT_LEASE_MAX} needs a `pending` stop_condition"
            )
        } else if until_end > REACH_MAX && lease.running.is_none() {
            format!("the end lies {until_end} ahead; more than {REACH_MAX} needs a `running` stop_condition")
        } else {
            return Ok(());
        };
        Err(ControlError::new(ErrorCode::OutOfRange, message))
    }

    /// All limits that ever apply to it.
    fn limits(&self) -> impl Iterator<Item = Millis> + '_ {
        let of_steps = match self.steps {
            Steps::One(_) => &[][..],
            Steps::Script(script) => script.steps(),
        };
        let conditions = of_steps.iter().filter_map(|step| step.stop_condition).chain(self.stop_condition);
        conditions.flat_map(|lease| [lease.pending, lease.running]).flatten()
    }
}
