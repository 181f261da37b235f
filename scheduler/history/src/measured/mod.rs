//! The network, the clocks and the sensors of a mission that was recorded: what a world file needs so that trials use the network
//! as it was. Nothing is read or printed here. `docs/measured.md` has the methods and what they cannot tell.

mod clock;
mod line;
mod link;
#[cfg(test)]
mod tests;
mod told;
mod written;

use serde::Serialize;
use urrcp::{RobotId, Server, Span, Timestamp};

use self::clock::Told;
use self::line::ClockLine;
use crate::history::{Exchange, History, HistorySource, KnownRobot};

pub use self::clock::{ClockMeasured, DriftMeasured, Follows};
pub use self::link::{Interruption, LinkMeasured, Loss, Method, Quantiles};
pub use self::told::{Break, OperatorMeasured, SensorMeasured};
pub use self::written::world_text;

/// What was measured in a mission.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// The scenario's name, if it is known.
    pub scenario: Option<String>,
    /// When the file begins.
    pub began: Timestamp<Server>,
    /// From there to its end.
    #[serde(rename = "duration_ms")]
    pub duration: Span,
    /// Where the file stops being whole, if it does.
    pub cut_off: Option<String>,
    /// By id.
    pub robots: Vec<RobotMeasured>,
    /// By robot and device.
    pub sensors: Vec<SensorMeasured>,
    /// How long acts waited for the operator.
    pub operator: OperatorMeasured,
    #[serde(skip)]
    source: HistorySource,
}

/// What was measured of a robot.
#[derive(Clone, Debug, Serialize)]
pub struct RobotMeasured {
    /// Its id.
    pub robot: RobotId,
    /// Its link; `None`: no question was answered.
    pub link: Option<LinkMeasured>,
    /// Connections that broke.
    pub breaks: Vec<Break>,
    /// Its clock; `None`: nothing tells of it.
    pub clock: Option<ClockMeasured>,
}

/// A file in which nothing was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NothingMeasured {
    /// A journal keeps decisions alone.
    #[error(
        "a journal has no messages, from which delays and losses are measured, and this one tells of no clock offset either; \
         `downbeat run --record FILE` makes a recording"
    )]
    Journal,
    /// A recording without an answer.
    #[error(
        "no robot answered a question in this recording, no sensor was read and no act waited for the operator, so nothing was \
         measured"
    )]
    Recording,
}

impl Measured {
    /// Measures what a recording or a journal has kept.
    ///
    /// # Errors
    /// [`NothingMeasured`] where a world file would say nothing.
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

/// The first and the last instant of a file.
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
        let told = Told::of(history, &robot.id);
        Self {
            robot: robot.id.clone(),
            link: LinkMeasured::of(&exchanges, line.as_ref()),
            breaks: told::breaks(history, &robot.id, bounds),
            clock: ClockMeasured::of(&exchanges, line.as_ref(), told, bounds.0),
        }
    }

    const fn says_something(&self) -> bool {
        self.link.is_some() || self.clock.is_some() || !self.breaks.is_empty()
    }
}
