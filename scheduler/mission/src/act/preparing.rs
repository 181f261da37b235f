//! Prepares an act: sends all its requests with one timestamp, and then makes one decision. If all robots have accepted, the act starts;
//! otherwise, no robot starts.

use urrcp::{Command, ControlRequest, Millis, RequestId, Server, SessionId, Span, StopCondition, Timestamp};

use super::approaching::Approach;
use super::member::present;
use super::{Act, ActAction, Member, Members, Promised, PromisedStage, Stage, Timing};
use crate::failure_kind::FailureKind;
use crate::record::{Promise, PromisedScript, Record};
use crate::robot_state::{RobotState, Robots};
use crate::script::{Script, ScriptRef};
use crate::skew::SkewBudget;
use crate::{ActNumber, Outcome, Progress, RobotIndex};

/// If a decision is overdue by more than this, the cause is a delay of this machine.
pub(super) const HELD_UP: Span = Span::from_millis(20);

/// Whether robots that have not answered were asked again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    Once,
    Again,
}

/// The state of an act whose requests have been sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Preparing {
    asked: Asked,
    /// Number of leading members that have accepted all their scripts.
    accepted: usize,
}

impl Preparing {
    pub(super) fn wakeup(self, timing: &Timing) -> Timestamp<Server> {
        match self.asked {
            Asked::Once => timing.ask_again(),
            Asked::Again => timing.decision,
        }
    }
}

impl Act {
    /// Returns the intended start of a ready act: the end of the previous act, or the time that the act waits for.
    pub(crate) const fn target(&self) -> Option<Timestamp<Server>> {
        match self.stage {
            Stage::Ready { target, .. } => target,
            _ => None,
        }
    }

    /// Whether it is time to check if the act can be sent.
    pub(crate) fn is_looked_at(&self, now: Timestamp<Server>) -> bool {
        matches!(&self.stage, Stage::Ready { look, .. } if look.is_none_or(|at| now >= at))
    }

    /// Sets the time of the next check whether the act can be sent. A change of circumstances also causes such a check.
    pub(crate) fn look_again_at(&mut self, at: Option<Timestamp<Server>>) {
        if let Stage::Ready { look, .. } = &mut self.stage {
            *look = at;
        }
    }

    /// Marks the act as deserted if all its robots have been left out.
    pub(super) fn leave_if_deserted(&mut self) -> Vec<ActAction> {
        if self.present().next().is_none() {
            self.stage = Stage::Deserted;
        }
        Vec::new()
    }

    /// Promises the act to its robots, with the instants in `timing`. `shift_of` returns the offset that converts the act's timestamp to
    /// a robot's clock. Returns the ids of the requests, which are unique even after a crash of this machine, and the actions to perform.
    pub(crate) fn promise(
        &mut self,
        timing: Timing,
        robots: &Robots,
        session: Option<&SessionId>,
        shift_of: impl Fn(&RobotState) -> Span,
    ) -> (Vec<(RobotIndex, RequestId, ScriptRef)>, Vec<ActAction>) {
        let session = session.map(|session| format!("{session}/")).unwrap_or_default();
        let micros = timing.timestamp.as_nanos() / 1_000;
        let mut names = Vec::new();
        for m in self.members.indices() {
            let member = &mut self.members[m];
            member.shift = shift_of(&robots[member.robot]);
            member.clock_steps = Some(robots[member.robot].clock.steps());
            for s in 0..member.scripts().len() {
                // This program generates session names, far below the limit.
                let id =
                    RequestId::new(format!("{session}{micros}/{}/{}/{s}", self.number, member.robot)).ok();
                let reference = ScriptRef { act: self.number, member: m, script: s };
                names.extend(id.clone().map(|id| (member.robot, id, reference)));
                member.name(s, id);
            }
        }
        let tell = Progress::Preparing {
            act: self.name(),
            timestamp: timing.timestamp,
            start: timing.start,
            lead: timing.lead,
            skew: timing.skew.clone(),
            slowest: timing.slowest.clone().map(|(robot, _)| robot),
        };
        let promise = self.promised(&timing, robots);
        self.stage = Stage::Promised(Promised { timing, stage: PromisedStage::Recording });
        (names, vec![ActAction::Record(Record::Prepared(promise)), ActAction::Tell(tell)])
    }

