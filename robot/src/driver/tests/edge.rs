//! Tests which values reach the hardware, in which order, and which effects failures have on scripts and devices.

use super::*;

#[tokio::test]
async fn values_reach_the_hardware_in_order_and_the_wheel_finally_stops() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    // Each script is done before the next one is due, so that none replaces another.
    for (id, value) in [("a", 4.0), ("b", -4.0), ("c", 2.0)] {
        rig.script("wheel", id, &[(0.0, value)], ControlType::Speed);
        rig.responses(&PLAYED).await;
    }
    let (done, not_at_rest) = rig.stop_and_tell();
    assert_eq!(done, ["connect", "wheel 4", "wheel -4", "wheel 2", "wheel 0"]);
    assert_eq!(not_at_rest, None);
}

#[tokio::test]
async fn script_steps_reach_the_hardware_in_order_and_the_last_one_always() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script_in("wheel", "a", 3_000.0, &[(0.0, 4.0), (300.0, -4.0), (600.0, 2.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    let done = rig.stop();
    // If the machine stalls for longer than a step, values that are out of date are skipped.
    let told: Vec<_> = done.iter().filter_map(|what| value_of("wheel", what)).collect();
    let mut steps = [4.0, -4.0, 2.0].into_iter();
    let played = &told[..told.len() - 1];
    assert!(played.iter().all(|value| steps.any(|step| step == *value)), "{done:?}");
    assert_eq!(played.last(), Some(&2.0), "{done:?}");
}

#[tokio::test]
async fn values_set_on_hardware_are_logged() {
    let log = LogFile::new("edge");
    let options = HostOptions::default().with_log(log.0.clone());
    let mut rig = Rig::on(options, BLOCK, Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (20.0, -4.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    let _done = rig.stop();
    let steps: Vec<_> =
        log.lines().iter().filter(|line| line["step"].is_u64()).map(|line| line["value"].clone()).collect();
    assert_eq!(steps, [4.0, -4.0]);
}

#[tokio::test]
async fn hardware_that_only_read_a_sensor_is_not_moved() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.link.send(Message::ControlRequest(ControlRequest::immediate(
        DeviceId::new("eye").unwrap(),
        Command::ReadSensor,
    )));
    assert_eq!(rig.response().await.status_value, StatusValue::Number(7.0));
    // A device that never moved is at rest, even if its hardware is gone.
    rig.bench.broken.store(true, Ordering::SeqCst);
    let (done, not_at_rest) = rig.stop_and_tell();
    assert_eq!((done, not_at_rest), (vec!["connect".to_owned(), "read eye".to_owned()], None));
}

#[tokio::test]
async fn linear_movement_is_sampled_on_the_grid_and_ends_at_its_target() {
    let options = DriverOptions { samples_per_second: Some(200.0), ..DriverOptions::default() };
    let mut rig = Rig::new(Bench::default(), options);
    rig.script("arm", "a", &[(2_000.0, 30.0)], ControlType::Position);
    rig.responses(&PLAYED).await;
    let done = rig.stop();
    let end = done.iter().rposition(|what| what == "arm 30").unwrap();
    let values: Vec<f64> =
        done[1..=end].iter().map(|what| what.strip_prefix("arm ").unwrap().parse().unwrap()).collect();
    assert!(values.len() > 3, "no samples: {values:?}");
    assert!(values.is_sorted(), "{values:?}");
    assert!(values.iter().all(|value| (value * 2.0).fract() == 0.0), "off the grid: {values:?}");
    assert_eq!(&done[end + 1..], ["wheel 0"]);
}

#[tokio::test]
async fn second_sample_of_a_movement_comes_one_period_after_the_first() {
    // One sample every three seconds, during a movement of six seconds. The first sample is near the start, though it may be a second
    // late; the third is at the end.
    let options = DriverOptions { samples_per_second: Some(1.0 / 3.0), ..DriverOptions::default() };
    let mut rig = Rig::new(Bench::default(), options);
    rig.script("arm", "a", &[(6_000.0, 30.0)], ControlType::Position);
    rig.responses(&PLAYED).await;
    let done = rig.stop();
    let values = done.iter().filter_map(|what| value_of("arm", what));
    let on_the_way: Vec<f64> = values.filter(|value| (10.0..29.0).contains(value)).collect();
    assert_eq!(on_the_way.len(), 1, "{done:?}");
}

#[tokio::test]
async fn devices_slow_down_in_place_when_the_edge_ends() {
    // The driver would take ramps, but this movement is not a ramp.
    let bench = Bench { takes_ramps: true, ..Bench::default() };
    let options = DriverOptions { samples_per_second: Some(200.0), ..DriverOptions::default() };
    let mut rig = Rig::of(LIFT, bench, options);
    rig.script("lift", "a", &[(5_000.0, 100.0)], ControlType::Position);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "lift ramp to 100"]);
    let done = rig.stop();
    let values: Vec<f64> = done.iter().filter_map(|what| value_of("lift", what)).collect();
    // From a speed of 20 per second, the movement continues for another 2 in 0.2 s, and does not reverse.
    assert!(values.len() > 1 && values.is_sorted(), "{done:?}");
    assert!(values.last().is_some_and(|last| (2.0..100.0).contains(last)), "{done:?}");
}

#[tokio::test]
async fn driver_with_ramps_receives_a_linear_movement_as_a_whole() {
    let bench = Bench { takes_ramps: true, ..Bench::default() };
    let mut rig = Rig::new(bench, DriverOptions::default());
    rig.script("arm", "a", &[(0.0, 3.0), (3_000.0, 30.0)], ControlType::Position);
    rig.responses(&PLAYED).await;
    let done = rig.stop();
    assert_eq!(done, ["connect", "arm 3", "arm ramp to 30", "arm 30", "wheel 0"]);
}

#[tokio::test]
async fn edge_ends_only_after_the_driver_has_finished_its_ramp() {
    let bench = Bench { takes_ramps: true, ..Bench::default() };
    let mut rig = Rig::of(HEAVY, bench, DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 10.0), (60_000.0, 10.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 10"]);
    let begin = HostClock::anchored().now();
    let mut done = rig.stop();
    let took = HostClock::anchored().now() - begin;
    done.retain(|what| what.starts_with("wheel"));
    assert_eq!(done, ["wheel ramp to 0", "wheel 0"]);
    assert!(took >= Span::from_millis(450), "ended {took} after it had begun to slow down for 500 ms");
}

#[tokio::test]
async fn position_that_cannot_come_to_rest_in_time_is_kept_without_a_jump() {
    let mut rig = Rig::of(HEAVY, Bench::default(), DriverOptions::default());
    rig.script("lift", "a", &[(4_000.0, 20.0), (60_000.0, 20.0)], ControlType::Position);
    rig.responses(&PLAYED[..2]).await;
    rig.until_beyond("lift", 2.0);
    let (done, not_at_rest) = rig.stop_and_tell();
    assert!(not_at_rest.unwrap().contains("`lift` had not reached its target after"));
    let values: Vec<f64> = done.iter().filter_map(|what| value_of("lift", what)).collect();
    assert_ne!(values.last(), Some(&0.0), "{values:?}");
}

#[tokio::test]
async fn hardware_is_pinged_however_close_the_steps_are() {
    let mut rig = Rig::of(HEAVY, Bench::default(), DriverOptions::default());
    let steps: Vec<_> = (0..700_u32).map(|i| (f64::from(i) * 5.0, f64::from(i % 2 + 1))).collect();
    rig.script("wheel", "a", &steps, ControlType::Speed);
    rig.responses(&PLAYED).await;
    let done: Vec<String> = rig.done.try_iter().collect();
    let mut played = done.iter().skip_while(|what| !what.starts_with("wheel"));
    assert!(played.any(|what| what == "ping"), "no ping in {} values", done.len());
}

#[tokio::test]
async fn slow_device_skips_outdated_values_without_delaying_the_machine() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.bench.busy.store(true, Ordering::SeqCst);
    rig.script("wheel", "a", &[(0.0, 0.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 0"]);
    // While the first value still hangs in the driver, the machine continues, but does not report an end.
    let steps: Vec<_> = (1..8_u32).map(|i| (f64::from(i) * 10.0, f64::from(i))).collect();
    rig.script("wheel", "b", &steps, ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.until_steps(8).await;
    let early = tokio::time::timeout(Duration::from_millis(150), rig.response()).await;
    assert!(early.is_err(), "told before the hardware has it: {early:?}");
    rig.bench.busy.store(false, Ordering::SeqCst);
    rig.next_done(&["wheel 7"]);
    rig.responses(&[Status::Ok, Status::Ok]).await;
}

#[tokio::test]
async fn value_delayed_too_long_is_not_set_and_its_script_fails_as_late() {
    // The limit is long enough that even a slow machine sets the first value in time.
    let late_max = Span::from_millis(5_000);
    let tolerance = Tolerance { step: late_max, ..Tolerance::AN_HOUR };
    let (host, options) = (HostOptions::default(), DriverOptions::default());
    let mut rig = Rig::tolerating(tolerance, host, BLOCK, Bench::default(), options);
    rig.bench.busy.store(true, Ordering::SeqCst);
    rig.script("wheel", "a", &[(0.0, 4.0), (50.0, 6.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.until_steps(2).await;
    tokio::time::sleep(late_max.to_duration() + Duration::from_millis(100)).await;
    rig.bench.busy.store(false, Ordering::SeqCst);
    assert_eq!(rig.response().await.error.unwrap().code, ErrorCode::Late);
    rig.next_done(&["wheel 0"]);
}

#[tokio::test]
async fn disconnected_hardware_is_unavailable_before_the_next_ping() {
    let (hangs_up, line) = std::os::unix::net::UnixStream::pair().unwrap();
    let bench = Bench { line: Some(line), ..Bench::default() };
    let mut rig = Rig::new(bench, DriverOptions::default());
    rig.script_in("wheel", "a", 60_000.0, &[(0.0, 4.0)], ControlType::Speed);
    rig.responses(&PLAYED[..1]).await;
    drop(hangs_up);
    let error = rig.response().await.error.unwrap();
    assert_eq!(error.message, "the hardware is not available: the line was cut");
}

#[tokio::test]
async fn hardware_failure_fails_the_script_and_reconnection_stops_the_wheel() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.broken.store(true, Ordering::SeqCst);
    // A ping detects the failure, since no further step is due.
    let failed = rig.response().await;
    assert_eq!(failed.status, Status::Failed);
    let error = failed.error.unwrap();
    assert_eq!(error.code, ErrorCode::Internal);
    assert!(error.message.contains("pulled out"), "{error}");
    rig.script("wheel", "b", &[(0.0, 5.0)], ControlType::Speed);
    assert_eq!(rig.response().await.error.unwrap().code, ErrorCode::Internal);
    rig.bench.broken.store(false, Ordering::SeqCst);
    rig.next_done(&["connect", "wheel 0"]);
    rig.script("wheel", "c", &[(0.0, 5.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
}

#[tokio::test]
async fn end_of_a_script_is_unknown_if_the_hardware_fails_in_its_last_value() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.bench.busy.store(true, Ordering::SeqCst);
    rig.script("wheel", "a", &[(0.0, 4.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.broken.store(true, Ordering::SeqCst);
    rig.bench.busy.store(false, Ordering::SeqCst);
    let error = rig.response().await.error.unwrap();
    let expected =
        "the hardware may not have accepted the last value: the hardware is not available: pulled out";
    assert_eq!((error.code, error.message.as_str()), (ErrorCode::Internal, expected));
}

#[tokio::test]
async fn stop_is_confirmed_once_the_hardware_has_accepted_it() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.busy.store(true, Ordering::SeqCst);
    let wheel = DeviceId::new("wheel").unwrap();
    let stop = Command::Script(Script::new(Vec::new()).unwrap());
    rig.link.send(Message::ControlRequest(ControlRequest::immediate(wheel, stop)));
    assert_eq!(rig.response().await.error.unwrap().code, ErrorCode::Cancelled);
    rig.next_done(&["wheel 0"]);
    let early = tokio::time::timeout(Duration::from_millis(150), rig.response()).await;
    assert!(early.is_err(), "told before the hardware has it: {early:?}");
    rig.bench.busy.store(false, Ordering::SeqCst);
    rig.responses(&PLAYED[2..]).await;
}

#[tokio::test]
async fn value_refused_by_the_hardware_is_reported_as_refused() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    rig.bench.refuses.store(true, Ordering::SeqCst);
    rig.script("wheel", "b", &[(0.0, 8.0), (60_000.0, 0.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    let error = rig.response().await.error.unwrap();
    assert_eq!(error.message, "the hardware refused speed 8 of `wheel`: too hot");
}

#[tokio::test]
async fn hardware_that_cannot_come_to_rest_is_reported_when_its_host_ends() {
    for noticed in [false, true] {
        let mut rig = Rig::new(Bench::default(), DriverOptions::default());
        rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
        rig.responses(&PLAYED[..2]).await;
        rig.next_done(&["connect", "wheel 4"]);
        rig.bench.broken.store(true, Ordering::SeqCst);
        if noticed {
            assert_eq!(rig.response().await.status, Status::Failed);
        }
        let (_, not_at_rest) = rig.stop_and_tell();
        assert_eq!(not_at_rest.as_deref(), Some("the hardware is not available: pulled out"));
    }
}

#[tokio::test]
async fn last_values_are_followed_by_a_ping_that_confirms_them() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    let Rig { host, done, link, .. } = rig;
    drop(link);
    assert_eq!(host.stop(), []);
    assert_eq!(done.iter().last().as_deref(), Some("ping"));
}

#[tokio::test]
async fn panic_of_a_driver_fails_the_running_script_but_not_the_host() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.panics.store(true, Ordering::SeqCst);
    let failed = rig.response().await;
    assert!(failed.error.unwrap().message.contains("its driver panicked"));
    let told = (vec![], Some("its driver panicked".to_owned()));
    assert_eq!(rig.stop_and_tell(), told);
}

#[tokio::test]
async fn sensor_is_read_at_most_at_its_rate() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default().with_readings_per_second(0.01));
    for _ in 0..3 {
        rig.link.send(Message::ControlRequest(ControlRequest::immediate(
            DeviceId::new("eye").unwrap(),
            Command::ReadSensor,
        )));
        assert_eq!(rig.response().await.status_value, StatusValue::Number(7.0));
    }
    assert_eq!(rig.stop(), ["connect", "read eye"]);
}

#[tokio::test]
async fn host_reports_whether_the_hardware_of_its_robots_answers() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    let figures = rig.host.figures();
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    // The robot reports a start before the driver's thread has received the value.
    rig.next_done(&["connect", "wheel 4"]);
    assert!(figures.robots()[0].hardware_answers());
    rig.bench.broken.store(true, Ordering::SeqCst);
    assert_eq!(rig.response().await.status, Status::Failed);
    assert!(!figures.robots()[0].hardware_answers());
    rig.bench.broken.store(false, Ordering::SeqCst);
    rig.next_done(&["connect", "wheel 0"]);
    rig.script("wheel", "b", &[(0.0, 5.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    assert!(figures.robots()[0].hardware_answers());
}

#[tokio::test]
async fn hardware_keeps_its_position_and_stops_turning_when_its_edge_ends() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("arm", "a", &[(0.0, 30.0)], ControlType::Position);
    rig.responses(&PLAYED).await;
    rig.script("wheel", "b", &[(0.0, 4.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    let Rig { host, done, link, .. } = rig;
    drop(link);
    assert_eq!(host.stop(), []);
    let done: Vec<_> = done.try_iter().filter(|what| what != "ping").collect();
    assert_eq!(done.last().map(String::as_str), Some("wheel 0"));
    assert!(!done.contains(&"arm 3".to_owned()), "{done:?}");
}

#[tokio::test]
async fn edge_is_free_at_the_next_check_after_its_session_has_ended() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    let handle = rig.host.handle();
    let session = urrcp::SessionId::new("show").ok();
    let claim = urrcp::AvailabilityRequest { session, ..Default::default() };
    rig.link.send(Message::AvailabilityRequest(claim));
    rig.link.recv().await.unwrap();
    handle.look(0).await;
    assert!(handle.owner(0).unwrap().borrow().is_some(), "its link stands");
    drop(rig.link);
    handle.look(0).await;
    assert!(handle.owner(0).unwrap().borrow().is_none());
}

#[tokio::test]
async fn hardware_watcher_receives_each_event() {
    let (tell, events) = channel();
    let (done, _seen) = channel();
    let bench = Arc::new(Bench::default());
    let fake = Fake { bench: Arc::clone(&bench), done, pushes: None };
    let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
    let hosted = Hosted::driven(block, Box::new(fake), DriverOptions::default())
        .watched(move |event| tell.send(event.to_string()).unwrap());
    let host = Host::start(vec![hosted], HostOptions::default()).unwrap();
    let next = || events.recv_timeout(Duration::from_secs(60)).unwrap();
    assert_eq!(next(), "the hardware is responding");
    bench.broken.store(true, Ordering::SeqCst);
    assert_eq!(next(), "the hardware is not available: pulled out");
    host.stop();
}
