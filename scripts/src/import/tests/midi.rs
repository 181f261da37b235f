//! MIDI: notes, controllers and tempi against the times of an independent reading in exact fractions.

use super::{fixture_of, keyframes_of, refused};
use crate::import::{Course, ImportFormat, ImportOptions, import_bytes};

#[test]
fn notes_and_controllers_are_set_at_the_times_of_the_tempo() {
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
    for part in ["times follow 2 tempo", "1 system exclusive message", "1 text", "1 signature"] {
        assert!(outcome.notes.iter().any(|note| note.contains(part)), "{part}: {:?}", outcome.notes);
    }
}

#[test]
fn files_that_are_no_songs_are_refused() {
    let bytes = fixture_of("beat.mid");
    refused(ImportFormat::Midi, b"", &["DB0001", "not a MIDI file"]);
    refused(ImportFormat::Midi, b"RIFF0000", &["DB0001"]);
    refused(ImportFormat::Midi, &vec![0; 5_000_000], &["DB0068", "5000000 bytes"]);
    refused(ImportFormat::Midi, b"MThd\0\0\0\x06\0\x01\0\x01\x80\0", &["DB0001", "smpte"]);
    let second =
        b"MThd\0\0\0\x06\0\x01\0\x01\x01\xe0MTrk\0\0\0\x04\0\xff\x2f\0MThd\0\0\0\x06\0\x01\0\x01\x80\x02";
    refused(ImportFormat::Midi, second, &["DB0001", "smpte"]);
    let empty = b"MThd\0\0\0\x06\0\0\0\x01\0\x60MTrk\0\0\0\x04\0\xff\x2f\0";
    refused(ImportFormat::Midi, empty, &["the file sets nothing"]);
    let mut songs = bytes;
    songs[9] = 2;
    refused(ImportFormat::Midi, &songs, &["format 2"]);
    // A song of a year: 28 bits of ticks of ten seconds each.
    let long = b"MThd\0\0\0\x06\0\0\0\x01\0\x01MTrk\0\0\0\x13\0\xff\x51\x03\xff\xff\xff\xff\xff\xff\x7f\x90\x24\x40\0\xff\x2f\0";
    refused(ImportFormat::Midi, long, &["DB0062", "the file lasts"]);
}
