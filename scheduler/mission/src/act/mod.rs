//! One act as a machine: it waits, is prepared, decided, committed, plays and is over.
//!
//! It is told what happened and returns what is to be done; it sends nothing, and nothing else changes what it knows. One
//! file a stage. It reads of the robots what the mission knows of them.

mod approaching;
mod drift;
mod elsewhere;
mod invariants;
mod member;
mod motions;
mod playing;
mod preparing;
mod resumed;
mod strayed;
#[cfg(test)]
mod tests;
pub(crate) mod timing;
mod waiting;

use std::sync::Arc;

use downbeat_plan::{Choreography, Way};
use urrcp::{ControlRequest, DeviceId, RequestId, Robot, Server, SessionId, Span, Timestamp};

use super::events::TakenReading;
use super::failure_kind::FailureKind;
use super::motion::Watched;
use super::robot_state::{Reading, RobotState};
use super::script::{Script, ScriptRef};
use super::{Outcome, Progress, Record};
use approaching::{Approach, Commitment};
use member::Part;
pub(crate) use member::{Member, members};
pub(crate) use playing::LAPSE;
pub(crate) use resumed::Reached;
pub(crate) use timing::Timing;

/// How far an act is.
#[derive(Clone, Debug)]
enum Stage {
    /// Its condition does not hold yet.
    Waiting(waiting::Waiting),
    /// It may be sent as soon as it fits.
    Ready {
        /// The instant at which it should start: the end of the act before, or the time that it waits for.
        target: Option<Timestamp<Server>>,
        /// When to look again whether it fits; `None`: whenever something has changed.
        look: Option<Timestamp<Server>>,
    },
    /// What it promises is being written down; requests go out once that is on the disk.
    Promised,
    /// Requests are out; the decision is due.
    Preparing(preparing::Preparing),
    /// All have accepted; the leases are brought near the start, and the commitment is due.
    Approaching(Approach),
    /// The leases reach over the start.
    Committed(Commitment),
    /// The start has passed.
    Playing(playing::Playing),
    /// It will not be committed, and another act still plays. Its robots drop it; once that act has ended, it is withdrawn.
    Lapsing(Outcome),
    /// No robot was left to play it before its commitment.
    Deserted,
    /// All has ended.
    Over,
}

/// The name of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Progressed {
    Waiting,
    Ready,
    Promised,
    Preparing,
    Approaching,
    Committed,
    Playing,
    Lapsing,
    Over,
}

/// What an act wants done.
#[derive(Clone, Debug)]
#[must_use]
pub(crate) enum ActAction {
    /// Read a sensor.
    Read { robot: usize, sensor: DeviceId, what: Reading },
    /// It has waited for too long: the mission goes this way instead.
    TimedOut(Way),
    /// Send this script's request.
    Send(ScriptRef),
    /// Send to every device of these robots what it has room for.
    Refill(Vec<usize>),
    /// Ask these robots what became of their scripts.
    Ask(Vec<usize>),
    /// These robots have failed.
    Fail(Vec<(usize, FailureKind)>),
    /// It cannot start: withdraw it.
    Withdraw(Outcome),
    /// Write this down.
    Record(Record),
    /// Tell the operator.
    Tell(Progress),
}

/// Requests that a robot is asked for together.
#[derive(Clone, Debug)]
pub(crate) struct NamedScripts {
    /// The pending lease that they have from then on, where that is shorter than theirs.
    pub(crate) lease: Option<Span>,
    /// When the lease ends at the latest, however late the question arrives, by the robot's own clock.
    pub(crate) until: Option<Timestamp<Robot>>,
    pub(crate) requests: Vec<RequestId>,
}

/// The effect of a question on the pending limits of the requests that it names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Question {
    Asks,
    /// The act approaches its start: the limits end at its brink.
    Shortens,
    /// The act is committed: the limits reach beyond its start.
    Extends,
}

