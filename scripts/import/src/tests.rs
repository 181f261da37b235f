//! Tests of all importers: no text makes them panic, and the scenarios that they write can be read back.

use std::fs;
use std::path::PathBuf;

use proptest::prelude::*;

use super::*;
use downbeat_yaml::node::{self, Node};

mod bvh;
mod exact_times;
mod fixture;
mod fleet_files;
mod fseq;
mod joint_states;
mod midi;
mod skybrush;
mod tables;
mod urdf;
mod webots;

fn fixture_of(name: &str) -> Vec<u8> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/import").join(name);
    fs::read(path).unwrap()
}

/// Returns the keyframes of the first device with this name, each as a time in milliseconds and a value.
fn keyframes_of(imported: &Imported, name: &str) -> Vec<(f64, f64)> {
    let mut devices = imported.devices();
    let (_, device) = devices.find(|(_, device)| device.device == name).unwrap();
    keyframes(device)
}

/// Returns the keyframes of a device, each as a time in milliseconds and a value.
fn keyframes(device: &DeviceMotion) -> Vec<(f64, f64)> {
    device.keyframes.iter().map(|keyframe| (keyframe.at.as_millis_f64(), keyframe.value)).collect()
}

#[track_caller]
fn refused(format: ImportFormat, bytes: &[u8], parts: &[&str]) {
    let outcome = import_bytes(format, "test", bytes, &ImportOptions::default());
    let text = downbeat_yaml::render::render(&outcome.findings, false);
    assert!(outcome.imported.is_none(), "{:?}", outcome.notes);
    assert!(parts.iter().all(|part| text.contains(part)), "{text}");
}

const CRAZYSWARM: &str = "duration,x^0,x^1,x^2,x^3,x^4,x^5,x^6,x^7,y^0,y^1,y^2,y^3,y^4,y^5,y^6,y^7,\
z^0,z^1,z^2,z^3,z^4,z^5,z^6,z^7,yaw^0,yaw^1,yaw^2,yaw^3,yaw^4,yaw^5,yaw^6,yaw^7\n\
0.25,1,2,0,0,0,0,0,0,1,0,0,0,0,0,0,0,1,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0\n\
0.25,1,2,0,0,0,0,0,0,1,0,0,0,0,0,0,0,1,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0\n";
const WAYPOINTS: &str = "id,x[m],y[m],z[m],t[s]\n1,0,0,1,0\n1,0,1,1,2\n2,1,0,1,0\n";
const JOINTS: &str = "joint_names: [a, b]\npoints:\n- {positions: [0, 1], velocities: [0, 0], time_from_start: 0.5}\n\
- {positions: [1, 2], velocities: [0, 0], time_from_start: {sec: 1, nanosec: 500000000}}\n";
const MOTION: &str = "play_motion2:\n  ros__parameters:\n    motions:\n      up:\n        joints: [a, b]\n        \
positions: [0, 1, 2, 3]\n        times_from_start: [0.5, 1]\n";
const BITBOTS: &str = "{\"keyframes\": [{\"duration\": 1, \"pause\": 0.5, \"goals\": {\"a\": 1}},\n\
{\"duration\": 1, \"pause\": 0, \"goals\": {\"b\": 1}}, {\"duration\": 1, \"pause\": 0, \"goals\": {\"a\": 2}}]}\n";
const CSV: &str = "t[ms];a[mm];b\n0;1;\n10;2;3\n";

const ALL: [(ImportFormat, &str); 6] = [
    (ImportFormat::Crazyswarm, CRAZYSWARM),
    (ImportFormat::Waypoints, WAYPOINTS),
    (ImportFormat::JointTrajectory, JOINTS),
    (ImportFormat::PlayMotion2, MOTION),
    (ImportFormat::Bitbots, BITBOTS),
    (ImportFormat::Csv, CSV),
];

fn imported(format: ImportFormat, text: &str) -> ImportOutcome {
    let options = ImportOptions {
        rate_hz: Some(7.0),
        kind: Some("r".into()),
        columns: vec![("r/a".into(), "a".into()), ("r/b".into(), "3".into())],
        ..ImportOptions::default()
    };
    import_bytes(format, "test", text.as_bytes(), &options)
}

/// Checks the properties that the outcome of every import must have, with or without errors.
fn check_outcome(format: ImportFormat, text: &str) {
    let ImportOutcome { imported, findings, .. } = imported(format, text);
    assert!(imported.is_some() || !findings.is_empty() || text.is_empty(), "silence about {text:?}");
    assert!(!downbeat_yaml::render::render(&findings, false).is_empty());
    let Some(imported) = imported else { return };
    for (_, device) in imported.devices() {
        assert!(device.keyframes.iter().all(|keyframe| keyframe.value.is_finite()));
        assert!(device.keyframes.windows(2).all(|pair| pair[0].at < pair[1].at), "{device:?}");
    }
    let written = scenario_text(&imported, Scenes::Acts, None, None);
    let source = Source { name: "written".into(), text: written };
    assert!(node::parse(&source).is_ok(), "{}", source.text);
}

