//! One act as a state machine. The act waits, is prepared, decided and committed, plays, and is over.
//!
//! An act receives events and returns actions. It sends nothing itself, and only events change its state. Each stage has its own source
//! file. The mission passes the states of the robots to the act.

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
use super::robot_state::{Reading, Robots};
use super::script::{Script, ScriptRef};
use super::{Outcome, Progress, Record};
use crate::{ActIndex, ActNumber, IndexVec, MemberIndex, RobotIndex};
use approaching::{Approach, Commitment};
pub(crate) use member::{Member, Members, members};
use member::{Part, present};
pub(crate) use playing::{LAPSE, ReportTimes};
use preparing::await_promise;
pub(crate) use resumed::Reached;
pub(crate) use timing::Timing;

/// Stage of an act.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a mission has at most two acts under way")]
enum Stage {
    /// The act's condition does not hold yet.
    Waiting(waiting::Waiting),
    /// The act may be sent as soon as its time has come and the devices have room for it.
    Ready {
        /// The intended start: the end of the previous act, or the time that the act waits for.
        target: Option<Timestamp<Server>>,
        /// The time of the next check whether the act can be sent; `None` if only after the next change.
        look: Option<Timestamp<Server>>,
    },
    /// All robots of the act were left out before it was promised.
    Deserted,
    /// The act was promised to its robots.
    Promised(Promised),
}

/// An act that was promised, with its instants.
#[derive(Clone, Debug)]
struct Promised {
    timing: Timing,
    stage: PromisedStage,
}

/// Stage of an act that was promised.
#[derive(Clone, Debug)]
enum PromisedStage {
    /// The promise (a record of the scripts about to be sent) is being written. Requests are sent once it is on disk.
    Recording,
    /// The requests have been sent. The decision whether to start is pending.
    Preparing(preparing::Preparing),
    /// All robots have accepted. Their leases are shortened to end just before the start, and the commitment, which extends them beyond
    /// it, is pending.
    Approaching(Approach),
    /// The act is committed: the scheduler extends the leases of its robots beyond the start.
    Committed(Commitment),
    /// The start has passed.
    Playing(playing::Playing),
    /// The act will not be committed, but another act still plays. The robots drop this act by themselves. It is withdrawn once the other
    /// act has ended.
    Lapsing(Outcome),
    /// All robots of the act were left out before its commitment.
    Deserted,
    /// All scripts of the act have ended.
    Over,
}

/// Stage of an act, without the data of the stage.
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

/// An action that an act requests.
#[derive(Clone, Debug)]
#[must_use]
pub(crate) enum ActAction {
    /// Read a sensor.
    Read { robot: RobotIndex, sensor: DeviceId, what: Reading },
    /// The act has waited for too long. The mission continues with this [`Way`] instead.
    TimedOut(Way),
    /// Send the request of this script.
    Send(ScriptRef),
    /// For each of these robots: send every device as many scripts as it has room for.
    Refill(Vec<RobotIndex>),
    /// Ask these robots about the state of their scripts.
    Ask(Vec<RobotIndex>),
    /// These robots have failed.
    Fail(Vec<(RobotIndex, FailureKind)>),
    /// Withdraw the act, because it cannot start.
    Withdraw(Outcome),
    /// Write this record.
    Record(Record),
    /// Report this to the operator.
    Tell(Progress),
}

/// Requests of one robot that a single question asks about.
#[derive(Clone, Debug)]
pub(crate) struct NamedScripts {
    /// The pending lease (while scripts wait for their start) that the question sets; `None` if it does not shorten the requests' own
    /// leases.
    pub(crate) lease: Option<Span>,
    /// The latest time until which the scripts may wait for their start, by the robot's clock, however late the question arrives. `None`
    /// if the question does not change it.
    pub(crate) until: Option<Timestamp<Robot>>,
    pub(crate) requests: Vec<RequestId>,
}

/// How a question changes the pending limits of the requests that it names. A pending limit is the time until which a script may wait for
/// its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Question {
    Asks,
    /// The act approaches its start: the question makes the limits end at the brink, just before the start.
    Shortens,
    /// The act is committed: the question extends the limits beyond the start of the act.
    Extends,
}