/// One act under way.
#[derive(Clone, Debug)]
pub(crate) struct Act {
    number: u32,
    index: usize,
    choreography: Arc<Choreography>,
    stage: Stage,
    follow: Way,
    /// How often the act was withdrawn and prepared again.
    attempts: u32,
    /// The start that must be kept: the operator's, or that of the attempts before.
    fixed: Option<Timestamp<Server>>,
    since: Timestamp<Server>,
    /// The planned end of the act before it, if that still played when this one began to wait.
    before: Option<Timestamp<Server>>,
    /// When nothing before it plays any more.
    alone_since: Option<Timestamp<Server>>,
    /// When the mission began to try to reach its robots without a link, before it promises the act.
    links_tried: Option<Timestamp<Server>>,
    timing: Option<Timing>,
    members: Vec<Member>,
    /// For each robot of the mission, by its index, where it stands in `members`; those that come after the last member are left out.
    place: Vec<Option<usize>>,
    readings_asked: usize,
    readings: Vec<TakenReading>,
    /// The devices whose motions are verified, once the act is committed.
    watched: Vec<Watched>,
}

impl Act {
    /// The act of that index in the choreography, about to wait for its condition.
    pub(crate) fn new(
        choreography: Arc<Choreography>,
        index: usize,
        number: u32,
        robots: &[RobotState],
        since: Timestamp<Server>,
        before: Option<Timestamp<Server>>,
    ) -> Self {
        let members = members(&choreography.acts[index].plan, robots);
        Self {
            number,
            index,
            stage: Stage::Waiting(waiting::Waiting::default()),
            follow: choreography.acts[index].next,
            attempts: 0,
            fixed: None,
            since,
            before,
            alone_since: None,
            links_tried: None,
            timing: None,
            place: places(&members),
            members,
            readings_asked: 0,
            readings: Vec::new(),
            watched: Vec::new(),
            choreography,
        }
    }

    /// Counts the acts of the mission.
    pub(crate) const fn number(&self) -> u32 {
        self.number
    }

    /// Which act of the choreography it is.
    pub(crate) const fn index(&self) -> usize {
        self.index
    }

    /// What the scenario says of it.
    pub(crate) fn written(&self) -> &downbeat_plan::Act {
        &self.choreography.acts[self.index]
    }

    /// Its name as people know it.
    pub(crate) fn name(&self) -> String {
        act_name(&self.choreography, self.index)
    }

    /// Where the mission goes after it.
    pub(crate) const fn follow(&self) -> Way {
        self.follow
    }

    /// Since when it is the next one.
    pub(crate) const fn since(&self) -> Timestamp<Server> {
        self.since
    }

    /// When the mission began to try to reach its robots without a link; `None` if it has not.
    pub(crate) const fn links_tried(&self) -> Option<Timestamp<Server>> {
        self.links_tried
    }

    /// The mission tries to reach its robots without a link.
    pub(crate) const fn tries_links(&mut self, now: Timestamp<Server>) {
        self.links_tried = Some(now);
    }

    /// How often the act was withdrawn and prepared again.
    pub(crate) const fn attempts(&self) -> u32 {
        self.attempts
    }

    /// Sets the number of withdrawn attempts. The act no longer waits, because its condition has been met.
    pub(crate) fn is_attempted_again(&mut self, attempts: u32) {
        self.attempts = attempts;
        self.links_tried = None;
        self.stage = Stage::Ready { target: self.fixed, look: None };
    }

    /// Fixes its start. A start that would be too late is refused.
    pub(crate) const fn starts_at(&mut self, at: Timestamp<Server>) {
        self.fixed = Some(at);
    }

    /// The start that must be kept.
    pub(crate) const fn must_start_at(&self) -> Option<Timestamp<Server>> {
        self.fixed
    }

    /// Lets the act lapse: it is not committed, and its robots drop it when its leases end.
    pub(crate) fn is_not_started(&mut self, outcome: Outcome) {
        self.stage = Stage::Lapsing(outcome);
    }

    pub(crate) const fn is_lapsing(&self) -> bool {
        matches!(self.stage, Stage::Lapsing(_))
    }

    pub(crate) const fn timing(&self) -> Option<&Timing> {
        self.timing.as_ref()
    }

    pub(crate) fn members(&self) -> &[Member] {
        &self.members
    }

    pub(crate) fn readings(&self) -> &[TakenReading] {
        &self.readings
    }

    /// The members that still take part.
    pub(crate) fn present(&self) -> impl Iterator<Item = &Member> {
        self.members.iter().filter(|member| member.takes_part())
    }

