//! The thread around a driver: connects the driver, passes values to it, sends intermediate values of movements, and reports failures.
#![expect(clippy::disallowed_methods, reason = "samples and pings on the monotonic clock")]

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use urrcp::{ControlType, DeviceId, InitializationBlock, Setpoint, Span};

use super::grid::on_grid;
use super::lifeline::Watcher;
use super::mailbox::{Drive, DriverTraits, Movement, Sign, Value, Work};
use super::planned::{Given, PlanNews};
use super::rates::HARDWARE_SILENCE_MAX;
use super::{Driver, DriverError, DriverOptions, Key, Mailbox, PlanReport, Pushes, Ramp, Rates};
use crate::confirmation::Ticket;
use crate::hardware::ReadingId;
use crate::plans::Lookahead;
use crate::signal::{is_rate, rest_of};
use crate::tolerance::Tolerance;

/// Pause between two attempts to connect: first the initial one, which doubles after each attempt, then the maximum.
const PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));
/// Time for which requests are answered with an unsolicited reading, if the sensor has no `max_delay`.
const PUSHED_COUNTS: Duration = Duration::from_secs(1);
/// Interval at which an idle thread polls the mailbox.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// Maximum number of values that an error message lists if the driver refuses several values in one call.
const UNTAKEN_SHOWN: usize = 8;
/// Maximum time for the devices to come to rest when the edge ends. After that, speeds are set to zero at once, and positions stay as
/// they are.
const REST_WAIT_MAX: Duration = Duration::from_secs(3);

/// A report of a driver's thread to the robot's state machine.
#[derive(Debug)]
pub(crate) enum News {
    /// The hardware is connected. `connection` is the number of this connection, counted from the start of the edge.
    There {
        connection: u64,
        /// Latency from a value to visible motion, by device, as the driver declares it.
        latency: BTreeMap<DeviceId, Duration>,
        /// Devices whose scripts the driver times by itself, with how far ahead it receives them.
        lookahead: BTreeMap<DeviceId, Lookahead>,
    },
    /// The hardware is not connected, or no longer connected; contains the reason.
    Away { reason: String },
    /// A value was not set because it was too late: its delay was `late`.
    Stale { device: urrcp::DeviceId, late: Duration },
    /// A report about a script that the driver times by itself.
    Plan(PlanNews),
    /// The hardware has taken all orders that were given before these tickets (questions of the state machine).
    Confirmed(Vec<Ticket>),
    /// A sensor was read. `reading` is the sensor's reading, or the reason for its absence.
    Reading { id: ReadingId, reading: Result<f64, String> },
}

/// Reason why no further calls are made until the hardware is connected again.
#[derive(Debug, thiserror::Error)]
pub(super) enum Lost {
    #[error("the hardware is not available: {0}")]
    Away(String),
    #[error("the hardware refused {0}")]
    Refused(String),
    #[error("the hardware reports a fault: {0}")]
    Fault(String),
}

impl From<DriverError> for Lost {
    fn from(error: DriverError) -> Self {
        Self::Away(error.to_string())
    }
}

impl Lost {
    /// Returns the error for values that the hardware refused or could not take.
    fn untaken(error: DriverError, values: &[(DeviceId, Setpoint)]) -> Self {
        match error {
            DriverError::Away(reason) => Self::Away(reason),
            DriverError::Refused(reason) => {
                let told = |(device, setpoint): &(DeviceId, Setpoint)| {
                    format!("{} {} of `{device}`", setpoint.control_type, setpoint.value)
                };
                let values: Vec<_> = values.iter().take(UNTAKEN_SHOWN).map(told).collect();
                Self::Refused(format!("{}: {reason}", values.join(", ")))
            }
        }
    }
}

