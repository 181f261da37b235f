//! Checks a robot's responses to requests, and records what they oblige the robot's devices to do.

use std::collections::HashSet;

use downbeat_robot::Robot;
use urrcp::{
    Command, ContentHash, ControlRequest, ControlResponse, ControlType, ErrorCode, RequestId, Server,
    SessionId, Span, Status, StatusValue, Timestamp,
};

use crate::judge::{Judge, ReceivedRequest, is_refused};
use crate::model::{DeviceModel, Order, cancels_from, start_of};
use crate::{Violation, hold};

/// Limit for a stop's timestamp that is ahead of the robot's clock. For messages of the stop's own sender, a timestamp further ahead
/// counts as this far ahead, as `docs/protocol.md` requires.
const TAKEN_BACK_AHEAD_MAX: Span = Span::from_millis(5_000);

type Now = Timestamp<urrcp::Robot>;

impl Judge {
    /// Judges the robot's first response to a request.
    pub(crate) fn answered(
        &mut self,
        now: Now,
        asked: &ReceivedRequest<'_>,
        answer: &ControlResponse,
    ) -> Result<(), Violation> {
        let request = asked.request;
        let echoes = answer.request_id == request.request_id && answer.device_id == request.device_id;
        hold(echoes && answer.timestamp == now, || format!("{answer:?} to {request:?}"))?;
        // A reading is not remembered: the robot reads the sensor again for a repeated request.
        if let Some(id) = request.request_id.as_ref().filter(|_| answer.status != Status::Provide) {
            self.remember(id, answer);
        }
        let owed = match answer.status {
            Status::Accepted => self.accepted(now, asked, answer)?,
            Status::Ok => {
                // The report about a movement's end has an event time. This response has none, so it must answer an empty script.
                let cancels = is_cancel(request) && self.devices.contains_key(&request.device_id);
                hold(cancels, || format!("done already: {request:?}"))?;
                self.hold_session(request.session.as_ref())?;
                self.cancelled_by(now, request)
            }
            Status::Provide => self.provided(request, answer)?,
            Status::Failed => self.refused(now, asked, answer)?,
            Status::Started | Status::Other(_) => return Err(Violation(format!("no answer: {answer:?}"))),
        };
        let cancelled = std::mem::take(&mut self.cancelled);
        hold(cancelled == owed, || {
            format!("the commands {cancelled:?} were cancelled, expected {owed:?}, after {request:?}")
        })
    }

    fn remember(&mut self, id: &RequestId, answer: &ControlResponse) {
        self.answers.insert(id.clone(), answer.clone());
        self.hashes.extend(answer.content_hash.map(|hash| (id.clone(), hash)));
    }

    /// Checks that the robot holds no command of a session other than `session`.
    pub(crate) fn hold_session(&self, session: Option<&SessionId>) -> Result<(), Violation> {
        let of_others = |order: &&Order| order.session.is_some() && order.session.as_ref() != session;
        let others = self.devices.values().flat_map(|device| &device.queue).find(of_others);
        hold(others.is_none(), || {
            format!(
                "the session {session:?} was served although the robot holds a command of another session: {others:?}"
            )
        })
    }

