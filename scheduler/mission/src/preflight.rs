//! The checks before a mission as one table: one row per robot, one column per check.

use std::collections::BTreeMap;

use downbeat_plan::{Choreography, OnFailure};
use downbeat_yaml::render::counted;
use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, ErrorCode, Millis, RobotId, Server, Span, Timestamp};

use super::failure_kind::FailureKind;
use super::poses::Expected;
use super::robot_state::{Link, RobotState};
use super::seize::Ownership;
use super::skew::SkewBudget;
use super::{ClockMode, Greeting, Mission, RobotIndex};

/// A check before a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Check {
    /// The robot is reachable.
    Link,
    /// The link leads to the right robot.
    Identity,
    /// The robot uses this version of URRCP.
    Version,
    /// The robot describes itself as the fleet file does, and the plan fits the robot.
    Description,
    /// The robot's clock agrees with the clocks of the fleet.
    Clock,
    /// The robot's devices are where the first keyframes expect them.
    Position,
    /// The robot's hardware is available.
    Hardware,
    /// The robot belongs to no other session, and the queues of its devices are free.
    Free,
    /// The robot's sensors read values that the fleet file permits.
    Sensors,
}

impl Check {
    /// All checks, in the order of the columns.
    pub const ALL: [Self; 9] = [
        Self::Link,
        Self::Identity,
        Self::Version,
        Self::Description,
        Self::Clock,
        Self::Position,
        Self::Hardware,
        Self::Free,
        Self::Sensors,
    ];

    /// The header of the check's column in the table.
    #[must_use]
    pub const fn title(self) -> &'static str {
        match self {
            Self::Link => "link",
            Self::Identity => "identity",
            Self::Version => "version",
            Self::Description => "description",
            Self::Clock => "clock",
            Self::Position => "position",
            Self::Hardware => "hardware",
            Self::Free => "free",
            Self::Sensors => "sensors",
        }
    }
}

/// Result of a check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "verdict", content = "detail", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Verdict {
    /// The check passed. Contains the observed value.
    Pass(String),
    /// The result is unexpected, but does not prevent the start.
    Warning(String),
    /// The result prevents the start.
    Failure(String),
    /// The check had no data.
    NotChecked,
}

/// A robot's row in the table of checks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PreflightRow {
    /// Id of the robot.
    pub robot: RobotId,
    /// The result of each check, in the order of [`Check::ALL`].
    pub checks: Vec<(Check, Verdict)>,
    /// The offset of the robot's clock, robot minus server; `None` if unknown. JSON contains it in the data of the robot instead.
    #[serde(skip)]
    pub clock_offset: Option<Span>,
    /// The position of each device of the first act: the commanded position or, without one, the reading of its sensor.
    #[serde(skip)]
    pub positions: BTreeMap<DeviceId, f64>,
    /// The readings of the robot's sensors, and the positions of its devices.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub readings: Vec<DeviceReading>,
}

/// The reading of a sensor or of a device that can report its position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceReading {
    /// Id of the device.
    pub device: DeviceId,
    /// The reading in the device's unit; `None` if the device gave none.
    pub reading: Option<f64>,
    /// The reason why the device gave no reading, in the robot's words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// The unit of the reading.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// The required reading, as text for users.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected: Option<String>,
}

/// The complete table of the checks before a mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Preflight {
    /// The kind of greeting: whether the mission asked the robots at all.
    pub greeting: Greeting,
    /// One row per robot.
    pub rows: Vec<PreflightRow>,
    /// The predicted spread of the motions at the start of the first act, as far as known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub skew: Option<SkewBudget>,
    /// The movements that the failure of an act may cause, one entry per such act. If an act without an entry fails, robots only stop in
    /// place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub after_failures: Vec<AfterFailure>,
}

/// The movements that a failure in one of the listed acts may cause.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AfterFailure {
    /// The names of the acts in which a failure may cause these movements.
    pub acts: Vec<String>,
    /// Whether robots may move to their default positions.
    pub home: bool,
    /// The name of the act that follows the failure. Unless robots have moved home, they first move to the first positions of that act.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub then: Option<String>,
}

pub(super) fn after_failures(choreography: &Choreography) -> Vec<AfterFailure> {
    let mut found: Vec<AfterFailure> = Vec::new();
    for act in &choreography.acts {
        let policy = &act.on_failure;
        let home = policy.policies().any(|policy| policy == OnFailure::Home);
        let then = policy.then.map(|then| choreography.acts[then].called().to_owned());
        if !home && then.is_none() {
            continue;
        }
        let name = act.called().to_owned();
        match found.iter_mut().find(|known| known.home == home && known.then == then) {
            Some(known) => known.acts.push(name),
            None => found.push(AfterFailure { acts: vec![name], home, then }),
        }
    }
    found
}

