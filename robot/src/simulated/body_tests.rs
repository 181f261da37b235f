//! Tests the body of a simulated robot in virtual time: its lag and its sensor.

use urrcp::{
    ControlRequest, ControlType, DeviceId, InitializationBlock, Millis, RequestId, Script, Setpoint,
    StatusValue, Step,
};

use super::*;

const LINK: LinkId = LinkId(1);
const BEGIN: i64 = 1_000_000_000_000;

fn at(millis: i64) -> Timestamp<True> {
    Timestamp::from_nanos(BEGIN + millis * 1_000_000)
}

fn id(name: &str) -> DeviceId {
    DeviceId::new(name).unwrap()
}

/// Returns a robot with an arm that has a body, and with a sensor for the arm's angle. At time 0, the arm is commanded to move to 10
/// within 100 ms.
fn moving(interpolation: &str, change: impl FnOnce(&mut Moves)) -> SimulatedRobot {
    let block = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
        {"id": "arm", "interpolation": "INTERPOLATION", "default_value": 0, "available_control_types": {
          "position": {"min_value": 0, "max_value": 90, "granularity": 1},
          "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 4}}},
        {"id": "angle", "available_control_types": {"sensor": {"min_value": -1, "max_value": 20}}}]}"#;
    let block: InitializationBlock =
        serde_json::from_str(&block.replace("INTERPOLATION", interpolation)).unwrap();
    let mut moves = Moves {
        device: id("arm"),
        latency: Span::from_millis(40),
        spread: Span::ZERO,
        time_constant: Span::ZERO,
        sensor: id("angle"),
        noise: 0.0,
        delay: Span::ZERO,
    };
    change(&mut moves);
    let mut robot = SimulatedRobot::new(block, Settings { moves: vec![moves], ..Settings::default() });
    let step = Step::new(Millis::new(100.0).unwrap(), Setpoint::new(ControlType::Position, 10.0));
    let script = Command::Script(Script::new(vec![step]).unwrap());
    let request = ControlRequest::immediate(id("arm"), script).with_request_id(RequestId::new("m").unwrap());
    robot.receive(at(0), LINK, Input::Message(Message::ControlRequest(request)));
    robot
}

/// Requests the sensor's reading at this instant. Returns the reading, and the time of the response.
fn read(robot: &mut SimulatedRobot, millis: i64) -> (f64, Timestamp<True>) {
    let mut out = Vec::new();
    while let Some(now) = robot.next_wakeup().filter(|wakeup| *wakeup <= at(millis)) {
        robot.advance(now, &mut out);
    }
    out.clear();
    let request = ControlRequest::immediate(id("angle"), Command::ReadSensor);
    robot.receive(at(millis), LINK, Input::Message(Message::ControlRequest(request)));
    let mut now = at(millis);
    loop {
        robot.advance(now, &mut out);
        let reading = out.drain(..).find_map(|outgoing| match outgoing {
            Outgoing::Message { message: Message::ControlResponse(response), .. }
                if response.status == Status::Provide =>
            {
                Some((response.status_value, response.timestamp))
            }
            _ => None,
        });
        if let Some((StatusValue::Number(value), told)) = reading {
            assert_eq!(told.as_nanos(), now.as_nanos(), "the answer has the time of its sending");
            return (value, now);
        }
        now = robot.next_wakeup().unwrap();
    }
}

#[track_caller]
fn shows(robot: &mut SimulatedRobot, expected: &[(i64, f64)]) {
    for (millis, value) in expected {
        let (shown, _) = read(robot, *millis);
        assert!((shown - value).abs() < 1e-6, "{shown} after {millis} ms, expected {value}");
    }
}

#[test]
fn body_follows_a_ramp_after_its_latency() {
    let mut robot = moving("linear", |_| {});
    shows(&mut robot, &[(0, 0.0), (39, 0.0), (40, 0.0), (65, 2.5), (140, 10.0), (500, 10.0)]);
}

#[test]
fn first_order_lag_trails_a_ramp_by_its_time_constant() {
    let mut robot = moving("linear", |moves| moves.time_constant = Span::from_millis(10));
    // The position on the ramp is 10 * (t - T + T exp(-t/T)) / 100.
    let on_ramp = |t: f64| 0.1 * (t - 10.0 + 10.0 * (-t / 10.0).exp());
    let end = on_ramp(100.0);
    let after = 10.0 - (10.0 - end) * (-2.0_f64).exp();
    shows(&mut robot, &[(40, 0.0), (60, on_ramp(20.0)), (120, on_ramp(80.0)), (160, after)]);
}

