//! A second evaluation of groups of bodies: positions are sampled from the steps of the plan, without the compiler's own paths.

use std::fmt::Write as _;

use proptest::prelude::*;

use super::robot;
use crate::space::{Body, Coordinate, Shape, Space};
use crate::{Act, Address, Code, Compiled, Fleet, FleetRobot, NoFiles, RateLimits, Source, compile};

/// Sampling interval of positions, in milliseconds.
const EVERY_MS: f64 = 5.0;
/// Largest permitted error of the devices, in metres.
const ERROR: f64 = 0.002;
const RADIUS: f64 = 0.1;
const DISTANCE: f64 = 0.2;

fn device(id: &str, home: f64, [granularity, error]: [f64; 2]) -> String {
    let limits =
        format!(r#""min_value": -50, "max_value": 50, "granularity": {granularity}, "max_error": {error}"#);
    format!(
        r#"{{"id": "{id}", "name": "{id}", "unit": "m", "interpolation": "linear", "default_value": {home}, "available_control_types": {{
  "position": {{{limits}}}, "script": {{{limits}, "max_number_of_steps": 2000}}}}}}"#
    )
}

/// Returns a drone with this initial place.
pub(super) fn drone(index: usize, at: [f64; 3]) -> FleetRobot {
    drone_on([0.001, ERROR], index, at)
}

/// Returns a drone whose devices have this granularity and largest error, both in metres.
pub(super) fn drone_on(grid: [f64; 2], index: usize, [x, y, z]: [f64; 3]) -> FleetRobot {
    let id = format!("d{index}");
    let devices = [("x", x), ("y", y), ("z", z)].map(|(name, home)| device(name, home, grid)).join(", ");
    let block = format!(r#"{{"id": "{id}", "api_version": "1", "devices": [{devices}]}}"#);
    let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
    let mut robot = FleetRobot::new(init.id.clone(), Address::Simulated, Some(init));
    let device = |name: &str| Coordinate::Device { device: name.parse().unwrap(), scale: 1.0, offset: 0.0 };
    let coordinates = [device("x"), device("y"), device("z"), Coordinate::Fixed(0.0)];
    let shape = Shape::Ball { radius: RADIUS };
    robot.body =
        Some(Body { coordinates, shape, speed: Some(5.0), acceleration: Some(10.0), ..Body::default() });
    robot
}

/// Returns drones on the ground in rows of ten, with a group `all`.
fn fleet(count: usize) -> Fleet {
    let place = |index: usize| [(index % 10) as f64 * 0.7, (index / 10) as f64 * 0.7, 0.0];
    let robots: Vec<FleetRobot> = (0..count).map(|index| drone(index, place(index))).collect();
    let all = robots.iter().map(|robot| robot.id.clone()).collect();
    let space = Space { distance: Some(DISTANCE), ..Space::default() };
    Fleet { groups: [("all".to_owned(), all)].into(), robots, space, ..Fleet::default() }
}

pub(super) fn compiled(count: usize, text: &str) -> Compiled {
    let source = Source { name: "s.yaml".into(), text: text.to_owned() };
    compile(&source, &fleet(count), &NoFiles)
}

pub(super) fn sound(count: usize, text: &str) -> Act {
    let compiled = compiled(count, text);
    let mut choreography = compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings));
    assert!(compiled.findings.is_empty(), "{:#?}", compiled.findings);
    choreography.acts.remove(0)
}

/// The steps of each drone's x, y and z, as times in milliseconds and values.
pub(super) type Steps = Vec<[Vec<(f64, f64)>; 3]>;

pub(super) fn steps(act: &Act, count: usize) -> Steps {
    let fleet = fleet(count);
    let home = |robot: &FleetRobot| {
        let devices = &robot.init.as_ref().unwrap().devices;
        ["x", "y", "z"].map(|axis| {
            let device = devices.iter().find(|device| device.id.as_str() == axis);
            device.unwrap().default_value.unwrap()
        })
    };
    steps_of(act, &fleet, &fleet.robots.iter().map(home).collect::<Vec<_>>())
}

/// Returns the steps of robots that begin at the places `from`.
pub(super) fn steps_of(act: &Act, fleet: &Fleet, from: &[[f64; 3]]) -> Steps {
    let of = |(robot, from): (&FleetRobot, &[f64; 3])| {
        std::array::from_fn(|number| {
            let axis = ["x", "y", "z"][number];
            let mut steps = vec![(0.0, from[number])];
            let plan = act.plan.robots.iter().find(|plan| plan.robot == robot.id);
            for script in
                plan.iter().flat_map(|plan| &plan.scripts).filter(|script| script.device.as_str() == axis)
            {
                steps.push((script.start.get(), steps.last().unwrap().1));
                let own = script.script.steps().iter();
                steps.extend(own.map(|step| (script.start.get() + step.offset.get(), step.setpoint.value)));
            }
            steps
        })
    };
    fleet.robots.iter().zip(from).map(of).collect()
}

