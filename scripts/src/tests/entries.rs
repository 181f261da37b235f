//! Jumps of devices at the beginning of acts, after each transition between acts.

use crate::{Address, Code, Finding, Fleet, FleetRobot, NoFiles, Severity, Source, compile};

/// Returns a fleet of arms with a lamp, with or without a speed limit.
fn fleet(interpolation: &str, speed: bool) -> Fleet {
    let speed = if speed { r#""speed": {"min_value": -60, "max_value": 60, "granularity": 1},"# } else { "" };
    let block = format!(
        r#"{{"id": "arm", "api_version": "1", "devices": [
          {{"id": "d", "name": "d", "interpolation": "{interpolation}", "default_value": 0, "script_queue": 4,
            "available_control_types": {{
              "position": {{"min_value": 0, "max_value": 90, "granularity": 0.5}}, {speed}
              "script": {{"min_value": 0, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 200}}}}}}]}}"#
    );
    let block: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
    Fleet {
        robots: vec![FleetRobot::new(block.id.clone(), Address::Simulated, Some(block))],
        ..Fleet::default()
    }
}

/// Compiles acts with additional keys. Each act moves a device from one position to another in ten seconds. Returns the findings.
fn jumps(fleet: &Fleet, acts: &[(&str, &str, u32, u32)]) -> Vec<Finding> {
    let act = |(name, keys, from, to): &(&str, &str, u32, u32)| {
        let track = format!("[{{at: 0s, to: {from}}}, {{at: 10s, to: {to}, ease: smooth}}]");
        format!("  - {{act: {name}, {keys} cues: [{{at: 0s, robots: arm, tracks: {{d: {track}}}}}]}}\n")
    };
    let acts: String = acts.iter().map(act).collect();
    let text = format!("scenario: s\nstart_tolerance: 20ms\nacts:\n{acts}");
    let compiled = compile(&Source { name: "s.yaml".into(), text }, fleet, &NoFiles);
    let jumps = |finding: &Finding| finding.message.contains("has to jump");
    compiled.findings.into_iter().filter(jumps).collect()
}

fn codes(findings: &[Finding]) -> Vec<Code> {
    findings.iter().map(|finding| finding.code).collect()
}

#[test]
fn jump_between_acts_is_error_with_speed_limit_and_warning_without() {
    let acts = [("one", "", 0, 80), ("two", "", 10, 0)];
    let limited = jumps(&fleet("linear", true), &acts);
    assert_eq!(codes(&limited), [Code::TooFast]);
    assert_eq!(limited[0].severity, Severity::Error);
    assert!(limited[0].message.contains("from 80, where the act `one` leaves it, to 10"), "{limited:?}");
    assert_eq!(codes(&jumps(&fleet("linear", false), &acts)), [Code::Jump]);
    assert_eq!(codes(&jumps(&fleet("linear", true), &[("one", "", 0, 80), ("two", "", 80, 0)])), []);
}

#[test]
fn jump_of_hold_device_between_acts_is_error_only_with_speed_limit() {
    let acts = [("one", "", 0, 80), ("two", "", 10, 0)];
    assert_eq!(codes(&jumps(&fleet("hold", true), &acts)), [Code::TooFast]);
    assert_eq!(codes(&jumps(&fleet("hold", false), &acts)), []);
}

#[test]
fn jump_on_return_to_earlier_act_is_checked() {
    let wait = "wait: {sensor: arm/d, above: 3, timeout: 5s, otherwise: one},";
    let back = jumps(&fleet("linear", true), &[("one", "next: two,", 0, 80), ("two", wait, 80, 40)]);
    assert_eq!(codes(&back), [Code::TooFast], "the wait of `two` leads back to `one`: {back:?}");
    assert!(back[0].message.contains("from 80, where the act `one` leaves it, to 0"), "{back:?}");
}

#[test]
fn after_failure_devices_start_at_default_if_policy_may_send_them_home() {
    let home = ["home", "stop, arm: home"].map(|policy| (policy, vec![Code::TooFast]));
    let elsewhere = ["stop", "home, arm: stop"].map(|policy| (policy, vec![]));
    for (policy, expected) in home.into_iter().chain(elsewhere) {
        let keys = format!("on_failure: {{default: {policy}, then: bow}}, next: end,");
        let found = jumps(&fleet("linear", true), &[("one", &keys, 0, 80), ("bow", "", 30, 40)]);
        assert_eq!(codes(&found), expected, "{policy}: {found:?}");
    }
}

#[test]
fn act_that_does_not_move_device_keeps_its_position() {
    let text = "scenario: s
acts:
  - {act: one, cues: [{at: 0s, robots: arm, tracks: {d: [{at: 0s, to: 0}, {at: 10s, to: 80, ease: smooth}]}}]}
  - {act: pause, cues: [{at: 0s, duration: 3s}]}
  - {act: two, cues: [{at: 0s, robots: arm, tracks: {d: [{at: 0s, to: 10}, {at: 10s, to: 0, ease: smooth}]}}]}
";
    let source = Source { name: "s.yaml".into(), text: text.into() };
    let found = compile(&source, &fleet("linear", true), &NoFiles).findings;
    let message = found.iter().find(|finding| finding.code == Code::TooFast).map(|finding| &finding.message);
    assert!(message.is_some_and(|message| message.contains("where the act `one` leaves it")), "{found:#?}");
}

#[test]
fn certain_jump_back_to_act_is_error_even_if_start_may_match() {
    let wait = "wait: {sensor: arm/d, above: 3, timeout: 5s, otherwise: end}, next: one,";
    let back = jumps(&fleet("linear", true), &[("one", "next: two,", 30, 80), ("two", wait, 80, 0)]);
    assert!(back.iter().any(|finding| finding.severity == Severity::Error), "{back:#?}");
}

#[test]
fn speed_control_leaves_device_position_unknown() {
    let text = "scenario: s
stop_condition: {running: 1s}
acts:
  - {act: one, cues: [{at: 0s, robots: arm, tracks: {d: {control: speed, keyframes: [{at: 0s, to: 20}, {at: 2s, to: 0}]}}}]}
  - {act: two, cues: [{at: 0s, robots: arm, tracks: {d: [{at: 0s, to: 40}, {at: 10s, to: 0, ease: smooth}]}}]}
";
    let source = Source { name: "s.yaml".into(), text: text.into() };
    let found = compile(&source, &fleet("linear", true), &NoFiles).findings;
    assert!(!found.iter().any(|finding| finding.message.contains("has to jump")), "{found:#?}");
}
