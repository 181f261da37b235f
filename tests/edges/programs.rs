//! Programs as drivers.

use std::process::{Command, Stdio};
use std::time::Duration;

use rustix::process::Signal;

use super::processes::Edge;
use super::{LEAD, SCENARIO, await_that, session};
use crate::robots::signal;
use crate::session::{Ran, Session, root};

pub const DRIVE: &str = include_str!("../drivers/drive.sh");

#[test]
fn a_shell_script_drives_a_robot_and_is_restarted_when_it_dies() {
    let session = session();
    session.file("drive.sh", DRIVE).file(
        "tanks.yaml",
        SCENARIO.replace("right", "left").replace("      left: [{at: 0s, to: 0}, {at: 500ms, to: 10}]\n", ""),
    );
    let edge = Edge::start(&session, "tank.json", "program:sh drive.sh driven.txt");
    let plain = format!(
        "robots: {{tank-1: {{init: tank.json, address: 'tcp://127.0.0.1:{}', require: {{battery: below 13}}}}}}\ngroups: {{tanks: [tank-1]}}\n",
        edge.1
    );
    session.file("fleet.yaml", plain);
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    await_that("the default state", || driven().lines().count() >= 3);
    session.run(&["run", "tanks.yaml", "--lead", LEAD]).says(0, &["done"]);
    session.file("tanks.yaml", "scenario: fatal\nstart_tolerance: 1s\ncues: [{at: 0s, robots: tanks, tracks: {left: [{at: 0s, to: 66}, {at: 60s, to: 0}]}}]\n");
    let ran = session.run(&["run", "tanks.yaml", "--lead", LEAD]);
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert!(ran.text().contains("the program `sh drive.sh driven.txt` has ended"), "{}", ran.text());
    let restarted = "set left position 66\nhello\nset left position 0\nset right position 0\n";
    await_that("the restart", || driven().contains(restarted));
    edge.terminate();
    let expected = "hello\nset left position 0\nset right position 0\nread battery\nset left position 40\nset left position -20\nset left position 0\n";
    assert!(driven().starts_with(expected), "{}", driven());
    assert!(driven().ends_with("set left position 0\nset right position 0\n"), "{}", driven());
}

#[test]
fn a_program_that_a_killed_scheduler_drove_is_started_by_no_stop_and_by_the_resume_after_it() {
    let session = session();
    session
        .file("drive.sh", DRIVE)
        .file("tanks.yaml", "scenario: tanks\nstart_tolerance: 1s\ncues: [{at: 0s, robots: tanks, tracks: {left: [{at: 0s, to: 40}, {at: 300ms, to: -20}, {at: 60s, to: 0}]}}]\n")
        .file("fleet.yaml", "robots: {tank-1: {init: tank.json, address: 'program:sh drive.sh driven.txt'}}\ngroups: {tanks: [tank-1]}\n");
    let mut run = session.command(&["run", "tanks.yaml", "--lead", LEAD]);
    let mut running = run.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    await_that("the second step", || driven().contains("set left position -20\n"));
    running.kill().unwrap();
    running.wait().unwrap();
    let elsewhere = tempfile::TempDir::new().unwrap();
    let there = |args: &[&str]| Ran(session.command(args).current_dir(elsewhere.path()).output().unwrap());
    let before = driven();
    there(&["stop"])
        .says(4, &["tank-1: stop NOT confirmed; a program drove it, and a stop starts no program"]);
    assert_eq!(driven(), before, "the stop started it");
    // Another program than before is started only if the operator names the file.
    let fleet = std::fs::read_to_string(session.path("fleet.yaml")).unwrap();
    session.file("fleet.yaml", fleet.replace("sh drive.sh", "touch other; sh drive.sh"));
    let not_started = ["no program is started: ", "says another program for robot `tank-1`", "--fleet "];
    there(&["resume"]).says(4, &not_started);
    assert_eq!(driven(), before, "the resume started it");
    session.file("fleet.yaml", fleet);
    if rustix::process::geteuid().is_root() {
        std::os::unix::fs::chown(session.path("fleet.yaml"), Some(65_534), None).unwrap();
        there(&["resume"]).says(4, &["says which programs to start, and is not yours alone"]);
        assert_eq!(driven(), before, "the resume started it");
    }
    let named = session.path("fleet.yaml");
    there(&["resume", "--fleet", named.to_str().unwrap()]).says(0, &["tank-1: default state confirmed"]);
    let after = driven().split_once("set left position -20\n").unwrap().1.to_owned();
    assert!(after.contains("set left position 0\n"), "{after}");
}

