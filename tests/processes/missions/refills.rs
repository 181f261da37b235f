//! Chains of scripts that are longer than a device's queue, in several acts. Every value of every script is set once and in order, in the
//! first act as in later ones, however many scripts the earlier acts have.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::Value;

use stage::play::{CHAIN, Play};
use stage::{Stage, Via};

/// Number of steps of one script.
const STEPS: u32 = 4;
const ACTS: usize = 3;
/// Number of devices of one robot.
const DEVICES: usize = 8;

/// Number of scripts of a device, for each act.
type Chains = [u32; ACTS];

/// Whether the robots report the progress of their scripts.
#[derive(Clone, Copy)]
enum Reports {
    Told,
    Untold,
}

/// A show of three acts of the same length. Each device has scripts for the whole length of each act.
struct Matrix {
    queue: u32,
    /// Length of an act, in milliseconds: the shortest for which `check` permits a chain of four scripts that the device receives in
    /// parts.
    act: u32,
    reports: Reports,
    chains: Vec<Chains>,
}

/// Returns the length of the shortest act, in milliseconds, for which `check` permits four scripts on a device with this queue.
fn shortest_act(queue: u32) -> u32 {
    match queue {
        2 => 4_032,
        3 => 2_016,
        _ => 960,
    }
}

fn all_chains() -> Vec<Chains> {
    let counts = || 1..=4_u32;
    counts().flat_map(|a| counts().flat_map(move |b| counts().map(move |c| [a, b, c]))).collect()
}

impl Matrix {
    fn of(queue: u32, reports: Reports, chains: Vec<Chains>) -> Self {
        Self { queue, act: shortest_act(queue), reports, chains }
    }

    fn init(&self) -> String {
        let reports = matches!(self.reports, Reports::Told);
        let device = |d: usize| {
            format!(
                "  - id: d{d}
    name: d{d}
    script_queue: {}
    available_control_types:
      position: {{min_value: 0, max_value: 90, granularity: 0.5}}
      script: {{min_value: 0, max_value: 90, granularity: 0.5, max_number_of_steps: {STEPS}}}
",
                self.queue
            )
        };
        let devices: String = (0..DEVICES).map(device).collect();
        format!("id: robot\napi_version: '1'\nreports: {reports}\ndevices:\n{devices}")
    }

    /// Returns the devices of a robot, each with the number of its scripts in each act.
    fn of_robot(&self, robot: usize) -> impl Iterator<Item = (String, Chains)> {
        let chains = self.chains.iter().skip(robot * DEVICES).take(DEVICES);
        chains.enumerate().map(|(d, chains)| (format!("d{d}"), *chains))
    }

    fn robots(&self) -> usize {
        self.chains.len().div_ceil(DEVICES)
    }

    fn scenario(&self) -> String {
        let mut text = "scenario: refills\nstart_tolerance: 1s\nacts:\n".to_owned();
        for act in 0..ACTS {
            text.push_str(&format!("  - act: act-{act}\n    cues:\n"));
            for robot in 0..self.robots() {
                text.push_str(&format!("      - robots: r{robot}\n        at: 0s\n        tracks:\n"));
                for (device, chains) in self.of_robot(robot) {
                    text.push_str(&format!("          {device}: [{}]\n", self.track(act, chains[act])));
                }
            }
        }
        text
    }

    fn track(&self, act: usize, scripts: u32) -> String {
        let spacing = self.act / (STEPS * scripts);
        let keyframe = |(k, value)| format!("{{at: {}ms, to: {value}}}", k * spacing);
        (0..).zip(values(act, scripts)).map(keyframe).collect::<Vec<_>>().join(", ")
    }

    fn stage(&self) -> Stage {
        let mut stage = Stage::new();
        stage.file("robot.yaml", self.init()).file("refills.yaml", self.scenario());
        for _ in 0..self.robots() {
            stage.robot("robot.yaml", Via::Direct);
        }
        stage
    }

    /// Returns the devices whose logged values differ from the plan, each with a description of the difference.
    fn deviations(&self, stage: &Stage) -> BTreeMap<String, String> {
        let mut deviations = BTreeMap::new();
        for robot in 0..self.robots() {
            for (device, chains) in self.of_robot(robot) {
                let planned: Vec<f64> = (0..ACTS).flat_map(|act| values(act, chains[act])).collect();
                let set = stage.robots[robot].values(&device);
                if set != planned {
                    let text = format!("{chains:?} scripts: {} of {} values", set.len(), planned.len());
                    deviations.insert(format!("r{robot}/{device}"), text);
                }
            }
        }
        deviations
    }

    #[track_caller]
    fn plays_to_the_end(&self) {
        let stage = self.stage();
        let ran = stage.run(&["run", "refills.yaml", "--format", "json"]);
        let deviations = self.deviations(&stage);
        let all = deviations.len();
        let some: Vec<_> = deviations.into_iter().take(4).collect();
        assert!(
            some.is_empty() && ran.code == Some(0),
            "queue {}, {all} devices otherwise than planned: {some:#?}\n{ran}",
            self.queue
        );
        self.is_reported(&ran.report());
    }

    #[track_caller]
    fn is_rehearsed(&self) {
        let stage = Stage::new();
        let robots = (0..self.robots()).map(|id| format!("  r{id}: {{init: robot.yaml, address: sim}}\n"));
        stage.file("fleet.yaml", format!("robots:\n{}", robots.collect::<String>()));
        stage.file("robot.yaml", self.init()).file("refills.yaml", self.scenario());
        let ran = stage.run(&["dry-run", "refills.yaml", "--format", "json"]);
        assert_eq!(ran.code, Some(0), "queue {}: {ran}", self.queue);
        self.is_reported(&ran.report());
    }

