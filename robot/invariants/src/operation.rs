//! Operations on a robot, decoded from arbitrary bytes.
//!
//! Times are multiples of a tick, or a few nanoseconds before or after one. Many events therefore occur at the same instant or almost so.

use arbitrary::{Arbitrary, Unstructured};
use urrcp::{
    Command, ControlRequest, ControlType, Device, DeviceId, Inquiry, Millis, RequestId, Robot, Script,
    SessionId, Setpoint, Span, Step, StopCondition, Timestamp,
};

/// Maximum number of operations per run. It is lower than the number of requests that the robot remembers.
const OPERATIONS_MAX: usize = 128;
/// Maximum number of steps of a script. The devices accept fewer.
const STEPS_MAX: usize = 6;
/// The tick: all times are multiples of it, apart from offsets of a few nanoseconds.
const TICK: Span = Span::from_millis(50);
/// An id that no device of the robot has.
const NO_DEVICE: &str = "leg";
const IDS: u8 = 8;
const SESSIONS: u8 = 3;
/// Lowest session number that names a session. Lower numbers mean no session.
const SESSIONLESS: u8 = 240;

/// One operation on a robot.
#[derive(Clone, Debug)]
pub enum Operation {
    /// A control request arrives.
    Request(Request),
    /// An earlier request arrives again, possibly on another link.
    Repeat {
        /// Index of the earlier request among the requests that were sent, modulo their number.
        which: u8,
        /// Number of the link.
        link: u8,
    },
    /// An availability request arrives.
    Ask {
        /// Number of the link.
        link: u8,
        /// Number of the session.
        session: u8,
    },
    /// An inquiry arrives.
    Inquire(Question),
    /// An initialization request arrives.
    Describe {
        /// Number of the link.
        link: u8,
    },
    /// An availability request with `seize` arrives.
    Seize {
        /// Number of a link without a proven identity. `None`: the link of an operator who may seize the robot.
        link: Option<u8>,
        /// Number of the session, if `link` is a link without a proven identity.
        session: u8,
    },
    /// A message arrives that only robots may send, not servers.
    Stray {
        /// Number of the link.
        link: u8,
    },
    /// A line arrives that is not a message.
    Noise {
        /// Number of the link.
        link: u8,
        /// Number of the device whose id can still be recognised in the line. `None`: no id can be recognised.
        device: Option<u8>,
    },
    /// A link breaks. Later messages of its peer arrive on a new link.
    Break {
        /// Number of the link that breaks.
        link: u8,
    },
    /// Time passes, and the robot is woken at every time that it requests.
    Wait(Pause),
    /// Time passes, and the robot is woken only at the end, as if its process had been stopped.
    HeldUp(Pause),
}

/// A period without messages. It ends at a tick, or a few nanoseconds before or after one.
#[derive(Clone, Debug, Arbitrary)]
pub struct Pause {
    ticks: u8,
    nudge: i8,
}

/// Parameters of an inquiry, as arbitrary numbers that `written` converts to an inquiry.
#[derive(Clone, Debug, Arbitrary)]
pub struct Question {
    pub(crate) link: u8,
    session: u8,
    /// Indices of earlier requests that the inquiry asks about. It also asks about a request that was never sent.
    requests: [u8; 3],
    device: u8,
    pending_ticks: Option<u8>,
    /// Latest end of the pending leases, in ticks from now; a negative value lies in the past. `None`: no limit.
    until_ticks: Option<i8>,
}

/// Parameters of a control request, as arbitrary numbers that `written` converts to a request.
#[derive(Clone, Debug, Arbitrary)]
pub struct Request {
    pub(crate) link: u8,
    session: u8,
    device: u8,
    id: Id,
    start: Start,
    lease: Option<Lease>,
    until_ticks: Option<i8>,
    hash: Hash,
    home: bool,
    what: What,
}

#[derive(Clone, Debug)]
enum Id {
    None,
    Fresh,
    Used(u8),
}

#[derive(Clone, Debug)]
enum Start {
    AtOnce,
    /// The request has a timestamp but no offset. A stop with a timestamp cancels messages that were sent earlier.
    Sent {
        ticks_ago: u8,
    },
    At {
        sent_ticks_ago: u8,
        ticks: i8,
        nudge: i8,
    },
    Anywhere {
        timestamp: i64,
        offset: f64,
    },
}

#[derive(Clone, Debug, Arbitrary)]
struct Lease {
    pending: Option<u8>,
    running: Option<u8>,
}

#[derive(Clone, Debug)]
enum Hash {
    None,
    Right,
    Wrong,
}

#[derive(Clone, Debug)]
enum What {
    Set(Target),
    Script(Vec<PlannedStep>),
    Cancel,
    Read,
}

#[derive(Clone, Debug, Arbitrary)]
struct PlannedStep {
    ticks: u8,
    target: Target,
    lease: Option<Lease>,
}

#[derive(Clone, Debug, Arbitrary)]
struct Target {
    kind: u8,
    value: Value,
    more: u8,
}

