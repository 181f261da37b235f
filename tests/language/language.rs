//! The meaning of the words of the scenario language, checked by the numbers of the compiled plan.

use std::io::Read as _;
use std::process::Stdio;

use serde_json::Value;

use stage::Process;
use stage::session::{Session, root};

/// The compiled plan of a scenario for the robots of `tests/sessions/findings`.
struct Planned(Value);

#[track_caller]
fn planned(yaml: &str) -> Planned {
    planned_with(yaml, &[])
}

#[track_caller]
fn planned_with(yaml: &str, files: &[(&str, &str)]) -> Planned {
    let session = Session::new();
    session.file("test.yaml", format!("scenario: test\n{yaml}"));
    for (name, content) in files {
        session.file(name, content);
    }
    let fleet = root().join("tests/sessions/findings/folder/fleet.yaml");
    let ran = session.run(&["plan", "test.yaml", "--fleet", fleet.to_str().unwrap(), "--format", "json"]);
    assert_eq!(ran.code(), 0, "{yaml}\n{}", ran.text());
    Planned(ran.json())
}

impl Planned {
    /// Returns start and end of a cue of the first act, in milliseconds.
    #[track_caller]
    fn cue(&self, name: &str) -> (f64, f64) {
        let cues = self.0["acts"][0]["cues"].as_array().unwrap();
        let cue = cues.iter().find(|cue| cue["name"] == name).unwrap();
        (cue["start"].as_f64().unwrap(), cue["end"].as_f64().unwrap())
    }

    fn scripts(&self, robot: &str, device: &str) -> Vec<&Value> {
        let requests = self.0["acts"][0]["robots"][robot].as_array().unwrap().iter();
        requests.map(|request| &request["control_request"]).filter(|r| r["device_id"] == device).collect()
    }

    /// Returns all steps of a device as (milliseconds since the start of the act, value).
    #[track_caller]
    fn steps(&self, robot: &str, device: &str) -> Vec<(f64, f64)> {
        let mut steps = Vec::new();
        for script in self.scripts(robot, device) {
            let begin = script["time_offset_to_start"].as_f64().unwrap();
            for step in script["control_value"].as_array().unwrap() {
                let at = begin + step["time_offset_to_start"].as_f64().unwrap();
                steps.push((at, step["control_value"].as_f64().unwrap()));
            }
        }
        steps
    }
}

const LIFT: &str = "moves:\n  lift:\n    parameters: {to: 30, back: 0}\n    tracks:\n      elbow: [{at: 0s, to: 0}, {at: 1s, to: $to}, {at: 3s, to: $back}]\n";

fn lift(cue: &str) -> Planned {
    planned(&format!("{LIFT}cues:\n  - {{cue: a, at: 0s, robots: left, move: lift, {cue}}}\n"))
}

#[test]
fn cues_start_as_early_as_their_relations_allow() {
    let cue = |name: &str, keys: &str, device: &str| {
        format!("  - {{cue: {name}, {keys}, robots: left, tracks: {{{device}: [{{at: 1s, to: 10}}]}}}}\n")
    };
    let text = [
        cue("a", "at: 500ms", "elbow"),
        cue("b", "after: a + 250ms", "wrist"),
        cue("c", "after: start of b + 3s", "wrist"),
        cue("d", "with: c - 0s", "elbow").replace("c - 0s", "c"),
        cue("e", "after: [c, d + 1s..2s]", "wrist"),
        cue("f", "with: end of e + 100ms", "elbow"),
        "  - {cue: m, after: f, before: g - 2s}\n".to_owned(),
        cue("g", "at: 12s..30s", "elbow"),
    ];
    let plan = planned(&format!("cues:\n{}", text.concat()));
    assert_eq!(plan.cue("b"), (1_750.0, 2_750.0));
    assert_eq!(plan.cue("c"), (4_750.0, 5_750.0));
    assert_eq!(plan.cue("d"), (4_750.0, 5_750.0));
    assert_eq!(plan.cue("e"), (6_750.0, 7_750.0));
    assert_eq!(plan.cue("f"), (7_850.0, 8_850.0));
    assert_eq!(plan.cue("m"), (8_850.0, 8_850.0));
    assert_eq!(plan.cue("g"), (12_000.0, 13_000.0));
    // All but `g` could be later; `f` has to end 2 s before `g`.
    let slack = |name: usize| plan.0["acts"][0]["cues"][name]["slack"].as_f64().unwrap();
    assert_eq!((slack(0), slack(5), slack(7)), (0.0, 1_150.0, 0.0));
}

