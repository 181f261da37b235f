//! The parties that use the links, and the party that owns the robot.
//!
//! A session is one run of a scheduler. It may use several links, in sequence or at the same time: leases, responses and stops belong to
//! the session, not to a link. A link that names no session is a party of its own.

use std::collections::{BTreeMap, HashMap, HashSet};

use urrcp::{Label, Robot, SessionId, Span, Timestamp};

use crate::ids::LinkId;
use crate::lease::LastMessages;
use urrcp::Proof;

/// Minimum silence of the session that owns an idle robot before another session may claim the robot.
const CLAIM_SILENCE: Span = Span::from_millis(5_000);
/// Maximum number of sessions that a robot remembers.
pub(crate) const SESSIONS_MAX: usize = 256;

/// A possible owner of the robot: a session, and the proven name of the peer that uses it, if any. The id of a session is a secret of the
/// peers that use it. Peers with different proven names have different sessions, even if they use the same session id.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Claimant {
    pub(crate) session: SessionId,
    pub(crate) peer: Option<Label>,
}

/// All parties of a robot. The id of a party is the id of its first link, unless another party already has this id.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parties {
    of_link: BTreeMap<LinkId, LinkId>,
    of_session: HashMap<Claimant, LinkId>,
    /// The proven identity of the peer on each link.
    proof_of: BTreeMap<LinkId, Proof>,
    /// For each party, the serial number of the key with which it sent its last message. Kept after its links have broken.
    key_of: HashMap<LinkId, Label>,
    /// For each party, the link on which its last message arrived.
    route: BTreeMap<LinkId, LinkId>,
    owner: Option<(Claimant, LinkId)>,
    /// The owner before the last seizure, and the name of the operator that seized the robot. `None` if no owner lost the robot by a
    /// seizure.
    seized: Option<(Claimant, Label)>,
    /// Number of owner changes so far.
    changes: u64,
    /// Number of parties whose id is not that of their first link. Their ids are counted down from the largest number, so that they never
    /// equal the id of a link.
    named: u64,
}

impl Parties {
    /// Returns the party that uses a link: a session, or the link itself if no session was named on it.
    pub(crate) fn party(&self, link: LinkId) -> LinkId {
        self.of_link.get(&link).copied().unwrap_or(link)
    }

    /// Returns the link on which to send messages to a party (a session, or a link without a session).
    pub(crate) fn route(&self, party: LinkId) -> LinkId {
        self.route.get(&party).copied().unwrap_or(party)
    }

    /// Records the proven identity of this link's peer.
    pub(crate) fn proven(&mut self, link: LinkId, proof: Proof) {
        self.proof_of.insert(link, proof);
    }

    /// Returns the proven identity of a link's peer. `None` if no proof is required.
    pub(crate) fn proof(&self, link: LinkId) -> Option<&Proof> {
        self.proof_of.get(&link)
    }

    /// Records the key with which a party has sent a message on this link.
    pub(crate) fn used_key(&mut self, party: LinkId, link: LinkId) {
        let serial = self.proof_of.get(&link).and_then(|proof| proof.serial.as_ref());
        if let Some(serial) = serial.filter(|serial| self.key_of.get(&party) != Some(serial)) {
            self.key_of.insert(party, serial.clone());
        }
    }

    /// Whether a party sent its last message with this key.
    pub(crate) fn has_key(&self, party: LinkId, serial: &Label) -> bool {
        self.key_of.get(&party) == Some(serial)
    }

    /// Forgets the keys of all parties except these.
    pub(crate) fn keep_keys(&mut self, parties: &HashSet<LinkId>) {
        self.key_of.retain(|party, _| parties.contains(party));
    }

    fn name(&self, link: LinkId) -> Option<&Label> {
        self.proof(link).map(|proof| &proof.name)
    }

    /// Returns the claimant (a possible owner) that consists of this session and the proven name of this link's peer.
    pub(crate) fn claimant(&self, link: LinkId, session: &SessionId) -> Claimant {
        Claimant { session: session.clone(), peer: self.name(link).cloned() }
    }

    /// Whether `claimant` consists of this session and the proven name of this link's peer.
    pub(crate) fn is_claimant(&self, link: LinkId, session: &SessionId, claimant: &Claimant) -> bool {
        claimant.session == *session && claimant.peer.as_ref() == self.name(link)
    }

    /// Records that a message of a session arrived on a link. Returns the session's party.
    pub(crate) fn join(&mut self, link: LinkId, session: &SessionId) -> LinkId {
        let claimant = self.claimant(link, session);
        let party = match self.of_session.get(&claimant) {
            Some(party) => *party,
            None => {
                if self.of_session.len() >= SESSIONS_MAX {
                    self.forget_oldest();
                }
                // If the link belonged to another session before, the new session becomes a party with an id that no other party has or
                // had.
                let taken = self.of_session.values().any(|party| *party == link);
                self.named += u64::from(taken);
                let party = if taken { LinkId(u64::MAX - self.named) } else { link };
                self.of_session.insert(claimant, party);
                party
            }
        };
        if let Some(before) = self.of_link.insert(link, party).filter(|before| *before != party) {
            self.leave(before, link);
        }
        self.route.insert(party, link);
        party
    }

