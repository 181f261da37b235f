//! The report of a direct stop: what is known of a mission that another process played.

use serde::Serialize;
use urrcp::{RobotId, SessionId};

use super::{Outcome, Report, RobotReport, StopState};
use crate::Failure;

/// What a direct stop knows. What the mission played before is not known, so none of the keys of that are there.
#[derive(Clone, Debug, Serialize)]
pub struct Withdrawal<'a> {
    scenario: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    session: Option<&'a SessionId>,
    outcome: &'a Outcome,
    #[serde(skip_serializing_if = "Option::is_none")]
    because: Option<&'a str>,
    robots: Vec<WithdrawnRobot<'a>>,
    failures: &'a [Failure],
    #[serde(skip_serializing_if = "<[String]>::is_empty")]
    not_at_rest: &'a [String],
}

#[derive(Clone, Debug, Serialize)]
struct WithdrawnRobot<'a> {
    robot: &'a RobotId,
    retries: u32,
    reconnects: u32,
    stop: StopState,
}

impl<'a> From<&'a Report> for Withdrawal<'a> {
    fn from(report: &'a Report) -> Self {
        Self {
            scenario: &report.scenario,
            session: report.session.as_ref(),
            outcome: &report.outcome,
            because: report.because.as_deref(),
            robots: report.robots.iter().map(WithdrawnRobot::from).collect(),
            failures: &report.failures,
            not_at_rest: &report.not_at_rest,
        }
    }
}

impl<'a> From<&'a RobotReport> for WithdrawnRobot<'a> {
    fn from(robot: &'a RobotReport) -> Self {
        Self { robot: &robot.robot, retries: robot.retries, reconnects: robot.reconnects, stop: robot.stop }
    }
}