#[test]
fn cues_that_determine_the_act_end_are_critical() {
    let cue = |name: &str, keys: &str| {
        format!("  - {{cue: {name}, {keys}, robots: left, tracks: {{{name}: [{{at: 1s, to: 10}}]}}}}\n")
    };
    let text = [cue("elbow", "at: 0s"), cue("wrist", "after: elbow + 1s")].concat();
    // `fixed` has no slack and ends before the others; `end` begins when `wrist` ends.
    let marks = "  - {cue: fixed, at: 500ms}\n  - {cue: end, after: wrist}\n";
    let plan = planned(&format!("cues:\n{text}{marks}"));
    let cues = plan.0["acts"][0]["cues"].as_array().unwrap().iter();
    let critical: Vec<_> = cues.map(|cue| (&cue["slack"], &cue["critical"])).collect();
    assert_eq!(serde_json::json!(critical), serde_json::json!([[0, true], [0, true], [0, false], [0, true]]));
}

#[test]
fn bars_and_beats_follow_the_tempo() {
    let plan = planned(
        "tempo: [{at: bar 1, bpm: 60, signature: 3/4}, {at: bar 3, bpm: 120}]\ncues:\n  - {cue: a, at: bar 2 beat 3, robots: left, tracks: {elbow: [{at: 1 beat, to: 10}, {at: 1 bar, to: 0}]}}\n  - {cue: b, at: bar 4, robots: right, tracks: {elbow: [{at: 2 beats, to: 10}]}}\n",
    );
    // Bar 2 begins at 3 s, its third beat at 5 s. After 6 s, a beat takes half a second.
    assert_eq!(plan.steps("left", "elbow"), [(6_000.0, 10.0), (7_000.0, 0.0)]);
    assert_eq!(plan.cue("b"), (7_500.0, 8_500.0));
}

#[test]
fn parameters_variables_and_roles_are_replaced_by_their_values() {
    let plan = planned(&format!(
        "variables: {{height: 12.5, pause: 2s}}\nroles: {{leader: left}}\n{LIFT}cues:\n  - {{at: $pause, robots: leader, move: lift, parameters: {{to: $height}}}}\n"
    ));
    assert_eq!(plan.steps("left", "elbow"), [(2_000.0, 0.0), (3_000.0, 12.5), (5_000.0, 0.0)]);
}

#[test]
fn movements_are_scaled_and_mirrored_about_a_value() {
    assert_eq!(lift("scale: 0.5").steps("left", "elbow")[1], (1_000.0, 15.0));
    // Scaled about 30, 0 becomes 15; mirrored at 30, it becomes 45. The peak stays.
    let plan = lift("scale: {by: 0.5, about: 30}, mirror: {about: 30}");
    assert_eq!(plan.steps("left", "elbow"), [(0.0, 45.0), (1_000.0, 30.0), (3_000.0, 45.0)]);
}

#[test]
fn reversed_and_repeated_movements_keep_their_full_length() {
    assert_eq!(lift("reverse: true").steps("left", "elbow"), [(0.0, 0.0), (2_000.0, 30.0), (3_000.0, 0.0)]);
    let five = [(0.0, 0.0), (1_000.0, 30.0), (3_000.0, 0.0), (4_000.0, 30.0), (6_000.0, 0.0)];
    assert_eq!(lift("repeat: 2").steps("left", "elbow"), five);
    assert_eq!(lift("repeat: {for: 8s}").steps("left", "elbow"), five);
    assert_eq!(lift("repeat: {until: 7s}").steps("left", "elbow"), five);
    assert_eq!(lift("duration: 6s").steps("left", "elbow"), [(0.0, 0.0), (2_000.0, 30.0), (6_000.0, 0.0)]);
}

#[test]
fn canon_staggers_robots_and_overrides_adjust_individual_ones() {
    let plan = planned(&format!(
        "{LIFT}cues:\n  - {{cue: a, at: 0s, robots: arms, move: lift, canon: 400ms, overrides: {{right: {{scale: 0.5, delay: 100ms}}}}}}\n"
    ));
    assert_eq!(plan.steps("left", "elbow")[0], (0.0, 0.0));
    assert_eq!(plan.steps("right", "elbow"), [(500.0, 0.0), (1_500.0, 15.0), (3_500.0, 0.0)]);
    assert_eq!(plan.cue("a"), (0.0, 3_500.0));
}

