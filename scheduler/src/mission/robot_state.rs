//! What the mission knows of one robot.

use std::collections::HashMap;

use downbeat_scripts::{DeviceScript, RobotPlan};
use serde::Serialize;
use urrcp::{
    ControlError, ControlResponse, DeviceId, ErrorCode, InitializationBlock, OpenRequests, RequestId, Robot,
    RobotId, Server, Span, Status, Timestamp,
};

use super::Participant;
use crate::clock::ClockEstimate;

/// The state of a robot's link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Link {
    Connecting,
    Up,
    Down,
}

/// What became of one device's script.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ScriptPhase {
    Planned,
    Sent,
    Accepted,
    Started,
    Ended,
    Failed(ControlError),
}

/// One device's script and its fate.
#[derive(Clone, Debug)]
pub(crate) struct ScriptState {
    pub(crate) plan: DeviceScript,
    pub(crate) phase: ScriptPhase,
    pub(crate) accepted: bool,
    pub(crate) started_at: Option<Timestamp<Robot>>,
    pub(crate) steps_done: u32,
}

/// One robot of the mission.
#[derive(Debug)]
pub(crate) struct RobotState {
    pub(crate) id: RobotId,
    pub(crate) link: Link,
    pub(crate) block: Option<InitializationBlock>,
    /// The robot has given its own block in this mission.
    pub(crate) introduced: bool,
    pub(crate) clock: ClockEstimate,
    /// The availability request that awaits its response.
    pub(crate) asked_at: Option<Timestamp<Server>>,
    pub(crate) scripts: Vec<ScriptState>,
    /// From request to index in `scripts`.
    pub(crate) open: OpenRequests<usize>,
    /// Stop requests that await their confirmation.
    pub(crate) stops: HashMap<RequestId, DeviceId>,
    pub(crate) stop_sent: bool,
    pub(crate) last_sent: Option<Timestamp<Server>>,
    pub(crate) failures: Vec<Failure>,
}

/// A robot failed the mission.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Failure {
    /// Which robot.
    pub robot: RobotId,
    /// What happened.
    #[serde(flatten)]
    pub kind: FailureKind,
}

/// Ways for a robot to fail the mission.
#[derive(Clone, Debug, PartialEq, Serialize, thiserror::Error)]
#[serde(tag = "failure", rename_all = "snake_case")]
pub enum FailureKind {
    /// The link broke or could not be made.
    #[error("link down: {reason}")]
    LinkDown {
        /// Why.
        reason: String,
    },
    /// It sent what is no message, or one out of place.
    #[error("garbled: {reason}")]
    Garbled {
        /// What is wrong.
        reason: String,
    },
    /// It did not answer in time.
    #[error("silent: no {awaited} within {within}")]
    Silent {
        /// What was awaited.
        awaited: String,
        /// For how long.
        #[serde(rename = "within_ms")]
        within: Span,
    },
    /// Its availability check failed.
    #[error("not available: {error}")]
    NotAvailable {
        /// Its own reason.
        error: ControlError,
    },
    /// Its own description does not fit the plan.
    #[error("does not fit the plan: {reason}")]
    Unfit {
        /// Where it differs.
        reason: String,
    },
    /// Its clock is further off than the scenario tolerates.
    #[error(
        "clock off by {offset} (+-{uncertainty}), the scenario tolerates {tolerance}: check the robot's NTP, or raise start_tolerance"
    )]
    Clock {
        /// Robot minus server.
        #[serde(rename = "offset_ms")]
        offset: Span,
        /// Of the offset.
        #[serde(rename = "uncertainty_ms")]
        uncertainty: Span,
        /// The scenario's start_tolerance.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// It refused or ended a script.
    #[error("device `{device}`: {error}")]
    Script {
        /// Which device.
        device: DeviceId,
        /// The robot's reason.
        error: ControlError,
    },
}

impl RobotState {
    pub(crate) fn new(participant: Participant, plan: &RobotPlan) -> Self {
        let script = |plan: &DeviceScript| ScriptState {
            plan: plan.clone(),
            phase: ScriptPhase::Planned,
            accepted: false,
            started_at: None,
            steps_done: 0,
        };
        Self {
            id: participant.id,
            link: Link::Connecting,
            block: participant.block,
            introduced: false,
            clock: ClockEstimate::default(),
            asked_at: None,
            scripts: plan.scripts.iter().map(script).collect(),
            open: OpenRequests::default(),
            stops: HashMap::new(),
            stop_sent: false,
            last_sent: None,
            failures: Vec::new(),
        }
    }

    pub(crate) fn has_failed(&self) -> bool {
        !self.failures.is_empty()
    }

    /// All its scripts are accepted, or beyond.
    pub(crate) fn has_accepted(&self) -> bool {
        self.scripts.iter().all(|script| script.accepted)
    }

    /// All its scripts have ended as planned.
    pub(crate) fn is_done(&self) -> bool {
        self.scripts.iter().all(|script| script.phase == ScriptPhase::Ended)
    }

    /// Whether it says when scripts start and end.
    pub(crate) fn reports(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.reports)
    }

    /// Takes the answer to a stop request, if it is one.
    pub(crate) fn stop_answered(&mut self, response: &ControlResponse) -> bool {
        let Some(id) = &response.request_id else {
            // A robot that echoes no ids answers in order; after the stops nothing else is open.
            let device = response.device_id.clone();
            let open = self.stops.iter().find(|(_, d)| **d == device).map(|(id, _)| id.clone());
            return match open {
                Some(id) if matches!(response.status, Status::Ok | Status::Accepted) => {
                    self.stops.remove(&id).is_some()
                }
                _ => false,
            };
        };
        match self.stops.contains_key(id) {
            true if response.status == Status::Failed => true,
            true => self.stops.remove(id).is_some(),
            false => false,
        }
    }

    /// Keeps the books true when a script's report comes after the mission has turned to stopping.
    pub(crate) fn note_late_response(&mut self, response: &ControlResponse) {
        let Some((_, &index)) = self.open.find(response) else { return };
        let script = &mut self.scripts[index];
        script.steps_done = script.steps_done.max(response.steps_done.unwrap_or(0));
        match &response.status {
            Status::Accepted => script.accepted = true,
            Status::Started => {
                script.phase = ScriptPhase::Started;
                script.started_at = response.event_timestamp.or(Some(response.timestamp));
            }
            Status::Ok => script.phase = ScriptPhase::Ended,
            Status::Failed => script.phase = ScriptPhase::Failed(error_of(response)),
            Status::Provide | Status::Other(_) => {}
        }
    }
}

/// The reason in a failed response, or a stand-in where the robot gave none.
pub(crate) fn error_of(response: &ControlResponse) -> ControlError {
    let without = || ControlError::new(ErrorCode::Internal, "the robot gave no reason");
    response.error.clone().unwrap_or_else(without)
}
