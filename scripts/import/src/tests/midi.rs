//! MIDI: notes, controllers and tempi, compared with an independent calculation in exact fractions.

use super::{fixture_of, keyframes_of, refused};
use crate::{Course, ImportFormat, ImportOptions, import_bytes};

#[test]
fn notes_and_controllers_follow_the_tempo() {
    let bytes = fixture_of("beat.mid");
    let outcome = import_bytes(ImportFormat::Midi, "beat.mid", &bytes, &ImportOptions::default());
    let imported = outcome.imported.unwrap();
    assert!(imported.devices().all(|(_, device)| device.course == Course::Held));
    let controller =
        [(0.0, 0.0), (462.500_231, 30.0), (925.000_463, 60.0), (1_387.500_694, 90.0), (1_850.000_925, 120.0)];
    assert_eq!(keyframes_of(&imported, "ch1-cc7"), controller);
    let drum = keyframes_of(&imported, "ch10-note36");
    assert_eq!(drum[..4], [(0.0, 100.0), (333.333_5, 0.0), (666.667, 99.0), (1_000.000_5, 0.0)]);
    // The tempo changes after three beats.
    assert_eq!(drum[6..9], [(2_000.001, 97.0), (2_214.286_5, 0.0), (2_428.572, 96.0)]);
    assert_eq!(drum[drum.len() - 1], (3_928.570_5, 0.0));
    assert_eq!(keyframes_of(&imported, "ch1-bend"), [(1_988.889_883, -8_192.0)]);
    for part in [
        "times are computed from 2 tempo",
        "1 system exclusive message",
        "1 text event",
        "1 other meta event",
    ] {
        assert!(outcome.notes.iter().any(|note| note.contains(part)), "{part}: {:?}", outcome.notes);
    }
}

#[test]
fn invalid_midi_files_are_refused() {
    let bytes = fixture_of("beat.mid");
    refused(ImportFormat::Midi, b"", &["DB0001", "the file is empty"]);
    refused(ImportFormat::Midi, b"scenario: x", &["DB0001", "found `scen` at byte 0, expected `MThd`"]);
    refused(ImportFormat::Midi, b"\xff\xd8\xff\xe0", &["DB0001", "it does not begin with `MThd`"]);
    refused(ImportFormat::Midi, b"MThd\0\0", &["DB0001", "cut off at byte 6", "copy or export"]);
    refused(ImportFormat::Midi, b"RIFF0000", &["DB0001"]);
    refused(ImportFormat::Midi, &vec![0; 5_000_000], &["DB0068", "5000000 bytes"]);
    let head = |division: [u8; 2]| [b"MThd\0\0\0\x06\0\x01\0\x01".as_slice(), &division].concat();
    refused(ImportFormat::Midi, &head([0x80, 2]), &["DB0001", "128 SMPTE frames"]);
    refused(ImportFormat::Midi, &head([0xe8, 0]), &["DB0001", "0 ticks per frame"]);
    refused(ImportFormat::Midi, &head([0, 0]), &["DB0001", "0 ticks per beat"]);
    refused(ImportFormat::Midi, &head([0, 96]), &["DB0001", "states 1 track, but the file has 0"]);
    let empty = b"MThd\0\0\0\x06\0\0\0\x01\0\x60MTrk\0\0\0\x04\0\xff\x2f\0";
    refused(ImportFormat::Midi, empty, &["the file has no notes or controller values"]);
    let mut songs = bytes;
    songs[9] = 2;
    refused(ImportFormat::Midi, &songs, &["format 2"]);
    // A song of many years: the largest 28-bit tick, with more than ten seconds per tick.
    let long = b"MThd\0\0\0\x06\0\0\0\x01\0\x01MTrk\0\0\0\x12\0\xff\x51\x03\xff\xff\xff\xff\xff\xff\x7f\x90\x24\x40\0\xff\x2f\0";
    refused(ImportFormat::Midi, long, &["DB0062", "the file lasts"]);
}

