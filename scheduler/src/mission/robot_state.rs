//! What the mission knows of one robot.

use std::collections::{BTreeSet, HashMap};

use downbeat_scripts::{DeviceScript, SensorRange};
use serde::Serialize;
use urrcp::{
    ControlError, ControlResponse, DeviceId, Encoding, ErrorCode, InitializationBlock, OpenRequests,
    RequestId, Robot, RobotId, Server, Span, Status, Timestamp,
};

use super::{ClockMode, Participant, Requirement};
use crate::clock::{ClockEstimate, ClockReading};

/// The state of a robot's link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Link {
    Connecting,
    Up,
    /// Broken, and why.
    Down(String),
}

/// Whether a robot takes part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Standing {
    In,
    /// Not there when the mission began; may join at the next act.
    Absent,
    /// It failed, and the others went on or were stopped.
    Out,
}

/// What became of one script.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ScriptPhase {
    Planned,
    Sent,
    Accepted,
    Started,
    Ended,
    Failed(ControlError),
}

/// One script and its fate.
#[derive(Clone, Debug)]
pub(crate) struct ScriptState {
    pub(crate) plan: DeviceScript,
    pub(crate) phase: ScriptPhase,
    pub(crate) accepted: bool,
    pub(crate) started_at: Option<Timestamp<Robot>>,
    pub(crate) steps_done: u32,
    pub(crate) late_steps: u32,
    pub(crate) request_id: Option<RequestId>,
    /// Asked again for a report that is overdue.
    pub(crate) probed: bool,
    /// Asked for by its name alone: who does not know the name answers for an empty script.
    pub(crate) asked_by_name: bool,
    /// When, by the server's clock and at the latest, the robot last said that it holds it.
    pub(crate) held_at: Option<Timestamp<Server>>,
}

impl ScriptState {
    pub(crate) fn new(plan: &DeviceScript) -> Self {
        Self {
            plan: plan.clone(),
            phase: ScriptPhase::Planned,
            accepted: false,
            started_at: None,
            steps_done: 0,
            late_steps: 0,
            request_id: None,
            probed: false,
            asked_by_name: false,
            held_at: None,
        }
    }

    pub(crate) const fn is_final(&self) -> bool {
        matches!(self.phase, ScriptPhase::Ended | ScriptPhase::Failed(_))
    }

    /// The robot holds it, or may hold it.
    pub(crate) const fn is_out(&self) -> bool {
        matches!(self.phase, ScriptPhase::Sent | ScriptPhase::Accepted | ScriptPhase::Started)
    }

    /// The robot said that it began.
    pub(crate) const fn has_begun(&self) -> bool {
        self.started_at.is_some()
            || self.steps_done > 0
            || matches!(self.phase, ScriptPhase::Started | ScriptPhase::Ended)
    }

    /// Takes an answer, in whatever order answers come. `true` where it is news.
    pub(crate) fn note(&mut self, response: &ControlResponse) -> bool {
        let before = self.phase.clone();
        self.steps_done = self.steps_done.max(response.steps_done.unwrap_or(0));
        self.late_steps = self.late_steps.max(response.late_steps.unwrap_or(0));
        match &response.status {
            Status::Accepted => {
                self.accepted = true;
                if self.phase == ScriptPhase::Sent {
                    self.phase = ScriptPhase::Accepted;
                }
            }
            Status::Started => {
                self.accepted = true;
                let first = self.started_at.is_none();
                self.started_at = self.started_at.or(response.event_timestamp).or(Some(response.timestamp));
                if !self.is_final() {
                    self.phase = ScriptPhase::Started;
                }
                return first;
            }
            // The answer to an empty script under its name, from a robot that does not know the name any more.
            Status::Ok if self.asked_by_name && response.steps_done.is_none() && !self.is_final() => {
                let message = "the robot has lost the script, as after a restart";
                self.phase = ScriptPhase::Failed(ControlError::new(ErrorCode::Internal, message));
            }
            Status::Ok if !self.is_final() => {
                self.accepted = true;
                self.phase = ScriptPhase::Ended;
                let all = u32::try_from(self.plan.script.steps().len()).unwrap_or(u32::MAX);
                self.steps_done = response.steps_done.unwrap_or(all);
            }
            Status::Failed if !self.is_final() => self.phase = ScriptPhase::Failed(error_of(response)),
            _ => {}
        }
        self.phase != before
    }
}

/// What a reading is for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Reading {
    /// A requirement of the fleet file, by its index.
    Requirement(usize),
    /// Where a device stands before the first act.
    Position(DeviceId),
    /// An act waits for it: the act's number.
    Wait(u32),
    /// The scenario reads it: the act's number, and which of its readings.
    Planned(u32, usize),
}

/// Sums over the acts that have ended.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Totals {
    pub(crate) scripts: usize,
    pub(crate) accepted: usize,
    pub(crate) started: usize,
    pub(crate) steps_done: u64,
    pub(crate) steps_planned: u64,
    pub(crate) late_steps: u64,
    pub(crate) start_error: Option<Span>,
    /// Scripts that were sent and of which nobody knows what became of them.
    pub(crate) unaccounted: usize,
    pub(crate) retries: u32,
    pub(crate) reconnects: u32,
}

