//! The mission machine: greet, check, prepare an act, decide once, commit, watch, continue with the next act, stop, report.
//!
//! It takes events with their time and returns actions; it reads no clock and does no I/O, so the same machine runs a
//! real fleet (`downbeat-runtime`), a dry run (`downbeat-rehearsal`) and the fault simulation. Each act is a machine of its own
//! (`act/`): the mission passes it events, and performs the actions that it returns. `docs/mission.md` draws both.
//!
//! Events of one instant are handled in the order in which the driver hands them over; timers of that instant come last,
//! so that an answer that arrives just in time counts.

#![warn(clippy::too_many_lines)]

pub(crate) mod act;
mod again;
#[cfg(test)]
mod bench;
mod claim;
pub mod clock;
mod course;
pub mod drive;
mod events;
mod exchanges;
mod facts;
mod failure;
mod failure_kind;
mod failures;
mod fates;
#[cfg(feature = "metrics")]
pub mod figures;
mod greet;
mod identity;
mod invariants;
mod kept;
mod latency;
mod lateness;
mod lead;
mod leases;
mod ledger;
mod lines;
mod motion;
mod options;
mod outcome;
mod poses;
pub(crate) mod preflight;
mod prepare;
mod reads;
pub(crate) mod record;
mod refill_time;
pub mod report;
mod requests;
pub mod requirements;
mod resume;
pub(crate) mod robot_state;
mod rounds;
mod script;
mod seize;
pub mod session;
mod skew;
mod stop;
mod transfer;
pub mod zone;

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::sync::Arc;

use downbeat_plan::{Choreography, FirstUse, Plan};
use urrcp::{ControlError, DeviceId, ErrorCode, Message, RobotId, Server, Span, Timestamp};

pub use claim::Claim;
pub use downbeat_fleet::fleet::{ClockMode, MissionSettings, Requirement};
pub use events::{Action, Event, Loss, Progress, TakenReading};
pub use facts::{ActReport, ActRobot, DeviceReport, DeviceState};
pub use failure_kind::{Failure, FailureKind, Slow};
pub use fates::{ActCourse, ActFate};
pub use kept::{Fate, Kept, Left, LeftOn, Progressed, Stopping, Torn};
pub use latency::{LatencyDiffers, OtherLatency};
pub use lead::{LEAD_MARGIN_MIN, LeadTime};
pub use lines::{dated_line, ended_acts, line, sound, whole, whole_length};
pub use motion::{MotionReport, MotionSpread};
pub use options::{FixedStart, FixedStarts, Greeting, Join, MissionOptions, Participant};
pub use outcome::Outcome;
pub use preflight::{AfterFailure, Check, DeviceReading, NOT_STRICT, Preflight, PreflightRow, Verdict};
pub use record::{ActFlaws, ActOver, OutOfTolerance, Promise, PromisedScript, Record, StepsLate};
pub use resume::Changed;
pub use script::promised_name;
pub use skew::{RobotSkew, SkewBudget};
pub use transfer::{Destination, PlanTransfer, TransferReport};

use act::Act;
use clock::NtpState;
pub use requests::may_be_for_a_stop;
use robot_state::RobotState;
pub use robot_state::{Rest, Standing, Totals};

/// Where the mission stands. Timers of each phase are in its file.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Links, availability, initialization blocks, clocks, sensors.
    Greeting { deadline: Timestamp<Server> },
    /// Acts wait, are prepared, start and play.
    Performing,
    /// Cancels are out; confirmations are awaited.
    Stopping { deadline: Timestamp<Server>, resend: Timestamp<Server>, by: StoppedBy },
    /// The report is ready.
    Ended,
}

/// Who began a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StoppedBy {
    Operator,
    Failure,
}

/// Durable records on their way to the disk.
#[derive(Debug, Default)]
struct Recording {
    /// Durable records so far.
    count: u64,
    /// Those that an act waits for, or that measure the disk: which record, which act, and since when.
    awaited: VecDeque<(u64, Option<u32>, Timestamp<Server>)>,
    /// How long the slowest of the last ones took; `None` before the first.
    longest: Option<Span>,
}

