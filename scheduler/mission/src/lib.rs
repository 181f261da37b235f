//! The state machine of a mission: greet, check, prepare an act, decide once, commit, watch, continue with the next act, stop, report.
//!
//! The machine takes events with their time and returns actions. It reads no clock and does no I/O, so the same machine runs a real fleet
//! (`downbeat-runtime`), a dry run (`downbeat-rehearsal`) and the fault simulation. Each act is a machine of its own (`act/`): the
//! mission passes it events, and performs the actions that it returns. `docs/mission.md` draws both.
//!
//! Events of one instant are handled in the order in which the driver passes them. Timers of that instant come last, so an answer that
//! arrives just in time is accepted.

#![warn(clippy::mod_module_files, clippy::too_many_lines)]

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
mod index;
mod invariants;
mod kept;
mod latency;
mod lateness;
mod lead;
mod leases;
mod ledger;
mod lines;
mod motion;
mod open_requests;
mod options;
mod outcome;
mod poses;
pub(crate) mod preflight;
mod prepare;
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

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::sync::Arc;

use downbeat_plan::{Choreography, Plan};
use urrcp::{ControlError, DeviceId, ErrorCode, RobotId, Server, Timestamp};

pub use claim::Claim;
pub use downbeat_fleet::fleet::{ClockMode, MissionSettings, Requirement};
pub use events::{Action, Event, Loss, Progress, TakenReading};
pub use facts::{ActReport, ActRobot, DeviceReport, DeviceState};
pub use failure_kind::{Failure, FailureKind, Slow};
pub use fates::{ActCourse, ActFate};
pub use index::{ActIndex, ActNumber, IndexVec, MemberIndex, RobotIndex};
pub use kept::{Fate, Kept, Left, LeftOn, Progressed, Stopping, Torn};
pub use latency::{LatencyDiffers, OtherLatency};
pub use lead::{LEAD_MARGIN_MIN, LeadTime};
pub use lines::{dated_line, ended_acts, line, sound, whole, whole_length};
pub use motion::{MotionReport, MotionSpread};
pub use options::{FixedStart, FixedStarts, Greeting, Join, MissionOptions, Participant};
pub use outcome::{Cause, Outcome};
pub use preflight::{AfterFailure, Check, DeviceReading, NOT_STRICT, Preflight, PreflightRow, Verdict};
pub use record::{ActFlaws, ActOver, OutOfTolerance, Promise, PromisedScript, Record, StepsLate};
pub use resume::Changed;
pub use script::promised_name;
pub use skew::{RobotSkew, SkewBudget};
pub use transfer::{Destination, PlanTransfer, TransferReport};

use act::Act;
use clock::NtpState;
pub use requests::may_be_for_a_stop;
pub use robot_state::{Rest, Standing, Totals};
use robot_state::{RobotState, Robots};

/// Phase of the mission. Each phase has a source file that handles its timers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// The mission greets the robots: links, availability, initialization blocks, clocks, sensors.
    Greeting { deadline: Timestamp<Server> },
    /// Acts wait, are prepared, start and play.
    Performing,
    /// Stops are sent; their confirmations are pending.
    Stopping { deadline: Timestamp<Server>, resend: Timestamp<Server>, by: StoppedBy },
    /// The mission has ended, and its report is ready.
    Ended,
}

/// What triggered a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StoppedBy {
    Operator,
    Failure,
}

/// One mission, from connecting to its report.
#[derive(Debug)]
pub struct Mission {
    choreography: Arc<Choreography>,
    options: MissionOptions,
    robots: Robots,
    phase: Phase,
    /// The acts under way, in order of their start; the last one may still wait.
    acts: Vec<Act>,
    course: course::Course,
    /// The state of the act that is planned after a stop and moves devices to their next or default positions.
    transfer: transfer::Transfer,
    /// The withdrawn act that is prepared again after the stop.
    again: Option<again::Again>,
    greeting: greet::FirstChecks,
    machine: lateness::Machine,
    timers: rounds::Timers,
    recording: requests::Recording,
    conclusion: outcome::Conclusion,
    outbox: requests::Outbox,
}

