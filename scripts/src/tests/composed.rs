//! Moves made of moves, sequences, and files with parameters. Each is equivalent to its written-out form. Faults are found at their
//! places, with the uses that lead there.

use std::collections::BTreeMap;

use crate::{Address, Choreography, Code, Compiled, Files, Finding, Fleet, FleetRobot, Source, compile};

const BLOCK: &str = r#"{"id": "ID", "api_version": "1", "devices": [
  {"id": "a", "name": "a", "interpolation": "linear", "default_value": 0, "available_control_types": {
     "position": {"min_value": -180, "max_value": 180, "granularity": 0.5},
     "script": {"min_value": -180, "max_value": 180, "granularity": 0.5, "max_number_of_steps": 100000}}},
  {"id": "b", "name": "b", "interpolation": "linear", "default_value": 0, "available_control_types": {
     "position": {"min_value": -180, "max_value": 180, "granularity": 0.5},
     "script": {"min_value": -180, "max_value": 180, "granularity": 0.5, "max_number_of_steps": 100000}}},
  {"id": "lamp", "name": "lamp", "interpolation": "hold", "default_value": 0, "available_control_types": {
     "position": {"min_value": 0, "max_value": 255, "granularity": 1},
     "script": {"min_value": 0, "max_value": 255, "granularity": 1, "max_number_of_steps": 100000}}}]}"#;

fn fleet() -> Fleet {
    let robot = |id: &str| {
        let init: urrcp::InitializationBlock = serde_json::from_str(&BLOCK.replace("ID", id)).unwrap();
        FleetRobot::new(init.id.clone(), Address::Simulated, Some(init))
    };
    Fleet { robots: ["left", "right", "third"].map(robot).into(), ..Fleet::default() }
}

struct Shelf(BTreeMap<&'static str, String>);

impl Files for Shelf {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        let text = self.0.get(name).unwrap_or_else(|| panic!("no file {name}"));
        Ok(Source { name: name.to_owned(), text: text.clone() })
    }
}

