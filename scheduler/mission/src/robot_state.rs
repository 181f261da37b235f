//! The mission's state of one robot: its link, its clock, its questions, and its stop.

mod invariants;

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use urrcp::{
    ControlError, ControlResponse, DeviceId, ErrorCode, InitializationBlock, Message, RequestId, Robot,
    RobotId, Server, Span, Status, Timestamp,
};

use super::exchanges::Exchanges;
use super::failure_kind::FailureKind;
use super::failures::Failures;
use super::greet::Greeted;
use super::identity::Identity;
use super::open_requests::OpenRequests;
use super::poses::Pose;
use super::requests::may_be_for_a_stop;
use super::script::{Script, ScriptRef};
use super::seize::Ownership;
use super::stop::Halt;
use super::{ActNumber, ClockMode, IndexVec, Loss, MissionSettings, Participant, RobotIndex};
use crate::clock::{ClockEstimate, ClockReading};

/// The state of a robot's link.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Link {
    /// The first connection is being made.
    Connecting,
    /// The link is connected, but the robot has not identified itself yet. Only the question for its identity, and stops, are sent.
    /// `unheard` is the previous loss of the link, as in [`Link::Up`].
    Unnamed { since: Timestamp<Server>, unheard: Option<Lost> },
    /// The link is connected to the right robot. `unheard` is the previous loss of the link, until a message arrives on the new link. A
    /// link that is repeatedly accepted and closed is therefore treated as lost.
    Up { unheard: Option<Lost> },
    /// The link broke, or could not be made.
    Lost(Lost),
}

/// A link that is down.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lost {
    pub(crate) reason: String,
    pub(crate) loss: Loss,
    /// The time of the first break since the last message from the robot.
    pub(crate) since: Timestamp<Server>,
    /// The time at which the link broke, or the last attempt to connect failed.
    pub(crate) failed: Timestamp<Server>,
    /// Whether a new connection is being made.
    pub(crate) connecting: bool,
    /// The time at which the mission gives up the robot; `None` if that is not scheduled.
    pub(crate) give_up: Option<Timestamp<Server>>,
}

/// Whether a robot takes part in the mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Standing {
    /// The robot takes part.
    In,
    /// The robot was not available when the mission began. It may join at the next act.
    Absent,
    /// The robot failed, and the other robots continued or were stopped.
    Out,
}

/// State of a robot's stop.
#[derive(Clone, Debug, Default)]
pub(crate) enum Stop {
    /// No stop was sent.
    #[default]
    None,
    /// A stop was sent, and some devices have not confirmed it.
    Sent(SentStop),
    /// Every device to which anything was sent is known to be at rest.
    Confirmed(Rest),
}

/// A stop that was sent.
#[derive(Clone, Debug)]
pub(crate) struct SentStop {
    pub(crate) at: Timestamp<Server>,
    pub(crate) rest: Rest,
    /// The error with which the robot refused the stop, if it belongs to another session. Such a robot no longer holds anything of this
    /// session.
    pub(crate) taken_over: Option<ControlError>,
    /// Whether the stop is no longer repeated, because the robot now belongs to another session and the operator did not request the
    /// stop.
    pub(crate) given_up: bool,
}

/// How a stopped device comes to rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rest {
    /// In place: the device slows down, and nothing begins to move.
    #[default]
    InPlace,
    /// In its default state, to which the device moves.
    Home,
}

/// Purpose of a reading.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Reading {
    /// A requirement of the fleet file, by its index.
    Requirement(usize),
    /// The position of a device before the first act.
    Position(DeviceId),
    /// A reading that is only displayed before a mission.
    Shown(DeviceId),
    /// An act waits for the reading. Contains the number of the act.
    Wait(ActNumber),
    /// The scenario requests the reading. Contains the number of the act, and the index of the reading.
    Planned(ActNumber, usize),
    /// The reading detects when a device begins to move. Contains the number of the act, and the index among the act's watched devices.
    Motion(ActNumber, usize),
}

