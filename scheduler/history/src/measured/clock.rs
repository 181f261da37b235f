//! Measures a robot's clock from timestamped questions and answers, and from the time shifts of the scripts that were promised to the
//! robot.

use serde::Serialize;
use urrcp::{RobotId, Server, Span, Timestamp};

use super::line::{ClockLine, counts_in};
use crate::history::{Exchange, History};
use downbeat_mission::clock::{ClockEstimate, ClockSample};

/// Largest uncertainty, as a fraction, with which a drift is reported although the true drift may be zero. It is half of the maximum
/// drift that is assumed for any clock.
const DRIFT_KNOWN: f64 = 50e-6;

/// The measured properties of a robot's clock.
#[derive(Clone, Debug, Serialize)]
pub struct ClockMeasured {
    /// How the robot's time is reconciled with the server's, as derived from the time shifts of its scripts. `None` if the robot received
    /// no script.
    pub follows: Option<Follows>,
    /// The robot's clock minus the server's clock when the mission began.
    #[serde(rename = "offset_ms")]
    pub offset: Span,
    /// Uncertainty of the offset, which covers any asymmetry of the network path. `None` if it is unknown, because the source is a
    /// journal.
    #[serde(rename = "uncertainty_ms")]
    pub uncertainty: Option<Span>,
    /// Lower bound on the largest absolute offset during the mission. `None` if every exchange is consistent with an offset of zero.
    #[serde(rename = "surely_off_ms")]
    pub surely_off: Option<Span>,
    /// Drift relative to the server's clock. `None` if the exchanges do not determine it.
    #[serde(flatten)]
    pub drift: Option<DriftMeasured>,
    /// Number of exchanges that the measurement is based on.
    pub exchanges: usize,
    /// Number of times that the clock was set, recognized by exchanges that contradict earlier ones.
    pub steps: u32,
    /// The largest deviation of a script's start from its planned start, by the robot's own clock.
    #[serde(rename = "start_error_ms")]
    pub start_error: Option<Span>,
}

/// How a robot's time is reconciled with the server's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Follows {
    /// The robot's clock follows NTP, so the timestamps sent to it were not shifted.
    Ntp,
    /// The scheduler measured the robot's clock and converted the times in its messages to that clock.
    Measured,
}

/// A measured drift in parts per million, with its bounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DriftMeasured {
    /// The most likely drift: that of the line with the largest distance from the bounds of all exchanges.
    #[serde(rename = "drift_ppm")]
    pub ppm: f64,
    /// Lower bound on the true drift.
    #[serde(rename = "drift_least_ppm")]
    pub least: f64,
    /// Upper bound on the true drift.
    #[serde(rename = "drift_most_ppm")]
    pub most: f64,
}

impl DriftMeasured {
    fn of(line: &ClockLine) -> Option<Self> {
        let (least, most) = line.rates?;
        let known = (least > 0.0 || most < 0.0) || most - least < 2.0 * DRIFT_KNOWN;
        known.then_some(Self { ppm: line.rate * 1e6, least: least * 1e6, most: most * 1e6 })
    }
}

impl ClockMeasured {
    /// Measures a clock; `None` if neither exchanges nor time shifts of scripts provide information about it.
    pub(super) fn of(
        exchanges: &[Exchange],
        line: Option<&ClockLine>,
        told: RecordedClock,
        began: Timestamp<Server>,
    ) -> Option<Self> {
        let samples: Vec<ClockSample> = exchanges.iter().map(sample).collect();
        let mut estimate = ClockEstimate::default();
        samples.iter().for_each(|sample| estimate.add(*sample));
        let resolution = counts_in(exchanges);
        let best = samples.iter().min_by_key(|sample| sample.delay);
        let (offset, uncertainty) = match (line, best) {
            (Some(line), _) => (line.offset_at(began), Some(line.uncertainty() + resolution)),
            // No line fits: each exchange has its own offset, and the best one is reported.
            (None, Some(best)) => (best.offset, Some(best.delay / 2 + resolution)),
            // A journal contains the shifts of timestamps, if any.
            (None, None) => (told.shift.filter(|shift| *shift != Span::ZERO)?, None),
        };
        // In a short recording, the best rate may be far from the true rate, so the ends of the line are ignored here.
        let surely = samples.iter().map(|sample| sample.offset.abs() - sample.delay / 2 - resolution).max();
        let surely = surely.filter(|surely| *surely > Span::ZERO);
        let surely_off = surely.zip(best).map(|(surely, best)| surely.max(best.offset.abs()));
        Some(Self {
            follows: told
                .shift
                .map(|shift| if shift == Span::ZERO { Follows::Ntp } else { Follows::Measured }),
            offset,
            uncertainty,
            surely_off,
            drift: line.and_then(DriftMeasured::of),
            exchanges: exchanges.len(),
            steps: estimate.steps(),
            start_error: told.start_error,
        })
    }
}

fn sample(exchange: &Exchange) -> ClockSample {
    let Exchange { sent, robot_received, robot_sent, received } = *exchange;
    ClockSample::from_exchange(sent, robot_received, robot_sent, received)
}

/// Information about a robot's clock from the recorded decisions of a mission.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RecordedClock {
    /// The first nonzero time shift of the robot's scripts; zero if no script was shifted. `None` if the robot received no script.
    shift: Option<Span>,
    start_error: Option<Span>,
}

impl RecordedClock {
    pub(super) fn of(history: &History, robot: &RobotId) -> Self {
        let promised = history.promises().flat_map(|(_, promise)| &promise.scripts);
        let shifts: Vec<Span> =
            promised.filter(|script| script.robot == *robot).map(|script| script.shift).collect();
        let added = shifts.iter().find(|shift| **shift != Span::ZERO);
        let rows = history.ended_acts().flat_map(|act| &act.report.robots);
        let devices = rows.filter(|row| row.robot == *robot).flat_map(|row| &row.devices);
        let errors = devices.filter_map(|device| device.start_error);
        Self { shift: added.or(shifts.first()).copied(), start_error: errors.map(Span::abs).max() }
    }
}
