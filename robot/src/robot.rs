//! A robot as a state machine: it receives messages and the time, and returns responses and values.

mod control;
mod driven;
mod inquiry;
mod permission;
mod planned;
mod seize;

pub use self::planned::PlanReportError;

use std::collections::{BTreeMap, BTreeSet, HashMap};

use urrcp::{
    AvailabilityResponse, ContentHash, ControlError, ControlRequest, ControlResponse, ControlType,
    DecodeError, DeviceId, ErrorCode, InitializationBlock, Label, Message, RequestId, SessionId, Status,
    StatusValue, Timestamp,
};

use crate::answers::Answers;
use crate::confirmation::{Said, Ticket, Unconfirmed};
use crate::counts::Counts;
use crate::device::{DeviceMachine, Effect, Motion, MotionLimits, Rest};
use crate::hardware::{Hardware, ReadingId};
use crate::ids::LinkId;
use crate::lease::LastMessages;
#[cfg(feature = "host")]
use crate::parties::Claimant;
use crate::parties::Parties;
use crate::plans::{PlanCancel, PlanPart, Plans};
use crate::tolerance::Tolerance;
use urrcp::Proof;

/// An input that a robot receives on a link.
#[derive(Clone, Debug)]
pub enum Input {
    /// A message from the peer.
    Message(Message),
    /// A request with the hash of its content. The thread that read the request has computed the hash, because hashing a long script
    /// takes a long time.
    Hashed(ControlRequest, ContentHash),
    /// The peer of the link has proven its identity. This input precedes the peer's messages.
    Proven(Proof),
    /// A key is no longer valid. The commands of the parties that used it end, and their devices come to rest. The link does not matter.
    Barred {
        /// Serial number of the key.
        serial: Label,
        /// Reason why the key is no longer valid, as a sentence without a full stop.
        why: String,
    },
    /// A line that is not a valid message. The robot answers it, but it renews no lease: noise on a line does not prove that the server
    /// works.
    Undecodable(DecodeError),
    /// The link broke. Its silence counts from the last message that arrived on it.
    LinkDown,
}

impl Input {
    /// Wraps a message. If the message contains a hash to check, computes the hash of its content here. This relieves the robot's thread,
    /// which serves several robots.
    #[must_use]
    pub fn read(message: Message) -> Self {
        match message {
            Message::ControlRequest(request) if request.content_hash.is_some() => {
                let computed = request.command.content_hash();
                Self::Hashed(request, computed)
            }
            message => Self::Message(message),
        }
    }
}

/// An action that the robot's state machine requests from its caller.
#[derive(Clone, Debug)]
pub enum Output {
    /// Send a message on a link.
    Send {
        /// Link on which to send the message.
        link: LinkId,
        /// The message to send.
        message: Message,
    },
    /// Move a device, or bring it to rest.
    Set(SetValue),
    /// Call [`Robot::confirmed`] once the hardware has taken all earlier values of this device. Only requested if
    /// [`Robot::confirmed_by_its_driver`] was called.
    Confirm {
        /// Identifies this request for confirmation.
        ticket: Ticket,
        /// Device whose earlier values the hardware must have taken.
        device: DeviceId,
    },
    /// Read a sensor of the hardware, and pass the result to [`Robot::reading_came`].
    Read {
        /// Identifies this reading.
        reading: ReadingId,
        /// Sensor to read.
        sensor: DeviceId,
    },
    /// Pass steps of a script to a driver that times scripts by itself, see [`Robot::plans_ahead`]. Pass the driver's reports to
    /// [`Robot::plan_reported`], and a refusal to [`Robot::plan_refused`].
    Plan(PlanPart<urrcp::Robot>),
    /// End a script that the driver times by itself, and pass the driver's confirmation to [`Robot::plan_cancelled`].
    Cancel(PlanCancel),
    /// For a log: the driver has reported a completed step of a script that it times by itself.
    Played {
        /// The step's value.
        set: SetValue,
        /// Time of the step, as the driver reports it.
        at: Timestamp<urrcp::Robot>,
    },
}