    #[track_caller]
    fn is_reported(&self, report: &Value) {
        assert_eq!(report["outcome"], "done");
        for robot in 0..self.robots() {
            let scripts: u32 = self.of_robot(robot).map(|(_, chains)| chains.iter().sum::<u32>()).sum();
            let row = &report["robots"][robot];
            assert_eq!(row["steps_done"], scripts * STEPS, "{row:#}");
            assert_eq!(row["started"], scripts, "{row:#}");
            assert_eq!(row["unaccounted"], 0, "{row:#}");
        }
    }
}

/// Returns the values that a device with this number of scripts sets in an act. No value occurs twice in a show.
fn values(act: usize, scripts: u32) -> impl Iterator<Item = f64> {
    let first = 1 + 30 * u32::try_from(act).unwrap();
    (first..first + STEPS * scripts).map(f64::from)
}

#[test]
fn every_chain_completes_on_devices_that_hold_two_scripts() {
    Matrix::of(2, Reports::Told, all_chains()).plays_to_the_end();
}

#[test]
fn every_chain_completes_on_devices_that_hold_three_scripts() {
    Matrix::of(3, Reports::Told, all_chains()).plays_to_the_end();
}

#[test]
fn every_chain_completes_on_devices_that_hold_four_scripts() {
    Matrix::of(4, Reports::Told, all_chains()).plays_to_the_end();
}

/// If all devices have the same chains, the next act is sent as soon as the devices have room. It need not wait for the slowest of many
/// different devices.
#[test]
fn fleet_with_identical_chains_on_all_devices_plays_to_its_end() {
    let alone: [(u32, Chains); 8] = [
        (2, [2, 2, 2]),
        (2, [1, 2, 1]),
        (2, [3, 2, 4]),
        (2, [3, 3, 3]),
        (2, [1, 4, 2]),
        (3, [2, 2, 3]),
        (3, [4, 3, 3]),
        (4, [3, 3, 4]),
    ];
    std::thread::scope(|scope| {
        let play =
            |(queue, chains)| move || Matrix::of(queue, Reports::Told, vec![chains; 2]).plays_to_the_end();
        let playing: Vec<_> = alone.into_iter().map(|one| scope.spawn(play(one))).collect();
        let failed = playing.into_iter().filter_map(|playing| playing.join().err()).count();
        assert_eq!(failed, 0, "fleets that did not play to the end");
    });
}

#[test]
fn dry_run_plays_every_chain_like_a_real_run() {
    (2..=4).for_each(|queue| Matrix::of(queue, Reports::Told, all_chains()).is_rehearsed());
}

#[test]
fn dry_run_plays_identical_chains_on_all_devices_like_a_real_run() {
    for queue in 2..=4 {
        all_chains()
            .into_iter()
            .for_each(|one| Matrix::of(queue, Reports::Told, vec![one; 2]).is_rehearsed());
    }
}

#[test]
fn robots_without_reports_receive_all_scripts_and_no_false_done_outcome() {
    let chains = vec![[3, 3, 3], [1, 2, 4], [4, 1, 3], [2, 2, 2]];
    let matrix = Matrix::of(2, Reports::Untold, chains);
    let stage = matrix.stage();
    let ran = stage.run(&["run", "refills.yaml", "--format", "json"]);
    let deviations = matrix.deviations(&stage);
    assert!(deviations.is_empty(), "{deviations:#?}\n{ran}");
    let outcome = &ran.report()["outcome"];
    assert!(outcome == "done" || outcome == "unknown", "{ran}");
    assert_eq!(outcome == "done", ran.code == Some(0), "{ran}");
}

#[test]
fn mission_is_not_done_if_robots_without_reports_miss_a_value() {
    let matrix = Matrix::of(2, Reports::Untold, vec![[4, 4, 4]]);
    let mut stage = matrix.stage();
    let running = stage.begin(&["run", "refills.yaml", "--format", "json"], [0], 6);
    stage.restart(0);
    let ran = running.ended();
    assert!(!matrix.deviations(&stage).is_empty(), "it was to miss values");
    assert!(ran.code != Some(0) && ran.report()["outcome"] != "done", "{ran}");
}

#[test]
fn link_too_slow_for_chained_scripts_is_refused_before_any_movement() {
    let chain = Play { steps: 12, every_ms: 260, script: 4, tolerance: "3s", ..CHAIN };
    let stage = chain.stage(&[Via::Proxy, Via::Direct]);
    stage.robots[0].link.as_ref().unwrap().delay(Duration::from_millis(600));
    let ended = stage.run(&["run", "play.yaml", "--patience", "60s", "--format", "json"]);
    assert_eq!(ended.code, Some(1), "{ended}");
    let report = ended.report();
    assert_eq!(report["outcome"], "not_started", "{report}");
    let failures = report["failures"].as_array().unwrap();
    let refused = |failure: &Value| failure["failure"] == "no_time_to_send" && failure["robot"] == "r0";
    assert!(!failures.is_empty() && failures.iter().all(refused), "{report}");
    assert!(stage.robots.iter().all(|robot| robot.sets().is_empty()));

    let fast = chain.stage(&[Via::Direct, Via::Direct]);
    let ended = fast.run(&["run", "play.yaml"]);
    assert_eq!(ended.code, Some(0), "{ended}");
}
