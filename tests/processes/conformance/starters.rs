//! The example robots that users copy: their limits for strangers that send nothing or half a message, reserved places for the owner, and
//! a mission.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use stage::Process;
use stage::session::{Session, root};
use stage::site::listens;

const HALF: &str = "{\"availability_request\":{\"session\"";
const REST: &str = ":\"show\"}}\n";

/// A peer that is connected to the robot.
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

    /// Waits until the robot disconnects, and returns when that happens.
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
    let mut child = robot.stdout(Stdio::piped()).spawn().unwrap();
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

fn python() -> Command {
    let mut python = Command::new(std::env::var("DOWNBEAT_PYTHON").unwrap_or_else(|_| "python3".to_owned()));
    python.env("PYTHONDONTWRITEBYTECODE", "1");
    python
}

/// Both devices hold their values. Their second script begins when the first one ends, but its first value is due 500 ms later.
#[test]
fn starter_robot_in_python_starts_in_sync_if_first_values_are_later() {
    const DEVICES: &str = "
api_version: '1'
reports: true
inquiry: true
pending_until: true
devices:
  - id: shoulder
    name: shoulder servo
    script_queue: 2
    available_control_types:
      position: {min_value: 0, max_value: 90, granularity: 0.5}
      script: {max_number_of_steps: 2}
";
    let session = Session::new();
    let robot = std::fs::read_to_string(root().join("robot/starters/python/robot.py")).unwrap();
    session.file("robot.py", robot.replace("\"max_number_of_steps\": 1000", "\"max_number_of_steps\": 2"));
    let mut child = python().arg(session.path("robot.py")).stdout(Stdio::piped()).spawn().unwrap();
    let said = listens(&mut child);
    let _robot = Process(child);
    let address = said.rsplit(' ').next().unwrap().trim();
    for id in ["arm-1", "arm-2"] {
        session.file(&format!("{id}.yaml"), format!("id: {id}{DEVICES}"));
    }
    session.file(
        "fleet.yaml",
        format!("robots:\n  arm-1: {{init: arm-1.yaml, address: 'tcp://{address}'}}\n  arm-2: {{init: arm-2.yaml, address: sim}}\n"),
    );
    session.file(
        "show.yaml",
        "scenario: show\nstart_tolerance: 200ms\ncues:\n  - {robots: [arm-1, arm-2], tracks: {shoulder: [{at: 0s, to: 45}, {at: 500ms, to: 20}, {at: 1s, to: 30}]}}\n",
    );
    session.play(&["run", "show.yaml"]).says(0, &["show: done", "2/2"]);
}

#[test]
fn starter_robot_in_python_limits_resources_used_by_strangers() {
    let mut robot = python();
    robot.arg(root().join("robot/starters/python/robot.py"));
    check(robot, 16);
}

#[test]
fn starter_robot_in_c_limits_resources_used_by_strangers() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("robot");
    let sources = root().join("robot/starters/c");
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-O1", "-o"]).arg(&program);
    compiler.args(["robot.c", "json.c", "sealed.c", "sha256.c", "-lm"]).current_dir(sources);
    assert!(compiler.status().unwrap().success());
    check(Command::new(program), 6);
}
