//! The thread round a driver: connects it, hands it what is to be set, samples movements, and says when it fails.
#![expect(clippy::disallowed_methods, reason = "samples and pings on the monotonic clock")]

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use urrcp::{InitializationBlock, Setpoint};

use super::grid::on_grid;
use super::lifeline::Watcher;
use super::mailbox::{Movement, Sign, Value, Work};
use super::{Driver, DriverError, Key, Mailbox, Ramp};
use crate::hardware::ReadingId;
use crate::signal::is_rate;

/// Between two tries to connect, at first and at most; it doubles.
const PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));
/// How often it is looked at the mailbox while nothing is due.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// How long the devices may take to come to rest when the edge ends. Then speeds go to zero at once, and positions stay.
const REST_WAIT_MAX: Duration = Duration::from_secs(3);

/// What a driver's thread tells the machine.
#[derive(Debug)]
pub(crate) enum News {
    /// The hardware is there, by its so-many-th connection.
    There { connection: u64 },
    /// It is not, or no longer, as this sentence says.
    Away { reason: String },
    /// A value came so late that it was not set.
    Stale { device: urrcp::DeviceId, late: Duration },
    /// A sensor was read.
    Reading { id: ReadingId, reading: Result<f64, String> },
}

/// Why nothing more is asked of the hardware until it is connected again.
#[derive(Debug, thiserror::Error)]
enum Lost {
    #[error("the hardware is away: {0}")]
    Away(String),
    #[error("the hardware refused {0}")]
    Refused(String),
}

impl From<DriverError> for Lost {
    fn from(error: DriverError) -> Self {
        Self::Away(error.to_string())
    }
}