impl Mission {
    /// A mission that plays this choreography and begins now.
    ///
    /// # Errors
    /// Fails if a robot of the choreography has no participant.
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
        let course = |index| ActCourse {
            act: act::act_name(&choreography, ActIndex::new(index)),
            ..ActCourse::default()
        };
        let fates = (0..choreography.acts.len()).map(course).collect();
        let index_of: HashMap<_, _> = participants
            .iter()
            .enumerate()
            .map(|(index, participant)| (&participant.id, RobotIndex::new(index)))
            .collect();
        let first =
            choreography.acts.get(options.first_act.get()).into_iter().flat_map(|act| &act.plan.robots);
        let first_robots = first.map(|planned| index_of.get(&planned.robot).copied()).collect();
        let first_uses = poses::first_uses(&choreography, options.first_act, &index_of);
        Self {
            choreography,
            options,
            robots: participants.into_iter().map(RobotState::new).collect(),
            phase: Phase::Greeting { deadline },
            acts: Vec::new(),
            course: course::Course::new(fates),
            transfer: transfer::Transfer::default(),
            again: None,
            greeting: greet::FirstChecks { first_robots, first_uses, sampling: None, preflight: None },
            machine: lateness::Machine::new(now),
            timers: rounds::Timers::default(),
            recording: requests::Recording::default(),
            conclusion: outcome::Conclusion::default(),
            outbox: requests::Outbox::new(now),
        }
    }

    /// A mission that plays a single act.
    ///
    /// # Errors
    /// Fails if a robot of the plan has no participant.
    pub fn of_plan(
        plan: Plan,
        participants: Vec<Participant>,
        options: MissionOptions,
        now: Timestamp<Server>,
    ) -> Result<Self, MissingParticipant> {
        Self::new(Choreography::of_plan(plan), participants, options, now)
    }

    /// Processes an event that happened at `now`. After the last event of an instant, the caller must call [`Mission::advance`] for the
    /// same instant, which may decide the consequences of the events.
    #[must_use]
    pub fn handle(&mut self, now: Timestamp<Server>, event: Event) -> Vec<Action> {
        self.happened(now, now, event)
    }

    /// Processes at `now` an event that happened earlier, at `at`: a message may have waited on this machine. Decisions and sends depend
    /// on `now`, measurements on `at`. The caller must then call [`Mission::advance`], as after [`Mission::handle`].
    #[must_use]
    pub fn happened(&mut self, at: Timestamp<Server>, now: Timestamp<Server>, event: Event) -> Vec<Action> {
        self.outbox.arrived = at;
        self.machine.lateness.called(now);
        self.measure_disk(now);
        self.notice_hold_up(now);
        match event {
            Event::LinkUp { robot } => self.link_up(now, robot),
            Event::Proven { robot, until, is_of_replaced_authority } => {
                let robot = &mut self.robots[robot];
                robot.identity.proven = true;
                robot.identity.certified_until = until;
                robot.identity.is_of_replaced_authority = is_of_replaced_authority;
            }
            Event::LinkDown { robot, loss, reason } => self.link_down(now, robot, loss, reason),
            Event::Received { robot, message } => self.receive(now, robot, message),
            Event::Garbled { robot, reason } => self.fail(now, robot, FailureKind::Garbled { reason }),
            Event::StopRequested { rest, by } => self.request_stop(now, rest, by),
            Event::Go { act, by } => self.go(now, act.as_deref(), by),
            Event::ServerTime(state) => self.server_time(state),
            Event::Recorded { count } => self.recorded(now, count),
            Event::JournalWrittenAgain => {
                self.recording.written_again += 1;
                self.tell(Progress::JournalWrittenAgain);
            }
            Event::JournalLost { reason } => self.journal_lost(now, reason),
        }
        self.check(now);
        std::mem::take(&mut self.outbox.actions)
    }

    /// Performs everything that is due at `now`, and handles the consequences of earlier events. Must be called
    /// after every [`Mission::handle`], and at [`Mission::next_wakeup`].
    #[must_use]
    pub fn advance(&mut self, now: Timestamp<Server>) -> Vec<Action> {
        self.machine.lateness.called(now);
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
        self.machine.lateness.asks(now, self.next_wakeup());
        self.check(now);
        self.check_timers(now);
        std::mem::take(&mut self.outbox.actions)
    }

    /// When [`Mission::advance`] is next due; `None` once the mission has ended.
    #[must_use]
    pub fn next_wakeup(&self) -> Option<Timestamp<Server>> {
        let due = match self.phase {
            Phase::Greeting { deadline } => {
                let sample = self.greeting.sampling.map(|(_, next)| next);
                Some(sample.map_or(deadline, |next| next.min(deadline)).min(self.machine.lateness.probe()))
            }
            Phase::Performing => {
                let acts = self.acts.iter().filter_map(Act::wakeup);
                acts.chain(self.timers.give_up)
                    .chain(self.timers.next_round)
                    .chain(self.timers.next_silence)
                    .min()
            }
            Phase::Stopping { deadline, resend, .. } => Some(deadline.min(resend)),
            Phase::Ended => return None,
        };
        let elsewhere = self.robots.iter().filter_map(|robot| robot.halt.elsewhere.flatten());
        due.into_iter().chain(self.timers.next_name).chain(elsewhere).min()
    }

    /// The pending timers, as text for a trace.
    #[must_use]
    pub fn due(&self) -> String {
        let acts: Vec<_> = self.acts.iter().map(|act| (act.number(), act.wakeup())).collect();
        format!(
            "{:?}, acts {acts:?}, round {:?}, silence {:?}, give up {:?}",
            self.phase, self.timers.next_round, self.timers.next_silence, self.timers.give_up
        )
    }

    /// The id of a robot by its index.
    #[must_use]
    pub fn robot_id(&self, robot: RobotIndex) -> &RobotId {
        &self.robots[robot].id
    }

    /// The choreography that the mission plays.
    #[must_use]
    pub fn choreography(&self) -> &Choreography {
        &self.choreography
    }

    /// The final outcome; `None` before the end. [`crate::report::Report::of`] returns the complete report.
    #[must_use]
    pub fn outcome(&self) -> Option<&Outcome> {
        self.conclusion.outcome.as_ref().filter(|_| self.phase == Phase::Ended)
    }

    /// How often the journal was removed or replaced while this process was writing it.
    pub(crate) const fn journal_written_again(&self) -> u64 {
        self.recording.written_again
    }

    /// The reason for the stop, if neither the outcome nor a failure of a robot states it.
    pub(crate) fn because(&self) -> Option<&str> {
        self.conclusion.because.as_deref()
    }

    /// The outcome of the move to the default positions. `None` if no move home was requested.
    pub(crate) const fn home(&self) -> Option<&TransferReport> {
        self.transfer.home.as_ref()
    }

    pub(crate) const fn approach(&self) -> Option<&TransferReport> {
        self.transfer.approach.as_ref()
    }

    /// The maximum number of acts, if this limit prevented a further act.
    pub(crate) fn bound_reached(&self) -> Option<u32> {
        self.options.acts_max.filter(|_| self.course.bounded)
    }

    /// Limits the number of acts, unless the operator chose a limit.
    pub fn bound_acts(&mut self, acts: u32) {
        self.options.acts_max.get_or_insert(acts);
    }

    /// Closes the mission at once, without waiting for anything: the operator leaves.
    pub(crate) fn leave(&mut self, now: Timestamp<Server>) {
        self.close_all(now);
    }

    pub(crate) const fn robots(&self) -> &Robots {
        &self.robots
    }

    /// The ids of the mission's robots, in order.
    pub fn robot_ids(&self) -> impl ExactSizeIterator<Item = &RobotId> {
        self.robots.iter().map(|robot| &robot.id)
    }

    /// For each robot: the devices that another process has moved. Empty if this mission already stops the robot, because it first asks
    /// which robot answers on the link.
    pub fn moved_by_another(&self) -> impl Iterator<Item = BTreeSet<DeviceId>> {
        let devices = |robot: &RobotState| {
            if robot.stop_was_sent() { BTreeSet::new() } else { robot.halt.touched.clone() }
        };
        self.robots.iter().map(devices)
    }

    /// The reports of the acts that were sent, in order, and the number of earlier reports that are no longer kept.
    #[must_use]
    pub const fn act_reports(&self) -> (&VecDeque<ActReport>, usize) {
        (&self.course.reports, self.course.reports_omitted)
    }

    /// The fate of every act of the scenario, in order.
    #[must_use]
    pub fn fates(&self) -> &[ActCourse] {
        &self.course.fates
    }

    pub(crate) const fn preflight(&self) -> Option<&Preflight> {
        self.greeting.preflight.as_ref()
    }

    /// The options of the mission, as the operator chose them.
    #[must_use]
    pub const fn options(&self) -> &MissionOptions {
        &self.options
    }

    /// Reports that this machine has lost or regained NTP. Robots that follow NTP stay in sync with each other, whatever the clock of
    /// this machine does.
    fn server_time(&mut self, state: NtpState) {
        let before = self.machine.ntp.replace(state).and_then(|before| before.lost_since);
        match (before, state.lost_since) {
            (None, Some(since)) => self.tell(Progress::NtpLost { since }),
            (Some(_), None) => self.tell(Progress::NtpBack { offset_change: state.offset_change }),
            _ => {}
        }
    }

    pub(crate) const fn ntp(&self) -> Option<NtpState> {
        self.machine.ntp
    }

    fn tell(&mut self, progress: Progress) {
        self.outbox.actions.push(Action::Tell(progress));
    }

    fn end(&mut self) {
        self.report_all_at_rest();
        self.phase = Phase::Ended;
        let outcome = self.conclusion.outcome.clone().unwrap_or(Outcome::Failed);
        self.record(Record::Ended { outcome });
    }
}

/// The error in a robot's refusal, or a default error if the robot gave none.
fn error_of_status(error: Option<&ControlError>) -> ControlError {
    let without = || ControlError::new(ErrorCode::Internal, "the robot gave no reason");
    error.cloned().unwrap_or_else(without)
}

/// Error: a robot of the choreography has no participant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("robot `{robot}` of the plan is not part of the mission")]
pub struct MissingParticipant {
    /// The robot's id.
    pub robot: RobotId,
}

#[cfg(test)]
mod tests;