/// A robot's totals over all acts that have ended.
#[derive(Clone, Copy, Debug, Default)]
pub struct Totals {
    /// Number of planned scripts.
    pub scripts: usize,
    /// Number of scripts that were sent.
    pub sent: usize,
    /// Number of accepted scripts, including those that have begun without an acceptance.
    pub accepted: usize,
    /// Number of scripts that were refused or ended early.
    pub failed: usize,
    /// Number of scripts that have started.
    pub started: usize,
    /// Number of executed steps.
    pub steps_done: u64,
    /// Number of planned steps.
    pub steps_planned: u64,
    /// Number of steps that were executed late.
    pub late_steps: u64,
    /// The largest lateness of a step.
    pub late_max: Option<Span>,
    /// The start error with the largest absolute value.
    pub start_error: Option<Span>,
    /// Number of scripts that were sent and whose fate is unknown.
    pub unaccounted: usize,
    /// Number of requests that were sent again.
    pub retries: u32,
    /// Number of times that the link to the robot was re-established.
    pub reconnects: u32,
}

impl Totals {
    pub(crate) fn add(&mut self, script: &Script, error: Option<Span>) {
        self.scripts += 1;
        self.sent += usize::from(!script.is_planned());
        // A script that has begun was accepted, even if the acceptance was lost.
        self.accepted += usize::from(script.was_accepted() || script.has_begun());
        self.failed += usize::from(script.has_failed());
        self.started += usize::from(script.has_started());
        self.steps_done += u64::from(script.steps_done());
        self.steps_planned += script.plan.script.steps().len() as u64;
        self.late_steps += u64::from(script.late_steps());
        self.late_max = self.late_max.max(script.late_max());
        self.start_error = self.start_error.into_iter().chain(error).max_by_key(|e| e.abs());
        self.unaccounted += usize::from(script.is_unaccounted());
    }
}

/// The questions that ask for the times of a robot's clock, and whether the robot has answered them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Questions {
    /// The sending times of the unanswered questions, oldest first.
    open: VecDeque<Timestamp<Server>>,
    /// The sending time of the newest answered question.
    answered: Option<Timestamp<Server>>,
    /// Whether a question is unanswered that was asked before the newest answered question, but after the one answered before that.
    passed_over: bool,
    /// The sending time of the newest question whose answer is no longer expected. The robot may nevertheless have received that
    /// question.
    forgiven: Option<Timestamp<Server>>,
}

/// The maximum number of unanswered questions that are remembered. More are unanswered only on a link that carries nothing.
const OPEN_MAX: usize = 64;

impl Questions {
    pub(crate) fn asked(&mut self, now: Timestamp<Server>) {
        if self.open.len() < OPEN_MAX {
            self.open.push_back(now);
        }
    }

    /// Notes the answer to the question that was sent at `sent`.
    pub(crate) fn answer(&mut self, sent: Timestamp<Server>) {
        if self.answered.is_none_or(|answered| answered < sent) {
            let forgiven = self.forgiven.filter(|forgiven| self.answered < Some(*forgiven));
            self.passed_over = self.open.front().copied().into_iter().chain(forgiven).any(|at| at < sent);
        }
        self.answered = self.answered.max(Some(sent));
        self.open.retain(|open| *open > sent);
    }

    /// The sending time of the newest answered question. The robot has certainly received everything sent at that time.
    pub(crate) const fn answered(&self) -> Option<Timestamp<Server>> {
        self.answered
    }

    /// Whether a question that was asked before the newest answered one may not have reached the robot.
    pub(crate) const fn passed_over(&self) -> bool {
        self.passed_over
    }

    /// The sending time of the newest question.
    pub(crate) fn last_asked(&self) -> Option<Timestamp<Server>> {
        self.answered.max(self.last_unanswered())
    }

    /// The sending time of the oldest unanswered question.
    pub(crate) fn unanswered(&self) -> Option<Timestamp<Server>> {
        self.open.front().copied()
    }

    /// The sending time of the newest unanswered question.
    pub(crate) fn last_unanswered(&self) -> Option<Timestamp<Server>> {
        self.open.back().copied()
    }

    /// Discards the open questions, because they indicate nothing about the robot: this machine itself was delayed, or the link is new.
    pub(crate) fn forgive(&mut self) {
        self.forgiven = self.forgiven.max(self.last_unanswered());
        self.open.clear();
    }
}

/// The robots of a mission.
pub(crate) type Robots = IndexVec<RobotIndex, RobotState>;

