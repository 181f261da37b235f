//! One robot with keys, and operators that drive it, stop it and seize it from each other.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Stdio};

use crate::session::{Ran, Session};

/// Runs the commands of operators that control one robot.
pub struct Operators<'a> {
    session: &'a Session,
    robot: &'a str,
}

impl<'a> Operators<'a> {
    /// Requests the robot's description as the operator `asking`, and writes it and a fleet file that refers to it.
    pub fn of(session: &'a Session, robot: &'a str, address: &str, asking: &str) -> Self {
        let own = Self { session, robot };
        session.file(&format!("{robot}.yaml"), own.by(asking, &["fleet", "describe", address]).out());
        own.fleet(address);
        own
    }

    /// Writes the fleet file, which contains the robot at this address.
    pub fn fleet(&self, address: &str) {
        let robot = self.robot;
        let fleet = format!("robots: {{{robot}: {{init: {robot}.yaml, address: '{address}'}}}}\n");
        self.session.file("fleet.yaml", fleet);
    }

    /// Runs a command as an operator and returns its result.
    pub fn by(&self, operator: &str, args: &[&str]) -> Ran {
        let mut command = self.session.command(args);
        Ran(command.env("DOWNBEAT_IDENTITY", format!("keys/operators/{operator}.pem")).output().unwrap())
    }

    /// Writes a scenario for the robot, with two keyframes: the first after 100 ms, and the second at the time `last`.
    pub fn scenario(&self, name: &str, last: &str) {
        let track = format!("shoulder: [{{at: 100ms, to: 45}}, {{at: {last}, to: 0}}]");
        let cue = format!("{{at: 0s, robots: {}, tracks: {{{track}}}}}", self.robot);
        let text = format!("scenario: {name}\nstart_tolerance: 1s\ncues: [{cue}]\n");
        self.session.file(&format!("{name}.yaml"), text);
    }

    /// Starts an operator's mission. Returns once the robot has accepted the mission's scripts.
    pub fn playing(&self, operator: &str, scenario: &str) -> Child {
        let mut command = self.session.command(&["run", scenario]);
        command.env("DOWNBEAT_IDENTITY", format!("keys/operators/{operator}.pem"));
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(child.stderr.as_mut().unwrap()).lines().map_while(Result::ok);
        said.find(|line| line.contains("all robots have accepted")).unwrap();
        child
    }
}

/// Checks that a running mission ends without success, and that its report contains `words`.
#[track_caller]
pub fn fails_with(mut playing: Child, words: &str) {
    let mut report = String::new();
    playing.stdout.as_mut().unwrap().read_to_string(&mut report).unwrap();
    assert!(report.contains(words), "{report}");
    assert!(!playing.wait().unwrap().success(), "{report}");
}
