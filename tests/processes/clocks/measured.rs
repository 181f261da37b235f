//! Checks that the recording of a mission reproduces the delays and clocks of the network on which it was played.

use std::fs;
use std::path::Path;
use std::time::Duration;

use downbeat_scripts::{Delay, read_fleet, read_world};
use serde_json::Value;

use stage::Via;
use stage::play::CHAIN;
use stage::session::Session;

/// Records a mission of two simulated arms. Their messages take 20 to 28 ms in each direction, and the left arm has no NTP.
fn recorded() -> Session {
    let session = Session::new();
    session.file(
        "fleet.yaml",
        "robots:
  left: {init: arm.yaml, address: sim, clock: measured, simulate: {clock_offset: 120ms, ntp_error: none, delay: [20ms, 28ms]}}
  right: {init: arm.yaml, address: sim, simulate: {clock_offset: -80ms, delay: [20ms, 28ms]}}
",
    );
    session.file(
        "show.yaml",
        "scenario: show
start_tolerance: 100ms
cues:
  - {at: 0s, robots: [left, right], tracks: {shoulder: [{at: 0s, to: 0}, {at: 4s, to: 60}]}}
",
    );
    session.run(&["run", "show.yaml", "--record", "show.mcap"]).says(0, &["done"]);
    session
}

fn ms(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Checks that a value lies in a range. Busy machines make delays longer, never shorter.
#[track_caller]
fn between(value: &Value, least: f64, most: f64) {
    assert!((least..=most).contains(&ms(value)), "{value} is not from {least} to {most}");
}

#[test]
fn recording_reproduces_simulated_delays_and_clocks() {
    let session = recorded();
    let measured = session.run(&["world", "show.mcap", "--format", "json"]).json();
    for (robot, offset) in [(0, 120.0), (1, 0.0)] {
        let robot = &measured["robots"][robot];
        assert_eq!(robot["link"]["method"], "each_way", "{robot}");
        assert!(ms(&robot["link"]["exchanges"]) > 10.0, "{robot}");
        between(&robot["link"]["delay_ms"]["least"], 19.5, 24.0);
        between(&robot["link"]["delay_ms"]["p50"], 21.0, 30.0);
        between(&robot["clock"]["offset_ms"], offset - 4.0, offset + 4.0);
    }
    assert_eq!(measured["robots"][0]["clock"]["follows"], "measured");
    assert_eq!(measured["robots"][1]["clock"]["follows"], "ntp");

    session
        .run(&["world", "show.mcap", "--output", "world.yaml"])
        .says(0, &["wrote world.yaml: 2 links measured"]);
    session
        .run(&["world", "show.mcap", "--output", "world.yaml"])
        .says(2, &["`world.yaml` already exists; --force"]);
    session.run(&["world", "show.mcap", "--output", "world.yaml", "--force"]).says(0, &[]);
    session.run(&["world", "show.mcap", "--output", "show.mcap", "--force"]).says(2, &["would overwrite"]);
    let text = fs::read_to_string(session.path("world.yaml")).unwrap();
    assert_eq!(session.run(&["world", "show.mcap"]).out(), text, "twice the same");
    let fleet = read_fleet(&session.path("fleet.yaml")).0.unwrap();
    let (world, findings) = read_world(&session.path("world.yaml"), &fleet, &[]);
    let world = world.unwrap_or_else(|| panic!("{text}{findings:?}"));
    assert!(matches!(world.links[1].as_ref().unwrap().delay, Delay::Quantiles(_)), "{text}");
    assert!(world.clocks[0].as_ref().unwrap().offset.is_some(), "{text}");
    assert!(world.clocks[1].as_ref().unwrap().error.is_some(), "{text}");

    let whole = fs::read(session.path("show.mcap")).unwrap();
    session.file("cut.mcap", &whole[..whole.len() * 2 / 3]);
    session.run(&["world", "cut.mcap"]).says(2, &["`cut.mcap` is incomplete: after ", "--partial measures"]);
    session.run(&["world", "cut.mcap", "--partial"]).says(0, &["world: show-", "# The file is incomplete: "]);
    session.run(&["world", "none.mcap"]).says(2, &["there is no such file"]);
}

#[test]
fn journal_yields_only_measured_clocks_and_nothing_if_all_follow_ntp() {
    let session = recorded();
    let state = fs::read_dir(session.path("state")).unwrap().map(|entry| entry.unwrap().path());
    let folder = state.into_iter().find(|folder| folder.join("journal").exists()).unwrap();
    let ran = session.run(&["world", folder.to_str().unwrap()]);
    ran.says(0, &["# A journal contains no messages", "left: {offset: 1"]);
    assert!(!ran.out().contains("links:") && !ran.out().contains("right: {"), "{}", ran.out());
    session.file(
        "fleet.yaml",
        fs::read_to_string(session.path("fleet.yaml"))
            .unwrap()
            .replace("clock: measured, ", "")
            .replace("ntp_error: none, ", ""),
    );
    fs::remove_dir_all(session.path("state")).unwrap();
    session.run(&["run", "show.yaml"]).says(0, &["done"]);
    let state = fs::read_dir(session.path("state")).unwrap().map(|entry| entry.unwrap().path());
    let folder =
        state.into_iter().find(|folder: &std::path::PathBuf| Path::join(folder, "journal").exists()).unwrap();
    session.run(&["world", folder.to_str().unwrap()]).says(2, &["run --record FILE"]);
}

#[test]
fn proxy_delay_is_measured_one_way() {
    let stage = CHAIN.stage(&[Via::Proxy]);
    stage.robots[0].link.as_ref().unwrap().delay(Duration::from_millis(30));
    let ended = stage.run(&["run", "play.yaml", "--record", "play.mcap"]);
    assert_eq!(ended.code, Some(0), "{ended}");
    let ended = stage.run(&["world", "play.mcap", "--format", "json"]);
    let measured: Value = serde_json::from_str(&ended.out).unwrap();
    between(&measured["robots"][0]["link"]["delay_ms"]["least"], 29.5, 36.0);
    between(&measured["robots"][0]["link"]["delay_ms"]["p50"], 29.5, 45.0);
}