/// One robot of the mission.
#[derive(Debug)]
pub(crate) struct RobotState {
    pub(crate) id: RobotId,
    pub(crate) link: Link,
    /// Why its link broke, until it is heard again.
    pub(crate) broken: Option<String>,
    pub(crate) standing: Standing,
    pub(crate) block: Option<InitializationBlock>,
    /// The robot has given its own block in this mission.
    pub(crate) introduced: bool,
    pub(crate) clock_mode: ClockMode,
    pub(crate) wake_up: Span,
    pub(crate) encoding: Encoding,
    /// What was last added to a timestamp so that it is right by its own clock.
    pub(crate) shift: Span,
    pub(crate) clock: ClockEstimate,
    /// The question for its times that has not been answered.
    pub(crate) asked_at: Option<Timestamp<Server>>,
    pub(crate) requires: Vec<Requirement>,
    /// Of `requires`, in its order.
    pub(crate) readings: Vec<Option<f64>>,
    /// Where devices stood before the first act.
    pub(crate) positions: Vec<(DeviceId, f64)>,
    pub(crate) reads: HashMap<RequestId, Reading>,
    /// When the newest message was sent that it has surely received.
    pub(crate) renewed_at: Option<Timestamp<Server>>,
    /// From request to (number of the act, member, script).
    pub(crate) open: OpenRequests<(u32, usize, usize)>,
    /// Devices that this mission has sent anything that moves.
    pub(crate) touched: BTreeSet<DeviceId>,
    /// Stop requests that await their confirmation.
    pub(crate) stops: HashMap<RequestId, DeviceId>,
    pub(crate) stop_sent: bool,
    pub(crate) stop_recorded: bool,
    /// It names the requests that it answers, so it knows them by their names.
    pub(crate) echoes: bool,
    pub(crate) hold: bool,
    /// When what it still held at the end of an act ends by its own leases; `None` where it has none.
    pub(crate) left: Vec<Option<Timestamp<Server>>>,
    pub(crate) last_sent: Option<Timestamp<Server>>,
    /// Its link is being made anew.
    pub(crate) reconnecting: bool,
    /// Attempts to reach it since its link was last up.
    pub(crate) attempts: u32,
    /// When its link broke in mid-mission, and when it is given up.
    pub(crate) give_up: Option<Timestamp<Server>>,
    pub(crate) failures: Vec<Failure>,
    pub(crate) totals: Totals,
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
    /// A sensor does not read what the fleet file requires.
    #[error("`{sensor}` reads {reading}, the fleet file requires {range}", reading = reading.map_or_else(|| "nothing".to_owned(), |r| r.to_string()))]
    Requirement {
        /// Which sensor.
        sensor: DeviceId,
        /// What it read.
        reading: Option<f64>,
        /// What is required.
        range: SensorRange,
    },
    /// A device stands where its first keyframe does not expect it.
    #[error(
        "device `{device}` stands at {reading}, its first keyframe expects {expected}: bring it there, or give the first keyframe a time"
    )]
    Position {
        /// Which device.
        device: DeviceId,
        /// Where it stands.
        reading: f64,
        /// Where it should.
        expected: f64,
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

/// The pause before the first attempt to reach a robot again; doubled with every attempt.
const RETRY_AFTER: Span = Span::from_millis(50);
const RETRY_AFTER_MAX: Span = Span::from_millis(1_000);

impl RobotState {
    /// The pause before the next attempt to reach it, which is counted.
    pub(crate) fn next_attempt(&mut self) -> Span {
        let after = RETRY_AFTER * (1 << self.attempts.min(8));
        self.attempts += 1;
        after.min(RETRY_AFTER_MAX)
    }

    pub(crate) fn new(participant: Participant) -> Self {
        Self {
            id: participant.id,
            link: Link::Connecting,
            broken: None,
            standing: Standing::In,
            block: participant.block,
            introduced: false,
            clock_mode: participant.clock,
            wake_up: participant.wake_up,
            encoding: participant.encoding,
            shift: Span::ZERO,
            clock: ClockEstimate::default(),
            asked_at: None,
            readings: vec![None; participant.requires.len()],
            requires: participant.requires,
            positions: Vec::new(),
            reads: HashMap::new(),
            renewed_at: None,
            open: OpenRequests::default(),
            touched: BTreeSet::new(),
            stops: HashMap::new(),
            stop_sent: false,
            stop_recorded: false,
            echoes: false,
            hold: false,
            left: Vec::new(),
            last_sent: None,
            reconnecting: false,
            attempts: 0,
            give_up: None,
            failures: Vec::new(),
            totals: Totals::default(),
        }
    }

    pub(crate) fn is_up(&self) -> bool {
        self.link == Link::Up
    }

    pub(crate) fn has_failed(&self) -> bool {
        !self.failures.is_empty()
    }

    /// Its clock at an instant.
    pub(crate) fn clock_at(&self, at: Timestamp<Server>) -> Option<ClockReading> {
        self.clock.reading_at(at)
    }

    /// Whether it says when scripts start and end.
    pub(crate) fn reports(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.reports)
    }

    /// How many scripts one of its devices holds.
    pub(crate) fn queue_of(&self, device: &DeviceId) -> usize {
        let device = self.block.as_ref().and_then(|block| block.device(device.as_str()));
        device.map_or(1, |device| device.script_queue as usize)
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

    /// Every device that was sent anything is known to be at rest.
    pub(crate) fn stop_confirmed(&self) -> bool {
        self.stop_sent && self.stops.is_empty()
    }
}

/// The reason in a failed response, or a stand-in where the robot gave none.
pub(crate) fn error_of(response: &ControlResponse) -> ControlError {
    let without = || ControlError::new(ErrorCode::Internal, "the robot gave no reason");
    response.error.clone().unwrap_or_else(without)
}