#[test]
fn a_program_that_a_killed_scheduler_drove_is_started_again_by_a_resume_from_another_folder() {
    let session = session();
    session
        .file("drive.sh", DRIVE)
        .file("tanks.yaml", "scenario: tanks\nstop_condition: {running: none}\ncues: [{at: 0s, robots: tanks, tracks: {left: [{at: 0s, to: 40}, {at: 300ms, to: -20}, {at: 60s, to: 0}]}}]\n")
        .file("fleet.yaml", "robots: {tank-1: {init: tank.json, address: 'program:sh drive.sh driven.txt'}}\ngroups: {tanks: [tank-1]}\n");
    let mut run = session.command(&["run", "tanks.yaml", "--lead", LEAD]);
    let mut running = run.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    await_that("the second step", || driven().contains("set left position -20\n"));
    running.kill().unwrap();
    running.wait().unwrap();
    let elsewhere = tempfile::TempDir::new().unwrap();
    let resumed = session.command(&["resume"]).current_dir(elsewhere.path()).output().unwrap();
    let resumed = crate::session::Ran(resumed);
    // What it held has ended with the process that drove it: the program is reached, and brought to rest.
    assert!(!resumed.text().contains("cannot open drive.sh"), "{}", resumed.text());
    resumed.says(1, &["tank-1: default state confirmed"]);
    let after = driven().split_once("set left position -20\n").unwrap().1.to_owned();
    assert!(after.contains("set left position 0\n"), "{after}");
}

/// A program drives a wheel, and the edge is sent these signals, one after another. What the program was told.
fn driven_until(signals: &[Signal]) -> (Option<i32>, String) {
    let session = Session::new();
    session.file("drive.sh", DRIVE).file("wheel.yaml", WHEEL);
    let edge = Edge::start(&session, "wheel.yaml", "program:sh drive.sh driven.txt");
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    let fleet = format!("robots: {{wheel: {{init: wheel.yaml, address: 'tcp://127.0.0.1:{}'}}}}\n", edge.1);
    session.file("fleet.yaml", fleet).file("turn.yaml", TURN);
    // A mission is not started on hardware that has yet to answer.
    await_that("the default state", || driven().ends_with("set wheel speed 0\n"));
    let mut running = session.command(&["run", "turn.yaml"]).spawn().unwrap();
    await_that("the wheel", || driven().ends_with("set wheel speed 5\n"));
    signals[..signals.len() - 1].iter().for_each(|by| signal(&edge.0, *by));
    std::thread::sleep(Duration::from_millis(50));
    assert!(driven().ends_with("set wheel speed 5\n"), "{signals:?}: {}", driven());
    let (code, _) = edge.ends_by(signals[signals.len() - 1]);
    let _gone = running.kill();
    let _reaped = running.wait();
    (code, driven())
}

const WHEEL: &str = "id: wheel
api_version: '1'
reports: true
devices:
  - id: wheel
    name: wheel
    available_control_types:
      speed: {min_value: 0, max_value: 10, granularity: 1}
      script: {min_value: 0, max_value: 10, granularity: 1, max_number_of_steps: 8, control_types: [speed]}
";

const TURN: &str = "scenario: turn
start_tolerance: 1s
stop_condition: {running: none}
cues: [{at: 0s, robots: wheel, tracks: {wheel: {control: speed, keyframes: [{at: 0s, to: 5}, {at: 60s, to: 0}]}}}]
";

#[test]
fn a_driver_is_told_to_stop_last_whatever_signal_asks_the_edge_to_end() {
    for by in [Signal::INT, Signal::TERM, Signal::HUP, Signal::QUIT] {
        let (code, driven) = driven_until(&[by]);
        assert!(driven.ends_with("set wheel speed 0\n"), "{by:?}: {driven}");
        assert_eq!(code, Some(0), "{by:?}");
    }
}

#[test]
fn signals_that_ask_for_nothing_do_not_end_an_edge() {
    let (code, driven) =
        driven_until(&[Signal::USR1, Signal::USR2, Signal::XFSZ, Signal::PIPE, Signal::TERM]);
    assert!(driven.ends_with("set wheel speed 0\n"), "{driven}");
    assert_eq!(code, Some(0));
}

#[test]
fn the_python_program_of_the_documents_drives_too() {
    let python = std::env::var("DOWNBEAT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    if Command::new(&python).arg("--version").output().is_err() {
        // Rust alone has to do for these tests; where everything has to hold there is a Python.
        return;
    }
    let session = session();
    session.file("drive.py", include_str!("../drivers/drive.py"));
    let edge = Edge::start(&session, "tank.json", &format!("program:{python} drive.py driven.txt"));
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    await_that("the default state", || driven() == "left position 0\nright position 0\n");
    edge.terminate();
}

#[test]
fn the_edge_document_shows_the_programs_that_are_tested() {
    let document = std::fs::read_to_string(root().join("docs/edge.md")).unwrap();
    for program in [DRIVE, include_str!("../drivers/drive.py"), include_str!("../thrift/urrcp.thrift")] {
        assert!(document.contains(program), "docs/edge.md lacks, word for word:\n{program}");
    }
}
