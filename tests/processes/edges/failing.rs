//! Hardware that fails shortly before a start, and the edge's reports about the failure.

use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use urrcp::{ErrorCode, Status};

use super::processes::{Edge, Tank};
use super::programs::DRIVE;
use super::server::Server;
use super::{of, session, sets};
use stage::signal;

#[test]
fn hardware_death_just_before_start_is_detected_and_prevents_start() {
    for before in [327, 108, 40] {
        let session = session();
        let (tank, port) = Tank::start(&session, "1.log", 0);
        let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
        edge.await_hardware();
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
fn hardware_freeze_before_start_makes_edge_unready_and_prevents_start() {
    let session = session();
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
    edge.await_hardware();
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
fn suspended_edge_sets_no_stale_values_after_continuing() {
    let session = session();
    let (_tank, port) = Tank::start(&session, "1.log", 0);
    let edge = Edge::start(&session, "tank.json", &format!("thrift://127.0.0.1:{port}"));
    edge.await_hardware();
    let mut server = Server::connected(&edge);
    server.script(1_000, &[(0.0, 40.0), (1_000.0, -20.0), (60_000.0, 5.0)]);
    assert_eq!(server.response().status, Status::Started);
    signal(&edge.0, Signal::STOP);
    std::thread::sleep(Duration::from_secs(2));
    signal(&edge.0, Signal::CONT);
    let failed = server.response();
    assert_eq!(failed.error.map(|error| error.code), Some(ErrorCode::Late));
    assert_eq!(of("left", &sets(&session, "1.log")), [40.0]);
}

#[test]
fn program_death_just_before_start_is_detected_and_prevents_start() {
    let session = session();
    session.file("drive.sh", DRIVE);
    let edge = Edge::start(&session, "tank.json", "program:echo $$ > pid; exec sh drive.sh driven.txt");
    edge.await_hardware();
    let mut server = Server::connected(&edge);
    server.script(1_000, &[(0.0, 40.0), (300.0, -20.0)]);
    server.await_start_less(108);
    let program = std::fs::read_to_string(session.path("pid")).unwrap();
    let program = program.trim().parse().ok().and_then(Pid::from_raw).unwrap();
    kill_process(program, Signal::KILL).unwrap();
    let error = server.fails_unstarted();
    assert_eq!(error.code, ErrorCode::Internal);
    assert!(error.message.contains("driven.txt` has ended"), "{error}");
}
