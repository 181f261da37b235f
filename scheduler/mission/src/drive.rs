//! The one loop that drives a mission, in real time (`run/`), in virtual time (`dry_run/`) and under faults (`simulation/`).
//!
//! The loop takes events, passes them to the mission, performs the actions in order, and waits until an event occurs or the mission is
//! due. A [`World`] implements everything that differs between these uses: clock, links, journal, output, operator.
//!
//! Every world processes the events of one instant in this order:
//! 1. commands of the operator;
//! 2. events of the journal;
//! 3. events on links, in the order of arrival; in virtual worlds, all robots do their due work before anything arrives;
//! 4. events of NTP;
//! 5. the mission's own timers, so that an answer that arrives just in time is accepted.
//!
//! A virtual world never waits, so `at_once` runs the same asynchronous loop without a runtime.

#![warn(clippy::too_many_lines)]

mod links;

use std::collections::VecDeque;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use urrcp::{Message, Server, Span, Timestamp};

pub use self::links::LinkNumber;
use self::links::Links;
use crate::report::Report;
use crate::{Action, Event, Loss, Mission, Progress, Record, RobotIndex};

/// The maximum number of events taken before the mission's timers are checked again.
const ROUND_MAX: usize = 1_024;

/// The environment of a mission: clock, links, journal, output, operator.
pub trait World {
    /// Returns the current time of the server's clock.
    fn now(&self) -> Timestamp<Server>;

    /// Returns the next event, in the order that this module documents; `None` if no event occurs until `until`. If `until` is `None`,
    /// waits until an event occurs.
    fn next(&mut self, until: Option<Timestamp<Server>>) -> impl Future<Output = Option<Happened>>;

    /// Starts to connect to a robot after the pause `after`. Events of the new connection carry the number `link`. An older link to the
    /// robot is closed.
    fn connect(&mut self, robot: RobotIndex, link: LinkNumber, after: Span);

    /// Sends a message on a link. A message that is not urgent may wait behind others. Never blocks the caller.
    ///
    /// # Errors
    /// [`QueueFull`] if too many messages already wait. The message is lost, and the link can no longer be used.
    fn send(
        &mut self,
        robot: RobotIndex,
        link: LinkNumber,
        message: Message,
        urgency: Urgency,
    ) -> Result<(), QueueFull>;

    /// Closes a link and discards the messages that wait to be sent on it.
    fn cut(&mut self, robot: RobotIndex, link: LinkNumber);

    /// Passes a record to the journal, without waiting for the disk.
    fn write(&mut self, at: Timestamp<Server>, record: Record) -> Filed;

    /// Reports progress to the operator.
    fn tell(&mut self, at: Timestamp<Server>, progress: Progress);

    /// Called by the driver at each iteration of its loop. Must not block.
    fn turned(&mut self, _mission: &Mission) {}

    /// Answers the operator's oldest unanswered go: with the act that the go permits to begin, or with the reason why the go is ignored.
    fn answer(&mut self, _answer: Result<String, String>) {}
}

/// Whether a message may wait behind others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Urgency {
    /// The message is sent after all earlier messages.
    InOrder,
    /// The message is sent before all waiting messages. Used for stops.
    Overtaking,
}

/// Error: too many messages wait to be sent on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the robot does not read its messages: {waiting} are waiting")]
pub struct QueueFull {
    /// Number of waiting messages.
    pub waiting: usize,
}

/// The result of passing a record to the journal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Filed {
    /// The driver need not wait for the record, for example because there is no journal.
    AtOnce,
    /// The record waits to be written. An event of the world reports when it is on disk.
    Waiting,
    /// The journal no longer accepts records. Contains the reason.
    Lost(String),
}

/// An event that a [`World`] returns.
#[derive(Clone, Debug)]
pub enum Happened {
    /// An event on a link. Events on an older link of the same robot are late and ignored.
    OnLink {
        /// The time of the event, by the server's clock.
        at: Timestamp<Server>,
        /// Index of the robot.
        robot: RobotIndex,
        /// The number of the link.
        link: LinkNumber,
        /// The event for the mission.
        event: Box<Event>,
    },
    /// An event that does not belong to a link.
    Event {
        /// The time of the event, by the server's clock.
        at: Timestamp<Server>,
        /// The event for the mission.
        event: Box<Event>,
    },
    /// The operator leaves without waiting for the end of the mission, or no event can ever occur again.
    Left,
    /// The process was killed.
    Killed,
}

