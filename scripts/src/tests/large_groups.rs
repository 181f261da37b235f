//! Tests of groups with as many robots as a formation may have places.

use super::groups::drone;
use crate::space::Space;
use crate::{Code, Compiled, Fleet, NoFiles, Source, compile};

const MOST: usize = 10_000;

/// Returns drones on the ground, one metre apart, in rows of 101.
fn fleet(count: usize) -> Fleet {
    let place = |index: usize| [(index % 101) as f64 - 50.0, (index / 101) as f64 - 49.5, 0.0];
    let robots: Vec<_> = (0..count).map(|index| drone(index, place(index))).collect();
    let all = robots.iter().map(|robot| robot.id.clone()).collect();
    let space = Space { distance: Some(0.2), ..Space::default() };
    Fleet { groups: [("all".to_owned(), all)].into(), robots, space, ..Fleet::default() }
}

fn compiled(count: usize, movement: &str) -> Compiled {
    let text = format!(
        "scenario: s\nformations: {{wall: {{grid: {{spacing: 0.9}}, at: [0, 0, 20]}}}}\npaths: {{bend: {{points: [[0, 0, 0], [0, 0, 5], [0, 0, 10]]}}}}\ncues: [{{cue: all, at: 0s, robots: all, {movement}, over: 120s, tolerance: 0.02}}]\n"
    );
    compile(&Source { name: "s.yaml".into(), text }, &fleet(count), &NoFiles)
}

/// Checks a movement of the largest possible group of drones.
#[track_caller]
fn check(movement: &str) {
    let compiled = compiled(MOST, movement);
    assert!(compiled.choreography.is_some(), "{movement}: {:#?}", compiled.findings.first());
}

#[test]
fn group_of_ten_thousand_drones_moves_into_formation() {
    check("form: wall");
}

#[test]
fn group_of_ten_thousand_drones_turns() {
    check("turn: 1, grow: 0.95");
}

#[test]
fn group_of_ten_thousand_drones_grows() {
    check("grow: 0.8");
}

#[test]
fn group_of_ten_thousand_drones_shifts() {
    check("shift: [0, 0, 5]");
}

#[test]
fn group_of_ten_thousand_drones_follows_path() {
    check("along: bend");
}

#[test]
fn groups_of_more_than_ten_thousand_robots_are_refused() {
    for movement in ["form: wall", "turn: 10", "grow: 0.8", "shift: [0, 0, 5]", "along: bend"] {
        let compiled = compiled(MOST + 1, movement);
        let [only] = compiled.findings.as_slice() else { panic!("{movement}: {:#?}", compiled.findings) };
        assert_eq!(only.code, Code::TooMuch);
        assert_eq!(only.message, "a group of 10001 robots", "{movement}");
        assert_eq!(only.expected, "at most 10000 robots", "{movement}");
    }
}