pub(super) fn compiled_with(text: &str, files: &[(&'static str, &str)]) -> Compiled {
    let shelf = Shelf(files.iter().map(|(name, text)| (*name, (*text).to_owned())).collect());
    compile(&Source { name: "s.yaml".into(), text: text.to_owned() }, &fleet(), &shelf)
}

fn compiled(text: &str) -> Compiled {
    compiled_with(text, &[])
}

/// Returns all steps of the robots as robot, device, time in microseconds and value, without names of cues. Steps that occur twice are
/// listed once.
fn steps(choreography: &Choreography) -> Vec<String> {
    let mut all = Vec::new();
    for robot in choreography.acts.iter().flat_map(|act| &act.plan.robots) {
        for script in &robot.scripts {
            let at = |offset: f64| (script.start.get() + offset) * 1_000.0;
            let step = |step: &urrcp::Step| {
                format!(
                    "{} {} {:.0} {}",
                    robot.robot,
                    script.device,
                    at(step.offset.get()),
                    step.setpoint.value
                )
            };
            all.extend(script.script.steps().iter().map(step));
        }
    }
    all.dedup();
    all
}

#[track_caller]
fn check_same(composed: &Compiled, written: &str) {
    let plain = compiled(written);
    let [one, other] = [composed, &plain].map(|compiled| {
        steps(compiled.choreography.as_ref().unwrap_or_else(|| panic!("{:#?}", compiled.findings)))
    });
    assert!(one.len() > 1, "nothing moves");
    assert_eq!(one, other);
}

#[track_caller]
fn check_moves(moves: &str, composed: &str, written: &str) {
    check_same(
        &compiled(&format!("scenario: s\ntempo: 110\nmoves:\n{moves}cues:\n{composed}")),
        &format!("scenario: s\ntempo: 110\nmoves:\n{moves}cues:\n{written}"),
    );
}

#[track_caller]
fn check_found(compiled: &Compiled, expected: &[(Code, &str, usize, &str)]) {
    let found: Vec<_> =
        compiled.findings.iter().map(|f| (f.code, f.file.as_str(), f.line, f.message.as_str())).collect();
    assert_eq!(found, expected);
}

const MOVES: &str =
    "  up: {parameters: {to: 45, time: 1s}, tracks: {a: [{at: 0s, to: 0}, {at: $time, to: $to}]}}
  down: {parameters: {from: 45}, tracks: {a: [{at: 0s, to: $from}, {at: 2s, to: 0, ease: smooth}]}}
  nod: {tracks: {b: [{at: 0s, to: 0}, {at: 500ms, to: 10}, {at: 1s, to: 0}]}}
  light: {parameters: {level: 200}, tracks: {lamp: [{at: 0s, to: $level}, {at: 300ms, to: 0}]}}
  swing: {tracks: {b: {wave: {amplitude: 20, period: 1s, for: 2s}}}}
";

#[test]
fn moves_play_in_sequence_or_together() {
    check_moves(
        &format!(
            "{MOVES}  greet: {{parameters: {{high: 30}}, play: [{{move: up, parameters: {{to: $high}}}}, [{{move: nod}}, \
             {{move: light, delay: 100ms}}], {{move: down, parameters: {{from: $high}}}}, {{move: swing, at: 4s}}]}}\n"
        ),
        "  - {at: 1s, robots: left, move: greet, parameters: {high: 40}}\n",
        "  - {at: 1s, robots: left, move: up, parameters: {to: 40}}
  - {at: 2s, robots: left, move: nod}
  - {at: 2100ms, robots: left, move: light}
  - {at: 3s, robots: left, move: down, parameters: {from: 40}}
  - {at: 5s, robots: left, move: swing}\n",
    );
}

#[test]
fn played_moves_take_same_modifiers_as_cues() {
    check_moves(
        &format!(
            "{MOVES}  more: {{play: [{{move: nod, scale: 2, repeat: 3}}, {{move: nod, devices: {{b: a}}, mirror: true, \
             duration: 4s}}, {{move: up, reverse: true}}]}}\n"
        ),
        "  - {at: 1s, robots: [left, right], move: more, canon: 500ms}\n",
        "  - {at: 1s, robots: [left, right], canon: 500ms, move: nod, scale: 2, repeat: 3}
  - {at: 4s, robots: [left, right], canon: 500ms, move: nod, devices: {b: a}, mirror: true, duration: 4s}
  - {at: 8s, robots: [left, right], canon: 500ms, move: up, reverse: true}\n",
    );
}

#[test]
fn composed_move_is_modified_as_one_movement() {
    let moves = format!("{MOVES}  both: {{play: [{{move: up}}, {{move: nod}}, {{move: down}}]}}\n");
    let repeated = "  - {at: 0s, robots: left, move: both, repeat: 2, mirror: true}\n";
    let one = |at: u32| {
        format!(
            "  - {{at: {at}s, robots: left, move: up, mirror: true}}
  - {{at: {}s, robots: left, move: nod, mirror: true}}
  - {{at: {}s, robots: left, move: down, mirror: true}}\n",
            at + 1,
            at + 2
        )
    };
    check_moves(&moves, repeated, &(one(0) + &one(4)));
    check_moves(
        &moves,
        "  - {at: 0s, robots: left, move: both, reverse: true}\n",
        "  - {at: 0s, robots: left, move: down, reverse: true}
  - {at: 2s, robots: left, move: nod, reverse: true}
  - {at: 3s, robots: left, move: up, reverse: true}\n",
    );
    check_moves(
        &moves,
        "  - {at: 0s, robots: left, move: both, duration: 8s}\n",
        "  - {at: 0s, robots: left, move: up, duration: 2s}
  - {at: 2s, robots: left, move: nod, duration: 2s}
  - {at: 4s, robots: left, move: down, duration: 4s}\n",
    );
}

#[test]
fn beats_within_moves_align_with_bars() {
    let moves = "  beat: {tracks: {a: [{at: 0s, to: 0}, {at: 1 beat, to: 10}]}}
  fall: {tracks: {a: [{at: 0s, to: 10}, {at: 1 beat, to: 0}]}}
  bar: {play: [{move: beat}, {move: fall}, {move: beat}, {move: fall}]}
  bars: {play: [{move: bar, repeat: 3}, {move: bar, delay: 1 bar}]}\n";
    let beat = |beat: u32| {
        let name = if beat.is_multiple_of(2) { "beat" } else { "fall" };
        format!("  - {{at: bar {} beat {}, robots: left, move: {name}}}\n", 2 + beat / 4, 1 + beat % 4)
    };
    let written: String = (0..12).chain(16..20).map(beat).collect();
    check_moves(moves, "  - {at: bar 2, robots: left, move: bars}\n", &written);
}

#[test]
fn robots_may_differ_within_played_moves() {
    check_moves(
        &format!(
            "{MOVES}  each: {{play: [{{move: nod}}, {{move: up, parameters: {{to: 10 + 10 * $index}}}}]}}\n"
        ),
        "  - {at: 0s, robots: [left, right], move: each}\n",
        "  - {at: 0s, robots: [left, right], move: nod}
  - {at: 1s, robots: left, move: up, parameters: {to: 10}}
  - {at: 1s, robots: right, move: up, parameters: {to: 20}}\n",
    );
}

#[test]
fn move_sees_variables_of_its_file_but_not_parameters_of_its_caller() {
    let text = "scenario: s
variables: {pace: 1s}
moves:
  inner: {tracks: {a: [{at: 0s, to: 0}, {at: $pace, to: 10}]}}
  outer: {parameters: {pace: 9s}, play: [{move: inner}]}
cues: [{at: 0s, robots: left, move: outer}]\n";
    let written =
        "scenario: s\ncues: [{at: 0s, robots: left, tracks: {a: [{at: 0s, to: 0}, {at: 1s, to: 10}]}}]\n";
    check_same(&compiled(text), written);
    let hidden = "scenario: s
moves:
  inner: {tracks: {a: [{at: 0s, to: $height}]}}
  outer: {parameters: {height: 9}, play: [{move: inner}]}
cues: [{at: 0s, robots: left, move: outer}]\n";
    let message = "unknown variable `height` (in the move `inner`, used by the move `outer` in line 4)";
    check_found(&compiled(hidden), &[(Code::Variable, "s.yaml", 3, message)]);
}

#[test]
fn invalid_value_is_reported_in_its_move_with_chain_of_callers() {
    let text = "scenario: s
moves:
  low: {tracks: {a: [{at: 0s, to: 0}]}}
  high: {tracks: {a: [{at: 0s, to: 0}, {at: 1s, to: 500}]}}
  middle: {play: [{move: low}, {move: high}]}
  outer: {play: [{move: middle}]}
cues: [{at: 0s, robots: left, move: outer}]\n";
    let message = "keyframe 2: 500 lies outside the limits for position of `a` on `left` \
                   (in the move `high`, used by the move `middle` in line 5, used by the move `outer` in line 6)";
    check_found(&compiled(text), &[(Code::OutOfRange, "s.yaml", 4, message)]);
}

#[test]
fn overlapping_movements_of_device_in_move_are_reported() {
    let text = format!(
        "scenario: s\nmoves:\n{MOVES}  both:\n    play:\n      - {{move: up}}\n      - {{move: down, at: 500ms}}\n\
         cues: [{{at: 0s, robots: left, move: both}}]\n"
    );
    let message = "the move `both` moves `a` from 0 ms to 1 s, and again from 500 ms \
                   (in the move `down`, used by the move `both` in line 11)";
    check_found(&compiled(&text), &[(Code::Overlap, "s.yaml", 4, message)]);
}

#[test]
fn cycle_is_reported_once_with_its_whole_chain() {
    let text = "scenario: s
moves:
  one: {play: [{move: two}]}
  two: {play: [{move: three}]}
  three: {play: [{move: one}]}
cues: [{at: 0s, robots: left, move: one}]\n";
    let message = "the move `one` uses itself via the move `two`, the move `three` \
                   (in the move `three`, used by the move `two` in line 4, used by the move `one` in line 3)";
    check_found(&compiled(text), &[(Code::PlaysItself, "s.yaml", 5, message)]);
    let text = "scenario: s\nmoves: {one: {play: [{move: one}]}}\ncues: [{cue: mark}]\n";
    check_found(&compiled(text), &[(Code::PlaysItself, "s.yaml", 2, "the move `one` uses itself")]);
}

#[test]
fn repeatedly_doubling_moves_are_bounded() {
    for depth in [20, 40] {
        let mut text =
            "scenario: s\nmoves:\n  m0: {tracks: {a: [{at: 0s, to: 0}, {at: 1ms, to: 0}]}}\n".to_owned();
        for level in 1..=depth {
            let below = level - 1;
            text.push_str(&format!("  m{level}: {{play: [{{move: m{below}}}, {{move: m{below}}}]}}\n"));
        }
        text.push_str(&format!("cues: [{{at: 0s, robots: left, move: m{depth}}}]\n"));
        let codes: Vec<_> = compiled(&text).findings.iter().map(|finding| finding.code).collect();
        assert_eq!(codes, [Code::TooMuch], "{depth}");
    }
}

const SEQUENCE: &str = "sequences:
  greet:
    doc: Bows, then nods.
    parameters: {to: 30, pause: 500ms, who: left}
    cues:
      - {cue: bow, move: up, parameters: {to: $to}}
      - {cue: back, after: bow + $pause, move: down, parameters: {from: $to}}
      - {cue: answer, robots: $who, at: 1s, move: nod}
";

#[test]
fn sequence_equals_its_cues_under_other_names() {
    let text = format!(
        "scenario: s\ntempo: 110\nmoves:\n{MOVES}{SEQUENCE}cues:
  - {{cue: first, sequence: greet, robots: [left, right], at: bar 2, parameters: {{who: third}}}}
  - {{cue: second, after: first.back + 1s, sequence: greet, robots: [left, right], parameters: {{who: third, to: 20, pause: 1s}}}}
  - {{cue: last, after: second, robots: left, move: light}}\n"
    );
    let composed = compiled(&text);
    let written = format!(
        "scenario: s\ntempo: 110\nmoves:\n{MOVES}cues:
  - {{cue: first, at: bar 2}}
  - {{cue: bow, with: first, robots: [left, right], move: up, parameters: {{to: 30}}}}
  - {{cue: back, after: bow + 500ms, robots: [left, right], move: down, parameters: {{from: 30}}}}
  - {{cue: answer, with: first + 1s, robots: third, move: nod}}
  - {{cue: second, after: back + 1s}}
  - {{cue: bow 2, with: second, robots: [left, right], move: up, parameters: {{to: 20}}}}
  - {{cue: back 2, after: bow 2 + 1s, robots: [left, right], move: down, parameters: {{from: 20}}}}
  - {{cue: answer 2, with: second + 1s, robots: third, move: nod}}
  - {{cue: last, after: [back 2, answer 2], robots: left, move: light}}\n"
    );
    check_same(&composed, &written);
    let act = &composed.choreography.unwrap().acts[0];
    let names: Vec<_> = act.cues.iter().map(|cue| cue.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "first",
            "first.bow",
            "first.back",
            "first.answer",
            "second",
            "second.bow",
            "second.back",
            "second.answer",
            "last"
        ]
    );
    let (first, back) = (&act.cues[0], &act.cues[2]);
    assert_eq!(first.end, back.end, "a sequence ends with the last of its cues");
}

#[test]
fn sequences_can_play_sequences() {
    let text = format!(
        "scenario: s\nmoves:\n{MOVES}{SEQUENCE}  twice:
    cues:
      - {{cue: one, sequence: greet, at: 1s}}
      - {{cue: two, sequence: greet, after: one.back}}
cues: [{{cue: all, sequence: twice, robots: right, at: 2s}}, {{after: all.two.bow, robots: third, move: nod}}]\n"
    );
    let one = |name: &str, when: &str| {
        format!(
            "  - {{cue: {name}, {when}}}
  - {{cue: {name} bow, with: {name}, robots: right, move: up, parameters: {{to: 30}}}}
  - {{cue: {name} back, after: {name} bow + 500ms, robots: right, move: down, parameters: {{from: 30}}}}
  - {{with: {name} + 1s, robots: left, move: nod}}\n"
        )
    };
    let written = format!(
        "scenario: s\nmoves:\n{MOVES}cues:\n{}{}  - {{after: two bow, robots: third, move: nod}}\n",
        one("one", "at: 3s"),
        one("two", "after: one back")
    );
    check_same(&compiled(&text), &written);
}

#[test]
fn sequence_faults_are_reported_at_definition_or_use() {
    let text = format!(
        "scenario: s\nmoves:\n{MOVES}sequences:
  greet:
    parameters: {{to: 30, pause: 500ms, who: ~}}
    cues:
      - {{cue: bow, robots: $who, move: up, parameters: {{to: $to}}}}
      - {{cue: back, after: bov, robots: $who, move: down}}
cues:
  - {{cue: first, at: 0s, sequence: greet, parameters: {{who: left, to: 400}}}}
  - {{cue: other, at: 9s, sequence: greet, scale: 2, parameters: {{whom: left, pause: 3}}}}
  - {{cue: none, sequence: great}}\n"
    );
    let found = compiled(&text);
    let places: Vec<_> = found.findings.iter().map(|f| (f.code, f.line, f.message.as_str())).collect();
    let use_ = "(in the sequence `greet`, used in line 15)";
    for expected in [
        (Code::UnknownKey, 16, "`scale` is not supported in a cue that plays a sequence".to_owned()),
        (Code::UnknownKey, 16, "the sequence `greet` has no parameter `whom`".to_owned()),
        (Code::WrongKind, 16, "the parameter `pause` needs a time, but its value is the number 3".to_owned()),
        (Code::UnknownSequence, 17, "no sequence `great`".to_owned()),
    ] {
        assert!(
            places.contains(&(expected.0, expected.1, &expected.2)),
            "{expected:?} is not in {places:#?}"
        );
    }
    let text = text.replace("scale: 2, parameters: {whom: left, pause: 3}", "parameters: {who: left}");
    let found = compiled(&text.replace("  - {cue: none, sequence: great}\n", ""));
    // Findings do not depend on the number of uses of the sequence.
    let cue = format!("no cue `bov` {use_}");
    let value = "keyframe 2 of the move `up`: 400 lies outside the limits for position of `a` on `left`";
    let messages: Vec<_> = found.findings.iter().map(|f| (f.line, f.message.as_str())).collect();
    assert_eq!(messages, [(13, cue.as_str()), (15, value)]);
}

#[test]
fn recursive_and_doubling_sequences_are_bounded() {
    let text = "scenario: s
sequences: {a: {cues: [{cue: x, sequence: b}]}, b: {cues: [{cue: y, sequence: a}]}}
cues: [{cue: all, sequence: a}]\n";
    let codes: Vec<_> = compiled(text).findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, [Code::PlaysItself]);
    let mut text = "scenario: s\nsequences:\n  s0: {cues: [{cue: mark}]}\n".to_owned();
    for level in 1..=30 {
        let below = level - 1;
        text.push_str(&format!(
            "  s{level}: {{cues: [{{cue: l, sequence: s{below}}}, {{cue: r, sequence: s{below}}}]}}\n"
        ));
    }
    text.push_str("cues: [{cue: all, sequence: s30}]\n");
    let codes: Vec<_> = compiled(&text).findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, [Code::TooMuch]);
}

