//! Edges that drive real hardware: Thrift robots and programs, which the tests drive, break and restart.
//!
//! The Thrift robot is `tests/processes/thrift/server.py` if `DOWNBEAT_PYTHON` names a Python with the package thriftpy2, otherwise the
//! robot of `thrift_robot`.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod descriptions;
mod failing;
mod lookahead;
mod processes;
mod programs;
mod server;

use std::process::Stdio;
use std::time::{Duration, Instant};

use processes::{Edge, Tank};
use programs::DRIVE;
use stage::session::Session;

const TANK: &str = include_str!("../thrift/tank.json");

/// Returns the values that a log contains, as `device value`, without their times. An incomplete last line is skipped.
fn sets(session: &Session, log: &str) -> Vec<String> {
    let text = std::fs::read_to_string(session.path(log)).unwrap_or_default();
    let whole = text.split_inclusive('\n').filter_map(|line| line.strip_suffix('\n'));
    whole.map(|line| line.split_once(' ').unwrap().1.to_owned()).collect()
}

fn of(device: &str, sets: &[String]) -> Vec<f64> {
    let values = sets.iter().filter_map(|set| set.strip_prefix(device));
    values.map(|value| value.trim().parse().unwrap()).collect()
}

/// Waits until a condition holds that other processes fulfil. Panics after a minute, which suffices for a busy machine.
#[track_caller]
fn await_that(what: &str, holds: impl Fn() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < Duration::from_secs(60), "{what}: not within a minute");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Lead (the time between the requests and the start) that suffices for a busy machine.
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
fn two_thrift_robots_start_together_and_receive_all_values_in_order() {
    let session = session();
    let tanks =
        [("tank-1", "1.log"), ("tank-2", "2.log")].map(|(id, log)| Tank::start_as(id, &session, log, 0));
    let addresses = tanks.each_ref().map(|(_, port)| format!("thrift://127.0.0.1:{port}"));
    session.file("fleet.yaml", fleet(&addresses, "above 12"));
    let ran = session.run(&["run", "tanks.yaml", "--lead", LEAD, "--format", "json"]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    let report = ran.json();
    assert_eq!(report["outcome"], "done", "{report:#}");
    for log in ["1.log", "2.log"] {
        let sets = sets(&session, log);
        // Played. At the end of the process the speed goes to zero, and the position stays.
        assert_eq!(of("left", &sets), [40.0, -20.0, 0.0, 0.0], "{sets:?}");
        let way = of("right", &sets);
        assert_eq!((way.first(), way.last()), (Some(&0.0), Some(&10.0)), "{sets:?}");
        assert!(way.is_sorted() && way.len() > 3, "{sets:?}");
    }
}

#[test]
fn two_thrift_robots_with_swapped_addresses_do_not_move() {
    let session = session();
    let tanks =
        [("tank-2", "2.log"), ("tank-1", "1.log")].map(|(id, log)| Tank::start_as(id, &session, log, 0));
    let addresses = tanks.each_ref().map(|(_, port)| format!("thrift://127.0.0.1:{port}"));
    session.file("fleet.yaml", fleet(&addresses, "above 12"));
    let other = ["its id is `tank-2`, expected `tank-1`", "its id is `tank-1`, expected `tank-2`"];
    session.run(&["run", "tanks.yaml", "--lead", LEAD]).says(1, &[other[0], other[1], "not started"]);
    for log in ["1.log", "2.log"] {
        assert_eq!(sets(&session, log), Vec::<String>::new());
    }
    let named = std::fs::read_to_string(session.path("fleet.yaml")).unwrap();
    let named = named.replace("tank-1:\n", "tank-1:\n    robot_id: tank-2\n");
    let named = named.replace("tank-2:\n", "tank-2:\n    robot_id: tank-1\n");
    session.file("fleet.yaml", named);
    session.run(&["run", "tanks.yaml", "--lead", LEAD]).says(0, &["tanks: done"]);
}

#[test]
fn thrift_robot_sensor_is_read_before_the_mission() {
    let session = session();
    let (_tank, port) = Tank::start(&session, "1.log", 0);
    session.file("fleet.yaml", fleet(&[format!("thrift://127.0.0.1:{port}")], "above 13"));
    session.run(&["preflight", "tanks.yaml"]).says(1, &["battery", "12.5"]);
    session.run(&["fleet", "ping"]).says(0, &["thrift://127.0.0.1:"]);
    assert_eq!(sets(&session, "1.log"), Vec::<String>::new(), "a preflight moves nothing");
}

#[test]
fn missing_thrift_robot_is_named_and_prevents_start() {
    let session = session();
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let (gone, gone_port) = Tank::start(&session, "2.log", 0);
    drop(gone);
    let addresses = [port, gone_port].map(|port| format!("thrift://127.0.0.1:{port}"));
    session.file("fleet.yaml", fleet(&addresses, "above 12"));
    session.run(&["run", "tanks.yaml", "--lead", LEAD]).says(
        1,
        &["not started", "tank-2", "the hardware is not available: no connection to thrift://", "refused"],
    );
    assert_eq!(sets(&session, "1.log"), Vec::<String>::new());
    drop(tank);
}

#[test]
fn edge_survives_robot_restart_but_does_not_resume_the_script() {
    let session = session();
    session.file("tanks.yaml", SCENARIO.replace("600ms, to: 0", "60s, to: 0"));
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
    let plain = format!(
        "robots: {{tank-1: {{init: tank.json, address: 'tcp://127.0.0.1:{}'}}}}\ngroups: {{tanks: [tank-1]}}\n",
        edge.1
    );
    session.file("fleet.yaml", plain);
    edge.await_hardware();
    let running = session
        .command(&["run", "tanks.yaml", "--lead", LEAD])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let running = running.unwrap();
    await_that("the second step", || of("left", &sets(&session, "1.log")).contains(&-20.0));
    drop(tank);
    let ran = stage::session::Ran(running.wait_with_output().unwrap());
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert!(ran.text().contains("the hardware is not available"), "{}", ran.text());
    let (_tank, _) = Tank::start(&session, "2.log", port);
    edge.await_hardware();
    assert_eq!(sets(&session, "2.log"), Vec::<String>::new(), "the restarted robot was moved");
    session.file("tanks.yaml", SCENARIO);
    let ran = session.run(&["run", "tanks.yaml", "--lead", LEAD]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    let (code, said) = edge.end();
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("tank-1: the hardware is available again"), "{said}");
    let sets = sets(&session, "2.log");
    assert_eq!(of("left", &sets), [40.0, -20.0, 0.0], "{sets:?}");
    assert_eq!(of("right", &sets), [0.0, 10.0], "{sets:?}");
}

#[test]
fn edge_reports_devices_it_cannot_bring_to_rest() {
    let session = session();
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
    edge.await_hardware();
    let mut server = server::Server::connected(&edge);
    server.script(1_000, &[(0.0, 40.0), (60_000.0, 5.0)]);
    await_that("the first step", || of("left", &sets(&session, "1.log")).contains(&40.0));
    drop(tank);
    let (code, said) = edge.end();
    assert_eq!(code, Some(4), "{said}");
    assert!(said.contains("the devices of `tank-1` may not be at rest: "), "{said}");
}

#[test]
fn run_names_its_own_hardware_that_may_not_be_at_rest() {
    let session = session();
    session.file("tanks.yaml", SCENARIO.replace("600ms, to: 0", "60s, to: 0"));
    let (tank, port) = Tank::start(&session, "1.log", 0);
    session.file("fleet.yaml", fleet(&[format!("thrift://127.0.0.1:{port}")], "above 12"));
    let mut run = session.command(&["run", "tanks.yaml", "--lead", LEAD]);
    let running = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    await_that("the second step", || of("left", &sets(&session, "1.log")).contains(&-20.0));
    drop(tank);
    let ran = stage::session::Ran(running.wait_with_output().unwrap());
    ran.says(4, &["the devices of `tank-1` may not be at rest: the hardware is not available"]);
}

#[test]
fn edge_moves_nothing_if_its_port_is_in_use() {
    let session = session();
    session.file("drive.sh", DRIVE);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let listen = taken.local_addr().unwrap().to_string();
    let driver = "program:sh drive.sh driven.txt";
    let edge = ["edge", "--init", "tank.json", "--listen", &listen, "--driver", driver];
    session.run(&edge).says(2, &["cannot listen on 127.0.0.1:"]);
    assert!(!session.path("driven.txt").exists(), "the driver was started");
}
