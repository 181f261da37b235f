//! Webots' motions: values, `*` in place of a value, and errors.

use super::{fixture_of, keyframes_of, refused};
use crate::{ImportFormat, ImportOptions, import_bytes};

#[test]
fn motion_is_imported_and_a_star_keeps_the_joint_position() {
    let bytes = fixture_of("hand_high.motion");
    let outcome = import_bytes(ImportFormat::Webots, "hand_high.motion", &bytes, &ImportOptions::default());
    let imported = outcome.imported.unwrap();
    let lower = [(0.0, -0.5), (1_000.0, 0.5), (5_000.0, 0.5), (5_500.0, 0.5), (6_000.0, -0.5)];
    assert_eq!(keyframes_of(&imported, "ArmLowerL"), lower);
    let upper = [
        (0.0, 0.2),
        (1_000.0, 0.2),
        (2_000.0, 0.77),
        (3_000.0, 0.2),
        (4_000.0, 0.77),
        (5_000.0, 0.2),
        (5_500.0, 0.2),
        (6_000.0, 0.2),
    ];
    assert_eq!(keyframes_of(&imported, "ArmUpperL"), upper);
    assert!(
        outcome.notes.iter().any(|note| note.contains("10 values written as `*`")),
        "{:?}",
        outcome.notes
    );
}

#[test]
fn invalid_motions_are_refused_with_the_line() {
    let check = |text: &str, parts: &[&str]| refused(ImportFormat::Webots, text.as_bytes(), parts);
    check("", &["the file is empty"]);
    check("#WEBOTS,V1.0,a\n", &["DB0060", "test:1:1", "`#WEBOTS_MOTION`"]);
    check("#WEBOTS_MOTION,V2.0,a\n", &["test:1:16", "`V1.0`"]);
    check("#WEBOTS_MOTION,V1.0\n", &["no joints"]);
    check("#WEBOTS_MOTION,V1.0,a\n", &["no poses"]);
    check("#WEBOTS_MOTION,V1.0,a\n00:00:000,p\n", &["test:2:", "2 columns, not 3"]);
    check(
        "#WEBOTS_MOTION,V1.0,a\n00:01:000,p,1\n00:01:000,q,2\n",
        &["DB0063", "test:3:1", "duplicate time 1 s"],
    );
    check("#WEBOTS_MOTION,V1.0,a\n1:2:3:4,p,1\n", &["DB0061", "minutes:seconds:milliseconds"]);
    check("#WEBOTS_MOTION,V1.0,a\n00:00:000,p,nan\n", &["DB0061", "test:2:13", "NaN"]);
    check("#WEBOTS_MOTION,V1.0,a\n999999999:0:0,p,1\n", &["DB0061"]);
    check("#WEBOTS_MOTION,V1.0,a,a\n00:00:000,p,1,1\n", &["DB0067", "two columns move `a`"]);
}
