//! Compares the numbers in a plan with the scenario.

use proptest::prelude::*;

use super::robot;
use crate::{Act, Code, Compiled, DeviceUse, Files, Finding, Fleet, FleetRobot, Source, compile};

const DEVICES: &str = r#"{"id": "bot", "api_version": "1", "devices": [
  {"id": "pole", "name": "pole", "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -100, "max_value": 100, "granularity": 0.001, "max_error": 0.01},
     "script": {"min_value": -100, "max_value": 100, "granularity": 0.001, "max_number_of_steps": 100000}}},
  {"id": "arm", "name": "arm", "default_value": 0, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -100, "max_value": 100, "granularity": 0.5, "max_error": 0.5},
     "speed": {"min_value": -60, "max_value": 60, "granularity": 1},
     "script": {"min_value": -100, "max_value": 100, "granularity": 0.5, "max_number_of_steps": 100000, "control_types": ["position"]}}},
  {"id": "lamp", "name": "lamp", "available_control_types": {
     "position": {"min_value": 0, "max_value": 255, "granularity": 1},
     "script": {"min_value": 0, "max_value": 255, "granularity": 1, "max_number_of_steps": 100000}}},
  {"id": "valve", "name": "valve", "available_control_types": {
     "position": {"min_value": -1000, "max_value": 1000, "granularity": 0.5},
     "script": {"min_value": -1000, "max_value": 1000, "granularity": 0.5, "max_number_of_steps": 100000}}},
  {"id": "dial", "name": "dial", "available_control_types": {
     "position": {"min_value": -50.2, "max_value": 47.3, "granularity": 4, "max_error": 4},
     "script": {"min_value": -50.2, "max_value": 47.3, "granularity": 4, "max_error": 4, "max_number_of_steps": 100000}}},
  {"id": "crane", "name": "crane", "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -1000, "max_value": 1000, "granularity": 0.5, "max_error": 0.5},
     "script": {"min_value": -1000, "max_value": 1000, "granularity": 0.5, "max_number_of_steps": 100000}}},
  {"id": "fine", "name": "fine", "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -6, "max_value": 6, "granularity": 0.0001},
     "script": {"min_value": -6, "max_value": 6, "granularity": 0.0001, "max_number_of_steps": 100000}}},
  {"id": "rgb", "name": "rgb", "available_control_types": {
     "custom_1": {"values": 3},
     "script": {"min_value": 0, "max_value": 255, "granularity": 1, "max_number_of_steps": 100000}}}]}"#;

struct Csv(&'static str);

impl Files for Csv {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        Ok(Source { name: name.into(), text: self.0.into() })
    }
}

fn bot() -> FleetRobot {
    let init: urrcp::InitializationBlock = serde_json::from_str(DEVICES).unwrap();
    FleetRobot { id: init.id.clone(), init: Some(init), ..robot() }
}

pub(super) fn compiled_with(text: &str, csv: &'static str) -> Compiled {
    let fleet = Fleet { robots: vec![bot()], ..Fleet::default() };
    compile(&Source { name: "s.yaml".into(), text: format!("scenario: s\n{text}") }, &fleet, &Csv(csv))
}

pub(super) fn compiled(text: &str) -> Compiled {
    compiled_with(text, "")
}

#[track_caller]
fn act(text: &str) -> Act {
    act_with(text, "")
}

#[track_caller]
fn act_with(text: &str, csv: &'static str) -> Act {
    let compiled = compiled_with(text, csv);
    let choreography = compiled.choreography.unwrap_or_else(|| panic!("{text}\n{:#?}", compiled.findings));
    choreography.acts.into_iter().next().unwrap()
}

pub(super) fn used<'a>(act: &'a Act, device: &str) -> &'a DeviceUse {
    act.devices.iter().find(|used| used.device.as_str() == device).unwrap()
}

/// Returns the steps of a device: nanoseconds since the act's start, and values.
pub(super) fn steps(act: &Act, device: &str) -> Vec<(i64, Vec<f64>)> {
    let scripts = act.plan.robots.iter().flat_map(|robot| &robot.scripts);
    let own = scripts.filter(|script| script.device.as_str() == device);
    let steps = own.flat_map(|script| {
        script.script.steps().iter().map(|step| {
            let at = script.start.span() + step.offset.span();
            let more = step.setpoint.more.iter().copied();
            (at.as_nanos(), std::iter::once(step.setpoint.value).chain(more).collect())
        })
    });
    steps.collect()
}