#[test]
fn duration_range_uses_shortest_time_the_device_allows() {
    // 90 degrees take 1.5 s at 60 degrees per second.
    let plan = planned(
        "cues:\n  - {cue: a, at: 0s, duration: 500ms..9s, robots: left, tracks: {elbow: [{at: 0s, to: 0}, {at: 3s, to: 90}]}}\n",
    );
    assert_eq!(plan.steps("left", "elbow"), [(0.0, 0.0), (1_500.0, 90.0)]);
}

#[test]
fn includes_provide_moves_and_variables() {
    let shared = "variables: {h: 20}\nmoves: {up: {tracks: {elbow: [{at: 1s, to: $h}]}}}\n";
    let plan = planned_with(
        "include: shared.yaml\ncues:\n  - {robots: left, move: up, devices: {elbow: wrist}}\n",
        &[("shared.yaml", shared)],
    );
    assert_eq!(plan.steps("left", "wrist"), [(1_000.0, 20.0)]);
}

#[test]
fn every_curve_stays_within_its_tolerance() {
    let near = |steps: &[(f64, f64)], curve: &dyn Fn(f64) -> f64, tolerance: f64| {
        for millis in (steps[0].0 as u32)..=(steps[steps.len() - 1].0 as u32) {
            let at = f64::from(millis);
            let after = steps.iter().position(|step| step.0 >= at).unwrap();
            let (b, a) = (steps[after], steps[after.saturating_sub(1)]);
            let value = if b.0 > a.0 { a.1 + (b.1 - a.1) * (at - a.0) / (b.0 - a.0) } else { b.1 };
            assert!((value - curve(at / 1_000.0)).abs() <= tolerance + 1e-9, "{at} ms: {value}");
        }
    };
    let track = |track: &str| {
        planned(&format!("cues:\n  - {{robots: left, tracks: {{wrist: {track}}}}}\n")).steps("left", "wrist")
    };
    let wave = |t: f64| 5.0 + 20.0 * (std::f64::consts::TAU * (t / 4.0 + 0.25)).sin();
    near(
        &track("{tolerance: 4, wave: {amplitude: 20, period: 4s, phase: 90, center: 5, for: 4s}}"),
        &wave,
        4.0,
    );
    near(
        &track("{tolerance: 1, polynomial: [{for: 2s, coefficients: [0, 10, -2.5]}]}"),
        &|t| 10.0 * t - 2.5 * t * t,
        1.0,
    );
    near(
        &track("{tolerance: 1, travel: {from: 0, speed: 5, acceleration: 10, for: 2s}}"),
        &|t| 5.0 * t + 5.0 * t * t,
        1.0,
    );
    let smooth = |t: f64| {
        60.0 * {
            let s = t / 2.0;
            s * s * s * (10.0 + s * (6.0 * s - 15.0))
        }
    };
    near(
        &track("{tolerance: 2, keyframes: [{at: 0s, to: 0}, {at: 2s, to: 60, ease: smooth}]}"),
        &smooth,
        2.0,
    );
}

#[test]
fn samples_are_read_from_a_file_column() {
    let csv = "# measured\nmillis;x,y\n0,1,0\n500,2,20\n1000,3,0\n".replace("millis;x", "millis,x");
    let plan = planned_with(
        "cues:\n  - {robots: left, tracks: {wrist: {samples: {file: c.csv, time: millis, value: 3, time_unit: ms, scale: 2}}}}\n",
        &[("c.csv", &csv)],
    );
    assert_eq!(plan.steps("left", "wrist"), [(0.0, 0.0), (500.0, 40.0), (1_000.0, 0.0)]);
}

#[test]
fn multiple_values_and_readings_are_planned() {
    let plan = planned(
        "cues:\n  - {at: 1s, robots: rover, read: {range: [0s, 500ms]}, tracks: {lamp: [{at: 0s, to: [1, 2, 3]}]}}\n",
    );
    let step = &plan.scripts("rover", "lamp")[0]["control_value"][0];
    assert_eq!(
        (&step["control_type"], &step["control_value_3"]),
        (&Value::from("custom_1"), &Value::from(3))
    );
    let times: Vec<_> =
        plan.0["acts"][0]["readings"].as_array().unwrap().iter().map(|r| r["at"].as_f64().unwrap()).collect();
    assert_eq!(times, [1_000.0, 1_500.0]);
}