/// For each robot of the mission: its index among the members of an act; `None` for a robot without a part.
type Places = IndexVec<RobotIndex, Option<MemberIndex>>;

/// One act under way.
#[derive(Clone, Debug)]
pub(crate) struct Act {
    number: ActNumber,
    index: ActIndex,
    choreography: Arc<Choreography>,
    stage: Stage,
    follow: Way,
    /// How often the act was withdrawn and prepared again.
    attempts: u32,
    /// The start that must be kept, because the operator fixed it or an earlier attempt had it; `None` if the start is not fixed.
    fixed: Option<Timestamp<Server>>,
    since: Timestamp<Server>,
    /// The planned end of the previous act, if that was still playing when this one began to wait.
    before: Option<Timestamp<Server>>,
    /// The time since which no earlier act has been playing; `None` while one plays.
    alone_since: Option<Timestamp<Server>>,
    /// The time at which the mission began to reconnect to robots of the act that have no link. It tries this before it promises the act
    /// to its robots.
    links_tried: Option<Timestamp<Server>>,
    members: Members,
    /// The index of each robot of the mission in `members`; `None` for a robot without a part. Robots after the last member are omitted.
    place: Places,
    readings_asked: usize,
    readings: Vec<TakenReading>,
    /// The devices whose movements are verified with sensors once the act is committed.
    watched: Vec<Watched>,
}

impl Stage {
    const fn timing(&self) -> Option<&Timing> {
        match self {
            Self::Promised(promised) => Some(&promised.timing),
            _ => None,
        }
    }

    const fn timing_mut(&mut self) -> Option<&mut Timing> {
        match self {
            Self::Promised(promised) => Some(&mut promised.timing),
            _ => None,
        }
    }

    /// The stage of an act that was promised; `None` before the promise.
    const fn promised(&self) -> Option<&PromisedStage> {
        match self {
            Self::Promised(promised) => Some(&promised.stage),
            _ => None,
        }
    }

    const fn promised_mut(&mut self) -> Option<&mut PromisedStage> {
        match self {
            Self::Promised(promised) => Some(&mut promised.stage),
            _ => None,
        }
    }
}

impl Act {
    /// Creates the act with this index in the choreography. It waits for its condition.
    pub(crate) fn new(
        choreography: Arc<Choreography>,
        index: ActIndex,
        number: ActNumber,
        robots: &Robots,
        since: Timestamp<Server>,
        before: Option<Timestamp<Server>>,
    ) -> Self {
        let members = members(&choreography.acts[index.get()].plan, robots);
        Self {
            number,
            index,
            stage: Stage::Waiting(waiting::Waiting::default()),
            follow: choreography.acts[index.get()].next,
            attempts: 0,
            fixed: None,
            since,
            before,
            alone_since: None,
            links_tried: None,
            place: places(&members),
            members,
            readings_asked: 0,
            readings: Vec::new(),
            watched: Vec::new(),
            choreography,
        }
    }

    /// Returns the act's number in the mission, starting at 0.
    pub(crate) const fn number(&self) -> ActNumber {
        self.number
    }

    /// Returns the act's index in the choreography.
    pub(crate) const fn index(&self) -> ActIndex {
        self.index
    }

    /// Returns the act's definition in the scenario.
    pub(crate) fn written(&self) -> &downbeat_plan::Act {
        &self.choreography.acts[self.index.get()]
    }

    /// Returns the act's name for users.
    pub(crate) fn name(&self) -> String {
        act_name(&self.choreography, self.index)
    }

    /// Returns how the mission continues after this act.
    pub(crate) const fn follow(&self) -> Way {
        self.follow
    }

    /// Returns the time at which this act became the next one to play.
    pub(crate) const fn since(&self) -> Timestamp<Server> {
        self.since
    }

    /// Returns the time at which the mission began to reconnect to robots of the act that have no link; `None` if it has not begun.
    pub(crate) const fn links_tried(&self) -> Option<Timestamp<Server>> {
        self.links_tried
    }

    /// Notes that the mission begins to reconnect to robots of the act that have no link.
    pub(crate) const fn tries_links(&mut self, now: Timestamp<Server>) {
        self.links_tried = Some(now);
    }

