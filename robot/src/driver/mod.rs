//! Drives hardware from an edge: the driver trait, the drivers that are part of Downbeat, and the thread around each driver.
//!
//! The robot's state machine runs on the precise thread and decides which values are set and when, but drivers are slow. Each driver
//! therefore has its own thread (`worker`) behind a short list of pending values (`mailbox`). A newer value of a signal replaces an older
//! one: a slow device skips values, and no other robot waits for it.

#[cfg(feature = "thrift")]
mod described;
#[cfg(feature = "dmx")]
mod dmx;
mod grid;
mod lifeline;
mod mailbox;
mod mavlink;
#[cfg(feature = "osc")]
mod osc;
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

#[cfg(feature = "dmx")]
pub use self::dmx::{
    ArtNetNode, AtEnd, DmxAddress, DmxFixture, FRAMES_PER_SECOND, PRIORITY, Protocol as DmxProtocol,
    SacnSource, hear_sacn, poll_art_net,
};
pub use self::lifeline::Lifeline;
pub(crate) use self::mailbox::{Key, Mailbox, Sampled};
#[cfg(feature = "mavlink")]
pub use self::mavlink::{HeardVehicle, MAVLINK_PORT, MavlinkVehicle, hear_mavlink};
pub use self::mavlink::{MavlinkAddress, TAKEOFF_MM, VehicleEnd};
#[cfg(feature = "osc")]
pub use self::osc::{OscAddress, OscRobot};
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
pub use self::spec::DriverSpec;
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
    /// The hardware is not connected, or no longer connected. Before any other call, [`Driver::connect`] is called again.
    #[error("{0}")]
    Away(String),
    /// The hardware is connected and refuses the call. If a reading or a script is refused, only this reading or script fails. After a
    /// refused value, the device is not where the robot reported it would be. All commands of the robot therefore end, and the driver is
    /// connected again, as after [`DriverError::Away`].
    #[error("{0}")]
    Refused(String),
}

/// A linear movement, for drivers whose hardware moves linearly by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Ramp {
    /// Position, speed or acceleration.
    pub control_type: ControlType,
    /// Target value, in the device's unit.
    pub to: f64,
    /// Time from the call until the target is reached.
    pub duration: Duration,
}

/// Drives the hardware of one robot.
///
/// All calls come from one thread and may block for about a second: a call that may hang needs a time limit of its own. After an error of
/// any call except a reading or a script, only [`Driver::connect`] is called, with growing pauses, until it succeeds. When the edge ends,
/// its devices are brought to rest; after a last [`Driver::ping`], the driver is dropped.
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
    /// The reason why the hardware is not available.
    fn connect(&mut self) -> Result<(), DriverError>;

    /// Sets one signal of one device now: a value of a request, a step of a script, or a sample between two steps of a device that moves
    /// linearly. The value lies within the limits that the device declares. Returns once the hardware, or at least the system below the
    /// driver, has taken the value.
    ///
    /// # Errors
    /// The reason why the value was not set.
    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError>;

    /// Returns the current reading of a sensor, in its unit. Never called for a robot without sensors.
    ///
    /// # Errors
    /// The reason why there is no reading.
    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError>;

    /// Returns the time between the sampling of the value that [`Driver::read`] returned last and its return. `None`, the default: the
    /// driver does not know it.
    fn age_of_reading(&self) -> Option<Duration> {
        None
    }

    /// Checks whether the hardware is available and able to move: only the hardware's own answer proves that.
    ///
    /// Called twice a second while the robot holds no command, and 20 times a second while it holds one. In the last second before a
    /// start, it is called 40 times a second. If calls take long, they are less frequent. Near a start, hardware counts as not ready once
    /// its silence exceeds both 150 ms and twice the duration of its calls.
    ///
    /// # Errors
    /// The reason why the hardware is not available.
    fn ping(&mut self) -> Result<(), DriverError>;

    /// Returns the time between the hardware's last sign of life and the last [`Driver::ping`], for a driver whose hardware sends states
    /// or heartbeats unasked. `None`, the default: the answer to the ping was the sign of life. Hardware that shows no sign of life for
    /// longer than [`Rates::silence_max`] counts as disconnected.
    fn last_sign(&self) -> Option<Duration> {
        None
    }

    /// Returns a descriptor that reports the end of the connection to the hardware: its socket, or the pipe from its process. Called
    /// after each [`Driver::connect`]. With this descriptor, the end is detected at once, even while no request is pending; without it,
    /// at the next ping.
    fn lifeline(&self) -> Option<Lifeline> {
        None
    }

    /// Whether the hardware itself has taken a value once [`Driver::set`] returns. Called after each [`Driver::connect`]. With `false`,
    /// the default, the end of a command is reported only once the hardware has answered a later call.
    fn set_is_acknowledged(&self) -> bool {
        false
    }

    /// Sets the values of several signals that are due at the same instant. Only called if [`Driver::takes_frames`] returns true; other
    /// drivers receive one value after another.
    ///
    /// # Errors
    /// The reason why not all values were set.
    fn set_frame(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), DriverError> {
        values.iter().try_for_each(|(device, setpoint)| self.set(device, setpoint))
    }

    /// Whether the driver receives in one call all values that are due at the same instant. Called after each [`Driver::connect`].
    fn takes_frames(&self) -> bool {
        false
    }

    /// Returns the latency of each device for which the driver declares one: the time from a value to the first visible motion. Called
    /// after each [`Driver::connect`]. The latency is displayed, not compensated.
    fn latency(&self) -> BTreeMap<DeviceId, Duration> {
        BTreeMap::new()
    }

    /// Returns the devices whose scripts the driver receives in advance and times by itself, with how far in advance. Called after each
    /// [`Driver::connect`]. For these devices, scripts are passed to [`Driver::plan`]; [`Driver::set`] is only called for movements to
    /// rest.
    fn lookahead(&self) -> BTreeMap<DeviceId, Lookahead> {
        BTreeMap::new()
    }

    /// Takes a script, or its continuation, and returns at once. A single value is a script of one step. The script must not start after
    /// `begin_by`.
    ///
    /// The driver reports the script's progress by [`Pushes::plan`]: its start, its steps if the driver knows of them, and its end.
    /// Without these reports, the script fails. An event that the hardware does not show is reported as assumed; a script whose end is
    /// assumed also fails. If the connection ends, its scripts end: after [`Driver::connect`], none of them may continue.
    ///
    /// # Errors
    /// [`DriverError::Refused`] with the reason: only this script ends.
    fn plan(&mut self, part: &PlanPart<SystemClock>) -> Result<(), DriverError> {
        let _ = part;
        Err(DriverError::Refused("this driver cannot play scripts by itself".to_owned()))
    }

    /// Ends a waiting or running script. Returns once the hardware no longer follows the script: after that, none of its values may be
    /// set.
    ///
    /// # Errors
    /// The reason why the script may still be running. The driver is then connected again.
    fn cancel(&mut self, cancel: &PlanCancel) -> Result<(), DriverError> {
        let _ = cancel;
        Err(DriverError::Refused("this driver cannot play scripts by itself".to_owned()))
    }

    /// Returns the driver's preferred call rates. Called after each [`Driver::connect`].
    fn rates(&self) -> Rates {
        Rates::default()
    }

    /// Takes the handle by which the driver makes unsolicited reports. Called once, before the first [`Driver::connect`].
    fn take_pushes(&mut self, pushes: Pushes) {
        let _ = pushes;
    }

    /// Starts a linear movement and returns at once. A later value or ramp for the same signal replaces the movement. Only called if
    /// [`Driver::takes_ramps`] returns true; other drivers receive samples (intermediate values).
    ///
    /// # Errors
    /// The reason why the movement did not start.
    fn ramp(&mut self, device: &DeviceId, ramp: Ramp) -> Result<(), DriverError> {
        let _ = (device, ramp);
        Err(DriverError::Refused("this driver does not support ramps".to_owned()))
    }

    /// Whether the hardware moves linearly by itself. Called after each [`Driver::connect`].
    fn takes_ramps(&self) -> bool {
        false
    }
}

