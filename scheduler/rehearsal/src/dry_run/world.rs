//! The world of a dry run: robots, links, the faults of a trial, and a clock that jumps.

use std::collections::{BTreeSet, VecDeque};

use downbeat_robot::set_log::LogEntry;
use downbeat_robot::simulated::{Fault, Outgoing, SimulatedRobot};
use downbeat_robot::{Input, LinkId};
use urrcp::{DeviceId, Message, RobotId, Server, Span, Timestamp};

use super::circumstances::{Circumstances, Drawn, Link, Mishap};
use super::operator::VirtualOperator;
use super::spread::{ActStarts, TrueSpread};
use super::{Audience, Cut, Logs};
use crate::world::{Direction, Kernel, Virtual};
use downbeat_mission::drive::{Filed, Happened, LinkNumber, QueueFull, Urgency, World};
use downbeat_mission::{Event, IndexVec, Loss, Progress, Record, RobotIndex};

/// One second in nanoseconds.
const SECOND: i64 = 1_000_000_000;
/// Time within which a connection must be established; otherwise the attempt fails, as over TCP (`link/tcp.rs`).
const CONNECT_TIMEOUT: Span = Span::from_millis(3_000);

/// The network of one robot and the state of its process.
struct Place {
    /// The state of a process that died; a restarted process continues from it.
    died: Option<SimulatedRobot>,
    /// The link to the robot. `None`: the robot delays its messages itself, and no message is lost.
    link: Option<Link>,
    /// The newest connection attempt to the robot, which replaces earlier attempts.
    attempt: Option<LinkNumber>,
    /// The robot's open connections.
    connections: BTreeSet<LinkNumber>,
}

/// A scheduled event other than the wake-up of a robot.
pub(super) enum Item {
    /// A connection attempt starts.
    Connect { robot: RobotIndex, link: LinkNumber },
    /// A connection attempt succeeds, if the robot's process runs.
    Connected { robot: RobotIndex, link: LinkNumber },
    /// A message or another input arrives at a robot.
    AtRobot { robot: RobotIndex, link: LinkNumber, input: Box<Input> },
    /// An event from a robot arrives at the scheduler.
    AtScheduler { robot: RobotIndex, link: LinkNumber, event: Box<Event> },
    /// A fault occurs.
    Mishap { robot: RobotIndex, mishap: Mishap },
    /// A robot's process restarts.
    Back { robot: RobotIndex },
    /// A fault ends, and the robot obeys again.
    Obeys { robot: RobotIndex, fault: Option<Fault> },
    /// The reading of a sensor changes.
    Reads { robot: RobotIndex, sensor: DeviceId, value: f64 },
}

pub(super) struct VirtualWorld<'a, A> {
    kernel: Kernel<Item>,
    places: IndexVec<RobotIndex, Place>,
    /// Incidents whose time is unknown until their act is sent.
    awaiting: Vec<Drawn>,
    arrived: VecDeque<Happened>,
    operator: VirtualOperator,
    spread: TrueSpread,
    logs: Vec<Vec<LogEntry>>,
    keeps: Logs,
    audience: &'a mut A,
    /// Buffer for the messages of a robot while they are distributed.
    out: Vec<Outgoing>,
}

impl<'a, A: Audience> VirtualWorld<'a, A> {
    pub(super) fn new(
        robots: Vec<SimulatedRobot>,
        ids: Vec<RobotId>,
        begin: Timestamp<Server>,
        mut operator: VirtualOperator,
        circumstances: Circumstances,
        keeps: Logs,
        audience: &'a mut A,
    ) -> Self {
        let count = robots.len();
        let Circumstances { links, incidents, readings, operator: manner } = circumstances;
        let still = readings.iter().map(|(at, ..)| *at).max().unwrap_or(begin);
        operator.behaves(manner, still);
        let links = links.into_iter().chain(std::iter::repeat(None));
        let place = |link| Place { died: None, link, attempt: None, connections: BTreeSet::new() };
        let mut world = Self {
            kernel: Kernel::new(robots.into_iter().map(Some), begin),
            places: links.take(count).map(place).collect(),
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
            world.kernel.put(at, Item::Reads { robot, sensor, value });
        }
        for incident in incidents {
            match incident.act {
                Some(_) => world.awaiting.push(incident),
                None => {
                    let Drawn { robot, mishap, at, .. } = incident;
                    world.kernel.put(begin + at, Item::Mishap { robot, mishap });
                }
            }
        }
        world
    }

    pub(super) const fn true_spread(&self) -> Option<Span> {
        self.spread.largest()
    }

    pub(super) const fn true_end_spread(&self) -> Option<Span> {
        self.spread.largest_of_ends()
    }

    /// Removes and returns, for each act that has ended, the scripts that really started.
    pub(super) fn take_starts(&mut self) -> Vec<ActStarts> {
        self.spread.take_starts()
    }

    /// Returns the values that the robots set, and why the operator ended the mission, if it did.
    pub(super) fn end(self) -> (Vec<Vec<LogEntry>>, Option<Cut>) {
        (self.logs, self.operator.cut)
    }

