//! Edges with real hardware behind them: Thrift robots and programs, driven, broken and restarted.
//!
//! The Thrift robot is `tests/thrift/server.py` where `DOWNBEAT_PYTHON` names a Python with the package thriftpy2,
//! else the one of `thrift_robot`.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use downbeat_robot::driver::{Driver, DriverError, ThriftRobot};
use urrcp::{
    AvailabilityRequest, AvailabilityResponse, Command as Controls, ControlError, ControlRequest,
    ControlResponse, ControlType, DeviceId, ErrorCode, Message, Millis, RequestId, Script, Setpoint, Status,
    Step, Timestamp,
};

use crate::session::{PROGRAM, Session, root};
use crate::thrift_robot;

const TANK: &str = include_str!("thrift/tank.json");

/// A Thrift robot of either kind; gone with the value.
enum Tank {
    Python(Child),
    Rust(thrift_robot::ThriftRobot),
}

impl Tank {
    /// Logs to a file of the session. Port 0 takes any free one.
    fn start(session: &Session, log: &str, port: u16) -> (Self, u16) {
        let log = session.path(log);
        let Some(python) = std::env::var_os("DOWNBEAT_PYTHON") else {
            let robot = thrift_robot::ThriftRobot::start(port, TANK, &log);
            let port = robot.port();
            return (Self::Rust(robot), port);
        };
        let schema = session.path("tank.json");
        std::fs::write(&schema, TANK).unwrap();
        let mut command = Command::new(python);
        command.arg(root().join("tests/thrift/server.py")).arg(port.to_string()).arg(schema).arg(log);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let port = first_line(&mut child).trim().parse().unwrap();
        (Self::Python(child), port)
    }
}

impl Tank {
    /// It keeps its connection and does nothing more.
    fn freeze(&self) {
        match self {
            Self::Python(child) => signal(child, "STOP"),
            Self::Rust(robot) => robot.freeze(),
        }
    }
}

fn signal(child: &Child, name: &str) {
    let id = child.id().to_string();
    assert!(Command::new("kill").args([&format!("-{name}"), &id]).status().unwrap().success());
}

impl Drop for Tank {
    fn drop(&mut self) {
        match self {
            Self::Python(child) => end(child),
            Self::Rust(robot) => robot.stop(),
        }
    }
}

fn first_line(child: &mut Child) -> String {
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    line
}

fn end(child: &mut Child) {
    let _gone = child.kill();
    let _reaped = child.wait();
}

/// An edge as a process, ended with the value.
struct Edge(Child, u16);

impl Edge {
    fn start(session: &Session, init: &str, driver: &str) -> Self {
        let mut command = Command::new(PROGRAM);
        command.args(["edge", "--listen", "127.0.0.1:0", "--init", init, "--driver", driver]);
        // What permission there is differs from machine to machine, and is told.
        command.args(["--realtime", "off"]);
        let command = command.current_dir(session.path(".")).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let line = first_line(&mut child);
        let port = line.trim().rsplit(':').next().unwrap().parse();
        let port = port.unwrap_or_else(|_| panic!("no port in `{line}`"));
        Self(child, port)
    }

    /// As Ctrl-C in its terminal, or the service manager.
    fn terminate(self) {
        assert_eq!(self.end(), (Some(0), String::new()));
    }

    /// Its exit code and what it said.
    fn end(self) -> (Option<i32>, String) {
        self.ends_by("TERM")
    }

    fn ends_by(mut self, name: &str) -> (Option<i32>, String) {
        signal(&self.0, name);
        let mut said = String::new();
        self.0.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        (self.0.wait().unwrap().code(), said)
    }
}

impl Drop for Edge {
    fn drop(&mut self) {
        end(&mut self.0);
    }
}

/// A server that speaks with one edge and does not look after its time.
struct Server {
    edge: BufReader<TcpStream>,
    /// Said of the script while something else was waited for.
    said: VecDeque<ControlResponse>,
    /// When the script of this server starts.
    start: SystemTime,
}

impl Server {
    fn connected(edge: &Edge) -> Self {
        let edge = TcpStream::connect(("127.0.0.1", edge.1)).unwrap();
        edge.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Self { edge: BufReader::new(edge), said: VecDeque::new(), start: SystemTime::now() }
    }

