//! Driving hardware from an edge: the driver trait, the drivers that come with Downbeat, and the thread around each driver.
//!
//! The robot's machine decides on the precise thread what is set and when; a driver is slow. Each driver therefore has its own thread
//! (`worker`) behind a short list of pending values (`mailbox`). A newer value of a signal replaces an older one: a slow device skips
//! values, and no other robot waits for it.

#[cfg(feature = "thrift")]
mod described;
mod grid;
mod lifeline;
mod mailbox;
mod planned;
mod program;
mod pulse;
mod pushes;
mod rates;
mod running;
mod simulated;
mod spec;
#[cfg(feature = "thrift")]
mod thrift;
mod watched;
mod worker;

use std::collections::BTreeMap;
use std::time::Duration;

use urrcp::{ControlType, DeviceId, Robot, Setpoint, Timestamp};

pub use self::lifeline::Lifeline;
pub(crate) use self::mailbox::{Key, Mailbox};
pub(crate) use self::planned::PlanNews;
pub use self::program::{Program, Timeouts};
pub(crate) use self::pulse::Demand;
pub(crate) use self::pushes::PlanReport;
pub use self::pushes::Pushes;
pub use self::rates::{
    HARDWARE_SILENCE_MAX, PINGS_BOUNDS, PINGS_PER_SECOND, READINGS_BOUNDS, Rates, SAMPLES_BOUNDS,
    SAMPLES_PER_SECOND,
};
pub use self::simulated::SimulatedDriver;
pub use self::spec::{DriverSpec, DriverSpecError};
#[cfg(feature = "thrift")]
pub use self::thrift::{ThriftRobot, describe as describe_thrift};
pub use self::watched::HardwareEvent;
pub(crate) use self::worker::{News, Worker};

use crate::clock::{HostClock, SystemClock};
use crate::confirmation::Ticket;
use crate::device::MotionLimits;
use crate::hardware::ReadingId;
use crate::plans::{Lookahead, PlanCancel, PlanPart};
use crate::signal::Signal;

/// An error of a driver or its hardware.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DriverError {
    /// The hardware is not connected, or no longer: it is connected again before any other call.
    #[error("{0}")]
    Away(String),
    /// The hardware is connected and refuses. A refused reading or script fails alone. After a refused value, everything ends and the
    /// driver is connected again, as after [`DriverError::Away`], since the device is not where the robot reported it would be.
    #[error("{0}")]
    Refused(String),
}

/// A linear movement, for drivers that move by themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Ramp {
    /// Position, speed or acceleration.
    pub control_type: ControlType,
    /// Target, in the device's unit.
    pub to: f64,
    /// Remaining time.
    pub duration: Duration,
}

/// Drives the hardware of one robot.
///
/// All calls come from one thread and may block for about a second: a call that may hang needs a time limit of its own. After an error,
/// except of a reading or a script, only [`Driver::connect`] is called, with growing pauses, until it succeeds. When its edge ends, a
/// driver is dropped after its devices were brought to rest and a last [`Driver::ping`].
///
/// ```
/// use downbeat_robot::driver::{Driver, DriverError};
/// use urrcp::{DeviceId, Setpoint};
///
/// /// A lamp behind a file, as Linux shows LEDs.
/// struct Lamp(std::path::PathBuf);
///
/// impl Driver for Lamp {
///     fn connect(&mut self) -> Result<(), DriverError> {
///         self.ping()
///     }
///     fn set(&mut self, _device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
///         std::fs::write(&self.0, setpoint.value.to_string()).map_err(|e| DriverError::Away(e.to_string()))
///     }
///     fn read(&mut self, _sensor: &DeviceId) -> Result<f64, DriverError> {
///         let text = std::fs::read_to_string(&self.0).map_err(|e| DriverError::Away(e.to_string()))?;
///         text.trim().parse().map_err(|_| DriverError::Refused(format!("`{text}` is no number")))
///     }
///     fn ping(&mut self) -> Result<(), DriverError> {
///         self.0.try_exists().map_err(|e| DriverError::Away(e.to_string())).map(|_| ())
///     }
/// }
/// ```
pub trait Driver: Send {
    /// Connects to the hardware, or starts it, and makes sure that it answers.
    ///
    /// # Errors
    /// Why the hardware is not available.
    fn connect(&mut self) -> Result<(), DriverError>;

