//! Determines when visible motion starts if the readings contradict the fitted response.
//!
//! No device follows exactly like first-order lags. A device with static friction, for example, rests for a while and then catches up:
//! the best fit starts to move before the device does. Therefore the readings of all trials are overlaid, aligned by their dead times,
//! and smoothed by local linear regression with tricube weights (Cleveland: Robust locally weighted regression and smoothing
//! scatterplots, Journal of the American Statistical Association 74, 1979). The fitted response is smoothed at the same instants with the
//! same weights, so that the smoothing distorts both equally. Each of the two smoothed curves crosses the share of the movement from
//! which motion is visible. The time between the two crossings is added to the latency if it is significant given the noise.

use super::fit::Fitted;
use super::model::{Lag, Readings, response};

/// The smallest and the largest half-width of the smoothing weights, in milliseconds.
const WIDTHS: (f64, f64) = (1.0, 16.0);
/// Ratio of each tried half-width to the previous one.
const WIDER: f64 = 1.4;
/// Minimum number of readings that the smoothing weights have to cover at each instant.
const READINGS_LEAST: usize = 5;
/// Maximum standard error of the time of a crossing, in milliseconds. A less precise crossing is not used.
const PRECISE: f64 = 1.0;
/// Maximum standard error of the smoothed readings, as a fraction of the share of the movement from which motion is visible. With more
/// noise, the curve may cross this share more than once.
const QUIET: f64 = 0.125;
/// The time between the crossings of the two curves is significant if it exceeds this number of standard errors and also [`MATTERS`].
const SIGNIFICANT: f64 = 4.0;
/// Minimum time between the crossings of the two curves, in milliseconds. A shorter time does not justify an exception from the fit.
const MATTERS: f64 = 0.5;
/// Interval between the instants at which the regression is computed, in milliseconds.
const STEP: f64 = 0.5;
/// The search for crossings ends where the fitted response has reached this share of the movement.
const BEGUN: f64 = 0.6;

/// A reading of one of the trials.
#[derive(Clone, Copy, Debug)]
struct Point {
    /// Milliseconds from the end of the trial's dead time to the reading.
    after: f64,
    /// The share of the movement that the reading shows.
    seen: f64,
    /// The share of the movement that the fitted response has made at the time of the reading.
    fitted: f64,
}

/// The readings of all trials in the order of their times, and the standard deviation of the readings at rest.
struct Pooled {
    points: Vec<Point>,
    at_rest: f64,
}

/// The result of the regression at one instant.
#[derive(Clone, Copy, Debug)]
struct Smoothed {
    at: f64,
    seen: f64,
    fitted: f64,
    /// Slope of the readings, per millisecond.
    slope: f64,
    standard_error: f64,
}

/// Returns how much later than the fitted response the motion visibly starts, in milliseconds. Motion is visible once it has made `share`
/// of the movement. The result is negative if devices start earlier. It is zero if the readings do not contradict the fit or are
/// inconclusive.
pub(super) fn later(trials: &[(&Readings, Fitted)], lag: Lag, share: f64) -> f64 {
    let Some(commanded) = trials.first().map(|(readings, _)| &readings.commanded) else { return 0.0 };
    let pooled = Pooled::of(trials, lag);
    let last = commanded.lasts_ms() + 20.0 * lag.constant + STEP;
    let begun = instants(0.0, last).find(|at| response(commanded, lag, *at) >= BEGUN).unwrap_or(last);
    let widths = std::iter::successors(Some(WIDTHS.0), |width| Some(width * WIDER));
    for width in widths.take_while(|width| *width <= WIDTHS.1) {
        let Some((difference, error)) = pooled.difference(width, begun, share) else { continue };
        if error <= PRECISE {
            return if difference.abs() > (SIGNIFICANT * error).max(MATTERS) { difference } else { 0.0 };
        }
    }
    0.0
}

fn instants(first: f64, last: f64) -> impl DoubleEndedIterator<Item = f64> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "movements are watched for seconds"
    )]
    let count = ((last - first) / STEP).ceil().max(0.0) as u32;
    (0..=count).map(move |index| first + f64::from(index) * STEP)
}

