//! Tests the rules of the protocol that a robot must follow, one rule per test.

mod hardware;
mod inquiries;
mod instants;
mod leases;
mod planned;
mod seizing;
mod sessions;

use proptest::prelude::*;
use urrcp::{
    AvailabilityRequest, Command, ControlRequest, ControlResponse, ControlType, Decoder, DeviceId, ErrorCode,
    InitializationBlock, Label, Message, Millis, RequestId, Script, Server, Setpoint, Span, Status,
    StatusValue, Step, StopCondition, Timestamp,
};

use super::{Input, Output, Robot, SetValue};
use crate::device::{Motion, MotionLimits};
use crate::ids::LinkId;

const LINK: LinkId = LinkId(1);
/// Time on the robot's clock at which every test starts, in nanoseconds.
const BEGIN: i64 = 1_000_000_000_000;

const BLOCK: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "arm", "name": "arm", "default_value": 10, "script_queue": 2, "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "script": {"min_value": -10, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 4}}},
  {"id": "ramp", "name": "ramp", "interpolation": "linear", "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "script": {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 4}}},
  {"id": "wheel", "name": "wheel", "available_control_types": {
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "script": {"min_value": -10, "max_value": 10, "granularity": 1, "max_number_of_steps": 4}}},
  {"id": "thermometer", "name": "t", "available_control_types": {"sensor": {"min_value": -20, "max_value": 60}}}]}"#;

/// A robot under test, its current time, and its outputs so far.
struct Bench {
    robot: Robot,
    now: Timestamp<urrcp::Robot>,
    out: Vec<Output>,
}

impl Bench {
    fn new() -> Self {
        let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
        Self { robot: Robot::new(block), now: Timestamp::from_nanos(BEGIN), out: Vec::new() }
    }

    /// Advances the time to `millis` milliseconds after [`BEGIN`], from wake-up to wake-up.
    fn until(&mut self, millis: i64) {
        let end = at(millis);
        while let Some(wakeup) = self.robot.next_wakeup().filter(|wakeup| *wakeup <= end) {
            self.now = self.now.max(wakeup);
            self.robot.advance(self.now, &mut self.out);
        }
        self.now = end;
        self.robot.advance(end, &mut self.out);
    }

    fn send(&mut self, message: Message) {
        self.robot.handle(self.now, LINK, Input::Message(message), &mut self.out);
    }

    fn request(&mut self, request: ControlRequest) {
        self.send(Message::ControlRequest(request));
    }

    fn responses(&self) -> Vec<&ControlResponse> {
        let response =
            |output: &'_ Output| matches!(output, Output::Send { message: Message::ControlResponse(_), .. });
        let sent = self.out.iter().filter(|output| response(output));
        sent.filter_map(|output| match output {
            Output::Send { message: Message::ControlResponse(response), .. } => Some(response),
            _ => None,
        })
        .collect()
    }

    fn statuses(&self) -> Vec<String> {
        let word = |r: &&ControlResponse| match &r.error {
            Some(error) => format!("{} {}", r.status, error.code),
            None => r.status.to_string(),
        };
        self.responses().iter().map(word).collect()
    }

    fn sets(&self) -> Vec<&SetValue> {
        self.out.iter().filter_map(|o| if let Output::Set(set) = o { Some(set) } else { None }).collect()
    }

    /// Returns the times, in milliseconds, and the values of all outputs that set a value directly.
    fn values(&self) -> Vec<(i64, f64)> {
        let value = |set: &&SetValue| match &set.motion {
            Motion::Set(setpoint) => Some(((set.due.as_nanos() - BEGIN) / 1_000_000, setpoint.value)),
            _ => None,
        };
        self.sets().iter().filter_map(value).collect()
    }
}

fn at(millis: i64) -> Timestamp<urrcp::Robot> {
    Timestamp::from_nanos(BEGIN + millis * 1_000_000)
}

fn script(control_type: ControlType, steps: &[(f64, f64)]) -> Command {
    let step = |(millis, value): &(f64, f64)| Step {
        offset: Millis::new(*millis).unwrap(),
        setpoint: Setpoint::new(control_type, *value),
        stop_condition: None,
    };
    Command::Script(Script::new(steps.iter().map(step).collect()).unwrap())
}

