//! Edges whose drivers are programs.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::Duration;

use rustix::process::Signal;

use super::processes::Edge;
use super::{LEAD, SCENARIO, await_that, fleet, session};
use stage::session::{Ran, Session, root};
use stage::signal;

pub const DRIVE: &str = include_str!("../drivers/drive.sh");

#[test]
fn shell_script_drives_a_robot_and_is_restarted_after_it_dies() {
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
    edge.await_hardware();
    session.run(&["run", "tanks.yaml", "--lead", LEAD]).says(0, &["done"]);
    session.file("tanks.yaml", "scenario: fatal\nstart_tolerance: 1s\ncues: [{at: 0s, robots: tanks, tracks: {left: [{at: 0s, to: 66}, {at: 60s, to: 0}]}}]\n");
    let ran = session.run(&["run", "tanks.yaml", "--lead", LEAD]);
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert!(ran.text().contains("the program `sh drive.sh driven.txt` has ended"), "{}", ran.text());
    await_that("the restart", || driven().ends_with("set left position 66\nhello\n"));
    edge.await_hardware();
    let (code, said) = edge.end();
    assert_eq!(code, Some(0), "{said}");
    let away = "tank-1: the hardware is not available: the program `sh drive.sh driven.txt` has ended";
    assert!(said.contains(away) && said.contains("tank-1: the hardware is available again"), "{said}");
    let expected = "hello\nread battery\nset left position 40\nset left position -20\nset left position 0\n";
    assert!(driven().starts_with(expected), "{}", driven());
    assert!(driven().ends_with("set left position 66\nhello\n"), "the end moved it: {}", driven());
}

#[test]
fn unresponsive_program_does_not_delay_the_end_of_its_edge() {
    let session = session();
    // The second program answers `hello`, but not `init`.
    for silent in ["cat > /dev/null", "read -r hello; echo ok 2; cat > /dev/null"] {
        session.file("silent.sh", format!("touch begun\n{silent}\n"));
        let edge = Edge::start(&session, "tank.json", "program:sh silent.sh");
        await_that("its start", || session.path("begun").exists());
        std::fs::remove_file(session.path("begun")).unwrap();
        let asked = std::time::Instant::now();
        let (code, said) = edge.end();
        assert_eq!(code, Some(0), "{said}");
        assert!(asked.elapsed() < Duration::from_secs(5), "{silent}: {:?}", asked.elapsed());
    }
}

#[test]
fn stop_does_not_start_program_of_killed_scheduler_but_resume_does() {
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
        .says(4, &["tank-1: stop NOT confirmed; it was driven by a program, which a stop does not start"]);
    assert_eq!(driven(), before, "the stop started it");
    // A changed program is started only if the operator names the file.
    let fleet = std::fs::read_to_string(session.path("fleet.yaml")).unwrap();
    session.file("fleet.yaml", fleet.replace("sh drive.sh", "touch other; sh drive.sh"));
    let not_started = ["no program is started: ", "names a different program for robot `tank-1`", "--fleet "];
    there(&["resume"]).says(4, &not_started);
    assert_eq!(driven(), before, "the resume started it");
    session.file("fleet.yaml", fleet);
    if rustix::process::geteuid().is_root() {
        std::os::unix::fs::chown(session.path("fleet.yaml"), Some(65_534), None).unwrap();
        there(&["resume"]).says(4, &["names programs to start, but is owned or writable by other users"]);
        assert_eq!(driven(), before, "the resume started it");
    }
    let named = session.path("fleet.yaml");
    there(&["resume", "--fleet", named.to_str().unwrap()]).says(3, &["tank-1: stop confirmed"]);
    let after = driven().split_once("set left position -20\n").unwrap().1.to_owned();
    assert!(after.contains("hello\n") && !after.contains("set"), "it was moved: {after}");
}

