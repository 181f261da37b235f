//! What a mission writes down: enough to know after a crash what was promised to whom.

use serde::{Deserialize, Serialize};
use urrcp::{ContentHash, DeviceId, Millis, RequestId, RobotId, Server, Span, Timestamp};

use super::facts::is_zero;
use super::{ActFate, ActReport, Failure, Outcome, Rest};

/// A line of the journal.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "record", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Record {
    /// The mission has begun.
    Begun,
    /// The fleet is checked: acts begin, or wait.
    Checked,
    /// The operator lets an act begin that waited for that.
    Go {
        /// Which act.
        act: String,
        /// Who has said so, where that is another operator than who began the mission.
        #[serde(skip_serializing_if = "Option::is_none")]
        by: Option<String>,
    },
    /// Requests of an act are about to be sent.
    Prepared(Promise),
    /// All have accepted.
    Decided {
        /// The number of the act.
        number: u32,
        /// Robots that do not know requests by their names.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        unnamed: Vec<RobotId>,
        /// A robot that goes silent without a word later than so long before the start may be noticed too late.
        #[serde(rename = "doubt_ms")]
        doubt: Span,
    },
    /// From now on leases may be carried over the start. Leases that were shortened end long before another process can read
    /// this, so it may be written before every robot has said that it holds its scripts.
    Committed {
        /// The number of the act.
        number: u32,
    },
    /// An act lapses while another act plays. It is not committed, even if its commitment was recorded ahead of time.
    Lapsing {
        /// The number of the act.
        number: u32,
    },
    /// A script is about to be sent with another offset for its robot's clock than the promise states, because that clock drifts.
    Translated {
        /// The request's id.
        request_id: RequestId,
        /// The offset that is added to its timestamp.
        #[serde(rename = "shift_ms")]
        shift: Span,
    },
    /// A robot has failed.
    Failed(Failure),
    /// A robot is left out.
    Dropped {
        /// The robot's id.
        robot: RobotId,
    },
    /// Stops have been sent: they go out first and are recorded afterwards.
    Stopping {
        /// The outcome that the mission will have.
        outcome: Outcome,
        /// How robots come to rest.
        rest: Rest,
        /// Who has said so, where that is another operator than who began the mission.
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
        /// What became of it.
        report: Box<ActReport>,
        /// What of it keeps the mission from being called done.
        #[serde(flatten)]
        flaws: ActFlaws,
        /// For the course of the mission.
        #[serde(flatten)]
        over: ActOver,
        /// Whether it was withdrawn before anything moved, to be prepared again.
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
    /// Whether it has to be on the disk, as a power failure leaves it: what is promised and committed, and that a mission is
    /// being stopped or has ended.
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

/// The beginning of the JSON of [`Record::ActEnded`], behind the time of its line.
pub(super) const ENDED_ACT: &[u8] = br#","record":"act_ended","#;

/// The fields of [`Record::ActEnded`], with as much of its report as `Report` reads.
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

/// An act of the scenario is over, so that another process can tell what became of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActOver {
    /// Its index in the choreography.
    pub act: usize,
    /// What became of it.
    #[serde(flatten)]
    pub fate: ActFate,
}

/// What keeps a mission from being called done: another process that takes it up has not seen it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActFlaws {
    /// Robots that had a part in it, of which nobody knows what they did of a script.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unaccounted: Vec<RobotId>,
    /// Starts were further apart, or from their plan, than the scenario allows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub out_of_tolerance: Option<OutOfTolerance>,
    /// Steps were later than the scenario allows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_late: Option<StepsLate>,
}

/// Starts that were further apart, or from their plan, than allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutOfTolerance {
    /// By how much.
    #[serde(rename = "spread_ms")]
    pub spread: Span,
    /// What is allowed.
    #[serde(rename = "tolerance_ms")]
    pub tolerance: Span,
}

/// Steps that were later than allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StepsLate {
    /// How late the latest of them was.
    #[serde(rename = "late_ms")]
    pub late: Span,
    /// The lateness that the scenario allows.
    #[serde(rename = "tolerance_ms")]
    pub tolerance: Span,
}

/// What is promised to the robots of an act.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Promise {
    /// The number of the act in the mission.
    pub number: u32,
    /// Its index in the choreography.
    pub act: usize,
    /// The sending timestamp.
    pub timestamp: Timestamp<Server>,
    /// When the first cue starts.
    pub start: Timestamp<Server>,
    /// The pending lease.
    #[serde(rename = "lease_ms")]
    pub lease: Span,
    /// How often the act was withdrawn before this attempt.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub prepared_again: u32,
    /// To whom what.
    pub scripts: Vec<PromisedScript>,
}

/// One script that a robot was or will be sent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PromisedScript {
    /// Which robot.
    pub robot: RobotId,
    /// Which of its devices.
    pub device: DeviceId,
    /// The request's id.
    pub request_id: RequestId,
    /// What it was bound to.
    pub content_hash: ContentHash,
    /// What was added to the timestamp for this robot's clock.
    #[serde(rename = "shift_ms")]
    pub shift: Span,
    /// From the act's start.
    pub start: Millis,
    /// How long it plays.
    #[serde(rename = "duration_ms")]
    pub duration: Span,
    /// The running lease; `None`: it goes on without a link.
    pub running: Option<Millis>,
}