/// A movement of one device.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct SetValue {
    /// Device to move.
    pub device: DeviceId,
    /// Movement of the device.
    pub motion: Motion,
    /// Time when the movement was due.
    pub due: Timestamp<urrcp::Robot>,
    /// Id of the request that caused the movement. `None` for movements to rest and to the default state.
    pub request_id: Option<RequestId>,
    /// Index of the step in the script. `None` if the movement is not a script's step.
    pub step: Option<u32>,
}

/// State machine of one robot.
#[derive(Clone, Debug)]
pub struct Robot {
    block: InitializationBlock,
    devices: Vec<DeviceMachine>,
    index_of: HashMap<DeviceId, usize>,
    heard: LastMessages,
    parties: Parties,
    /// Time at which each device may first need to be woken. After a lease is renewed, an entry may be too early, but never too late.
    wakeups: BTreeSet<(Timestamp<urrcp::Robot>, usize)>,
    wakeup_of: Vec<Option<Timestamp<urrcp::Robot>>>,
    answers: Answers,
    readings: HashMap<DeviceId, f64>,
    hardware: Hardware,
    /// Reports of ended commands and responses to stops, which are held back until the hardware confirms the last value. `None` if they
    /// are sent at once.
    unconfirmed: Option<Unconfirmed>,
    /// Scripts that the driver has received or will receive, and that it times by itself.
    plans: Plans,
    tolerance: Tolerance,
    /// Whether the robot has set any value since its start.
    moved: bool,
    effects: Vec<Effect>,
    /// Command counts. Their field `held` is unused, because [`Robot::counts`] computes it.
    counts: Counts,
    /// Reports that have not been sent yet, each with the index of its device and the time of the event.
    reports: Vec<(usize, Now, Effect)>,
}

type Now = Timestamp<urrcp::Robot>;

/// Whether a server sends messages of this kind. A robot ignores all others.
const fn is_of_server(message: &Message) -> bool {
    matches!(
        message,
        Message::AvailabilityRequest(_)
            | Message::InitializationRequest(_)
            | Message::ControlRequest(_)
            | Message::Inquiry(_)
    )
}

impl Robot {
    /// Creates a robot at rest from its initialization block.
    #[must_use]
    pub fn new(block: InitializationBlock) -> Self {
        let devices: Vec<_> = block.devices.iter().cloned().map(DeviceMachine::new).collect();
        let index_of = block.devices.iter().enumerate().map(|(i, device)| (device.id.clone(), i)).collect();
        let wakeup_of = vec![None; devices.len()];
        Self {
            devices,
            index_of,
            heard: LastMessages::default(),
            parties: Parties::default(),
            wakeups: BTreeSet::new(),
            wakeup_of,
            answers: Answers::of(block.devices.len()),
            block,
            readings: HashMap::new(),
            hardware: Hardware::simulated(),
            unconfirmed: None,
            plans: Plans::default(),
            tolerance: Tolerance::default(),
            moved: false,
            effects: Vec::new(),
            counts: Counts::default(),
            reports: Vec::new(),
        }
    }

    /// Sets limits for movements to rest and to the default state. A limit applies only if it is lower than the one that the device
    /// declares.
    #[must_use]
    pub fn with_limits(mut self, limits: &BTreeMap<DeviceId, MotionLimits>) -> Self {
        for device in &mut self.devices {
            device.limits = limits.get(&device.spec.id).copied().unwrap_or_default();
        }
        self
    }

    /// Returns the robot's initialization block.
    #[must_use]
    pub const fn block(&self) -> &InitializationBlock {
        &self.block
    }

