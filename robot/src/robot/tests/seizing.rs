//! Tests the loss of a robot: by seizure, and by a key that is no longer valid.

use super::sessions::{OTHER, hello, of, operator, stop_of};
use super::*;
use urrcp::Role;
use urrcp::SessionId;

const DRIVES: [Role; 2] = [Role::Observe, Role::Drive];
const SEIZES: [Role; 3] = [Role::Observe, Role::Drive, Role::Seize];

/// The name and the roles that a peer has proven. `None` if it has proven nothing.
type Proven<'a> = Option<(&'a str, &'a [Role])>;

fn seize(session: Option<&str>) -> Message {
    let session = session.map(|session| SessionId::new(session).unwrap());
    Message::AvailabilityRequest(AvailabilityRequest {
        timestamp: None,
        session,
        seize: true,
        revocation_list: None,
    })
}

/// Returns a robot on which Anna's command for the arm is running, and her command for the device `ramp` is waiting. If `other` is not
/// `None`, its operator is the peer of the link `OTHER`.
fn anna_plays(other: Proven<'_>) -> Bench {
    let mut bench = Bench::new();
    bench.robot.handle(bench.now, LINK, operator("operator anna", &DRIVES), &mut bench.out);
    if let Some((name, roles)) = other {
        bench.robot.handle(bench.now, OTHER, operator(name, roles), &mut bench.out);
    }
    for (device, id, start) in [("arm", "a", 100.0), ("ramp", "b", 1_500.0)] {
        let mut request = timed(device, id, start, script(ControlType::Position, &PAPER));
        request.stop_condition = lease(5_000.0, 5_000.0);
        bench.send_on(LINK, of("anna's", request));
    }
    bench.until(1_200);
    bench
}

#[test]
fn seized_robot_stops_playing_before_it_is_reported_available() {
    let mut bench = anna_plays(Some(("operator eva", &SEIZES)));
    assert_eq!(bench.values(), [(100, 45.0), (1_100, 0.0)]);
    bench.out.clear();
    bench.send_on(OTHER, seize(Some("eva's")));
    let told: Vec<String> = bench
        .out
        .iter()
        .map(|output| match output {
            Output::Set(set) => format!("{} {:?}", set.device, set.request_id),
            Output::Send { link, message: Message::ControlResponse(r) } => {
                let error = r.error.as_ref().map(ToString::to_string).unwrap_or_default();
                format!("{} {} {} {error}", link.0, r.device_id, r.status)
            }
            Output::Send { link, message: Message::AvailabilityResponse(r) } => {
                format!("{} {}", link.0, r.status)
            }
            other => format!("{other:?}"),
        })
        .collect();
    assert_eq!(told.last().map(String::as_str), Some("2 OK"));
    for expected in [
        "1 arm Failed cancelled: taken by operator eva",
        "1 ramp Failed cancelled: taken by operator eva",
        "wheel None",
    ] {
        assert!(told.iter().any(|line| line == expected), "{expected}: {told:?}");
    }
    assert!(bench.robot.is_idle());
    assert_eq!(bench.robot.value("arm", ControlType::Position, bench.now), Some(0.0), "it stays");
    // Eva now owns the robot. Only Anna is informed who took it.
    bench.send_on(LINK, hello("anna's"));
    assert_eq!(bench.last_said(), "1 Failed `r` was taken over by operator eva");
    let third = LinkId(3);
    bench.robot.handle(bench.now, third, operator("operator bert", &DRIVES), &mut bench.out);
    bench.send_on(third, hello("anna's"));
    assert_eq!(bench.last_said(), "3 Failed `r` belongs to another session until that session ends");
    bench.send_on(OTHER, of("eva's", timed("arm", "e", 1_300.0, script(ControlType::Position, &PAPER))));
    assert_eq!(bench.last_said(), "2 Accepted ");
    bench.until(5_000);
    let played: Vec<_> = bench.values().into_iter().filter(|(at, _)| *at >= 1_300).collect();
    assert_eq!(played, [(1_300, 45.0), (2_300, 0.0), (3_300, 45.0)]);
}

