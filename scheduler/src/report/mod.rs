//! What really happened: for people (`text`), for machines (serde), in a picture (`picture`).

pub mod picture;
mod text;

use std::fmt;

use serde::Serialize;
use urrcp::{DeviceId, Robot, RobotId, Server, SessionId, Span, Timestamp};

use crate::clock::ClockReading;
use crate::mission::act::{ActRun, Member, start_error};
use crate::mission::{ClockMode, Failure, LeadTime, Mission, Preflight, SkewBudget, TakenReading};
use crate::server_clock::NtpState;
pub use text::{choreography_figures, main_duration, plan_figures, plan_table, preflight_table, report_text};

use crate::mission::robot_state::{RobotState, ScriptPhase, ScriptState, Standing};

/// The JSON Schema of a report.
pub const SCHEMA: &str = include_str!("schema.json");

/// How a mission ended.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// All robots started together and came to their end.
    Done,
    /// The others came to their end; robots that failed were left out, as `on_failure` says.
    DoneWithout,
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
            Self::DoneWithout => f.write_str("done, without the robots that failed"),
            Self::Ready => f.write_str("ready, nothing was sent"),
            Self::NotReady => f.write_str("not ready, nothing was sent"),
            Self::NotStarted => f.write_str("not started"),
            Self::Failed => f.write_str("failed and stopped"),
            Self::Stopped => f.write_str("stopped by the operator"),
            Self::Abandoned => f.write_str("left by the operator before the stop was confirmed"),
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
    /// The session on whose behalf robots were driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionId>,
    /// How it ended.
    pub outcome: Outcome,
    /// Planned start of the first cue of the first act reported, by the server's clock.
    pub start: Option<Timestamp<Server>>,
    /// Why the start was that far ahead.
    pub lead: Option<LeadTime>,
    /// Largest spread of starts of any act, by the robots' own clocks.
    #[serde(rename = "spread_ms")]
    pub spread: Option<Span>,
    /// The same by the one true clock, which only a dry run has.
    #[serde(rename = "true_spread_ms", skip_serializing_if = "Option::is_none")]
    pub true_spread: Option<Span>,
    /// The acts that were sent, in order.
    pub acts: Vec<ActReport>,
    /// Earlier acts that are no longer listed; the journal has them.
    pub acts_omitted: usize,
    /// Robots in the order of the fleet, over all acts.
    pub robots: Vec<RobotReport>,
    /// All failures, in order.
    pub failures: Vec<Failure>,
    /// What NTP said of this machine's clock at last, where the fleet file names an NTP server.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ntp: Option<NtpState>,
    /// What was checked before.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preflight: Option<Preflight>,
}

/// What became of one act.
#[derive(Clone, Debug, Serialize)]
pub struct ActReport {
    /// Its name.
    pub act: String,
    /// Which of the mission's acts, counted from zero.
    pub number: u32,
    /// The sending timestamp that all its requests shared.
    pub timestamp: Timestamp<Server>,
    /// Planned start.
    pub start: Timestamp<Server>,
    /// Why the start was that far ahead.
    pub lead: LeadTime,
    /// How much later it started than it should have: at the end of the act before, or at the time that it waited for.
    #[serde(rename = "gap_ms")]
    pub gap: Option<Span>,
    /// How far apart the clocks allowed the starts to be, before the decision.
    pub skew: Option<SkewBudget>,
    /// Largest minus smallest start error, by the robots' own clocks.
    #[serde(rename = "spread_ms")]
    pub spread: Option<Span>,
    /// Time left at the decision after the last acceptance.
    #[serde(rename = "margin_left_ms")]
    pub margin_left: Option<Span>,
    /// Between the first renewal that carried a lease over the start and the last confirmed: had the scheduler died in it,
    /// some robots would have started and others not.
    #[serde(rename = "window_ms")]
    pub window: Option<Span>,
    /// Readings that the scenario asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub readings: Vec<TakenReading>,
    /// Robots in the order of the plan.
    pub robots: Vec<ActRobot>,
}

/// What one robot did in one act.
#[derive(Clone, Debug, Serialize)]
pub struct ActRobot {
    /// Which.
    pub robot: RobotId,
    /// It was left out.
    pub left_out: bool,
    /// Each device.
    pub devices: Vec<DeviceReport>,
}

/// What one robot did over all acts.
#[derive(Clone, Debug, Serialize)]
pub struct RobotReport {
    /// Which.
    pub robot: RobotId,
    /// `in`, `absent` or `out`.
    pub standing: &'static str,
    /// It accepted all its scripts.
    pub accepted: bool,
    /// Scripts that it said it had started.
    pub started: usize,
    /// Scripts planned.
    pub scripts: usize,
    /// Its start error of largest size: actual (by its clock) minus planned.
    #[serde(rename = "start_error_ms")]
    pub start_error: Option<Span>,
    /// Steps executed, by its own account.
    pub steps_done: u64,
    /// Steps planned.
    pub steps_planned: u64,
    /// Steps that came more than a millisecond late, by its own account.
    pub late_steps: u64,
    /// Scripts that it was sent and of which it has not said what became of them.
    pub unaccounted: usize,
    /// Requests sent again.
    pub retries: u32,
    /// Times its link was made anew.
    pub reconnects: u32,
    /// How its time was brought to agree with the server's.
    pub clock_mode: ClockMode,
    /// Its clock against the server's.
    pub clock: Option<ClockReading>,
    /// After a stop: whether it is known to be in its default state.
    pub stop: StopState,
}