    fn accepted(
        &mut self,
        now: Now,
        asked: &ReceivedRequest<'_>,
        answer: &ControlResponse,
    ) -> Result<HashSet<usize>, Violation> {
        let request = asked.request;
        self.hold_session(request.session.as_ref())?;
        let value = match &request.command {
            Command::Set(setpoint) => StatusValue::Number(setpoint.value),
            Command::Script(script) => StatusValue::Script(script.clone()),
            Command::ReadSensor | Command::Unknown(_) => StatusValue::Null,
        };
        let right_hash = request.content_hash.is_none_or(|hash| hash == hash_of(request));
        let echoed = answer.content_hash == request.content_hash && answer.status_value == value;
        hold(right_hash && echoed && value != StatusValue::Null, || format!("{answer:?} to {request:?}"))?;
        let order = Order::new(self.serials, now, asked.party, request);
        self.serials += 1;
        let Some(device) = self.devices.get_mut(&request.device_id) else {
            return Err(Violation(format!("a request for an unknown device was accepted: {request:?}")));
        };
        hold(order.start >= now, || {
            format!(
                "a request was accepted although its start had passed {} ago: {request:?}",
                now - order.start
            )
        })?;
        let taken_back = request.timestamp.is_some() && request.timestamp <= device.taken_back;
        hold(!taken_back && !is_cancel(request), || {
            format!("an empty script, or a request that a stop had cancelled, was accepted: {request:?}")
        })?;
        let taken = device.queue.iter().find(|held| overlap(held, &order));
        hold(taken.is_none(), || format!("{request:?} overlaps {taken:?}"))?;
        device.insert(order);
        hold(device.queue.len() <= device.spec.script_queue as usize, || {
            format!("more commands were accepted than the queue can hold: {device:?}")
        })?;
        Ok(HashSet::new())
    }

    /// Returns the serial numbers of the orders that `request`, an empty script, must cancel.
    fn cancelled_by(&mut self, now: Now, request: &ControlRequest) -> HashSet<usize> {
        let from = cancels_from(now, request);
        let Some(device) = self.devices.get_mut(&request.device_id) else { return HashSet::new() };
        if from.is_none() {
            let at_most = |ahead| {
                let latest: Timestamp<Server> = (now + ahead).assume_clock();
                request.timestamp.map(|sent| sent.min(latest))
            };
            // A bound in the future may be reset when a session claims the robot.
            device.taken_back = device.taken_back.max(at_most(Span::ZERO));
            device.taken_back_at_most = device.taken_back_at_most.max(at_most(TAKEN_BACK_AHEAD_MAX));
        }
        // Orders that have ended are no longer in the queue. The orders that are still there must not be cancelled.
        let standing: HashSet<_> =
            device.queue.iter().filter(|order| order.falls(from)).map(|order| order.serial).collect();
        &self.cancelled | &standing
    }

    fn provided(
        &self,
        request: &ControlRequest,
        answer: &ControlResponse,
    ) -> Result<HashSet<usize>, Violation> {
        let device = self.devices.get(&request.device_id);
        let sensor = device.is_some_and(|device| device.spec.available_control_types.sensor().is_some());
        let read = matches!(answer.status_value, StatusValue::Number(reading) if reading.is_finite());
        let asked = request.command == Command::ReadSensor;
        hold(sensor && read && asked, || format!("{answer:?} to {request:?}"))?;
        Ok(HashSet::new())
    }

    /// Judges a refusal: the stated reason must apply.
    fn refused(
        &mut self,
        now: Now,
        asked: &ReceivedRequest<'_>,
        answer: &ControlResponse,
    ) -> Result<HashSet<usize>, Violation> {
        let request = asked.request;
        let order = Order::new(self.serials, now, asked.party, request);
        let sessions: HashSet<&SessionId> = self.heard.sessions().collect();
        let others = sessions.iter().any(|session| request.session.as_ref() != Some(*session));
        let right_hash = request.content_hash.is_none_or(|hash| hash == hash_of(request));
        let Some(device) = self.devices.get(&request.device_id) else {
            let unknown =
                is_refused(answer, &ErrorCode::UnknownDevice) || is_refused(answer, &ErrorCode::Busy);
            hold(unknown, || format!("{answer:?} to {request:?}"))?;
            return Ok(HashSet::new());
        };
        let full = device.queue.len() >= device.spec.script_queue as usize;
        let several = order.steps.iter().any(|step| !step.setpoint.more.is_empty());
        let is_case = match answer.error.as_ref().map(|error| &error.code) {
            Some(ErrorCode::Late) => {
                start_of(now, request) < now || request.pending_until.is_some_and(|until| until <= now)
            }
            Some(ErrorCode::Overlap) => device.queue.iter().any(|held| overlap(held, &order)),
            Some(ErrorCode::Busy) => full || others,
            Some(ErrorCode::Cancelled) => {
                request.timestamp.is_some() && request.timestamp <= device.taken_back_at_most
            }
            Some(ErrorCode::Malformed) => !right_hash || several,
            Some(ErrorCode::TooManySteps | ErrorCode::OutOfRange | ErrorCode::OffGranularity) => {
                !order.steps.is_empty()
            }
            Some(ErrorCode::UnsupportedControlType) => {
                self.hold_session(request.session.as_ref())?;
                let left = device.queue.iter().map(|order| order.serial).collect();
                return Ok(&self.cancelled | &left);
            }
            _ => false,
        };
        hold(is_case && answer.status_value == StatusValue::Null, || {
            format!("{answer:?} to {request:?}: {device:?}")
        })?;
        Ok(HashSet::new())
    }

