//! Tests robots whose hardware may be away, fail and return, and whose sensors are slow.

use super::*;
use crate::hardware::{READINGS_MAX, SensorReading};

fn driven() -> Bench {
    let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
    Bench { robot: Robot::driven(block), ..Bench::new() }
}

fn ready() -> Bench {
    let mut bench = driven();
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench
}

fn available(bench: &mut Bench) -> (Status, Option<String>) {
    bench.send(Message::AvailabilityRequest(AvailabilityRequest::default()));
    match bench.out.last() {
        Some(Output::Send { message: Message::AvailabilityResponse(response), .. }) => {
            (response.status.clone(), response.error.as_ref().map(|error| error.message.to_string()))
        }
        other => panic!("{other:?}"),
    }
}

fn read(bench: &mut Bench, id: &str) {
    bench.request(ControlRequest {
        request_id: Some(RequestId::new(id).unwrap()),
        ..ControlRequest::immediate(DeviceId::new("thermometer").unwrap(), Command::ReadSensor)
    });
}

fn open_reading(bench: &Bench) -> crate::hardware::ReadingId {
    match bench.out.last() {
        Some(Output::Read { reading, sensor }) if sensor.as_str() == "thermometer" => *reading,
        other => panic!("{other:?}"),
    }
}

/// Returns the devices that were brought to rest, with their control types and values.
fn rests(bench: &Bench) -> Vec<(String, f64)> {
    let value = |set: &&SetValue| match &set.motion {
        Motion::Rest(rest) => Some((format!("{} {}", set.device, rest.control_type), rest.value)),
        _ => None,
    };
    bench.sets().iter().filter_map(value).collect()
}

#[test]
fn robot_without_hardware_is_unavailable_and_accepts_nothing() {
    let mut bench = driven();
    let (status, why) = available(&mut bench);
    assert_eq!(status, Status::Failed);
    assert!(why.unwrap().contains("the hardware is not available: it has not answered yet"));
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    read(&mut bench, "b");
    assert_eq!(bench.statuses(), ["Failed internal", "Failed internal"]);
    bench.robot.hardware_found(bench.now, &mut bench.out);
    assert_eq!(available(&mut bench), (Status::Ok, None));
    // The refusal was temporary, and nothing was set meanwhile.
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    assert_eq!(bench.statuses().last().unwrap(), "Accepted");
    assert!(bench.sets().is_empty());
}

#[test]
fn hardware_failure_fails_all_scripts_and_reconnection_resumes_none() {
    let mut bench = ready();
    bench.request(ControlRequest::immediate(
        DeviceId::new("wheel").unwrap(),
        Command::Set(Setpoint::new(ControlType::Speed, 5.0)),
    ));
    bench.request(timed("arm", "runs", 100.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "waits", 5_000.0, script(ControlType::Position, &PAPER)));
    bench.until(1_500);
    bench.out.clear();
    bench.robot.hardware_lost(bench.now, "unplugged", &mut bench.out);
    assert_eq!(bench.statuses(), ["Failed internal", "Failed internal"]);
    let [runs, waits] = bench.responses()[..] else { panic!() };
    assert_eq!((runs.steps_done, waits.steps_done), (Some(2), Some(0)));
    assert!(runs.error.as_ref().unwrap().message.contains("unplugged"));
    assert!(bench.sets().is_empty(), "nothing can be set");
    bench.until(3_000);
    assert!(bench.sets().is_empty(), "the script is over");
    bench.robot.hardware_found(bench.now, &mut bench.out);
    assert_eq!(rests(&bench), [("wheel speed".to_owned(), 0.0)], "it may turn still");
    bench.until(10_000);
    assert_eq!(bench.values(), []);
    assert_eq!(bench.sets().len(), 1);
    assert_eq!(bench.robot.value("arm", ControlType::Position, bench.now), Some(0.0), "where it was last");
}

#[test]
fn hardware_without_set_values_is_left_unchanged() {
    let mut bench = ready();
    bench.robot.hardware_lost(bench.now, "unplugged", &mut bench.out);
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench.robot.shut_down(bench.now, &mut bench.out);
    assert!(bench.sets().is_empty());
}

