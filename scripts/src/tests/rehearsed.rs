//! Patterns that depend on the places of robots after movements of groups. Positions are sampled from the steps of the plan.

use super::groups::{compiled, places, sound, steps};

const COUNT: usize = 8;
const WAYS: &str = "scenario: s
off_grid: snap
formations:
  ring: {circle: {radius: 1.5}, at: [2, 0, 1.5]}
  small: {points: [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1]], at: [2, 0, 1.5]}
paths:
  bow: {points: [[0, 0, 0], [2, 1, 0.5], [4, 0, 0]]}
cues:
";
/// Movements of a group of eight robots that initially form a row.
const FIRST: [&str; 9] = [
    "form: ring, over: 8s",
    "form: {to: small, spare: stay}, over: 8s",
    "form: {to: ring, least: longest}, over: 8s, canon: 500ms",
    "turn: 50, over: 8s",
    "grow: 1.7, over: 8s",
    "shift: [1, 2, 3], over: 8s",
    "along: bow, over: 8s",
    "along: {path: bow, turning: true}, over: 8s",
    "turn: {by: 30, about: [3, 3]}, grow: 1.3, shift: [0, 0, 1], over: 8s",
];

/// Returns the time at which each robot begins to rise, in milliseconds, and the robot's place at that time.
fn begins(text: &str) -> Vec<(f64, [f64; 3])> {
    let act = sound(COUNT, text);
    let begin = act.cues.last().unwrap().start.as_millis_f64();
    let steps = steps(&act, COUNT);
    let places = places(&steps, begin);
    // After half of its time, each robot has risen by half of the height.
    let late = |index: usize| {
        let height = |at: f64| self::places(&steps, begin + at)[index][2];
        (0..40_000).map(f64::from).find(|at| height(*at) > places[index][2] + 0.5).unwrap() - 2_000.0
    };
    (0..COUNT).map(|index| (late(index), places[index])).collect()
}

/// Checks that robots begin in the order of x, like a wave at 0.5 m/s.
fn assert_in_order_of_x(text: &str) {
    let begins = begins(text);
    let least = begins.iter().map(|(_, [x, ..])| *x).fold(f64::INFINITY, f64::min);
    assert!(begins.iter().any(|(_, [x, ..])| x - least > 0.5), "{begins:?}");
    for (late, [x, ..]) in &begins {
        // Steps end within their permitted error of the movement's end.
        assert!((late - (x - least) / 0.5 * 1_000.0).abs() < 15.0, "{late} at {x}: {text}");
    }
}

#[test]
fn canon_by_position_uses_positions_after_group_movement() {
    for first in FIRST {
        assert_in_order_of_x(&format!(
            "{WAYS}  - {{cue: first, robots: all, {first}}}\n  - {{after: first + 1s, robots: all, canon: {{speed: 0.5, by: x}}, shift: [0, 0, 1], over: 4s}}\n"
        ));
    }
}

#[test]
fn canon_by_position_uses_positions_after_several_group_movements() {
    let cues: String = FIRST
        .iter()
        .enumerate()
        .map(|(index, first)| {
            format!("  - {{cue: c{index}, after: c{}, robots: all, {first}}}\n", index.saturating_sub(1))
        })
        .collect();
    let cues = cues.replacen(", after: c0", "", 1);
    assert_in_order_of_x(&format!(
        "{WAYS}{cues}  - {{after: c8 + 1s, robots: all, canon: {{speed: 0.5, by: x}}, shift: [0, 0, 1], over: 4s}}\n"
    ));
}

#[test]
fn values_are_spread_by_positions_after_group_movement() {
    let text = format!(
        "{WAYS}  - {{cue: first, robots: all, form: ring, over: 8s}}\n  - {{after: first, robots: all, tracks: {{z: [{{at: 4s, to: {{from: 2, to: 3, across: group, by: y}}}}]}}}}\n"
    );
    let act = compiled(COUNT, &text).choreography.unwrap().acts.remove(0);
    let steps = steps(&act, COUNT);
    for ([_, y, _], [_, _, z]) in places(&steps, 8_000.0).iter().zip(places(&steps, 12_000.0)) {
        assert!((z - (2.5 + y / 3.0)).abs() < 0.005, "{y} {z}");
    }
}

#[test]
fn impossible_group_movement_leaves_positions_unknown() {
    let text = format!(
        "{WAYS}  - {{cue: first, robots: all, form: ring, over: 100ms}}\n  - {{after: first + 1s, robots: all, canon: {{speed: 0.5, by: x}}, shift: [0, 0, 1], over: 4s}}\n"
    );
    let told: Vec<String> =
        compiled(COUNT, &text).findings.iter().map(|found| found.message.clone()).collect();
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("for its path"), "{told:?}");
}

#[test]
fn tracks_beside_group_movement_determine_robot_positions() {
    let rise =
        "{z: [{at: 0s, to: {from: 0, to: 4, across: group}}, {at: 8s, to: {from: 4, to: 0, across: group}}]}";
    let text = format!(
        "{WAYS}  - {{cue: first, robots: all, turn: 90, over: 8s, tracks: {rise}}}\n  - {{after: first, robots: all, canon: {{speed: 1, by: z}}, tracks: {{x: [{{at: 1s, to: 0}}]}}}}\n"
    );
    let compiled = compiled(COUNT, &text);
    let act = compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings)).acts.remove(0);
    // The first robot is then 4 m high and the last one is on the ground, so the last one begins first.
    let begins: Vec<f64> = ["d0", "d7"]
        .iter()
        .map(|id| {
            let plan = act.plan.robots.iter().find(|plan| plan.robot.as_str() == *id).unwrap();
            let of_x = plan.scripts.iter().filter(|script| script.device.as_str() == "x");
            of_x.map(|script| script.start.get() + script.script.steps().last().unwrap().offset.get())
                .fold(0.0, f64::max)
        })
        .collect();
    assert!((begins[0] - begins[1] - 4_000.0).abs() < 1e-6, "{begins:?}");
}
