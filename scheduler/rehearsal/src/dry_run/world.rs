//! The world of a dry run: robots, links, what goes wrong in a trial, and a clock that jumps.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, VecDeque};

use downbeat_robot::set_log::LogEntry;
use downbeat_robot::simulated::{Fault, Outgoing, SimulatedRobot, True};
use downbeat_robot::{Input, LinkId};
use urrcp::{DeviceId, Message, RobotId, Server, Span, Timestamp};

use super::circumstances::{Circumstances, Drawn, Link, Mishap};
use super::operator::VirtualOperator;
use super::spread::{ActStarts, TrueSpread};
use super::{Audience, Cut, Logs};
use crate::world::{Agenda, Direction};
use downbeat_mission::drive::{Filed, Happened, LinkNumber, QueueFull, Urgency, World};
use downbeat_mission::{Event, Loss, Progress, Record};

/// In nanoseconds.
const SECOND: i64 = 1_000_000_000;
/// A connection that does not stand by then is given up, as over TCP (`link/tcp.rs`).
const CONNECT_TIMEOUT: Span = Span::from_millis(3_000);

/// A robot, and the network to it.
struct Place {
    /// `None`: its process is not there.
    machine: Option<SimulatedRobot>,
    /// The process that died, as far as the next one goes on from it.
    died: Option<SimulatedRobot>,
    /// It stands still until then.
    stalls_until: Timestamp<Server>,
    /// `None`: the robot delays its messages itself, and nothing is lost.
    link: Option<Link>,
    /// The newest attempt to reach the robot; it replaces earlier ones.
    attempt: Option<LinkNumber>,
    /// The connections that it has.
    connections: BTreeSet<LinkNumber>,
}

/// Something that happens at an instant outside of the robots.
enum Item {
    /// A connection is begun.
    Connect { robot: usize, link: LinkNumber },
    /// A connection would stand.
    Connected { robot: usize, link: LinkNumber },
    /// Something arrives at a robot.
    AtRobot { robot: usize, link: LinkNumber, input: Box<Input> },
    /// Something arrives from a robot.
    AtScheduler { robot: usize, link: LinkNumber, event: Box<Event> },
    /// Something goes wrong.
    Mishap { robot: usize, mishap: Mishap },
    /// A robot's process begins again.
    Back { robot: usize },
    /// A robot no longer does what it did wrong.
    Obeys { robot: usize, fault: Option<Fault> },
    /// A sensor reads something else.
    Reads { robot: usize, sensor: DeviceId, value: f64 },
}

pub(super) struct VirtualWorld<'a, A> {
    now: Timestamp<Server>,
    places: Vec<Place>,
    /// When each robot is next due, in order, and by robot. What `due` does not confirm is outdated.
    robots: BinaryHeap<Reverse<(Timestamp<Server>, usize)>>,
    due: Vec<Option<Timestamp<Server>>>,
    agenda: Agenda<Item>,
    /// Incidents that wait for their act to be sent.
    awaiting: Vec<Drawn>,
    arrived: VecDeque<Happened>,
    operator: VirtualOperator,
    spread: TrueSpread,
    logs: Vec<Vec<LogEntry>>,
    keeps: Logs,
    audience: &'a mut A,
    /// What robots send, while it is sorted.
    out: Vec<Outgoing>,
}

impl<'a, A: Audience> VirtualWorld<'a, A> {
    pub(super) fn new(
        robots: Vec<SimulatedRobot>,
        ids: Vec<RobotId>,
        begin: Timestamp<Server>,
        (mut operator, circumstances): (VirtualOperator, Circumstances),
        keeps: Logs,
        audience: &'a mut A,
    ) -> Self {
        let count = robots.len();
        let Circumstances { links, incidents, readings, operator: manner } = circumstances;
        let still = readings.iter().map(|(at, ..)| *at).max().unwrap_or(begin);
        operator.behaves(manner, still);
        let links = links.into_iter().chain(std::iter::repeat(None));
        let place = |(machine, link)| Place {
            machine: Some(machine),
            died: None,
            stalls_until: begin,
            link,
            attempt: None,
            connections: BTreeSet::new(),
        };
        let mut world = Self {
            now: begin,
            places: robots.into_iter().zip(links).map(place).collect(),
            robots: (0..count).map(|robot| Reverse((begin, robot))).collect(),
            due: vec![Some(begin); count],
            agenda: Agenda::default(),
            awaiting: Vec::new(),
            arrived: VecDeque::new(),
            operator,
            spread: TrueSpread::new(ids),
            logs: vec![Vec::new(); if keeps == Logs::Kept { count } else { 0 }],
            keeps,
            audience,
            out: Vec::new(),
        };
        for (at, robot, sensor, value) in readings {
            world.put(at, Item::Reads { robot, sensor, value });
        }
        for incident in incidents {
            match incident.act {
                Some(_) => world.awaiting.push(incident),
                None => {
                    let Drawn { robot, mishap, at, .. } = incident;
                    world.put(begin + at, Item::Mishap { robot, mishap });
                }
            }
        }
        world
    }

