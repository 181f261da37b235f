//! Rules that hold for the whole compiler: it never panics, and findings refer to places in the text, even through aliases.

use proptest::prelude::*;

use crate::keys::Keys;
use crate::scenario::CueKeys;
use crate::{Address, Code, Files, Finding, Fleet, FleetRobot, Source, compile};

const BLOCK: &str = r#"{"id": "arm", "api_version": "1", "devices": [
  {"id": "d", "name": "d", "interpolation": "linear", "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "script": {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 8}}}]}"#;

const SCENARIO: &str = "scenario: s
cues:
  - at: 0s
    robots: [arm]
    tracks:
      d: [{at: 0s, to: 0}, {at: 1s, to: 45, ease: smooth}]
";

/// Returns a simulated robot with the description [`BLOCK`].
pub(crate) fn robot() -> FleetRobot {
    let init: urrcp::InitializationBlock = serde_json::from_str(BLOCK).unwrap();
    FleetRobot::new(init.id.clone(), Address::Simulated, Some(init))
}

fn fleet() -> Fleet {
    Fleet { robots: vec![robot()], ..Fleet::default() }
}

fn compile_text(text: &str) -> crate::Compiled {
    compile(&Source { name: "s.yaml".into(), text: text.to_owned() }, &fleet(), &crate::NoFiles)
}

/// A file that scenarios can include.
struct Included(String);

impl Files for Included {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        match name {
            "a.yaml" => Ok(Source { name: name.into(), text: self.0.clone() }),
            _ => crate::NoFiles.read(name),
        }
    }
}

/// Checks that every finding names a line of the text, and that there is a plan if and only if there are no findings.
fn check_laws(text: &str) {
    check_laws_with(text, "");
}

fn check_laws_with(text: &str, included: &str) {
    let source = Source { name: "s.yaml".into(), text: text.to_owned() };
    let compiled = compile(&source, &fleet(), &Included(included.to_owned()));
    let error = |finding: &crate::Finding| finding.severity == crate::Severity::Error;
    assert_eq!(compiled.choreography.is_none(), compiled.findings.iter().any(error));
    for finding in &compiled.findings {
        let text = if finding.file == "a.yaml" { included } else { text };
        assert!(finding.line <= text.matches(['\n', '\r']).count() + 1, "{finding:?}");
    }
    let _shown = crate::render(&compiled.findings, true);
}

#[test]
fn yaml_error_is_reported_on_line_shown_by_editors() {
    let compiled = compile_text("a: \u{2028}x\u{85}y\n- b: [ö, c\n");
    let finding = &compiled.findings[0];
    assert!(finding.line <= 3 && compiled.choreography.is_none(), "{finding:?}");
    // U+2028 and U+0085 are line breaks for the parser, but not for an editor.
    for (text, line) in
        [("key:\u{2028}word", 1), ("a: 1\nkey:\u{2028}word", 2), ("a: 1\r\nkey:\u{85}word", 2)]
    {
        let finding = &compile_text(text).findings[0];
        assert_eq!((finding.line, finding.message.as_str()), (line, "this line has no colon"), "{finding:?}");
    }
    let compiled = compile_text("scenario: s\r\ncues: [\u{e9}, {a: b: c}]\r\n");
    let finding = &compiled.findings[0];
    assert_eq!(
        (finding.line, finding.column, finding.source_line.as_str()),
        (2, 16, "cues: [\u{e9}, {a: b: c}]")
    );
}

#[test]
fn lone_carriage_return_is_line_break_as_in_yaml() {
    let compiled = compile_text(
        "scenario: s\rcues:\r\n  - at: 0s\r    robots: arm\r    tracks: {d: [{at: 0s, to: 0.3}]}\r",
    );
    let finding = &compiled.findings[0];
    assert_eq!((finding.line, finding.column), (5, 31));
    assert_eq!(finding.source_line, "    tracks: {d: [{at: 0s, to: 0.3}]}");
}

