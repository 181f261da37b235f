//! How a mission ended.

use std::fmt;

use serde::{Deserialize, Serialize};
use urrcp::{Server, Span, Timestamp};

use super::LeadTime;

/// How a mission ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Outcome {
    /// All robots started together and came to their end.
    Done,
    /// The others came to their end; robots that failed were left out, as `on_failure` says.
    DoneWithout,
    /// It came to its end, and acts were left out on the way: what they waited for did not come.
    DoneSkipping {
        /// The names of these acts.
        acts: Vec<String>,
    },
    /// It was played to its end, but starts were further apart, or further from their plan, than the scenario tolerates, or clocks
    /// drifted by more than that while it played.
    OutOfTolerance {
        /// How far apart the starts of an act were, or how far one was from its plan, by the robots' own clocks.
        #[serde(rename = "spread_ms")]
        spread: Span,
        /// The scenario's start_tolerance.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// It was played to its end, but steps were later than the scenario tolerates.
    StepsLate {
        /// How late the latest step was, by its robot's own clock.
        #[serde(rename = "late_ms")]
        late: Span,
        /// The scenario's start_tolerance.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// It was played to its end, as far as is known: some robots cannot say what they did.
    Unknown,
    /// The fleet is checked and nothing was sent.
    Ready,
    /// The fleet is checked, and would not start.
    NotReady,
    /// None started.
    NotStarted,
    /// It started, then a robot failed, and all were stopped.
    Failed,
    /// The operator stopped it.
    Stopped,
    /// The operator left without waiting for the stop to be confirmed.
    Abandoned,
    /// The lead time asked for is too short; nothing was sent.
    LeadTooShort {
        /// What was asked for.
        #[serde(rename = "lead_ms")]
        lead: Span,
        /// What this fleet needs.
        needed: LeadTime,
        /// The earliest start that would have been safe.
        safe_start: Timestamp<Server>,
    },
    /// The start asked for has passed, or is too soon; nothing was sent.
    StartTooSoon {
        /// What was asked for.
        start: Timestamp<Server>,
        /// The earliest start that would have been safe.
        safe_start: Timestamp<Server>,
    },
    /// The pending lease asked for is too short; nothing was sent.
    LeaseTooShort {
        /// What was asked for.
        #[serde(rename = "lease_ms")]
        lease: Span,
        /// What the measured delays need.
        #[serde(rename = "needed_ms")]
        needed: Span,
    },
    /// The journal cannot be written, or its disk stands still: nothing more may be promised, and all were stopped.
    JournalLost {
        /// Why, for people.
        reason: String,
    },
    /// The scheduler itself was held up over the decision; none started.
    DecisionLate {
        /// By how much.
        #[serde(rename = "by_ms")]
        by: Span,
    },
    /// The scheduler itself or its disk was held up over the commitment; none started.
    CommitmentLate {
        /// By how much, at least.
        #[serde(rename = "by_ms")]
        by: Span,
    },
}

impl Outcome {
    /// Whether it states that nothing was sent or that no robot started.
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

    /// What held the scheduler up, for people, if that is why an act was withdrawn.
    pub(crate) fn hold_up(&self) -> Option<String> {
        let (what, late) = match self {
            Self::DecisionLate { by } => ("this machine was held up, the decision", (*by, "")),
            Self::CommitmentLate { by } => {
                ("this machine or its disk was held up, the commitment", (*by, " or more"))
            }
            _ => return None,
        };
        Some(match late {
            (Span::ZERO, _) => format!("{what} came too late; {LESS_TO_DO}"),
            (by, or_more) => format!("{what} came {by}{or_more} too late; {LESS_TO_DO}"),
        })
    }
}

const LESS_TO_DO: &str = "give this machine less to do meanwhile";

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
                "played to its end, but out of tolerance: robots were {spread} apart or off their plan, start_tolerance is {tolerance}"
            ),
            Self::StepsLate { late, tolerance } => write!(
                f,
                "played to its end, but steps were up to {late} late, start_tolerance is {tolerance}"
            ),
            Self::Unknown => {
                f.write_str("played to its end as far as is known: some robots do not say what they did")
            }
            Self::Ready => f.write_str("ready, nothing was sent"),
            Self::NotReady => f.write_str("not ready, nothing was sent"),
            Self::NotStarted => f.write_str("not started"),
            Self::Failed => f.write_str("failed and stopped"),
            Self::Stopped => f.write_str("stopped by the operator"),
            Self::Abandoned => f.write_str("the operator left before the stop was confirmed"),
            Self::LeadTooShort { lead, needed, safe_start } => write!(
                f,
                "not sent: a lead of {lead} is too short, this fleet needs {} ({} to prepare, {} of lease, {} of margin); the earliest safe start was {safe_start}",
                needed.total(),
                needed.prepare,
                needed.lease,
                needed.margin
            ),
            Self::StartTooSoon { start, safe_start } => write!(
                f,
                "not sent: a start at {start} has passed or is too soon, the earliest safe start was {safe_start}"
            ),
            Self::LeaseTooShort { lease, needed } => write!(
                f,
                "not sent: a pending stop_condition of {lease} is too short, the measured delays need {needed}"
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
    fn a_delay_that_is_none_is_not_told_as_zero() {
        let told = |by| Outcome::CommitmentLate { by }.to_string();
        let begin = "not started: this machine or its disk was held up, the commitment came ";
        assert_eq!(told(Span::ZERO), format!("{begin}too late; {LESS_TO_DO}"));
        assert_eq!(told(Span::from_millis(3)), format!("{begin}3 ms or more too late; {LESS_TO_DO}"));
        assert_eq!(Outcome::Failed.hold_up(), None);
    }
}