/// One mission, from connecting to its report.
#[derive(Debug)]
pub struct Mission {
    choreography: Arc<Choreography>,
    options: MissionOptions,
    robots: Vec<RobotState>,
    /// The index of each robot of the first act, in the order of its plan.
    first_robots: Vec<Option<usize>>,
    /// For each robot: the first script of each device, from the first act on, and the largest speed of the device in that act.
    first_uses: Vec<BTreeMap<DeviceId, (FirstUse, Option<f64>)>>,
    phase: Phase,
    /// In order of their start; the last one may still wait.
    acts: Vec<Act>,
    acts_begun: u32,
    /// How many of them repeat an act that was withdrawn.
    acts_repeated: u32,
    /// Another act would have followed if `acts_max` had let it.
    bounded: bool,
    /// The act that a failure policy wants next.
    detour: Option<usize>,
    /// After a stop the mission goes on with this act.
    then: Option<usize>,
    /// The act that is planned after a stop.
    transfer: transfer::Transfer,
    /// The withdrawn act that is prepared again after the stop.
    again: Option<again::Again>,
    /// The act with the start that the operator fixes has been lined up.
    start_was_fixed: bool,
    /// The delay of this machine that acts allow for, as for a slower link: at least twice the delay of the last withdrawn act.
    hold_up: Span,
    /// How late this machine calls the mission.
    lateness: lateness::Lateness,
    next_round: Option<Timestamp<Server>>,
    /// Rounds that this machine was too late for.
    rounds_held_up: u64,
    /// When it is next looked whether a robot has been silent for too long.
    next_silence: Option<Timestamp<Server>>,
    /// When it is next looked whether a robot has not said which one it is.
    next_name: Option<Timestamp<Server>>,
    /// When stops were last sent.
    stopped_at: Option<Timestamp<Server>>,
    /// The earliest instant at which a lost robot is given up.
    give_up: Option<Timestamp<Server>>,
    /// Messages that must not be sent before an act is committed or withdrawn.
    deferred: Vec<(usize, Message)>,
    recording: Recording,
    /// What became of each act of the scenario.
    fates: Vec<ActCourse>,
    /// Whether robots may have moved in a mission that is withdrawn. Its acts are not in `fates`.
    moved_before: bool,
    /// Acts in a row without a robot left to play them.
    skipped: usize,
    /// Until when clocks are sampled further, and when next.
    sampling: Option<(Timestamp<Server>, Timestamp<Server>)>,
    preflight: Option<Preflight>,
    ntp: Option<NtpState>,
    outcome: Option<Outcome>,
    /// Why it was stopped, where neither its outcome nor a failure of a robot says so.
    because: Option<String>,
    /// How often the journal was removed or replaced while this process wrote it.
    journal_written_again: u64,
    /// Which operator has stopped it, where that is another than who began it.
    said_stop: Option<String>,
    /// Something failed on the way, whatever follows.
    flawed: Option<Outcome>,
    /// Set by the first act whose starts were too far apart or whose steps were too late.
    flaw_of_times: Option<Outcome>,
    reports: VecDeque<ActReport>,
    reports_omitted: usize,
    /// When the message arrived that is being handled.
    arrived: Timestamp<Server>,
    actions: Vec<Action>,
}

impl Mission {
    /// A mission of this choreography, beginning now.
    ///
    /// # Errors
    /// A robot of the choreography that has no participant.
    pub fn new(
        choreography: impl Into<Arc<Choreography>>,
        participants: Vec<Participant>,
        options: MissionOptions,
        now: Timestamp<Server>,
    ) -> Result<Self, MissingParticipant> {
        let choreography = choreography.into();
        let known: std::collections::HashSet<_> = participants.iter().map(|p| &p.id).collect();
        let planned = choreography.acts.iter().flat_map(|act| &act.plan.robots);
        if let Some(missing) = planned.map(|planned| &planned.robot).find(|id| !known.contains(id)) {
            return Err(MissingParticipant { robot: missing.clone() });
        }
        Ok(Self::with_robots(choreography, participants, options, now))
    }

    fn with_robots(
        choreography: Arc<Choreography>,
        participants: Vec<Participant>,
        options: MissionOptions,
        now: Timestamp<Server>,
    ) -> Self {
        let deadline = now + options.patience;
        let course = |index| ActCourse { act: act::act_name(&choreography, index), ..ActCourse::default() };
        let fates = (0..choreography.acts.len()).map(course).collect();
        let index_of: HashMap<_, _> =
            participants.iter().enumerate().map(|(index, participant)| (&participant.id, index)).collect();
        let first = choreography.acts.get(options.first_act).into_iter().flat_map(|act| &act.plan.robots);
        let first_robots = first.map(|planned| index_of.get(&planned.robot).copied()).collect();
        let first_uses = poses::first_uses(&choreography, options.first_act, &index_of);
        Self {
            choreography,
            options,
            robots: participants.into_iter().map(RobotState::new).collect(),
            first_robots,
            first_uses,
            phase: Phase::Greeting { deadline },
            acts: Vec::new(),
            acts_begun: 0,
            acts_repeated: 0,
            bounded: false,
            detour: None,
            then: None,
            transfer: transfer::Transfer::default(),
            again: None,
            start_was_fixed: false,
            hold_up: Span::ZERO,
            lateness: lateness::Lateness::new(now),
            next_round: None,
            rounds_held_up: 0,
            next_silence: None,
            next_name: None,
            stopped_at: None,
            give_up: None,
            deferred: Vec::new(),
            recording: Recording::default(),
            fates,
            moved_before: false,
            skipped: 0,
            sampling: None,
            preflight: None,
            ntp: None,
            outcome: None,
            because: None,
            journal_written_again: 0,
            said_stop: None,
            flawed: None,
            flaw_of_times: None,
            reports: VecDeque::new(),
            reports_omitted: 0,
            arrived: now,
            actions: Vec::new(),
        }
    }

