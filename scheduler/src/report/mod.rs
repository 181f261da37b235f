//! What really happened: for people (`text`), for machines (serde), in a picture (`picture`).

pub mod picture;
mod text;

use std::fmt;

use downbeat_scripts::Plan;
use serde::Serialize;
use urrcp::{DeviceId, Robot, RobotId, Server, Span, Timestamp};

use crate::clock::ClockReading;
use crate::mission::{Failure, LeadTime};
pub use text::{choreography_figures, main_duration, plan_figures, plan_table, report_text};

use crate::mission::robot_state::{Link, RobotState, ScriptPhase, ScriptState};

/// How a mission ended.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// All robots started together and came to their end.
    Done,
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
    /// The scheduler itself was held up over the decision; none started.
    DecisionLate {
        /// By how much.
        #[serde(rename = "by_ms")]
        by: Span,
    },
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Done => f.write_str("done"),
            Self::NotStarted => f.write_str("not started"),
            Self::Failed => f.write_str("failed and stopped"),
            Self::Stopped => f.write_str("stopped by the operator"),
            Self::Abandoned => f.write_str("left by the operator before the stop was confirmed"),
            Self::LeadTooShort { lead, needed } => write!(
                f,
                "not sent: a lead of {lead} is too short, this fleet needs {} ({} to prepare, {} of lease, {} of margin)",
                needed.total(),
                needed.prepare,
                needed.lease,
                needed.margin
            ),
            Self::LeaseTooShort { lease, needed } => write!(
                f,
                "not sent: a pending stop_condition of {lease} is too short, the measured delays need {needed}"
            ),
            Self::DecisionLate { by } => {
                write!(f, "not started: this machine was held up, the decision came {by} late")
            }
        }
    }
}

/// The report of one mission. Times in milliseconds, instants in RFC 3339.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The scenario's name.
    pub scenario: String,
    /// How it ended.
    pub outcome: Outcome,
    /// Planned start of the first cue, by the server's clock.
    pub start: Option<Timestamp<Server>>,
    /// Why the start was that far ahead.
    pub lead: Option<LeadTime>,
    /// Largest minus smallest start error over all robots, by their own clocks.
    #[serde(rename = "spread_ms")]
    pub spread: Option<Span>,
    /// The same by the one true clock, which only a dry run has.
    #[serde(rename = "true_spread_ms", skip_serializing_if = "Option::is_none")]
    pub true_spread: Option<Span>,
    /// Robots in the order of the plan.
    pub robots: Vec<RobotReport>,
    /// All failures, in order.
    pub failures: Vec<Failure>,
}

/// What one robot did.
#[derive(Clone, Debug, Serialize)]
pub struct RobotReport {
    /// Which.
    pub robot: RobotId,
    /// It accepted all its scripts.
    pub accepted: bool,
    /// Scripts that it said it had started.
    pub started: usize,
    /// Its start error of largest size: actual (by its clock) minus planned.
    #[serde(rename = "start_error_ms")]
    pub start_error: Option<Span>,
    /// Steps executed, by its own account.
    pub steps_done: u32,
    /// Steps planned.
    pub steps_planned: usize,
    /// Its clock against the server's.
    pub clock: Option<ClockReading>,
    /// After a stop: whether it is known to be in its default state.
    pub stop: StopState,
    /// Each device.
    pub devices: Vec<DeviceReport>,
}

/// What became of the stop of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "state")]
pub enum StopState {
    /// None was sent.
    NotSent,
    /// The robot confirmed its default state on every device.
    Confirmed,
    /// No confirmation; it stops by itself when its longest lease ends.
    Unconfirmed {
        /// When, by the server's clock; `None` if a script runs on without a lease.
        lease_ends: Option<Timestamp<Server>>,
    },
}

/// What one device did.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceReport {
    /// Which.
    pub device: DeviceId,
    /// `planned`, `sent`, `accepted`, `started`, `ended` or `failed`.
    pub state: &'static str,
    /// Planned start of its script.
    pub planned_start: Option<Timestamp<Server>>,
    /// Actual start by the robot's clock.
    pub started_at: Option<Timestamp<Robot>>,
    /// Actual minus planned.
    #[serde(rename = "start_error_ms")]
    pub start_error: Option<Span>,
    /// Steps executed.
    pub steps_done: u32,
    /// Steps planned.
    pub steps_planned: usize,
}