/// What became of the stop of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "state")]
pub enum StopState {
    /// None was sent.
    NotSent,
    /// The robot confirmed on every device that it is at rest.
    Confirmed,
    /// No confirmation; it stops by itself when its longest lease ends.
    Unconfirmed {
        /// When, by the server's clock; `None` if a script runs on without a lease.
        lease_ends: Option<Timestamp<Server>>,
    },
}

/// What one script of a device did.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceReport {
    /// Which device.
    pub device: DeviceId,
    /// `planned`, `sent`, `accepted`, `started`, `ended` or `failed`.
    pub state: &'static str,
    /// Planned start of its script.
    pub planned_start: Option<Timestamp<Server>>,
    /// From there to its first step.
    #[serde(skip)]
    pub first_step: Span,
    /// Actual start by the robot's clock.
    pub started_at: Option<Timestamp<Robot>>,
    /// Actual minus planned.
    #[serde(rename = "start_error_ms")]
    pub start_error: Option<Span>,
    /// Steps executed.
    pub steps_done: u32,
    /// Steps planned.
    pub steps_planned: usize,
    /// Steps that came more than a millisecond late.
    pub late_steps: u32,
}

impl Report {
    pub(crate) fn new(mission: &Mission, outcome: Outcome) -> Self {
        let (acts, acts_omitted) = mission.act_reports();
        let robots = mission.robots();
        Self {
            scenario: mission.choreography().scenario.clone(),
            session: mission.options().session.clone(),
            outcome,
            start: acts.front().map(|act| act.start),
            lead: acts.front().map(|act| act.lead),
            spread: acts.iter().filter_map(|act| act.spread).max(),
            true_spread: None,
            acts: acts.iter().cloned().collect(),
            acts_omitted,
            robots: robots.iter().map(robot_report).collect(),
            failures: robots.iter().flat_map(|robot| robot.failures.iter().cloned()).collect(),
            ntp: mission.ntp(),
            preflight: mission.preflight().cloned(),
        }
    }

    /// Whether all went as planned.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.outcome == Outcome::Done
    }
}

impl ActReport {
    /// `None` for an act that was not sent.
    pub(crate) fn new(act: String, run: &ActRun, robots: &[RobotState]) -> Option<Self> {
        let timing = run.timing.as_ref()?;
        let errors = || {
            let members = run.members.iter();
            members.flat_map(|member| {
                member.scripts.iter().filter_map(move |script| start_error(run, member, script))
            })
        };
        let spread = errors().max().zip(errors().min()).map(|(max, min)| max - min);
        let robot = |member: &Member| ActRobot {
            robot: robots[member.robot].id.clone(),
            left_out: member.out,
            devices: member.scripts.iter().map(|script| device_report(run, member, script)).collect(),
        };
        Some(Self {
            act,
            number: run.number,
            timestamp: timing.timestamp,
            start: timing.start,
            lead: timing.lead,
            gap: timing.gap,
            skew: timing.skew.clone(),
            spread,
            margin_left: timing.accepted_at.map(|at| timing.decision - at),
            window: timing.round.map(|(sent, answered)| answered - sent),
            readings: run.readings.clone(),
            robots: run.members.iter().map(robot).collect(),
        })
    }
}

fn robot_report(robot: &RobotState) -> RobotReport {
    let totals = &robot.totals;
    RobotReport {
        robot: robot.id.clone(),
        standing: match robot.standing {
            Standing::In => "in",
            Standing::Absent => "absent",
            Standing::Out => "out",
        },
        accepted: totals.scripts > 0 && totals.accepted == totals.scripts,
        started: totals.started,
        scripts: totals.scripts,
        start_error: totals.start_error,
        steps_done: totals.steps_done,
        steps_planned: totals.steps_planned,
        late_steps: totals.late_steps,
        unaccounted: totals.unaccounted,
        retries: totals.retries,
        reconnects: totals.reconnects,
        clock_mode: robot.clock_mode,
        clock: robot.clock.reading(),
        stop: stop_state(robot),
    }
}

fn stop_state(robot: &RobotState) -> StopState {
    match (robot.stop_sent, robot.stop_confirmed(), robot.left.is_empty()) {
        (true, true, _) => StopState::Confirmed,
        (false, _, true) => StopState::NotSent,
        _ => {
            let ends: Option<Vec<_>> = robot.left.iter().copied().collect();
            StopState::Unconfirmed { lease_ends: ends.and_then(|ends| ends.into_iter().max()) }
        }
    }
}

fn device_report(run: &ActRun, member: &Member, script: &ScriptState) -> DeviceReport {
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
        planned_start: run.timing.as_ref().map(|timing| timing.start + script.plan.start.span()),
        first_step: script.plan.script.steps().first().map_or(Span::ZERO, |step| step.offset.span()),
        started_at: script.started_at,
        start_error: start_error(run, member, script),
        steps_done: script.steps_done,
        steps_planned: script.plan.script.steps().len(),
        late_steps: script.late_steps,
    }
}
