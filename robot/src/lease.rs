//! A `stop_condition` as a lease: how long a link may be silent before commands end.

use std::collections::{BTreeMap, HashSet};

use urrcp::{Millis, Robot, StopCondition, Timestamp};

use crate::ids::LinkId;

/// The time of each party's last message. A link that is down is silent, so its leases expire.
#[derive(Clone, Debug)]
pub(crate) struct LastMessages {
    at: BTreeMap<LinkId, Timestamp<Robot>>,
    /// Entry of the party that sent the latest message. At nearly every step of a device, this is the party that is looked up.
    latest: Option<(LinkId, Timestamp<Robot>)>,
    /// Number of entries above which parties that hold no commands are forgotten.
    room: usize,
}

/// Minimum number of parties whose last message is remembered.
const PARTIES_MIN: usize = 1_024;

impl Default for LastMessages {
    fn default() -> Self {
        Self { at: BTreeMap::new(), latest: None, room: PARTIES_MIN }
    }
}

impl LastMessages {
    /// Records that a message of `party` arrived at `now`. Returns whether it is time to call [`LastMessages::keep`] with the parties
    /// that hold commands.
    #[must_use]
    pub(crate) fn heard(&mut self, party: LinkId, now: Timestamp<Robot>) -> bool {
        self.at.insert(party, now);
        self.latest = Some((party, now));
        self.at.len() > self.room
    }

    /// Forgets all parties except these. This loses nothing: without an entry, a lease counts from the time when it was granted.
    pub(crate) fn keep(&mut self, holding: &HashSet<LinkId>) {
        self.at.retain(|party, _| holding.contains(party));
        self.latest = None;
        self.room = PARTIES_MIN.max(2 * self.at.len());
    }

    /// Returns the time of a party's last message, if it is remembered.
    pub(crate) fn last(&self, party: LinkId) -> Option<Timestamp<Robot>> {
        match self.latest {
            Some((latest, at)) if latest == party => Some(at),
            _ => self.at.get(&party).copied(),
        }
    }

    /// Returns when a lease ends. `None` if its silence has no limit.
    pub(crate) fn ends(&self, lease: &Lease) -> Option<Timestamp<Robot>> {
        let silence = lease.silence?.span();
        let heard = self.last(lease.link).unwrap_or(lease.granted);
        Some(heard.max(lease.granted) + silence)
    }
}

/// A command's current lease.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lease {
    pub(crate) link: LinkId,
    pub(crate) granted: Timestamp<Robot>,
    /// Maximum silence of the link. `None`: no limit.
    pub(crate) silence: Option<Millis>,
}

/// Returns the maximum silence before the start. `None`: no limit.
pub(crate) fn pending(stop_condition: Option<StopCondition>) -> Option<Millis> {
    stop_condition.and_then(|lease| lease.pending)
}

/// Returns the maximum silence while a step is current. The step's own condition takes precedence over the command's. `None`: no limit.
pub(crate) fn running(command: Option<StopCondition>, step: Option<StopCondition>) -> Option<Millis> {
    step.or(command).and_then(|lease| lease.running)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Timestamp<Robot> {
        Timestamp::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn parties_that_hold_nothing_are_forgotten_once_there_are_too_many() {
        let mut heard = LastMessages::default();
        let many = PARTIES_MIN as u64;
        let full: Vec<_> = (0..=many).map(|party| heard.heard(LinkId(party), at(1))).collect();
        assert_eq!(full.iter().filter(|full| **full).count(), 1, "with the last");
        heard.keep(&HashSet::from([LinkId(0), LinkId(7)]));
        assert_eq!(heard.at.len(), 2);
        let last = [0, 7, 8, many].map(|party| heard.last(LinkId(party)));
        assert_eq!(last, [Some(at(1)), Some(at(1)), None, None]);
        assert!(!heard.heard(LinkId(9), at(2)), "there is room again");
        assert_eq!(heard.last(LinkId(9)), Some(at(2)));
    }

    #[test]
    fn many_that_hold_something_have_room_for_as_many_more() {
        let mut heard = LastMessages::default();
        let holding: HashSet<_> = (0..2_000).map(LinkId).collect();
        let full = holding.iter().filter(|party| heard.heard(**party, at(1))).count();
        assert_eq!(full, 2_000 - PARTIES_MIN);
        heard.keep(&holding);
        let full = (2_000..4_001).map(|party| heard.heard(LinkId(party), at(2)));
        assert_eq!(full.collect::<Vec<_>>().iter().position(|full| *full), Some(2_000));
    }

    #[test]
    fn a_lease_counts_from_its_begin_or_from_what_was_heard_last() {
        let mut heard = LastMessages::default();
        let silence = Millis::new(100.0).ok();
        let lease = Lease { link: LinkId(1), granted: at(50), silence };
        assert_eq!(heard.ends(&lease), Some(at(150)));
        let _room = heard.heard(LinkId(1), at(20));
        assert_eq!(heard.ends(&lease), Some(at(150)));
        let _room = heard.heard(LinkId(1), at(80));
        let _room = heard.heard(LinkId(2), at(90));
        assert_eq!(heard.ends(&lease), Some(at(180)));
        assert_eq!(heard.ends(&Lease { silence: None, ..lease }), None);
    }
}
