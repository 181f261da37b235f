//! Expressions in scenarios: a scenario with expressions compiles to the same result as one with the numbers written out.

use std::collections::BTreeMap;

use super::numbers::compiled;
use super::robot;
use crate::{Compiled, Fleet, FleetRobot, NoFiles, Source, compile};

const BLOCK: &str = r#"{"id": "x", "api_version": "1", "devices": [
  {"id": "d", "name": "d", "default_value": 0, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -500, "max_value": 500, "granularity": 0.01, "max_error": 0.05},
     "script": {"min_value": -500, "max_value": 500, "granularity": 0.01, "max_number_of_steps": 10000}}}]}"#;

fn fleet() -> Fleet {
    let one = |name: &str| {
        let mut init: urrcp::InitializationBlock = serde_json::from_str(BLOCK).unwrap();
        init.id = urrcp::RobotId::new(name).unwrap();
        FleetRobot { id: init.id.clone(), init: Some(init), ..robot() }
    };
    let robots: Vec<FleetRobot> = ["a", "b", "c", "e"].map(one).into();
    let group = |ids: &[usize]| ids.iter().map(|index| robots[*index].id.clone()).collect();
    let groups = BTreeMap::from([
        ("all".to_owned(), group(&[0, 1, 2, 3])),
        ("back".to_owned(), group(&[3, 2])),
        ("empty".to_owned(), group(&[])),
    ]);
    Fleet { robots, groups, ..Fleet::default() }
}

fn of_four(text: &str) -> Compiled {
    compile(&Source { name: "s.yaml".into(), text: format!("scenario: s\n{text}") }, &fleet(), &NoFiles)
}

/// Returns the scripts of every robot.
#[track_caller]
fn scripts(text: &str) -> Vec<String> {
    let compiled = of_four(text);
    let choreography = compiled.choreography.unwrap_or_else(|| panic!("{text}\n{:#?}", compiled.findings));
    let robots = choreography.acts.iter().flat_map(|act| &act.plan.robots);
    robots.map(|robot| format!("{:?} {:?}", robot.robot, robot.scripts)).collect()
}

#[track_caller]
fn same(with: &str, without: &str) {
    let (with, without) = (scripts(with), scripts(without));
    assert_eq!(with.len(), without.len());
    for (a, b) in with.iter().zip(&without) {
        assert_eq!(a, b);
    }
}

/// Returns the findings as `line:column-width message`.
fn found(text: &str) -> Vec<String> {
    let one = |finding: &crate::Finding| {
        format!("{}:{}-{} {}", finding.line, finding.column, finding.width, finding.message)
    };
    of_four(text).findings.iter().map(one).collect()
}

#[test]
fn expressions_are_evaluated_per_robot() {
    same(
        "
variables: {r: 40, phase: 360 * $index / $count}
moves: {swing: {parameters: {size: 10, at: 1s}, tracks: {d: [{at: 0s, to: 0}, {at: $at, to: $size}]}}}
cues:
  - {robots: all, tracks: {d: {wave: {amplitude: $r / 2, period: 2s, phase: $phase, for: 4s}}}}
  - {cue: n, after: cue 1 + 2 * 500ms, robots: back, move: swing, parameters: {size: 10 + 5 * $index, at: 1s + $index * 250ms}}
  - {cue: m, after: n, robots: all, scale: $index + 1, mirror: $index % 2 == 1, repeat: $count - $index, tracks: {d: [{at: 0s, to: 0}, {at: 4s / 4, to: 2 * $r / 4}]}}
",
        "
moves: {swing: {parameters: {size: 10, at: 1s}, tracks: {d: [{at: 0s, to: 0}, {at: $at, to: $size}]}}}
cues:
  - robots: all
    tracks: {d: {wave: {amplitude: 20, period: 2s, phase: 0, for: 4s}}}
    overrides:
      b: {tracks: {d: {wave: {amplitude: 20, period: 2s, phase: 90, for: 4s}}}}
      c: {tracks: {d: {wave: {amplitude: 20, period: 2s, phase: 180, for: 4s}}}}
      e: {tracks: {d: {wave: {amplitude: 20, period: 2s, phase: 270, for: 4s}}}}
  - {cue: n, after: cue 1 + 1s, robots: back, move: swing, overrides: {c: {parameters: {size: 15, at: 1250ms}}}}
  - cue: m
    after: n
    robots: all
    tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 20}]}
    overrides: {a: {repeat: 4}, b: {scale: 2, mirror: true, repeat: 3}, c: {scale: 3, repeat: 2}, e: {scale: 4, mirror: true}}
