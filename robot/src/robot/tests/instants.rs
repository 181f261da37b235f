//! Tests events that occur at the same time, the leases that apply, and the responses that are remembered.

use std::collections::{BTreeMap, BTreeSet};

use super::*;
use crate::answers::ENDED_KEPT;

fn set(control_type: ControlType, value: f64) -> Command {
    Command::Set(Setpoint::new(control_type, value))
}

fn at_once(device: &str, id: &str, command: Command) -> ControlRequest {
    let request_id = Some(RequestId::new(id).unwrap());
    ControlRequest { request_id, ..ControlRequest::immediate(DeviceId::new(device).unwrap(), command) }
}

fn ping() -> Message {
    Message::AvailabilityRequest(AvailabilityRequest::default())
}

fn bench_of(devices: &str, reports: bool) -> Bench {
    let block = format!(r#"{{"id": "r", "api_version": "1", "reports": {reports}, "devices": [{devices}]}}"#);
    let block = serde_json::from_str(&block).unwrap();
    Bench { robot: Robot::new(block), now: at(0), out: Vec::new() }
}

#[test]
fn set_at_the_start_of_a_held_script_precedes_the_script() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "b", 1_000.0, set(ControlType::Position, 30.0)));
    bench.until(1_000);
    assert_eq!(bench.values(), [(1_000, 30.0), (1_000, 45.0)]);
    assert_eq!(bench.statuses()[2..], ["Started", "OK", "Started"]);
}

#[test]
fn set_during_a_started_script_overlaps_even_at_its_first_instant() {
    let mut bench = Bench::new();
    bench.request(at_once("arm", "a", script(ControlType::Position, &PAPER)));
    bench.request(at_once("arm", "b", set(ControlType::Position, 30.0)));
    bench.until(500);
    bench.request(at_once("arm", "c", set(ControlType::Position, 30.0)));
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed overlap", "Failed overlap"]);
}

#[test]
fn start_at_receipt_is_on_time_and_a_nanosecond_earlier_is_late() {
    let mut bench = Bench::new();
    bench.until(500);
    bench.request(timed("arm", "a", 500.0, set(ControlType::Position, 30.0)));
    bench.request(timed("arm", "b", 499.999_999, set(ControlType::Position, 40.0)));
    assert_eq!(bench.values(), [(500, 30.0)]);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK", "Failed late"]);
}

#[test]
fn set_at_the_end_of_a_script_follows_the_script() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, set(ControlType::Position, 30.0)));
    bench.request(timed("arm", "b", 0.0, script(ControlType::Position, &[(0.0, 1.0), (1_000.0, 2.0)])));
    bench.until(2_000);
    assert_eq!(bench.values(), [(0, 1.0), (1_000, 2.0), (1_000, 30.0)]);
}

#[test]
fn step_precedes_a_simultaneous_message_that_would_cancel_it() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    bench.until(1_500);
    bench.now = at(2_000);
    bench.request(at_once("arm", "b", Command::Script(Script::cancel())));
    assert_eq!(bench.values(), [(1_000, 45.0), (2_000, 0.0)]);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed cancelled", "OK"]);
}

#[test]
fn robot_delayed_beyond_the_start_tolerance_skips_the_start() {
    for (woke, said) in [(1_050, "Started"), (1_051, "Failed late")] {
        let mut bench = Bench::new();
        bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
        bench.now = at(woke);
        bench.robot.advance(bench.now, &mut bench.out);
        assert_eq!(bench.statuses(), ["Accepted", said]);
        assert_eq!(bench.values().len(), usize::from(said == "Started"));
    }
}

#[test]
fn robot_delayed_beyond_its_lease_skips_steps_that_were_due_before() {
    for (woke, set) in [(2_499, vec![(1_000, 45.0), (2_000, 0.0)]), (2_500, vec![(1_000, 45.0)])] {
        let mut bench = Bench::new();
        let mut request = timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER));
        request.stop_condition = lease(2_500.0, 2_500.0);
        bench.request(request);
        bench.until(1_500);
        bench.now = at(woke);
        let Bench { robot, now, out } = &mut bench;
        robot.advance(*now, out);
        assert_eq!(bench.values(), set, "woke up at {woke}");
        let lost = bench.statuses().last().is_some_and(|status| status == "Failed link_lost");
        assert_eq!(lost, woke == 2_500, "{:?}", bench.statuses());
    }
}

