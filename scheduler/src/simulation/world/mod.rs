//! The virtual world of one seed: what is due next, and who does it. What becomes of messages is in `network`, what goes wrong
//! in `faults`.

mod faults;
mod network;

use std::collections::BTreeMap;

use downbeat_robot::simulated::{Outgoing, SimulatedRobot, True};
use downbeat_robot::{Input, LinkId, LogEntry};
use fastrand::Rng;
use urrcp::{Message, Server, SessionId, Span, Timestamp};

use super::{Drawn, DrawnRobot, Fault, Happened, Ran};
use crate::dry_run::BEGIN;
use crate::journal::{Asked, Kept, Opened};
use crate::mission::{Action, Event, Mission, MissionOptions, Participant, Record};
use crate::report::Report;

/// A mission that lasts longer hangs.
const LASTS_MAX: Span = Span::from_millis(180_000);
/// Rounds at one instant, at most: far more than there can be events.
const ROUNDS_MAX: u32 = 20_000;
/// After so long an attempt to connect fails.
const CONNECT_FAILS: Span = Span::from_millis(300);
/// After the mission's end robots are watched for so long: whatever they still do is seen.
const AFTERMATH: Span = Span::from_millis(8_000);

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
    recorded: u64,
    records: Vec<(Timestamp<Server>, Record)>,
    history: Vec<(Timestamp<Server>, Happened)>,
    /// Keep every message: only for a trace.
    verbose: bool,
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

/// Plays a world to its end.
pub(super) fn play(drawn: Drawn, verbose: bool) -> Ran {
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
        recorded: 0,
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
            let done = self.mission.as_ref().and_then(Report::of);
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
        let before = self.recorded;
        self.perform_each(actions);
        if self.recorded > before {
            let count = self.recorded;
            self.tell(Event::Recorded { count });
        }
    }

    fn perform_each(&mut self, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Send { robot, message, .. } => self.send(robot, &message),
                Action::Reconnect { robot, after } => {
                    self.links[robot] = None;
                    self.put(self.now + after, Item::Connect { robot, session: self.life });
                }
                Action::Record(record) => {
                    self.recorded += u64::from(record.is_durable());
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
}

impl RobotSide {
    fn collect(&mut self) {
        if let Some(machine) = &mut self.machine {
            self.log.append(&mut machine.take_log());
        }
    }
}
