//! Tests the session that owns a robot, and how the robot comes to rest when it is stopped.

use super::*;
use urrcp::SessionId;
use urrcp::{Proof, Role};

pub(super) const OTHER: LinkId = LinkId(2);

pub(super) fn of(session: &str, request: ControlRequest) -> Message {
    Message::ControlRequest(ControlRequest { session: SessionId::new(session).ok(), ..request })
}

pub(super) fn hello(session: &str) -> Message {
    Message::AvailabilityRequest(AvailabilityRequest {
        timestamp: None,
        session: SessionId::new(session).ok(),
        seize: false,
        revocation_list: None,
    })
}

impl Bench {
    pub(super) fn send_on(&mut self, link: LinkId, message: Message) {
        self.robot.handle(self.now, link, Input::Message(message), &mut self.out);
    }

    pub(super) fn last_said(&self) -> String {
        match self.out.iter().rfind(|output| matches!(output, Output::Send { .. })) {
            Some(Output::Send { link, message: Message::ControlResponse(r) }) => {
                format!("{} {} {}", link.0, r.status, r.error.as_ref().map_or("", |e| e.message.as_str()))
            }
            Some(Output::Send { link, message: Message::AvailabilityResponse(r) }) => {
                format!("{} {} {}", link.0, r.status, r.error.as_ref().map_or("", |e| e.message.as_str()))
            }
            other => format!("{other:?}"),
        }
    }
}

#[test]
fn second_session_is_refused_while_robot_belongs_to_another() {
    let mut bench = Bench::new();
    bench.send_on(LINK, hello("first"));
    assert_eq!(bench.last_said(), "1 OK ");
    bench.send_on(OTHER, hello("second"));
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to another session until that session ends");
    bench.send_on(OTHER, of("second", timed("arm", "b", 900.0, script(ControlType::Position, &PAPER))));
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to another session until that session ends");
    // A request without a session is refused as well, and the second session must not stop the first session's commands.
    bench.send_on(
        OTHER,
        Message::ControlRequest(timed("arm", "c", 900.0, script(ControlType::Position, &PAPER))),
    );
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to another session until that session ends");
    bench.send_on(LINK, of("first", timed("arm", "a", 900.0, script(ControlType::Position, &PAPER))));
    bench.send_on(
        OTHER,
        of(
            "second",
            ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel())),
        ),
    );
    bench.until(5_000);
    assert_eq!(bench.values(), [(900, 45.0), (1_900, 0.0), (2_900, 45.0)]);
}

#[test]
fn every_control_request_must_name_its_session() {
    let mut bench = Bench::new();
    bench.send_on(LINK, hello("first"));
    let script = timed("arm", "a", 900.0, script(ControlType::Position, &PAPER));
    bench.send_on(LINK, Message::ControlRequest(script.clone()));
    assert_eq!(bench.last_said(), "1 Failed `r` belongs to another session until that session ends");
    bench.send_on(LINK, of("first", script));
    assert_eq!(bench.last_said(), "1 Accepted ");
}

#[test]
fn robot_without_session_obeys_every_server() {
    let mut bench = Bench::new();
    for (link, device) in [(LINK, "arm"), (OTHER, "ramp")] {
        let script = timed(device, device, 900.0, script(ControlType::Position, &PAPER));
        bench.send_on(link, Message::ControlRequest(script));
        assert_eq!(bench.last_said(), format!("{} Accepted ", link.0));
    }
}

#[test]
fn sensor_reading_does_not_claim_robot() {
    for (device, command, expected) in [
        ("thermometer", Command::ReadSensor, "1 OK "),
        (
            "arm",
            script(ControlType::Position, &PAPER),
            "1 Failed `r` belongs to another session until that session ends",
        ),
    ] {
        let mut bench = Bench::new();
        let request = ControlRequest::immediate(DeviceId::new(device).unwrap(), command);
        bench.send_on(OTHER, of("second", request));
        bench.send_on(LINK, hello("first"));
        assert_eq!(bench.last_said(), expected, "{device}");
    }
}

