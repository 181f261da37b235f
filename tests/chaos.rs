//! Real processes, killed with SIGKILL or stopped with SIGSTOP at random moments: what the journal and the reports say has to
//! agree with what the robots' own logs say. `DOWNBEAT_CHAOS=200` plays so many missions.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test in a binary of its own")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

use std::collections::{BTreeMap, HashSet};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

const PROGRAM: &str = env!("CARGO_BIN_EXE_downbeat");
const ROBOTS: usize = 3;
/// The running lease of the scenario.
const LEASE: Duration = Duration::from_millis(700);

const ARM: &str = "id: arm
api_version: '1'
reports: true
devices:
  - id: shoulder
    name: shoulder servo
    available_control_types:
      position: {min_value: 0, max_value: 90, granularity: 0.5}
      script: {min_value: 0, max_value: 90, granularity: 0.5, max_number_of_steps: 8}
";
const SCENARIO: &str = "scenario: chaos
start_tolerance: 100ms
stop_condition: {running: 700ms}
cues:
  - {at: 0s, robots: arms, tracks: {shoulder: [{at: 0s, to: 10}, {at: 400ms, to: 20}, {at: 800ms, to: 30}, {at: 1200ms, to: 40}]}}
";

#[derive(Clone, Copy, Debug)]
enum Fault {
    KillScheduler { resume: bool },
    StopScheduler(Duration),
    KillRobot(usize),
    StopRobot(usize, Duration),
}

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _reaped = self.0.wait();
    }
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

fn robot(folder: &Path, id: usize) -> (Killed, u16) {
    let mut command = Command::new(PROGRAM);
    command.args(["robot", "--init", "arm.yaml", "--listen", "127.0.0.1:0", "--id", &format!("r{id}")]);
    command.args(["--log-file", &format!("r{id}.jsonl")]).current_dir(folder).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let port = line.trim().rsplit(':').next().unwrap().parse().unwrap();
    (Killed(child), port)
}

fn downbeat(folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(PROGRAM);
    command.args(args).args(["--format", "json", "--patience", "2s"]).current_dir(folder);
    command.env("DOWNBEAT_STATE", folder.join("state")).stdout(Stdio::piped()).stderr(Stdio::null());
    command
}

fn output(mut child: Killed, within: Duration, what: &str) -> Option<Value> {
    let began = Instant::now();
    while child.0.try_wait().unwrap().is_none() {
        assert!(began.elapsed() < within, "{what} hangs");
        std::thread::sleep(Duration::from_millis(10));
    }
    let mut text = String::new();
    child.0.stdout.take().unwrap().read_to_string(&mut text).unwrap();
    serde_json::from_str(&text).ok()
}

/// What a robot set, as far as its log is whole: a killed process may leave a torn last line.
fn log(folder: &Path, id: usize) -> Vec<Value> {
    let text = std::fs::read_to_string(folder.join(format!("r{id}.jsonl"))).unwrap();
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

struct Played {
    fault: Fault,
    /// When the fault began and ended, in nanoseconds since the epoch.
    at: (i64, i64),
    report: Option<Value>,
    logs: Vec<Vec<Value>>,
    journal: Vec<Value>,
}

fn epoch_nanos() -> i64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    i64::try_from(now.as_nanos()).unwrap()
}

fn play(seed: u64) -> Played {
    let mut rng = fastrand::Rng::with_seed(seed);
    let folder = tempfile::TempDir::new().unwrap();
    let path: PathBuf = folder.path().to_path_buf();
    std::fs::write(path.join("arm.yaml"), ARM).unwrap();
    std::fs::write(path.join("chaos.yaml"), SCENARIO).unwrap();
    let mut robots: Vec<_> = (0..ROBOTS).map(|id| robot(&path, id)).collect();
    let rows: String = (0..ROBOTS)
        .map(|id| format!("  r{id}: {{init: arm.yaml, address: \"tcp://127.0.0.1:{}\"}}\n", robots[id].1))
        .collect();
    let fleet = format!("robots:\n{rows}groups:\n  arms: [r0, r1, r2]\n");
    std::fs::write(path.join("fleet.yaml"), fleet).unwrap();
    let fault = match rng.u8(0..5) {
        0 | 1 => Fault::KillScheduler { resume: rng.bool() },
        2 => Fault::StopScheduler(Duration::from_millis(rng.u64(50..1_500))),
        3 => Fault::KillRobot(rng.usize(0..ROBOTS)),
        _ => Fault::StopRobot(rng.usize(0..ROBOTS), Duration::from_millis(rng.u64(50..1_500))),
    };
    let mut scheduler = Killed(downbeat(&path, &["run", "chaos.yaml"]).spawn().unwrap());
    std::thread::sleep(Duration::from_millis(rng.u64(0..1_900)));
    let began = epoch_nanos();
    let mut report = None;
    match fault {
        Fault::KillScheduler { resume } => {
            scheduler.0.kill().unwrap();
            scheduler.0.wait().unwrap();
            if resume {
                std::thread::sleep(Duration::from_millis(rng.u64(0..400)));
                let resumed = Killed(downbeat(&path, &["resume"]).spawn().unwrap());
                report = output(resumed, Duration::from_secs(20), "resume");
            }
        }
        Fault::StopScheduler(lasts) => {
            signal(&scheduler.0, "STOP");
            std::thread::sleep(lasts);
            signal(&scheduler.0, "CONT");
        }
        Fault::KillRobot(id) => {
            robots[id].0.0.kill().unwrap();
            robots[id].0.0.wait().unwrap();
        }
        Fault::StopRobot(id, lasts) => {
            signal(&robots[id].0.0, "STOP");
            std::thread::sleep(lasts);
            signal(&robots[id].0.0, "CONT");
        }
    }
    let ended = epoch_nanos();
    if !matches!(fault, Fault::KillScheduler { .. }) {
        report = output(scheduler, Duration::from_secs(20), "the scheduler");
    }
    // Whatever a lease still allows is over then.
    std::thread::sleep(LEASE + Duration::from_millis(900));
    let logs = (0..ROBOTS).map(|id| log(&path, id)).collect();
    Played { fault, at: (began, ended), report, logs, journal: journal(&path.join("state")) }
}

