//! The report of a direct stop: what is known of a mission that another process played.

use serde::{Deserialize, Serialize};
use urrcp::{RobotId, SessionId};

use super::{Outcome, Report, RobotReport, StopState};
use crate::Failure;

/// What a direct stop knows. What the mission played before is not known, so none of the keys of that are there. The report of a
/// mission contains all keys of this one, so a stop reads both alike.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Withdrawal {
    /// The scenario's name.
    pub scenario: String,
    /// The session on whose behalf robots were driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionId>,
    /// How it ended.
    pub outcome: Outcome,
    /// Why it was stopped, if neither the outcome nor a failure states the reason.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub because: Option<String>,
    /// In the order of the fleet.
    pub robots: Vec<WithdrawnRobot>,
    /// In order.
    pub failures: Vec<Failure>,
    /// Robots driven in the process whose hardware may not be at rest, each with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_at_rest: Vec<String>,
}

/// What a direct stop knows of a robot.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct WithdrawnRobot {
    /// Its id.
    pub robot: RobotId,
    /// Requests sent again.
    pub retries: u32,
    /// How often its link was made again.
    pub reconnects: u32,
    /// What became of its stop.
    pub stop: StopState,
}

impl Withdrawal {
    /// Whether a robot may move although it was to be stopped.
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
