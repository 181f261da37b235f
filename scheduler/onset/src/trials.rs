//! From the readings of several trials to the latency of each, or why it cannot be told.

use urrcp::Span;

use super::begin;
use super::commanded::Commanded;
use super::fit::{self, Fitted};
use super::model::{Lag, Readings, visible_delay};
use super::{Latencies, Unclear};

/// Readings that are needed before the movement, and from its command on.
const READINGS_LEAST: usize = 4;
/// So many times the noise a movement has to be.
const NOISE_RATIO: f64 = 5.0;
/// A device that moves less than this share of what it was told to does not follow.
const MOVED_LEAST: f64 = 0.2;
/// Of readings that are at one end of the range, so many make the sensor saturated.
const SATURATED_SHARE: f64 = 0.2;
/// After so many time constants a movement is over but for 2 %.
const SETTLED: f64 = 4.0;
/// A ramp has to last so many time constants for the lag behind it to become steady.
const RAMP_STEADY: f64 = 3.0;
/// The largest share of a movement that can be its visible begin.
const VISIBLE_MAX: f64 = 0.5;
/// Motion may seem this much earlier than the command, by errors of clocks.
const EARLY_MAX: f64 = 5.0;

/// A reading around a movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// When the value was taken, since the first step of the movement was due.
    pub at: Span,
    /// How far off that may be.
    pub uncertainty: Span,
    /// The value, in the sensor's unit.
    pub value: f64,
}

/// One movement and what the sensor showed.
#[derive(Clone, Debug)]
pub struct Trial {
    /// What was commanded.
    pub commanded: Commanded,
    /// By how much the device is to move, in the sensor's unit, with its sign.
    pub movement: f64,
    /// In any order.
    pub samples: Vec<Sample>,
}

/// What is known of the sensor before any trial.
#[derive(Clone, Copy, Debug)]
pub struct Readable {
    /// Lowest and highest reading of the sensor; `None` without limits.
    pub range: Option<(f64, f64)>,
    /// A device that has moved by so much has visibly begun to move.
    pub visible: f64,
}

/// The begin of one motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Onset {
    /// From the instant at which the first step was due to the first visible motion, less what a device without latency and lag would
    /// take to move so far.
    pub latency: Span,
    /// From the instant at which the first step was due until the device begins to follow.
    pub dead_time: Span,
    /// Its standard error from the noise of the readings.
    pub standard_error: Span,
    /// How far all readings together may be off: the largest uncertainty of a sample. It does not average out.
    pub uncertainty: Span,
    /// By how much the readings changed in all, in the sensor's unit.
    pub moved: f64,
    /// Standard deviation of the readings around the fit, in the sensor's unit.
    pub noise: f64,
}

/// What the trials say of a device.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Of each trial, in order.
    pub onsets: Vec<Result<Onset, Unclear>>,
    /// Of those that could be judged; `None` of fewer than three.
    pub latencies: Option<Latencies>,
    /// How the device follows; `None` where the readings do not tell it from a device that follows at once.
    pub lag: Option<downbeat_fleet::fleet::Lag>,
    /// How far the device is behind a ramp once it follows: dead time and time constant together, which is exact for the model. `None`
    /// where no movement lasted long enough.
    pub tracking_lag: Option<Span>,
}

/// The begin of a single motion, with a lag that is known, or else fitted to this motion alone.
///
/// # Errors
/// [`Unclear`]: why it cannot be told.
pub fn onset(
    trial: &Trial,
    readable: Readable,
    lag: Option<downbeat_fleet::fleet::Lag>,
) -> Result<Onset, Unclear> {
    let readings = readable.readings(trial)?;
    let known = lag.map(Lag::from);
    let lag = known.unwrap_or_else(|| fit::lag(&[&readings]).0);
    let fitted = fit::fitted(&readings, lag);
    let later = known.map_or_else(|| readable.later(&[(trial, &readings, fitted)], lag), |lag| lag.later);
    readable.judged(trial, &readings, fitted, Lag { later, ..lag })
}

/// The latency of each of several motions of one device, and what they have in common.
#[must_use]
pub fn estimate(trials: &[Trial], readable: Readable) -> Estimate {
    let readings: Vec<Result<Readings, Unclear>> =
        trials.iter().map(|trial| readable.readings(trial)).collect();
    let usable: Vec<&Readings> = readings.iter().filter_map(|readings| readings.as_ref().ok()).collect();
    let (lag, error) = if usable.is_empty() { (Lag::NONE, f64::INFINITY) } else { fit::lag(&usable) };
    let constant = lag.constant;
    let fitted: Vec<_> = (readings.into_iter())
        .map(|readings| readings.map(|readings| (fit::fitted(&readings, lag), readings)))
        .collect();
    let clear: Vec<_> = (trials.iter().zip(&fitted))
        .filter_map(|(trial, fitted)| {
            fitted.as_ref().ok().map(|(fitted, readings)| (trial, readings, *fitted))
        })
        .filter(|(trial, readings, fitted)| readable.judged(trial, readings, *fitted, lag).is_ok())
        .collect();
    let lag = Lag { later: readable.later(&clear, lag), ..lag };
    let onsets: Vec<_> = (trials.iter().zip(fitted))
        .map(|(trial, fitted)| {
            fitted.and_then(|(fitted, readings)| readable.judged(trial, &readings, fitted, lag))
        })
        .collect();
    let known: Vec<f64> = onsets.iter().flatten().map(|onset| onset.latency.as_millis_f64()).collect();
    let latencies = Latencies::of(&known);
    let lasted = trials.iter().map(|trial| trial.commanded.lasts_ms()).fold(0.0, f64::max);
    let steady = lasted > 0.0 && lasted >= RAMP_STEADY * constant;
    let time_constant = Span::from_millis_f64(constant);
    let told = (constant > 2.0 * error || lag.later != 0.0).then(|| lag.into());
    let mut dead: Vec<Span> = onsets.iter().flatten().map(|onset| onset.dead_time).collect();
    dead.sort_unstable();
    let tracking_lag = dead.get(dead.len() / 2).filter(|_| steady).map(|dead| *dead + time_constant);
    Estimate { onsets, latencies, lag: told, tracking_lag: latencies.and(tracking_lag) }
}

