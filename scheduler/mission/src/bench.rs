//! Robots, scripts and answers for unit tests, without a mission and without links.

use std::sync::Arc;

use downbeat_plan::{Choreography, DeviceScript, Plan, RobotPlan};
use urrcp::{
    ContentHash, ControlError, ControlResponse, ControlType, DeviceId, ErrorCode, InitializationBlock,
    Millis, RequestId, RequestReport, RequestState, Robot, RobotId, Script, Server, Setpoint, Span, Status,
    Step, StopCondition, Timestamp,
};

use super::robot_state::RobotState;
use super::{Participant, RobotIndex};

/// How a test robot reports about its scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tells {
    /// The robot reports by itself, and answers inquiries.
    Everything,
    /// The robot reports by itself.
    Reports,
    /// The robot answers inquiries.
    Answers,
    /// The robot neither reports by itself nor answers inquiries.
    Nothing,
}

/// A script of a device: the device, its start and its playing time in milliseconds.
pub(super) type Planned<'a> = (&'a str, i64, i64);

/// The robots of a test, in order.
pub(super) const R0: RobotIndex = RobotIndex::new(0);
pub(super) const R1: RobotIndex = RobotIndex::new(1);
pub(super) const R2: RobotIndex = RobotIndex::new(2);

pub(super) const RUNNING: Span = Span::from_millis(2_000);
pub(super) const TOLERANCE: Span = Span::from_millis(10);

pub(super) fn ms(millis: i64) -> Span {
    Span::from_millis(millis)
}

/// Returns the instant that is `millis` milliseconds after a fixed one.
pub(super) fn at(millis: i64) -> Timestamp<Server> {
    Timestamp::from_nanos(0) + ms(1_000_000 + millis)
}

/// Returns a connected robot with the devices `a`, `b` and `c`.
pub(super) fn robot(id: &str, tells: Tells, queue: usize) -> RobotState {
    let (reports, inquiry) = match tells {
        Tells::Everything => (true, true),
        Tells::Reports => (true, false),
        Tells::Answers => (false, true),
        Tells::Nothing => (false, false),
    };
    let device = |name: &str| {
        format!(
            r#"{{"id": "{name}", "name": "{name}", "script_queue": {queue}, "available_control_types": {{
                "position": {{"min_value": 0, "max_value": 90, "granularity": 1}},
                "script": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 8}}}}}}"#
        )
    };
    let devices = ["a", "b", "c"].map(device).join(", ");
    let block = format!(
        r#"{{"id": "{id}", "api_version": "1", "reports": {reports}, "inquiry": {inquiry}, "pending_until": {inquiry}, "devices": [{devices}]}}"#
    );
    let block: InitializationBlock = serde_json::from_str(&block).unwrap();
    let mut robot = RobotState::new(Participant::new(RobotId::new(id).unwrap(), Some(block)));
    robot.connected(at(0));
    robot.named();
    robot
}

pub(super) fn stop_condition() -> StopCondition {
    StopCondition { pending: None, running: Some(Millis::from_span(RUNNING)) }
}

/// Returns a script with a step at its start and one at its end.
pub(super) fn device_script((device, start, duration): Planned) -> DeviceScript {
    let step = |offset: i64| Step {
        offset: Millis::from_span(ms(offset)),
        setpoint: Setpoint::new(ControlType::Position, 45.0),
        stop_condition: None,
    };
    DeviceScript {
        device: device.parse().unwrap(),
        start: Millis::from_span(ms(start)),
        stop_condition: stop_condition(),
        script: Script::new(vec![step(0), step(duration)]).unwrap(),
        rest: Span::ZERO,
    }
}

/// Returns a choreography of one act, in which the robots `r0`, `r1` and so on play these scripts.
pub(super) fn choreography(scripts: &[&[Planned]]) -> Choreography {
    let robot = |(index, scripts): (usize, &&[Planned])| RobotPlan {
        robot: RobotId::new(format!("r{index}")).unwrap(),
        scripts: scripts.iter().map(|planned| device_script(*planned)).collect(),
    };
    Choreography::of_plan(Plan {
        scenario: "s".into(),
        start_tolerance: TOLERANCE,
        lead: None,
        stop_condition: stop_condition(),
        robots: scripts.iter().enumerate().map(robot).collect(),
    })
}

pub(super) fn played(scripts: &[&[Planned]]) -> Arc<Choreography> {
    Arc::new(choreography(scripts))
}

/// Returns the time of a robot's clock at `at`, if that clock agrees with the server's.
pub(super) fn by_robot(at: Timestamp<Server>) -> Timestamp<Robot> {
    at.assume_clock()
}

pub(super) fn response(
    device: &DeviceId,
    id: Option<&RequestId>,
    status: Status,
    said: Timestamp<Server>,
) -> ControlResponse {
    ControlResponse {
        request_id: id.cloned(),
        ..ControlResponse::new(by_robot(said), device.clone(), status)
    }
}

pub(super) fn refusal(code: ErrorCode) -> Option<ControlError> {
    Some(ControlError::new(code, "no"))
}

pub(super) fn report(id: &RequestId, state: RequestState, hash: Option<ContentHash>) -> RequestReport {
    RequestReport { content_hash: hash, ..RequestReport::new(id.clone(), state) }
}
