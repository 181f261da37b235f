//! Missions with robots and scheduler as real processes over TCP: all robots start, or none does.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rustix::process::Signal;

use stage::held_up::{ATTEMPTS, reason};
use stage::quiet::await_that;
use stage::session::{Session, arm_at, program};
use stage::{free_port, signal};

const SCENARIO: &str = "scenario: test
start_tolerance: 1s
cues:
  - at: 0s
    robots: all
    tracks:
      shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 0}, {at: 600ms, to: 45}]
";

/// Six robots, each in a process of its own; they end when this is dropped.
struct Fleet {
    session: Session,
    robots: Vec<Child>,
}

impl Fleet {
    /// Starts the robots. `third` contains additional arguments for the robot `r3`.
    fn start(third: &[&str]) -> Self {
        let session = Session::new();
        session.file("arm.yaml", arm_at(45)).file("test.yaml", SCENARIO);
        let mut fleet = Self { session, robots: Vec::new() };
        let mut yaml = "robots:\n".to_owned();
        for id in 0..6 {
            let port = fleet.robot(id, if id == 3 { third } else { &[] });
            yaml.push_str(&format!("  r{id}: {{init: arm.yaml, address: 'tcp://127.0.0.1:{port}'}}\n"));
        }
        yaml.push_str("groups: {all: [r0, r1, r2, r3, r4, r5]}\n");
        fleet.session.file("fleet.yaml", yaml);
        fleet
    }

    fn robot(&mut self, id: usize, extra: &[&str]) -> u16 {
        let offset = format!("{}ms", id * 60);
        let log = self.session.path(&format!("r{id}.jsonl"));
        let mut command = Command::new(program());
        command.args(["robot", "--listen", "127.0.0.1:0", "--id", &format!("r{id}"), "--init"]);
        command.arg(self.session.path("arm.yaml")).arg("--log-file").arg(log);
        command.args([
            "--clock-offset",
            &offset,
            "--ntp-error",
            "40us",
            "--delay-max",
            "80ms",
            "--seed",
            &id.to_string(),
        ]);
        let mut child = command.args(extra).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        self.robots.push(child);
        line.trim().rsplit(':').next().unwrap().parse().unwrap_or_else(|_| panic!("no port in `{line}`"))
    }

    /// Returns what a robot has logged so far.
    fn log(&self, id: usize) -> String {
        std::fs::read_to_string(self.session.path(&format!("r{id}.jsonl"))).unwrap()
    }