#[test]
fn custom_type_rests_at_its_declared_value_only_after_a_command() {
    let block = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
      {"id": "wheel", "name": "w", "available_control_types": {
         "speed": {"min_value": -10, "max_value": 10, "granularity": 1}}},
      {"id": "lamp", "name": "l", "available_control_types": {"custom_1": {"at_rest": 0}}},
      {"id": "valve", "name": "v", "available_control_types": {"custom_2": {"at_rest": [1, 2]}}},
      {"id": "horn", "name": "h", "default_value": 7, "available_control_types": {"custom_3": {}}}]}"#;
    let block: InitializationBlock = serde_json::from_str(block).unwrap();
    let mut bench = Bench { robot: Robot::driven(block), ..Bench::new() };
    bench.robot.hardware_found(bench.now, &mut bench.out);
    let rests = |bench: &mut Bench| -> Vec<String> {
        let rest = |set: &&SetValue| match &set.motion {
            Motion::Rest(rest) => Some(format!("{} {:?}", set.device, rest.values().collect::<Vec<_>>())),
            _ => None,
        };
        let rests = bench.sets().iter().filter_map(rest).collect();
        bench.out.clear();
        rests
    };
    let colours =
        |custom| Setpoint { more: [5.0, 9.0].into(), ..Setpoint::new(ControlType::Custom(custom), 4.0) };
    let stop = |bench: &mut Bench| {
        for device in ["lamp", "valve", "horn"] {
            let cancel = Command::Script(Script::cancel());
            bench.request(ControlRequest::immediate(DeviceId::new(device).unwrap(), cancel));
        }
    };
    stop(&mut bench);
    assert_eq!(rests(&mut bench), [""; 0]);
    for (device, custom) in [("lamp", 1), ("valve", 2), ("horn", 3)] {
        let device = DeviceId::new(device).unwrap();
        bench.request(ControlRequest::immediate(device, Command::Set(colours(custom))));
    }
    stop(&mut bench);
    assert_eq!(rests(&mut bench), ["lamp [0.0, 0.0, 0.0]", "valve [1.0, 2.0, 2.0]"]);
    bench.robot.hardware_lost(bench.now, "unplugged", &mut bench.out);
    bench.robot.hardware_found(bench.now, &mut bench.out);
    assert_eq!(rests(&mut bench), ["lamp [0.0, 0.0, 0.0]", "valve [1.0, 2.0, 2.0]"]);
    bench.robot.shut_down(bench.now, &mut bench.out);
    assert_eq!(rests(&mut bench), ["wheel [0.0]", "lamp [0.0, 0.0, 0.0]", "valve [1.0, 2.0, 2.0]"]);
}

#[test]
fn end_of_the_edge_cancels_running_scripts_and_keeps_positions() {
    let mut bench = ready();
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &PAPER)));
    bench.until(10);
    bench.robot.shut_down(bench.now, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed cancelled"]);
    assert_eq!(rests(&bench), [("wheel speed".to_owned(), 0.0)]);
    assert_eq!(bench.robot.value("arm", ControlType::Position, bench.now), Some(45.0));
}

#[test]
fn unconfirmed_stop_may_succeed_when_it_is_sent_again() {
    let mut bench = driven();
    bench.robot = bench.robot.confirmed_by_its_driver();
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &PAPER)));
    bench.until(10);
    let cancel = || ControlRequest {
        request_id: Some(RequestId::new("stop").unwrap()),
        ..ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()))
    };
    bench.request(cancel());
    assert!(!bench.statuses().contains(&"OK".to_owned()), "nobody has confirmed it");
    bench.robot.hardware_lost(bench.now, "unplugged", &mut bench.out);
    assert_eq!(bench.statuses().last().unwrap(), "Failed internal");
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench.request(cancel());
    let mut tickets = bench.out.iter().filter_map(|output| match output {
        Output::Confirm { ticket, .. } => Some(*ticket),
        _ => None,
    });
    let last = tickets.next_back().unwrap();
    bench.robot.confirmed(bench.now, last, &mut bench.out);
    assert_eq!(bench.statuses().last().unwrap(), "OK");
}