    /// Advances time by `length` without a scheduler. For each robot, returns whether it is still active afterwards.
    pub(super) fn settle(mut self, length: Span) -> Vec<bool> {
        let until = self.kernel.now + length;
        while let Some(at) = self.kernel.next_instant().filter(|at| *at <= until) {
            self.step(at);
            self.arrived.clear();
        }
        let wakes = |robot| self.kernel.robots.get(robot).and_then(SimulatedRobot::next_wakeup);
        (0..self.places.len()).map(|robot| wakes(robot).is_some()).collect()
    }

    fn begin_connection(&mut self, robot: RobotIndex, link: LinkNumber) {
        let (now, by) = (self.kernel.now, self.kernel.now + CONNECT_TIMEOUT);
        let connects = |Link { path, rng }: &mut Link| path.connects(rng, now, by);
        match self.places[robot].link.as_mut().map_or(Some(now), connects) {
            Some(at) => self.kernel.put(at, Item::Connected { robot, link }),
            None => {
                let reason = format!("no answer within {CONNECT_TIMEOUT}");
                let event = Box::new(Event::LinkDown { robot, loss: Loss::Unreachable, reason });
                self.kernel.put(by, Item::AtScheduler { robot, link, event });
            }
        }
    }

    fn reach_robot(&mut self, robot: RobotIndex, link: LinkNumber, input: Input) {
        let connections = &mut self.places[robot].connections;
        let stands = match input {
            Input::LinkDown => connections.remove(&link),
            _ => connections.contains(&link),
        };
        if stands {
            let now = self.kernel.now.assume_clock();
            self.kernel.robots.change(robot.get(), |machine| machine.receive(now, LinkId(link.0), input));
        }
    }