fn value(steps: &[(f64, f64)], at: f64) -> f64 {
    let after = steps.partition_point(|(time, _)| *time <= at);
    match (after.checked_sub(1).map(|before| steps[before]), steps.get(after)) {
        (Some((from, a)), Some((to, b))) => a + (b - a) * (at - from) / (to - from),
        (Some((_, last)), None) => last,
        (None, _) => steps[0].1,
    }
}

pub(super) fn places(steps: &Steps, at: f64) -> Vec<[f64; 3]> {
    steps.iter().map(|axes| axes.each_ref().map(|axis| value(axis, at))).collect()
}

pub(super) fn apart(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// Returns the least distance between any two bodies at any sampled time, from surface to surface, in metres.
fn closest(act: &Act, steps: &Steps) -> f64 {
    let ends = act.cues.iter().map(|cue| cue.end.as_millis_f64()).fold(0.0, f64::max);
    let mut least = f64::INFINITY;
    let mut at = 0.0;
    while at <= ends {
        let places = places(steps, at);
        for (index, a) in places.iter().enumerate() {
            least = places[index + 1..].iter().map(|b| apart(a, b)).fold(least, f64::min);
        }
        at += EVERY_MS;
    }
    least - 2.0 * RADIUS
}

const SHOW: &str = "scenario: eight drones
tempo: 120
formations:
  ring: {circle: {radius: 1.5}, at: [2, 0, 1.5]}
  geese: {v: {spacing: 0.8}, at: [2, 0, 1.5]}
cues:
  - {cue: take off, at: 0s, robots: all, shift: [0, 0, 1.5], over: 4 beats, canon: 1 beat}
  - {cue: circle, after: take off, robots: all, form: ring, over: 16 beats}
  - {cue: round, after: circle, robots: all, turn: 720, over: 96 beats}
  - {cue: vee, after: round, robots: all, form: geese, over: 16 beats}
  - {cue: hold, after: vee + 8s, robots: all, shift: [0, 1, 0], over: 8 beats}
  - {cue: land, after: hold, robots: all, form: home, over: 16 beats, canon: 1 beat}
";

#[test]
fn suggested_time_for_formation_is_enough() {
    // Over 0.7 m, the least time is 15/8 of the distance at 5 m/s, or 10/sqrt(3) of the distance at 10 m/s2, which is longer.
    let text = |over: &str| {
        format!(
            "scenario: s\nformations: {{f: {{points: [[0.7, 0, 0]]}}}}\ncues: [{{robots: d0, form: f, over: {over}}}]\n"
        )
    };
    let short = compiled(1, &text("10ms"));
    let expected = short.findings[0].expected.clone();
    let needed = expected.split(['`', ' ']).nth(2).unwrap();
    assert!(compiled(1, &text(needed)).findings.is_empty(), "{expected}");
}

/// Returns the findings that report robots at unknown places, in a scenario of acts.
fn lost(text: &str) -> Vec<String> {
    let found = compiled(2, text).findings;
    found
        .into_iter()
        .filter(|finding| finding.code == Code::NotInGroup)
        .map(|finding| finding.message)
        .collect()
}

const UP: &str = "{cue: up, at: 0s, robots: all, shift: [0, 0, 1], over: 9s}";

#[test]
fn positions_are_unknown_in_act_also_reached_after_failure() {
    let acts = |policy: &str| {
        format!(
            "scenario: s\nacts:\n  - {{act: one, cues: [{UP}], {policy}}}\n  - {{act: two, cues: [{UP}]}}\n"
        )
    };
    assert_eq!(lost(&acts("on_failure: stop")), Vec::<String>::new());
    let after_failure = lost(&acts("on_failure: {default: stop, then: two}"));
    assert!(after_failure.len() == 1 && after_failure[0].contains("when `up` starts"), "{after_failure:?}");
}

#[test]
fn positions_are_unknown_in_act_revisited_from_later_act() {
    let acts = |next: &str| {
        format!(
            "scenario: s\nacts:\n  - {{act: one, wait: operator, cues: [{UP}]}}\n  - {{act: two, wait: {{time: '19:30:00', timeout: 30s, otherwise: end}}, cues: [{UP}], next: {next}}}\n"
        )
    };
    assert_eq!(lost(&acts("end")), Vec::<String>::new());
    assert_eq!(lost(&acts("one")).len(), 1, "what follows the act is not told once more");
}

#[test]
fn act_reached_only_by_failure_starts_where_failure_policy_leaves_robots() {
    let text = |policy: &str| {
        format!(
            "scenario: s\nacts:\n  - {{act: one, cues: [{UP}], next: end, on_failure: {{default: {policy}, then: landing}}}}\n  - {{act: landing, cues: [{{cue: down, at: 0s, robots: all, form: home, over: 9s}}]}}\n"
        )
    };
    assert_eq!(lost(&text("home")), Vec::<String>::new());
    assert_eq!(lost(&text("stop")).len(), 1, "they may have stopped anywhere");
}

#[test]
fn movement_modifiers_are_refused_with_group_movements() {
    for key in ["repeat: 2", "mirror: true", "scale: 2", "reverse: true", "overrides: {d1: {mirror: true}}"] {
        let found = compiled(
            3,
            &format!("scenario: s\ncues: [{{robots: all, shift: [0, 0, 1], over: 4s, {key}}}]\n"),
        );
        let codes: Vec<Code> = found.findings.iter().map(|finding| finding.code).collect();
        assert_eq!(codes, [Code::UnknownKey], "{key}: {:#?}", found.findings);
    }
}

#[test]
fn waiting_robots_end_exactly_with_their_cue() {
    for (tempo, beats) in [(130, 8), (130, 11), (151, 9), (163, 8)] {
        let text = format!(
            "scenario: s
tempo: {tempo}
formations: {{line: {{line: {{spacing: 1.5}}, at: [3, 0, 2]}}}}
cues:
  - {{cue: up, at: 0s, robots: all, form: line, over: {beats} beats}}
  - {{cue: home, after: up, robots: all, form: home, over: {beats} beats, canon: 1 beat}}
  - {{cue: again, after: home, robots: all, form: line, over: {beats} beats}}
"
        );
        sound(4, &text);
    }
}

#[test]
fn eight_drones_take_off_circle_form_v_and_land() {
    assert!(SHOW.lines().count() < 50);
    let act = sound(8, SHOW);
    let (steps, stated) = (steps(&act, 8), act.in_space.closest.as_ref().unwrap().distance);
    let sampled = closest(&act, &steps);
    assert!(
        stated >= DISTANCE - 1e-6 && sampled >= stated - 1e-6 && sampled <= stated + 0.02,
        "{sampled} {stated}"
    );
    // The third drone takes off on the third beat.
    assert_eq!((places(&steps, 1_000.0)[2][2], places(&steps, 1_000.0)[3][2]), (0.0, 0.0));
    assert!(places(&steps, 1_600.0)[2][2] > 0.0 && places(&steps, 3_100.0)[2][2] > 1.49);
    let cue = |name: &str| act.cues.iter().find(|cue| cue.name == name).unwrap();
    let end = act.cues.iter().map(|cue| cue.end.as_millis_f64()).fold(0.0, f64::max);
    let home: Vec<[f64; 3]> = (0..8).map(|index| [f64::from(index) * 0.7, 0.0, 0.0]).collect();
    for (place, home) in places(&steps, end).iter().zip(&home) {
        assert!(apart(place, home) < 1e-3, "{place:?} {home:?}");
    }
    // During the turn, all drones stay on the circle; after two turns, they are back at their places.
    let round = (cue("round").start.as_millis_f64(), cue("round").end.as_millis_f64());
    for at in 0..=1_000 {
        let at = round.0 + (round.1 - round.0) * f64::from(at) / 1_000.0;
        for [x, y, z] in places(&steps, at) {
            let radius = (x - 2.0).hypot(y);
            assert!(
                (radius - 1.5).abs() < 1.5 * ERROR + 1e-3 && (z - 1.5).abs() < 1e-6,
                "{radius} {z} at {at}"
            );
        }
    }
    for (a, b) in places(&steps, round.0).iter().zip(places(&steps, round.1)) {
        assert!(apart(a, &b) < 2.0 * ERROR);
    }
}

#[test]
fn hundred_drones_change_formations_and_keep_their_distance() {
    let text = "scenario: hundred
formations:
  ring: {circle: {spacing: 0.6}, at: [0, 0, 12], rotate: [90, 0, 0]}
  word: {text: DOWN, scale: 8, at: [0, 0, 6]}
  block: {grid: {spacing: 0.7}, at: [0, 0, 3]}
cues:
  - {cue: up, at: 0s, robots: all, form: ring, over: 12s}
  - {cue: word, after: up, robots: all, form: word, over: 20s}
  - {cue: block, after: word, robots: all, form: {to: block, least: longest}, over: 20s}
";
    let act = sound(100, text);
    let stated = act.in_space.closest.as_ref().unwrap().distance;
    let sampled = closest(&act, &steps(&act, 100));
    assert!(stated >= DISTANCE - 1e-6 && sampled >= stated - 1e-6, "{sampled} {stated}");
}

#[test]
fn bodies_with_close_places_are_positioned_more_finely() {
    // Two bodies must be 0.4 m apart, from middle to middle, and the steps of each may be off by up to 35 mm.
    for spacing in ["0.402", "0.41", "0.43"] {
        let text = format!(
            "scenario: close
formations:
  row: {{line: {{spacing: {spacing}}}, at: [6, 4, 2], rotate: 25}}
cues:
  - {{cue: row, at: 0s, robots: all, form: row, over: 8s, tolerance: 0.02}}
  - {{cue: home, after: row, robots: all, form: home, over: 8s, tolerance: 0.02}}
"
        );
        let act = sound(8, &text);
        let (stated, sampled) =
            (act.in_space.closest.as_ref().unwrap().distance, closest(&act, &steps(&act, 8)));
        assert!(stated >= DISTANCE - 1e-6 && sampled >= stated - 1e-6, "{sampled} {stated}");
    }
}

#[test]
fn bodies_starting_too_close_are_not_blamed_on_grid() {
    let mut fleet = fleet(3);
    fleet.robots[1] = drone(1, [0.3, 0.0, 0.0]);
    let text = "scenario: s\nformations: {f: {line: {spacing: 1}, at: [5, 5, 3]}}\ncues: [{cue: c, at: 0s, robots: all, form: f, over: 9s}]\n";
    let found = compile(&Source { name: "s.yaml".into(), text: text.into() }, &fleet, &NoFiles).findings;
    let [finding] = found.as_slice() else { panic!("{found:#?}") };
    assert_eq!(finding.code, Code::TooClose);
    assert!(!finding.hint.as_ref().unwrap().contains("grid"), "{finding:#?}");
}

#[test]
fn places_too_close_for_some_bodies_are_reported() {
    let mut fleet = fleet(3);
    fleet.robots[2].body.as_mut().unwrap().shape = Shape::Ball { radius: 0.5 };
    let cue = |cue: &str| {
        let text = format!(
            "scenario: s\nformations: {{f: {{line: {{spacing: 0.5}}, at: [5, 5, 3]}}}}\ncues: [{{cue: c, at: 0s, robots: all, {cue}, over: 9s}}]\n"
        );
        let found = compile(&Source { name: "s.yaml".into(), text }, &fleet, &NoFiles).findings;
        let [finding] = found.as_slice() else { panic!("{found:#?}") };
        (finding.code, finding.expected.clone(), finding.hint.clone().unwrap())
    };
    // The distances are 0.1 m, 0.5 m and 0.2 m.
    let (code, expected, hint) = cue("form: f");
    assert_eq!((code, expected.as_str()), (Code::NoWayPast, "at least 0.800 m; they end 0.500 m apart"));
    assert_eq!(hint, "use `spacing: 0.807`");
}

#[test]
fn group_starts_where_previous_movements_end_even_in_next_act() {
    let text = "scenario: acts
acts:
  - act: one
    cues:
      - {cue: later, at: 2s, robots: d0, shift: [0, 0, 2], over: 2s}
      - {cue: first, at: 0s, robots: d0, tracks: {x: [{at: 0s, to: 0}, {at: 1s, to: 3}]}}
  - act: two
    cues: [{cue: turn, at: 0s, robots: d0, turn: {by: 90, about: [0, 0]}, grow: 2, shift: [1, 0, 0], over: 4s}]
";
    let compiled = compiled(1, text);
    let acts = compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings)).acts;
    let last = |act: &Act, device: &str| {
        let scripts = &act.plan.robots[0].scripts;
        scripts
            .iter()
            .rfind(|script| script.device.as_str() == device)
            .map(|script| script.script.steps().last().unwrap().setpoint.value)
    };
    assert_eq!((last(&acts[0], "x"), last(&acts[0], "y"), last(&acts[0], "z")), (Some(3.0), None, Some(2.0)));
    // [3, 0], doubled and turned by 90 degrees, is [0, 6].
    assert_eq!((last(&acts[1], "x"), last(&acts[1], "y"), last(&acts[1], "z")), (Some(1.0), Some(6.0), None));
}

