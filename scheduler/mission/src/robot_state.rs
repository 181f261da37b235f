//! What the mission knows of one robot: its link, its clock, what it was asked, and its stop.

mod invariants;

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

use serde::{Deserialize, Serialize};
use urrcp::{
    ControlError, ControlResponse, DeviceId, ErrorCode, InitializationBlock, Message, RequestId, Robot,
    RobotId, Server, Span, Status, Timestamp,
};

use super::exchanges::Exchanges;
use super::failure_kind::FailureKind;
use super::failures::Failures;
use super::latency::LatencyDiffers;
use super::reads::OwedReadings;
use super::requests::may_be_for_a_stop;
use super::script::{Ending, Script, ScriptRef, ScriptState};
use super::seize::Ownership;
use super::{ClockMode, Loss, MissionSettings, Participant};
use crate::clock::{ClockEstimate, ClockReading};

/// The state of a robot's link.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Link {
    /// A first connection is being made.
    Connecting,
    /// It stands, and the robot behind it has not said yet which one it is: nothing but that question is sent, and stops.
    /// `unheard` as below.
    Unnamed { since: Timestamp<Server>, unheard: Option<Lost> },
    /// It stands, and the robot behind it is the one that is meant. `unheard` is how it was lost before, until
    /// something is heard on it again: a link that is taken and closed again and again is as good as none.
    Up { unheard: Option<Lost> },
    /// It broke, or could not be made.
    Lost(Lost),
}

/// A link that is down.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lost {
    pub(crate) reason: String,
    pub(crate) loss: Loss,
    /// When it broke for the first time since the robot was last heard.
    pub(crate) since: Timestamp<Server>,
    /// When the link broke, or when the last attempt to connect failed.
    pub(crate) failed: Timestamp<Server>,
    /// A new connection is being made.
    pub(crate) connecting: bool,
    /// When the robot is given up; `None`: not yet.
    pub(crate) give_up: Option<Timestamp<Server>>,
}

/// Whether a robot takes part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Standing {
    /// It takes part.
    In,
    /// Not there when the mission began; may join at the next act.
    Absent,
    /// It failed, and the others went on or were stopped.
    Out,
}

/// What became of the stop of a robot.
#[derive(Clone, Debug, Default)]
pub(crate) enum Stop {
    /// None was sent.
    #[default]
    None,
    /// Sent; these have not been confirmed.
    Sent(SentStop),
    /// Every device that was sent anything is known to be at rest.
    Confirmed(Rest),
}

/// A stop on its way.
#[derive(Clone, Debug)]
pub(crate) struct SentStop {
    pub(crate) at: Timestamp<Server>,
    pub(crate) rest: Rest,
    pub(crate) unconfirmed: HashMap<RequestId, DeviceId>,
    /// Why the robot has refused it, where it belongs to another session: it holds nothing of this one any more.
    pub(crate) taken_over: Option<ControlError>,
    /// It is not sent again: nobody but this mission, which has lost the robot to another session, wants it to rest.
    pub(crate) given_up: bool,
}

/// How a stopped device comes to rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rest {
    /// Where it is: it slows down, and nothing begins to move.
    #[default]
    InPlace,
    /// In its default state, to which it moves.
    Home,
}

/// What a reading is for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Reading {
    /// A requirement of the fleet file, by its index.
    Requirement(usize),
    /// Where a device stands before the first act.
    Position(DeviceId),
    /// Only to be shown before a mission.
    Shown(DeviceId),
    /// An act waits for it: the act's number.
    Wait(u32),
    /// The scenario reads it: the act's number, and which of its readings.
    Planned(u32, usize),
    /// It shows when a device begins to move: the act's number, and which of the devices that it watches.
    Motion(u32, usize),
}

