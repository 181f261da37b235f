//! Checks the invariants of a robot under any operations: compares the robot's actions with an independent, simpler model of its duties.
//! The tests of this crate and the fuzzer play lists of operations. The model uses only the public interface of robots.
//!
//! The following holds after every operation:
//! - no value outside the limits or off the granularity is set;
//! - nothing starts early or late;
//! - no command outlives its lease, and no lease ends early;
//! - no device holds more commands than its queue permits;
//! - every accepted request ends once, and sets nothing afterwards;
//! - every response names its request;
//! - no session affects another session's commands, unless a permitted operator seizes the robot, and then all held commands end first;
//! - an inquiry is answered truthfully and changes only leases.

mod answers;
mod described;
mod inquiries;
mod judge;
mod model;
mod operation;
#[cfg(test)]
mod tests;

use downbeat_robot::{Input, LinkId, Output, Robot};
use urrcp::{
    AvailabilityRequest, AvailabilityResponse, ControlRequest, DecodeError, DecodeErrorKind, DeviceId,
    InitializationBlock, InitializationRequest, Label, Message, Proof, Role, SessionId, Status, Timestamp,
};

pub use described::drive_all;
use judge::Judge;
pub use operation::{Operation, Pause, Question, Request, operations};

/// A violated invariant, described in one sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Violation(String);

/// Maximum number of consecutive wake-ups. A robot that needs more is considered to never come to rest.
const WAKEUPS_MAX: usize = 100_000;
/// Number of links that are open at the same time.
const LINKS: usize = 4;
/// Link of an operator who may seize the robot. It is always up.
const OPERATOR: LinkId = LinkId(1 << 32);
/// Start time of a run, in nanoseconds.
const BEGIN: i64 = 1_000_000_000_000;

/// Description of a robot with a device of each kind: positions that are held or move linearly, speeds, an acceleration, a sensor, and
/// custom control.
const BLOCK: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "arm", "name": "arm", "default_value": 10, "script_queue": 2, "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "script": {"min_value": -10, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 4}}},
  {"id": "ramp", "name": "ramp", "interpolation": "linear", "script_queue": 3, "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "script": {"min_value": 0, "max_value": 60, "granularity": 1, "max_number_of_steps": 4}}},
  {"id": "wheel", "name": "wheel", "available_control_types": {
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "script": {"min_value": -10, "max_value": 10, "granularity": 1, "max_number_of_steps": 4}}},
  {"id": "crane", "name": "crane", "default_value": 0, "interpolation": "linear", "script_queue": 2, "available_control_types": {
     "position": {"min_value": -20, "max_value": 90, "granularity": 0.25},
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "acceleration": {"min_value": -40, "max_value": 40, "granularity": 1},
     "script": {"min_value": -20, "max_value": 90, "granularity": 0.25, "max_number_of_steps": 5, "control_types": ["position", "speed"]}}},
  {"id": "lamp", "name": "lamp", "script_queue": 2, "available_control_types": {"custom_1": {"colours": 3},
     "script": {"min_value": 0, "max_value": 1, "granularity": 1, "max_number_of_steps": 4}}},
  {"id": "shut", "name": "takes one", "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5}}},
  {"id": "thermometer", "name": "t", "available_control_types": {"sensor": {"min_value": -20, "max_value": 60}}}]}"#;

/// Plays operations on a robot at rest, and then lets time pass until no work is left.
///
/// # Errors
/// The first [`Violation`].
pub fn play(operations: &[Operation]) -> Result<(), Violation> {
    let mut bench = Bench::new()?;
    operations.iter().try_for_each(|operation| bench.play(operation))?;
    bench.wait_until(Timestamp::from_nanos(i64::MAX))?;
    bench.judge.check_rest(&bench.robot)
}

/// Sends a request to a robot at rest, twice, and lets time pass until no work is left.
///
/// # Errors
/// The first [`Violation`].
pub fn ask(request: &ControlRequest) -> Result<(), Violation> {
    let mut bench = Bench::new()?;
    bench.request(0, request.clone())?;
    bench.request(1, request.clone())?;
    bench.wait_until(Timestamp::from_nanos(i64::MAX))?;
    bench.judge.check_rest(&bench.robot)
}

/// Returns a violation with the text that `otherwise` creates, unless `holds` is true.
fn hold(holds: bool, otherwise: impl FnOnce() -> String) -> Result<(), Violation> {
    if holds { Ok(()) } else { Err(Violation(otherwise())) }
}