#[test]
fn request_overtaken_by_a_stop_is_cancelled_on_arrival() {
    let mut bench = Bench::new();
    let mut stop = at_once("arm", "stop", Command::Script(Script::cancel()));
    stop.timestamp = Some(Timestamp::from_nanos(BEGIN + 5_000_000));
    bench.request(stop);
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    assert_eq!(bench.statuses(), ["OK", "Failed cancelled"]);
    let mut later = timed("arm", "b", 1_000.0, script(ControlType::Position, &PAPER));
    later.timestamp = Some(Timestamp::from_nanos(BEGIN + 5_000_001));
    bench.request(later);
    assert_eq!(bench.statuses()[2], "Accepted");
}

#[test]
fn lease_ends_before_a_simultaneous_message_could_renew_it() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(300.0, 300.0);
    bench.request(request);
    bench.now = at(300);
    bench.send(ping());
    assert_eq!(bench.statuses(), ["Accepted", "Failed link_lost"]);
}

#[test]
fn undecodable_line_renews_no_lease() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(300.0, 300.0);
    bench.request(request);
    bench.until(200);
    let mut decoder = Decoder::default();
    decoder.push(b"noise\n");
    let error = decoder.next_message().unwrap().unwrap_err();
    bench.robot.handle(bench.now, LINK, Input::Undecodable(error), &mut bench.out);
    bench.until(9_000);
    assert_eq!(bench.responses()[1].event_timestamp, Some(at(300)));
}

#[test]
fn all_movements_of_an_instant_precede_all_reports() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("wheel", "b", 1_000.0, set(ControlType::Speed, 5.0)));
    bench.out.clear();
    bench.until(1_000);
    let kinds: Vec<_> = bench.out.iter().map(|output| matches!(output, Output::Set(_))).collect();
    assert_eq!(kinds, [true, true, false, false, false]);
}

#[test]
fn steps_keep_their_absolute_deadlines_when_the_driver_wakes_late() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    bench.robot.advance(at(1_007), &mut bench.out);
    bench.robot.advance(at(2_900), &mut bench.out);
    bench.until(3_000);
    assert_eq!(bench.values(), [(1_000, 45.0), (2_000, 0.0), (3_000, 45.0)]);
    assert_eq!(bench.responses()[1].event_timestamp, Some(at(1_007)), "when it really started");
}

#[test]
fn start_is_skipped_if_the_running_lease_has_ended_by_then() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER));
    request.stop_condition = lease(5_000.0, 200.0);
    bench.request(request);
    bench.until(9_000);
    assert_eq!(bench.values(), []);
    assert_eq!(bench.statuses(), ["Accepted", "Failed link_lost"]);
    assert_eq!(bench.responses()[1].event_timestamp, Some(at(1_000)));
}

fn with_own_lease(step: usize, own: Option<StopCondition>) -> Command {
    let Command::Script(script) = script(ControlType::Position, &PAPER) else { panic!() };
    let mut steps = script.steps().to_vec();
    steps[step].stop_condition = own;
    Command::Script(Script::new(steps).unwrap())
}

#[test]
fn step_is_not_set_if_its_own_lease_has_ended_by_then() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 100.0, with_own_lease(1, lease(300.0, 300.0))));
    bench.until(9_000);
    assert_eq!(bench.values(), [(100, 45.0)]);
    assert_eq!(bench.responses()[2].event_timestamp, Some(at(1_100)));
}

#[test]
fn stop_condition_of_a_step_applies_while_the_step_is_current() {
    let mut bench = Bench::new();
    let unlimited = Some(StopCondition { pending: None, running: None });
    let mut request = timed("arm", "a", 100.0, with_own_lease(0, unlimited));
    request.stop_condition = lease(1_500.0, 1_500.0);
    bench.request(request);
    bench.until(9_000);
    assert_eq!(bench.values(), [(100, 45.0), (1_100, 0.0)], "lost at 1,500 ms, in the second step");
}

