//! The facts of an act for the report and the journal.

use std::fmt;

use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, Robot, RobotId, Server, Span, Timestamp};

use super::act::{Act, Member};
use super::events::TakenReading;
use super::motion::{MotionReport, MotionSpread};
use super::robot_state::{Robots, Totals};
use super::script::{Ending, Script, ScriptState};
use super::{ActNumber, LeadTime, SkewBudget};

/// The report of one act.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ActReport {
    /// The name of the act.
    pub act: String,
    /// The number of the act in the mission, starting at 0.
    pub number: ActNumber,
    /// The sending timestamp that all requests of the act shared.
    pub timestamp: Timestamp<Server>,
    /// The planned start.
    pub start: Timestamp<Server>,
    /// The components of the lead time, from sending the requests to the start.
    pub lead: LeadTime,
    /// The robot whose slow link determines the lead time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slowest: Option<RobotId>,
    /// How much later than intended the act started. The intended start is the end of the previous act, or the time that the act waited
    /// for.
    #[serde(rename = "gap_ms")]
    pub gap: Option<Span>,
    /// How far apart the robots could start according to their clocks, as known before the decision.
    pub skew: Option<SkewBudget>,
    /// The robots' largest minus their smallest start error, by their own clocks.
    #[serde(rename = "spread_ms")]
    pub spread: Option<Span>,
    /// The time that was left until the decision when the last acceptance arrived.
    #[serde(rename = "margin_left_ms")]
    pub margin_left: Option<Span>,
    /// Time from sending the first message that extends a lease beyond the start to the last confirmation. If the scheduler had died
    /// during this time, only some robots would have started.
    #[serde(rename = "window_ms")]
    pub window: Option<Span>,
    /// The length of the interval before the start in which a robot's sudden silence could be noticed too late to prevent the start.
    #[serde(rename = "doubt_ms")]
    pub doubt: Span,
    /// How often the act was withdrawn before anything moved, and prepared again, because this machine was too slow.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub prepared_again: u32,
    /// The readings that the scenario requested.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub readings: Vec<TakenReading>,
    /// The starts of motions, as verified with sensors; empty if they were not verified.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub motions: Vec<MotionReport>,
    /// How far apart the verified motions started, relative to their plans.
    #[serde(rename = "motion", skip_serializing_if = "Option::is_none")]
    pub motion_spread: Option<MotionSpread>,
    /// The results of each robot, in the order of the plan.
    pub robots: Vec<ActRobot>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
pub(super) const fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// The results of one robot in one act.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ActRobot {
    /// The robot's id.
    pub robot: RobotId,
    /// Whether the robot was left out.
    pub left_out: bool,
    /// The results of the scripts of each device.
    pub devices: Vec<DeviceReport>,
}

/// Progress of a script, as far as the scheduler knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum DeviceState {
    /// The script was not sent.
    Planned,
    /// The script was sent, and the robot has not answered.
    Sent,
    /// The robot holds the script, and has not started it.
    Accepted,
    /// The script has started.
    Started,
    /// All steps of the script were executed.
    Ended,
    /// The robot refused the script, or ended it early.
    Failed,
    /// The script was sent, and its fate is unknown.
    Unknown,
}

impl fmt::Display for DeviceState {
    /// Formats the state as in reports.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Planned => "planned",
            Self::Sent => "sent",
            Self::Accepted => "accepted",
            Self::Started => "started",
            Self::Ended => "ended",
            Self::Failed => "failed",
            Self::Unknown => "unknown",
        })
    }
}

/// The result of one script of a device.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DeviceReport {
    /// Id of the device.
    pub device: DeviceId,
    /// Progress of the script.
    pub state: DeviceState,
    /// The planned start of the script: the time at which it sets its first value or, on a device that moves linearly, begins to move to
    /// this value.
    pub planned_start: Option<Timestamp<Server>>,
    /// The actual start by the robot's clock.
    pub started_at: Option<Timestamp<Robot>>,
    /// The actual minus the planned start.
    #[serde(rename = "start_error_ms")]
    pub start_error: Option<Span>,
    /// Number of executed steps.
    pub steps_done: u32,
    /// Number of planned steps.
    pub steps_planned: usize,
    /// Number of steps that were more than a millisecond late.
    pub late_steps: u32,
    /// The largest lateness of the late steps; `None` if the robot does not report it.
    #[serde(rename = "late_ms_max", skip_serializing_if = "Option::is_none")]
    pub late_max: Option<Span>,
}

