//! How an edge drives hardware: the trait of a driver, the drivers that come with Downbeat, and the thread round each.
//!
//! The robot's machine decides what is set and when, on the precise thread; a driver is slow. So each has a thread of
//! its own (`worker`) behind a short list of what is still to be set (`mailbox`), where the newest value of a signal
//! takes the place of an older one: what a slow device cannot follow it skips, and no other robot waits for it.

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
pub(crate) use self::pushes::PlanWord;
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

/// Hardware did not do what it should.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DriverError {
    /// It is not there, or no longer: it is connected again before anything else is asked of it.
    #[error("{0}")]
    Away(String),
    /// It is there and says no. A reading fails alone, and so does a script that is handed over; after a refused value everything ends and the driver is connected
    /// again, as after [`DriverError::Away`], since the device is not where the robot said that it would be.
    #[error("{0}")]
    Refused(String),
}

/// A linear movement, for drivers that move by themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Ramp {
    /// position, speed or acceleration.
    pub control_type: ControlType,
    /// Where it ends, in the device's unit.
    pub to: f64,
    /// How long it still takes.
    pub duration: Duration,
}

/// Drives the hardware of one robot.
///
/// All calls come from one thread and may block, for a second or so: a call that may hang needs a time limit of its own.
/// After an error, other than of a reading or a script, nothing but [`Driver::connect`] is called, with growing pauses, until it succeeds. A driver is dropped
/// when its edge ends, after its devices were brought to rest and a last [`Driver::ping`].
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
    /// Connects, or starts what is to be driven, and makes sure that it answers.
    ///
    /// # Errors
    /// Why it is not there.
    fn connect(&mut self) -> Result<(), DriverError>;

    /// Sets one signal of one device now: a value of a request, a step of a script, or a sample between two steps of a device that
    /// moves linearly. It lies within the limits that the device declares. Returns once the hardware has it, or at least the
    /// system under it.
    ///
    /// # Errors
    /// Why it was not set.
    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError>;

    /// What a sensor reads now, in its unit. Never called for a robot without sensors.
    ///
    /// # Errors
    /// Why there is no reading.
    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError>;

    /// Whether the hardware is there and could be moved: only its own answer tells. Asked twice a second while nothing is
    /// held, 20 times while something is, 40 times in the second before a start, less often where calls take long. Near a
    /// start hardware that has not answered for 150 ms, and twice what its calls take, counts as not ready.
    ///
    /// # Errors
    /// Why it is not.
    fn ping(&mut self) -> Result<(), DriverError>;

    /// How long before the last [`Driver::ping`] the hardware itself showed a sign of life, for a driver that hears from its hardware
    /// without asking it: the age of its latest state or heartbeat. `None`, the default: the answer to the ping was that sign.
    /// Hardware that shows none for longer than [`Rates::silence_max`] is away.
    fn last_sign(&self) -> Option<Duration> {
        None
    }

    /// What ends with the hardware: its socket, the pipe from its process. Asked for after each [`Driver::connect`]; its
    /// end is then noticed at once, also while nothing is asked. Without one the next ping has to tell.
    fn lifeline(&self) -> Option<Lifeline> {
        None
    }

    /// Whether the hardware itself has a value once [`Driver::set`] returns; asked after each [`Driver::connect`]. Without that,
    /// which is the default, the end of a command is told once the hardware has answered a later call.
    fn set_is_acknowledged(&self) -> bool {
        false
    }

    /// Sets the values of several signals that are due at one instant. Only called where [`Driver::takes_frames`]; others are told
    /// one value after another.
    ///
    /// # Errors
    /// Why not all of them were set.
    fn set_frame(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), DriverError> {
        values.iter().try_for_each(|(device, setpoint)| self.set(device, setpoint))
    }

    /// Whether it is told all values that are due at one instant by one call; asked after each [`Driver::connect`].
    fn takes_frames(&self) -> bool {
        false
    }

    /// How long each device takes from a value to its first visible motion, as far as the driver declares it; asked after each
    /// [`Driver::connect`]. It is shown, not compensated.
    fn latency(&self) -> BTreeMap<DeviceId, Duration> {
        BTreeMap::new()
    }

    /// Which devices' scripts it is told ahead of their time, to time them by itself; asked after each [`Driver::connect`]. For
    /// these devices [`Driver::plan`] is called, and [`Driver::set`] only for the way to rest.
    fn lookahead(&self) -> BTreeMap<DeviceId, Lookahead> {
        BTreeMap::new()
    }

    /// Takes a script, or its continuation, and returns at once; a single value is a script of one step. What becomes of it is told by
    /// [`Pushes::plan`]: that it began, steps if the driver knows of them, and that it is done. Without these words the script counts
    /// as failed. What the hardware does not show is reported as assumed; a script whose end is assumed counts as failed as well. It must not begin after `begin_by`. A connection that ends takes its scripts with it: after
    /// [`Driver::connect`] none of them may go on.
    ///
    /// # Errors
    /// [`DriverError::Refused`] why it was not taken: this script alone ends.
    fn plan(&mut self, part: &PlanPart<SystemClock>) -> Result<(), DriverError> {
        let _ = part;
        Err(DriverError::Refused("this driver times no scripts".to_owned()))
    }

    /// Ends a script, which may be waiting or under way. Returns once the hardware does not follow it any more: after that nothing of
    /// it may be set.
    ///
    /// # Errors
    /// Why it may still be under way. The driver is connected again then.
    fn cancel(&mut self, cancel: &PlanCancel) -> Result<(), DriverError> {
        let _ = cancel;
        Err(DriverError::Refused("this driver times no scripts".to_owned()))
    }

    /// How often it wants to be called; asked after each [`Driver::connect`].
    fn rates(&self) -> Rates {
        Rates::default()
    }

    /// Takes the handle by which it tells what it was not asked for. Called once, before the first [`Driver::connect`].
    fn take_pushes(&mut self, pushes: Pushes) {
        let _ = pushes;
    }

    /// Begins a linear movement and returns at once. A value or a further ramp takes its place.
    /// Only called where [`Driver::takes_ramps`]; others are sent samples.
    ///
    /// # Errors
    /// Why it did not begin.
    fn ramp(&mut self, device: &DeviceId, ramp: Ramp) -> Result<(), DriverError> {
        let _ = (device, ramp);
        Err(DriverError::Refused("this driver takes no ramps".to_owned()))
    }

    /// Whether the hardware moves linearly by itself; asked after each [`Driver::connect`].
    fn takes_ramps(&self) -> bool {
        false
    }
}

