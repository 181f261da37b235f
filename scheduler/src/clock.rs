//! Offsets between clocks, from exchanges of four timestamps as in NTP (RFC 5905, section 8). No clock is read here.

use serde::Serialize;
use urrcp::{Robot, Server, Span, Timestamp};

/// One exchange with a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockSample {
    /// The robot's clock minus the server's, if both ways took equally long.
    pub offset: Span,
    /// Round trip without the robot's own time.
    pub delay: Span,
}

impl ClockSample {
    /// Offset ((T2-T1)+(T3-T4))/2 and delay (T4-T1)-(T3-T2), RFC 5905 section 8.
    #[must_use]
    pub fn from_exchange(
        sent: Timestamp<Server>,
        robot_received: Timestamp<Robot>,
        robot_sent: Timestamp<Robot>,
        received: Timestamp<Server>,
    ) -> Self {
        let there = robot_received - sent.assume_clock();
        let back = robot_sent - received.assume_clock();
        let delay = (received - sent) - (robot_sent - robot_received);
        Self { offset: (there + back) / 2, delay: delay.max(Span::ZERO) }
    }
}

/// What the exchanges so far say of a robot's clock and link.
#[derive(Clone, Debug, Default)]
pub struct ClockEstimate {
    best: Option<ClockSample>,
    delay_max: Span,
    samples: u32,
}

/// A robot's clock as reported.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClockReading {
    /// The robot's clock minus the server's, in milliseconds.
    #[serde(rename = "offset_ms")]
    pub offset: Span,
    /// The true offset lies within this of `offset`: half the least delay, whatever the asymmetry of the path.
    #[serde(rename = "uncertainty_ms")]
    pub uncertainty: Span,
    /// Least round trip.
    #[serde(rename = "delay_min_ms")]
    pub delay_min: Span,
    /// Longest round trip.
    #[serde(rename = "delay_max_ms")]
    pub delay_max: Span,
    /// How many exchanges stand behind it.
    pub samples: u32,
}

impl ClockEstimate {
    /// Takes one more exchange; the one of least delay decides.
    pub fn add(&mut self, sample: ClockSample) {
        self.samples += 1;
        self.delay_max = self.delay_max.max(sample.delay);
        if self.best.is_none_or(|best| sample.delay < best.delay) {
            self.best = Some(sample);
        }
    }

    /// Number of exchanges so far.
    #[must_use]
    pub const fn samples(&self) -> u32 {
        self.samples
    }

    /// The estimate, or `None` before the first exchange.
    #[must_use]
    pub fn reading(&self) -> Option<ClockReading> {
        self.best.map(|best| ClockReading {
            offset: best.offset,
            uncertainty: best.delay / 2 + Span::from_nanos(1),
            delay_min: best.delay,
            delay_max: self.delay_max,
            samples: self.samples,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_true_offset_lies_within_the_uncertainty_whatever_the_asymmetry() {
        let offset = Span::from_millis(250);
        let mut rng = fastrand::Rng::with_seed(7);
        for _ in 0..1_000 {
            let mut estimate = ClockEstimate::default();
            for k in 0..8 {
                let sent = Timestamp::<Server>::from_nanos(k * 1_000_000_000);
                let there = Span::from_nanos(rng.i64(0..80_000_000));
                let back = Span::from_nanos(rng.i64(0..80_000_000));
                let arrived = sent.assume_clock::<Robot>() + there + offset;
                let received = sent + there + back;
                estimate.add(ClockSample::from_exchange(sent, arrived, arrived, received));
            }
            let reading = estimate.reading().unwrap();
            assert!((reading.offset - offset).abs() <= reading.uncertainty, "{reading:?}");
        }
    }
}
