//! Measures the network, the clocks and the sensors of a recorded mission. The result is a world file (the description of a simulated
//! network), so that trials can use the same network.
//!
//! This module reads no files and prints nothing. `docs/measured.md` describes the methods and their limits.

mod clock;
mod line;
mod link;
#[cfg(test)]
mod tests;
mod told;
mod written;

use serde::Serialize;
use urrcp::{RobotId, Server, Span, Timestamp};

use self::clock::RecordedClock;
use self::line::ClockLine;
use crate::history::{Exchange, History, HistorySource, KnownRobot};

pub use self::clock::{ClockMeasured, DriftMeasured, Follows};
pub use self::link::{Interruption, LinkMeasured, Loss, Method, Quantiles};
pub use self::told::{Break, OperatorMeasured, SensorMeasured};
pub use self::written::world_text;

/// The measurements of a recorded mission.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// The scenario's name; `None` if it is not known.
    pub scenario: Option<String>,
    /// The earliest instant in the data of the file.
    pub began: Timestamp<Server>,
    /// Time from the earliest to the latest instant in the data of the file.
    #[serde(rename = "duration_ms")]
    pub duration: Span,
    /// The reason why the file is incomplete; `None` if it is complete.
    pub cut_off: Option<String>,
    /// The measurements of each robot, sorted by robot id.
    pub robots: Vec<RobotMeasured>,
    /// The measurements of each sensor, sorted by robot and device.
    pub sensors: Vec<SensorMeasured>,
    /// How long acts waited for the operator.
    pub operator: OperatorMeasured,
    #[serde(skip)]
    source: HistorySource,
}

/// The measurements of a robot.
#[derive(Clone, Debug, Serialize)]
pub struct RobotMeasured {
    /// The id of the robot.
    pub robot: RobotId,
    /// The robot's link; `None` if the robot answered no question.
    pub link: Option<LinkMeasured>,
    /// The connections to the robot that broke.
    pub breaks: Vec<Break>,
    /// The robot's clock; `None` without information about it.
    pub clock: Option<ClockMeasured>,
}

/// Why a file contains no measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NothingMeasured {
    /// The file is a journal, which contains only decisions.
    #[error(
        "a journal contains no messages, so delays and losses cannot be measured, and this journal contains no clock offset either; \
         record a mission with `downbeat run --record FILE`"
    )]
    Journal,
    /// The file is a recording that contains nothing to measure.
    #[error(
        "nothing to measure: in this recording, no robot answered a request, no sensor was read and no act waited for the \
         operator"
    )]
    Recording,
}

impl Measured {
    /// Evaluates the data of a recording or a journal.
    ///
    /// # Errors
    /// [`NothingMeasured`] if the world file would be empty.
    pub fn of(history: &History) -> Result<Self, NothingMeasured> {
        let (began, ended) = bounds(history);
        let mut robots: Vec<RobotMeasured> =
            history.robots.iter().map(|robot| RobotMeasured::of(history, robot, (began, ended))).collect();
        robots.sort_by(|a, b| a.robot.cmp(&b.robot));
        let mut sensors: Vec<SensorMeasured> =
            history.robots.iter().flat_map(|robot| told::sensors(robot, began)).collect();
        sensors.sort_by(|a, b| (&a.robot, &a.sensor).cmp(&(&b.robot, &b.sensor)));
        let operator = told::operator(history);
        let of_robots = robots.iter().any(RobotMeasured::says_something);
        if !of_robots && sensors.is_empty() && operator.waits.is_empty() {
            return Err(match history.source {
                HistorySource::Journal => NothingMeasured::Journal,
                HistorySource::Recording => NothingMeasured::Recording,
            });
        }
        Ok(Self {
            scenario: history.scenario.clone(),
            began,
            duration: ended - began,
            cut_off: history.cut_off.clone(),
            robots,
            sensors,
            operator,
            source: history.source,
        })
    }
}

/// Returns the earliest and the latest instant in the data of a file.
fn bounds(history: &History) -> (Timestamp<Server>, Timestamp<Server>) {
    let records = history.records.iter().map(|(at, _)| *at);
    let written = records.chain(history.told.iter().map(|(at, _)| *at));
    let exchanges = history.robots.iter().flat_map(|robot| &robot.exchanges);
    let all = written.chain(exchanges.flat_map(|exchange| [exchange.sent, exchange.received]));
    let (first, last) = all.fold((None, None), |(first, last): (Option<_>, Option<_>), at| {
        (Some(first.map_or(at, |first| at.min(first))), last.max(Some(at)))
    });
    let nothing = Timestamp::from_nanos(0);
    (first.unwrap_or(nothing), last.unwrap_or(nothing))
}

impl RobotMeasured {
    fn of(history: &History, robot: &KnownRobot, bounds: (Timestamp<Server>, Timestamp<Server>)) -> Self {
        let mut exchanges: Vec<Exchange> = robot.exchanges.clone();
        exchanges.sort_by_key(|exchange| (exchange.sent, exchange.received));
        let line = ClockLine::fit(&exchanges);
        let told = RecordedClock::of(history, &robot.id);
        Self {
            robot: robot.id.clone(),
            link: LinkMeasured::of(&exchanges, line.as_ref()),
            breaks: told::breaks(history, &robot.id, bounds.0, bounds.1),
            clock: ClockMeasured::of(&exchanges, line.as_ref(), told, bounds.0),
        }
    }

    const fn says_something(&self) -> bool {
        self.link.is_some() || self.clock.is_some() || !self.breaks.is_empty()
    }
}
