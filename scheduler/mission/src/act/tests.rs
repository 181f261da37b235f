//! Tests of an act without a mission. The tests simulate answers, the disk and time.

mod approaching;
mod drift;
mod drifted_apart;
mod dropped;
mod playing;
mod preparing;
mod resumed;
mod strayed;
mod waiting;

use std::sync::Arc;

use downbeat_plan::Choreography;
use urrcp::{ControlResponse, ErrorCode, RequestState, Server, Span, Status, Timestamp};

use super::timing::{Leases, Measured, Pace};
use super::{Act, ActAction, NamedScripts, Progressed, ReportTimes, Timing};
use crate::bench::{self, Planned, R0, R1, R2, Tells, at, by_robot, ms, response};
use crate::clock::ClockSample;
use crate::failure_kind::FailureKind;
use crate::lead::LeadTime;
use crate::ledger;
use crate::record::Record;
use crate::robot_state::{Link, Lost, Reading, Robots};
use crate::script::{ScriptRef, ScriptState};
use crate::{ActIndex, ActNumber, Loss, MemberIndex, MissionOptions, Outcome, Progress, RobotIndex};

const ROUND_TRIP: Span = Span::from_micros(400);
const LEASE: Span = Span::from_millis(240);
/// The expected duration of writing a record to disk.
const RECORDING: Span = Span::from_millis(20);

#[derive(Clone, Debug, PartialEq)]
enum Arrival {
    Recorded,
    /// The answer to a question that was sent at `asked`.
    Answer {
        robot: RobotIndex,
        asked: Timestamp<Server>,
    },
    Said {
        script: ScriptRef,
        status: Status,
    },
}

#[derive(Clone, Debug)]
struct Question {
    at: Timestamp<Server>,
    stage: Progressed,
    robot: RobotIndex,
    named: Vec<NamedScripts>,
}

/// How the mission reacts to a failure of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Policy {
    Abort,
    Without,
}

/// An act, its robots, and all actions that it requested.
struct Bench {
    now: Timestamp<Server>,
    robots: Robots,
    act: Act,
    options: MissionOptions,
    policy: Policy,
    /// Duration of a write to the disk; `None`: it never finishes.
    disk: Option<Span>,
    /// How much later than planned the last robot may start.
    late: Span,
    /// Robots that do not answer at all.
    silent: Vec<RobotIndex>,
    /// Robots that play but do not report by themselves, whatever they support.
    mum: Vec<RobotIndex>,
    /// The state that the robots in `mum` report for all their scripts, instead of the true one.
    says_always: Option<RequestState>,
    arrivals: Vec<(Timestamp<Server>, Arrival)>,
    recorded: Vec<(Timestamp<Server>, Record)>,
    sent: Vec<(Timestamp<Server>, ScriptRef)>,
    asked: Vec<Question>,
    reads: Vec<(Timestamp<Server>, RobotIndex, Reading)>,
    failed: Vec<(Timestamp<Server>, RobotIndex, FailureKind)>,
    withdrawn: Option<(Timestamp<Server>, Outcome)>,
    told: Vec<(Timestamp<Server>, Progress)>,
    went: Option<downbeat_plan::Way>,
}

fn times(
    asked_at: Timestamp<Server>,
    said_at: Timestamp<urrcp::Robot>,
    arrived: Timestamp<Server>,
) -> ReportTimes {
    ReportTimes { asked_at, said_at, arrived }
}

impl Bench {
    fn new(tells: &[Tells], scripts: &[&[Planned]]) -> Self {
        Self::of(tells, 2, bench::played(scripts))
    }

    fn of(tells: &[Tells], queue: usize, choreography: Arc<Choreography>) -> Self {
        let robots = robots(tells, queue);
        let mut act = Act::new(choreography, ActIndex::new(0), ActNumber::new(0), &robots, at(0), None);
        act.comes_next(at(0));
        Self::around(act, robots)
    }

    fn around(act: Act, robots: Robots) -> Self {
        Self {
            now: at(0),
            robots,
            act,
            options: MissionOptions::default(),
            policy: Policy::Abort,
            disk: Some(ms(2)),
            late: ms(1),
            silent: Vec::new(),
            mum: Vec::new(),
            says_always: None,
            arrivals: Vec::new(),
            recorded: Vec::new(),
            sent: Vec::new(),
            asked: Vec::new(),
            reads: Vec::new(),
            failed: Vec::new(),
            withdrawn: None,
            told: Vec::new(),
            went: None,
        }
    }

