use std::path::Path;

use downbeat_scripts::{Act, Choreography, Fleet, Folder, Source, World, compile, read_fleet, read_world};

use super::{Results, Started, Trials};
use crate::dry_run::Logs;
use downbeat_mission::MissionOptions;
use downbeat_mission::report::Outcome;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
const WAVE: &str = "scenario: wave
start_tolerance: 20ms
stop_condition: {running: 1s}
cues:
  - {cue: up, at: 0s, robots: [cf1, cf2, cf3], tracks: {z: [{at: 0s, to: 0}, {at: 5s, to: 1}]}}";
const ACTS: &str = "scenario: two
stop_condition: {running: 1s}
acts:
  - act: first
    cues: [{cue: up, at: 0s, robots: [cf1, cf2], tracks: {z: [{at: 0s, to: 0}, {at: 2s, to: 1}]}}]
  - act: second
    wait: WAIT
    cues: [{cue: down, at: 0s, robots: [cf1, cf2], tracks: {z: [{at: 0s, to: 1}, {at: 2s, to: 0}]}}]";

struct Stage {
    choreography: Choreography,
    fleet: Fleet,
    world: World,
}

fn stage(scenario: &str, world: &str) -> Stage {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let fleet = read_fleet(&Path::new(ROOT).join("fleet.yaml")).0.unwrap();
    let source = Source::read(&file("scenario.yaml", scenario)).unwrap();
    let compiled = compile(&source, &fleet, &Folder::new(folder.path().to_path_buf()));
    let choreography = compiled.choreography.unwrap_or_else(|| panic!("{:?}", compiled.findings));
    let acts: Vec<&str> = choreography.acts.iter().map(Act::called).collect();
    let (world, findings) = read_world(&file("world.yaml", &format!("world: w\n{world}")), &fleet, &acts);
    Stage { world: world.unwrap_or_else(|| panic!("{findings:?}")), choreography, fleet }
}

impl Stage {
    fn trials(&self, seed: u64) -> Trials<'_> {
        let options = MissionOptions { acts_max: Some(4), ..MissionOptions::default() };
        Trials::new(&self.choreography, &self.fleet, &self.world, options, seed)
    }

    fn play(&self, count: u32) -> Results {
        self.trials(7).play(count, 2, |_| true).unwrap()
    }
}

fn results(scenario: &str, world: &str, count: u32) -> Results {
    stage(scenario, world).play(count)
}

#[test]
fn all_start_and_finish_within_their_clock_error_without_faults() {
    let results = results(WAVE, "clocks: {all: {error: 2ms}}", 50);
    assert_eq!((results.starts.count, results.finishes.count), (50, 50), "{:?}", results.reasons);
    let spread = results.spread.unwrap();
    // The spread results from three clocks with offsets of up to 2 ms in either direction.
    assert!(
        (1.0..=4.0).contains(&spread.p50.as_millis_f64()) && spread.max.as_millis_f64() <= 4.0,
        "{spread:?}"
    );
    assert_eq!(results.weakest_robot, None);
}

const ROUGH: &str =
    "links: {all: {delay: 1ms, jitter: 2ms, loss: 3%, interruptions: [{every: 20s, lasts: 300ms}]}}
clocks: {all: {error: 1ms}}
incidents: [{robot: all, what: dies, at: {from: 0s, to: 9s}, back_after: 1s, probability: 10%}]";

#[test]
fn results_depend_on_the_seed_but_not_on_the_number_of_threads() {
    let stage = stage(WAVE, ROUGH);
    let json = |threads, seed| {
        serde_json::to_string(&stage.trials(seed).play(60, threads, |_| true).unwrap()).unwrap()
    };
    let one = json(1, 7);
    assert_eq!(one, json(4, 7));
    assert_ne!(one, json(1, 8));
}

#[test]
fn trial_played_alone_ends_as_it_does_among_the_others() {
    let stage = stage(WAVE, ROUGH);
    let together = stage.play(60);
    let failed = together.each.iter().find(|trial| trial.outcome != "done").unwrap();
    for trial in [&together.each[0], &together.each[59], failed] {
        let alone = stage.trials(7).play_one(trial.trial, Logs::Kept, &mut ()).unwrap();
        assert_eq!(alone.report.outcome == Outcome::Done, trial.outcome == "done");
        assert_eq!(alone.report.true_spread, trial.spread);
    }
}

#[test]
fn fewer_trials_are_a_prefix_of_more() {
    let stage = stage(WAVE, ROUGH);
    assert_eq!(stage.play(20).each[..], stage.play(40).each[..20]);
}

