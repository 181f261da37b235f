//! The world of a dry run: robots, links without faults, and a clock that jumps.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, VecDeque};

use downbeat_robot::set_log::{Kept, LogEntry};
use downbeat_robot::simulated::{Outgoing, SimulatedRobot, True};
use downbeat_robot::{Input, LinkId};
use urrcp::{Message, RobotId, Server, Span, Timestamp};

use super::operator::VirtualOperator;
use super::spread::TrueSpread;
use super::{Audience, Cut, Logs};
use crate::drive::{Filed, Happened, LinkNumber, QueueFull, Urgency, World};
use crate::mission::{Event, Loss, Progress, Record};

/// In nanoseconds.
const SECOND: i64 = 1_000_000_000;

pub(super) struct VirtualWorld<'a, A> {
    now: Timestamp<Server>,
    robots: Vec<SimulatedRobot>,
    /// When each robot is next due, in order, and by robot. What `due` does not confirm is outdated.
    agenda: BinaryHeap<Reverse<(Timestamp<Server>, usize)>>,
    due: Vec<Option<Timestamp<Server>>>,
    /// Links to be made.
    connecting: BTreeSet<(Timestamp<Server>, usize, LinkNumber)>,
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
        mut robots: Vec<SimulatedRobot>,
        ids: Vec<RobotId>,
        begin: Timestamp<Server>,
        operator: VirtualOperator,
        keeps: Logs,
        audience: &'a mut A,
    ) -> Self {
        let count = robots.len();
        if keeps == Logs::Dropped {
            robots.iter_mut().for_each(|robot| robot.keep(Kept::FirstSteps));
        }
        Self {
            now: begin,
            robots,
            agenda: (0..count).map(|robot| Reverse((begin, robot))).collect(),
            due: vec![Some(begin); count],
            connecting: BTreeSet::new(),
            arrived: VecDeque::new(),
            operator,
            spread: TrueSpread::new(ids),
            logs: vec![Vec::new(); if keeps == Logs::Kept { count } else { 0 }],
            keeps,
            audience,
            out: Vec::new(),
        }
    }

    pub(super) const fn true_spread(&self) -> Option<Span> {
        self.spread.largest()
    }

    /// What the robots set, and why the operator ended the mission.
    pub(super) fn end(self) -> (Vec<Vec<LogEntry>>, Option<Cut>) {
        (self.logs, self.operator.cut)
    }

    /// Lets this much time pass without a scheduler. Which robots still have something to do then.
    pub(super) fn settle(mut self, length: Span) -> Vec<bool> {
        let until = self.now + length;
        self.connecting.clear();
        while let Some((at, robot)) = self.first_due().filter(|(at, _)| *at <= until) {
            self.now = self.now.max(at);
            self.advance(robot);
            self.arrived.clear();
        }
        self.due.iter().map(Option::is_some).collect()
    }

    /// The robot that is due first.
    fn first_due(&mut self) -> Option<(Timestamp<Server>, usize)> {
        loop {
            let Reverse((at, robot)) = *self.agenda.peek()?;
            if self.due[robot] == Some(at) {
                return Some((at, robot));
            }
            self.agenda.pop();
        }
    }

    fn next_instant(&mut self) -> Option<Timestamp<Server>> {
        let robots = self.first_due().map(|(at, _)| at);
        let links = self.connecting.first().map(|(at, ..)| *at);
        robots.into_iter().chain(links).chain(self.operator.speaks()).min()
    }

    fn pass(&mut self, at: Timestamp<Server>) {
        let second = |at: Timestamp<Server>| at.as_nanos().div_euclid(SECOND);
        if second(at) > second(self.now) {
            self.audience.second(at);
        }
        self.now = self.now.max(at);
    }

    /// All robots do what is due, in the order of the mission; then links are made.
    fn step(&mut self) {
        while let Some((_, robot)) = self.first_due().filter(|(at, _)| *at <= self.now) {
            self.advance(robot);
        }
        while let Some(first) = self.connecting.first().copied().filter(|(at, ..)| *at <= self.now) {
            self.connecting.remove(&first);
            let (_, robot, link) = first;
            self.arrive(robot, link, Event::LinkUp { robot });
        }
    }

    fn advance(&mut self, robot: usize) {
        let mut out = std::mem::take(&mut self.out);
        self.robots[robot].advance(self.now.assume_clock::<True>(), &mut out);
        for outgoing in out.drain(..) {
            match outgoing {
                Outgoing::Message { link, message } => {
                    self.arrive(robot, LinkNumber(link.0), Event::Received { robot, message });
                }
                Outgoing::Close { link } => {
                    let (loss, reason) = (Loss::Closed, "the robot closed the link".to_owned());
                    self.arrive(robot, LinkNumber(link.0), Event::LinkDown { robot, loss, reason });
                }
            }
        }
        self.out = out;
        let mut log = self.robots[robot].take_log();
        for entry in &log {
            self.spread.see(robot, entry);
            self.audience.set(robot, entry);
        }
        if self.keeps == Logs::Kept {
            self.logs[robot].append(&mut log);
        }
        self.note_due(robot);
    }

    fn note_due(&mut self, robot: usize) {
        let next = self.robots[robot].next_wakeup().map(Timestamp::assume_clock::<Server>);
        let known = std::mem::replace(&mut self.due[robot], next);
        if known != next {
            self.agenda.extend(next.map(|at| Reverse((at, robot))));
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
        self.connecting.insert((self.now + after, robot, link));
    }

    fn send(
        &mut self,
        robot: usize,
        link: LinkNumber,
        message: Message,
        _: Urgency,
    ) -> Result<(), QueueFull> {
        self.robots[robot].receive(self.now.assume_clock(), LinkId(link.0), Input::Message(message));
        self.note_due(robot);
        Ok(())
    }

    fn cut(&mut self, robot: usize, link: LinkNumber) {
        self.robots[robot].receive(self.now.assume_clock(), LinkId(link.0), Input::LinkDown);
        self.note_due(robot);
    }

    fn write(&mut self, _: Timestamp<Server>, record: Record) -> Filed {
        if let Record::ActEnded { report, .. } = &record {
            self.spread.act_ended(report);
        }
        Filed::AtOnce
    }

    fn tell(&mut self, at: Timestamp<Server>, progress: Progress) {
        self.operator.see(at, &progress);
        self.audience.told(at, &progress);
    }
}
