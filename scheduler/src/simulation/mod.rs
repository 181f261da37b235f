//! Missions under faults, in virtual time: the same mission machine and the same robot machines, a network that loses,
//! doubles, delays and reorders, partitions, processes that die or stand still, clocks that are off, drift and are set,
//! and robots that lie. Everything follows from a seed: what it found once it finds again, and can be read as a trace.

pub mod baseline;
mod check;
mod draw;
mod trace;

use std::collections::BTreeMap;

use downbeat_robot::simulated::{Outgoing, SimulatedRobot, True};
use downbeat_robot::{Input, LinkId, LogEntry};
use fastrand::Rng;
use urrcp::{
    AvailabilityResponse, Command, ContentHash, ControlResponse, Message, Server, SessionId, Span, Status,
    Timestamp,
};

use crate::dry_run::BEGIN;
use crate::journal::{Asked, Fate, Kept, Opened};
use crate::mission::{Action, Event, Mission, MissionOptions, Participant, Record};
use crate::report::Report;
pub use check::{Starts, Verdict, Violation};
pub use draw::{Drawn, DrawnRobot, Fault, Lie, Network, draw};
pub use trace::trace;

/// A mission that lasts longer hangs.
const LASTS_MAX: Span = Span::from_millis(180_000);
/// Rounds at one instant, at most: far more than there can be events.
const ROUNDS_MAX: u32 = 20_000;
/// Before a link is tried again.
const RECONNECT: Span = Span::from_millis(50);
/// After so long an attempt to connect fails.
const CONNECT_FAILS: Span = Span::from_millis(300);
/// After the mission's end robots are watched for so long: whatever they still do is seen.
const AFTERMATH: Span = Span::from_millis(8_000);

/// What happened to a seed.
#[derive(Debug)]
pub struct Ran {
    /// What the seed stood for.
    pub drawn: Drawn,
    /// The report of the process that ended the mission, if one did.
    pub report: Option<Report>,
    /// What was written down, and when.
    pub records: Vec<(Timestamp<Server>, Record)>,
    /// What each robot really set.
    pub logs: Vec<Vec<LogEntry>>,
    /// Everything that happened, for the trace and for the checks.
    pub history: Vec<(Timestamp<Server>, Happened)>,
    /// The mission never came to an end.
    pub hung: bool,
}