    /// Whether the robot holds no command and no lease runs.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.wakeups.is_empty()
            && !self.awaits_confirmation()
            && self.plans.is_empty()
            && self.devices.iter().all(DeviceMachine::is_idle)
    }

    /// Returns the robot's command counts.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let held = self.devices.iter().map(|device| device.held() as u64).sum();
        Counts { held, ..self.counts }
    }

    /// Whether the robot's hardware answers; true for a robot without hardware.
    #[cfg(feature = "host")]
    pub(crate) const fn hardware_answers(&self) -> bool {
        self.hardware.answers()
    }

    /// Returns the value of a device's signal at `now`, even in the middle of a linear movement. `None` if there is no such device or
    /// signal.
    #[must_use]
    pub fn value(&self, device: &str, control_type: ControlType, now: Now) -> Option<f64> {
        self.devices[*self.index_of.get(device)?].value(control_type, now)
    }

    /// Sets the position of a simulated robot's device without a command.
    pub(crate) fn place(&mut self, device: &DeviceId, position: f64) {
        if let Some(index) = self.index_of.get(device) {
            self.devices[*index].place(position);
        }
    }

    /// Returns the readings of the sensors that the state machine answers by itself, without hardware.
    pub(crate) fn readings(&self) -> impl Iterator<Item = (&DeviceId, f64)> {
        self.readings.iter().map(|(sensor, reading)| (sensor, *reading))
    }

    /// Sets the reading of a sensor that the state machine answers by itself, without hardware.
    pub fn set_reading(&mut self, device: DeviceId, reading: f64) {
        self.readings.insert(device, reading);
    }

    /// Returns when [`Robot::advance`] must be called next. This is the time of the next event, or an earlier time. `None` if no event is
    /// to come.
    #[must_use]
    pub fn next_wakeup(&self) -> Option<Now> {
        let device = self.wakeups.first().map(|(at, _)| *at);
        device.into_iter().chain(self.hardware.next_wakeup()).chain(self.plans.next_wakeup()).min()
    }

    /// Executes everything due at or before `now`: first all movements, then all reports.
    pub fn advance(&mut self, now: Now, out: &mut Vec<Output>) {
        self.advance_movements(now, out);
        self.give_up_unreported(now, out);
        self.send_reports(now, out);
        self.give_up_readings(now, out);
    }

    /// Executes the movements due at or before `now`, but sends no reports yet. A caller can thus move many robots at one instant before
    /// it spends time on messages.
    pub(crate) fn advance_movements(&mut self, now: Now, out: &mut Vec<Output>) {
        while let Some(&(at, index)) = self.wakeups.first() {
            if at > now {
                break;
            }
            self.devices[index].advance(now, &self.heard, &mut self.effects);
            self.refresh_wakeup(index);
            self.move_device(now, index, out);
        }
        self.hand_over(now, out);
    }

    /// Handles an input that reached the robot at `now`. Everything that was due until then is executed first.
    pub fn handle(&mut self, now: Now, link: LinkId, input: Input, out: &mut Vec<Output>) {
        self.advance(now, out);
        if let Input::Message(message) = &input
            && let Some(error) = self.forbids(link, message)
        {
            return self.answer_forbidden(now, link, message, error, out);
        }
        match input {
            Input::LinkDown => self.parties.link_down(link),
            Input::Proven(proof) => self.parties.proven(link, proof),
            Input::Barred { serial, why } => self.bar(now, &serial, why, out),
            Input::Undecodable(error) => self.answer_undecodable(now, link, &error, out),
            Input::Message(message) if !is_of_server(&message) => {
                tracing::debug!(robot = %self.block.id, "ignored a message that no server sends");
            }
            Input::Message(message) => {
                if matches!(message, Message::Inquiry(_)) {
                    self.release_if_over(now);
                }
                let session = match &message {
                    Message::AvailabilityRequest(request) => request.session.as_ref(),
                    Message::ControlRequest(request) => request.session.as_ref(),
                    Message::Inquiry(inquiry) => inquiry.session.as_ref(),
                    _ => None,
                };
                self.heard_from(now, link, session);
                self.handle_message(now, link, message, out);
            }
            Input::Hashed(request, computed) => {
                if let Some(error) = self.forbids_request(link, &request) {
                    return tell(link, ControlResponse::refusal(now, &request, error), out);
                }
                self.heard_from(now, link, request.session.as_ref());
                self.control(now, link, request, Some(computed), out);
            }
        }
    }

    fn heard_from(&mut self, now: Now, link: LinkId, session: Option<&SessionId>) {
        let party = match session {
            Some(session) => self.parties.join(link, session),
            None => self.parties.party(link),
        };
        self.parties.used_key(party, link);
        if self.heard.heard(party, now) {
            self.forget_who_holds_nothing();
        }
    }

    /// Releases the robot if the session that owns it is over. This must happen before an inquiry renews leases, because an inquiry is no
    /// claim and must not give the robot back to an ended session.
    pub(crate) fn release_if_over(&mut self, now: Now) {
        let idle = self.devices.iter().all(DeviceMachine::is_idle);
        if self.parties.owner(now, idle, &self.heard).is_none() {
            self.parties.release();
        }
    }

    /// Returns the number of owner changes, and the current or last owner.
    #[cfg(feature = "host")]
    pub(crate) fn last_claimant(&self) -> (u64, Option<&Claimant>) {
        (self.parties.changes(), self.parties.last_claimant())
    }

    /// Whether the party of this link (its session, or the link itself) owns the robot, or owned it last.
    #[cfg(feature = "host")]
    pub(crate) fn is_owner(&self, link: LinkId) -> bool {
        self.parties.last_owner() == Some(self.parties.party(link))
    }

    /// Forgets the time of the last message of every party, except for the owner and the parties that hold commands. The memory is thus
    /// bounded, however many strangers send messages.
    fn forget_who_holds_nothing(&mut self) {
        let holding = self.devices.iter().flat_map(DeviceMachine::parties);
        let holding = holding.chain(self.parties.last_owner()).collect();
        self.heard.keep(&holding);
        self.parties.keep_keys(&holding);
    }

    fn handle_message(&mut self, now: Now, link: LinkId, message: Message, out: &mut Vec<Output>) {
        match message {
            Message::AvailabilityRequest(request) => {
                if let Some(session) = request.session.as_ref().filter(|_| request.seize) {
                    self.seize(now, link, session, out);
                }
                let taken = self.claim(now, link, request.session.as_ref()).err();
                let status = if taken.is_some() { Status::Failed } else { Status::Ok };
                let response = AvailabilityResponse {
                    error: taken.filter(|_| request.session.is_some()),
                    ..AvailabilityResponse::new(&request, now, now, status)
                };
                let response = match (self.hardware.missing(), request.session) {
                    (Some(missing), _) => {
                        AvailabilityResponse { status: Status::Failed, error: Some(missing), ..response }
                    }
                    (None, Some(_)) => response,
                    (None, None) => AvailabilityResponse { status: Status::Ok, ..response },
                };
                out.push(Output::Send { link, message: Message::AvailabilityResponse(response) });
            }
            Message::InitializationRequest(_) => {
                let message = Message::InitializationBlock(self.block.clone());
                out.push(Output::Send { link, message });
            }
            Message::ControlRequest(request) => self.control(now, link, request, None, out),
            Message::Inquiry(inquiry) => self.inquire(now, link, &inquiry, out),
            _ => {}
        }
    }

    fn answer_undecodable(&mut self, now: Now, link: LinkId, error: &DecodeError, out: &mut Vec<Output>) {
        let reason = ControlError::new(ErrorCode::Malformed, error.to_string());
        let message = match &error.device_id {
            Some(device) => Message::ControlResponse(ControlResponse {
                request_id: error.request_id.clone(),
                error: Some(reason),
                ..ControlResponse::new(now, device.clone(), Status::Failed)
            }),
            None => Message::AvailabilityResponse(AvailabilityResponse {
                originate_timestamp: None,
                receive_timestamp: now,
                timestamp: now,
                status: Status::Failed,
                error: Some(reason),
                revocation_list: None,
            }),
        };
        out.push(Output::Send { link, message });
    }

    /// Ends all waiting and running commands of a device, and brings the device to rest.
    fn stop(&mut self, now: Now, index: usize, why: &str, rest: Rest, out: &mut Vec<Output>) {
        self.stop_with(now, index, &ControlError::new(ErrorCode::Cancelled, why), rest, out);
    }

    /// Like [`Robot::stop`], with the error that the ended commands report.
    fn stop_with(&mut self, now: Now, index: usize, error: &ControlError, rest: Rest, out: &mut Vec<Output>) {
        self.devices[index].stop(now, error, rest, &mut self.effects);
        self.settle(now, index, out);
    }

    /// Updates a device's wake-up time, outputs its movements and sends its reports, after an input has changed the device.
    fn settle(&mut self, now: Now, index: usize, out: &mut Vec<Output>) {
        self.refresh_wakeup(index);
        self.move_device(now, index, out);
        self.send_reports(now, out);
    }

    fn refuse(
        &mut self,
        now: Now,
        link: LinkId,
        request: &ControlRequest,
        error: ControlError,
        out: &mut Vec<Output>,
    ) {
        self.answer(link, ControlResponse::refusal(now, request, error), out);
    }

    /// Sends a response, and remembers it in case its request is repeated.
    fn answer(&mut self, link: LinkId, answer: ControlResponse, out: &mut Vec<Output>) {
        self.answers.remember(&answer);
        tell(link, answer, out);
    }

    fn refresh_wakeup(&mut self, index: usize) {
        let next = self.devices[index].next_wakeup(&self.heard);
        let known = std::mem::replace(&mut self.wakeup_of[index], next);
        if known != next {
            known.map(|at| self.wakeups.remove(&(at, index)));
            next.map(|at| self.wakeups.insert((at, index)));
        }
    }

    /// Outputs a device's movements. Keeps the device's reports for later, so that no movement has to wait for a report.
    fn move_device(&mut self, now: Now, index: usize, out: &mut Vec<Output>) {
        if self.devices[index].lookahead.is_some() {
            return self.plan_effects(now, index, out);
        }
        let device = &self.devices[index].spec.id;
        for effect in self.effects.drain(..) {
            match effect {
                Effect::Move { motion, due, request_id, step } => {
                    self.moved = true;
                    out.push(Output::Set(SetValue { device: device.clone(), motion, due, request_id, step }));
                }
                Effect::Stopped => {}
                report => self.reports.push((index, now, report)),
            }
        }
    }

    /// Whether reports are pending.
    pub(crate) const fn has_reports(&self) -> bool {
        !self.reports.is_empty()
    }

    pub(crate) fn send_reports(&mut self, now: Now, out: &mut Vec<Output>) {
        let mut reports = std::mem::take(&mut self.reports);
        for (index, happened, report) in reports.drain(..) {
            // If the driver itself has reported the end of a script, the hardware need not confirm it.
            let is_told = self.devices[index].lookahead.is_some();
            let unconfirmed = self.unconfirmed.as_mut().filter(|_| !is_told);
            if let (Effect::Ended { .. }, Some(unconfirmed)) = (&report, unconfirmed) {
                let ticket = unconfirmed.add(index, Said::Report(happened, report));
                out.push(Output::Confirm { ticket, device: self.devices[index].spec.id.clone() });
            } else {
                self.report(now, index, happened, report, out);
            }
        }
        // Keeps the emptied vector to reuse its allocation.
        self.reports = reports;
    }

    fn report(&mut self, now: Now, index: usize, happened: Now, effect: Effect, out: &mut Vec<Output>) {
        let device = self.devices[index].spec.id.clone();
        let base = |status| ControlResponse {
            event_timestamp: Some(happened),
            ..ControlResponse::new(now, device, status)
        };
        let (link, report) = match effect {
            Effect::Move { .. } | Effect::Stopped => return,
            Effect::Started { link, request_id, value, .. } => {
                self.counts.started += 1;
                let status_value = StatusValue::Number(value);
                (link, ControlResponse { request_id, status_value, ..base(Status::Started) })
            }
            Effect::Ended { link, request_id, value, steps_done, late, .. } => {
                self.counts.ended += 1;
                self.counts.late_steps += u64::from(late.count);
                let status_value = StatusValue::Number(value);
                let steps_done = Some(steps_done);
                let (late_steps, late_ms_max) = (Some(late.count), late.ms_max());
                let base = ControlResponse { late_steps, late_ms_max, ..base(Status::Ok) };
                (link, ControlResponse { request_id, status_value, steps_done, ..base })
            }
            Effect::Failed { link, request_id, error, steps_done, .. } => {
                self.counts.failed += 1;
                let error = Some(error);
                (link, ControlResponse { request_id, error, steps_done, ..base(Status::Failed) })
            }
        };
        let link = self.parties.route(link);
        self.answers.remember(&report);
        if self.block.reports {
            out.push(Output::Send { link, message: Message::ControlResponse(report) });
        }
    }
}

/// Sends a response, but does not remember it in case its request is repeated.
fn tell(link: LinkId, answer: ControlResponse, out: &mut Vec<Output>) {
    out.push(Output::Send { link, message: Message::ControlResponse(answer) });
}

#[cfg(test)]
mod tests;