    /// A robot's part in it, whether it still takes part or not.
    pub(crate) fn member(&self, robot: usize) -> Option<&Member> {
        self.place_of_member(robot).map(|place| &self.members[place])
    }

    /// The place of a robot that still takes part.
    pub(crate) fn place_of(&self, robot: usize) -> Option<usize> {
        self.place_of_member(robot).filter(|place| self.members[*place].takes_part())
    }

    /// The place of a robot, whether it still takes part or not.
    fn place_of_member(&self, robot: usize) -> Option<usize> {
        self.place.get(robot).copied().flatten()
    }

    pub(crate) fn script(&self, script: ScriptRef) -> &Script {
        &self.members[script.member].scripts()[script.script]
    }

    /// The index of the robot that plays a script.
    pub(crate) fn robot_of(&self, script: ScriptRef) -> usize {
        self.members[script.member].robot
    }

    /// Its requests may be sent: what it promises is on the disk.
    pub(crate) const fn is_open(&self) -> bool {
        matches!(
            self.stage,
            Stage::Preparing(_) | Stage::Approaching(_) | Stage::Committed(_) | Stage::Playing(_)
        )
    }

    /// Whether one of its robots may have something of it.
    pub(crate) const fn was_sent(&self) -> bool {
        self.timing.is_some()
    }

    /// Whether a script may be sent as far as those before it on its device are concerned. Its lease relies on the first one:
    /// where that is lost on the way, what follows it would begin without it and without the others.
    pub(crate) fn lets_follow(&self, member: usize, script: usize) -> bool {
        let uncommitted = matches!(self.stage, Stage::Preparing(_) | Stage::Approaching(_));
        !uncommitted || self.members[member].may_follow(script)
    }

    pub(crate) const fn is_committed(&self) -> bool {
        matches!(self.stage, Stage::Committed(_) | Stage::Playing(_) | Stage::Over)
    }

    pub(crate) const fn is_playing(&self) -> bool {
        matches!(self.stage, Stage::Playing(_))
    }

    pub(crate) const fn is_over(&self) -> bool {
        matches!(self.stage, Stage::Deserted | Stage::Over)
    }

    pub(crate) fn has_begun(&self) -> bool {
        self.members.iter().flat_map(Member::scripts).any(Script::has_begun)
    }

    /// A robot may have something of it that it has not spoken of.
    pub(crate) fn is_unaccounted(&self) -> bool {
        self.members.iter().flat_map(Member::scripts).any(Script::is_unaccounted)
    }

    /// Whether a robot that takes part has completed all its scripts.
    pub(crate) fn is_done_by_one(&self) -> bool {
        self.present().any(Member::is_done)
    }

    /// Whether a robot that takes part has refused a script or ended one before its last step.
    pub(crate) fn was_cut_short(&self) -> bool {
        self.present().flat_map(Member::scripts).any(|script| script.is_final() && !script.has_completed())
    }

    /// How far it is, to tell whether it went on.
    pub(crate) const fn progress(&self) -> Progressed {
        match self.stage {
            Stage::Waiting(_) => Progressed::Waiting,
            Stage::Ready { .. } => Progressed::Ready,
            Stage::Promised => Progressed::Promised,
            Stage::Preparing(_) => Progressed::Preparing,
            Stage::Approaching(_) => Progressed::Approaching,
            Stage::Committed(_) => Progressed::Committed,
            Stage::Playing(_) => Progressed::Playing,
            Stage::Lapsing(_) => Progressed::Lapsing,
            Stage::Deserted | Stage::Over => Progressed::Over,
        }
    }

    /// Nothing before it plays any more.
    pub(crate) fn comes_next(&mut self, now: Timestamp<Server>) {
        self.alone_since.get_or_insert(now);
        // It may have waited for room that the act before it has left without a word.
        self.look_again();
    }

    pub(crate) const fn is_alone(&self) -> bool {
        self.alone_since.is_some()
    }

    /// The mission goes elsewhere after it.
    pub(crate) fn lead_to(&mut self, way: Way) {
        self.follow = way;
    }

    /// A robot takes part no longer.
    pub(crate) fn drop_robot(&mut self, robot: usize) {
        if let Some(place) = self.place_of_member(robot) {
            self.members[place].part = Part::Dropped;
        }
        self.look_again();
    }

