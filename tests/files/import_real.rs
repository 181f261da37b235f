//! Imports complete sets of real files, and checks their values and step counts. `DOWNBEAT_DATA` names the folder of the files.

use std::path::{Path, PathBuf};

use downbeat_import::{
    DeviceMotion, ImportFormat, ImportOptions, ImportOutcome, Imported, Scenes, fixture, steps_written,
};
use downbeat_scripts::{Source, init_of};

use stage::session::{Session, root};
use urrcp::Span;

/// Returns the folder of the real files. Without this folder, the tests are skipped.
fn data() -> Option<PathBuf> {
    std::env::var_os("DOWNBEAT_DATA").map(PathBuf::from)
}

fn drones(data: &Path) -> PathBuf {
    data.join("crazyswarm/ros_ws/src/crazyswarm/scripts")
}

fn demos(data: &Path) -> PathBuf {
    data.join("bitbots-animations/bitbots_demo_animations")
}

fn outcome(format: ImportFormat, path: &Path, options: &ImportOptions) -> ImportOutcome {
    downbeat_import::import(format, &[path.to_path_buf()], options)
}

#[track_caller]
fn imported(format: ImportFormat, path: &Path, options: &ImportOptions) -> Imported {
    let outcome = outcome(format, path, options);
    assert_eq!(outcome.findings, [], "{}", path.display());
    outcome.imported.unwrap()
}

fn rate(rate_hz: f64) -> ImportOptions {
    ImportOptions { rate_hz: Some(rate_hz), ..ImportOptions::default() }
}

/// Returns the minimum and the maximum value over all devices of this name.
fn range(imported: &Imported, name: &str) -> (f64, f64) {
    let devices = imported.devices().filter(|(_, device)| device.device == name);
    let values: Vec<f64> = devices.flat_map(|(_, d)| d.keyframes.iter().map(|k| k.value)).collect();
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    (least, values.iter().copied().fold(f64::NEG_INFINITY, f64::max))
}

#[track_caller]
fn check_range(imported: &Imported, name: &str, least: f64, most: f64) {
    let (found_least, found_most) = range(imported, name);
    assert!(
        (found_least - least).abs() < 0.006 && (found_most - most).abs() < 0.006,
        "{name} {found_least}..{found_most}"
    );
}

/// Returns the polynomial pieces of a file as numbers, read without the importer.
fn pieces(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let numbers = |line: &str| line.split(',').filter_map(|cell| cell.trim().parse().ok()).collect();
    text.lines().skip(1).map(numbers).collect()
}

/// Evaluates a piecewise polynomial by summing powers, without Horner's rule. Where two pieces meet, either value is valid, so both are
/// returned.
fn polynomial(pieces: &[Vec<f64>], axis: usize, at_s: f64) -> [f64; 2] {
    let mut start = 0.0;
    let mut values = Vec::new();
    for piece in pieces {
        let local = at_s - start;
        if local >= -1e-9 && local <= piece[0] + 1e-9 {
            let power = |(i, c): (i32, &f64)| c * local.powi(i);
            values.push((0..).zip(&piece[1 + 8 * axis..9 + 8 * axis]).map(power).sum::<f64>());
        }
        start += piece[0];
    }
    [values[0], values[values.len() - 1]]
}

#[track_caller]
fn check_samples(pieces: &[Vec<f64>], axis: usize, device: &DeviceMotion) {
    for keyframe in &device.keyframes {
        let expected = polynomial(pieces, axis, keyframe.at.as_nanos() as f64 / 1e9);
        assert!(
            expected.iter().any(|value| (value - keyframe.value).abs() <= 1e-6),
            "{keyframe:?}, {expected:?}"
        );
    }
}