    /// A mission of one act.
    ///
    /// # Errors
    /// As [`Mission::new`].
    pub fn of_plan(
        plan: Plan,
        participants: Vec<Participant>,
        options: MissionOptions,
        now: Timestamp<Server>,
    ) -> Result<Self, MissingParticipant> {
        Self::new(Choreography::of_plan(plan), participants, options, now)
    }

    /// Takes an event that happened at `now`. [`Mission::advance`] has to follow at the same instant, once no further event of
    /// that instant waits: what follows from the event may be decided there.
    #[must_use]
    pub fn handle(&mut self, now: Timestamp<Server>, event: Event) -> Vec<Action> {
        self.happened(now, now, event)
    }

    /// Takes at `now` an event that happened at `at`: a message may have waited on this machine. What is decided and sent
    /// depends on what time it is, what is measured on when it came. As after [`Mission::handle`], [`Mission::advance`] has to follow.
    #[must_use]
    pub fn happened(&mut self, at: Timestamp<Server>, now: Timestamp<Server>, event: Event) -> Vec<Action> {
        self.arrived = at;
        self.lateness.called(now);
        self.measure_disk(now);
        self.notice_hold_up(now);
        match event {
            Event::LinkUp { robot } => self.link_up(now, robot),
            Event::Proven { robot, until } => {
                self.robots[robot].proven = true;
                self.robots[robot].certified_until = until;
            }
            Event::LinkDown { robot, loss, reason } => self.link_down(now, robot, loss, reason),
            Event::Received { robot, message } => self.receive(now, robot, message),
            Event::Garbled { robot, reason } => self.fail(now, robot, FailureKind::Garbled { reason }),
            Event::StopRequested { rest, by } => self.request_stop(now, rest, by),
            Event::Go { act, by } => self.go(now, act.as_deref(), by),
            Event::ServerTime(state) => self.server_time(state),
            Event::Recorded { count } => self.recorded(now, count),
            Event::JournalWrittenAgain => {
                self.journal_written_again += 1;
                self.tell(Progress::JournalWrittenAgain);
            }
            Event::JournalLost { reason } => self.journal_lost(now, reason),
        }
        self.check(now);
        std::mem::take(&mut self.actions)
    }

    /// Does what is due at `now`, and what follows from the events before it. To be called after every [`Mission::handle`], and
    /// when [`Mission::next_wakeup`] has come.
    #[must_use]
    pub fn advance(&mut self, now: Timestamp<Server>) -> Vec<Action> {
        self.lateness.called(now);
        self.ask_names_again(now);
        self.other_processes_rest(now);
        match self.phase {
            Phase::Greeting { deadline } => {
                self.sample_clocks(now);
                if now >= deadline {
                    self.greeting_overdue(now);
                }
            }
            Phase::Performing => self.perform(now),
            Phase::Stopping { deadline, resend, .. } => {
                if now >= deadline {
                    self.stopped(now);
                } else if now >= resend {
                    self.stop_again(now);
                }
            }
            Phase::Ended => {}
        }
        self.lateness.asks(now, self.next_wakeup());
        self.check(now);
        std::mem::take(&mut self.actions)
    }

    /// When [`Mission::advance`] is next due; `None` once the mission has ended.
    #[must_use]
    pub fn next_wakeup(&self) -> Option<Timestamp<Server>> {
        let due = match self.phase {
            Phase::Greeting { deadline } => {
                let sample = self.sampling.map(|(_, next)| next);
                Some(sample.map_or(deadline, |next| next.min(deadline)).min(self.lateness.probe()))
            }
            Phase::Performing => {
                let acts = self.acts.iter().filter_map(Act::wakeup);
                acts.chain(self.give_up).chain(self.next_round).chain(self.next_silence).min()
            }
            Phase::Stopping { deadline, resend, .. } => Some(deadline.min(resend)),
            Phase::Ended => return None,
        };
        let elsewhere = self.robots.iter().filter_map(|robot| robot.elsewhere.flatten());
        due.into_iter().chain(self.next_name).chain(elsewhere).min()
    }