/// Returns the codes of all findings, and the text of the first finding.
fn found(count: usize, cue: &str) -> (Vec<Code>, String) {
    let mut text =
        "scenario: s\nformations: {three: {points: [[0, 0, 1], [2, 0, 1], [4, 0, 1]]}}\ncues:\n".to_owned();
    writeln!(text, "  - {{cue: c, at: 0s, robots: all, {cue}}}").unwrap();
    let findings = compiled(count, &text).findings;
    let first =
        findings.first().map(|first| format!("{} | {} | {:?}", first.message, first.expected, first.hint));
    (findings.iter().map(|finding| finding.code).collect(), first.unwrap_or_default())
}

#[test]
fn mismatch_of_robots_and_places_requires_explicit_choice() {
    assert_eq!(found(4, "form: three, over: 5s").0, [Code::PlacesCount]);
    assert_eq!(found(2, "form: three, over: 5s").0, [Code::PlacesCount]);
    for (count, choice) in [(4, "spare: stay"), (4, "spare: home"), (2, "thin: evenly"), (2, "thin: nearest")]
    {
        let (codes, text) = found(count, &format!("form: {{to: three, {choice}}}, over: 5s"));
        assert!(codes.is_empty(), "{choice}: {text}");
    }
    // `spare`, the choice for too few places, is ignored if there are too many.
    assert_eq!(found(2, "form: {to: three, spare: stay}, over: 5s").0, [Code::PlacesCount]);
}