#[test]
fn swap_of_six_drones_is_imported() {
    let Some(data) = data() else { return };
    let folder = drones(&data).join("swap6v_pps");
    let swap = imported(ImportFormat::Crazyswarm, &folder, &ImportOptions::default());
    assert_eq!((swap.robots().len(), swap.steps(), swap.duration()), (6, 432, Span::from_millis(4_250)));
    assert_eq!(steps_written(&swap, Scenes::Acts), 6 * 4 * 17, "a piece each, not a straight way");
    assert!(
        swap.devices()
            .all(|(_, d)| d.keyframes.len() == 18 && d.keyframes[17].at == Span::from_millis(4_250))
    );
    for (name, least, most) in [("x", -3.67, -3.01), ("y", -2.0, 0.0), ("z", 1.13, 2.87), ("yaw", 0.0, 0.0)] {
        check_range(&swap, name, least, most);
    }
    let fast = imported(ImportFormat::Crazyswarm, &folder, &rate(50.0));
    assert!(fast.devices().all(|(_, device)| device.keyframes.len() == 214));
    for import in [&swap, &fast] {
        for (index, robot) in import.scenes[0].robots.iter().enumerate() {
            let pieces = pieces(&folder.join(format!("pp{}.csv", index + 1)));
            assert_eq!(pieces.len(), 17);
            robot.devices.iter().enumerate().for_each(|(axis, device)| check_samples(&pieces, axis, device));
        }
    }
}

#[test]
fn sequence_of_nineteen_scenes_is_imported() {
    let Some(data) = data() else { return };
    let folder = drones(&data).join("sequence_trajectories");
    let scenes = imported(ImportFormat::Crazyswarm, &folder, &rate(10.0));
    let lengths: Vec<_> =
        scenes.scenes.iter().map(|scene| scene.duration().as_nanos() / 1_000_000_000).collect();
    assert_eq!(lengths, [11, 16, 9, 10, 8, 10, 11, 9, 9, 9, 12, 10, 10, 10, 10, 10, 8, 7, 19]);
    assert_eq!((scenes.robots().len(), scenes.duration()), (7, Span::from_millis(198_000)));
    assert_eq!(steps_written(&scenes, Scenes::Joined), 1_981 * 7 * 4);
    assert_eq!(1_981 * 7 * 3, 41_601);
    for (name, least, most) in [("x", -1.50, 2.28), ("y", -1.07, 1.25), ("z", 0.0, 2.48)] {
        check_range(&scenes, name, least, most);
    }
    for pair in scenes.scenes.windows(2) {
        for (before, after) in pair[0].robots.iter().zip(&pair[1].robots) {
            assert_eq!(before.duration(), pair[0].duration(), "equal across robots");
            for (end, begin) in before.devices.iter().zip(&after.devices) {
                let gap = end.keyframes[end.keyframes.len() - 1].value - begin.keyframes[0].value;
                assert!(gap.abs() <= 3.3e-6, "{gap}");
            }
        }
    }
    let pieces = imported(ImportFormat::Crazyswarm, &folder, &ImportOptions::default());
    let boundaries = |scene: &downbeat_import::Scene| scene.robots[0].devices[0].keyframes.len() - 1;
    assert_eq!(pieces.scenes.iter().map(boundaries).sum::<usize>(), 198);
}

#[test]
fn drones_in_both_shows_keep_their_documented_distance() {
    let Some(data) = data() else { return };
    for show in ["swap6v_pps", "sequence_trajectories"] {
        let session = Session::new();
        let folder = drones(&data).join(show).display().to_string();
        session.run(&["import", "crazyswarm", &folder, "--output", "out"]).says(0, &[]);
        let plan = session.run(&["plan", "out/scenario.yaml", "--format", "json"]).json();
        let acts = plan["acts"].as_array().unwrap();
        let distances = acts.iter().map(|act| act["closest"]["distance_m"].as_f64().unwrap());
        let closest = distances.fold(f64::INFINITY, f64::min);
        assert!((0.28..0.31).contains(&closest), "{show}: {closest}");
    }
}

#[test]
fn trajectory_with_too_many_pieces_is_rejected() {
    let Some(data) = data() else { return };
    let folder = data.join("crazyswarm/crazyflie_examples/crazyflie_examples/data");
    let both = folder.join("multi_trajectory");
    let refused = outcome(ImportFormat::Crazyswarm, &both, &ImportOptions::default());
    assert_eq!(refused.findings.len(), 1, "{:?}", refused.findings);
    assert!(refused.findings[0].message.contains("32 pieces, but a robot can store at most 31"));
    assert!(refused.findings[0].file.ends_with("traj0.csv"));
    let one = imported(ImportFormat::Crazyswarm, &both.join("traj1.csv"), &ImportOptions::default());
    assert_eq!((one.steps(), one.duration()), (17 * 4, Span::from_micros(24_984_019)));
    let options = ImportOptions { pieces_max: Some(32), ..ImportOptions::default() };
    let taken = outcome(ImportFormat::Crazyswarm, &both, &options);
    assert_eq!(taken.imported.unwrap().duration(), Span::from_micros(56_528_067));
    assert!(
        taken.notes.iter().any(|note| note.contains("robots end at different times")),
        "{:?}",
        taken.notes
    );
    imported(ImportFormat::Crazyswarm, &folder.join("figure8.csv"), &ImportOptions::default());
}