#[test]
fn zones_separate_cues_in_given_or_computed_order() {
    let cues = "cues:\n  - {cue: long, uses: table, robots: left, tracks: {elbow: [{at: 3s, to: 30}]}}\n  - {cue: short, uses: table, end_by: 2s, robots: right, tracks: {elbow: [{at: 1s, to: 30}]}}\n";
    let plan = planned(&format!("zones: {{table: auto}}\n{cues}"));
    assert_eq!((plan.cue("short"), plan.cue("long")), ((0.0, 1_000.0), (1_000.0, 4_000.0)));
    let plan = planned(&format!("zones: [table]\n{}", cues.replace("end_by: 2s, ", "")));
    assert_eq!((plan.cue("long"), plan.cue("short")), ((0.0, 3_000.0), (3_000.0, 4_000.0)));
    let plan = planned(
        "cues:\n  - {cue: a, robots: left, tracks: {elbow: [{at: 1s, to: 30}]}}\n  - {cue: b, apart: a, robots: right, tracks: {elbow: [{at: 1s, to: 30}]}}\n",
    );
    assert_eq!(plan.cue("b"), (1_000.0, 2_000.0));
}

#[test]
fn long_scripts_are_chained_without_gaps() {
    let plan = lift("repeat: 5");
    let scripts = plan.scripts("left", "elbow");
    assert_eq!(scripts.len(), 2);
    assert_eq!(scripts[0]["control_value"].as_array().unwrap().len(), 8);
    assert_eq!(scripts[1]["time_offset_to_start"], 10_000);
    assert_eq!(plan.steps("left", "elbow").len(), 11);
    assert_eq!(plan.0["acts"][0]["devices"][0]["budget"], 16);
}

#[test]
fn max_steps_minimizes_error_and_tolerance_omits_keyframes() {
    let keyframes = "[{at: 0s, to: 0}, {at: 1s, to: 10}, {at: 2s, to: 20.5}, {at: 3s, to: 30}]";
    let plan = |wish: &str| {
        planned(&format!(
            "cues:\n  - {{robots: left, tracks: {{elbow: {{{wish}, keyframes: {keyframes}}}}}}}\n"
        ))
    };
    assert_eq!(plan("control: position").steps("left", "elbow").len(), 4);
    assert_eq!(plan("tolerance: 0.5").steps("left", "elbow"), [(0.0, 0.0), (3_000.0, 30.0)]);
    assert_eq!(plan("max_steps: 2").steps("left", "elbow"), [(0.0, 0.0), (3_000.0, 30.0)]);
}

#[test]
fn acts_contain_their_wait_conditions_and_successors() {
    let plan = planned(
        "on_failure: stop\nacts:\n  - act: one\n    cues: [{robots: left, tracks: {elbow: [{at: 1s, to: 10}]}}]\n    next: three\n    on_failure: {default: without, then: three}\n  - act: two\n    wait: {time: '19:30'}\n    cues: [{robots: left, tracks: {elbow: [{at: 1s, to: 20}]}}]\n    next: end\n  - act: three\n    wait: {sensor: rover/range, within: [0.5, 1], timeout: 20s, otherwise: two}\n    cues: [{robots: left, tracks: {elbow: [{at: 1s, to: 30}]}}]\n    next: end\n",
    );
    let acts = plan.0["acts"].as_array().unwrap();
    assert_eq!((&acts[0]["next"], &acts[0]["on_failure"]), (&Value::from("three"), &Value::from("without")));
    assert_eq!(acts[1]["wait"]["time_of_day"], 70_200_000);
    assert_eq!(acts[2]["wait"]["sensor"]["range"]["within"], serde_json::json!([0.5, 1.0]));
    assert_eq!((&acts[2]["on_timeout"], &acts[2]["timeout_ms"]), (&Value::from("two"), &Value::from(20_000)));
    assert_eq!(acts[2]["on_failure"], "stop");
}