/// How a driver is used.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct DriverOptions {
    /// Samples of a movement a second, for a driver that takes no ramps; `None`: as the driver declares, or [`SAMPLES_PER_SECOND`].
    pub samples_per_second: Option<f64>,
    /// The same of single devices, which comes first.
    pub samples_of: BTreeMap<DeviceId, f64>,
    /// Pings a second in the second before a start, half as many while something is held; `None`: as the driver declares, or
    /// [`PINGS_PER_SECOND`].
    pub pings_per_second: Option<f64>,
    /// So often a second each sensor is read at most; requests in between are answered with the last reading. `None`: as the driver
    /// declares, or as often as it is asked for.
    pub readings_per_second: Option<f64>,
    /// Limits of the movements to rest and home, if they are tighter than those that the robot declares.
    pub limits: BTreeMap<DeviceId, MotionLimits>,
}

impl DriverOptions {
    /// The same with these limits of the movements to rest and home.
    #[must_use]
    pub fn with_limits(mut self, limits: BTreeMap<DeviceId, MotionLimits>) -> Self {
        self.limits = limits;
        self
    }

    /// The same with so many samples a second.
    #[must_use]
    pub const fn with_samples_per_second(mut self, samples_per_second: f64) -> Self {
        self.samples_per_second = Some(samples_per_second);
        self
    }

    /// The same with so many samples a second of one device.
    #[must_use]
    pub fn with_samples_of(mut self, device: DeviceId, samples_per_second: f64) -> Self {
        self.samples_of.insert(device, samples_per_second);
        self
    }

    /// The same with so many pings a second.
    #[must_use]
    pub const fn with_pings_per_second(mut self, pings_per_second: f64) -> Self {
        self.pings_per_second = Some(pings_per_second);
        self
    }

    /// The same with at most so many readings of each sensor a second.
    #[must_use]
    pub const fn with_readings_per_second(mut self, readings_per_second: f64) -> Self {
        self.readings_per_second = Some(readings_per_second);
        self
    }
}

/// What a machine wants of its hardware, in the robot's own time, which is the host's.
#[derive(Clone, Debug)]
pub(crate) enum Wanted {
    /// A value of a script with when it was due, or one of a stop.
    Set(Key, Setpoint, Option<Timestamp<Robot>>),
    Follow(Key, Signal),
    Read(ReadingId, DeviceId),
    /// To be told when all that was wanted before of the device has been done.
    Confirm(Ticket, DeviceId),
    /// Steps of a script that the driver times by itself.
    Plan(PlanPart<Robot>),
    Cancel(PlanCancel),
}

impl Wanted {
    /// With the clock to follow it by.
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
