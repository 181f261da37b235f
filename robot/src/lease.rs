//! The `stop_condition` as a lease: how long a link may stay silent.

use std::collections::HashMap;

use urrcp::{Millis, Robot, StopCondition, Timestamp};

use crate::robot::LinkId;

/// When each link was last heard. Links that are down stay silent, so their leases run out.
#[derive(Clone, Debug, Default)]
pub(crate) struct LastHeard(HashMap<LinkId, Timestamp<Robot>>);

/// Links whose silence is remembered; the longest silent go first.
const LINKS_MAX: usize = 1_024;

impl LastHeard {
    pub(crate) fn heard(&mut self, link: LinkId, now: Timestamp<Robot>) {
        self.0.insert(link, now);
        if self.0.len() > LINKS_MAX {
            let oldest = self.0.iter().min_by_key(|(_, at)| **at).map(|(link, _)| *link);
            oldest.and_then(|link| self.0.remove(&link));
        }
    }

    /// When a party was last heard.
    pub(crate) fn last(&self, party: LinkId) -> Option<Timestamp<Robot>> {
        self.0.get(&party).copied()
    }

    /// When a lease of this length runs out; `None` without a lease.
    pub(crate) fn ends(&self, lease: &Lease) -> Option<Timestamp<Robot>> {
        let silence = lease.silence?.span();
        // A forgotten link has been silent for longer than 1,024 others.
        let heard = self.0.get(&lease.link).copied().unwrap_or(lease.granted);
        Some(heard.max(lease.granted) + silence)
    }
}

/// The lease under which a command is held at the moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lease {
    pub(crate) link: LinkId,
    pub(crate) granted: Timestamp<Robot>,
    /// `None`: no limit.
    pub(crate) silence: Option<Millis>,
}

/// The limit before the start.
pub(crate) fn pending(stop_condition: Option<StopCondition>) -> Option<Millis> {
    stop_condition.and_then(|lease| lease.pending)
}

/// The limit while a step is current; the step's own wins over the command's.
pub(crate) fn running(command: Option<StopCondition>, step: Option<StopCondition>) -> Option<Millis> {
    step.or(command).and_then(|lease| lease.running)
}