/// Returns the bytes of a MIDI file whose only track has these events.
fn song(events: &[u8]) -> Vec<u8> {
    let length = u32::try_from(events.len()).unwrap().to_be_bytes();
    [b"MThd\0\0\0\x06\0\0\0\x01\0\x60MTrk".as_slice(), &length, events].concat()
}

const END: [u8; 4] = [0, 0xff, 0x2f, 0];

#[test]
fn running_status_continues_after_text_and_exclusive_messages() {
    // A note, a text, and a note with running status; the same after an exclusive message.
    let notes = [0, 0x90, 60, 100, 96, 0xff, 1, 1, b'x', 0, 62, 90, 96, 0xf0, 2, 1, 0xf7, 0, 64, 80];
    let bytes = song(&[&notes[..], &END].concat());
    let outcome = import_bytes(ImportFormat::Midi, "a.mid", &bytes, &ImportOptions::default());
    let imported = outcome.imported.unwrap_or_else(|| panic!("{:?}", outcome.findings));
    assert_eq!(imported.devices().count(), 3);
    assert_eq!(keyframes_of(&imported, "ch1-note64").last().map(|last| last.1), Some(80.0));
    let noted = outcome.notes.iter().any(|note| note.contains("2 events") && note.contains("running status"));
    assert!(noted, "{:?}", outcome.notes);
}

#[test]
fn track_is_read_to_its_end_or_refused_at_the_faulty_byte() {
    let check = |bytes: &[u8], parts: &[&str]| refused(ImportFormat::Midi, bytes, parts);
    let note = [0, 0x90, 60, 100];
    let whole = song(&[&note[..], &note, &END].concat());
    for length in 23..whole.len() {
        check(&whole[..length], &["DB0001", "track 1", &format!("cut off at byte {length}")]);
    }
    for status in [0xf1, 0xf4, 0xf8, 0xfe] {
        let bytes = song(&[&note[..], &[0, status], &note, &END].concat());
        check(&bytes, &["DB0001", "track 1", "byte 27", &format!("0x{status:02x}")]);
    }
    check(&song(&[&[0, 60, 100][..], &END].concat()), &["track 1", "byte 23", "missing status byte"]);
    check(&song(&[&[0, 0x90, 60, 0x91][..], &END].concat()), &["track 1", "byte 25", "0x91"]);
    check(&song(&[&[0, 0xff, 1, 100, 0][..], &END].concat()), &["track 1", "100 bytes"]);
    check(&song(&[&[0xff, 0xff, 0xff, 0xff, 1][..], &END].concat()), &["track 1", "byte 22", "four bytes"]);
    // The header states two tracks.
    let mut two = whole.clone();
    two[11] = 2;
    check(&two, &["DB0001", "2 tracks", "the file has 1"]);
    check(b"MThd\0\0\0\x06\0\0\0\x01\0\x60MTr", &["DB0001", "byte 17"]);
}

#[test]
fn other_chunks_and_bytes_after_track_end_are_ignored_with_a_note() {
    let track = song(&[&[0, 0x90, 60, 100][..], &END].concat());
    let (head, chunk) = track.split_at(14);
    let foreign = [b"XFIH\0\0\0\x02ab".as_slice(), chunk].concat();
    let padded = song(&[&[0, 0x90, 60, 100][..], &END, &[0, 0, 0]].concat());
    for (bytes, part) in [([head, &foreign].concat(), "`XFIH`"), (padded, "3 bytes after the end of track 1")]
    {
        let outcome = import_bytes(ImportFormat::Midi, "a.mid", &bytes, &ImportOptions::default());
        assert!(outcome.imported.is_some(), "{:?}", outcome.findings);
        assert!(outcome.notes.iter().any(|note| note.contains(part)), "{part}: {:?}", outcome.notes);
    }
}
