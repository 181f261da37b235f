//! Missions whose scheduler was killed. Another process resumes, refuses or withdraws them, and reports what happened before.

use std::process::Command;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use stage::quiet::await_that;
use stage::session::Session;
use stage::{Process, Proxy};

use super::missions::{evening, on_tcp, ports, robot, start_command};

/// Starts a command, and kills it once the journal of its mission contains `record`.
#[track_caller]
fn killed_after(session: &Session, command: Command, record: &str) {
    let (child, _) = start_command(command, "");
    await_record(session, record);
    drop(child);
}

/// Starts a command, and kills it 100 ms after the start of an act. The record `committed` alone does not suffice, because a commitment
/// is recorded before it is sent.
#[track_caller]
fn killed_in_act(session: &Session, command: Command, number: u32) {
    let (child, _) = start_command(command, "");
    await_record(session, &format!(r#""record":"committed","number":{number}"#));
    let journals = journals(session);
    let start = journals.rsplit_once(r#""start":""#).unwrap().1.split_once('"').unwrap().0;
    let start = UNIX_EPOCH + Duration::from_nanos(u64::try_from(stage::nanos(start)).unwrap());
    await_that("the start", || SystemTime::now() > start + Duration::from_millis(100));
    drop(child);
}

#[track_caller]
fn await_record(session: &Session, record: &str) {
    await_that(record, || journals(session).contains(record));
}

fn journals(session: &Session) -> String {
    let missions = std::fs::read_dir(session.path("state")).into_iter().flatten().flatten();
    missions.filter_map(|mission| std::fs::read_to_string(mission.path().join("journal")).ok()).collect()
}

const OPENING_ENDED: &str = r#""record":"act_ended""#;

#[test]
fn resumed_mission_without_active_act_ends_as_failed() {
    let session = evening("wait: operator");
    let _sim = on_tcp(&session);
    killed_after(&session, session.command(&["run", "evening.yaml"]), OPENING_ENDED);
    let resumed = session.run(&["resume"]);
    let why = "the process of the mission died: no act was under way";
    resumed.says(1, &["evening: failed", why, "left: stop confirmed", "right: stop confirmed"]);
    assert!(journals(&session).contains(r#""record":"ended","outcome":"failed""#), "{}", resumed.text());
}

#[test]
fn mission_stopped_by_operator_after_a_crash_is_recorded_as_stopped() {
    let session = evening("wait: operator");
    let _sim = on_tcp(&session);
    killed_after(&session, session.command(&["run", "evening.yaml"]), OPENING_ENDED);
    let stopped = session.run(&["stop", "--format", "json"]);
    stopped.says(0, &[]);
    assert_eq!(stopped.json()["outcome"], "stopped", "{}", stopped.text());
    assert!(journals(&session).contains(r#""record":"ended","outcome":"stopped""#), "{}", stopped.text());
}

/// Returns a session with two acts, the second of which takes longer than a resumption. The process contains the robots.
fn with_a_long_finale() -> (Session, Process) {
    let session = evening("");
    let text = std::fs::read_to_string(session.path("evening.yaml")).unwrap();
    let (opening, finale) = text.split_once("- act: finale").unwrap();
    let finale = finale.replace("400ms", "4s");
    let leases = "stop_condition: {running: 20s}\nacts:";
    session.file("evening.yaml", format!("{opening}- act: finale{finale}").replace("acts:", leases));
    let sim = on_tcp(&session);
    (session, sim)
}

#[test]
fn resumed_mission_report_counts_acts_completed_before_the_crash() {
    let (session, _sim) = with_a_long_finale();
    killed_in_act(&session, session.command(&["run", "evening.yaml"]), 1);
    let resumed = session.run(&["resume", "--format", "json"]);
    let report = resumed.json();
    assert_eq!(report["outcome"], "done", "{}", resumed.text());
    assert_eq!(report["acts"].as_array().map(Vec::len), Some(2), "{report:#}");
    for robot in report["robots"].as_array().unwrap() {
        assert_eq!((&robot["scripts"], &robot["steps_done"]), (&2.into(), &4.into()), "{report:#}");
    }
}

#[test]
fn mission_is_not_resumed_if_another_act_was_edited() {
    let (session, _sim) = with_a_long_finale();
    let text = std::fs::read_to_string(session.path("evening.yaml")).unwrap();
    let text = text.replace("400ms", "4s");
    session.file("evening.yaml", &text);
    killed_in_act(&session, session.command(&["run", "evening.yaml"]), 0);
    let (opening, finale) = text.split_once("- act: finale").unwrap();
    session.file("evening.yaml", format!("{opening}- act: finale{}", finale.replace("to: 0}", "to: 10}")));
    let changed =
        "the plan differs from the one with which the mission began: the scenario or the fleet has changed";
    session.run(&["resume"]).says(1, &[changed, "restore the files", "`downbeat stop`"]);
    session.file("evening.yaml", &text);
    session.run(&["resume"]).says(0, &["evening: done"]);
}

#[test]
fn robot_left_out_before_crash_is_reported_with_failure_and_steps() {
    let session = Session::new();
    let keyframes = (0..16).map(|step| format!("{{at: {}ms, to: {step}}}", step * 500)).collect::<Vec<_>>();
    let scenario = "scenario: without\nstart_tolerance: 1s\non_failure: without\nstop_condition: {running: 1s}\ncues:\n  - {robots: arms, at: 0s, tracks: {shoulder: [";
    session
        .file("arm.yaml", stage::session::ARM.replace("max_number_of_steps: 8", "max_number_of_steps: 32"));
    session.file("without.yaml", format!("{scenario}{}]}}}}\n", keyframes.join(", ")));
    let (left, right) = ports(&session);
    let _robots = [robot(&session, "left", left), robot(&session, "right", right)];
    let link = Proxy::to(right);
    let fleet = std::fs::read_to_string(session.path("fleet.yaml")).unwrap();
    session.file("fleet.yaml", fleet.replace(&right.to_string(), &link.port.to_string()));
    let (child, _) = start_command(session.command(&["run", "without.yaml"]), "starting `");
    await_that("a step", || {
        let log = std::fs::read_to_string(session.path("right.jsonl")).unwrap_or_default();
        log.lines().filter_map(stage::Logged::read).filter(|entry| entry.motion == "set").count() > 1
    });
    link.interrupt();
    await_record(&session, r#""record":"dropped","robot":"right""#);
    drop(child);
    link.open();
    let resumed = session.run(&["resume", "--format", "json"]);
    let report = resumed.json();
    assert_eq!((resumed.code(), &report["outcome"]), (5, &"done_without".into()), "{}", resumed.text());
    let (robot, failure) = (&report["robots"][1], &report["failures"][0]);
    assert_eq!(
        (&failure["robot"], &failure["failure"]),
        (&"right".into(), &"link_down".into()),
        "{report:#}"
    );
    assert_eq!((&robot["standing"], &robot["scripts"]), (&"out".into(), &1.into()), "{report:#}");
    let steps = robot["steps_done"].as_u64().unwrap();
    assert!((1..16).contains(&steps), "{report:#}");
    assert_eq!(report["robots"][0]["steps_done"], 16, "{report:#}");
}
