//! Compiled drone shows: their contents are imported, and archives that contradict themselves are rejected.

use std::io::{Cursor, Write};

use serde_json::{Value, json};
use urrcp::Span;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::*;

fn fixture() -> Vec<u8> {
    fixture_of("two_drones.skyc")
}

fn archive(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn show(drones: &Value) -> Vec<u8> {
    let show = json!({"version": 1, "swarm": {"drones": drones}});
    archive(&[("show.json", show.to_string().as_bytes())])
}

fn one(trajectory: &Value) -> Vec<u8> {
    show(&json!([{"settings": {"trajectory": trajectory}}]))
}

fn read(bytes: &[u8]) -> ImportOutcome {
    import_bytes(ImportFormat::Skybrush, "show.skyc", bytes, &ImportOptions::default())
}

#[track_caller]
fn refused(bytes: &[u8], parts: &[&str]) {
    let outcome = read(bytes);
    let text = downbeat_yaml::render::render(&outcome.findings, false);
    assert!(outcome.imported.is_none() && !outcome.findings.is_empty(), "{:?}", outcome.notes);
    assert!(parts.iter().all(|part| text.contains(part)), "{text}");
}

/// Returns the point of a Bezier curve at `share` (0 to 1) by de Casteljau's geometric construction. The importer computes it
/// differently, with polynomials.
fn drawn(points: &[f64], share: f64) -> f64 {
    let mut points = points.to_vec();
    while points.len() > 1 {
        points = points.windows(2).map(|pair| pair[0] + (pair[1] - pair[0]) * share).collect();
    }
    points[0]
}

#[test]
fn curves_are_reproduced_within_a_picometre() {
    let bytes = fixture();
    let mut zip = zip::ZipArchive::new(Cursor::new(&bytes)).unwrap();
    let file = zip.by_name("drones/Drone 1/trajectory.json").unwrap();
    let trajectory: Value = serde_json::from_reader(file).unwrap();
    let imported = read(&bytes).imported.unwrap();
    let mut worst: f64 = 0.0;
    for axis in 0..3 {
        let device = &imported.scenes[0].robots[0].devices[axis];
        let Course::Pieces(pieces) = &device.course else { panic!("{device:?}") };
        let points = trajectory["points"].as_array().unwrap();
        assert_eq!(pieces.len(), points.len(), "a wait for the takeoff, and each way");
        assert_eq!(
            pieces[0],
            Piece {
                length: Span::from_millis(1_500),
                coefficients: vec![points[0][1][axis].as_f64().unwrap()]
            }
        );
        for (piece, pair) in pieces[1..].iter().zip(points.windows(2)) {
            let seconds = pair[1][0].as_f64().unwrap() - pair[0][0].as_f64().unwrap();
            assert_eq!(piece.length, Span::from_millis_f64(seconds * 1e3));
            let controls = pair[1][2].as_array().unwrap().iter().map(|control| &control[axis]);
            let all = std::iter::once(&pair[0][1][axis]).chain(controls).chain([&pair[1][1][axis]]);
            let all: Vec<f64> = all.map(|value| value.as_f64().unwrap()).collect();
            for step in 0..=100 {
                let share = f64::from(step) / 100.0;
                let sum = piece.coefficients.iter().rev().fold(0.0, |sum, c| sum * (seconds * share) + c);
                worst = worst.max((sum - drawn(&all, share)).abs());
            }
        }
    }
    assert!(worst < 1e-12, "{worst}");
}

#[test]
fn straight_paths_headings_and_lamps_are_imported() {
    let outcome = read(&fixture());
    let imported = outcome.imported.unwrap();
    assert_eq!(imported.robots(), ["Drone 1", "Drone 2"]);
    let device = |robot: usize, name: &str| {
        let mut devices = imported.scenes[0].robots[robot].devices.iter();
        devices.find(|device| device.device == name).unwrap()
    };
    let keyframes: Vec<_> =
        device(1, "z").keyframes.iter().map(|k| (k.at.as_millis_f64(), k.value)).collect();
    assert_eq!(keyframes, [(0.0, 0.0), (2_000.0, 4.0), (10_000.0, 4.0), (12_000.0, 0.0)]);
    assert_eq!((&device(1, "z").course, device(0, "yaw").unit.as_str()), (&Course::Straight, "deg"));
    let Course::Several(colors) = &device(1, "lamp").course else { panic!() };
    assert_eq!((&colors[0], &colors[colors.len() - 1]), (&vec![128.0; 3], &vec![0.0; 3]));
    let all = [
        "lights fade in steps, one every 20 ms",
        "left out `drones' home`",
        "heading times are counted from the start",
    ];
    assert!(
        all.iter().all(|part| outcome.notes.iter().any(|note| note.contains(part))),
        "{:?}",
        outcome.notes
    );
}

#[test]
fn invalid_shows_are_refused_with_the_position() {
    refused(b"no zip", &["DB0001", "this is not a ZIP archive"]);
    refused(&archive(&[("other.json", b"{}")]), &["show.skyc/show.json", "no such file", "`other.json`"]);
    refused(&archive(&[("show.json", b"{\"version\": 1,")]), &["DB0002", "show.skyc/show.json:1:"]);
    refused(&archive(&[("show.json", b"{\"version\": 2}")]), &["DB0066", "show.json:1:13", "version 1"]);
    refused(&show(&json!([])), &["DB0068", "0 drones"]);
    refused(
        &show(&json!([{"settings": {"trajectory": {"$ref": "./gone.json#"}}}])),
        &["show.skyc/gone.json"],
    );
    let way = |points: Value| one(&json!({"version": 1, "points": points}));
    refused(&way(json!([[0, [0, 0, 0], []], [0, [1, 0, 0], []]])), &["DB0062", "point 2 at 0 s"]);
    refused(&way(json!([[2, [0, 0, 0], []], [1, [0, 0, 0], []]])), &["DB0062", "times must increase"]);
    refused(&way(json!([[0, [0, 0], []]])), &["DB0066", "2 coordinates"]);
    refused(&way(json!([[0, [0, "high", 0], []]])), &["DB0061", "the text `high`"]);
    refused(&way(json!([[-1, [0, 0, 0], []]])), &["DB0062"]);
    refused(&way(json!([])), &["no points"]);
    let controls: Vec<_> = (0..7).map(|_| json!([0, 0, 0])).collect();
    refused(&way(json!([[0, [0, 0, 0], []], [1, [0, 0, 0], controls]])), &["7 control points"]);
    let nan = r#"{"version": 1, "swarm": {"drones": [{"settings": {"trajectory": {"version": 1, "points": [[0, [NaN, 0, 0]]]}}}]}}"#;
    refused(&archive(&[("show.json", nan.as_bytes())]), &["DB0002", "show.json:1:"]);
    let lamp = |data: &str| {
        let way = json!({"version": 1, "points": [[0, [0, 0, 0]], [1, [1, 0, 0]]]});
        show(&json!([{"settings": {"trajectory": way, "lights": {"version": 1, "data": data}}}]))
    };
    refused(&lamp("%"), &["DB0066", "not base64"]);
    refused(&lamp("EgA="), &["jumps at byte 0"]);
    // Nested loops of 255 repetitions.
    refused(&lamp("DP8M/wz/DP8HAQ0NDQ0A"), &["more than 200000 commands"]);
}

#[test]
fn archives_that_expand_excessively_are_refused() {
    let zeros = vec![b' '; 9 << 20];
    let bomb = archive(&[("show.json", &zeros)]);
    assert!(bomb.len() < 20_000);
    refused(&bomb, &["show.json", "more than 8388608 bytes"]);
    // Every drone refers to the same large file.
    let drones: Vec<_> = (0..40).map(|_| json!({"settings": {"trajectory": {"$ref": "big.json"}}})).collect();
    let show = json!({"version": 1, "swarm": {"drones": drones}}).to_string();
    let mut big = br#"{"version": 1, "points": [[0, [0, 0, 0]]]"#.to_vec();
    big.resize(6 << 20, b' ');
    big.push(b'}');
    refused(
        &archive(&[("show.json", show.as_bytes()), ("big.json", &big)]),
        &["the unpacked archive has more than 134217728 bytes"],
    );
    let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    refused(&archive(&[("show.json", deep.as_bytes())]), &["DB0002", "recursion limit"]);
}
