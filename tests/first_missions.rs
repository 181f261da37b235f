//! A few missions on robots as processes, for everyone who runs `cargo test`. They wait for events, and their long leases and wide
//! tolerances allow for a slow machine. `tests/processes/` contains all other missions.

use std::time::Duration;

use rustix::process::Signal;
use stage::{Stage, Via, one_device};

/// Time within which a robot starts to play, even on a busy machine.
const SOON: Duration = Duration::from_secs(60);

/// Prepares robots with one device, and a scenario of two acts. The second act waits for the operator.
fn stage(robots: usize) -> Stage {
    let mut stage = Stage::new();
    stage.file("robot.yaml", one_device(2, 90, 20));
    stage.file(
        "show.yaml",
        "scenario: show
start_tolerance: 2s
stop_condition: {pending: 5s, running: 20s}
acts:
  - act: rise
    cues: [{at: 0s, robots: all, tracks: {d: [{at: 0s, to: 1}, {at: 200ms, to: 2}, {at: 400ms, to: 3}]}}]
  - act: fall
    wait: operator
    cues: [{at: 0s, robots: all, tracks: {d: [{at: 0s, to: 2}, {at: 200ms, to: 1}]}}]
",
    );
    stage.file(
        "long.yaml",
        "scenario: long
start_tolerance: 2s
stop_condition: {pending: 5s, running: 20s}
cues: [{at: 0s, robots: all, tracks: {d: [{at: 0s, to: 1}, {at: 300ms, to: 2}, {at: 600ms, to: 3}, {at: 120s, to: 4}]}}]
",
    );
    for _ in 0..robots {
        stage.robot("robot.yaml", Via::Direct);
    }
    stage
}

/// Plays both acts. Repeats the command `go`, which starts the second act, until the mission accepts it.
#[test]
fn all_robots_play_two_acts_and_second_waits_for_go() {
    let stage = stage(3);
    let ended = stage::held_up::played(
        || {
            let mut running = stage.start(&["run", "show.yaml", "--format", "json"]);
            while running.process.0.try_wait().unwrap().is_none() && stage.run(&["go"]).code != Some(0) {}
            running.ended()
        },
        |ended| format!("{}{}", ended.told, ended.out),
    );
    assert_eq!(ended.code, Some(0), "{ended}");
    let report = ended.report();
    assert_eq!(report["outcome"], "done");
    for (robot, row) in stage.robots.iter().zip(report["robots"].as_array().unwrap()) {
        assert!(
            robot.values("d").ends_with(&[1.0, 2.0, 3.0, 2.0, 1.0]),
            "{}: {:?}",
            robot.id,
            robot.values("d")
        );
        assert_eq!(row["steps_done"], 5, "{ended}");
    }
}

#[test]
fn no_robot_moves_if_one_is_missing() {
    let mut stage = stage(3);
    stage.robots[1].kill();
    let ended = stage.run(&["run", "show.yaml", "--patience", "2s", "--format", "json"]);
    assert_eq!(ended.code, Some(1), "{ended}");
    let report = ended.report();
    assert_eq!(report["outcome"], "not_started", "{ended}");
    assert_eq!(report["failures"][0]["robot"], "r1", "{ended}");
    assert!(stage.robots.iter().all(|robot| robot.log().is_empty()), "a robot moved");
}

#[test]
fn every_robot_confirms_a_ctrl_c_stop() {
    let stage = stage(2);
    let ended = stage::held_up::played(
        || {
            let before: Vec<_> = stage.robots.iter().map(|robot| robot.sets().len()).collect();
            let mut running = stage.start(&["run", "long.yaml"]);
            let moves =
                || stage.robots.iter().zip(&before).all(|(robot, before)| robot.sets().len() >= before + 3);
            while !moves() && running.process.0.try_wait().unwrap().is_none() {
                std::thread::yield_now();
            }
            running.process.signal(Signal::INT);
            running.ended()
        },
        |ended| format!("{}{}", ended.told, ended.out),
    );
    assert_eq!(ended.code, Some(3), "{ended}");
    assert!(ended.out.contains("stopped by the operator"), "{ended}");
    for robot in &stage.robots {
        assert!(ended.out.contains(&format!("{}: stop confirmed", robot.id)), "{ended}");
        assert!(!robot.values("d").contains(&4.0), "{} played on", robot.id);
    }
}

#[test]
fn background_mission_is_stopped_from_another_terminal() {
    let stage = stage(2);
    let started = stage.play(&["run", "long.yaml", "--detach"]);
    assert_eq!(started.code, Some(0), "{started}");
    stage.robots.iter().for_each(|robot| robot.await_sets(3, SOON));
    let stopped = stage.run(&["stop"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    assert!(stage.robots.iter().all(|robot| !robot.values("d").contains(&4.0)), "a robot played on");
}

#[test]
fn mission_with_killed_scheduler_is_stopped_from_its_journal() {
    let stage = stage(2);
    let mut running = stage.begin(&["run", "long.yaml"], 0..stage.robots.len(), 3);
    running.process.kill();
    let stopped = stage.run(&["stop"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    assert!(stage.robots.iter().all(|robot| !robot.values("d").contains(&4.0)), "a robot played on");
}
