//! Missions over Zenoh without a router: the process of the robots listens, and schedulers connect to it.

use std::process::Stdio;

use crate::network::{STEPS, client, fleet, lies, listening, names, outcome, sets, simulated, stage, start};
use stage::{Process, Stage, free_port};

/// Starts `count` robots in one process, and writes a fleet file with which schedulers reach them.
fn set_up(count: usize, running: &str) -> (Stage, Process) {
    let (stage, port) = (stage(running), free_port());
    stage.file("robots.json5", listening(port)).file("scheduler.json5", client(port));
    stage.file("fleet.yaml", fleet(&names(0, count), "scheduler.json5"));
    let robots = simulated(&stage, "fleet.yaml", count, &["--zenoh", "robots.json5"]);
    (stage, robots)
}

#[test]
fn mission_over_zenoh_keys_plays_and_report_matches_robot_logs() {
    let (stage, _robots) = set_up(6, "2s");
    let ping = stage.run(&["fleet", "ping", "fleet.yaml"]);
    assert_eq!(ping.code, Some(0), "{ping}");
    let describe = stage
        .command(&["fleet", "describe", "zenoh:hall/r3"])
        .env("DOWNBEAT_ZENOH", "scheduler.json5")
        .output();
    let describe = String::from_utf8(describe.unwrap().stdout).unwrap();
    assert!(describe.contains("id: r3"), "{describe}");
    let ended = stage.run(&["run", "play.yaml", "--format", "json", "--patience", "30s"]);
    assert_eq!((ended.code, outcome(&ended)), (Some(0), "done".into()), "{ended}");
    let sets = sets(&stage, &["fleet.yaml"]);
    assert_eq!(lies(&ended, &sets), [""; 0]);
    assert_eq!(sets.len(), 6);
    assert!(sets.values().all(|sets| sets.len() == STEPS as usize));
}

#[test]
fn robot_has_one_mission_at_a_time_and_a_stop_ends_it() {
    let (stage, _robots) = set_up(2, "2s");
    let mut first = stage.start(&["run", "play.yaml", "--patience", "30s"]);
    assert!(first.start() > 0);
    // As on another machine, which has no access to the journal of the first.
    let elsewhere = stage.path("elsewhere");
    let other =
        stage.command(&["preflight", "play.yaml"]).env("DOWNBEAT_STATE", &elsewhere).output().unwrap();
    let told = String::from_utf8_lossy(&other.stdout).into_owned() + &String::from_utf8_lossy(&other.stderr);
    assert_eq!(other.status.code(), Some(1), "{told}");
    assert!(told.contains("session"), "{told}");
    let stop = stage.run(&["stop"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    let first = first.ended();
    assert_eq!(first.code, Some(3), "{first}");
    let again = stage.run(&["preflight", "play.yaml", "--patience", "30s"]);
    assert_eq!(again.code, Some(0), "{again}");
}

#[test]
fn zenoh_address_and_configuration_errors_state_how_to_fix_them() {
    let (stage, _robots) = set_up(1, "2s");
    let robot = |listen: &str, args: &[&str]| {
        let args = [&["robot", "--init", "robot.yaml", "--listen", listen], args].concat();
        let ended = stage.command(&args).stderr(Stdio::piped()).output().unwrap();
        assert_eq!(ended.status.code(), Some(2));
        String::from_utf8(ended.stderr).unwrap()
    };
    stage.file("open.json5", "{mode: \"client\", connect: {endpoints: [\"tcp/192.0.2.7:7447\"]}}");
    stage.file("wrong.json5", "{mode: \"clown\"}").file("nobody.json5", client(free_port()));
    for (listen, args, says) in [
        ("zenoh:hall/r0", &["--zenoh", "scheduler.json5"][..], "another robot already uses this key"),
        ("zenoh:hall/*", &[], "a key is words between slashes"),
        ("zenoh:hall/x", &[], "name it with `zenoh:`"),
        ("zenoh:hall/x", &["--zenoh", "missing.json5"], "missing.json5: No such file"),
        ("zenoh:hall/x", &["--zenoh", "wrong.json5"], "expected a Zenoh configuration"),
        ("zenoh:hall/x", &["--zenoh", "nobody.json5"], "connect/endpoints"),
        ("zenoh:hall/x", &["--zenoh", "scheduler.json5", "--secret", "x"], "--secret guards TCP"),
    ] {
        let told = robot(listen, args);
        assert!(told.contains(says), "{listen} {args:?}: {told}");
    }
    stage.file("fleet.yaml", fleet(&names(7, 1), "scheduler.json5"));
    let ping = stage.run(&["fleet", "ping", "fleet.yaml"]);
    assert_eq!(ping.code, Some(1), "{ping}");
    assert!(ping.told.contains("zenoh:hall/r7: no robot answers there"), "{ping}");
}

#[test]
fn loss_of_killed_robot_process_is_detected_and_reported_truthfully() {
    let (stage, mut robots) = set_up(4, "2s");
    let run = stage.start(&["run", "play.yaml", "--format", "json", "--patience", "5s"]);
    stage::sleep_until(start(&stage) + 1_000_000_000);
    robots.kill();
    let ended = run.ended();
    // Nothing can confirm whether the robots' devices have stopped.
    assert_eq!((ended.code, outcome(&ended)), (Some(4), "failed".into()), "{ended}");
    assert_eq!(lies(&ended, &sets(&stage, &["fleet.yaml"])), [""; 0]);
}
