//! What a robot says of a script, compared with what is possible.
//!
//! A robot is believed what it says of itself, as long as that can be true: no more steps than the script has, no start before
//! the script was sent or ahead of now, no end before the script can have ended. Times are compared as far as the robot's
//! clock is known, and starts within `start_tolerance` are no matter here.

use serde::{Deserialize, Serialize};
use urrcp::{ControlResponse, RequestReport, RequestState, Robot, Server, Span, Status, Timestamp};

/// What a busy machine and coarse clocks may add to any time.
const GRAIN: Span = Span::from_millis(20);

/// Something that a robot says of a script and that cannot be true.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "claim", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Claim {
    /// More steps than the script has.
    #[error("{claimed} steps done, of {planned} planned")]
    Steps {
        /// What it says.
        claimed: u32,
        /// What the script has.
        planned: u32,
    },
    /// Fewer steps than it had said before.
    #[error("{claimed} steps done, after it had said {before}")]
    FewerSteps {
        /// What it says.
        claimed: u32,
        /// What it had said.
        before: u32,
    },
    /// More late steps than it has done.
    #[error("{claimed} steps late, of {done} done")]
    LateSteps {
        /// What it says.
        claimed: u32,
        /// What it says to have done.
        done: u32,
    },
    /// The end of the script before its last step.
    #[error("completed with {claimed} steps done, of {planned} planned")]
    Completed {
        /// What it says.
        claimed: u32,
        /// What the script has.
        planned: u32,
    },
    /// A start before the script was sent.
    #[error("started {by} before the script was sent")]
    BeforeSent {
        /// What it says.
        claimed: Timestamp<Robot>,
        /// How long before it can have been, at least.
        #[serde(rename = "by_ms")]
        by: Span,
    },
    /// A start before it can have come.
    #[error("started {by} before it can have")]
    StartedEarly {
        /// How long before, at least.
        #[serde(rename = "by_ms")]
        by: Span,
    },
    /// Something that has not happened yet.
    #[error("the time of what it reports is {by} after it can have been")]
    Ahead {
        /// What it says.
        claimed: Timestamp<Robot>,
        /// How long after the arrival of its report, at least.
        #[serde(rename = "by_ms")]
        by: Span,
    },
    /// The end of the script before it can have been played.
    #[error("completed {by} before the script can have ended")]
    EndedEarly {
        /// How long before, at least.
        #[serde(rename = "by_ms")]
        by: Span,
    },
}

/// What a robot says of a script at one instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Told {
    arrived: Timestamp<Server>,
    said_at: Timestamp<Robot>,
    steps_done: Option<u32>,
    late_steps: Option<u32>,
    /// It says that it has begun.
    begun: bool,
    /// It says that it is at its end.
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

    /// When it came.
    pub(crate) const fn arrived(&self) -> Timestamp<Server> {
        self.arrived
    }

    pub(crate) fn says_that_it_moved(&self) -> bool {
        self.begun || self.steps_done.is_some_and(|steps| steps > 0)
    }

    /// Its number of steps, and when it said so.
    pub(crate) fn steps(&self) -> Option<(Timestamp<Robot>, u32)> {
        self.steps_done.map(|steps| (self.said_at, steps))
    }
}

/// What can be true of a script.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Possible {
    /// How many steps it has.
    pub(crate) planned: u32,
    /// What the robot last said of its steps, and when by its clock.
    pub(crate) before: Option<(Timestamp<Robot>, u32)>,
    /// The robot's times; `None` before the script's act was sent.
    pub(crate) times: Option<Times>,
}

/// The instants of a script, and how well the robot's clock is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    /// The act was not sent before this.
    pub(crate) sent: Timestamp<Server>,
    /// When the script starts by the robot's clock, and how long it plays.
    pub(crate) start: Timestamp<Robot>,
    pub(crate) duration: Span,
    /// Robot minus server, and how far that may be off.
    pub(crate) offset: Span,
    pub(crate) uncertainty: Span,
    /// How far from the plan a start may be.
    pub(crate) tolerance: Span,
}

impl Possible {
    /// What of it cannot be true.
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
