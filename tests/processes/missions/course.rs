//! Acts that wait, and what becomes of them: the report names every act of the scenario, and a mission with a skipped act is no success.

use rustix::process::Signal;
use serde_json::Value;

use stage::{Ended, Stage, Via, one_device};

const RANGE: &str = "  - id: range
    name: range
    available_control_types:
      sensor: {min_value: 0, max_value: 4}
";

/// Plays three acts. The second act has the condition `wait`.
fn played(wait: &str) -> (Stage, Ended) {
    let cues = "cues: [{robots: all, tracks: {d: [{at: 0s, to: 1}, {at: 100ms, to: 2}]}}]";
    let mut stage = Stage::new();
    let init = one_device(1, 90, 8).replace("reports: true", "reports: true\ninquiry: true") + RANGE;
    stage.file("robot.yaml", init).file(
        "show.yaml",
        format!(
            "scenario: show
start_tolerance: 1s
acts:
  - {{act: one, {cues}}}
  - {{act: two, wait: {wait}, {cues}}}
  - {{act: three, next: end, {cues}}}
"
        ),
    );
    stage.robot("robot.yaml", Via::Direct);
    let ended = stage.run(&["run", "show.yaml", "--format", "json"]);
    (stage, ended)
}

fn course(ended: &Ended) -> Vec<(String, String)> {
    let report = ended.report();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    report["course"].as_array().unwrap().iter().map(|act| (text(&act["act"]), text(&act["fate"]))).collect()
}

fn fates(expected: [(&str, &str); 3]) -> Vec<(String, String)> {
    expected.map(|(act, fate)| (act.to_owned(), fate.to_owned())).to_vec()
}

#[test]
fn outcome_names_the_act_skipped_for_its_unmet_sensor_condition() {
    let (stage, ended) = played("{sensor: r0/range, below: 0.5, timeout: 400ms, otherwise: end}");
    assert_eq!(ended.code, Some(5), "{ended}");
    assert_eq!(course(&ended), fates([("one", "played"), ("two", "timed_out"), ("three", "not_reached")]));
    let report = ended.report();
    assert_eq!(report["outcome"]["done_skipping"]["acts"][0], "two");
    assert_eq!(report["course"][1]["awaited"], "`r0/range` below 0.5");
    let text = stage.run(&["run", "show.yaml"]);
    assert!(text.out.contains("show: done, but skipped `two`"), "{text}");
    assert!(
        text.out.contains("act `two`: skipped: `r0/range` below 0.5 did not occur within 400 ms"),
        "{text}"
    );
    assert!(text.out.contains("act `three`: not reached"), "{text}");
}

#[test]
fn missing_operator_go_is_named_after_timeout() {
    let (_stage, ended) = played("{for: operator, timeout: 300ms, otherwise: three}");
    assert_eq!(ended.code, Some(5), "{ended}");
    assert_eq!(course(&ended), fates([("one", "played"), ("two", "timed_out"), ("three", "played")]));
    assert_eq!(ended.report()["course"][1]["awaited"], "the operator's go");
    assert!(ended.told.is_empty() || ended.told.contains("did not occur within"), "{ended}");
}

#[test]
fn timeout_without_otherwise_fails_the_mission_and_names_skipped_act() {
    let (_stage, ended) = played("{for: operator, timeout: 300ms}");
    assert_eq!(ended.code, Some(1), "{ended}");
    assert_eq!(course(&ended), fates([("one", "played"), ("two", "timed_out"), ("three", "not_reached")]));
}

#[test]
fn mission_with_all_acts_played_is_done() {
    let (_stage, ended) = played("done");
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!(course(&ended), fates([("one", "played"), ("two", "played"), ("three", "played")]));
}

#[test]
fn stopped_act_of_silent_robot_is_not_reported_as_withdrawn() {
    let mut stage = Stage::new();
    let steps: Vec<_> = (0..40).map(|step| format!("{{at: {}ms, to: {step}}}", step * 100)).collect();
    let tracks = steps.join(", ");
    stage.file("robot.yaml", one_device(1, 90, 50).replace("reports: true", "reports: false")).file(
        "show.yaml",
        format!("scenario: show\nstart_tolerance: 1s\ncues: [{{at: 0s, robots: all, tracks: {{d: [{tracks}]}}}}]\n"),
    );
    stage.robot("robot.yaml", Via::Proxy);
    // The robot answers no inquiries either.
    stage.robots[0].link.as_ref().unwrap().leave_out(&["inquiry"]);
    let running = stage.begin(&["run", "show.yaml", "--format", "json", "--patience", "1s"], [0], 5);
    stage.robots[0].freeze();
    running.process.signal(Signal::INT);
    let ended = running.ended();
    assert_eq!(ended.report()["course"][0]["fate"], "stopped", "{ended}");
}
