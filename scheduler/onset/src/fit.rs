//! Fits the model to the readings: a latency for each trial, and one lag for all trials.

use downbeat_fleet::fleet::LAGS_MAX;

use super::model::{Agreement, Lag, Readings, response};

/// Time constants of the coarse search, in milliseconds: zero, one, then each twice the previous one.
const TIME_CONSTANTS: [f64; 11] =
    [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, TIME_CONSTANT_MAX];
/// The largest time constant of the search, in milliseconds.
pub(super) const TIME_CONSTANT_MAX: f64 = 512.0;
/// Number of steps of a golden-section search. All steps together narrow the interval by a factor of more than 10 000.
const GOLDEN_STEPS: u32 = 20;
/// Rounding error of the sum of squared deviations from the fit, as a share of the readings' squared deviations from their mean.
const ROUNDING: f64 = 1e-12;
/// The smaller part of an interval that is divided by the golden section, as a share of the interval.
const GOLDEN: f64 = 0.381_966_011_250_105;
/// The 99 % quantile of chi squared with one degree of freedom: a larger likelihood ratio is significant.
const SIGNIFICANT: f64 = 6.63;
/// Maximum number of latencies that the coarse search tries.
const GRID_MAX: f64 = 48.0;

/// The result of fitting one trial.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fitted {
    /// The latency in milliseconds.
    pub(super) latency: f64,
    /// Standard error of the latency due to noise, for the given lag, in milliseconds.
    pub(super) standard_error: f64,
    pub(super) agreement: Agreement,
    /// Standard deviation of the readings around the fit, in the sensor's unit.
    pub(super) noise: f64,
}

/// Returns the lag that fits all trials best, and the standard error of its time constant in milliseconds.
pub(super) fn lag(trials: &[&Readings]) -> (Lag, f64) {
    let of = |lags: u8| {
        let cost = |constant: f64| -> f64 {
            let lag = Lag { constant, lags, later: 0.0 };
            trials.iter().map(|trial| trial.agreement(latency(trial, lag), lag).squares).sum()
        };
        let (constant, error) = time_constant(trials, cost);
        (Lag { constant, lags, later: 0.0 }, error, cost(constant))
    };
    let found: Vec<_> = (1..=LAGS_MAX).map(of).collect();
    // Both models have the same number of parameters, so the model with the smaller sum of squares is more likely.
    let best = found.into_iter().min_by(|a, b| a.2.total_cmp(&b.2));
    best.map_or((Lag::NONE, f64::INFINITY), |(lag, error, _)| (lag, error))
}

#[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
fn time_constant(trials: &[&Readings], cost: impl Fn(f64) -> f64) -> (f64, f64) {
    let costs: Vec<f64> = TIME_CONSTANTS.iter().map(|constant| cost(*constant)).collect();
    let best = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or_default();
    let (low, high) = (best.saturating_sub(1), (best + 1).min(costs.len() - 1));
    let constant = golden(TIME_CONSTANTS[low], TIME_CONSTANTS[high], 12, &cost);
    let readings: usize = trials.iter().map(|trial| trial.at.len()).sum();
    let free = (readings as f64 - 3.0 * trials.len() as f64 - 1.0).max(1.0);
    let (with, without) = (cost(constant), costs[0]);
    let moved: f64 = trials.iter().map(|trial| trial.squares()).sum();
    // A time constant that explains no more than chance would bias the latency in the opposite direction, so zero is used instead. For
    // readings without noise, the sum of squares consists of rounding errors.
    if without - with <= SIGNIFICANT * with / free + ROUNDING * moved {
        return (0.0, error_of_constant(trials, 0.0, cost));
    }
    (constant, error_of_constant(trials, constant, cost))
}

/// Returns the standard error of the time constant from the curvature of the cost. The error is the change of the time constant at which
/// the cost rises by the variance of a reading (profile likelihood; Venzon, Moolgavkar: A method for computing profile-likelihood-based
/// confidence intervals, Applied Statistics 37(1), 1988).
#[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
fn error_of_constant(trials: &[&Readings], constant: f64, cost: impl Fn(f64) -> f64) -> f64 {
    let readings: usize = trials.iter().map(|trial| trial.at.len()).sum();
    let free = readings as f64 - 3.0 * trials.len() as f64 - 1.0;
    let least = cost(constant);
    let variance = least / free.max(1.0);
    let step = (constant * 0.2).max(1.0);
    let curvature = (cost(constant + step) - least) / (step * step);
    if curvature > 0.0 { (variance / curvature).sqrt() } else { f64::INFINITY }
}