pub(super) fn table(mission: &Mission, now: Timestamp<Server>) -> Preflight {
    let row = |index: RobotIndex| {
        let robot = mission.robots[index].id.clone();
        let checks = Check::ALL.map(|check| (check, verdict(mission, index, check, now)));
        let clock_offset = mission.robots[index].clock_at(now).map(|reading| reading.offset);
        let positions = mission.positions_to_leave(index);
        let readings = readings(mission, index);
        PreflightRow { robot, checks: checks.to_vec(), clock_offset, positions, readings }
    };
    let rows = mission.robots.indices().map(row).collect();
    Preflight {
        greeting: mission.options.greeting,
        rows,
        skew: mission.skew_of_first_act(now),
        after_failures: after_failures(&mission.choreography),
    }
}

/// All readings of a robot, in this order: those that the fleet file requires, the positions of devices, those that are only displayed.
fn readings(mission: &Mission, index: RobotIndex) -> Vec<DeviceReading> {
    let robot = &mission.robots[index];
    let unit = |device: &DeviceId| {
        let described = robot.block.as_ref()?.device(device.as_str())?;
        described.unit.as_ref().map(ToString::to_string)
    };
    let row = |device: &DeviceId, reading: Option<f64>, expected| {
        let why = robot.greeted.unread.get(device).filter(|_| reading.is_none()).cloned();
        DeviceReading { device: device.clone(), reading, why, unit: unit(device), expected }
    };
    let asked = mission.options.greeting == Greeting::Full;
    let required = robot.settings.require.iter().zip(&robot.greeted.readings).filter(|_| asked);
    let required =
        required.map(|(required, reading)| row(&required.sensor, *reading, Some(required.range.to_string())));
    let expected = |expected: Expected| format!("{} ±{}", expected.position, expected.within);
    let stands = robot.known_positions().map(|(device, reading)| {
        row(device, Some(reading), mission.expected_position(index, device).map(expected))
    });
    let shown = robot.greeted.shown.iter().map(|(device, reading)| row(device, *reading, None));
    required.chain(stands).chain(shown).collect()
}

/// A certificate that expires sooner than this causes a warning: enough time to create a new one and copy it to the robot.
const EXPIRES_SOON: Span = Span::from_millis(30 * DAY_MS);
const DAY_MS: i64 = 24 * 3_600 * 1_000;

fn identity(robot: &RobotState, now: Timestamp<Server>) -> Verdict {
    match robot.identity.certified_until.map(|until| until - now).filter(|left| *left < EXPIRES_SOON) {
        None if robot.identity.is_of_replaced_authority => Verdict::Warning(format!(
            "its certificate is of an authority that is being replaced: copy its new identity file to it, after `downbeat keys renew {}`",
            robot.identity.own_id
        )),
        None => Verdict::Pass(robot.identity.own_id.to_string()),
        Some(left) => {
            let days = left.as_nanos() / 1_000_000 / DAY_MS;
            Verdict::Warning(format!(
                "its certificate expires in {}: make a new one with `downbeat keys renew {}`",
                counted(usize::try_from(days).unwrap_or_default(), "day"),
                robot.identity.own_id
            ))
        }
    }
}

fn verdict(mission: &Mission, index: RobotIndex, check: Check, now: Timestamp<Server>) -> Verdict {
    let robot = &mission.robots[index];
    let failures: Vec<String> = robot
        .failures
        .iter()
        .filter(|failure| column(&failure.kind) == check)
        .map(|failure| failure.kind.to_string())
        .collect();
    if !failures.is_empty() {
        let omitted = robot.failures.omitted();
        let first = robot.failures.first().map(|failure| column(&failure.kind));
        let rest = (omitted > 0 && first == Some(check)).then(|| format!("{omitted} more failures"));
        return Verdict::Failure(failures.into_iter().chain(rest).collect::<Vec<_>>().join("; "));
    }
    let greeted = mission.options.greeting == Greeting::Full;
    match check {
        Check::Link => match &robot.link {
            Link::Unnamed { .. } => Verdict::Pass("up".to_owned()),
            Link::Up { .. } => Verdict::Pass(match robot.clock.reading() {
                Some(reading) => format!("{} to {} ms", ms(reading.delay_min), ms(reading.delay_max)),
                None => "up".to_owned(),
            }),
            Link::Lost(lost) => Verdict::Warning(lost.reason.clone()),
            Link::Connecting => Verdict::Warning("not there".to_owned()),
        },
        Check::Identity | Check::Version | Check::Description if !robot.greeted.introduced => {
            Verdict::NotChecked
        }
        Check::Identity => identity(robot, now),
        Check::Version => {
            Verdict::Pass(robot.block.as_ref().map(|block| block.api_version.to_string()).unwrap_or_default())
        }
        Check::Description => description(robot),
        Check::Clock => clock(robot, now),
        Check::Position => positions(mission, index),
        Check::Hardware => {
            if greeted && robot.clock.samples() > 0 {
                Verdict::Pass("there".to_owned())
            } else {
                Verdict::NotChecked
            }
        }
        Check::Free => match greeted && mission.options.session.is_some() && robot.is_up() {
            true if robot.identity.ownership == Ownership::Seized => {
                Verdict::Warning("ours, taken over from another session".to_owned())
            }
            true => Verdict::Pass("ours".to_owned()),
            false => Verdict::NotChecked,
        },
        Check::Sensors => match robot.settings.require.len() {
            0 => Verdict::NotChecked,
            _ if !greeted || robot.greeted.readings.iter().any(Option::is_none) => Verdict::NotChecked,
            _ => {
                let readings =
                    robot.settings.require.iter().zip(&robot.greeted.readings).filter_map(
                        |(required, reading)| Some(format!("{} {}", required.sensor, (*reading)?)),
                    );
                Verdict::Pass(readings.collect::<Vec<_>>().join(", "))
            }
        },
    }
}