fn track(track: &str) -> Act {
    act(&format!("cues: [{{at: 0s, robots: bot, tracks: {{{track}}}}}]\n"))
}

fn values(act: &Act, device: &str) -> Vec<(i64, f64)> {
    steps(act, device).into_iter().map(|(at, values)| (at / 1_000_000, values[0])).collect()
}

#[test]
fn all_bars_that_fit_are_played() {
    let mut wrong = Vec::new();
    for bpm in 60..=200 {
        for repeat in ["{for: 24 bars}", "{for: 96 beats}", "{until: bar 57}"] {
            let act = act(&format!(
                "tempo: {bpm}\ncues:\n  - {{at: bar 33, robots: bot, repeat: {repeat}, tracks: {{arm: [{{at: 0s, to: 0}}, {{at: 2 beats, to: 5}}, {{at: 1 bar, to: 0}}]}}}}\n  - {{at: bar 57, robots: bot, tracks: {{arm: [{{at: 0s, to: 0}}, {{at: 1 bar, to: 5}}]}}}}\n"
            ));
            let steps = steps(&act, "arm");
            if steps.len() < 49 || act.cues[0].end != act.cues[1].start {
                wrong.push((bpm, repeat, steps.len(), act.cues[1].start - act.cues[0].end));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn repeats_with_waits_end_where_next_beat_starts() {
    let mut wrong = Vec::new();
    for bpm in 60..=200 {
        let act = act(&format!(
            "tempo: {bpm}\ncues:\n  - {{at: bar 2, robots: bot, repeat: {{times: 3, every: 3 beats}}, tracks: {{arm: [{{at: 0s, to: 0}}, {{at: 1 beat, to: 0.5}}]}}}}\n  - {{at: bar 3 beat 4, robots: bot, tracks: {{arm: [{{at: 0s, to: 0.5}}, {{at: 1 beat, to: 0}}]}}}}\n"
        ));
        if act.cues[0].end != act.cues[1].start {
            wrong.push((bpm, act.cues[1].start - act.cues[0].end));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// Draws a number with up to two decimals, as text and in hundredths.
fn decimal(range: std::ops::Range<i128>) -> impl Strategy<Value = (String, i128)> {
    range.prop_map(|hundredths| (format!("{}.{:02}", hundredths / 100, hundredths % 100), hundredths))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// The check uses exact numbers: times are fractions of nanoseconds, compared by cross-multiplication of integers.
    #[test]
    fn repeated_movement_ends_at_end_of_its_bars(
        (first, first_hundredths) in decimal(4_000..25_000),
        (second, second_hundredths) in decimal(4_000..25_000),
        (beats, beats_again, change, start, turns) in (1i128..9, 1i128..9, 2i128..12, 0i128..6, 1i128..40),
        form in 0..4,
        late in any::<bool>(),
    ) {
        // If a cue begins before the change of tempo, its first bar has the first tempo.
        let begin = if late { change + start } else { 1 };
        let (hundredths, beats_a_bar) = if late { (second_hundredths, beats_again) } else { (first_hundredths, beats) };
        let bar = |number: i128| {
            let before = number.min(change) - 1;
            let (n1, d1) = (before * beats * 6_000_000_000_000, first_hundredths);
            let (n2, d2) = ((number - change).max(0) * beats_again * 6_000_000_000_000, second_hundredths);
            (n1 * d2 + n2 * d1, d1 * d2)
        };
        let rounded = |(n, d): (i128, i128)| (2 * n + d).div_euclid(2 * d);
        let (n, d) = bar(begin);
        let cycle = (beats_a_bar * 6_000_000_000_000, hundredths);
        let turn = |k: i128| rounded((n * cycle.1 + k * cycle.0 * d, d * cycle.1)) - rounded((n, d));
        let times = if late { turns } else { turns.min(change - 1) };
        let repeat = match form {
            0 => format!("{{for: {times} bars}}"),
            1 => format!("{{for: {} beats}}", times * beats_a_bar),
            2 => format!("{{until: bar {}}}", begin + times),
            _ => times.to_string(),
        };
        let act = act(&format!(
            "tempo: [{{at: bar 1, bpm: {first}, signature: {beats}/4}}, {{at: bar {change}, bpm: {second}, signature: {beats_again}/4}}]\ncues:\n  - {{at: bar {begin}, robots: bot, repeat: {repeat}, tracks: {{lamp: [{{at: 0s, to: 0}}, {{at: 0.5 beats, to: 5}}, {{at: 1 bar, to: 0}}]}}}}\n  - {{at: bar {}, robots: bot, tracks: {{lamp: [{{at: 0s, to: 0}}, {{at: 1 bar, to: 5}}]}}}}\n",
            begin + times
        ));
        let begins: Vec<i128> = steps(&act, "lamp").iter().filter(|(_, v)| v[0] == 0.0).map(|(at, _)| i128::from(*at)).collect();
        let expected: Vec<i128> = (0..=times).map(|k| rounded((n, d)) + turn(k)).collect();
        prop_assert_eq!(&begins[..expected.len()], &expected[..]);
        prop_assert_eq!(act.cues[0].end, act.cues[1].start);
    }
}

#[test]
fn cues_chained_in_beats_never_overrun_their_bar() {
    for bpm in (40..240).step_by(7) {
        let chain: String =
            (1..24).map(|i| format!("  - {{cue: c{i}, after: c{}, duration: 1 beat}}\n", i - 1)).collect();
        let last = "  - {after: c23, at: bar 7}\n";
        let music =
            format!("tempo: {bpm}\ncues:\n  - {{cue: c0, at: bar 1, duration: 1 beat}}\n{chain}{last}");
        let findings = compiled(&music).findings;
        assert!(findings.is_empty(), "{bpm}: {findings:?}");
    }
}

/// Writes pieces of a straight line or a curve, with jumps of `gap` between the pieces.
fn polynomial(gap: f64, curve: f64) -> String {
    let piece = |i: usize| {
        let begin = 0.471 * i as f64 + if i % 2 == 1 { gap } else { 0.0 };
        format!("{{for: 1s, coefficients: [{begin}, {}, {curve}]}}", 0.471 - curve)
    };
    let pieces: Vec<_> = (0..12).map(piece).collect();
    format!("pole: {{polynomial: [{}]}}", pieces.join(", "))
}

/// The limits are off the grid, either those of the device or only those of its scripts.
#[test]
fn value_between_last_grid_value_and_limit_is_set_to_grid_value() {
    for (position, script) in [(9.99, 9.99), (10.0, 9.99)] {
        let block = DEVICES
            .replace(
                r#""min_value": -100, "max_value": 100, "granularity": 0.5, "max_error": 0.5"#,
                &format!(r#""min_value": -{position}, "max_value": {position}, "granularity": 1"#),
            )
            .replace(
                r#""min_value": -100, "max_value": 100, "granularity": 0.5, "max_number"#,
                &format!(r#""min_value": -{script}, "max_value": {script}, "granularity": 1, "max_number"#),
            );
        assert_ne!(block, DEVICES);
        let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
        let robot = FleetRobot { id: init.id.clone(), init: Some(init.clone()), ..robot() };
        let fleet = Fleet { robots: vec![robot], ..Fleet::default() };
        for (track, begins, ends) in [
            ("polynomial: [{for: 1s, coefficients: [9.8, -3]}]", 9.0, 7.0),
            ("polynomial: [{for: 1s, coefficients: [0, -9.8]}]", 0.0, -9.0),
            ("formula: \"9.9 - 2 * t / 1s\", for: 1s", 9.0, 8.0),
            ("wave: {amplitude: 9.9, period: 4s, for: 1s}", 0.0, 9.0),
        ] {
            let text =
                format!("scenario: s\ncues: [{{at: 0s, robots: bot, tracks: {{arm: {{{track}}}}}}}]\n");
            let compiled = compile(&Source { name: "s.yaml".into(), text }, &fleet, &Csv(""));
            let choreography =
                compiled.choreography.unwrap_or_else(|| panic!("{track}: {:#?}", compiled.findings));
            let script = &choreography.acts[0].plan.robots[0].scripts[0].script;
            let device = init.device("arm").unwrap();
            for step in script.steps() {
                assert!(device.check(&step.setpoint).is_ok(), "{track}: {step:?}");
                assert!(device.check_in_script(&step.setpoint).is_ok(), "{track}: {step:?}");
            }
            let (first, last) = (script.steps().first().unwrap(), script.steps().last().unwrap());
            assert_eq!((first.setpoint.value, last.setpoint.value), (begins, ends), "{track}");
        }
    }
}

#[test]
fn gaps_below_tolerance_are_closed() {
    for (gap, curve) in [(0.0, 0.0), (1e-6, 0.0), (8e-5, 0.0), (-3e-5, 0.0), (1e-6, 0.3), (8e-5, 0.3)] {
        let act = track(&polynomial(gap, curve));
        let (closed, with) = (track(&polynomial(0.0, curve)), used(&act, "pole"));
        let without = used(&closed, "pole");
        assert_eq!((with.steps, with.at_least), (without.steps, without.at_least), "{gap} {curve}");
        assert!(with.worst_error <= 0.01 + 1e-9, "{}", with.worst_error);
        let steps = steps(&act, "pole");
        assert!(steps.windows(2).all(|pair| pair[0].0 < pair[1].0), "{steps:?}");
        assert!(
            steps.iter().all(|(_, v)| (v[0] * 1_000.0 - (v[0] * 1_000.0).round()).abs() < 1e-9),
            "{steps:?}"
        );
    }
}

#[test]
fn repeated_movement_closing_within_rounding_has_one_step_per_seam() {
    let act = act(
        "cues: [{at: 0s, robots: bot, repeat: 3, tracks: {pole: {tolerance: 0.5, wave: {amplitude: 20, period: 2s, for: 2s}}}}]\n",
    );
    let steps = steps(&act, "pole");
    assert!(steps.windows(2).all(|pair| pair[0].0 < pair[1].0), "{steps:?}");
}

#[test]
fn cue_with_slack_is_not_on_critical_path() {
    let act = act("tempo: 40
cues:
  - {cue: free, robots: bot, duration: 700ms..2700ms, tracks: {pole: [{at: 0ms, to: 0}, {at: 1ms, to: 0}]}}
  - {cue: rigid, robots: bot, duration: 1s, tracks: {lamp: [{at: 0ms, to: 0}, {at: 1s, to: 1}]}, with: [end of free]}
  - {cue: last, robots: bot, at: bar 3, with: [end of free], tracks: {arm: [{at: 0ms, to: 0}, {at: 3s, to: 0}]}}");
    let told = act.cues.iter().map(|cue| (cue.name.as_str(), cue.slack.as_millis_f64(), cue.critical));
    assert_eq!(
        told.collect::<Vec<_>>(),
        [("free", 2_000.0, false), ("rigid", 0.0, true), ("last", 0.0, true)]
    );
}

#[test]
fn hold_device_uses_fewest_steps_within_tolerance() {
    let keyframes =
        "[{at: 0s, to: 10}, {at: 1s, to: 10}, {at: 2s, to: 80}, {at: 3s, to: 82}, {at: 4s, to: 10}]";
    let with = |wish: &str| track(&format!("lamp: {{{wish}keyframes: {keyframes}}}"));
    assert_eq!(values(&with(""), "lamp").len(), 5);
    let exact = with("tolerance: 0.5, ");
    assert_eq!(values(&exact, "lamp"), [(0, 10.0), (2_000, 80.0), (3_000, 82.0), (4_000, 10.0)]);
    let near = with("tolerance: 1, ");
    assert_eq!(values(&near, "lamp"), [(0, 10.0), (2_000, 81.0), (4_000, 10.0)]);
    assert_eq!((used(&near, "lamp").at_least, used(&near, "lamp").worst_error), (3, 1.0));
    let few = with("max_steps: 3, tolerance: 5, ");
    assert_eq!((values(&few, "lamp").len(), used(&few, "lamp").worst_error), (3, 1.0));
}

#[test]
fn multi_value_track_uses_fewest_steps_within_tolerance() {
    let keyframes = "[{at: 0s, to: [1, 2, 3]}, {at: 1s, to: [1, 2, 3]}, {at: 2s, to: [9, 2, 3]}, {at: 3s, to: [9, 4, 3]}, {at: 4s, to: [0, 0, 0]}]";
    let with = |wish: &str| track(&format!("rgb: {{{wish}keyframes: {keyframes}}}"));
    assert_eq!(steps(&with(""), "rgb").len(), 5);
    let near = with("tolerance: 1, ");
    let shown: Vec<_> = steps(&near, "rgb").into_iter().map(|(at, v)| (at / 1_000_000_000, v)).collect();
    assert_eq!(shown, [(0, vec![1.0, 2.0, 3.0]), (2, vec![9.0, 3.0, 3.0]), (4, vec![0.0; 3])]);
    assert_eq!((used(&near, "rgb").at_least, used(&near, "rgb").worst_error), (3, 1.0));
    let few = with("tolerance: 1, max_steps: 3, ");
    assert_eq!(steps(&few, "rgb").len(), 3);
}

const SWITCHED: &str = "t,v\n0,0\n1,0\n2,255\n3,255\n4,255\n5,0\n6,0\n";

fn sampled(device: &str, keys: &str) -> Act {
    sampled_from(SWITCHED, device, keys)
}

fn sampled_from(table: &'static str, device: &str, keys: &str) -> Act {
    let text = format!(
        "cues: [{{at: 0s, robots: bot, tracks: {{{device}: {{samples: {{file: c.csv, time: t, value: v{keys}}}}}}}}}]\n"
    );
    act_with(&text, table)
}

#[test]
fn samples_of_hold_device_are_steps_unless_linear_is_requested() {
    let steps = [(0, 0.0), (2_000, 255.0), (5_000, 0.0)];
    let act = sampled("lamp", "");
    assert_eq!(values(&act, "lamp"), steps);
    assert_eq!((used(&act, "lamp").at_least, used(&act, "lamp").worst_error), (3, 0.0));
    assert_eq!(act.duration(), urrcp::Span::from_millis(6_000));
    assert_eq!(values(&sampled("lamp", ", ease: step"), "lamp"), steps);
    assert!(values(&sampled("lamp", ", ease: linear"), "lamp").len() > 100);
}

#[test]
fn samples_are_read_in_formats_saved_by_spreadsheets() {
    let expected = values(&sampled("lamp", ""), "lamp");
    let semicolons = SWITCHED.replace(',', ";").replace("2;255", "2,0;255,0");
    for table in [semicolons.clone(), format!("sep=;\n{semicolons}"), SWITCHED.replace(',', "\t")] {
        let table = table.leak();
        assert_eq!(values(&sampled_from(table, "lamp", ""), "lamp"), expected, "{table}");
    }
}

#[test]
fn worst_error_is_distance_from_written_values() {
    let keyframes = "[{at: 0s, to: 1.0005}, {at: 1s, to: 2}, {at: 2s, to: 3.0005}]";
    let with = |wish: &str| {
        act(&format!(
            "off_grid: snap\ncues: [{{at: 0s, robots: bot, tracks: {{pole: {{{wish}keyframes: {keyframes}}}}}}}]\n"
        ))
    };
    assert!((used(&with(""), "pole").worst_error - 0.0005).abs() < 1e-9);
    let text = "[{at: 0s, to: 0}, {at: 1s, to: 10.0012}, {at: 2s, to: 20.0004}, {at: 3s, to: 29.9985}, {at: 4s, to: 40.0005}]";
    let written = [0.0, 10.0012, 20.0004, 29.9985, 40.0005];
    let act = act(&format!(
        "off_grid: snap\ncues: [{{at: 0s, robots: bot, tracks: {{pole: {{tolerance: 0.001, keyframes: {text}}}}}}}]\n"
    ));
    let (steps, mut worst) = (values(&act, "pole"), 0.0f64);
    for (second, value) in written.iter().enumerate() {
        let at = 1_000 * second as i64;
        let after = steps.iter().position(|step| step.0 >= at).unwrap();
        let (b, a) = (steps[after], steps[after.saturating_sub(1)]);
        let played = if b.0 > a.0 { a.1 + (b.1 - a.1) * (at - a.0) as f64 / (b.0 - a.0) as f64 } else { b.1 };
        worst = worst.max((played - value).abs());
    }
    assert!(worst <= 0.001 + 1e-9, "{worst}");
    assert!(
        (used(&act, "pole").worst_error - worst).abs() < 1e-9,
        "{} {worst}",
        used(&act, "pole").worst_error
    );
}

#[test]
fn every_track_jump_is_reported_and_is_error_with_speed_limit() {
    let jumps = |device: &str| {
        let pieces =
            "[{for: 1s, coefficients: [0]}, {for: 1s, coefficients: [5]}, {for: 1s, coefficients: [9]}]";
        let text =
            format!("cues: [{{at: 0s, robots: bot, tracks: {{{device}: {{polynomial: {pieces}}}}}}}]\n");
        compiled(&text).findings.iter().map(|found| found.code).collect::<Vec<_>>()
    };
    assert_eq!(jumps("pole"), [Code::Jump, Code::Jump]);
    assert_eq!(jumps("arm"), [Code::TooFast, Code::TooFast]);
    let between = "cues:\n  - {at: 0s, robots: bot, tracks: {arm: [{at: 0s, to: 0}, {at: 1s, to: 5}]}}\n  - {at: 2s, robots: bot, tracks: {arm: [{at: 0s, to: 40}, {at: 1s, to: 45}]}}\n";
    assert_eq!(
        compiled(between).findings.iter().map(|found| found.code).collect::<Vec<_>>(),
        [Code::TooFast]
    );
    let hurried = between.replace("{at: 0s, to: 40}, {at: 1s", "{at: 1ms, to: 40}, {at: 1s");
    assert_eq!(
        compiled(&hurried).findings.iter().map(|found| found.code).collect::<Vec<_>>(),
        [Code::TooFast]
    );
}

#[test]
fn values_invalid_only_by_rounding_are_corrected_without_finding() {
    let written = |dust: f64| {
        let keyframe = |k: i32| format!("{{at: {}ms, to: {}}}", 100 * k, f64::from(k * k % 7) + dust);
        let keyframes: Vec<_> = (0..100).map(keyframe).collect();
        compiled(&format!("cues: [{{at: 0s, robots: bot, tracks: {{fine: [{}]}}}}]\n", keyframes.join(", ")))
    };
    let compiled = written(3e-10);
    assert!(compiled.findings.is_empty(), "{:#?}", compiled.findings);
    let act = compiled.choreography.unwrap().acts.remove(0);
    assert!(values(&act, "fine").iter().all(|(_, value)| value.fract() == 0.0));
    assert!(written(3e-5).findings.iter().any(|finding| finding.code == Code::OffGranularity));
}

#[test]
fn snapped_values_of_track_are_one_warning() {
    let keyframe = |k: i32| format!("{{at: {}ms, to: {}}}", 100 * k, f64::from(k) * 0.51);
    let keyframes: Vec<_> = (0..20).map(keyframe).collect();
    let track = format!(
        "off_grid: snap\ncues: [{{at: 0s, robots: bot, tracks: {{valve: [{}]}}}}]\n",
        keyframes.join(", ")
    );
    let found = compiled(&track).findings;
    let [warning] = found.as_slice() else { panic!("{found:#?}") };
    assert_eq!(warning.code, Code::Snapped);
    let expected = "keyframe 20: 9.69 is rounded to 9.5, an error of 0.19, the largest of 19 such errors, for position of `valve` on `bot`";
    assert_eq!(warning.message, expected);
}

#[test]
fn off_grid_values_of_track_are_one_error() {
    let keyframe = |k: i32| format!("{{at: {}ms, to: {}}}", 100 * k, f64::from(k) * 0.51);
    let keyframes: Vec<_> = (0..4).map(keyframe).collect();
    let track = format!("cues: [{{at: 0s, robots: bot, tracks: {{valve: [{}]}}}}]\n", keyframes.join(", "));
    let found = compiled(&track).findings;
    let [error] = found.as_slice() else { panic!("{found:#?}") };
    assert_eq!(error.code, Code::OffGranularity);
    let expected = "keyframe 4: 1.53 and 2 other values lie off the grid for position of `valve` on `bot`";
    assert_eq!(error.message, expected);
}