    /// Returns how often the act was withdrawn and prepared again.
    pub(crate) const fn attempts(&self) -> u32 {
        self.attempts
    }

    /// Sets the number of withdrawn attempts, and makes the act ready to be sent. The act does not wait again, because its condition has
    /// been met.
    pub(crate) fn is_attempted_again(&mut self, attempts: u32) {
        self.attempts = attempts;
        self.links_tried = None;
        self.stage = Stage::Ready { target: self.fixed, look: None };
    }

    /// Fixes the act's start. If this start can no longer be kept when the act is prepared, the mission refuses to start the act.
    pub(crate) const fn starts_at(&mut self, at: Timestamp<Server>) {
        self.fixed = Some(at);
    }

    /// Returns the start that must be kept; `None` if the start is not fixed.
    pub(crate) const fn must_start_at(&self) -> Option<Timestamp<Server>> {
        self.fixed
    }

    /// Lets the act lapse: it is not committed, and its robots drop it when its leases end.
    pub(crate) fn is_not_started(&mut self, outcome: Outcome) {
        self.enter(PromisedStage::Lapsing(outcome));
    }

    /// Moves an act that was promised to another stage.
    fn enter(&mut self, stage: PromisedStage) {
        if let Stage::Promised(promised) = &mut self.stage {
            promised.stage = stage;
        }
    }

    pub(crate) const fn is_lapsing(&self) -> bool {
        matches!(self.stage.promised(), Some(PromisedStage::Lapsing(_)))
    }

    /// Returns the instants of the act; `None` before the promise.
    pub(crate) const fn timing(&self) -> Option<&Timing> {
        self.stage.timing()
    }

    pub(crate) const fn members(&self) -> &Members {
        &self.members
    }

    pub(crate) fn readings(&self) -> &[TakenReading] {
        &self.readings
    }

    /// Returns the members that still take part.
    pub(crate) fn present(&self) -> impl Iterator<Item = &Member> {
        present(&self.members)
    }

    /// Returns the member for a robot, even if the robot no longer takes part.
    pub(crate) fn member(&self, robot: RobotIndex) -> Option<&Member> {
        self.place_of_member(robot).map(|place| &self.members[place])
    }

    /// Returns the index in `members` of a robot; `None` if the robot does not take part, or no longer.
    pub(crate) fn place_of(&self, robot: RobotIndex) -> Option<MemberIndex> {
        self.place_of_member(robot).filter(|place| self.members[*place].takes_part())
    }

    /// Returns the index in `members` of a robot, even if the robot no longer takes part.
    fn place_of_member(&self, robot: RobotIndex) -> Option<MemberIndex> {
        self.place.get(robot.get()).copied().flatten()
    }

    pub(crate) fn script(&self, script: ScriptRef) -> &Script {
        &self.members[script.member].scripts()[script.script]
    }

    /// Returns the index of the robot that plays a script.
    pub(crate) fn robot_of(&self, script: ScriptRef) -> RobotIndex {
        self.members[script.member].robot
    }

    /// Whether the act's requests may be sent: the promise of the act is on disk, and the act is not over.
    pub(crate) const fn is_open(&self) -> bool {
        use PromisedStage::{Approaching, Committed, Playing, Preparing};
        matches!(self.stage.promised(), Some(Preparing(_) | Approaching(_) | Committed(_) | Playing(_)))
    }

    /// Whether a robot may have received any request of the act.
    pub(crate) const fn was_sent(&self) -> bool {
        matches!(self.stage, Stage::Promised(_))
    }

    /// Whether a script may be sent now. Before the commitment, the device must have accepted its first script. If the first script were
    /// lost on the way, a later one could begin without it and without the other robots.
    pub(crate) fn lets_follow(&self, member: MemberIndex, script: usize) -> bool {
        use PromisedStage::{Approaching, Preparing};
        let uncommitted = matches!(self.stage.promised(), Some(Preparing(_) | Approaching(_)));
        !uncommitted || self.members[member].may_follow(script)
    }

