//! A robot on the precise thread: hardware around it, or a simulated world.

use std::sync::Arc;

use urrcp::Timestamp;

use crate::clock::{HostClock, HostTime};
use crate::driver::{Mailbox, News};
use crate::edge::Edge;
use crate::ids::LinkId;
use crate::outgoing::Outgoing;
use crate::robot::{Input, Robot};
use crate::set_log::LogEntry;
use crate::simulated::SimulatedRobot;

/// What surrounds a robot's machine.
pub(super) enum Body {
    /// Hardware behind a driver.
    Edge(Box<Edge>),
    /// A world with a clock, delays and faults of its own. Its true time is the host's.
    Simulated(Box<SimulatedRobot>),
}

impl Body {
    pub(super) fn is_idle(&self) -> bool {
        match self {
            Self::Edge(edge) => edge.is_idle(),
            Self::Simulated(robot) => robot.is_idle(),
        }
    }

    /// The machine inside.
    pub(super) const fn machine(&self) -> &Robot {
        match self {
            Self::Edge(edge) => edge.machine(),
            Self::Simulated(robot) => robot.robot(),
        }
    }

    /// It looks whether the session to which it belonged is over.
    pub(super) fn look(&mut self, now: Timestamp<HostTime>) {
        match self {
            Self::Edge(edge) => edge.look(now),
            Self::Simulated(robot) => robot.look(now.assume_clock()),
        }
    }

    /// Something was sent to the robot at `now`.
    pub(super) fn receive(&mut self, now: Timestamp<HostTime>, link: LinkId, input: Input) {
        match self {
            Self::Edge(edge) => edge.receive(now, link, input),
            Self::Simulated(robot) => robot.receive(now.assume_clock(), link, input),
        }
    }

    /// Does everything due at or before `now`.
    pub(super) fn advance(&mut self, now: Timestamp<HostTime>, out: &mut Vec<Outgoing>) {
        match self {
            Self::Edge(edge) => edge.advance(now, out),
            Self::Simulated(robot) => robot.advance(now.assume_clock(), out),
        }
    }

    /// The movements due at or before `now`, without their reports.
    pub(super) fn advance_movements(&mut self, now: Timestamp<HostTime>) {
        match self {
            Self::Edge(edge) => edge.advance_movements(now),
            Self::Simulated(robot) => robot.advance_movements(now.assume_clock()),
        }
    }

    /// When [`Body::advance`] is next due.
    pub(super) fn next_wakeup(&self) -> Option<Timestamp<HostTime>> {
        match self {
            Self::Edge(edge) => edge.next_wakeup(),
            Self::Simulated(robot) => robot.next_wakeup().map(Timestamp::assume_clock),
        }
    }

    /// Whether the robot itself has something to do by then: what travels on a simulated network does not count.
    pub(super) fn moves_by(&self, by: Timestamp<HostTime>) -> bool {
        match self {
            Self::Edge(edge) => edge.next_wakeup().is_some_and(|at| at <= by),
            Self::Simulated(robot) => robot.moves_by(by.assume_clock()),
        }
    }

    /// What was set since the last call.
    pub(super) fn take_log(&mut self) -> Vec<LogEntry> {
        match self {
            Self::Edge(edge) => edge.take_log(),
            Self::Simulated(robot) => robot.take_log(),
        }
    }

    /// Whether anything was set since then.
    pub(super) const fn has_log(&self) -> bool {
        match self {
            Self::Edge(edge) => edge.has_log(),
            Self::Simulated(robot) => robot.has_log(),
        }
    }

    /// Passes on what is wanted of hardware.
    pub(super) fn post(&mut self, clock: &HostClock) {
        if let Self::Edge(edge) = self {
            edge.post(clock);
        }
    }

    /// Tells what a driver's thread says.
    pub(super) fn hear(&mut self, now: Timestamp<HostTime>, news: News) {
        if let Self::Edge(edge) = self {
            edge.hear(now, news);
        }
    }

    /// Hardware comes to rest, because the host ends. A simulated robot stays where it is.
    pub(super) fn shut_down(&mut self, now: Timestamp<HostTime>) {
        if let Self::Edge(edge) = self {
            edge.shut_down(now);
        }
    }

    pub(super) fn mailbox(&self) -> Option<Arc<Mailbox>> {
        match self {
            Self::Edge(edge) => Some(edge.mailbox()),
            Self::Simulated(_) => None,
        }
    }
}
