//! What single commands say and with which code they end, where nothing or something unusual is there for them.

use std::fs::File;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::robots::play::{LONG, SHORT, SOON};
use crate::robots::{Process, Via};
use crate::session::Session;

const SCENARIO: &str = "scenario: hello
start_tolerance: 1s
cues:
  - at: 0s
    robots: arms
    tracks: {shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 0}]}
";

#[test]
fn where_nothing_runs_stop_and_go_print_a_document_in_json() {
    let session = Session::new();
    for args in [&["stop"][..], &["stop", "nobody"], &["go"], &["go", "--mission", "nobody"], &["resume"]] {
        let ran = session.run(&[args, &["--format", "json"]].concat());
        assert_eq!(ran.code(), 2, "{args:?}: {}", ran.text());
        let error = ran.json()["error"].as_str().unwrap().to_owned();
        assert!(error.starts_with("no mission "), "{args:?}: {error}");
    }
    let all = session.run(&["stop", "--all", "--format", "json"]);
    assert_eq!((all.code(), all.json()), (2, serde_json::json!([])));
}

#[test]
fn several_missions_run_and_were_cut_off() {
    let stage = LONG.stage(&[Via::Direct, Via::Direct]);
    let play = std::fs::read_to_string(stage.path("play.yaml")).unwrap();
    let one = |robot: &str| play.replace("robots: all", &format!("robots: {robot}"));
    stage.file("one.yaml", one("r0")).file("two.yaml", one("r1"));
    let mut one = stage.start(&["run", "one.yaml"]);
    let mut two = stage.start(&["run", "two.yaml"]);
    for run in [&mut one, &mut two] {
        assert!(run.line("connected").is_some());
    }
    let go = stage.run(&["go"]);
    assert_eq!(go.code, Some(2), "{go}");
    assert!(go.told.contains("several missions run, name one of them"), "{go}");
    one.process.kill();
    two.process.kill();
    let resume = stage.run(&["resume"]);
    assert!(resume.told.contains("several missions were cut off, name one of them"), "{resume}");
}

#[test]
fn a_scenario_without_acts_says_so_where_one_is_asked_for() {
    let session = Session::new();
    session.file("hello.yaml", SCENARIO);
    let ran = session.run(&["dry-run", "hello.yaml", "--act", "finale"]);
    ran.says(2, &["no act `finale`, the scenario has no acts of its own"]);
    assert!(!ran.text().contains("``"), "{}", ran.text());
}
