//! The report of a mission. The module `show` of `downbeat` formats it as text.

#[cfg(test)]
mod kinds;
mod wake_up;
mod withdrawal;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use urrcp::{RobotId, Server, SessionId, Span, Timestamp};

use crate::clock::{ClockReading, NtpState};
use crate::requirements::Judged;
use crate::robot_state::{Rest, RobotState, SentStop, Standing, Stop};
pub use crate::{ActCourse, ActFate, ActReport, ActRobot, DeviceReport, DeviceState, Greeting, Outcome};
use crate::{ClockMode, Failure, LatencyDiffers, LeadTime, Mission, Preflight, TransferReport};
pub use wake_up::HostWakeUp;
pub use withdrawal::{Withdrawal, WithdrawnRobot};

/// The JSON Schema of a report.
pub const SCHEMA: &str = include_str!("report/schema.json");

/// The report of one mission. In JSON, times are in milliseconds and instants in RFC 3339.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The scenario's name.
    pub scenario: String,
    /// The name of the session for which robots were driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionId>,
    /// The outcome of the mission.
    pub outcome: Outcome,
    /// The reason for the stop, as text for users, if neither the outcome nor a failure of a robot states it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub because: Option<String>,
    /// How often the journal was removed or replaced during the mission, and written again.
    #[serde(skip_serializing_if = "is_zero")]
    pub journal_written_again: u64,
    /// The requested maximum number of acts, if it ended the mission although another act would have followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acts_max_reached: Option<u32>,
    /// Planned start of the first cue of the first reported act, by the server's clock.
    pub start: Option<Timestamp<Server>>,
    /// The components of the lead time of the first reported act.
    pub lead: Option<LeadTime>,
    /// The largest spread of starts of any act, by the robots' own clocks.
    #[serde(rename = "spread_ms")]
    pub spread: Option<Span>,
    /// The largest spread of starts of any act by the true clock; `None` outside a dry run, because only a dry run has a true clock.
    #[serde(rename = "true_spread_ms", skip_serializing_if = "Option::is_none")]
    pub true_spread: Option<Span>,
    /// The largest spread of the last steps of scripts by the true clock. Clocks drift while robots play, so it differs from the spread
    /// of starts.
    #[serde(rename = "true_end_spread_ms", skip_serializing_if = "Option::is_none")]
    pub true_end_spread: Option<Span>,
    /// The requirements of the scenario, judged by this dry run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub requirements: Vec<Judged>,
    /// The fate of every act of the scenario, in the order of the file.
    pub course: Vec<ActCourse>,
    /// The acts that were sent, in order.
    pub acts: Vec<ActReport>,
    /// Number of earlier acts that are no longer listed in `acts`. The journal has them.
    pub acts_omitted: usize,
    /// The results of each robot over all acts, in the order of the fleet.
    pub robots: Vec<RobotReport>,
    /// The failures of each robot, in order. If a robot fails repeatedly, only its first failures are listed.
    pub failures: Vec<Failure>,
    /// The outcome of the move to the default positions. `None` if no move home was requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub home: Option<TransferReport>,
    /// The outcome of the approach (the move to the first positions of the act after the last failure). `None` if no approach was
    /// necessary.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub approach: Option<TransferReport>,
    /// Robots driven by this process whose hardware may not be at rest, each with the reason.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub not_at_rest: Vec<String>,
    /// The last state of this machine's clock according to NTP, if the fleet file names an NTP server.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ntp: Option<NtpState>,
    /// The result of the recording, if one was requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording: Option<Recorded>,
    /// How late this host wakes its robots, if a preflight measured it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wake_up: Option<HostWakeUp>,
    /// The results of the checks before the mission.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preflight: Option<Preflight>,
}

/// The results of one robot over all acts.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(Deserialize))]
pub struct RobotReport {
    /// Id of the robot.
    pub robot: RobotId,
    /// Whether the robot takes part in the mission.
    pub standing: Standing,
    /// Whether the robot accepted all its scripts.
    pub accepted: bool,
    /// Number of scripts that the robot reported as started.
    pub started: usize,
    /// Number of planned scripts.
    pub scripts: usize,
    /// The robot's start error with the largest absolute value: actual start by its own clock, minus planned start.
    #[serde(rename = "start_error_ms")]
    pub start_error: Option<Span>,
    /// Number of executed steps, as the robot reported.
    pub steps_done: u64,
    /// Number of planned steps.
    pub steps_planned: u64,
    /// Number of steps that were more than a millisecond late, as the robot reported.
    pub late_steps: u64,
    /// The largest lateness of the late steps; `None` if the robot does not report it.
    #[serde(rename = "late_ms_max", skip_serializing_if = "Option::is_none")]
    pub late_max: Option<Span>,
    /// Number of scripts that were sent to the robot and whose fate it has not reported.
    pub unaccounted: usize,
    /// Number of requests that were sent again.
    pub retries: u32,
    /// Number of times that the link to the robot was re-established.
    pub reconnects: u32,
    /// Number of ignored answers. They matched no question, or their times were impossible.
    #[serde(skip_serializing_if = "is_zero")]
    pub ignored_answers: u64,
    /// Number of further failures of the robot, beyond those that the report lists.
    #[serde(skip_serializing_if = "is_zero")]
    pub failures_omitted: u64,
    /// How the robot's clock is synchronized with the server's.
    pub clock_mode: ClockMode,
    /// The robot's clock compared with the server's.
    pub clock: Option<ClockReading>,
    /// Devices that declare a latency different from the compensated one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency_differs: Option<LatencyDiffers>,
    /// Whether the robot declares `pending_until`, and therefore drops a script whose start was not decided. `None` if the robot has not
    /// described itself.
    pub pending_until: Option<bool>,
    /// Whether the robot is known to be at rest after a stop.
    pub stop: StopState,
}

