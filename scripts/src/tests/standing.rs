//! Bodies that are too close to each other although neither of them moves.

use super::groups::drone;
use crate::space::Space;
use crate::{Code, Compiled, Fleet, NoFiles, Source, compile};

/// Returns three balls with a radius of 0.1 m. The middles of two are 0.25 m apart, the third one is far away. Surfaces must be at least
/// 0.1 m apart.
fn near() -> Fleet {
    let robots = vec![drone(0, [0.0; 3]), drone(1, [0.25, 0.0, 0.0]), drone(2, [9.0, 0.0, 0.0])];
    let space = Space { distance: Some(0.1), ..Space::default() };
    Fleet { robots, space, ..Fleet::default() }
}

fn compiled(cues: &str) -> Compiled {
    let text = format!("scenario: standing\ncues:\n{cues}");
    compile(&Source { name: "s.yaml".into(), text }, &near(), &NoFiles)
}

#[track_caller]
fn too_close(cues: &str, says: &str) {
    let found = compiled(cues).findings;
    let too_close: Vec<_> = found.iter().filter(|finding| finding.code == Code::TooClose).collect();
    assert_eq!(too_close.len(), 1, "{found:#?}");
    assert!(too_close[0].message.contains(says), "{}", too_close[0].message);
}

#[test]
fn bodies_too_close_are_reported_even_if_neither_moves() {
    too_close("  - {cue: mark, at: 0s}\n", "`d0` and `d1` come within 0.050 m of each other at 0 ms");
    let far = "  - {at: 0s, robots: d2, tracks: {x: [{at: 0s, to: 9}]}}\n";
    too_close(far, "`d0` and `d1` come within 0.050 m of each other at 0 ms");
}

#[test]
fn bodies_set_too_close_in_one_step_are_reported() {
    let set = "  - {at: 0s, robots: d2, tracks: {x: [{at: 0s, to: 0.5}]}}\n";
    let found = compiled(set).findings;
    let near = found.iter().filter(|finding| finding.code == Code::TooClose);
    let near: Vec<&str> = near.map(|finding| finding.message.as_str()).collect();
    assert!(near.iter().any(|message| message.contains("`d1` and `d2` come within 0.050 m")), "{found:#?}");
}

#[test]
fn closest_approach_is_known_without_movement() {
    let choreography = compiled("  - {cue: mark, at: 0s}\n").choreography;
    assert!(choreography.is_none(), "an act with bodies too near is not played");
    let text =
        "scenario: standing\nrequire: {closest: above 0.01m}\ncues:\n  - {cue: mark, at: 0s}\n".to_owned();
    let fleet = Fleet { space: Space::default(), ..near() };
    let compiled = compile(&Source { name: "s.yaml".into(), text }, &fleet, &NoFiles);
    let choreography = compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings));
    let closest = choreography.acts[0].in_space.closest.as_ref().unwrap();
    assert!((closest.distance - 0.05).abs() < 1e-9, "{closest:?}");
}