#[test]
fn every_device_accepts_an_empty_script() {
    let mut bench = Bench::new();
    bench.until(500);
    for device in ["arm", "ramp", "wheel", "thermometer"] {
        for start in [0.0, 900.0] {
            let stop = timed(device, &format!("{device} {start}"), start, Command::Script(Script::cancel()));
            bench.request(ControlRequest { pending_until: Some(at(100)), ..stop });
            assert_eq!(bench.statuses().last().unwrap(), "OK", "{device} {start}");
        }
    }
}

#[test]
fn strangers_request_for_a_missing_sensor_stops_nothing() {
    let mut bench = Bench::new();
    bench.send_on(LINK, of("first", timed("arm", "a", 900.0, script(ControlType::Position, &PAPER))));
    let read = |device: &str| ControlRequest::immediate(DeviceId::new(device).unwrap(), Command::ReadSensor);
    bench.send_on(OTHER, Message::ControlRequest(read("arm")));
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to another session until that session ends");
    bench.send_on(OTHER, Message::ControlRequest(read("thermometer")));
    assert_eq!(bench.last_said(), "2 Provide ", "to read is free to all");
    bench.until(5_000);
    assert_eq!(bench.values(), [(900, 45.0), (1_900, 0.0), (2_900, 45.0)]);
}

#[test]
fn ended_session_is_not_revived_by_commands_of_others() {
    let mut bench = Bench::new();
    bench.send_on(LINK, hello("first"));
    bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    let plain = |id| Message::ControlRequest(timed("arm", id, 900.0, script(ControlType::Position, &PAPER)));
    bench.send_on(OTHER, plain("a"));
    assert_eq!(bench.last_said(), "2 Accepted ");
    let cancel = ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()));
    bench.send_on(OTHER, Message::ControlRequest(cancel));
    assert_eq!(bench.last_said(), "2 OK ");
}

#[test]
fn robot_is_free_once_its_session_is_gone_and_no_command_is_held() {
    let mut bench = Bench::new();
    bench.send_on(LINK, of("first", timed("arm", "a", 900.0, script(ControlType::Position, &PAPER))));
    bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    bench.send_on(OTHER, hello("second"));
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to another session until that session ends");
    bench.until(3_000);
    bench.send_on(OTHER, hello("second"));
    assert_eq!(bench.last_said(), "2 OK ");
}

#[test]
fn session_continues_on_another_link() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 900.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(1_000.0, 1_000.0);
    bench.send_on(LINK, of("first", request));
    bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    for millis in (500..4_000).step_by(500) {
        bench.until(millis);
        bench.send_on(OTHER, hello("first"));
    }
    assert_eq!(bench.values(), [(900, 45.0), (1_900, 0.0), (2_900, 45.0)]);
    let ended = bench.out.iter().any(|output| {
        matches!(output, Output::Send { link, message: Message::ControlResponse(r) } if *link == OTHER && r.status == Status::Ok)
    });
    assert!(ended, "the end is reported on the link that stands");
}

#[test]
fn refusal_due_to_another_session_is_not_remembered() {
    let mut bench = Bench::new();
    bench.send_on(LINK, hello("first"));
    let request = timed("arm", "b", 9_000.0, script(ControlType::Position, &PAPER));
    bench.send_on(OTHER, of("second", request.clone()));
    bench.until(6_000);
    bench.send_on(OTHER, of("second", request));
    assert_eq!(bench.last_said(), "2 Accepted ");
}

#[test]
fn cancel_holds_device_in_place_and_cancel_with_home_moves_it_home() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &PAPER)));
    bench.until(500);
    let cancel = ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()));
    bench.request(cancel.clone());
    assert_eq!(bench.robot.value("arm", ControlType::Position, at(600)), Some(45.0));
    bench.request(ControlRequest { home: true, ..cancel });
    // The arm moves at its declared speed of 10 per second.
    assert_eq!(bench.robot.value("arm", ControlType::Position, at(1_500)), Some(35.0));
    assert_eq!(bench.robot.value("arm", ControlType::Position, at(4_000)), Some(10.0));
}

