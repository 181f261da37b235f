//! Tests that the end of a pending lease ends only pending commands.

use super::*;

fn leased(device: &str, id: &str, start_ms: f64, command: Command, pending: f64) -> ControlRequest {
    ControlRequest { stop_condition: lease(pending, 2_000.0), ..timed(device, id, start_ms, command) }
}

fn paper() -> Command {
    script(ControlType::Position, &PAPER)
}

#[test]
fn lease_end_error_names_the_lease_and_any_delay_of_the_robot() {
    for (start, lease_of) in [(0.0, "running"), (1_000.0, "pending")] {
        for (woke, why) in [
            (350, "ended: the server was silent"),
            (351, "ended while the robot was delayed: the robot woke up 51 ms"),
        ] {
            let mut bench = Bench::new();
            let leased = timed("arm", "a", start, script(ControlType::Position, &PAPER));
            bench.request(ControlRequest { stop_condition: lease(300.0, 300.0), ..leased });
            bench.robot.advance(at(woke), &mut bench.out);
            let error = bench.responses().last().unwrap().error.clone().unwrap();
            assert!(error.message.starts_with(&format!("the {lease_of} lease {why}")), "{error:?}");
        }
    }
}

#[test]
fn end_of_a_pending_lease_does_not_affect_the_running_script() {
    let mut bench = Bench::new();
    bench.request(leased("arm", "running", 0.0, paper(), 240.0));
    bench.until(100);
    bench.request(leased("arm", "queued", 3_000.0, paper(), 240.0));
    bench.until(700);
    assert_eq!(bench.statuses()[3..], ["Failed link_lost"], "600 ms of silence");
    let lost = bench.responses()[3];
    assert_eq!(lost.request_id.as_ref().unwrap().as_str(), "queued");
    assert_eq!(lost.event_timestamp, Some(at(340)));
    bench.send(Message::AvailabilityRequest(AvailabilityRequest::default()));
    bench.until(5_000);
    assert_eq!(bench.values(), [(0, 45.0), (1_000, 0.0), (2_000, 45.0)]);
    assert_eq!(bench.statuses()[4..], ["OK"]);
}

#[test]
fn end_of_a_pending_lease_cancels_later_starts_and_keeps_earlier_ones() {
    let block = BLOCK.replace(r#""script_queue": 2"#, r#""script_queue": 3"#);
    let mut bench = Bench { robot: Robot::new(serde_json::from_str(&block).unwrap()), ..Bench::new() };
    let bow = || script(ControlType::Position, &[(0.0, 5.0)]);
    bench.request(leased("arm", "later", 2_000.0, bow(), 9_000.0));
    bench.request(leased("arm", "first", 1_000.0, bow(), 9_000.0));
    bench.request(leased("arm", "middle", 1_500.0, bow(), 300.0));
    bench.until(1_200);
    assert_eq!(bench.statuses()[3..], ["Failed link_lost", "Failed link_lost", "Started", "OK"]);
    let of = |index: usize| bench.responses()[index].request_id.as_ref().unwrap().as_str().to_owned();
    assert_eq!([of(3), of(4), of(5)], ["middle", "later", "first"]);
    assert_eq!(bench.values(), [(1_000, 5.0)]);
}

#[test]
fn speed_left_on_keeps_its_own_lease_when_a_pending_lease_ends() {
    let mut bench = Bench::new();
    bench.request(leased("wheel", "on", 0.0, script(ControlType::Speed, &[(0.0, 5.0)]), 240.0));
    bench.request(leased("wheel", "next", 9_000.0, script(ControlType::Speed, &[(0.0, 7.0)]), 240.0));
    bench.until(1_999);
    assert_eq!(bench.statuses()[4..], ["Failed link_lost"]);
    assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(5.0));
    bench.until(2_000);
    assert_eq!(bench.statuses()[5..], ["Failed link_lost"]);
    assert_eq!(bench.robot.value("wheel", ControlType::Speed, bench.now), Some(0.0));
}

#[test]
fn end_of_a_pending_lease_moves_nothing() {
    let mut bench = Bench::new();
    bench.request(leased("arm", "done", 0.0, script(ControlType::Position, &[(0.0, 45.0)]), 240.0));
    bench.request(leased("arm", "queued", 3_000.0, paper(), 240.0));
    bench.until(9_000);
    assert_eq!(bench.statuses().last().unwrap(), "Failed link_lost");
    assert_eq!(bench.sets().len(), 1, "the first script alone: {:?}", bench.sets());
}

#[test]
fn end_of_a_running_lease_cancels_pending_scripts() {
    let mut bench = Bench::new();
    let mut running = leased("arm", "running", 0.0, paper(), 240.0);
    running.stop_condition = lease(240.0, 300.0);
    bench.request(running);
    bench.request(leased("arm", "queued", 3_000.0, paper(), 9_000.0));
    bench.until(300);
    assert_eq!(bench.statuses()[3..], ["Failed link_lost", "Failed link_lost"]);
    assert_eq!(bench.robot.value("arm", ControlType::Position, bench.now), Some(45.0), "it stays");
}

/// Returns the reports about the command `a` of a device that follow the report of its end, within a minute without messages. If
/// `cancels`, the device is cancelled after 150 ms.
fn reported_after_the_end(device: &str, command: Command, cancels: bool) -> Vec<String> {
    let mut bench = Bench::new();
    bench.request(ControlRequest {
        stop_condition: lease(400.0, 400.0),
        ..timed(device, "a", 100.0, command)
    });
    bench.until(150);
    if cancels {
        let cancel = Command::Script(Script::cancel());
        bench.request(ControlRequest::immediate(DeviceId::new(device).unwrap(), cancel));
    }
    bench.until(60_000);
    let of_it = bench
        .responses()
        .into_iter()
        .filter(|said| said.request_id.as_ref().is_some_and(|id| id.as_str() == "a"));
    let told = |said: &ControlResponse| match &said.error {
        Some(error) => format!("{} {}", said.status, error.code),
        None => said.status.to_string(),
    };
    let is_open = |said: &&ControlResponse| matches!(said.status, Status::Accepted | Status::Started);
    of_it.skip_while(is_open).map(told).skip(1).collect()
}

#[test]
fn only_the_lease_end_of_a_speed_left_on_is_reported_after_an_end() {
    let speed = |value| script(ControlType::Speed, &[(0.0, value)]);
    let position = script(ControlType::Position, &[(0.0, 45.0)]);
    for (device, command, cancels, expected) in [
        ("wheel", speed(5.0), false, &["Failed link_lost"][..]),
        ("wheel", speed(5.0), true, &[]),
        ("wheel", speed(0.0), false, &[]),
        ("wheel", speed(11.0), false, &[]),
        ("arm", position, false, &[]),
        ("arm", paper(), false, &[]),
        ("arm", paper(), true, &[]),
    ] {
        let reported = reported_after_the_end(device, command.clone(), cancels);
        assert_eq!(reported, expected, "{device}, {command:?}, cancelled: {cancels}");
    }
}

#[test]
fn message_that_only_robots_send_does_not_renew_a_lease() {
    let mut bench = Bench::new();
    bench.request(leased("arm", "a", 5_000.0, paper(), 300.0));
    bench.until(200);
    bench.send(Message::InitializationBlock(bench.robot.block().clone()));
    bench.until(300);
    assert_eq!(bench.statuses(), ["Accepted", "Failed link_lost"]);
}
