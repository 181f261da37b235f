//! The response of one or two first-order lags to the commanded movement, and how well readings agree with it.

use urrcp::Span;

use super::commanded::{Commanded, MovementPart};

/// Time constants below this, in milliseconds, are treated as zero.
const NO_LAG: f64 = 1e-3;

/// Returns how far a device has moved, as a share of the movement, `after` milliseconds after the start of its motion.
pub(super) fn response(commanded: &Commanded, lag: Lag, after: f64) -> f64 {
    commanded.parts.iter().map(|part| part.share * part.response(lag, after - part.begins)).sum()
}

/// Returns how much later, in milliseconds, a device with this lag has moved by `share` of the movement than a device without lag.
pub(super) fn visible_delay(commanded: &Commanded, lag: Lag, share: f64) -> f64 {
    let crossed = |lag: Lag| {
        let (mut before, mut after) = (0.0, commanded.lasts_ms() + 20.0 * lag.constant + 1.0);
        for _ in 0..48 {
            let middle = f64::midpoint(before, after);
            if response(commanded, lag, middle) < share { before = middle } else { after = middle }
        }
        after
    };
    (crossed(lag) - crossed(Lag::NONE)).max(0.0) + lag.later
}

/// The lag of a device: one first-order lag, or two equal ones in series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lag {
    /// Total time constant of all lags, in milliseconds.
    pub(super) constant: f64,
    /// Number of lags: one or two.
    pub(super) lags: u8,
    /// How much later the device visibly starts than this response predicts, in milliseconds. Negative if it starts earlier.
    pub(super) later: f64,
}

impl Lag {
    pub(super) const NONE: Self = Self { constant: 0.0, lags: 1, later: 0.0 };

    /// Returns the response to a step of size one, `after` milliseconds after the step.
    fn step(self, after: f64) -> f64 {
        match self.lags {
            1 => -(-after / self.constant).exp_m1(),
            _ => {
                let each = after / (self.constant / 2.0);
                1.0 - (1.0 + each) * (-each).exp()
            }
        }
    }

    /// Returns the response to a ramp of slope one, `after` milliseconds after its start.
    fn ramp(self, after: f64) -> f64 {
        match self.lags {
            1 => after + self.constant * (-after / self.constant).exp_m1(),
            _ => after - self.constant + (after + self.constant) * (-2.0 * after / self.constant).exp(),
        }
    }
}

impl From<Lag> for downbeat_fleet::fleet::Lag {
    fn from(lag: Lag) -> Self {
        let time_constant = Span::from_millis_f64(lag.constant);
        Self { time_constant, lags: lag.lags, later: Span::from_millis_f64(lag.later) }
    }
}

impl From<downbeat_fleet::fleet::Lag> for Lag {
    fn from(lag: downbeat_fleet::fleet::Lag) -> Self {
        Self { constant: lag.time_constant.as_millis_f64(), lags: lag.lags, later: lag.later.as_millis_f64() }
    }
}

impl MovementPart {
    fn response(self, lag: Lag, after: f64) -> f64 {
        if after <= 0.0 {
            return 0.0;
        }
        let lags = lag.constant > NO_LAG;
        if self.lasts <= 0.0 {
            return if lags { lag.step(after) } else { 1.0 };
        }
        if !lags {
            return (after / self.lasts).min(1.0);
        }
        let since_end = (after - self.lasts).max(0.0);
        (lag.ramp(after) - lag.ramp(since_end)) / self.lasts
    }
}

/// The readings of one trial: their times in milliseconds since the movement was due, and their values.
#[derive(Clone, Debug)]
pub(super) struct Readings {
    pub(super) commanded: Commanded,
    pub(super) at: Vec<f64>,
    pub(super) values: Vec<f64>,
}

/// The agreement of the readings with the response for one latency and lag.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// Sum of the squared deviations of the readings from the response.
    pub(super) squares: f64,
    /// The gain of the fit: by how much the whole movement changes the readings, in the sensor's unit.
    pub(super) gain: f64,
}

impl Readings {
    /// Returns the agreement for the rest value and the gain that fit best with this latency and lag.
    #[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
    pub(super) fn agreement(&self, latency: f64, lag: Lag) -> Agreement {
        let n = self.at.len() as f64;
        let (mut r_sum, mut v_sum, mut rr, mut rv, mut vv) = (0.0, 0.0, 0.0, 0.0, 0.0);
        // Values are taken relative to the first one, to avoid cancellation in the squares.
        let origin = self.values.first().copied().unwrap_or_default();
        for (at, value) in self.at.iter().zip(&self.values) {
            let (r, v) = (response(&self.commanded, lag, at - latency), value - origin);
            (r_sum, v_sum) = (r_sum + r, v_sum + v);
            (rr, rv, vv) = (rr + r * r, rv + r * v, vv + v * v);
        }
        let (s_rr, s_rv, s_vv) = (rr - r_sum * r_sum / n, rv - r_sum * v_sum / n, vv - v_sum * v_sum / n);
        // A response that is equal at all readings explains nothing.
        let gain = if s_rr > 1e-12 * n { s_rv / s_rr } else { 0.0 };
        let squares = (s_vv - gain * s_rv).max(0.0);
        Agreement { squares, gain }
    }

    /// Returns the sum of the squared deviations of the readings from their mean.
    #[expect(clippy::cast_precision_loss, reason = "readings are below 2^53")]
    pub(super) fn squares(&self) -> f64 {
        let mean = self.values.iter().sum::<f64>() / self.values.len().max(1) as f64;
        self.values.iter().map(|value| (value - mean).powi(2)).sum()
    }

    /// Returns the times of the first and the last reading in milliseconds.
    pub(super) fn span(&self) -> (f64, f64) {
        (self.at.first().copied().unwrap_or_default(), self.at.last().copied().unwrap_or_default())
    }

    /// Returns the median interval between two readings in milliseconds.
    pub(super) fn interval(&self) -> f64 {
        let mut steps: Vec<f64> = self.at.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or_default().max(0.01)
    }
}