fn positions(mission: &Mission, index: RobotIndex) -> Verdict {
    let robot = &mission.robots[index];
    let unknown = match mission.options.greeting {
        Greeting::Full if robot.greeted.introduced => mission.unknown_positions(index),
        _ => Vec::new(),
    };
    if let Some(first) = unknown.first() {
        let others = match unknown.len() - 1 {
            0 => String::new(),
            others => format!(" and of {}", counted(others, "other")),
        };
        return Verdict::Warning(format!(
            "the position of `{first}`{others} is unknown: the act starts wherever the device is"
        ));
    }
    match robot.known_positions().count() {
        0 => Verdict::NotChecked,
        devices => Verdict::Pass(format!("{devices} read")),
    }
}

/// The warning about a robot that ignores `pending_until`.
pub const NOT_STRICT: &str =
    "it does not declare `pending_until`: a delayed message may start a script whose start was not decided";

fn description(robot: &RobotState) -> Verdict {
    match &robot.greeted.latency_differs {
        Some(differs) => Verdict::Warning(differs.to_string()),
        None if robot.drops_undecided() => Verdict::Pass("fits".to_owned()),
        None => Verdict::Warning(NOT_STRICT.to_owned()),
    }
}

fn clock(robot: &RobotState, now: Timestamp<Server>) -> Verdict {
    match robot.clock_at(now) {
        None => Verdict::NotChecked,
        Some(reading) => {
            let measured = if robot.settings.clock == ClockMode::Measured { ", measured" } else { "" };
            Verdict::Pass(format!("{} ±{} ms{measured}", ms(reading.offset), ms(reading.uncertainty)))
        }
    }
}

/// Formats a time in milliseconds, with the precision that users need.
fn ms(span: Span) -> String {
    format!("{:.2}", Millis::from_span(span).get())
}

/// The column of a failure in the table.
fn column(kind: &FailureKind) -> Check {
    match kind {
        FailureKind::LinkDown { .. }
        | FailureKind::Flooding { .. }
        | FailureKind::TooSlow { .. }
        | FailureKind::Garbled { .. }
        | FailureKind::Silent { .. }
        | FailureKind::NeverJoined { .. } => Check::Link,
        FailureKind::WrongVersion { .. } => Check::Version,
        FailureKind::Unfit { .. } | FailureKind::NoTimeToSend { .. } => Check::Description,
        FailureKind::Clock { .. } | FailureKind::LatencySpread { .. } => Check::Clock,
        FailureKind::Requirement { .. } => Check::Sensors,
        FailureKind::Position { .. } => Check::Position,
        FailureKind::AnotherRobot { .. } => Check::Identity,
        // A robot that is busy belongs to another session; any other reason concerns its equipment.
        FailureKind::NotAvailable { error } if error.code == ErrorCode::Busy => Check::Free,
        FailureKind::NotAvailable { .. } => Check::Hardware,
        FailureKind::Script { .. } | FailureKind::Claim { .. } => Check::Free,
    }
}

#[cfg(test)]
mod tests {
    use urrcp::ControlError;

    use super::*;

    #[test]
    fn busy_fails_the_free_check_and_other_errors_the_hardware_check() {
        let not_available = |code| FailureKind::NotAvailable { error: ControlError::new(code, "why") };
        assert_eq!(column(&not_available(ErrorCode::Busy)), Check::Free);
        assert_eq!(column(&not_available(ErrorCode::Internal)), Check::Hardware);
    }
}
