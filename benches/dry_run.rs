//! Measures the CPU time and peak memory of a dry run: 100 robots play a million steps in ten minutes. Also measures a dry run of half
//! that duration. The baselines are compiling the plan alone, and the bare robot state machines, which play the same scripts without a
//! mission.
//!
//! `cargo bench -p downbeat --bench dry_run`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]
#![expect(clippy::disallowed_methods, reason = "a benchmark waits for its processes")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;
use std::process::{Command as Process, Stdio};
use std::time::Duration;

use downbeat::dry_run::BEGIN;
use downbeat_robot::simulated::{Settings, SimulatedRobot, True};
use downbeat_robot::{Input, LinkId};
use downbeat_scripts::{Choreography, Fleet, Folder, Source};
use rustix::process::{WaitId, WaitIdOptions, waitid};
use urrcp::{Command, ControlRequest, Message, Millis, Timestamp};

const ROBOTS: usize = 100;
/// Time between two steps of a robot.
const STEP_MS: usize = 60;
const MINUTES: usize = 10;
/// Number of clock ticks per second. `/proc` states CPU times in these ticks, which are the same on every Linux system.
const TICKS: f64 = 100.0;

const INIT: &str = r#"id: arm
name: arm
api_version: "1"
reports: true
devices:
  - id: joint
    name: joint
    default_value: 0
    interpolation: linear
    script_queue: 2
    available_control_types:
      position: {min_value: -90, max_value: 90, granularity: 0.001}
      script: {min_value: -90, max_value: 90, granularity: 0.001, max_number_of_steps: 200}
"#;

/// Writes a fleet and a scenario in which every robot makes a step every 60 ms. The values are chosen so that no step can be omitted.
fn generate(folder: &Path, minutes: usize) {
    std::fs::write(folder.join("arm.yaml"), INIT).unwrap();
    let names: Vec<String> = (0..ROBOTS).map(|robot| format!("r{robot}")).collect();
    let mut fleet = "robots:\n".to_owned();
    for name in &names {
        writeln!(fleet, "  {name}: {{init: arm.yaml, address: sim}}").unwrap();
    }
    writeln!(fleet, "groups: {{all: [{}]}}", names.join(", ")).unwrap();
    std::fs::write(folder.join("fleet.yaml"), fleet).unwrap();
    let mut rng = fastrand::Rng::with_seed(1);
    let mut samples = "time,value\n".to_owned();
    for step in 0..minutes * 60_000 / STEP_MS {
        let at = (step * STEP_MS) as f64 / 1e3;
        writeln!(samples, "{at:.3},{:.3}", rng.f64() * 4.0 - 2.0).unwrap();
    }
    std::fs::write(folder.join("samples.csv"), samples).unwrap();
    let scenario = "scenario: long\nfleet: fleet.yaml\ncues:\n  - robots: all\n    canon: 1ms\n    tracks:\n      \
                    joint: {samples: {file: samples.csv, time: time, value: value}}\n";
    std::fs::write(folder.join("long.yaml"), scenario).unwrap();
}

fn compiled(folder: &Path) -> (Choreography, Fleet) {
    let source = Source::read(&folder.join("long.yaml")).unwrap();
    let (fleet, _) = downbeat_scripts::read_fleet(&folder.join("fleet.yaml"));
    let fleet = fleet.unwrap();
    let compiled = downbeat_scripts::compile(&source, &fleet, &Folder::new(folder.to_path_buf()));
    (compiled.choreography.unwrap(), fleet)
}

