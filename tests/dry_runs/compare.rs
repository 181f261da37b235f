//! Tests `downbeat graph` and `downbeat diff` at a terminal: their output for any kind of name, and their exit codes.

use std::io::Write;

use serde_json::Value;

use crate::page::Page;
use stage::Via;
use stage::play::SHORT;
use stage::session::{Ran, Session, root};

const SHOW: &str = "scenario: show
acts:
  - act: rise
    cues:
      - {cue: up, at: 0s, robots: arms, tracks: {shoulder: [{at: 0s, to: 0}, {at: 1s, to: 40}]}}
      - {cue: mark, after: up}
  - act: fall
    wait: {for: operator, timeout: 5s, otherwise: end}
    cues:
      - {cue: down, at: 0s, robots: left, tracks: {shoulder: [{at: 0s, to: 40}, {at: 1s, to: 0}]}}
";

/// Writes the show to `a.yaml`, and a copy with the replacements `change` to `b.yaml`.
fn two(change: &[(&str, &str)]) -> Session {
    let session = Session::new();
    let mut changed = SHOW.to_owned();
    for (from, to) in change {
        assert!(changed.contains(from), "{from}");
        changed = changed.replacen(from, to, 1);
    }
    session.file("a.yaml", SHOW).file("b.yaml", changed);
    session
}

#[track_caller]
fn differ(change: &[(&str, &str)]) -> (Ran, Value) {
    let session = two(change);
    let json = session.run(&["diff", "a.yaml", "b.yaml", "--format", "json"]);
    assert_eq!(json.code(), 1, "{}", json.text());
    let text = session.run(&["diff", "a.yaml", "b.yaml"]);
    assert_eq!(text.code(), 1, "{}", text.text());
    (text, json.json())
}

#[test]
fn plans_with_same_compiled_result_are_equal() {
    let session = two(&[
        ("{at: 1s, to: 40}", "{at: 1000ms, to: 40.0}"),
        ("scenario: show\n", "scenario: show # text\n"),
    ]);
    let ran = session.run(&["diff", "a.yaml", "b.yaml"]);
    ran.says(0, &["the plans are the same: "]);
    let json = session.run(&["diff", "a.yaml", "b.yaml", "--format", "json"]).json();
    assert_eq!((&json["same"], &json["hash"]["a"]), (&true.into(), &json["hash"]["b"]));
}

#[test]
fn order_of_robots_in_fleet_file_is_ignored() {
    let session = two(&[]);
    session.file(
        "other.yaml",
        "robots:\n  right: {init: arm.yaml, address: sim}\n  left: {init: arm.yaml, address: sim}\ngroups:\n  arms: [right, left]\n",
    );
    session.run(&["diff", "a.yaml", "b.yaml", "--fleet-b", "other.yaml"]).says(0, &["the same"]);
}

#[test]
fn changed_keyframe_is_reported_with_time_and_both_values() {
    let (text, json) =
        differ(&[("{at: 1s, to: 40}", "{at: 1s, to: 50}"), ("{at: 0s, to: 40}", "{at: 0s, to: 50}")]);
    let acts = json["acts"].as_array().unwrap();
    assert_eq!(acts.len(), 2);
    let left = &acts[0]["devices"][0];
    assert_eq!(
        (&left["robot"], &left["unit"], &left["value_changed"]),
        (&"left".into(), &"deg".into(), &1.into())
    );
    let step = &left["steps"][0];
    assert_eq!(
        (&step["a"]["at_ms"], &step["a"]["values"][0], &step["b"]["values"][0]),
        (&1000.into(), &40.0.into(), &50.0.into())
    );
    assert_eq!((&left["largest"]["a"], &left["largest"]["b"]), (&40.0.into(), &50.0.into()));
    text.says(1, &["left/shoulder", "40 deg at 1 s → 50 deg at 1 s", "10 deg at 1 s: 40 → 50"]);
}