    /// Returns two robots that report everything, with one script each.
    fn pair() -> Self {
        Self::new(&[Tells::Everything; 2], &[&[("a", 0, 400)], &[("a", 0, 400)]])
    }

    fn of_three(policy: Policy) -> Self {
        let scripts: [&[Planned]; 3] = [&[("a", 0, 400)]; 3];
        Self { policy, ..Self::new(&[Tells::Everything; 3], &scripts) }
    }

    fn timing(&self) -> &Timing {
        self.act.timing().unwrap()
    }

    /// Promises the act at once, without a condition.
    fn promise(&mut self, leases: Leases) {
        self.pump();
        assert_eq!(self.act.progress(), Progressed::Ready);
        let timing = timing(&self.act, self.now, leases, self.late);
        let (_, actions) = self.act.promise(timing, &self.robots, None, |_| Span::ZERO);
        self.carry_out(actions);
    }

    fn start(&self) -> Timestamp<Server> {
        self.timing().start
    }

    /// Handles everything that is due or arrives until `until`.
    fn run_until(&mut self, until: Timestamp<Server>) {
        for _ in 0..100_000 {
            let arrives = self.arrivals.iter().map(|(at, _)| *at).min();
            let Some(next) = self.wakeup().into_iter().chain(arrives).min().filter(|next| *next <= until)
            else {
                self.now = self.now.max(until);
                return;
            };
            self.now = self.now.max(next);
            self.take_arrivals();
            self.pump();
        }
        panic!("the act wakes up for nothing at {}", self.now);
    }

    fn wakeup(&self) -> Option<Timestamp<Server>> {
        self.act.wakeup().filter(|_| self.withdrawn.is_none())
    }

    /// Continues far beyond the end of the act.
    fn run_to_the_end(&mut self) {
        let end = self.timing().end + ms(10_000);
        self.run_until(end);
    }

    fn take_arrivals(&mut self) {
        let now = self.now;
        let (due, later) = std::mem::take(&mut self.arrivals).into_iter().partition(|(at, _)| *at <= now);
        self.arrivals = later;
        let due: Vec<(Timestamp<Server>, Arrival)> = due;
        due.into_iter().for_each(|(_, arrival)| self.take(arrival));
    }

    fn take(&mut self, arrival: Arrival) {
        let actions = match arrival {
            Arrival::Recorded => self.act.recorded(),
            Arrival::Answer { robot, .. } if self.silent.contains(&robot) => return,
            Arrival::Answer { robot, asked } => return self.answer(robot, asked),
            Arrival::Said { script, .. } if self.silent.contains(&self.act.robot_of(script)) => return,
            Arrival::Said { script, status } => return self.say(script, status),
        };
        self.carry_out(actions);
    }

    fn pump(&mut self) {
        for _ in 0..10 {
            if self.withdrawn.is_some() {
                return;
            }
            let before = self.act.progress();
            let actions = self.act.advance(self.now, &self.robots, &self.options);
            if actions.is_empty() && self.act.progress() == before {
                return;
            }
            self.carry_out(actions);
        }
    }

    fn carry_out(&mut self, actions: Vec<ActAction>) {
        let now = self.now;
        for action in actions {
            match action {
                ActAction::Read { robot, what, .. } => self.reads.push((now, robot, what)),
                ActAction::TimedOut(way) => self.went = Some(way),
                ActAction::Send(script) => self.send(script),
                ActAction::Refill(robots) => robots.into_iter().for_each(|robot| self.refill(robot)),
                ActAction::Ask(robots) => robots.into_iter().for_each(|robot| self.ask(robot)),
                ActAction::Fail(failing) => {
                    failing.into_iter().for_each(|(robot, kind)| self.fail(robot, kind))
                }
                ActAction::Withdraw(outcome) => self.withdrawn = Some((now, outcome)),
                ActAction::Record(record) => {
                    let done = self.disk.filter(|_| record.is_durable());
                    self.arrivals.extend(done.map(|takes| (now + takes, Arrival::Recorded)));
                    self.recorded.push((now, record));
                }
                ActAction::Tell(progress) => self.told.push((now, progress)),
            }
        }
    }