/// Plays the scripts on the robot state machines alone, without a mission, leases or a listener. Each script is sent 200 ms before its
/// start.
fn bare_robots(folder: &Path) {
    let (choreography, fleet) = compiled(folder);
    let begin: Timestamp<True> = BEGIN.assume_clock();
    let mut machines = Vec::new();
    let (mut agenda, mut dues) = (BTreeSet::new(), Vec::new());
    let mut sends = BTreeSet::new();
    let plan = &choreography.acts[0].plan;
    for (index, planned) in plan.robots.iter().enumerate() {
        let block = fleet.robots.iter().find(|robot| robot.id == planned.robot).unwrap().init.clone();
        machines.push(SimulatedRobot::new(block.unwrap(), Settings::default()));
        agenda.insert((begin, index));
        dues.push(Some(begin));
        let scripts = planned.scripts.iter().enumerate();
        sends.extend(scripts.map(|(nth, script)| (begin + script.start.span(), index, nth)));
    }
    let mut out = Vec::new();
    let mut steps = 0;
    loop {
        let sent = sends.first().map(|(at, index, nth)| (*at, *index, *nth));
        let due = agenda.first().copied();
        let (now, index) = match (sent, due) {
            (Some((at, index, nth)), due) if due.is_none_or(|(due, _)| at <= due) => {
                sends.pop_first();
                let script = &plan.robots[index].scripts[nth];
                let command = Command::Script(script.script.clone());
                let mut request = ControlRequest::immediate(script.device.clone(), command);
                request.timestamp = Some(at.assume_clock());
                request.time_offset_to_start = Some(Millis::new(200.0).unwrap());
                let message = Input::Message(Message::ControlRequest(request));
                machines[index].receive(at, LinkId(0), message);
                (at, index)
            }
            (_, Some(due)) => due,
            (_, None) => break,
        };
        machines[index].advance(now, &mut out);
        out.clear();
        steps += machines[index].take_log().len();
        let next = machines[index].next_wakeup();
        if let Some(known) = std::mem::replace(&mut dues[index], next) {
            agenda.remove(&(known, index));
        }
        agenda.extend(next.map(|at| (at, index)));
    }
    println!("{steps} steps");
}

/// Runs a program, which must succeed. Returns its CPU time in seconds and its peak resident memory in megabytes.
fn measure(program: &Path, arguments: &[&str]) -> (f64, f64) {
    let mut child =
        Process::new(program).args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let proc = Path::new("/proc").join(child.id().to_string());
    let pid = rustix::process::Pid::from_child(&child);
    let mut peak = 0.0_f64;
    // A zombie process still reports its CPU times, but no memory.
    let ended = || {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOWAIT | WaitIdOptions::NOHANG;
        waitid(WaitId::Pid(pid), options).unwrap().is_some()
    };
    while !ended() {
        let status = std::fs::read_to_string(proc.join("status")).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
        peak = peak.max(kilobytes.unwrap_or(0.0) / 1e3);
        std::thread::sleep(Duration::from_millis(2));
    }
    let stat = std::fs::read_to_string(proc.join("stat")).unwrap();
    // The program name is in parentheses and may contain spaces. utime and stime are fields 14 and 15.
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    let ticks: f64 = fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap();
    assert!(child.wait().unwrap().success(), "{} {arguments:?}", program.display());
    (ticks / TICKS, peak)
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, role, folder] = &arguments[..]
        && role == "robots"
    {
        return bare_robots(Path::new(folder));
    }
    let downbeat = Path::new(env!("CARGO_BIN_EXE_downbeat"));
    let itself = std::env::current_exe().unwrap();
    println!("{:<28} {:>16} {:>16} {:>7}", "100 robots, a step a 60 ms", "5 minutes", "10 minutes", "ratio");
    let mut rows = Vec::new();
    let folders: Vec<_> = [MINUTES / 2, MINUTES]
        .into_iter()
        .map(|minutes| {
            let folder = tempfile::tempdir().unwrap();
            generate(folder.path(), minutes);
            folder
        })
        .collect();
    for name in ["plan", "robots", "dry-run"] {
        let of = |folder: &tempfile::TempDir| {
            let scenario = folder.path().join("long.yaml");
            match name {
                "robots" => measure(&itself, &["robots", folder.path().to_str().unwrap()]),
                command => measure(downbeat, &[command, scenario.to_str().unwrap()]),
            }
        };
        let (half, whole) = (of(&folders[0]), of(&folders[1]));
        let text = |(cpu, memory): (f64, f64)| format!("{cpu:.2} s {memory:>4.0} MB");
        println!("{name:<28} {:>16} {:>16} {:>7.2}", text(half), text(whole), whole.0 / half.0.max(0.01));
        rows.push(whole);
    }
    let (plan, robots, dry_run) = (rows[0], rows[1], rows[2]);
    println!(
        "dry run / bare robots: {:.2} times the CPU time, {:.2} times the memory; dry run - plan: {:.2} s, {:.0} MB",
        dry_run.0 / robots.0.max(0.01),
        dry_run.1 / robots.1.max(1.0),
        dry_run.0 - plan.0,
        dry_run.1 - plan.1
    );
}
