//! Applies the numbers that hints suggest to the scenario. Each number must be sufficient, and no larger than necessary.

use super::groups::{drone, drone_on};
use crate::space::{Coordinate, Space};
use crate::{Code, Compiled, Fleet, NoFiles, Severity, Source, compile};

/// Returns drones on the ground in rows of six. Flat drones cannot leave the ground.
fn fleet(count: usize, is_flat: bool) -> Fleet {
    let robots = (0..count).map(|index| {
        let mut robot = drone(index, [(index % 6) as f64 * 0.7, (index / 6) as f64 * 0.7, 0.0]);
        if let Some(body) = robot.body.as_mut().filter(|_| is_flat) {
            body.coordinates[2] = Coordinate::Fixed(0.0);
        }
        robot
    });
    let robots: Vec<_> = robots.collect();
    let all = robots.iter().map(|robot| robot.id.clone()).collect();
    let space = Space { distance: Some(0.2), ..Space::default() };
    Fleet { groups: [("all".to_owned(), all)].into(), robots, space, ..Fleet::default() }
}

fn compiled(fleet: &Fleet, text: &str) -> Compiled {
    compile(&Source { name: "s.yaml".into(), text: text.to_owned() }, fleet, &NoFiles)
}

/// Returns the only error and its hint.
#[track_caller]
fn fault(fleet: &Fleet, text: &str) -> (Code, String) {
    let found = compiled(fleet, text).findings;
    let errors: Vec<_> = found.iter().filter(|finding| finding.severity == Severity::Error).collect();
    let [only] = errors.as_slice() else { panic!("{text}\n{found:#?}") };
    (only.code, only.hint.clone().unwrap_or_default())
}

#[track_caller]
fn is_sound(fleet: &Fleet, text: &str) {
    let compiled = compiled(fleet, text);
    assert!(compiled.choreography.is_some(), "{text}\n{:#?}", compiled.findings);
}

/// Returns the edits between back-ticks in a hint, such as `radius: 1.55` or `over: 12s`.
fn edits(hint: &str) -> Vec<(&str, &str)> {
    hint.split('`').skip(1).step_by(2).filter_map(|edit| edit.split_once(": ")).collect()
}

/// Changes the value of a key in a scenario. If the key is missing, adds it to the formation.
fn edited(text: &str, (key, value): (&str, &str)) -> String {
    let Some(begin) = text.find(&format!("{key}: ")) else {
        return text.replacen(", at: [", &format!(", {key}: {value}, at: ["), 1);
    };
    let begin = begin + key.len() + 2;
    let rest = &text[begin..];
    let end = if rest.starts_with('[') {
        rest.find(']').unwrap() + 1
    } else {
        rest.find([',', '}', '\n']).unwrap()
    };
    format!("{}{value}{}", &text[..begin], &rest[end..])
}

/// Applies the hint of the only fault to the text, checks that no fault remains, and returns the hint.
#[track_caller]
fn fixed(fleet: &Fleet, text: &str, code: Code) -> String {
    let (found, hint) = fault(fleet, text);
    assert!(
        found == code && (hint.contains("is enough") || hint.contains("use ")),
        "{text}\n{found:?} {hint}"
    );
    let first = hint.split("; ").next().unwrap();
    let text = edits(first).into_iter().fold(text.to_owned(), |text, edit| edited(&text, edit));
    is_sound(fleet, &text);
    hint
}

fn form(formation: &str, cue: &str) -> String {
    format!(
        "scenario: s\nformations: {{f: {{{formation}, at: [1.5, 1, 4]}}}}\ncues: [{{robots: all, {cue}}}]\n"
    )
}

#[test]
fn suggested_size_is_sufficient_and_slightly_less_is_not() {
    let fleet = fleet(12, false);
    for (formation, least) in [
        ("circle: {radius: 0.4}", "circle: {radius: 0.75}"),
        ("circle: {spacing: 0.3}", "circle: {spacing: 0.39}"),
        ("line: {length: 2}", "line: {length: 4.3}"),
        ("grid: {spacing: 0.25}", "grid: {spacing: 0.39}"),
        ("sphere: {radius: 0.3}", "sphere: {radius: 0.4}"),
        ("v: {spacing: 0.1}", "v: {spacing: 0.39}"),
        ("text: OX, size: 0.7", "text: OX, size: 1"),
        ("grid: {spacing: [0.2, 0.3, 1]}, scale: 1", "grid: {spacing: [0.2, 0.3, 1]}, scale: 1.9"),
    ] {
        let cue = "form: f, over: 30s";
        fixed(&fleet, &form(formation, cue), Code::NoWayPast);
        assert_eq!(fault(&fleet, &form(least, cue)).0, Code::NoWayPast, "{least}");
    }
}