/// A line of a trace.
#[derive(Clone, Debug)]
pub enum Happened {
    /// A message was sent to a robot.
    ToRobot(usize, Message),
    /// A message from the scheduler arrived at a robot.
    AtRobot(usize, Message),
    /// A message from a robot arrived at the scheduler.
    FromRobot(usize, Message),
    /// A message was lost on the way to or from a robot.
    Lost(usize),
    /// A message to or from a robot travelled for so long.
    Slow(usize, Span),
    /// Something went wrong.
    Fault(Fault),
    /// A robot is back.
    Back(usize),
    /// A link stands.
    LinkUp(usize),
    /// A link is down, as the scheduler sees it.
    LinkDown(usize),
    /// The mission was taken up by its journal.
    TakenUp(&'static str),
    /// The operator was told.
    Told(String),
}

enum Item {
    ToRobot { robot: usize, link: LinkId, message: Box<Message> },
    ToScheduler { robot: usize, link: LinkId, event: Box<Event>, session: u32 },
    RobotLinkDown { robot: usize, link: LinkId },
    Connect { robot: usize, session: u32 },
    Fault(Fault),
    RobotBack(usize),
    Resume,
    Answer { robot: usize, link: LinkId, message: Box<Message> },
}

struct RobotSide {
    machine: Option<SimulatedRobot>,
    /// The connection with the scheduler, as this side sees it.
    link: Option<LinkId>,
    paused_until: Timestamp<Server>,
    partitioned_until: Timestamp<Server>,
    log: Vec<LogEntry>,
    /// Last arrivals, so that a stream keeps its order: there and back.
    last: [Timestamp<Server>; 2],
    clock_steps: Span,
}

struct World {
    drawn: Drawn,
    rng: Rng,
    now: Timestamp<Server>,
    items: BTreeMap<(Timestamp<Server>, u64), Item>,
    sequence: u64,
    next_link: u64,
    robots: Vec<RobotSide>,
    mission: Option<Mission>,
    /// Counts the scheduler's lives: what was under way for an earlier one is lost.
    life: u32,
    paused_until: Timestamp<Server>,
    waiting: Vec<Event>,
    links: Vec<Option<LinkId>>,
    kept: Kept,
    records: Vec<(Timestamp<Server>, Record)>,
    history: Vec<(Timestamp<Server>, Happened)>,
    /// Keep every message: only for a trace.
    verbose: bool,
}

/// Plays a seed to its end and watches what the robots still do.
#[must_use]
pub fn run(seed: u64) -> Ran {
    play(draw(seed), false)
}

/// The same, keeping every message.
#[must_use]
pub fn run_verbosely(seed: u64) -> Ran {
    play(draw(seed), true)
}

fn session() -> Option<SessionId> {
    SessionId::new("soak").ok()
}

fn options() -> MissionOptions {
    MissionOptions { patience: Span::from_millis(2_000), session: session(), ..MissionOptions::default() }
}

fn participants(drawn: &Drawn) -> Vec<Participant> {
    let participant = |robot: &DrawnRobot| Participant {
        clock: robot.clock,
        ..Participant::new(robot.block.id.clone(), Some(robot.block.clone()))
    };
    drawn.robots.iter().map(participant).collect()
}

fn play(drawn: Drawn, verbose: bool) -> Ran {
    let mission = Mission::new(drawn.choreography.clone(), participants(&drawn), options(), BEGIN).ok();
    let robots: Vec<RobotSide> = drawn
        .robots
        .iter()
        .map(|robot| RobotSide {
            machine: Some(SimulatedRobot::new(robot.block.clone(), robot.settings.clone())),
            link: None,
            paused_until: BEGIN,
            partitioned_until: BEGIN,
            log: Vec::new(),
            last: [BEGIN; 2],
            clock_steps: Span::ZERO,
        })
        .collect();
    let opened = Opened {
        session: session().unwrap_or_else(unreachable_session),
        pid: 0,
        scenario: "soak".into(),
        fleet: "soak".into(),
        asked: Asked::default(),
        robots: drawn.robots.iter().map(|robot| (robot.block.id.clone(), "soak".to_owned())).collect(),
    };
    let mut world = World {
        rng: Rng::with_seed(drawn.seed ^ 0x5eed),
        now: BEGIN,
        items: BTreeMap::new(),
        sequence: 0,
        next_link: 1,
        links: vec![None; robots.len()],
        robots,
        mission,
        life: 0,
        paused_until: BEGIN,
        waiting: Vec::new(),
        kept: Kept::new(opened, BEGIN),
        records: Vec::new(),
        history: Vec::new(),
        verbose,
        drawn,
    };
    for (at, fault) in world.drawn.faults.clone() {
        world.put(BEGIN + at, Item::Fault(fault));
    }
    for robot in 0..world.robots.len() {
        world.put(BEGIN, Item::Connect { robot, session: 0 });
    }
    world.go()
}

#[expect(clippy::expect_used, reason = "a constant below every limit")]
fn unreachable_session() -> SessionId {
    SessionId::new("s").expect("a constant below every limit")
}

impl World {
    fn put(&mut self, at: Timestamp<Server>, item: Item) {
        self.sequence += 1;
        self.items.insert((at.max(self.now), self.sequence), item);
    }

    fn note(&mut self, happened: Happened) {
        self.history.push((self.now, happened));
    }

    fn go(mut self) -> Ran {
        let mut report: Option<Report> = None;
        let mut until = BEGIN + LASTS_MAX;
        let mut ended = false;
        let mut rounds = 0;
        while let Some(next) = self.next_instant(ended).filter(|next| *next <= until) {
            rounds = if next > self.now { 0 } else { rounds + 1 };
            if rounds > ROUNDS_MAX {
                // Somebody is due and never does what he is due for.
                let robots: Vec<_> =
                    self.robots.iter().map(|robot| robot.machine.as_ref()?.next_wakeup()).collect();
                let mission = self.mission.as_ref().and_then(Mission::next_wakeup);
                let due = self.mission.as_ref().map(Mission::due).unwrap_or_default();
                self.note(Happened::Told(format!("stuck: robots {robots:?}, mission {mission:?}: {due}")));
                break;
            }
            self.now = self.now.max(next);
            self.advance_robots();
            while let Some(entry) = self.items.first_entry().filter(|entry| entry.key().0 <= self.now) {
                let item = entry.remove();
                self.happen(item);
                self.advance_robots();
            }
            if !ended {
                self.advance_mission();
            }
            let done = self.mission.as_ref().and_then(Mission::report);
            // Without a scheduler, and nobody who will take it up, that was all.
            let over = done.is_some() || (self.mission.is_none() && !self.will_resume());
            if over && !ended {
                ended = true;
                report = done;
                self.mission = None;
                until = self.now + AFTERMATH;
            }
        }
        for robot in &mut self.robots {
            robot.collect();
        }
        Ran {
            report,
            records: self.records,
            logs: self.robots.into_iter().map(|robot| robot.log).collect(),
            history: self.history,
            hung: !ended,
            drawn: self.drawn,
        }
    }