#[test]
fn speed_left_on_keeps_its_lease_when_another_signal_is_commanded() {
    let mut bench = Bench::new();
    let mut request = at_once("arm", "a", set(ControlType::Speed, 5.0));
    request.stop_condition = lease(400.0, 400.0);
    bench.request(request);
    bench.until(100);
    let mut position = at_once("arm", "b", set(ControlType::Position, 30.0));
    position.stop_condition = lease(9_000.0, 9_000.0);
    bench.request(position);
    bench.until(500);
    assert_eq!(bench.robot.value("arm", ControlType::Speed, bench.now), Some(0.0));
    let lost = bench.responses()[6];
    assert_eq!(lost.request_id.as_ref().map(RequestId::as_str), Some("a"));
    assert_eq!(lost.event_timestamp, Some(at(500)));
}

#[test]
fn speed_that_is_set_again_has_the_new_lease() {
    let mut bench = Bench::new();
    let mut request = at_once("wheel", "a", set(ControlType::Speed, 5.0));
    request.stop_condition = lease(400.0, 400.0);
    bench.request(request);
    bench.request(at_once("wheel", "b", set(ControlType::Speed, 3.0)));
    bench.until(9_000);
    assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(3.0), "b has no lease");
    assert!(bench.robot.is_idle());
}

#[test]
fn pending_set_repeated_after_many_other_requests_is_executed_once() {
    let mut bench = Bench::new();
    let held = timed("arm", "held", 5_000.0, set(ControlType::Position, 30.0));
    bench.request(held.clone());
    for i in 0..2 * ENDED_KEPT {
        bench.request(timed("leg", &i.to_string(), 100.0, set(ControlType::Position, 1.0)));
    }
    bench.until(10);
    bench.request(held);
    assert_eq!(bench.statuses().last().map(String::as_str), Some("Accepted"));
    assert_eq!(bench.responses().last().unwrap().timestamp, at(10), "sent again, so stamped again");
    bench.until(9_000);
    assert_eq!(bench.values(), [(5_000, 30.0)]);
}

#[test]
fn unsupported_control_type_cancels_the_held_commands_of_the_device() {
    let mut bench = Bench::new();
    bench.request(timed("wheel", "a", 100.0, set(ControlType::Speed, 5.0)));
    bench.request(at_once("wheel", "b", set(ControlType::Position, 5.0)));
    assert_eq!(bench.statuses(), ["Accepted", "Failed cancelled", "Failed unsupported_control_type"]);
}

#[test]
fn cancel_is_never_late_and_echoes_its_hash() {
    let mut bench = Bench::new();
    bench.until(700);
    let mut cancel = timed("arm", "a", 100.0, Command::Script(Script::cancel()));
    cancel.content_hash = Some(cancel.command.content_hash());
    bench.request(cancel.clone());
    assert_eq!(bench.statuses(), ["OK"]);
    assert_eq!(bench.responses()[0].content_hash, cancel.content_hash);
}

#[test]
fn content_hash_is_computed_and_echoed_if_the_request_contains_one() {
    let mut bench = Bench::new();
    let mut request = timed("arm", "a", 100.0, script(ControlType::Position, &PAPER));
    request.content_hash = Some(request.command.content_hash());
    bench.request(request.clone());
    bench.request(timed("ramp", "b", 100.0, script(ControlType::Position, &PAPER)));
    let hashes: Vec<_> = bench.responses().iter().map(|response| response.content_hash).collect();
    assert_eq!(hashes, [request.content_hash, None]);
}

const DOOR: &str = r#"{"id": "door", "name": "door", "interpolation": "linear", "available_control_types": {
    "position": {"min_value": 20, "max_value": 90, "granularity": 1},
    "speed": {"min_value": -5, "max_value": 5, "granularity": 1},
    "script": {"min_value": -5, "max_value": 90, "granularity": 1, "max_number_of_steps": 9}}}"#;

#[test]
fn without_reports_nothing_follows_the_acceptance() {
    let mut bench = bench_of(DOOR, false);
    let mut request = timed("door", "a", 100.0, script(ControlType::Position, &[(0.0, 45.0)]));
    request.stop_condition = lease(200.0, 200.0);
    bench.request(request);
    bench.until(9_000);
    assert_eq!(bench.statuses(), ["Accepted"]);
    assert_eq!(bench.values(), [(100, 45.0)]);
}

