//! Tests that a certificate permits exactly the plan that a dry run has tried with every fault. If the plan differs, the refusal names
//! the difference.

use std::fs;

use serde_json::Value;

use stage::session::{ARM, Ran, Session};

const SHOW: &str = "scenario: show
start_tolerance: 1s
acts:
  - {act: one, cues: [{robots: arms, tracks: {shoulder: [{at: 0s, to: 0}, {at: 200ms, to: 45}]}}], next: two}
  - {act: two, cues: [{robots: left, tracks: {shoulder: [{at: 0s, to: 45}, {at: 200ms, to: 0}]}}], next: end}
";

fn session() -> Session {
    let session = Session::new();
    session.file("show.yaml", SHOW);
    session
}

fn certify(session: &Session) -> Ran {
    session.run(&["dry-run", "show.yaml", "--certify", "show.cert.json"])
}

fn certified() -> Session {
    let session = session();
    certify(&session).says(0, &["played against 15 faults", "certified plan"]);
    session
}

fn replace(session: &Session, file: &str, from: &str, to: &str) {
    let text = fs::read_to_string(session.path(file)).unwrap();
    assert!(text.contains(from), "{file}: {text}");
    session.file(file, text.replace(from, to));
}

const REQUIRED: [&str; 4] = ["run", "show.yaml", "--require-certificate", "show.cert.json"];

#[test]
fn certified_show_plays_and_recertification_gives_same_bytes() {
    let session = certified();
    let first = fs::read(session.path("show.cert.json")).unwrap();
    session.run(&["preflight", "show.yaml", "--require-certificate", "show.cert.json"]).says(0, &[]);
    session.play(&REQUIRED).says(0, &["show: done"]);
    certify(&session);
    assert_eq!(fs::read(session.path("show.cert.json")).unwrap(), first);
}

#[test]
fn certificate_lists_every_fault_with_its_outcome() {
    let session = certified();
    let text = fs::read_to_string(session.path("show.cert.json")).unwrap();
    let certificate: Value = serde_json::from_str(&text).unwrap();
    let trials = certificate["trials"].as_array().unwrap();
    assert_eq!(trials.len(), 16);
    let of = |fault: &str, robot: &str| {
        let is = |trial: &&Value| trial["injected"]["fault"] == fault && trial["injected"]["robot"] == robot;
        trials.iter().find(is).unwrap()
    };
    assert_eq!((&trials[0]["injected"]["fault"], &trials[0]["outcome"]), (&"none".into(), &"done".into()));
    assert_eq!(trials[0]["moved"], serde_json::json!(["left", "right"]));
    for fault in ["refuses", "silent", "disconnects"] {
        for robot in ["left", "right"] {
            let trial = of(fault, robot);
            assert_eq!(
                (&trial["outcome"], &trial["moved"]),
                (&"not_started".into(), &serde_json::json!([])),
                "{trial}"
            );
        }
    }
}

/// Replaces `from` with `to` in `file` of a certified plan. Checks that the plan is refused and that the refusal contains the texts
/// `says`.
#[track_caller]
fn refused(file: &str, from: &str, to: &str, says: &[&str]) {
    let session = certified();
    replace(&session, file, from, to);
    for command in ["run", "preflight"] {
        let ran = session.run(&[&[command], &REQUIRED[1..]].concat());
        ran.says(1, says);
        ran.says(1, &["does not certify this plan and this fleet, so nothing was sent"]);
        assert!(!ran.text().contains("show: done"), "{}", ran.text());
    }
}

#[test]
fn changed_step_value_or_time_is_refused() {
    let says = ["act `two`: the scripts of `left/shoulder` differ from the certified ones"];
    refused("show.yaml", "{at: 200ms, to: 0}", "{at: 200ms, to: 0.5}", &says);
    refused("show.yaml", "{at: 200ms, to: 0}", "{at: 201ms, to: 0}", &says);
}

#[test]
fn changed_limit_description_or_body_is_reported_with_its_robot() {
    let right = "right: {init: arm.yaml, address: sim";
    refused(
        "fleet.yaml",
        right,
        "right: {init: arm.yaml, limits: {shoulder: {speed: 300}}, address: sim",
        &["robot `right`: limits of `shoulder` is", "300"],
    );
    refused(
        "fleet.yaml",
        right,
        "right: {init: arm.yaml, body: {x: 1}, address: sim",
        &["robot `right`: its body differs"],
    );
    refused(
        "fleet.yaml",
        right,
        "right: {init: arm.yaml, wake_up: 2ms, address: sim",
        &["`right`: wake_up_ms is 2, but 1 was certified"],
    );
    refused(
        "arm.yaml",
        "max_number_of_steps: 8",
        "max_number_of_steps: 9",
        &["robot `left`: the description of its device `shoulder`"],
    );
}