    /// If a robot is left out: the requests that it may have received before this process took the act up, without those whose
    /// fate it has reported.
    pub(crate) fn unheard_of(&self, robot: usize) -> Option<NamedScripts> {
        self.left_out_with(robot, Script::is_unheard_since_taken_up)
    }

    /// If a robot is left out: the requests whose fate it has not reported.
    pub(crate) fn owed_by(&self, robot: usize) -> Option<NamedScripts> {
        self.left_out_with(robot, Script::is_out)
    }

    fn left_out_with(&self, robot: usize, is_meant: impl Fn(&Script) -> bool) -> Option<NamedScripts> {
        let member = self.member(robot).filter(|member| !member.takes_part())?;
        let meant = member.scripts().iter().filter(|script| is_meant(script));
        let requests: Vec<_> = meant.filter_map(|script| script.request_id().cloned()).collect();
        (!requests.is_empty()).then_some(NamedScripts { lease: None, until: None, requests })
    }

    /// Robots have come; those that are there now take part, if nothing has been sent.
    pub(crate) fn gather(&mut self, robots: &[RobotState]) {
        if !self.was_sent() {
            self.members = members(&self.written().plan, robots);
            self.place = places(&self.members);
        }
    }

    /// Does what is due at `now`.
    pub(crate) fn advance(
        &mut self,
        now: Timestamp<Server>,
        robots: &[RobotState],
        options: &super::MissionOptions,
    ) -> Vec<ActAction> {
        let mut watched = self.watch_motions(now);
        let actions = match &self.stage {
            Stage::Waiting(_) => self.wait(now, robots, options),
            Stage::Ready { .. } => self.leave_if_deserted(),
            Stage::Promised => self.await_promise(now),
            Stage::Preparing(_) => self.decide_if_due(now, robots),
            Stage::Approaching(_) => self.approach(now, robots),
            Stage::Committed(_) => self.begin_if_due(now, robots),
            Stage::Playing(_) => self.watch(now, robots),
            Stage::Lapsing(outcome) if self.is_alone() => vec![ActAction::Withdraw(outcome.clone())],
            Stage::Lapsing(_) | Stage::Deserted | Stage::Over => Vec::new(),
        };
        if watched.is_empty() {
            return actions;
        }
        watched.extend(actions);
        watched
    }

    /// When [`Act::advance`] is next due; `None`: when something happens.
    pub(crate) fn wakeup(&self) -> Option<Timestamp<Server>> {
        let timing = self.timing.as_ref();
        match &self.stage {
            Stage::Waiting(waiting) => self.wait_wakeup(waiting),
            Stage::Ready { look, .. } => *look,
            Stage::Promised => timing.map(|timing| timing.decision),
            Stage::Preparing(preparing) => timing.map(|timing| preparing.wakeup(timing)),
            Stage::Approaching(approach) => Some(approach.wakeup()),
            Stage::Committed(commitment) => self.motion_due().into_iter().chain([commitment.wakeup()]).min(),
            Stage::Playing(playing) => {
                let due = self.reading_due().into_iter().chain(self.motion_due());
                due.chain([playing.wakeup(self.since)]).min()
            }
            Stage::Lapsing(_) | Stage::Deserted | Stage::Over => None,
        }
    }

    /// The record that it waits for is on the disk.
    pub(crate) fn recorded(&mut self) -> Vec<ActAction> {
        match &mut self.stage {
            Stage::Promised => self.open(),
            Stage::Approaching(approach) => {
                approach.recorded();
                Vec::new()
            }
            _ => Vec::new(),
        }
    }

    /// The request of a script, without its limit.
    pub(crate) fn request(&self, script: ScriptRef, session: Option<&SessionId>) -> Option<ControlRequest> {
        let timing = self.timing.as_ref()?;
        Some(preparing::request(timing, &self.members[script.member], script.script, session))
    }

    /// The limit of a script that is sent now. `ahead` is the time by which the robot's clock is ahead of the server's, if known.
    pub(crate) fn pending_until(&self, script: ScriptRef, ahead: Option<Span>) -> Option<Timestamp<Robot>> {
        let (timing, member) = (self.timing.as_ref()?, &self.members[script.member]);
        Some(if self.is_committed() {
            member.beyond_start(script.script, timing)
        } else {
            member.brink_of(script.script, timing, ahead)
        })
    }