#[test]
fn position_that_cannot_be_zero_begins_at_the_nearest_valid_value() {
    let bench = bench_of(DOOR, true);
    assert_eq!(bench.robot.value("door", ControlType::Position, at(0)), Some(20.0));
}

#[test]
fn step_at_the_time_of_the_previous_step_is_a_jump() {
    let mut bench = bench_of(DOOR, true);
    let steps = [(0.0, 30.0), (1_000.0, 40.0), (1_000.0, 60.0)];
    bench.request(timed("door", "a", 0.0, script(ControlType::Position, &steps)));
    bench.until(9_000);
    assert_eq!(bench.values(), [(0, 30.0), (1_000, 40.0), (1_000, 60.0)]);
    let ramps = bench.sets().iter().filter(|set| matches!(set.motion, Motion::Ramp { .. })).count();
    assert_eq!(ramps, 1, "from 30 to 40");
}

#[test]
fn linear_device_does_not_ramp_from_one_control_type_to_another() {
    let mut bench = bench_of(DOOR, true);
    let step = |millis, control_type, value| Step {
        offset: Millis::new(millis).unwrap(),
        setpoint: Setpoint::new(control_type, value),
        stop_condition: None,
    };
    let steps = vec![step(0.0, ControlType::Position, 30.0), step(500.0, ControlType::Speed, 4.0)];
    bench.request(timed("door", "a", 0.0, Command::Script(Script::new(steps).unwrap())));
    bench.until(9_000);
    assert!(bench.sets().iter().all(|set| matches!(set.motion, Motion::Set(_))));
    assert_eq!(bench.values(), [(0, 30.0), (500, 4.0)]);
}

#[test]
fn availability_response_contains_the_times_of_request_and_robot() {
    let mut bench = Bench::new();
    bench.until(40);
    bench.send(Message::AvailabilityRequest(AvailabilityRequest {
        session: None,
        timestamp: Some(Timestamp::from_nanos(7)),
        seize: false,
        revocation_list: None,
    }));
    let Some(Output::Send { message: Message::AvailabilityResponse(response), .. }) = bench.out.last() else {
        panic!()
    };
    assert_eq!(response.originate_timestamp, Some(Timestamp::from_nanos(7)));
    assert_eq!((response.receive_timestamp, response.timestamp), (at(40), at(40)));
    assert_eq!(response.status, Status::Ok);
}

#[test]
fn initialization_request_gets_the_block_and_a_block_gets_no_response() {
    let mut bench = Bench::new();
    bench.send(Message::InitializationRequest(urrcp::InitializationRequest::default()));
    let block = bench.robot.block().clone();
    bench.send(Message::InitializationBlock(block.clone()));
    assert_eq!(bench.out.len(), 1);
    let answered =
        matches!(&bench.out[0], Output::Send { message: Message::InitializationBlock(b), .. } if *b == block);
    assert!(answered);
}

#[test]
fn wake_ups_of_32000_devices_are_found_without_checking_each() {
    let device = |i: usize| DOOR.replacen("\"door\"", &format!("\"d{i}\""), 1);
    let devices: Vec<_> = (0..32_000).map(device).collect();
    let mut bench = bench_of(&devices.join(","), true);
    for i in 0..32_000 {
        let id = format!("d{i}");
        bench.request(timed(&id, &id, 1_000.0 + f64::from(i), set(ControlType::Position, 30.0)));
    }
    let end = 1_000 + 32_000;
    bench.until(end);
    assert_eq!(bench.values().len(), 32_000);
    assert!(bench.values().iter().map(|(millis, _)| *millis).eq(1_000..end));
}

/// An action of a server, with a different id for each request.
#[derive(Clone, Debug)]
enum Move {
    Request {
        device: usize,
        link: u64,
        start: Option<u16>,
        steps: Vec<(u16, u8)>,
        pending: u16,
        running: u16,
    },
    Ping {
        link: u64,
    },
    Wait(u16),
}

