//! Prepares an act again if it was withdrawn before anything moved, because this machine was too slow to start it.

use downbeat_plan::OnFailure;
use urrcp::{ErrorCode, Server, Span, Timestamp};

use super::act::{Member, Progressed};
use super::failure_kind::FailureKind;
use super::record::Record;
use super::robot_state::Rest;
use super::{ActIndex, ActNumber, Mission, Outcome, Phase, RobotIndex};

/// The maximum number of times that an act is prepared again.
pub(super) const AGAIN_MAX: u32 = 2;
/// The minimum delay of this machine that the next attempt allows for. A machine that was late by less may be late by this much the next
/// time.
const HOLD_UP_MIN: Span = Span::from_millis(40);
/// If an act is overdue by more than this, or was so in the last few seconds, the mission has missed a round of questions. If leases end
/// then, this machine is the cause.
const OVERDUE: Span = Span::from_millis(5);

/// An act that is withdrawn, and that is prepared again once all robots have confirmed their stop. While another act plays, the withdrawn
/// act lapses without a stop, because a stop would end both acts.
#[derive(Debug)]
pub(super) struct Again {
    act: ActIndex,
    attempts: u32,
    /// The fixed start of the act; `None` if the start is not fixed.
    start: Option<Timestamp<Server>>,
    /// Robots that would count as failed if this machine were not suspected to be the cause. They fail if they do not confirm their stop.
    suspended: Vec<(RobotIndex, FailureKind)>,
    hold_up: Span,
}

impl Mission {
    /// Withdraws an act that this machine was too slow to start, and prepares it again if that is permitted.
    pub(super) fn withdraw_act(&mut self, now: Timestamp<Server>, number: ActNumber, outcome: Outcome) {
        if self.may_be_prepared_again(now, number) {
            self.prepare_again(now, outcome, Vec::new())
        } else {
            self.abort(now, outcome, Rest::InPlace, None)
        }
    }

    /// Handles robots of an act that seem to have failed. This machine may be the cause in two cases. Leases ended or robots were silent
    /// before the commitment, and the mission has run late. Or most robots have not accepted in time although their links are up. In both
    /// cases, the mission prepares the act again before it considers the robots failed.
    pub(super) fn fail_of_act(
        &mut self,
        now: Timestamp<Server>,
        number: ActNumber,
        failing: Vec<(RobotIndex, FailureKind)>,
    ) {
        // While the mission stops all robots, it no longer withdraws an act.
        let act = self.acts.iter().find(|act| act.number() == number);
        let act = act.filter(|_| self.phase == Phase::Performing);
        let act = act.filter(|_| self.may_be_prepared_again(now, number));
        // A round that was sent late makes leases end slightly later, when the mission is no longer overdue. Robots on the same machine
        // answer as late.
        let overdue = act.filter(|act| !act.is_committed()).map(|act| {
            let by = act.wakeup().map_or(Span::ZERO, |due| now - due);
            by.max(self.machine.lateness.largest())
        });
        let is_slowness = |(robot, kind): &(RobotIndex, FailureKind)| match kind {
            FailureKind::Silent { .. } => {
                self.policy_of(*robot).is_none_or(|(what, _)| what != OnFailure::Without)
            }
            kind => is_lease(kind),
        };
        if let Some(by) = overdue.filter(|by| *by > OVERDUE && failing.iter().all(is_slowness)) {
            let decided = act.is_some_and(|act| act.progress() > Progressed::Preparing);
            let outcome = if decided { Outcome::CommitmentLate { by } } else { Outcome::DecisionLate { by } };
            return self.prepare_again(now, outcome, failing);
        }
        let suspect = act.filter(|_| self.acts.len() == 1).is_some_and(|act| {
            let silent = failing.iter().all(|(_, kind)| matches!(kind, FailureKind::Silent { .. }));
            let all = act.present().count();
            let most = failing.len() >= 2 && failing.len() * 2 > all;
            let again = act.attempts() == 0 || failing.len() == all;
            silent && most && again && act.progress() == Progressed::Preparing
        });
        if suspect {
            self.prepare_again(now, Outcome::DecisionLate { by: Span::ZERO }, failing)
        } else {
            self.fail_all(now, failing)
        }
    }