    /// Returns the number of robots that have set a value of a script.
    fn moved(&self) -> usize {
        let moved = |log: &str| log.contains(r#""motion":"set""#) || log.contains(r#""motion":"ramp""#);
        (0..6).filter(|id| moved(&self.log(*id))).count()
    }

    /// Waits until all robots have set a value of a script.
    #[track_caller]
    fn await_moves(&self) {
        await_that("a move of each robot", || self.moved() == 6);
    }

    /// Asserts that no robot has set a value of a script when the time `window` has passed.
    #[track_caller]
    fn assert_none_moves(&self, window: Duration) {
        std::thread::sleep(window);
        assert_eq!(self.moved(), 0);
    }

    /// Starts a mission, and returns it when all robots have moved. Starts it again if its report states that this machine was too slow.
    #[track_caller]
    fn playing(&self) -> Child {
        for _ in 0..ATTEMPTS {
            let mut scheduler = self.run_in_background(&[]);
            await_line(&mut scheduler, "all robots have accepted");
            await_that("moves, or an end", || self.moved() == 6 || scheduler.try_wait().unwrap().is_some());
            if scheduler.try_wait().unwrap().is_none() {
                return scheduler;
            }
            let ended = scheduler.wait_with_output().unwrap();
            let said =
                [ended.stdout, ended.stderr].map(|out| String::from_utf8_lossy(&out).into_owned()).concat();
            assert!(reason(&said).is_some(), "it ended before its robots moved: {said}");
        }
        panic!("this machine was too slow to begin {ATTEMPTS} times");
    }

    fn run_in_background(&self, args: &[&str]) -> Child {
        let mut command = self.session.command(&["run", "test.yaml"]);
        command.args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        for robot in &mut self.robots {
            let _gone = robot.kill();
            let _reaped = robot.wait();
        }
    }
}

/// Reads the scheduler's progress messages until a line contains this text.
fn await_line(child: &mut Child, text: &str) {
    let lines = BufReader::new(child.stderr.as_mut().unwrap()).lines();
    for line in lines {
        if line.unwrap().contains(text) {
            return;
        }
    }
    panic!("the scheduler never said `{text}`");
}

#[test]
fn six_processes_with_separate_clocks_start_and_report() {
    let fleet = Fleet::start(&[]);
    let ran = fleet.session.run(&["run", "test.yaml", "--format", "json"]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    let report = ran.json();
    assert_eq!(report["outcome"], "done");
    assert!(report["robots"].as_array().unwrap().iter().all(|robot| robot["steps_done"] == 3));
    fleet.await_moves();
}

#[track_caller]
fn check_none_starts(third: &[&str], says: &[&str]) {
    let fleet = Fleet::start(third);
    let ran = fleet.session.run(&["run", "test.yaml"]);
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    for part in says {
        assert!(ran.text().contains(part), "`{part}` is missing in:\n{}", ran.text());
    }
    fleet.assert_none_moves(Duration::from_secs(3));
}

#[test]
fn no_robot_starts_if_one_refuses_and_report_names_it() {
    check_none_starts(&["--fault", "refuse"], &["test: not started", "r3: device `shoulder`: busy"]);
}

#[test]
fn no_robot_starts_if_one_is_silent_and_report_names_it() {
    check_none_starts(
        &["--fault", "silent"],
        &["test: not started", "r3: silent: no acceptance by `shoulder`"],
    );
}

#[test]
fn no_robot_starts_if_one_disconnects_between_acceptance_and_decision() {
    check_none_starts(&["--fault", "disconnect"], &["test: not started", "r3: link down"]);
}

#[test]
fn no_robot_starts_if_one_is_missing_and_report_names_it() {
    let mut fleet = Fleet::start(&[]);
    fleet.robots[3].kill().unwrap();
    fleet.robots[3].wait().unwrap();
    fleet
        .session
        .run(&["run", "test.yaml"])
        .says(1, &["test: not started", "r3: link down: no connection to 127.0.0.1"]);
    fleet.assert_none_moves(Duration::from_secs(3));
}

#[test]
fn no_robot_starts_if_scheduler_is_killed_before_commitment() {
    let fleet = Fleet::start(&[]);
    let mut scheduler = fleet.run_in_background(&["--lead", "5s"]);
    await_line(&mut scheduler, "all robots have accepted");
    scheduler.kill().unwrap();
    scheduler.wait().unwrap();
    fleet.assert_none_moves(Duration::from_secs(6));
}

#[test]
fn ctrl_c_stops_every_robot() {
    let fleet = Fleet::start(&[]);
    fleet.session.file("test.yaml", SCENARIO.replace("600ms", "60s"));
    let mut scheduler = fleet.playing();
    signal(&scheduler, Signal::INT);
    let mut printed = String::new();
    scheduler.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    assert_eq!(scheduler.wait().unwrap().code(), Some(3), "{printed}");
    assert!(printed.contains("stopped by the operator"), "{printed}");
    assert_eq!(printed.matches("stop confirmed").count(), 6, "{printed}");
}

#[test]
fn second_ctrl_c_exits_immediately_and_lists_unconfirmed_robots() {
    let fleet = Fleet::start(&[]);
    fleet.session.file("test.yaml", SCENARIO.replace("600ms", "60s"));
    let mut scheduler = fleet.playing();
    // A robot that is stopped by its debugger confirms nothing.
    signal(&fleet.robots[3], Signal::STOP);
    signal(&scheduler, Signal::INT);
    await_line(&mut scheduler, "stopping all robots");
    signal(&scheduler, Signal::INT);
    let mut printed = String::new();
    scheduler.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    assert_eq!(scheduler.wait().unwrap().code(), Some(4), "{printed}");
    assert!(printed.contains("r3: stop NOT confirmed; its lease ends at"), "{printed}");
}

#[test]
fn moving_robots_stop_at_lease_end_after_scheduler_is_killed() {
    let fleet = Fleet::start(&[]);
    fleet.session.file(
        "test.yaml",
        SCENARIO.replace("600ms", "60s").replace("cues:", "stop_condition: {running: 1s}\ncues:"),
    );
    let mut scheduler = fleet.playing();
    scheduler.kill().unwrap();
    scheduler.wait().unwrap();
    let rests =
        |id: usize| fleet.log(id).lines().last().is_some_and(|line| line.contains(r#""motion":"rest""#));
    await_that("the rest of each robot", || (0..6).all(rests));
}

#[test]
fn fleet_in_one_process_is_pinged_and_started_without_handshake() {
    let session = Session::new();
    let yaml = |handshake: &str, ports: &[u16]| {
        let robot = |(id, port): (usize, &u16)| {
            format!("  r{id}: {{init: arm.yaml, address: 'tcp://127.0.0.1:{port}'}}\n")
        };
        let robots: String = ports.iter().enumerate().map(robot).collect();
        format!("handshake: {handshake}\nrobots:\n{robots}groups: {{all: [r0, r1, r2]}}\n")
    };
    let ports = [free_port(), free_port(), free_port()];
    session.file("test.yaml", SCENARIO).file("fleet.yaml", yaml("skip", &ports));
    let mut sim = session.command(&["sim", "fleet.yaml"]).stdout(Stdio::piped()).spawn().unwrap();
    let mut listening = BufReader::new(sim.stdout.take().unwrap()).lines();
    for (id, port) in ports.iter().enumerate() {
        let line = listening.next().unwrap().unwrap();
        assert_eq!(line, format!("robot r{id} listens on 127.0.0.1:{port}"));
    }
    let ping = session.run(&["fleet", "ping", "fleet.yaml"]);
    let ran = session.run(&["run", "test.yaml", "--format", "json"]);
    signal(&sim, Signal::TERM);
    assert_eq!(sim.wait().unwrap().code(), Some(0));
    ping.says(0, &["r2", "tcp://127.0.0.1:", "yes"]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    let report = ran.json();
    assert!(report["robots"].as_array().unwrap().iter().all(|r| r["steps_done"] == 3));
}