    pub(crate) const fn is_committed(&self) -> bool {
        use PromisedStage::{Committed, Over, Playing};
        matches!(self.stage.promised(), Some(Committed(_) | Playing(_) | Over))
    }

    pub(crate) const fn is_playing(&self) -> bool {
        matches!(self.stage.promised(), Some(PromisedStage::Playing(_)))
    }

    pub(crate) const fn is_over(&self) -> bool {
        use PromisedStage::{Deserted, Over};
        matches!(self.stage, Stage::Deserted) || matches!(self.stage.promised(), Some(Deserted | Over))
    }

    pub(crate) fn has_begun(&self) -> bool {
        self.members.iter().flat_map(Member::scripts).any(Script::has_begun)
    }

    /// Whether any robot may hold a script of this act, or have run it, without having reported the outcome.
    pub(crate) fn is_unaccounted(&self) -> bool {
        self.members.iter().flat_map(Member::scripts).any(Script::is_unaccounted)
    }

    /// Whether at least one robot that takes part has completed all its scripts.
    pub(crate) fn is_done_by_one(&self) -> bool {
        self.present().any(Member::is_done)
    }

    /// Whether a robot that takes part has refused a script or ended one before its last step.
    pub(crate) fn was_cut_short(&self) -> bool {
        self.present().flat_map(Member::scripts).any(|script| script.is_final() && !script.has_completed())
    }

    /// Returns the act's stage without its data, so that callers can detect progress.
    pub(crate) const fn progress(&self) -> Progressed {
        match &self.stage {
            Stage::Waiting(_) => Progressed::Waiting,
            Stage::Ready { .. } => Progressed::Ready,
            Stage::Deserted => Progressed::Over,
            Stage::Promised(promised) => match promised.stage {
                PromisedStage::Recording => Progressed::Promised,
                PromisedStage::Preparing(_) => Progressed::Preparing,
                PromisedStage::Approaching(_) => Progressed::Approaching,
                PromisedStage::Committed(_) => Progressed::Committed,
                PromisedStage::Playing(_) => Progressed::Playing,
                PromisedStage::Lapsing(_) => Progressed::Lapsing,
                PromisedStage::Deserted | PromisedStage::Over => Progressed::Over,
            },
        }
    }

    /// Notes that all earlier acts have ended.
    pub(crate) fn comes_next(&mut self, now: Timestamp<Server>) {
        self.alone_since.get_or_insert(now);
        // The act may have waited for room that the previous act has freed without notice.
        self.look_again();
    }

    pub(crate) const fn is_alone(&self) -> bool {
        self.alone_since.is_some()
    }

    /// Changes how the mission continues after this act.
    pub(crate) fn lead_to(&mut self, way: Way) {
        self.follow = way;
    }

    /// Removes a robot from the act.
    pub(crate) fn drop_robot(&mut self, robot: RobotIndex) {
        if let Some(place) = self.place_of_member(robot) {
            self.members[place].part = Part::Dropped;
        }
        self.look_again();
    }

    /// For a robot that is left out, returns the requests that it may have received before this process took over the act. Requests whose
    /// fate the robot has reported are excluded. `None` if none remain.
    pub(crate) fn unheard_of(&self, robot: RobotIndex) -> Option<NamedScripts> {
        self.left_out_with(robot, Script::is_unheard_since_taken_up)
    }

    /// For a robot that is left out, returns the requests whose fate it has not reported; `None` if there are none.
    pub(crate) fn owed_by(&self, robot: RobotIndex) -> Option<NamedScripts> {
        self.left_out_with(robot, Script::is_out)
    }

    fn left_out_with(&self, robot: RobotIndex, is_meant: impl Fn(&Script) -> bool) -> Option<NamedScripts> {
        let member = self.member(robot).filter(|member| !member.takes_part())?;
        let meant = member.scripts().iter().filter(|script| is_meant(script));
        let requests: Vec<_> = meant.filter_map(|script| script.request_id().cloned()).collect();
        (!requests.is_empty()).then_some(NamedScripts { lease: None, until: None, requests })
    }

    /// Adds robots that have joined the mission meanwhile, unless the act has already been sent.
    pub(crate) fn gather(&mut self, robots: &Robots) {
        if !self.was_sent() {
            self.members = members(&self.written().plan, robots);
            self.place = places(&self.members);
        }
    }