/// The result of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Recorded {
    /// The path of the recording's file.
    pub path: PathBuf,
    /// The reason why the recording is incomplete; `None` if it is complete.
    pub failure: Option<String>,
}

/// The state of a robot's stop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "state")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum StopState {
    /// No stop was sent.
    NotSent,
    /// The robot confirmed on every device that it has ended its activity, and comes to rest in place.
    Confirmed,
    /// The robot confirmed on every device that it goes to its default state.
    Home,
    /// The robot refused the stop, because it now belongs to another session, whose commands it may execute. It holds nothing of this
    /// session.
    TakenOver,
    /// The robot has not confirmed the stop. It stops by itself when its longest lease ends.
    Unconfirmed {
        /// The end of the lease by the server's clock; `None` if a script continues without a lease.
        lease_ends: Option<Timestamp<Server>>,
    },
}

impl StopState {
    /// Whether the robot may move although a stop was requested.
    #[must_use]
    pub const fn is_unconfirmed(&self) -> bool {
        matches!(self, Self::TakenOver | Self::Unconfirmed { .. })
    }
}

impl Report {
    /// The largest spread of steps that are planned for the same instant, by the true clock; `None` outside a dry run.
    #[must_use]
    pub fn largest_true_spread(&self) -> Option<Span> {
        self.true_spread.max(self.true_end_spread)
    }

    /// The report of a mission that has ended; `None` before.
    #[must_use]
    pub fn of(mission: &Mission) -> Option<Self> {
        mission.outcome().map(|outcome| Self::with(mission, outcome.clone()))
    }

    /// Ends the mission at once because the operator leaves, and returns its report without waiting for anything.
    #[must_use]
    pub fn as_left(mission: &mut Mission, now: Timestamp<Server>) -> Self {
        mission.leave(now);
        Self::with(mission, Outcome::Abandoned)
    }

    fn with(mission: &Mission, outcome: Outcome) -> Self {
        let (acts, acts_omitted) = mission.act_reports();
        let robots = mission.robots();
        let trusts_files = mission.options().greeting == Greeting::Skip;
        Self {
            scenario: mission.choreography().scenario.clone(),
            session: mission.options().session_name().cloned(),
            outcome,
            because: mission.because().map(str::to_owned),
            home: mission.home().cloned(),
            approach: mission.approach().cloned(),
            journal_written_again: mission.journal_written_again(),
            acts_max_reached: mission.bound_reached(),
            start: acts.front().map(|act| act.start),
            lead: acts.front().map(|act| act.lead),
            spread: acts.iter().filter_map(|act| act.spread).max(),
            true_spread: None,
            true_end_spread: None,
            requirements: Vec::new(),
            course: mission.fates().to_vec(),
            acts: acts.iter().cloned().collect(),
            acts_omitted,
            robots: robots.iter().map(|robot| robot_report(robot, trusts_files)).collect(),
            failures: robots.iter().flat_map(|robot| robot.failures.iter().cloned()).collect(),
            not_at_rest: Vec::new(),
            ntp: mission.ntp(),
            recording: None,
            wake_up: None,
            preflight: mission.preflight().cloned(),
        }
    }

    /// Whether the mission went as planned.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.outcome == Outcome::Done
    }
}

/// The report of a robot. With `trusts_files`, descriptions come from the fleet's files, because the mission did not request them from
/// the robots.
fn robot_report(robot: &RobotState, trusts_files: bool) -> RobotReport {
    let is_described = trusts_files || robot.greeted.introduced;
    let totals = &robot.totals;
    RobotReport {
        robot: robot.id.clone(),
        standing: robot.standing,
        accepted: totals.scripts > 0 && totals.accepted == totals.scripts,
        started: totals.started,
        scripts: totals.scripts,
        start_error: totals.start_error,
        steps_done: totals.steps_done,
        steps_planned: totals.steps_planned,
        late_steps: totals.late_steps,
        late_max: totals.late_max,
        unaccounted: totals.unaccounted,
        retries: totals.retries,
        reconnects: totals.reconnects,
        ignored_answers: robot.contact.exchanges.ignored(),
        failures_omitted: robot.failures.omitted(),
        clock_mode: robot.settings.clock,
        clock: robot.clock.reading(),
        latency_differs: robot.greeted.latency_differs.clone(),
        pending_until: robot.block.as_ref().filter(|_| is_described).map(|_| robot.drops_undecided()),
        stop: stop_state(robot),
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde wants a reference")]
const fn is_zero(count: &u64) -> bool {
    *count == 0
}

fn stop_state(robot: &RobotState) -> StopState {
    if let (Stop::Confirmed(_), Some(lease_ends)) = (&robot.halt.stop, robot.halt.elsewhere) {
        return StopState::Unconfirmed { lease_ends };
    }
    match (&robot.halt.stop, robot.halt.left.is_empty()) {
        (Stop::Confirmed(Rest::InPlace), _) => StopState::Confirmed,
        (Stop::Confirmed(Rest::Home), _) => StopState::Home,
        (Stop::None, true) => StopState::NotSent,
        (Stop::Sent(SentStop { taken_over: Some(_), .. }), _) => StopState::TakenOver,
        (Stop::None | Stop::Sent(_), _) => {
            let ends: Option<Vec<_>> = robot.halt.left.iter().copied().collect();
            StopState::Unconfirmed { lease_ends: ends.and_then(|ends| ends.into_iter().max()) }
        }
    }
}
