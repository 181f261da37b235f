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

#[cfg(test)]
mod tests {
    use super::*;

    const GRAIN: Span = Span::from_nanos(1);

    fn at(after: Span) -> Timestamp<Robot> {
        Timestamp::from_nanos(0) + after
    }

    /// What is said of a single value that is to be set so much later, under these limits.
    fn says(ahead: Span, ends: Span, limits: [Option<Span>; 2], is_first: bool) -> Option<String> {
        let [pending, running] = limits.map(|limit| limit.map(Millis::from_span));
        let steps = Steps::One(urrcp::Setpoint::new(urrcp::ControlType::Position, 1.0));
        let stop_condition = Some(StopCondition { pending, running });
        let reach = Reach { start: at(ahead), end: at(ends), stop_condition, steps: &steps, is_first };
        reach.check(at(Span::ZERO)).err().map(|error| error.message.to_string())
    }

    #[track_caller]
    fn check(told: Option<String>, expected: Option<&str>) {
        let fits =
            expected.map_or(told.is_none(), |part| told.as_ref().is_some_and(|told| told.contains(part)));
        assert!(fits, "{told:?}, expected {expected:?}");
    }

    #[test]
    fn limits_are_as_long_as_silence_may_be_and_no_longer() {
        for limit in [[Some(SILENCE_MAX), None], [None, Some(SILENCE_MAX)]] {
            check(says(GRAIN, GRAIN, limit, true), None);
        }
        let beyond = Some(SILENCE_MAX + Span::from_millis(1));
        for limit in [[beyond, Some(GRAIN)], [Some(GRAIN), beyond]] {
            check(says(GRAIN, GRAIN, limit, true), Some("a limit of its stop_condition"));
        }
    }

    #[test]
    fn a_start_far_ahead_needs_a_pending_limit_unless_it_follows_something() {
        let lease = [Some(Span::from_millis(300)), None];
        let without = START_WITHOUT_LEASE_MAX;
        check(says(without, without, [None; 2], true), None);
        check(says(without + GRAIN, without + GRAIN, [None; 2], true), Some("needs a `pending`"));
        check(says(without + GRAIN, without + GRAIN, [None; 2], false), None);
        check(says(without + GRAIN, without + GRAIN, lease, true), None);
        check(says(REACH_MAX, REACH_MAX, lease, true), None);
        check(says(REACH_MAX + GRAIN, REACH_MAX + GRAIN, lease, true), Some("the start lies"));
    }

    #[test]
    fn an_end_far_ahead_needs_a_running_limit() {
        check(says(GRAIN, REACH_MAX, [None; 2], true), None);
        check(says(GRAIN, REACH_MAX + GRAIN, [None; 2], true), Some("needs a `running`"));
        check(says(GRAIN, REACH_MAX + GRAIN, [None, Some(Span::from_millis(300))], true), None);
    }
}
