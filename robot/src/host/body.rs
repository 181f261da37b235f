//! A robot that the precise thread runs, with its hardware or its simulated world.

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

/// A robot's state machine, with its hardware or its simulated world.
pub(super) enum Body {
    /// A state machine that controls hardware through a driver.
    Edge(Box<Edge>),
    /// A state machine in a simulated world, which has its own clock, delays and faults. The true time of this world is the host's time.
    Simulated(Box<SimulatedRobot>),
}

impl Body {
    pub(super) fn is_idle(&self) -> bool {
        match self {
            Self::Edge(edge) => edge.is_idle(),
            Self::Simulated(robot) => robot.is_idle(),
        }
    }

    /// Returns the robot's state machine.
    pub(super) const fn machine(&self) -> &Robot {
        match self {
            Self::Edge(edge) => edge.machine(),
            Self::Simulated(robot) => robot.robot(),
        }
    }

    /// Makes the robot available to other sessions if the session that owns it is over.
    pub(super) fn look(&mut self, now: Timestamp<HostTime>) {
        match self {
            Self::Edge(edge) => edge.look(now),
            Self::Simulated(robot) => robot.look(now.assume_clock()),
        }
    }

    /// Handles an input that was sent to the robot at `now`.
    pub(super) fn receive(&mut self, now: Timestamp<HostTime>, link: LinkId, input: Input) {
        match self {
            Self::Edge(edge) => edge.receive(now, link, input),
            Self::Simulated(robot) => robot.receive(now.assume_clock(), link, input),
        }
    }

    /// Executes everything due at or before `now`.
    pub(super) fn advance(&mut self, now: Timestamp<HostTime>, out: &mut Vec<Outgoing>) {
        match self {
            Self::Edge(edge) => edge.advance(now, out),
            Self::Simulated(robot) => robot.advance(now.assume_clock(), out),
        }
    }

    /// Executes the movements due at or before `now`, but does not send the reports about them yet.
    pub(super) fn advance_movements(&mut self, now: Timestamp<HostTime>) {
        match self {
            Self::Edge(edge) => edge.advance_movements(now),
            Self::Simulated(robot) => robot.advance_movements(now.assume_clock()),
        }
    }

    /// Returns when [`Body::advance`] is next due.
    pub(super) fn next_wakeup(&self) -> Option<Timestamp<HostTime>> {
        match self {
            Self::Edge(edge) => edge.next_wakeup(),
            Self::Simulated(robot) => robot.next_wakeup().map(Timestamp::assume_clock),
        }
    }

    /// Whether the robot itself has work due at or before `by`. Messages on a simulated network do not count.
    pub(super) fn moves_by(&self, by: Timestamp<HostTime>) -> bool {
        match self {
            Self::Edge(edge) => edge.next_wakeup().is_some_and(|at| at <= by),
            Self::Simulated(robot) => robot.moves_by(by.assume_clock()),
        }
    }

    /// Removes and returns the log entries that were added since the last call.
    pub(super) fn take_log(&mut self) -> Vec<LogEntry> {
        match self {
            Self::Edge(edge) => edge.take_log(),
            Self::Simulated(robot) => robot.take_log(),
        }
    }

    /// Whether there are log entries for [`Body::take_log`] to return.
    pub(super) const fn has_log(&self) -> bool {
        match self {
            Self::Edge(edge) => edge.has_log(),
            Self::Simulated(robot) => robot.has_log(),
        }
    }

    /// Hands the pending hardware requests to the driver, if there is one.
    pub(super) fn post(&mut self, clock: &HostClock) {
        if let Self::Edge(edge) = self {
            edge.post(clock);
        }
    }

    /// Handles a report from a driver's thread.
    pub(super) fn hear(&mut self, clock: &HostClock, news: News) {
        if let Self::Edge(edge) = self {
            edge.hear(clock, news);
        }
    }

    /// Brings hardware to rest, because the host is shutting down. A simulated robot stays where it is.
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
