//! Tests a simulated robot's clock, link and faults in virtual time.

use urrcp::{
    AvailabilityRequest, ControlRequest, ControlType, DeviceId, Millis, RequestId, Script, Server, Setpoint,
    Step, StopCondition,
};

use super::*;

const LINK: LinkId = LinkId(1);
const BEGIN: i64 = 1_000_000_000_000;

fn at(millis: i64) -> Timestamp<True> {
    Timestamp::from_nanos(BEGIN + millis * 1_000_000)
}

fn robot(settings: Settings) -> SimulatedRobot {
    let block = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [{"id": "arm", "name": "arm",
        "available_control_types": {
          "position": {"min_value": 0, "max_value": 90, "granularity": 1},
          "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 4}}}]}"#;
    SimulatedRobot::new(serde_json::from_str(block).unwrap(), settings)
}

#[test]
fn hardware_is_checked_at_its_wakeups_and_at_any_time_once_silent() {
    let block = robot(Settings::default()).robot().block().clone();
    let mut edge = SimulatedRobot::with_hardware(block, Settings::default(), at(0));
    let mut out = Vec::new();
    edge.advance(at(0), &mut out);
    edge.receive(at(10), LINK, paper(1_000.0, "a"));
    assert!(edge.is_due(at(10)));
    edge.advance(at(10), &mut out);
    assert_eq!(edge.next_wakeup(), Some(at(1_000)));
    assert!(!edge.is_due(at(999)) && edge.is_due(at(1_000)));
    edge.step_clock(Span::from_millis(100));
    assert_eq!(edge.next_wakeup(), Some(at(900)), "its clock shows that earlier now");
    edge.hardware_dies(at(500));
    assert!(edge.is_due(at(501)));
    edge.hardware_found(at(600));
    assert!(!edge.is_due(at(601)));
}

fn paper(start_ms: f64, id: &str) -> Input {
    let step = |millis, value| Step {
        offset: Millis::new(millis).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, value),
        stop_condition: None,
    };
    let steps = vec![step(0.0, 45.0), step(1_000.0, 0.0), step(2_000.0, 45.0)];
    let command = Command::Script(Script::new(steps).unwrap());
    Input::Message(Message::ControlRequest(ControlRequest {
        timestamp: Some(Timestamp::<Server>::from_nanos(BEGIN)),
        time_offset_to_start: Some(Millis::new(start_ms).unwrap()),
        stop_condition: Some(StopCondition::both(Millis::new(5_000.0).unwrap())),
        request_id: Some(RequestId::new(id).unwrap()),
        ..ControlRequest::immediate(DeviceId::new("arm").unwrap(), command)
    }))
}

fn ping(sent: i64) -> Input {
    let timestamp = Some(Timestamp::from_nanos(sent));
    Input::Message(Message::AvailabilityRequest(AvailabilityRequest {
        timestamp,
        session: None,
        seize: false,
        revocation_list: None,
    }))
}

/// Advances the time to `until`, from wake-up to wake-up. Returns the outgoing messages with their times.
fn run(robot: &mut SimulatedRobot, until: Timestamp<True>) -> Vec<(Timestamp<True>, Outgoing)> {
    let mut left = Vec::new();
    let mut out = Vec::new();
    while let Some(now) = robot.next_wakeup().filter(|wakeup| *wakeup <= until) {
        robot.advance(now, &mut out);
        left.extend(out.drain(..).map(|outgoing| (now, outgoing)));
    }
    left
}

#[test]
fn simulated_robot_and_edge_declare_inquiry_support() {
    let simulated = robot(Settings::default());
    let block = InitializationBlock { inquiry: false, ..simulated.robot().block().clone() };
    let edge = crate::Robot::driven(block);
    assert!(simulated.robot().block().inquiry && edge.block().inquiry);
}

#[test]
fn jitter_affects_the_clock_in_an_inquiry_response() {
    let mut robot = robot(Settings { jitter: Span::from_millis(5), ..Settings::default() });
    robot.receive(at(0), LINK, Input::Message(Message::Inquiry(urrcp::Inquiry::default())));
    let left = run(&mut robot, at(1_000));
    let [(_, Outgoing::Message { message: Message::InquiryResponse(response), .. })] = &left[..] else {
        panic!("{left:?}")
    };
    let off = response.timestamp.as_nanos() - BEGIN;
    assert!(off != 0 && off.abs() <= 5_000_000, "{off} ns");
    assert_eq!(response.timestamp, response.receive_timestamp);
}

fn words(left: &[(Timestamp<True>, Outgoing)]) -> Vec<String> {
    let word = |outgoing: &Outgoing| match outgoing {
        Outgoing::Close { .. } => "closed".to_owned(),
        Outgoing::Message { message: Message::ControlResponse(response), .. } => match &response.error {
            Some(error) => format!("{} {}", response.status, error.code),
            None => response.status.to_string(),
        },
        Outgoing::Message { .. } => "other".to_owned(),
    };
    left.iter().map(|(_, outgoing)| word(outgoing)).collect()
}

#[test]
fn perfect_robot_sets_each_step_at_its_true_time() {
    let mut robot = robot(Settings::default());
    robot.receive(at(0), LINK, paper(1_500.0, "a"));
    let left = run(&mut robot, at(9_000));
    assert_eq!(words(&left), ["Accepted", "Started", "OK"]);
    let log: Vec<_> = robot.take_log().iter().map(|entry| (entry.true_ns, entry.value)).collect();
    let due = |millis| at(millis).as_nanos();
    assert_eq!(log, [(due(1_500), 45.0), (due(2_500), 0.0), (due(3_500), 45.0)]);
    assert!(robot.take_log().is_empty() && robot.is_idle());
}

#[test]
fn ntp_hides_offset_and_drift_except_for_its_error() {
    let error = Span::from_micros(40);
    let mut robot = robot(Settings {
        clock_offset: Span::from_millis(300),
        drift_ppm: 50.0,
        ntp_error: Some(error),
        seed: 7,
        ..Settings::default()
    });
    robot.receive(at(0), LINK, paper(1_500.0, "a"));
    run(&mut robot, at(9_000));
    let starts = robot.take_log()[0].true_ns - at(1_500).as_nanos();
    assert!(Span::from_nanos(starts).abs() <= error && starts != 0, "{starts} ns");
}

#[test]
fn clock_without_ntp_shows_offset_and_drift() {
    let settings = Settings {
        clock_offset: Span::from_millis(300),
        drift_ppm: 100.0,
        ntp_error: None,
        ..Settings::default()
    };
    let mut robot = robot(settings);
    robot.advance(at(0), &mut Vec::new());
    assert_eq!(robot.robot_from_true(at(0)).as_nanos(), at(300).as_nanos());
    assert_eq!(robot.robot_from_true(at(10_000)).as_nanos(), at(10_301).as_nanos());
    robot.receive(at(0), LINK, paper(1_500.0, "a"));
    run(&mut robot, at(9_000));
    let log = robot.take_log();
    assert_eq!(log[0].set_at, log[0].due, "on time by its own clock");
    let early = at(1_500).as_nanos() - log[0].true_ns;
    assert!((300_000_000..301_000_000).contains(&early), "early by {early} ns of true time");
}

#[test]
fn robot_time_maps_to_its_first_true_instant_for_any_drift() {
    for drift_ppm in [-100_000.0, -333.3, 0.0, 17.0, 100_000.0, f64::NAN] {
        let clock_offset = Span::from_millis(-123);
        let mut robot = robot(Settings { clock_offset, drift_ppm, ntp_error: None, ..Settings::default() });
        robot.advance(at(0), &mut Vec::new());
        for millis in [0, 1, 999, 86_400_000] {
            let shown = Timestamp::from_nanos(at(millis).as_nanos() + 77);
            let first = robot.true_from_robot(shown);
            assert!(robot.robot_from_true(first) >= shown, "{drift_ppm} ppm, {millis} ms");
            assert!(
                robot.robot_from_true(first - Span::from_nanos(1)) < shown,
                "{drift_ppm} ppm, {millis} ms"
            );
        }
    }
}

#[test]
fn start_at_the_end_of_time_does_not_hang() {
    for seed in 0..8 {
        let mut robot =
            robot(Settings { ntp_error: Some(Span::from_millis(5)), seed, ..Settings::default() });
        let Input::Message(Message::ControlRequest(mut request)) = paper(1e11, "a") else { panic!() };
        request.timestamp = Some(Timestamp::from_nanos(i64::MAX));
        request.stop_condition = None;
        robot.receive(at(0), LINK, Input::Message(Message::ControlRequest(request)));
        assert_eq!(words(&run(&mut robot, at(60_000))), ["Failed out_of_range"]);
    }
}

#[test]
fn messages_are_delayed_in_both_directions_and_keep_their_order() {
    let delay = Some((Span::from_millis(10), Span::from_millis(80)));
    let mut robot = robot(Settings { delay, seed: 3, ..Settings::default() });
    for i in 0..200 {
        robot.receive(at(i), LINK, ping(i));
    }
    let left = run(&mut robot, at(9_000));
    let mut order = Vec::new();
    for (left_at, outgoing) in left {
        let Outgoing::Message { message: Message::AvailabilityResponse(response), .. } = outgoing else {
            panic!()
        };
        let sent = response.originate_timestamp.unwrap().as_nanos();
        let there = response.receive_timestamp.as_nanos() - at(sent).as_nanos();
        let back = left_at.as_nanos() - response.timestamp.as_nanos();
        assert!((10_000_000..=80_000_000).contains(&there), "{there}");
        assert!((10_000_000..=80_000_000).contains(&back), "{back}");
        order.push(sent);
    }
    assert_eq!(order, (0..200).collect::<Vec<_>>());
    assert!(robot.lanes.is_empty(), "nothing is kept of a link on which nothing travels");
}

#[test]
fn jitter_affects_reported_times_and_not_actions() {
    let mut robot = robot(Settings { jitter: Span::from_micros(500), seed: 5, ..Settings::default() });
    robot.receive(at(0), LINK, ping(0));
    let left = run(&mut robot, at(0));
    let Outgoing::Message { message: Message::AvailabilityResponse(response), .. } = &left[0].1 else {
        panic!()
    };
    let error = response.receive_timestamp.as_nanos() - BEGIN;
    assert!(error != 0 && error.abs() <= 500_000, "{error} ns");
    robot.receive(at(0), LINK, paper(100.0, "a"));
    run(&mut robot, at(100));
    assert_eq!(robot.take_log()[0].true_ns, at(100).as_nanos());
}

#[track_caller]
fn check_fault(fault: Fault, expected: &[&str], sets: usize) {
    let mut robot = robot(Settings { fault: Some(fault), ..Settings::default() });
    robot.receive(at(0), LINK, paper(100.0, "a"));
    let mut left = run(&mut robot, at(50));
    robot.receive(at(50), LINK, Input::LinkDown);
    left.extend(run(&mut robot, at(150)));
    assert_eq!(words(&left), expected);
    assert_eq!(robot.take_log().len(), sets);
}

#[test]
fn faults_refuse_stay_silent_or_disconnect_right_after_acceptance() {
    check_fault(Fault::Refuse, &["Failed busy"], 0);
    check_fault(Fault::Silent, &[], 0);
    // The command's lease of five seconds still runs; a new connection is closed.
    check_fault(Fault::Disconnect, &["Accepted", "closed", "closed", "Started"], 1);
}

#[test]
fn faulty_robot_still_answers_requests_unaffected_by_its_fault() {
    for fault in [Fault::Refuse, Fault::Silent, Fault::Disconnect] {
        let mut robot = robot(Settings { fault: Some(fault), ..Settings::default() });
        robot.receive(at(0), LINK, ping(0));
        assert_eq!(words(&run(&mut robot, at(1))), ["other"], "{fault:?}");
    }
}

#[test]
fn flood_closes_only_its_own_link_and_is_discarded() {
    let delay = Some((Span::from_millis(50), Span::from_millis(50)));
    let mut robot = robot(Settings { delay, ..Settings::default() });
    for i in 0..2 * i64::try_from(TRAVELLING_MAX).unwrap() {
        robot.receive(at(0), LINK, ping(i));
    }
    robot.receive(at(0), LinkId(2), ping(0));
    assert_eq!(robot.in_flight.len(), TRAVELLING_MAX + 2);
    let left = run(&mut robot, at(1_000));
    let closed =
        |link| left.iter().any(|(_, o)| matches!(o, Outgoing::Close { link: l } if *l == LinkId(link)));
    assert!(closed(1) && !closed(2));
}

#[test]
fn same_seed_gives_the_same_run() {
    let run_of = |seed| {
        let delay = Some((Span::ZERO, Span::from_millis(80)));
        let ntp_error = Some(Span::from_micros(100));
        let mut robot = robot(Settings { delay, ntp_error, seed, ..Settings::default() });
        robot.receive(at(0), LINK, ping(0));
        robot.receive(at(0), LINK, paper(1_500.0, "a"));
        let left = run(&mut robot, at(9_000));
        (left.iter().map(|(at, _)| at.as_nanos()).collect::<Vec<_>>(), robot.take_log())
    };
    assert_eq!(run_of(1), run_of(1));
    assert_ne!(run_of(1), run_of(2));
}

#[test]
fn robot_is_idle_without_held_commands_or_messages_in_transit() {
    let delay = Some((Span::from_millis(10), Span::from_millis(10)));
    let mut travelling = robot(Settings { delay, ..Settings::default() });
    assert!(travelling.is_idle());
    travelling.receive(at(0), LINK, ping(0));
    assert!(!travelling.is_idle(), "a message is on its way");
    run(&mut travelling, at(1_000));
    assert!(travelling.is_idle());
    let mut holding = robot(Settings::default());
    holding.receive(at(0), LINK, paper(1_500.0, "a"));
    run(&mut holding, at(100));
    assert!(!holding.is_idle(), "a script is held");
}

#[test]
fn restarted_robot_keeps_only_its_sensors_and_its_clock() {
    let settings = Settings {
        clock_offset: Span::from_millis(300),
        drift_ppm: 1_000.0,
        ntp_error: None,
        ..Settings::default()
    };
    let mut before = robot(settings);
    before.advance(at(0), &mut Vec::new());
    before.set_reading(DeviceId::new("eye").unwrap(), 5.0);
    before.receive(at(0), LINK, paper(20_000.0, "a"));
    run(&mut before, at(100));
    let mut after = before.restarted(at(10_000));
    assert!(after.is_idle() && !before.is_idle());
    after.advance(at(10_000), &mut Vec::new());
    assert_eq!(after.robot_from_true(at(10_000)), before.robot_from_true(at(10_000)));
    assert_eq!(after.robot_from_true(at(10_000)).as_nanos(), at(10_310).as_nanos());
    let readings: Vec<_> = after.robot().readings().map(|(_, reading)| reading).collect();
    assert_eq!(readings, [5.0]);
}

#[cfg(feature = "host")]
#[test]
fn movement_needs_precise_waiting_and_message_delivery_does_not() {
    let delay = Some((Span::from_millis(10), Span::from_millis(10)));
    let mut robot = robot(Settings { delay, ..Settings::default() });
    robot.advance(at(0), &mut Vec::new());
    robot.receive(at(0), LINK, paper(1_000.0, "a"));
    assert_eq!(robot.next_wakeup(), Some(at(10)));
    assert!(!robot.moves_by(at(10)), "a delivery is no movement");
    run(&mut robot, at(100));
    assert!(!robot.moves_by(at(999)) && robot.moves_by(at(1_000)));
    assert!(!robot.has_log());
    robot.advance_movements(at(1_000));
    assert!(robot.has_log(), "its movement does not wait for its words");
    assert!(robot.is_due(at(1_000)), "its words go out with the next advance");
}

#[cfg(feature = "host")]
#[test]
fn movements_do_not_overtake_an_earlier_message() {
    let mut robot = robot(Settings::default());
    robot.advance(at(0), &mut Vec::new());
    robot.receive(at(0), LINK, paper(1_000.0, "a"));
    run(&mut robot, at(100));
    let stop = ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()));
    robot.receive(at(900), LINK, Input::Message(Message::ControlRequest(stop)));
    robot.advance_movements(at(1_000));
    assert!(!robot.has_log(), "the stop came first");
}