    fn put(&mut self, at: Timestamp<Server>, item: Item) {
        self.agenda.put(at.max(self.now), item);
    }

    pub(super) const fn true_spread(&self) -> Option<Span> {
        self.spread.largest()
    }

    pub(super) const fn true_end_spread(&self) -> Option<Span> {
        self.spread.largest_of_ends()
    }

    /// How many scripts of the acts that have ended really began.
    pub(super) fn take_starts(&mut self) -> Vec<ActStarts> {
        self.spread.take_starts()
    }

    /// What the robots set, and why the operator ended the mission.
    pub(super) fn end(self) -> (Vec<Vec<LogEntry>>, Option<Cut>) {
        (self.logs, self.operator.cut)
    }

    /// Lets this much time pass without a scheduler. Which robots still have something to do then.
    pub(super) fn settle(mut self, length: Span) -> Vec<bool> {
        let until = self.now + length;
        while let Some(at) = self.next_in_world().filter(|at| *at <= until) {
            self.now = self.now.max(at);
            self.step();
            self.arrived.clear();
        }
        self.due.iter().map(Option::is_some).collect()
    }

    /// The robot that is due first.
    fn first_due(&mut self) -> Option<(Timestamp<Server>, usize)> {
        loop {
            let Reverse((at, robot)) = *self.robots.peek()?;
            if self.due[robot] == Some(at) {
                return Some((at, robot));
            }
            self.robots.pop();
        }
    }

    fn next_instant(&mut self) -> Option<Timestamp<Server>> {
        self.next_in_world().into_iter().chain(self.operator.speaks()).min()
    }

    /// When something happens by itself.
    fn next_in_world(&mut self) -> Option<Timestamp<Server>> {
        let robots = self.first_due().map(|(at, _)| at);
        let items = self.agenda.peek().map(|(at, _)| at);
        robots.into_iter().chain(items).min()
    }

    fn pass(&mut self, at: Timestamp<Server>) {
        let second = |at: Timestamp<Server>| at.as_nanos().div_euclid(SECOND);
        if second(at) > second(self.now) {
            self.audience.second(at);
        }
        self.now = self.now.max(at);
    }

    /// All robots do what is due, in the order of the mission; then comes what else happens, which may let them do more.
    fn step(&mut self) {
        self.advance_robots();
        while let Some(item) = self.agenda.pop_due(self.now) {
            self.happen(item);
            if self.agenda.peek().is_none_or(|(at, _)| at > self.now) {
                self.advance_robots();
            }
        }
    }

    fn advance_robots(&mut self) {
        while let Some((_, robot)) = self.first_due().filter(|(at, _)| *at <= self.now) {
            self.advance(robot);
        }
    }

    fn happen(&mut self, item: Item) {
        match item {
            Item::Connect { robot, link } | Item::Connected { robot, link }
                if self.places[robot].attempt != Some(link) => {}
            Item::Connect { robot, link } => self.begin_connection(robot, link),
            Item::Connected { robot, link } => match self.places[robot].machine {
                Some(_) => {
                    self.places[robot].connections.insert(link);
                    self.arrive(robot, link, Event::LinkUp { robot });
                }
                None => {
                    let reason = "connection refused".to_owned();
                    self.arrive(robot, link, Event::LinkDown { robot, loss: Loss::Refused, reason });
                }
            },
            Item::AtRobot { robot, link, input } => self.reach_robot(robot, link, *input),
            Item::AtScheduler { robot, link, event } => self.arrive(robot, link, *event),
            Item::Mishap { robot, mishap } => self.go_wrong(robot, mishap),
            Item::Back { robot } => {
                let now = self.now.assume_clock();
                let place = &mut self.places[robot];
                place.machine = place.died.take().map(|died| died.restarted(now)).or(place.machine.take());
                self.note_due(robot);
            }
            Item::Obeys { robot, fault } => {
                if let Some(machine) = &mut self.places[robot].machine {
                    machine.replace_fault(fault);
                }
            }
            Item::Reads { robot, sensor, value } => {
                let Place { machine, died, .. } = &mut self.places[robot];
                for machine in machine.iter_mut().chain(died) {
                    machine.set_reading(sensor.clone(), value);
                }
            }
        }
    }

