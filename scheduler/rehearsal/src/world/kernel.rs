//! Virtual time: it jumps to what happens next.

use downbeat_robot::simulated::SimulatedRobot;
use urrcp::{Server, Timestamp};

use super::{Agenda, Processes};

/// The clock of a world, its items and its robots.
#[derive(Debug)]
pub struct Kernel<T> {
    /// The true time.
    pub now: Timestamp<Server>,
    /// What happens outside of robots.
    pub agenda: Agenda<T>,
    /// The robots' processes.
    pub robots: Processes,
}

impl<T> Kernel<T> {
    /// A world at its beginning.
    pub fn new(machines: impl IntoIterator<Item = Option<SimulatedRobot>>, begin: Timestamp<Server>) -> Self {
        Self { now: begin, agenda: Agenda::default(), robots: Processes::new(machines, begin) }
    }

    /// Adds an item that is due at `at`, or now if that has passed.
    pub fn put(&mut self, at: Timestamp<Server>, item: T) {
        self.agenda.put(at.max(self.now), item);
    }

    /// When something happens next.
    pub fn next_instant(&mut self) -> Option<Timestamp<Server>> {
        let item = self.agenda.peek().map(|(at, _)| at);
        item.into_iter().chain(self.robots.next_instant()).min()
    }
}

/// A world in virtual time.
pub trait Virtual {
    /// What happens outside of robots.
    type Item;

    /// The parts that all worlds share.
    fn kernel(&mut self) -> &mut Kernel<Self::Item>;

    /// Advances a robot to the present, and sends its messages.
    fn advance(&mut self, robot: usize);

    /// Performs an item.
    fn happen(&mut self, item: Self::Item);

    /// When something happens outside of the kernel, such as a word of the operator.
    fn wakes(&self) -> Option<Timestamp<Server>>;

    /// Sets the time to `at`, or leaves it, if it is later already.
    fn pass(&mut self, at: Timestamp<Server>);

    /// When something happens next.
    fn next_instant(&mut self) -> Option<Timestamp<Server>> {
        self.kernel().next_instant().into_iter().chain(self.wakes()).min()
    }

    /// Goes to the next thing that happens: advances all robots in their order, then performs one item, then advances the robots again,
    /// since the item may concern them.
    fn step(&mut self, at: Timestamp<Server>) {
        self.pass(at);
        self.advance_robots();
        let kernel = self.kernel();
        if let Some(item) = kernel.agenda.pop_due(kernel.now) {
            self.happen(item);
            self.advance_robots();
        }
    }

    /// Advances all robots that are due.
    fn advance_robots(&mut self) {
        let kernel = self.kernel();
        for robot in kernel.robots.take_due(kernel.now) {
            self.advance(robot);
        }
    }
}
