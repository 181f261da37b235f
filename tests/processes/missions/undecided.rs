//! A link that slows down after the greeting, before the scheduler decides that an act starts: no robot plays an act alone.

use std::time::Duration;

use rustix::process::Signal;

use stage::play::{Play, SHORT};
use stage::quiet::await_that;
use stage::{Running, Stage, Via};

const LEAD: &str = "1500ms";
/// Delay of a request. With this delay, the request arrives before its start, and its pending lease ends after the start.
const UNDER_WAY: Duration = Duration::from_millis(1_300);
/// Time after which every act that is going to start has started.
const AFTER_THE_START: Duration = Duration::from_secs(3);

/// Starts a mission whose first robot receives its requests late. Calls `meanwhile` with the scheduler while they are in flight. Checks
/// that no robot moves.
fn played_late(meanwhile: impl FnOnce(&mut Running)) -> (Stage, Running) {
    let stage = Play { steps: 16, ..SHORT }.stage(&[Via::Proxy, Via::Direct, Via::Direct]);
    let link = stage.robots[0].link.as_ref().unwrap();
    link.slow_down_at("control_request", UNDER_WAY);
    let mut running =
        stage.start(&["run", "play.yaml", "--lead", LEAD, "--patience", "3s", "--format", "json"]);
    await_that("the first request", || link.has_slowed_down());
    meanwhile(&mut running);
    std::thread::sleep(AFTER_THE_START);
    for robot in &stage.robots {
        assert!(
            robot.log().is_empty(),
            "{} moved in an act that was never decided: {:?}",
            robot.id,
            robot.log()
        );
    }
    (stage, running)
}

#[test]
fn act_withdrawn_over_a_slow_link_moves_no_robot() {
    let (_stage, running) = played_late(|_| {});
    let ended = running.ended();
    assert_eq!(ended.report()["outcome"], "not_started", "{ended}");
}

#[test]
fn act_moves_no_robot_if_scheduler_dies_while_requests_are_in_transit() {
    played_late(|running| running.process.kill());
}

#[test]
fn act_moves_no_robot_if_scheduler_stalls_while_requests_are_in_transit() {
    let (_stage, running) = played_late(|running| running.process.signal(Signal::STOP));
    running.process.signal(Signal::CONT);
    // The mission prepares the act again, but the slow link does not permit it.
    let ended = running.ended();
    let report = ended.report();
    // At the second attempt, this machine still counts as slow.
    assert_eq!(
        (&report["outcome"], &report["acts"][0]["prepared_again"]),
        (&"not_started".into(), &2.into()),
        "{ended}"
    );
}