/// Sums over the acts that have ended.
#[derive(Clone, Copy, Debug, Default)]
pub struct Totals {
    /// Scripts planned.
    pub scripts: usize,
    /// Scripts sent.
    pub sent: usize,
    /// Scripts accepted.
    pub accepted: usize,
    /// Scripts refused, or ended early.
    pub failed: usize,
    /// Scripts started.
    pub started: usize,
    /// Steps executed.
    pub steps_done: u64,
    /// Steps planned.
    pub steps_planned: u64,
    /// Steps executed late.
    pub late_steps: u64,
    /// The largest lateness of a step.
    pub late_max: Option<Span>,
    /// The start error with the largest absolute value.
    pub start_error: Option<Span>,
    /// Scripts that were sent and whose fate is unknown.
    pub unaccounted: usize,
    /// Requests sent again.
    pub retries: u32,
    /// How often the link was re-established.
    pub reconnects: u32,
}

impl Totals {
    pub(crate) fn add(&mut self, script: &Script, error: Option<Span>) {
        self.scripts += 1;
        self.sent += usize::from(!script.is_planned());
        // What has begun was accepted, even if that answer was lost.
        self.accepted += usize::from(script.was_accepted() || script.has_begun());
        self.failed += usize::from(matches!(script.state(), ScriptState::Ended(Ending::Failed(_))));
        self.started += usize::from(script.has_started());
        self.steps_done += u64::from(script.steps_done());
        self.steps_planned += script.plan.script.steps().len() as u64;
        self.late_steps += u64::from(script.late_steps());
        self.late_max = self.late_max.max(script.late_max());
        self.start_error = self.start_error.into_iter().chain(error).max_by_key(|e| e.abs());
        self.unaccounted += usize::from(script.is_unaccounted());
    }
}

/// Questions for a robot's times, and whether it answers them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Questions {
    /// When those were sent that have not been answered, the oldest first.
    open: VecDeque<Timestamp<Server>>,
    /// When the newest one was sent that has been answered.
    answered: Option<Timestamp<Server>>,
    /// Between that one and the one answered before it others were asked, and never answered.
    passed_over: bool,
    /// When the newest one was sent of those that are not owed any more and may have been heard.
    forgiven: Option<Timestamp<Server>>,
}

/// Questions that are remembered; more are open only on a link that carries nothing.
const OPEN_MAX: usize = 64;

impl Questions {
    pub(crate) fn asked(&mut self, now: Timestamp<Server>) {
        if self.open.len() < OPEN_MAX {
            self.open.push_back(now);
        }
    }

    /// Whether this is an answer to a question that was asked.
    pub(crate) fn answer(&mut self, sent: Timestamp<Server>) {
        if self.answered.is_none_or(|answered| answered < sent) {
            let forgiven = self.forgiven.filter(|forgiven| self.answered < Some(*forgiven));
            self.passed_over = self.open.front().copied().into_iter().chain(forgiven).any(|at| at < sent);
        }
        self.answered = self.answered.max(Some(sent));
        self.open.retain(|open| *open > sent);
    }

    /// When the newest question was sent that it has answered: it has surely heard what was sent then.
    pub(crate) const fn answered(&self) -> Option<Timestamp<Server>> {
        self.answered
    }

    /// Whether others were asked before the newest question that was answered, of which nobody knows if they reached it.
    pub(crate) const fn passed_over(&self) -> bool {
        self.passed_over
    }

    /// When the newest question was sent.
    pub(crate) fn last_asked(&self) -> Option<Timestamp<Server>> {
        self.answered.max(self.last_unanswered())
    }

    /// When the oldest question was sent that it has not answered.
    pub(crate) fn unanswered(&self) -> Option<Timestamp<Server>> {
        self.open.front().copied()
    }

    /// When the newest question was sent that has not been answered.
    pub(crate) fn last_unanswered(&self) -> Option<Timestamp<Server>> {
        self.open.back().copied()
    }

