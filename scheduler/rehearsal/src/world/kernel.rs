//! Virtual time, which jumps from one event to the next.

use downbeat_robot::simulated::SimulatedRobot;
use urrcp::{Server, Timestamp};

use super::{Agenda, Processes};

/// The parts that all virtual worlds share: the clock, the scheduled items and the robots.
#[derive(Debug)]
pub struct Kernel<T> {
    /// The current true time.
    pub now: Timestamp<Server>,
    /// The scheduled events other than wake-ups of robots.
    pub agenda: Agenda<T>,
    /// The robots' processes.
    pub robots: Processes,
}

impl<T> Kernel<T> {
    /// Creates the clock, the robots and an empty agenda of a world whose time starts at `begin`.
    pub fn new(machines: impl IntoIterator<Item = Option<SimulatedRobot>>, begin: Timestamp<Server>) -> Self {
        Self { now: begin, agenda: Agenda::default(), robots: Processes::new(machines, begin) }
    }

    /// Adds an item that is due at `at`. If `at` has passed, the item is due now.
    pub fn put(&mut self, at: Timestamp<Server>, item: T) {
        self.agenda.put(at.max(self.now), item);
    }

    /// Returns when the next event is due; `None` without an event.
    pub fn next_instant(&mut self) -> Option<Timestamp<Server>> {
        let item = self.agenda.peek().map(|(at, _)| at);
        item.into_iter().chain(self.robots.next_instant()).min()
    }
}

/// A world in virtual time.
pub trait Virtual {
    /// The type of scheduled events other than wake-ups of robots.
    type Item;

    /// Returns the parts that all virtual worlds share: the clock, the scheduled items and the robots.
    fn kernel(&mut self) -> &mut Kernel<Self::Item>;

    /// Advances a robot to the current time, and sends its messages.
    fn advance(&mut self, robot: usize);

    /// Executes a scheduled item.
    fn happen(&mut self, item: Self::Item);

    /// Returns when the next event outside the kernel, such as an operator's input, is due; `None` if no such event is due.
    fn wakes(&self) -> Option<Timestamp<Server>>;

    /// Sets the time to `at`, unless it is already later.
    fn pass(&mut self, at: Timestamp<Server>);

    /// Returns when the next event is due; `None` without an event.
    fn next_instant(&mut self) -> Option<Timestamp<Server>> {
        self.kernel().next_instant().into_iter().chain(self.wakes()).min()
    }

    /// Jumps to `at`, the instant of the next event. Advances all robots that are due, executes one item, and advances robots again,
    /// because the item may affect them.
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