    fn begin_connection(&mut self, robot: usize, link: LinkNumber) {
        let (now, by) = (self.now, self.now + CONNECT_TIMEOUT);
        let connects = |Link { path, rng }: &mut Link| path.connects(rng, now, by);
        match self.places[robot].link.as_mut().map_or(Some(now), connects) {
            Some(at) => self.put(at, Item::Connected { robot, link }),
            None => {
                let reason = format!("no answer within {CONNECT_TIMEOUT}");
                let event = Box::new(Event::LinkDown { robot, loss: Loss::Unreachable, reason });
                self.put(by, Item::AtScheduler { robot, link, event });
            }
        }
    }

    fn reach_robot(&mut self, robot: usize, link: LinkNumber, input: Input) {
        let place = &mut self.places[robot];
        let stands = match input {
            Input::LinkDown => place.connections.remove(&link),
            _ => place.connections.contains(&link),
        };
        if let Some(machine) = place.machine.as_mut().filter(|_| stands) {
            machine.receive(self.now.assume_clock(), LinkId(link.0), input);
            self.note_due(robot);
        }
    }

    fn go_wrong(&mut self, robot: usize, mishap: Mishap) {
        let now = self.now;
        match mishap {
            Mishap::Dies { back_after } => {
                self.collect(robot);
                let place = &mut self.places[robot];
                let Some(machine) = place.machine.take() else { return };
                place.died = Some(machine);
                self.due[robot] = None;
                for link in std::mem::take(&mut self.places[robot].connections) {
                    let (loss, reason) = (Loss::Closed, "the robot closed the connection".to_owned());
                    self.send_back(robot, link, Event::LinkDown { robot, loss, reason });
                }
                if let Some(after) = back_after {
                    self.put(now + after, Item::Back { robot });
                }
            }
            Mishap::Stalls { lasts } => {
                let place = &mut self.places[robot];
                place.stalls_until = place.stalls_until.max(now + lasts);
                self.note_due(robot);
            }
            Mishap::Refuses { lasts } => {
                let Some(machine) = &mut self.places[robot].machine else { return };
                let fault = machine.replace_fault(Some(Fault::Refuse));
                if let Some(lasts) = lasts {
                    self.put(now + lasts, Item::Obeys { robot, fault });
                }
            }
            Mishap::LinkDown { lasts } => {
                if let Some(link) = &mut self.places[robot].link {
                    link.path.block(Direction::ToRobot, now + lasts);
                    link.path.block(Direction::FromRobot, now + lasts);
                }
            }
        }
    }

    /// An act is being sent: what is to go wrong around its start is known now.
    fn act_sent(&mut self, act: &str, start: Timestamp<Server>) {
        let is_of_act = |incident: &mut Drawn| incident.act.as_deref() == Some(act);
        let due: Vec<Drawn> = self.awaiting.extract_if(.., is_of_act).collect();
        for Drawn { robot, mishap, at, .. } in due {
            let at = if let Mishap::Refuses { .. } = mishap { self.now } else { start + at };
            self.put(at, Item::Mishap { robot, mishap });
        }
    }

    fn advance(&mut self, robot: usize) {
        let mut out = std::mem::take(&mut self.out);
        if let Some(machine) = &mut self.places[robot].machine {
            machine.advance(self.now.assume_clock::<True>(), &mut out);
        }
        for outgoing in out.drain(..) {
            match outgoing {
                Outgoing::Message { link, message } => {
                    self.send_back(robot, LinkNumber(link.0), Event::Received { robot, message });
                }
                Outgoing::Close { link } => {
                    self.places[robot].connections.remove(&LinkNumber(link.0));
                    let (loss, reason) = (Loss::Closed, "the robot closed the link".to_owned());
                    self.send_back(robot, LinkNumber(link.0), Event::LinkDown { robot, loss, reason });
                }
            }
        }
        self.out = out;
        self.collect(robot);
        self.note_due(robot);
    }

    /// Takes what the robot has set.
    fn collect(&mut self, robot: usize) {
        let Some(machine) = &mut self.places[robot].machine else { return };
        let mut log = machine.take_log();
        for entry in &log {
            self.spread.see(robot, entry);
            self.audience.set(robot, entry);
        }
        if self.keeps == Logs::Kept {
            self.logs[robot].append(&mut log);
        }
    }