#[derive(Clone, Debug)]
enum Value {
    Small(i8),
    Wide(u8),
    Fine(i16),
    Any(f64),
}

/// Implements `Arbitrary` so that one byte selects a choice: the first whose bound exceeds the byte. If no bound does, the last choice
/// applies.
macro_rules! chosen {
    ($kind:ty, $bytes:ident, $($below:literal => $choice:expr,)* else $last:expr) => {
        impl<'a> Arbitrary<'a> for $kind {
            fn arbitrary($bytes: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
                let byte = u8::arbitrary($bytes)?;
                $(if byte < $below {
                    return Ok($choice);
                })*
                Ok($last)
            }
        }
    };
}

// The bounds make accepted operations more frequent than refused ones.
chosen!(Operation, bytes,
    110 => Self::Request(bytes.arbitrary()?),
    176 => Self::Wait(bytes.arbitrary()?),
    187 => Self::Inquire(bytes.arbitrary()?),
    190 => Self::Wait(bytes.arbitrary()?),
    220 => Self::Ask { link: bytes.arbitrary()?, session: bytes.arbitrary()? },
    228 => Self::Repeat { which: bytes.arbitrary()?, link: bytes.arbitrary()? },
    236 => Self::HeldUp(bytes.arbitrary()?),
    242 => Self::Noise { link: bytes.arbitrary()?, device: bytes.arbitrary()? },
    247 => Self::Break { link: bytes.arbitrary()? },
    252 => Self::Describe { link: bytes.arbitrary()? },
    254 => Self::Seize { link: bytes.arbitrary()?, session: bytes.arbitrary()? },
    else Self::Stray { link: bytes.arbitrary()? });
chosen!(Id, bytes, 150 => Self::Fresh, 210 => Self::None, else Self::Used(bytes.arbitrary()?));
chosen!(Start, bytes,
    160 => Self::At { sent_ticks_ago: bytes.arbitrary()?, ticks: bytes.arbitrary()?, nudge: bytes.arbitrary()? },
    220 => Self::AtOnce,
    246 => Self::Sent { ticks_ago: bytes.arbitrary()? },
    else Self::Anywhere { timestamp: bytes.arbitrary()?, offset: bytes.arbitrary()? });
chosen!(Hash, bytes, 200 => Self::None, 245 => Self::Right, else Self::Wrong);
chosen!(What, bytes,
    120 => Self::Script(bytes.arbitrary()?),
    200 => Self::Set(bytes.arbitrary()?),
    246 => Self::Cancel,
    else Self::Read);
chosen!(Value, bytes,
    190 => Self::Small(bytes.arbitrary()?),
    230 => Self::Wide(bytes.arbitrary()?),
    250 => Self::Fine(bytes.arbitrary()?),
    else Self::Any(bytes.arbitrary()?));

/// Decodes bytes as operations. Any bytes are valid.
#[must_use]
pub fn operations(bytes: &[u8]) -> Vec<Operation> {
    let mut bytes = Unstructured::new(bytes);
    let mut operations = Vec::new();
    while !bytes.is_empty() && operations.len() < OPERATIONS_MAX {
        let Ok(operation) = Operation::arbitrary(&mut bytes) else { break };
        operations.push(operation);
    }
    operations
}

impl Pause {
    /// Returns the instant at which the pause ends.
    pub(crate) fn until(&self, now: Timestamp<Robot>) -> Timestamp<Robot> {
        // The pause is usually shorter than a script, and sometimes longer than all leases.
        let ticks = if self.ticks < 240 { self.ticks % 12 } else { self.ticks };
        now.max(on_grid(now, i64::from(ticks)) + nudged(self.nudge))
    }
}

impl Question {
    /// Creates the inquiry. It asks about requests that were sent, and about one that was never sent.
    pub(crate) fn written(
        &self,
        now: Timestamp<Robot>,
        sent: &[ControlRequest],
        devices: &[DeviceId],
    ) -> Inquiry {
        let earlier = |which: &u8| sent.get(usize::from(*which) % sent.len().max(1))?.request_id.clone();
        let mut requests: Vec<_> = self.requests.iter().filter_map(earlier).collect();
        requests.extend(RequestId::new("never sent"));
        let device = devices.get(usize::from(self.device) % (devices.len() + 1)).cloned();
        Inquiry {
            timestamp: None,
            session: session(self.session),
            requests,
            devices: device.or_else(|| DeviceId::new(NO_DEVICE).ok()).into_iter().collect(),
            pending_lease: self.pending_ticks.map(|ticks| Millis::from_span(TICK * i64::from(ticks % 24))),
            pending_until: self.until_ticks.map(|ticks| on_grid(now, i64::from(ticks % 24))),
        }
    }
}

