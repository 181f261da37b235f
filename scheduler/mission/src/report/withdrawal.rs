//! The report of a direct stop: the available information about a mission that another process played.

use serde::{Deserialize, Serialize};
use urrcp::{RobotId, SessionId};

use super::{Outcome, Report, RobotReport, StopState};
use crate::Failure;

/// The report of a direct stop. A direct stop does not know the earlier course of the mission, so the keys for that are missing. The
/// report of a mission contains all keys of this report, so both can be read in the same way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Withdrawal {
    /// The scenario's name.
    pub scenario: String,
    /// The session for which robots were driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionId>,
    /// The outcome of the mission.
    pub outcome: Outcome,
    /// The reason for the stop, if neither the outcome nor a failure states it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub because: Option<String>,
    /// The results of each robot, in the order of the fleet.
    pub robots: Vec<WithdrawnRobot>,
    /// The failures of the robots, in order.
    pub failures: Vec<Failure>,
    /// Robots driven by the process itself whose hardware may not be at rest, each with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_at_rest: Vec<String>,
}

/// The results of one robot in the report of a direct stop.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct WithdrawnRobot {
    /// Id of the robot.
    pub robot: RobotId,
    /// Number of requests that were sent again.
    pub retries: u32,
    /// Number of times that the link to the robot was re-established.
    pub reconnects: u32,
    /// The state of the robot's stop.
    pub stop: StopState,
}

impl Withdrawal {
    /// Whether a robot may move although a stop was requested.
    #[must_use]
    pub fn is_unconfirmed(&self) -> bool {
        !self.not_at_rest.is_empty() || self.robots.iter().any(|robot| robot.stop.is_unconfirmed())
    }
}

impl From<&Report> for Withdrawal {
    fn from(report: &Report) -> Self {
        Self {
            scenario: report.scenario.clone(),
            session: report.session.clone(),
            outcome: report.outcome.clone(),
            because: report.because.clone(),
            robots: report.robots.iter().map(WithdrawnRobot::from).collect(),
            failures: report.failures.clone(),
            not_at_rest: report.not_at_rest.clone(),
        }
    }
}

impl From<&RobotReport> for WithdrawnRobot {
    fn from(robot: &RobotReport) -> Self {
        let RobotReport { robot, retries, reconnects, stop, .. } = robot;
        Self { robot: robot.clone(), retries: *retries, reconnects: *reconnects, stop: *stop }
    }
}