#[test]
fn waypoints_of_three_drones_are_imported() {
    let Some(data) = data() else { return };
    let waypoints =
        imported(ImportFormat::Waypoints, &drones(&data).join("waypoints.csv"), &ImportOptions::default());
    let times = |device: &DeviceMotion| {
        device.keyframes.iter().map(|k| k.at.as_nanos() / 1_000_000).collect::<Vec<_>>()
    };
    let found: Vec<_> = waypoints.scenes[0].robots.iter().map(|robot| times(&robot.devices[0])).collect();
    assert_eq!(found, [vec![0, 2_000, 4_000], vec![0, 4_000], vec![0, 2_000, 4_000]]);
    assert_eq!(waypoints.steps(), 24);
}

#[test]
fn humanoid_animations_are_imported() {
    let Some(data) = data() else { return };
    let options = ImportOptions::default();
    let dance = imported(ImportFormat::Bitbots, &demos(&data).join("schnup_dance.json"), &options);
    assert_eq!((dance.steps() - dance.held, dance.duration()), (760, Span::from_millis(40_500)));
    assert_eq!(dance.devices().count(), 20);
    let all: Vec<f64> = dance
        .devices()
        .flat_map(|(_, d)| d.keyframes.iter().take(36).chain(&d.keyframes[37..]))
        .map(|k| k.value)
        .collect();
    let least = all.iter().copied().fold(f64::INFINITY, f64::min);
    let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    assert!((least + 128.8).abs() < 0.06 && (most - 127.6).abs() < 0.06, "{least}..{most}");
    let on_grid = |values: &[f64]| values.iter().filter(|v| (**v / 0.087890625).fract() == 0.0).count();
    // Leaves out the repeated values of the two pauses.
    let own: Vec<f64> = dance
        .devices()
        .flat_map(|(_, d)| {
            d.keyframes
                .iter()
                .filter(|k| ![36_500, 39_500].map(Span::from_millis).contains(&k.at))
                .map(|k| k.value)
        })
        .collect();
    assert_eq!((own.len(), on_grid(&own)), (760, 722));
    let wolfgang =
        data.join("bitbots-animations/bitbots_robot/wolfgang_animations/animations/misc/cheering.json");
    let cheering = imported(ImportFormat::Bitbots, &wolfgang, &options);
    assert_eq!((cheering.devices().count(), cheering.duration()), (20, Span::from_millis(12_000)));
    let jogram = imported(ImportFormat::Bitbots, &demos(&data).join("jogram.json"), &options);
    assert_eq!((jogram.devices().count(), jogram.duration()), (24, Span::from_millis(54_200)));
    let still = outcome(ImportFormat::Bitbots, &demos(&data).join("Projektwoche2/test_02.json"), &options);
    assert_eq!(still.findings.len(), 1);
    assert!(still.findings[0].message.starts_with("keyframe 10 has a duration of 0"), "{:?}", still.findings);
}

#[test]
fn dance_exceeds_exactly_five_limits() {
    let Some(data) = data() else { return };
    let session = Session::new();
    let dance = demos(&data).join("schnup_dance.json").display().to_string();
    let init = root().join("scripts/examples/robots/wolfgang.yaml").display().to_string();
    session.run(&["import", "bitbots", &dance, "--init", &init, "--output", "out"]).says(0, &["800 steps"]);
    let json = session.run(&["check", "out/scenario.yaml", "--format", "json"]).json();
    let findings = json["findings"].as_array().unwrap().clone();
    let mut limits: Vec<_> =
        findings.iter().filter(|f| f["code"] == "DB0011").map(|f| f["message"].as_str().unwrap()).collect();
    limits.sort_unstable();
    let expected = [
        ("keyframe 1: -50.44921875 ", "`RShoulderRoll`"),
        ("keyframe 22: -94.04296875 ", "`RElbow`"),
        ("keyframe 27: 45.52734375 ", "`LShoulderRoll`"),
        ("keyframe 28: -45.703125 ", "`RShoulderRoll`"),
        ("keyframe 29: 45.087890625 ", "`LShoulderRoll`"),
    ];
    assert_eq!(limits.len(), 5, "{limits:#?}");
    for (found, (beginning, joint)) in limits.iter().zip(expected) {
        assert!(found.starts_with(beginning) && found.contains(joint), "{found}");
    }
}