const LIMITED: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "arm", "name": "arm", "default_value": 0, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "acceleration": {"min_value": -20, "max_value": 20, "granularity": 1},
     "script": {"min_value": -20, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 4, "control_types": ["position"]}}},
  {"id": "wheel", "name": "wheel", "available_control_types": {
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "acceleration": {"min_value": -5, "max_value": 5, "granularity": 1},
     "script": {"min_value": -10, "max_value": 10, "granularity": 1, "max_number_of_steps": 4, "control_types": ["speed"]}}}]}"#;

#[test]
fn stop_decelerates_a_device_with_declared_acceleration() {
    let block: InitializationBlock = serde_json::from_str(LIMITED).unwrap();
    let mut bench = Bench { robot: Robot::new(block), ..Bench::new() };
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &[(0.0, 0.0), (10_000.0, 80.0)])));
    bench.request(timed("wheel", "w", 0.0, script(ControlType::Speed, &[(0.0, 10.0), (9_000.0, 10.0)])));
    bench.until(4_000);
    for device in ["arm", "wheel"] {
        bench.request(ControlRequest::immediate(
            DeviceId::new(device).unwrap(),
            Command::Script(Script::cancel()),
        ));
    }
    let speed = |bench: &Bench, millis| bench.robot.value("wheel", ControlType::Speed, at(millis)).unwrap();
    // The speed decreases from 10 at 5 per second squared, which takes two seconds.
    assert_eq!([4_000, 5_000, 6_000].map(|millis| speed(&bench, millis)), [10.0, 5.0, 0.0]);
    let position = |millis| bench.robot.value("arm", ControlType::Position, at(millis)).unwrap();
    assert!((position(4_400) - 33.6).abs() < 1e-9, "{}", position(4_400));
    let mut before = (position(4_000), 8.0);
    for millis in (4_001..9_000).map(i64::from) {
        let speed = (position(millis) - before.0) / 0.001;
        assert!(((speed - before.1) / 0.001).abs() < 20.5, "{millis}: {before:?} {speed}");
        before = (position(millis), speed);
    }
    assert!((position(9_000) - 33.6).abs() < 1e-9, "it stays where it came to rest");
}

#[test]
fn link_that_names_many_sessions_is_remembered_for_the_last_one() {
    let mut bench = Bench::new();
    for i in 0..2_000 {
        bench.send_on(OTHER, hello(&format!("s{i}")));
    }
    assert!(bench.robot.parties.remembered() < 2 * crate::parties::SESSIONS_MAX);
    bench.robot.handle(bench.now, OTHER, Input::LinkDown, &mut bench.out);
    bench.until(6_000);
    bench.send_on(LINK, hello("another"));
    assert_eq!(bench.last_said(), "1 OK ");
}

#[test]
fn many_strangers_do_not_end_the_lease_of_an_open_link() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 900.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(500.0, 500.0);
    bench.send_on(LINK, of("first", request));
    for millis in (400..4_000).step_by(400) {
        bench.until(millis);
        bench.send_on(LINK, hello("first"));
        bench.until(millis + 1);
        for i in 0..1_200 {
            bench.send_on(LinkId(1_000 + i), hello(&format!("{millis}-{i}")));
            bench.robot.handle(bench.now, LinkId(1_000 + i), Input::LinkDown, &mut bench.out);
        }
    }
    assert_eq!(bench.values(), [(900, 45.0), (1_900, 0.0), (2_900, 45.0)]);
}