    /// Sets one signal of one device now: a value of a request, a step of a script, or a sample between two steps of a device that moves
    /// linearly. The value lies within the limits that the device declares. Returns once the hardware has it, or at least the system
    /// below the driver.
    ///
    /// # Errors
    /// Why it was not set.
    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError>;

    /// Returns the current reading of a sensor, in its unit. Never called for a robot without sensors.
    ///
    /// # Errors
    /// Why there is no reading.
    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError>;

    /// Checks whether the hardware is available and could be moved: only the hardware's own answer proves that. Called twice a second
    /// while nothing is held, 20 times while something is, 40 times in the second before a start, less often if calls take long. Near a
    /// start, hardware that has not answered for 150 ms, and for twice the duration of its calls, is not ready.
    ///
    /// # Errors
    /// Why it is not available.
    fn ping(&mut self) -> Result<(), DriverError>;

    /// Returns the time between the hardware's last sign of life and the last [`Driver::ping`], for a driver whose hardware sends states
    /// or heartbeats unasked. `None`, the default: the answer to the ping was that sign. Hardware that shows no sign of life for longer
    /// than [`Rates::silence_max`] is away.
    fn last_sign(&self) -> Option<Duration> {
        None
    }

    /// Returns a descriptor that ends with the hardware: its socket, or the pipe from its process. Called after each [`Driver::connect`].
    /// The end is then detected at once, even while no request is pending. Without a lifeline, the next ping detects it.
    fn lifeline(&self) -> Option<Lifeline> {
        None
    }

    /// Whether the hardware itself has a value once [`Driver::set`] returns; called after each [`Driver::connect`]. If not, which is the
    /// default, the end of a command is reported once the hardware has answered a later call.
    fn set_is_acknowledged(&self) -> bool {
        false
    }

    /// Sets the values of several signals that are due at one instant. Only called if [`Driver::takes_frames`]; other drivers receive one
    /// value after another.
    ///
    /// # Errors
    /// Why not all of them were set.
    fn set_frame(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), DriverError> {
        values.iter().try_for_each(|(device, setpoint)| self.set(device, setpoint))
    }

    /// Whether the driver receives all values that are due at one instant in one call; called after each [`Driver::connect`].
    fn takes_frames(&self) -> bool {
        false
    }

    /// Returns each device's latency from a value to its first visible motion, if the driver declares it; called after each
    /// [`Driver::connect`]. It is displayed, not compensated.
    fn latency(&self) -> BTreeMap<DeviceId, Duration> {
        BTreeMap::new()
    }

    /// Returns the devices whose scripts the driver receives ahead of their time and times by itself; called after each
    /// [`Driver::connect`]. For these devices [`Driver::plan`] is called, and [`Driver::set`] only for the way to rest.
    fn lookahead(&self) -> BTreeMap<DeviceId, Lookahead> {
        BTreeMap::new()
    }

    /// Takes a script, or its continuation, and returns at once; a single value is a script of one step. The driver reports its progress
    /// by [`Pushes::plan`]: that it began, steps if the driver knows of them, and that it is done. Without these reports, the script
    /// fails. An event that the hardware does not show is reported as assumed; a script with an assumed end fails as well. The script
    /// must not begin after `begin_by`. If the connection ends, its scripts end: after [`Driver::connect`] none of them may continue.
    ///
    /// # Errors
    /// [`DriverError::Refused`] with the reason: only this script ends.
    fn plan(&mut self, part: &PlanPart<SystemClock>) -> Result<(), DriverError> {
        let _ = part;
        Err(DriverError::Refused("this driver does not time scripts".to_owned()))
    }

    /// Ends a waiting or running script. Returns once the hardware no longer follows it: after that, none of its values may be set.
    ///
    /// # Errors
    /// Why it may still be running. The driver is then connected again.
    fn cancel(&mut self, cancel: &PlanCancel) -> Result<(), DriverError> {
        let _ = cancel;
        Err(DriverError::Refused("this driver does not time scripts".to_owned()))
    }

    /// Returns the preferred call rates; called after each [`Driver::connect`].
    fn rates(&self) -> Rates {
        Rates::default()
    }