fn any_move() -> impl Strategy<Value = Move> {
    // Times are multiples of 50 ms, so that many events occur at the same instant.
    let tick = |max: u16| (0..max).prop_map(|ticks| ticks * 50);
    let steps = prop::collection::vec((tick(8), 0u8..10), 0..4);
    prop_oneof![
        4 => (0usize..3, 0u64..2, prop::option::of(tick(30)), steps, tick(20), tick(20)).prop_map(
            |(device, link, start, steps, pending, running)| Move::Request {
                device, link, start, steps, pending, running
            }
        ),
        2 => (0u64..2).prop_map(|link| Move::Ping { link }),
        3 => tick(8).prop_map(Move::Wait),
    ]
}

struct Sent {
    link: u64,
    start: Timestamp<urrcp::Robot>,
    first_offset: Span,
    started: Timestamp<urrcp::Robot>,
    lease: StopCondition,
}

proptest! {
    #[test]
    fn no_lease_is_exceeded_no_start_is_missed_and_no_step_is_set_twice(
        moves in prop::collection::vec(any_move(), 0..80),
    ) {
        let mut bench = Bench::new();
        let mut heard: BTreeMap<u64, Vec<Timestamp<urrcp::Robot>>> = BTreeMap::new();
        let mut sent = BTreeMap::new();
        let mut millis = 0;
        for (id, one) in moves.into_iter().enumerate() {
            match one {
                Move::Wait(wait) => {
                    millis += i64::from(wait);
                    bench.until(millis);
                }
                Move::Ping { link } => {
                    heard.entry(link).or_default().push(bench.now);
                    bench.robot.handle(bench.now, LinkId(link), Input::Message(ping()), &mut bench.out);
                }
                Move::Request { device, link, start, mut steps, pending, running } => {
                    steps.sort_unstable();
                    let name = ["arm", "ramp", "wheel"][device];
                    let control_type = if device == 2 { ControlType::Speed } else { ControlType::Position };
                    let steps: Vec<_> = steps.iter().map(|(t, v)| (f64::from(*t), f64::from(*v))).collect();
                    let command = match steps[..] {
                        [(_, value)] => set(control_type, value),
                        _ => script(control_type, &steps),
                    };
                    let first_offset = match &command {
                        Command::Script(script) => script.steps().first().map_or(Span::ZERO, |s| s.offset.span()),
                        _ => Span::ZERO,
                    };
                    let mut request = at_once(name, &id.to_string(), command);
                    if let Some(start) = start {
                        request.timestamp = Some(Timestamp::from_nanos(BEGIN));
                        request.time_offset_to_start = Millis::new(f64::from(start)).ok();
                    }
                    let lease = lease(f64::from(pending), f64::from(running)).unwrap();
                    request.stop_condition = Some(lease);
                    let start = start.map_or(bench.now, |start| at(i64::from(start)));
                    let started = if name == "ramp" { start } else { start + first_offset };
                    sent.insert(id.to_string(), Sent { link, start, first_offset, started, lease });
                    heard.entry(link).or_default().push(bench.now);
                    let input = Input::Message(Message::ControlRequest(request));
                    bench.robot.handle(bench.now, LinkId(link), input, &mut bench.out);
                }
            }
        }
        bench.until(millis + 10_000);
        prop_assert!(bench.robot.is_idle());
        let mut seen = BTreeSet::new();
        for moved in bench.sets() {
            let Some(id) = moved.request_id.as_ref().map(RequestId::as_str) else { continue };
            let Sent { link, start, first_offset, lease, .. } = &sent[id];
            // Messages at the instant of a movement come after it, so only earlier ones count. However, a command that starts at its
            // receipt is started by that very message.
            let last = heard[link].iter().filter(|at| **at < moved.due || **at <= *start && *start == moved.due).max();
            let silence = moved.due - *last.unwrap();
            prop_assert!(lease.running.is_some_and(|running| silence < running.span()), "{moved:?} after {silence}");
            if let (Motion::Set(_), Some(step)) = (&moved.motion, moved.step) {
                prop_assert!(seen.insert((id.to_owned(), step)), "twice: {moved:?}");
                prop_assert!(step > 0 || moved.due == *start + *first_offset, "{moved:?}");
            }
        }
        for response in bench.responses() {
            if let (Status::Started, Some(id)) = (&response.status, &response.request_id) {
                prop_assert_eq!(response.event_timestamp, Some(sent[id.as_str()].started));
            }
        }
    }
}

