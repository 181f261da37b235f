//! Missions that outlive their terminal.

use std::path::PathBuf;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use super::cell::stop;
use super::show::{Show, Trouble, WHEELED, scenario, wheel};
use super::{Way, text};
use stage::quiet::await_that;
use stage::{Robot, Stage, Via, held_up, one_device};

/// Checks that a robot sets 50 more values. That takes longer than a stop, which would have ended them.
#[track_caller]
fn plays_on(robot: &Robot) {
    robot.await_sets(robot.sets().len() + 50, Duration::from_secs(20));
}

/// Starts a mission in the background, and waits until it moves the first robot or has ended. Returns the command's output.
#[track_caller]
fn in_the_background(stage: &Stage) -> Value {
    let detached = stage.run(&["--format", "json", "run", "play.yaml", "--detach"]);
    assert_eq!(detached.code, Some(0), "{detached}");
    let told = detached.report();
    await_that("its start or its end", || moves(stage) || logged(&told).contains("\"outcome\""));
    told
}

fn moves(stage: &Stage) -> bool {
    stage.robots[0].sets().len() >= 5
}

fn logged(told: &Value) -> String {
    std::fs::read_to_string(told["log"].as_str().unwrap()).unwrap()
}

/// Returns the log of a mission that ended before it moved the first robot; an empty text if the robot moves.
fn ended_early(stage: &Stage, told: &Value) -> String {
    if moves(stage) { String::new() } else { logged(told) }
}

#[test]
fn background_mission_outlives_its_terminal_and_is_stopped_by_command() {
    let mut stage = Stage::new();
    stage.file("arm.yaml", one_device(1, 600, 600)).file("wheel.yaml", wheel()).file("play.yaml", scenario());
    for robot in 0..6 {
        stage.robot(if robot == WHEELED { "wheel.yaml" } else { "arm.yaml" }, Via::Direct);
    }
    let told = held_up::played(|| in_the_background(&stage), |told| ended_early(&stage, told));
    assert_eq!(ended_early(&stage, &told), "", "it ended before its robots moved");
    let process = Pid::from_raw(told["process"].as_i64().unwrap().try_into().unwrap()).unwrap();
    let log = PathBuf::from(told["log"].as_str().unwrap());
    assert!(
        log.starts_with(stage.path("state")) && log.parent().unwrap().join("journal").exists(),
        "{log:?}"
    );
    assert_eq!(rustix::process::getsid(Some(process)).unwrap(), process, "it belongs to a terminal");
    kill_process(process, Signal::HUP).unwrap();
    plays_on(&stage.robots[0]);
    let stopped = stage.run(&["stop", told["mission"].as_str().unwrap()]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    await_that("its report", || std::fs::read_to_string(&log).unwrap().contains("\"outcome\": \"stopped\""));
}

#[test]
fn failure_to_start_a_background_mission_is_reported_immediately() {
    let mut stage = Stage::new();
    stage.file("arm.yaml", one_device(1, 600, 600)).file(
        "play.yaml",
        "scenario: play\nstart_tolerance: 1s\ncues: [{at: 0s, robots: r0, tracks: {d: [{at: 0s, to: 1}]}}]\n",
    );
    stage.robot("arm.yaml", Via::Direct);
    stage.file("state", "no folder");
    let detached = stage.run(&["run", "play.yaml", "--detach"]);
    assert_eq!(detached.code, Some(2), "{detached}");
    assert!(detached.told.contains("cannot start the mission in the background with the log "), "{detached}");
}

#[test]
fn program_started_with_nohup_survives_the_end_of_its_terminal() {
    let mut show = Show::begin_by(Trouble::Nothing, &["nohup"]);
    kill_process(show.pid, Signal::HUP).unwrap();
    plays_on(&show.stage.robots[0]);
    let stopped = stop(&mut show, Way::Terminate);
    assert_eq!(stopped.code, Some(3), "{}", text(&show.stage, "told"));
}
