//! Tests that the published schemas accept and reject the same texts as the parser, as far as a schema can express the parser's rules.

use serde_json::Value;

use crate::documents::scenarios_of;
use stage::schema::validator;
use stage::session::root;

#[track_caller]
fn check_sound(validator: &jsonschema::Validator, name: &str, text: &str) {
    let document: Value = serde_yaml::from_str(text).unwrap();
    let errors: Vec<_> =
        validator.iter_errors(&document).map(|e| format!("{} at {}", e, e.instance_path)).collect();
    assert!(errors.is_empty(), "{name}: {errors:#?}");
}

#[test]
fn every_example_and_documented_scenario_is_valid() {
    let validator = validator("scenario");
    for entry in std::fs::read_dir(root().join("scripts/examples")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "yaml") {
            check_sound(&validator, &path.display().to_string(), &std::fs::read_to_string(&path).unwrap());
        }
    }
    for scenario in scenarios_of("docs/scenario.md") {
        check_sound(&validator, "docs/scenario.md", &scenario);
    }
}

#[test]
fn demo_fleet_is_valid() {
    let text = std::fs::read_to_string(root().join("fleet.yaml")).unwrap();
    check_sound(&validator("fleet"), "fleet.yaml", &text);
}

#[test]
fn invalid_scenarios_and_fleets_are_rejected() {
    let cue = |keys: &str| {
        format!("scenario: s\ncues: [{{robots: a, tracks: {{d: [{{at: 0s, to: 1}}]}}, {keys}}}]\n")
    };
    let track = |track: &str| format!("scenario: s\ncues: [{{robots: a, tracks: {{d: {track}}}}}]\n");
    let scenarios = [
        "cues: []\n".to_owned(),
        "scenario: s\n".to_owned(),
        "scenario: s\ncues: []\n".to_owned(),
        "scenario: s\ncues: [{cue: a}]\nacts: [{cues: [{cue: a}]}]\n".to_owned(),
        "scenario: s\nled: 2s\ncues: [{cue: a}]\n".to_owned(),
        "scenario: s\nlead: 2\ncues: [{cue: a}]\n".to_owned(),
        cue("att: 1s"),
        cue("at: soon"),
        cue("duration: 5"),
        cue("repeat: 0"),
        cue("off_grid: maybe"),
        cue("mirror: 3"),
        track("[{at: 0s}]"),
        track("[{at: 0s, to: high}]"),
        track("[{at: 0s, to: 1, ease: quick}]"),
        track("{wave: {period: 1s, for: 2s}}"),
        track("{control: sensor, keyframes: []}"),
    ];
    let validator_of_scenarios = validator("scenario");
    for text in scenarios {
        let document: Value = serde_yaml::from_str(&text).unwrap();
        assert!(!validator_of_scenarios.is_valid(&document), "{text}");
    }
    let validator = validator("fleet");
    for text in [
        "robots: {}\n",
        "robots: {a: {init: x.yaml}}\n",
        "robots: {a: {init: x.yaml, address: 'udp://x'}}\n",
        "robots: {a: {init: x.yaml, address: sim, limits: {d: {speed: 0}}}}\n",
    ] {
        let document: Value = serde_yaml::from_str(text).unwrap();
        assert!(!validator.is_valid(&document), "{text}");
    }
}
