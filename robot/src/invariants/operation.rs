//! What may happen to a robot, one operation at a time, decoded from arbitrary bytes.
//!
//! Times are coarse, so that many events fall on one instant, with nudges of a nanosecond round them.

use arbitrary::{Arbitrary, Unstructured};
use urrcp::{
    Command, ControlRequest, ControlType, DeviceId, Millis, RequestId, Robot, Script, SessionId, Setpoint,
    Span, Step, StopCondition, Timestamp,
};

/// Operations that are played at most: fewer than the robot remembers requests.
const OPERATIONS_MAX: usize = 128;
/// Steps of one script at most; more than the devices take.
const STEPS_MAX: usize = 6;
/// The unit of all coarse times.
const TICK: Span = Span::from_millis(50);
/// Ids and names that occur beside those of the robot's devices.
const NO_DEVICE: &str = "leg";
const IDS: u8 = 8;
const SESSIONS: u8 = 3;

/// One thing that happens to a robot.
#[derive(Clone, Debug, Arbitrary)]
pub enum Operation {
    /// A control request comes.
    Request(Request),
    /// An earlier request comes once more, maybe on another link.
    Repeat {
        /// Which.
        which: u8,
        /// On which link.
        link: u8,
    },
    /// An availability request comes.
    Ask {
        /// On which link.
        link: u8,
        /// On whose behalf.
        session: Option<u8>,
    },
    /// An initialization request comes.
    Describe {
        /// On which link.
        link: u8,
    },
    /// A message comes that only a robot sends.
    Stray {
        /// On which link.
        link: u8,
    },
    /// A line comes that is no message.
    Noise {
        /// On which link.
        link: u8,
        /// The device that could be made out all the same.
        device: Option<u8>,
    },
    /// A link breaks; what comes on it later comes on a new one.
    Break {
        /// Which.
        link: u8,
    },
    /// Time passes, and the robot is woken whenever it asks to be.
    Wait(Pause),
    /// Time passes, and the robot is woken in the end only, as when its process was stopped.
    HeldUp(Pause),
}

/// How long nothing comes: to an instant of the coarse grid, or a few nanoseconds beside it.
#[derive(Clone, Debug, Arbitrary)]
pub struct Pause {
    ticks: u8,
    nudge: i8,
}

/// A control request before it is written out.
#[derive(Clone, Debug, Arbitrary)]
pub struct Request {
    pub(super) link: u8,
    session: Option<u8>,
    device: u8,
    id: Id,
    start: Start,
    lease: Option<Lease>,
    hash: Hash,
    hold: bool,
    what: What,
}

#[derive(Clone, Debug, Arbitrary)]
enum Id {
    None,
    Fresh,
    Used(u8),
}

#[derive(Clone, Debug, Arbitrary)]
enum Start {
    AtOnce,
    /// A timestamp and no offset: a stop takes back what was sent before it.
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

#[derive(Clone, Debug, Arbitrary)]
enum Hash {
    None,
    Right,
    Wrong,
}

#[derive(Clone, Debug, Arbitrary)]
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
    more: Option<i8>,
}

#[derive(Clone, Debug, Arbitrary)]
enum Value {
    Whole(i8),
    Fine(i16),
    Any(f64),
}

/// Reads bytes as operations; any bytes give some.
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
    /// The instant at which it is over.
    pub(super) fn until(&self, now: Timestamp<Robot>) -> Timestamp<Robot> {
        now.max(on_grid(now, i64::from(self.ticks)) + nudged(self.nudge))
    }
}

impl Request {
    /// Writes the request out, as of `now`, for one of these devices or for none. `fresh` makes an id that no other has.
    pub(super) fn written(
        &self,
        now: Timestamp<Robot>,
        devices: &[DeviceId],
        fresh: usize,
    ) -> Option<ControlRequest> {
        let device = usize::from(self.device) % (devices.len() + 1);
        let device_id = devices.get(device).cloned().or_else(|| DeviceId::new(NO_DEVICE).ok())?;
        let command = self.what.command()?;
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
            request_id: id.and_then(|id| RequestId::new(id).ok()),
            content_hash: match self.hash {
                Hash::None => None,
                Hash::Right => Some(command.content_hash()),
                Hash::Wrong => Some(urrcp::ContentHash::of(b"another")),
            },
            session: self.session.and_then(session),
            hold: self.hold,
            ..ControlRequest::immediate(device_id, command)
        })
    }
}

/// The session of a number.
pub(super) fn session(number: u8) -> Option<SessionId> {
    SessionId::new(format!("session-{}", number % SESSIONS)).ok()
}

impl Start {
    fn written(&self, now: Timestamp<Robot>) -> (Option<Timestamp<Robot>>, Option<Millis>) {
        match *self {
            Self::AtOnce => (None, None),
            Self::Sent { ticks_ago } => (Some(on_grid(now, -i64::from(ticks_ago))), None),
            Self::At { sent_ticks_ago, ticks, nudge } => {
                let sent = on_grid(now, -i64::from(sent_ticks_ago));
                let start = on_grid(now, i64::from(ticks)) + nudged(nudge);
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
        let millis = |ticks: u8| Millis::from_span(TICK * i64::from(ticks));
        StopCondition { pending: self.pending.map(millis), running: self.running.map(millis) }
    }
}

impl What {
    fn command(&self) -> Option<Command> {
        Some(match self {
            Self::Set(target) => Command::Set(target.setpoint()),
            Self::Script(planned) => {
                let mut steps: Vec<_> = planned.iter().take(STEPS_MAX).map(PlannedStep::step).collect();
                steps.sort_by(|a, b| a.offset.get().total_cmp(&b.offset.get()));
                Command::Script(Script::new(steps).ok()?)
            }
            Self::Cancel => Command::Script(Script::cancel()),
            Self::Read => Command::ReadSensor,
        })
    }
}

impl PlannedStep {
    fn step(&self) -> Step {
        let offset = Millis::from_span(TICK * i64::from(self.ticks % 16));
        Step {
            offset,
            setpoint: self.target.setpoint(),
            stop_condition: self.lease.as_ref().map(Lease::written),
        }
    }
}

impl Target {
    fn setpoint(&self) -> Setpoint {
        let control_type = match self.kind % 8 {
            0..=2 => ControlType::Position,
            3 | 4 => ControlType::Speed,
            5 => ControlType::Acceleration,
            6 => ControlType::Custom(1),
            _ => ControlType::Custom(2),
        };
        let value = match self.value {
            Value::Whole(whole) => f64::from(whole),
            Value::Fine(fine) => f64::from(fine) / 64.0,
            Value::Any(any) => Some(any).filter(|any| any.is_finite()).unwrap_or_default(),
        };
        Setpoint { control_type, value, more: self.more.map(f64::from).into_iter().collect() }
    }
}

/// The instant so many ticks from the tick at or before `now`.
fn on_grid(now: Timestamp<Robot>, ticks: i64) -> Timestamp<Robot> {
    now - Span::from_nanos(now.as_nanos().rem_euclid(TICK.as_nanos())) + TICK * ticks
}

/// Mostly nothing, else a nanosecond or two either way.
fn nudged(nudge: i8) -> Span {
    Span::from_nanos(i64::from(nudge / 50))
}