/// One robot of the mission. Its parts belong to the files that handle them.
#[derive(Debug)]
pub(crate) struct RobotState {
    pub(crate) id: RobotId,
    /// The robot's settings in the fleet file.
    pub(crate) settings: MissionSettings,
    pub(crate) in_process: bool,
    pub(crate) block: Option<InitializationBlock>,
    pub(crate) standing: Standing,
    /// Whether the robot joined after the mission had begun.
    pub(crate) joined_late: bool,
    /// Whether the robot was missing when an act in which it has a part was sent.
    pub(crate) has_missed_an_act: bool,
    /// Whether the fate of a script of the robot in an ended act is unknown.
    pub(crate) was_lost_sight_of: bool,
    pub(crate) link: Link,
    /// The time at which the newest link was made, if an earlier one had broken.
    relinked_at: Option<Timestamp<Server>>,
    /// Number of attempts to reach the robot since its last message.
    attempts: u32,
    /// The offset last added to a timestamp to convert it to the robot's clock.
    pub(crate) shift: Span,
    pub(crate) clock: ClockEstimate,
    pub(crate) identity: Identity,
    pub(crate) greeted: Greeted,
    pub(crate) pose: Pose,
    pub(crate) contact: Contact,
    pub(crate) halt: Halt,
    /// The requests that were sent to the robot and whose answers are expected.
    pub(crate) requests: OpenRequests,
    pub(crate) failures: Failures,
    pub(crate) totals: Totals,
}

/// The questions to the robot, and the times at which messages were exchanged.
#[derive(Debug, Default)]
pub(crate) struct Contact {
    pub(crate) questions: Questions,
    /// The open questions to which the robot's answers may belong.
    pub(crate) exchanges: Exchanges,
    /// The time of the last report to the operator about the robot's own status.
    pub(crate) told_at: Option<Timestamp<Server>>,
    /// The time of the last message from the robot.
    heard_at: Option<Timestamp<Server>>,
    /// The time, by the robot's own clock, at which it received the newest question that it has answered.
    reached_at: Option<Timestamp<Robot>>,
    pub(crate) last_sent: Option<Timestamp<Server>>,
    /// The time of the last message to the robot other than a question.
    spoken_at: Option<Timestamp<Server>>,
}

/// The pause before the second attempt to reconnect to a robot, doubled with every attempt. The first attempt is immediate.
const RETRY_AFTER: Span = Span::from_millis(10);
const RETRY_AFTER_MAX: Span = Span::from_millis(1_000);
/// The longest time for which a message may still be under way after a later question has overtaken it.
const UNDER_WAY: Span = Span::from_millis(1_000);

impl RobotState {
    pub(crate) fn new(participant: Participant) -> Self {
        Self {
            identity: Identity::new(participant.own_id().clone()),
            greeted: Greeted::new(&participant.settings),
            id: participant.id,
            settings: participant.settings,
            in_process: participant.in_process,
            block: participant.block,
            standing: Standing::In,
            joined_late: false,
            has_missed_an_act: false,
            was_lost_sight_of: false,
            link: Link::Connecting,
            relinked_at: None,
            attempts: 0,
            shift: Span::ZERO,
            clock: ClockEstimate::default(),
            pose: Pose::default(),
            contact: Contact::default(),
            halt: Halt::default(),
            requests: OpenRequests::default(),
            failures: Failures::default(),
            totals: Totals::default(),
        }
    }

    /// The reason, at the end of the mission, why a robot that was missing at first took no part. `None` for all other robots.
    pub(crate) fn why_it_never_joined(&self) -> Option<String> {
        match self.standing {
            Standing::Absent if self.has_failed() => None,
            Standing::Absent => Some(match self.lost() {
                Some(lost) => format!("link down: {}", lost.reason),
                None => "it has not answered".to_owned(),
            }),
            Standing::In if self.has_missed_an_act && self.totals.sent == 0 => {
                Some("its acts had already started when it joined".to_owned())
            }
            Standing::In | Standing::Out => None,
        }
    }

    /// Counts an attempt to reconnect, and returns the pause before it.
    pub(crate) fn next_attempt(&mut self) -> Span {
        let attempts = self.attempts;
        self.attempts = attempts.saturating_add(1);
        match attempts.checked_sub(1) {
            None => Span::ZERO,
            Some(again) => (RETRY_AFTER * (1 << again.min(8))).min(RETRY_AFTER_MAX),
        }
    }