",
    );
}

#[test]
fn overrides_are_evaluated_per_robot_including_roles() {
    same(
        "
roles: {front: [c, a]}
cues:
  - {robots: [front, b], tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 7}]}, overrides: {front: {tracks: {d: [{at: 0s, to: $index}, {at: 1s, to: $count}]}, delay: $index * 100ms}}}
",
        "
cues:
  - {robots: [c, a, b], tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 7}]}, overrides: {c: {tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 3}]}}, a: {tracks: {d: [{at: 0s, to: 1}, {at: 1s, to: 3}]}, delay: 100ms}}}
",
    );
}

#[test]
fn robots_with_equal_results_share_movement() {
    let compiled = of_four(
        "cues: [{robots: all, tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 20 * ($index % 2), ease: smooth}]}}]\n",
    );
    let choreography = compiled.choreography.unwrap();
    let robots = &choreography.acts[0].plan.robots;
    assert_eq!(format!("{:?}", robots[0].scripts), format!("{:?}", robots[2].scripts));
    assert_ne!(format!("{:?}", robots[0].scripts), format!("{:?}", robots[1].scripts));
}

#[test]
fn formula_with_index_matches_waves() {
    let wave =
        |phase: u32| format!("{{d: {{wave: {{amplitude: 30, period: 8s, phase: {phase}, for: 8s}}}}}}");
    let by_formula = "cues: [{robots: all, tracks: {d: {formula: \"30 * sin(2 * pi * t / 8s + 2 * pi * $index / $count)\", for: 8s}}}]\n";
    let by_wave = format!(
        "cues: [{{robots: all, tracks: {}, overrides: {{b: {{tracks: {}}}, c: {{tracks: {}}}, e: {{tracks: {}}}}}}}]\n",
        wave(0),
        wave(90),
        wave(180),
        wave(270)
    );
    let steps = |text: &str| -> Vec<(i64, f64)> {
        let choreography = of_four(text).choreography.unwrap_or_else(|| panic!("{:?}", found(text)));
        let robots = choreography.acts[0].plan.robots.clone();
        let scripts = robots.iter().flat_map(|robot| &robot.scripts);
        let steps = scripts.flat_map(|planned| planned.script.steps());
        steps.map(|step| (step.offset.span().as_nanos(), step.setpoint.value)).collect()
    };
    let (formula, wave) = (steps(by_formula), steps(&by_wave));
    // The bounds of the curvature differ slightly.
    assert!(formula.len().abs_diff(wave.len()) <= 8, "{} and {}", formula.len(), wave.len());
}

#[test]
fn expression_fault_of_one_robot_is_reported_once_at_its_column() {
    let text = "cues: [{robots: all, tracks: {d: [{at: 0s, to: 10 / ($index - 2)}]}}]\n";
    assert_eq!(found(text), ["2:51-1 division by zero"]);
    let text = "variables: {h: 2}\ncues: [{robots: all, tracks: {d: [{at: 0s, to: \"2 * $j\"}]}}]\n";
    assert_eq!(found(text), ["3:53-2 unknown variable `j`"]);
    let text = "cues: [{end_by: $index * 1s, robots: all, tracks: {d: [{at: 0s, to: 0}]}}]\n";
    assert_eq!(found(text), ["2:17-6 `$index` differs between robots and is not supported here"]);
    let text = "cues: [{robots: all, tracks: {d: [{at: 0s, to: max(1, $index, 3)}, {at: 1s, to: 2}]}}]\n";
    assert_eq!(found(text).len(), 1, "{:?}", found(text));
    assert!(found(text)[0].contains("the expression `max(1` is cut off by a comma"), "{:?}", found(text));
}