#[test]
fn delayed_cue_shifts_its_steps() {
    let (text, json) = differ(&[("up, at: 0s", "up, at: 500ms")]);
    let act = &json["acts"][0];
    let changes: Vec<_> =
        act["cues"].as_array().unwrap().iter().map(|cue| cue["start_ms"].to_string()).collect();
    assert_eq!(changes, [r#"{"a":0,"b":500}"#, r#"{"a":1000,"b":1500}"#]);
    assert_eq!((&act["duration_ms"]["a"], &act["duration_ms"]["b"]), (&1000.into(), &1500.into()));
    assert_eq!(act["devices"][0]["shifted_by_ms"], 500);
    text.says(1, &["act rise: lasts 1 s → 1.5 s", "0 ms → 500 ms", "all steps later by 500 ms"]);
    assert!(!text.out().contains("act fall"), "{}", text.out());
}

#[test]
fn added_and_removed_acts_and_robots_are_named() {
    let (text, json) = differ(&[("act: fall", "act: drop"), ("robots: arms", "robots: right")]);
    let presence = |name: &str| {
        let act = json["acts"].as_array().unwrap().iter().find(|act| act["act"] == name).unwrap();
        act["presence"].as_str().unwrap().to_owned()
    };
    assert_eq!(
        (presence("drop"), presence("fall"), presence("rise")),
        ("added".into(), "removed".into(), "changed".into())
    );
    text.says(1, &["act drop: added, with 1 cue and 1 device", "act fall: removed", "robots removed: left"]);
    assert!(text.out().contains(r#"next: {"act":"fall"} → {"act":"drop"}"#), "{}", text.out());
}

#[test]
fn reordered_acts_are_reported_as_moved() {
    let session = two(&[]);
    let (head, acts) = SHOW.split_once("acts:\n").unwrap();
    let at = acts.find("  - act: fall").unwrap();
    session.file("b.yaml", format!("{head}acts:\n{}{}", &acts[at..], &acts[..at]));
    let json = session.run(&["diff", "a.yaml", "b.yaml", "--format", "json"]).json();
    let moved: Vec<_> =
        json["acts"].as_array().unwrap().iter().filter(|act| !act["place"].is_null()).collect();
    assert_eq!(moved.len(), 1, "{json:#}");
}

#[test]
fn act_settings_are_compared() {
    let (text, json) = differ(&[("timeout: 5s, otherwise: end", "timeout: 6s, otherwise: rise")]);
    let settings = json["acts"][0]["settings"].as_array().unwrap();
    let names: Vec<_> = settings.iter().map(|setting| setting["setting"].as_str().unwrap()).collect();
    assert_eq!(names, ["on_timeout", "timeout_ms"]);
    text.says(1, &["timeout_ms: 5000 → 6000"]);
}

#[test]
fn changed_closest_approach_is_reported_as_better_or_worse() {
    let session = Session::new();
    let swap = root().join("scripts/examples/swap.yaml");
    let fleet = root().join("fleet.yaml");
    let (swap, fleet) = (swap.to_str().unwrap(), fleet.to_str().unwrap());
    let text =
        std::fs::read_to_string(fleet).unwrap().replace("init: ", &format!("init: {}/", root().display()));
    assert!(text.contains("radius: 0.07"), "the bodies of the demo fleet: {text}");
    session.file("slim.yaml", text.replace("radius: 0.07", "radius: 0.05"));
    // The robot descriptions are in the repository, but the changed fleet is not.
    let diff = |fleet: &str, other: &str| {
        session.run(&["diff", swap, swap, "--fleet", fleet, "--fleet-b", other, "--project", "/"])
    };
    let ran = diff(fleet, "slim.yaml");
    ran.says(1, &["closest approach: ", "better, they stay further apart"]);
    let ran = diff("slim.yaml", fleet);
    ran.says(1, &["worse, they come closer"]);
}

#[test]
fn incomparable_inputs_end_with_exit_code_2() {
    let session = two(&[]);
    session.file("broken.yaml", SHOW.replace("to: 40", "to: 4000"));
    session.run(&["diff", "a.yaml", "broken.yaml"]).says(2, &["DB0011"]);
    session.run(&["diff", "a.yaml", "nowhere.yaml"]).says(2, &["cannot read `nowhere.yaml`"]);
    session.run(&["diff", "a.yaml", "b.yaml", "--within", "1ms"]).says(2, &["--within"]);
    session.file("played/journal", "00000000 {\n");
    session
        .run(&["diff", "a.yaml", "played"])
        .says(2, &["`played` is a recorded mission, but `a.yaml` is not"]);
    let ran = session.run(&["diff", "a.yaml", "played", "--format", "json"]);
    assert!(
        ran.json()["error"].as_str().unwrap().contains("expected two scenarios, or two recordings"),
        "{}",
        ran.text()
    );
}

#[test]
fn names_cannot_inject_terminal_escape_sequences() {
    let name = r#""\u001b[31m\"]; <b>\n2""#;
    let session = two(&[("cue: up", &format!("cue: {name}")), ("after: up", &format!("after: {name}"))]);
    let ran = session.run(&["diff", "a.yaml", "b.yaml"]);
    ran.says(1, &[r#"\u{1b}[31m"]; <b>\n2"#]);
    assert!(!ran.out().contains('\u{1b}'), "{}", ran.out());
}

#[test]
fn missions_are_compared_by_their_results() {
    let stage = SHORT.stage(&[Via::Direct, Via::Direct]);
    for name in ["one.mcap", "two.mcap"] {
        // Late steps are reported as a difference at any tolerance.
        let in_time = |ran: &stage::Ended| {
            let late = ran.out.contains("more than 1 ms late");
            if late {
                drop(writeln!(std::io::stderr(), "played again, because the report names late steps: {ran}"));
            }
            !late
        };
        let mut played = (0..5).map(|_| stage.play(&["run", "play.yaml", "--record", name]));
        let ran = played.find(in_time).expect("a mission of five whose steps are in time");
        assert_eq!(ran.code, Some(0), "{ran}");
    }
    let same = stage.run(&["diff", "one.mcap", "one.mcap"]);
    assert_eq!((same.code, same.out.as_str()), (Some(0), "the same\n"), "{same}");
    let other = stage.run(&["diff", "one.mcap", "two.mcap"]);
    assert_eq!(other.code, Some(1), "no two starts are equal: {other}");
    assert!(other.out.contains("spread: ") && other.out.contains("start error"), "{other}");
    let within = stage.run(&["diff", "one.mcap", "two.mcap", "--within", "10s"]);
    assert_eq!(within.code, Some(0), "{within}");
    let mixed = stage.run(&["diff", "play.yaml", "two.mcap"]);
    assert_eq!(mixed.code, Some(2), "{mixed}");
}

#[test]
fn graph_contains_every_cue_and_transition() {
    let session = two(&[]);
    let json = session.run(&["graph", "a.yaml", "--format", "json"]).json();
    let cues: Vec<_> =
        json["acts"][0]["cues"].as_array().unwrap().iter().map(|cue| cue["cue"].clone()).collect();
    assert_eq!(cues, ["up", "mark"]);
    let relation = &json["acts"][0]["relations"][0];
    assert_eq!(
        (&relation["from"], &relation["to"], &relation["critical"]),
        (&"a0c0".into(), &"a0c1".into(), &true.into())
    );
    assert_eq!(json["acts"][1]["waits_for"], "the operator");
    let course: Vec<_> = json["course"].as_array().unwrap().iter().map(|way| way["kind"].clone()).collect();
    assert_eq!(course, ["next", "next", "on_timeout"]);
    session.run(&["graph", "a.yaml"]).says(0, &["digraph", "subgraph cluster_a1", "timeout after 5 s"]);
}

#[test]
fn graph_of_one_act_has_no_transitions() {
    let session = two(&[]);
    let ran = session.run(&["graph", "a.yaml", "--act", "fall"]);
    ran.says(0, &["cluster_a1"]);
    assert!(!ran.out().contains("cluster_a0") && !ran.out().contains("end ["), "{}", ran.out());
    session.run(&["graph", "a.yaml", "--act", "fal"]).says(2, &["unknown act `fal`", "did you mean `fall`?"]);
}

#[test]
fn page_of_two_missions_shows_steps_of_first_behind_second() {
    let stage = SHORT.stage(&[Via::Direct, Via::Direct]);
    let play = std::fs::read_to_string(stage.path("play.yaml")).unwrap();
    let changed = play.replace("to: 4}", "to: 9}");
    assert_ne!(play, changed);
    stage.file("changed.yaml", changed);
    for (scenario, recording) in [("play.yaml", "one.mcap"), ("changed.yaml", "two.mcap")] {
        let ran = stage.play(&["run", scenario, "--record", recording]);
        assert_eq!(ran.code, Some(0), "{ran}");
    }
    let ran = stage.run(&["diff", "one.mcap", "two.mcap", "--html", "page.html"]);
    assert_eq!(ran.code, Some(1), "{ran}");
    let page = Page::read(&stage.path("page.html"));
    let compared = &page.mission["compared"];
    assert_eq!(compared["with"], "one.mcap");
    let ghost = &compared["ghosts"][0];
    assert_eq!((ghost["plan"].as_u64(), ghost["lanes"].as_array().map(Vec::len)), (Some(0), Some(2)));
    let sent = |lane: &Value| page.numbers(&lane["scripts"][0]["steps"]["v"]);
    assert_eq!(sent(&ghost["lanes"][0]).last(), Some(&4.0));
    assert_eq!(sent(&page.mission["plans"][0]["lanes"][0]).last(), Some(&9.0));
    let differences = compared["differences"].as_array().unwrap();
    let script = differences.iter().find(|difference| difference["subject"] == "r0/d").unwrap();
    let robot = &page.mission["robots"][usize::try_from(script["robot"].as_u64().unwrap()).unwrap()];
    assert_eq!((&script["plan"], &robot["id"]), (&0.into(), &"r0".into()), "{script}");
    assert!(differences.iter().any(|difference| difference["subject"] == "spread"), "{differences:?}");
    stage.run(&["diff", "one.mcap", "one.mcap", "--html", "same.html"]);
    let same = Page::read(&stage.path("same.html"));
    assert_eq!(same.mission["compared"]["differences"], serde_json::json!([]));
    assert_eq!(same.mission["compared"]["ghosts"][0]["lanes"], serde_json::json!([]));
    let replaced = stage.run(&["diff", "one.mcap", "two.mcap", "--html", "two.mcap"]);
    assert_eq!(replaced.code, Some(2), "{replaced}");
}

#[test]
fn page_shows_first_plan_behind_second() {
    let session = two(&[("up, at: 0s", "up, at: 500ms")]);
    let ran = session.run(&["diff", "a.yaml", "b.yaml", "--html", "page.html"]);
    assert_eq!(ran.code(), 1, "{}", ran.text());
    let page = Page::read(&session.path("page.html"));
    let compared = &page.mission["compared"];
    assert_eq!(compared["with"], "a.yaml");
    let ghost = &compared["ghosts"][0];
    assert_eq!(ghost["cues"][0], serde_json::json!({"cue": 0, "start": 0.0, "end": 1000.0}));
    assert_eq!(ghost["lanes"].as_array().unwrap().len(), 2);
    assert_eq!(page.numbers(&ghost["lanes"][0]["scripts"][0]["steps"]["v"]), [0.0, 40.0]);
    assert_eq!(compared["ghosts"][1]["lanes"], serde_json::json!([]), "what is the same has no ghost");
    let differences = compared["differences"].as_array().unwrap();
    let up = differences.iter().find(|difference| difference["subject"] == "up").unwrap();
    assert_eq!((&up["at"], &up["text"]), (&500.0.into(), &"start 0 ms → 500 ms".into()));
    assert!(differences.iter().any(|difference| difference["subject"] == "left/shoulder"), "{differences:?}");
    session
        .run(&["diff", "a.yaml", "b.yaml", "--html", "a.yaml"])
        .says(2, &["the output would overwrite its own source `a.yaml`"]);
}