#[test]
fn hint_for_larger_formation_includes_longer_time() {
    let hint = fixed(&fleet(12, false), &form("line: {length: 2}", "form: f, over: 1s"), Code::NoWayPast);
    assert!(hint.starts_with("use `") && hint.contains("` with `over: "), "{hint}");
}

#[test]
fn hint_for_exceeded_limits_names_largest_possible_value() {
    let fleet = fleet(12, false);
    for (cue, formation) in [
        ("form: f, over: 300s", "circle: {radius: 70}"),
        ("form: f, over: 300s", "line: {spacing: 20}"),
        ("form: f, over: 300s", "text: HELLO, size: 210"),
        ("shift: [70, -3, 0], over: 300s", "circle: {radius: 1}"),
        ("shift: [0, 0, -80], over: 300s", "circle: {radius: 1}"),
        ("grow: 90, over: 300s", "circle: {radius: 1}"),
    ] {
        fixed(&fleet, &form(formation, cue), Code::OutOfRange);
    }
}

#[test]
fn suggested_time_for_movement_is_enough() {
    let fleet = fleet(12, false);
    for over in ["10ms", "500ms", "1s"] {
        fixed(&fleet, &form("circle: {radius: 3}", &format!("form: f, over: {over}")), Code::BodyTooFast);
    }
}