/// Drives a mission to its end and returns its report. `None` if its process is killed before the end.
pub async fn drive<W: World>(mission: &mut Mission, world: &mut W) -> Option<Report> {
    let mut driver = Driver::new(mission.robots().len());
    for robot in mission.robots().indices() {
        let link = driver.links.connect(robot);
        world.connect(robot, link, Span::ZERO);
    }
    // The mission may already have ended, for example if all robots were in the process that has died.
    if let Some(report) = Report::of(mission) {
        let actions = mission.advance(world.now());
        driver.perform(world, actions);
        return Some(report);
    }
    loop {
        world.turned(mission);
        let mut until = mission.next_wakeup();
        for _ in 0..ROUND_MAX {
            let (at, event) = match driver.next(world, until).await {
                None => break,
                Some(Happened::Killed) => return None,
                Some(Happened::Left) => return Some(Report::as_left(mission, world.now())),
                Some(Happened::OnLink { at, robot, link, event }) => {
                    if driver.links.takes(robot, link, &event) { (at, event) } else { continue }
                }
                Some(Happened::Event { at, event }) => (at, event),
            };
            let actions = mission.happened(at, world.now(), *event);
            driver.perform(world, actions);
            if let Some(report) = Report::of(mission) {
                return Some(report);
            }
            until = Some(world.now());
        }
        let actions = mission.advance(world.now());
        driver.perform(world, actions);
        if let Some(report) = Report::of(mission) {
            return Some(report);
        }
    }
}

/// Runs a future to its end. Panics if the future has to wait.
pub fn at_once<F: Future>(future: F) -> F::Output {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(output) => output,
        Poll::Pending => unreachable!("a virtual world never waits"),
    }
}

/// State of the loop between two events.
struct Driver {
    links: Links,
    /// Events that follow from performed actions, to be passed to the mission next.
    pending: VecDeque<(Timestamp<Server>, Event)>,
    /// Number of durable records that the driver accepted without waiting for a disk.
    recorded: u64,
    journal: JournalState,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum JournalState {
    Taking,
    /// The journal no longer accepts records, and the mission has been notified.
    Lost,
}

impl Driver {
    fn new(robots: usize) -> Self {
        Self {
            links: Links::new(robots),
            pending: VecDeque::new(),
            recorded: 0,
            journal: JournalState::Taking,
        }
    }

    async fn next<W: World>(&mut self, world: &mut W, until: Option<Timestamp<Server>>) -> Option<Happened> {
        match self.pending.pop_front() {
            Some((at, event)) => Some(Happened::Event { at, event: Box::new(event) }),
            None => world.next(until).await,
        }
    }

    fn perform<W: World>(&mut self, world: &mut W, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Send { robot, message, urgent } => {
                    let urgency = if urgent { Urgency::Overtaking } else { Urgency::InOrder };
                    self.send(world, robot, message, urgency);
                }
                Action::Reconnect { robot, after } => {
                    let link = self.links.connect(robot);
                    world.connect(robot, link, after);
                }
                Action::Record(record) => self.record(world, record),
                Action::Tell(progress) => world.tell(world.now(), progress),
                Action::Answer(answer) => world.answer(answer),
            }
        }
    }

    /// Sends a message. A message on a broken link is lost; the mission receives an event about the break.
    fn send<W: World>(&mut self, world: &mut W, robot: RobotIndex, message: Message, urgency: Urgency) {
        let Some(link) = self.links.of(robot) else { return };
        if let Err(full) = world.send(robot, link, message, urgency) {
            world.cut(robot, link);
            self.links.broke(robot);
            let event = Event::LinkDown { robot, loss: Loss::Unreachable, reason: full.to_string() };
            self.pending.push_back((world.now(), event));
        }
    }

    fn record<W: World>(&mut self, world: &mut W, record: Record) {
        let now = world.now();
        let durable = record.is_durable();
        match world.write(now, record) {
            Filed::AtOnce if durable => {
                self.recorded += 1;
                self.pending.push_back((now, Event::Recorded { count: self.recorded }));
            }
            Filed::Lost(reason) if self.journal == JournalState::Taking => {
                self.journal = JournalState::Lost;
                self.pending.push_back((now, Event::JournalLost { reason }));
            }
            Filed::AtOnce | Filed::Waiting | Filed::Lost(_) => {}
        }
    }
}

#[cfg(test)]
mod tests;
