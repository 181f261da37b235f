//! Fleets of robots that are addressed by Zenoh keys, the processes that simulate them, and routers.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde_json::Value;

use stage::{Ended, Logged, Process, Stage, one_device};

/// Number of steps in the scenario; `EVERY_MS` is the time between them.
pub const STEPS: u32 = 40;
pub const EVERY_MS: u32 = 100;

/// Returns the configuration of a Zenoh member that listens on this port, so that others can connect to it.
pub fn listening(port: u16) -> String {
    format!("{{mode: \"peer\", listen: {{endpoints: [\"tcp/127.0.0.1:{port}\"]}}}}")
}

/// Returns the configuration of a Zenoh member that connects to this port.
pub fn client(port: u16) -> String {
    format!("{{mode: \"client\", connect: {{endpoints: [\"tcp/127.0.0.1:{port}\"]}}}}")
}

/// Returns a fleet file of robots with these names, each at the Zenoh key `hall/NAME`. `zenoh` is the configuration file.
pub fn fleet(names: &[String], zenoh: &str) -> String {
    let row = |name: &String| format!("  {name}: {{init: robot.yaml, address: 'zenoh:hall/{name}'}}\n");
    let rows: String = names.iter().map(row).collect();
    format!("zenoh: {zenoh}\nrobots:\n{rows}groups:\n  all: [{}]\n", names.join(", "))
}

pub fn names(first: usize, count: usize) -> Vec<String> {
    (first..first + count).map(|i| format!("r{i}")).collect()
}

/// Returns a stage with a scenario in which all robots play 1, 2, 3, and so on, with this running lease. Robots that fail are left out.
pub fn stage(running: &str) -> Stage {
    stage_where(running, "without")
}

/// Like [`stage`], with the `on_failure` setting of the scenario.
pub fn stage_where(running: &str, on_failure: &str) -> Stage {
    stage_of(running, on_failure, STEPS, EVERY_MS)
}

/// Like [`stage_where`], with this number of steps and this time between them.
pub fn stage_of(running: &str, on_failure: &str, steps: u32, every_ms: u32) -> Stage {
    let stage = Stage::new();
    let track = track(steps, every_ms, 100);
    // On a busy machine, long scripts take longer to send than the measured link times suggest.
    let (lead, pending) = if steps > STEPS { ("lead: 4s\n", "pending: 2s, ") } else { ("", "") };
    stage.file("robot.yaml", one_device(1, 200, steps.max(200)));
    stage.file(
        "play.yaml",
        format!(
            "scenario: play\nstart_tolerance: 2s\n{lead}on_failure: {on_failure}\nstop_condition: {{{pending}running: {running}}}\ncues:\n  \
             - {{at: 0s, robots: all, tracks: {{d: [{track}]}}}}\n"
        ),
    );
    stage
}

/// Returns a YAML track that rises by 1 with every step up to `top`, then falls by 1 with every step, and so on.
pub fn track(steps: u32, every_ms: u32, top: u32) -> String {
    let value = |step: u32| 1 + (step % (2 * top)).min(2 * top - step % (2 * top));
    let keyframe = |step: u32| format!("{{at: {}ms, to: {}}}", step * every_ms, value(step));
    (0..steps).map(keyframe).collect::<Vec<_>>().join(", ")
}

/// Starts a process that simulates the robots of a fleet file, and returns it when all `count` robots listen.
pub fn simulated(stage: &Stage, fleet: &str, count: usize, args: &[&str]) -> Process {
    let mut command =
        stage.command(&[&["sim", fleet, "--log-file", &format!("{fleet}.jsonl")], args].concat());
    let mut process = Process(command.stderr(Stdio::inherit()).spawn().unwrap());
    let lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
    let listening = lines.map_while(Result::ok).filter(|line| line.contains("listens on zenoh:hall/"));
    assert_eq!(listening.take(count).count(), count, "{fleet}");
    process
}