/// Two robots that must exchange their places but cannot pass above or below each other.
const SWAP: &str = "scenario: s
formations: {wide: {points: [[0, 2, 0], [0.7, -2, 0]]}}
cues:
  - cue: there
    robots: all
    tracks:
      x: [{at: 0s, to: \"if($index == 0, 0, 0.7)\"}, {at: 4s, to: \"if($index == 0, 0.7, 0)\"}]
      y: [{at: 0s, to: 0}, {at: 2s, to: \"if($index == 0, 1, -1)\"}, {at: 4s, to: 0}]
  - {cue: back, after: there, robots: all, form: home, over: 5s}
";

#[test]
fn hint_proposes_intermediate_formation_to_avoid_collision() {
    let fleet = fleet(2, true);
    let (code, hint) = fault(&fleet, SWAP);
    assert_eq!(code, Code::NoWayPast);
    assert!(hint.contains("form `wide` on the way"), "{hint}");
    let between =
        "  - {cue: wide, after: there, robots: all, form: wide, over: 5s}\n  - {cue: back, after: wide,";
    is_sound(&fleet, &SWAP.replace("  - {cue: back, after: there,", between));
}

const CIRCLE: [&str; 3] = ["after: c", "after: a + 500ms", "after: end of b"];

#[test]
fn cycle_is_resolved_by_removing_any_of_its_relations() {
    let cue = |(name, when): (&str, &str)| {
        let tracks = "tracks: {x: [{at: 0s, to: 0}, {at: 2s, to: 1}]}";
        format!(
            "  - {{cue: {name}, {when}, robots: d{}, {tracks}}}\n",
            ["a", "b", "c"].iter().position(|n| *n == name).unwrap()
        )
    };
    let text = |relations: [&str; 3]| {
        format!(
            "scenario: s\ncues:\n{}",
            ["a", "b", "c"].into_iter().zip(relations).map(cue).collect::<String>()
        )
    };
    let mut fleet = fleet(3, false);
    fleet.space.distance = None;
    let (code, hint) = fault(&fleet, &text(CIRCLE));
    let message = &compiled(&fleet, &text(CIRCLE)).findings[0].message;
    assert!(message.contains("form a cycle"), "{message}");
    for (index, relation) in ["after: c", "after: a + 500ms", "after: b"].iter().enumerate() {
        assert!(code == Code::Conflict && hint.contains(&format!("`{relation}`")), "{hint}");
        let mut without = CIRCLE;
        without[index] = "at: 0s";
        is_sound(&fleet, &text(without));
    }
    // A deadline or a fixed time is not a cycle.
    let with = text(["at: 0s", "after: a, with: a", "at: 0s"]);
    assert!(!compiled(&fleet, &with).findings[0].message.contains("wait"));
    let both = text(["with: b", "after: a", "at: 0s"]);
    assert!(compiled(&fleet, &both).findings[0].message.contains("form a cycle"));
    let late = text(["at: 1s", "after: a + 0s..1s", "before: b"]);
    assert!(!compiled(&fleet, &late).findings.iter().any(|found| found.message.contains("cycle")));
}

#[test]
fn endless_cycle_of_acts_is_resolved_by_hinted_end() {
    let act = |number: usize, next: usize| {
        format!(
            "  - {{act: a{number}, next: a{next}, cues: [{{robots: d0, tracks: {{x: [{{at: 0s, to: 0}}]}}}}]}}\n"
        )
    };
    let text = format!(
        "scenario: s\nacts:\n{}",
        (0..9).map(|number| act(number, (number + 1) % 9)).collect::<String>()
    );
    let fleet = fleet(1, false);
    let (code, hint) = fault(&fleet, &text);
    assert!(code == Code::DeadEnd && hint == "write `next: end` in the act `a8`", "{hint}");
    is_sound(&fleet, &text.replace("act: a8, next: a0", "act: a8, next: end"));
    // Two cycles are two findings; an act that leads into a cycle is none.
    let two = format!("scenario: s\nacts:\n{}{}{}{}", act(0, 1), act(1, 1), act(2, 3), act(3, 2))
        .replace("act: a0,", "act: a0, wait: {for: operator, timeout: 1s, otherwise: a2},");
    let found = compiled(&fleet, &two).findings;
    let ends: Vec<_> =
        found.iter().filter(|found| found.code == Code::DeadEnd).map(|found| found.line).collect();
    assert_eq!(ends, [4, 6], "{found:#?}");
}

#[test]
fn unreachable_acts_are_reported_at_first_of_them() {
    let act = |name: &str, next: &str| {
        format!(
            "  - {{act: {name}, next: {next}, cues: [{{robots: d0, tracks: {{x: [{{at: 0s, to: 0}}]}}}}]}}\n"
        )
    };
    let text =
        format!("scenario: s\nacts:\n{}{}{}{}", act("a", "end"), act("b", "c"), act("c", "d"), act("d", "c"));
    let mut fleet = fleet(1, false);
    fleet.space.distance = None;
    let found = compiled(&fleet, &text).findings;
    let messages: Vec<&str> = found.iter().map(|found| found.message.as_str()).collect();
    assert_eq!(messages, ["the act `b` is unreachable, and with it `c`, `d`"]);
}

#[test]
fn move_scaled_or_mirrored_beyond_limits_gets_exact_hint() {
    let text = |keys: &str| {
        format!(
            "scenario: s\nmoves: {{m: {{tracks: {{d: [{{at: 0s, to: 10}}, {{at: 1s, to: 40}}]}}}}}}\ncues: [{{robots: arm, move: m, {keys}}}]\n"
        )
    };
    let fleet = super::fleet();
    let (code, hint) = fault(&fleet, &text("scale: 3"));
    assert_eq!((code, hint.as_str()), (Code::OutOfRange, "use a factor of at most 2.25"));
    is_sound(&fleet, &text("scale: 2.25"));
    let (code, hint) = fault(&fleet, &text("mirror: true"));
    assert_eq!(
        (code, hint.as_str()),
        (
            Code::OutOfRange,
            "mirror it about its middle to stay within the limits: `{about: 25, devices: [d]}`"
        )
    );
    is_sound(&fleet, &text("mirror: {about: 25, devices: [d]}"));
}

#[test]
fn invalid_parameter_is_reported_where_it_is_given() {
    let text = |to: &str| {
        format!(
            "scenario: s
moves: {{m: {{parameters: {{to: 0}}, tracks: {{d: [{{at: 0s, to: 0}}, {{at: 1s, to: $to}}]}}}}}}
cues:
  - {{robots: arm, move: m, parameters: {{to: {to}}}}}
"
        )
    };
    let fleet = super::fleet();
    let finding = &compiled(&fleet, &text("120")).findings[0];
    assert_eq!((finding.line, finding.column), (4, 45), "{finding:#?}");
    assert_eq!(finding.hint.as_deref(), Some("`to` sets it to 120: the nearest possible value is 90"));
    is_sound(&fleet, &text("90"));
    let finding = &compiled(&fleet, &text("20deg")).findings[0];
    assert_eq!((finding.line, finding.column, finding.message.as_str()), (4, 45, "found the text `20deg`"));
}

#[test]
fn wave_shifted_or_scaled_as_hinted_is_within_limits() {
    let text = |center: f64| {
        format!(
            "scenario: s\ncues: [{{robots: arm, tracks: {{d: {{tolerance: 3, wave: {{amplitude: 10, period: 4s, center: {center}, for: 4s}}}}}}}}]\n"
        )
    };
    let fleet = super::fleet();
    for (center, hint) in [(4.0, "increase all values by 6"), (84.0, "decrease all values by 4")] {
        let (code, told) = fault(&fleet, &text(center));
        assert_eq!((code, told.as_str()), (Code::OutOfRange, hint));
    }
    is_sound(&fleet, &text(10.0));
    is_sound(&fleet, &text(80.0));
    // An amplitude that is too large for any position.
    let large = |amplitude: &str| text(45.0).replace("amplitude: 10", &format!("amplitude: {amplitude}"));
    let (code, told) = fault(&fleet, &large("60"));
    let expected = "the values span 120, but the limits span only 90: scale the movement by 0.75";
    assert_eq!((code, told.as_str()), (Code::OutOfRange, expected));
    is_sound(&fleet, &large("0.75 * 60"));
}

/// Returns drones in a row above the ground. Their devices have steps of 0.01 and move at up to 3 m/s.
fn coarse(count: usize) -> Fleet {
    let robots = (0..count).map(|index| {
        let mut robot = drone_on([0.01; 2], index, [index as f64, 0.0, 1.0]);
        if let Some(body) = &mut robot.body {
            body.speed = Some(3.0);
        }
        robot
    });
    let robots: Vec<_> = robots.collect();
    let all = robots.iter().map(|robot| robot.id.clone()).collect();
    let space = Space { distance: Some(0.4), ..Space::default() };
    Fleet { groups: [("all".to_owned(), all)].into(), robots, space, ..Fleet::default() }
}

#[test]
fn suggested_time_for_turn_is_enough_for_its_steps() {
    for count in [5, 8, 12] {
        for keys in ["turn: 90", "turn: 360", "grow: 1.2, turn: 180, shift: [0, 0, 1]", "grow: 3"] {
            let text = format!("scenario: s\ncues: [{{robots: all, {keys}, over: 100ms}}]\n");
            fixed(&coarse(count), &text, Code::BodyTooFast);
        }
    }
}

#[test]
fn places_of_suggested_size_leave_room_for_steps() {
    for count in [7, 12] {
        for formation in [
            "circle: {radius: 0.35}",
            "circle: {spacing: 0.3}",
            "line: {spacing: 0.3}, rotate: 30",
            "grid: {spacing: 0.3}",
        ] {
            fixed(&coarse(count), &form(formation, "form: f, over: 30s"), Code::NoWayPast);
        }
    }
}

#[test]
fn hint_for_parameter_in_expression_refers_to_result() {
    let text = "scenario: s
moves: {m: {parameters: {to: 0}, tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 2 * $to}]}}}
cues:
  - {robots: arm, move: m, parameters: {to: 80}}
";
    let (code, hint) = fault(&super::fleet(), text);
    let expected = "`to` results in 160: use a value that results in at most 90";
    assert_eq!((code, hint.as_str()), (Code::OutOfRange, expected));
}

#[test]
fn size_is_blamed_for_too_long_path_that_leaves_limits() {
    let fleet = fleet(6, false);
    let text = form("circle: {radius: 300}", "form: f, over: 1s");
    let hint = fixed(&fleet, &text, Code::OutOfRange);
    assert!(hint.contains("radius: ") && hint.contains("over: "), "{hint}");
}

#[test]
fn formation_of_wrong_size_is_one_finding() {
    let text = "scenario: s
formations: {f: {circle: {radius: 300}, at: [1.5, 1, 4]}}
cues:
  - {cue: a, robots: all, form: f, over: 9000s}
  - {cue: b, after: a, robots: all, form: home, over: 9000s}
  - {cue: c, after: b, robots: all, form: f, over: 9000s}
";
    let found = compiled(&fleet(6, false), text).findings;
    assert_eq!(found.iter().map(|found| found.code).collect::<Vec<_>>(), [Code::OutOfRange], "{found:#?}");
    let text = text.replace("radius: 300", "radius: 0.05");
    let found = compiled(&fleet(6, false), &text).findings;
    assert_eq!(found.iter().map(|found| found.code).collect::<Vec<_>>(), [Code::NoWayPast], "{found:#?}");
}

#[test]
fn places_at_required_distance_are_far_enough() {
    let robots: Vec<_> = (0..12).map(|index| drone_on([0.01; 2], index, [index as f64, 0.0, 0.0])).collect();
    let between = robots[0].body.as_ref().map_or(0.0, |body| 2.0 * body.shape.outer_radius());
    let all = robots.iter().map(|robot| robot.id.clone()).collect();
    let space = Space { distance: Some(0.4), ..Space::default() };
    let fleet = Fleet { groups: [("all".to_owned(), all)].into(), robots, space, ..Fleet::default() };
    let spacing = |spacing: f64| format!("line: {{spacing: {spacing}}}, rotate: 7");
    is_sound(&fleet, &form(&spacing(0.4 + between), "form: f, over: 20s"));
    let (code, _) = fault(&fleet, &form(&spacing(0.38 + between), "form: f, over: 20s"));
    assert_eq!(code, Code::NoWayPast);
}