    /// Notes a message from the robot. Returns whether it is the first message since the robot's link was lost.
    pub(crate) fn heard(&mut self, now: Timestamp<Server>) -> bool {
        self.attempts = 0;
        self.contact.heard_at = Some(now);
        match &mut self.link {
            Link::Up { unheard } => unheard.take().is_some(),
            Link::Connecting | Link::Unnamed { .. } | Link::Lost(_) => false,
        }
    }

    /// Notes that a question reached the robot at `at` by its own clock. Returns the previous such time, unless that was later.
    pub(crate) fn reached(&mut self, at: Timestamp<Robot>) -> Option<Timestamp<Robot>> {
        let before = self.contact.reached_at;
        self.contact.reached_at = before.max(Some(at));
        before.filter(|before| *before < at)
    }

    /// Notes that a message is sent to the robot.
    pub(crate) fn is_sent(&mut self, now: Timestamp<Server>, message: &Message) {
        self.contact.last_sent = Some(now);
        if let Message::ControlRequest(_) = message {
            self.contact.spoken_at = Some(now);
        }
    }

    /// Whether a message other than a question may have reached the robot between two instants by its own clock.
    pub(crate) fn was_spoken_to(
        &self,
        now: Timestamp<Server>,
        before: Timestamp<Robot>,
        at: Timestamp<Robot>,
    ) -> bool {
        let (before, at) = (self.said_at(now, before), self.said_at(now, at));
        self.contact.spoken_at.is_some_and(|spoken| spoken + UNDER_WAY >= before && spoken <= at)
    }

    /// Notes that the robot's clock was set. Times by that clock from before and after cannot be compared.
    pub(crate) fn clock_was_set(&mut self) {
        self.contact.reached_at = None;
    }

    /// Notes a connection to the robot's address. The robot that answers must first identify itself.
    pub(crate) fn connected(&mut self, now: Timestamp<Server>) {
        let unheard = self.lost_mut().cloned();
        self.relinked_at = unheard.as_ref().map(|_| now);
        self.link = Link::Unnamed { since: now, unheard };
        self.contact.questions.forgive();
        self.contact.exchanges.begin_again();
        self.requests.clear_readings();
        self.pose.asked = None;
    }

    /// The time at which the robot's current link was made, if the clock was measured only on an earlier link. The robot may now be a new
    /// process with a different clock. `None` once the robot has answered on the current link.
    pub(crate) fn unmeasured_since(&self) -> Option<Timestamp<Server>> {
        let stands = matches!(self.link, Link::Unnamed { .. } | Link::Up { .. });
        let answered = self.contact.questions.answered();
        self.relinked_at.filter(|at| stands && self.clock.samples() > 0 && answered < Some(*at))
    }

    /// Whether scripts have to wait until the robot answers, because its clock is unknown or was measured on an earlier link.
    pub(crate) fn owes_its_times(&self) -> bool {
        let unknown = self.clock.samples() == 0 && self.settings.clock == ClockMode::Measured;
        unknown || self.unmeasured_since().is_some()
    }

    /// Whether scripts may be sent to the robot: no stop was sent, and the robot does not owe an answer with the times of its clock.
    pub(crate) fn may_be_sent_scripts(&self) -> bool {
        !self.stop_was_sent() && !self.owes_its_times()
    }

    /// Notes that the right robot answers, or that its identity is not checked. Returns `false` if that was already known for this link.
    pub(crate) fn named(&mut self) -> bool {
        let Link::Unnamed { unheard, .. } = &mut self.link else { return false };
        self.link = Link::Up { unheard: unheard.take() };
        true
    }

    /// The time at which the current link was made, if the robot has not identified itself on it yet.
    pub(crate) const fn unnamed_since(&self) -> Option<Timestamp<Server>> {
        match self.link {
            Link::Unnamed { since, .. } => Some(since),
            _ => None,
        }
    }

    /// The time at which the robot's first link was made, if the robot has not identified itself on it yet. After a loss of the link,
    /// another deadline applies.
    pub(crate) const fn owes_its_name_since(&self) -> Option<Timestamp<Server>> {
        match self.link {
            Link::Unnamed { since, unheard: None } => Some(since),
            _ => None,
        }
    }

    pub(crate) const fn is_up(&self) -> bool {
        matches!(self.link, Link::Up { .. })
    }

