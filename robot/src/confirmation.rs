//! Ends that a robot reports only after its hardware has taken the last value.

use std::collections::BTreeMap;

use urrcp::{ControlResponse, Robot, Timestamp};

use crate::device::Effect;
use crate::ids::LinkId;

/// Identifies a question whether the hardware has taken the values it received.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// Reported once the hardware has confirmed.
#[derive(Clone, Debug)]
pub(crate) enum Said {
    /// The end of a command, and its time.
    Report(Timestamp<Robot>, Effect),
    /// The answer to a stop.
    Answer(LinkId, ControlResponse),
}

/// Reports that wait for the hardware, each with the index of its device, in the order of the events.
#[derive(Clone, Debug, Default)]
pub(crate) struct Unconfirmed {
    waiting: BTreeMap<Ticket, (usize, Said)>,
    last: u64,
}

impl Unconfirmed {
    pub(crate) fn add(&mut self, device: usize, said: Said) -> Ticket {
        self.last += 1;
        let ticket = Ticket(self.last);
        self.waiting.insert(ticket, (device, said));
        ticket
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Returns the report that the hardware has now confirmed. `None` if it was given up before.
    pub(crate) fn take(&mut self, ticket: Ticket) -> Option<(usize, Said)> {
        self.waiting.remove(&ticket)
    }

    /// Removes and returns the reports that wait for a device: they will not be confirmed.
    pub(crate) fn give_up(&mut self, device: usize) -> Vec<Said> {
        let all = std::mem::take(&mut self.waiting).into_iter();
        let (given_up, left): (BTreeMap<_, _>, _) = all.partition(|(_, (of, _))| *of == device);
        self.waiting = left;
        given_up.into_values().map(|(_, said)| said).collect()
    }
}