    /// This machine itself was held up, or the link is new: what was open says nothing about the robot.
    pub(crate) fn forgive(&mut self) {
        self.forgiven = self.forgiven.max(self.last_unanswered());
        self.open.clear();
    }
}

/// One robot of the mission.
#[derive(Debug)]
pub(crate) struct RobotState {
    pub(crate) id: RobotId,
    /// What it has to call itself.
    pub(crate) own_id: RobotId,
    /// It has proven who it is, and so does this mission to it.
    pub(crate) proven: bool,
    /// Until when its certificate counts, if it has shown one.
    pub(crate) certified_until: Option<Timestamp<Server>>,
    /// To whom it belongs, while robots are greeted.
    pub(crate) ownership: Ownership,
    pub(crate) link: Link,
    /// When its newest link was made, if an earlier one had broken.
    relinked_at: Option<Timestamp<Server>>,
    /// Attempts to reach it since it was last heard.
    attempts: u32,
    pub(crate) standing: Standing,
    /// Whether it joined after the mission had begun.
    pub(crate) joined_late: bool,
    /// Whether its devices may no longer be where the greeting found them, because it joined late or is on a new link.
    pub(crate) unplaced: bool,
    /// Devices that a stop has left at positions that the next act that moves them may not expect.
    pub(crate) adrift: BTreeSet<DeviceId>,
    /// The last question for positions of an act on this link.
    pub(crate) positions_asked: Option<PositionsAsked>,
    /// It was not there when an act was sent in which it has a part.
    pub(crate) has_missed_an_act: bool,
    pub(crate) block: Option<InitializationBlock>,
    /// The robot has given its own block in this mission.
    pub(crate) introduced: bool,
    /// What it declares of latencies, where that is not what was compensated.
    pub(crate) latency_differs: Option<LatencyDiffers>,
    /// What the fleet file says of it.
    pub(crate) settings: MissionSettings,
    pub(crate) in_process: bool,
    /// What was last added to a timestamp so that it is right by its own clock.
    pub(crate) shift: Span,
    pub(crate) clock: ClockEstimate,
    pub(crate) questions: Questions,
    /// When the operator was last told what it says of itself.
    pub(crate) told_at: Option<Timestamp<Server>>,
    /// When something last came from it.
    heard_at: Option<Timestamp<Server>>,
    /// When a question last reached it that it has answered, by its own clock.
    reached_at: Option<Timestamp<Robot>>,
    /// Of `settings.require`, in its order.
    pub(crate) readings: Vec<Option<f64>>,
    /// Where devices stood before the first act.
    pub(crate) positions: Vec<(DeviceId, f64)>,
    /// The commanded positions of devices before the first act, as the robot states them.
    pub(crate) commanded: BTreeMap<DeviceId, f64>,
    /// Number of pending answers that state them.
    pub(crate) positions_owed: usize,
    /// What its other sensors read, which nothing depends on.
    pub(crate) shown: Vec<(DeviceId, Option<f64>)>,
    /// Why a device gave no reading, as the robot says it.
    pub(crate) unread: BTreeMap<DeviceId, String>,
    pub(crate) reads: OwedReadings,
    /// The requests that it was sent, by their names.
    pub(crate) requests: HashMap<RequestId, ScriptRef>,
    /// Devices that this mission has sent anything that moves.
    pub(crate) touched: BTreeSet<DeviceId>,
    /// It has confirmed its stop, and was sent nothing that moves since.
    pub(crate) at_rest: bool,
    pub(crate) stop: Stop,
    /// Whether the mission has reported that the robot has confirmed its stop.
    pub(crate) rest_reported: bool,
    /// Set once the robot has lost a script that another process may still run: the end of its lease, `None` without a lease.
    pub(crate) elsewhere: Option<Option<Timestamp<Server>>>,
    /// When what it still held at the end of an act ends by its own leases; `None` where it has none.
    pub(crate) left: Vec<Option<Timestamp<Server>>>,
    pub(crate) last_sent: Option<Timestamp<Server>>,
    /// When it was last sent anything but a question.
    spoken_at: Option<Timestamp<Server>>,
    pub(crate) failures: Failures,
    /// The questions that its answers may answer.
    pub(crate) exchanges: Exchanges,
    pub(crate) totals: Totals,
    /// Nobody knows what it did of a script of an act that has ended.
    pub(crate) was_lost_sight_of: bool,
}