#[test]
fn on_doubt_defaults_to_start_unless_act_or_scenario_overrides_it() {
    let doubts = |whole: &str, own: &str| {
        let act = |name: &str, own: &str| {
            let cues = "cues: [{robots: left, tracks: {elbow: [{at: 1s, to: 10}]}}]";
            format!("  - {{act: {name}, {own}{cues}}}\n")
        };
        let plan = planned(&format!("{whole}acts:\n{}{}", act("one", own), act("two", "")));
        [0, 1].map(|index| plan.0["acts"][index]["on_doubt"].as_str().unwrap().to_owned())
    };
    assert_eq!(doubts("", ""), ["start", "start"]);
    assert_eq!(doubts("", "on_doubt: withdraw, "), ["withdraw", "start"]);
    assert_eq!(doubts("on_doubt: withdraw\n", ""), ["withdraw", "withdraw"]);
    assert_eq!(doubts("on_doubt: withdraw\n", "on_doubt: start, "), ["start", "withdraw"]);
    let whole = "on_doubt: withdraw\ncues: [{robots: left, tracks: {elbow: [{at: 1s, to: 10}]}}]\n";
    assert_eq!(planned(whole).0["acts"][0]["on_doubt"], "withdraw");
}

#[test]
fn denied_warnings_are_errors_and_findings_are_exported_as_sarif() {
    let session = Session::new();
    session.file(
        "test.yaml",
        "scenario: test\ncues:\n  - {robots: left, tracks: {elbow: [{at: 0s, to: 30}]}}\n",
    );
    let fleet = root().join("tests/sessions/findings/folder/fleet.yaml");
    let fleet = fleet.to_str().unwrap();
    session.run(&["check", "test.yaml", "--fleet", fleet]).says(0, &["DB0034", "0 errors, 1 warning"]);
    session
        .run(&["check", "test.yaml", "--fleet", fleet, "--deny", "warnings", "--sarif", "out.sarif"])
        .says(1, &["warnings denied"]);
    let sarif: Value =
        serde_json::from_str(&std::fs::read_to_string(session.path("out.sarif")).unwrap()).unwrap();
    let result = &sarif["runs"][0]["results"][0];
    assert_eq!((&result["ruleId"], &result["level"]), (&Value::from("DB0034"), &Value::from("warning")));
    assert_eq!(result["locations"][0]["physicalLocation"]["region"]["startLine"], 3);
}

/// Returns the job shop ft06 (Muth and Thompson, 1963; proven optimum 55) as a scenario. Its tasks are cues that need machines and have
/// to end by `deadline`.
fn job_shop(deadline: &str) -> String {
    let text = std::fs::read_to_string(root().join("tests/fixtures/jobshop/instances.json")).unwrap();
    let shop: Value = serde_json::from_str::<Value>(&text).unwrap()["ft06"].take();
    let mut yaml = "scenario: ft06\norder: auto\nzones: [m0, m1, m2, m3, m4, m5]\ncues:\n".to_owned();
    for job in 0..6 {
        for task in 0..6 {
            let machine = &shop["machines_matrix"][job][task];
            let seconds = &shop["duration_matrix"][job][task];
            let after = if task > 0 { format!(", after: j{job}t{}", task - 1) } else { String::new() };
            yaml.push_str(&format!(
                "  - {{cue: j{job}t{task}, uses: m{machine}, duration: {seconds}s, end_by: {deadline}{after}}}\n"
            ));
        }
    }
    yaml
}

#[test]
fn job_shop_meets_its_optimal_deadline_but_no_earlier_one() {
    let session = Session::new();
    session.file("in_time.yaml", job_shop("55s")).file("too_early.yaml", job_shop("54s"));
    let plan = session.run(&["plan", "in_time.yaml", "--format", "json"]).json();
    let ends = plan["acts"][0]["cues"].as_array().unwrap().iter().map(|cue| cue["end"].as_f64().unwrap());
    assert_eq!(ends.fold(0.0, f64::max), 55_000.0);
    session.run(&["check", "too_early.yaml"]).says(
        1,
        &[
            "DB0027",
            "found no order that satisfies all time limits of the cues that use ",
            "the search may have missed a valid order",
        ],
    );
}

