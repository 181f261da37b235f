//! What a file is that was taken for something else: the fleet for the scenario, a recording for text.

use std::path::Path;

use crate::finding::{Code, Finding, did_you_mean};
use crate::import::ImportFormat;
use crate::node::Node;
use crate::scenario::SCENARIO_KEYS;
use crate::source::Source;

/// The documents that people write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Document {
    Scenario,
    Fleet,
    Robot,
    World,
}

impl Document {
    const fn name(self) -> &'static str {
        match self {
            Self::Scenario => "a scenario",
            Self::Fleet => "a fleet file",
            Self::Robot => "the description of a robot",
            Self::World => "a world file",
        }
    }

    const fn expected(self) -> &'static str {
        match self {
            Self::Scenario => "a map with `scenario`, and `cues` or `acts`",
            Self::Fleet => "a map with `robots`",
            Self::Robot => "a map with `id`, `api_version` and `devices`",
            Self::World => "a map with `world`",
        }
    }

    /// What a map is by its keys.
    fn of(entries: &[(String, Node)]) -> Option<Self> {
        let has = |name: &str| entries.iter().any(|(key, _)| key == name);
        if has("cues") || has("acts") || has("scenario") {
            Some(Self::Scenario)
        } else if has("world") {
            Some(Self::World)
        } else if has("robots") {
            Some(Self::Fleet)
        } else if has("devices") {
            Some(Self::Robot)
        } else {
            None
        }
    }

    /// What to do about a file that is `self` where `wanted` was to be.
    fn instead_of(self, wanted: Self) -> &'static str {
        match (wanted, self) {
            (Self::Scenario, Self::Fleet) => "name the scenario, and the fleet with `--fleet FILE`",
            (Self::Scenario, _) => "name the scenario; a fleet file names the descriptions of its robots",
            (Self::Fleet, Self::Robot) => {
                "name a fleet file; it refers to this file as `robots: {arm-1: {init: FILE, address: sim}}`"
            }
            (Self::Fleet, _) => "name the file that lists the robots, usually `fleet.yaml`",
            (Self::World, _) => "name the world file with `--world FILE`",
            (Self::Robot, _) => "name the file that a robot of the fleet has as its `init`",
        }
    }
}

/// The one finding for a document that is not what was wanted, rather than one for each of its keys. Documents that are nearly
/// right are read on.
pub(crate) fn mistaken(source: &Source, document: &Node, wanted: Document) -> Option<Finding> {
    let (message, hint) = match document {
        Node::Map(entries) => match Document::of(entries) {
            Some(found) if found == wanted => return None,
            Some(found) => (
                format!("this is {}, not {}", found.name(), wanted.name()),
                found.instead_of(wanted).to_owned(),
            ),
            None if wanted != Document::Scenario || entries.iter().any(|(key, _)| belongs(key)) => {
                return None;
            }
            None => (format!("this is not {}", wanted.name()), begin(wanted)),
        },
        Node::Text(_) => {
            let hint = importing(&source.name).unwrap_or_else(|| begin(wanted));
            (format!("this text is not {}", wanted.name()), hint)
        }
        _ => return None,
    };
    Some(Finding::about_file(Code::WrongType, &source.name, message, wanted.expected(), Some(hint)))
}

/// Why a file cannot be included, and a hint, if it is a document of its own.
pub(crate) fn not_to_include(document: &Node) -> Option<(String, &'static str)> {
    let Node::Map(entries) = document else { return None };
    let found = Document::of(entries)?;
    let hint = match found {
        Document::Scenario => {
            "move what both share, such as `moves`, into a file of its own, and include that"
        }
        Document::Fleet => "name it under `fleet` instead",
        Document::Robot => "name it as the `init` of a robot in the fleet file",
        Document::World => "name it with `--world FILE`",
    };
    Some((format!("this file is {}", found.name()), hint))
}

/// Whether a key is one of a scenario, perhaps misspelt.
fn belongs(key: &str) -> bool {
    SCENARIO_KEYS.contains(&key) || did_you_mean(key, SCENARIO_KEYS).is_some()
}

/// How to get a document of this kind.
pub(crate) fn begin(wanted: Document) -> String {
    let (what, name) = match wanted {
        Document::Scenario => ("a scenario", "show.yaml"),
        Document::Fleet => ("a fleet file", "fleet.yaml"),
        Document::Robot => ("the description of a robot", "robots/arm.yaml"),
        Document::World => return "`world: NAME` begins a world file; docs/world.md has its keys".to_owned(),
    };
    format!("`downbeat init first-show` writes {what} to begin with: `first-show/{name}`")
}

/// Where files of other tools belong, by the ends of their names.
const IMPORTED: [(&str, ImportFormat); 8] = [
    ("csv", ImportFormat::Csv),
    ("mid", ImportFormat::Midi),
    ("midi", ImportFormat::Midi),
    ("bvh", ImportFormat::Bvh),
    ("fseq", ImportFormat::Fseq),
    ("mcap", ImportFormat::Mcap),
    ("motion", ImportFormat::Webots),
    ("skyc", ImportFormat::Skybrush),
];

/// The format of another tool's file by the end of its name.
pub(crate) fn format_of(name: &str) -> Option<ImportFormat> {
    let end = Path::new(name).extension()?.to_str()?.to_ascii_lowercase();
    IMPORTED.iter().find(|(known, _)| *known == end).map(|(_, format)| *format)
}

/// The command that makes a scenario of another tool's file.
pub(crate) fn importing(name: &str) -> Option<String> {
    let format = format_of(name)?;
    Some(format!(
        "`downbeat import {} {name}` makes a scenario of it; see `downbeat import --help`",
        format.word()
    ))
}

/// What a file is that is not text, by its first bytes.
pub(crate) fn binary(bytes: &[u8]) -> Option<&'static str> {
    const KNOWN: [(&[u8], &str); 9] = [
        (b"MThd", "a MIDI file"),
        (b"\x89MCAP", "a recording (MCAP)"),
        (b"PSEQ", "a light sequence (FSEQ)"),
        (b"PK\x03\x04", "a ZIP archive"),
        (b"\x89PNG", "a picture"),
        (b"\xff\xd8\xff", "a picture"),
        (b"%PDF", "a PDF document"),
        (b"\x7fELF", "a program"),
        (b"\x1f\x8b", "a compressed file"),
    ];
    KNOWN.iter().find(|(start, _)| bytes.starts_with(start)).map(|(_, what)| *what)
}