#[test]
fn no_session_renews_lease_of_another_even_after_many_sessions() {
    let mut bench = Bench::new();
    // The first session also uses another link, so that it is not forgotten.
    for link in [OTHER, LINK] {
        bench.send_on(link, hello("s0"));
    }
    for i in 1..600 {
        bench.send_on(OTHER, hello(&format!("s{i}")));
    }
    bench.until(9_000);
    let mut request = timed("arm", "a", 12_000.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(1_000.0, 1_000.0);
    bench.send_on(OTHER, of("owner", request));
    for millis in (9_500..12_000).step_by(500) {
        bench.until(millis);
        bench.send_on(OTHER, hello("stranger"));
    }
    bench.until(20_000);
    assert_eq!(bench.values(), [], "the owner was silent from 9 s on");
}

/// Returns all messages that the robot has sent, encoded as on the wire, as text.
fn all_said(bench: &Bench) -> String {
    let mut bytes = Vec::new();
    for output in &bench.out {
        if let Output::Send { message, .. } = output {
            urrcp::encode(message, &mut bytes);
        }
    }
    String::from_utf8(bytes).unwrap()
}

#[test]
fn no_request_reveals_session_name_to_a_stranger() {
    let mut bench = Bench::new();
    bench.send_on(LINK, of("a-secret", timed("arm", "a", 900.0, script(ControlType::Position, &PAPER))));
    bench.out.clear();
    for session in [None, SessionId::new("guess").ok()] {
        let availability = AvailabilityRequest {
            timestamp: None,
            session: session.clone(),
            seize: false,
            revocation_list: None,
        };
        bench.send_on(OTHER, Message::AvailabilityRequest(availability));
        let inquiry = urrcp::Inquiry {
            session: session.clone(),
            requests: vec![RequestId::new("a").unwrap()],
            devices: vec![DeviceId::new("arm").unwrap()],
            ..urrcp::Inquiry::default()
        };
        bench.send_on(OTHER, Message::Inquiry(inquiry));
        for device in ["arm", "wheel", "thermometer", "none"] {
            let set = Command::Set(Setpoint::new(ControlType::Speed, 1.0));
            for command in [Command::ReadSensor, Command::Script(Script::cancel()), set] {
                let request = ControlRequest::immediate(DeviceId::new(device).unwrap(), command);
                let request = ControlRequest { session: session.clone(), ..request };
                bench.send_on(OTHER, Message::ControlRequest(request));
            }
        }
        bench.send_on(OTHER, Message::InitializationRequest(urrcp::InitializationRequest::default()));
    }
    let said = all_said(&bench);
    assert!(said.contains("belongs to another session") && !said.contains("a-secret"), "{said}");
}

#[test]
fn stranger_cannot_renew_a_lease_or_divert_a_report() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 900.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(1_000.0, 500.0);
    bench.send_on(LINK, of("first", request));
    for millis in (100..1_400).step_by(100) {
        bench.until(millis);
        bench.send_on(OTHER, hello("second"));
        bench.send_on(OTHER, Message::AvailabilityRequest(AvailabilityRequest::default()));
        bench.send_on(OTHER, Message::Inquiry(urrcp::Inquiry::default()));
    }
    // The owner's link breaks: its reports are discarded instead of being sent to a link of another session.
    bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    bench.until(9_000);
    assert_eq!(bench.values(), [], "its lease over the start was over at 0.5 s, whatever others said");
    let diverted = bench.out.iter().any(|output| {
        matches!(output, Output::Send { link, message: Message::ControlResponse(r) }
            if *link == OTHER && r.event_timestamp.is_some())
    });
    assert!(!diverted);
}