#[test]
fn musical_positions_are_refused_in_sequences() {
    let text =
        "scenario: s\ntempo: 120\nsequences: {a: {cues: [{cue: x, at: bar 2}]}}\ncues: [{sequence: a}]\n";
    let message = "the position `bar 2` is not supported in a sequence (in the sequence `a`, used in line 4)";
    check_found(&compiled(text), &[(Code::Music, "s.yaml", 3, message)]);
}

#[test]
fn time_conflict_in_sequence_gets_fix_in_its_own_terms() {
    let text = format!(
        "scenario: s\nmoves:\n{MOVES}sequences:
  greet:
    cues:
      - {{cue: bow, robots: left, move: up}}
      - {{cue: back, after: bow + 1s, at: 500ms, robots: left, move: nod}}
cues: [{{cue: hello, at: 1s, sequence: greet}}]\n"
    );
    let found = compiled(&text);
    let [finding] = found.findings.as_slice() else { panic!("{:#?}", found.findings) };
    assert_eq!(finding.code, Code::Conflict);
    let hint = finding.hint.as_ref().unwrap();
    assert!(hint.contains("`after: bow + -500ms`") && hint.contains("`at: 2s`"), "{finding:#?}");
    let lines: Vec<_> = finding.related.iter().map(|related| related.line).collect();
    assert_eq!(lines, [13, 11, 12, 12]);
}