    fn will_resume(&self) -> bool {
        self.items.values().any(|item| matches!(item, Item::Resume))
    }

    fn next_instant(&self, ended: bool) -> Option<Timestamp<Server>> {
        let items = self.items.keys().next().map(|(at, _)| *at);
        let robots = self.robots.iter().filter_map(|robot| {
            let at = robot.machine.as_ref()?.next_wakeup()?.assume_clock::<Server>();
            Some(at.max(robot.paused_until))
        });
        let mission = self.mission.as_ref().filter(|_| !ended).and_then(Mission::next_wakeup);
        let mission = mission.map(|at| at.max(self.paused_until));
        let waiting = (!self.waiting.is_empty()).then_some(self.paused_until);
        items.into_iter().chain(robots).chain(mission).chain(waiting).min()
    }

    fn advance_robots(&mut self) {
        for robot in 0..self.robots.len() {
            let side = &mut self.robots[robot];
            if self.now < side.paused_until {
                continue;
            }
            let Some(machine) = &mut side.machine else { continue };
            let mut out = Vec::new();
            machine.advance(self.now.assume_clock::<True>(), &mut out);
            side.collect();
            for outgoing in out {
                if let Outgoing::Message { link, message } = outgoing {
                    let slow = self.drawn.robots[robot].slow;
                    if let Some(message) = self.lie(robot, message) {
                        self.put(self.now + slow, Item::Answer { robot, link, message: Box::new(message) });
                    }
                }
            }
        }
    }

    /// What a robot that lies makes of its answer.
    fn lie(&mut self, robot: usize, mut message: Message) -> Option<Message> {
        match (self.drawn.robots[robot].lie, &mut message) {
            (Some(Lie::WrongTime(by)), Message::AvailabilityResponse(response)) => {
                let AvailabilityResponse { receive_timestamp, timestamp, .. } = response;
                *receive_timestamp = *receive_timestamp + by;
                *timestamp = *timestamp + by;
            }
            (Some(Lie::WrongHash), Message::ControlResponse(response)) if response.content_hash.is_some() => {
                response.content_hash = Some(ContentHash::of(b"something else"));
            }
            (
                Some(Lie::Forgets),
                Message::ControlResponse(ControlResponse { status: Status::Accepted, .. }),
            ) => {
                let drawn = &self.drawn.robots[robot];
                let fresh = SimulatedRobot::new(drawn.block.clone(), drawn.settings.clone());
                self.robots[robot].collect();
                self.robots[robot].machine = Some(fresh);
            }
            _ => {}
        }
        Some(message)
    }

    /// When a message arrives, or that it is lost. `way` is 0 to the robot, 1 from it.
    fn travel(&mut self, robot: usize, way: usize) -> Option<Timestamp<Server>> {
        let (least, largest) = self.drawn.delay;
        let mut delay = Span::from_nanos(self.rng.i64(least.as_nanos()..=largest.as_nanos()));
        if self.rng.f64() < self.drawn.tail {
            delay += largest * self.rng.i64(1..=20);
        }
        let side = &mut self.robots[robot];
        let arrival = match self.drawn.network {
            Network::Stream => {
                // What a stream carries into a partition comes out of it at its end.
                let arrival = (self.now.max(side.partitioned_until) + delay).max(side.last[way]);
                side.last[way] = arrival;
                arrival
            }
            Network::Datagram { loss, .. } => {
                if self.now < side.partitioned_until || self.rng.f64() < loss {
                    self.note(Happened::Lost(robot));
                    return None;
                }
                self.now + delay
            }
        };
        let travelled = arrival - self.now;
        if travelled > largest {
            self.note(Happened::Slow(robot, travelled));
        }
        Some(arrival)
    }

    fn doubled(&mut self) -> bool {
        match self.drawn.network {
            Network::Stream => false,
            Network::Datagram { double, .. } => self.rng.f64() < double,
        }
    }