    fn promised(&self, timing: &Timing, robots: &Robots) -> Promise {
        let script = |member: &Member, script: &Script| {
            Some(PromisedScript {
                robot: robots[member.robot].id.clone(),
                device: script.plan.device.clone(),
                request_id: script.request_id()?.clone(),
                content_hash: script.content_hash(),
                shift: member.shift,
                start: script.plan.start,
                duration: script.plan.script.duration(),
                running: script.plan.stop_condition.running,
            })
        };
        let of_member =
            |member: &Member| member.scripts().iter().filter_map(|s| script(member, s)).collect::<Vec<_>>();
        Promise {
            number: self.number,
            act: self.index,
            timestamp: timing.timestamp,
            start: timing.start,
            lease: timing.lead.lease,
            prepared_again: self.attempts,
            scripts: self.present().flat_map(of_member).collect(),
        }
    }

    /// Sends the requests, because the promise is on disk.
    pub(super) fn open(&mut self) -> Vec<ActAction> {
        self.enter(PromisedStage::Preparing(Preparing { asked: Asked::Once, accepted: 0 }));
        vec![ActAction::Refill(self.present().map(|member| member.robot).collect())]
    }

    /// Notes that a script's request is sent.
    pub(crate) fn sent(&mut self, now: Timestamp<Server>, script: ScriptRef) {
        self.members[script.member].change(script.script, |script| script.sent(now));
    }

    /// Decides whether the act starts, as soon as all robots have accepted or when the decision is due. It starts only if every robot has
    /// accepted all its scripts; otherwise, none starts.
    pub(super) fn decide_if_due(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let Stage::Promised(Promised { timing, stage: PromisedStage::Preparing(preparing) }) =
            &mut self.stage
        else {
            return Vec::new();
        };
        let (timing, members) = (&*timing, &self.members);
        // Each event checks from the first member that has not accepted.
        let accepted = |member: &&Member| !member.takes_part() || member.has_accepted(timing);
        preparing.accepted += members.iter().skip(preparing.accepted).take_while(accepted).count();
        let all = preparing.accepted == members.len();
        if !all && now < timing.decision {
            if preparing.asked == Asked::Again || now < timing.ask_again() {
                return Vec::new();
            }
            preparing.asked = Asked::Again;
            return unanswered(self.number, timing, members, robots);
        }
        if present(members).next().is_none() {
            self.enter(PromisedStage::Deserted);
            return Vec::new();
        }
        // A late decision would leave too little time for the leases to end before the start.
        let too_late = now > timing.brink() - timing.lead.lease;
        if !all {
            // If this process stalled, it may not have read acceptances that have arrived. Only a robot whose link is down is blamed.
            let held_up = now > timing.decision + HELD_UP;
            let blamed = |member: &&Member| {
                let had_time = !held_up && has_had_time(now, member, timing);
                had_time || robots[member.robot].broken().is_some()
            };
            let slow: Vec<&Member> =
                present(members).filter(|member| !member.has_accepted(timing)).filter(blamed).collect();
            if slow.is_empty() {
                return vec![ActAction::Withdraw(Outcome::DecisionLate { by: now - timing.decision })];
            }
            let failure = |member: &Member| (member.robot, unaccepted(&robots[member.robot], member, timing));
            return vec![ActAction::Fail(slow.into_iter().map(failure).collect())];
        }
        if too_late {
            return vec![ActAction::Withdraw(Outcome::DecisionLate { by: now - timing.decision })];
        }
        self.decide(now, robots)
    }