#[test]
fn resume_from_another_folder_restarts_program_of_killed_scheduler() {
    let session = session();
    session
        .file("drive.sh", DRIVE)
        .file("tanks.yaml", "scenario: tanks\nstart_tolerance: 1s\nstop_condition: {running: none}\ncues: [{at: 0s, robots: tanks, tracks: {left: [{at: 0s, to: 40}, {at: 300ms, to: -20}, {at: 60s, to: 0}]}}]\n")
        .file("fleet.yaml", "robots: {tank-1: {init: tank.json, address: 'program:sh drive.sh driven.txt'}}\ngroups: {tanks: [tank-1]}\n");
    let mut run = session.command(&["run", "tanks.yaml", "--lead", LEAD]);
    let mut running = run.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    await_that("the second step", || driven().contains("set left position -20\n"));
    running.kill().unwrap();
    running.wait().unwrap();
    let elsewhere = tempfile::TempDir::new().unwrap();
    let resumed = session.command(&["resume"]).current_dir(elsewhere.path()).output().unwrap();
    let resumed = stage::session::Ran(resumed);
    // The held commands ended with the process that drove the robot: the program is reached, and brought to rest.
    assert!(!resumed.text().contains("cannot open drive.sh"), "{}", resumed.text());
    resumed.says(1, &["tank-1: stop confirmed"]);
    let after = driven().split_once("set left position -20\n").unwrap().1.to_owned();
    assert!(after.contains("hello\n") && !after.contains("set"), "it was moved: {after}");
}

/// Lets a program drive a wheel, and sends these signals to the edge, one after another. Returns the edge's exit code and the input of
/// the program.
fn driven_until(signals: &[Signal]) -> (Option<i32>, String) {
    let session = Session::new();
    session.file("drive.sh", DRIVE).file("wheel.yaml", WHEEL);
    let edge = Edge::start(&session, "wheel.yaml", "program:sh drive.sh driven.txt");
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    let fleet = format!("robots: {{wheel: {{init: wheel.yaml, address: 'tcp://127.0.0.1:{}'}}}}\n", edge.1);
    session.file("fleet.yaml", fleet).file("turn.yaml", TURN);
    // A mission is not started on hardware that has yet to answer.
    edge.await_hardware();
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
fn edge_sends_a_final_stop_to_its_driver_on_every_termination_signal() {
    for by in [Signal::INT, Signal::TERM, Signal::HUP, Signal::QUIT] {
        let (code, driven) = driven_until(&[by]);
        assert!(driven.ends_with("set wheel speed 0\n"), "{by:?}: {driven}");
        assert_eq!(code, Some(0), "{by:?}");
    }
}

#[test]
fn non_terminating_signals_do_not_end_an_edge() {
    let (code, driven) =
        driven_until(&[Signal::USR1, Signal::USR2, Signal::XFSZ, Signal::PIPE, Signal::TERM]);
    assert!(driven.ends_with("set wheel speed 0\n"), "{driven}");
    assert_eq!(code, Some(0));
}

/// Returns a shell command for Python, with the driver package on its path. `None` if Python is missing; these tests then use only Rust.
pub fn python() -> Option<String> {
    let python = std::env::var("DOWNBEAT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    Command::new(&python).arg("--version").output().ok()?;
    let package = root().join("robot/drivers/python");
    Some(format!("PYTHONDONTWRITEBYTECODE=1 PYTHONPATH='{}' {python}", package.display()))
}

#[test]
fn documented_python_program_drives_a_robot() {
    let Some(python) = python() else { return };
    let session = session();
    session.file("drive.py", include_str!("../drivers/drive.py"));
    let edge = Edge::start(&session, "tank.json", &format!("program:{python} drive.py driven.txt"));
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    edge.await_hardware();
    let fleet = format!("robots: {{tank-1: {{init: tank.json, address: 'tcp://127.0.0.1:{}'}}}}\n", edge.1);
    session.file("fleet.yaml", fleet).file(
        "play.yaml",
        "scenario: play\nstart_tolerance: 1s\ncues: [{at: 0s, robots: tank-1, tracks: {left: [{at: 0s, to: 20}]}}]\n",
    );
    session.run(&["run", "play.yaml", "--lead", LEAD]).says(0, &["play: done"]);
    assert_eq!(driven(), "left position 20.0\n");
    edge.terminate();
}

#[test]
fn python_driver_package_passes_its_own_tests() {
    let Some(python) = python() else { return };
    let tests = root().join("robot/drivers/python");
    let command = format!("{python} -m unittest discover tests");
    let ran = Command::new("sh").arg("-c").arg(command).current_dir(tests).output().unwrap();
    let said = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success() && said.contains("OK"), "{said}");
}

/// A driver that reports its latency and a reading, takes frames (the values of several devices), and fails on the value 66.
const SECOND: &str = r#"
import sys, threading, time
from downbeat_driver import Driver

class Second(Driver):
    latency_ms = 42

    def start(self, robot):
        print("the SDK greets", robot.devices["left"].id)
        threading.Thread(target=self.tell, daemon=True).start()

    def set_frame(self, values):
        with open(sys.argv[1], "a") as driven:
            driven.write(" ".join(f"{of.device}={of.value:g}" for of in values) + "\n")
        if any(of.value == 66 for of in values):
            self.fault("emergency stop")

    def tell(self):
        while True:
            self.push_reading("battery", 13.5)
            time.sleep(0.01)

Second().run()
"#;

#[test]
fn version_2_program_handles_frames_readings_faults_and_latency() {
    let Some(python) = python() else { return };
    let session = session();
    session.file("second.py", SECOND);
    let edge = Edge::start(&session, "tank.json", &format!("program:{python} second.py driven.txt"));
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    edge.await_hardware();
    let fleet = format!(
        "robots: {{tank-1: {{init: tank.json, address: 'tcp://127.0.0.1:{}', require: {{battery: above 13}}}}}}\n",
        edge.1
    );
    let play = |left: i32| {
        format!(
            "scenario: play\nstart_tolerance: 1s\ncues: [{{at: 0s, robots: tank-1, tracks: {{left: [{{at: 0s, to: 1}}, \
             {{at: 300ms, to: {left}}}, {{at: 900ms, to: 0}}], right: [{{at: 0s, to: 2}}, {{at: 300ms, to: 3}}]}}}}]\n"
        )
    };
    session.file("fleet.yaml", &fleet).file("play.yaml", play(20));
    let line = "set `latency: {left: 42ms, right: 42ms}` in the fleet file";
    let declares =
        ["its declared latency differs from the compensated latency: `left` 42 ms instead of 0 ms", line];
    session.run(&["preflight", "play.yaml"]).says(0, &declares);
    session.run(&["run", "play.yaml", "--lead", LEAD]).says(0, &[&["play: done"][..], &declares].concat());
    assert_eq!(driven(), "left=1 right=2\nleft=20 right=3\nleft=0\n");
    session.file("fleet.yaml", fleet.replace("tank.json,", "tank.json, latency: {left: 42ms, right: 42ms},"));
    let same = session.run(&["preflight", "play.yaml"]);
    assert!(same.code() == 0 && !same.text().contains("its declared latency differs"), "{}", same.text());
    session.file("fleet.yaml", &fleet);
    session.file("play.yaml", play(66));
    let ran = session.run(&["run", "play.yaml", "--lead", LEAD]);
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert!(ran.text().contains("the hardware reports a fault: emergency stop"), "{}", ran.text());
    let (_, said) = edge.end();
    for expected in [
        "latency, which is reported to missions: left 42 ms, right 42 ms",
        "the SDK greets left",
        "fault: emergency stop",
    ] {
        assert!(said.contains(expected), "{expected}: {said}");
    }
}

#[test]
fn invalid_latency_declaration_of_program_causes_a_warning() {
    let session = session();
    session.file(
        "drive.sh",
        "read -r hello\necho ok 2\nread -r init\necho 'ok {\"latency_ms\": {\"wing\": 3}}'\nread -r end\n",
    );
    let mut edge = Edge::start(&session, "tank.json", "program:sh drive.sh");
    let mut said = BufReader::new(edge.0.stderr.take().unwrap()).lines().map_while(Result::ok);
    let warning = said.find(|line| line.contains("latency_ms names `wing`, which this robot does not have"));
    assert!(warning.is_some(), "the edge ended without the warning");
}

/// A driver that stops answering after the value 66, and refuses the value 55.
const MOODY: &str = r#"while read -r verb device control value; do
    case "$value" in
        66) sleep 60 ;;
        55) echo error too hot ;;
        *) echo ok ;;
    esac