/// Returns the latency, in milliseconds, that fits one trial best for this lag.
pub(super) fn latency(trial: &Readings, lag: Lag) -> f64 {
    let cost = |latency: f64| trial.agreement(latency, lag).squares;
    let (first, last) = trial.span();
    let step = (trial.interval() / 2.0).max((last - first) / GRID_MAX);
    let mut best = (first, f64::INFINITY);
    let mut at = first;
    while at <= last {
        let squares = cost(at);
        if squares < best.1 {
            best = (at, squares);
        }
        at += step;
    }
    let found = golden(best.0 - step, best.0 + step, GOLDEN_STEPS, cost);
    middle_of_flat(found, trial.interval(), cost)
}

/// Returns the middle of the range around the latency `found` in which the cost is equally low. If the movement is a step between two
/// readings, all latencies in this range fit equally well. The middle minimizes the largest possible error.
fn middle_of_flat(found: f64, interval: f64, cost: impl Fn(f64) -> f64) -> f64 {
    let least = cost(found);
    let is_flat = |at: f64| cost(at) <= least * (1.0 + 1e-9) + f64::MIN_POSITIVE;
    let edge = |sign: f64| {
        // Finds the end of the flat section by bisection.
        let (mut inside, mut outside) = (0.0, interval * 1.5);
        if is_flat(found + sign * outside) {
            return outside;
        }
        for _ in 0..12 {
            let middle = (inside + outside) / 2.0;
            if is_flat(found + sign * middle) { inside = middle } else { outside = middle }
        }
        inside
    };
    if !is_flat(found + interval / 64.0) && !is_flat(found - interval / 64.0) {
        return found;
    }
    found + (edge(1.0) - edge(-1.0)) / 2.0
}

fn golden(low: f64, high: f64, steps: u32, cost: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (low, high);
    let (mut left, mut right) = (low + GOLDEN * (high - low), high - GOLDEN * (high - low));
    let (mut at_left, mut at_right) = (cost(left), cost(right));
    for _ in 0..steps {
        if at_left <= at_right {
            (high, right, at_right) = (right, left, at_left);
            left = low + GOLDEN * (high - low);
            at_left = cost(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = high - GOLDEN * (high - low);
            at_right = cost(right);
        }
    }
    if at_left <= at_right { left } else { right }
}

/// Fits the latency of one trial for this lag.
#[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
pub(super) fn fitted(trial: &Readings, lag: Lag) -> Fitted {
    let latency = latency(trial, lag);
    let agreement = trial.agreement(latency, lag);
    let free = (trial.at.len() as f64 - 3.0).max(1.0);
    let noise = (agreement.squares / free).sqrt();
    let standard_error = standard_error(trial, latency, lag, &agreement, noise);
    Fitted { latency, standard_error, agreement, noise }
}

/// Returns the standard error of the latency in the linearized fit of rest, gain and latency. If no reading falls within the movement,
/// the movement may have started anywhere between two readings. The error is then the interval between readings divided by the square
/// root of 12.
fn standard_error(trial: &Readings, latency: f64, lag: Lag, agreement: &Agreement, noise: f64) -> f64 {
    let between = trial.interval() / 12.0_f64.sqrt();
    let step = (trial.interval() / 8.0).max(0.05);
    let shape = |after: f64| response(&trial.commanded, lag, after);
    // The effect of a larger latency on the readings, without the part that rest and gain can explain.
    let rows: Vec<(f64, f64)> = (trial.at.iter())
        .map(|at| {
            let after = at - latency;
            let slope = (shape(after + step) - shape(after - step)) / (2.0 * step);
            (shape(after), -agreement.gain * slope)
        })
        .collect();
    let mean = |of: fn(&(f64, f64)) -> f64| rows.iter().map(of).sum::<f64>() / rows.len().max(1) as f64;
    let (r_mean, d_mean) = (mean(|row| row.0), mean(|row| row.1));
    let sum =
        |of: &dyn Fn(f64, f64) -> f64| -> f64 { rows.iter().map(|(r, d)| of(r - r_mean, d - d_mean)).sum() };
    let (rr, rd, dd) = (sum(&|r, _| r * r), sum(&|r, d| r * d), sum(&|_, d| d * d));
    let left = if rr > 0.0 { dd - rd * rd / rr } else { dd };
    if left > 0.0 { noise / left.sqrt() } else { between }
}