#[test]
fn robot_that_refuses_three_of_ten_missions_keeps_those_from_starting() {
    let results = results(WAVE, "incidents: [{robot: cf2, what: refuses, probability: 30%}]", 300);
    let refused = results.aborts;
    assert!(refused.least < 0.3 && 0.3 < refused.largest, "{refused:?}");
    assert_eq!(results.starts.count + refused.count, 300);
    assert_eq!(results.mixed.count, 0);
    let [reason] = results.reasons.as_slice() else { panic!("{:?}", results.reasons) };
    assert_eq!(reason.robot.as_ref().unwrap().as_str(), "cf2");
    assert!(reason.text.contains("busy"), "{reason:?}");
    assert_eq!(results.weakest_robot.unwrap().as_str(), "cf2");
}

#[test]
fn robot_that_dies_during_an_act_ends_it_after_all_have_begun() {
    let results = results(WAVE, "incidents: [{robot: cf3, what: dies, act: wave, at: 2s}]", 20);
    assert_eq!((results.starts.count, results.finishes.count, results.mixed.count), (20, 0, 0));
    assert!(results.each.iter().all(|trial| trial.outcome == "failed" && trial.started == Started::All));
    assert_eq!(results.reasons[0].robot.as_ref().unwrap().as_str(), "cf3");
}

#[test]
fn robot_that_dies_before_the_start_keeps_all_robots_from_starting() {
    let results = results(WAVE, "incidents: [{robot: cf3, what: dies, act: wave, at: -200ms}]", 20);
    assert_eq!((results.starts.count, results.mixed.count, results.aborts.count), (0, 0, 20));
    assert!(results.each.iter().all(|trial| trial.started == Started::None));
}

#[test]
fn robot_stalled_across_the_start_is_detected_as_starting_late() {
    let results =
        results(WAVE, "incidents: [{robot: cf3, what: stalls, act: wave, at: -5ms, lasts: 900ms}]", 5);
    assert_eq!((results.finishes.count, results.mixed.count), (0, 5), "{results:?}");
}

#[test]
fn link_down_longer_than_the_lease_stops_the_mission() {
    let long = "incidents: [{robot: cf1, what: link_down, act: wave, at: 1s, lasts: 3s}]";
    let short = "incidents: [{robot: cf1, what: link_down, act: wave, at: 1s, lasts: 100ms}]";
    assert_eq!(results(WAVE, long, 10).finishes.count, 0);
    assert_eq!(results(WAVE, short, 10).finishes.count, 10);
}

#[test]
fn slowest_link_is_the_weakest_and_reports_the_sufficient_lead() {
    let tolerant = WAVE.replace("start_tolerance: 20ms", "start_tolerance: 100ms");
    let results =
        results(&tolerant, "links: {cf2: {delay: 20ms}, all: {delay: 1ms}}\nclocks: {all: {error: 1ms}}", 20);
    assert_eq!(results.weakest_link.unwrap().as_str(), "cf2", "{:?}", results.reasons);
    let lead = results.lead.unwrap();
    assert!(lead.enough.max < lead.had.p50, "{lead:?}");
    // Acceptance takes one round trip.
    let within = results.robots[1].accepts_within.unwrap();
    assert!((40.0..42.0).contains(&within.p50.as_millis_f64()), "{within:?}");
    assert_eq!(results.robots[1].accepts_last.count, results.robots[1].accepts_last.of);
}

#[test]
fn missing_operator_go_leaves_the_act_waiting_and_is_the_reason() {
    let scenario = ACTS.replace("WAIT", "operator");
    let never = results(&scenario, "operator: {go_after: {from: 1s, to: 90s}, never: 25%}", 40);
    let waited = never.finishes.of - never.finishes.count;
    assert!((3..=20).contains(&waited), "{waited}");
    assert!(never.reasons.iter().all(|reason| reason.kind == "waited"), "{:?}", never.reasons);
}

#[test]
fn sensor_reads_the_values_of_the_world_at_their_times() {
    let scenario = ACTS.replace("WAIT", "{sensor: rover-1/range, below: 0.5}");
    let comes = results(&scenario, "sensors: {rover-1/range: [[0s, 2], [{from: 90s, to: 100s}, 0.4]]}", 3);
    assert_eq!(comes.finishes.count, 3, "{:?}", comes.reasons);
    let never = results(&scenario, "sensors: {rover-1/range: [[0s, 2], [100s, 0.6]]}", 3);
    assert_eq!((never.finishes.count, never.reasons[0].kind.as_str()), (0, "waited"), "{:?}", never.reasons);
}
