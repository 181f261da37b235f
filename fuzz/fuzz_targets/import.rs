//! Imports any bytes as a file of any supported format, which the first byte selects. The importer does not panic or hang, and its memory
//! is bounded. It returns a choreography exactly if it has no findings. The values of the choreography are finite and in order of time.
//!
//! If the environment variable `DOWNBEAT_FORMAT` names a format, all bytes are a file of that format.
#![no_main]

use std::sync::LazyLock;

use downbeat_import::{Course, DescriptionOutcome, ImportFormat, ImportOptions, Scenes, files_of, fixture, import_bytes, urdf};
use downbeat_scripts::{Source, init_of, render};
use libfuzzer_sys::fuzz_target;

/// Kind of the input: a choreography, or a robot's description.
#[derive(Clone, Copy)]
enum Format {
    Motions(ImportFormat),
    Urdf,
    Fixture,
}

static ONLY: LazyLock<Option<Format>> = LazyLock::new(|| {
    let word = std::env::var("DOWNBEAT_FORMAT").ok()?;
    match ImportFormat::ALL.iter().find(|known| known.word == word) {
        Some(known) => Some(Format::Motions(known.format)),
        None if word == "urdf" => Some(Format::Urdf),
        None if word == "fixture" => Some(Format::Fixture),
        None => panic!("DOWNBEAT_FORMAT={word} is no format"),
    }
});

fuzz_target!(|data: &[u8]| {
    let (format, bytes) = match (*ONLY, data.split_first()) {
        (Some(format), _) => (format, data),
        (None, Some((which, bytes))) => (of_byte(*which), bytes),
        (None, None) => return,
    };
    match format {
        Format::Motions(format) => check_motions(format, bytes),
        Format::Urdf => check_description(bytes, |source| urdf(source, None)),
        Format::Fixture => {
            check_description(bytes, |source| fixture(source, None, None));
            check_description(bytes, |source| fixture(source, Some("m"), None));
        }
    }
});

fn of_byte(which: u8) -> Format {
    let formats = ImportFormat::ALL;
    let index = usize::from(which) % (formats.len() + 2);
    match formats.get(index) {
        Some(known) => Format::Motions(known.format),
        None if index == formats.len() => Format::Urdf,
        None => Format::Fixture,
    }
}

fn check_motions(format: ImportFormat, bytes: &[u8]) {
    let columns = match format {
        ImportFormat::Csv => vec![("r/a".to_owned(), "a".to_owned()), ("r/*".to_owned(), "c*,2".to_owned())],
        ImportFormat::Fseq => vec![("r/a".to_owned(), "1".to_owned()), ("r/p*".to_owned(), "1-6/3".to_owned())],
        _ => Vec::new(),
    };
    // Some tables get times in frames per second.
    let rate_hz = (format == ImportFormat::Csv && bytes.len() % 2 == 1).then_some(29.97);
    let options = ImportOptions { columns, rate_hz, pieces_max: Some(100), ..ImportOptions::default() };
    let outcome = import_bytes(format, "f", bytes, &options);
    assert!(outcome.imported.is_none() || outcome.findings.is_empty());
    let _shown = render(&outcome.findings, false);
    let Some(imported) = outcome.imported else { return };
    for (_, device) in imported.devices() {
        assert!(device.keyframes.iter().all(|keyframe| keyframe.value.is_finite()), "{device:?}");
        assert!(device.keyframes.windows(2).all(|pair| pair[0].at < pair[1].at), "{device:?}");
        match &device.course {
            Course::Pieces(pieces) => assert!(pieces.iter().all(|piece| piece.length > urrcp::Span::ZERO), "{pieces:?}"),
            Course::Several(values) => assert_eq!(values.len(), device.keyframes.len()),
            Course::Straight | Course::Held => {}
        }
    }
    if imported.steps() < 1_000 {
        let _files = files_of(&imported, Scenes::Acts, None);
    }
}

fn check_description(bytes: &[u8], convert: impl Fn(&Source) -> DescriptionOutcome) {
    let Ok(text) = String::from_utf8(bytes.to_vec()) else { return };
    let outcome = convert(&Source { name: "f".into(), text });
    let _shown = render(&outcome.findings, false);
    assert_eq!(outcome.files.is_empty(), !outcome.findings.is_empty());
    if let Some(block) = outcome.files.first() {
        let source = Source { name: "block".into(), text: block.text.clone() };
        assert!(init_of(&source).is_ok(), "{}", block.text);
    }
}