#[test]
fn refused_seizure_changes_nothing() {
    let attempts: [(Proven<'_>, Option<&str>, &str); 4] = [
        (
            Some(("operator bert", &DRIVES)),
            Some("bert's"),
            "operator bert has the roles observe, drive, but this requires the role seize",
        ),
        (
            Some(("operator cleo", &[Role::Seize])),
            Some("cleo's"),
            "operator cleo has the role seize, but this requires the role drive",
        ),
        (Some(("operator eva", &SEIZES)), None, "`seize` requires a `session`"),
        (None, Some("a stranger's"), "this connection has not proven any role"),
    ];
    for (other, session, refusal) in attempts {
        let mut bench = anna_plays(other);
        bench.out.clear();
        bench.send_on(OTHER, seize(session));
        assert!(bench.last_said().starts_with("2 Failed"), "{}", bench.last_said());
        assert!(bench.last_said().contains(refusal), "{}", bench.last_said());
        assert_eq!(bench.out.len(), 1, "{:?}", bench.out);
        bench.send_on(LINK, hello("anna's"));
        assert_eq!(bench.last_said(), "1 OK ");
        bench.until(5_000);
        assert_eq!(
            bench.values(),
            [(1_500, 45.0), (2_100, 45.0), (2_500, 0.0), (3_500, 45.0)],
            "the arm continues, and the ramp begins"
        );
    }
}

#[test]
fn seizing_a_free_or_already_owned_robot_does_not_affect_motion() {
    let mut bench = Bench::new();
    bench.robot.handle(bench.now, OTHER, operator("operator eva", &SEIZES), &mut bench.out);
    bench.send_on(OTHER, seize(Some("eva's")));
    assert_eq!(bench.last_said(), "2 OK ");
    bench.send_on(OTHER, of("eva's", timed("arm", "e", 100.0, script(ControlType::Position, &PAPER))));
    bench.until(500);
    bench.send_on(OTHER, seize(Some("eva's")));
    bench.until(5_000);
    assert_eq!(bench.values(), [(100, 45.0), (1_100, 0.0), (2_100, 45.0)]);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
}

#[test]
fn seizure_ends_commands_sent_without_a_session() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &PAPER)));
    bench.until(200);
    bench.robot.handle(bench.now, OTHER, operator("operator eva", &SEIZES), &mut bench.out);
    bench.send_on(OTHER, seize(Some("eva's")));
    assert_eq!(bench.statuses().last().map(String::as_str), Some("Failed cancelled"));
    assert!(bench.robot.is_idle());
}

#[test]
fn mission_that_lost_robot_cannot_stop_new_owner_whatever_its_roles() {
    let mut bench = Bench::new();
    let all: Vec<Role> = Role::ALL.to_vec();
    bench.robot.handle(bench.now, LINK, operator("operator anna", &all), &mut bench.out);
    bench.robot.handle(bench.now, OTHER, operator("operator eva", &SEIZES), &mut bench.out);
    bench.send_on(LINK, hello("anna's"));
    bench.send_on(OTHER, seize(Some("eva's")));
    bench.send_on(OTHER, of("eva's", timed("arm", "e", 100.0, script(ControlType::Position, &PAPER))));
    bench.until(500);
    bench.send_on(LINK, of("anna's", stop_of("arm")));
    assert_eq!(bench.last_said(), "1 Failed `r` was taken over by operator eva");
    assert!(!bench.robot.is_idle());
    // A stop that names no session applies to the current owner.
    bench.send_on(LINK, Message::ControlRequest(stop_of("arm")));
    assert_eq!(bench.last_said(), "1 OK ");
    assert!(bench.robot.is_idle());
}

const TROLLEY: &str = r#"{"id": "t", "api_version": "1", "reports": true, "devices": [
  {"id": "wheel", "available_control_types": {
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "acceleration": {"min_value": -5, "max_value": 5, "granularity": 1},
     "script": {"min_value": -10, "max_value": 10, "granularity": 1, "max_number_of_steps": 4, "control_types": ["speed"]}}}]}"#;

#[test]
fn seizure_slows_moving_device_and_next_session_starts_from_its_state() {
    let mut bench = Bench::new();
    bench.robot = Robot::new(serde_json::from_str(TROLLEY).unwrap());
    bench.robot.handle(bench.now, LINK, operator("operator anna", &DRIVES), &mut bench.out);
    bench.robot.handle(bench.now, OTHER, operator("operator eva", &SEIZES), &mut bench.out);
    // The command ends at once and leaves no lease, and the wheel continues to turn.
    bench.send_on(LINK, of("anna's", timed("wheel", "a", 100.0, script(ControlType::Speed, &[(0.0, 10.0)]))));
    bench.until(1_000);
    assert!(bench.robot.is_idle());
    bench.send_on(OTHER, seize(Some("eva's")));
    assert_eq!(bench.last_said(), "2 OK ");
    bench.until(2_000);
    let speed = bench.robot.value("wheel", ControlType::Speed, bench.now);
    assert_eq!(speed, Some(5.0), "by 5 a second");
    bench
        .send_on(OTHER, of("eva's", timed("wheel", "e", 2_500.0, script(ControlType::Speed, &[(0.0, 4.0)]))));
    bench.until(6_000);
    assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(4.0));
}