/// A robot under test, its judge, and the links and requests of its peers.
struct Bench {
    robot: Robot,
    judge: Judge,
    now: Timestamp<urrcp::Robot>,
    links: [LinkId; LINKS],
    links_opened: u64,
    devices: Vec<DeviceId>,
    sent: Vec<ControlRequest>,
}

impl Bench {
    fn new() -> Result<Self, Violation> {
        let block: InitializationBlock = serde_json::from_str(BLOCK).map_err(|e| Violation(e.to_string()))?;
        let mut robot = Robot::new(block.clone());
        let name = Label::new("operator").map_err(|e| Violation(e.to_string()))?;
        let roles = [Role::Drive, Role::Seize].into_iter().collect();
        let proof = Proof { name, roles, serial: None };
        robot.handle(Timestamp::from_nanos(BEGIN), OPERATOR, Input::Proven(proof), &mut Vec::new());
        Ok(Self {
            judge: Judge::new(&block),
            now: Timestamp::from_nanos(BEGIN),
            links: std::array::from_fn(|i| LinkId(i as u64)),
            links_opened: LINKS as u64,
            devices: block.devices.iter().map(|device| device.id.clone()).collect(),
            sent: Vec::new(),
            robot,
        })
    }

    fn play(&mut self, operation: &Operation) -> Result<(), Violation> {
        match operation {
            Operation::Wait(pause) => self.wait_until(pause.until(self.now)),
            Operation::HeldUp(pause) => {
                self.now = pause.until(self.now);
                self.advance()
            }
            Operation::Request(request) => {
                let Some(written) = request.written(self.now, &self.robot.block().devices, self.sent.len())
                else {
                    return Ok(());
                };
                self.sent.push(written.clone());
                self.request(request.link, written)
            }
            Operation::Repeat { which, link } => match self.sent.len() {
                0 => Ok(()),
                sent => self.request(*link, self.sent[usize::from(*which) % sent].clone()),
            },
            Operation::Ask { link, session } => self.ask(*link, *session),
            Operation::Inquire(question) => self.inquire(question),
            Operation::Describe { link } => self.describe(*link),
            Operation::Seize { link: Some(link), session } => self.seize_in_vain(*link, *session),
            Operation::Seize { link: None, .. } => self.seize(),
            Operation::Stray { link } => self.stray(*link),
            Operation::Noise { link, device } => self.noise(*link, *device),
            Operation::Break { link } => {
                let broken = self.link(*link);
                let out = self.handle(broken, Input::LinkDown)?;
                hold(out.is_empty(), || format!("unexpected output after a link broke: {out:?}"))?;
                self.links[usize::from(*link) % LINKS] = LinkId(self.links_opened);
                self.links_opened += 1;
                Ok(())
            }
        }
    }

    const fn link(&self, link: u8) -> LinkId {
        self.links[link as usize % LINKS]
    }

    /// Advances time to `end`, and wakes the robot at every time that it requests until then.
    fn wait_until(&mut self, end: Timestamp<urrcp::Robot>) -> Result<(), Violation> {
        for _ in 0..WAKEUPS_MAX {
            let Some(wakeup) = self.robot.next_wakeup().filter(|wakeup| *wakeup <= end) else {
                self.now = end;
                return self.advance();
            };
            self.now = self.now.max(wakeup);
            self.advance()?;
        }
        Err(Violation(format!("more than {WAKEUPS_MAX} wake-ups")))
    }

    fn advance(&mut self) -> Result<(), Violation> {
        let mut out = Vec::new();
        self.robot.advance(self.now, &mut out);
        self.judge.passed(self.now, &out)?;
        self.judge.check_settled(self.now, &self.robot)
    }

    /// Lets the robot handle an input. Executes due events first, so that only the input can cause further outputs.
    fn handle(&mut self, link: LinkId, input: Input) -> Result<Vec<Output>, Violation> {
        self.advance()?;
        let mut out = Vec::new();
        self.robot.handle(self.now, link, input, &mut out);
        Ok(out)
    }

    fn request(&mut self, link: u8, request: ControlRequest) -> Result<(), Violation> {
        let link = self.link(link);
        let out = self.handle(link, Input::Message(Message::ControlRequest(request.clone())))?;
        self.judge.asked(self.now, link, &request, &out)?;
        self.judge.check_settled(self.now, &self.robot)
    }

