//! Tests that the examples do what they are meant to show.

use std::process::Command;

use stage::session::{Ran, program, root};

fn downbeat(args: &[&str]) -> Ran {
    Ran(Command::new(program()).args(args).current_dir(root()).output().unwrap())
}

#[test]
fn every_example_passes_check_and_plays_in_virtual_time() {
    for name in ["swap", "dance", "tank", "wave", "meeting", "sky", "eight"] {
        let scenario = format!("scripts/examples/{name}.yaml");
        downbeat(&["check", &scenario]).says(0, &["no errors"]);
        let ran = downbeat(&["dry-run", &scenario, "--format", "json"]);
        let report = ran.json();
        assert_eq!((ran.code(), report["outcome"].as_str()), (0, Some("done")));
        // By the one true clock, over all acts.
        assert!(report["true_spread_ms"].as_f64().unwrap() < 5.0, "{name}: {}", report["true_spread_ms"]);
    }
}

#[test]
fn examples_with_third_party_robots_succeed() {
    for name in ["mujoco/greeting", "reachy-mini/nod", "together"] {
        let scenario = format!("examples/{name}.yaml");
        downbeat(&["check", &scenario]).says(0, &["no errors"]);
        let report = downbeat(&["dry-run", &scenario, "--format", "json"]).json();
        assert_eq!(report["outcome"], "done", "{name}");
    }
}

#[test]
fn swap_has_432_steps_in_4250_ms_with_18_per_device() {
    let plan = downbeat(&["plan", "scripts/examples/swap.yaml", "--format", "json"]).json();
    assert_eq!(plan["duration_ms"], 4_250);
    let robots = plan["acts"][0]["robots"].as_object().unwrap();
    assert_eq!(robots.len(), 6);
    let requests: Vec<_> = robots.values().flat_map(|requests| requests.as_array().unwrap()).collect();
    assert_eq!(requests.len(), 24);
    for request in requests {
        let steps = request["control_request"]["control_value"].as_array().unwrap();
        assert_eq!(steps.len(), 18);
        assert_eq!(steps[17]["time_offset_to_start"], 4_250);
    }
}

/// Returns the positions of a drone at every millisecond, computed from the requests that it received: one list per axis.
fn flown(requests: &serde_json::Value) -> [Vec<f64>; 3] {
    ["x", "y", "z"].map(|axis| {
        let request = requests.as_array().unwrap().iter().map(|request| &request["control_request"]);
        let request = request.into_iter().find(|request| request["device_id"] == axis).unwrap();
        let steps = request["control_value"].as_array().unwrap().iter();
        let number = |step: &serde_json::Value, key: &str| step[key].as_f64().unwrap();
        let steps: Vec<(f64, f64)> =
            steps.map(|s| (number(s, "time_offset_to_start"), number(s, "control_value"))).collect();
        let at = |ms: u32| {
            let next = steps.iter().position(|step| step.0 >= f64::from(ms)).unwrap().max(1);
            let ((from, begin), (to, end)) = (steps[next - 1], steps[next]);
            begin + (end - begin) * (f64::from(ms) - from) / (to - from)
        };
        (0..=4_250).map(at).collect()
    })
}

#[test]
fn closest_approach_of_swap_matches_its_steps() {
    let plan = downbeat(&["plan", "scripts/examples/swap.yaml", "--format", "json"]).json();
    let act = &plan["acts"][0];
    let drones: Vec<_> = act["robots"].as_object().unwrap().values().map(flown).collect();
    let mut least = (f64::INFINITY, 0);
    for (index, a) in drones.iter().enumerate() {
        for b in &drones[index + 1..] {
            for ms in 0..=4_250 {
                let squares = (0..3).map(|axis| (a[axis][ms] - b[axis][ms]).powi(2));
                least = if squares.clone().sum::<f64>() < least.0 { (squares.sum(), ms) } else { least };
            }
        }
    }
    let (found, at) =
        (act["closest"]["distance_m"].as_f64().unwrap(), act["closest"]["at_ms"].as_f64().unwrap());
    // The fleet file gives every drone a radius of 7 cm.
    assert!(
        (found - (least.0.sqrt() - 0.14)).abs() < 1e-5 && (at - least.1 as f64).abs() <= 1.0,
        "{found} at {at}"
    );
    downbeat(&["plan", "scripts/examples/swap.yaml"])
        .says(0, &["closest approach: `cf2` and `cf5`, 0.162 m at 2.324 s"]);
}

#[test]
fn changed_speed_rechecks_limits_of_bodies() {
    let swap = |speed| downbeat(&["dry-run", "scripts/examples/swap.yaml", "--speed", speed]);
    swap("1.2").says(0, &["done"]);
    swap("2").says(1, &["robot `cf2`: its body would reach", "m/s, but the limit is 1.5"]);
}

#[test]
fn dry_run_picture_shows_every_device() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("swap.svg");
    downbeat(&["dry-run", "scripts/examples/swap.yaml", "--picture", path.to_str().unwrap()]).says(0, &[]);
    let svg = std::fs::read_to_string(path).unwrap();
    // A lane draws its planned values in one path and its dots in another.
    assert_eq!(svg.matches("<path class='line'").count(), 24);
    assert_eq!(dots(&svg), 432);
}

/// Returns the number of dots in the lanes of a picture. Dots in the legend are not counted: there, `class` is not the first attribute of
/// the path.
fn dots(svg: &str) -> usize {
    svg.split("<path class='dots")
        .skip(1)
        .filter_map(|path| path.split("/>").next())
        .map(|path| path.matches("h0").count())
        .sum()
}

#[test]
fn lamp_picture_shows_all_of_its_colours() {
    let folder = tempfile::tempdir().unwrap();
    let [scenario, picture] = ["lamp.yaml", "lamp.svg"].map(|name| folder.path().join(name));
    let blue = "scenario: lamp
cues:
  - at: 0s
    robots: rover-1
    tracks: {lamp: {control: custom_1, keyframes: [{at: 0s, to: [0, 20, 40]}, {at: 1s, to: [0, 120, 255]}]}}
";
    std::fs::write(&scenario, blue).unwrap();
    let args = [
        "dry-run",
        scenario.to_str().unwrap(),
        "--fleet",
        "fleet.yaml",
        "--picture",
        picture.to_str().unwrap(),
    ];
    downbeat(&args).says(0, &[]);
    let svg = std::fs::read_to_string(picture).unwrap();
    assert!(svg.contains("0 .. 255") && svg.contains("dashed"), "{svg}");
    assert_eq!(svg.matches("<path class='line").count(), 3);
}

#[test]
fn demo_fleet_responds_to_ping_and_show() {
    let ping = downbeat(&["fleet", "ping", "--format", "json"]).json();
    assert_eq!(ping.as_array().unwrap().len(), 13);
    assert!(ping.as_array().unwrap().iter().all(|answer| answer["clock"]["samples"].as_u64() >= Some(8)));
    downbeat(&["fleet", "show"])
        .says(0, &["RShoulderRoll", "max", "battery"].map(|s| if s == "max" { "granularity" } else { s }));
}