#[test]
fn robot_is_idle_unless_it_holds_a_command() {
    let mut bench = Bench::new();
    assert!(bench.robot.is_idle());
    bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &[(0.0, 20.0), (100.0, 30.0)])));
    assert!(!bench.robot.is_idle());
    bench.until(1_000);
    assert!(bench.robot.is_idle());
}

#[test]
fn zero_acceleration_causes_no_gradual_slowdown() {
    let limits = |acceleration: &str| {
        format!(
            r#"{{"id": "lift", "interpolation": "linear", "default_value": 0, "available_control_types": {{
            "position": {{"min_value": 0, "max_value": 100, "granularity": 1}},
            "acceleration": {{"min_value": {acceleration}, "max_value": 0, "granularity": 1}},
            "script": {{"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 8}}}}}}"#
        )
    };
    for (acceleration, slows) in [("0", false), ("-10", true)] {
        let mut bench = bench_of(&limits(acceleration), true);
        let way = script(ControlType::Position, &[(0.0, 0.0), (1_000.0, 80.0)]);
        bench.request(timed("lift", "a", 0.0, way));
        bench.until(500);
        let stop =
            ControlRequest::immediate(DeviceId::new("lift").unwrap(), Command::Script(Script::cancel()));
        bench.request(stop);
        let slow = bench.sets().iter().any(|set| matches!(set.motion, Motion::Slow { .. }));
        assert_eq!(slow, slows, "{acceleration}");
        let position = bench.robot.value("lift", ControlType::Position, at(10_000)).unwrap();
        assert_eq!(position > 40.0, slows, "it moves while it brakes: {position}");
    }
}

#[test]
fn stop_without_home_turns_no_undriven_wheel_to_its_default_state() {
    let wheel = r#"{"id": "wheel", "default_value": 8, "available_control_types": {
        "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
        "acceleration": {"min_value": -4, "max_value": 4, "granularity": 1}}}"#;
    let stop = |home| {
        let mut bench = bench_of(wheel, true);
        let id = DeviceId::new("wheel").unwrap();
        let stop = ControlRequest::immediate(id, Command::Script(Script::cancel()));
        bench.request(ControlRequest { home, ..stop });
        let speed = |millis| bench.robot.value("wheel", ControlType::Speed, at(millis)).unwrap();
        (bench.sets().iter().map(|set| set.motion.clone()).collect::<Vec<_>>(), [0, 1_000, 9_000].map(speed))
    };
    let rest = Motion::Rest(Setpoint::new(ControlType::Speed, 0.0));
    assert_eq!(stop(false), (vec![rest], [0.0; 3]));
    assert_eq!(stop(true).1, [0.0, 4.0, 8.0], "home within its acceleration");
}

/// Returns the statuses and the number of late steps that a robot reports for a script if it wakes up `nanos` nanoseconds after the
/// start.
fn woken_late(nanos: i64) -> (Vec<String>, Option<u32>) {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &[(0.0, 45.0), (1_000.0, 0.0)])));
    bench.now = Timestamp::from_nanos(at(1_000).as_nanos() + nanos);
    bench.robot.advance(bench.now, &mut bench.out);
    bench.until(3_000);
    (bench.statuses(), bench.responses().last().unwrap().late_steps)
}

#[test]
fn start_may_be_50_ms_late_and_counts_as_late_beyond_1_ms() {
    let played = ["Accepted", "Started", "OK"].map(str::to_owned).to_vec();
    assert_eq!(woken_late(1_000_000), (played.clone(), Some(0)));
    assert_eq!(woken_late(1_000_001), (played.clone(), Some(1)));
    assert_eq!(woken_late(50_000_000), (played, Some(1)));
    assert_eq!(woken_late(50_000_001).0, ["Accepted", "Failed late"]);
}