const ARM: &str = "parameters: {side: ~, reach: 40, time: 1s}
variables: {far: $side * $reach}
roles: {mine: left}
moves:
  out: {tracks: {a: [{at: 0s, to: 0}, {at: $time, to: $far}]}}
  in: {tracks: {a: [{at: 0s, to: $far}, {at: $time, to: 0}]}}
  out and in: {play: [{move: out}, {move: in}]}
sequences:
  both: {cues: [{cue: o, robots: mine, move: out and in}]}
";

#[test]
fn file_can_be_included_twice_with_different_parameters() {
    let text = "scenario: s
variables: {width: 20}
include:
  - {file: arm.yaml, as: l, parameters: {side: 1}}
  - {file: arm.yaml, as: r, parameters: {side: -1, reach: 2 * $width - 10, time: 2s}}
cues:
  - {at: 0s, robots: left, move: l.out and in}
  - {at: 0s, robots: right, move: r.out and in}
  - {at: 9s, sequence: r.both}\n";
    let track = |side: i32, time: u32| {
        format!("{{a: [{{at: 0s, to: 0}}, {{at: {time}s, to: {side}}}, {{at: {}s, to: 0}}]}}", 2 * time)
    };
    let written = format!(
        "scenario: s\ncues:\n  - {{at: 0s, robots: left, tracks: {0}}}\n  - {{at: 0s, robots: right, tracks: {1}}}\n  \
         - {{at: 9s, robots: left, tracks: {1}}}\n",
        track(40, 1),
        track(-30, 2)
    );
    check_same(&compiled_with(text, &[("arm.yaml", ARM)]), &written);
}