#[test]
fn stop_is_not_confirmed_while_the_device_positions_are_unknown() {
    let mut bench = ready();
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &PAPER)));
    bench.until(10);
    bench.robot.hardware_lost(bench.now, "unplugged", &mut bench.out);
    let cancel = || ControlRequest {
        request_id: Some(RequestId::new("stop").unwrap()),
        ..ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()))
    };
    bench.request(cancel());
    assert_eq!(bench.statuses().last().unwrap(), "Failed internal");
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench.request(cancel());
    assert_eq!(bench.statuses().last().unwrap(), "OK");
}

#[test]
fn reading_is_provided_when_it_arrives() {
    let mut bench = ready();
    read(&mut bench, "a");
    let reading = open_reading(&bench);
    bench.until(400);
    assert_eq!(bench.statuses(), Vec::<String>::new());
    bench.robot.reading_came(bench.now, reading, Ok(21.5.into()), &mut bench.out);
    let [answer] = bench.responses()[..] else { panic!() };
    assert_eq!((&answer.status, &answer.status_value), (&Status::Provide, &StatusValue::Number(21.5)));
    assert_eq!(answer.request_id.as_ref().unwrap().as_str(), "a");
    bench.until(5_000);
    assert_eq!(bench.responses().len(), 1, "it is answered once");
}

#[test]
fn reading_states_when_it_was_taken_if_the_hardware_does() {
    let mut bench = ready();
    for taken in [None, Some(at(380))] {
        read(&mut bench, "a");
        let reading = open_reading(&bench);
        bench.until(400);
        let came = SensorReading { value: 21.5, taken };
        bench.robot.reading_came(bench.now, reading, Ok(came), &mut bench.out);
        assert_eq!(bench.responses().last().unwrap().event_timestamp, taken);
    }
}

#[test]
fn reading_that_does_not_arrive_fails_and_a_later_one_is_ignored() {
    let mut bench = ready();
    read(&mut bench, "a");
    let reading = open_reading(&bench);
    assert_eq!(bench.robot.next_wakeup(), Some(at(1_000)));
    bench.until(1_000);
    assert_eq!(bench.statuses(), ["Failed internal"]);
    bench.robot.reading_came(bench.now, reading, Ok(21.5.into()), &mut bench.out);
    assert_eq!(bench.responses().len(), 1);
    assert!(bench.robot.is_idle());
}

#[test]
fn sensor_declares_the_maximum_delay_of_its_readings() {
    let block = BLOCK.replace("\"max_value\": 60", "\"max_value\": 60, \"max_delay\": 250");
    let mut bench = driven();
    bench.robot = Robot::driven(serde_json::from_str(&block).unwrap());
    bench.robot.hardware_found(bench.now, &mut bench.out);
    read(&mut bench, "a");
    assert_eq!(bench.robot.next_wakeup(), Some(at(250)));
}

#[test]
fn refused_non_finite_or_interrupted_readings_fail_with_the_reason() {
    let mut bench = ready();
    for (reading, says) in
        [(Err("no such pin".to_owned()), "no such pin"), (Ok(f64::NAN.into()), "expected a finite number")]
    {
        read(&mut bench, says);
        let id = open_reading(&bench);
        bench.robot.reading_came(bench.now, id, reading, &mut bench.out);
        let answers = bench.responses();
        let error = answers.last().unwrap().error.as_ref().unwrap();
        assert_eq!(error.code, ErrorCode::Internal);
        assert!(error.message.contains(says), "{error}");
    }
    read(&mut bench, "c");
    bench.robot.hardware_lost(bench.now, "unplugged", &mut bench.out);
    assert_eq!(bench.statuses().len(), 3);
    assert!(bench.robot.is_idle());
}

/// Requests a reading on behalf of a session. Returns whether the robot has sent the request to the hardware.
fn opens(bench: &mut Bench, link: u64, session: Option<&str>) -> bool {
    let request = ControlRequest::immediate(DeviceId::new("thermometer").unwrap(), Command::ReadSensor);
    let session = session.and_then(|session| urrcp::SessionId::new(session).ok());
    let message = Message::ControlRequest(ControlRequest { session, ..request });
    bench.robot.handle(bench.now, LinkId(link), Input::Message(message), &mut bench.out);
    matches!(bench.out.last(), Some(Output::Read { .. }))
}

