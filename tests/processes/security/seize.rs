//! An operator takes over (seizes) robots from another operator's mission, with processes and TLS or shared secrets.

use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use stage::operators::{Operators, fails_with};
use stage::session::{ARM, Ran, Session};
use stage::site::Site;

/// The scenario of the operator Anna: the arms go up and stay there for a minute.
const LONG: &str = "scenario: long
start_tolerance: 1s
cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 45}, {at: 60s, to: 10}]}}]
";
/// The scenario of the operator Eva: the arms go to other positions than in Anna's scenario.
const OTHER: &str = "scenario: other
start_tolerance: 1s
cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 100ms, to: 30}, {at: 400ms, to: 20}]}}]
";

/// Starts Anna's mission on all robots; Eva may seize.
pub fn anna_plays(scheme: &'static str) -> (Site, Child) {
    let site = Site::with(scheme);
    site.session.run(&["keys", "operator", "eva", "--role", "drive,seize"]).says(0, &["eva"]);
    site.session.file("long.yaml", LONG).file("other.yaml", OTHER);
    let mut playing = site.session.command(&["run", "long.yaml", "--format", "json"]);
    playing.env("DOWNBEAT_IDENTITY", "keys/operators/anna.pem");
    let playing = playing.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    // Two lines of each robot, whose logs are written within 50 ms.
    while site.moved() < 6 {
        assert!(begun.elapsed() < Duration::from_secs(30), "nothing moves");
        std::thread::sleep(Duration::from_millis(20));
    }
    (site, playing)
}

/// Runs a command as this operator, with a state folder of its own as on another machine.
fn by(session: &Session, operator: &str, args: &[&str]) -> Ran {
    let mut command = session.command(args);
    command.env("DOWNBEAT_IDENTITY", format!("keys/operators/{operator}.pem"));
    Ran(command.env("DOWNBEAT_STATE", session.path(operator)).output().unwrap())
}

fn said(site: &Site, name: &str) -> String {
    std::fs::read_to_string(site.session.path(name)).unwrap()
}

#[test]
fn only_operators_with_the_seize_role_seize_robots_from_a_mission() {
    robots_are_taken("tls");
}

#[test]
fn operator_with_seize_role_seizes_robots_with_a_secret() {
    robots_are_taken("hmac");
}