fn timed(device: &str, id: &str, start_ms: f64, command: Command) -> ControlRequest {
    ControlRequest {
        timestamp: Some(Timestamp::<Server>::from_nanos(BEGIN)),
        time_offset_to_start: Some(Millis::new(start_ms).unwrap()),
        request_id: Some(RequestId::new(id).unwrap()),
        ..ControlRequest::immediate(DeviceId::new(device).unwrap(), command)
    }
}

fn lease(pending: f64, running: f64) -> Option<StopCondition> {
    Some(StopCondition { pending: Millis::new(pending).ok(), running: Millis::new(running).ok() })
}

const PAPER: [(f64, f64); 3] = [(0.0, 45.0), (1_000.0, 0.0), (2_000.0, 45.0)];

#[test]
fn script_of_the_paper_sets_45_0_45_at_absolute_deadlines() {
    let mut bench = Bench::new();
    bench.until(3);
    bench.request(timed("arm", "a", 1_500.0, script(ControlType::Position, &PAPER)));
    bench.until(5_000);
    assert_eq!(bench.values(), [(1_500, 45.0), (2_500, 0.0), (3_500, 45.0)]);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
    let [accepted, started, ended] = bench.responses()[..] else { panic!() };
    assert!(matches!(&accepted.status_value, StatusValue::Script(script) if script.steps().len() == 3));
    assert_eq!(started.event_timestamp, Some(at(1_500)));
    assert_eq!((ended.steps_done, &ended.status_value), (Some(3), &StatusValue::Number(45.0)));
}

#[test]
fn command_with_a_past_start_is_refused_and_never_started() {
    let mut bench = Bench::new();
    bench.until(1_501);
    bench.request(timed("arm", "a", 1_500.0, script(ControlType::Position, &PAPER)));
    bench.until(9_000);
    assert_eq!(bench.statuses(), ["Failed late"]);
    assert_eq!(bench.values(), []);
}

#[test]
fn command_without_offset_starts_immediately() {
    let mut bench = Bench::new();
    bench.until(70);
    let command = Command::Set(Setpoint::new(ControlType::Position, 30.0));
    bench.request(ControlRequest::immediate(DeviceId::new("arm").unwrap(), command));
    assert_eq!(bench.values(), [(70, 30.0)]);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
}

#[track_caller]
fn check_refused(device: &str, command: Command, code: ErrorCode) {
    let mut bench = Bench::new();
    bench.request(timed(device, "a", 100.0, command));
    bench.until(500);
    let error = bench.responses()[0].error.clone().unwrap();
    assert_eq!(error.code, code, "{error}");
    assert_eq!(bench.responses()[0].status_value, StatusValue::Null);
    assert_eq!(bench.values(), []);
}

#[test]
fn command_that_the_device_does_not_declare_is_refused() {
    check_refused("leg", script(ControlType::Position, &PAPER), ErrorCode::UnknownDevice);
    check_refused("arm", script(ControlType::Acceleration, &PAPER), ErrorCode::UnsupportedControlType);
    check_refused("arm", script(ControlType::Position, &[(0.0, 90.5)]), ErrorCode::OutOfRange);
    check_refused("arm", script(ControlType::Position, &[(0.0, 0.25)]), ErrorCode::OffGranularity);
    let five: Vec<_> = (0..5).map(|i| (f64::from(i), 1.0)).collect();
    check_refused("arm", script(ControlType::Position, &five), ErrorCode::TooManySteps);
}

#[test]
fn unsupported_control_type_sends_the_device_to_its_default_state() {
    let unknown = Command::Unknown(Label::new("torque").unwrap());
    for unsupported in [script(ControlType::Acceleration, &PAPER), unknown] {
        let mut bench = Bench::new();
        bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &PAPER)));
        bench.until(150);
        bench.request(timed("arm", "b", 900.0, unsupported));
        bench.until(9_000);
        assert_eq!(bench.statuses().last().unwrap(), "Failed unsupported_control_type");
        assert_eq!(bench.values(), [(100, 45.0)]);
        let position = bench.robot.value("arm", ControlType::Position, bench.now);
        assert_eq!(position, Some(10.0), "the default value");
    }
}