    /// Something from a robot sets out.
    fn send_back(&mut self, robot: usize, link: LinkNumber, event: Event) {
        let message = if let Event::Received { message, .. } = &event { Some(message) } else { None };
        match self.travel(robot, Direction::FromRobot, message) {
            Some(at) => self.put(at, Item::AtScheduler { robot, link, event: Box::new(event) }),
            None => self.give_up(robot, link),
        }
    }

    /// Something to a robot sets out.
    fn send_there(&mut self, robot: usize, link: LinkNumber, input: Input) {
        let message = if let Input::Message(message) = &input { Some(message) } else { None };
        match self.travel(robot, Direction::ToRobot, message) {
            Some(at) => self.put(at, Item::AtRobot { robot, link, input: Box::new(input) }),
            None => self.give_up(robot, link),
        }
    }

    /// When something arrives that sets out now; `None`: the connection is given up.
    fn travel(
        &mut self,
        robot: usize,
        way: Direction,
        message: Option<&Message>,
    ) -> Option<Timestamp<Server>> {
        let now = self.now;
        let Some(Link { path, rng }) = &mut self.places[robot].link else { return Some(now) };
        path.travel(rng, now, way, message).map(|travel| travel.arrives)
    }

    /// The systems at both ends find that nothing passes on a connection.
    fn give_up(&mut self, robot: usize, link: LinkNumber) {
        let (loss, reason) = (Loss::Unreachable, "connection timed out".to_owned());
        self.reach_robot(robot, link, Input::LinkDown);
        self.arrive(robot, link, Event::LinkDown { robot, loss, reason });
    }

    fn note_due(&mut self, robot: usize) {
        let place = &self.places[robot];
        let machine = place.machine.as_ref();
        let next = machine.and_then(SimulatedRobot::next_wakeup).map(Timestamp::assume_clock::<Server>);
        let next = next.map(|at| at.max(place.stalls_until));
        let known = std::mem::replace(&mut self.due[robot], next);
        if known != next {
            self.robots.extend(next.map(|at| Reverse((at, robot))));
        }
    }

    fn arrive(&mut self, robot: usize, link: LinkNumber, event: Event) {
        let event = Box::new(event);
        self.arrived.push_back(Happened::OnLink { at: self.now, robot, link, event });
    }
}

impl<A: Audience> World for VirtualWorld<'_, A> {
    fn now(&self) -> Timestamp<Server> {
        self.now
    }

    async fn next(&mut self, until: Option<Timestamp<Server>>) -> Option<Happened> {
        loop {
            if let Some(word) = self.operator.word(self.now) {
                return Some(Happened::Event { at: self.now, event: Box::new(word) });
            }
            if let Some(happened) = self.arrived.pop_front() {
                return Some(happened);
            }
            match (self.next_instant(), until) {
                (Some(next), until) if until.is_none_or(|until| next <= until) => {
                    self.pass(next);
                    self.step();
                }
                (_, Some(until)) => {
                    self.pass(until);
                    return None;
                }
                // Nothing will ever happen again.
                (_, None) => return Some(Happened::Left),
            }
        }
    }

    fn connect(&mut self, robot: usize, link: LinkNumber, after: Span) {
        if self.places[robot].link.is_some() {
            let older: Vec<LinkNumber> = self.places[robot].connections.iter().copied().collect();
            older.into_iter().for_each(|older| self.send_there(robot, older, Input::LinkDown));
        }
        self.places[robot].attempt = Some(link);
        self.put(self.now + after, Item::Connect { robot, link });
    }

    fn send(
        &mut self,
        robot: usize,
        link: LinkNumber,
        message: Message,
        _: Urgency,
    ) -> Result<(), QueueFull> {
        self.send_there(robot, link, Input::Message(message));
        Ok(())
    }

    fn cut(&mut self, robot: usize, link: LinkNumber) {
        self.send_there(robot, link, Input::LinkDown);
    }

    fn write(&mut self, _: Timestamp<Server>, record: Record) -> Filed {
        if let Record::ActEnded { report, .. } = &record {
            self.spread.act_ended(report);
        }
        Filed::AtOnce
    }

    fn tell(&mut self, at: Timestamp<Server>, progress: Progress) {
        self.operator.see(at, &progress);
        if let Progress::Preparing { act, start, .. } = &progress {
            self.act_sent(act, *start);
        }
        self.audience.told(at, &progress);
    }
}