#[test]
fn impossible_group_movements_are_reported() {
    let (codes, text) = found(3, "form: three, over: 100ms");
    assert_eq!(codes, [Code::BodyTooFast]);
    assert!(text.contains("`over: "), "{text}");
    for (cue, code) in [
        ("form: tree, over: 5s", Code::UnknownFormation),
        ("form: three", Code::MissingKey),
        ("over: 3s", Code::MissingKey),
        ("form: three, over: 0s", Code::BadMotion),
        ("form: three, turn: 90, over: 5s", Code::UnknownKey),
        ("form: three, over: 5s, duration: 5s", Code::UnknownKey),
        ("form: {to: three, least: way}, over: 5s", Code::UnknownWord),
        ("grow: 0, over: 5s", Code::WrongType),
        ("shift: [1, 2], over: 5s", Code::WrongType),
        ("shift: [0, 0, 1e300], over: 5s", Code::WrongType),
        ("shift: [0, 0, 100], over: 100s", Code::OutOfRange),
        ("turn: 1e9, over: 5s", Code::WrongType),
        ("form: three, over: 5s, tracks: {x: [{at: 0s, to: 0}, {at: 1s, to: 0}]}", Code::Overlap),
    ] {
        let (codes, text) = found(3, cue);
        assert!(codes.contains(&code), "{cue}: {codes:?} {text}");
    }
    // A robot without a body.
    let fleet = Fleet { robots: vec![robot()], ..Fleet::default() };
    let text = "scenario: s\ncues: [{at: 0s, robots: arm, shift: [0, 0, 1], over: 1s}]\n";
    let source = Source { name: "s.yaml".into(), text: text.to_owned() };
    let findings = compile(&source, &fleet, &NoFiles).findings;
    assert_eq!(findings.iter().map(|found| found.code).collect::<Vec<_>>(), [Code::NotInGroup]);
}