#[test]
fn changed_transitions_order_and_policies_of_acts_are_reported() {
    refused(
        "show.yaml",
        "next: end",
        "next: end, on_failure: home",
        &[r#"act `two`: on_failure is "home", but "stop" was certified"#],
    );
    refused("show.yaml", "{act: one,", "{act: one, wait: operator,", &["act `one`: wait is", "operator"]);
    let session = certified();
    let mut lines: Vec<&str> = SHOW.lines().collect();
    lines.swap(3, 4);
    // The first act in the file starts the mission, so `one` now has to follow `two`.
    let swapped = lines
        .join("\n")
        .replace("next: two", "next: end ")
        .replace("to: 0}]}}], next: end}", "to: 0}]}}], next: one}");
    session.file("show.yaml", swapped);
    session.run(&REQUIRED).says(1, &["the order of the acts is now `two`, `one`"]);
}

#[test]
fn different_options_are_named_instead_of_every_changed_script() {
    let session = certified();
    let ran = session.run(&[&REQUIRED[..], &["--speed", "0.5"]].concat());
    ran.says(1, &["--speed: 0.5, but certified with 1"]);
    assert!(!ran.text().contains("scripts of"), "{}", ran.text());
    session
        .run(&[&REQUIRED[..], &["--act", "one"]].concat())
        .says(1, &["--act: `one`, but certified with all acts"]);
    session
        .run(&[&REQUIRED[..], &["--only", "left"]].concat())
        .says(1, &["--only: `left`, but certified with all robots"]);
    let json = session.run(&[&REQUIRED[..], &["--speed", "0.5", "--format", "json"]].concat());
    assert_eq!(json.json()["differences"][0], "--speed: 0.5, but certified with 1");
}

#[test]
fn change_without_effect_on_played_steps_needs_no_new_certificate() {
    let session = certified();
    replace(&session, "show.yaml", "{robots: left,", "{cue: back, robots: left,");
    replace(
        &session,
        "fleet.yaml",
        "left: {init: arm.yaml, address: sim",
        "left: {init: arm.yaml, simulate: {jitter: 1us}, address: sim",
    );
    session.play(&REQUIRED).says(0, &["show: done"]);
}

#[test]
fn incomplete_or_altered_certificate_is_refused_with_exit_code_2() {
    let session = certified();
    let whole = fs::read_to_string(session.path("show.cert.json")).unwrap();
    session.file("show.cert.json", &whole[..whole.len() / 2]);
    session.run(&REQUIRED).says(2, &["is not a complete certificate", "--certify"]);
    session.file("show.cert.json", whole.replacen("\"seed\": 0", "\"seed\": 1", 1));
    session.run(&REQUIRED).says(2, &["was changed after it was written"]);
    session.file("show.cert.json", whole.replacen("\"certificate\": 1", "\"certificate\": 9", 1));
    session.run(&REQUIRED).says(2, &["version 9", "expected version 1"]);
    fs::remove_file(session.path("show.cert.json")).unwrap();
    session.run(&REQUIRED).says(2, &["cannot read the certificate `show.cert.json`"]);
}

#[test]
fn failed_guarantee_is_named_and_no_certificate_is_written() {
    let session = session();
    replace(
        &session,
        "fleet.yaml",
        "right: {init: arm.yaml, address: sim",
        "right: {init: arm.yaml, simulate: {fault: refuse}, address: sim",
    );
    let ran = certify(&session);
    ran.says(
        1,
        &[
            "no fault: the mission did not succeed although no fault was injected:",
            "no certificate was written, because a guarantee did not hold",
        ],
    );
    assert!(!session.path("show.cert.json").exists());
}

#[test]
fn failed_optional_robot_is_left_out_and_others_play() {
    let session = session();
    replace(
        &session,
        "show.yaml",
        "start_tolerance: 1s",
        "start_tolerance: 1s\non_failure: {default: stop, right: without}",
    );
    certify(&session).says(0, &["certified plan"]);
    let text = fs::read_to_string(session.path("show.cert.json")).unwrap();
    let certificate: Value = serde_json::from_str(&text).unwrap();
    let refuses =
        |trial: &&Value| trial["injected"] == serde_json::json!({"fault": "refuses", "robot": "right"});
    let trial = certificate["trials"].as_array().unwrap().iter().find(refuses).unwrap();
    assert_eq!((&trial["outcome"], &trial["moved"]), (&"done_without".into(), &serde_json::json!(["left"])));
}

#[test]
fn certificate_never_overwrites_its_source() {
    let session = session();
    session
        .run(&["dry-run", "show.yaml", "--certify", "show.yaml"])
        .says(2, &["the output would overwrite its own source `show.yaml`"]);
    session.file("arm.yaml", ARM);
}

#[test]
fn certificate_refuses_options_it_does_not_cover() {
    let session = session();
    for more in [["--acts", "2"], ["--world", "world.yaml"], ["--trials", "10"], ["--html", "show.html"]] {
        session
            .run(&[&["dry-run", "show.yaml", "--certify", "show.cert.json"][..], &more].concat())
            .says(2, &["cannot be used with", more[0]]);
    }
}