/// The pause before the second attempt to reach a robot again, doubled with every attempt; the first comes at once.
const RETRY_AFTER: Span = Span::from_millis(10);
const RETRY_AFTER_MAX: Span = Span::from_millis(1_000);
/// What is overtaken by a question may come so long after it was sent.
const UNDER_WAY: Span = Span::from_millis(1_000);

/// A question for the positions of a robot's devices before an act.
#[derive(Clone, Debug)]
pub(crate) struct PositionsAsked {
    pub(crate) act: u32,
    pub(crate) at: Timestamp<Server>,
    /// When the act asked first.
    pub(crate) since: Timestamp<Server>,
    /// The positions of adrift devices in the previous answer.
    pub(crate) before: BTreeMap<DeviceId, f64>,
}

impl RobotState {
    pub(crate) fn new(participant: Participant) -> Self {
        Self {
            own_id: participant.own_id().clone(),
            proven: false,
            certified_until: None,
            ownership: Ownership::default(),
            id: participant.id,
            link: Link::Connecting,
            relinked_at: None,
            attempts: 0,
            standing: Standing::In,
            joined_late: false,
            unplaced: false,
            adrift: BTreeSet::new(),
            positions_asked: None,
            has_missed_an_act: false,
            block: participant.block,
            introduced: false,
            latency_differs: None,
            shift: Span::ZERO,
            clock: ClockEstimate::default(),
            questions: Questions::default(),
            told_at: None,
            heard_at: None,
            reached_at: None,
            readings: vec![None; participant.settings.require.len()],
            settings: participant.settings,
            in_process: participant.in_process,
            positions: Vec::new(),
            commanded: BTreeMap::new(),
            positions_owed: 0,
            shown: Vec::new(),
            unread: BTreeMap::new(),
            reads: OwedReadings::default(),
            requests: HashMap::new(),
            touched: BTreeSet::new(),
            at_rest: false,
            stop: Stop::None,
            rest_reported: false,
            elsewhere: None,
            left: Vec::new(),
            last_sent: None,
            spoken_at: None,
            failures: Failures::default(),
            exchanges: Exchanges::default(),
            totals: Totals::default(),
            was_lost_sight_of: false,
        }
    }

    /// At the end of the mission: why a robot that was not there at first took no part. `None` for all other robots.
    pub(crate) fn why_it_never_joined(&self) -> Option<String> {
        match self.standing {
            Standing::Absent if self.has_failed() => None,
            Standing::Absent => Some(match self.lost() {
                Some(lost) => format!("link down: {}", lost.reason),
                None => "it has not answered".to_owned(),
            }),
            Standing::In if self.has_missed_an_act && self.totals.sent == 0 => {
                Some("its acts had begun when it came".to_owned())
            }
            Standing::In | Standing::Out => None,
        }
    }

    /// The pause before the next attempt to reach it, which is counted.
    pub(crate) fn next_attempt(&mut self) -> Span {
        let attempts = self.attempts;
        self.attempts = attempts.saturating_add(1);
        match attempts.checked_sub(1) {
            None => Span::ZERO,
            Some(again) => (RETRY_AFTER * (1 << again.min(8))).min(RETRY_AFTER_MAX),
        }
    }

    /// Something came from it. `true`: for the first time since its link was lost.
    pub(crate) fn heard(&mut self, now: Timestamp<Server>) -> bool {
        self.attempts = 0;
        self.heard_at = Some(now);
        match &mut self.link {
            Link::Up { unheard } => unheard.take().is_some(),
            Link::Connecting | Link::Unnamed { .. } | Link::Lost(_) => false,
        }
    }