#[test]
fn include_parameters_are_checked_where_file_is_included() {
    let text = "scenario: s
include:
  - {file: arm.yaml, as: l, parameters: {side: 1, reech: 3}}
  - {file: arm.yaml, as: m, parameters: {side: 1, time: 3}}
  - {file: arm.yaml, as: r}
cues: [{cue: mark}]\n";
    let found = compiled_with(text, &[("arm.yaml", ARM)]);
    check_found(
        &found,
        &[
            (Code::UnknownKey, "s.yaml", 3, "the file `arm.yaml` has no parameter `reech`"),
            (
                Code::WrongKind,
                "s.yaml",
                4,
                "the parameter `time` needs a time, but its value is the number 3",
            ),
            (Code::Variable, "s.yaml", 5, "the file `arm.yaml` needs a value for `side`"),
        ],
    );
    let plain = "scenario: s\ninclude: arm.yaml\ncues: [{cue: mark}]\n";
    check_found(
        &compiled_with(plain, &[("arm.yaml", ARM)]),
        &[(Code::Variable, "s.yaml", 2, "the file `arm.yaml` needs a value for `side`")],
    );
}

#[test]
fn fault_in_included_file_names_its_include() {
    let text = "scenario: s
include:
  - {file: arm.yaml, as: l, parameters: {side: 1}}
  - {file: arm.yaml, as: r, parameters: {side: 9}}
cues: [{at: 0s, robots: right, move: r.out and in}]\n";
    let found = compiled_with(text, &[("arm.yaml", ARM)]);
    let place: Vec<_> = found.findings.iter().map(|f| (f.code, f.file.as_str(), f.line)).collect();
    assert_eq!(place, [(Code::OutOfRange, "arm.yaml", 5)]);
    let message = &found.findings[0].message;
    assert!(
        message.ends_with(
            "(in the move `r.out`, used by the move `r.out and in` in line 7, used in line 4 of s.yaml)"
        ),
        "{message}"
    );
}

