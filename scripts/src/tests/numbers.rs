//! The numbers that a plan states, against what was written.

use proptest::prelude::*;

use super::robot;
use crate::{Act, Compiled, Files, Finding, Fleet, FleetRobot, Source, compile};

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

/// Nanoseconds from the act's start, and values.
fn steps(act: &Act, device: &str) -> Vec<(i64, Vec<f64>)> {
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

#[test]
fn as_many_bars_as_fit_are_all_played() {
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

/// A number with up to two decimals, as text and in hundredths.
fn decimal(range: std::ops::Range<i128>) -> impl Strategy<Value = (String, i128)> {
    range.prop_map(|hundredths| (format!("{}.{:02}", hundredths / 100, hundredths % 100), hundredths))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// Checked with whole numbers: times are fractions of nanoseconds, compared by multiplying out.
    #[test]
    fn repeated_music_ends_where_its_bars_end(
        (first, first_hundredths) in decimal(4_000..25_000),
        (second, second_hundredths) in decimal(4_000..25_000),
        (beats, beats_again, change, start, turns) in (1i128..9, 1i128..9, 2i128..12, 0i128..6, 1i128..40),
        form in 0..4,
        late in any::<bool>(),
    ) {
        // Where a cue begins before the change of tempo, its first bar is one of the first tempo.
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
fn cues_that_follow_each_other_in_beats_are_never_later_than_the_bar() {
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