/// Waits until the journal of the only mission contains a record of this kind, and returns the record.
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

/// Waits until the only mission plans its start, just before it sends requests. Returns that start, in nanoseconds since the epoch.
pub fn start(stage: &Stage) -> i64 {
    stage::nanos(recorded(stage, "prepared")["start"].as_str().unwrap())
}

/// Returns, by the name of the robot, the values that each robot of these fleets has set.
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

/// Returns the robots whose rows in the report contradict their logs, with the number of logged values and the row.
pub fn lies(ended: &Ended, sets: &BTreeMap<String, Vec<Logged>>) -> Vec<String> {
    let report = ended.report();
    let mut lies = Vec::new();
    for row in report["robots"].as_array().unwrap() {
        let name = row["robot"].as_str().unwrap();
        let did = sets.get(name).map_or(0, Vec::len) as u64;
        let said = |key: &str| row[key].as_u64().unwrap_or(0);
        let (done, unaccounted) = (said("steps_done"), said("unaccounted"));
        // The report marks steps that a robot could no longer report as unaccounted.
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

/// A relay to a port, which counts the steps of scripts that the connecting side sends.
pub struct Relay {
    pub port: u16,
    steps: Arc<AtomicU64>,
}

/// Text that occurs exactly once in each step in JSON, and nowhere outside steps.
const IN_A_STEP: &[u8] = b"\"position\"";

impl Relay {
    /// Starts a relay to this port. Its threads end with their connections.
    pub fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let relay = Self { port: listener.local_addr().unwrap().port(), steps: Arc::default() };
        let counted = Arc::clone(&relay.steps);
        std::thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(("127.0.0.1", port)) else { continue };
                for (from, to, counted) in
                    [(&near, &far, Arc::clone(&counted)), (&far, &near, Arc::default())]
                {
                    let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    std::thread::spawn(move || carry(from, to, &counted));
                }
            }
        });
        relay
    }

    /// Returns the number of steps that the relay has recognised. It misses steps that Zenoh splits into fragments.
    pub fn steps(&self) -> u64 {
        self.steps.load(Ordering::Relaxed)
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, counted: &AtomicU64) {
    let (mut bytes, mut searched) = (vec![0; 64 * 1024], Vec::<u8>::new());
    to.set_nodelay(true).unwrap();
    while let Ok(came @ 1..) = from.read(&mut bytes) {
        searched.extend(&bytes[..came]);
        let steps = searched.windows(IN_A_STEP.len()).filter(|found| *found == IN_A_STEP).count();
        counted.fetch_add(steps as u64, Ordering::Relaxed);
        searched.drain(..searched.len().saturating_sub(IN_A_STEP.len() - 1));
        if to.write_all(&bytes[..came]).is_err() {
            break;
        }
    }
    let _gone = to.shutdown(Shutdown::Both);
}

/// A Zenoh router that can be killed and restarted.
pub struct Router {
    config: std::path::PathBuf,
    pub port: u16,
    process: Option<Process>,
}

impl Router {
    /// Starts a router that connects to the routers at the ports `others`.
    pub fn start(stage: &Stage, name: &str, others: &[u16]) -> Self {
        let port = stage::free_port();
        let others: Vec<_> = others.iter().map(|port| format!("\"tcp/127.0.0.1:{port}\"")).collect();
        let config = format!(
            "{{mode: \"router\", listen: {{endpoints: [\"tcp/127.0.0.1:{port}\"]}}, connect: {{endpoints: [{}]}},\n \
             scouting: {{multicast: {{enabled: false}}, gossip: {{enabled: false}}}}}}",
            others.join(", ")
        );
        Self::of(stage, name, port, config)
    }

    /// Starts a router with this configuration, which listens on this port.
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
        while TcpStream::connect(("127.0.0.1", self.port)).is_err() {
            assert!(began.elapsed() < Duration::from_secs(30), "the router does not listen");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
