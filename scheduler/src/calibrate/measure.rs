//! Measures one device: reads the sensor at rest, moves the device to and fro until the latency is known, and moves it back.

use downbeat_onset::{Commanded, Estimate, Latencies, Readable, Sample, Trial, Unclear, estimate};
use downbeat_scripts::Lag;
use urrcp::{ControlType, Interpolation, Millis, Script, Setpoint, Span, Step};

use super::NotMeasured;
use super::plan::PlannedDevice;
use super::talk::{DialogueError, RobotDialogue};

/// Number of readings at rest before the first movement.
const AT_REST: usize = 24;
/// Minimum size of a movement, as a multiple of the sensor's noise at rest.
const NOISE_RATIO: f64 = 5.0;
/// Minimum duration of a movement, as a number of half intervals between readings. At least one reading then falls within the movement. A
/// larger value would make the movement slower, and its start less distinct.
const HALF_READINGS_ON_MOVEMENT: i64 = 3;
/// Minimum number of readings between a movement's command and its start.
const READINGS_BEFORE: i64 = 10;
/// Minimum pause between two readings.
const BETWEEN_READINGS: std::time::Duration = std::time::Duration::from_millis(1);
/// How long the sensor is read after the end of the first movement.
const WATCHED_FIRST: Span = Span::from_millis(1_000);
/// Maximum time for which the sensor is read after the end of later movements.
const WATCHED_MAX: Span = Span::from_millis(3_000);
/// Maximum number of steps of a movement, for a device that holds each value until the next step.
const STAIRS_MAX: u32 = 20;
/// If the error of the median is at most this, no trials beyond the requested number are made.
const MEDIAN_ERROR_MAX: Span = Span::from_millis(1);
/// Maximum number of trials, as a multiple of the requested number. Additional trials reduce the error of the median, and replace trials
/// that cannot be evaluated.
const TRIALS_FACTOR: usize = 3;
/// Number of movements after which the measurement fails if it has no result, because some of these movements cannot be evaluated.
const UNCLEAR_MAX: usize = 3;

/// The result of measuring one device.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Summary of the latencies in all trials.
    pub latencies: Latencies,
    /// The lag with which the device follows. `None` if it is indistinguishable from no lag.
    pub lag: Option<Lag>,
    /// Time by which the device lags behind a ramp. `None` if it is unknown.
    pub tracking_lag: Option<Span>,
    /// Maximum systematic error of all latencies. The error arises because it is unknown when, within a round trip, the sensor takes its
    /// value.
    pub systematic: Span,
    /// The interval between two readings, computed from the median round trip.
    pub interval: Span,
    /// The median time that the sensor itself takes to respond, without the round trip to the robot.
    pub sensor_delay: Span,
    /// The number of movements that could not be evaluated.
    pub unclear: usize,
}

/// The progress of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// The number of movements made so far.
    pub trials: usize,
    /// The number of requested movements.
    pub of: usize,
}

/// The properties of the sensor's readings while nothing moves.
struct AtRest {
    position: f64,
    interval: Span,
    own_delay: Span,
    link: Span,
}

/// Measures one device and moves it back to its original position.
///
/// # Errors
/// Returns [`NotMeasured`]. In that case, the device may not be at its original position; call [`hold`](RobotDialogue::hold) for it.
pub async fn measure(
    talk: &mut RobotDialogue,
    planned: &PlannedDevice,
    trials: usize,
    mut tell: impl FnMut(Progress),
) -> Result<Measured, NotMeasured> {
    let rest = at_rest(talk, planned).await?;
    let from = planned.on_grid(planned.how.from.unwrap_or(rest.position));
    let to = planned.on_grid(from + planned.how.by);
    let (least, largest) = (planned.limits.min_value, planned.limits.max_value);
    let wanted = from + planned.how.by;
    if !(wanted >= least && wanted <= largest) || to == from {
        return Err(NotMeasured::BeyondLimits { from, to: wanted, least, largest });
    }
    if (rest.position - from).abs() > planned.how.by.abs() {
        return Err(NotMeasured::Elsewhere { at: rest.position, from });
    }
    let lasts = planned.lasts.max(rest.interval * HALF_READINGS_ON_MOVEMENT / 2);
    let mut mover = Mover { talk, planned, rest: &rest, lasts, watched: WATCHED_FIRST, at_from: true };
    let was = planned.on_grid(rest.position);
    mover.settle(was, from).await?;
    let result = mover.trials(from, to, trials, &mut tell).await;
    // The device is moved back whatever the result. If that fails too, the first error is returned, because it is more informative.
    let here = if mover.at_from { from } else { to };
    let back = mover.settle(here, was).await;
    let estimate = result?;
    back?;
    measured(&estimate, &rest)
}