#[test]
fn body_follows_a_step_with_first_order_lag() {
    let mut robot = moving("hold", |moves| moves.time_constant = Span::from_millis(10));
    let lagged = 10.0 * (1.0 - (-1.0_f64).exp());
    shows(&mut robot, &[(139, 0.0), (140, 0.0), (150, lagged), (400, 10.0)]);
}

#[test]
fn delayed_sensor_response_shows_body_at_time_of_request() {
    let mut robot = moving("linear", |moves| moves.delay = Span::from_millis(30));
    let (value, answered) = read(&mut robot, 65);
    assert!((value - 2.5).abs() < 1e-6 && answered == at(95), "{value} at {answered:?}");
}

#[test]
fn sensor_noise_has_its_deviation_and_stays_in_range() {
    let mut robot = moving("linear", |moves| moves.noise = 0.5);
    let values: Vec<f64> = (0..400).map(|index| read(&mut robot, 500 + index).0).collect();
    let mean = values.iter().sum::<f64>() / 400.0;
    let deviation = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 399.0).sqrt();
    assert!((mean - 10.0).abs() < 0.15 && (deviation - 0.5).abs() < 0.1, "{mean} +-{deviation}");
    let mut wild = moving("linear", |moves| moves.noise = 1e6);
    assert!((0..20).all(|index| (-1.0..=20.0).contains(&read(&mut wild, 500 + index).0)));
}

#[test]
fn movement_starts_vary_within_spread_and_are_reproducible_by_seed() {
    let begin = |seed: u64| {
        let mut robot = moving("linear", |moves| moves.spread = Span::from_millis(6));
        robot.bodies[0] = body::MovedBody::new(
            robot.bodies[0].moves.clone(),
            (-1.0, 20.0),
            0.0,
            fastrand::Rng::with_seed(seed),
        );
        // The position on the ramp reveals the start time.
        65.0 - read(&mut robot, 65).0 * 10.0
    };
    let begins: Vec<f64> = (0..200).map(begin).collect();
    let within = begins.iter().filter(|begin| (**begin - 40.0).abs() <= 6.0).count();
    assert!((182..=198).contains(&within), "{within} of 200");
    assert_eq!(begin(3), begins[3]);
}

#[test]
fn commands_within_the_latency_are_followed_in_order() {
    let mut robot = moving("hold", |_| {});
    let steps = [(0.0, 2.0), (20.0, 6.0)].map(|(offset, value)| {
        Step::new(Millis::new(offset).unwrap(), Setpoint::new(ControlType::Position, value))
    });
    let script = Command::Script(Script::new(steps.to_vec()).unwrap());
    read(&mut robot, 200);
    let request = ControlRequest::immediate(id("arm"), script).with_request_id(RequestId::new("n").unwrap());
    robot.receive(at(200), LINK, Input::Message(Message::ControlRequest(request)));
    shows(&mut robot, &[(239, 10.0), (240, 2.0), (259, 2.0), (260, 6.0)]);
}

#[test]
fn body_without_commands_is_at_the_rest_position_of_its_device() {
    let mut robot = moving("linear", |_| {});
    let mut unmoved = robot.restarted(at(0));
    unmoved.bodies[0] =
        body::MovedBody::new(robot.bodies[0].moves.clone(), (-1.0, 20.0), 0.0, fastrand::Rng::with_seed(1));
    shows(&mut unmoved, &[(10, 0.0), (500, 0.0)]);
    shows(&mut robot, &[(140, 10.0)]);
}

#[test]
fn body_of_a_stopped_device_continues_for_its_latency_then_rests() {
    let mut robot = moving("linear", |_| {});
    read(&mut robot, 90);
    let stop = ControlRequest::immediate(id("arm"), Command::Script(Script::cancel()));
    robot.receive(at(90), LINK, Input::Message(Message::ControlRequest(stop)));
    shows(&mut robot, &[(120, 8.0), (129, 8.9), (130, 9.0), (500, 9.0)]);
}