    pub(crate) fn link_down(&mut self, link: LinkId) {
        let party = self.party(link);
        self.of_link.remove(&link);
        self.proof_of.remove(&link);
        self.leave(party, link);
    }

    /// Removes a link from a party. After that, messages to the party use another of its links, if it has one.
    fn leave(&mut self, party: LinkId, link: LinkId) {
        if self.route.get(&party) == Some(&link) {
            self.route.remove(&party);
            let other = self.of_link.iter().filter(|(_, p)| **p == party).map(|(link, _)| *link).max();
            other.map(|link| self.route.insert(party, link));
        }
    }

    /// Returns the session that owns the robot. A session remains the owner while the robot holds commands, or while one of its links is
    /// up and its last message is less than [`CLAIM_SILENCE`] old.
    pub(crate) fn owner(
        &self,
        now: Timestamp<Robot>,
        idle: bool,
        heard: &LastMessages,
    ) -> Option<&(Claimant, LinkId)> {
        self.owner.as_ref().filter(|(_, party)| {
            let recent = heard.last(*party).is_some_and(|at| now < at + CLAIM_SILENCE);
            !idle || (recent && self.route.contains_key(party))
        })
    }

    /// Makes the claimant the owner of the robot.
    pub(crate) fn claim(&mut self, claimant: Claimant, party: LinkId) {
        if self.owner.as_ref().is_none_or(|(owner, _)| *owner != claimant) {
            self.owner = Some((claimant, party));
            self.changes += 1;
        }
    }

    /// Returns the proven name of the peer whose session owns the robot, or owned it last.
    pub(crate) fn owner_name(&self) -> Option<&Label> {
        self.owner.as_ref().and_then(|(owner, _)| owner.peer.as_ref())
    }

    /// Transfers the robot from its owner to the claimant, whose peer has proven the name `by`.
    pub(crate) fn seize(&mut self, claimant: Claimant, party: LinkId, by: Label) {
        self.seized = self.owner.take().map(|(before, _)| (before, by));
        self.claim(claimant, party);
    }

    /// Returns the name of the operator that seized the robot from this session of the link's peer. `None` if there was no seizure, or if
    /// the last one affected another session.
    pub(crate) fn seized_by(&self, link: LinkId, session: &SessionId) -> Option<&Label> {
        let (_, by) = self.seized.as_ref().filter(|(from, _)| self.is_claimant(link, session, from))?;
        Some(by)
    }

    /// Releases the robot: after that, no session owns it.
    pub(crate) fn release(&mut self) {
        if self.owner.take().is_some() {
            self.changes += 1;
        }
    }

    /// Returns the current or last owner of the robot. `None` if there was none.
    #[cfg(feature = "host")]
    pub(crate) fn last_claimant(&self) -> Option<&Claimant> {
        self.owner.as_ref().map(|(claimant, _)| claimant)
    }

    /// Returns a number that changes whenever the result of [`Parties::last_claimant`] changes.
    #[cfg(feature = "host")]
    pub(crate) const fn changes(&self) -> u64 {
        self.changes
    }

    /// Returns the party that owns the robot, or owned it last.
    pub(crate) fn last_owner(&self) -> Option<LinkId> {
        self.owner.as_ref().map(|(_, party)| *party)
    }

    /// Returns how many entries about parties are stored in all.
    #[cfg(test)]
    pub(crate) fn remembered(&self) -> usize {
        let keys = self.proof_of.len() + self.key_of.len();
        self.of_link.len() + self.of_session.len() + self.route.len() + keys
    }