#[test]
fn group_leaving_device_limits_is_reported_once_per_device() {
    let findings =
        compiled(12, "scenario: s\ncues: [{at: 0s, robots: all, turn: 720, grow: 40, over: 500s}]\n")
            .findings;
    let others: Vec<_> = findings.iter().filter(|finding| finding.code != Code::OutOfRange).collect();
    assert!(others.is_empty(), "{others:#?}");
    assert!((1..=24).contains(&findings.len()), "{}", findings.len());
    let mut told: Vec<&str> = findings.iter().map(|finding| finding.message.as_str()).collect();
    told.sort_unstable();
    told.dedup();
    assert_eq!(told.len(), findings.len(), "{findings:#?}");
}

#[test]
fn distances_are_computed_from_settable_positions() {
    let mut fleet = fleet(2);
    for robot in &mut fleet.robots {
        let block = robot.init.as_mut().unwrap();
        let text = serde_json::to_string(&block).unwrap();
        let coarse = text
            .replace("\"granularity\":0.001", "\"granularity\":0.5")
            .replace("\"max_error\":0.002", "\"max_error\":0.5");
        assert_ne!(coarse, text);
        *block = serde_json::from_str(&coarse).unwrap();
        robot.body.as_mut().unwrap().acceleration = None;
    }
    // d1 is at 0.7 m, which is not a multiple of 0.5 m. The distance to the place is 1.3 m as set, and 1.05 m as written.
    let formation = "f: {points: [[-1, 0, 0], [1.75, 0, 0]]}";
    let over = enough(&fleet, formation, "form: f, over: 10ms").unwrap();
    let needed: f64 = over.trim_end_matches("ms").parse().unwrap();
    // 1.3 m at 5 m/s at most, with minimum jerk.
    assert!((needed - 1.3 / 5.0 * 1.875 * 1_000.0).abs() < 15.0, "{over}");
}

#[test]
fn single_robot_turned_or_grown_about_itself_is_reported_as_unmoved() {
    for cue in ["turn: 90, over: 5s", "grow: 2, over: 5s", "turn: {by: 90, about: [0, 0]}, over: 5s"] {
        let (codes, text) = found(1, cue);
        assert_eq!(codes, [Code::NotInGroup], "{cue}");
        assert!(text.contains("none of them moves"), "{text}");
    }
    assert!(found(1, "turn: {by: 90, about: [1, 0]}, over: 5s").0.is_empty());
    assert!(found(1, "turn: 90, shift: [1, 0, 0], over: 5s").0.is_empty());
    assert!(found(2, "turn: 90, over: 5s").0.is_empty());
}

#[test]
fn large_numbers_are_reported_with_few_digits() {
    for cue in ["shift: [1e300, 0, 0], over: 5s", "turn: 1e300, over: 5s"] {
        let (_, text) = found(2, cue);
        assert!(text.len() < 200, "{text}");
    }
}

/// Returns a fleet with limits for its devices instead of its bodies.
fn limited(count: usize) -> Fleet {
    let mut fleet = fleet(count);
    let limits = |speed: f64| RateLimits { speed: Some(speed), acceleration: Some(2.0) };
    for robot in &mut fleet.robots {
        robot.limits =
            [("x", 1.0), ("y", 1.5), ("z", 0.5)].map(|(id, speed)| (id.to_owned(), limits(speed))).into();
        let body = robot.body.as_mut().unwrap();
        (body.speed, body.acceleration) = (None, None);
    }
    fleet
}

#[test]
fn suggested_time_is_enough_for_axes_stepping_at_different_times() {
    let cue = "turn: -154, grow: 2.9, shift: [1.5, -0.8, -0.3]";
    let over = enough(&fleet(3), "", &format!("{cue}, over: 10ms")).unwrap();
    assert_eq!(enough(&fleet(3), "", &format!("{cue}, over: {over}")), None, "{over}");
}

