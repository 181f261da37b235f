//! How a session loses the robot: an operator with the role `seize` takes it, or the key of the session's operator becomes invalid.

use urrcp::{ControlError, ErrorCode, Label, SessionId};

use super::control::Owner;
use super::{Now, Output, Robot};
use crate::device::{DeviceMachine, Rest};
use crate::ids::LinkId;

impl Robot {
    /// Takes the robot for this session, whose peer has permission to seize it. Before the robot responds, the commands of other sessions
    /// end, and every device begins to come to rest.
    ///
    /// Changes nothing if the robot is free or already belongs to the session. Changes nothing either if its hardware is away: the robot
    /// then holds no commands, and its last values may still be on their way to the hardware.
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

    /// Ends the commands of all parties with this key, which is no longer valid, even if their links have broken. Brings the devices of
    /// these commands to rest. If one of the parties owns the robot, brings all devices to rest, because the owner may have left some of
    /// them moving, and releases the robot.
    pub(super) fn bar(&mut self, now: Now, serial: &Label, why: String, out: &mut Vec<Output>) {
        let owner = self.parties.last_owner().filter(|party| self.parties.has_key(*party, serial));
        let name = self.parties.owner_name().filter(|_| owner.is_some());
        let name = name.map_or_else(String::new, |name| format!(" of {name}"));
        tracing::warn!(robot = %self.block.id, %serial, "the commands{name} end: {why}");
        let error = ControlError::new(ErrorCode::Forbidden, why);
        for index in 0..self.devices.len() {
            let mut holders = self.devices[index].parties();
            if owner.is_some() || holders.any(|party| self.parties.has_key(party, serial)) {
                drop(holders);
                self.stop_with(now, index, &error, Rest::InPlace, out);
            }
        }
        if owner.is_some() {
            self.parties.release();
        }
    }
}
