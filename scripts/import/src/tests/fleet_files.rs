//! Imported drones get a body and a minimum distance, so that `check` detects paths that come too close.

use super::{CRAZYSWARM, WAYPOINTS, fixture_of};
use crate::{ImportFormat, ImportOptions, ImportOutcome, Scenes, files_of, import_bytes};

fn fleet(format: ImportFormat, bytes: &[u8], maps: &[(&str, &str)]) -> (String, ImportOutcome) {
    let columns = maps.iter().map(|(to, column)| ((*to).to_owned(), (*column).to_owned())).collect();
    let options = ImportOptions { columns, ..ImportOptions::default() };
    let outcome = import_bytes(format, "test", bytes, &options);
    let imported = outcome.imported.as_ref().unwrap_or_else(|| panic!("{:?}", outcome.findings));
    let files = files_of(imported, Scenes::Acts, None);
    (files.iter().find(|file| file.path == "fleet.yaml").unwrap().text.clone(), outcome)
}

const BODY: &str = "body: {x: x, y: y, z: z}";
const AXES: [(&str, &str); 3] = [("r/x", "x"), ("r/y", "y"), ("r/z", "z")];

#[test]
fn robots_with_x_y_and_z_get_a_body_and_a_distance_with_its_source() {
    let csv = "t[s],x[mm],y[mm],z[mm]\n0,0,0,0\n1,1,1,1\n";
    for (format, bytes, maps) in [
        (ImportFormat::Waypoints, WAYPOINTS.as_bytes(), &[][..]),
        (ImportFormat::Crazyswarm, CRAZYSWARM.as_bytes(), &[]),
        (ImportFormat::Csv, csv.as_bytes(), &AXES),
    ] {
        let (text, _) = fleet(format, bytes, maps);
        assert!(text.contains(BODY), "{format:?}\n{text}");
        assert!(text.contains("space: {distance: 0.24}") && text.contains("Crazyflie"), "{format:?}\n{text}");
    }
    let (text, _) = fleet(ImportFormat::Skybrush, &fixture_of("two_drones.skyc"), &[]);
    assert_eq!(text.matches(BODY).count(), 2, "{text}");
    assert!(text.contains("space: {distance: 3}") && text.contains("Skybrush"), "{text}");
}

#[test]
fn position_in_unknown_unit_is_noted_and_gives_no_body() {
    let csv = "t[s],x,y,z\n0,0,0,0\n1,1,1,1\n";
    let (text, outcome) = fleet(ImportFormat::Csv, csv.as_bytes(), &AXES);
    assert!(!text.contains("body") && !text.contains("space"), "{text}");
    assert!(
        outcome.notes.iter().any(|note| note.contains("unit of `x`, `y` and `z`")),
        "{:?}",
        outcome.notes
    );
    let csv = "t[s],x[m],y[m]\n0,0,0\n1,1,1\n";
    let (text, outcome) = fleet(ImportFormat::Csv, csv.as_bytes(), &AXES[..2]);
    assert!(!text.contains("body"), "a plane is no space: {text}");
    assert!(!outcome.notes.iter().any(|note| note.contains("body")), "{:?}", outcome.notes);
}
