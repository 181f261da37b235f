//! Imports complete sets of real files, and checks the results. `DOWNBEAT_DATA` names the folder of the files.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use stage::session::{Session, root};

/// Returns the folder of the real files. Without this folder, the tests are skipped.
fn data() -> Option<PathBuf> {
    std::env::var_os("DOWNBEAT_DATA").map(PathBuf::from)
}

/// Imports a file with an initialization block and checks the result. Returns the code and message of each error, or `None` if the import
/// fails.
fn errors(format: &str, file: &Path, init: &str) -> Option<Vec<(String, String)>> {
    let session = Session::new();
    let init = root().join("scripts/examples/robots").join(init);
    let (file, init) = (file.to_str().unwrap(), init.to_str().unwrap());
    if session.run(&["import", format, file, "--init", init, "--output", "out"]).code() != 0 {
        return None;
    }
    let args = ["check", "out/scenario.yaml", "--fleet", "out/fleet.yaml", "--format", "json"];
    let json = session.run(&args).json();
    let findings = json["findings"].as_array().unwrap().iter().filter(|f| f["severity"] == "error");
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    Some(findings.map(|f| (text(&f["code"]), text(&f["message"]))).collect())
}

fn json_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files = Vec::new();
    for path in entries {
        if path.is_dir() {
            files.extend(json_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "json") {
            files.push(path);
        }
    }
    files.sort();
    files
}

#[test]
fn three_of_twenty_demos_respect_joint_limits() {
    let Some(data) = data() else { return };
    let demos = json_files(&data.join("bitbots-animations/bitbots_demo_animations"));
    assert_eq!(demos.len(), 20);
    let sound =
        |path: &&PathBuf| errors("bitbots", path, "wolfgang.yaml").is_some_and(|errors| errors.is_empty());
    let sound: Vec<_> =
        demos.iter().filter(sound).map(|path| path.file_stem().unwrap().to_str().unwrap()).collect();
    assert_eq!(sound, ["brucelee", "pushup", "wave"]);
}

#[test]
fn dance_exceeds_exactly_five_limits() {
    let Some(data) = data() else { return };
    let dance = data.join("bitbots-animations/bitbots_demo_animations/schnup_dance.json");
    let errors = errors("bitbots", &dance, "wolfgang.yaml").unwrap();
    assert_eq!(errors.len(), 5, "{errors:#?}");
    let expected = [
        "keyframe 27: 45.52734375 lies outside the limits for position of `LShoulderRoll`",
        "keyframe 29: 45.087890625 lies outside the limits for position of `LShoulderRoll`",
        "keyframe 22: -94.04296875 lies outside the limits for position of `RElbow`",
        "keyframe 1: -50.44921875 lies outside the limits for position of `RShoulderRoll`",
        "keyframe 28: -45.703125 lies outside the limits for position of `RShoulderRoll`",
    ];
    for start in expected {
        assert!(
            errors.iter().any(|(code, message)| code == "DB0011" && message.starts_with(start)),
            "{start}"
        );
    }
}

#[test]
fn only_reach_max_torso_motion_of_tiago_is_too_fast() {
    let Some(data) = data() else { return };
    let motions = data.join("tiago-motions/tiago_bringup/config/motions");
    for (name, too_fast) in [("no-arm", 0), ("pal-gripper", 1), ("pal-hey5", 1), ("robotiq-2f-85", 1)] {
        let file = motions.join(format!("tiago_motions_{name}.yaml"));
        let errors = errors("play-motion2", &file, "tiago.yaml").unwrap();
        assert_eq!(errors.len(), too_fast, "{name}: {errors:#?}");
        for (code, message) in errors {
            assert_eq!(code, "DB0032");
            assert!(
                message.starts_with("keyframe 2: moving from 0.1 to 0.35 in 3 s requires a speed of 0.0833"),
                "{message}"
            );
        }
    }
}

#[test]
fn invalid_yaml_table_states_why_each_text_is_rejected() {
    let Some(data) = data() else { return };
    let table = std::fs::read_to_string(root().join("docs/yaml.md")).unwrap();
    let fleet = root().join("tests/sessions/findings/folder/fleet.yaml");
    let mut texts = 0;
    for entry in std::fs::read_dir(data.join("yaml-invalid")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "yaml") {
            continue;
        }
        texts += 1;
        let session = Session::new();
        let args = ["check", path.to_str().unwrap(), "--fleet", fleet.to_str().unwrap(), "--format", "json"];
        let ran = session.run(&args);
        assert_eq!(ran.code(), 1, "{}", path.display());
        let json = ran.json();
        let findings = json["findings"].as_array().unwrap().iter();
        let codes: BTreeSet<_> = findings.map(|f| f["code"].as_str().unwrap().to_owned()).collect();
        let codes: Vec<_> = codes.into_iter().collect();
        let name = path.file_stem().unwrap().to_str().unwrap();
        let row = table.lines().find(|line| line.starts_with(&format!("| {name} |"))).unwrap();
        assert!(row.ends_with(&format!("| {} |", codes.join(", "))), "{row}: {codes:?}");
    }
    assert_eq!(texts, 94);
}

#[test]
fn nineteen_scenes_of_seven_drones_fit_as_acts_and_refill_as_one_act() {
    let Some(data) = data() else { return };
    let scenes = sequence(&data);
    let session = Session::new();
    let init = root().join("scripts/examples/robots/crazyflie.yaml");
    let (scenes, init) = (scenes.to_str().unwrap(), init.to_str().unwrap());
    session.run(&["import", "crazyswarm", scenes, "--init", init, "--output", "acts"]).says(0, &[]);
    let plan =
        session.run(&["plan", "acts/scenario.yaml", "--fleet", "acts/fleet.yaml", "--format", "json"]).json();
    assert_eq!(plan["acts"].as_array().unwrap().len(), 19);
    assert_eq!(plan["duration_ms"], 198_000);
    for act in plan["acts"].as_array().unwrap() {
        assert_eq!(act["robots"].as_object().unwrap().len(), 7);
        assert!(act["devices"].as_array().unwrap().iter().all(|device| device["scripts"] == 1));
    }
    session.run(&["import", "crazyswarm", scenes, "--init", init, "--join", "--output", "one"]).says(0, &[]);
    session
        .run(&["check", "one/scenario.yaml", "--fleet", "one/fleet.yaml"])
        .says(0, &["no errors, 7 robots, 28 devices, 5572 steps, 198 s"]);
    // As one act, every device needs 7 scripts and holds 2; the others are sent while it plays.
    session
        .run(&["dry-run", "one/scenario.yaml", "--fleet", "one/fleet.yaml", "--verbose"])
        .says(0, &["done", "28/28", "796/796"]);
}

/// Returns the folder `sequence_trajectories`, whose seven subfolders contain nineteen scenes.
fn sequence(data: &Path) -> PathBuf {
    fn find(folder: &Path) -> Option<PathBuf> {
        for entry in std::fs::read_dir(folder).ok()?.flatten() {
            let path = entry.path();
            if path.is_dir() {
                if path.ends_with("sequence_trajectories") {
                    return Some(path);
                }
                if let Some(found) = find(&path) {
                    return Some(found);
                }
            }
        }
        None
    }
    find(&data.join("crazyswarm")).unwrap()
}