    fn decide(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let shown = SkewBudget::of_sent(self.present(), robots, self.written().plan.start_tolerance, now);
        let early = shown.map(|shown| self.allow_for_shown(now, &shown, robots)).unwrap_or_default();
        if !early.is_empty() {
            return vec![ActAction::Fail(early)];
        }
        let Some(timing) = self.stage.timing_mut() else { return Vec::new() };
        timing.accepted_at = Some(now);
        let (start, doubt) = (timing.start, timing.doubt());
        tracing::info!(%start, "decided");
        self.enter(PromisedStage::Approaching(Approach::beginning(now)));
        let unnamed = self.present().map(|member| &robots[member.robot]);
        let unnamed = unnamed.filter(|robot| !robot.takes_inquiries()).map(|robot| robot.id.clone());
        let record = Record::Decided { number: self.number, unnamed: unnamed.collect(), doubt };
        let tell = self.decided().map(ActAction::Tell);
        std::iter::once(ActAction::Record(record)).chain(tell).collect()
    }

    /// Returns the progress that is reported at the decision. A process that takes over the act before its commitment also reports it.
    pub(crate) fn decided(&self) -> Option<Progress> {
        let timing = self.timing()?;
        let (start, no_return, doubt) = (timing.start, timing.no_return(), timing.doubt());
        let (duration, leases_end) = (self.written().plan.duration(), timing.brink());
        Some(Progress::Decided { act: self.name(), start, duration, leases_end, no_return, doubt })
    }
}

/// Withdraws the act if the disk is so slow that the promise is not stored by the time of the decision.
pub(super) fn await_promise(now: Timestamp<Server>, timing: &Timing) -> Vec<ActAction> {
    if now < timing.decision {
        return Vec::new();
    }
    vec![ActAction::Withdraw(Outcome::DecisionLate { by: now - timing.decision })]
}

/// Whether a robot has had at least half of the preparation time to accept its scripts. If the disk stored the promise late, it has had
/// less.
fn has_had_time(now: Timestamp<Server>, member: &Member, timing: &Timing) -> bool {
    let mut awaited = member.unaccepted(timing).filter_map(|(_, script)| script.first_sent_at());
    awaited.any(|sent| (now - sent) * 2 >= timing.lead.prepare)
}

/// Returns the unanswered requests, to be sent again in case they were lost.
fn unanswered(act: ActNumber, timing: &Timing, members: &Members, robots: &Robots) -> Vec<ActAction> {
    let waits =
        |member: &Member| member.takes_part() && !member.has_accepted(timing) && robots[member.robot].is_up();
    let waiting = members.enumerated().filter(|(_, member)| waits(member));
    let open = waiting.flat_map(|(m, member)| member.unaccepted(timing).map(move |(s, _)| (m, s)));
    open.map(|(member, script)| ActAction::Send(ScriptRef { act, member, script })).collect()
}

fn unaccepted(robot: &RobotState, member: &Member, timing: &Timing) -> FailureKind {
    match robot.broken() {
        Some(reason) => FailureKind::LinkDown { reason: reason.to_owned() },
        None => {
            FailureKind::Silent { awaited: awaited_acceptance(member, timing), within: timing.lead.prepare }
        }
    }
}

fn awaited_acceptance(member: &Member, timing: &Timing) -> String {
    let open: Vec<_> =
        member.unaccepted(timing).map(|(_, script)| format!("`{}`", script.plan.device)).collect();
    match open.len() {
        0..=4 => format!("acceptance by {}", open.join(", ")),
        n => format!("acceptance by {} and {} more devices", open[..3].join(", "), n - 3),
    }
}

pub(super) fn request(
    timing: &Timing,
    member: &Member,
    index: usize,
    session: Option<&SessionId>,
) -> ControlRequest {
    let script = &member.scripts()[index];
    let offset = timing.start - timing.timestamp + script.plan.start.span();
    ControlRequest {
        timestamp: Some(timing.timestamp + member.shift_of(script)),
        time_offset_to_start: Some(Millis::from_span(offset)),
        device_id: script.plan.device.clone(),
        stop_condition: Some(StopCondition {
            pending: member.pending_lease(index, timing.lead.lease).map(Millis::from_span),
            running: script.plan.stop_condition.running,
        }),
        pending_until: None,
        request_id: script.request_id().cloned(),
        content_hash: Some(script.content_hash()),
        session: session.cloned(),
        home: false,
        command: Command::Script(script.plan.script.clone()),
    }
}
