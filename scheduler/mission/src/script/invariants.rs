//! Invariants of a script between two events.

use urrcp::RobotId;

use super::{Ending, Script, ScriptState};
use crate::invariants::holds;

impl Script {
    /// Whether only this process can have sent the script.
    pub(crate) const fn is_of_this_process(&self) -> bool {
        !self.perhaps_sent
    }

    /// Panics if an invariant of the script does not hold.
    pub(crate) fn check(&self, robot: &RobotId) {
        let device = &self.plan.device;
        let of = format_args!("{robot}/{device}: {self:?}");
        match &self.state {
            ScriptState::Planned => {
                assert!(
                    !self.has_begun() || self.perhaps_sent,
                    "a script must not start before it was sent: {of}"
                );
            }
            ScriptState::Sent => {
                assert!(self.sent.is_some(), "a request that is on its way was sent: {of}")
            }
            ScriptState::Held => {
                assert!(self.was_accepted(), "a robot holds only what it has accepted: {of}");
                assert!(self.was_ever_sent(), "a robot holds only what it was sent: {of}");
            }
            ScriptState::Running => {
                assert!(self.was_accepted(), "a script that runs was accepted: {of}");
                assert!(self.was_ever_sent(), "a script that runs was sent: {of}");
            }
            ScriptState::Ended(Ending::Discredited(_)) => {
                holds!(
                    self.started_at().is_none(),
                    of,
                    "Nothing that the robot reports about that script counts after that"
                );
            }
            ScriptState::Ended(Ending::Completed | Ending::Failed(_)) | ScriptState::Unknown => {}
        }
        self.check_times(robot);
        self.check_word(robot);
    }

    fn check_times(&self, robot: &RobotId) {
        let of = format_args!("{robot}/{}: {self:?}", self.plan.device);
        assert!(
            self.sent.is_none_or(|sent| sent.first <= sent.last),
            "a script is sent first before it is sent again: {of}"
        );
        assert!(self.starts >= self.plan.start.span(), "a script starts no earlier than it begins: {of}");
        assert!(
            self.running.shortest <= self.running.longest || self.running.longest.is_none(),
            "the shortest lease is not longer than the longest: {of}"
        );
    }

    /// Checks what the robot reported about the script.
    fn check_word(&self, robot: &RobotId) {
        let of = format_args!("{robot}/{}: {self:?}", self.plan.device);
        assert!(
            self.steps.done <= self.steps_planned() || self.is_discredited(),
            "at most the planned steps are done: {of}"
        );
        assert!(
            self.steps.late <= self.steps.done || self.is_discredited(),
            "only steps that were done were late: {of}"
        );
        if self.held_at.is_some() {
            assert!(self.was_accepted(), "a robot that holds a script has accepted it: {of}");
            assert!(self.reported_at >= self.held_at, "`held` is a report: {of}");
        }
        if self.lost {
            let known = matches!(self.state, ScriptState::Unknown | ScriptState::Ended(_));
            assert!(known, "a script that its robot has lost does not run: {of}");
        }
        if self.request_id.is_some() {
            assert!(self.promised_id.is_some(), "the journal knows every request: {of}");
        }
        if self.refusals == 0 {
            assert_eq!(self.request_id, self.promised_id, "only a refused request gets another name: {of}");
        }
    }
}
