//! Tests of motions that sensors verify, in virtual time: the bodies of two robots follow with a delay, and their latencies are known.

use downbeat_scripts::{Folder, Source, compile, read_fleet};

use super::Rehearsal;
use downbeat_mission::{MissionOptions, MotionReport, MotionSpread};
use downbeat_runtime::fleet::{greeting, participants, simulated};

const ARM: &str = "id: arm
api_version: '1'
reports: true
devices:
  - id: elbow
    unit: deg
    default_value: 0
    interpolation: linear
    available_control_types:
      position: {min_value: -90, max_value: 90, granularity: 0.01}
      script: {min_value: -90, max_value: 90, granularity: 0.01, max_number_of_steps: 100}
  - id: angle
    available_control_types:
      sensor: {min_value: -180, max_value: 180}
";
const UP: &str = "scenario: up
cues:
  - {cue: up, at: 0s, robots: [left, right], tracks: {elbow: [{at: 0s, to: 0}, {at: 1s, to: 40}]}}
";

/// Plays a mission with two arms: the left one follows its command after 60 ms, the right one after 12 ms. With a lag of 10 ms, the first
/// 0.02 degrees of this ramp take 3.34 ms: t - 10 (1 - exp(-t / 10)) = 0.5 ms. This is 2.84 ms more than without the lag.
fn motions(known: [&str; 2], measured: &str) -> (Vec<MotionReport>, Option<MotionSpread>) {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    file("arm.yaml", ARM);
    file("latency.yaml", &format!("latency: {measured}"));
    let robot = |name: &str, latency: &str, known: &str| {
        format!(
            "  {name}:\n    init: arm.yaml\n    address: sim\n    {known}\n    calibrate: {{elbow: {{sensor: angle, by: 2, visible: 0.02}}}}\n    \
             simulate: {{clock_offset: 30ms, moves: {{elbow: {{latency: {latency}, time_constant: 10ms, sensor: angle, noise: 0.05, delay: 2ms}}}}}}\n"
        )
    };
    let robots = [robot("left", "60ms", known[0]), robot("right", "12ms", known[1])].concat();
    let (fleet, findings) =
        read_fleet(&file("fleet.yaml", &format!("latency: latency.yaml\nrobots:\n{robots}")));
    let fleet = fleet.unwrap_or_else(|| panic!("{findings:?}"));
    let source = Source::read(&file("up.yaml", UP)).unwrap();
    let compiled = compile(&source, &fleet, &Folder::new(folder.path().to_path_buf()));
    let choreography = compiled.choreography.unwrap_or_else(|| panic!("{:?}", compiled.findings));
    let robots: Vec<_> = fleet.robots.iter().collect();
    let machines = robots.iter().zip(1..).map(|(robot, seed)| simulated(robot, seed).unwrap()).collect();
    let options =
        MissionOptions { greeting: greeting(&fleet), verify_motion: true, ..MissionOptions::default() };
    let played = Rehearsal::new(choreography, participants(&robots), options, machines).unwrap().play();
    let act = played.report.acts.into_iter().next().unwrap();
    (act.motions, act.motion_spread)
}

/// The error of a motion in milliseconds.
fn error(motion: &MotionReport) -> f64 {
    motion.error.unwrap_or_else(|| panic!("{motion:?}")).as_millis_f64()
}

#[test]
fn sensors_show_motions_in_sync_only_with_known_latencies() {
    let (apart, spread) = motions(["clock: ntp", "clock: ntp"], "{}");
    let [left, right] = apart.as_slice() else { panic!("{apart:?}") };
    for (motion, latency) in [(left, 62.84), (right, 14.84)] {
        let uncertainty = motion.uncertainty.unwrap().as_millis_f64();
        assert!((error(motion) - latency).abs() < uncertainty && uncertainty < 20.0, "{apart:?}");
    }
    let spread = spread.unwrap();
    let off = (spread.spread.as_millis_f64() - 48.0).abs();
    assert!(off < spread.uncertainty.as_millis_f64() && spread.motions == 2, "{spread:?}");

    let (together, spread) = motions(["latency: 60ms", "latency: 12ms"], "{}");
    let [left, right] = together.as_slice() else { panic!("{together:?}") };
    assert_eq!(left.planned, right.planned, "both are to begin at once");
    assert!(error(left).abs() < 6.0 && error(right).abs() < 6.0, "{together:?}");
    let spread = spread.unwrap();
    assert!(spread.spread < spread.uncertainty && spread.spread.as_millis_f64() < 10.0, "{spread:?}");

    let file = "{left: {elbow: {median: 62.84ms, time_constant: 10ms}}, right: {elbow: {median: 14.84ms, time_constant: 10ms}}}";
    let (measured, spread) = motions(["clock: ntp", "clock: ntp"], file);
    for motion in &measured {
        let uncertainty = motion.uncertainty.unwrap().as_millis_f64();
        assert!(error(motion).abs() < uncertainty && uncertainty < 3.0, "{measured:?}");
    }
    assert!(spread.unwrap().spread.as_millis_f64() < 3.0, "{spread:?}");
}
