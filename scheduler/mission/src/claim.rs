//! Checks a robot's statements about a script against the possible values.
//!
//! A robot's statement about itself is accepted as long as it can be true: at most as many steps as the script has, no start before
//! the script was sent or in the future, no end before the script can have ended. Times are compared as far as the robot's clock is
//! known. Starts within `start_tolerance` are not checked here.

use serde::{Deserialize, Serialize};
use urrcp::{ControlResponse, RequestReport, RequestState, Robot, Server, Span, Status, Timestamp};

/// The maximum error that a busy machine and coarse clocks add to any timestamp.
const GRAIN: Span = Span::from_millis(20);

/// An impossible statement of a robot about a script.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "claim", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Claim {
    /// The robot has executed more steps than the script has.
    #[error("{claimed} steps done, of {planned} planned")]
    Steps {
        /// The stated number of executed steps.
        claimed: u32,
        /// The number of steps of the script.
        planned: u32,
    },
    /// The robot has executed fewer steps than it had stated before.
    #[error("{claimed} steps done, after reporting {before}")]
    FewerSteps {
        /// The stated number of executed steps.
        claimed: u32,
        /// The number of executed steps that the robot had stated before.
        before: u32,
    },
    /// More steps were late than were executed.
    #[error("{claimed} steps late, of {done} done")]
    LateSteps {
        /// The stated number of late steps.
        claimed: u32,
        /// The stated number of executed steps.
        done: u32,
    },
    /// The robot has completed the script before its last step.
    #[error("completed with {claimed} steps done, of {planned} planned")]
    Completed {
        /// The stated number of executed steps.
        claimed: u32,
        /// The number of steps of the script.
        planned: u32,
    },
    /// The script started before it was sent.
    #[error("started {by} before the script was sent")]
    BeforeSent {
        /// The start that the robot states.
        claimed: Timestamp<Robot>,
        /// The start is too early by at least this time.
        #[serde(rename = "by_ms")]
        by: Span,
    },
    /// The script started before it can have arrived.
    #[error("started {by} earlier than possible")]
    StartedEarly {
        /// The start is too early by at least this time.
        #[serde(rename = "by_ms")]
        by: Span,
    },
    /// The robot states a time in the future.
    #[error("the reported time is {by} in the future")]
    Ahead {
        /// The time that the robot states.
        claimed: Timestamp<Robot>,
        /// The stated time is later than the arrival of the report by at least this time.
        #[serde(rename = "by_ms")]
        by: Span,
    },
    /// The robot has completed the script before it can have been played.
    #[error("completed {by} earlier than possible")]
    EndedEarly {
        /// The completion is too early by at least this time.
        #[serde(rename = "by_ms")]
        by: Span,
    },
}

/// A robot's statement about a script at one instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Told {
    arrived: Timestamp<Server>,
    said_at: Timestamp<Robot>,
    steps_done: Option<u32>,
    late_steps: Option<u32>,
    /// Whether the robot states that the script has begun.
    begun: bool,
    /// Whether the robot states that the script has completed.
    completed: bool,
    started_at: Option<Timestamp<Robot>>,
    ended_at: Option<Timestamp<Robot>>,
}

impl Told {
    pub(crate) fn by_response(response: &ControlResponse, arrived: Timestamp<Server>) -> Self {
        let at = response.event_timestamp;
        Self {
            arrived,
            said_at: response.timestamp,
            steps_done: response.steps_done,
            late_steps: response.late_steps,
            begun: matches!(response.status, Status::Started | Status::Ok),
            completed: response.status == Status::Ok,
            started_at: at.filter(|_| response.status == Status::Started),
            ended_at: at.filter(|_| response.status == Status::Ok),
        }
    }

    pub(crate) fn by_report(
        report: &RequestReport,
        said_at: Timestamp<Robot>,
        arrived: Timestamp<Server>,
    ) -> Self {
        let completed = report.state == RequestState::Ended && report.error.is_none();
        Self {
            arrived,
            said_at,
            steps_done: report.steps_done,
            late_steps: report.late_steps,
            begun: completed || report.state == RequestState::Running,
            completed,
            started_at: report.event_timestamp,
            ended_at: None,
        }
    }

