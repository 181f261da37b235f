//! Any text as a scenario for a small fleet: no panic, no hang, bounded memory; findings stand in the text, and there is a
//! choreography exactly when there is no error.
#![no_main]

use std::collections::BTreeMap;
use std::sync::LazyLock;

use downbeat_scripts::{
    Address, Fleet, FleetRobot, NoFiles, RateLimits, Severity, Source,
    compile, render, sarif,
};
use libfuzzer_sys::fuzz_target;

const ARM: &str = r#"{"id": "arm", "api_version": "1", "devices": [
  {"id": "d", "name": "d", "default_value": 0, "interpolation": "linear", "script_queue": 2, "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "speed": {"min_value": -60, "max_value": 60, "granularity": 1},
     "script": {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 64, "control_types": ["position"]}}},
  {"id": "s", "name": "s", "available_control_types": {"sensor": {"min_value": 0, "max_value": 4}}}]}"#;
const ROVER: &str = r#"{"id": "rover", "api_version": "1", "devices": [
  {"id": "d", "name": "d", "default_value": 0, "available_control_types": {
     "speed": {"min_value": -1, "max_value": 1, "granularity": 0.001, "max_error": 0.1},
     "script": {"min_value": -1, "max_value": 1, "granularity": 0.001, "max_number_of_steps": 64}}},
  {"id": "c", "name": "c", "available_control_types": {"custom_1": {},
     "script": {"min_value": -1, "max_value": 1, "granularity": 1, "max_number_of_steps": 64}}}]}"#;

static FLEET: LazyLock<Fleet> = LazyLock::new(|| {
    let robot = |name: &str, block: &str| {
        let mut init: urrcp::InitializationBlock = serde_json::from_str(block).unwrap();
        init.id = urrcp::RobotId::new(name).unwrap();
        let limits =
            BTreeMap::from([("d".to_owned(), RateLimits { speed: None, acceleration: Some(500.0) })]);
        FleetRobot { limits, ..FleetRobot::new(init.id.clone(), Address::Simulated, Some(init)) }
    };
    let robots = vec![robot("a", ARM), robot("b", ARM), robot("r", ROVER)];
    let groups = BTreeMap::from([("ab".to_owned(), vec![robots[0].id.clone(), robots[1].id.clone()])]);
    Fleet { robots, groups, ..Fleet::default() }
});

fuzz_target!(|text: &str| {
    let source = Source { name: "s.yaml".into(), text: text.to_owned() };
    let compiled = compile(&source, &FLEET, &NoFiles);
    let error = |finding: &downbeat_scripts::Finding| finding.severity == Severity::Error;
    assert_eq!(compiled.choreography.is_none(), compiled.findings.iter().any(error));
    let lines = text.matches(['\n', '\r']).count() + 1;
    for finding in &compiled.findings {
        assert!(finding.line <= lines, "{finding:?}");
    }
    let shown = render(&compiled.findings, true);
    assert!(!shown.is_empty());
    let _document = sarif(&compiled.findings).to_string();
});
