//! The mission machine: greet, check, prepare an act, decide once, commit, watch, go on to the next act, stop, report.
//!
//! It takes events with their time and returns actions; it reads no clock and does no I/O, so the same machine runs a
//! real fleet (`run/`), a dry run (`dry_run/`) and the fault simulation (`simulation/`). One file a concern; the state
//! machine is drawn in `docs/mission.md`.
//!
//! Events of one instant are handled in the order in which the driver hands them over; timers of that instant come last,
//! so that an answer that arrives just in time counts.

pub(crate) mod act;
mod commit;
mod events;
mod failure;
mod greet;
mod lead;
mod options;
pub(crate) mod preflight;
mod prepare;
pub(crate) mod record;
mod resume;
pub(crate) mod robot_state;
mod skew;
mod stop;
mod wait;
mod watch;

use std::collections::VecDeque;
use std::sync::Arc;

use downbeat_scripts::{Choreography, Plan, Way};
use urrcp::{ControlResponse, Message, RobotId, Server, Timestamp};

pub use events::{Action, Event, Loss, Progress, TakenReading};
pub use lead::{LEAD_MARGIN_MIN, LeadTime};
pub use options::{ClockMode, Greeting, Join, MissionOptions, Participant, Requirement};
pub use preflight::{Check, Preflight, PreflightRow, Verdict};
pub use record::{Promise, PromisedScript, Record};
pub use resume::Changed;
pub use robot_state::{Failure, FailureKind};
pub use skew::{RobotSkew, SkewBudget};
pub(crate) use wait::next_time_of_day;

use crate::report::{ActReport, Outcome, Report};
use crate::server_clock::NtpState;
use act::{ActRun, Stage};
use robot_state::{Link, RobotState};

/// Where the mission stands. Timers of each phase are in its file.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Links, availability, initialization blocks, clocks, sensors.
    Greeting { deadline: Timestamp<Server> },
    /// Acts wait, are prepared, start and play.
    Performing,
    /// Cancels are out; confirmations are awaited.
    Stopping { deadline: Timestamp<Server>, resend: Timestamp<Server> },
    /// The report is ready.
    Ended,
}

/// Reports of acts are kept as long as they have no more rows than this in all.
const ROWS_KEPT: usize = 20_000;