    fn happen(&mut self, item: Item) {
        match item {
            Item::ToRobot { robot, link, message } => self.arrive_at_robot(robot, link, *message),
            Item::Answer { robot, link, message } => self.answer(robot, link, &message),
            Item::ToScheduler { robot, link, event, session } => {
                if session == self.life && self.links[robot] == Some(link) {
                    self.tell(*event);
                }
            }
            Item::RobotLinkDown { robot, link } => {
                let side = &mut self.robots[robot];
                if side.link == Some(link) {
                    side.link = None;
                    let now = self.now.assume_clock();
                    if let Some(machine) = &mut side.machine {
                        machine.receive(now, link, Input::LinkDown);
                    }
                }
            }
            Item::Connect { robot, session } => self.connect(robot, session),
            Item::Fault(fault) => self.go_wrong(fault),
            Item::RobotBack(robot) => {
                let drawn = &self.drawn.robots[robot];
                let mut machine = SimulatedRobot::new(drawn.block.clone(), drawn.settings.clone());
                machine.step_clock(self.robots[robot].clock_steps);
                self.robots[robot].machine = Some(machine);
                self.note(Happened::Back(robot));
            }
            Item::Resume => self.resume(),
        }
    }

    fn arrive_at_robot(&mut self, robot: usize, link: LinkId, message: Message) {
        let side = &self.robots[robot];
        if side.machine.is_none() {
            return;
        }
        if side.link != Some(link) {
            // Its system knows no such connection and says so.
            let event = Event::LinkDown { robot, reason: "connection reset".to_owned() };
            return self.send_event(robot, link, event);
        }
        if self.now < side.paused_until {
            return self.put(side.paused_until, Item::ToRobot { robot, link, message: Box::new(message) });
        }
        let forgets = self.drawn.robots[robot].lie == Some(Lie::NeverMoves);
        if self.verbose {
            self.note(Happened::AtRobot(robot, message.clone()));
        } else if !forgets {
            self.note(Happened::AtRobot(robot, brief(&message)));
        }
        if let Some(machine) = &mut self.robots[robot].machine {
            machine.receive(self.now.assume_clock(), link, Input::Message(message));
        }
    }

    fn answer(&mut self, robot: usize, link: LinkId, message: &Message) {
        if self.robots[robot].link != Some(link) {
            return;
        }
        for _ in 0..if self.doubled() { 2 } else { 1 } {
            if let Some(at) = self.travel(robot, 1) {
                let event = Box::new(Event::Received { robot, message: message.clone() });
                self.put(at, Item::ToScheduler { robot, link, event, session: self.life });
            }
        }
    }

    fn send_event(&mut self, robot: usize, link: LinkId, event: Event) {
        let at = self.now + self.drawn.delay.1;
        let (event, session) = (Box::new(event), self.life);
        self.put(at, Item::ToScheduler { robot, link, event, session });
    }

    fn connect(&mut self, robot: usize, session: u32) {
        if session != self.life || self.mission.is_none() {
            return;
        }
        let link = LinkId(self.next_link);
        self.next_link += 1;
        self.links[robot] = Some(link);
        let side = &mut self.robots[robot];
        let reachable = side.machine.is_some() && self.now >= side.partitioned_until;
        if !reachable {
            let event = Box::new(Event::LinkDown { robot, reason: "no connection".to_owned() });
            let at = self.now + CONNECT_FAILS;
            return self.put(at, Item::ToScheduler { robot, link, event, session });
        }
        if let (Some(old), Some(machine)) = (side.link.replace(link), &mut side.machine) {
            machine.receive(self.now.assume_clock(), old, Input::LinkDown);
        }
        side.last = [self.now; 2];
        self.tell(Event::LinkUp { robot });
    }

