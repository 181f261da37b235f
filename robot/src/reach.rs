//! Limits how far commands may reach into the future, so that one message cannot occupy a robot for years.

use urrcp::{ControlError, ErrorCode, Millis, Robot, Span, StopCondition, Timestamp};

use crate::held::Steps;

/// Maximum time from the receipt of a command to its start. It also limits the end of a command without a `running` limit.
pub(crate) const REACH_MAX: Span = Span::from_millis(24 * 3_600_000);
/// Maximum value of a limit in a `stop_condition`. A higher value would have no effect.
pub(crate) const SILENCE_MAX: Span = REACH_MAX;
/// Maximum time from receipt to start of the first command of a device, if this command has no `pending` limit.
pub(crate) const START_WITHOUT_LEASE_MAX: Span = Span::from_millis(3_600_000);

/// A command, to check how far it reaches into the future.
pub(crate) struct Reach<'a> {
    pub(crate) start: Timestamp<Robot>,
    pub(crate) end: Timestamp<Robot>,
    pub(crate) stop_condition: Option<StopCondition>,
    pub(crate) steps: &'a Steps,
    /// Whether this command depends on no other command that the device holds.
    pub(crate) is_first: bool,
}

impl Reach<'_> {
    /// Checks how far a command that is received at `now` reaches into the future.
    ///
    /// # Errors
    /// `out_of_range`, with the excessive value and its limit.
    pub(crate) fn check(&self, now: Timestamp<Robot>) -> Result<(), ControlError> {
        let silence = self.limits().map(Millis::span).max().filter(|silence| *silence > SILENCE_MAX);
        let (ahead, until_end) = (self.start - now, self.end - now);
        let lease = self.stop_condition.unwrap_or_default();
        let message = if let Some(silence) = silence {
            format!("the stop_condition allows {silence} of silence, expected at most {SILENCE_MAX}")
        } else if ahead > REACH_MAX {
            format!("the start is {ahead} in the future, expected at most {REACH_MAX}")
        } else if ahead > START_WITHOUT_LEASE_MAX && self.is_first && lease.pending.is_none() {
            format!(
                "the start is {ahead} in the future; more than {START_WITHOUT_LEASE_MAX} requires a `pending` stop_condition"
            )
        } else if until_end > REACH_MAX && lease.running.is_none() {
            format!(
                "the end is {until_end} in the future; more than {REACH_MAX} requires a `running` stop_condition"
            )
        } else {
            return Ok(());
        };
        Err(ControlError::new(ErrorCode::OutOfRange, message))
    }

    /// Returns all silence limits of the command and its steps.
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

    /// Returns the error, if any, for a single value that starts `ahead` from now and ends `ends` from now. `limits` are the `pending`
    /// and the `running` limit.
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
    fn stop_condition_limits_are_at_most_the_maximum_silence() {
        for limit in [[Some(SILENCE_MAX), None], [None, Some(SILENCE_MAX)]] {
            check(says(GRAIN, GRAIN, limit, true), None);
        }
        let beyond = Some(SILENCE_MAX + Span::from_millis(1));
        for limit in [[beyond, Some(GRAIN)], [Some(GRAIN), beyond]] {
            check(says(GRAIN, GRAIN, limit, true), Some("the stop_condition allows"));
        }
    }

    #[test]
    fn distant_start_requires_a_pending_limit_unless_it_follows_a_command() {
        let lease = [Some(Span::from_millis(300)), None];
        let without = START_WITHOUT_LEASE_MAX;
        check(says(without, without, [None; 2], true), None);
        check(
            says(without + GRAIN, without + GRAIN, [None; 2], true),
            Some("requires a `pending` stop_condition"),
        );
        check(says(without + GRAIN, without + GRAIN, [None; 2], false), None);
        check(says(without + GRAIN, without + GRAIN, lease, true), None);
        check(says(REACH_MAX, REACH_MAX, lease, true), None);
        check(says(REACH_MAX + GRAIN, REACH_MAX + GRAIN, lease, true), Some("the start is"));
    }

    #[test]
    fn distant_end_requires_a_running_limit() {
        check(says(GRAIN, REACH_MAX, [None; 2], true), None);
        check(says(GRAIN, REACH_MAX + GRAIN, [None; 2], true), Some("requires a `running` stop_condition"));
        check(says(GRAIN, REACH_MAX + GRAIN, [None, Some(Span::from_millis(300))], true), None);
    }
}