#[test]
fn session_belongs_to_proven_name_of_its_peer() {
    let mut bench = Bench::new();
    let named = |name: &str| {
        Input::Proven(Proof {
            name: Label::new(name).unwrap(),
            roles: [Role::Observe, Role::Drive].into_iter().collect(),
            serial: None,
        })
    };
    bench.robot.handle(bench.now, LINK, named("desk"), &mut bench.out);
    bench.robot.handle(bench.now, OTHER, named("intruder"), &mut bench.out);
    let mut request = timed("arm", "a", 900.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(500.0, 500.0);
    bench.send_on(LINK, of("show", request));
    let stop = ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()));
    // Neither a peer with another name nor an unproven peer can use this session.
    for link in [OTHER, LinkId(3)] {
        bench.send_on(link, of("show", stop.clone()));
        let refused = format!("{} Failed `r` belongs to another session until that session ends", link.0);
        assert_eq!(bench.last_said(), refused);
    }
    bench.until(400);
    bench.send_on(OTHER, hello("show"));
    bench.until(2_000);
    assert_eq!(bench.statuses().last().map(String::as_str), Some("Failed link_lost"), "nor do they renew");
    // The same name on another link is the same session.
    bench.send_on(LINK, of("show", timed("arm", "b", 3_000.0, script(ControlType::Position, &PAPER))));
    let again = LinkId(4);
    bench.robot.handle(bench.now, again, named("desk"), &mut bench.out);
    bench.send_on(again, of("show", stop));
    assert_eq!(bench.last_said(), "4 OK ");
}

#[test]
fn stop_with_future_timestamp_does_not_block_next_session() {
    let mut bench = Bench::new();
    let in_an_hour = Some(Timestamp::from_nanos(BEGIN + 3_600_000_000_000));
    let stop = ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()));
    bench.send_on(OTHER, Message::ControlRequest(ControlRequest { timestamp: in_an_hour, ..stop.clone() }));
    let sent_at = |id: &str, ms: i64| ControlRequest {
        timestamp: Some(Timestamp::from_nanos(BEGIN + ms * 1_000_000)),
        ..timed("arm", id, 900.0, script(ControlType::Position, &PAPER))
    };
    bench.send_on(LINK, Message::ControlRequest(sent_at("early", 240)));
    assert_eq!(
        bench.last_said(),
        "1 Failed the command was cancelled by a stop that arrived before it",
        "clocks may differ by this much"
    );
    bench.send_on(LINK, Message::ControlRequest(sent_at("a", 260)));
    assert_eq!(bench.last_said(), "1 Accepted ");
    bench.send_on(OTHER, Message::ControlRequest(ControlRequest { timestamp: in_an_hour, ..stop.clone() }));
    bench.until(10);
    bench.send_on(LINK, of("show", sent_at("b", 0)));
    assert_eq!(
        bench.last_said(),
        "1 Failed the command was cancelled by a stop that arrived before it",
        "it may have been sent before the stop"
    );
    bench.send_on(LINK, of("show", sent_at("c", 11)));
    assert_eq!(bench.last_said(), "1 Accepted ");
    // A stop also cancels commands that its sender has sent earlier by a clock that is ahead.
    let mut bench = Bench::new();
    let ahead = Some(Timestamp::from_nanos(BEGIN + 4_000_000_000));
    bench.send_on(LINK, of("show", ControlRequest { timestamp: ahead, ..stop }));
    let overtaken = ControlRequest {
        timestamp: Some(Timestamp::from_nanos(BEGIN + 3_900_000_000)),
        ..timed("arm", "b", 900.0, script(ControlType::Position, &PAPER))
    };
    bench.send_on(OTHER, of("show", overtaken));
    assert_eq!(bench.statuses(), ["OK", "Failed cancelled"]);
}

/// Checks the robot's response to a script for the arm. `start_ms` is the delay of the start, and `last_ms` the offset of the last step.
#[track_caller]
fn check_reach(start_ms: f64, last_ms: f64, lease: Option<StopCondition>, expected: &str) {
    let mut bench = Bench::new();
    let far = script(ControlType::Position, &[(0.0, 45.0), (last_ms, 0.0)]);
    bench.request(ControlRequest { stop_condition: lease, ..timed("arm", "a", start_ms, far) });
    assert_eq!(bench.statuses(), [expected], "{:?}", bench.last_said());
}

