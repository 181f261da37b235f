//! Handling of control requests, in the order of the section "Refusing" of `docs/protocol.md`.

use urrcp::{
    Command, ContentHash, ControlError, ControlRequest, ControlResponse, ControlType, ErrorCode, SessionId,
    Status, StatusValue, Timestamp,
};

use super::{Now, Output, Robot, tell};
use crate::device::{DeviceMachine, Rest};
use crate::ids::CommandId;
use crate::ids::LinkId;
use urrcp::Role;

/// The owner of the robot, as seen by the sender of a request.
pub(super) enum Owner {
    Nobody,
    /// The sender's own session.
    Asker,
    /// Another session. Contains the error with which the robot refuses the sender's request.
    Another(ControlError),
}

impl Robot {
    /// Handles a control request. `computed` is the hash of the command, if it has already been computed.
    pub(super) fn control(
        &mut self,
        now: Now,
        link: LinkId,
        request: ControlRequest,
        computed: Option<ContentHash>,
        out: &mut Vec<Output>,
    ) {
        if let Some(answer) = request.request_id.as_ref().and_then(|id| self.answers.find(id)) {
            return tell(link, ControlResponse { timestamp: now, ..answer.clone() }, out);
        }
        if !self.only_reads(&request)
            && !self.stops_others(link, &request)
            && let Err(error) = self.claim(now, link, request.session.as_ref())
        {
            // The response is not remembered: the same request may be accepted once the robot is free.
            return tell(link, ControlResponse::refusal(now, &request, error), out);
        }
        let Some(&index) = self.index_of.get(&request.device_id) else {
            let error = ControlError::new(
                ErrorCode::UnknownDevice,
                format!("`{}` has no device `{}`", self.block.id, request.device_id),
            );
            return self.refuse(now, link, &request, error, out);
        };
        let content_hash = match check_hash(&request, computed) {
            Ok(content_hash) => content_hash,
            Err(error) => return self.refuse(now, link, &request, error, out),
        };
        if let Some(missing) = self.hardware.away() {
            // The response is not remembered: the same request may be accepted once the hardware is back.
            return tell(link, ControlResponse::refusal(now, &request, missing), out);
        }
        match &request.command {
            Command::ReadSensor => return self.provide(now, link, index, &request, out),
            Command::Script(script) if script.is_empty() => {
                return self.cancel(now, link, index, &request, content_hash, out);
            }
            Command::Set(_) | Command::Script(_) | Command::Unknown(_) => {}
        }
        match self.accept(now, link, index, &request) {
            Ok(command) => {
                self.plan(index, command);
                self.confirm(now, link, index, &request, content_hash, out);
            }
            Err(error) => {
                if error.code == ErrorCode::UnsupportedControlType {
                    let why = "the device went to its default state: it received an unsupported control type";
                    self.stop(now, index, why, Rest::Home, out);
                }
                self.refuse(now, link, &request, error, out);
            }
        }
    }

    /// Whether a request only reads a sensor. False if the device is not a sensor, because the request then moves the device to its
    /// default state.
    fn only_reads(&self, request: &ControlRequest) -> bool {
        let device = self.index_of.get(&request.device_id).map(|index| &self.devices[*index].spec);
        matches!(request.command, Command::ReadSensor)
            && device.is_some_and(|spec| spec.available_control_types.sensor().is_some())
    }

    /// Whether the sender of a request may stop a robot that belongs to another session. A stop that names a session affects only the
    /// commands of that session: after a seizure, the mission that lost the robot must not stop the mission that has it now.
    fn stops_others(&self, link: LinkId, request: &ControlRequest) -> bool {
        let may = || self.parties.proof(link).is_some_and(|proof| proof.roles.has(Role::Stop));
        request.is_stop() && request.session.is_none() && may()
    }

    /// Claims the robot for a session, if it is free. Without a session, nothing is claimed, and a robot that another session has claimed
    /// remains unavailable.
    pub(super) fn claim(
        &mut self,
        now: Now,
        link: LinkId,
        session: Option<&SessionId>,
    ) -> Result<(), ControlError> {
        match self.owner(now, link, session) {
            Owner::Another(busy) => return Err(busy),
            Owner::Asker => {}
            // A claim that has ended stays ended, whatever commands other parties hold later.
            Owner::Nobody => {
                self.parties.release();
                if session.is_some() {
                    self.devices.iter_mut().for_each(|device| device.claimed(now));
                }
            }
        }
        if let Some(session) = session {
            let claimant = self.parties.claimant(link, session);
            self.parties.claim(claimant, self.parties.party(link));
        }
        Ok(())
    }

    /// Returns the owner of the robot, as seen by this session. The result never reveals the id of another session: with this id, anyone
    /// could stop the robot, renew leases and divert reports.
    pub(super) fn owner(&self, now: Now, link: LinkId, session: Option<&SessionId>) -> Owner {
        let idle = self.devices.iter().all(DeviceMachine::is_idle);
        match self.parties.owner(now, idle, &self.heard) {
            None => Owner::Nobody,
            Some((owner, _))
                if session.is_some_and(|session| self.parties.is_claimant(link, session, owner)) =>
            {
                Owner::Asker
            }
            Some(_) => {
                let id = &self.block.id;
                let message = match session.and_then(|session| self.parties.seized_by(link, session)) {
                    Some(by) => format!("`{id}` was taken over by {by}"),
                    None => format!("`{id}` belongs to another session until that session ends"),
                };
                Owner::Another(ControlError::new(ErrorCode::Busy, message))
            }
        }
    }

