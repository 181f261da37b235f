//! ROS recordings: files that another program has written (the Python package mcap-ros2-support), compressed files, and invalid files.

use super::{fixture_of, keyframes_of, refused};
use crate::{ImportFormat, ImportOptions, import_bytes};

#[test]
fn recorded_positions_are_imported_exactly() {
    let bytes = fixture_of("arm.mcap");
    let outcome = import_bytes(ImportFormat::Mcap, "arm.mcap", &bytes, &ImportOptions::default());
    let imported = outcome.imported.unwrap();
    let (elbow, wrist) = (keyframes_of(&imported, "elbow"), keyframes_of(&imported, "wrist_1"));
    assert_eq!((elbow.len(), wrist.len()), (101, 101));
    for (index, (elbow, wrist)) in elbow.iter().zip(&wrist).enumerate() {
        let t = index as f64 * 0.02;
        assert_eq!((elbow.0, wrist.0), (index as f64 * 20.0, index as f64 * 20.0));
        assert!((elbow.1 - t.sin()).abs() < 1e-15 && (wrist.1 - 0.25 * t).abs() < 1e-15);
    }
    for part in ["left out 1 other topic: `/chatter`", "velocities and efforts are ignored"] {
        assert!(outcome.notes.iter().any(|note| note.contains(part)), "{part}: {:?}", outcome.notes);
    }
}

#[test]
fn lz4_chunks_are_read_like_zstd_chunks() {
    let of = |name: &str| {
        import_bytes(ImportFormat::Mcap, "arm.mcap", &fixture_of(name), &ImportOptions::default()).imported
    };
    assert!(of("arm_lz4.mcap").is_some());
    assert_eq!(of("arm_lz4.mcap"), of("arm.mcap"));
}

#[test]
fn broken_recordings_are_refused() {
    for name in ["arm.mcap", "arm_lz4.mcap"] {
        broken_recordings_of(name);
    }
}

#[test]
fn attachment_that_ends_before_its_checksum_is_ignored() {
    let magic = *b"\x89MCAP0\r\n";
    // Two times, two empty names, a data length, and no checksum: 32 bytes.
    let attachment = [&[9][..], &32_u64.to_le_bytes(), &[0; 32]].concat();
    let sound = fixture_of("arm.mcap");
    let with = [&magic[..], &attachment, &sound[magic.len()..]].concat();
    let of = |bytes: &[u8]| {
        import_bytes(ImportFormat::Mcap, "arm.mcap", bytes, &ImportOptions::default()).imported
    };
    assert!(of(&sound).is_some());
    assert_eq!(of(&with), of(&sound));
}

#[test]
fn record_with_false_length_is_refused() {
    let magic = *b"\x89MCAP0\r\n";
    for length in [64, u64::MAX - 8, u64::MAX] {
        let bytes = [&magic[..], &[12], &length.to_le_bytes(), &[0; 32], &magic].concat();
        refused(ImportFormat::Mcap, &bytes, &["cannot be read"]);
    }
}

fn broken_recordings_of(name: &str) {
    let bytes = fixture_of(name);
    refused(ImportFormat::Mcap, b"", &["DB0001"]);
    refused(ImportFormat::Mcap, b"no recording at all", &["DB0001", "cannot be read"]);
    refused(ImportFormat::Mcap, &bytes[..bytes.len() / 2], &["DB0001"]);
    for at in (20..bytes.len()).step_by(97) {
        let mut broken = bytes.clone();
        broken[at] ^= 0x55;
        let outcome = import_bytes(ImportFormat::Mcap, "arm.mcap", &broken, &ImportOptions::default());
        assert!(outcome.imported.is_some() || !outcome.findings.is_empty(), "byte {at}");
    }
}