#[test]
fn every_format_is_read() {
    for (format, text) in ALL {
        let outcome = imported(format, text);
        assert_eq!(outcome.findings, [], "{format:?}");
        assert!(outcome.imported.is_some_and(|imported| imported.steps() > 0), "{format:?}");
    }
}

#[test]
fn imported_values_match_the_file() {
    let devices = |format, text| -> Vec<(String, Vec<(f64, f64)>)> {
        let imported = imported(format, text).imported.unwrap();
        imported.devices().map(|(_, device)| (device.device.clone(), keyframes(device))).collect()
    };
    let expected = [
        // Held for its pause, and again because the second keyframe omits it.
        ("a".to_owned(), vec![(1_000.0, 1.0), (1_500.0, 1.0), (2_500.0, 1.0), (3_500.0, 2.0)]),
        ("b".to_owned(), vec![(2_500.0, 1.0)]),
    ];
    assert_eq!(devices(ImportFormat::Bitbots, BITBOTS), expected);
    let expected = [("a".to_owned(), vec![(0.0, 1.0), (10.0, 2.0)]), ("b".to_owned(), vec![(10.0, 3.0)])];
    assert_eq!(devices(ImportFormat::Csv, CSV), expected);
    let expected = [
        ("a".to_owned(), vec![(500.0, 0.0), (1_000.0, 2.0)]),
        ("b".to_owned(), vec![(500.0, 1.0), (1_000.0, 3.0)]),
    ];
    assert_eq!(devices(ImportFormat::PlayMotion2, MOTION), expected);
}

#[test]
fn scalars_are_read_back_as_written() {
    for text in
        ["1", "y", "true", "a: b", "#", "", " ", "é\u{1F916}", "\u{0}\n", "- x", "null", "cf1", "1e5", "~"]
    {
        let source = Source { name: String::new(), text: format!("k: {}\n", yaml::scalar(text)) };
        let expected = Node::Map(vec![("k".into(), Node::Text(text.into()))]);
        assert_eq!(node::parse(&source).unwrap(), expected, "{text:?}");
    }
}

#[test]
fn numbers_are_read_back_unchanged() {
    for value in [0.0, -0.1, 0.087890625, 1e300, -1.5e-300, 123_456.789, 1e15, 1e-9] {
        let source = Source { name: String::new(), text: format!("k: {}\n", yaml::number(value)) };
        let expected = Node::Map(vec![("k".into(), Node::Number(value))]);
        assert_eq!(node::parse(&source).unwrap(), expected, "{value:?}");
    }
}

#[test]
fn folders_become_robots_and_files_scenes_in_numerical_order() {
    let folder = tempfile(&["1/10.csv", "1/2.csv", "2/10.csv", "2/2.csv"], CRAZYSWARM);
    let outcome =
        import(ImportFormat::Crazyswarm, std::slice::from_ref(&folder.0), &ImportOptions::default());
    let imported = outcome.imported.unwrap();
    let names: Vec<_> = imported.scenes.iter().map(|scene| scene.name.as_str()).collect();
    assert_eq!((names, imported.robots()), (vec!["scene 2", "scene 10"], vec!["cf1", "cf2"]));
    assert_eq!(steps_written(&imported, Scenes::Acts), 2 * 2 * 4 * 2);
}

/// A temporary folder that is deleted when it is dropped.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).unwrap();
    }
}

