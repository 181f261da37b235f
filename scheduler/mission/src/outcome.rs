//! The outcome of a mission.

use std::fmt;

use serde::{Deserialize, Serialize};
use urrcp::{Server, Span, Timestamp};

use super::LeadTime;

/// The outcome of a mission, as far as it is known, and its reason.
#[derive(Debug, Default)]
pub(super) struct Conclusion {
    pub(super) outcome: Option<Outcome>,
    /// The reason for the stop, if neither the outcome nor a failure of a robot states it.
    pub(super) because: Option<String>,
    /// The operator who stopped the mission, if another operator started it.
    pub(super) said_stop: Option<String>,
    /// The outcome of the first failure in the course of the mission. Later events do not change it.
    pub(super) flawed: Option<Outcome>,
    /// The outcome that follows from the first act whose starts were too far apart or whose steps were too late.
    pub(super) flaw_of_times: Option<Outcome>,
}

/// Why another process withdraws a mission.
#[derive(Clone, Debug, PartialEq)]
pub struct Cause {
    /// The outcome; a withdrawal corrects it if it contradicts the movements of robots.
    pub outcome: Outcome,
    /// The reason, as text for users.
    pub reason: String,
}

/// The outcome of a mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Outcome {
    /// All robots started together and finished.
    Done,
    /// Robots that failed were left out, according to `on_failure`. The other robots finished.
    DoneWithout,
    /// The mission finished, but acts were left out because their condition was not met.
    DoneSkipping {
        /// The names of the acts that were left out.
        acts: Vec<String>,
    },
    /// The mission was played to its end, but starts were further apart, or further off the plan, than the scenario tolerates. Clocks
    /// that drift by more than this tolerance during the mission have the same outcome.
    OutOfTolerance {
        /// The spread of the starts of an act, or the largest start error, by the robots' own clocks.
        #[serde(rename = "spread_ms")]
        spread: Span,
        /// The scenario's `start_tolerance`.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// The mission was played to its end, but steps were later than the scenario tolerates.
    StepsLate {
        /// The largest lateness of a step, by its robot's own clock.
        #[serde(rename = "late_ms")]
        late: Span,
        /// The scenario's `start_tolerance`.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// The mission was played to its end, as far as known. Some robots cannot report what they did.
    Unknown,
    /// The fleet is checked and nothing was sent.
    Ready,
    /// The fleet is checked, and must not start.
    NotReady,
    /// No robot started.
    NotStarted,
    /// The mission started, then a robot failed, and all robots were stopped.
    Failed,
    /// The operator stopped the mission.
    Stopped,
    /// The operator left without waiting for the stop to be confirmed.
    Abandoned,
    /// The requested lead time is too short; nothing was sent.
    LeadTooShort {
        /// The requested lead time.
        #[serde(rename = "lead_ms")]
        lead: Span,
        /// The lead time that this fleet needs.
        needed: LeadTime,
        /// The earliest start that would have been safe.
        safe_start: Timestamp<Server>,
    },
    /// The requested start has passed, or is too soon; nothing was sent.
    StartTooSoon {
        /// The requested start.
        start: Timestamp<Server>,
        /// The earliest start that would have been safe.
        safe_start: Timestamp<Server>,
    },
    /// The requested pending lease is too short; nothing was sent.
    LeaseTooShort {
        /// The requested lease.
        #[serde(rename = "lease_ms")]
        lease: Span,
        /// The lease that the measured delays need.
        #[serde(rename = "needed_ms")]
        needed: Span,
    },
    /// The journal cannot be written, or its disk has stalled. The mission can promise no further scripts to robots, and all robots were
    /// stopped.
    JournalLost {
        /// The reason why the journal was lost, as text for users.
        reason: String,
    },
    /// The scheduler itself was delayed, and decided too late whether an act starts; no robot started.
    DecisionLate {
        /// The delay of the decision.
        #[serde(rename = "by_ms")]
        by: Span,
    },
    /// The scheduler itself or its disk was delayed, and an act was committed too late; no robot started.
    CommitmentLate {
        /// The minimum delay of the commitment; zero if unknown.
        #[serde(rename = "by_ms")]
        by: Span,
    },
}

impl Outcome {
    /// Whether the outcome states that nothing was sent or that no robot started.
    pub(super) const fn denies_any_start(&self) -> bool {
        matches!(
            self,
            Self::NotStarted
                | Self::LeadTooShort { .. }
                | Self::StartTooSoon { .. }
                | Self::LeaseTooShort { .. }
                | Self::DecisionLate { .. }
                | Self::CommitmentLate { .. }
        )
    }

    /// The cause of the scheduler's delay, as text for users, if an act was withdrawn because of that delay.
    pub(crate) fn hold_up(&self) -> Option<String> {
        let (what, late) = match self {
            Self::DecisionLate { by } => ("this machine was delayed, and the decision", (*by, "")),
            Self::CommitmentLate { by } => {
                ("this machine or its disk was delayed, and the commitment", (*by, " or more"))
            }
            _ => return None,
        };
        Some(match late {
            (Span::ZERO, _) => format!("{what} came too late; {LESS_TO_DO}"),
            (by, or_more) => format!("{what} came {by}{or_more} too late; {LESS_TO_DO}"),
        })
    }
}

const LESS_TO_DO: &str = "reduce the load on this machine during missions";

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Done => f.write_str("done"),
            Self::DoneWithout => f.write_str("done, without the robots that failed"),
            Self::DoneSkipping { acts } => {
                let acts: Vec<_> = acts.iter().map(|act| format!("`{act}`")).collect();
                write!(f, "done, but skipped {}", acts.join(", "))
            }
            Self::OutOfTolerance { spread, tolerance } => write!(
                f,
                "played to the end, but out of tolerance: robots started {spread} apart or off schedule; start_tolerance is {tolerance}"
            ),
            Self::StepsLate { late, tolerance } => write!(
                f,
                "played to the end, but steps were up to {late} late; start_tolerance is {tolerance}"
            ),
            Self::Unknown => {
                f.write_str("played to the end as far as known: some robots do not report their progress")
            }
            Self::Ready => f.write_str("ready, nothing was sent"),
            Self::NotReady => f.write_str("not ready, nothing was sent"),
            Self::NotStarted => f.write_str("not started"),
            Self::Failed => f.write_str("failed and stopped"),
            Self::Stopped => f.write_str("stopped by the operator"),
            Self::Abandoned => f.write_str("the operator exited before the stop was confirmed"),
            Self::LeadTooShort { lead, needed, safe_start } => write!(
                f,
                "not sent: the lead of {lead} is too short, because this fleet needs {} ({} to prepare, {} lease, {} margin); the earliest safe start was {safe_start}",
                needed.total(),
                needed.prepare,
                needed.lease,
                needed.margin
            ),
            Self::StartTooSoon { start, safe_start } => write!(
                f,
                "not sent: the start at {start} has passed or is too soon; the earliest safe start was {safe_start}"
            ),
            Self::LeaseTooShort { lease, needed } => write!(
                f,
                "not sent: a pending stop_condition of {lease} is too short; the measured delays require {needed}"
            ),
            Self::JournalLost { reason } => write!(f, "stopped: {reason}"),
            Self::DecisionLate { .. } | Self::CommitmentLate { .. } => {
                write!(f, "not started: {}", self.hold_up().unwrap_or_default())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_delay_is_reported_without_a_number() {
        let told = |by| Outcome::CommitmentLate { by }.to_string();
        let begin = "not started: this machine or its disk was delayed, and the commitment came ";
        assert_eq!(told(Span::ZERO), format!("{begin}too late; {LESS_TO_DO}"));
        assert_eq!(told(Span::from_millis(3)), format!("{begin}3 ms or more too late; {LESS_TO_DO}"));
        assert_eq!(Outcome::Failed.hold_up(), None);
    }
}