    fn ask(&mut self, link: u8, session: u8) -> Result<(), Violation> {
        let (link, session) = (self.link(link), operation::session(session));
        let timestamp = Some(Timestamp::from_nanos(BEGIN));
        let request =
            AvailabilityRequest { timestamp, session: session.clone(), seize: false, revocation_list: None };
        let out = self.handle(link, Input::Message(Message::AvailabilityRequest(request)))?;
        self.judge.heard(self.now, link, session.as_ref());
        let answered = matches!(&out[..], [Output::Send { link: to, message: Message::AvailabilityResponse(r) }]
            if *to == link && r.originate_timestamp == timestamp && r.timestamp == self.now);
        hold(answered, || format!("unexpected answer to an availability request: {out:?}"))
    }

    /// Checks that a peer without a proven identity cannot seize the robot, and that its attempt renews no lease.
    fn seize_in_vain(&mut self, link: u8, session: u8) -> Result<(), Violation> {
        let link = self.link(link);
        let request = AvailabilityRequest {
            timestamp: None,
            session: operation::session(session),
            seize: true,
            revocation_list: None,
        };
        let out = self.handle(link, Input::Message(Message::AvailabilityRequest(request)))?;
        let refused = matches!(&out[..], [Output::Send { link: to, message: Message::AvailabilityResponse(r) }]
            if *to == link && r.status == Status::Failed && r.error.is_some());
        hold(refused, || format!("unexpected answer to an unauthorized attempt to seize the robot: {out:?}"))
    }

    /// Seizes the robot as an operator who may do so.
    fn seize(&mut self) -> Result<(), Violation> {
        let session = SessionId::new("an operator's").ok();
        let request = AvailabilityRequest {
            timestamp: None,
            session: session.clone(),
            seize: true,
            revocation_list: None,
        };
        let mut out = self.handle(OPERATOR, Input::Message(Message::AvailabilityRequest(request)))?;
        let answer = out.pop();
        let taken = matches!(&answer, Some(Output::Send { link: OPERATOR, message: Message::AvailabilityResponse(r) })
            if r.status == Status::Ok);
        hold(taken, || {
            format!("unexpected answer to an authorized seizure of the robot: {answer:?}, sent after {out:?}")
        })?;
        self.judge.seized(self.now, OPERATOR, session.as_ref(), &out)?;
        self.judge.check_settled(self.now, &self.robot)
    }

    fn inquire(&mut self, question: &Question) -> Result<(), Violation> {
        let link = self.link(question.link);
        let inquiry = question.written(self.now, &self.sent, &self.devices);
        let out = self.handle(link, Input::Message(Message::Inquiry(inquiry.clone())))?;
        self.judge.inquired(self.now, link, &inquiry, &out)?;
        self.judge.check_settled(self.now, &self.robot)
    }

    fn describe(&mut self, link: u8) -> Result<(), Violation> {
        let link = self.link(link);
        let out = self
            .handle(link, Input::Message(Message::InitializationRequest(InitializationRequest::default())))?;
        self.judge.heard(self.now, link, None);
        let answered = matches!(&out[..], [Output::Send { link: to, message: Message::InitializationBlock(block) }]
            if *to == link && block == self.robot.block());
        hold(answered, || format!("unexpected answer to an initialization request: {out:?}"))
    }

    fn stray(&mut self, link: u8) -> Result<(), Violation> {
        let link = self.link(link);
        let block = Message::InitializationBlock(self.robot.block().clone());
        let out = self.handle(link, Input::Message(block))?;
        hold(out.is_empty(), || format!("unexpected answer to a message that only robots send: {out:?}"))
    }

    fn noise(&mut self, link: u8, device: Option<u8>) -> Result<(), Violation> {
        let link = self.link(link);
        let device_id = device.map(|device| self.devices[usize::from(device) % self.devices.len()].clone());
        let kind = DecodeErrorKind::NotUtf8 { valid_up_to: 0 };
        let error = DecodeError { kind, device_id: device_id.clone(), request_id: None };
        let out = self.handle(link, Input::Undecodable(error))?;
        let answered = match (&out[..], device_id) {
            ([Output::Send { link: to, message: Message::ControlResponse(r) }], Some(device)) => {
                *to == link && r.device_id == device && r.status == Status::Failed
            }
            ([Output::Send { link: to, message: Message::AvailabilityResponse(r) }], None) => {
                let AvailabilityResponse { status, .. } = r;
                *to == link && *status == Status::Failed
            }
            _ => false,
        };
        hold(answered, || format!("unexpected answer to bytes that are not a message: {out:?}"))
    }
}