fn journal(state: &Path) -> Vec<Value> {
    let Ok(entries) = std::fs::read_dir(state) else { return Vec::new() };
    let texts =
        entries.flatten().filter_map(|entry| std::fs::read_to_string(entry.path().join("journal")).ok());
    let lines: Vec<String> =
        texts.flat_map(|text| text.lines().map(str::to_owned).collect::<Vec<_>>()).collect();
    lines.iter().filter_map(|line| serde_json::from_str(line.get(9..)?).ok()).collect()
}

/// What is wrong with a mission.
fn wrong(played: &Played) -> Vec<String> {
    let mut wrong = Vec::new();
    let promised = played.journal.iter().find(|record| record["record"] == "prepared");
    let start = promised.and_then(|record| record["start"].as_str()).map(nanos);
    let lease = promised.map_or(0.0, |record| record["lease_ms"].as_f64().unwrap());
    let sets = |id: usize| played.logs[id].iter().filter(|entry| entry["motion"] == "set");
    let moved: Vec<usize> = (0..ROBOTS).filter(|id| sets(*id).count() > 0).collect();
    if start.is_none() && !moved.is_empty() {
        wrong.push(format!("{moved:?} moved and nothing was promised"));
    }
    if let Some(start) = start.filter(|_| !moved.is_empty() && moved.len() < ROBOTS) {
        let from = start - (lease * 1.2e6) as i64;
        let in_window = played.at.1 >= from && played.at.0 <= start + 100_000_000;
        if !in_window {
            wrong.push(format!("(a) only {moved:?} started, and nothing happened in the window"));
        }
    }
    for id in 0..ROBOTS {
        let mut seen = HashSet::new();
        for entry in sets(id) {
            if !seen.insert((entry["request_id"].to_string(), entry["step"].to_string())) {
                wrong.push(format!("(b) r{id} did a step twice: {entry}"));
            }
            let late = nanos(entry["set_at"].as_str().unwrap()) - nanos(entry["due"].as_str().unwrap());
            if entry["step"] == 0 && late > 60_000_000 {
                wrong.push(format!("(b) r{id} started {} ms late", late / 1_000_000));
            }
            let value = entry["value"].as_f64().unwrap();
            if !(0.0..=90.0).contains(&value) {
                wrong.push(format!("(d) r{id} set {value}"));
            }
        }
    }
    if let Fault::KillScheduler { resume: false } = played.fault {
        let silent = played.at.0 + i64::try_from(LEASE.as_nanos()).unwrap() + 150_000_000;
        for id in 0..ROBOTS {
            if let Some(entry) = sets(id).find(|entry| entry["true_ns"].as_i64().unwrap() > silent) {
                wrong.push(format!("(c) r{id} moved after its lease had run out: {entry}"));
            }
        }
    }
    wrong.extend(lies(played));
    wrong
}

fn nanos(text: &str) -> i64 {
    let at: urrcp::Timestamp<urrcp::Server> = serde_json::from_value(Value::String(text.to_owned())).unwrap();
    at.as_nanos()
}

/// What the report says that the robots' logs do not.
fn lies(played: &Played) -> Vec<String> {
    let Some(report) = &played.report else { return Vec::new() };
    let mut lies = Vec::new();
    let killed = |id: usize| matches!(played.fault, Fault::KillRobot(killed) if killed == id);
    for row in report["robots"].as_array().into_iter().flatten() {
        let id: usize = row["robot"].as_str().unwrap()[1..].parse().unwrap();
        let steps = played.logs[id].iter().filter(|entry| entry["motion"] == "set").count() as u64;
        let said = row["steps_done"].as_u64().unwrap();
        if said > steps && !killed(id) {
            lies.push(format!("(e) r{id} is said to have done {said} steps, and did {steps}"));
        }
        if report["outcome"] == "done" && steps != 4 {
            lies.push(format!("(e) done, and r{id} did {steps} of 4 steps"));
        }
        let sure = row["stop"]["state"] != "unconfirmed" && row["unaccounted"] == 0;
        if report["outcome"] == "not_started" && steps > 0 && sure && !killed(id) {
            lies.push(format!("(e) not started, and r{id} did {steps} steps"));
        }
    }
    lies
}

#[test]
fn whatever_is_killed_or_stopped_the_invariants_hold_and_reports_agree_with_the_robots() {
    let missions: u64 = std::env::var("DOWNBEAT_CHAOS").ok().and_then(|n| n.parse().ok()).unwrap_or(8);
    let next = std::sync::atomic::AtomicU64::new(0);
    let all = std::sync::Mutex::new((Vec::new(), BTreeMap::<String, u32>::new()));
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    if seed >= missions {
                        return;
                    }
                    let played = play(seed);
                    let found = wrong(&played);
                    let outcome =
                        played.report.as_ref().map_or("no report".to_owned(), |r| r["outcome"].to_string());
                    let mut all = all.lock().unwrap();
                    *all.1.entry(outcome).or_default() += 1;
                    all.0.extend(
                        found.into_iter().map(|what| format!("mission {seed}, {:?}: {what}", played.fault)),
                    );
                }
            });
        }
    });
    let (wrong, outcomes) = all.into_inner().unwrap();
    println!("{missions} missions: {outcomes:?}");
    assert!(wrong.is_empty(), "{wrong:#?}");
}