fn tempfile(names: &[&str], text: &str) -> Folder {
    let folder = Folder(std::env::temp_dir().join(format!("downbeat-import-{}", std::process::id())));
    for name in names {
        let path = folder.0.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    folder
}

/// A text with some of its bytes replaced, removed or duplicated.
fn mutated(text: &str, changes: &[(usize, u8, String)]) -> String {
    let mut chars: Vec<char> = text.chars().collect();
    for (place, kind, other) in changes {
        let at = place % (chars.len() + 1);
        match kind % 3 {
            0 if at < chars.len() => drop(chars.remove(at)),
            1 => drop(chars.splice(at..at, other.chars())),
            _ => chars.truncate(at.max(1)),
        }
    }
    chars.into_iter().collect()
}

#[test]
fn deeply_nested_brackets_are_refused_at_once() {
    let deep = format!("{{\"keyframes\": {}", "[".repeat(100_000));
    let outcome = imported(ImportFormat::Bitbots, &deep);
    assert!(outcome.findings[0].message.contains("more than 500 levels deep"), "{:?}", outcome.findings);
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in ".{0,200}", format in 0_usize..6) {
        check_outcome(ALL[format].0, &text);
    }

    #[test]
    fn mutated_files_never_panic(
        changes in prop::collection::vec(
            (any::<usize>(), 0_u8..5, "[0-9.,;:\\[\\]{}!\"e \n-]{0,4}|nan|inf|1e309|99999999999|-1|!!python/tuple |é"),
            1..6,
        ),
        format in 0_usize..6,
    ) {
        let (format, text) = ALL[format];
        let changes: Vec<_> = changes.into_iter().map(|(at, kind, t)| (at, if kind > 2 { 1 } else { kind }, t)).collect();
        check_outcome(format, &mutated(text, &changes));
    }

    #[test]
    fn broken_midi_files_never_panic(changes in prop::collection::vec((any::<usize>(), any::<u8>()), 1..8), length in any::<usize>()) {
        let mut bytes = fixture_of("beat.mid");
        for (at, byte) in changes {
            let at = at % bytes.len();
            bytes[at] = byte;
        }
        bytes.truncate(length % (2 * bytes.len()));
        let outcome = import_bytes(ImportFormat::Midi, "a.mid", &bytes, &ImportOptions::default());
        prop_assert_eq!(outcome.imported.is_some(), outcome.findings.is_empty());
        for (_, device) in outcome.imported.iter().flat_map(Imported::devices) {
            prop_assert!(device.keyframes.windows(2).all(|pair| pair[0].at < pair[1].at), "{:?}", device);
        }
    }

    #[test]
    fn times_from_arbitrary_text_never_panic(text in "[0-9]{0,30}[0-9:;.,eE+TZ -]{0,30}[0-9]{0,30}", rate in 0.001..1_000.0) {
        use TimeUnit::{Date, Frames, HoursMinutesSeconds, MinutesSeconds, MinutesSecondsMillis, Nanos, Timecode};
        for unit in [Nanos(1), Nanos(3_600_000_000_000), Frames(rate), Timecode(rate), Timecode(29.97)] {
            unit.time(&text);
        }
        for unit in [HoursMinutesSeconds, MinutesSeconds, MinutesSecondsMillis, Date] {
            unit.time(&text);
        }
    }
}

/// ROS and Webots use radians and metres.
#[test]
fn joint_values_are_converted_to_the_units_of_the_robot() {
    let device = |id: &str, unit: &str| {
        format!(
            r#"{{"id": "{id}", "name": "{id}", {unit} "interpolation": "linear", "available_control_types": {{
                "position": {{"min_value": -9000, "max_value": 9000, "granularity": 0.001}}}}}}"#
        )
    };
    let units = [
        ("turn", r#""unit": "deg","#),
        ("slide", r#""unit": "mm","#),
        ("same", r#""unit": "rad","#),
        ("own", ""),
    ];
    let devices: Vec<_> = units.iter().map(|(id, unit)| device(id, unit)).collect();
    let block = format!(r#"{{"id": "arm", "api_version": "1", "devices": [{}]}}"#, devices.join(", "));
    let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
    let straight = "joint_names: [turn, slide, same, own]\npoints:\n- {positions: [1.5708, 0.25, 1.5, 7], time_from_start: 1}\n";
    let curved = "joint_names: [turn]\npoints:\n- {positions: [0], velocities: [0], time_from_start: 0}\n\
                  - {positions: [1.5708], velocities: [0], time_from_start: 1}\n";
    let motion = "#WEBOTS_MOTION,V1.0,turn,slide,same,own\n00:01:000,pose,1.5708,0.25,1.5,7\n";
    for (format, text) in [
        (ImportFormat::JointTrajectory, straight),
        (ImportFormat::Webots, motion),
        (ImportFormat::JointTrajectory, curved),
    ] {
        let options = ImportOptions { init: Some(init.clone()), ..ImportOptions::default() };
        let imported = import_bytes(format, "test", text.as_bytes(), &options);
        let notes = &imported.notes;
        let imported = imported.imported.unwrap_or_else(|| panic!("{:?}", imported.findings));
        let value = |device: &str| keyframes_of(&imported, device).last().unwrap().1;
        assert_eq!(value("turn"), 90.000_210_5, "{format:?}");
        assert!(notes.iter().any(|note| note == "`turn` is converted from rad or m to deg"), "{notes:?}");
        if text != curved {
            assert_eq!(["slide", "same", "own"].map(value), [250.0, 1.5, 7.0], "{format:?}");
            assert!(
                !notes.iter().any(|note| note.contains("`same` is") || note.contains("`own` is")),
                "{notes:?}"
            );
        }
    }
    // Only the user knows the unit of scaled values.
    let scales = vec![("turn".to_owned(), 57.295_78)];
    let options = ImportOptions { init: Some(init), scales, ..ImportOptions::default() };
    let scaled =
        import_bytes(ImportFormat::JointTrajectory, "test", straight.as_bytes(), &options).imported.unwrap();
    assert!((keyframes_of(&scaled, "turn")[0].1 - 90.0).abs() < 0.001);
    let unknown =
        import_bytes(ImportFormat::JointTrajectory, "test", straight.as_bytes(), &ImportOptions::default());
    assert!(unknown.imported.unwrap().devices().all(|(_, device)| device.unit.is_empty()));
}