async fn at_rest(talk: &mut RobotDialogue, planned: &PlannedDevice) -> Result<AtRest, NotMeasured> {
    let mut readings = Vec::new();
    let began = talk.now();
    for _ in 0..AT_REST {
        readings.push(talk.read_again(&planned.how.sensor).await?.since(began));
        talk.ping().await?;
    }
    let link = talk.clock_reading().map_or(Span::ZERO, |reading| reading.delay_min);
    let values: Vec<f64> = readings.iter().map(|reading| reading.value).collect();
    let count = f64::from(u32::try_from(values.len()).unwrap_or(u32::MAX));
    let mean = values.iter().sum::<f64>() / count;
    let noise = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt();
    let by = planned.how.by;
    if noise * NOISE_RATIO > by.abs() {
        return Err(NotMeasured::Noise { sensor: planned.how.sensor.to_string(), noise, by });
    }
    let median = |mut spans: Vec<Span>| {
        spans.sort_unstable();
        spans[spans.len() / 2]
    };
    let round_trip = median(readings.iter().map(|reading| reading.answered - reading.asked).collect());
    let own_delay = median(readings.iter().map(|reading| reading.own_delay(link)).collect());
    let interval = round_trip + Span::from_millis(1);
    Ok(AtRest { position: mean, interval, own_delay, link })
}

struct Mover<'a> {
    talk: &'a mut RobotDialogue,
    planned: &'a PlannedDevice,
    rest: &'a AtRest,
    lasts: Span,
    watched: Span,
    /// Whether the device is at the start position of the trials, not at the other end.
    at_from: bool,
}

impl Mover<'_> {
    /// Moves the device to and fro until its latency is known, or until the maximum number of trials is reached.
    async fn trials(
        &mut self,
        from: f64,
        to: f64,
        wanted: usize,
        tell: &mut impl FnMut(Progress),
    ) -> Result<Estimate, NotMeasured> {
        let (least, largest) = self.planned.sensor_range;
        let visible = self.planned.how.visible;
        let readable = Readable { range: Some((least, largest)), visible };
        let mut trials: Vec<Trial> = Vec::new();
        loop {
            let (here, there) = if self.at_from { (from, to) } else { (to, from) };
            let trial = self.movement(here, there).await?;
            self.at_from = !self.at_from;
            trials.push(trial);
            tell(Progress { trials: trials.len(), of: wanted });
            if trials.len() == 2 || trials.len() == UNCLEAR_MAX {
                let first;
                (trials, first) = estimated(trials, readable).await;
                unclear(&first, UNCLEAR_MAX)?;
                self.watched = self.enough(&first);
            }
            // Trials end only after an even number of movements, when the device is at the start position.
            if trials.len() < wanted || !self.at_from {
                continue;
            }
            let found;
            (trials, found) = estimated(trials, readable).await;
            let known = found.latencies.is_some_and(|known| known.median_error <= MEDIAN_ERROR_MAX);
            let clear = found.onsets.iter().flatten().count();
            if known && clear >= wanted || trials.len() >= wanted * TRIALS_FACTOR {
                return Ok(found);
            }
        }
    }
}