    /// A question reached it at that time by its own clock. Returns when the one before did, unless that was later.
    pub(crate) fn reached(&mut self, at: Timestamp<Robot>) -> Option<Timestamp<Robot>> {
        let before = self.reached_at;
        self.reached_at = before.max(Some(at));
        before.filter(|before| *before < at)
    }

    /// Something is sent to it.
    pub(crate) fn is_sent(&mut self, now: Timestamp<Server>, message: &Message) {
        self.last_sent = Some(now);
        if let Message::ControlRequest(_) = message {
            self.spoken_at = Some(now);
        }
    }

    /// Whether anything but questions may have reached it between two instants by its own clock.
    pub(crate) fn was_spoken_to(
        &self,
        now: Timestamp<Server>,
        (before, at): (Timestamp<Robot>, Timestamp<Robot>),
    ) -> bool {
        let (before, at) = (self.said_at(now, before), self.said_at(now, at));
        self.spoken_at.is_some_and(|spoken| spoken + UNDER_WAY >= before && spoken <= at)
    }

    /// Its clock was set: times by it from before and after do not compare.
    pub(crate) fn clock_was_set(&mut self) {
        self.reached_at = None;
    }

    /// A link to its address stands. Which robot answers there it has to say first.
    pub(crate) fn connected(&mut self, now: Timestamp<Server>) {
        let unheard = self.lost_mut().cloned();
        self.relinked_at = unheard.as_ref().map(|_| now);
        self.link = Link::Unnamed { since: now, unheard };
        self.questions.forgive();
        self.exchanges.begin_again();
        self.reads.clear();
        self.positions_asked = None;
    }

    /// When its link was made, if its clock was measured on an earlier link and it has not answered on this one yet. It may be a
    /// new process with another clock.
    pub(crate) fn unmeasured_since(&self) -> Option<Timestamp<Server>> {
        let stands = matches!(self.link, Link::Unnamed { .. } | Link::Up { .. });
        let answered = self.questions.answered();
        self.relinked_at.filter(|at| stands && self.clock.samples() > 0 && answered < Some(*at))
    }

    /// Whether scripts have to wait until it has answered: its clock is not known, or was measured on an earlier link.
    pub(crate) fn owes_its_times(&self) -> bool {
        let unknown = self.clock.samples() == 0 && self.settings.clock == ClockMode::Measured;
        unknown || self.unmeasured_since().is_some()
    }

    /// Whether it may be sent scripts: no stop was sent to it, and it does not owe its times.
    pub(crate) fn may_be_sent_scripts(&self) -> bool {
        !self.stop_was_sent() && !self.owes_its_times()
    }

    /// It is the one that is meant, or it is not asked. `false`: that was known of this link.
    pub(crate) fn named(&mut self) -> bool {
        let Link::Unnamed { unheard, .. } = &mut self.link else { return false };
        self.link = Link::Up { unheard: unheard.take() };
        true
    }

    /// A link stands on which it has not said yet which robot it is, since then.
    pub(crate) const fn unnamed_since(&self) -> Option<Timestamp<Server>> {
        match self.link {
            Link::Unnamed { since, .. } => Some(since),
            _ => None,
        }
    }

    /// The same on the first link of this process: one that was lost before is given up in its own time.
    pub(crate) const fn owes_its_name_since(&self) -> Option<Timestamp<Server>> {
        match self.link {
            Link::Unnamed { since, unheard: None } => Some(since),
            _ => None,
        }
    }

    pub(crate) const fn is_up(&self) -> bool {
        matches!(self.link, Link::Up { .. })
    }