    /// The requests that a robot may have, in the groups in which it is asked for them, each with the pending lease that
    /// the question carries: while the act approaches its start, one that ends before the script would begin. `ahead` is what
    /// the robot's clock is ahead of the server's, if that is known: all leases end at one instant, whatever a clock shows.
    pub(crate) fn names_of(
        &self,
        robot: usize,
        now: Timestamp<Server>,
        ahead: Option<Span>,
    ) -> Vec<NamedScripts> {
        let (Some(place), Some(timing)) = (self.place_of(robot), &self.timing) else { return Vec::new() };
        let question = match self.stage {
            Stage::Approaching(_) => Question::Shortens,
            Stage::Committed(_) | Stage::Playing(_) => Question::Extends,
            _ => Question::Asks,
        };
        self.members[place].names(timing, now, ahead, question)
    }

    /// Whether a robot may have a request of it.
    pub(crate) fn has_something_on(&self, robot: usize) -> bool {
        let place = self.place_of(robot).filter(|_| self.was_sent());
        place.is_some_and(|place| self.members[place].under_way().any(|(_, script)| script.is_unaccounted()))
    }

    /// Whether every message to a robot has to come behind a question that carries a lease.
    pub(crate) fn approaches(&self, robot: usize) -> bool {
        matches!(self.stage, Stage::Approaching(_)) && self.place_of(robot).is_some()
    }

    /// What a robot may have of it and could begin, with leases that end before that as while the act approaches its start;
    /// nothing once it is committed or those leases have ended. They end no earlier than they have to: a process that takes
    /// the act up may still commit it, and cannot lengthen them.
    pub(crate) fn to_withdraw(
        &self,
        robot: usize,
        now: Timestamp<Server>,
        ahead: Option<Span>,
    ) -> Vec<NamedScripts> {
        let uncommitted =
            matches!(self.stage, Stage::Preparing(_) | Stage::Approaching(_) | Stage::Lapsing(_));
        let Some(timing) = self.timing.as_ref().filter(|timing| uncommitted && now < timing.brink()) else {
            return Vec::new();
        };
        let Some(place) = self.place_of(robot) else { return Vec::new() };
        let mut named = self.members[place].names(timing, now, ahead, Question::Shortens);
        named.retain(|named| named.lease.is_some());
        named
    }

    /// Whether nothing may be sent to a robot now: it would carry its lease over a start that is not committed.
    pub(crate) fn hushes(&self, robot: usize, now: Timestamp<Server>) -> bool {
        let critical = self.timing.as_ref().is_some_and(|timing| now >= timing.critical());
        let undecided = match &self.stage {
            Stage::Preparing(_) => true,
            Stage::Approaching(approach) => !approach.asks_late(now),
            _ => false,
        };
        critical && undecided && self.place_of(robot).is_some()
    }

    /// When something that is due now may be sent, if its robots are about to start.
    pub(crate) fn out_of_quiet(&self, now: Timestamp<Server>) -> Timestamp<Server> {
        self.timing.as_ref().map_or(now, |timing| timing.out_of_quiet(now))
    }

    /// Whether a message that cannot wait may still go to a robot that is hushed, behind a question with a shorter lease.
    pub(crate) fn lets_through(&self, robot: usize, now: Timestamp<Server>) -> bool {
        let timing = self.timing.as_ref().filter(|timing| timing.lets_through(now));
        timing.is_some() && self.approaches(robot)
    }

    /// Something has changed that may let it go on.
    pub(crate) fn look_again(&mut self) {
        match &mut self.stage {
            Stage::Playing(playing) => playing.recheck(),
            Stage::Ready { look, .. } => *look = None,
            _ => {}
        }
    }
}

fn places(members: &[Member]) -> Vec<Option<usize>> {
    let mut places = vec![None; members.iter().map(|member| member.robot + 1).max().unwrap_or_default()];
    for (place, member) in members.iter().enumerate() {
        places[member.robot] = Some(place);
    }
    places
}

/// The name of an act as people know it.
pub(crate) fn act_name(choreography: &Choreography, act: usize) -> String {
    let act = &choreography.acts[act];
    if act.name.is_empty() { act.plan.scenario.clone() } else { act.name.clone() }
}