/// Returns the sufficient time that the hint suggests for a group that would move too fast; `None` if there is no such finding.
fn enough(fleet: &Fleet, formations: &str, cue: &str) -> Option<String> {
    let text = format!("scenario: s\nformations: {{{formations}}}\ncues: [{{at: 0s, robots: all, {cue}}}]\n");
    let found = compile(&Source { name: "s.yaml".into(), text }, fleet, &NoFiles).findings;
    let of_space = [Code::TooClose, Code::NoWayPast, Code::OutOfRange, Code::NearPlaces];
    let too_fast = found.iter().find(|finding| !of_space.contains(&finding.code))?;
    let told = too_fast.expected.split_once("over: ");
    let (_, after) = told.unwrap_or_else(|| panic!("{cue}: {too_fast:#?}"));
    Some(after.split_once('`').unwrap().0.to_owned())
}

#[test]
fn finding_names_places_too_close_for_their_bodies() {
    let (codes, text) = found(2, "form: {to: three, thin: evenly}, over: 5s");
    assert!(codes.is_empty(), "{text}");
    let near = "near: {points: [[0, 0, 1], [0.39, 0, 1], [4, 0, 1]]}";
    let text = format!(
        "scenario: s\nformations: {{{near}}}\ncues: [{{at: 0s, robots: all, form: near, over: 60s}}]\n"
    );
    let findings = compiled(3, &text).findings;
    let codes: Vec<Code> = findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, [Code::NoWayPast], "{findings:#?}");
    assert_eq!(findings[0].message, "places 1 and 2 of `near` are 0.390 m apart");
    assert!(findings[0].expected.starts_with("at least 0.400 m between centres"), "{findings:#?}");
    let hint = findings[0].hint.as_deref().unwrap();
    assert_eq!(hint, "use `scale: 1.05`");
    // Without bodies and distances, two robots still cannot be at the same place.
    let ring = "ring: {circle: {radius: 0.01}, at: [0, 0, 1]}";
    let text = format!(
        "scenario: s\nformations: {{{ring}}}\ncues: [{{at: 0s, robots: all, form: ring, over: 60s}}]\n"
    );
    let findings = compiled(3, &text).findings;
    assert!(findings[0].message.contains("of `ring` are 0.017 m apart"), "{findings:#?}");
}

#[test]
fn robot_with_fixed_height_is_named_if_others_change_height() {
    let mut fleet = fleet(3);
    if let Some(body) = &mut fleet.robots[1].body {
        body.coordinates[2] = Coordinate::Fixed(0.0);
    }
    let codes = |cue: &str| {
        let text = format!(
            "scenario: s\nformations: {{three: {{points: [[0, 0, 1], [2, 0, 1], [4, 0, 1]]}}, floor: {{points: [[0, 0, 0], [2, 0, 0], [4, 0, 0]]}}}}\n\
             cues: [{{at: 0s, robots: d0, tracks: {{z: [{{at: 0s, to: 0}}, {{at: 1s, to: 1}}]}}}}, {{at: 1s, robots: all, {cue}}}]\n"
        );
        let found = compile(&Source { name: "s.yaml".into(), text }, &fleet, &NoFiles).findings;
        found.iter().map(|found| (found.code, found.message.clone())).collect::<Vec<_>>()
    };
    for cue in ["form: three, over: 9s", "grow: 2, over: 9s", "shift: [0, 0, 1], over: 9s"] {
        let found = codes(cue);
        assert!(found.len() == 1 && found[0].0 == Code::NotInGroup, "{cue}: {found:?}");
        assert!(found[0].1.contains("`d1` cannot change its height"), "{cue}: {found:?}");
    }
    for cue in
        ["form: floor, over: 9s", "form: home, over: 9s", "turn: 20, over: 9s", "shift: [0, 1, 0], over: 9s"]
    {
        assert!(codes(cue).is_empty(), "{cue}: {:?}", codes(cue));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, ..ProptestConfig::default() })]
    #[test]
    fn suggested_shortest_time_is_enough(
        turn in -9_000..9_000i32,
        grow in 5..30i32,
        shift in prop::array::uniform3(-20..20i32),
        form: bool,
        of_devices: bool,
    ) {
        let fleet = if of_devices { limited(3) } else { fleet(3) };
        let [x, y, z] = shift.map(|tenths| f64::from(tenths) / 10.0);
        let cue = if form { "form: f".to_owned() } else { format!("turn: {turn}, grow: {}, shift: [{x}, {y}, {z}]", f64::from(grow) / 10.0) };
        let formation = format!("f: {{points: [[{x}, {y}, 1], [{}, 3, 2], [4, {}, 1]]}}", x + 1.0, y + 4.0);
        if let Some(over) = enough(&fleet, &formation, &format!("{cue}, over: 10ms")) {
            let again = enough(&fleet, &formation, &format!("{cue}, over: {over}"));
            prop_assert!(again.is_none(), "{cue}: {over} is not enough, {again:?} is");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, ..ProptestConfig::default() })]
    #[test]
    fn random_groups_reach_their_places_and_keep_stated_distance(
        points in prop::collection::vec(prop::array::uniform3(1..40i32), 2..8),
        canon in 0..900u32,
        turn in -400..400i32,
        longest: bool,
    ) {
        let count = points.len();
        let place = |point: &[i32; 3]| point.map(|metres| f64::from(metres) / 10.0);
        let goals: Vec<[f64; 3]> = points.iter().map(place).collect();
        let least = if longest { "longest" } else { "total" };
        let text = format!(
            "scenario: random
formations: {{f: {{points: {goals:?}}}}}
cues:
  - {{cue: form, at: 0s, robots: all, form: {{to: f, least: {least}}}, over: 9s, canon: {canon}ms}}
  - {{cue: turn, after: form, robots: all, turn: {turn}, grow: 1.5, shift: [1, 0, 0.5], over: 15s}}
"
        );
        let compiled = compiled(count, &text);
        // Places may be too close to each other.
        let Some(choreography) = compiled.choreography else {
            let told = compiled.findings.iter().any(|found| matches!(found.code, Code::TooClose | Code::NoWayPast | Code::BodyTooFast));
            prop_assert!(told, "{:#?}", compiled.findings);
            return Ok(());
        };
        let act = &choreography.acts[0];
        let steps = steps(act, count);
        let stated = act.in_space.closest.as_ref().unwrap().distance;
        let sampled = closest(act, &steps);
        prop_assert!(stated >= DISTANCE - 1e-6 && sampled >= stated - 1e-6, "{sampled} {stated}");
        let formed = places(&steps, act.cues[0].end.as_millis_f64());
        let mut free = goals.clone();
        for place in &formed {
            let nearest = (0..free.len()).min_by(|a, b| apart(place, &free[*a]).total_cmp(&apart(place, &free[*b]))).unwrap();
            prop_assert!(apart(place, &free.swap_remove(nearest)) < 1e-3, "{formed:?} {goals:?}");
        }
        let middle: [f64; 3] = std::array::from_fn(|axis| formed.iter().map(|place| place[axis]).sum::<f64>() / count as f64);
        let (sine, cosine) = f64::from(turn).to_radians().sin_cos();
        for (before, after) in formed.iter().zip(places(&steps, act.cues[1].end.as_millis_f64())) {
            let [x, y, z] = std::array::from_fn(|axis| 1.5 * (before[axis] - middle[axis]));
            let turned = [
                middle[0] + x * cosine - y * sine + 1.0, middle[1] + x * sine + y * cosine, middle[2] + z + 0.5,
            ];
            prop_assert!(apart(&turned, &after) < 2e-3, "{turned:?} {after:?}");
        }
    }
}