    /// Whether an act may be prepared again: it has attempts left, and no fixed start prevents a later one. While another act plays, all
    /// robots of this act must also drop it by themselves.
    pub(super) fn may_be_prepared_again(&self, now: Timestamp<Server>, number: ActNumber) -> bool {
        let drops = |member: &Member| self.robots[member.robot].drops_undecided();
        let (act, drops) = match self.acts.as_slice() {
            [act] => (act, true),
            [_, act] => (act, !act.is_committed() && act.present().all(drops)),
            _ => return false,
        };
        let within = self.options.fixed.within;
        let in_time = |start| within > Span::ZERO && now < start + within;
        let may_be_late = act.fixed_start(&self.options).is_none_or(in_time);
        act.number() == number && drops && act.attempts() < AGAIN_MAX && may_be_late
    }

    fn prepare_again(
        &mut self,
        now: Timestamp<Server>,
        outcome: Outcome,
        suspended: Vec<(RobotIndex, FailureKind)>,
    ) {
        if let [_, act] = self.acts.as_mut_slice() {
            act.is_not_started(outcome);
            let number = act.number();
            // Robots that play the previous act may have received nothing for some time.
            self.timers.next_round = Some(now);
            return self.record(Record::Lapsing { number });
        }
        let Some(act) = self.acts.first() else { return };
        let (name, index) = (act.name(), act.index());
        let late = match &outcome {
            Outcome::DecisionLate { by } | Outcome::CommitmentLate { by } => *by,
            _ => Span::ZERO,
        };
        let hold_up = (late * 2).max(HOLD_UP_MIN).max(self.machine.hold_up * 2);
        let reason = match suspended.as_slice() {
            [(_, FailureKind::Silent { .. }), ..] if act.progress() == Progressed::Preparing => {
                let (count, all) = (suspended.len(), act.present().count());
                format!("{count} of {all} robots did not accept their scripts in time")
            }
            _ => outcome.hold_up().unwrap_or_else(|| outcome.to_string()),
        };
        let reason = format!("{reason}; `{name}` is prepared again");
        let (attempts, start) = (act.attempts() + 1, act.fixed_start(&self.options));
        self.again = Some(Again { act: index, attempts, start, suspended, hold_up });
        self.abort_because(now, outcome, reason, Rest::InPlace, Some(index));
    }

    /// Handles the end of the stop of a withdrawn act. Returns whether the act is prepared again; if not, the mission ends.
    pub(super) fn goes_again(&mut self, now: Timestamp<Server>, confirmed: bool) -> bool {
        let Some(again) = self.again.take() else { return false };
        let moved = self.acts.iter().any(|act| self.may_have_begun(now, act));
        if self.course.then == Some(again.act) && confirmed && !moved {
            self.machine.hold_up = again.hold_up;
            self.again = Some(again);
            return true;
        }
        self.course.then = None;
        // Robots that confirm nothing are the cause, not this machine.
        let failed =
            again.suspended.into_iter().filter(|(robot, _)| moved || self.robots[*robot].awaits_stop());
        let failed: Vec<_> = failed.collect();
        if !failed.is_empty() && self.conclusion.outcome != Some(Outcome::Stopped) {
            self.conclusion.because = None;
            let moved = moved || self.has_moved();
            self.conclusion.outcome = Some(if moved { Outcome::Failed } else { Outcome::NotStarted });
        }
        failed.into_iter().for_each(|(robot, kind)| self.note_failure(robot, kind));
        false
    }

    /// Discards the withdrawn attempt, and queues the act again. The act does not wait for its condition, which has already been met.
    pub(super) fn line_up_again(&mut self, now: Timestamp<Server>) {
        let Some(Again { act, attempts, start, .. }) = self.again.take() else { return };
        while !self.acts.is_empty() {
            self.forget_act(now, 0);
        }
        self.conclusion.outcome = None;
        self.conclusion.because = None;
        self.course.repeated += 1;
        self.line_up_attempt(now, act, attempts, start);
        self.goes_on(now);
    }
}

/// Whether the failure is a pending lease that has ended.
fn is_lease(kind: &FailureKind) -> bool {
    matches!(kind, FailureKind::Script { error, .. } if error.code == ErrorCode::LinkLost)
}