    /// Performs everything that is due at `now`.
    pub(crate) fn advance(
        &mut self,
        now: Timestamp<Server>,
        robots: &Robots,
        options: &super::MissionOptions,
    ) -> Vec<ActAction> {
        let mut watched = self.watch_motions(now);
        let actions = match &self.stage {
            Stage::Waiting(_) => self.wait(now, robots, options),
            Stage::Ready { .. } => self.leave_if_deserted(),
            Stage::Deserted => Vec::new(),
            Stage::Promised(Promised { timing, stage }) => match stage {
                PromisedStage::Recording => await_promise(now, timing),
                PromisedStage::Preparing(_) => self.decide_if_due(now, robots),
                PromisedStage::Approaching(_) => self.approach(now, robots),
                PromisedStage::Committed(_) => self.begin_if_due(now, robots),
                PromisedStage::Playing(_) => self.watch(now, robots),
                PromisedStage::Lapsing(outcome) if self.is_alone() => {
                    vec![ActAction::Withdraw(outcome.clone())]
                }
                PromisedStage::Lapsing(_) | PromisedStage::Deserted | PromisedStage::Over => Vec::new(),
            },
        };
        if watched.is_empty() {
            return actions;
        }
        watched.extend(actions);
        watched
    }

    /// Returns the time at which [`Act::advance`] is next due; `None` if only after the next event.
    pub(crate) fn wakeup(&self) -> Option<Timestamp<Server>> {
        match &self.stage {
            Stage::Waiting(waiting) => self.wait_wakeup(waiting),
            Stage::Ready { look, .. } => *look,
            Stage::Deserted => None,
            Stage::Promised(Promised { timing, stage }) => match stage {
                PromisedStage::Recording => Some(timing.decision),
                PromisedStage::Preparing(preparing) => Some(preparing.wakeup(timing)),
                PromisedStage::Approaching(approach) => Some(approach.wakeup()),
                PromisedStage::Committed(commitment) => {
                    self.motion_due().into_iter().chain([commitment.wakeup()]).min()
                }
                PromisedStage::Playing(playing) => {
                    let due = self.reading_due().into_iter().chain(self.motion_due());
                    due.chain([playing.wakeup(self.since)]).min()
                }
                PromisedStage::Lapsing(_) | PromisedStage::Deserted | PromisedStage::Over => None,
            },
        }
    }

    /// Notes that the record for which the act waits is on disk.
    pub(crate) fn recorded(&mut self) -> Vec<ActAction> {
        match self.stage.promised_mut() {
            Some(PromisedStage::Recording) => self.open(),
            Some(PromisedStage::Approaching(approach)) => {
                approach.recorded();
                Vec::new()
            }
            _ => Vec::new(),
        }
    }

    /// Returns the request that carries a script, without its time limit `pending_until`.
    pub(crate) fn request(&self, script: ScriptRef, session: Option<&SessionId>) -> Option<ControlRequest> {
        let timing = self.timing()?;
        Some(preparing::request(timing, &self.members[script.member], script.script, session))
    }

    /// Returns the limit `pending_until` of a script that is sent now: the latest time until which it may wait for its start. `ahead` is
    /// how far the robot's clock is ahead of the server's, if known.
    pub(crate) fn pending_until(&self, script: ScriptRef, ahead: Option<Span>) -> Option<Timestamp<Robot>> {
        let (timing, member) = (self.timing()?, &self.members[script.member]);
        Some(if self.is_committed() {
            member.beyond_start(script.script, timing)
        } else {
            member.brink_of(script.script, timing, ahead)
        })
    }