#[test]
fn single_message_cannot_occupy_a_robot_for_years() {
    const HOUR: f64 = 3_600_000.0;
    let short = lease(1_000.0, 1_000.0);
    check_reach(0.9 * HOUR, 0.0, None, "Accepted");
    check_reach(1.1 * HOUR, 0.0, None, "Failed out_of_range");
    check_reach(1.1 * HOUR, 0.0, short, "Accepted");
    check_reach(23.9 * HOUR, 0.0, short, "Accepted");
    check_reach(24.1 * HOUR, 0.0, short, "Failed out_of_range");
    check_reach(1_000.0, 23.9 * HOUR, None, "Accepted");
    check_reach(1_000.0, 24.1 * HOUR, None, "Failed out_of_range");
    check_reach(1_000.0, 1e11, short, "Accepted");
    // A limit that is too long does not count as a limit.
    check_reach(1_000.0, 1e11, lease(1_000.0, 1e11), "Failed out_of_range");
    check_reach(2.0 * HOUR, 0.0, lease(1e11, 1_000.0), "Failed out_of_range");
}

#[test]
fn command_queued_on_its_device_needs_no_lease_before_its_start() {
    const HOUR: f64 = 3_600_000.0;
    let mut bench = Bench::new();
    let long = script(ControlType::Position, &[(0.0, 45.0), (2.0 * HOUR, 0.0)]);
    bench.request(timed("arm", "a", 1_000.0, long));
    bench.request(timed("arm", "b", 3.0 * HOUR, script(ControlType::Position, &PAPER)));
    assert_eq!(bench.statuses()[..2], ["Accepted", "Accepted"]);
}

/// Returns the input that proves the name and the roles of an operator.
pub(super) fn operator(name: &str, roles: &[Role]) -> Input {
    let roles = roles.iter().copied().collect();
    // Each operator has one key, whose serial number is its name.
    Input::Proven(Proof { name: Label::new(name).unwrap(), roles, serial: Label::new(name).ok() })
}

pub(super) fn stop_of(device: &str) -> ControlRequest {
    ControlRequest::immediate(DeviceId::new(device).unwrap(), Command::Script(Script::cancel()))
}

#[test]
fn roles_of_an_operator_determine_permitted_requests() {
    let ask = || {
        Message::AvailabilityRequest(AvailabilityRequest {
            timestamp: None,
            session: None,
            seize: false,
            revocation_list: None,
        })
    };
    let set = || {
        of(
            "s",
            ControlRequest::immediate(
                DeviceId::new("arm").unwrap(),
                Command::Set(Setpoint::new(ControlType::Position, 30.0)),
            ),
        )
    };
    let allowed = |role: Role, message: Message| {
        let mut bench = Bench::new();
        bench.robot.handle(bench.now, LINK, operator("anna", &[role]), &mut bench.out);
        bench.send_on(LINK, message);
        !bench.last_said().contains("but this requires")
    };
    let table = [
        (Role::Observe, [true, false, false, false, false]),
        (Role::Drive, [true, true, true, true, true]),
        (Role::Stop, [true, false, false, true, false]),
        (Role::Seize, [false, false, false, false, false]),
    ];
    for (role, expected) in table {
        let home = ControlRequest { home: true, ..stop_of("arm") };
        let [stop, home] = [stop_of("arm"), home].map(Message::ControlRequest);
        let messages = [ask(), hello("s"), set(), stop, home];
        assert_eq!(messages.map(|message| allowed(role, message)), expected, "{role}");
    }
}

