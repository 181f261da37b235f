//! Times are imported exactly to the nanosecond, in every format.

use super::{ALL, fixture_of, refused};
use crate::{ImportFormat, ImportOptions, Scenes, import_bytes, scenario_text};

/// Imports `bytes`, and returns the scenario as text and the notes of the import.
fn written(format: ImportFormat, bytes: &[u8], rate_hz: Option<f64>) -> (String, Vec<String>) {
    let columns = match format {
        ImportFormat::Csv => vec![("r/a".to_owned(), "a".to_owned())],
        _ => Vec::new(),
    };
    let options = ImportOptions { columns, rate_hz, ..ImportOptions::default() };
    let outcome = import_bytes(format, "test", bytes, &options);
    let imported = outcome.imported.unwrap_or_else(|| panic!("{:?}", outcome.findings));
    (scenario_text(&imported, Scenes::Acts, None, None), outcome.notes)
}

const BVH: &str =
    "HIERARCHY\nROOT a\n{\nCHANNELS 1 Xrotation\n}\nMOTION\nFrames: 4\nFrame Time: 0.0083333\n0\n1\n2\n3\n";

#[test]
fn times_keep_fractions_of_a_millisecond() {
    use ImportFormat::{Bitbots, Bvh, Crazyswarm, Csv, JointTrajectory, PlayMotion2, Waypoints};
    let of = |which: ImportFormat| ALL.iter().find(|(format, _)| *format == which).unwrap().1;
    let csv = "t[s],a\n0,0\n0.0083333,1\n0.0086,2\n1.000000001,3\n";
    let sampled = of(Crazyswarm).to_owned();
    for (format, text, rate, parts) in [
        (
            Bvh,
            BVH.to_owned(),
            None,
            &["at: 8.3333ms, to: 1", "at: 16.6666ms, to: 2", "at: 24.9999ms, to: 3"][..],
        ),
        (Csv, csv.to_owned(), None, &["at: 8.3333ms, to: 1", "at: 8.6ms, to: 2", "at: 1.000000001s, to: 3"]),
        (Waypoints, of(Waypoints).replace(",1,1,2\n", ",1,1,2.0004\n"), None, &["at: 2.0004s, to: 1"]),
        (
            JointTrajectory,
            of(JointTrajectory).replace("500000000", "8333333"),
            Some(30.0),
            &["at: 1.008333333s, to: 1"],
        ),
        (PlayMotion2, of(PlayMotion2).replace("[0.5, 1]", "[0.5, 0.50025]"), None, &["at: 500.25ms, to: 2"]),
        (
            Bitbots,
            of(Bitbots).replace("\"duration\": 1,", "\"duration\": 0.0083333,"),
            None,
            &["at: 8.3333ms, to: 1"],
        ),
        (Crazyswarm, sampled.clone(), Some(30.0), &["at: 33.333333ms, to: 1.0666667", "at: 66.666667ms"]),
        (Crazyswarm, sampled.replace("\n0.25,", "\n0.0005,"), None, &["for: 500us, coefficients"]),
    ] {
        let (found, notes) = written(format, text.as_bytes(), rate);
        for part in parts {
            assert!(found.contains(part), "{format:?}: no `{part}` in\n{found}");
        }
        assert!(!notes.iter().any(|note| note.contains("whole milliseconds")), "{notes:?}");
    }
    let (found, _) = written(ImportFormat::Midi, &fixture_of("beat.mid"), None);
    assert!(found.contains("at: 333.3335ms, to: 0"), "{found}");
}

#[test]
fn only_equal_times_are_refused_as_duplicates() {
    let text = "t[s],a\n0.0001,1\n0.0004,2\n0.0004,3\n";
    let outcome = import_bytes(
        ImportFormat::Csv,
        "test",
        text.as_bytes(),
        &ImportOptions { columns: vec![("r/a".into(), "a".into())], ..ImportOptions::default() },
    );
    let found: Vec<_> =
        outcome.findings.iter().map(|finding| (finding.code.as_str(), finding.line)).collect();
    assert_eq!(found, [("DB0063", 4)], "{:?}", outcome.findings);
    let still = BVH.replace("0.0083333", "0.0000000001");
    refused(ImportFormat::Bvh, still.as_bytes(), &["DB0062", "a frame lasts"]);
}

#[test]
fn jumps_of_about_a_turn_are_noted_with_the_unwrap_option() {
    let bvh = BVH.replace("\n0\n1\n2\n3\n", "\n170\n-175\n-160\n175\n");
    let (_, notes) = written(ImportFormat::Bvh, bvh.as_bytes(), None);
    let jumps: Vec<_> = notes.iter().filter(|note| note.contains("--unwrap a.Xrotation=360")).collect();
    assert_eq!(jumps.len(), 1, "{notes:?}");
    assert!(jumps[0].contains("2 times, first at 8.333 ms"), "{}", jumps[0]);
    // Radians, in another format; and a fast turn without a jump.
    let csv = "t[s],a[rad]\n0,3.1\n0.02,-3.1\n1,3.1\n";
    let (_, notes) = written(ImportFormat::Csv, csv.as_bytes(), None);
    assert!(
        notes.iter().any(|note| note.contains("--unwrap a=6.283185307179586") && note.contains("once")),
        "{notes:?}"
    );
    let (_, notes) = written(ImportFormat::Csv, b"t[s],a[deg]\n0,-170\n1,170\n", None);
    assert!(!notes.iter().any(|note| note.contains("--unwrap")), "{notes:?}");
}