#[test]
fn mistake_in_anchor_is_also_located_where_alias_is_used() {
    let text =
        "scenario: s\ncues:\n  - &cue {at: 0s, robots: [arm], tracks: {d: [{at: 0s, to: 1000}]}}\n  - *cue\n";
    let compiled = compile_text(text);
    let off: Vec<_> = compiled.findings.iter().filter(|f| f.code == Code::OutOfRange).collect();
    assert_eq!(off.iter().map(|f| (f.line, f.column)).collect::<Vec<_>>(), [(3, 60)]);
    assert!(off[0].message.ends_with("; the same mistake on line 4"), "{}", off[0].message);
}

#[test]
fn gap_between_cues_holds_value_instead_of_interpolating() {
    let second = "  - at: 5s\n    robots: arm\n    tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 9}]}\n";
    let plan = compile_text(&format!("{SCENARIO}{second}").replace(", ease: smooth", ""))
        .choreography
        .unwrap()
        .acts
        .remove(0)
        .plan;
    let steps = plan.robots[0].scripts[0].script.steps();
    let shown: Vec<_> = steps.iter().map(|step| (step.offset.get(), step.setpoint.value)).collect();
    assert_eq!(shown, [(0.0, 0.0), (1_000.0, 45.0), (5_000.0, 45.0), (5_000.0, 0.0), (6_000.0, 9.0)]);
}

#[test]
fn many_findings_are_reported_on_their_lines_up_to_the_maximum() {
    let keyframes: String =
        (0..10_000).map(|i| format!("        - {{at: {i}s, to: {}}}\n", 1000 + i)).collect();
    let text = format!("scenario: s\ncues:\n  - at: 0s\n    robots: arm\n    tracks:\n      d:\n{keyframes}");
    let compiled = compile_text(&text);
    let off = compiled.findings.iter().filter(|finding| finding.code == Code::OutOfRange);
    let lines: Vec<_> = off.map(|finding| finding.line).collect();
    assert_eq!(lines, (7..7 + crate::budget::FINDINGS_MAX).collect::<Vec<_>>());
}

proptest! {
    #[test]
    fn no_text_makes_compiler_panic(text in "\\PC{0,200}") {
        check_laws(&text);
    }

    #[test]
    fn no_scenario_mutation_causes_panic(
        cut in 0usize..SCENARIO.len(),
        drop in 0usize..20,
        insert in "[\\[\\]{}:,&*!|>'\"#%@`a-z0-9 \n-]{0,12}",
    ) {
        let end = (cut + drop).min(SCENARIO.len());
        check_laws(&format!("{}{insert}{}", &SCENARIO[..cut], &SCENARIO[end..]));
    }
}

/// Possible values, valid and invalid ones.
const VALUES: [&str; 53] = [
    "$v * 2",
    "$index * 500ms",
    "2 * $w / 3",
    "if($index < 1, 1, 2)",
    "$index % 2 == 0",
    "360 * $index / $count",
    "$v / ($v - 3)",
    "00:00:01.5",
    "0s",
    "1s",
    "250ms",
    "1m30s",
    "1s..2s",
    "2s..1s",
    "bar 2 beat 1",
    "bar 0",
    "3 beats",
    "x",
    "y + 1s",
    "start of x + 0s..1s",
    "[x, y]",
    "arm",
    "[arm, arm]",
    "nobody",
    "m",
    "i.m",
    "j.x",
    "{from: 0, to: $v, across: group}",
    "{d: [{at: 0s, to: 1}]}",
    "{p: 2}",
    "{d: e}",
    "true",
    "{about: 45}",
    "{by: 0.5, about: 1}",
    "0.5",
    "-3",
    "1e308",
    ".nan",
    ".inf",
    "-0",
    "7",
    "{for: 8s}",
    "{until: 20s}",
    "z",
    "n",
    "o",
    "$v",
    "-$v",
    "$w",
    "snap",
    "[]",
    "{}",
    "~",
];
const TRACKS: [&str; 12] = [
    "{formula: '$v + 10 * sin(360 * t / 2s)', for: 3s}",
    "{formula: 'abs(10 * t / 1s - $index) % 7', for: $w + 1s}",
    "{formula: '1 / t', for: 2s, tolerance: 1}",
    "[{at: 0s, to: 0}, {at: 1s, to: 45, ease: smooth}]",
    "[{at: 1s, to: 10}, {at: 2s, to: $v, ease: step}]",
    "{wave: {amplitude: 10, period: 1s, center: 45, for: 3s}}",
    "{wave: {amplitude: 1e300, frequency: 1e9, for: 3s}, tolerance: 1e-300}",
    "{spline: [{at: 0s, to: 0}, {at: 1s, to: 5}, {at: 2s, to: 0}], max_steps: 3}",
    "{polynomial: {for: 1s, coefficients: [0, 1e200, -1e200]}}",
    "{travel: {from: 0, speed: 10, acceleration: 5, for: 2s}, tolerance: 3}",
    "[{at: 0s, to: [1, 2]}]",
    "{keyframes: [{at: 0s, to: 0}, {at: 27777h, to: 90}]}",
];