fn robots_are_taken(scheme: &'static str) {
    let (site, mut playing) = anna_plays(scheme);
    let moved = site.moved();
    let session = &site.session;
    by(session, "bert", &["preflight", "other.yaml"])
        .says(1, &["bert has the role observe, but this requires the role drive"]);
    by(session, "cleo", &["preflight", "other.yaml"])
        .says(1, &["belongs to another session", "`seize`", "run --seize"]);
    by(session, "cleo", &["run", "other.yaml"]).says(1, &["belongs to another session", "run --seize"]);
    by(session, "cleo", &["run", "other.yaml", "--seize"])
        .says(1, &["operator cleo has the roles observe, drive, but this requires the role seize"]);
    // Without `--seize`, Eva seizes no robot; with it, none for a mission that would not start.
    by(session, "eva", &["run", "other.yaml"]).says(1, &["belongs to another session"]);
    let fleet = said(&site, "fleet.yaml");
    let mut elsewhere = site.addresses(scheme);
    elsewhere[2] = format!("{scheme}://127.0.0.1:1");
    site.fleet(&elsewhere, "eva");
    by(session, "eva", &["run", "other.yaml", "--seize"])
        .says(1, &["r2: link down", "r0: not available", "belongs to another session"]);
    let sensor = "  - id: battery\n    name: battery\n    available_control_types:\n      sensor: {min_value: 0, max_value: 100}\n";
    session.file("weak.yaml", format!("{ARM}{sensor}"));
    let weak = "  s3: {init: weak.yaml, address: sim, require: {battery: above 60}}\ngroups: {all: [s3, ";
    let with_weak = fleet.replacen("groups: {all: [", weak, 1);
    assert_ne!(with_weak, fleet);
    session.file("fleet.yaml", with_weak);
    by(session, "eva", &["run", "other.yaml", "--seize"])
        .says(1, &["s3: `battery` reads 50", "r0: not available", "belongs to another session"]);
    session.file("fleet.yaml", fleet);
    assert_eq!(site.moved(), moved, "no robot was moved");
    assert!(playing.try_wait().unwrap().is_none(), "anna's mission continues");

    by(session, "eva", &["run", "other.yaml", "--seize"]).says(0, &["other: done"]);
    let anna = Ran(playing.wait_with_output().unwrap());
    assert!([1, 4].contains(&anna.code()), "{}", anna.text());
    let (code, report) = (anna.code(), anna.json());
    assert_ne!(report["outcome"]["outcome"], "done", "{report}");
    let failures = report["failures"].as_array().unwrap();
    for robot in ["r0", "r1", "r2"] {
        let stop = report["robots"].as_array().unwrap().iter().find(|row| row["robot"] == robot).unwrap();
        let state = stop["stop"]["state"].as_str().unwrap();
        // A robot that Anna's mission stopped before Eva's request arrived was already free.
        let taken = failures.iter().any(|failure: &Value| {
            failure["robot"] == robot
                && failure["text"].as_str().is_some_and(|text| {
                    text.contains("taken by operator eva") || text.contains("taken over by operator eva")
                })
        });
        assert!(if taken { state == "taken_over" } else { state == "confirmed" }, "{robot}: {report}");
        assert!(!taken || code == 4, "{code}: {report}");
        let log = said(&site, &format!("{robot}.log"));
        assert!(!taken || log.contains("seized by operator eva, taken from operator anna"), "{log}");
        // First to the default state, and then to the positions of Eva's scenario.
        let values: Vec<f64> = said(&site, &format!("{robot}.jsonl"))
            .lines()
            .filter_map(|line| serde_json::from_str::<Value>(line).unwrap()["value"].as_f64())
            .collect();
        assert_eq!(values.last(), Some(&20.0), "{values:?}");
    }
    assert!(failures.iter().any(|f| f.to_string().contains("taken by operator eva")), "{report}");
    assert!(
        said(&site, "r0.log")
            .contains("operator cleo has the roles observe, drive, but this requires the role seize")
    );
    // Afterwards Anna can play again, once Eva has gone.
    site.session.run(&["run", "test.yaml", "--approach", "1s"]).says(0, &["test: done"]);
}

#[test]
fn robots_are_not_seized_without_authentication() {
    let session = Session::new();
    session.file("fleet.yaml", "handshake: skip\nrobots: {left: {init: arm.yaml, address: sim}}\n");
    let scenario = "scenario: s\nstart_tolerance: 1s\ncues: [{at: 0s, robots: left, tracks: {shoulder: [{at: 100ms, to: 45}]}}]\n";
    session.file("s.yaml", scenario);
    session.run(&["run", "s.yaml", "--seize"]).says(2, &["--seize", "handshake: skip"]);
    // Robots of its own process belong to no other session.
    session.file("fleet.yaml", "robots: {left: {init: arm.yaml, address: sim}}\n");
    session.run(&["run", "s.yaml", "--seize"]).says(0, &["s: done"]);
}

#[test]
fn starter_robot_in_python_is_seized_only_with_the_seize_role() {
    let site = Site::new();
    let session = &site.session;
    session.run(&["keys", "robot", "arm-1"]).says(0, &[]);
    session.run(&["keys", "operator", "eva", "--role", "drive,seize"]).says(0, &[]);
    let (_robot, address) = stage::site::python_robot(session);
    let operators = Operators::of(session, "arm-1", &address, "cleo");
    operators.scenario("long", "60s");
    operators.scenario("short", "400ms");
    let mut playing = operators.playing("anna", "long.yaml");
    by(session, "cleo", &["run", "short.yaml", "--seize"])
        .says(1, &["operator cleo has the roles drive, observe, but this requires the role seize"]);
    assert!(playing.try_wait().unwrap().is_none(), "anna's mission continues");
    by(session, "eva", &["run", "short.yaml", "--seize"]).says(0, &["short: done"]);
    fails_with(playing, "taken by operator eva");
}