    /// The time at which the robot's silence becomes a failure: it owes an answer, and `bound` has elapsed since its last message. `None`
    /// if it owes no answer.
    pub(crate) fn silent_at(&self, bound: Span) -> Option<Timestamp<Server>> {
        let asked = self.contact.questions.unanswered().or(self.owes_its_name_since())?;
        // After a delay of this machine, a question must have had its time.
        let answerable = asked + bound * 2 / 3;
        Some(self.contact.heard_at.map_or(asked + bound, |heard| (heard + bound).max(answerable)))
    }

    /// The cause of the link's loss, unless a message from the robot has arrived since.
    pub(crate) fn broken(&self) -> Option<&str> {
        self.lost().map(|lost| lost.reason.as_str())
    }

    /// The loss of the link, unless a message from the robot has arrived since.
    pub(crate) const fn lost(&self) -> Option<&Lost> {
        match &self.link {
            Link::Lost(lost) => Some(lost),
            Link::Unnamed { unheard, .. } | Link::Up { unheard } => unheard.as_ref(),
            Link::Connecting => None,
        }
    }

    /// Like `lost`, but mutable, to change whether and when the mission gives up the robot.
    pub(crate) const fn lost_mut(&mut self) -> Option<&mut Lost> {
        match &mut self.link {
            Link::Lost(lost) => Some(lost),
            Link::Unnamed { unheard, .. } | Link::Up { unheard } => unheard.as_mut(),
            Link::Connecting => None,
        }
    }

    /// Whether it is certain that no process of the robot runs any longer.
    pub(crate) const fn is_gone(&self) -> bool {
        matches!(&self.link, Link::Lost(Lost { loss: Loss::Refused, .. }))
    }

    pub(crate) fn has_failed(&self) -> bool {
        !self.failures.is_empty()
    }

    /// Whether the robot belongs to another session and is to be taken over from that session.
    pub(crate) const fn is_of_another(&self) -> bool {
        matches!(self.identity.ownership, Ownership::OfAnother(_))
    }

    /// The reading of the robot's clock at an instant; `None` if the clock was not measured.
    pub(crate) fn clock_at(&self, at: Timestamp<Server>) -> Option<ClockReading> {
        self.clock.reading_at(at)
    }

    /// An upper limit that the round trips of the robot's link nearly always keep.
    pub(crate) const fn round_trip(&self) -> Span {
        self.clock.delay_high()
    }

    /// The server time at which the robot sent something, as far as its clock is known, and at most `now`.
    pub(crate) fn said_at(&self, now: Timestamp<Server>, timestamp: Timestamp<Robot>) -> Timestamp<Server> {
        let offset = self.clock_at(now).map_or(Span::ZERO, |reading| reading.offset);
        (timestamp - offset).assume_clock::<Server>().min(now)
    }