#[test]
fn only_stop_role_stops_robot_of_another_session_and_operator_is_named() {
    let mut bench = Bench::new();
    bench.robot.handle(bench.now, LINK, operator("operator anna", &[Role::Drive]), &mut bench.out);
    bench.robot.handle(bench.now, OTHER, operator("operator bert", &[Role::Drive]), &mut bench.out);
    let third = LinkId(3);
    bench.robot.handle(bench.now, third, operator("operator cleo", &[Role::Stop]), &mut bench.out);
    let mut request = timed("arm", "a", 100.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(5_000.0, 5_000.0);
    bench.send_on(LINK, of("show", request));
    bench.send_on(OTHER, of("other", stop_of("arm")));
    assert!(bench.last_said().contains("belongs to another session"), "{}", bench.last_said());
    assert!(!bench.robot.is_idle());
    bench.out.clear();
    bench.send_on(third, Message::ControlRequest(stop_of("arm")));
    assert!(bench.robot.is_idle());
    let told = bench.out.iter().find_map(|output| match output {
        Output::Send { link: LINK, message: Message::ControlResponse(r) } => r.error.clone(),
        _ => None,
    });
    assert_eq!(told.map(|error| error.message).as_deref(), Some("stopped by operator cleo"));
}

#[test]
fn forbidden_request_gets_response_of_its_kind_with_its_timestamp() {
    let mut bench = Bench::new();
    bench.robot.handle(bench.now, LINK, operator("anna", &[Role::Seize]), &mut bench.out);
    let timestamp = Some(Timestamp::from_nanos(7));
    let session = SessionId::new("show").ok();
    bench.send(Message::Inquiry(urrcp::Inquiry { timestamp, ..urrcp::Inquiry::default() }));
    bench.send(Message::AvailabilityRequest(AvailabilityRequest {
        timestamp,
        session,
        seize: false,
        revocation_list: None,
    }));
    bench.send(Message::InitializationRequest(urrcp::InitializationRequest::default()));
    bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &PAPER)));
    let told = |output: &Output| match output {
        Output::Send { message: Message::InquiryResponse(r), .. } => {
            ("inquiry", r.originate_timestamp, r.status.clone(), r.error.as_ref().map(|e| e.code.clone()))
        }
        Output::Send { message: Message::AvailabilityResponse(r), .. } => (
            "availability",
            r.originate_timestamp,
            r.status.clone(),
            r.error.as_ref().map(|e| e.code.clone()),
        ),
        Output::Send { message: Message::ControlResponse(r), .. } => {
            ("control", None, r.status.clone(), r.error.as_ref().map(|e| e.code.clone()))
        }
        other => panic!("{other:?}"),
    };
    let forbidden = |kind, asked| (kind, asked, Status::Failed, Some(ErrorCode::Forbidden));
    let expected = [
        forbidden("inquiry", timestamp),
        forbidden("availability", timestamp),
        forbidden("availability", None),
        forbidden("control", None),
    ];
    assert_eq!(bench.out.iter().map(told).collect::<Vec<_>>(), expected);
    bench.until(500);
    assert_eq!(bench.values(), []);
}

#[test]
fn refusal_lists_actual_and_required_roles() {
    for (roles, expected) in [
        (&[Role::Stop][..], "1 Failed anna has the role stop, but this requires the role drive"),
        (&[], "1 Failed anna has no role, but this requires the role drive"),
    ] {
        let mut bench = Bench::new();
        bench.robot.handle(bench.now, LINK, operator("anna", roles), &mut bench.out);
        bench.send_on(LINK, hello("show"));
        assert_eq!(bench.last_said(), expected);
    }
}

#[test]
fn idle_robot_is_free_after_five_seconds_of_silence() {
    for (millis, expected) in
        [(4_999, "2 Failed `r` belongs to another session until that session ends"), (5_000, "2 OK ")]
    {
        let mut bench = Bench::new();
        bench.send_on(LINK, hello("first"));
        bench.until(millis);
        bench.send_on(OTHER, hello("second"));
        assert_eq!(bench.last_said(), expected, "{millis}");
    }
}

