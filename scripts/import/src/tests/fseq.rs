//! Light sequences: compressed or not, with all channels or only some ranges of channels.

use super::{fixture_of, keyframes_of};
use crate::{Course, ImportFormat, ImportOptions, ImportOutcome, import_bytes};

fn read(bytes: &[u8], maps: &[(&str, &str)]) -> ImportOutcome {
    let columns = maps.iter().map(|(to, channels)| ((*to).to_owned(), (*channels).to_owned())).collect();
    let options = ImportOptions { columns, ..ImportOptions::default() };
    import_bytes(ImportFormat::Fseq, "star.fseq", bytes, &options)
}

#[track_caller]
fn refused(bytes: &[u8], maps: &[(&str, &str)], part: &str) {
    let outcome = read(bytes, maps);
    let text = downbeat_yaml::render::render(&outcome.findings, false);
    assert!(outcome.imported.is_none() && text.contains(part), "{text}");
}

/// Returns the bytes of an uncompressed file with one channel.
fn plain(frames: &[u8]) -> Vec<u8> {
    let mut bytes = b"PSEQ\x20\0\0\x02\x20\0".to_vec();
    bytes.extend(1_u32.to_le_bytes());
    bytes.extend(u32::try_from(frames.len()).unwrap().to_le_bytes());
    bytes.extend([25, 0, 0, 0, 0, 0]);
    bytes.extend([0; 8]);
    bytes.extend(frames);
    bytes
}

#[test]
fn packed_channel_ranges_are_imported_where_they_change() {
    let outcome =
        read(&fixture_of("star.fseq"), &[("star/lamp", "1,2,3"), ("star/px*", "4-6/1"), ("top/dim", "101")]);
    let imported = outcome.imported.unwrap();
    assert_eq!(imported.robots(), ["star", "top"]);
    let lamp = &imported.scenes[0].robots[0].devices[0];
    let Course::Several(colors) = &lamp.course else { panic!() };
    assert_eq!((lamp.keyframes.len(), lamp.keyframes[39].at.as_millis_f64()), (41, 975.0));
    for (frame, color) in colors.iter().enumerate().take(40) {
        let second = if frame >= 20 { 255.0 } else { 0.0 };
        assert_eq!(color, &vec![(frame * 6 % 256) as f64, second, 10.0]);
    }
    assert_eq!(colors[40], colors[39]);
    assert_eq!(keyframes_of(&imported, "px2"), [(0.0, 2.0), (1_000.0, 2.0)]);
    assert_eq!(
        keyframes_of(&imported, "dim"),
        [(0.0, 0.0), (250.0, 1.0), (500.0, 2.0), (750.0, 3.0), (1_000.0, 3.0)]
    );
    for part in [
        "40 frames, one every 25 ms",
        "ignored 2 channels without a mapping",
        "ignored other entries of the file: sp",
    ] {
        assert!(outcome.notes.iter().any(|note| note.contains(part)), "{part}: {:?}", outcome.notes);
    }
}

#[test]
fn inconsistent_sequences_are_refused() {
    let file = fixture_of("star.fseq");
    refused(b"", &[("r/a", "1")], "PSEQ");
    refused(&file, &[], "none of the 9 channels is mapped to a device");
    refused(&file, &[("r/a", "7")], "no channel 7");
    refused(&file, &[("r/a", "104")], "no channel 104");
    refused(&file, &[("r/a", "red")], "is not a list of channels");
    refused(&file, &[("r/a*", "1-5/3")], "cannot be divided evenly into devices of 3 channels");
    refused(&file[..100], &[("r/a", "1")], "DB00");
    let changed = |at: usize, byte: u8| {
        let mut bytes = file.clone();
        bytes[at] = byte;
        bytes
    };
    refused(&changed(7, 1), &[("r/a", "1")], "version 1");
    refused(&changed(20, 7), &[("r/a", "1")], "compression 7");
    refused(&changed(13, 255), &[("r/a", "1")], "the channel ranges have 9 channels");
    refused(&changed(14, 41), &[("r/a", "1")], "40 frames, but its header states 41");
    refused(&changed(18, 0), &[("r/a", "1")], "0 ms per frame");
    refused(&changed(file.len() - 3, 0xff), &[("r/a", "1")], "DB0066");
    assert!(read(&plain(&[1, 2, 2, 3]), &[("r/a", "1")]).imported.is_some());
    let mut huge = plain(&[1]);
    huge[14..18].copy_from_slice(&u32::MAX.to_le_bytes());
    refused(&huge, &[("r/a", "1")], "exceed the limit of 1073741824 bytes");
}

#[test]
fn files_of_other_types_are_identified_in_the_error() {
    let check = |bytes: &[u8], part: &str| super::refused(ImportFormat::Fseq, bytes, &["DB0001", part]);
    check(b"ESEQ\x01\0\0\0", "an effect sequence (ESEQ) of one model");
    check(b"<?xml version=\"1.0\"?>", "not rendered (XML)");
    // The header of the first format version.
    check(
        b"FSEQ\x1c\0\0\x01\x1c\0\x04\0",
        "version 1.0 of FSEQ is not supported: save the file as version 2",
    );
    check(b"PNG", "does not begin with PSEQ");
}
