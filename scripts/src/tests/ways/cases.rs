//! Faults of the compiler that the second evaluation found, each as one scenario.

use super::{ROBOTS, compiled, fleet_of};
use crate::{Choreography, Code, Fleet, RateLimits};

/// Returns the code and the line of each finding.
fn found(text: &str, fleet: &Fleet) -> Vec<(Code, usize)> {
    let text = format!("scenario: s\n{text}");
    compiled(&text, fleet).findings.iter().map(|finding| (finding.code, finding.line)).collect()
}

#[track_caller]
fn choreography(text: &str, fleet: &Fleet) -> Choreography {
    let compiled = compiled(&format!("scenario: s\n{text}"), fleet);
    compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings))
}

/// A show in which both robots move to 20, then back to 10. After a failure, an act follows that expects the position 10.
const FAILURE: &str = "acts:
  - {act: one, on_failure: {RULES, then: two}, next: back, cues: [{robots: [a, b], tracks: {joint: [{at: 0s, to: 10}, {at: 1s, to: 20}]}}]}
  - {act: back, cues: [{robots: [a, b], tracks: {joint: [{at: 0s, to: 20}, {at: 1s, to: 10}]}}]}
  - act: two
    cues:
      - {robots: a, tracks: {joint: [{at: 0s, to: 10}]}}
";

#[test]
fn act_after_failure_starts_where_continuing_robots_are_left() {
    let fleet = fleet_of(&ROBOTS);
    let with = |rules: &str| found(&FAILURE.replace("RULES", rules), &fleet);
    assert_eq!(with("default: without"), [(Code::TooFast, 7)]);
    assert_eq!(with("b: without"), [(Code::TooFast, 7)]);
    // A robot that failed itself does not take part in the act.
    assert_eq!(with("a: without"), []);
    // The robot does not take part in the mission, so it cannot fail.
    assert_eq!(with("c: without"), []);
    assert_eq!(with("default: stop"), []);
}

#[test]
fn stopped_device_is_not_in_motion_whatever_its_default_position() {
    let text = "stop_condition: {running: none}
cues: [{at: 0s, robots: a, tracks: {joint: {control: speed, keyframes: [{at: 0s, to: 5}, {at: 1s, to: SPEED}]}}}]
";
    let fleet = fleet_of(&ROBOTS);
    assert_eq!(found(&text.replace("SPEED", "0"), &fleet), []);
    // The default position of the device is 10.
    assert_eq!(found(&text.replace("SPEED", "10"), &fleet), [(Code::LeftInMotion, 3)]);
}

#[test]
fn jump_between_later_cues_is_reported_after_speed_controlled_cue() {
    let text = "cues:
  - {at: 0s, robots: a, tracks: {joint: {control: speed, keyframes: [{at: 0s, to: 5}, {at: 1s, to: 0}]}}}
  - {at: 2s, robots: a, tracks: {joint: [{at: 0s, to: 10}, {at: 1s, to: 20}]}}
  - {at: 4s, robots: a, tracks: {joint: [{at: 0s, to: 40}]}}
";
    assert_eq!(found(text, &fleet_of(&ROBOTS)), [(Code::TooFast, 5)]);
}

#[test]
fn excluded_robots_use_no_devices() {
    let text = "cues: [{at: 0s, robots: [a, b], tracks: {slide: [{at: 0s, to: 8}, {at: 1s, to: 12}]}}]\n";
    let only = choreography(text, &fleet_of(&ROBOTS)).only(&["a".parse().unwrap()]).unwrap();
    let devices = &only.acts[0].devices;
    assert_eq!(devices.iter().map(|used| used.robot.as_str()).collect::<Vec<_>>(), ["a"]);
}

#[test]
fn changed_speed_rechecks_accelerations_and_entries_into_acts() {
    let limits = RateLimits { speed: None, acceleration: Some(40.0) };
    let mut fleet = fleet_of(&ROBOTS);
    fleet.robots[0].limits.insert("slide".to_owned(), limits);
    // The largest acceleration of `cubic` is six times the distance divided by the square of the time: 12.
    let smooth =
        "cues: [{at: 0s, robots: a, tracks: {slide: [{at: 0s, to: 8}, {at: 2s, to: 16, ease: cubic}]}}]\n";
    let show = choreography(smooth, &fleet);
    assert!(show.clone().at_speed(1.8, &fleet).is_ok());
    let faults = show.at_speed(1.9, &fleet).unwrap_err();
    assert_eq!(
        faults,
        ["robot `a`, device `slide`: it can move at most 1.826 times as fast as written (act ``)"]
    );
    let acts = "acts:
  - {act: one, cues: [{robots: a, tracks: {joint: [{at: 0s, to: 10}, {at: 2s, to: 30}]}}]}
  - {act: two, cues: [{robots: a, tracks: {joint: [{at: 1s, to: 15}]}}]}
";
    let show = choreography(acts, &fleet);
    assert!(show.clone().at_speed(1.3, &fleet).is_ok());
    let faults = show.clone().at_speed(1.5, &fleet).unwrap_err();
    assert_eq!(
        faults,
        ["robot `a`, device `joint`: it can move at most 1.333 times as fast as written (act `two`)"]
    );
    // At the beginning of a single act, `run` asks the robot for its position.
    assert!(show.act_alone(1).at_speed(1.5, &fleet).is_ok());
}