done
"#;

/// Plays a script on `left` that ends with `value`; the driver is the program `MOODY`. Returns the result of the mission and the edge's
/// output.
fn one_value(value: i32) -> (Ran, String) {
    let session = session();
    session.file("moody.sh", MOODY);
    let edge = Edge::start(&session, "tank.json", "program:sh moody.sh");
    let fleet = format!("robots: {{tank-1: {{init: tank.json, address: 'tcp://127.0.0.1:{}'}}}}\n", edge.1);
    let play = format!(
        "scenario: play\nstart_tolerance: 1s\ncues: [{{at: 0s, robots: tank-1, tracks: {{left: [{{at: 0s, to: 1}}, {{at: 300ms, to: {value}}}]}}}}]\n"
    );
    session.file("fleet.yaml", fleet).file("play.yaml", play);
    let ran = session.run(&["run", "play.yaml", "--lead", LEAD]);
    (ran, edge.end().1)
}

#[test]
fn mission_is_not_done_if_program_never_acknowledges_last_value() {
    let (ran, said) = one_value(66);
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    // The edge waits for an answer as long as the mission waits for the end, so either may be the first to give up.
    let why = [
        "the hardware may not have accepted the last value",
        "no report about the end of the script on `left`",
    ];
    assert!(why.iter().any(|why| ran.text().contains(why)), "{}", ran.text());
    assert!(said.contains("did not answer `set left position 66` within 1 s"), "{said}");
}