    fn send(&mut self, message: &Message) {
        let mut line = Vec::new();
        urrcp::encode(message, &mut line);
        self.edge.get_mut().write_all(&line).unwrap();
    }

    fn hear(&mut self) -> Message {
        let mut line = String::new();
        self.edge.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: `{line}`"))
    }

    /// What the edge says next of the script.
    fn response(&mut self) -> ControlResponse {
        if let Some(said) = self.said.pop_front() {
            return said;
        }
        match self.hear() {
            Message::ControlResponse(response) => response,
            other => panic!("{other:?}"),
        }
    }

    fn availability(&mut self) -> AvailabilityResponse {
        self.send(&Message::AvailabilityRequest(AvailabilityRequest::default()));
        loop {
            match self.hear() {
                Message::AvailabilityResponse(response) => return response,
                Message::ControlResponse(response) => self.said.push_back(response),
                other => panic!("{other:?}"),
            }
        }
    }

    /// Sends a script for `left`: these values at these milliseconds, from so many after now.
    fn script(&mut self, lead: u64, steps: &[(f64, f64)]) {
        let step = |(millis, value): &(f64, f64)| Step {
            offset: Millis::new(*millis).unwrap(),
            setpoint: Setpoint::new(ControlType::Position, *value),
            stop_condition: None,
        };
        let script = Script::new(steps.iter().map(step).collect()).unwrap();
        self.start = SystemTime::now() + Duration::from_millis(lead);
        let start = self.start.duration_since(SystemTime::UNIX_EPOCH).unwrap();
        self.send(&Message::ControlRequest(ControlRequest {
            timestamp: Some(Timestamp::from_nanos(i64::try_from(start.as_nanos()).unwrap())),
            time_offset_to_start: Some(Millis::new(0.0).unwrap()),
            request_id: Some(RequestId::new("a").unwrap()),
            ..ControlRequest::immediate(DeviceId::new("left").unwrap(), Controls::Script(script))
        }));
        assert_eq!(self.response().status, Status::Accepted);
    }

    /// Sleeps until so long before the start.
    fn await_start_less(&self, millis: u64) {
        let at = self.start - Duration::from_millis(millis);
        std::thread::sleep(at.duration_since(SystemTime::now()).unwrap_or_default());
    }

    /// Why the script fails, which it has to, without a start.
    fn fails_unstarted(&mut self) -> ControlError {
        let failed = self.response();
        assert_eq!(failed.status, Status::Failed, "{failed:?}");
        failed.error.unwrap()
    }
}

/// What was set, as `device value`, without the times in front. A line that is being written is none yet.
fn sets(session: &Session, log: &str) -> Vec<String> {
    let text = std::fs::read_to_string(session.path(log)).unwrap_or_default();
    let whole = text.split_inclusive('\n').filter_map(|line| line.strip_suffix('\n'));
    whole.map(|line| line.split_once(' ').unwrap().1.to_owned()).collect()
}

fn of(device: &str, sets: &[String]) -> Vec<f64> {
    let values = sets.iter().filter_map(|set| set.strip_prefix(device));
    values.map(|value| value.trim().parse().unwrap()).collect()
}

/// Waits for what other processes do in their own time; a minute is for machines that do much else.
#[track_caller]
fn await_that(what: &str, holds: impl Fn() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < Duration::from_secs(60), "{what}: not within a minute");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Enough for a machine that does much else.
const LEAD: &str = "3s";

const SCENARIO: &str = "scenario: tanks
start_tolerance: 1s
cues:
  - at: 0s
    robots: tanks
    tracks:
      left: [{at: 0s, to: 40}, {at: 300ms, to: -20}, {at: 600ms, to: 0}]
      right: [{at: 0s, to: 0}, {at: 500ms, to: 10}]
";

