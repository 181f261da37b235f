//! What a robot set, and when: the truth against which reports are held.

use serde::Serialize;
use urrcp::{DeviceId, Robot, Timestamp};

use crate::clock::HostTime;
use crate::device::Motion;
use crate::robot::SetValue;

/// One value set.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LogEntry {
    /// When, by the one true clock of the host, in nanoseconds since the Unix epoch.
    pub true_ns: i64,
    /// When, by the robot's own clock.
    pub set_at: Timestamp<Robot>,
    /// When it was due by the robot's own clock.
    pub due: Timestamp<Robot>,
    /// Which device.
    pub device: DeviceId,
    /// `set`, `ramp`, `slow`, `rest` or `default`.
    pub motion: &'static str,
    /// position, speed, acceleration or custom_N.
    pub control_type: String,
    /// The value set, or where the ramp ends.
    pub value: f64,
    /// Index of the script's step.
    pub step: Option<u32>,
    /// The request behind it.
    pub request_id: Option<String>,
}

impl LogEntry {
    /// Whether a step of a script was set, and not the way to the next one.
    #[cfg(feature = "host")]
    pub(crate) fn is_a_step(&self) -> bool {
        self.step.is_some() && self.motion == "set"
    }

    pub(crate) fn new(host_time: Timestamp<HostTime>, set_at: Timestamp<Robot>, set: SetValue) -> Self {
        let (motion, control_type, value) = match set.motion {
            Motion::Set(setpoint) => ("set", setpoint.control_type, setpoint.value),
            Motion::Ramp { control_type, to, .. } => ("ramp", control_type, to),
            Motion::Slow { control_type, to, .. } => ("slow", control_type, to),
            Motion::Rest(setpoint) => ("rest", setpoint.control_type, setpoint.value),
            Motion::Default(setpoint) => ("default", setpoint.control_type, setpoint.value),
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