#[test]
fn value_refused_by_program_is_reported_as_refused() {
    let (ran, said) = one_value(55);
    let refused = "the hardware refused position 55 of `left`: the program reported: too hot";
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert!(
        ran.text().contains(refused) && !ran.text().contains("hardware is not available"),
        "{}",
        ran.text()
    );
    assert!(said.contains(&format!("tank-1: {refused}")), "{said}");
}

/// A driver that takes 11 s to start, longer than the default limit of 10 s.
const SLOW: &str = r#"
import sys, time
from downbeat_driver import Driver

class Slow(Driver):
    def start(self, robot):
        with open("starting", "w"):
            time.sleep(11)

    def set(self, device, control_type, value, *more):
        with open(sys.argv[1], "a") as driven:
            driven.write(f"{device} {value:g}\n")

Slow().run()
"#;

/// Returns a session with a fleet of one robot, whose driver starts slowly.
fn slow(python: &str) -> Session {
    let session = session();
    session.file("slow.py", SLOW);
    let address = format!("program:{python} slow.py driven.txt").replace('\'', "''");
    session.file("fleet.yaml", format!("robots: {{tank-1: {{init: tank.json, address: '{address}'}}}}\n")).file(
        "play.yaml",
        "scenario: play\nstart_tolerance: 1s\ncues: [{at: 0s, robots: tank-1, tracks: {left: [{at: 0s, to: 20}]}}]\n",
    );
    session
}

#[test]
fn program_with_startup_over_ten_seconds_drives_a_fleet_file_robot() {
    let Some(python) = python() else { return };
    let session = slow(&python);
    let in_time = ["--driver-start-timeout", "120s"];
    let preflight = ["preflight", "play.yaml", "--start-programs"];
    session.run(&[&preflight[..], &in_time].concat()).says(0, &["ready"]);
    let run = ["run", "play.yaml", "--lead", LEAD];
    session.run(&[&run[..], &in_time].concat()).says(0, &["play: done"]);
    assert_eq!(std::fs::read_to_string(session.path("driven.txt")).unwrap(), "left 20\n");
    session.run(&run).says(1, &["did not answer `init", "within 10 s"]);
    let refused = session.run(&["run", "play.yaml", "--driver-start-timeout", "1h"]);
    refused.says(2, &["'1h' for '--driver-start-timeout <TIME>': expected a time from 10ms to 600s"]);
}

#[test]
fn stop_does_not_wait_for_starting_hardware() {
    let Some(python) = python() else { return };
    let session = slow(&python);
    session.file("slow.py", SLOW.replace("sleep(11)", "sleep(600)"));
    let run = ["run", "play.yaml", "--driver-start-timeout", "600s"];
    let mut command = session.command(&run);
    let running = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    await_that("the start of the hardware", || session.path("starting").exists());
    session.run(&["stop"]).says(0, &[]);
    Ran(running.wait_with_output().unwrap()).says(3, &["stopped"]);
}

#[test]
fn edge_document_contains_the_tested_programs() {
    let document = std::fs::read_to_string(root().join("docs/edge.md")).unwrap();
    for program in [DRIVE, include_str!("../drivers/drive.py"), include_str!("../thrift/urrcp.thrift")] {
        assert!(document.contains(program), "docs/edge.md lacks, word for word:\n{program}");
    }
}

#[test]
fn failed_sensor_reading_of_program_is_shown_with_reason() {
    let session = session();
    session.file("drive.sh", DRIVE.replace("echo 12.5", "echo 'error the pack does not answer'"));
    session.file("fleet.yaml", fleet(&["program:sh drive.sh driven.txt".to_owned()], "above 12"));
    let preflight = ["preflight", "tanks.yaml", "--start-programs"];
    session.run(&preflight).says(1, &["nothing: ", "the pack does not answer", "above 12"]);
    let report = session.run(&[&preflight[..], &["--format", "json"]].concat()).json();
    let reading = &report["preflight"]["rows"][0]["readings"][0];
    assert_eq!(reading["reading"], serde_json::Value::Null, "{reading}");
    assert!(reading["why"].as_str().unwrap().contains("the pack does not answer"), "{reading}");
}
