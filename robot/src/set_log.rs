//! Log of the values that a robot set, with their times. It shows what really happened, so reports are checked against it.

use std::fmt;

use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, Robot, Timestamp};

use crate::clock::HostTime;
use crate::device::Motion;
use crate::robot::SetValue;

/// How the value of a device changes, as an entry of the log records it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MotionKind {
    /// The value changes at once.
    Set,
    /// The value starts to change linearly, and reaches its target when the step is due.
    Ramp,
    /// A position slows down and comes to rest, within the declared acceleration.
    Slow,
    /// A stop makes the device keep its current value, or sets a speed or an acceleration to zero.
    Rest,
    /// The device moves to its default state.
    Default,
}

impl fmt::Display for MotionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Set => "set",
            Self::Ramp => "ramp",
            Self::Slow => "slow",
            Self::Rest => "rest",
            Self::Default => "default",
        })
    }
}

/// An entry of the log: one value that was set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct LogEntry {
    /// Time when the value was set, by the host's clock, in nanoseconds since the Unix epoch.
    pub true_ns: i64,
    /// Time when the value was set, by the robot's own clock.
    pub set_at: Timestamp<Robot>,
    /// Time when the value was due, by the robot's own clock.
    pub due: Timestamp<Robot>,
    /// Device whose value was set.
    pub device: DeviceId,
    /// How the value changes.
    pub motion: MotionKind,
    /// Control type: `position`, `speed`, `acceleration` or `custom_N`.
    pub control_type: String,
    /// The value that was set, or the target of the ramp.
    pub value: f64,
    /// Index of the step in the script. `None` if the value is not a script's step.
    pub step: Option<u32>,
    /// Id of the request that caused the change. `None` for movements to rest and to the default state, and for a request without an id.
    pub request_id: Option<String>,
}

impl LogEntry {
    /// Whether the value changed at once: by a step of a script, or by a direct request.
    #[must_use]
    pub const fn is_set(&self) -> bool {
        matches!(self.motion, MotionKind::Set)
    }

    /// Whether the entry sets the value of a script's step. False for the linear movement towards a step.
    #[cfg(feature = "host")]
    pub(crate) const fn is_a_step(&self) -> bool {
        self.step.is_some() && self.is_set()
    }

    pub(crate) fn new(host_time: Timestamp<HostTime>, set_at: Timestamp<Robot>, set: SetValue) -> Self {
        let (motion, control_type, value) = match set.motion {
            Motion::Set(setpoint) => (MotionKind::Set, setpoint.control_type, setpoint.value),
            Motion::Ramp { control_type, to, .. } => (MotionKind::Ramp, control_type, to),
            Motion::Slow { control_type, to, .. } => (MotionKind::Slow, control_type, to),
            Motion::Rest(setpoint) => (MotionKind::Rest, setpoint.control_type, setpoint.value),
            Motion::Default(setpoint) => (MotionKind::Default, setpoint.control_type, setpoint.value),
        };
        Self {
            true_ns: host_time.as_nanos(),
            set_at,
            due: set.due,
            device: set.device,
            motion,
            control_type: control_type.to_string(),
            value,
            step: set.step,
            request_id: set.request_id.map(|id| id.as_str().to_owned()),
        }
    }
}