#[test]
fn stop_with_a_clock_far_ahead_cancels_at_most_five_seconds() {
    let mut bench = Bench::new();
    let mut stop =
        ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()));
    stop.timestamp = Some(at(1_000_000).assume_clock());
    bench.request(stop);
    let sent = |sent: i64| ControlRequest {
        timestamp: Some(at(sent).assume_clock()),
        ..timed("arm", &sent.to_string(), 20_000.0, script(ControlType::Position, &PAPER))
    };
    bench.request(sent(5_000));
    bench.request(sent(5_001));
    assert_eq!(bench.statuses(), ["OK", "Failed cancelled", "Accepted"]);
}

#[test]
fn different_content_hash_is_refused() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 100.0, script(ControlType::Position, &PAPER));
    request.content_hash = Some(script(ControlType::Position, &[(0.0, 1.0)]).content_hash());
    bench.request(request);
    assert_eq!(bench.statuses(), ["Failed malformed"]);
}

#[test]
fn overlapping_scripts_are_refused_and_adjacent_ones_leave_no_gap() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "b", 2_999.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "c", 3_000.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "d", 9_000.0, script(ControlType::Position, &PAPER)));
    assert_eq!(bench.statuses(), ["Accepted", "Failed overlap", "Accepted", "Failed busy"]);
    bench.until(9_000);
    assert_eq!(bench.values().len(), 6);
}

#[test]
fn repeated_request_is_answered_twice_and_executed_once() {
    let mut bench = Bench::new();
    let request = timed("arm", "a", 100.0, script(ControlType::Position, &PAPER));
    bench.request(request.clone());
    bench.request(request.clone());
    bench.until(5_000);
    bench.request(request);
    assert_eq!(bench.statuses(), ["Accepted", "Accepted", "Started", "OK", "OK"]);
    assert_eq!(bench.values().len(), 3);
}

#[test]
fn immediate_empty_script_cancels_all_scripts_and_moves_nothing() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "b", 5_000.0, script(ControlType::Position, &PAPER)));
    bench.until(600);
    bench
        .request(ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel())));
    bench.until(9_000);
    assert_eq!(bench.statuses()[3..], ["Failed cancelled", "Failed cancelled", "OK"]);
    assert_eq!(bench.values(), [(100, 45.0)]);
    assert_eq!(bench.sets().len(), 1);
    assert_eq!(bench.robot.value("arm", ControlType::Position, bench.now), Some(45.0));
}

#[test]
fn later_empty_script_cancels_later_starts_and_keeps_the_running_script() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "b", 5_000.0, script(ControlType::Position, &PAPER)));
    bench.until(600);
    bench.request(timed("arm", "c", 4_000.0, Command::Script(Script::cancel())));
    bench.until(9_000);
    assert_eq!(bench.values(), [(100, 45.0), (1_100, 0.0), (2_100, 45.0)]);
}

#[test]
fn pending_script_is_dropped_when_the_server_is_silent() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(300.0, 300.0);
    bench.request(request);
    bench.until(250);
    bench.send(Message::AvailabilityRequest(AvailabilityRequest::default()));
    bench.until(9_000);
    assert_eq!(bench.values(), [], "silent from 250 ms on, dropped at 550 ms");
    assert_eq!(bench.statuses(), ["Accepted", "Failed link_lost"]);
    assert_eq!(bench.responses()[1].event_timestamp, Some(at(550)));
}

#[test]
fn lease_that_ends_at_the_instant_of_the_start_prevents_the_start() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(1_000.0, 1_000.0);
    bench.request(request);
    bench.until(9_000);
    assert_eq!(bench.values(), []);
}

#[test]
fn every_message_renews_a_lease_and_a_lost_connection_does_not() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(300.0, 300.0);
    bench.request(request);
    for millis in (200..=1_600).step_by(200) {
        bench.until(millis);
        bench.send(Message::AvailabilityRequest(AvailabilityRequest::default()));
    }
    bench.robot.handle(bench.now, LINK, Input::LinkDown, &mut bench.out);
    bench.until(9_000);
    assert_eq!(bench.values(), [(1_000, 45.0)], "ended at 1,900 ms, before its second step");
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed link_lost"]);
}

#[test]
fn messages_of_another_server_renew_no_lease() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(300.0, 300.0);
    bench.request(request);
    bench.until(250);
    let ping = Message::AvailabilityRequest(AvailabilityRequest::default());
    bench.robot.handle(bench.now, LinkId(2), Input::Message(ping), &mut bench.out);
    bench.until(9_000);
    assert_eq!(bench.values(), []);
}