/// A driver and the state of its thread.
pub(crate) struct Worker {
    driver: Box<dyn Driver>,
    block: InitializationBlock,
    mailbox: Arc<Mailbox>,
    tell: Box<dyn Fn(News) + Send>,
    options: DriverOptions,
    /// Preferred call rates, as the driver declares them.
    rates: Rates,
    moving: BTreeMap<Key, Moving>,
    /// Ramps that the hardware is executing by itself.
    handed_over: BTreeMap<Key, Movement>,
    touched: Touched,
    /// Whether the hardware has received a value, such as a speed, that must be set to rest after a reconnection. Positions stay as they
    /// are.
    owes_rest: bool,
    /// Time of the next sample, for each sample period that a movement uses.
    beats: BTreeMap<Duration, Instant>,
    pub(super) given: Given,
    /// Last reading and its time, for sensors with a maximum number of readings per second.
    readings: BTreeMap<DeviceId, (f64, Instant)>,
}

/// When the driver last received a movement: never, before the last reconnection, or since then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Touched {
    Never,
    /// The driver received a movement, but none since the last reconnection.
    Before,
    Now,
}

struct Moving {
    movement: Movement,
    sent: Option<f64>,
    /// Interval between two samples (intermediate values) of the movement.
    period: Duration,
}

impl Worker {
    pub(crate) fn new(
        mut driver: Box<dyn Driver>,
        block: InitializationBlock,
        mailbox: Arc<Mailbox>,
        options: DriverOptions,
        tell: Box<dyn Fn(News) + Send>,
    ) -> Self {
        driver.take_pushes(Pushes::into(Arc::clone(&mailbox)));
        Self {
            driver,
            block,
            mailbox,
            tell,
            options,
            rates: Rates::default(),
            moving: BTreeMap::new(),
            handed_over: BTreeMap::new(),
            touched: Touched::Never,
            owes_rest: false,
            beats: BTreeMap::new(),
            given: Given::default(),
            readings: BTreeMap::new(),
        }
    }

    /// Runs until the mailbox is closed and empty, or until it is closed while the hardware is not connected.
    ///
    /// # Errors
    /// The reason why moved devices may not be at rest.
    pub(crate) fn run(mut self) -> Result<(), String> {
        let mut pause = PAUSE.0;
        let mut connection = 0;
        let mut away = String::new();
        while !self.mailbox.is_closed() {
            let reason = match self.driver.connect() {
                Ok(()) => {
                    connection += 1;
                    if self.touched != Touched::Never {
                        self.touched = if self.owes_rest { Touched::Before } else { Touched::Never };
                    }
                    self.rates = self.driver.rates();
                    let manners = DriverTraits {
                        ping_period: self.rates.ping_period(&self.options),
                        silence_max: self.rates.silence_max,
                        acknowledges: self.driver.set_is_acknowledged(),
                        takes_frames: self.driver.takes_frames(),
                    };
                    self.mailbox.connected(connection, manners);
                    let (latency, lookahead) = (self.driver.latency(), self.driver.lookahead());
                    (self.tell)(News::There { connection, latency, lookahead });
                    self.mailbox.tried();
                    let since = Instant::now();
                    // The watcher is dropped before the driver connects again: hardware may accept only one connection at a time.
                    let watcher = self.watch(connection);
                    let served = self.serve();
                    drop(watcher);
                    let error = match served {
                        Ok(_) if self.touched == Touched::Before => {
                            return Err(
                                "the hardware was reconnected too late to receive commands".to_owned()
                            );
                        }
                        Ok(cut_short) => return cut_short,
                        Err(error) => error,
                    };
                    if since.elapsed() > PAUSE.1 {
                        pause = PAUSE.0;
                    }
                    error
                }
                Err(error) => error.into(),
            };
            self.moving.clear();
            self.handed_over.clear();
            self.given.clear();
            self.readings.clear();
            // The mailbox is closed to orders before the report is sent, so that no earlier order reaches the next connection.
            self.mailbox.disconnected();
            tracing::warn!(robot = %self.block.id, "{reason}");
            away = reason.to_string();
            (self.tell)(News::Away { reason: away.clone() });
            self.mailbox.tried();
            self.mailbox.pause(pause);
            pause = (pause * 2).min(PAUSE.1);
        }
        match self.touched {
            Touched::Never => Ok(()),
            Touched::Before | Touched::Now => Err(away),
        }
    }