    /// Returns the requests that a robot may hold, in one group per question, each with the pending lease that the question sets. While
    /// the act approaches its start, this lease ends before the script would begin. `ahead` is how far the robot's clock is ahead of the
    /// server's, if known. All leases end at the same instant, whatever a clock shows.
    pub(crate) fn names_of(
        &self,
        robot: RobotIndex,
        now: Timestamp<Server>,
        ahead: Option<Span>,
    ) -> Vec<NamedScripts> {
        let (Some(place), Some(timing)) = (self.place_of(robot), self.timing()) else { return Vec::new() };
        let question = match self.stage.promised() {
            Some(PromisedStage::Approaching(_)) => Question::Shortens,
            Some(PromisedStage::Committed(_) | PromisedStage::Playing(_)) => Question::Extends,
            _ => Question::Asks,
        };
        self.members[place].names(timing, now, ahead, question)
    }

    /// Whether a robot may hold a request of this act.
    pub(crate) fn has_something_on(&self, robot: RobotIndex) -> bool {
        let place = self.place_of(robot).filter(|_| self.was_sent());
        place.is_some_and(|place| self.members[place].under_way().any(|(_, script)| script.is_unaccounted()))
    }

    /// Whether the act approaches its start and includes this robot. Every message to the robot must then follow a question that sets a
    /// lease.
    pub(crate) fn approaches(&self, robot: RobotIndex) -> bool {
        matches!(self.stage.promised(), Some(PromisedStage::Approaching(_))) && self.place_of(robot).is_some()
    }

    /// Returns the requests of this act that a robot may hold and could begin, with leases that end before the start. Empty once the act
    /// is committed or those leases have ended. The leases end no earlier than necessary. A process that takes over the act may still
    /// commit it, but cannot extend them.
    pub(crate) fn to_withdraw(
        &self,
        robot: RobotIndex,
        now: Timestamp<Server>,
        ahead: Option<Span>,
    ) -> Vec<NamedScripts> {
        use PromisedStage::{Approaching, Lapsing, Preparing};
        let Stage::Promised(Promised { timing, stage: Preparing(_) | Approaching(_) | Lapsing(_) }) =
            &self.stage
        else {
            return Vec::new();
        };
        if now >= timing.brink() {
            return Vec::new();
        }
        let Some(place) = self.place_of(robot) else { return Vec::new() };
        let mut named = self.members[place].names(timing, now, ahead, Question::Shortens);
        named.retain(|named| named.lease.is_some());
        named
    }

    /// Whether messages to a robot must wait, because they would extend its lease beyond a start that is not committed.
    pub(crate) fn holds_messages_to(&self, robot: RobotIndex, now: Timestamp<Server>) -> bool {
        let Stage::Promised(Promised { timing, stage }) = &self.stage else { return false };
        let undecided = match stage {
            PromisedStage::Preparing(_) => true,
            PromisedStage::Approaching(approach) => !approach.asks_late(now),
            _ => false,
        };
        now >= timing.critical() && undecided && self.place_of(robot).is_some()
    }

    /// Returns the earliest time to send a message that is due at `now`: later than `now` during the quiet period around the start.
    pub(crate) fn out_of_quiet(&self, now: Timestamp<Server>) -> Timestamp<Server> {
        self.timing().map_or(now, |timing| timing.out_of_quiet(now))
    }

    /// Whether an urgent message may be sent to a robot although other messages to it must wait. It follows a question that shortens the
    /// robot's lease.
    pub(crate) fn lets_through(&self, robot: RobotIndex, now: Timestamp<Server>) -> bool {
        self.timing().is_some_and(|timing| timing.lets_through(now)) && self.approaches(robot)
    }

    /// Notes that something has changed, so that the act checks again whether it can continue.
    pub(crate) fn look_again(&mut self) {
        match &mut self.stage {
            Stage::Promised(Promised { stage: PromisedStage::Playing(playing), .. }) => playing.recheck(),
            Stage::Ready { look, .. } => *look = None,
            _ => {}
        }
    }
}

fn places(members: &Members) -> Places {
    let robots = members.iter().map(|member| member.robot.get() + 1).max().unwrap_or_default();
    let mut places = Places::from(vec![None; robots]);
    for (place, member) in members.enumerated() {
        places[member.robot] = Some(place);
    }
    places
}

/// Returns the name of an act for users.
pub(crate) fn act_name(choreography: &Choreography, act: ActIndex) -> String {
    let act = &choreography.acts[act.get()];
    if act.name.is_empty() { act.plan.scenario.clone() } else { act.name.clone() }
}
