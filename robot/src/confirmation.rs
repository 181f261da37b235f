//! Delayed reports: a robot reports the end of a command only after its hardware has taken the last value.

use std::collections::BTreeMap;

use urrcp::{ControlResponse, Robot, Timestamp};

use crate::device::Effect;
use crate::ids::LinkId;

/// Identifies a question to the driver: has the hardware taken the values that were sent so far?
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// A message that is sent once the hardware has confirmed that it has taken the values.
#[derive(Clone, Debug)]
pub(crate) enum Said {
    /// Report about the end of a command, preceded by the time of that end.
    Report(Timestamp<Robot>, Effect),
    /// Response to a stop request.
    Answer(LinkId, ControlResponse),
}

/// Reports that wait for the hardware's confirmation, in the order of the events. Each contains the index of its device.
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

    /// Removes and returns the report that the hardware has now confirmed. `None` if `give_up` has removed it before.
    pub(crate) fn take(&mut self, ticket: Ticket) -> Option<(usize, Said)> {
        self.waiting.remove(&ticket)
    }

    /// Removes and returns the reports that wait for a confirmation of the device with this index, which will no longer come.
    pub(crate) fn give_up(&mut self, device: usize) -> Vec<Said> {
        let all = std::mem::take(&mut self.waiting).into_iter();
        let (given_up, left): (BTreeMap<_, _>, _) = all.partition(|(_, (of, _))| *of == device);
        self.waiting = left;
        given_up.into_values().map(|(_, said)| said).collect()
    }
}