    /// When it has been silent for so long that it has failed: it owes an answer, and this time has passed since anything came
    /// from it.
    pub(crate) fn silent_at(&self, bound: Span) -> Option<Timestamp<Server>> {
        let asked = self.questions.unanswered().or(self.owes_its_name_since())?;
        // After this machine was held up, a question must have had its time.
        let answerable = asked + bound * 2 / 3;
        Some(self.heard_at.map_or(asked + bound, |heard| (heard + bound).max(answerable)))
    }

    /// Why its link broke, unless it has been heard since.
    pub(crate) fn broken(&self) -> Option<&str> {
        self.lost().map(|lost| lost.reason.as_str())
    }

    /// How its link was lost, unless it has been heard since.
    pub(crate) const fn lost(&self) -> Option<&Lost> {
        match &self.link {
            Link::Lost(lost) => Some(lost),
            Link::Unnamed { unheard, .. } | Link::Up { unheard } => unheard.as_ref(),
            Link::Connecting => None,
        }
    }

    /// The same, to be given up or not.
    pub(crate) const fn lost_mut(&mut self) -> Option<&mut Lost> {
        match &mut self.link {
            Link::Lost(lost) => Some(lost),
            Link::Unnamed { unheard, .. } | Link::Up { unheard } => unheard.as_mut(),
            Link::Connecting => None,
        }
    }

    /// Whether it is certain that no process of it runs any more.
    pub(crate) const fn is_gone(&self) -> bool {
        matches!(&self.link, Link::Lost(Lost { loss: Loss::Refused, .. }))
    }

    pub(crate) fn has_failed(&self) -> bool {
        !self.failures.is_empty()
    }

    /// Whether it belongs to another session and is to be taken from that.
    pub(crate) const fn is_of_another(&self) -> bool {
        matches!(self.ownership, Ownership::OfAnother(_))
    }

    /// Its clock at an instant.
    pub(crate) fn clock_at(&self, at: Timestamp<Server>) -> Option<ClockReading> {
        self.clock.reading_at(at)
    }

    /// The round trip that its link keeps to nearly always.
    pub(crate) const fn round_trip(&self) -> Span {
        self.clock.delay_high()
    }

    /// The server's time at which it sent something, as far as its clock is known, and not later than now.
    pub(crate) fn said_at(&self, now: Timestamp<Server>, timestamp: Timestamp<Robot>) -> Timestamp<Server> {
        let offset = self.clock_at(now).map_or(Span::ZERO, |reading| reading.offset);
        (timestamp - offset).assume_clock::<Server>().min(now)
    }

