//! A `stop_condition` as a lease: it limits how long a link may be silent before the robot ends commands.

use std::collections::{BTreeMap, HashSet};

use urrcp::{Millis, Robot, StopCondition, Timestamp};

use crate::ids::LinkId;

/// The time of the last message of each party (a session, or a link without a session). A link that is down is silent, so its leases
/// expire.
#[derive(Clone, Debug)]
pub(crate) struct LastMessages {
    at: BTreeMap<LinkId, Timestamp<Robot>>,
    /// The party that sent the most recent message, with the time of the message. Nearly every step of a device looks up this party.
    latest: Option<(LinkId, Timestamp<Robot>)>,
    /// Number of entries above which the parties without commands are forgotten.
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
    /// Records that a message of `party` arrived at `now`. Returns whether there are too many entries; the caller must then call
    /// [`LastMessages::keep`] with the parties that hold commands.
    #[must_use]
    pub(crate) fn heard(&mut self, party: LinkId, now: Timestamp<Robot>) -> bool {
        self.at.insert(party, now);
        self.latest = Some((party, now));
        self.at.len() > self.room
    }

    /// Forgets all parties except those in `holding`. This loses nothing: if a party has no entry, its lease counts from the time when it
    /// was granted.
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

    /// Returns when a lease ends unless another message arrives. `None` if the lease does not limit the silence.
    pub(crate) fn ends(&self, lease: &Lease) -> Option<Timestamp<Robot>> {
        let silence = lease.silence?.span();
        let heard = self.last(lease.link).unwrap_or(lease.granted);
        Some(heard.max(lease.granted) + silence)
    }
}

/// The lease that currently applies to a command.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lease {
    pub(crate) link: LinkId,
    pub(crate) granted: Timestamp<Robot>,
    /// Maximum silence of the link before the lease ends. `None`: no limit.
    pub(crate) silence: Option<Millis>,
}

/// Returns the maximum silence of the link before a command starts. `None`: no limit.
pub(crate) fn pending(stop_condition: Option<StopCondition>) -> Option<Millis> {
    stop_condition.and_then(|lease| lease.pending)
}

/// Returns the maximum silence of the link while a step is executed. The `stop_condition` of the step takes precedence over that of the
/// command. `None`: no limit.
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
    fn parties_without_held_commands_are_forgotten_when_there_are_too_many() {
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
    fn parties_with_held_commands_leave_room_for_as_many_others() {
        let mut heard = LastMessages::default();
        let holding: HashSet<_> = (0..2_000).map(LinkId).collect();
        let full = holding.iter().filter(|party| heard.heard(**party, at(1))).count();
        assert_eq!(full, 2_000 - PARTIES_MIN);
        heard.keep(&holding);
        let full = (2_000..4_001).map(|party| heard.heard(LinkId(party), at(2)));
        assert_eq!(full.collect::<Vec<_>>().iter().position(|full| *full), Some(2_000));
    }

    #[test]
    fn lease_counts_from_its_start_or_from_the_last_received_message() {
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