impl Readable {
    fn readings(&self, trial: &Trial) -> Result<Readings, Unclear> {
        let mut samples: Vec<&Sample> =
            trial.samples.iter().filter(|sample| sample.value.is_finite()).collect();
        samples.sort_by_key(|sample| sample.at);
        let before = samples.iter().filter(|sample| sample.at < Span::ZERO).count();
        let after = samples.len() - before;
        if before < READINGS_LEAST || after < READINGS_LEAST {
            return Err(Unclear::TooSparse { before, after, least: READINGS_LEAST });
        }
        let values: Vec<f64> = samples.iter().map(|sample| sample.value).collect();
        self.saturated(&values)?;
        let at = samples.iter().map(|sample| sample.at.as_millis_f64()).collect();
        Ok(Readings { commanded: trial.commanded.clone(), at, values })
    }

    #[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
    fn saturated(&self, values: &[f64]) -> Result<(), Unclear> {
        let Some((least, largest)) = self.range else { return Ok(()) };
        let share = |count: usize| count as f64 / values.len() as f64;
        let at_end = |limit: f64, share: f64| {
            if share >= SATURATED_SHARE {
                Err(Unclear::Saturated { share: share * 100.0, limit })
            } else {
                Ok(())
            }
        };
        at_end(least, share(values.iter().filter(|value| **value <= least).count()))?;
        at_end(largest, share(values.iter().filter(|value| **value >= largest).count()))
    }

    /// See [`begin::later`].
    fn later(&self, trials: &[(&Trial, &Readings, Fitted)], lag: Lag) -> f64 {
        let Some((trial, ..)) = trials.first() else { return 0.0 };
        let pooled: Vec<_> = trials.iter().map(|(_, readings, fitted)| (*readings, *fitted)).collect();
        begin::later(&pooled, lag, self.visible_share(trial))
    }

    fn visible_share(&self, trial: &Trial) -> f64 {
        (self.visible / trial.movement.abs()).min(VISIBLE_MAX)
    }

    fn judged(&self, trial: &Trial, readings: &Readings, fitted: Fitted, lag: Lag) -> Result<Onset, Unclear> {
        let Fitted { latency, standard_error, agreement, noise } = fitted;
        let (movement, seen) = (trial.movement.abs(), agreement.gain.abs());
        if noise * NOISE_RATIO > movement.max(seen.min(movement * 2.0)) {
            return Err(Unclear::Noisy { noise, movement, ratio: NOISE_RATIO });
        }
        if seen < (movement * MOVED_LEAST).max(noise * 2.0) {
            return Err(Unclear::NothingMoved { seen, movement });
        }
        if agreement.gain * trial.movement < 0.0 {
            return Err(Unclear::WrongWay { seen: agreement.gain, movement: trial.movement });
        }
        if lag.constant > fit::TIME_CONSTANT_MAX * 0.98 {
            return Err(Unclear::TooSlow { least: Span::from_millis_f64(fit::TIME_CONSTANT_MAX) });
        }
        if latency < -EARLY_MAX - 4.0 * standard_error {
            let early = Span::from_millis_f64(-latency);
            let uncertainty = uncertainty_at(trial, Span::from_millis_f64(latency));
            return Err(if early > uncertainty + Span::from_millis_f64(EARLY_MAX) {
                Unclear::MovedBefore { early }
            } else {
                Unclear::LateReading { uncertainty }
            });
        }
        let (_, last) = readings.span();
        if last - latency < readings.commanded.shown_ms() + SETTLED * lag.constant {
            return Err(Unclear::NotSettled { watched: Span::from_millis_f64(last) });
        }
        let uncertainty = trial.samples.iter().map(|sample| sample.uncertainty).max().unwrap_or_default();
        let visible = self.visible_share(trial);
        Ok(Onset {
            latency: Span::from_millis_f64(latency + visible_delay(&readings.commanded, lag, visible)),
            dead_time: Span::from_millis_f64(latency),
            standard_error: Span::from_millis_f64(standard_error),
            uncertainty,
            moved: agreement.gain,
            noise,
        })
    }
}

/// The larger uncertainty of the last reading before an instant and the first one after it.
fn uncertainty_at(trial: &Trial, instant: Span) -> Span {
    let (before, after): (Vec<&Sample>, Vec<&Sample>) =
        trial.samples.iter().partition(|sample| sample.at <= instant);
    let last = before.into_iter().max_by_key(|sample| sample.at);
    let first = after.into_iter().min_by_key(|sample| sample.at);
    last.into_iter().chain(first).map(|sample| sample.uncertainty).max().unwrap_or_default()
}
