//! Determines the latency of each of several trials from its readings, or the reason why the latency cannot be determined.

use urrcp::Span;

use super::begin;
use super::commanded::Commanded;
use super::fit::{self, Fitted};
use super::model::{Lag, Readings, visible_delay};
use super::{Latencies, Unclear};

/// Minimum number of readings before the command, and also after it.
const READINGS_LEAST: usize = 4;
/// Minimum ratio of the movement's size to the noise of the readings.
const NOISE_RATIO: f64 = 5.0;
/// Minimum motion that the readings have to show, as a share of the commanded movement. A device that moves less does not follow the
/// command.
const MOVED_LEAST: f64 = 0.2;
/// The sensor counts as saturated if at least this share of its readings is at one end of its range.
const SATURATED_SHARE: f64 = 0.2;
/// Number of time constants after which only 2 % of a movement is still missing.
const SETTLED: f64 = 4.0;
/// Number of time constants that a ramp has to last, so that the device's lag behind the ramp becomes steady.
const RAMP_STEADY: f64 = 3.0;
/// Upper limit for the share of a movement from which motion counts as visible.
const VISIBLE_MAX: f64 = 0.5;
/// Maximum time, in milliseconds, by which clock errors may make a motion appear earlier than its command.
const EARLY_MAX: f64 = 5.0;

/// A sensor reading before, during or after a movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// When the value was taken, relative to the due time of the movement's first step.
    pub at: Span,
    /// Uncertainty of `at`, in both directions.
    pub uncertainty: Span,
    /// The value, in the sensor's unit.
    pub value: f64,
}

/// One movement and the sensor readings around it.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The commanded movement.
    pub commanded: Commanded,
    /// Signed size of the commanded movement, in the sensor's unit.
    pub movement: f64,
    /// The sensor readings, in any order.
    pub samples: Vec<Sample>,
}

/// The properties of the sensor that are known before any trial.
#[derive(Clone, Copy, Debug)]
pub struct Readable {
    /// Lowest and highest reading of the sensor; `None` without limits.
    pub range: Option<(f64, f64)>,
    /// Displacement from which motion is visible, in the sensor's unit.
    pub visible: f64,
}

/// The result of one trial: when the motion starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Onset {
    /// Time from when the first step is due to the first visible motion, minus the time that a device without latency and lag needs to
    /// move this far.
    pub latency: Span,
    /// Time from the due time of the first step until the device starts to follow.
    pub dead_time: Span,
    /// Standard error of the dead time due to the noise of the readings.
    pub standard_error: Span,
    /// Error common to all readings: the largest uncertainty of a sample. It does not average out over trials.
    pub uncertainty: Span,
    /// Total change of the readings, in the sensor's unit.
    pub moved: f64,
    /// Standard deviation of the readings around the fit, in the sensor's unit.
    pub noise: f64,
}

/// The result for a device from all its trials.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The result of each trial, in the order of the trials.
    pub onsets: Vec<Result<Onset, Unclear>>,
    /// Summary of the trials with a result. `None` if there are fewer than three of them.
    pub latencies: Option<Latencies>,
    /// The lag with which the device follows. `None` if the readings do not distinguish the device from one that follows at once.
    pub lag: Option<downbeat_fleet::fleet::Lag>,
    /// Time by which the device lags behind a ramp once it follows steadily: dead time plus time constant, which is exact for the model.
    /// `None` if no movement lasted long enough.
    pub tracking_lag: Option<Span>,
}

/// Determines the start of a single motion. Uses the given lag, or else fits a lag to this motion alone.
///
/// # Errors
/// Returns the reason, [`Unclear`], if the start cannot be determined.
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

/// Determines the latency of each of several motions of one device, and the properties that they share.
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

    /// Returns how much later than the fitted response the motion visibly starts, in milliseconds. The readings of all these trials are
    /// evaluated together: see [`begin::later`].
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

/// Returns the larger of two uncertainties: that of the last reading up to an instant, and that of the first reading after it.
fn uncertainty_at(trial: &Trial, instant: Span) -> Span {
    let (before, after): (Vec<&Sample>, Vec<&Sample>) =
        trial.samples.iter().partition(|sample| sample.at <= instant);
    let last = before.into_iter().max_by_key(|sample| sample.at);
    let first = after.into_iter().min_by_key(|sample| sample.at);
    last.into_iter().chain(first).map(|sample| sample.uncertainty).max().unwrap_or_default()
}
