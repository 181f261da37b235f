//! The response of a first-order lag to what was commanded, and how well readings agree with it.

use super::commanded::{Commanded, Part};

/// Below this a time constant is none, in milliseconds.
const NO_LAG: f64 = 1e-3;

/// How far a device has come `after` milliseconds since its motion began, as a share of the movement.
pub(super) fn response(commanded: &Commanded, time_constant: f64, after: f64) -> f64 {
    commanded.parts.iter().map(|part| part.share * part.response(time_constant, after - part.begins)).sum()
}

impl Part {
    fn response(self, time_constant: f64, after: f64) -> f64 {
        if after <= 0.0 {
            return 0.0;
        }
        let lags = time_constant > NO_LAG;
        if self.lasts <= 0.0 {
            return if lags { -(-after / time_constant).exp_m1() } else { 1.0 };
        }
        if !lags {
            return (after / self.lasts).min(1.0);
        }
        let since_end = (after - self.lasts).max(0.0);
        (lagged(after, time_constant) - lagged(since_end, time_constant)) / self.lasts
    }
}

/// The response to a ramp of slope one.
fn lagged(after: f64, time_constant: f64) -> f64 {
    after + time_constant * (-after / time_constant).exp_m1()
}

/// The readings of one trial: milliseconds since the movement was due, and values.
#[derive(Clone, Debug)]
pub(super) struct Readings {
    pub(super) commanded: Commanded,
    pub(super) at: Vec<f64>,
    pub(super) values: Vec<f64>,
}

/// Readings against the response for one latency and time constant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// Sum of the squared deviations.
    pub(super) squares: f64,
    /// Of the whole movement, in the sensor's unit.
    pub(super) gain: f64,
}

impl Readings {
    /// The best fit at this latency and time constant.
    #[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
    pub(super) fn agreement(&self, latency: f64, time_constant: f64) -> Agreement {
        let n = self.at.len() as f64;
        let (mut r_sum, mut v_sum, mut rr, mut rv, mut vv) = (0.0, 0.0, 0.0, 0.0, 0.0);
        // Counted from the first value, so that squares do not cancel.
        let origin = self.values.first().copied().unwrap_or_default();
        for (at, value) in self.at.iter().zip(&self.values) {
            let (r, v) = (response(&self.commanded, time_constant, at - latency), value - origin);
            (r_sum, v_sum) = (r_sum + r, v_sum + v);
            (rr, rv, vv) = (rr + r * r, rv + r * v, vv + v * v);
        }
        let (s_rr, s_rv, s_vv) = (rr - r_sum * r_sum / n, rv - r_sum * v_sum / n, vv - v_sum * v_sum / n);
        // A response that is the same at all readings explains nothing.
        let gain = if s_rr > 1e-12 * n { s_rv / s_rr } else { 0.0 };
        let squares = (s_vv - gain * s_rv).max(0.0);
        Agreement { squares, gain }
    }

    /// Milliseconds between the first reading and the last.
    pub(super) fn span(&self) -> (f64, f64) {
        (self.at.first().copied().unwrap_or_default(), self.at.last().copied().unwrap_or_default())
    }

    /// The median of the times between two readings.
    pub(super) fn interval(&self) -> f64 {
        let mut steps: Vec<f64> = self.at.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or_default().max(0.01)
    }
}