    fn forget_oldest(&mut self) {
        let silent = self.of_session.iter().filter(|(claimant, party)| {
            let owns = self.owner.as_ref().is_some_and(|(owner, _)| owner == *claimant);
            !owns && !self.route.contains_key(*party)
        });
        let oldest = silent.min_by_key(|(_, party)| **party).map(|(claimant, _)| claimant.clone());
        // If all links are up, the number of links bounds the sessions.
        oldest.and_then(|claimant| self.of_session.remove(&claimant));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use urrcp::Roles;

    const ONE: LinkId = LinkId(1);
    const TWO: LinkId = LinkId(2);
    const THREE: LinkId = LinkId(3);

    fn session(name: &str) -> SessionId {
        name.parse().unwrap()
    }

    fn at(millis: i64) -> Timestamp<Robot> {
        Timestamp::from_nanos(millis * 1_000_000)
    }

    fn proof(name: &str) -> Proof {
        Proof { name: name.parse().unwrap(), roles: Roles::default(), serial: None }
    }

    #[test]
    fn party_is_reached_on_its_last_active_connection_or_its_newest() {
        let mut parties = Parties::default();
        for link in [ONE, THREE, TWO] {
            assert_eq!(parties.join(link, &session("s")), ONE, "it is named by its first link");
            assert_eq!((parties.party(link), parties.route(ONE)), (ONE, link));
        }
        parties.link_down(ONE);
        assert_eq!(parties.route(ONE), TWO, "that was another link");
        parties.link_down(TWO);
        assert_eq!((parties.party(TWO), parties.route(ONE)), (TWO, THREE));
        parties.link_down(THREE);
        assert_eq!(parties.route(ONE), ONE, "no link is left");
    }

    #[test]
    fn connection_with_another_session_leaves_its_party_for_a_new_one() {
        let mut parties = Parties::default();
        parties.join(ONE, &session("a"));
        parties.join(TWO, &session("a"));
        parties.join(ONE, &session("a"));
        let new = parties.join(ONE, &session("b"));
        assert_ne!(new, ONE);
        assert_eq!((parties.party(ONE), parties.route(new), parties.route(ONE)), (new, ONE, TWO));
        let third = parties.join(ONE, &session("c"));
        assert!(third != new && third != ONE, "a name that no other has or had");
        assert_eq!(parties.join(THREE, &session("b")), new, "its session is remembered");
    }

    #[test]
    fn session_of_a_proven_name_differs_from_the_same_session_of_others() {
        let mut parties = Parties::default();
        parties.proven(ONE, proof("eve"));
        parties.proven(TWO, proof("eve"));
        let eves = parties.join(ONE, &session("s"));
        assert_eq!(parties.join(TWO, &session("s")), eves);
        assert_eq!(parties.join(THREE, &session("s")), THREE);
        let claimant = parties.claimant(ONE, &session("s"));
        let is = |link, name: &str| parties.is_claimant(link, &session(name), &claimant);
        assert_eq!([is(TWO, "s"), is(THREE, "s"), is(TWO, "t")], [true, false, false]);
        parties.link_down(ONE);
        assert_eq!(parties.proof(ONE), None);
    }

    #[test]
    fn idle_robot_belongs_to_a_connected_party_active_in_last_five_seconds() {
        let mut parties = Parties::default();
        let party = parties.join(ONE, &session("s"));
        parties.claim(parties.claimant(ONE, &session("s")), party);
        let mut heard = LastMessages::default();
        let owned = |parties: &Parties, heard: &LastMessages, millis, idle| {
            parties.owner(at(millis), idle, heard).is_some()
        };
        assert_eq!([true, false].map(|idle| owned(&parties, &heard, 0, idle)), [false, true]);
        let _room = heard.heard(party, at(1_000));
        assert_eq!([5_999, 6_000].map(|now| owned(&parties, &heard, now, true)), [true, false]);
        assert!(owned(&parties, &heard, 60_000, false), "it holds something of it");
        parties.link_down(ONE);
        assert_eq!([true, false].map(|idle| owned(&parties, &heard, 1_001, idle)), [false, true]);
    }

    #[test]
    fn ownership_changes_are_counted_and_reported_to_the_previous_owner() {
        let mut parties = Parties::default();
        parties.proven(ONE, proof("eve"));
        let eve = parties.claimant(ONE, &session("s"));
        let adam = Claimant { session: session("t"), peer: Some("adam".parse().unwrap()) };
        assert!(parties.owner_name().is_none());
        parties.claim(eve.clone(), ONE);
        parties.claim(eve, ONE);
        assert_eq!((parties.changes, parties.last_owner()), (1, Some(ONE)));
        assert_eq!(parties.seized_by(ONE, &session("s")), None);
        parties.seize(adam, TWO, "adam".parse().unwrap());
        assert_eq!((parties.changes, parties.last_owner()), (2, Some(TWO)));
        assert_eq!(parties.owner_name().map(Label::as_str), Some("adam"));
        assert_eq!(parties.seized_by(ONE, &session("s")).map(Label::as_str), Some("adam"));
        assert_eq!(parties.seized_by(TWO, &session("s")), None, "that is another's session");
        parties.release();
        parties.release();
        assert_eq!((parties.changes, parties.last_owner()), (3, None));
    }

    #[test]
    fn oldest_session_without_robot_and_connection_is_forgotten_at_the_limit() {
        let mut parties = Parties::default();
        let name = |number: usize| session(&format!("s{number}"));
        let link = |number: usize| LinkId(number as u64);
        for number in 0..SESSIONS_MAX {
            parties.join(link(number), &name(number));
        }
        parties.claim(parties.claimant(link(0), &name(0)), link(0));
        [0, 2, 3].into_iter().for_each(|number| parties.link_down(link(number)));
        let known = |parties: &Parties, number| {
            parties.of_session.contains_key(&Claimant { session: name(number), peer: None })
        };
        parties.join(link(1_000), &name(1_000));
        assert_eq!([0, 1, 2, 3, 1_000].map(|n| known(&parties, n)), [true, true, false, true, true]);
        assert_eq!(parties.of_session.len(), SESSIONS_MAX);
        parties.join(link(1), &name(1));
        assert!(known(&parties, 3), "one that is known needs no room");
        parties.join(link(1_001), &name(1_001));
        assert!(!known(&parties, 3));
    }
}
