//! Fleets at keys, the processes that simulate them, and routers.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::robots::{Ended, Logged, Process, Stage, one_device};

/// Steps of the scenario, and the time between two of them.
pub const STEPS: u32 = 40;
pub const EVERY_MS: u32 = 100;

/// A configuration of a member that listens here, so that others can connect to it.
pub fn listening(port: u16) -> String {
    format!("{{mode: \"peer\", listen: {{endpoints: [\"tcp/127.0.0.1:{port}\"]}}}}")
}

/// A configuration of a member that connects there.
pub fn client(port: u16) -> String {
    format!("{{mode: \"client\", connect: {{endpoints: [\"tcp/127.0.0.1:{port}\"]}}}}")
}

/// Robots with these names at keys of one hall, as a fleet file.
pub fn fleet(names: &[String], zenoh: &str) -> String {
    let row = |name: &String| format!("  {name}: {{init: robot.yaml, address: 'zenoh:hall/{name}'}}\n");
    let rows: String = names.iter().map(row).collect();
    format!("zenoh: {zenoh}\nrobots:\n{rows}groups:\n  all: [{}]\n", names.join(", "))
}

pub fn names(first: usize, count: usize) -> Vec<String> {
    (first..first + count).map(|i| format!("r{i}")).collect()
}

/// A folder with a robot and a scenario that all play: 1, 2, 3, and so on, under a running lease. Who fails is left out.
pub fn stage(running: &str) -> Stage {
    stage_where(running, "without")
}

/// The same with this rule for failures.
pub fn stage_where(running: &str, on_failure: &str) -> Stage {
    let stage = Stage::new();
    let track: Vec<_> =
        (0..STEPS).map(|step| format!("{{at: {}ms, to: {}}}", step * EVERY_MS, step + 1)).collect();
    stage.file("robot.yaml", one_device(1, 200, 200));
    stage.file(
        "play.yaml",
        format!(
            "scenario: play\nstart_tolerance: 2s\non_failure: {on_failure}\nstop_condition: {{running: {running}}}\ncues:\n  \
             - {{at: 0s, robots: all, tracks: {{d: [{}]}}}}\n",
            track.join(", ")
        ),
    );
    stage
}

/// A process that simulates the robots of a fleet file, once they all listen.
pub fn simulated(stage: &Stage, fleet: &str, count: usize, args: &[&str]) -> Process {
    let mut command =
        stage.command(&[&["sim", fleet, "--log-file", &format!("{fleet}.jsonl")], args].concat());
    let mut process = Process(command.stderr(Stdio::inherit()).spawn().unwrap());
    let lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
    let listening = lines.map_while(Result::ok).filter(|line| line.contains("listens on zenoh:hall/"));
    assert_eq!(listening.take(count).count(), count, "{fleet}");
    process
}

/// Waits until the journal of the one mission has such a record.
pub fn recorded(stage: &Stage, record: &str) -> Value {
    let began = Instant::now();
    let find = || {
        let missions = std::fs::read_dir(stage.path("state")).ok()?;
        let journals =
            missions.filter_map(|mission| std::fs::read_to_string(mission.ok()?.path().join("journal")).ok());
        let text: String = journals.collect();
        let records = text.lines().filter_map(|line| serde_json::from_str(line.split_once(' ')?.1).ok());
        records.into_iter().find(|found: &Value| found["record"] == record)
    };
    loop {
        if let Some(found) = find() {
            return found;
        }
        assert!(began.elapsed() < Duration::from_secs(90), "the mission never was {record}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// When the one mission is to start, in nanoseconds since the epoch, as soon as its first request may be sent.
pub fn start(stage: &Stage) -> i64 {
    crate::robots::nanos(recorded(stage, "prepared")["start"].as_str().unwrap())
}

/// What every robot of these fleets has set, by its name.
pub fn sets(stage: &Stage, fleets: &[&str]) -> BTreeMap<String, Vec<Logged>> {
    // Logs are written within 50 ms.
    std::thread::sleep(Duration::from_millis(300));
    let mut sets: BTreeMap<String, Vec<Logged>> = BTreeMap::new();
    for fleet in fleets {
        let text = std::fs::read_to_string(stage.path(&format!("{fleet}.jsonl"))).unwrap();
        for line in text.lines().filter_map(Logged::read).filter(|line| line.motion == "set") {
            sets.entry(line.robot.clone()).or_default().push(line);
        }
    }
    sets
}

/// What a report says of each robot that does not agree with its log.
pub fn lies(ended: &Ended, sets: &BTreeMap<String, Vec<Logged>>) -> Vec<String> {
    let report = ended.report();
    let mut lies = Vec::new();
    for row in report["robots"].as_array().unwrap() {
        let name = row["robot"].as_str().unwrap();
        let did = sets.get(name).map_or(0, Vec::len) as u64;
        let said = |key: &str| row[key].as_u64().unwrap_or(0);
        let (done, unaccounted) = (said("steps_done"), said("unaccounted"));
        // What a robot could not tell any more is said to be unknown.
        let agrees = if unaccounted == 0 { did == done } else { did >= done };
        if !agrees || (said("started") == 0 && unaccounted == 0 && did > 0) {
            lies.push(format!("{name} has set {did} values: {row}"));
        }
    }
    lies
}

pub fn outcome(ended: &Ended) -> Value {
    ended.report()["outcome"].clone()
}

/// A router that can be killed and started again.
pub struct Router {
    config: std::path::PathBuf,
    pub port: u16,
    process: Option<Process>,
}

impl Router {
    /// One that connects to others.
    pub fn start(stage: &Stage, name: &str, others: &[u16]) -> Self {
        let port = crate::robots::free_port();
        let others: Vec<_> = others.iter().map(|port| format!("\"tcp/127.0.0.1:{port}\"")).collect();
        let config = format!(
            "{{mode: \"router\", listen: {{endpoints: [\"tcp/127.0.0.1:{port}\"]}}, connect: {{endpoints: [{}]}},\n \
             scouting: {{multicast: {{enabled: false}}, gossip: {{enabled: false}}}}}}",
            others.join(", ")
        );
        Self::of(stage, name, port, config)
    }

    /// One with this configuration, which listens on this port.
    pub fn of(stage: &Stage, name: &str, port: u16, config: String) -> Self {
        let file = format!("{name}.json5");
        stage.file(&file, config);
        let mut router = Self { config: stage.path(&file), port, process: None };
        router.restart();
        router
    }

    pub fn kill(&mut self) {
        self.process = None;
    }

    pub fn restart(&mut self) {
        let zenohd = std::env::var("ZENOHD").unwrap_or_else(|_| "zenohd".to_owned());
        let mut command = Command::new(&zenohd);
        let folder = self.config.parent().unwrap();
        command
            .arg("--config")
            .arg(&self.config)
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let process =
            command.spawn().unwrap_or_else(|error| panic!("{zenohd}: {error}; ZENOHD names the router"));
        self.process = Some(Process(process));
        let began = Instant::now();
        while std::net::TcpStream::connect(("127.0.0.1", self.port)).is_err() {
            assert!(began.elapsed() < Duration::from_secs(30), "the router does not listen");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