#[test]
fn each_movement_has_its_own_latency_shared_by_its_steps() {
    let mut robot = moving("hold", |moves| {
        moves.spread = Span::from_millis(30);
        moves.latency = Span::from_millis(100);
    });
    let mut begins = Vec::new();
    for movement in 0..2 {
        let begin = 1_000 + movement * 1_000;
        let steps = [(0.0, 2.0), (300.0, 8.0)].map(|(offset, value)| {
            Step::new(Millis::new(offset).unwrap(), Setpoint::new(ControlType::Position, value))
        });
        let script = Command::Script(Script::new(steps.to_vec()).unwrap());
        read(&mut robot, begin);
        let name = RequestId::new(movement.to_string()).unwrap();
        let request = ControlRequest::immediate(id("arm"), script).with_request_id(name);
        robot.receive(at(begin), LINK, Input::Message(Message::ControlRequest(request)));
        let mut changed_at = |from: i64, value: f64| {
            (from..from + 300).find(|millis| (read(&mut robot, *millis).0 - value).abs() < 1e-9).unwrap()
                - from
        };
        let (first, second) = (changed_at(begin, 2.0), changed_at(begin + 300, 8.0));
        assert_eq!(first, second, "{movement}");
        begins.push(first);
    }
    assert_ne!(begins[0], begins[1]);
}

#[test]
fn lag_follows_consecutive_ramps_without_a_jump() {
    let mut robot = moving("linear", |moves| moves.time_constant = Span::from_millis(20));
    let values: Vec<f64> = (0..400).map(|millis| read(&mut robot, millis).0).collect();
    // The position changes by at most 0.1 per millisecond. It is never ahead of the ramp, never moves backwards, and reaches the target.
    assert!(values.windows(2).all(|pair| (0.0..=0.1 + 1e-9).contains(&(pair[1] - pair[0]))), "{values:?}");
    assert!(
        values
            .iter()
            .zip(0..)
            .all(|(value, millis)| *value <= 0.1 * (f64::from(millis) - 40.0).max(0.0) + 1e-9)
    );
    assert!((values[399] - 10.0).abs() < 1e-4, "{}", values[399]);
}

#[test]
fn body_read_late_has_slowed_down_at_the_end_of_its_movement() {
    let moves = Moves {
        device: id("arm"),
        latency: Span::from_millis(20),
        spread: Span::ZERO,
        time_constant: Span::from_millis(10),
        sensor: id("angle"),
        noise: 0.0,
        delay: Span::ZERO,
    };
    let due = at(0).assume_clock();
    let until = due + Span::from_millis(100);
    let motion =
        crate::device::Motion::Slow { control_type: ControlType::Position, from: 0.0, to: 10.0, until };
    let set = crate::robot::SetValue { device: id("arm"), motion, due, request_id: None, step: None };
    let end = 0.1 * (90.0 + 10.0 * (-10.0_f64).exp());
    for (millis, expected) in [(10, 0.0), (120, end), (150, 10.0 - (10.0 - end) * (-3.0_f64).exp())] {
        let rng = fastrand::Rng::with_seed(1);
        let mut body = body::MovedBody::new(moves.clone(), (-1.0, 20.0), 0.0, rng);
        body.told(at(0), &set);
        let shown = body.shown(at(millis), 0.0);
        assert!((shown - expected).abs() < 1e-9, "{shown} after {millis} ms, expected {expected}");
    }
}

#[test]
fn body_is_moved_only_by_positions() {
    let mut robot = moving("linear", |_| {});
    let setpoint = Setpoint::new(ControlType::Speed, 9.0);
    let motion = crate::device::Motion::Set(setpoint);
    let due = at(0).assume_clock();
    let set = crate::robot::SetValue { device: id("arm"), motion, due, request_id: None, step: None };
    robot.bodies[0].told(at(0), &set);
    shows(&mut robot, &[(39, 0.0), (65, 2.5)]);
}

#[test]
fn body_remembers_at_most_16384_pending_movements() {
    for (further, begun) in [(16_383, 1.0), (16_384, 0.0)] {
        let moves =
            Moves { latency: Span::from_millis(1_000), ..moving("hold", |_| {}).bodies[0].moves.clone() };
        let mut body = body::MovedBody::new(moves, (-1.0, 20.0), 0.0, fastrand::Rng::with_seed(1));
        let mut told = |millis: i64, value: f64| {
            let motion = crate::device::Motion::Set(Setpoint::new(ControlType::Position, value));
            let due = at(millis).assume_clock();
            let set = crate::robot::SetValue { device: id("arm"), motion, due, request_id: None, step: None };
            body.told(at(millis), &set);
        };
        told(0, 1.0);
        (0..further).for_each(|_| told(500, 2.0));
        assert_eq!([1_000, 1_500].map(|millis| body.shown(at(millis), 0.0)), [begun, 2.0]);
    }
}
