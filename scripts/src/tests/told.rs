//! The text of findings, and the conditions for reporting them.

use super::numbers::{compiled, compiled_with};
use super::robot;
use crate::{Code, Compiled, Fleet, FleetRobot, NoFiles, Source, compile, did_you_mean};

fn codes(compiled: &Compiled) -> Vec<Code> {
    compiled.findings.iter().map(|finding| finding.code).collect()
}

#[track_caller]
fn says(text: &str, expected: &[&str]) {
    let compiled = compiled(text);
    let shown = crate::render(&compiled.findings, false);
    for part in expected {
        assert!(shown.contains(part), "{part:?} is not in\n{shown}");
    }
}

#[test]
fn different_values_at_same_instant_are_an_overlap() {
    let lamp = |cues: &str| {
        let found = super::numbers::compiled(&format!("cues:\n{cues}")).findings;
        found.iter().map(|finding| (finding.code, finding.line)).collect::<Vec<_>>()
    };
    let cue = |name: &str, when: &str, keys: &str| {
        format!("  - {{cue: {name}, {when}, robots: bot, tracks: {{lamp: [{keys}]}}}}\n")
    };
    let set = |value: u32| format!("{{at: 0s, to: {value}}}");
    let fade = "{at: 0s, to: 30}, {at: 1s, to: 60}";
    let overlap = |line| vec![(Code::Overlap, line)];
    assert_eq!(lamp(&(cue("a", "at: 1s", &set(10)) + &cue("b", "at: 1s", &set(50)))), overlap(4));
    assert_eq!(lamp(&(cue("a", "at: 1s", &set(10)) + &cue("b", "at: 1s", fade))), overlap(4));
    assert_eq!(lamp(&(cue("a", "at: 1s", fade) + &cue("b", "at: 1s", &set(10)))).len(), 1);
    assert_eq!(lamp(&(cue("a", "at: 1s", &set(10)) + &cue("b", "after: a", &set(50)))), overlap(4));
    // One movement follows the other, or both set the same value.
    assert_eq!(lamp(&(cue("a", "at: 1s", fade) + &cue("b", "after: a", &set(50)))), []);
    assert_eq!(lamp(&(cue("a", "at: 1s", &set(10)) + &cue("b", "at: 1s", &set(10)))), []);
}

#[test]
fn only_similar_words_are_suggested() {
    assert_eq!(did_you_mean("spread", ["read", "at"]), None);
    assert_eq!(did_you_mean("if", ["at", "of", "cue"]), None);
    assert_eq!(did_you_mean("sm", ["ms", "s"]).as_deref(), Some("did you mean `ms`?"));
    assert_eq!(did_you_mean("cues", ["cue"]).as_deref(), Some("did you mean `cue`?"));
    assert_eq!(did_you_mean("shoulder", ["shuolder", "elbow"]).as_deref(), Some("did you mean `shuolder`?"));
    let of_a_name = did_you_mean("forms", ["cues", "formations", "for"]);
    assert_eq!(of_a_name.as_deref(), Some("did you mean `formations`?"));
    assert_eq!(did_you_mean("for", ["formations"]), None);
    says("cues: [{robots: bot, move: x}]\n", &["a move that is defined under `moves`"]);
    let of_the_protocol = "cues: [{robots: bot, tracks: {lamp: {control_type: speed, keyframes: []}}}]\n";
    says(of_the_protocol, &["unknown key `control_type`", "did you mean `control`?"]);
}

const PARAMETERS: &str = "moves:\n  go:\n    parameters: {to: ~}\n    tracks: {lamp: [{at: 0s, to: $to}]}\n";

#[test]
fn parameters_may_be_set_only_by_overrides() {
    let cue = "cues: [{robots: bot, move: go, overrides: {bot: {parameters: {to: 5}}}}]\n";
    assert_eq!(codes(&compiled(&format!("{PARAMETERS}{cue}"))), []);
    let without = "cues: [{robots: bot, move: go}]\n";
    assert_eq!(codes(&compiled(&format!("{PARAMETERS}{without}"))), [Code::Variable]);
}

#[test]
fn unreadable_time_causes_no_overlap_finding() {
    let track = "robots: bot, tracks: {lamp: [{at: 0s, to: 1}, {at: 2s, to: 2}]}";
    let text = format!("cues:\n  - {{cue: a, {track}}}\n  - {{cue: b, at: 5 parsecs, {track}}}\n");
    assert_eq!(codes(&compiled(&text)), [Code::BadDuration]);
    let late = format!("cues:\n  - {{cue: a, {track}, duration: 2 parsecs, end_by: 1s}}\n");
    assert_eq!(codes(&compiled(&late)), [Code::BadDuration]);
}

#[test]
fn one_fault_of_many_robots_is_one_finding() {
    let robots: Vec<FleetRobot> =
        (0..8).map(|n| FleetRobot { id: format!("r{n}").parse().unwrap(), ..robot() }).collect();
    let fleet = Fleet { robots, ..Fleet::default() };
    let names = (0..8).map(|n| format!("r{n}")).collect::<Vec<_>>().join(", ");
    let cue = |at: &str| {
        format!(
            "  - {{cue: c{at}, at: {at}, robots: [{names}], tracks: {{d: [{{at: 0s, to: 0}}, {{at: 3s, to: 9}}]}}}}\n"
        )
    };
    let text = format!("scenario: s\ncues:\n{}{}", cue("0s"), cue("2s"));
    let compiled = compile(&Source { name: "s.yaml".into(), text }, &fleet, &NoFiles);
    let overlaps: Vec<_> = compiled.findings.iter().filter(|finding| finding.code == Code::Overlap).collect();
    assert_eq!(overlaps.len(), 1, "{overlaps:?}");
    assert!(
        overlaps[0].message.contains("`d` of 8 robots (`r0`, `r1`, `r2` and 5 more)"),
        "{}",
        overlaps[0].message
    );
}

