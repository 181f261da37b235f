//! Starts and ends Thrift robots and edges, each as a process of its own.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};

use rustix::process::Signal;
use urrcp::Status;

use super::TANK;
use super::server::Server;
use stage::quiet::await_that;
use stage::session::{Session, root};
use stage::thrift_robot;
use stage::{ended_by_a_hang_up, signal};

/// A Thrift robot, written in Python or in Rust; it ends when this is dropped.
pub enum Tank {
    Python(Child),
    Rust(thrift_robot::ThriftRobot),
}

impl Tank {
    /// Starts a robot with the id `tank-1` that logs to a file of the session. Port 0 stands for any free port. Returns the robot and its
    /// port.
    pub fn start(session: &Session, log: &str, port: u16) -> (Self, u16) {
        Self::start_as("tank-1", session, log, port)
    }

    /// Starts a robot with this id, otherwise like [`Self::start`].
    pub fn start_as(id: &str, session: &Session, log: &str, port: u16) -> (Self, u16) {
        let log = session.path(log);
        let tank = TANK.replace("\"tank-1\"", &format!("\"{id}\""));
        let Some(python) = std::env::var_os("DOWNBEAT_PYTHON") else {
            let robot = thrift_robot::ThriftRobot::start(port, &tank, &log);
            let port = robot.port();
            return (Self::Rust(robot), port);
        };
        let schema = session.path(&format!("{id}.json"));
        std::fs::write(&schema, tank).unwrap();
        let mut command = Command::new(python);
        command
            .arg(root().join("tests/processes/thrift/server.py"))
            .arg(port.to_string())
            .arg(schema)
            .arg(log);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let port = first_line(&mut child).trim().parse().unwrap();
        (Self::Python(child), port)
    }
}

impl Tank {
    /// Freezes the robot: it keeps its connection and does nothing more.
    pub fn freeze(&self) {
        match self {
            Self::Python(child) => signal(child, Signal::STOP),
            Self::Rust(robot) => robot.freeze(),
        }
    }
}

impl Drop for Tank {
    fn drop(&mut self) {
        match self {
            Self::Python(child) => end(child),
            Self::Rust(robot) => robot.stop(),
        }
    }
}

pub fn first_line(child: &mut Child) -> String {
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    line
}

pub fn end(child: &mut Child) {
    let _gone = child.kill();
    let _reaped = child.wait();
}

/// The process of an edge, which is killed when this is dropped, and its port.
pub struct Edge(pub Child, pub u16);

impl Edge {
    pub fn start(session: &Session, init: &str, driver: &str) -> Self {
        Self::start_with(session, init, driver, &[])
    }

    /// Starts an edge with further arguments.
    pub fn start_with(session: &Session, init: &str, driver: &str, args: &[&str]) -> Self {
        let mut command = ended_by_a_hang_up();
        command.args(["edge", "--listen", "127.0.0.1:0", "--init", init, "--driver", driver]);
        // The permissions differ from machine to machine, and are reported.
        command.args(["--realtime", "off"]).args(args);
        command.current_dir(session.path(".")).env("DOWNBEAT_STATE", session.path("state"));
        let command = command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let line = first_line(&mut child);
        let port = line.trim().rsplit(':').next().unwrap().parse();
        let port = port.unwrap_or_else(|_| panic!("no port in `{line}`"));
        Self(child, port)
    }

    /// Waits until the edge's hardware has answered.
    #[track_caller]
    pub fn await_hardware(&self) {
        await_that("an answer of the hardware", || {
            Server::connected(self).availability().status == Status::Ok
        });
    }

    /// Terminates the edge as a service manager does, by SIGTERM. Checks that the exit code is 0 and that nothing is printed.
    pub fn terminate(self) {
        assert_eq!(self.end(), (Some(0), String::new()));
    }

    /// Terminates the edge by SIGTERM, and returns its exit code and its output.
    pub fn end(self) -> (Option<i32>, String) {
        self.ends_by(Signal::TERM)
    }

    pub fn ends_by(mut self, by: Signal) -> (Option<i32>, String) {
        signal(&self.0, by);
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
