//! The one loop that drives a mission, in real time (`run/`), in virtual time (`dry_run/`) and under faults (`simulation/`).
//!
//! It takes what happens, hands it to the mission, performs the actions in order, and waits until something happens or the
//! mission is due. A [`World`] is what differs: clock, links, journal, output, operator.
//!
//! The order at one instant, in every world:
//! 1. the operator's words;
//! 2. what the journal says;
//! 3. what happened on links, in the order of arrival; in virtual worlds all robots do what is due before anything arrives;
//! 4. what NTP says;
//! 5. the mission's own timers, so that an answer that arrives just in time counts.
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
use crate::{Action, Event, Loss, Mission, Progress, Record};

/// Events that are taken before the mission's timers are looked at again, however many more wait.
const ROUND_MAX: usize = 1_024;

/// What surrounds a mission.
pub trait World {
    /// What the server's clock shows.
    fn now(&self) -> Timestamp<Server>;

    /// The next thing that happens until then, in the order that this module states. `None`: nothing has happened, and it is
    /// that late now. Without `until` there is nothing but events to wait for.
    fn next(&mut self, until: Option<Timestamp<Server>>) -> impl Future<Output = Option<Happened>>;

    /// Begins to connect to a robot after a pause; what becomes of that happens under this number. An older link to the
    /// robot is closed.
    fn connect(&mut self, robot: usize, link: LinkNumber, after: Span);

    /// Sends a message on a link. It may wait behind others, if it is not urgent; it never makes the caller wait.
    ///
    /// # Errors
    /// [`QueueFull`] where too much waits already: the message is lost, and the link of no more use.
    fn send(
        &mut self,
        robot: usize,
        link: LinkNumber,
        message: Message,
        urgency: Urgency,
    ) -> Result<(), QueueFull>;

    /// Closes a link and discards what waits to be sent on it.
    fn cut(&mut self, robot: usize, link: LinkNumber);

    /// Hands a record to the journal, without waiting for the disk.
    fn write(&mut self, at: Timestamp<Server>, record: Record) -> Filed;

    /// Tells the operator.
    fn tell(&mut self, at: Timestamp<Server>, progress: Progress);

    /// The loop turns once more. Nothing of this may wait.
    fn turned(&mut self, _mission: &Mission) {}

    /// Answers the oldest go of the operator that has no answer yet: which act it lets begin, or why it counts for none.
    fn answer(&mut self, _answer: Result<String, String>) {}
}

/// Whether a message may wait behind others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Urgency {
    /// Behind all that was sent before it.
    InOrder,
    /// Ahead of all that waits: a stop.
    Overtaking,
}

/// Too many messages wait to be sent on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the robot does not read: {waiting} messages wait for it")]
pub struct QueueFull {
    /// How many.
    pub waiting: usize,
}

/// What became of a record that was handed to the journal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Filed {
    /// There is nothing to wait for, as without a journal.
    AtOnce,
    /// The world says by an event when it is on the disk.
    Waiting,
    /// The journal takes no more, and why.
    Lost(String),
}

/// Something that happened in the world.
#[derive(Clone, Debug)]
pub enum Happened {
    /// On a link. What happens on an older link of the same robot comes too late and is ignored.
    OnLink {
        /// When it happened, by the server's clock.
        at: Timestamp<Server>,
        /// Index of the robot.
        robot: usize,
        /// On which of its links.
        link: LinkNumber,
        /// The event for the mission.
        event: Box<Event>,
    },
    /// Anywhere else.
    Event {
        /// When it happened, by the server's clock.
        at: Timestamp<Server>,
        /// The event for the mission.
        event: Box<Event>,
    },
    /// The operator leaves without waiting for anything, or nothing will ever happen again.
    Left,
    /// The process is gone.
    Killed,
}

/// Drives a mission to its end. `None` if its process is killed before.
pub async fn drive<W: World>(mission: &mut Mission, world: &mut W) -> Option<Report> {
    let mut driver = Driver::new(mission.robots().len());
    for robot in 0..mission.robots().len() {
        let link = driver.links.connect(robot);
        world.connect(robot, link, Span::ZERO);
    }
    // There may be nothing to wait for, as where all robots were in the process that is gone.
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

/// Runs a future that never waits.
pub fn at_once<F: Future>(future: F) -> F::Output {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(output) => output,
        Poll::Pending => unreachable!("a virtual world never waits"),
    }
}

/// What the loop keeps between two events.
struct Driver {
    links: Links,
    /// What follows from performing actions, for the mission to hear next.
    pending: VecDeque<(Timestamp<Server>, Event)>,
    /// Durable records that had not to wait for a disk.
    recorded: u64,
    journal: JournalState,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum JournalState {
    Taking,
    /// The mission has been told.
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

    /// What is sent on a link that has broken is lost: the mission hears of the break by its own event.
    fn send<W: World>(&mut self, world: &mut W, robot: usize, message: Message, urgency: Urgency) {
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