    /// Checks, between two operations, that the robot has done everything that is due, and requests its next wake-up in time.
    pub(crate) fn check_settled(&self, now: Now, robot: &Robot) -> Result<(), Violation> {
        let wakeup = robot.next_wakeup();
        hold(wakeup.is_none_or(|at| at > now || now == Timestamp::from_nanos(i64::MAX)), || {
            format!("at {now}, the robot requested a wake-up that is not in the future: {wakeup:?}")
        })?;
        for device in self.devices.values() {
            self.check_device(now, wakeup, device)?;
            for control_type in [ControlType::Position, ControlType::Speed] {
                let value = robot.value(device.spec.id.as_str(), control_type, now);
                let limits = device.spec.available_control_types.limits(control_type);
                let within = value.zip(limits).is_none_or(|(value, limits)| {
                    (limits.min_value - 1e-9..=limits.max_value + 1e-9).contains(&value)
                });
                hold(within, || {
                    format!(
                        "`{}` has the value {value:?} for {control_type}, which is outside its limits",
                        device.spec.id
                    )
                })?;
            }
        }
        Ok(())
    }

    fn check_device(&self, now: Now, wakeup: Option<Now>, device: &DeviceModel) -> Result<(), Violation> {
        let earliest = device.earliest(&self.heard);
        hold(earliest.is_none_or(|at| at > now), || format!("at {now}, a command was overdue: {device:?}"))?;
        let asks = earliest.is_none_or(|at| wakeup.is_some_and(|wakeup| wakeup <= at));
        hold(asks, || format!("the requested wake-up at {wakeup:?} is too late for {device:?}"))?;
        let began = device.queue.iter().filter(|order| order.began).count();
        let done = device.queue.iter().any(Order::is_done);
        hold(began <= 1 && !done, || {
            format!(
                "{began} commands are running at once, or a completed command was never reported: {device:?}"
            )
        })
    }

    /// Checks that the robot holds no order at the end of a run.
    pub(crate) fn check_rest(&self, robot: &Robot) -> Result<(), Violation> {
        let held = self.devices.values().find(|device| !device.queue.is_empty() || !device.guards.is_empty());
        hold(held.is_none() && robot.is_idle(), || {
            format!("at the end of the run, the robot still holds commands: {held:?}")
        })
    }
}

fn is_cancel(request: &ControlRequest) -> bool {
    matches!(&request.command, Command::Script(script) if script.is_empty())
}

fn hash_of(request: &ControlRequest) -> ContentHash {
    request.command.content_hash()
}

/// Whether two orders would drive the device at the same time. Adjacent orders do not overlap, nor does a zero-length order overlap an
/// order that starts later.
fn overlap(held: &Order, new: &Order) -> bool {
    let into_running = held.began && (new.start, new.end()) < (held.start, held.end());
    into_running || new.start < held.end() && held.start < new.end()
}