#[test]
fn plan_states_duration_of_each_repetition() {
    let repeat = |cue: &str| {
        let json = lift(cue).0["acts"][0]["cues"][0]["repeat"].clone();
        ["times", "length_ms", "every_ms"].map(|key| json[key].as_f64())
    };
    assert_eq!(repeat("repeat: 2"), [Some(2.0), Some(3_000.0), Some(3_000.0)]);
    // `duration` covers all repetitions together.
    assert_eq!(repeat("repeat: 2, duration: 12s"), [Some(2.0), Some(6_000.0), Some(6_000.0)]);
    assert_eq!(repeat("repeat: {times: 2, every: 4s}"), [Some(2.0), Some(3_000.0), Some(4_000.0)]);
    assert_eq!(
        repeat("repeat: {times: 2, every: 4s}, duration: 14s"),
        [Some(2.0), Some(6_000.0), Some(8_000.0)]
    );
    assert_eq!(repeat("overrides: {left: {repeat: 3}}"), [Some(3.0), Some(3_000.0), Some(3_000.0)]);
    assert_eq!((repeat("repeat: 1"), repeat("duration: 6s")), ([None; 3], [None; 3]));
}

#[test]
fn plan_lists_devices_with_unknown_speed_limits() {
    let session = Session::new();
    let nods = "scenario: s\ntempo: 480\ncues:\n  - {cue: nods, at: 0s, robots: arms, duration: 1 bar, repeat: 5, tracks: {DEVICE: [{at: 0s, to: 0}, {at: 500ms, to: 30, ease: smooth}, {at: 1s, to: 0, ease: smooth}]}}\n  - {cue: rest, after: nods, robots: left, tracks: {DEVICE: [{at: 1s, to: 0}]}}\n";
    session
        .file("arm.yaml", stage::session::ARM.replace("max_number_of_steps: 8", "max_number_of_steps: 200"));
    session.file("nods.yaml", nods.replace("DEVICE", "shoulder"));
    let unlimited = "speeds are not checked for `shoulder` of 2 robots: their limits are unknown; add `limits` to the fleet file";
    session
        .run(&["plan", "nods.yaml"])
        .says(0, &["repeated", " nods    0 ms  500 ms   0 ms  5 x 100 ms", unlimited]);
    // The arms that `init` writes have limits.
    session.run(&["init", "show"]).says(0, &[]);
    session.file("show/nods.yaml", nods.replace("DEVICE", "elbow").replace("left", "arm-1"));
    session
        .run(&["check", "show/nods.yaml", "--fleet", "show/fleet.yaml"])
        .says(1, &["DB0032", "at most 300"]);
    for template in ["arms", "drones", "stage", "edge"] {
        session.run(&["init", template, "--template", template]).says(0, &[]);
        let plan = session.run(&[
            "plan",
            &format!("{template}/show.yaml"),
            "--fleet",
            &format!("{template}/fleet.yaml"),
        ]);
        plan.says(0, &[]);
        assert!(!plan.out().contains("speeds are not checked"), "{}", plan.out());
    }
}

#[test]
fn plan_with_many_steps_is_printed_incrementally() {
    const STEPS: usize = 200_000;
    let session = Session::new();
    let rows = (0..STEPS).map(|row| format!("{}.{:02},{}\n", row / 100, row % 100, (row * 37) % 90));
    session.file("curve.csv", format!("t,elbow\n{}", rows.collect::<String>()));
    let limits = "{min_value: 0, max_value: 100, granularity: 1}";
    session.file("bot.yaml", format!("id: bot
api_version: '1'
devices: [{{id: elbow, name: elbow, available_control_types: {{position: {limits}, script: {{max_number_of_steps: 1000000}}}}}}]
"));
    session.file("fleet.yaml", "robots: {bot: {init: bot.yaml, address: sim}}\n");
    let samples = "{file: curve.csv, time: t, value: elbow}";
    session.file(
        "test.yaml",
        format!(
            "scenario: test\ncues: [{{at: 0s, robots: bot, tracks: {{elbow: {{samples: {samples}}}}}}}]\n"
        ),
    );
    let mut command = session.command(&["plan", "test.yaml", "--format", "json"]);
    let mut plan = Process(command.stdout(Stdio::piped()).spawn().unwrap());
    let mut out = plan.0.stdout.take().unwrap();
    // While the pipe is not read, the rest cannot be printed.
    let mut printed = vec![0];
    out.read_exact(&mut printed).unwrap();
    let megabytes = plan.memory();
    assert!(megabytes < 120, "{megabytes} MB");
    out.read_to_end(&mut printed).unwrap();
    let plan = Planned(serde_json::from_slice(&printed).unwrap());
    assert!(plan.steps("bot", "elbow").len() > STEPS / 2);
}
