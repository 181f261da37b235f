//! The robots to copy among strangers: connections that say nothing, or half a message, and the places of the owner.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use stage::Process;
use stage::session::root;
use stage::site::listens;

const HALF: &str = "{\"availability_request\":{\"session\"";
const REST: &str = ":\"show\"}}\n";

/// A peer of the robot.
struct Peer(TcpStream);

impl Peer {
    fn new(address: &str) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Self(stream)
    }

    fn says(mut self, text: &str) -> Self {
        self.0.write_all(text.as_bytes()).unwrap();
        self
    }

    fn told_ok(mut self) -> Self {
        let mut bytes = [0; 4096];
        let read = self.0.read(&mut bytes).unwrap();
        let told = String::from_utf8_lossy(&bytes[..read]);
        assert!(told.contains("\"OK\""), "{told}");
        self
    }

    /// When the robot hangs up.
    fn ended(mut self) -> Instant {
        loop {
            match self.0.read(&mut [0; 4096]) {
                Ok(1..) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    panic!("the robot does not hang up")
                }
                Ok(0) | Err(_) => return Instant::now(),
            }
        }
    }

    fn stays_open(mut self) -> bool {
        self.0.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        match self.0.read(&mut [0; 1]) {
            Err(error) => matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
            Ok(read) => read > 0,
        }
    }
}

#[track_caller]
fn check(mut robot: Command, strangers_max: usize) {
    let mut child = robot.env("PYTHONDONTWRITEBYTECODE", "1").stdout(Stdio::piped()).spawn().unwrap();
    let said = listens(&mut child);
    let _robot = Process(child);
    let address = said.rsplit(' ').next().unwrap().trim();
    let began = Instant::now();
    let silent = Peer::new(address);
    let half = Peer::new(address).says("{\"availability_request\":{}}\n").told_ok().says(HALF);
    let owner = Peer::new(address).says(&format!("{HALF}{REST}")).told_ok().says(HALF);
    for (peer, seconds) in [(silent, 5), (half, 10)] {
        let took = peer.ended() - began;
        let limit = Duration::from_secs(seconds);
        assert!(took >= limit && took < limit + Duration::from_secs(30), "{took:?}, not {limit:?}");
    }
    let owner = owner.says(REST).told_ok();
    let strangers: Vec<_> = (0..40).map(|_| Peer::new(address)).collect();
    owner.says(&format!("{HALF}{REST}")).told_ok();
    Peer::new(address).says(&format!("{HALF}{REST}")).told_ok();
    let open = strangers.into_iter().map(Peer::stays_open).filter(|open| *open).count();
    assert!(open < strangers_max && open > 0, "{open} strangers");
}

#[test]
fn the_robot_to_copy_in_python_bounds_what_strangers_cost() {
    let python = std::env::var("DOWNBEAT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut robot = Command::new(python);
    robot.arg(root().join("robot/starters/python/robot.py"));
    check(robot, 16);
}

#[test]
fn the_robot_to_copy_in_c_bounds_what_strangers_cost() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("robot");
    let sources = root().join("robot/starters/c");
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-O1", "-o"]).arg(&program);
    compiler.args(["robot.c", "json.c", "sealed.c", "sha256.c", "-lm"]).current_dir(sources);
    assert!(compiler.status().unwrap().success());
    check(Command::new(program), 6);
}