    /// Returns the arrival time of the statement.
    pub(crate) const fn arrived(&self) -> Timestamp<Server> {
        self.arrived
    }

    pub(crate) fn says_that_it_moved(&self) -> bool {
        self.begun || self.steps_done.is_some_and(|steps| steps > 0)
    }

    /// Returns the stated number of executed steps, with the time of the statement; `None` if the robot states no number.
    pub(crate) fn steps(&self) -> Option<(Timestamp<Robot>, u32)> {
        self.steps_done.map(|steps| (self.said_at, steps))
    }
}

/// The limits that a robot's statement about a script must observe to be possible.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Possible {
    /// The number of steps of the script.
    pub(crate) planned: u32,
    /// The number of executed steps in the robot's latest report, with the time of that report by the robot's clock.
    pub(crate) before: Option<(Timestamp<Robot>, u32)>,
    /// The instants of the script; `None` before the script's act was sent.
    pub(crate) times: Option<Times>,
}

/// The instants of a script, and the accuracy of the robot's clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    /// The earliest time at which the act may have been sent.
    pub(crate) sent: Timestamp<Server>,
    /// The planned start of the script, by the robot's clock.
    pub(crate) start: Timestamp<Robot>,
    /// The playing time of the script.
    pub(crate) duration: Span,
    /// The robot's clock minus the server's.
    pub(crate) offset: Span,
    /// The true offset differs from `offset` by at most this.
    pub(crate) uncertainty: Span,
    /// The maximum permitted difference between the actual and the planned start.
    pub(crate) tolerance: Span,
}

impl Possible {
    /// Returns the impossible part of a statement; `None` if the whole statement is possible.
    pub(crate) fn contradicts(&self, told: &Told) -> Option<Claim> {
        self.steps(told).or_else(|| self.times.and_then(|times| times.contradicts(told)))
    }

    fn steps(&self, told: &Told) -> Option<Claim> {
        let planned = self.planned;
        if let Some(claimed) = told.steps_done {
            let before = self.before.filter(|(at, steps)| told.said_at > *at && claimed < *steps);
            match before {
                _ if claimed > planned => return Some(Claim::Steps { claimed, planned }),
                Some((_, before)) => return Some(Claim::FewerSteps { claimed, before }),
                None if told.completed && claimed < planned => {
                    return Some(Claim::Completed { claimed, planned });
                }
                None => {}
            }
        }
        let done = told.steps_done.unwrap_or(planned);
        let claimed = told.late_steps.filter(|late| *late > done)?;
        Some(Claim::LateSteps { claimed, done })
    }
}

impl Times {
    fn contradicts(&self, told: &Told) -> Option<Claim> {
        let known = self.uncertainty + GRAIN;
        let by_server = |at: Timestamp<Robot>| (at - self.offset).assume_clock::<Server>();
        if let Some(claimed) = told.started_at {
            let by = self.sent - by_server(claimed) - known;
            if by > Span::ZERO {
                return Some(Claim::BeforeSent { claimed, by });
            }
        }
        for claimed in told.started_at.into_iter().chain(told.ended_at) {
            let by = by_server(claimed) - told.arrived - known;
            if by > Span::ZERO {
                return Some(Claim::Ahead { claimed, by });
            }
        }
        let ahead = |due| by_server(due) - told.arrived - self.tolerance - known;
        let end = self.start + self.duration;
        let by_its_clock = told.ended_at.map(|at| end - at - self.tolerance - GRAIN);
        let ended_early = by_its_clock.into_iter().chain([ahead(end)]).max().filter(|_| told.completed);
        let started_early = Some(ahead(self.start)).filter(|_| told.begun);
        let early = |by: Option<Span>| by.filter(|by| *by > Span::ZERO);
        let ended_early = early(ended_early).map(|by| Claim::EndedEarly { by });
        ended_early.or_else(|| early(started_early).map(|by| Claim::StartedEarly { by }))
    }
}

#[cfg(test)]
mod tests;