#[test]
fn delayed_robot_starts_where_another_group_has_moved_it() {
    // d1 moves to the left and back to the right before its own start in the canon.
    let text = "scenario: s
cues:
  - {robots: [d0, d1], canon: 10s, shift: [0, 0, 2], over: 4s}
  - {cue: aside, at: 1s, robots: d1, shift: [3, 1, 0], over: 4s}
";
    let act = sound(2, text);
    let steps = steps(&act, 2);
    assert!(apart(&places(&steps, 10_000.0)[1], &[3.7, 1.0, 0.0]) < 0.005);
    let mut before = places(&steps, 0.0)[1];
    for index in 1..=2_800 {
        let now = places(&steps, f64::from(index) * 5.0)[1];
        assert!(apart(&before, &now) < 0.02, "{index} {before:?} {now:?}");
        before = now;
    }
}

#[test]
fn groups_waiting_for_each_other_are_reported() {
    let text = "scenario: s
cues:
  - {cue: a, robots: [d0, d1], canon: 10s, shift: [0, 0, 2], over: 4s}
  - {cue: b, at: 1s, robots: [d1, d0], canon: 10s, shift: [3, 1, 0], over: 4s}
";
    let found = compiled(2, text).findings;
    assert_eq!(
        found.iter().map(|found| (found.code, found.line)).collect::<Vec<_>>(),
        [(Code::NotInGroup, 3)]
    );
}

#[test]
fn form_home_accepts_no_options() {
    for choice in ["spare: home", "spare: stay", "thin: evenly", "least: longest"] {
        let text = format!(
            "scenario: s\ncues:\n  - {{cue: up, robots: all, shift: [0, 0, 1], over: 4s}}\n  - {{after: up, robots: all, form: {{to: home, {choice}}}, over: 4s}}\n"
        );
        let found = compiled(2, &text).findings;
        let found: Vec<_> = found.iter().map(|found| (found.code, found.line)).collect();
        assert_eq!(found, [(Code::UnknownKey, 4)], "{choice}");
    }
}

#[test]
fn robots_with_invalid_movement_cause_no_further_findings() {
    let codes =
        |text: &str| -> Vec<Code> { compiled(2, text).findings.iter().map(|found| found.code).collect() };
    let next = "  - {cue: next, at: 1s, robots: d1, tracks: {x: [{at: 0s, to: 0.7}, {at: 4s, to: -1}]}}\n";
    let through = format!("scenario: s\ncues:\n{next}");
    assert_eq!(codes(&through), [Code::TooClose]);
    for up in [
        "robots: d0, shift: [0, 0, 5], over: 100ms",
        "robots: d0, tracks: {zz: [{at: 0s, to: 5}]}",
        "robots: d0, form: sky, over: 1s",
    ] {
        let found = codes(&format!("scenario: s\ncues:\n  - {{cue: up, at: 0s, {up}}}\n{next}"));
        assert!(found.len() == 1 && found != [Code::TooClose], "{up}: {found:?}");
    }
}