#[test]
fn lags_may_be_negative() {
    let start = |keys: &str| {
        let track = "robots: bot, tracks: {lamp: [{at: 0s, to: 1}, {at: 1s, to: 2}]}";
        let text = format!("cues:\n  - {{cue: a, at: 5s, duration: 2s}}\n  - {{cue: b, {keys}, {track}}}\n");
        let compiled = compiled(&text);
        let choreography = compiled.choreography.unwrap_or_else(|| panic!("{keys} {:?}", compiled.findings));
        choreography.acts[0].cues[1].start.as_millis_f64()
    };
    assert_eq!(start("with: a + -2s..3s"), 3_000.0);
    assert_eq!(start("with: a - 2s"), 3_000.0);
    assert_eq!(start("after: a + -500ms"), 6_500.0);
    assert_eq!(start("after: a - 500ms"), 6_500.0);
    assert_eq!(start("before: a + 1s, with: end of a - 2s"), 5_000.0);
    assert_eq!(start("before: a - -1s, with: end of a - 2s"), 5_000.0);
}

#[test]
fn findings_use_correct_names_for_parts_of_movement() {
    let track = |track: &str| format!("cues: [{{robots: bot, tracks: {{arm: {track}}}}}]\n");
    says(
        &track("{polynomial: [{for: 1s, coefficients: [0]}, {for: 1s, coefficients: [0, 900]}]}"),
        &["piece 2: "],
    );
    says(&track("{spline: [{at: 0s, to: 0}, {at: 1s, to: 900}]}"), &["point 2: "]);
    says(
        &track("{spline: [{at: 1s, to: 0}, {at: 0s, to: 9}]}"),
        &[
            "the point at 0 ms is not later than the previous one at 1 s",
            "sort the points of a track by time",
        ],
    );
    says(&track("[{at: 0s, to: 0}, {at: 1s, to: 900}]"), &["keyframe 2: "]);
}

#[test]
fn loop_with_too_many_steps_gets_hint_to_reduce_repetitions() {
    let track = |keys: &str| {
        format!(
            "cues: [{{cue: c, robots: bot, {keys} tracks: {{lamp: [{{at: 0s, to: 0}}, {{at: 1ms, to: 1}}, {{at: 2ms, to: 0}}]}}}}]\n"
        )
    };
    says(&track("repeat: 90000,"), &["reduce the number of repetitions in `c`"]);
}

#[test]
fn common_yaml_mistakes_are_explained() {
    says("cues:\n\t- {robots: bot}\n", &["spaces", "tab"]);
    says("cues:\n  - at:0s\n    robots: bot\n", &["a space after the colon"]);
    says("cues: [{at:0s, robots: bot}]\n", &["a space after the colon: `at: 0s`"]);
    says("fleet:f.yaml\ncues: []\n", &["a space after the colon"]);
    says("cues: []\n\u{feff}scenario: s\n", &["byte order mark"]);
    let compiled = compile(
        &Source { name: "s.yaml".into(), text: "\u{feff}scenario: s\ncues: [{cue: mark}]\n".into() },
        &Fleet { robots: vec![robot()], ..Fleet::default() },
        &NoFiles,
    );
    assert_eq!(codes(&compiled), []);
}

#[test]
fn csv_header_after_hash_is_recognised() {
    let csv = "# recorded in May\n# t, v\n0,0\n1,5\n";
    let text = "cues: [{robots: bot, tracks: {lamp: {samples: {file: c.csv, time: t, value: v}}}}]\n";
    assert_eq!(codes(&compiled_with(text, csv)), []);
}

#[test]
fn values_differing_per_robot_are_one_finding() {
    let robots: Vec<FleetRobot> =
        (0..12).map(|n| FleetRobot { id: format!("r{n}").parse().unwrap(), ..robot() }).collect();
    let all = robots.iter().map(|robot| robot.id.clone()).collect();
    let fleet = Fleet { robots, groups: [("all".to_owned(), all)].into(), ..Fleet::default() };
    let found = |to: &str| {
        let tracks = format!("tracks: {{d: [{{at: 0s, to: 0}}, {{at: 1s, to: {to}}}]}}");
        let text = format!("scenario: s\ncues: [{{robots: all, {tracks}}}]\n");
        let found = compile(&Source { name: "s.yaml".into(), text }, &fleet, &NoFiles).findings;
        found.into_iter().map(|finding| finding.message).collect::<Vec<_>>()
    };
    let limits = "keyframe 2: 110 lies outside the limits for position of `d` on 12 robots (`r0`, `r1`, `r2` and 9 more)";
    assert_eq!(found("99 + $index"), [limits]);
    let grid = found("10.1 + $index");
    assert!(
        matches!(grid.as_slice(), [only] if only.ends_with("on 12 robots (`r0`, `r1`, `r2` and 9 more)")),
        "{grid:?}"
    );
    let twice = "scenario: s\ncues: [{robots: [all, all], tracks: {d: [{at: 0s, to: 0}]}}]\n";
    let found = compile(&Source { name: "s.yaml".into(), text: twice.into() }, &fleet, &NoFiles).findings;
    assert!(matches!(found.as_slice(), [only] if only.code == Code::ListedTwice), "{found:#?}");
}