#[test]
fn open_readings_are_limited_and_all_readings_are_answered() {
    let mut bench = ready();
    let opened: Vec<_> =
        (0..5).map(|link| (0..64).filter(|_| opens(&mut bench, link, None)).count()).collect();
    assert_eq!(opened, [16, 16, 0, 0, 0], "of each peer and of all that own nothing");
    assert!(bench.statuses().iter().all(|status| status == "Failed busy"));
    bench.until(1_000);
    assert_eq!(bench.statuses().len(), 5 * 64);
}

#[test]
fn any_number_of_strangers_leaves_room_for_readings_of_the_owner() {
    let mut bench = ready();
    bench.send(Message::AvailabilityRequest(AvailabilityRequest {
        session: urrcp::SessionId::new("show").ok(),
        ..AvailabilityRequest::default()
    }));
    let opened: Vec<_> =
        (10..20).map(|link| (0..20).filter(|_| opens(&mut bench, link, None)).count()).collect();
    assert_eq!(opened, [4, 4, 0, 0, 0, 0, 0, 0, 0, 0]);
    // The session was named on this link before.
    let own = (0..READINGS_MAX).filter(|i| opens(&mut bench, 1, Some("show").filter(|_| i % 2 == 0))).count();
    assert_eq!(own, READINGS_MAX - 8);
}

#[test]
fn running_script_fails_if_its_next_step_is_overdue_beyond_tolerance() {
    let mut bench = ready();
    bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &[(0.0, 20.0), (100.0, 30.0)])));
    bench.until(150);
    let borne = Span::from_millis(100);
    bench.robot.give_up_overdue(at(300), borne, &mut bench.out);
    assert!(!bench.statuses().iter().any(|status| status.starts_with("Failed")), "{:?}", bench.statuses());
    bench.robot.give_up_overdue(at(301), borne, &mut bench.out);
    assert_eq!(bench.statuses().last().map(String::as_str), Some("Failed late"));
}

#[cfg(feature = "host")]
#[test]
fn latencies_declared_by_the_driver_appear_in_the_description() {
    use std::time::Duration;
    let mut bench = ready();
    let id = bench.robot.block().devices[0].id.clone();
    let unknown = DeviceId::new("no-such-device").unwrap();
    let latency = Duration::from_micros(41_200);
    bench.robot.declare_latencies(&[(id.clone(), latency), (unknown, latency)].into());
    bench.send(Message::InitializationRequest(urrcp::InitializationRequest::default()));
    let Some(Output::Send { message: Message::InitializationBlock(block), .. }) = bench.out.last() else {
        panic!("{:?}", bench.out)
    };
    assert_eq!(block.device(id.as_str()).unwrap().latency, Some(Span::from_micros(41_200)));
    assert_eq!(block.devices.iter().filter(|device| device.latency.is_some()).count(), 1);
}