    fn go_wrong(&mut self, robot: RobotIndex, mishap: Mishap) {
        let now = self.kernel.now;
        match mishap {
            Mishap::Dies { back_after } => {
                self.collect(robot);
                let Some(machine) = self.kernel.robots.end(robot.get()) else { return };
                self.places[robot].died = Some(machine);
                for link in std::mem::take(&mut self.places[robot].connections) {
                    let (loss, reason) = (Loss::Closed, "the robot closed the connection".to_owned());
                    self.send_back(robot, link, Event::LinkDown { robot, loss, reason });
                }
                if let Some(after) = back_after {
                    self.kernel.put(now + after, Item::Back { robot });
                }
            }
            Mishap::Stalls { lasts } => self.kernel.robots.stall(robot.get(), now + lasts),
            Mishap::Refuses { lasts } => {
                let refuse = |machine: &mut SimulatedRobot| machine.replace_fault(Some(Fault::Refuse));
                let fault = self.kernel.robots.change(robot.get(), refuse);
                if let (Some(fault), Some(lasts)) = (fault, lasts) {
                    self.kernel.put(now + lasts, Item::Obeys { robot, fault });
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

    /// Schedules the incidents of an act. Called when the act is sent, because its start is then known.
    fn act_sent(&mut self, act: &str, start: Timestamp<Server>) {
        let is_of_act = |incident: &mut Drawn| incident.act.as_deref() == Some(act);
        let due: Vec<Drawn> = self.awaiting.extract_if(.., is_of_act).collect();
        for Drawn { robot, mishap, at, .. } in due {
            let at = if let Mishap::Refuses { .. } = mishap { self.kernel.now } else { start + at };
            self.kernel.put(at, Item::Mishap { robot, mishap });
        }
    }

    /// Collects the values that `robot` has set since the last call.
    fn collect(&mut self, robot: RobotIndex) {
        let log = self.kernel.robots.change(robot.get(), SimulatedRobot::take_log);
        let Some(mut log) = log else { return };
        for entry in &log {
            self.spread.see(robot, entry);
            self.audience.set(robot, entry);
        }
        if self.keeps == Logs::Kept {
            self.logs[robot.get()].append(&mut log);
        }
    }

    /// Sends an event from a robot to the scheduler.
    fn send_back(&mut self, robot: RobotIndex, link: LinkNumber, event: Event) {
        let message = if let Event::Received { message, .. } = &event { Some(message) } else { None };
        match self.travel(robot, Direction::FromRobot, message) {
            Some(at) => self.kernel.put(at, Item::AtScheduler { robot, link, event: Box::new(event) }),
            None => self.give_up(robot, link),
        }
    }

    /// Sends an input from the scheduler to a robot.
    fn send_there(&mut self, robot: RobotIndex, link: LinkNumber, input: Input) {
        let message = if let Input::Message(message) = &input { Some(message) } else { None };
        match self.travel(robot, Direction::ToRobot, message) {
            Some(at) => self.kernel.put(at, Item::AtRobot { robot, link, input: Box::new(input) }),
            None => self.give_up(robot, link),
        }
    }

    /// Returns the arrival time of a message that is sent now; `None` if the message does not arrive and the connection breaks.
    fn travel(
        &mut self,
        robot: RobotIndex,
        way: Direction,
        message: Option<&Message>,
    ) -> Option<Timestamp<Server>> {
        let now = self.kernel.now;
        let Some(Link { path, rng }) = &mut self.places[robot].link else { return Some(now) };
        path.travel(rng, now, way, message).map(|travel| travel.arrives)
    }

    /// Breaks a connection: the operating systems at both ends report that it timed out.
    fn give_up(&mut self, robot: RobotIndex, link: LinkNumber) {
        let (loss, reason) = (Loss::Unreachable, "connection timed out".to_owned());
        self.reach_robot(robot, link, Input::LinkDown);
        self.arrive(robot, link, Event::LinkDown { robot, loss, reason });
    }

    fn arrive(&mut self, robot: RobotIndex, link: LinkNumber, event: Event) {
        let event = Box::new(event);
        self.arrived.push_back(Happened::OnLink { at: self.kernel.now, robot, link, event });
    }
}

impl<A: Audience> Virtual for VirtualWorld<'_, A> {
    type Item = Item;

    fn kernel(&mut self) -> &mut Kernel<Item> {
        &mut self.kernel
    }

    fn advance(&mut self, robot: usize) {
        let robot = RobotIndex::new(robot);
        let mut out = std::mem::take(&mut self.out);
        let now = self.kernel.now.assume_clock();
        self.kernel.robots.change(robot.get(), |machine| machine.advance(now, &mut out));
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
    }

    fn happen(&mut self, item: Item) {
        match item {
            Item::Connect { robot, link } | Item::Connected { robot, link }
                if self.places[robot].attempt != Some(link) => {}
            Item::Connect { robot, link } => self.begin_connection(robot, link),
            Item::Connected { robot, link } if self.kernel.robots.get(robot.get()).is_some() => {
                self.places[robot].connections.insert(link);
                self.arrive(robot, link, Event::LinkUp { robot });
            }
            Item::Connected { robot, link } => {
                let reason = "connection refused".to_owned();
                self.arrive(robot, link, Event::LinkDown { robot, loss: Loss::Refused, reason });
            }
            Item::AtRobot { robot, link, input } => self.reach_robot(robot, link, *input),
            Item::AtScheduler { robot, link, event } => self.arrive(robot, link, *event),
            Item::Mishap { robot, mishap } => self.go_wrong(robot, mishap),
            Item::Back { robot } => {
                if let Some(died) = self.places[robot].died.take() {
                    self.kernel.robots.begin(robot.get(), died.restarted(self.kernel.now.assume_clock()));
                }
            }
            Item::Obeys { robot, fault } => {
                self.kernel.robots.change(robot.get(), |machine| machine.replace_fault(fault));
            }
            Item::Reads { robot, sensor, value } => {
                if let Some(died) = &mut self.places[robot].died {
                    died.set_reading(sensor.clone(), value);
                }
                self.kernel.robots.change(robot.get(), |machine| machine.set_reading(sensor, value));
            }
        }
    }

    fn wakes(&self) -> Option<Timestamp<Server>> {
        self.operator.speaks()
    }

    fn pass(&mut self, at: Timestamp<Server>) {
        let second = |at: Timestamp<Server>| at.as_nanos().div_euclid(SECOND);
        if second(at) > second(self.kernel.now) {
            self.audience.second(at);
        }
        self.kernel.now = at.max(self.kernel.now);
    }
}

impl<A: Audience> World for VirtualWorld<'_, A> {
    fn now(&self) -> Timestamp<Server> {
        self.kernel.now
    }

    async fn next(&mut self, until: Option<Timestamp<Server>>) -> Option<Happened> {
        loop {
            if let Some(word) = self.operator.word(self.kernel.now) {
                return Some(Happened::Event { at: self.kernel.now, event: Box::new(word) });
            }
            if let Some(happened) = self.arrived.pop_front() {
                return Some(happened);
            }
            match (self.next_instant(), until) {
                (Some(next), until) if until.is_none_or(|until| next <= until) => self.step(next),
                (_, Some(until)) => {
                    self.pass(until);
                    return None;
                }
                // No further event will ever occur.
                (_, None) => return Some(Happened::Left),
            }
        }
    }

    fn connect(&mut self, robot: RobotIndex, link: LinkNumber, after: Span) {
        if self.places[robot].link.is_some() {
            let older: Vec<LinkNumber> = self.places[robot].connections.iter().copied().collect();
            older.into_iter().for_each(|older| self.send_there(robot, older, Input::LinkDown));
        }
        self.places[robot].attempt = Some(link);
        self.kernel.put(self.kernel.now + after, Item::Connect { robot, link });
    }

    fn send(
        &mut self,
        robot: RobotIndex,
        link: LinkNumber,
        message: Message,
        _: Urgency,
    ) -> Result<(), QueueFull> {
        self.send_there(robot, link, Input::Message(message));
        Ok(())
    }

    fn cut(&mut self, robot: RobotIndex, link: LinkNumber) {
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
