//! The output of `preflight` and `fleet ping` before a show: readings, clocks and hardware.

use serde_json::{Value, json};

use stage::session::{ARM, Ran, Session};

const SCENARIO: &str = "scenario: test
cues: [{at: 0s, robots: arms, tracks: {shoulder: [{at: 0s, to: 10}, {at: 1s, to: 0}]}}]
";

/// Returns a session with two arms that can report their position and have two further sensors. `left` and `right` are the arms' keys in
/// the fleet file.
fn session(left: &str, right: &str) -> Session {
    let session = Session::new();
    let arm = ARM.replace("      script:", "      sensor: {min_value: 0, max_value: 90}\n      script:")
        + "  - id: battery\n    unit: '%'\n    available_control_types:\n      sensor: {min_value: 0, max_value: 100}\n"
        + "  - id: range\n    unit: m\n    available_control_types:\n      sensor: {min_value: 0, max_value: 10}\n";
    session.file("arm.yaml", arm).file("test.yaml", SCENARIO);
    session.file(
        "fleet.yaml",
        format!("robots:\n  left: {{init: arm.yaml, {left}}}\n  right: {{init: arm.yaml, {right}}}\ngroups: {{arms: [left, right]}}\n"),
    );
    session
}

const SIM: &str = "address: sim";
const A_MINUTE_AHEAD: &str = "address: sim, simulate: {clock_offset: 60s, ntp_error: none}";

/// Returns the result of one check of a robot, from the JSON output of `preflight`.
fn verdict(ran: &Ran, robot: &str, check: &str) -> Value {
    let report = ran.json();
    let rows = report["preflight"]["rows"].as_array().unwrap();
    let row = rows.iter().find(|row| row["robot"] == robot).unwrap();
    let checks = row["checks"].as_array().unwrap();
    checks.iter().find(|of| of[0] == check).unwrap()[1]["verdict"].clone()
}

#[test]
fn preflight_shows_device_positions_and_sensor_readings() {
    let session = session("address: sim, require: {battery: above 30}", SIM);
    let ran = session.run(&["preflight", "test.yaml"]);
    ran.says(1, &["battery", "50 %", "above 30 %", "shoulder", "0 deg", "10 ±1 deg", "range", "5 m"]);
    let report = session.run(&["preflight", "test.yaml", "--format", "json"]).json();
    let readings = &report["preflight"]["rows"][0]["readings"];
    let expected = json!([
        {"device": "battery", "reading": 50.0, "unit": "%", "expected": "above 30"},
        {"device": "shoulder", "reading": 0.0, "unit": "deg", "expected": "10 ±1"},
        {"device": "range", "reading": 5.0, "unit": "m"},
    ]);
    assert_eq!(*readings, expected);
}

#[test]
fn preflight_table_fits_the_terminal_width() {
    let session = session(SIM, SIM);
    let ran = session.run(&["preflight", "test.yaml"]);
    let table = ran.out();
    let table = table.lines().skip(1).take_while(|line| !line.contains("keyframe expects"));
    for line in table {
        assert!(line.chars().count() <= 80, "{} characters: {line}", line.chars().count());
    }
}

#[test]
fn clock_off_by_a_minute_is_shown_as_failure_and_never_as_agreeing() {
    let session = session(SIM, A_MINUTE_AHEAD);
    let mut command = session.command(&["preflight", "test.yaml"]);
    let coloured = Ran(command.env("CLICOLOR_FORCE", "1").output().unwrap());
    coloured.says(1, &["right: clock off by 60 s", "\u{1b}[31mFAILURE"]);
    let ran = session.run(&["preflight", "test.yaml", "--format", "json"]);
    assert_eq!(verdict(&ran, "right", "clock"), "failure");
    let ran = session.run(&["run", "test.yaml"]);
    ran.says(1, &["clock off by 60 s"]);
    assert!(!ran.text().contains("clocks agree"), "{}", ran.text());
}

#[test]
fn ping_fails_for_a_clock_beyond_the_tolerance_unless_measured() {
    let off = session(SIM, A_MINUTE_AHEAD);
    off.run(&["fleet", "ping"]).says(1, &["its clock is off by more than 10 ms", "60 s"]);
    off.run(&["fleet", "ping", "--tolerance", "2m"]).says(0, &["60 s"]);
    let mut command = off.command(&["fleet", "ping"]);
    let coloured = Ran(command.env("CLICOLOR_FORCE", "1").output().unwrap());
    let red = coloured.out().lines().filter(|line| line.contains("\u{1b}[31m")).count();
    assert_eq!(red, 1, "{}", coloured.out());
    let measured = session(SIM, &format!("{A_MINUTE_AHEAD}, clock: measured"));
    measured.run(&["fleet", "ping"]).says(0, &["60 s"]);
}

#[test]
fn unavailable_hardware_is_reported_under_hardware() {
    let session = session(SIM, "address: 'program:exit 1'");
    let ran = session.run(&["preflight", "test.yaml", "--start-programs", "--format", "json"]);
    assert_eq!(ran.code(), 1, "{}", ran.text());
    assert_eq!(verdict(&ran, "right", "hardware"), "failure", "{}", ran.text());
    assert_ne!(verdict(&ran, "right", "free"), "failure");
    assert_eq!(verdict(&ran, "left", "hardware"), "pass");
    let ran = session.run(&["preflight", "test.yaml", "--start-programs"]);
    ran.says(1, &["right hardware: not available"]);
}
