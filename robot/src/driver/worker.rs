//! The thread round a driver: connects it, hands it what is to be set, samples movements, and says when it fails.
#![expect(clippy::disallowed_methods, reason = "samples and pings on the monotonic clock")]

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use urrcp::{ControlType, DeviceId, InitializationBlock, Setpoint, Span};

use super::grid::on_grid;
use super::lifeline::Watcher;
use super::mailbox::{Drive, Manners, Movement, Sign, Value, Work};
use super::planned::{Given, PlanNews};
use super::rates::HARDWARE_SILENCE_MAX;
use super::{Driver, DriverError, DriverOptions, Key, Mailbox, PlanWord, Pushes, Ramp, Rates};
use crate::confirmation::Ticket;
use crate::hardware::ReadingId;
use crate::plans::Lookahead;
use crate::signal::{is_rate, rest_of};
use crate::tolerance::Tolerance;

/// Between two tries to connect, at first and at most; it doubles.
const PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));
/// A reading that was told unasked answers requests for so long, if the sensor has no `max_delay`.
const PUSHED_COUNTS: Duration = Duration::from_secs(1);
/// How often it is looked at the mailbox while nothing is due.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// Of a frame that was refused, so many values are named.
const UNTAKEN_SHOWN: usize = 8;
/// How long the devices may take to come to rest when the edge ends. Then speeds go to zero at once, and positions stay.
const REST_WAIT_MAX: Duration = Duration::from_secs(3);

/// What a driver's thread tells the machine.
#[derive(Debug)]
pub(crate) enum News {
    /// The hardware is there, by its so-many-th connection.
    There {
        connection: u64,
        /// As the driver declares it.
        latency: BTreeMap<DeviceId, Duration>,
        /// Whose scripts the driver times by itself.
        lookahead: BTreeMap<DeviceId, Lookahead>,
    },
    /// It is not, or no longer, as this sentence says.
    Away { reason: String },
    /// A value came so late that it was not set.
    Stale { device: urrcp::DeviceId, late: Duration },
    /// Something about a script that the driver times by itself.
    Plan(PlanNews),
    /// The hardware has taken what these ask about.
    Confirmed(Vec<Ticket>),
    /// A sensor was read.
    Reading { id: ReadingId, reading: Result<f64, String> },
}

/// Why nothing more is asked of the hardware until it is connected again.
#[derive(Debug, thiserror::Error)]
pub(super) enum Lost {
    #[error("the hardware is away: {0}")]
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
    /// Devices did not take what they were told.
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

/// A driver with what it needs to know of its robot.
pub(crate) struct Worker {
    driver: Box<dyn Driver>,
    block: InitializationBlock,
    mailbox: Arc<Mailbox>,
    tell: Box<dyn Fn(News) + Send>,
    options: DriverOptions,
    /// As the driver declares them.
    rates: Rates,
    moving: BTreeMap<Key, Moving>,
    /// Ramps that the hardware goes by itself.
    handed_over: BTreeMap<Key, Movement>,
    touched: Touched,
    /// Whether the hardware received a value, such as a speed, that must come to rest after a reconnection. Positions stay.
    owes_rest: bool,
    /// When what is sampled with each period is sampled next.
    beats: BTreeMap<Duration, Instant>,
    pub(super) given: Given,
    /// What sensors read last, where they are not to be read more often.
    readings: BTreeMap<DeviceId, (f64, Instant)>,
}

/// What a driver was told to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Touched {
    Never,
    /// Not since it was connected again.
    Before,
    Now,
}

struct Moving {
    movement: Movement,
    sent: Option<f64>,
    /// Between two samples.
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

    /// Runs until the mailbox is closed and empty, or closed while there is no hardware.
    ///
    /// # Errors
    /// Why devices that were moved may not be at rest.
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
                    let manners = Manners {
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
                    // Goes before the driver connects again: hardware may take one connection at a time.
                    let watcher = self.watch(connection);
                    let served = self.serve();
                    drop(watcher);
                    let error = match served {
                        Ok(_) if self.touched == Touched::Before => {
                            return Err("the hardware came back too late to be told anything".to_owned());
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
            // First nothing more is taken, then it is told: no order of before reaches the next connection.
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

    /// Does what comes until the hardware fails or nothing more will come; then, what had to be cut short.
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

    /// When to look again, while something is on its way to rest.
    fn next_until_rest(&self) -> Option<Instant> {
        let sample = self.next_sample();
        let left = self.handed_over.values().map(Movement::left).max().filter(|left| !left.is_zero());
        let look = left.map(|left| Instant::now() + left.min(LOOK_EVERY));
        sample.into_iter().chain(look).min()
    }

    /// When anything is sampled next.
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

    /// Whether a stop sets this signal to a value at rest, as it does with a speed. A position stays.
    fn comes_to_rest(&self, device: &DeviceId, control_type: ControlType) -> bool {
        let spec = self.block.device(device.as_str());
        spec.is_some_and(|spec| rest_of(spec, control_type, None).is_some())
    }

    /// The driver is told to move something.
    pub(super) const fn touch(&mut self) {
        self.touched = Touched::Now;
    }

    /// What the driver has said of scripts and was not passed on.
    pub(super) fn words(&self) -> Vec<PlanWord> {
        self.mailbox.words()
    }

    /// Has the end of the connection noticed, where the driver can name what ends with it.
    fn watch(&self, connection: u64) -> Option<Watcher> {
        let watcher = Watcher::begin(self.driver.lifeline()?, Arc::clone(&self.mailbox), connection);
        watcher.inspect_err(|error| tracing::warn!("the hardware's connection is not watched: {error}")).ok()
    }

    /// Calls the driver and notes how long it took.
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

    /// What has become stale is told and not set, and neither is what follows from it: the machine ends both.
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
        // The hardware is told at once: what is confirmed behind it must not be an intention of this process alone.
        if self.moving.values().any(|moving| moving.sent.is_none()) {
            self.sample(Instant::now())?;
        }
        Ok(())
    }

    /// By one call, if the driver takes several values at a time.
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

    /// Sends where each movement is now, as far as that differs from what was sent, and ends it on its target.
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
        // On a fixed beat; beats that a slow device missed are left out.
        let now = Instant::now();
        for period in due {
            if let Some(at) = self.beats.get_mut(&period).filter(|at| **at <= now) {
                *at = (*at + period).max(now);
            }
        }
        Ok(())
    }

    /// What went to rest by itself is told so, and what has taken too long is ended where it is: rates go to zero, a
    /// position has been set by its last sample and stays, since the rest of its way would be one jump.
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
                cut_short =
                    Err(format!("`{}` was still on its way after {seconds} s, and stays there", key.0));
            }
        }
        // Calls that are not confirmed have been taken once a later one is answered.
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
        self.mailbox.reading(true);
        let reading = self.driver.read(sensor);
        self.mailbox.reading(false);
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

    /// For how long a reading that was told unasked answers requests.
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
    /// A driver that panics is hardware that is away, for good.
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.mailbox.disconnected();
            (self.tell)(News::Away { reason: "the hardware is away: its driver panicked".to_owned() });
            self.mailbox.tried();
        }
    }
}

impl Movement {
    fn now(&self) -> urrcp::Timestamp<urrcp::Robot> {
        self.clock.now().assume_clock()
    }

    /// How long it still takes.
    fn left(&self) -> Duration {
        (self.signal.rests_at() - self.now()).to_duration()
    }
}