prop_compose! {
    fn cue()(
        name in "[xyz]",
        keys in prop::collection::vec((0..CueKeys::NAMES.len(), 0..VALUES.len()), 0..5),
        track in 0..TRACKS.len(),
    ) -> String {
        let mut cue = format!("  - cue: {name}\n    robots: arm\n    tracks: {{d: {}}}\n", TRACKS[track]);
        for (key, value) in keys {
            let key = CueKeys::NAMES[key];
            if !cue.contains(&format!("    {key}:")) && key != "cue" {
                cue.push_str(&format!("    {key}: {}\n", VALUES[value]));
            }
        }
        cue
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_generated_scenario_causes_panic(
        cues in prop::collection::vec(cue(), 1..6),
        auto in any::<bool>(),
        tempo in prop::option::of(1u32..300),
        given in prop::collection::vec(prop::option::of(0..VALUES.len()), 2),
        declared in prop::collection::vec(0..VALUES.len(), 2),
    ) {
        let mut text = "scenario: s\nvariables: {v: 3, w: 2s}\n".to_owned();
        let argument = |(name, value): (&str, &Option<usize>)| value.map(|value| format!("{name}: {}", VALUES[value]));
        let arguments: Vec<String> = ["p", "q"].into_iter().zip(&given).filter_map(argument).collect();
        text.push_str(&format!("include: [{{file: a.yaml, as: i, parameters: {{{}}}}}, {{file: a.yaml, as: j}}]\n", arguments.join(", ")));
        let included = format!(
            "parameters: {{p: {}, q: {}}}\nvariables: {{r: $p * 2}}\nmoves: {{m: {{parameters: {{p: $r}}, tracks: {{d: [{{at: 0s, to: 0}}, {{at: 1s, to: $p}}]}}}}}}\nsequences: {{x: {{cues: [{{robots: arm, move: m, parameters: {{p: $q}}}}]}}}}\n",
            VALUES[declared[0]], VALUES[declared[1]],
        );
        text.push_str("moves: {m: {parameters: {p: 1}, tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: $p}]}}}\n");
        text.push_str("  n: {play: [{move: m, repeat: 2}, [{move: m, at: $w}, {move: n, parameters: {p: $v}}], {move: o, duration: $w}]}\n");
        text.push_str("  o: {parameters: {p: 1s}, play: [{move: m, reverse: true, delay: $p}, {tracks: {d: [{at: 1s, to: 3}]}}]}\n");
        text.push_str("sequences: {x: {parameters: {p: o}, cues: [{cue: x, robots: arm, move: $p}, {cue: y, sequence: z}]}, z: {cues: [{after: x, sequence: y}, {at: 1s, robots: arm, move: n}]}}\n");
        text.push_str(if auto { "zones: {z: auto}\n" } else { "zones: [z]\n" });
        if let Some(tempo) = tempo {
            text.push_str(&format!("tempo: {tempo}\n"));
        }
        text.push_str("cues:\n");
        text.push_str(&cues.concat());
        check_laws_with(&text, &included);
    }
}

mod carried;
mod compensated;
mod composed;
mod entries;
mod expressions;
mod fixes;
mod groups;
mod held;
mod hints;
mod large_groups;
mod metamorphic;
mod names;
mod numbers;
mod once;
mod orders;
mod patterns;
mod places;
mod rehearsed;
mod standing;
mod told;
mod troupe;
mod verified;
mod ways;
mod whole;
