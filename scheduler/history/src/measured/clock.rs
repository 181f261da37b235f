//! A robot's clock, from its exchanges and from what was promised to it.

use serde::Serialize;
use urrcp::{RobotId, Server, Span, Timestamp};

use super::line::{ClockLine, counts_in};
use crate::history::{Exchange, History};
use downbeat_mission::clock::{ClockEstimate, ClockSample};

/// A drift is told where zero is not possible, or where it is known this well: half of what any clock may have.
const DRIFT_KNOWN: f64 = 50e-6;

/// What was measured of a robot's clock.
#[derive(Clone, Debug, Serialize)]
pub struct ClockMeasured {
    /// How its time is brought to agree with the server's, by what was added to its timestamps; `None`: it was sent no script.
    pub follows: Option<Follows>,
    /// The robot's clock minus the server's when the mission began.
    #[serde(rename = "offset_ms")]
    pub offset: Span,
    /// The true offset is within this, whatever the asymmetry of the path; `None`: a journal does not say it.
    #[serde(rename = "uncertainty_ms")]
    pub uncertainty: Option<Span>,
    /// How far it was off, either way, where an exchange leaves no room for an offset of zero; `None`: none does.
    #[serde(rename = "surely_off_ms")]
    pub surely_off: Option<Span>,
    /// How fast it gained on the server's clock; `None`: its exchanges do not tell.
    #[serde(flatten)]
    pub drift: Option<DriftMeasured>,
    /// Exchanges behind it.
    pub exchanges: usize,
    /// How often exchanges contradicted earlier ones: the clock was set.
    pub steps: u32,
    /// How far from its plan a script started at most, by the robot's own clock.
    #[serde(rename = "start_error_ms")]
    pub start_error: Option<Span>,
}

/// How a robot's time is brought to agree with the server's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Follows {
    /// It follows NTP: nothing was added to its timestamps.
    Ntp,
    /// What it was sent was translated into its own time.
    Measured,
}

/// A drift in parts per million, and between which values it lies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DriftMeasured {
    /// What leaves the most room to all bounds.
    #[serde(rename = "drift_ppm")]
    pub ppm: f64,
    /// The true one is not below this,
    #[serde(rename = "drift_least_ppm")]
    pub least: f64,
    /// nor above this.
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
    /// `None` where neither exchanges nor what was added to timestamps tells of it.
    pub(super) fn of(
        exchanges: &[Exchange],
        line: Option<&ClockLine>,
        told: Told,
        began: Timestamp<Server>,
    ) -> Option<Self> {
        let samples: Vec<ClockSample> = exchanges.iter().map(sample).collect();
        let mut estimate = ClockEstimate::default();
        samples.iter().for_each(|sample| estimate.add(*sample));
        let resolution = counts_in(exchanges);
        let best = samples.iter().min_by_key(|sample| sample.delay);
        let (offset, uncertainty) = match (line, best) {
            (Some(line), _) => (line.offset_at(began), Some(line.uncertainty() + resolution)),
            // No line holds: of each exchange its own offset is known, and the best of them is told.
            (None, Some(best)) => (best.offset, Some(best.delay / 2 + resolution)),
            // A journal has what was added to timestamps, where anything was.
            (None, None) => (told.shift.filter(|shift| *shift != Span::ZERO)?, None),
        };
        // A rate that fits a short recording best may be far from the true one, so the ends of the line count for nothing here.
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

/// What the decisions of a mission tell of a robot's clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Told {
    /// What was first added to its timestamps, or zero where it was sent scripts and nothing was added to any of them.
    shift: Option<Span>,
    start_error: Option<Span>,
}

impl Told {
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