#[test]
fn start_on_silent_hardware_fails_if_there_was_time_for_a_ping() {
    let notice = Span::from_millis(200);
    for (lead, expected) in [(200.0, "Failed internal"), (199.0, "Started")] {
        let mut bench = ready();
        bench.request(timed("arm", "a", lead, script(ControlType::Position, &PAPER)));
        bench.now = at(lead as i64);
        bench.robot.hardware_silent(bench.now, Some(Span::from_millis(400)), notice, &mut bench.out);
        bench.robot.advance(bench.now, &mut bench.out);
        assert_eq!(bench.statuses().last().map(String::as_str), Some(expected));
    }
    let mut bench = ready();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    assert_eq!(bench.robot.next_start(notice), Some(at(1_000)));
    bench.robot.hardware_silent(at(999), Some(Span::from_millis(400)), notice, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted"], "it is not due yet");
    let (status, why) = available(&mut bench);
    assert_eq!((status, why.as_deref()), (Status::Failed, Some("the hardware has not answered for 400 ms")));
    bench.robot.hardware_silent(at(999), None, notice, &mut bench.out);
    assert_eq!(available(&mut bench), (Status::Ok, None));
}

#[test]
fn hardware_silence_is_checked_from_one_second_before_a_start() {
    let mut bench = ready();
    bench.request(timed("arm", "a", 2_000.0, script(ControlType::Position, &PAPER)));
    let mut asked = |millis| {
        let mut asked = false;
        bench.robot.check_hardware(
            at(millis),
            || {
                asked = true;
                None
            },
            &mut Vec::new(),
        );
        asked
    };
    assert!(!asked(999) && asked(1_000));
}

#[test]
fn reading_with_maximum_delay_over_a_minute_fails_after_a_minute() {
    let block = BLOCK.replace("\"max_value\": 60", "\"max_value\": 60, \"max_delay\": 90000");
    let mut bench = driven();
    bench.robot = Robot::driven(serde_json::from_str(&block).unwrap());
    bench.robot.hardware_found(bench.now, &mut bench.out);
    read(&mut bench, "a");
    assert_eq!(bench.robot.next_wakeup(), Some(at(60_000)));
    bench.until(60_000);
    let error = bench.responses()[0].error.clone().unwrap();
    assert_eq!(error.message, "no reading within 60 s");
}

#[test]
fn value_too_late_for_hardware_fails_unconfirmed_script_of_its_device() {
    let mut bench = driven();
    bench.robot = bench.robot.confirmed_by_its_driver();
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &[(0.0, 20.0)])));
    bench.request(timed("wheel", "b", 0.0, script(ControlType::Speed, &[(0.0, 5.0), (9_000.0, 0.0)])));
    let arm = DeviceId::new("arm").unwrap();
    bench.robot.value_stale(bench.now, &arm, Span::from_millis(300), &mut bench.out);
    let error = bench.responses().last().unwrap().error.clone().unwrap();
    let why = "the hardware may not have accepted the last value: a value reached the hardware 300 ms late and was not set";
    assert_eq!((error.code, error.message.as_str()), (ErrorCode::Late, why));
    assert!(!bench.robot.is_idle(), "the wheel continues");
    let unknown = DeviceId::new("leg").unwrap();
    let said = bench.out.len();
    bench.robot.value_stale(bench.now, &unknown, Span::from_millis(300), &mut bench.out);
    assert_eq!(bench.out.len(), said);
}

#[test]
fn robot_is_not_idle_until_its_hardware_has_confirmed_the_end() {
    let mut bench = driven();
    bench.robot = bench.robot.confirmed_by_its_driver();
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &[(0.0, 20.0)])));
    bench.until(10);
    assert_eq!(bench.statuses(), ["Accepted", "Started"]);
    assert!(!bench.robot.is_idle());
    bench.robot.confirmed(bench.now, crate::confirmation::Ticket(1), &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
    assert_eq!(bench.responses()[2].event_timestamp, Some(at(0)), "when it was, not when it was confirmed");
    assert!(bench.robot.is_idle());
    let said = bench.out.len();
    bench.robot.confirmed(bench.now, crate::confirmation::Ticket(1), &mut bench.out);
    assert_eq!(bench.out.len(), said, "once");
}

#[test]
fn reading_without_hardware_is_the_given_value_position_or_middle() {
    let block = r#"{"id": "r", "api_version": "1", "devices": [
      {"id": "arm", "default_value": 3, "available_control_types": {"sensor": {"min_value": -20, "max_value": 60},
         "position": {"min_value": 0, "max_value": 9, "granularity": 1}}},
      {"id": "thermometer", "available_control_types": {"sensor": {"min_value": -20, "max_value": 60}}}]}"#;
    let mut bench = Bench { robot: Robot::new(serde_json::from_str(block).unwrap()), ..Bench::new() };
    let reads = |bench: &mut Bench, sensor: &str| {
        bench.request(ControlRequest::immediate(DeviceId::new(sensor).unwrap(), Command::ReadSensor));
        bench.responses().last().unwrap().status_value.clone()
    };
    assert_eq!(reads(&mut bench, "thermometer"), StatusValue::Number(20.0));
    assert_eq!(reads(&mut bench, "arm"), StatusValue::Number(3.0));
    bench.robot.set_reading(DeviceId::new("arm").unwrap(), 7.0);
    assert_eq!(reads(&mut bench, "arm"), StatusValue::Number(7.0));
}
