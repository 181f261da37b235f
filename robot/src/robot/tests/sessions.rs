//! The session to which a robot belongs, and how it comes to rest on a stop.

use super::*;
use urrcp::SessionId;

const OTHER: LinkId = LinkId(2);

fn of(session: &str, request: ControlRequest) -> Message {
    Message::ControlRequest(ControlRequest { session: SessionId::new(session).ok(), ..request })
}

fn hello(session: &str) -> Message {
    Message::AvailabilityRequest(AvailabilityRequest {
        timestamp: None,
        session: SessionId::new(session).ok(),
    })
}

impl Bench {
    fn send_on(&mut self, link: LinkId, message: Message) {
        self.robot.handle(self.now, link, Input::Message(message), &mut self.out);
    }

    fn last_said(&self) -> String {
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
fn a_second_session_is_told_to_whom_the_robot_belongs() {
    let mut bench = Bench::new();
    bench.send_on(LINK, hello("first"));
    assert_eq!(bench.last_said(), "1 OK ");
    bench.send_on(OTHER, hello("second"));
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to session `first` until that ends");
    bench.send_on(OTHER, of("second", timed("arm", "b", 900.0, script(ControlType::Position, &PAPER))));
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to session `first` until that ends");
    // Neither does one that names no session, nor may the second stop what the first does.
    bench.send_on(
        OTHER,
        Message::ControlRequest(timed("arm", "c", 900.0, script(ControlType::Position, &PAPER))),
    );
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to session `first` until that ends");
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
fn a_stranger_who_asks_for_a_reading_that_there_is_not_stops_nothing() {
    let mut bench = Bench::new();
    bench.send_on(LINK, of("first", timed("arm", "a", 900.0, script(ControlType::Position, &PAPER))));
    let read = |device: &str| ControlRequest::immediate(DeviceId::new(device).unwrap(), Command::ReadSensor);
    bench.send_on(OTHER, Message::ControlRequest(read("arm")));
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to session `first` until that ends");
    bench.send_on(OTHER, Message::ControlRequest(read("thermometer")));
    assert_eq!(bench.last_said(), "2 Provide ", "to read is free to all");
    bench.until(5_000);
    assert_eq!(bench.values(), [(900, 45.0), (1_900, 0.0), (2_900, 45.0)]);
}

#[test]
fn a_session_that_has_gone_does_not_come_back_with_what_others_hold() {
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
fn a_robot_is_free_once_its_session_has_gone_and_nothing_is_held() {
    let mut bench = Bench::new();
    bench.send_on(LINK, of("first", timed("arm", "a", 900.0, script(ControlType::Position, &PAPER))));
    bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    bench.send_on(OTHER, hello("second"));
    assert_eq!(bench.last_said(), "2 Failed `r` belongs to session `first` until that ends");
    bench.until(3_000);
    bench.send_on(OTHER, hello("second"));
    assert_eq!(bench.last_said(), "2 OK ");
}

#[test]
fn a_session_goes_on_on_another_link() {
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
fn a_refusal_for_another_session_is_not_remembered() {
    let mut bench = Bench::new();
    bench.send_on(LINK, hello("first"));
    let request = timed("arm", "b", 9_000.0, script(ControlType::Position, &PAPER));
    bench.send_on(OTHER, of("second", request.clone()));
    bench.until(6_000);
    bench.send_on(OTHER, of("second", request));
    assert_eq!(bench.last_said(), "2 Accepted ");
}

#[test]
fn a_cancel_that_holds_leaves_the_device_where_it_is() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &PAPER)));
    bench.until(500);
    let cancel = ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()));
    bench.request(ControlRequest { hold: true, ..cancel });
    assert_eq!(bench.robot.value("arm", ControlType::Position, at(600)), Some(45.0));
    bench
        .request(ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel())));
    assert_eq!(bench.robot.value("arm", ControlType::Position, at(700)), Some(10.0));
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
fn where_an_acceleration_is_declared_a_stop_decelerates() {
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
    // 10 at 5 a second squared: two seconds.
    assert_eq!([4_000, 5_000, 6_000].map(|millis| speed(&bench, millis)), [10.0, 5.0, 0.0]);
    let position = |millis| bench.robot.value("arm", ControlType::Position, at(millis)).unwrap();
    assert!((position(4_400) - 33.6).abs() < 1e-9, "{}", position(4_400));
    let mut before = (position(4_000), 8.0);
    for millis in (4_001..9_000).map(i64::from) {
        let speed = (position(millis) - before.0) / 0.001;
        assert!(((speed - before.1) / 0.001).abs() < 20.5, "{millis}: {before:?} {speed}");
        before = (position(millis), speed);
    }
    assert_eq!(position(9_000), 0.0);
}

#[test]
fn a_link_that_names_many_sessions_is_remembered_for_the_last_of_them() {
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
fn strangers_however_many_end_no_lease_of_a_link_that_stands() {
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
fn no_session_renews_the_lease_of_another_however_many_have_been() {
    let mut bench = Bench::new();
    // The first continues by a link of its own, so that it is not forgotten.
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
