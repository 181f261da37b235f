//! Six robot processes, and the starts in their logs.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use downbeat::link::{Endpoint, LinkEncoding, Security};
use tempfile::TempDir;

use super::ROBOTS;
use super::figures::{Round, Start};

/// Starts that are at least this far apart belong to different missions.
const BETWEEN_MISSIONS_NS: i64 = 100_000_000;

/// Initialization block of each robot.
pub const ROBOT: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "d", "name": "d", "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 1},
     "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 8}}}]}"#;

/// Command-line settings of the robot processes in a fleet.
#[derive(Clone, Copy)]
pub struct Settings {
    pub delay: &'static str,
    pub ntp_error: &'static str,
    pub realtime: &'static str,
}

/// Robot processes, which are killed on drop.
pub struct Fleet {
    folder: TempDir,
    robots: Vec<Child>,
    ports: Vec<u16>,
}

impl Fleet {
    pub fn start(settings: Settings) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("robot.json"), ROBOT).unwrap();
        let mut fleet = Self { folder, robots: Vec::new(), ports: Vec::new() };
        for id in 0..ROBOTS {
            let mut command = Command::new(env!("CARGO_BIN_EXE_downbeat"));
            command.args(["robot", "--listen", "127.0.0.1:0", "--id", &format!("r{id}"), "--init"]);
            command.arg(fleet.folder.path().join("robot.json")).arg("--log-file").arg(fleet.log(id));
            command.args(["--clock-offset", &format!("{}ms", id * 60), "--ntp-error", settings.ntp_error]);
            command.args(["--delay-max", settings.delay, "--seed", &id.to_string()]);
            command.args(["--realtime", settings.realtime]);
            let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
            let mut line = String::new();
            BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
            fleet.ports.push(line.trim().rsplit(':').next().unwrap().parse().unwrap());
            fleet.robots.push(child);
        }
        fleet
    }

    fn log(&self, id: usize) -> PathBuf {
        self.folder.path().join(format!("r{id}.jsonl"))
    }

    pub fn endpoint(&self, id: usize) -> Endpoint {
        Endpoint::Tcp {
            host: "127.0.0.1".into(),
            port: self.ports[id],
            encoding: LinkEncoding::default(),
            security: Security::Plain,
        }
    }

    /// Returns the starts of a robot's scripts, from its log.
    fn starts(&self, id: usize) -> Vec<Start> {
        let log = std::fs::read_to_string(self.log(id)).unwrap();
        let entries = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
        let first = entries.filter(|entry| entry["motion"] == "set" && entry["step"] == 0);
        let at = |time: &serde_json::Value| {
            let time = chrono::DateTime::parse_from_rfc3339(time.as_str().unwrap()).unwrap();
            time.timestamp_nanos_opt().unwrap()
        };
        first
            .map(|entry| Start {
                true_ns: entry["true_ns"].as_i64().unwrap(),
                late_ns: at(&entry["set_at"]) - at(&entry["due"]),
            })
            .collect()
    }

    /// Returns the starts of each mission in which all robots started.
    pub fn rounds(&self) -> Vec<Round> {
        let mut starts: Vec<_> = (0..ROBOTS).flat_map(|id| self.starts(id)).collect();
        starts.sort_by_key(|start| start.true_ns);
        let missions = starts.chunk_by(|a, b| b.true_ns - a.true_ns < BETWEEN_MISSIONS_NS);
        missions.filter(|starts| starts.len() == ROBOTS).map(<[Start]>::to_vec).collect()
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