#[test]
fn files_that_include_themselves_under_names_are_reported() {
    let file = "include: {file: a.yaml, as: again}\n";
    let text = "scenario: s\ninclude: {file: a.yaml, as: one}\ncues: [{cue: mark}]\n";
    let codes: Vec<_> = compiled_with(text, &[("a.yaml", file)]).findings.iter().map(|f| f.code).collect();
    assert_eq!(codes, [Code::PlaysItself]);
}

#[test]
fn unused_sequence_is_read_as_if_it_started_at_zero() {
    let text = "scenario: s
tempo: [{at: bar 1, bpm: 120}, {at: bar 5, bpm: 60}]
sequences:
  part: {cues: [{at: 2 beats, robots: left, tracks: {a: [{at: 0 beats, to: 0}, {at: 2 beats, to: 10}]}}]}
cues: [{robots: left, tracks: {a: [{at: 0s, to: 0}]}}]
";
    assert_eq!(compiled(text).findings, Vec::new());
}

#[test]
fn cues_of_unused_sequences_do_not_count_towards_scenario_limit() {
    let cue = "{robots: left, tracks: {a: [{at: 0s, to: 0}]}}, ".repeat(100);
    let play = |other: &str, times: u32| format!("{{sequence: {other}}}, ").repeat(times as usize);
    let text = format!(
        "sequences:\n  hundred: {{cues: [{cue}]}}\n  b: {{cues: [{}]}}\n  c: {{cues: [{}]}}\ncues: [{}]\n",
        play("hundred", 120),
        play("hundred", 120),
        play("hundred", 120)
    );
    let found = compiled(&text).findings;
    assert!(found.iter().all(|found| found.code != Code::TooMuch), "{found:?}");
}

#[test]
fn include_names_are_plain_and_distinct() {
    let found = |include: &str| -> Vec<(Code, usize)> {
        let text = format!(
            "scenario: s\ninclude:\n{include}cues: [{{robots: left, tracks: {{a: [{{at: 0s, to: 0}}]}}}}]\n"
        );
        let nods = "moves: {nod: {tracks: {a: [{at: 0s, to: 0}]}}}\n";
        compiled_with(&text, &[("f.yaml", nods)])
            .findings
            .iter()
            .map(|found| (found.code, found.line))
            .collect()
    };
    assert_eq!(found("  - {file: f.yaml, as: r}\n  - {file: f.yaml, as: l}\n"), []);
    assert_eq!(found("  - {file: f.yaml, as: r}\n  - {file: f.yaml, as: r}\n"), [(Code::NameTwice, 4)]);
    assert_eq!(found("  - {file: f.yaml, as: r.x}\n"), [(Code::WrongType, 3)]);
}