impl Mover<'_> {
    /// Returns how long the sensor is read after later movements: until the device has settled, with a reserve for slower movements.
    fn enough(&self, found: &Estimate) -> Span {
        let slowest = found.onsets.iter().flatten().map(|onset| onset.latency).max();
        let Some(slowest) = slowest else { return self.watched };
        let settled = found.lag.map_or(Span::ZERO, |lag| lag.time_constant) * 8;
        let spare = self.rest.interval * READINGS_BEFORE + Span::from_millis(100);
        (slowest + settled + spare).max(Span::from_millis(200)).min(WATCHED_MAX)
    }

    /// Moves the device without measuring.
    async fn settle(&mut self, here: f64, there: f64) -> Result<(), NotMeasured> {
        if here != there {
            self.movement(here, there).await?;
        }
        Ok(())
    }

    /// Moves the device once and reads the sensor meanwhile.
    async fn movement(&mut self, here: f64, there: f64) -> Result<Trial, NotMeasured> {
        let (script, commanded) = self.script(here, there)?;
        // Readings before the start show the rest position.
        let lead = self.rest.interval * READINGS_BEFORE;
        let device = &self.planned.device;
        let (start, request) = self.talk.command(device, script, lead).await?;
        let until = start + self.lasts + self.watched;
        let mut samples = Vec::new();
        while self.talk.now() < until {
            let reading = self.talk.read_again(&self.planned.how.sensor).await?.since(start);
            let (at, uncertainty) = reading.instant(self.rest.link, self.planned.how.taken);
            samples.push(Sample {
                at: at - self.planned.how.sensor_delay,
                uncertainty,
                value: reading.value,
            });
            tokio::time::sleep(BETWEEN_READINGS).await;
        }
        // The clocks drift during a movement, so the robot's clock is measured again.
        self.talk.ping().await?;
        self.talk.check(device, request.as_ref())?;
        Ok(Trial { commanded, movement: there - here, samples })
    }

    /// Returns the movement as a script for the robot, and as input of the estimator.
    fn script(&self, here: f64, there: f64) -> Result<(Script, Commanded), NotMeasured> {
        let step = |at: Span, value: f64| {
            Step::new(Millis::from_span(at), Setpoint::new(ControlType::Position, value))
        };
        let (steps, commanded) = match self.planned.interpolation {
            // The ramp begins at the device's position, so that it never jumps.
            Interpolation::Linear => (vec![step(self.lasts, there)], Commanded::ramp(self.lasts)),
            _ => self.stairs(here, there, step),
        };
        let script = Script::new(steps).map_err(|error| DialogueError::Refused(error.to_string()))?;
        Ok((script, commanded))
    }

    /// Returns the movement as many small steps, for a device that holds each value until the next step.
    fn stairs(&self, here: f64, there: f64, step: impl Fn(Span, f64) -> Step) -> (Vec<Step>, Commanded) {
        let count = STAIRS_MAX.min(self.planned.steps_max).max(1);
        let share = |index: u32| f64::from(index) / f64::from(count);
        let (mut steps, mut shares, mut last) = (Vec::new(), Vec::new(), here);
        for index in 1..=count {
            let value = self.planned.on_grid(here + (there - here) * share(index));
            if value != last {
                let at = Span::from_millis_f64(self.lasts.as_millis_f64() * share(index - 1));
                steps.push(step(at, value));
                shares.push((at, (value - last) / (there - here)));
                last = value;
            }
        }
        (steps, Commanded::stairs(shares))
    }
}

/// Runs the estimator on another thread. On this thread, it would block the messages to the robot for too long.
async fn estimated(trials: Vec<Trial>, readable: Readable) -> (Vec<Trial>, Estimate) {
    let fit = move || {
        let estimate = estimate(&trials, readable);
        (trials, estimate)
    };
    match tokio::task::spawn_blocking(fit).await {
        Ok(done) => done,
        Err(error) => std::panic::resume_unwind(error.into_panic()),
    }
}

/// Returns the number of movements that cannot be evaluated. Returns an error with the first reason if this number is at least
/// `at_least`, or if at least `at_least` movements were made without a result.
fn unclear(estimate: &Estimate, at_least: usize) -> Result<usize, NotMeasured> {
    let reasons: Vec<Unclear> = estimate.onsets.iter().filter_map(|onset| onset.err()).collect();
    let (count, trials) = (reasons.len(), estimate.onsets.len());
    match reasons.first() {
        Some(why) if count >= at_least || estimate.latencies.is_none() && trials >= at_least => {
            Err(NotMeasured::Unclear { of: count, trials, why: *why })
        }
        _ => Ok(count),
    }
}

fn measured(estimate: &Estimate, rest: &AtRest) -> Result<Measured, NotMeasured> {
    // At most a quarter of the movements may be unusable, for example because of slow readings.
    let unclear = unclear(estimate, estimate.onsets.len() / 4 + 1)?;
    let too_few = Unclear::TooSparse { before: 0, after: 0, least: 1 };
    let Some(latencies) = estimate.latencies else {
        return Err(NotMeasured::Unclear { of: unclear, trials: estimate.onsets.len(), why: too_few });
    };
    let mut uncertainties: Vec<Span> =
        estimate.onsets.iter().flatten().map(|onset| onset.uncertainty).collect();
    uncertainties.sort_unstable();
    Ok(Measured {
        latencies,
        lag: estimate.lag,
        tracking_lag: estimate.tracking_lag,
        systematic: uncertainties.get(uncertainties.len() / 2).copied().unwrap_or_default(),
        interval: rest.interval,
        sensor_delay: rest.own_delay,
        unclear,
    })
}
