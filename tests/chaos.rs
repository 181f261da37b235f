//! Real processes, killed with SIGKILL or stopped with SIGSTOP at random moments: what the journal and the reports say has to
//! agree with what the robots' own logs say. `DOWNBEAT_CHAOS=200` plays so many missions.

#![expect(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test in a binary of its own")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod robots;

use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::time::Duration;

use robots::{Logged, Robot, Running, Stage, Via, epoch_nanos, nanos};
use rustix::process::Signal;
use serde_json::Value;

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
start_tolerance: 1s
stop_condition: {running: 700ms}
cues:
  - {at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 10}, {at: 400ms, to: 20}, {at: 800ms, to: 30}, {at: 1200ms, to: 40}]}}
";

#[derive(Clone, Copy, Debug)]
enum Fault {
    KillScheduler { resume: bool },
    StopScheduler(Duration),
    KillRobot(usize),
    StopRobot(usize, Duration),
}

fn downbeat(stage: &Stage, args: &[&str]) -> Running {
    stage.start(&[args, &["--format", "json", "--patience", "2s"]].concat())
}

fn report(running: Running) -> Option<Value> {
    serde_json::from_str(&running.ended().out).ok()
}

struct Played {
    fault: Fault,
    /// When the fault began and ended, in nanoseconds since the epoch.
    at: (i64, i64),
    report: Option<Value>,
    sets: Vec<Vec<Logged>>,
    journal: Vec<Value>,
}

fn play(seed: u64) -> Played {
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut stage = Stage::new();
    stage.file("arm.yaml", ARM).file("chaos.yaml", SCENARIO);
    for _ in 0..ROBOTS {
        stage.robot("arm.yaml", Via::Direct);
    }
    let fault = match rng.u8(0..5) {
        0 | 1 => Fault::KillScheduler { resume: rng.bool() },
        2 => Fault::StopScheduler(Duration::from_millis(rng.u64(50..1_500))),
        3 => Fault::KillRobot(rng.usize(0..ROBOTS)),
        _ => Fault::StopRobot(rng.usize(0..ROBOTS), Duration::from_millis(rng.u64(50..1_500))),
    };
    let mut scheduler = downbeat(&stage, &["run", "chaos.yaml"]);
    std::thread::sleep(Duration::from_millis(rng.u64(0..1_900)));
    let began = epoch_nanos();
    let told = match fault {
        Fault::KillScheduler { resume } => {
            scheduler.process.kill();
            resume.then(|| {
                std::thread::sleep(Duration::from_millis(rng.u64(0..400)));
                downbeat(&stage, &["resume"])
            })
        }
        Fault::StopScheduler(lasts) => {
            scheduler.process.signal(Signal::STOP);
            std::thread::sleep(lasts);
            scheduler.process.signal(Signal::CONT);
            Some(scheduler)
        }
        Fault::KillRobot(id) => {
            stage.robots[id].kill();
            Some(scheduler)
        }
        Fault::StopRobot(id, lasts) => {
            stage.robots[id].freeze();
            std::thread::sleep(lasts);
            stage.robots[id].thaw();
            Some(scheduler)
        }
    };
    let ended = epoch_nanos();
    let report = told.and_then(report);
    // Whatever a lease still allows is over then.
    std::thread::sleep(LEASE + Duration::from_millis(900));
    let sets = stage.robots.iter().map(Robot::sets).collect();
    Played { fault, at: (began, ended), report, sets, journal: journal(&stage.path("state")) }
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
    let moved: Vec<usize> = (0..ROBOTS).filter(|id| !played.sets[*id].is_empty()).collect();
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
        for entry in &played.sets[id] {
            if !seen.insert((&entry.request, entry.step)) {
                wrong.push(format!("(b) r{id} did a step twice: {entry:?}"));
            }
            let late = entry.set_at - entry.due;
            if entry.step == Some(0) && late > 60_000_000 {
                wrong.push(format!("(b) r{id} started {} ms late", late / 1_000_000));
            }
            if !(0.0..=90.0).contains(&entry.value) {
                wrong.push(format!("(d) r{id} set {}", entry.value));
            }
        }
    }
    if let Fault::KillScheduler { resume: false } = played.fault {
        let silent = played.at.0 + i64::try_from(LEASE.as_nanos()).unwrap() + 150_000_000;
        for id in 0..ROBOTS {
            if let Some(entry) = played.sets[id].iter().find(|entry| entry.at > silent) {
                wrong.push(format!("(c) r{id} moved after its lease had run out: {entry:?}"));
            }
        }
    }
    wrong.extend(lies(played));
    wrong
}

/// What the report says that the robots' logs do not.
fn lies(played: &Played) -> Vec<String> {
    let Some(report) = &played.report else { return Vec::new() };
    let mut lies = Vec::new();
    let killed = |id: usize| matches!(played.fault, Fault::KillRobot(killed) if killed == id);
    for row in report["robots"].as_array().into_iter().flatten() {
        let id: usize = row["robot"].as_str().unwrap()[1..].parse().unwrap();
        let steps = played.sets[id].len() as u64;
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
