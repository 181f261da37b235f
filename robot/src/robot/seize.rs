//! Seizure: an operator with the role `seize` takes the robot from the session that owns it.

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
}