fn fleet(addresses: &[String], require: &str) -> String {
    let mut yaml = "robots:\n".to_owned();
    for (i, address) in addresses.iter().enumerate() {
        yaml.push_str(&format!(
            "  tank-{}:
    init: tank.json
    address: {address}
    require: {{battery: {require}}}
    devices:
      left: {{control_type: speed, granularity: 1, unit: \"%\"}}
      right: {{granularity: 1, interpolation: linear}}
",
            i + 1
        ));
    }
    let names: Vec<_> = (1..=addresses.len()).map(|i| format!("tank-{i}")).collect();
    format!("{yaml}groups: {{tanks: [{}]}}\n", names.join(", "))
}

fn session() -> Session {
    let session = Session::new();
    session.file("tank.json", TANK).file("tanks.yaml", SCENARIO);
    session
}

#[test]
fn two_thrift_robots_start_together_and_are_sent_every_value_in_order() {
    let session = session();
    let tanks = ["1.log", "2.log"].map(|log| Tank::start(&session, log, 0));
    let addresses = tanks.each_ref().map(|(_, port)| format!("thrift://127.0.0.1:{port}"));
    session.file("fleet.yaml", fleet(&addresses, "above 12"));
    let ran = session.run(&["run", "tanks.yaml", "--lead", LEAD, "--format", "json"]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    let report = ran.json();
    assert_eq!(report["outcome"], "done", "{report:#}");
    for log in ["1.log", "2.log"] {
        let sets = sets(&session, log);
        // Played, then at the end of the process the default state.
        assert_eq!(of("left", &sets), [40.0, -20.0, 0.0, 0.0], "{sets:?}");
        let right = of("right", &sets);
        let (way, rest) = right.split_at(right.len() - 1);
        assert_eq!((way.first(), way.last(), rest), (Some(&0.0), Some(&10.0), [0.0].as_slice()), "{sets:?}");
        assert!(way.is_sorted() && way.len() > 3, "{sets:?}");
    }
}

#[test]
fn a_sensor_of_a_thrift_robot_is_read_before_the_mission() {
    let session = session();
    let (_tank, port) = Tank::start(&session, "1.log", 0);
    session.file("fleet.yaml", fleet(&[format!("thrift://127.0.0.1:{port}")], "above 13"));
    session.run(&["preflight", "tanks.yaml"]).says(1, &["battery", "12.5"]);
    session.run(&["fleet", "ping"]).says(0, &["thrift://127.0.0.1:"]);
    assert_eq!(sets(&session, "1.log"), Vec::<String>::new(), "whoever looks moves nothing");
}

#[test]
fn a_thrift_robot_that_is_not_there_keeps_all_from_starting_and_is_named() {
    let session = session();
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let (gone, gone_port) = Tank::start(&session, "2.log", 0);
    drop(gone);
    let addresses = [port, gone_port].map(|port| format!("thrift://127.0.0.1:{port}"));
    session.file("fleet.yaml", fleet(&addresses, "above 12"));
    session
        .run(&["run", "tanks.yaml", "--lead", LEAD])
        .says(1, &["not started", "tank-2", "the hardware is away: no connection to thrift://", "refused"]);
    assert_eq!(sets(&session, "1.log"), Vec::<String>::new());
    drop(tank);
}

#[test]
fn an_edge_outlives_the_restart_of_its_robot_and_does_not_go_on_in_the_middle() {
    let session = session();
    session.file("tanks.yaml", SCENARIO.replace("600ms, to: 0", "60s, to: 0"));
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
    let plain = format!(
        "robots: {{tank-1: {{init: tank.json, address: 'tcp://127.0.0.1:{}'}}}}\ngroups: {{tanks: [tank-1]}}\n",
        edge.1
    );
    session.file("fleet.yaml", plain);
    await_that("the default state at the start", || sets(&session, "1.log").len() == 2);
    let running = session
        .command(&["run", "tanks.yaml", "--lead", LEAD])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let running = running.unwrap();
    await_that("the second step", || of("left", &sets(&session, "1.log")).contains(&-20.0));
    drop(tank);
    let ran = crate::session::Ran(running.wait_with_output().unwrap());
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert!(ran.text().contains("the hardware is away"), "{}", ran.text());
    let (_tank, _) = Tank::start(&session, "2.log", port);
    await_that("the default state of the restarted robot", || sets(&session, "2.log").len() >= 2);
    assert_eq!(sets(&session, "2.log"), ["left 0", "right 0"]);
    session.file("tanks.yaml", SCENARIO);
    let ran = session.run(&["run", "tanks.yaml", "--lead", LEAD]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    edge.terminate();
    let sets = sets(&session, "2.log");
    assert_eq!(of("left", &sets), [0.0, 40.0, -20.0, 0.0, 0.0], "{sets:?}");
    assert_eq!(of("right", &sets), [0.0, 0.0, 10.0, 0.0], "{sets:?}");
}

#[test]
fn hardware_that_dies_shortly_before_a_start_is_missed_at_once_and_nothing_starts() {
    for before in [327, 108, 40] {
        let session = session();
        let (tank, port) = Tank::start(&session, "1.log", 0);
        let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
        await_that("the default state at the start", || sets(&session, "1.log").len() == 2);
        let mut server = Server::connected(&edge);
        server.script(1_000, &[(0.0, 40.0), (300.0, -20.0)]);
        server.await_start_less(before);
        drop(tank);
        let error = server.fails_unstarted();
        assert_eq!(error.code, ErrorCode::Internal);
        assert!(error.message.contains("has closed the connection"), "{error}");
        assert_eq!(server.availability().status, Status::Failed);
    }
}

#[test]
fn hardware_that_freezes_shortly_before_a_start_makes_the_edge_unready_and_nothing_starts() {
    let session = session();
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
    await_that("the default state at the start", || sets(&session, "1.log").len() == 2);
    let mut server = Server::connected(&edge);
    server.script(1_500, &[(0.0, 40.0), (300.0, -20.0)]);
    server.await_start_less(700);
    assert_eq!(server.availability().status, Status::Ok);
    tank.freeze();
    server.await_start_less(200);
    let unready = server.availability();
    assert_eq!(unready.status, Status::Failed);
    let error = unready.error.unwrap();
    assert!(error.message.contains("the hardware has not answered for "), "{error}");
    let error = server.fails_unstarted();
    assert_eq!(error.code, ErrorCode::Internal);
    assert!(error.message.contains("the hardware has not answered for "), "{error}");
}

#[test]
fn an_edge_that_was_stopped_and_goes_on_sets_no_value_that_has_become_stale() {
    let session = session();
    let (_tank, port) = Tank::start(&session, "1.log", 0);
    let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
    await_that("the default state at the start", || sets(&session, "1.log").len() == 2);
    let mut server = Server::connected(&edge);
    server.script(1_000, &[(0.0, 40.0), (1_000.0, -20.0), (60_000.0, 5.0)]);
    assert_eq!(server.response().status, Status::Started);
    signal(&edge.0, "STOP");
    std::thread::sleep(Duration::from_secs(2));
    signal(&edge.0, "CONT");
    let failed = server.response();
    assert_eq!(failed.error.map(|error| error.code), Some(ErrorCode::Late));
    await_that("the default state", || of("left", &sets(&session, "1.log")).len() == 3);
    assert_eq!(of("left", &sets(&session, "1.log")), [0.0, 40.0, 0.0]);
}

#[test]
fn a_program_that_dies_shortly_before_a_start_is_missed_at_once_and_nothing_starts() {
    let session = session();
    session.file("drive.sh", DRIVE);
    let edge = Edge::start(&session, "tank.json", "program:echo $$ > pid; exec sh drive.sh driven.txt");
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    await_that("the default state", || driven().lines().count() >= 3);
    let mut server = Server::connected(&edge);
    server.script(1_000, &[(0.0, 40.0), (300.0, -20.0)]);
    server.await_start_less(108);
    let program = std::fs::read_to_string(session.path("pid")).unwrap();
    assert!(Command::new("kill").args(["-KILL", program.trim()]).status().unwrap().success());
    let error = server.fails_unstarted();
    assert_eq!(error.code, ErrorCode::Internal);
    assert!(error.message.contains("driven.txt` has ended"), "{error}");
}

#[test]
fn an_edge_that_cannot_bring_its_devices_to_rest_says_so() {
    let session = session();
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
    await_that("the default state at the start", || sets(&session, "1.log").len() == 2);
    drop(tank);
    let (code, said) = edge.end();
    assert_eq!(code, Some(4), "{said}");
    assert!(said.contains("the devices of `tank-1` may not be in their default state: "), "{said}");
}

#[test]
fn a_run_names_the_hardware_of_its_own_that_it_could_not_bring_to_rest() {
    let session = session();
    session.file("tanks.yaml", SCENARIO.replace("600ms, to: 0", "60s, to: 0"));
    let (tank, port) = Tank::start(&session, "1.log", 0);
    session.file("fleet.yaml", fleet(&[format!("thrift://127.0.0.1:{port}")], "above 12"));
    let mut run = session.command(&["run", "tanks.yaml", "--lead", LEAD]);
    let running = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    await_that("the second step", || of("left", &sets(&session, "1.log")).contains(&-20.0));
    drop(tank);
    let ran = crate::session::Ran(running.wait_with_output().unwrap());
    ran.says(4, &["the devices of `tank-1` may not be in their default state: the hardware is away"]);
}

#[test]
fn an_edge_that_finds_its_port_taken_moves_nothing() {
    let session = session();
    session.file("drive.sh", DRIVE);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let listen = taken.local_addr().unwrap().to_string();
    let driver = "program:sh drive.sh driven.txt";
    let edge = ["edge", "--init", "tank.json", "--listen", &listen, "--driver", driver];
    session.run(&edge).says(2, &["cannot listen on 127.0.0.1:"]);
    assert!(!session.path("driven.txt").exists(), "the driver was started");
}

const DRIVE: &str = include_str!("drivers/drive.sh");

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
    let anew = "set left position 66\nhello\nset left position 0\nset right position 0\n";
    await_that("the restart", || driven().contains(anew));
    edge.terminate();
    let expected = "hello\nset left position 0\nset right position 0\nread battery\nset left position 40\nset left position -20\nset left position 0\n";
    assert!(driven().starts_with(expected), "{}", driven());
    assert!(driven().ends_with("set left position 0\nset right position 0\n"), "{}", driven());
}

#[test]
fn a_program_that_a_killed_scheduler_drove_is_stopped_from_another_folder() {
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
    let stopped = session.command(&["stop"]).current_dir(elsewhere.path()).output().unwrap();
    crate::session::Ran(stopped).says(0, &["tank-1: default state confirmed"]);
    let after = driven().split_once("set left position -20\n").unwrap().1.to_owned();
    assert!(after.contains("set left position 0\n"), "{after}");
}

/// A program drives a wheel, and the edge is sent these signals, one after another. What the program was told.
fn driven_until(signals: &[&str]) -> (Option<i32>, String) {
    let session = Session::new();
    session.file("drive.sh", DRIVE).file("wheel.yaml", WHEEL);
    let edge = Edge::start(&session, "wheel.yaml", "program:sh drive.sh driven.txt");
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    let fleet = format!("robots: {{wheel: {{init: wheel.yaml, address: 'tcp://127.0.0.1:{}'}}}}\n", edge.1);
    session.file("fleet.yaml", fleet).file("turn.yaml", TURN);
    let mut running = session.command(&["run", "turn.yaml"]).spawn().unwrap();
    await_that("the wheel", || driven().ends_with("set wheel speed 5\n"));
    signals[..signals.len() - 1].iter().for_each(|name| signal(&edge.0, name));
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
    for name in ["INT", "TERM", "HUP", "QUIT"] {
        let (code, driven) = driven_until(&[name]);
        assert!(driven.ends_with("set wheel speed 0\n"), "{name}: {driven}");
        assert_eq!(code, Some(0), "{name}");
    }
}

#[test]
fn signals_that_ask_for_nothing_do_not_end_an_edge() {
    let (code, driven) = driven_until(&["USR1", "USR2", "XFSZ", "PIPE", "TERM"]);
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
    session.file("drive.py", include_str!("drivers/drive.py"));
    let edge = Edge::start(&session, "tank.json", &format!("program:{python} drive.py driven.txt"));
    let driven = || std::fs::read_to_string(session.path("driven.txt")).unwrap_or_default();
    await_that("the default state", || driven() == "left position 0\nright position 0\n");
    edge.terminate();
}

#[test]
fn a_thrift_robot_is_asked_and_says_no() {
    let session = session();
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let block = downbeat_scripts::read_init(&session.path("tank.json")).unwrap();
    let mut driver = ThriftRobot::new("127.0.0.1", port, &block).unwrap();
    let device = |id: &str| DeviceId::new(id).unwrap();
    assert!(matches!(driver.ping(), Err(DriverError::Away(_))), "nothing before it is connected");
    driver.connect().unwrap();
    driver.set(&device("left"), &Setpoint::new(ControlType::Position, 4.5)).unwrap();
    assert_eq!(driver.read(&device("battery")), Ok(12.5));
    assert_eq!(sets(&session, "1.log"), ["left 4.5"]);
    let schema = downbeat_robot::driver::describe_thrift;
    drop(driver);
    assert_eq!(schema("127.0.0.1", port).unwrap(), TANK);
    let mut driver = ThriftRobot::new("127.0.0.1", port, &block).unwrap();
    driver.connect().unwrap();
    drop(tank);
    // A one-way call may still fit into the socket; a question cannot be answered.
    assert!(matches!(driver.ping(), Err(DriverError::Away(_))));
    assert!(matches!(driver.connect(), Err(DriverError::Away(reason)) if reason.contains("no connection")));
}

#[test]
fn a_device_with_two_control_types_or_a_space_is_refused_by_drivers_that_cannot_say_it() {
    let session = Session::new();
    session.file(
        "two.yaml",
        "id: a\napi_version: '1'\ndevices: [{id: two wheels, name: w, available_control_types: {position: {min_value: 0, max_value: 1, granularity: 1}, speed: {min_value: 0, max_value: 1, granularity: 1}}}]\n",
    );
    let refused = |driver: &str| session.run(&["edge", "--init", "two.yaml", "--driver", driver]);
    refused("thrift://localhost:1").says(2, &["`two wheels` has several control types"]);
    refused("program:true").says(2, &["`two wheels` has a space in its id"]);
    refused("serial:x").says(2, &["expected sim, thrift://host:port or program:COMMAND"]);
}

#[test]
fn a_robot_describes_itself_as_an_init_file_by_either_protocol() {
    let session = session();
    let (_tank, port) = Tank::start(&session, "1.log", 0);
    let told = session.run(&["fleet", "describe", &format!("thrift://127.0.0.1:{port}")]);
    assert_eq!(told.code(), 0, "{}", told.text());
    session.file("told.yaml", told.out());
    let edge = Edge::start(&session, "told.yaml", "sim");
    let again = session.run(&["fleet", "describe", &format!("tcp://127.0.0.1:{}", edge.1)]);
    assert_eq!(again.out(), told.out());
    assert!(told.out().contains("id: tank-1\n"), "{}", told.out());
    session.run(&["fleet", "describe", "sim"]).says(2, &["describes itself to nobody"]);
    session.run(&["fleet", "describe", "thrift://127.0.0.1:1"]).says(1, &["127.0.0.1:1"]);
}

#[test]
fn faults_in_the_description_of_a_thrift_robot_are_found_in_either_file() {
    let session = session();
    let tank = |keys: &str| {
        format!(
            "robots:\n  tank-1:\n    init: tank.json\n    address: thrift://localhost:9090\n{keys}groups: {{tanks: [tank-1]}}\n"
        )
    };
    let check = |fleet: &str, says: &[&str]| {
        session.file("fleet.yaml", fleet);
        session.run(&["check", "tanks.yaml"]).says(1, says);
    };
    check(
        &tank("    devices: {lft: {granularity: 1}}\n"),
        &["DB0009", "fleet.yaml:5:15", "no device `lft`", "did you mean `left`?"],
    );
    check(&tank("    devices:\n      left: {granularity: 0}\n"), &["DB0003", "fleet.yaml:6:27", "above 0"]);
    check(&tank("    devices: {left: {control_type: sped}}\n"), &["DB0020", "did you mean `speed`?"]);
    check(
        &tank("").replace("localhost:9090", "localhost"),
        &["DB0020", "fleet.yaml:4:14", "thrift://host:port"],
    );
    let whole = tank("    devices: {shoulder: {granularity: 1}}\n").replace("tank.json", "arm.yaml");
    check(&whole, &["DB0004", "fleet.yaml:5:5", "`arm.yaml` describes its devices whole"]);
    session.file("tank.json", TANK.replace("get_sensor_double_value", "get_colour"));
    check(&tank(""), &["DB0020", "tank.json:19:15", "unknown call `get_colour`", "get_sensor_double_value"]);
}

#[test]
fn the_edge_document_shows_the_programs_that_are_tested() {
    let document = std::fs::read_to_string(root().join("docs/edge.md")).unwrap();
    for program in [DRIVE, include_str!("drivers/drive.py"), include_str!("thrift/urrcp.thrift")] {
        assert!(document.contains(program), "docs/edge.md lacks, word for word:\n{program}");
    }
}