impl Request {
    /// Creates the request at the time `now`, for one of `devices` or for a device that does not exist. `fresh` gives the request a
    /// unique id.
    pub(crate) fn written(
        &self,
        now: Timestamp<Robot>,
        devices: &[Device],
        fresh: usize,
    ) -> Option<ControlRequest> {
        let device = devices.get(usize::from(self.device % 64) % (devices.len() + 1));
        let device_id = device.map(|device| device.id.clone()).or_else(|| DeviceId::new(NO_DEVICE).ok())?;
        let primary = device.and_then(Device::primary_control_type).unwrap_or(ControlType::Position);
        let command = self.what.command(primary)?;
        let id = match self.id {
            Id::None => None,
            Id::Fresh => Some(format!("fresh-{fresh}")),
            Id::Used(id) => Some(format!("used-{}", id % IDS)),
        };
        let (timestamp, time_offset_to_start) = self.start.written(now);
        Some(ControlRequest {
            timestamp: timestamp.map(Timestamp::assume_clock),
            time_offset_to_start,
            stop_condition: self.lease.as_ref().map(Lease::written),
            pending_until: self.until_ticks.map(|ticks| on_grid(now, i64::from(ticks % 24))),
            request_id: id.and_then(|id| RequestId::new(id).ok()),
            content_hash: match self.hash {
                Hash::None => None,
                Hash::Right => Some(command.content_hash()),
                Hash::Wrong => Some(urrcp::ContentHash::of(b"another")),
            },
            session: session(self.session),
            home: self.home,
            ..ControlRequest::immediate(device_id, command)
        })
    }
}

/// Returns the session that a number names. Most numbers name none.
pub(crate) fn session(number: u8) -> Option<SessionId> {
    let named = number.checked_sub(SESSIONLESS)?;
    SessionId::new(format!("session-{}", named % SESSIONS)).ok()
}

impl Start {
    fn written(&self, now: Timestamp<Robot>) -> (Option<Timestamp<Robot>>, Option<Millis>) {
        match *self {
            Self::AtOnce => (None, None),
            Self::Sent { ticks_ago } => (Some(on_grid(now, -i64::from(ticks_ago % 8))), None),
            Self::At { sent_ticks_ago, ticks, nudge } => {
                let sent = on_grid(now, -i64::from(sent_ticks_ago % 8));
                let start = on_grid(now, i64::from(ticks.rem_euclid(16)) - 2) + nudged(nudge);
                (Some(sent), Some(Millis::from_span(start - sent)))
            }
            Self::Anywhere { timestamp, offset } => {
                (Some(Timestamp::from_nanos(timestamp)), Some(Millis::new(offset).unwrap_or_default()))
            }
        }
    }
}

impl Lease {
    fn written(&self) -> StopCondition {
        let millis = |ticks: u8| Millis::from_span(TICK * i64::from(ticks % 24));
        StopCondition { pending: self.pending.map(millis), running: self.running.map(millis) }
    }
}

impl What {
    fn command(&self, primary: ControlType) -> Option<Command> {
        Some(match self {
            Self::Set(target) => Command::Set(target.setpoint(primary)),
            Self::Script(planned) => {
                let mut steps: Vec<_> =
                    planned.iter().take(STEPS_MAX).map(|step| step.written(primary)).collect();
                steps.sort_by(|a, b| a.offset.get().total_cmp(&b.offset.get()));
                Command::Script(Script::new(steps).ok()?)
            }
            Self::Cancel => Command::Script(Script::cancel()),
            Self::Read => Command::ReadSensor,
        })
    }
}

impl PlannedStep {
    fn written(&self, primary: ControlType) -> Step {
        let offset = Millis::from_span(TICK * i64::from(self.ticks % 8));
        Step {
            offset,
            setpoint: self.target.setpoint(primary),
            stop_condition: self.lease.as_ref().map(Lease::written),
        }
    }
}

impl Target {
    fn setpoint(&self, primary: ControlType) -> Setpoint {
        let control_type = match self.kind % 32 {
            0..=23 => primary,
            24 | 25 => ControlType::Position,
            26..=28 => ControlType::Speed,
            29 => ControlType::Acceleration,
            30 => ControlType::Custom(1),
            _ => ControlType::Custom(2),
        };
        let value = match self.value {
            Value::Small(small) => f64::from(small.rem_euclid(12) - 1),
            Value::Wide(wide) => f64::from(wide) / 2.0,
            Value::Fine(fine) => f64::from(fine) / 64.0,
            Value::Any(any) => Some(any).filter(|any| any.is_finite()).unwrap_or_default(),
        };
        Setpoint { control_type, value, more: (self.more > 240).then_some(0.5).into_iter().collect() }
    }
}

/// Returns the instant that is `ticks` ticks after the last tick at or before `now`.
fn on_grid(now: Timestamp<Robot>, ticks: i64) -> Timestamp<Robot> {
    now - Span::from_nanos(now.as_nanos().rem_euclid(TICK.as_nanos())) + TICK * ticks
}

/// Returns an offset that is usually zero, otherwise a nanosecond or two in either direction.
fn nudged(nudge: i8) -> Span {
    Span::from_nanos(i64::from(nudge / 50))
}