/// Call rates and motion limits for a driver, as its user configures them.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct DriverOptions {
    /// Samples (intermediate values) of a movement per second, for a driver that takes no ramps. `None`: the driver's declared rate, or
    /// [`SAMPLES_PER_SECOND`].
    pub samples_per_second: Option<f64>,
    /// Samples of a movement per second, for single devices. Takes precedence over `samples_per_second`.
    pub samples_of: BTreeMap<DeviceId, f64>,
    /// Pings per second in the last second before a start; half as many at other times while the robot holds a command. `None`: the
    /// driver's declared rate, or [`PINGS_PER_SECOND`].
    pub pings_per_second: Option<f64>,
    /// Maximum readings of each sensor per second. Requests in between are answered with the last reading. `None`: the driver's declared
    /// rate, or one reading per request.
    pub readings_per_second: Option<f64>,
    /// Limits for movements to rest and to the default state, by device, where they are lower than those that the robot declares.
    pub limits: BTreeMap<DeviceId, MotionLimits>,
}

impl DriverOptions {
    /// Sets the limits for movements to rest and to the default state, by device.
    #[must_use]
    pub fn with_limits(mut self, limits: BTreeMap<DeviceId, MotionLimits>) -> Self {
        self.limits = limits;
        self
    }

    /// Sets the number of samples (intermediate values) of a movement per second.
    #[must_use]
    pub const fn with_samples_per_second(mut self, samples_per_second: f64) -> Self {
        self.samples_per_second = Some(samples_per_second);
        self
    }

    /// Sets the number of samples of a movement per second for one device.
    #[must_use]
    pub fn with_samples_of(mut self, device: DeviceId, samples_per_second: f64) -> Self {
        self.samples_of.insert(device, samples_per_second);
        self
    }

    /// Sets the number of pings per second in the last second before a start.
    #[must_use]
    pub const fn with_pings_per_second(mut self, pings_per_second: f64) -> Self {
        self.pings_per_second = Some(pings_per_second);
        self
    }

    /// Sets the maximum number of readings of each sensor per second.
    #[must_use]
    pub const fn with_readings_per_second(mut self, readings_per_second: f64) -> Self {
        self.readings_per_second = Some(readings_per_second);
        self
    }
}

/// A request of a robot's state machine to the hardware. Times refer to the robot's clock, which is the host's clock.
#[derive(Clone, Debug)]
pub(crate) enum Wanted {
    /// Set a value. A value of a script has a due time; a value of a stop has none (`None`).
    Set(Key, Setpoint, Option<Timestamp<Robot>>),
    Follow(Key, Signal),
    Read(ReadingId, DeviceId),
    /// Report once all earlier requests for the device have been executed.
    Confirm(Ticket, DeviceId),
    /// Take these steps of a script that the driver times by itself.
    Plan(PlanPart<Robot>),
    Cancel(PlanCancel),
}

impl Wanted {
    /// Converts the request to an order whose times refer to `clock`.
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