impl Pooled {
    #[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
    fn of(trials: &[(&Readings, Fitted)], lag: Lag) -> Self {
        let (mut points, mut squares, mut free) = (Vec::new(), 0.0, 0.0);
        for (readings, fitted) in trials.iter().filter(|(_, fitted)| fitted.agreement.gain != 0.0) {
            let resting = || readings.at.iter().zip(&readings.values).filter(|(at, _)| **at < 0.0);
            let count = resting().count() as f64;
            let rest = resting().map(|(_, value)| value).sum::<f64>() / count.max(1.0);
            let share = |value: f64| (value - rest) / fitted.agreement.gain;
            squares += resting().map(|(_, value)| share(*value).powi(2)).sum::<f64>();
            free += (count - 1.0).max(0.0);
            points.extend(readings.at.iter().zip(&readings.values).map(|(at, value)| {
                let after = at - fitted.latency;
                Point { after, seen: share(*value), fitted: response(&readings.commanded, lag, after) }
            }));
        }
        points.sort_by(|a, b| a.after.total_cmp(&b.after));
        Self { points, at_rest: (squares / free.max(1.0)).sqrt() }
    }

    /// Returns how much later the smoothed readings reach `share` of the movement than the smoothed response does, and the standard error
    /// of this difference. Both are in milliseconds. Returns `None` if the readings are too few or show no clear crossing.
    fn difference(&self, width: f64, begun: f64, share: f64) -> Option<(f64, f64)> {
        let first = self.points.first()?.after.max(-begun);
        let smoothed: Option<Vec<Smoothed>> =
            instants(first + width, begun).map(|at| self.smoothed(at, width)).collect();
        let smoothed = smoothed?;
        let seen = crossing(&smoothed, share, |smoothed| smoothed.seen)?;
        let fitted = crossing(&smoothed, share, |smoothed| smoothed.fitted)?;
        let near = smoothed.iter().min_by(|a, b| (a.at - seen).abs().total_cmp(&(b.at - seen).abs()))?;
        let told = near.slope > 0.0 && near.standard_error <= QUIET * share;
        told.then(|| (seen - fitted, near.standard_error / near.slope))
    }

    #[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
    fn smoothed(&self, at: f64, width: f64) -> Option<Smoothed> {
        let begin = self.points.partition_point(|point| point.after <= at - width);
        let end = self.points.partition_point(|point| point.after < at + width);
        let near = &self.points[begin..end];
        if near.len() < READINGS_LEAST {
            return None;
        }
        let weight = |point: &Point| (1.0 - ((point.after - at).abs() / width).powi(3)).powi(3);
        let (mut s0, mut s1, mut s2) = (0.0, 0.0, 0.0);
        for point in near {
            let (weight, distance) = (weight(point), point.after - at);
            (s0, s1, s2) = (s0 + weight, s1 + weight * distance, s2 + weight * distance * distance);
        }
        let determinant = s0 * s2 - s1 * s1;
        if determinant <= 1e-9 * s0 * s0 {
            return None;
        }
        let (mut seen, mut fitted, mut slope, mut gained) = (0.0, 0.0, 0.0, 0.0);
        for point in near {
            let (weight, distance) = (weight(point), point.after - at);
            let part = weight * (s2 - s1 * distance) / determinant;
            (seen, fitted, gained) =
                (seen + part * point.seen, fitted + part * point.fitted, gained + part * part);
            slope += weight * (s0 * distance - s1) / determinant * point.seen;
        }
        let deviation = |point: &Point| point.seen - seen - slope * (point.after - at);
        let squares = near.iter().map(|point| weight(point) * deviation(point).powi(2)).sum::<f64>() / s0;
        let count = near.len() as f64;
        let variance = (squares * count / (count - 2.0)).max(self.at_rest.powi(2));
        Some(Smoothed { at, seen, fitted, slope, standard_error: (variance * gained).sqrt() })
    }
}

/// Returns the time, in milliseconds, at which the smoothed values rise above `share` for the last time. Returns `None` if they never
/// cross it.
fn crossing(smoothed: &[Smoothed], share: f64, of: impl Fn(&Smoothed) -> f64) -> Option<f64> {
    let below = smoothed.iter().rposition(|smoothed| of(smoothed) < share)?;
    let (before, after) = (smoothed.get(below)?, smoothed.get(below + 1)?);
    Some(before.at + (after.at - before.at) * (share - of(before)) / (of(after) - of(before)))
}