    fn fail(&mut self, robot: RobotIndex, kind: FailureKind) {
        self.failed.push((self.now, robot, kind));
        match self.policy {
            Policy::Abort => self.withdrawn = self.withdrawn.take().or(Some((self.now, Outcome::NotStarted))),
            Policy::Without => self.act.drop_robot(robot),
        }
    }

    fn refill(&mut self, robot: RobotIndex) {
        let scripts = ledger::sendable(std::slice::from_ref(&self.act), robot, &self.robots[robot]);
        scripts.into_iter().for_each(|script| self.send(script));
    }

    /// Records a script as sent. A robot that is not silent accepts it and plays it.
    fn send(&mut self, script: ScriptRef) {
        self.sent.push((self.now, script));
        self.act.sent(self.now, script);
        let robot = self.act.robot_of(script);
        self.says(self.now + ROUND_TRIP, script, Status::Accepted);
        if self.robots[robot].reports() && !self.mum.contains(&robot) {
            let plan = &self.act.script(script).plan;
            let start = self.start() + plan.start.span();
            let end = start + plan.script.duration();
            self.says(start + ROUND_TRIP / 2, script, Status::Started);
            self.says(end + ROUND_TRIP / 2, script, Status::Ok);
        }
    }

    fn says(&mut self, at: Timestamp<Server>, script: ScriptRef, status: Status) {
        let arrival = Arrival::Said { script, status };
        if !self.arrivals.iter().any(|(_, other)| *other == arrival) {
            self.arrivals.push((at, arrival));
        }
    }

    fn ask(&mut self, robot: RobotIndex) {
        let hushed = self.act.holds_messages_to(robot, self.now);
        assert!(!hushed, "{robot} is asked at {}, {} before the start", self.now, self.start() - self.now);
        self.robots[robot].contact.questions.asked(self.now);
        let (stage, named) = (self.act.progress(), self.act.names_of(robot, self.now, None));
        self.asked.push(Question { at: self.now, stage, robot, named });
        self.arrivals.push((self.now + ROUND_TRIP, Arrival::Answer { robot, asked: self.now }));
    }

    /// Passes a robot's answer to the act: its clock times, and the states of its scripts.
    fn answer(&mut self, robot: RobotIndex, asked: Timestamp<Server>) {
        let there = by_robot(asked + ROUND_TRIP / 2);
        self.robots[robot].clock.add(ClockSample::from_exchange(asked, there, there, self.now));
        self.robots[robot].contact.questions.answer(asked);
        self.robots[robot].heard(self.now);
        if !self.robots[robot].takes_inquiries() {
            return;
        }
        let always = self.says_always.filter(|_| self.mum.contains(&robot));
        for script in self.scripts_of(robot) {
            let state = always.unwrap_or_else(|| self.truth(script, asked + ROUND_TRIP / 2));
            self.report(script, asked, state);
        }
    }

    fn report(&mut self, script: ScriptRef, asked: Timestamp<Server>, state: RequestState) {
        let Some(id) = self.act.script(script).request_id().cloned() else { return };
        let report = bench::report(&id, state, None);
        let times = times(asked, by_robot(asked + ROUND_TRIP / 2), self.now);
        let noted = self.act.reported(script, &report, times, &self.robots);
        self.carry_out(noted.actions);
    }

    /// Returns the true state of a script on a robot that plays correctly.
    fn truth(&self, script: ScriptRef, when: Timestamp<Server>) -> RequestState {
        let plan = &self.act.script(script).plan;
        let start = self.start() + plan.start.span();
        let came = self.sent.iter().any(|(at, sent)| *sent == script && *at < when);
        match came {
            false => RequestState::Unknown,
            true if when < start => RequestState::Held,
            true if when < start + plan.script.duration() => RequestState::Running,
            true => RequestState::Ended,
        }
    }

    fn say(&mut self, script: ScriptRef, status: Status) {
        let response = self.response(script, status);
        self.take_response(script, &response);
    }