#[test]
fn start_fails_if_simulated_hardware_has_been_silent_too_long() {
    for (dies_at, expected) in [(850, "Started"), (849, "Failed internal")] {
        let block = robot(Settings::default()).robot().block().clone();
        let mut edge = SimulatedRobot::with_hardware(block, Settings::default(), at(0));
        edge.advance(at(0), &mut Vec::new());
        edge.receive(at(0), LINK, paper(1_000.0, "a"));
        run(&mut edge, at(500));
        edge.hardware_dies(at(dies_at));
        let at_start = at(1_000);
        let mut out = Vec::new();
        edge.advance(at_start, &mut out);
        let left: Vec<_> = out.into_iter().map(|outgoing| (at_start, outgoing)).collect();
        assert_eq!(words(&left), [expected], "{dies_at}");
    }
}

#[test]
fn fault_can_be_replaced_while_a_robot_runs() {
    let mut robot = robot(Settings { fault: Some(Fault::Silent), ..Settings::default() });
    assert_eq!(robot.replace_fault(Some(Fault::Refuse)), Some(Fault::Silent));
    assert_eq!(robot.replace_fault(None), Some(Fault::Refuse));
    robot.receive(at(0), LINK, paper(1_000.0, "a"));
    assert_eq!(words(&run(&mut robot, at(0))), ["Accepted"]);
}

