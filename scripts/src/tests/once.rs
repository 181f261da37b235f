//! One fault, one finding: what follows from it is not told, and it is told where it stands.

use super::composed::compiled_with;

/// What is found, as line, column and message.
fn found_with(text: &str, files: &[(&'static str, &str)]) -> Vec<String> {
    let findings = compiled_with(text, files).findings;
    let shown = |found: &crate::Finding| format!("{}:{} {}", found.line, found.column, found.message);
    findings.iter().map(shown).collect()
}

#[track_caller]
fn check(text: &str, expected: &[&str]) {
    assert_eq!(found_with(text, &[]), expected, "{text}");
}

/// A scenario whose only cue plays a sequence with these parameters.
fn played(given: &str) -> String {
    format!(
        "scenario: s
sequences:
  show:
    parameters: {{who: ~, pause: 1s, depth: 5, name: a}}
    cues:
      - {{cue: one, robots: $who, tracks: {{a: [{{at: 0s, to: 0}}, {{at: $pause, to: $depth * 2}}]}}}}
      - {{cue: two, after: one + $pause, sequence: inner, parameters: {{who: $who, depth: $depth}}}}
  inner:
    parameters: {{who: ~, depth: 1}}
    cues: [{{robots: $who, tracks: {{b: [{{at: 0s, to: 0}}, {{at: 1s, to: $depth}}]}}}}]
cues: [{{cue: c, sequence: show, parameters: {{{given}}}}}]
"
    )
}

#[test]
fn what_uses_a_parameter_without_a_value_is_not_told() {
    check(&played("who: left"), &[]);
    check(&played("pause: 2s"), &["11:27 the sequence `show` needs a value for `who`"]);
    check(
        &played("who: left, depth: deep"),
        &["11:64 the parameter `depth` is a number, and this is the text `deep`"],
    );
    check(
        &played("who: left, pause: soon"),
        &["11:64 the parameter `pause` is a time, and this is the text `soon`"],
    );
    // What it is the name of is known where it is used.
    check(&played("who: left, name: anything"), &[]);
}

#[test]
fn a_parameter_that_is_misspelt_is_not_missing_as_well() {
    check(&played("woh: left"), &["11:46 the sequence `show` has no parameter `woh`"]);
    let text = "scenario: s
moves: {m: {parameters: {reach: ~}, tracks: {a: [{at: 0s, to: 0}, {at: 1s, to: $reach}]}}}
cues: [{robots: left, move: m, parameters: {raech: 3}}]
";
    check(text, &["3:45 the move `m` has no parameter `raech`"]);
    check(
        &text.replace("raech", "speed"),
        &["3:29 the move `m` needs a value for `reach`", "3:45 the move `m` has no parameter `speed`"],
    );
}

#[test]
fn a_robot_that_is_given_to_a_sequence_is_looked_for_where_it_is_given() {
    check(&played("who: lift"), &["11:51 no robot or group `lift` in the fleet"]);
}

#[test]
fn what_uses_a_faulty_variable_is_not_told() {
    let text = "scenario: s
variables: {far: $sid * 2, twice: 2 * $far, sid3: 4}
cues: [{robots: left, tracks: {a: [{at: 0s, to: $far}, {at: 1s, to: -$far}, {at: $far, to: 3 + $twice}]}}]
";
    check(text, &["2:18 no variable `sid` is known here"]);
    let parts = "parameters: {reach: ~}
variables: {far: 2 * $reach}
moves: {m: {tracks: {a: [{at: 0s, to: 0}, {at: 1s, to: $far}]}}}
";
    let text = "scenario: s\ninclude: {file: p.yaml, as: p}\ncues: [{robots: left, move: p.m}]\n";
    assert_eq!(found_with(text, &[("p.yaml", parts)]), ["2:10 the file `p.yaml` needs a value for `reach`"]);
}

#[test]
fn a_circle_of_uses_is_told_once_and_two_circles_twice() {
    let text = "scenario: s
moves:
  a: {play: [{move: b}, {move: a}]}
  b: {play: [{move: c}]}
  c: {play: [{move: a}]}
cues: [{robots: left, move: c}]
";
    let found = found_with(text, &[]);
    assert_eq!(found.len(), 2, "{found:#?}");
    assert!(found[0].starts_with("3:32 the move `a` uses itself ("), "{found:#?}");
    let around = "4:21 the move `a` uses itself, by way of the move `b`, the move `c` (";
    assert!(found[1].starts_with(around), "{found:#?}");
}

#[test]
fn a_name_of_several_cues_is_told_once_with_the_cues() {
    let track = "tracks: {a: [{at: 0s, to: 0}, {at: 1s, to: 0}]}";
    let text = format!(
        "scenario: s
cues:
  - {{cue: x, robots: left, {track}}}
  - {{cue: x, robots: right, {track}}}
  - {{cue: y, after: x, robots: third, {track}}}
  - {{cue: z, after: x, before: x, robots: third, {track}}}
"
    );
    let findings = compiled_with(&text, &[]).findings;
    let [found] = findings.as_slice() else { panic!("{findings:#?}") };
    assert_eq!((found.line, found.column), (5, 21));
    assert_eq!(found.related.iter().map(|related| related.line).collect::<Vec<_>>(), [5, 3, 4]);
}

#[test]
fn the_ends_of_a_spread_are_of_one_kind_and_of_that_of_the_parameter() {
    let text = |to: &str| {
        format!(
            "scenario: s
variables: {{low: 1}}
moves: {{m: {{parameters: {{to: 1}}, tracks: {{a: [{{at: 0s, to: 0}}, {{at: 1s, to: $to}}]}}}}}}
cues: [{{robots: [left, right], move: m, parameters: {{to: {to}}}}}]
"
        )
    };
    check(&text("{from: $low, to: 3, across: group}"), &[]);
    check(&text("{from: $low, to: 2 * 3s, across: group}"), &["4:75 a spread from a plain number to a time"]);
    check(
        &text("{from: 1s, to: 3s, across: group}"),
        &[
            "4:65 the parameter `to` is a number, and this is the text `1s`",
            "4:73 the parameter `to` is a number, and this is the text `3s`",
        ],
    );
    let words = compiled_with(&text("low"), &[]).findings;
    assert_eq!(words[0].hint.as_deref(), Some("the variable is written `$low`"));
    // Not that the ends differ: the number is right.
    check(
        &text("{from: 1s, to: 3, across: group}"),
        &["4:65 the parameter `to` is a number, and this is the text `1s`"],
    );
}

#[test]
fn what_is_wrong_in_a_text_of_several_lines_or_with_escapes_is_found_at_its_character() {
    let at = |value: &str| {
        let text = format!(
            "scenario: s\nvariables: {{v: 2}}\ncues:\n  - robots: left\n    tracks:\n      a:\n        - {{at: 0s, to: 0}}\n        - at: 1s\n          to: {value}\n"
        );
        let found = found_with(&text, &[]);
        assert_eq!(found.len(), 1, "{text}\n{found:#?}");
        found[0].split(' ').next().unwrap().to_owned()
    };
    assert_eq!(at("$v + 2 / 0"), "9:22");
    assert_eq!(at("\"$v +\\t2 / 0\""), "9:24");
    assert_eq!(at("\"\\x24v + 2 / 0\""), "9:26");
    assert_eq!(at("$v +\n            2 / 0"), "10:15");
    assert_eq!(at(">-\n            $v +\n            2 / 0"), "11:15");
    assert_eq!(at("|\n            $v +\n            2 / 0"), "11:15");
    assert_eq!(at("\"$v + \\\n            2 / 0\""), "10:15");
    assert_eq!(at("&x $v / 0"), "9:21");
    assert_eq!(at("!!str \"$v / 0\""), "9:25");
}

#[test]
fn numbers_in_expressions_are_those_of_yaml() {
    let text = |value: &str| {
        format!(
            "scenario: s\nvariables: {{v: 2}}\ncues: [{{robots: left, tracks: {{a: [{{at: 0s, to: 0}}, {{at: 1s, to: {value}}}]}}}}]\n"
        )
    };
    for value in ["$v * 1e1", "$v * 25E-1", "\"5e+0 * $v\"", "1e-3 * 500 * $v", "1e300 / 1e299 * $v"] {
        check(&text(value), &[]);
    }
    let found = |value: &str| {
        let findings = compiled_with(&text(value), &[]).findings;
        format!("{}: {}", findings[0].message, findings[0].hint.clone().unwrap_or_default())
    };
    assert_eq!(found("$v * 1e400"), "the number is too large: ");
    assert_eq!(found("$v * 2pi"), "`2pi` cannot be read: to multiply, write `2 * pi`");
    assert_eq!(found("2 $v"), "`$` after a complete value: to multiply, write `*` between the two");
    assert_eq!(
        found("\"(2 + 3)(4 + $v)\""),
        "`(` after a complete value: to multiply, write `*` between the two"
    );
}

#[test]
fn a_time_that_is_nearly_right_is_told_how_it_is_written() {
    let hint = |time: &str| {
        let text = format!(
            "scenario: s\ntempo: 120\ncues: [{{robots: left, tracks: {{a: [{{at: 0s, to: 0}}, {{at: {time}, to: 1}}]}}}}]\n"
        );
        compiled_with(&text, &[]).findings[0].hint.clone().unwrap_or_default()
    };
    assert_eq!(hint("2beats"), "write `2 beats`");
    assert_eq!(hint("2 * 2beats"), "write `2 beats`");
    assert_eq!(hint("1s..2s"), "a range has no place here: write one time");
    assert_eq!(hint("1,5s"), "write a decimal point: `1.5s`");
    assert_eq!(hint("1:30"), "write hours, minutes and seconds, `00:01:30` or `01:30:00`");
}