    /// Whether the robot reports the start and end of scripts.
    pub(crate) fn reports(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.reports)
    }

    /// Whether the robot answers inquiries.
    pub(crate) fn takes_inquiries(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.inquiry)
    }

    /// Whether the robot itself drops an undecided script, however long a message to it is delayed.
    pub(crate) fn drops_undecided(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.inquiry && block.pending_until)
    }

    /// Whether the robot can report the fate of a script.
    pub(crate) fn tells_fates(&self) -> bool {
        self.reports() || self.takes_inquiries()
    }

    /// The number of scripts that a device can hold; 1 if the device is not described.
    pub(crate) fn queue_of(&self, device: &DeviceId) -> usize {
        let device = self.block.as_ref().and_then(|block| block.device(device.as_str()));
        device.map_or(1, |device| device.script_queue as usize)
    }

    /// Marks the robot's stop as over, so that the robot can play again. A robot that was left out stays stopped.
    pub(crate) fn plays_again(&mut self) {
        if self.standing != Standing::Out {
            self.set_stop(Stop::None);
            self.halt.at_rest = true;
            self.halt.left.clear();
        }
    }

    pub(crate) const fn stop_was_sent(&self) -> bool {
        !matches!(self.halt.stop, Stop::None)
    }

    /// Whether a stop is pending: sent, not confirmed, and not given up.
    pub(crate) const fn awaits_stop(&self) -> bool {
        matches!(self.halt.stop, Stop::Sent(SentStop { given_up: false, .. }))
    }

    /// Whether the robot has refused its stop because it belongs to another session, and the mission leaves it to that session.
    pub(crate) const fn is_left_to_others(&self) -> bool {
        matches!(self.halt.stop, Stop::Sent(SentStop { given_up: true, .. }))
    }

    /// Whether a message of the robot could not be read.
    pub(crate) fn is_garbled(&self) -> bool {
        self.failures.iter().any(|failure| matches!(failure.kind, FailureKind::Garbled { .. }))
    }

    /// Whether the robot was stopped with a kind of rest other than `rest`.
    pub(crate) fn stops_otherwise(&self, rest: Rest) -> bool {
        match &self.halt.stop {
            // An earlier stop brought the robot to rest.
            Stop::None => rest == Rest::Home && !self.halt.touched.is_empty(),
            Stop::Sent(sent) => sent.rest != rest,
            Stop::Confirmed(confirmed) => *confirmed != rest,
        }
    }

    /// Whether nothing that this mission sent can still move the robot: it was sent nothing, or it has confirmed its stop. A process that
    /// replaced an earlier process of the robot cannot confirm the stop of the earlier one.
    pub(crate) fn is_settled(&self) -> bool {
        match self.halt.stop {
            Stop::None => self.holds_nothing(),
            Stop::Sent(_) => false,
            Stop::Confirmed(_) => self.halt.elsewhere.is_none(),
        }
    }

    /// Whether a script of this mission may still move the robot: its stop is not confirmed, it is not gone, and not all leases have
    /// ended.
    pub(crate) fn may_move_at(&self, now: Timestamp<Server>) -> bool {
        let ended = |lease: &Option<Timestamp<Server>>| lease.is_some_and(|ends| ends <= now);
        let rests = !self.halt.left.is_empty() && self.halt.left.iter().all(ended);
        !self.is_settled() && !self.is_gone() && !rests
    }

    /// Whether the robot was sent nothing that moves it, at least since it confirmed a stop.
    pub(crate) fn holds_nothing(&self) -> bool {
        self.halt.touched.is_empty() || self.halt.at_rest
    }

    /// Notes that the robot's current process has lost a script. An earlier process may run that script until its lease ends at `until`;
    /// `None` if it has no lease.
    pub(super) fn runs_elsewhere(&mut self, until: Option<Timestamp<Server>>) {
        let before = self.halt.elsewhere.unwrap_or(until);
        self.halt.elsewhere = Some(before.zip(until).map(|(before, until)| before.max(until)));
    }

    /// Replaces the state of the robot's stop. The requests of the previous stop no longer count.
    pub(crate) fn set_stop(&mut self, stop: Stop) {
        self.requests.remove_all_stops();
        self.halt.stop = stop;
    }

    /// Returns the id of the stop that a response without an id confirms; `None` if it does not confirm a stop. It does so only if it
    /// cannot belong to `open`, a script of its device. A mission that only withdraws another one knows no scripts.
    pub(crate) fn stop_confirmed_without_id(
        &self,
        now: Timestamp<Server>,
        response: &ControlResponse,
        open: Option<ScriptRef>,
    ) -> Option<RequestId> {
        let Stop::Sent(sent) = &self.halt.stop else { return None };
        // An acceptance confirms only a future action, and without an id possibly that of a script.
        let confirms = response.status == Status::Ok && may_be_for_a_stop(response);
        let is_meant = confirms && open.is_none() && self.said_at(now, response.timestamp) >= sent.at;
        let mut stops = self.requests.stops().filter(|_| is_meant);
        stops.find(|(_, device)| **device == response.device_id).map(|(id, _)| id.clone())
    }

    /// Processes the answer to the stop of one device. Only `OK` confirms the stop.
    pub(crate) fn stop_answered(&mut self, id: &RequestId, response: &ControlResponse) {
        let Stop::Sent(sent) = &mut self.halt.stop else { return };
        let busy = response.error.as_ref().filter(|error| error.code == ErrorCode::Busy);
        if let Some(error) = busy.filter(|_| response.status == Status::Failed) {
            sent.taken_over.get_or_insert_with(|| error.clone());
        }
        let rest = sent.rest;
        if response.status == Status::Ok {
            self.requests.remove_stop(id);
            if self.requests.stops().next().is_none() {
                self.halt.stop = Stop::Confirmed(rest);
            }
        }
    }
}

#[cfg(test)]
mod tests;
