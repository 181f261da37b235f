//! Actuation latency: the robots' own logs show that commands are sent earlier than the motions are due. One robot is an edge whose
//! driver declares a latency.

use stage::session::Session;
use stage::{Stage, Via, one_device};

const PLAY: &str = "scenario: play\nstart_tolerance: 1s\ncues:\n  - {cue: up, at: 0s, robots: all, tracks: \
                    {d: [{at: 0s, to: 1}, {at: 100ms, to: 2}]}}\n";
const LATENCY: i64 = 60_000_000;
/// Maximum delay that a busy machine may cause, in nanoseconds.
const BUSY: i64 = 30_000_000;

#[test]
fn robot_with_60_ms_latency_is_commanded_60_ms_earlier() {
    let mut stage = Stage::new();
    stage.file("arm.yaml", one_device(1, 9, 9)).file("play.yaml", PLAY);
    stage.robot_with("arm.yaml", Via::Direct, Vec::new(), ", latency: 60ms");
    stage.robot("arm.yaml", Via::Direct);
    let ran = stage.run(&["run", "play.yaml", "--format", "json"]);
    assert_eq!(ran.code, Some(0), "{ran}");
    let logs: Vec<_> = stage.robots.iter().map(stage::Robot::sets).collect();
    let [slow, quick] = logs.as_slice() else { panic!("{logs:?}") };
    assert_eq!((slow.len(), quick.len()), (2, 2), "{logs:?}");
    for (slow, quick) in slow.iter().zip(quick) {
        assert_eq!(slow.value, quick.value);
        // Due times are exact; set times depend on how busy the machine was.
        assert_eq!(quick.due - slow.due, LATENCY, "{logs:?}");
        let apart = quick.at - slow.at;
        assert!((apart - LATENCY).abs() < BUSY, "{apart} ns apart: {logs:?}");
    }
    let report: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    // Reported starts are relative to the plan: they are simultaneous.
    assert!(report["spread_ms"].as_f64().unwrap() < 30.0, "{ran}");
}

#[test]
fn latency_variation_is_budgeted_and_shown_separately_from_clocks() {
    let mut stage = Stage::new();
    stage.file("arm.yaml", one_device(1, 9, 9)).file("play.yaml", PLAY);
    stage.robot_with("arm.yaml", Via::Direct, Vec::new(), ", latency: {d: {median: 20ms, spread: 100ms}}");
    stage.robot("arm.yaml", Via::Direct);
    let ran = stage.run(&["run", "play.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran}");
    assert!(ran.out.contains("from the clocks alone, the rest from varying latencies"), "{ran}");
    stage.file("tight.yaml", PLAY.replace("start_tolerance: 1s", "start_tolerance: 150ms"));
    let refused = stage.run(&["preflight", "tight.yaml"]);
    assert_ne!(refused.code, Some(0), "{refused}");
    let said = format!("{refused}");
    assert!(said.contains("the latency of its devices varies by +-100 ms"), "{said}");
}

#[test]
fn plan_and_check_show_compensated_latency_and_its_source() {
    let session = Session::new();
    let arm = one_device(1, 9, 9).replace("    name: d\n", "    name: d\n    latency: 25\n");
    session.file("arm.yaml", arm).file("play.yaml", PLAY);
    session.file(
        "fleet.yaml",
        "latency: latency.yaml\nrobots:\n  a: {init: arm.yaml, address: sim, latency: 60ms}\n  \
         b: {init: arm.yaml, address: sim}\n  c: {init: arm.yaml, address: sim}\ngroups: {all: [a, b, c]}\n",
    );
    session.file("latency.yaml", "latency: {b: {d: {median: 30ms, spread: 2ms}}}\n");
    let plan = session.run(&["plan", "play.yaml"]);
    assert_eq!(plan.code(), 0, "{}", plan.text());
    for expected in
        ["first commands sent 60 ms before the motions", "30 ms", "±2 ms", "fleet", "file", "robot"]
    {
        assert!(plan.text().contains(expected), "{expected}: {}", plan.text());
    }
    let check = session.run(&["check", "play.yaml"]);
    let line = "latency compensated for 3 devices, up to 60 ms (1 from the fleet, 1 from the file, 1 from the robot)";
    assert!(check.text().contains(line), "{}", check.text());
    let json = session.run(&["plan", "play.yaml", "--format", "json"]).json();
    let act = &json["acts"][0];
    assert_eq!(act["lead_in_ms"], 60.0);
    assert_eq!(act["cues"][0]["start"], 60.0);
    assert_eq!(
        act["latencies"]["b"]["d"],
        serde_json::json!({"median_ms": 30, "spread_ms": 2, "from": "file"})
    );
    let offset =
        |robot: &str| act["robots"][robot][0]["control_request"]["time_offset_to_start"].as_f64().unwrap();
    assert_eq!([offset("a"), offset("b"), offset("c")], [0.0, 30.0, 35.0]);
}