impl Report {
    pub(crate) fn new(
        plan: &Plan,
        robots: &[RobotState],
        timing: Option<(Timestamp<Server>, LeadTime)>,
        outcome: Outcome,
    ) -> Self {
        let start = timing.map(|(start, _)| start);
        let errors = || {
            let devices = robots.iter().flat_map(|robot| &robot.scripts);
            devices.filter_map(|script| start_error(script, start))
        };
        let spread = errors().max().zip(errors().min()).map(|(max, min)| max - min);
        Self {
            scenario: plan.scenario.clone(),
            outcome,
            start,
            lead: timing.map(|(_, lead)| lead),
            spread,
            true_spread: None,
            robots: robots.iter().map(|robot| robot_report(robot, start, timing.map(|t| t.1))).collect(),
            failures: robots.iter().flat_map(|robot| robot.failures.iter().cloned()).collect(),
        }
    }

    /// Whether all went as planned.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.outcome == Outcome::Done
    }
}

fn start_error(script: &ScriptState, start: Option<Timestamp<Server>>) -> Option<Span> {
    let planned = start? + script.plan.start.span();
    Some(script.started_at? - planned.assume_clock())
}

fn robot_report(robot: &RobotState, start: Option<Timestamp<Server>>, lead: Option<LeadTime>) -> RobotReport {
    let errors = robot.scripts.iter().filter_map(|script| start_error(script, start));
    RobotReport {
        robot: robot.id.clone(),
        accepted: robot.has_accepted(),
        started: robot.scripts.iter().filter(|script| script.started_at.is_some()).count(),
        start_error: errors.max_by_key(|error| error.abs()),
        steps_done: robot.scripts.iter().map(|script| script.steps_done).sum(),
        steps_planned: robot.scripts.iter().map(|script| script.plan.script.steps().len()).sum(),
        clock: robot.clock.reading(),
        stop: stop_state(robot, start, lead),
        devices: robot.scripts.iter().map(|script| device_report(script, start)).collect(),
    }
}

fn stop_state(robot: &RobotState, start: Option<Timestamp<Server>>, lead: Option<LeadTime>) -> StopState {
    let sent = robot.scripts.iter().any(|script| script.phase != ScriptPhase::Planned);
    if !sent || (!robot.stop_sent && robot.is_done()) {
        return StopState::NotSent;
    }
    if robot.stop_sent && robot.stops.is_empty() && robot.link == Link::Up {
        return StopState::Confirmed;
    }
    let ends = robot.scripts.iter().map(|script| lease_end(robot, script, start, lead));
    let all: Option<Vec<_>> = ends.collect();
    StopState::Unconfirmed { lease_ends: all.and_then(|ends| ends.into_iter().max()) }
}

/// When a script ends by its own lease: while it waits by the pending one, else by the running one.
fn lease_end(
    robot: &RobotState,
    script: &ScriptState,
    start: Option<Timestamp<Server>>,
    lead: Option<LeadTime>,
) -> Option<Timestamp<Server>> {
    let silent_since = robot.last_sent?;
    let pending_ends = silent_since + lead?.lease;
    let begins = start? + script.plan.start.span();
    match script.phase {
        ScriptPhase::Sent | ScriptPhase::Accepted if pending_ends < begins => Some(pending_ends),
        _ => Some((silent_since + script.plan.stop_condition.running?.span()).max(pending_ends)),
    }
}

fn device_report(script: &ScriptState, start: Option<Timestamp<Server>>) -> DeviceReport {
    DeviceReport {
        device: script.plan.device.clone(),
        state: match script.phase {
            ScriptPhase::Planned => "planned",
            ScriptPhase::Sent => "sent",
            ScriptPhase::Accepted => "accepted",
            ScriptPhase::Started => "started",
            ScriptPhase::Ended => "ended",
            ScriptPhase::Failed(_) => "failed",
        },
        planned_start: start.map(|start| start + script.plan.start.span()),
        started_at: script.started_at,
        start_error: start_error(script, start),
        steps_done: script.steps_done,
        steps_planned: script.plan.script.steps().len(),
    }
}