#[test]
fn tiago_motions_are_imported() {
    let Some(data) = data() else { return };
    let folder = data.join("tiago-motions/tiago_bringup/config/motions");
    for (name, motions, positions) in
        [("pal-gripper", 17, 351), ("pal-hey5", 20, 394), ("robotiq-2f-85", 17, 343), ("no-arm", 2, 17)]
    {
        let path = folder.join(format!("tiago_motions_{name}.yaml"));
        let outcome = outcome(ImportFormat::PlayMotion2, &path, &ImportOptions::default());
        assert_eq!(outcome.findings, []);
        let tiago = outcome.imported.unwrap();
        assert_eq!((tiago.scenes.len(), tiago.steps()), (motions, positions), "{name}");
        let most = tiago.scenes.iter().map(|scene| scene.robots[0].devices.len()).max();
        assert!(most <= Some(11), "{most:?}");
        let longest = tiago.devices().map(|(_, device)| device.keyframes.len()).max();
        assert!(longest <= Some(8), "{longest:?}");
        assert!(tiago.scenes.iter().all(|scene| scene.duration() <= Span::from_millis(21_000)));
        let zero = outcome
            .notes
            .iter()
            .any(|note| note.contains("`wave`, `offer`, `shake_hands`, `pick_from_floor`"));
        assert_eq!(zero, name != "no-arm", "{:?}", outcome.notes);
    }
}

#[test]
fn yaml_tags_of_other_programs_are_rejected() {
    let Some(data) = data() else { return };
    for file in ["mapf-yaml/centralized/cbs/input.yaml", "mapf-yaml/centralized/sipp/input.yaml"] {
        let refused = outcome(ImportFormat::JointTrajectory, &data.join(file), &ImportOptions::default());
        assert!(
            refused.findings.iter().all(|finding| finding.code.as_str() == "DB0064"),
            "{:?}",
            refused.findings
        );
        assert!(!refused.findings.is_empty());
    }
}

/// Returns all fixtures of the Open Fixture Library.
fn fixtures(data: &Path) -> Vec<PathBuf> {
    let entries = |folder: &Path| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let folders = entries(&data.join("open-fixture-library/fixtures")).filter(|path| path.is_dir());
    folders.flat_map(|folder| entries(&folder).collect::<Vec<_>>()).collect()
}

#[test]
fn all_modes_of_all_fixtures_are_imported() {
    let Some(data) = data() else { return };
    let (mut modes, mut devices, mut redirects, mut files) = (0, 0, 0, 0);
    for path in fixtures(&data) {
        let source = Source::read(&path).unwrap();
        let json: serde_json::Value = serde_json::from_str(&source.text).unwrap();
        files += 1;
        if json.get("redirectTo").is_some() {
            let refused = fixture(&source, None, None);
            assert!(refused.findings[0].message.contains("only redirects"), "{:?}", refused.findings);
            redirects += 1;
            continue;
        }
        for mode in json["modes"].as_array().unwrap() {
            let name = mode["name"].as_str().unwrap();
            let outcome = fixture(&source, Some(name), None);
            assert_eq!(outcome.findings, [], "{} {name}", path.display());
            let block = Source { name: "block.yaml".into(), text: outcome.files[0].text.clone() };
            let block =
                init_of(&block).unwrap_or_else(|found| panic!("{} {name}: {found:?}", path.display()));
            assert_eq!(block.devices.len(), outcome.devices);
            for device in block.devices.iter() {
                let limits = device.available_control_types.limits(urrcp::ControlType::Position).unwrap();
                let default = device.default_value.unwrap();
                assert!(
                    limits.contains(default) && limits.on_grid(default),
                    "{} {}",
                    path.display(),
                    device.id
                );
            }
            modes += 1;
            devices += outcome.devices;
        }
    }
    let counts = format!("{files} files, {redirects} redirects, {modes} modes, {devices} devices");
    assert!(files >= 600 && modes > files && devices > modes, "{counts}");
}
