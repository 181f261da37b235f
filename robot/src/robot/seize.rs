//! Losing the robot: an operator with the role `seize` takes it from the session that owns it, or the owner's key becomes invalid.

use urrcp::SessionId;

use super::control::Owner;
use super::{Now, Output, Robot};
use crate::device::{DeviceMachine, Rest};
use crate::ids::LinkId;

impl Robot {
    /// Takes the robot for this session, whose peer is permitted to seize. First, the commands of other sessions end and every device
    /// comes to rest; the response follows.
    ///
    /// Nothing changes if the robot is free or belongs to the session. Nothing changes either if its hardware is away: the robot holds no
    /// command, and its last values may still be on the way to the hardware.
    pub(super) fn seize(&mut self, now: Now, link: LinkId, session: &SessionId, out: &mut Vec<Output>) {
        let Some(by) = self.parties.proof(link).map(|proof| proof.name.clone()) else { return };
        let holds = || !self.devices.iter().all(DeviceMachine::is_idle);
        let is_taken = match self.owner(now, link, Some(session)) {
            Owner::Asker => false,
            Owner::Another(_) => true,
            // Any peer that reaches a free robot can command it without a session.
            Owner::Nobody => holds(),
        };
        if !is_taken || self.hardware.away().is_some() {
            return;
        }
        self.release_if_over(now);
        let from =
            self.parties.owner_name().map_or_else(|| "another session".to_owned(), ToString::to_string);
        tracing::warn!(robot = %self.block.id, "seized by {by}, taken from {from}");
        let why = format!("taken by {by}");
        for index in 0..self.devices.len() {
            self.stop(now, index, &why, Rest::InPlace, out);
        }
        self.devices.iter_mut().for_each(|device| device.claimed(now));
        let claimant = self.parties.claimant(link, session);
        self.parties.seize(claimant, self.parties.party(link), by);
    }
    /// Ends the commands of a peer whose key is no longer valid, and brings their devices to rest. If the peer's session owns the robot, all
    /// devices come to rest, because the session may have left some moving, and the robot is free.
    pub(super) fn bar(&mut self, now: Now, link: LinkId, why: &str, out: &mut Vec<Output>) {
        let party = self.parties.party(link);
        let name = self.parties.proof(link).map_or_else(String::new, |proof| format!(" of {}", proof.name));
        tracing::warn!(robot = %self.block.id, "the session{name} ends: {why}");
        let is_owner = self.parties.last_owner() == Some(party);
        for index in 0..self.devices.len() {
            if is_owner || self.devices[index].parties().any(|holder| holder == party) {
                self.stop(now, index, why, Rest::InPlace, out);
            }
        }
        if is_owner {
            self.parties.release();
        }
    }
}