#[test]
fn step_counts_as_late_beyond_1_ms_and_each_late_step_is_counted() {
    for (nanos, late) in [(1_000_000, 0), (1_000_001, 2)] {
        let mut bench = Bench::new();
        bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &PAPER)));
        for millis in [1_000, 2_000] {
            bench.now = Timestamp::from_nanos(at(millis).as_nanos() + nanos);
            bench.robot.advance(bench.now, &mut bench.out);
        }
        let responses = bench.responses();
        let ended = responses.last().unwrap();
        assert_eq!(ended.late_steps, Some(late));
        let latest = (late > 0).then(|| Millis::new(1.000_001).unwrap());
        assert_eq!(ended.late_ms_max, latest, "the latest one, where any is late");
    }
}

#[test]
fn stopped_device_holds_position_stops_turning_and_goes_home_on_request() {
    for (home, position) in [(false, 45.0), (true, 10.0)] {
        let mut bench = Bench::new();
        bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &PAPER)));
        bench.request(at_once("wheel", "b", set(ControlType::Speed, 5.0)));
        bench.until(500);
        for device in ["arm", "wheel"] {
            bench.request(ControlRequest {
                home,
                ..at_once(device, device, Command::Script(Script::cancel()))
            });
        }
        // The movement to the default state takes 3.5 s at the speed that the arm declares.
        bench.until(4_000);
        assert_eq!(bench.robot.value("arm", ControlType::Position, bench.now), Some(position));
        assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(0.0));
        assert!(bench.robot.is_idle());
    }
}

#[test]
fn rest_and_return_home_obey_the_tighter_device_or_operator_limits() {
    let limits = |device: &str, speed, acceleration| {
        [(DeviceId::new(device).unwrap(), MotionLimits { speed, acceleration })].into()
    };
    let end = |device: &str| at_once(device, "end", Command::Script(Script::cancel()));
    // The arm declares a speed of 10, and its remaining distance is 35.
    for (limit, millis) in [(Some(5.0), 7_000), (Some(20.0), 3_500), (None, 3_500)] {
        let mut bench = Bench::new();
        bench.robot = bench.robot.with_limits(&limits("arm", limit, None));
        bench.request(at_once("arm", "a", set(ControlType::Position, 45.0)));
        bench.request(ControlRequest { home: true, ..end("arm") });
        bench.until(millis - 100);
        assert_ne!(bench.robot.value("arm", ControlType::Position, bench.now), Some(10.0), "{limit:?}");
        bench.until(millis);
        assert_eq!(bench.robot.value("arm", ControlType::Position, bench.now), Some(10.0), "{limit:?}");
    }
    // The wheel declares no acceleration.
    for (limit, after_a_second) in [(Some(4.0), 4.0), (None, 0.0)] {
        let mut bench = Bench::new();
        bench.robot = bench.robot.with_limits(&limits("wheel", None, limit));
        bench.request(at_once("wheel", "a", set(ControlType::Speed, 8.0)));
        bench.request(end("wheel"));
        bench.until(1_000);
        assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(after_a_second));
        bench.until(2_000);
        assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(0.0));
    }
}

#[test]
fn speed_with_zero_acceleration_ends_immediately() {
    let wheel = |most: u32| {
        format!(
            r#"{{"id": "wheel", "available_control_types": {{
            "speed": {{"min_value": -10, "max_value": 10, "granularity": 1}},
            "acceleration": {{"min_value": 0, "max_value": {most}, "granularity": 1}}}}}}"#
        )
    };
    for (most, after_a_second) in [(0, 0.0), (5, 3.0)] {
        let mut bench = bench_of(&wheel(most), true);
        bench.request(at_once("wheel", "a", set(ControlType::Speed, 8.0)));
        bench.request(at_once("wheel", "b", Command::Script(Script::cancel())));
        bench.until(1_000);
        assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(after_a_second));
    }
}

#[test]
fn robot_starts_when_woken_50_ms_late_but_not_a_nanosecond_later() {
    for (late, status) in [(Span::from_millis(50), "Started"), (Span::from_nanos(50_000_001), "Failed late")]
    {
        let mut bench = Bench::new();
        bench.request(timed("arm", "a", 100.0, script(ControlType::Position, &PAPER)));
        bench.now = at(100) + late;
        bench.robot.advance(bench.now, &mut bench.out);
        assert_eq!(bench.statuses()[1], status, "{late}");
    }
}
