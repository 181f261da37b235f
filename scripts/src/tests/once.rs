//! Each fault causes one finding: its consequences are not reported, and it is reported at its own place.

use super::composed::compiled_with;

/// Returns each finding as line, column and message.
fn found_with(text: &str, files: &[(&'static str, &str)]) -> Vec<String> {
    let findings = compiled_with(text, files).findings;
    let shown = |found: &crate::Finding| format!("{}:{} {}", found.line, found.column, found.message);
    findings.iter().map(shown).collect()
}

#[track_caller]
fn check(text: &str, expected: &[&str]) {
    assert_eq!(found_with(text, &[]), expected, "{text}");
}

/// Writes a scenario whose only cue plays a sequence with these parameters.
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
fn uses_of_parameter_without_value_are_not_reported() {
    check(&played("who: left"), &[]);
    check(&played("pause: 2s"), &["11:27 the sequence `show` needs a value for `who`"]);
    check(
        &played("who: left, depth: deep"),
        &["11:64 the parameter `depth` needs a number, but its value is the text `deep`"],
    );
    check(
        &played("who: left, pause: soon"),
        &["11:64 the parameter `pause` needs a time, but its value is the text `soon`"],
    );
    // What a name refers to is known only where the name is used.
    check(&played("who: left, name: anything"), &[]);
}

#[test]
fn misspelt_parameter_is_not_also_reported_missing() {
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
fn robot_passed_to_sequence_is_checked_where_it_is_passed() {
    check(&played("who: lift"), &["11:51 no robot or group `lift` in the fleet"]);
}

#[test]
fn uses_of_faulty_variable_are_not_reported() {
    let text = "scenario: s
variables: {far: $sid * 2, twice: 2 * $far, sid3: 4}
cues: [{robots: left, tracks: {a: [{at: 0s, to: $far}, {at: 1s, to: -$far}, {at: $far, to: 3 + $twice}]}}]
";
    check(text, &["2:18 unknown variable `sid`"]);
    let parts = "parameters: {reach: ~}
variables: {far: 2 * $reach}
moves: {m: {tracks: {a: [{at: 0s, to: 0}, {at: 1s, to: $far}]}}}
";
    let text = "scenario: s\ninclude: {file: p.yaml, as: p}\ncues: [{robots: left, move: p.m}]\n";
    assert_eq!(found_with(text, &[("p.yaml", parts)]), ["2:10 the file `p.yaml` needs a value for `reach`"]);
}

#[test]
fn each_cycle_of_uses_is_reported_once() {
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
    let around = "4:21 the move `a` uses itself via the move `b`, the move `c` (";
    assert!(found[1].starts_with(around), "{found:#?}");
}

#[test]
fn duplicate_cue_name_is_reported_once_with_its_cues() {
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
    assert_eq!((found.line, found.column), (4, 11));
    assert_eq!(found.related.iter().map(|related| related.line).collect::<Vec<_>>(), [4, 3]);
    // The name is reported even if nothing refers to it.
    let unused = text.lines().take(4).collect::<Vec<_>>().join("\n");
    check(&unused, &["4:11 duplicate cue name `x`"]);
    // Cues of different acts may have the same name.
    let acts = format!(
        "scenario: s
acts:
  - {{act: a, cues: [{{cue: x, robots: left, {track}}}]}}
  - {{act: b, wait: operator, cues: [{{cue: x, robots: left, {track}}}]}}
"
    );
    check(&acts, &[]);
}

#[test]
fn role_is_checked_once_whether_used_or_not() {
    let track = "tracks: {a: [{at: 0s, to: 0}]}";
    let text = format!(
        "scenario: s
roles: {{left: right, solo: lefft, both: [left, left], lead: right, all: [lead]}}
cues:
  - {{cue: x, robots: both, {track}}}
  - {{cue: y, after: x, robots: both, {track}}}
"
    );
    check(
        &text,
        &[
            "2:9 the role `left` has the same name as a robot",
            "2:28 no robot or group `lefft` in the fleet",
            "2:48 already in the role `both`: `left`",
            "2:74 no robot or group `lead` in the fleet",
        ],
    );
}

#[test]
fn beat_beyond_its_bar_is_reported_with_intended_position() {
    let scenario = |at: &str| {
        format!(
            "scenario: s
tempo: [{{at: bar 1, bpm: 120}}, {{at: bar 3, bpm: 90, signature: 3/4}}]
cues: [{{at: {at}, robots: left, tracks: {{a: [{{at: 0s, to: 0}}]}}}}]
"
        )
    };
    for (at, beats, meant) in [
        ("bar 2 beat 5", 4, "bar 3 beat 1"),
        ("bar 3 beat 4", 3, "bar 4 beat 1"),
        ("bar 2 beat 8.5", 4, "bar 4 beat 1.5"),
    ] {
        let findings = compiled_with(&scenario(at), &[]).findings;
        let [found] = findings.as_slice() else { panic!("{findings:#?}") };
        assert_eq!(found.message, format!("`{at}` is beyond the end of its bar, which has {beats} beats"));
        assert_eq!(found.hint, Some(format!("write `{meant}`")));
        check(&scenario(meant), &[]);
    }
    check(&scenario("bar 2 beat 4.9"), &[]);
}

#[test]
fn misspelt_key_is_read_as_intended_key() {
    // Neither the parameter nor its value is reported as unknown.
    let text = "scenario: s
moves: {m: {parameter: {reach: 3}, tracks: {a: [{at: 0s, to: 0}, {at: 1s, to: $reach}]}}}
cues: [{robots: left, move: m, parameters: {reach: 4}}]
";
    check(text, &["2:13 unknown key `parameter` in the move `m`"]);
    let text = text.replace("parameter: {reach: 3}", "parameters: [reach]");
    check(&text, &["2:25 found a list"]);
    let text = "scenario: s
moves: {m: {tracks: {a: [{at: 0s, to 0}, {time: 1s, to: 1}]}}}
cues: [{robots: left, moves: m}]
";
    check(
        text,
        &[
            "2:35 unknown key `to 0` in a keyframe",
            "2:43 unknown key `time` in a keyframe",
            "3:23 unknown key `moves` in a cue",
        ],
    );
}

#[test]
fn template_braces_are_one_finding_in_any_position() {
    for (value, meant) in
        [("{{ x }}", "$x"), ("\"{{ x }}\"", "$x"), ("{{ $x }}", "$x"), ("{{ x + 1 }}", "$x + 1")]
    {
        let scenario = |value: &str| {
            format!(
                "scenario: s\nvariables: {{x: 3}}\ncues: [{{robots: left, tracks: {{a: [{{at: 1s, to: {value}}}]}}}}]\n"
            )
        };
        let findings = compiled_with(&scenario(value), &[]).findings;
        let [found] = findings.as_slice() else { panic!("{value}: {findings:#?}") };
        assert_eq!(found.hint, Some(format!("write `{meant}`, without braces")), "{value}");
        check(&scenario(meant), &[]);
    }
    for place in [
        "at: {{ x }}",
        "tracks: {{ x }}",
        "tracks: {a: {{ x }}}",
        "tracks: {a: [{{ x }}]}",
        "repeat: {{ x }}",
    ] {
        let text = format!(
            "scenario: s\nvariables: {{x: 3}}\ncues: [{{robots: left, tracks: {{a: [{{at: 0s, to: 0}}]}}, {place}}}]\n"
        );
        let text = if place.starts_with("tracks") {
            text.replace("tracks: {a: [{at: 0s, to: 0}]}, ", "")
        } else {
            text
        };
        let found = found_with(&text, &[]);
        assert!(found.len() == 1 && found[0].ends_with("braces around `x`"), "{place}: {found:?}");
    }
}

#[test]
fn finding_on_variable_value_points_to_variable_definition() {
    let definition = |text: &str, files: &[(&'static str, &str)]| {
        let findings = compiled_with(text, files).findings;
        let [found] = findings.as_slice() else { panic!("{findings:#?}") };
        let related = found.related.iter().map(|related| (related.line, related.message.clone()));
        (found.message.clone(), related.collect::<Vec<_>>())
    };
    let text = "scenario: s
variables: {far: 45deg}
moves: {m: {parameters: {pause: 2}, tracks: {a: [{at: 0s, to: 0}, {at: $pause, to: 1}]}}}
cues: [{robots: left, move: m}, {robots: right, tracks: {a: [{at: 0s, to: $far}]}}]
";
    let (_, related) = definition(&text.replace("pause: 2", "pause: 2s"), &[]);
    assert_eq!(related[1], (2, "`far` is defined here".to_owned()));
    let (_, related) = definition(&text.replace("45deg", "4"), &[]);
    assert_eq!(related[1], (3, "`pause` is defined here".to_owned()));
    let text = "scenario: s\ninclude: v.yaml\ncues: [{robots: left, tracks: {a: [{at: 0s, to: $far}]}}]\n";
    let (message, _) = definition(text, &[("v.yaml", "variables: {far: 45deg}\n")]);
    assert_eq!(message, "found the text `45deg` (`far` is defined here in line 1 of v.yaml)");
}

#[test]
fn spread_ends_must_match_each_other_and_parameter_type() {
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
            "4:65 the parameter `to` needs a number, but its value is the text `1s`",
            "4:73 the parameter `to` needs a number, but its value is the text `3s`",
        ],
    );
    let words = compiled_with(&text("low"), &[]).findings;
    assert_eq!(words[0].hint.as_deref(), Some("write the variable as `$low`"));
    // It is not reported that the types of the two ends differ: the number is correct.
    check(
        &text("{from: 1s, to: 3, across: group}"),
        &["4:65 the parameter `to` needs a number, but its value is the text `1s`"],
    );
}

#[test]
fn fault_in_multiline_or_escaped_text_is_reported_at_its_column() {
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
fn numbers_in_expressions_follow_yaml_syntax() {
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
    assert_eq!(found("$v * 2pi"), "invalid value `2pi`: to multiply, write `2 * pi`");
    assert_eq!(found("2 $v"), "unexpected `$` after a value: to multiply, write `*` between the two values");
    assert_eq!(
        found("\"(2 + 3)(4 + $v)\""),
        "unexpected `(` after a value: to multiply, write `*` between the two values"
    );
}

#[test]
fn nearly_correct_time_gets_hint_with_correct_form() {
    let hint = |time: &str| {
        let text = format!(
            "scenario: s\ntempo: 120\ncues: [{{robots: left, tracks: {{a: [{{at: 0s, to: 0}}, {{at: {time}, to: 1}}]}}}}]\n"
        );
        compiled_with(&text, &[]).findings[0].hint.clone().unwrap_or_default()
    };
    assert_eq!(hint("2beats"), "write `2 beats`");
    assert_eq!(hint("2 * 2beats"), "write `2 beats`");
    assert_eq!(hint("1s..2s"), "a range is not supported here: write one time");
    assert_eq!(hint("1,5s"), "write a decimal point: `1.5s`");
    assert_eq!(hint("1:30"), "write hours, minutes and seconds, as in `00:01:30` or `01:30:00`");
}