    fn accept(
        &mut self,
        now: Now,
        link: LinkId,
        index: usize,
        request: &ControlRequest,
    ) -> Result<CommandId, ControlError> {
        self.devices[index].accept(now, start_of(now, request), self.parties.party(link), request)
    }

    fn confirm(
        &mut self,
        now: Now,
        link: LinkId,
        index: usize,
        request: &ControlRequest,
        content_hash: Option<ContentHash>,
        out: &mut Vec<Output>,
    ) {
        let status_value = match &request.command {
            Command::Set(setpoint) => StatusValue::Number(setpoint.value),
            Command::Script(script) => StatusValue::Script(script.clone()),
            Command::ReadSensor | Command::Unknown(_) => StatusValue::Null,
        };
        let answer = ControlResponse {
            status_value,
            content_hash,
            request_id: request.request_id.clone(),
            ..ControlResponse::new(now, request.device_id.clone(), Status::Accepted)
        };
        self.answer(link, answer, out);
        if let Some(id) = &request.request_id {
            self.answers.plan(id, start_of(now, request));
        }
        self.refresh_wakeup(index);
        self.advance(now, out);
    }

    fn provide(
        &mut self,
        now: Now,
        link: LinkId,
        index: usize,
        request: &ControlRequest,
        out: &mut Vec<Output>,
    ) {
        let spec = &self.devices[index].spec;
        let Some(sensor) = spec.available_control_types.sensor() else {
            let message = format!("`{}` is not a sensor", spec.id);
            let error = ControlError::new(ErrorCode::UnsupportedControlType, message);
            let why = "the device went to its default state: it received a request for a reading, but it is not a sensor";
            self.stop(now, index, why, Rest::Home, out);
            return self.refuse(now, link, request, error, out);
        };
        if !self.hardware.is_simulated() {
            let max_delay = sensor.max_delay;
            return self.ask_hardware(now, link, request, max_delay, out);
        }
        let middle = f64::midpoint(sensor.min_value, sensor.max_value);
        let position = self.devices[index].value(ControlType::Position, now);
        let reading = self.readings.get(&request.device_id).copied().or(position).unwrap_or(middle);
        let answer = ControlResponse {
            status_value: StatusValue::Number(reading),
            request_id: request.request_id.clone(),
            ..ControlResponse::new(now, request.device_id.clone(), Status::Provide)
        };
        // The response is not remembered: a repeated request reads the sensor again.
        tell(link, answer, out);
    }

    fn cancel(
        &mut self,
        now: Now,
        link: LinkId,
        index: usize,
        request: &ControlRequest,
        content_hash: Option<ContentHash>,
        out: &mut Vec<Output>,
    ) {
        let why = match self.parties.proof(link) {
            Some(proof) => format!("stopped by {}", proof.name),
            None => "cancelled by an empty script".to_owned(),
        };
        if self.stops_others(link, request) {
            tracing::warn!(robot = %self.block.id, device = %request.device_id, "{why}");
        }
        let from: Option<Now> = request.starts_at().map(Timestamp::assume_clock);
        match from.filter(|from| *from > now) {
            None => {
                if let Some(sent) = request.timestamp {
                    let party = self.parties.party(link);
                    self.devices[index].take_back(now, sent, party);
                }
                let rest = if request.home { Rest::Home } else { Rest::InPlace };
                self.stop(now, index, &why, rest, out);
            }
            Some(from) => {
                let error = ControlError::new(ErrorCode::Cancelled, why);
                self.devices[index].cancel_from(from, &error, &mut self.effects);
                self.settle(now, index, out);
            }
        }
        let answer = ControlResponse {
            request_id: request.request_id.clone(),
            content_hash,
            ..ControlResponse::new(now, request.device_id.clone(), Status::Ok)
        };
        self.answer_stop(link, index, answer, out);
    }
}

/// Returns the start time of a request that is received at `now`.
fn start_of(now: Now, request: &ControlRequest) -> Now {
    request.starts_at().map_or(now, Timestamp::assume_clock)
}

/// Compares the hash in the request, if any, with the robot's own hash of the command. Returns the robot's hash, or `None` if the request
/// contains no hash to compare.
fn check_hash(
    request: &ControlRequest,
    computed: Option<ContentHash>,
) -> Result<Option<ContentHash>, ControlError> {
    let Some(expected) = request.content_hash else { return Ok(None) };
    // For these two commands, the value does not matter.
    if matches!(request.command, Command::ReadSensor | Command::Unknown(_)) {
        return Ok(None);
    }
    match computed.unwrap_or_else(|| request.command.content_hash()) {
        computed if computed == expected => Ok(Some(computed)),
        computed => {
            let message = format!("content_hash is {expected}, but the hash of control_value is {computed}");
            Err(ControlError::new(ErrorCode::Malformed, message))
        }
    }
}