#[test]
fn decimal_comma_gets_hint_to_use_decimal_point() {
    let hint = |value: &str| {
        let text =
            format!("cues: [{{robots: all, tracks: {{d: [{{at: 0s, to: 1}}, {{at: {value}, to: 2}}]}}}}]\n");
        let findings = of_four(&text).findings;
        assert_eq!(findings.len(), 1, "{value}: {findings:?}");
        findings[0].hint.clone().unwrap_or_default()
    };
    for (value, right) in [
        ("1,5s", "write a decimal point: `1.5s`"),
        ("\"1,5s\"", "write a decimal point: `1.5s`"),
        ("00:00:01,5", "write a decimal point: `00:00:01.5`"),
        ("\"1s * 1,5\"", "write a decimal point: `1.5`"),
        ("1s * 1,5", "write a decimal point: `1.5`"),
    ] {
        assert_eq!(hint(value), right, "{value}");
    }
}

#[test]
fn times_can_be_written_as_hours_minutes_and_seconds() {
    same(
        "cues: [{at: 00:00:01.5, robots: a, tracks: {d: [{at: 00:00:00, to: 1}, {at: 00:01:30, to: 2}]}}]\n",
        "cues: [{at: 1500ms, robots: a, tracks: {d: [{at: 0s, to: 1}, {at: 90s, to: 2}]}}]\n",
    );
}

#[test]
fn earlier_syntax_keeps_its_meaning() {
    same(
        "
variables: {a-b: 3, my var: 4, t: 1s, index: 5, note: pay $me now, sig: 3/4}
signature: $sig
cues: [{robots: a, tracks: {d: [{at: 0s, to: $a-b}, {at: $t, to: -$a-b}, {at: 2s, to: $my var}, {at: 3s, to: $index}]}}]
",
        "cues: [{robots: a, tracks: {d: [{at: 0s, to: 3}, {at: 1s, to: -3}, {at: 2s, to: 4}, {at: 3s, to: 5}]}}]\n",
    );
}

#[test]
fn formula_with_many_turns_is_fitted_or_refused() {
    let text = |hours: u32| {
        format!(
            "cues: [{{robots: a, tracks: {{d: {{tolerance: 20, formula: \"400 * sin(360 * t / 8s)\", for: {hours}h}}}}}}]\n"
        )
    };
    let compiled = of_four(&text(3));
    assert!(compiled.choreography.is_some(), "{:#?}", compiled.findings);
    for hours in [24, 300] {
        assert_eq!(found(&text(hours)), ["2:57-25 the formula has too many turns, corners or jumps"]);
    }
}

#[test]
fn formula_that_is_not_a_movement_is_reported() {
    let message = |formula: &str| {
        let text = format!(
            "cues: [{{at: 0s, robots: bot, tracks: {{pole: {{formula: \"{formula}\", for: 4s}}}}}}]\n"
        );
        let findings = compiled(&text).findings;
        findings.iter().map(|finding| finding.message.clone()).collect::<Vec<_>>().join("; ")
    };
    assert_eq!(message("90 * t"), "the result of the formula is a time");
    assert_eq!(message("1 / (t / 1s - 2)"), "the formula has no value at 2 s");
    assert_eq!(message("sqrt(2 - t / 1s)").split(" at ").next(), Some("the formula has no value"));
    assert_eq!(message("floor(1000000 * t / 1s)"), "the formula has too many turns, corners or jumps");
    assert!(message("200 * t / 1s").contains("800"), "{}", message("200 * t / 1s"));
}