    /// Executes work until the hardware fails or the mailbox is closed. If closing the mailbox cut a movement short, the inner error
    /// describes the movement.
    fn serve(&mut self) -> Result<Result<(), String>, Lost> {
        let mut closing: Option<Instant> = None;
        loop {
            let sample = self.next_sample();
            match self.mailbox.next(sample.unwrap_or_else(|| Instant::now() + LOOK_EVERY)) {
                Work::Drive(drives) => self.drive(drives)?,
                Work::Read(id, sensor) => self.read(id, &sensor)?,
                Work::Plan(order) => self.do_plan(order)?,
                Work::Words(words) => self.pass_on(words)?,
                Work::Confirm(tickets) => (self.tell)(News::Confirmed(tickets)),
                Work::Ping => self.ping()?,
                Work::HungUp(reason) => return Err(Lost::Away(reason)),
                Work::Fault(reason) => return Err(Lost::Fault(reason)),
                Work::Nothing => {}
                Work::Closed => {
                    let end = *closing.get_or_insert_with(|| Instant::now() + REST_WAIT_MAX);
                    let next = self.next_until_rest().filter(|_| Instant::now() < end);
                    let Some(next) = next else { return self.end_movements() };
                    std::thread::sleep(next.min(end).saturating_duration_since(Instant::now()));
                }
            }
            let now = Instant::now();
            if self.next_sample().is_some_and(|at| at <= now) {
                self.sample(now)?;
            }
        }
    }

    /// Returns when to check again whether the remaining movements have ended. `None` if no movement remains.
    fn next_until_rest(&self) -> Option<Instant> {
        let sample = self.next_sample();
        let left = self.handed_over.values().map(Movement::left).max().filter(|left| !left.is_zero());
        let look = left.map(|left| Instant::now() + left.min(LOOK_EVERY));
        sample.into_iter().chain(look).min()
    }

    /// Returns the time of the next sample (intermediate value) of any movement. `None` if nothing moves.
    fn next_sample(&self) -> Option<Instant> {
        let at = |moving: &Moving| self.beats.get(&moving.period).copied();
        self.moving.values().filter_map(at).min()
    }

    pub(super) fn tell(&self, news: News) {
        (self.tell)(news);
    }

    pub(super) const fn block(&self) -> &InitializationBlock {
        &self.block
    }

    pub(super) fn tolerance(&self) -> Tolerance {
        self.mailbox.tolerance()
    }

    /// Whether a stop sets this signal to its value at rest, as it does for speeds. Positions stay as they are.
    fn comes_to_rest(&self, device: &DeviceId, control_type: ControlType) -> bool {
        let spec = self.block.device(device.as_str());
        spec.is_some_and(|spec| rest_of(spec, control_type, None).is_some())
    }

    /// Records that the driver receives a movement.
    pub(super) const fn touch(&mut self) {
        self.touched = Touched::Now;
    }

    /// Removes and returns the driver's reports about scripts that were not forwarded yet.
    pub(super) fn words(&self) -> Vec<PlanReport> {
        self.mailbox.words()
    }

    /// Watches for the end of the connection, if the driver has a lifeline.
    fn watch(&self, connection: u64) -> Option<Watcher> {
        let watcher = Watcher::begin(self.driver.lifeline()?, Arc::clone(&self.mailbox), connection);
        watcher
            .inspect_err(|error| tracing::warn!("cannot monitor the connection to the hardware: {error}"))
            .ok()
    }

    /// Calls the driver, and records the call's duration, and what the call shows about whether the hardware is alive.
    pub(super) fn call<T>(
        &mut self,
        sign: Sign,
        call: impl FnOnce(&mut dyn Driver) -> Result<T, DriverError>,
    ) -> Result<T, DriverError> {
        let begin = Instant::now();
        let called = call(&mut *self.driver);
        if called.is_ok() {
            self.mailbox.called(begin.elapsed(), sign);
        }
        called
    }