#[test]
fn speed_left_on_after_its_script_still_ends_with_the_lease() {
    let mut bench = Bench::new();
    let mut request = timed("wheel", "a", 100.0, script(ControlType::Speed, &[(0.0, 5.0)]));
    request.stop_condition = lease(400.0, 400.0);
    bench.request(request);
    bench.until(300);
    assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(5.0));
    bench.until(500);
    assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(0.0));
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK", "Failed link_lost"]);
}

#[test]
fn linear_device_moves_linearly_and_arrives_on_time() {
    let mut bench = Bench::new();
    bench.request(timed("ramp", "a", 100.0, script(ControlType::Position, &[(500.0, 50.0), (1_000.0, 0.0)])));
    let mut value = |millis| {
        bench.until(millis);
        bench.robot.value("ramp", ControlType::Position, bench.now).unwrap()
    };
    assert_eq!([value(100), value(350), value(600), value(850), value(1_100)], [0.0, 25.0, 50.0, 25.0, 0.0]);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
}

#[test]
fn linear_device_without_default_value_holds_its_position_when_stopped() {
    let mut bench = Bench::new();
    bench.request(timed("ramp", "a", 100.0, script(ControlType::Position, &[(0.0, 0.0), (1_000.0, 80.0)])));
    bench.until(600);
    bench.request(ControlRequest::immediate(
        DeviceId::new("ramp").unwrap(),
        Command::Script(Script::cancel()),
    ));
    bench.until(2_000);
    assert_eq!(bench.robot.value("ramp", ControlType::Position, bench.now), Some(40.0));
}

#[test]
fn only_a_sensor_provides_a_reading() {
    let mut bench = Bench::new();
    bench.robot.set_reading(DeviceId::new("thermometer").unwrap(), 21.5);
    let read = |device: &str| ControlRequest::immediate(DeviceId::new(device).unwrap(), Command::ReadSensor);
    bench.request(read("thermometer"));
    bench.request(read("arm"));
    assert_eq!(bench.responses()[0].status, Status::Provide);
    assert_eq!(bench.responses()[0].status_value, StatusValue::Number(21.5));
    assert_eq!(bench.statuses()[1], "Failed unsupported_control_type");
}

#[test]
fn repeated_reading_is_read_again_and_reserves_no_request_id() {
    let mut bench = Bench::new();
    let mut read = timed("thermometer", "a", 0.0, Command::ReadSensor);
    read.content_hash = Some(Command::ReadSensor.content_hash());
    for reading in [21.5, 22.0] {
        bench.robot.set_reading(DeviceId::new("thermometer").unwrap(), reading);
        bench.request(read.clone());
        assert_eq!(bench.responses().last().unwrap().status_value, StatusValue::Number(reading));
    }
    bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &PAPER)));
    assert_eq!(bench.statuses().last().unwrap(), "Accepted");
}

#[test]
fn undecodable_line_gets_a_control_response_or_availability_response() {
    let mut bench = Bench::new();
    let mut decoder = Decoder::default();
    decoder.push(b"{\"control_request\":{\"device_id\":\"arm\",\"request_id\":\"x\"}}\nnonsense\n");
    for _ in 0..2 {
        let error = decoder.next_message().unwrap().unwrap_err();
        bench.robot.handle(bench.now, LINK, Input::Undecodable(error), &mut bench.out);
    }
    assert_eq!(bench.statuses(), ["Failed malformed"]);
    assert_eq!(bench.out.len(), 2, "the second by an availability response");
}

/// An action of a server.
#[derive(Clone, Debug)]
enum Act {
    Request { device: usize, id: u8, start: f64, steps: Vec<(u16, i16)>, lease: Option<u16> },
    Ping,
    Wait(u16),
}

fn act() -> impl Strategy<Value = Act> {
    let steps = prop::collection::vec((0u16..400, -30i16..120), 0..6);
    prop_oneof![
        4 => (0usize..4, any::<u8>(), 0.0..3_000.0, steps, prop::option::of(1u16..600))
            .prop_map(|(device, id, start, steps, lease)| Act::Request { device, id, start, steps, lease }),
        1 => Just(Act::Ping),
        3 => (0u16..500).prop_map(Act::Wait),
    ]
}