    fn go_wrong(&mut self, fault: Fault) {
        self.note(Happened::Fault(fault));
        let now = self.now;
        match fault {
            Fault::RobotCrash { robot, back_after, told } => {
                let side = &mut self.robots[robot];
                side.collect();
                if side.machine.take().is_none() {
                    return;
                }
                let link = side.link.take();
                if let Some(link) = link.filter(|_| told) {
                    let reason = "the robot closed the connection".to_owned();
                    self.send_event(robot, link, Event::LinkDown { robot, reason });
                }
                if let Some(after) = back_after {
                    self.put(now + after, Item::RobotBack(robot));
                }
            }
            Fault::RobotPause { robot, lasts } => self.robots[robot].paused_until = now + lasts,
            Fault::Partition { robot, lasts, breaks } => {
                let side = &mut self.robots[robot];
                side.partitioned_until = side.partitioned_until.max(now + lasts);
                if let Some(link) = side.link.filter(|_| breaks) {
                    let end = side.partitioned_until;
                    self.put(end, Item::RobotLinkDown { robot, link });
                    let event =
                        Box::new(Event::LinkDown { robot, reason: "connection timed out".to_owned() });
                    self.put(end, Item::ToScheduler { robot, link, event, session: self.life });
                }
            }
            Fault::ClockStep { robot, by } => {
                let side = &mut self.robots[robot];
                side.clock_steps += by;
                if let Some(machine) = &mut side.machine {
                    machine.step_clock(by);
                }
            }
            Fault::SchedulerCrash { resumed_after } => {
                if self.mission.take().is_none() {
                    return;
                }
                self.life += 1;
                self.waiting.clear();
                for robot in 0..self.robots.len() {
                    if let Some(link) = self.links[robot].take() {
                        let at = now + self.drawn.delay.1;
                        self.put(at, Item::RobotLinkDown { robot, link });
                    }
                }
                if let Some(after) = resumed_after {
                    self.put(now + after, Item::Resume);
                }
            }
            Fault::SchedulerPause { lasts } => self.paused_until = now + lasts,
            Fault::Stop => self.tell(Event::StopRequested),
        }
    }

    /// What `downbeat resume` does.
    fn resume(&mut self) {
        if self.mission.is_some() || self.kept.outcome.is_some() {
            return;
        }
        let participants = participants(&self.drawn);
        let fate = self.kept.fate();
        let resumed = match &fate {
            Fate::Resume => Mission::resume(
                self.drawn.choreography.clone(),
                participants.clone(),
                options(),
                &self.kept,
                self.now,
            )
            .ok(),
            Fate::Withdraw(_) => None,
        };
        let how = if resumed.is_some() { "resumed" } else { "withdrawn" };
        self.note(Happened::TakenUp(how));
        self.mission = Some(
            resumed
                .unwrap_or_else(|| Mission::withdraw(participants, options(), &self.kept.touched, self.now)),
        );
        for robot in 0..self.robots.len() {
            self.put(self.now, Item::Connect { robot, session: self.life });
        }
    }

    fn tell(&mut self, event: Event) {
        if self.now < self.paused_until {
            return self.waiting.push(event);
        }
        match &event {
            Event::LinkUp { robot } => self.note(Happened::LinkUp(*robot)),
            Event::LinkDown { robot, .. } => self.note(Happened::LinkDown(*robot)),
            Event::Received { robot, message } if self.verbose => {
                self.note(Happened::FromRobot(*robot, message.clone()));
            }
            _ => {}
        }
        let Some(mission) = &mut self.mission else { return };
        let actions = mission.handle(self.now, event);
        self.perform(actions);
    }

    fn advance_mission(&mut self) {
        if self.now < self.paused_until {
            return;
        }
        for event in std::mem::take(&mut self.waiting) {
            self.tell(event);
        }
        let Some(mission) = &mut self.mission else { return };
        let actions = mission.advance(self.now);
        self.perform(actions);
    }

    fn perform(&mut self, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Send { robot, message, .. } => self.send(robot, &message),
                Action::Reconnect { robot } => {
                    self.links[robot] = None;
                    self.put(self.now + RECONNECT, Item::Connect { robot, session: self.life });
                }
                Action::Record(record) => {
                    self.kept.note(&record);
                    self.records.push((self.now, record));
                }
                Action::Tell(progress) => {
                    if self.verbose {
                        let text = serde_json::to_string(&progress).unwrap_or_default();
                        self.note(Happened::Told(text));
                    }
                }
            }
        }
    }

    fn send(&mut self, robot: usize, message: &Message) {
        let Some(link) = self.links[robot] else { return };
        if self.verbose {
            self.note(Happened::ToRobot(robot, message.clone()));
        }
        for _ in 0..if self.doubled() { 2 } else { 1 } {
            if let Some(at) = self.travel(robot, 0) {
                self.put(at, Item::ToRobot { robot, link, message: Box::new(message.clone()) });
            }
        }
    }
}

impl RobotSide {
    fn collect(&mut self) {
        if let Some(machine) = &mut self.machine {
            self.log.append(&mut machine.take_log());
        }
    }
}

/// As much of a message as the checks need.
fn brief(message: &Message) -> Message {
    match message {
        Message::ControlRequest(request) => {
            let mut brief = request.clone();
            if !matches!(&brief.command, Command::Script(script) if script.is_empty()) {
                brief.command = Command::ReadSensor;
            }
            Message::ControlRequest(brief)
        }
        other => other.clone(),
    }
}

#[cfg(test)]
mod tests;
