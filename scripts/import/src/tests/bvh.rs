//! Motion capture: every channel of every frame is imported.

use super::{fixture_of, keyframes_of, refused};
use crate::{ImportFormat, ImportOptions, import_bytes};

#[test]
fn every_value_of_every_frame_is_imported_unchanged() {
    let bytes = fixture_of("nod.bvh");
    let options = ImportOptions::default();
    let outcome = import_bytes(ImportFormat::Bvh, "nod.bvh", &bytes, &options);
    let imported = outcome.imported.unwrap();
    let names: Vec<_> = imported.devices().map(|(_, device)| device.device.as_str()).collect();
    assert_eq!((names.len(), names[0], names[8]), (9, "Hips.Xposition", "Chest.Yrotation"));
    let text = String::from_utf8(bytes).unwrap();
    let lines: Vec<&str> = text.lines().skip_while(|line| !line.starts_with("Frame Time")).skip(1).collect();
    for (column, name) in names.iter().enumerate() {
        let found = keyframes_of(&imported, name);
        assert_eq!(found.len(), lines.len());
        for (frame, (line, (at_ms, value))) in lines.iter().zip(found).enumerate() {
            let expected: f64 = line.split(' ').nth(column).unwrap().parse().unwrap();
            assert_eq!((at_ms, value), ((frame as f64 * 33.3333 * 1e6).round() / 1e6, expected));
        }
    }
    let unwraps = vec![("Chest.Yrotation".to_owned(), 360.0)];
    let turned =
        import_bytes(ImportFormat::Bvh, "nod.bvh", text.as_bytes(), &ImportOptions { unwraps, ..options });
    assert!(turned.imported.is_some());
}

#[test]
fn invalid_captures_are_refused_with_the_position() {
    let check = |text: &str, parts: &[&str]| refused(ImportFormat::Bvh, text.as_bytes(), parts);
    let head = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n}\nMOTION\n";
    check("", &["found ``", "`HIERARCHY`"]);
    check("HIERARCHY\nROOT a\n{\nOFFSET 0 x 0\n", &["DB0061", "test:4:10", "an offset is `x`"]);
    check("HIERARCHY\nROOT a\n{\nCHANNELS 1 Wrotation\n", &["test:4:12", "the channel `Wrotation`"]);
    check("HIERARCHY\nROOT a\n{\nCHANNELS 7 Xrotation\n", &["7 channels"]);
    check("HIERARCHY\nMOTION\n", &["`MOTION` in the skeleton"]);
    check(&format!("{head}Frames: 99999999999\n"), &["DB0066"]);
    check(&format!("{head}Frames: 900000000\n"), &["DB0068"]);
    check(&format!("{head}Frames: 2\nFrame Time: 0\n"), &["DB0062", "a frame lasts 0 s"]);
    check(
        &format!("{head}Frames: 2\nFrame Time: 0.1\n1\n"),
        &["DB0066", "test:8:9", "`Frames: 2`, but contains 1"],
    );
    check(&format!("{head}Frames: 2\nFrame Time: 0.1\n1\ninf\n"), &["DB0061", "test:11:1"]);
    check(&format!("{head}Frames: 1\nFrame Time: 0.1\n1\n2\n"), &["test:8:9", "`Frames: 1`, but contains 2"]);
    let two = head.replace("1 Xrotation", "2 Xrotation Yrotation");
    check(&format!("{two}Frames: 2\nFrame Time: 0.1\n1 2\n3\n"), &["the file ends here", "`a.Yrotation`"]);
    check(
        &format!("{two}Frames: 1\nFrame Time: 0.1\n1 2\n3\n"),
        &["the last frame ends after channel 1", "2 values, one for"],
    );
    check(&format!("{two}Frames: 1\nFrame Time: 0.1\n1 2\n3 x\n"), &["DB0061", "test:11:3"]);
    check(&format!("HIERARCHY\n{}", "JOINT a\n{\n".repeat(5_000)), &["DB0068", "more than 200 levels deep"]);
}
