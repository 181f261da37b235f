//! The records that a mission writes to its journal. After a crash, they show which scripts were promised to which robot.

use serde::{Deserialize, Serialize};
use urrcp::{ContentHash, DeviceId, Millis, RequestId, RobotId, Server, Span, Timestamp};

use super::facts::is_zero;
use super::{ActFate, ActIndex, ActNumber, ActReport, Failure, Outcome, Rest};

/// A line of the journal.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "record", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Record {
    /// The mission has begun.
    Begun,
    /// The fleet has been checked. From this record on, acts begin or wait.
    Checked,
    /// The operator permits a waiting act to begin.
    Go {
        /// Name of the act.
        act: String,
        /// The operator who sent the go, if another operator started the mission.
        #[serde(skip_serializing_if = "Option::is_none")]
        by: Option<String>,
    },
    /// Requests of an act are about to be sent.
    Prepared(Promise),
    /// All robots of an act have accepted their scripts.
    Decided {
        /// The number of the act.
        number: ActNumber,
        /// Robots that do not recognize requests by their ids.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        unnamed: Vec<RobotId>,
        /// The length of the interval before the start in which the mission may notice too late that a robot has gone silent.
        #[serde(rename = "doubt_ms")]
        doubt: Span,
    },
    /// An act is committed: leases may now be extended beyond its start. Shortened leases end long before another process can read this
    /// record. The record may therefore be written before every robot has confirmed that it holds its scripts.
    Committed {
        /// The number of the act.
        number: ActNumber,
    },
    /// An act lapses while another act plays: it is not committed, and its leases end. This applies even if its commitment was recorded
    /// ahead of time.
    Lapsing {
        /// The number of the act.
        number: ActNumber,
    },
    /// A script is about to be sent with another offset for its robot's clock than the promise states, because that clock drifts.
    Translated {
        /// The request's id.
        request_id: RequestId,
        /// The offset added to the request's timestamp.
        #[serde(rename = "shift_ms")]
        shift: Span,
    },
    /// A robot has failed.
    Failed(Failure),
    /// A robot is left out of the mission.
    Dropped {
        /// The robot's id.
        robot: RobotId,
    },
    /// Stops have been sent: they are sent first and recorded afterwards.
    Stopping {
        /// The outcome that the mission will have.
        outcome: Outcome,
        /// How robots come to rest.
        rest: Rest,
        /// The operator who requested the stop, if another operator started the mission.
        #[serde(skip_serializing_if = "Option::is_none")]
        by: Option<String>,
    },
    /// A robot has confirmed its stop.
    StopConfirmed {
        /// The robot's id.
        robot: RobotId,
    },
    /// An act is over.
    ActEnded {
        /// The report of the act.
        report: Box<ActReport>,
        /// Flaws that rule out the outcome `done`.
        #[serde(flatten)]
        flaws: ActFlaws,
        /// The act's entry in the course of the mission.
        #[serde(flatten)]
        over: ActOver,
        /// Whether the act was withdrawn before anything moved, to be prepared again.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        again: bool,
    },
    /// An act was not played.
    ActSkipped(ActOver),
    /// The mission is over.
    Ended {
        /// The outcome of the mission.
        outcome: Outcome,
    },
}

impl Record {
    /// Whether the record must be on disk to survive a power failure. This holds for promises and commitments, and for the stop and the
    /// end of a mission.
    #[must_use]
    pub const fn is_durable(&self) -> bool {
        match self {
            Self::Begun
            | Self::Prepared(_)
            | Self::Committed { .. }
            | Self::Stopping { .. }
            | Self::Ended { .. } => true,
            Self::Checked
            | Self::Go { .. }
            | Self::Decided { .. }
            | Self::Lapsing { .. }
            | Self::Translated { .. }
            | Self::Failed(_)
            | Self::Dropped { .. }
            | Self::StopConfirmed { .. }
            | Self::ActEnded { .. }
            | Self::ActSkipped(_) => false,
        }
    }
}

/// The text that follows the time in the JSON of a [`Record::ActEnded`].
pub(super) const ENDED_ACT: &[u8] = br#","record":"act_ended","#;

/// The fields of [`Record::ActEnded`]. The type `Report` determines which fields of the report are read.
#[derive(Deserialize)]
pub(super) struct EndedAct<Report> {
    pub(super) report: Report,
    #[serde(flatten)]
    pub(super) flaws: ActFlaws,
    #[serde(flatten)]
    pub(super) over: ActOver,
    #[serde(default)]
    pub(super) again: bool,
}

/// The fate of an ended act of the scenario, recorded for a process that takes over the mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActOver {
    /// Index of the act in the choreography.
    pub act: ActIndex,
    /// The fate of the act.
    #[serde(flatten)]
    pub fate: ActFate,
}

/// Flaws of an act that rule out the outcome `done`. They are recorded because a process that takes over the mission has not observed
/// them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActFlaws {
    /// The robots of the act that have a script whose fate is unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unaccounted: Vec<RobotId>,
    /// Set if starts were further apart, or further off the plan, than the scenario allows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub out_of_tolerance: Option<OutOfTolerance>,
    /// Set if steps were later than the scenario allows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_late: Option<StepsLate>,
}

/// Starts that were further apart, or further off the plan, than allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutOfTolerance {
    /// The actual spread of the starts.
    #[serde(rename = "spread_ms")]
    pub spread: Span,
    /// The allowed spread.
    #[serde(rename = "tolerance_ms")]
    pub tolerance: Span,
}

/// Steps that were later than allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StepsLate {
    /// The largest lateness of a step.
    #[serde(rename = "late_ms")]
    pub late: Span,
    /// The lateness that the scenario allows.
    #[serde(rename = "tolerance_ms")]
    pub tolerance: Span,
}

/// The promise that a mission makes to the robots of an act: its scripts, and when they start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Promise {
    /// The number of the act in the mission.
    pub number: ActNumber,
    /// Index of the act in the choreography.
    pub act: ActIndex,
    /// The sending timestamp that all requests share.
    pub timestamp: Timestamp<Server>,
    /// The start of the act's first cue.
    pub start: Timestamp<Server>,
    /// The pending lease of the requests.
    #[serde(rename = "lease_ms")]
    pub lease: Span,
    /// How often the act was withdrawn before this attempt.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub prepared_again: u32,
    /// The promised scripts of all robots.
    pub scripts: Vec<PromisedScript>,
}

/// A script that was or will be sent to a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PromisedScript {
    /// Id of the robot.
    pub robot: RobotId,
    /// Id of the device.
    pub device: DeviceId,
    /// The request's id.
    pub request_id: RequestId,
    /// The hash of the request's content, which is bound to the request's id.
    pub content_hash: ContentHash,
    /// The offset added to the request's timestamp for this robot's clock.
    #[serde(rename = "shift_ms")]
    pub shift: Span,
    /// The start of the script, relative to the act's start.
    pub start: Millis,
    /// The playing time of the script.
    #[serde(rename = "duration_ms")]
    pub duration: Span,
    /// The running lease of the script; `None` if the script continues without a link.
    pub running: Option<Millis>,
}
