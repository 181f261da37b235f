//! The fate of each act of the scenario, including acts that were never sent.

use std::fmt;

use downbeat_plan::Wait;
use serde::{Deserialize, Serialize};
use urrcp::Span;

use super::act::Act;

/// The fate of an act of the scenario. If the act occurred several times, the fate of its last occurrence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "fate")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum ActFate {
    /// The mission did not reach the act.
    #[default]
    NotReached,
    /// The act was waiting when the mission ended.
    StillWaiting,
    /// The act's condition was not met, and the mission continued according to `otherwise`.
    TimedOut {
        /// The condition that the act waited for, as text for users.
        awaited: String,
        /// The time allowed for the condition.
        #[serde(rename = "within_ms")]
        within: Span,
    },
    /// All robots of the act had been left out.
    NobodyLeft,
    /// The act was sent and withdrawn before anything moved.
    Withdrawn,
    /// The act was stopped after it had begun.
    Stopped,
    /// The act's planned end has passed, and no robot has reported whether it played the act.
    Unknown,
    /// The act was played to its end.
    Played,
}

/// An act of the scenario, with its fate.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ActCourse {
    /// The name of the act; empty for a single act without a name.
    pub act: String,
    /// How often the act was played to its end.
    pub played: u32,
    /// The fate of the act.
    #[serde(flatten)]
    pub fate: ActFate,
    /// Whether robots have moved, or may have moved, in any occurrence of the act.
    #[serde(skip)]
    pub(super) moved: bool,
}

impl ActCourse {
    pub(super) fn note(&mut self, fate: ActFate) {
        self.played += u32::from(fate == ActFate::Played);
        self.moved |= matches!(fate, ActFate::Played | ActFate::Stopped | ActFate::Unknown);
        self.fate = fate;
    }

    /// Whether the act was skipped: it was to be played and was not, and the mission continued.
    pub(crate) const fn was_skipped(&self) -> bool {
        matches!(self.fate, ActFate::TimedOut { .. } | ActFate::NobodyLeft)
    }
}

impl ActFate {
    /// Returns the fate of an act whose condition was not met in time.
    pub(super) fn timed_out(act: &Act) -> Self {
        let written = act.written();
        let awaited = match &written.wait {
            Wait::Operator => "the operator's go".to_owned(),
            Wait::Sensor { robot, sensor, range } => format!("`{robot}/{sensor}` {range}"),
            Wait::Done | Wait::TimeOfDay(_) | Wait::Instant(_) => "its time".to_owned(),
        };
        Self::TimedOut { awaited, within: written.timeout.unwrap_or_default() }
    }
}

impl fmt::Display for ActFate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotReached => f.write_str("not reached"),
            Self::StillWaiting => f.write_str("still waiting at the end"),
            Self::TimedOut { awaited, within } => {
                write!(f, "skipped: {awaited} did not occur within {within}")
            }
            Self::NobodyLeft => f.write_str("skipped: all of its robots were left out or had not joined yet"),
            Self::Withdrawn => f.write_str("withdrawn before anything moved"),
            Self::Stopped => f.write_str("stopped before its end"),
            Self::Unknown => f.write_str("unknown whether it was played"),
            Self::Played => f.write_str("played"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn act_counts_each_play_and_keeps_its_last_fate() {
        let mut course = ActCourse::default();
        for (fate, played) in
            [(ActFate::Played, 1), (ActFate::NobodyLeft, 1), (ActFate::Played, 2), (ActFate::Stopped, 2)]
        {
            course.note(fate.clone());
            assert_eq!((course.played, &course.fate), (played, &fate));
        }
    }
}