    /// Takes the handle for unsolicited reports. Called once, before the first [`Driver::connect`].
    fn take_pushes(&mut self, pushes: Pushes) {
        let _ = pushes;
    }

    /// Begins a linear movement and returns at once. A value or a further ramp replaces it. Only called if [`Driver::takes_ramps`]; other
    /// drivers receive samples.
    ///
    /// # Errors
    /// Why it did not begin.
    fn ramp(&mut self, device: &DeviceId, ramp: Ramp) -> Result<(), DriverError> {
        let _ = (device, ramp);
        Err(DriverError::Refused("this driver does not support ramps".to_owned()))
    }

    /// Whether the hardware moves linearly by itself; called after each [`Driver::connect`].
    fn takes_ramps(&self) -> bool {
        false
    }
}

/// Options for the use of a driver.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct DriverOptions {
    /// Samples of a movement per second, for a driver that takes no ramps; `None`: as the driver declares, or [`SAMPLES_PER_SECOND`].
    pub samples_per_second: Option<f64>,
    /// The same per device; takes precedence.
    pub samples_of: BTreeMap<DeviceId, f64>,
    /// Pings per second in the second before a start, half as many while something is held; `None`: as the driver declares, or
    /// [`PINGS_PER_SECOND`].
    pub pings_per_second: Option<f64>,
    /// Maximum readings per second of each sensor; requests in between are answered with the last reading. `None`: as the driver
    /// declares, or one per request.
    pub readings_per_second: Option<f64>,
    /// Limits of the movements to rest and home, if they are tighter than those that the robot declares.
    pub limits: BTreeMap<DeviceId, MotionLimits>,
}

impl DriverOptions {
    /// Sets the limits of the movements to rest and home.
    #[must_use]
    pub fn with_limits(mut self, limits: BTreeMap<DeviceId, MotionLimits>) -> Self {
        self.limits = limits;
        self
    }

    /// Sets the samples per second.
    #[must_use]
    pub const fn with_samples_per_second(mut self, samples_per_second: f64) -> Self {
        self.samples_per_second = Some(samples_per_second);
        self
    }

    /// Sets the samples per second of one device.
    #[must_use]
    pub fn with_samples_of(mut self, device: DeviceId, samples_per_second: f64) -> Self {
        self.samples_of.insert(device, samples_per_second);
        self
    }

    /// Sets the pings per second.
    #[must_use]
    pub const fn with_pings_per_second(mut self, pings_per_second: f64) -> Self {
        self.pings_per_second = Some(pings_per_second);
        self
    }

    /// Sets the maximum readings per second of each sensor.
    #[must_use]
    pub const fn with_readings_per_second(mut self, readings_per_second: f64) -> Self {
        self.readings_per_second = Some(readings_per_second);
        self
    }
}

/// A request of a machine to its hardware, in the robot's own time, which is the host's.
#[derive(Clone, Debug)]
pub(crate) enum Wanted {
    /// A value of a script with its due time, or a value of a stop.
    Set(Key, Setpoint, Option<Timestamp<Robot>>),
    Follow(Key, Signal),
    Read(ReadingId, DeviceId),
    /// Report when all earlier requests for the device have been executed.
    Confirm(Ticket, DeviceId),
    /// Steps of a script that the driver times by itself.
    Plan(PlanPart<Robot>),
    Cancel(PlanCancel),
}

impl Wanted {
    /// Converts the request to an order on the given clock.
    pub(crate) fn on_clock(self, clock: HostClock) -> mailbox::Order {
        match self {
            Self::Set(key, setpoint, due) => {
                let due = due.map(|due| clock.instant_of(due.assume_clock()));
                mailbox::Order::Set(key, mailbox::Value { setpoint, due })
            }
            Self::Follow(key, signal) => mailbox::Order::Follow(key, mailbox::Movement { signal, clock }),
            Self::Read(reading, sensor) => mailbox::Order::Read(reading, sensor),
            Self::Confirm(ticket, device) => mailbox::Order::Confirm(ticket, device),
            Self::Plan(part) => mailbox::Order::Plan(mailbox::PlanOrder::Take(part, clock)),
            Self::Cancel(cancel) => mailbox::Order::Plan(mailbox::PlanOrder::Cancel(cancel)),
        }
    }
}

#[cfg(test)]
mod tests;