#[test]
fn formation_places_too_close_for_fleet_are_reported_even_if_unused() {
    // The bodies have a radius of 0.1 m and must keep 0.2 m apart.
    for (gap, expected) in [(0.39, vec![Code::NearPlaces]), (0.4, vec![])] {
        let text = format!(
            "scenario: s\nformations: {{two: {{points: [[0, 0, 1], [{gap}, 0, 1]]}}}}\ncues: [{{robots: d0, shift: [0, 0, 1], over: 4s}}]\n"
        );
        let found: Vec<Code> = compiled(2, &text).findings.iter().map(|found| found.code).collect();
        assert_eq!(found, expected, "{gap}");
    }
}

#[test]
fn unmoved_devices_stay_where_previous_acts_left_them() {
    let acts = |last: &str| {
        format!(
            "scenario: s
acts:
  - {{act: a, cues: [{{robots: d0, tracks: {{x: [{{at: 0s, to: 0}}, {{at: 4s, to: 3}}]}}}}]}}
  - {{act: b, cues: [{{robots: d0, tracks: {{y: [{{at: 0s, to: 0}}, {{at: 4s, to: 1}}]}}}}]}}
  - {{act: c, cues: [{{robots: d0, {last}}}]}}
"
        )
    };
    let compiled = compiled(1, &acts("shift: [1, 0, 0], over: 4s"));
    assert_eq!(compiled.findings, Vec::new());
    let act = &compiled.choreography.unwrap().acts[2];
    let script = act.plan.robots.iter().flat_map(|plan| &plan.scripts).next_back().unwrap();
    let last = script.script.steps().last().unwrap();
    assert_eq!((script.device.as_str(), last.setpoint.value), ("x", 4.0));
    // Nothing moves the robot back.
    let jumps = super::groups::compiled(1, &acts("tracks: {x: [{at: 0s, to: 0}, {at: 1s, to: 1}]}")).findings;
    assert_eq!(jumps.iter().map(|found| found.code).collect::<Vec<_>>(), [Code::Jump]);
}

#[test]
fn bodies_left_by_earlier_acts_are_obstacles() {
    let text = "scenario: s
acts:
  - {act: a, cues: [{robots: d0, shift: [0, 3, 0], over: 10s}]}
  - {act: b, cues: [{robots: d1, shift: [0, 1, 0], over: 10s}]}
  - {act: c, cues: [{robots: d1, shift: [5, 0, 0], over: 20s}]}
  - {act: d, cues: [{robots: d1, shift: [0, 2, 0], over: 10s}]}
  - {act: e, cues: [{robots: d1, shift: [-9, 0, 0], over: 20s}]}
";
    let found = compiled(2, text).findings;
    let errors: Vec<_> =
        found.iter().filter(|found| found.code == Code::TooClose).map(|found| found.line).collect();
    assert_eq!(errors, [7], "{found:#?}");
}

#[test]
fn group_must_start_after_overlapping_movements_of_its_robots() {
    let found = |second: &str| {
        let text = format!(
            "scenario: s\ncues:
  - {{cue: up, at: 0s, robots: all, shift: [0, 0, 2], over: 8s}}
  - {{cue: next, at: 4s, robots: all, {second}, over: 8s}}\n"
        );
        compiled(3, &text).findings
    };
    for second in ["form: home", "shift: [0, 0, -1]"] {
        let findings = found(second);
        let [overlap] = findings.as_slice() else { panic!("{second}: {findings:#?}") };
        assert_eq!(overlap.code, Code::Overlap, "{second}");
        assert!(overlap.message.contains("`d0`, `d1`, `d2`"), "{second}: {}", overlap.message);
        let hint = overlap.hint.as_deref().unwrap_or_default();
        assert!(hint.contains("4s later"), "{second}: {hint}");
    }
    // Coordinates that the group does not move may still be moving.
    assert_eq!(found("shift: [1, 0, 0]"), []);
}

#[test]
fn overlap_within_one_cue_gets_hint_to_remove_a_movement() {
    let text = "scenario: s\nformations: {f: {points: [[0, 0, 2]]}}
cues:\n  - {cue: a, at: 0s, robots: d0, form: f, over: 8s, tracks: {z: [{at: 1s, to: 0}, {at: 5s, to: 3}]}}\n";
    let findings = compiled(1, text).findings;
    let overlaps: Vec<_> = findings.iter().filter(|finding| finding.code == Code::Overlap).collect();
    let [overlap] = overlaps.as_slice() else { panic!("{findings:#?}") };
    let hint = overlap.hint.as_deref().unwrap_or_default();
    assert!(hint.starts_with("remove one of the two movements"), "{hint}");
}
