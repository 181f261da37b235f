//! Ends that a robot does not tell before its hardware has taken the last value.

use std::collections::BTreeMap;

use urrcp::{ControlResponse, Robot, Timestamp};

use crate::device::Effect;
use crate::ids::LinkId;

/// Names a question whether the hardware has taken what it was told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// What is told once the hardware has confirmed it.
#[derive(Clone, Debug)]
pub(crate) enum Said {
    /// The end of a command, and when it was.
    Report(Timestamp<Robot>, Effect),
    /// The answer to a stop.
    Answer(LinkId, ControlResponse),
}

/// What waits for the hardware, each with the index of its device; in the order in which it happened.
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

    /// The hardware has taken it. `None` if that was given up before.
    pub(crate) fn take(&mut self, ticket: Ticket) -> Option<(usize, Said)> {
        self.waiting.remove(&ticket)
    }

    /// What waits for the hardware to move a device: it will not be confirmed.
    pub(crate) fn give_up(&mut self, device: usize) -> Vec<Said> {
        let all = std::mem::take(&mut self.waiting).into_iter();
        let (given_up, left): (BTreeMap<_, _>, _) = all.partition(|(_, (of, _))| *of == device);
        self.waiting = left;
        given_up.into_values().map(|(_, said)| said).collect()
    }
}
