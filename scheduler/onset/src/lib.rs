//! Estimates when a device starts moving after a command, from sensor readings around a small commanded movement. The crate reads no
//! clock and performs no input or output.
//!
//! Fits the readings with the response of one first-order lag with dead time (FOPDT), or of two equal lags in series, whichever fits
//! better. These are the usual models for identifying a plant from its step response (Åström, Hägglund: Advanced PID Control, ISA 2006,
//! section 2.7; Bi et al.: Robust identification of first-order plus dead-time model from step response, Control Engineering Practice
//! 7(1), 1999):
//!
//! ```text
//! value(t) = rest + gain * response(t - dead_time),    response' = (commanded - response) / time_constant
//! ```
//!
//! The latency is the time in which this response moves by the visible amount, minus the time for this motion without dead time and lag.
//! A plain threshold on the readings would be inaccurate, because it has to be well above the noise. The fit uses every reading instead.
//! If the readings of all trials together show significantly that the device starts at a different time than the response, that time is
//! used (`begin.rs`). `rest` and `gain` enter linearly and are computed directly for each pair of the other two parameters (variable
//! projection: Golub, Pereyra: The differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate, SIAM
//! Journal on Numerical Analysis 10(2), 1973). The lag is a property of the device, so all trials share it; each trial has its own dead
//! time.
//!
//! **Limits.** A sensor delay that does not appear in its round trips is indistinguishable from a latency of the device: the latencies
//! include it. The instant within a round trip at which the value was taken is also unknown: see [`Reading::instant`].

mod begin;
mod commanded;
mod fit;
mod model;
mod summary;
mod trials;

pub use commanded::Commanded;
pub use summary::{Latencies, quantile_bound, spread_bound};
pub use trials::{Estimate, Onset, Readable, Sample, Trial, estimate, onset};

pub use downbeat_fleet::fleet::Taken;
use urrcp::Span;

/// Why the start of a motion cannot be determined.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Unclear {
    /// Too few readings before the movement or after its command.
    #[error(
        "too few readings of the sensor: {before} before the movement and {after} after its command, expected at least {least} each"
    )]
    TooSparse {
        /// Number of readings before the movement was commanded.
        before: usize,
        /// Number of readings after the movement was commanded.
        after: usize,
        /// Required number of readings before, and also after, the command.
        least: usize,
    },
    /// The movement does not stand out from the noise.
    #[error(
        "the sensor's noise of {noise:.4} is too large for a movement of {movement:.4}; the movement must be at least {ratio} times the noise"
    )]
    Noisy {
        /// Standard deviation of the readings around the fit, in the sensor's unit.
        noise: f64,
        /// Commanded movement of the device, in the sensor's unit.
        movement: f64,
        /// Required ratio of movement to noise.
        ratio: f64,
    },
    /// The readings do not change.
    #[error(
        "the sensor shows no movement: its readings changed by {seen:.4}, but {movement:.4} was commanded"
    )]
    NothingMoved {
        /// Change of the readings, in the sensor's unit.
        seen: f64,
        /// Commanded movement of the device, in the sensor's unit.
        movement: f64,
    },
    /// The sensor shows a movement in the opposite direction.
    #[error(
        "the sensor shows a movement in the opposite direction: its readings changed by {seen:.4}, but {movement:.4} was commanded; check the sign of the sensor, and that the sensor belongs to this device"
    )]
    WrongWay {
        /// Change of the readings, in the sensor's unit.
        seen: f64,
        /// Commanded movement of the device, in the sensor's unit.
        movement: f64,
    },
    /// The device responds too slowly for the fit to determine when it starts moving.
    #[error(
        "the device responds too slowly to detect when it starts moving: its time constant is {least} or more"
    )]
    TooSlow {
        /// The largest time constant that the fit covers.
        least: Span,
    },
    /// Too many readings are at one end of the sensor's range.
    #[error("the sensor is at the end of its range: {share:.0} % of its readings are {limit}")]
    Saturated {
        /// Percentage of the readings that are at one end of the sensor's range.
        share: f64,
        /// The end of the sensor's range that the readings have reached: its lowest or highest value, in the sensor's unit.
        limit: f64,
    },
    /// The device moved before the command.
    #[error(
        "the sensor shows motion {early} before the movement was commanded; check whether something else moves the device"
    )]
    MovedBefore {
        /// Time from the observed motion to the command.
        early: Span,
    },
    /// The motion seems to start before the command, because a reading took so long that its time is uncertain.
    #[error(
        "a reading took so long that its time, and thus the start of the motion, is known only to +-{uncertainty}"
    )]
    LateReading {
        /// Uncertainty of the time at which the reading's value was taken.
        uncertainty: Span,
    },
    /// The device was still moving at the last reading.
    #[error(
        "the device was still moving {watched} after the movement was commanded, when the observation ended"
    )]
    NotSettled {
        /// Duration of the observation after the command.
        watched: Span,
    },
}

/// One sensor reading, with times measured by the requester.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// When the reading was requested.
    pub asked: Span,
    /// When the response arrived.
    pub answered: Span,
    /// Value in the sensor's unit.
    pub value: f64,
}

impl Reading {
    /// Returns when the value was taken, and the uncertainty of that instant. `link` is the duration of a round trip that does not
    /// involve the sensor, such as that of an availability request. Each direction is assumed to take half of it. The rest of the
    /// reading's round trip is the sensor's own delay.
    ///
    /// The value was taken between the arrival of the request and the departure of the response. If `taken` does not state the exact
    /// instant, the middle is assumed. This adds half of the sensor's delay to the uncertainty. The resulting error is systematic: it
    /// does not average out over trials.
    #[must_use]
    pub fn instant(&self, link: Span, taken: Taken) -> (Span, Span) {
        let way = link / 2;
        let own = self.own_delay(link);
        let (arrived, departed) = (self.asked + way, self.asked + way + own);
        match taken {
            Taken::AtRequest => (arrived, way),
            Taken::AtAnswer => (departed, way),
            Taken::Between => (arrived + own / 2, way + own / 2),
        }
    }

    /// Returns the processing time of the sensor itself: the reading's round trip minus the round trip `link`, at least zero.
    #[must_use]
    pub fn own_delay(&self, link: Span) -> Span {
        (self.answered - self.asked - link).max(Span::ZERO)
    }
}

#[cfg(test)]
mod tests;