/// One mission, from connecting to its report.
#[derive(Debug)]
pub struct Mission {
    choreography: Arc<Choreography>,
    options: MissionOptions,
    robots: Vec<RobotState>,
    phase: Phase,
    /// In order; the last one may still wait.
    runs: Vec<ActRun>,
    acts_begun: u32,
    /// The act that a failure policy wants next.
    detour: Option<usize>,
    /// After a stop the mission goes on with this act.
    then: Option<usize>,
    next_renewal: Option<Timestamp<Server>>,
    /// When stops were last sent.
    stopped_at: Option<Timestamp<Server>>,
    /// The earliest instant at which a lost robot is given up.
    give_up: Option<Timestamp<Server>>,
    /// Acts in a row that nobody was left to play.
    skipped: usize,
    /// Until when clocks are sampled further, and when next.
    sampling: Option<(Timestamp<Server>, Timestamp<Server>)>,
    preflight: Option<Preflight>,
    ntp: Option<NtpState>,
    outcome: Option<Outcome>,
    /// Something failed on the way, whatever follows.
    flawed: Option<Outcome>,
    acts: VecDeque<ActReport>,
    acts_omitted: usize,
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
        Self {
            choreography,
            options,
            robots: participants.into_iter().map(RobotState::new).collect(),
            phase: Phase::Greeting { deadline },
            runs: Vec::new(),
            acts_begun: 0,
            detour: None,
            then: None,
            next_renewal: None,
            stopped_at: None,
            give_up: None,
            skipped: 0,
            sampling: None,
            preflight: None,
            ntp: None,
            outcome: None,
            flawed: None,
            acts: VecDeque::new(),
            acts_omitted: 0,
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

    /// Takes an event that happened at `now`.
    #[must_use]
    pub fn handle(&mut self, now: Timestamp<Server>, event: Event) -> Vec<Action> {
        match event {
            Event::LinkUp { robot } => self.link_up(now, robot),
            Event::LinkDown { robot, reason, .. } => self.link_down(now, robot, reason),
            Event::Received { robot, message } => self.receive(now, robot, message),
            Event::Garbled { robot, reason } => self.fail(now, robot, FailureKind::Garbled { reason }),
            Event::StopRequested => self.request_stop(now),
            Event::Go => self.go(),
            Event::ServerTime(state) => self.server_time(state),
            Event::Recorded { .. } => {}
            Event::JournalLost { reason } => {
                self.tell(Progress::JournalLost { reason });
                self.request_stop(now);
            }
        }
        std::mem::take(&mut self.actions)
    }

    /// Does what is due at `now`.
    #[must_use]
    pub fn advance(&mut self, now: Timestamp<Server>) -> Vec<Action> {
        match self.phase {
            Phase::Greeting { deadline } => {
                self.sample_clocks(now);
                if now >= deadline {
                    self.greeting_overdue(now);
                }
            }
            Phase::Performing => self.perform(now),
            Phase::Stopping { deadline, resend } => {
                if now >= deadline {
                    self.stopped(now);
                } else if now >= resend {
                    self.stop_again(now);
                }
            }
            Phase::Ended => {}
        }
        std::mem::take(&mut self.actions)
    }

    /// When [`Mission::advance`] is next due; `None` once the mission has ended.
    #[must_use]
    pub fn next_wakeup(&self) -> Option<Timestamp<Server>> {
        match self.phase {
            Phase::Greeting { deadline } => {
                let sample = self.sampling.map(|(_, next)| next);
                Some(sample.map_or(deadline, |next| next.min(deadline)))
            }
            Phase::Performing => {
                let runs = self.runs.iter().filter_map(|run| self.run_wakeup(run));
                runs.chain(self.give_up).chain(self.next_renewal).min()
            }
            Phase::Stopping { deadline, resend } => Some(deadline.min(resend)),
            Phase::Ended => None,
        }
    }

    /// What it is due for, for a trace.
    pub(crate) fn due(&self) -> String {
        let runs: Vec<_> =
            self.runs.iter().map(|run| (run.number, run.stage, self.run_wakeup(run))).collect();
        format!(
            "{:?}, acts {runs:?}, renewal {:?}, give up {:?}",
            self.phase, self.next_renewal, self.give_up
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

    /// What really happened, once the mission has ended.
    #[must_use]
    pub fn report(&self) -> Option<Report> {
        let outcome = self.outcome.clone().filter(|_| self.phase == Phase::Ended)?;
        Some(Report::new(self, outcome))
    }

    /// What is known if the operator leaves now, without waiting for anything.
    #[must_use]
    pub fn report_as_left(&mut self, now: Timestamp<Server>) -> Report {
        while !self.runs.is_empty() {
            self.close_run(now, 0);
        }
        Report::new(self, Outcome::Abandoned)
    }

    pub(crate) fn robots(&self) -> &[RobotState] {
        &self.robots
    }

    pub(crate) const fn act_reports(&self) -> (&VecDeque<ActReport>, usize) {
        (&self.acts, self.acts_omitted)
    }

    pub(crate) const fn preflight(&self) -> Option<&Preflight> {
        self.preflight.as_ref()
    }

    pub(crate) const fn options(&self) -> &MissionOptions {
        &self.options
    }

    /// One round of everything that is due while acts wait, start and play.
    fn perform(&mut self, now: Timestamp<Server>) {
        self.renew_if_due(now);
        self.give_up_lost(now);
        let mut index = 0;
        while self.phase == Phase::Performing && index < self.runs.len() {
            self.advance_run(now, index);
            match self.runs.get(index).map(|run| run.stage) {
                Some(Stage::Over) => self.close_run(now, index),
                _ => index += 1,
            }
        }
        if self.phase == Phase::Performing {
            self.line_up(now);
        }
    }

    fn advance_run(&mut self, now: Timestamp<Server>, index: usize) {
        // A stage may be passed through at once: each is looked at in turn.
        for _ in 0..4 {
            let before = self.runs[index].stage;
            match before {
                Stage::Waiting => self.check_wait(now, index),
                Stage::Ready => self.prepare_if_it_fits(now, index),
                Stage::Preparing => self.decide_if_due(now, index),
                Stage::Decided => self.commit_if_due(now, index),
                Stage::Committed => self.begin_if_due(now, index),
                Stage::Playing => self.watch(now, index),
                Stage::Over => return,
            }
            let gone_on = self.runs.get(index).is_some_and(|run| run.stage != before);
            if self.phase != Phase::Performing || !gone_on {
                return;
            }
        }
    }

    fn run_wakeup(&self, run: &ActRun) -> Option<Timestamp<Server>> {
        let timing = run.timing.as_ref();
        match run.stage {
            Stage::Waiting => self.wait_wakeup(run),
            Stage::Ready => run.poll,
            Stage::Preparing => timing.map(|timing| match timing.asked_again {
                true => timing.decision,
                false => timing.ask_again(),
            }),
            Stage::Decided => timing.map(|timing| timing.commit),
            Stage::Committed => timing.map(|timing| timing.start),
            Stage::Playing => run.watch.into_iter().chain(self.reading_due(run)).min(),
            Stage::Over => None,
        }
    }

    /// Sees to it that the act that follows is there in time, and ends the mission after the last one.
    fn line_up(&mut self, now: Timestamp<Server>) {
        let Some(last) = self.runs.last() else { return };
        let surely = matches!(last.stage, Stage::Committed | Stage::Playing);
        if !surely || self.runs.len() > 1 {
            return;
        }
        let way = self.detour.map_or(last.follow, Way::Act);
        if let Way::Act(act) = way {
            self.detour = None;
            self.line_up_act(now, act);
        }
    }

    /// After an act has ended with none behind it.
    fn go_on_from(&mut self, now: Timestamp<Server>, follow: Way) {
        let way = self.detour.take().map_or(follow, Way::Act);
        self.go_way(now, way);
    }

    fn go_way(&mut self, now: Timestamp<Server>, way: Way) {
        match way {
            Way::Act(act) => self.line_up_act(now, act),
            Way::End => {
                let failed = self.robots.iter().any(|robot| robot.standing == robot_state::Standing::Out);
                let well = if failed { Outcome::DoneWithout } else { Outcome::Done };
                self.outcome = Some(self.flawed.clone().unwrap_or(well));
                self.end();
            }
            Way::Fail => self.abort(now, Outcome::Failed, false, None),
        }
    }

    fn line_up_act(&mut self, now: Timestamp<Server>, act: usize) {
        let run = ActRun {
            number: self.acts_begun,
            act,
            stage: Stage::Waiting,
            follow: self.choreography.acts[act].next,
            since: now,
            alone_since: self.runs.is_empty().then_some(now),
            gone: false,
            poll: None,
            target: None,
            timing: None,
            members: act::members(&self.choreography.acts[act].plan, &self.robots),
            awaited: 0,
            watch: None,
            recheck: false,
            readings_asked: 0,
            readings: Vec::new(),
        };
        self.acts_begun += 1;
        self.runs.push(run);
        let index = self.runs.len() - 1;
        self.announce_wait(index);
        self.advance_run(now, index);
    }

    /// The name of an act as people know it.
    fn act_name(&self, act: usize) -> String {
        let act = &self.choreography.acts[act];
        if act.name.is_empty() { act.plan.scenario.clone() } else { act.name.clone() }
    }

    /// Puts an act's story into its report and forgets the rest.
    fn close_run(&mut self, now: Timestamp<Server>, index: usize) {
        let run = self.runs.remove(index);
        self.account(now, &run);
        if run.is_sent() {
            self.skipped = 0;
            let name = self.act_name(run.act);
            if let Some(report) = ActReport::new(name.clone(), &run, &self.robots) {
                self.record(Record::ActEnded { report: Box::new(report.clone()) });
                self.acts.push_back(report);
            }
            let rows = |acts: &VecDeque<ActReport>| acts.iter().map(|act| act.robots.len()).sum::<usize>();
            while self.acts.len() > 1 && rows(&self.acts) > ROWS_KEPT {
                self.acts.pop_front();
                self.acts_omitted += 1;
            }
            self.tell(Progress::ActEnded { act: name });
        }
        if let Some(next) = self.runs.get_mut(index) {
            next.alone_since = Some(now);
        }
        let mut follow = run.follow;
        if !run.is_sent() {
            // A round of acts that nobody is left to play would go on for ever.
            self.skipped += 1;
            if self.skipped > self.choreography.acts.len() {
                follow = Way::End;
            }
            if let Some(before) = index.checked_sub(1).and_then(|before| self.runs.get_mut(before)) {
                before.follow = follow;
            }
        }
        if self.runs.is_empty() && self.phase == Phase::Performing {
            self.go_on_from(now, follow);
        }
    }

    fn account(&mut self, now: Timestamp<Server>, run: &ActRun) {
        let start = run.timing.as_ref().map(|timing| timing.start);
        for member in &run.members {
            let robot = &mut self.robots[member.robot];
            for script in &member.scripts {
                let totals = &mut robot.totals;
                totals.scripts += 1;
                totals.accepted += usize::from(script.accepted);
                totals.started += usize::from(script.has_begun());
                totals.steps_done += u64::from(script.steps_done);
                totals.steps_planned += script.plan.script.steps().len() as u64;
                totals.late_steps += u64::from(script.late_steps);
                let error = act::start_error(run, member, script);
                totals.start_error = totals.start_error.into_iter().chain(error).max_by_key(|e| e.abs());
                totals.unaccounted += usize::from(script.is_out());
                let ends =
                    start.map(|start| start + script.plan.start.span() + script.plan.script.duration());
                if robot.stop_sent || (script.is_out() && ends.is_some_and(|ends| now < ends)) {
                    let ends = act::lease_end(run, script, robot.last_sent, robot.clock.reading());
                    // One that has run out already has run out by now.
                    robot.left.extend(ends.map(|ends| ends.map(|at| at.max(now))));
                }
                if let Some(id) = &script.request_id {
                    robot.open.close(&script.plan.device, id);
                }
            }
        }
    }

    fn receive(&mut self, now: Timestamp<Server>, robot: usize, message: Message) {
        self.robots[robot].broken = None;
        match message {
            Message::AvailabilityResponse(response) => self.availability(now, robot, &response),
            Message::InitializationBlock(block) => self.introduced(now, robot, block),
            Message::ControlResponse(response) => self.control_response(now, robot, response),
            Message::AvailabilityRequest(_)
            | Message::InitializationRequest(_)
            | Message::ControlRequest(_) => {
                let reason = "sent a message that only a server sends".to_owned();
                self.fail(now, robot, FailureKind::Garbled { reason });
            }
        }
    }

    fn control_response(&mut self, now: Timestamp<Server>, robot: usize, response: ControlResponse) {
        if self.robots[robot].stop_answered(&response) {
            return self.stop_progress(now);
        }
        if self.reading_taken(now, robot, &response) {
            return;
        }
        self.script_response(now, robot, &response);
        if matches!(self.phase, Phase::Stopping { .. }) {
            self.stop_progress(now);
        }
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

    fn send(&mut self, now: Timestamp<Server>, robot: usize, message: Message) {
        self.send_by(now, robot, message, false);
    }

    fn send_by(&mut self, now: Timestamp<Server>, robot: usize, message: Message, urgent: bool) {
        if self.robots[robot].link == Link::Up {
            self.robots[robot].last_sent = Some(now);
            self.actions.push(Action::Send { robot, message, urgent });
        }
    }

    fn tell(&mut self, progress: Progress) {
        self.actions.push(Action::Tell(progress));
    }

    fn record(&mut self, record: Record) {
        self.actions.push(Action::Record(record));
    }

    fn end(&mut self) {
        self.phase = Phase::Ended;
        let outcome = self.outcome.clone().unwrap_or(Outcome::Failed);
        self.record(Record::Ended { outcome });
    }
}

/// A robot of the choreography has no participant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("robot `{robot}` of the plan takes no part in the mission")]
pub struct MissingParticipant {
    /// Which.
    pub robot: RobotId,
}