    /// Sets the values and starts the movements. A value that is too late is not set but reported, and the movement that follows it is
    /// skipped; the robot's state machine then ends both.
    fn drive(&mut self, drives: Vec<Drive>) -> Result<(), Lost> {
        let late_max = self.tolerance().step.to_duration();
        let mut values = Vec::new();
        let mut movements = Vec::new();
        for (key, value, movement) in drives {
            if let Some(late) = value.as_ref().and_then(|value| value.stale(Instant::now(), late_max)) {
                (self.tell)(News::Stale { device: key.0, late });
                continue;
            }
            if let Some(Value { setpoint, .. }) = value {
                self.moving.remove(&key);
                self.handed_over.remove(&key);
                let value = on_grid(&self.block, &key, setpoint.value);
                values.push((key.0.clone(), Setpoint { value, ..setpoint }));
            }
            movements.extend(movement.map(|movement| (key, movement)));
        }
        self.set(&values)?;
        movements.into_iter().try_for_each(|(key, movement)| self.follow(key, movement))?;
        // Sends the first sample at once: a confirmation that follows must not confirm a value that only this process knows.
        if self.moving.values().any(|moving| moving.sent.is_none()) {
            self.sample(Instant::now())?;
        }
        Ok(())
    }

    /// Sets the values, in one call if the driver takes frames.
    fn set(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), Lost> {
        if values.is_empty() {
            return Ok(());
        }
        self.touched = Touched::Now;
        let rests =
            |(device, setpoint): &(DeviceId, Setpoint)| self.comes_to_rest(device, setpoint.control_type);
        self.owes_rest |= values.iter().any(rests);
        if self.driver.takes_frames() {
            let told = self.call(Sign::Unknown, |driver| driver.set_frame(values));
            return told.map_err(|error| Lost::untaken(error, values));
        }
        values.iter().try_for_each(|value| {
            let told = self.call(Sign::Unknown, |driver| driver.set(&value.0, &value.1));
            told.map_err(|error| Lost::untaken(error, std::slice::from_ref(value)))
        })
    }

    fn follow(&mut self, key: Key, movement: Movement) -> Result<(), Lost> {
        self.touched = Touched::Now;
        self.owes_rest |= self.comes_to_rest(&key.0, key.1);
        if self.driver.takes_ramps() && movement.signal.is_linear() {
            self.moving.remove(&key);
            let to = on_grid(&self.block, &key, movement.signal.target());
            let ramp = Ramp { control_type: key.1, to, duration: movement.left() };
            let told = self.call(Sign::Unknown, |driver| driver.ramp(&key.0, ramp));
            told.map_err(|error| Lost::untaken(error, &[(key.0.clone(), Setpoint::new(key.1, to))]))?;
            self.handed_over.insert(key, movement);
            return Ok(());
        }
        self.handed_over.remove(&key);
        let period = self.rates.sample_period(&self.options, &key.0);
        if !self.moving.values().any(|moving| moving.period == period) {
            self.beats.insert(period, Instant::now());
        }
        self.moving.insert(key, Moving { movement, sent: None, period });
        Ok(())
    }

    /// Sends the current value of each movement if it differs from the last value sent. A movement that has reached its target ends.
    fn sample(&mut self, now: Instant) -> Result<(), Lost> {
        let mut values = Vec::new();
        let unsent = self.moving.values().filter(|moving| moving.sent.is_none()).map(|moving| moving.period);
        let unsent: Vec<_> = unsent.collect();
        let is_due = |(period, at): (&Duration, &Instant)| *at <= now || unsent.contains(period);
        let due: Vec<_> = self.beats.iter().filter(|beat| is_due(*beat)).map(|(period, _)| *period).collect();
        let (block, given) = (&self.block, &self.given);
        self.moving.retain(|key, moving| {
            if given.is_followed_by(&key.0, now) {
                return false;
            }
            if !due.contains(&moving.period) {
                return true;
            }
            let now = moving.movement.now();
            let value = on_grid(block, key, moving.movement.signal.value(now));
            if moving.sent.replace(value) != Some(value) {
                values.push((key.0.clone(), Setpoint::new(key.1, value)));
            }
            now < moving.movement.signal.rests_at()
        });
        self.set(&values)?;
        // Samples follow a fixed beat. Beats that a slow device missed are skipped.
        let now = Instant::now();
        for period in due {
            if let Some(at) = self.beats.get_mut(&period).filter(|at| **at <= now) {
                *at = (*at + period).max(now);
            }
        }
        Ok(())
    }

