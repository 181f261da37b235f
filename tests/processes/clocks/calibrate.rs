//! Tests of `downbeat calibrate` with robots as processes, whose simulated bodies lag behind the commands by a known time.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rustix::process::Signal;
use serde_json::Value;

use stage::quiet::{await_that, stays};
use stage::session::{Ran, Session};
use stage::{Proxy, free_port, signal};

const ARM: &str = "id: arm
api_version: '1'
reports: true
devices:
  - id: elbow
    unit: deg
    default_value: 0
    interpolation: linear
    script_queue: 2
    available_control_types:
      position: {min_value: -90, max_value: 90, granularity: 0.01}
      script: {min_value: -90, max_value: 90, granularity: 0.01, max_number_of_steps: 1000, control_types: [position]}
  - id: angle
    available_control_types:
      sensor: {min_value: -180, max_value: 180}
  - id: grip
    available_control_types:
      position: {min_value: 0, max_value: 1, granularity: 0.01}
      script: {min_value: 0, max_value: 1, granularity: 0.01, max_number_of_steps: 100, control_types: [position]}
";

/// A robot with a simulated body, as a separate process behind a proxy.
struct Show {
    session: Session,
    robot: Child,
    port: u16,
    proxy: Proxy,
}

impl Show {
    fn new(moves: &str, calibrate: &str) -> Self {
        let session = Session::new();
        let port = free_port();
        let fleet = |port: u16| {
            format!(
                "robots:\n  arm:\n    init: robot.yaml\n    address: 'tcp://127.0.0.1:{port}'\n    simulate: {{moves: {{elbow: {{{moves}}}}}}}\n    \
                 calibrate: {{elbow: {{{calibrate}}}}}\n"
            )
        };
        session.file("robot.yaml", ARM).file("robots.yaml", fleet(port));
        let mut command: Command = session.command(&["sim", "robots.yaml", "--log-file", "log.jsonl"]);
        let mut robot = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(robot.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let proxy = Proxy::to(port);
        session.file("fleet.yaml", fleet(proxy.port));
        Self { session, robot, port, proxy }
    }

    fn calibrate(&self, args: &[&str]) -> Ran {
        self.session.run(&[&["calibrate", "--yes"], args].concat())
    }

    fn start(&self) -> Child {
        let mut command = self.session.command(&["calibrate", "--yes", "--trials", "200"]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    /// Returns the complete lines of the robot's log.
    fn log(&self) -> Vec<Value> {
        let log = std::fs::read_to_string(self.session.path("log.jsonl")).unwrap_or_default();
        let whole = log.split_inclusive('\n').filter_map(|line| line.strip_suffix('\n'));
        whole.map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// Waits for half a second, and returns the robot's log. An idle machine writes the log within 50 ms.
    fn settled_log(&self) -> Vec<Value> {
        std::thread::sleep(Duration::from_millis(500));
        self.log()
    }

    fn has_not_moved(&self) {
        let log = self.settled_log();
        assert!(log.is_empty(), "{log:?}");
    }

    fn await_movements(&self, count: usize) {
        let ramps = || self.log().iter().filter(|set| set["motion"] == "ramp").count();
        await_that("a movement", || ramps() >= count);
    }
}

impl Drop for Show {
    fn drop(&mut self) {
        let _gone = self.robot.kill();
        let _gone = self.robot.wait();
    }
}

fn ended(child: Child) -> Ran {
    Ran(child.wait_with_output().unwrap())
}

const MOVES: &str = "latency: 60ms, spread: 2ms, time_constant: 15ms, sensor: angle, noise: 0.02, delay: 4ms";
const BY: &str = "sensor: angle, by: 2, taken: request";

#[test]
fn lag_is_measured_and_saved_and_device_returns_to_its_position() {
    let show = Show::new(MOVES, BY);
    show.session.file(
        "latency.yaml",
        "latency:\n  other:\n    wheel: {median: 5ms}\n  arm:\n    elbow: {median: 1ms}\n",
    );
    let ran = show.calibrate(&["--trials", "10", "--format", "json"]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    let device = &ran.json()["devices"][0];
    // An idle machine measures 55 to 75 ms. A busy one makes the lag longer, never shorter.
    let median = device["median_ms"].as_f64().unwrap();
    assert!((55.0..165.0).contains(&median), "{device}");
    assert!(device["p95_ms"].as_f64().unwrap() >= median, "{device}");
    let written = std::fs::read_to_string(show.session.path("latency.yaml")).unwrap();
    assert!(written.contains("wheel: {median: 5ms}") && !written.contains("median: 1ms"), "{written}");
    let last = || show.log().into_iter().rfind(|set| set["device"] == "elbow");
    await_that("the way back", || last().is_some_and(|set| set["value"].as_f64().unwrap().abs() < 0.1));
}

#[test]
fn dry_run_moves_nothing_and_lists_planned_and_skipped_devices() {
    let show = Show::new(MOVES, BY);
    let ran = show.session.run(&["calibrate", "--dry-run"]);
    ran.says(0, &["elbow", "angle", "2 deg", "grip: not measured: no sensor measures its position"]);
    show.session.run(&["calibrate"]).says(2, &["add --yes if the movement is safe"]);
    assert_eq!(show.settled_log(), Vec::<Value>::new());
}

#[test]
fn noisy_sensor_or_wrong_start_position_is_refused_before_any_movement() {
    let noisy = Show::new("sensor: angle, noise: 1", BY);
    noisy.calibrate(&[]).says(1, &["too much for a movement of 2"]);
    noisy.has_not_moved();
    assert!(!noisy.session.path("latency.yaml").exists());
    let elsewhere = Show::new(MOVES, "sensor: angle, from: 30, by: 2");
    elsewhere.calibrate(&[]).says(1, &["but the movement starts at 30"]);
    elsewhere.has_not_moved();
}

/// A driver program of which every twentieth reading fails.
const FORGETFUL: &str = r#"
value=0; count=0
while read -r verb device control number rest; do
    case "$verb" in
        set) value=$number; echo ok ;;
        read) count=$((count + 1)); if [ $((count % 20)) = 0 ]; then echo error busy; else echo "$value"; fi ;;
        *) echo ok ;;
    esac
done
"#;

#[test]
fn failed_sensor_reading_is_requested_again() {
    let session = Session::new();
    let robot = "robots:\n  arm: {init: robot.yaml, address: 'program:sh drive.sh', calibrate: {elbow: {sensor: angle, by: 2}}}\n";
    session.file("robot.yaml", ARM).file("fleet.yaml", robot).file("drive.sh", FORGETFUL);
    let ran = session.run(&["calibrate", "--yes", "--trials", "6"]);
    ran.says(0, &["elbow"]);
    assert!(session.path("latency.yaml").exists());
}

#[test]
fn calibration_gives_up_soon_if_device_does_not_move() {
    // The sensor of the body shows no movement for longer than the calibration watches.
    let show = Show::new("latency: 10s, sensor: angle", BY);
    show.calibrate(&[]).says(1, &["the sensor shows no movement"]);
    assert!(show.settled_log().iter().filter(|set| set["motion"] == "ramp").count() < 8);
}

#[test]
fn unwritable_output_file_is_reported_before_any_movement() {
    let show = Show::new(MOVES, BY);
    show.calibrate(&["--output", "no/such/folder.yaml"]).says(2, &["cannot write no/such/folder.yaml"]);
    assert_eq!(show.settled_log(), Vec::<Value>::new());
}

#[test]
fn robot_of_another_session_is_not_moved() {
    let show = Show::new(MOVES, BY);
    let mut other = TcpStream::connect(("127.0.0.1", show.port)).unwrap();
    writeln!(other, r#"{{"availability_request":{{"session":"another"}}}}"#).unwrap();
    BufReader::new(other.try_clone().unwrap()).read_line(&mut String::new()).unwrap();
    show.calibrate(&[]).says(1, &["belongs to another session"]);
    drop(other);
    assert!(show.settled_log().iter().all(|set| set["motion"] != "ramp"));
}

#[test]
fn cut_link_leaves_device_at_rest() {
    let show = Show::new(MOVES, BY);
    let running = show.start();
    show.await_movements(2);
    show.proxy.cut();
    ended(running).says(4, &["may still be moving"]);
    std::thread::sleep(Duration::from_millis(2_500));
    let moves = show.log().len();
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(show.log().len(), moves, "it still moves");
    // The robot is free again.
    show.proxy.open();
    let again = show.calibrate(&["--trials", "6"]);
    assert_eq!(again.code(), 0, "{}", again.text());
}

#[test]
fn interrupt_leaves_device_in_place_and_robot_free() {
    let show = Show::new(MOVES, BY);
    let running = show.start();
    show.await_movements(2);
    signal(&running, Signal::INT);
    ended(running).says(3, &["interrupted"]);
    show.settled_log();
    stays(Duration::from_millis(1_500), || show.log().len());
    assert_eq!(show.calibrate(&["--trials", "6"]).code(), 0);
}

#[test]
fn mission_with_unverifiable_motions_is_refused_before_any_movement() {
    let session = Session::new();
    session
        .file("robot.yaml", ARM)
        .file("fleet.yaml", "robots: {arm: {init: robot.yaml, address: sim}}\n")
        .file(
            "show.yaml",
            "scenario: show\nstart_tolerance: 1s\ncues: [{at: 0s, robots: arm, tracks: {elbow: [{at: 0s, to: 0}]}}]\n",
        );
    session.run(&["run", "show.yaml", "--verify-motion"]).says(
        2,
        &[
            "no robot of this scenario has that key",
            "add `calibrate: {DEVICE: {sensor: SENSOR, by: AMOUNT}}`",
        ],
    );
}