impl Lost {
    /// A device did not take what it was told.
    fn untaken(error: DriverError, (device, control_type): &Key, value: f64) -> Self {
        match error {
            DriverError::Away(reason) => Self::Away(reason),
            DriverError::Refused(reason) => {
                Self::Refused(format!("{control_type} {value} of `{device}`: {reason}"))
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
    period: Duration,
    moving: BTreeMap<Key, Moving>,
    /// Ramps that the hardware goes by itself.
    handed_over: BTreeMap<Key, Movement>,
    touched: Touched,
    next_sample: Instant,
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
}

impl Worker {
    pub(crate) fn new(
        driver: Box<dyn Driver>,
        block: InitializationBlock,
        mailbox: Arc<Mailbox>,
        samples_per_second: f64,
        tell: Box<dyn Fn(News) + Send>,
    ) -> Self {
        let now = Instant::now();
        let period = Duration::from_secs_f64(1.0 / samples_per_second.clamp(0.1, 1_000.0));
        let (moving, handed_over) = (BTreeMap::new(), BTreeMap::new());
        let (touched, next_sample) = (Touched::Never, now);
        Self { driver, block, mailbox, tell, period, moving, handed_over, touched, next_sample }
    }

    /// Runs until the mailbox is closed and empty, or closed while there is no hardware.
    ///
    /// # Errors
    /// Why devices that were moved may not be in their default state.
    pub(crate) fn run(mut self) -> Result<(), String> {
        let mut pause = PAUSE.0;
        let mut connection = 0;
        let mut away = String::new();
        while !self.mailbox.is_closed() {
            let reason = match self.driver.connect() {
                Ok(()) => {
                    connection += 1;
                    if self.touched == Touched::Now {
                        self.touched = Touched::Before;
                    }
                    self.mailbox.connected(connection);
                    (self.tell)(News::There { connection });
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
            let sample = (!self.moving.is_empty()).then_some(self.next_sample);
            match self.mailbox.next(sample.unwrap_or_else(|| Instant::now() + LOOK_EVERY)) {
                Work::Drive(key, value, movement) => self.drive(key, value, movement)?,
                Work::Read(id, sensor) => self.read(id, &sensor)?,
                Work::Ping => self.ping()?,
                Work::HungUp(reason) => return Err(Lost::Away(reason)),
                Work::Nothing => {}
                Work::Closed => {
                    let end = *closing.get_or_insert_with(|| Instant::now() + REST_WAIT_MAX);
                    let next = self.next_until_rest().filter(|_| Instant::now() < end);
                    let Some(next) = next else { return self.end_movements() };
                    std::thread::sleep(next.min(end).saturating_duration_since(Instant::now()));
                }
            }
            if !self.moving.is_empty() && Instant::now() >= self.next_sample {
                self.sample()?;
            }
        }
    }

    /// When to look again, while something is on its way to rest.
    fn next_until_rest(&self) -> Option<Instant> {
        let sample = (!self.moving.is_empty()).then_some(self.next_sample);
        let left = self.handed_over.values().map(Movement::left).max().filter(|left| !left.is_zero());
        let look = left.map(|left| Instant::now() + left.min(LOOK_EVERY));
        sample.into_iter().chain(look).min()
    }

    /// Has the end of the connection noticed, where the driver can name what ends with it.
    fn watch(&self, connection: u64) -> Option<Watcher> {
        let watcher = Watcher::begin(self.driver.lifeline()?, Arc::clone(&self.mailbox), connection);
        watcher.inspect_err(|error| tracing::warn!("the hardware's connection is not watched: {error}")).ok()
    }

    /// Calls the driver and notes how long it took.
    fn call<T>(
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
    fn drive(
        &mut self,
        key: Key,
        value: Option<Value>,
        movement: Option<Movement>,
    ) -> Result<(), Lost> {
        if let Some(late) = value.as_ref().and_then(|value| value.stale(Instant::now())) {
            (self.tell)(News::Stale { device: key.0, late });
            return Ok(());
        }
        value.map_or(Ok(()), |value| self.set(&key, &value.setpoint))?;
        movement.map_or(Ok(()), |movement| self.follow(key, movement))
    }

    fn set(&mut self, key: &Key, setpoint: &Setpoint) -> Result<(), Lost> {
        self.moving.remove(key);
        self.handed_over.remove(key);
        self.touched = Touched::Now;
        let value = on_grid(&self.block, key, setpoint.value);
        let setpoint = Setpoint { value, ..setpoint.clone() };
        self.tell_value(key, &setpoint)
    }

    fn tell_value(&mut self, key: &Key, setpoint: &Setpoint) -> Result<(), Lost> {
        let told = self.call(Sign::Unknown, |driver| driver.set(&key.0, setpoint));
        told.map_err(|error| Lost::untaken(error, key, setpoint.value))
    }

    fn follow(&mut self, key: Key, movement: Movement) -> Result<(), Lost> {
        self.touched = Touched::Now;
        if self.driver.takes_ramps() && movement.signal.is_linear() {
            self.moving.remove(&key);
            let to = on_grid(&self.block, &key, movement.signal.target());
            let ramp = Ramp { control_type: key.1, to, duration: movement.left() };
            let told = self.call(Sign::Unknown, |driver| driver.ramp(&key.0, ramp));
            told.map_err(|error| Lost::untaken(error, &key, to))?;
            self.handed_over.insert(key, movement);
            return Ok(());
        }
        self.handed_over.remove(&key);
        if self.moving.is_empty() {
            self.next_sample = Instant::now() + self.period;
        }
        self.moving.insert(key, Moving { movement, sent: None });
        Ok(())
    }

    /// Sends where each movement is now, as far as that differs from what was sent, and ends it on its target.
    fn sample(&mut self) -> Result<(), Lost> {
        let keys: Vec<Key> = self.moving.keys().cloned().collect();
        for key in keys {
            let Some(moving) = self.moving.get(&key) else { continue };
            let now = moving.movement.now();
            let value = on_grid(&self.block, &key, moving.movement.signal.value(now));
            let rests = now >= moving.movement.signal.rests_at();
            if moving.sent != Some(value) {
                let setpoint = Setpoint::new(key.1, value);
                self.tell_value(&key, &setpoint)?;
            }
            match self.moving.get_mut(&key) {
                Some(moving) if !rests => moving.sent = Some(value),
                _ => {
                    self.moving.remove(&key);
                }
            }
        }
        // On a fixed beat; beats that a slow device missed are left out.
        self.next_sample = (self.next_sample + self.period).max(Instant::now());
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
                self.tell_value(&key, &Setpoint::new(key.1, value))?;
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
        self.mailbox.reading(true);
        let reading = self.driver.read(sensor);
        self.mailbox.reading(false);
        let reading = match reading {
            Err(DriverError::Away(reason)) => {
                (self.tell)(News::Reading { id, reading: Err(reason.clone()) });
                return Err(Lost::Away(reason));
            }
            Err(DriverError::Refused(reason)) => Err(reason),
            Ok(reading) => Ok(reading),
        };
        self.mailbox.called(Duration::ZERO, Sign::Answered);
        (self.tell)(News::Reading { id, reading });
        Ok(())
    }

    fn ping(&mut self) -> Result<(), Lost> {
        Ok(self.call(Sign::Answered, |driver| driver.ping())?)
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
