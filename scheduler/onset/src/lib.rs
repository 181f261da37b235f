//! When a device begins to move after it was told to: the instant is estimated from readings of a sensor around a small movement that
//! was commanded. Pure: no clock is read and nothing is sent here.
//!
//! What the sensor shows is fitted by the response of one first-order lag with dead time (FOPDT) to what was commanded, or of two equal
//! ones in a row, whichever fits better. These are the usual models for the identification of a plant from its response to a step
//! (Åström, Hägglund: Advanced PID Control, ISA 2006, section 2.7; Bi et al.: Robust identification of first-order plus dead-time model
//! from step response, Control Engineering Practice 7(1), 1999):
//!
//! ```text
//! value(t) = rest + gain * response(t - dead_time),    response' = (commanded - response) / time_constant
//! ```
//!
//! The latency is when this response has moved by the visible amount, less what it would take without dead time and lag. A bare threshold
//! for readings would not do: with noise it has to lie well above it. In the fit, every reading counts. Where all readings together show
//! beyond doubt that the device begins at another time than the response, that time is taken (`begin.rs`). `rest` and `gain` enter linearly
//! and are solved for at each pair of the other two (variable projection: Golub, Pereyra: The differentiation of pseudo-inverses and
//! nonlinear least squares problems whose variables separate, SIAM Journal on Numerical Analysis 10(2), 1973). The lag is a property of
//! the device, so all trials have it in common; each trial has a dead time of its own.
//!
//! **What cannot be known.** A delay of the sensor that its round trips do not show cannot be told from a latency of the device: the
//! latencies contain it. Where within a round trip the value was taken cannot be known either: see [`Reading::instant`].

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

/// Why a motion's begin cannot be told.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Unclear {
    /// Too few readings before the movement, or after it began.
    #[error(
        "the sensor gave too few readings: {before} before the movement and {after} from then on, at least {least} each are needed"
    )]
    TooSparse {
        /// Readings before the movement was commanded.
        before: usize,
        /// Readings from then on.
        after: usize,
        /// So many of each are needed.
        least: usize,
    },
    /// The movement does not stand out from the noise.
    #[error(
        "the sensor's noise of {noise:.4} is too large for a movement of {movement:.4}: it has to be {ratio} times as large as the noise"
    )]
    Noisy {
        /// Standard deviation of the readings around the fit, in the sensor's unit.
        noise: f64,
        /// By how much the device was to move.
        movement: f64,
        /// How many times the noise a movement has to be.
        ratio: f64,
    },
    /// The readings stay where they were.
    #[error(
        "the sensor shows no movement: its readings changed by {seen:.4} where {movement:.4} was commanded"
    )]
    NothingMoved {
        /// By how much the readings changed, in the sensor's unit.
        seen: f64,
        /// By how much the device was to move.
        movement: f64,
    },
    /// The sensor shows a movement the other way.
    #[error(
        "the sensor shows the opposite movement: its readings changed by {seen:.4} where {movement:.4} was commanded: is its sign the other way round, or is it the sensor of another device?"
    )]
    WrongWay {
        /// By how much the readings changed, in the sensor's unit.
        seen: f64,
        /// By how much the device was to move.
        movement: f64,
    },
    /// It follows so slowly that the fit does not tell when it began.
    #[error("the device follows too slowly for a begin to be told: its time constant is {least} or more")]
    TooSlow {
        /// The largest time constant that is fitted.
        least: Span,
    },
    /// The sensor shows one of the ends of its range.
    #[error("the sensor is at the end of its range: {share:.0} % of its readings are {limit}")]
    Saturated {
        /// How many of the readings, in per cent.
        share: f64,
        /// What they show.
        limit: f64,
    },
    /// The device moved before it was told to.
    #[error(
        "the sensor shows motion {early} before the movement was commanded: does something else move the device?"
    )]
    MovedBefore {
        /// How much earlier.
        early: Span,
    },
    /// The motion seems to begin before the command, because a reading took too long.
    #[error(
        "a reading took so long that its time, and so the beginning of the motion, is known only to +-{uncertainty}"
    )]
    LateReading {
        /// How uncertain the time of the reading is.
        uncertainty: Span,
    },
    /// The device still moved at the last reading.
    #[error("the device still moved {watched} after the movement was commanded, as long as it was watched")]
    NotSettled {
        /// How long it was watched.
        watched: Span,
    },
}

/// One reading of a sensor as the one that asks sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// When it was asked for.
    pub asked: Span,
    /// When the answer was there.
    pub answered: Span,
    /// What it says, in the sensor's unit.
    pub value: f64,
}

impl Reading {
    /// When the value was taken, and how far off that may be. `link` is a round trip without the sensor, such as that of an availability
    /// request, of which each way is taken to be half. What the reading took longer is the sensor's own delay.
    ///
    /// The value was taken between the arrival of the request and the departure of the answer. If it is not known where, the middle is
    /// taken, and half of the sensor's delay remains as the uncertainty. That is a systematic error: it does not average out over trials.
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

    /// How long the sensor itself took.
    #[must_use]
    pub fn own_delay(&self, link: Span) -> Span {
        (self.answered - self.asked - link).max(Span::ZERO)
    }
}

#[cfg(test)]
mod tests;