#[test]
fn lost_simulated_hardware_provides_no_reading_until_it_is_found() {
    let block = r#"{"id": "r", "api_version": "1", "devices": [
        {"id": "eye", "available_control_types": {"sensor": {"min_value": 0, "max_value": 9}}}]}"#;
    let block: InitializationBlock = serde_json::from_str(block).unwrap();
    let mut edge = SimulatedRobot::with_hardware(block, Settings::default(), at(0));
    let eye = DeviceId::new("eye").unwrap();
    edge.set_reading(eye.clone(), 4.0);
    let reads = |edge: &mut SimulatedRobot, now| {
        let read = ControlRequest::immediate(eye.clone(), Command::ReadSensor);
        edge.receive(now, LINK, Input::Message(Message::ControlRequest(read)));
        let mut out = Vec::new();
        edge.advance(now, &mut out);
        match out.pop() {
            Some(Outgoing::Message { message: Message::ControlResponse(r), .. }) => Some(r.status_value),
            None => None,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(reads(&mut edge, at(0)), Some(urrcp::StatusValue::Number(4.0)));
    edge.hardware_dies(at(10));
    assert_eq!(reads(&mut edge, at(10)), None, "it does not answer");
    edge.hardware_lost(at(20), "unplugged");
    edge.advance(at(20), &mut Vec::new());
    assert_eq!(reads(&mut edge, at(20)), Some(urrcp::StatusValue::Null), "it is known to be away");
    edge.hardware_found(at(30));
    assert_eq!(reads(&mut edge, at(30)), Some(urrcp::StatusValue::Number(4.0)));
}

#[test]
fn delay_is_within_its_bounds_and_never_negative() {
    for (least, largest, expected) in [(30, 30, 30..=30), (30, 10, 30..=30), (-20, -10, 0..=0), (5, 9, 5..=9)]
    {
        let delay = Some((Span::from_millis(least), Span::from_millis(largest)));
        let mut robot = robot(Settings { delay, seed: 3, ..Settings::default() });
        let drawn: Vec<_> = (0..200).map(|_| robot.draw_delay().as_nanos()).collect();
        let bounds = expected.start() * 1_000_000..=expected.end() * 1_000_000;
        assert!(drawn.iter().all(|nanos| bounds.contains(nanos)), "{least} to {largest}: {drawn:?}");
    }
}

#[test]
fn unrealistic_drift_is_limited() {
    for (drift_ppm, expected) in [(50.0, 50e-6), (1e9, 0.1), (-1e9, -0.1)] {
        let robot = robot(Settings { drift_ppm, ..Settings::default() });
        assert!((robot.drift() - expected).abs() < 1e-12, "{drift_ppm}");
    }
}