#[test]
fn idle_robot_is_free_as_soon_as_last_link_of_its_session_is_lost() {
    let mut bench = Bench::new();
    bench.send_on(LINK, hello("first"));
    bench.send_on(LinkId(3), hello("first"));
    bench.robot.handle(bench.now, LinkId(3), Input::LinkDown, &mut bench.out);
    bench.send_on(OTHER, hello("second"));
    assert!(bench.last_said().starts_with("2 Failed"), "its other link stands");
    bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    bench.send_on(OTHER, hello("second"));
    assert_eq!(bench.last_said(), "2 OK ");
}

#[test]
fn availability_request_without_session_succeeds_on_an_owned_robot() {
    let mut bench = Bench::new();
    bench.send_on(LINK, hello("first"));
    bench.send_on(OTHER, Message::AvailabilityRequest(AvailabilityRequest::default()));
    assert_eq!(bench.last_said(), "2 OK ");
}

#[cfg(feature = "host")]
#[test]
fn every_change_of_the_owner_session_has_a_distinct_number() {
    let mut bench = Bench::new();
    let mut seen = vec![bench.robot.last_claimant().0];
    for session in ["first", "second"] {
        bench.send_on(LINK, hello(session));
        seen.push(bench.robot.last_claimant().0);
        bench.send_on(LINK, hello(session));
        assert_eq!(bench.robot.last_claimant().0, seen[seen.len() - 1], "the same again");
        assert_eq!(bench.robot.last_claimant().1.unwrap().session.as_str(), session);
        bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
        bench.robot.release_if_over(bench.now);
        assert!(bench.robot.last_claimant().1.is_none());
        seen.push(bench.robot.last_claimant().0);
    }
    assert!(seen.is_sorted_by(|before, after| before < after), "{seen:?}");
}

#[test]
fn observe_role_can_read_sensors_and_stop_role_cannot() {
    let expected = "1 Failed anna has the role stop, but this requires the role observe or drive";
    for (role, expected) in
        [(Role::Observe, "1 Provide "), (Role::Drive, "1 Provide "), (Role::Stop, expected)]
    {
        let mut bench = Bench::new();
        bench.robot.handle(bench.now, LINK, operator("anna", &[role]), &mut bench.out);
        let read = ControlRequest::immediate(DeviceId::new("thermometer").unwrap(), Command::ReadSensor);
        bench.send_on(LINK, Message::ControlRequest(read));
        assert_eq!(bench.last_said(), expected);
    }
}

#[test]
fn roles_determine_inquiries_permitted_with_and_without_session() {
    for (role, asks, asks_for_its_session) in
        [(Role::Observe, true, false), (Role::Drive, true, true), (Role::Stop, false, false)]
    {
        for (session, expected) in [(None, asks), (SessionId::new("show").ok(), asks_for_its_session)] {
            let mut bench = Bench::new();
            bench.robot.handle(bench.now, LINK, operator("anna", &[role]), &mut bench.out);
            bench.send(Message::Inquiry(urrcp::Inquiry { session, ..urrcp::Inquiry::default() }));
            let Some(Output::Send { message: Message::InquiryResponse(r), .. }) = bench.out.last() else {
                panic!("{:?}", bench.out)
            };
            assert_eq!(r.status == Status::Ok, expected, "{role}");
        }
    }
}

#[test]
fn request_with_precomputed_hash_requires_the_same_roles() {
    for (role, status) in [(Role::Observe, "Failed forbidden"), (Role::Drive, "Accepted")] {
        let mut bench = Bench::new();
        bench.robot.handle(bench.now, LINK, operator("operator anna", &[role]), &mut bench.out);
        let request = timed("arm", "a", 100.0, script(ControlType::Position, &PAPER));
        let hash = request.command.content_hash();
        let request =
            ControlRequest { content_hash: Some(hash), session: SessionId::new("s").ok(), ..request };
        bench.robot.handle(bench.now, LINK, Input::Hashed(request, hash), &mut bench.out);
        assert_eq!(bench.statuses(), [status], "{role}");
    }
}
