//! Examples in which devices that hold their values need the fewest steps.

use super::numbers::{steps, used};
use super::robot;
use crate::{Act, Compiled, Fleet, FleetRobot, NoFiles, Source, compile};

/// Compiles a track for a servo that holds its values, from -20 to 155 with this granularity.
fn servo(granularity: f64, max_steps: u32, track: &str) -> Compiled {
    let limits =
        format!(r#""min_value": -20, "max_value": 155, "granularity": {granularity}, "max_error": 12"#);
    let block = format!(
        r#"{{"id": "servo", "api_version": "1", "devices": [{{"id": "neck", "name": "neck", "interpolation": "hold",
        "available_control_types": {{"position": {{{limits}}},
        "script": {{{limits}, "max_number_of_steps": {max_steps}}}}}}}]}}"#
    );
    let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
    let robot = FleetRobot { id: init.id.clone(), init: Some(init), ..robot() };
    let fleet = Fleet { robots: vec![robot], ..Fleet::default() };
    let text = format!(
        "scenario: s\noff_grid: snap\ncues: [{{at: 0s, robots: servo, tracks: {{neck: {track}}}}}]\n"
    );
    compile(&Source { name: "s.yaml".into(), text }, &fleet, &NoFiles)
}

#[track_caller]
fn act(granularity: f64, track: &str) -> Act {
    let compiled = servo(granularity, 1_000, track);
    let choreography = compiled.choreography.unwrap_or_else(|| panic!("{track}\n{:#?}", compiled.findings));
    choreography.acts.into_iter().next().unwrap()
}

/// Writes a track that rises to a value over three seconds. `wish` is an additional key of the track.
fn rise(wish: &str, to: f64) -> String {
    format!("{{{wish}, keyframes: [{{at: 0s, to: 0}}, {{at: 3s, to: {to}, ease: smooth}}]}}")
}

#[track_caller]
fn values(act: &Act) -> Vec<f64> {
    steps(act, "neck").into_iter().map(|(_, values)| values[0]).collect()
}

#[test]
fn value_is_held_until_curve_leaves_its_tolerance() {
    // The value 0 serves up to 1.01, 2 from 0.99 to 3.01, and so on. After 154, only the end remains.
    let fine = act(1.0, &rise("tolerance: 1.01", 155.0));
    let expected: Vec<f64> = (0..78).map(|step| f64::from(2 * step)).chain([155.0]).collect();
    assert_eq!(values(&fine), expected);
    let coarse = act(20.0, &rise("tolerance: 21", 100.0));
    assert_eq!(values(&coarse), [0.0, 40.0, 80.0, 100.0]);
    for act in [&fine, &coarse] {
        let used = used(act, "neck");
        assert_eq!(used.at_least, used.steps);
    }
}

#[test]
fn least_error_of_curve_is_reached_with_equal_runs() {
    // The first and the last value each hold for half a run; the four values between them each hold for a whole run.
    let act = act(0.001, &rise("max_steps: 6", 5.0));
    let used = used(&act, "neck");
    assert_eq!(used.steps, 6);
    assert!((used.worst_error - 0.5).abs() < 2e-3, "{}", used.worst_error);
}

#[test]
fn lower_bound_does_not_exceed_sufficient_steps() {
    for tolerance in 3..40 {
        let tolerance = f64::from(tolerance) / 10.0;
        let act = act(0.001, &rise(&format!("tolerance: {tolerance}"), 20.0));
        // Both ends take half a run each, and the values between them whole runs.
        let suffice = (20.0 / (2.0 * tolerance) - 1e-9).ceil() as usize + 1;
        let used = used(&act, "neck");
        assert_eq!((used.steps, used.at_least), (suffice, suffice), "{tolerance}");
    }
}

#[test]
fn redundant_last_step_is_not_sent_but_movement_ends_as_written() {
    let compiled = servo(22.5, 6, "[{at: 0s, to: 2.5}, {at: 3s, to: 115, ease: smooth}]");
    let choreography = compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings));
    let act = &choreography.acts[0];
    assert_eq!(values(act), [0.0, 45.0, 90.0, 112.5]);
    assert!(steps(act, "neck")[3].0 < 3_000_000_000);
    let three = urrcp::Span::from_millis(3_000);
    assert_eq!((act.cues[0].end, act.duration(), act.plan.duration()), (three, three, three));
}

#[test]
fn redundant_written_last_step_is_not_sent() {
    let act = act(1.0, "[{at: 0s, to: 3}, {at: 1s, to: 9}, {at: 2s, to: 9}, {at: 3s, to: 9}]");
    assert_eq!(values(&act), [3.0, 9.0]);
    let used = used(&act, "neck");
    assert_eq!((used.steps, used.at_least), (2, 2));
    assert_eq!(act.duration(), urrcp::Span::from_millis(3_000));
}

#[test]
fn steps_and_curves_of_one_movement_share_values() {
    // A level, a curve that begins at it, and a level at the end of the curve: 10 serves the first, 30 the last two.
    let keyframes = "[{at: 0s, to: 9}, {at: 1s, to: 11}, {at: 2s, to: 29, ease: linear}, {at: 3s, to: 31}]";
    let act = act(1.0, &format!("{{tolerance: 10, keyframes: {keyframes}}}"));
    let used = used(&act, "neck");
    assert_eq!((values(&act).len(), used.at_least), (2, 2), "{:?}", steps(&act, "neck"));
}
