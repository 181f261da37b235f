//! The mission prepares an act again if this machine was too slow to start it.

use rustix::process::Signal;

use stage::play::SHORT;
use stage::{Via, sleep_until};

#[test]
fn a_scheduler_that_stalls_over_the_commitment_starts_all_robots_a_little_later() {
    let stage = SHORT.stage(&[Via::Direct; 3]);
    let mut running = stage.start(&["run", "play.yaml", "--lead", "1s"]);
    let start = running.start();
    sleep_until(start - 250_000_000);
    running.process.signal(Signal::STOP);
    sleep_until(start + 200_000_000);
    running.process.signal(Signal::CONT);
    let ended = running.ended();
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(ended.told.contains("`play` is prepared again"), "{ended}");
    let reported = "before anything moved, and prepared again";
    assert!(ended.out.split_whitespace().collect::<Vec<_>>().join(" ").contains(reported), "{ended}");
    stage.robots.iter().for_each(|robot| SHORT.was_played_by(robot));
}