    fn response(&self, script: ScriptRef, status: Status) -> ControlResponse {
        let state = self.act.script(script);
        response(&state.plan.device, state.request_id(), status, self.now)
    }

    fn refuse(&mut self, script: ScriptRef, code: ErrorCode) {
        let response =
            ControlResponse { error: bench::refusal(code), ..self.response(script, Status::Failed) };
        self.take_response(script, &response);
    }

    fn take_response(&mut self, script: ScriptRef, response: &ControlResponse) {
        let noted = self.act.answered(script, response, self.now, &self.robots);
        self.carry_out(noted.actions);
    }

    /// Returns the scripts of a robot in this act.
    fn scripts_of(&self, robot: RobotIndex) -> Vec<ScriptRef> {
        let member = self.act.members().position(|member| member.robot == robot).unwrap();
        let scripts = self.act.members()[member].scripts().len();
        (0..scripts).map(|script| ScriptRef { act: self.act.number(), member, script }).collect()
    }

    fn state(&self, robot: RobotIndex, script: usize) -> &ScriptState {
        self.act.script(self.scripts_of(robot)[script]).state()
    }

    fn sent_to(&self, robot: RobotIndex) -> Vec<(Timestamp<Server>, usize)> {
        let of_robot = |(_, script): &&(Timestamp<Server>, ScriptRef)| self.act.robot_of(*script) == robot;
        self.sent.iter().filter(of_robot).map(|(at, script)| (*at, script.script)).collect()
    }

    fn asked_of(&self, robot: RobotIndex) -> impl Iterator<Item = &Question> {
        self.asked.iter().filter(move |question| question.robot == robot)
    }

    fn records(&self, which: impl Fn(&Record) -> bool) -> Vec<Timestamp<Server>> {
        self.recorded.iter().filter(|(_, record)| which(record)).map(|(at, _)| *at).collect()
    }

    fn commitments(&self) -> Vec<Timestamp<Server>> {
        self.records(|record| matches!(record, Record::Committed { .. }))
    }

    fn decisions(&self) -> Vec<Timestamp<Server>> {
        self.records(|record| matches!(record, Record::Decided { .. }))
    }

    /// Continues until the act has been promised, accepted by all robots, and decided.
    fn decide(&mut self, leases: Leases) {
        self.promise(leases);
        self.run_until(self.now + ms(4));
        assert_eq!(self.act.progress(), Progressed::Approaching);
    }

    fn commit(&mut self, leases: Leases) {
        self.decide(leases);
        while self.act.progress() == Progressed::Approaching && self.now < self.start() {
            self.run_until(self.now + Span::from_micros(100));
        }
        assert_eq!(self.act.progress(), Progressed::Committed);
    }

    fn play(&mut self, leases: Leases) {
        self.commit(leases);
        self.run_until(self.start() + ms(5));
        assert_eq!(self.act.progress(), Progressed::Playing);
    }

    fn break_link(&mut self, robot: RobotIndex) {
        let (reason, loss) = ("cut".to_owned(), Loss::Closed);
        let lost = Lost { reason, loss, since: self.now, failed: self.now, connecting: true, give_up: None };
        self.robots[robot].link = Link::Lost(lost);
    }
}

fn robots(tells: &[Tells], queue: usize) -> Robots {
    let robot = |(index, tells): (usize, &Tells)| bench::robot(&format!("r{index}"), *tells, queue);
    tells.iter().enumerate().map(robot).collect()
}

/// Returns the timing of an act that is sent now to robots on a fast link.
fn timing(act: &Act, now: Timestamp<Server>, leases: Leases, late: Span) -> Timing {
    let (robots, scripts) = (act.members().len(), act.members().iter().map(|m| m.scripts().len()).sum());
    let early = ms(1);
    let measured = Measured {
        robots,
        scripts,
        questions: 1,
        leases,
        round_trip: ROUND_TRIP,
        early,
        late,
        record: RECORDING,
        lateness: Span::ZERO,
    };
    let pace = Pace::of(&measured, LEASE);
    let needed = LeadTime::needed(ROUND_TRIP, scripts, 1_000, &pace, LEASE);
    let lead = LeadTime { prepare: needed.prepare + RECORDING, ..needed };
    Timing::new(now, lead, pace, act.written().plan.duration())
}