    /// Whether it says when scripts start and end.
    pub(crate) fn reports(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.reports)
    }

    /// Whether it answers inquiries.
    pub(crate) fn takes_inquiries(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.inquiry)
    }

    /// Whether the robot itself drops a script that was not decided, however long a message to it was delayed.
    pub(crate) fn drops_undecided(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.inquiry && block.pending_until)
    }

    /// Whether what became of a script can be learned from it.
    pub(crate) fn tells_fates(&self) -> bool {
        self.reports() || self.takes_inquiries()
    }

    /// How many scripts one of its devices holds.
    pub(crate) fn queue_of(&self, device: &DeviceId) -> usize {
        let device = self.block.as_ref().and_then(|block| block.device(device.as_str()));
        device.map_or(1, |device| device.script_queue as usize)
    }

    /// Its stop is over. A robot that was left out stays stopped.
    pub(crate) fn plays_again(&mut self) {
        if self.standing != Standing::Out {
            (self.stop, self.at_rest) = (Stop::None, true);
            self.left.clear();
        }
    }

    pub(crate) const fn stop_was_sent(&self) -> bool {
        !matches!(self.stop, Stop::None)
    }

    /// Whether a stop is on its way that has not been confirmed and is not given up.
    pub(crate) const fn awaits_stop(&self) -> bool {
        matches!(self.stop, Stop::Sent(SentStop { given_up: false, .. }))
    }

    /// Whether it has refused its stop because it belongs to another session, and is left to that.
    pub(crate) const fn is_left_to_others(&self) -> bool {
        matches!(self.stop, Stop::Sent(SentStop { given_up: true, .. }))
    }

    /// What it said could not be read.
    pub(crate) fn is_garbled(&self) -> bool {
        self.failures.iter().any(|failure| matches!(failure.kind, FailureKind::Garbled { .. }))
    }

    /// Whether it was stopped to come to rest in another way than this.
    pub(crate) fn stops_otherwise(&self, rest: Rest) -> bool {
        match &self.stop {
            // It came to rest by an earlier stop.
            Stop::None => rest == Rest::Home && !self.touched.is_empty(),
            Stop::Sent(sent) => sent.rest != rest,
            Stop::Confirmed(confirmed) => *confirmed != rest,
        }
    }

    /// Whether nothing that this mission sent can still move it: it was sent nothing, or it has confirmed its stop. A process
    /// that replaced another one cannot confirm the stop of that one.
    pub(crate) fn is_settled(&self) -> bool {
        match self.stop {
            Stop::None => self.holds_nothing(),
            Stop::Sent(_) => false,
            Stop::Confirmed(_) => self.elsewhere.is_none(),
        }
    }

    /// Whether a script of this mission may still move it: its stop is not confirmed, it is not gone, and a lease has not ended.
    pub(crate) fn may_move_at(&self, now: Timestamp<Server>) -> bool {
        let ended = |lease: &Option<Timestamp<Server>>| lease.is_some_and(|ends| ends <= now);
        let rests = !self.left.is_empty() && self.left.iter().all(ended);
        !self.is_settled() && !self.is_gone() && !rests
    }

    /// It was sent nothing that moves, at least since it has confirmed a stop.
    pub(crate) fn holds_nothing(&self) -> bool {
        self.touched.is_empty() || self.at_rest
    }

    /// Notes that the process that answers has lost a script. Another process may run it until its lease ends.
    pub(super) fn runs_elsewhere(&mut self, until: Option<Timestamp<Server>>) {
        let before = self.elsewhere.unwrap_or(until);
        self.elsewhere = Some(before.zip(until).map(|(before, until)| before.max(until)));
    }

    /// Takes the answer to a stop request, if it is one. An answer without a name is one only if no script of its device
    /// can be meant: `open_on` tells whether one is open. A process that only withdraws a mission knows no scripts.
    pub(crate) fn stop_answered(
        &mut self,
        now: Timestamp<Server>,
        response: &ControlResponse,
        open_on: impl Fn(&DeviceId) -> bool,
    ) -> bool {
        let said_at = self.said_at(now, response.timestamp);
        let Stop::Sent(sent) = &mut self.stop else { return false };
        // An acceptance says that something will be done, and without a name perhaps that a script will.
        let confirms = response.status == Status::Ok;
        let id = match &response.request_id {
            Some(id) if !sent.unconfirmed.contains_key(id) => return false,
            Some(id) => id.clone(),
            None => {
                let of_device = |(_, device): &(&RequestId, &DeviceId)| **device == response.device_id;
                let open = sent.unconfirmed.iter().find(of_device).map(|(id, _)| id.clone());
                let before = said_at < sent.at;
                let is_meant = confirms && may_be_for_a_stop(response) && !before;
                match open.filter(|_| is_meant && !open_on(&response.device_id)) {
                    Some(id) => id,
                    None => return false,
                }
            }
        };
        let busy = response.error.as_ref().filter(|error| error.code == ErrorCode::Busy);
        if let Some(error) = busy.filter(|_| response.status == Status::Failed) {
            sent.taken_over.get_or_insert_with(|| error.clone());
        }
        if confirms {
            sent.unconfirmed.remove(&id);
            if sent.unconfirmed.is_empty() {
                self.stop = Stop::Confirmed(sent.rest);
            }
        }
        true
    }
}

#[cfg(test)]
mod tests;