/// The key with this serial number is no longer valid.
fn barred(serial: &str) -> Input {
    Input::Barred { serial: serial.parse().unwrap(), why: "the operator's key was revoked".to_owned() }
}

#[test]
fn invalid_key_ends_commands_of_its_operator_and_frees_robot() {
    let mut bench = anna_plays(Some(("operator bert", &DRIVES)));
    bench.out.clear();
    bench.robot.handle(bench.now, LinkId(u64::MAX), barred("operator anna"), &mut bench.out);
    let told = bench.statuses();
    assert_eq!(told, ["Failed forbidden", "Failed forbidden"]);
    assert!(bench.robot.is_idle());
    bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    bench.send_on(OTHER, of("bert's", timed("arm", "e", 1_300.0, script(ControlType::Position, &PAPER))));
    assert_eq!(bench.last_said(), "2 Accepted ", "the robot belongs to no session");
    bench.until(5_000);
    let played: Vec<_> = bench.values().into_iter().filter(|(at, _)| *at >= 1_200).collect();
    assert_eq!(played, [(1_300, 45.0), (2_300, 0.0), (3_300, 45.0)], "nothing of Anna's");
}

#[test]
fn owner_keeps_robot_when_key_of_another_operator_becomes_invalid() {
    let mut bench = anna_plays(Some(("operator bert", &DRIVES)));
    bench.robot.handle(bench.now, LinkId(u64::MAX), barred("operator bert"), &mut bench.out);
    bench.send_on(LINK, hello("anna's"));
    assert_eq!(bench.last_said(), "1 OK ");
    bench.until(5_000);
    assert_eq!(bench.values().len(), 6, "the arm continues, and the ramp begins: {:?}", bench.values());
}

#[test]
fn device_left_moving_stops_when_key_of_its_operator_becomes_invalid() {
    let mut bench = Bench::new();
    bench.robot = Robot::new(serde_json::from_str(TROLLEY).unwrap());
    bench.robot.handle(bench.now, LINK, operator("operator anna", &DRIVES), &mut bench.out);
    bench.send_on(LINK, of("anna's", timed("wheel", "a", 100.0, script(ControlType::Speed, &[(0.0, 10.0)]))));
    bench.until(1_000);
    assert!(bench.robot.is_idle());
    bench.robot.handle(bench.now, LinkId(u64::MAX), barred("operator anna"), &mut bench.out);
    bench.until(6_000);
    assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(0.0));
}

#[test]
fn commands_of_invalid_key_end_even_after_link_loss_or_session_change() {
    let breaks = |bench: &mut Bench| bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    let names_another = |bench: &mut Bench| bench.send_on(LINK, hello("another"));
    let cases: [&dyn Fn(&mut Bench); 2] = [&breaks, &names_another];
    for case in cases {
        let mut bench = Bench::new();
        bench.robot.handle(bench.now, LINK, operator("operator anna", &DRIVES), &mut bench.out);
        let without_lease = timed("arm", "a", 100.0, script(ControlType::Position, &PAPER));
        bench.send_on(LINK, of("anna's", without_lease));
        bench.until(200);
        case(&mut bench);
        bench.robot.handle(bench.now, LinkId(u64::MAX), barred("operator anna"), &mut bench.out);
        assert!(bench.robot.is_idle());
        bench.until(5_000);
        assert_eq!(bench.values(), [(100, 45.0)], "it moves no further");
    }
}

#[test]
fn session_continued_with_new_key_survives_end_of_old_key() {
    let mut bench = anna_plays(None);
    let renewed = LinkId(3);
    let roles = DRIVES.into_iter().collect();
    let proof = urrcp::Proof { name: "operator anna".parse().unwrap(), roles, serial: "new".parse().ok() };
    bench.robot.handle(bench.now, renewed, Input::Proven(proof), &mut bench.out);
    bench.send_on(renewed, hello("anna's"));
    bench.robot.handle(bench.now, LinkId(u64::MAX), barred("operator anna"), &mut bench.out);
    assert!(!bench.robot.is_idle());
    bench.robot.handle(bench.now, LinkId(u64::MAX), barred("new"), &mut bench.out);
    assert!(bench.robot.is_idle());
}