    /// The pending timers, for a trace.
    #[must_use]
    pub fn due(&self) -> String {
        let acts: Vec<_> = self.acts.iter().map(|act| (act.number(), act.wakeup())).collect();
        format!(
            "{:?}, acts {acts:?}, round {:?}, silence {:?}, give up {:?}",
            self.phase, self.next_round, self.next_silence, self.give_up
        )
    }

    /// The id of a robot by its index.
    #[must_use]
    pub fn robot_id(&self, robot: usize) -> &RobotId {
        &self.robots[robot].id
    }

    /// What it plays.
    #[must_use]
    pub fn choreography(&self) -> &Choreography {
        &self.choreography
    }

    /// How it ended; `None` before. [`crate::report::Report::of`] tells what really happened.
    #[must_use]
    pub fn outcome(&self) -> Option<&Outcome> {
        self.outcome.as_ref().filter(|_| self.phase == Phase::Ended)
    }

    /// How often the journal was removed or replaced while this process wrote it.
    pub(crate) const fn journal_written_again(&self) -> u64 {
        self.journal_written_again
    }

    /// Why it was stopped, where neither its outcome nor a failure of a robot says so.
    pub(crate) fn because(&self) -> Option<&str> {
        self.because.as_deref()
    }

    /// The outcome of the way home. `None` if no way home was requested.
    pub(crate) const fn home(&self) -> Option<&TransferReport> {
        self.transfer.home.as_ref()
    }

    pub(crate) const fn approach(&self) -> Option<&TransferReport> {
        self.transfer.approach.as_ref()
    }

    /// How many acts were to begin at most, where another would have followed.
    pub(crate) fn bound_reached(&self) -> Option<u32> {
        self.options.acts_max.filter(|_| self.bounded)
    }

    /// Limits the number of acts, unless the operator chose a limit.
    pub fn bound_acts(&mut self, acts: u32) {
        self.options.acts_max.get_or_insert(acts);
    }

    /// The operator leaves now, without waiting for anything.
    pub(crate) fn leave(&mut self, now: Timestamp<Server>) {
        self.close_all(now);
    }

    pub(crate) fn robots(&self) -> &[RobotState] {
        &self.robots
    }

    /// The ids of its robots, in order.
    pub fn robot_ids(&self) -> impl ExactSizeIterator<Item = &RobotId> {
        self.robots.iter().map(|robot| &robot.id)
    }

    /// For each robot: the devices that another process has moved and that have not been sent a stop. A mission that only stops
    /// robots first asks which robot it has reached.
    pub fn moved_by_another(&self) -> impl Iterator<Item = BTreeSet<DeviceId>> {
        let devices = |robot: &RobotState| {
            if robot.stop_was_sent() { BTreeSet::new() } else { robot.touched.clone() }
        };
        self.robots.iter().map(devices)
    }

    /// The reports of the acts that were sent, in order, and how many earlier ones are no longer kept.
    #[must_use]
    pub const fn act_reports(&self) -> (&VecDeque<ActReport>, usize) {
        (&self.reports, self.reports_omitted)
    }

    /// Every act of the scenario and what became of it, in order.
    #[must_use]
    pub fn fates(&self) -> &[ActCourse] {
        &self.fates
    }

    pub(crate) const fn preflight(&self) -> Option<&Preflight> {
        self.preflight.as_ref()
    }

    /// The choices of the operator.
    #[must_use]
    pub const fn options(&self) -> &MissionOptions {
        &self.options
    }

    /// Robots that follow NTP go on agreeing with each other whatever this machine's clock does; people are told.
    fn server_time(&mut self, state: NtpState) {
        let before = self.ntp.replace(state).and_then(|before| before.lost_since);
        match (before, state.lost_since) {
            (None, Some(since)) => self.tell(Progress::NtpLost { since }),
            (Some(_), None) => self.tell(Progress::NtpBack { offset_change: state.offset_change }),
            _ => {}
        }
    }

    pub(crate) const fn ntp(&self) -> Option<NtpState> {
        self.ntp
    }

    fn tell(&mut self, progress: Progress) {
        self.actions.push(Action::Tell(progress));
    }

    fn end(&mut self) {
        self.report_all_at_rest();
        self.phase = Phase::Ended;
        let outcome = self.outcome.clone().unwrap_or(Outcome::Failed);
        self.record(Record::Ended { outcome });
    }
}

/// The reason of a refusal, or a stand-in where the robot gave none.
fn error_of_status(error: Option<&ControlError>) -> ControlError {
    let without = || ControlError::new(ErrorCode::Internal, "the robot gave no reason");
    error.cloned().unwrap_or_else(without)
}

/// A robot of the choreography has no participant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("robot `{robot}` of the plan takes no part in the mission")]
pub struct MissingParticipant {
    /// The robot's id.
    pub robot: RobotId,
}

#[cfg(test)]
mod tests;