impl ActReport {
    /// Returns the report of an act; `None` if the act was not sent.
    pub(super) fn new(act: &Act, robots: &Robots) -> Option<Self> {
        let timing = act.timing()?;
        let robot = |member: &Member| ActRobot {
            robot: robots[member.robot].id.clone(),
            left_out: !member.takes_part(),
            devices: member.scripts().iter().map(|script| device_report(act, member, script)).collect(),
        };
        let motions = act.motions(robots);
        Some(Self {
            motion_spread: MotionSpread::of(&motions),
            motions,
            act: act.name(),
            number: act.number(),
            timestamp: timing.timestamp,
            start: timing.start,
            lead: timing.lead,
            slowest: timing.slowest.as_ref().map(|(robot, _)| robot.clone()),
            gap: timing.gap,
            skew: timing.skew.clone(),
            spread: spread(act, act.members().iter()),
            margin_left: timing.accepted_at.map(|at| timing.decision - at),
            window: timing.round.map(|(sent, answered)| answered - sent),
            doubt: timing.stated_doubt.unwrap_or_else(|| timing.doubt()),
            prepared_again: act.attempts(),
            readings: act.readings().to_vec(),
            robots: act.members().iter().map(robot).collect(),
        })
    }
}

impl ActReport {
    /// Adds the results of a robot's scripts to `totals`. Used for an act that ended before this process resumed the mission.
    pub(super) fn add_to(&self, totals: &mut Totals, robot: &ActRobot) {
        use DeviceState::{Accepted, Ended, Failed, Planned, Sent, Started, Unknown};
        let all_accepted = self.margin_left.is_some();
        for script in &robot.devices {
            let state = script.state;
            let begun =
                script.started_at.is_some() || script.steps_done > 0 || matches!(state, Started | Ended);
            let accepted = begun || state == Accepted || all_accepted && matches!(state, Failed | Unknown);
            totals.scripts += 1;
            totals.sent += usize::from(state != Planned);
            totals.accepted += usize::from(accepted);
            totals.failed += usize::from(state == Failed);
            totals.started += usize::from(begun);
            totals.steps_done += u64::from(script.steps_done);
            totals.steps_planned += script.steps_planned as u64;
            totals.late_steps += u64::from(script.late_steps);
            totals.late_max = totals.late_max.max(script.late_max);
            totals.start_error =
                totals.start_error.into_iter().chain(script.start_error).max_by_key(|error| error.abs());
            totals.unaccounted += usize::from(matches!(state, Sent | Accepted | Started | Unknown));
        }
    }

    /// Returns the largest start error of a script, by its robot's own clock. Robots that were left out are not included.
    pub(super) fn off_plan(&self) -> Option<Span> {
        let scripts = self.robots.iter().filter(|robot| !robot.left_out).flat_map(|robot| &robot.devices);
        scripts.filter_map(|script| script.start_error).map(Span::abs).max()
    }

    /// Returns the largest lateness of a step, among the robots that were not left out.
    pub(super) fn late_max(&self) -> Option<Span> {
        let scripts = self.robots.iter().filter(|robot| !robot.left_out).flat_map(|robot| &robot.devices);
        scripts.filter_map(|script| script.late_max).max()
    }
}

/// Returns how far apart devices started, relative to their plans: the largest minus the smallest start error of their first scripts.
pub(super) fn spread<'a>(act: &Act, members: impl Iterator<Item = &'a Member>) -> Option<Span> {
    let errors = |member: &'a Member| {
        let firsts = member.firsts();
        firsts.filter_map(move |script| act.start_error(member, script))
    };
    let errors: Vec<Span> = members.flat_map(errors).collect();
    errors.iter().max().zip(errors.iter().min()).map(|(max, min)| *max - *min)
}

fn device_report(act: &Act, member: &Member, script: &Script) -> DeviceReport {
    DeviceReport {
        device: script.plan.device.clone(),
        state: match script.state() {
            ScriptState::Planned if script.is_unaccounted() => DeviceState::Unknown,
            ScriptState::Planned => DeviceState::Planned,
            ScriptState::Sent => DeviceState::Sent,
            ScriptState::Held => DeviceState::Accepted,
            ScriptState::Running if script.has_started() => DeviceState::Started,
            ScriptState::Running => DeviceState::Accepted,
            ScriptState::Ended(Ending::Completed) => DeviceState::Ended,
            ScriptState::Ended(Ending::Failed(_) | Ending::Discredited(_)) => DeviceState::Failed,
            ScriptState::Unknown => DeviceState::Unknown,
        },
        planned_start: act.timing().map(|timing| timing.start + script.starts()),
        started_at: script.started_at(),
        start_error: act.start_error(member, script),
        steps_done: script.steps_done(),
        steps_planned: script.plan.script.steps().len(),
        late_steps: script.late_steps(),
        late_max: script.late_max(),
    }
}