    /// Ends the remaining movements. Rates (such as speeds) are set to their target, which is rest. A position that is still moving stays
    /// at its last sample, because the rest of its path would be one jump.
    fn end_movements(&mut self) -> Result<Result<(), String>, Lost> {
        let sampled =
            std::mem::take(&mut self.moving).into_iter().map(|(key, moving)| (key, moving.movement));
        let ended: Vec<_> = sampled.chain(std::mem::take(&mut self.handed_over)).collect();
        let mut cut_short = Ok(());
        for (key, movement) in ended {
            if is_rate(key.1) {
                let value = on_grid(&self.block, &key, movement.signal.target());
                self.set(&[(key.0, Setpoint::new(key.1, value))])?;
            } else if !movement.left().is_zero() {
                let seconds = REST_WAIT_MAX.as_secs();
                cut_short = Err(format!(
                    "`{}` had not reached its target after {seconds} s and stays where it is",
                    key.0
                ));
            }
        }
        // Once a later call is answered, earlier unconfirmed calls have been taken.
        if self.touched == Touched::Now {
            self.driver.ping()?;
        }
        Ok(cut_short)
    }

    fn read(&mut self, id: ReadingId, sensor: &urrcp::DeviceId) -> Result<(), Lost> {
        if let Some(reading) = self.mailbox.pushed(sensor, self.reading_counts_for(sensor)) {
            (self.tell)(News::Reading { id, reading: Ok(reading) });
            return Ok(());
        }
        let kept = self.rates.reading_period(&self.options, sensor);
        let fresh = |(_, at): &&(f64, Instant)| kept.is_some_and(|kept| at.elapsed() < kept);
        if let Some((reading, _)) = self.readings.get(sensor).filter(fresh) {
            (self.tell)(News::Reading { id, reading: Ok(*reading) });
            return Ok(());
        }
        let begin = Instant::now();
        self.mailbox.begin_reading();
        let reading = self.driver.read(sensor);
        self.mailbox.end_reading();
        let reading = match reading {
            Err(DriverError::Away(reason)) => {
                (self.tell)(News::Reading { id, reading: Err(reason.clone()) });
                return Err(Lost::Away(reason));
            }
            Err(DriverError::Refused(reason)) => Err(reason),
            Ok(reading) => {
                if kept.is_some() {
                    self.readings.insert(sensor.clone(), (reading, begin));
                }
                Ok(reading)
            }
        };
        self.mailbox.called(Duration::ZERO, Sign::Answered);
        (self.tell)(News::Reading { id, reading });
        Ok(())
    }

    /// Returns how long requests are answered with an unsolicited reading of this sensor.
    pub(super) fn reading_counts_for(&self, sensor: &DeviceId) -> Duration {
        let sensor = self.block.device(sensor.as_str());
        let parameters = sensor.and_then(|device| device.available_control_types.sensor());
        let max_delay = parameters.and_then(|sensor| sensor.max_delay);
        max_delay
            .map_or(PUSHED_COUNTS, |ms| Duration::try_from_secs_f64(ms / 1_000.0).unwrap_or(PUSHED_COUNTS))
    }

    fn ping(&mut self) -> Result<(), Lost> {
        let begin = Instant::now();
        self.driver.ping()?;
        let ago = self.driver.last_sign();
        self.mailbox.called(begin.elapsed(), ago.map_or(Sign::Answered, Sign::Seen));
        let most = self.rates.silence_max.unwrap_or(HARDWARE_SILENCE_MAX);
        match ago.filter(|ago| *ago > most) {
            Some(ago) => {
                let reason = format!("the hardware has shown no sign of life for {}", Span::from(ago));
                Err(Lost::Away(reason))
            }
            None => Ok(()),
        }
    }
}

impl Drop for Worker {
    /// If the driver panics, reports that the hardware is permanently disconnected.
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.mailbox.disconnected();
            (self.tell)(News::Away {
                reason: "the hardware is not available: its driver panicked".to_owned(),
            });
            self.mailbox.tried();
        }
    }
}

impl Movement {
    fn now(&self) -> urrcp::Timestamp<urrcp::Robot> {
        self.clock.now().assume_clock()
    }

    /// Returns the remaining time of the movement.
    fn left(&self) -> Duration {
        (self.signal.rests_at() - self.now()).to_duration()
    }
}