proptest! {
    #[test]
    fn values_stay_within_limits_and_no_start_is_late_or_repeated(
        acts in prop::collection::vec(act(), 0..60),
    ) {
        let mut bench = Bench::new();
        let names = ["arm", "ramp", "wheel", "thermometer"];
        let mut clock = 0;
        for act in acts {
            match act {
                Act::Wait(millis) => {
                    clock += i64::from(millis);
                    bench.until(clock);
                }
                Act::Ping => bench.send(Message::AvailabilityRequest(AvailabilityRequest::default())),
                Act::Request { device, id, start, mut steps, lease: silence } => {
                    steps.sort_unstable();
                    let control_type = if device == 2 { ControlType::Speed } else { ControlType::Position };
                    let steps: Vec<_> = steps.iter().map(|(t, v)| (f64::from(*t), f64::from(*v) / 2.0)).collect();
                    let mut request = timed(names[device], &id.to_string(), start, script(control_type, &steps));
                    request.stop_condition = silence.and_then(|s| lease(f64::from(s), f64::from(s)));
                    bench.request(request);
                }
            }
            for (device, limit) in bench.robot.devices.iter().zip([2, 1, 1, 1]) {
                prop_assert!(device.held() <= limit);
            }
        }
        bench.until(clock + 10_000);
        prop_assert!(bench.robot.is_idle() || bench.robot.next_wakeup().is_none());
        for set in bench.sets() {
            if let Motion::Set(setpoint) = &set.motion {
                let device = bench.robot.block().device(set.device.as_str()).unwrap();
                prop_assert!(device.check(setpoint).is_ok(), "{set:?}");
            }
        }
        let mut started: Vec<_> = bench.responses().iter().filter(|r| r.status == Status::Started)
            .map(|r| r.request_id.clone()).collect();
        // A repeated request may get the response again, with its own timestamp; all starts of one id have the same instant.
        started.sort();
        started.dedup();
        for id in started {
            let instants: std::collections::BTreeSet<_> = bench.responses().iter()
                .filter(|r| r.status == Status::Started && r.request_id == id).map(|r| r.event_timestamp).collect();
            prop_assert_eq!(instants.len(), 1);
        }
    }
}

#[test]
fn times_in_these_tests_are_in_milliseconds() {
    assert_eq!(at(1) - at(0), Span::from_millis(1));
}

#[test]
fn response_to_an_undecodable_line_names_its_device_and_request() {
    let mut decoder = Decoder::default();
    decoder.push(b"{\"control_request\": {\"device_id\": \"arm\", \"request_id\": \"a\"}}\nnonsense\n");
    let mut bench = Bench::new();
    bench.until(7);
    for _ in 0..2 {
        let error = decoder.next_message().unwrap().unwrap_err();
        bench.robot.handle(bench.now, LINK, Input::Undecodable(error), &mut bench.out);
    }
    let [
        Output::Send { message: Message::ControlResponse(of_device), .. },
        Output::Send { message: Message::AvailabilityResponse(of_line), .. },
    ] = &bench.out[..]
    else {
        panic!("{:?}", bench.out)
    };
    assert_eq!(of_device.request_id, RequestId::new("a").ok());
    assert_eq!((of_device.device_id.as_str(), of_device.status.clone()), ("arm", Status::Failed));
    assert_eq!(
        (of_line.status.clone(), of_line.receive_timestamp, of_line.timestamp),
        (Status::Failed, at(7), at(7))
    );
    for error in [&of_device.error, &of_line.error] {
        assert_eq!(error.as_ref().map(|error| error.code.clone()), Some(ErrorCode::Malformed));
    }
}

#[test]
fn robot_counts_held_commands_and_their_outcomes() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "b", 9_000.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("wheel", "c", 9_000.0, script(ControlType::Speed, &[(0.0, 5.0)])));
    let counts = |bench: &Bench| {
        let counts = bench.robot.counts();
        (counts.held, counts.started, counts.ended, counts.failed, counts.late_steps)
    };
    assert_eq!(counts(&bench), (3, 0, 0, 0, 0));
    bench.until(100);
    // Two steps of the script are late.
    bench.now = at(2_110);
    bench.robot.advance(bench.now, &mut bench.out);
    assert_eq!(counts(&bench), (2, 1, 1, 0, 2));
    bench
        .request(ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel())));
    assert_eq!(counts(&bench), (1, 1, 1, 1, 2));
}
