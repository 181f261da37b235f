//! Recognizes documents that were passed in place of another kind, such as a fleet in place of a scenario.

use crate::finding::{Code, Finding, did_you_mean};
use crate::formats::importing;
use crate::node::Node;
use crate::source::Source;

/// The kinds of documents that users write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Document {
    /// A scenario file: a choreography.
    Scenario,
    /// A fleet file: a list of robots.
    Fleet,
    /// An init file: the initialization block of a robot.
    Robot,
    /// A world file: the simulated delays, losses and clocks for dry runs.
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

    /// Returns the kind of a document for whose keys `has` returns true; `None` if they do not identify a kind.
    pub fn of(has: impl Fn(&str) -> bool) -> Option<Self> {
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

    fn of_entries(entries: &[(String, Node)]) -> Option<Self> {
        Self::of(|name| entries.iter().any(|(key, _)| key == name))
    }

    /// Returns the hint for a document of this kind where `wanted` was expected.
    fn instead_of(self, wanted: Self) -> &'static str {
        match (wanted, self) {
            (Self::Scenario, Self::Fleet) => "pass the scenario, and the fleet with `--fleet FILE`",
            (Self::Scenario, _) => "pass the scenario; a fleet file refers to the descriptions of its robots",
            (Self::Fleet, Self::Robot) => {
                "use a fleet file; it refers to this file as `robots: {arm-1: {init: FILE, address: sim}}`"
            }
            (Self::Fleet, _) => "use the file that lists the robots, usually `fleet.yaml`",
            (Self::World, _) => "pass the world file with `--world FILE`",
            (Self::Robot, _) => "use the `init` file of a robot in the fleet",
        }
    }
}

/// Returns a single finding for a document of the wrong kind, instead of one finding for each of its keys. `None` if the document may be
/// of the kind `wanted`.
pub fn mistaken(source: &Source, document: &Node, wanted: Document) -> Option<Finding> {
    match document {
        Node::Map(entries) => {
            let found = Document::of_entries(entries).filter(|found| *found != wanted)?;
            let message = format!("this is {}, not {}", found.name(), wanted.name());
            Some(not_wanted(source, wanted, message, found.instead_of(wanted).to_owned()))
        }
        Node::Text(_) => {
            let hint = importing(&source.name).unwrap_or_else(|| begin(wanted));
            Some(not_wanted(source, wanted, format!("this text is not {}", wanted.name()), hint))
        }
        _ => None,
    }
}

/// Like [`mistaken`]. Also returns a finding for a list, and for a map that has none of these keys of such a document, not even misspelt:
/// findings about its own keys would quote a file that may have been named by mistake.
pub fn mistaken_by_keys(
    source: &Source,
    document: &Node,
    wanted: Document,
    keys: &[&'static str],
) -> Option<Finding> {
    mistaken(source, document, wanted).or_else(|| {
        let message = || format!("this is not {}", wanted.name());
        is_foreign(document, keys).then(|| not_wanted(source, wanted, message(), begin(wanted)))
    })
}

/// Whether a document is a list, or a map with none of these keys, not even misspelt, that is no other document that users write.
#[must_use]
pub fn is_foreign(document: &Node, keys: &[&'static str]) -> bool {
    let belongs = |key: &str| keys.contains(&key) || did_you_mean(key, keys.iter().copied()).is_some();
    match document {
        Node::Map(entries) => {
            Document::of_entries(entries).is_none() && !entries.iter().any(|(key, _)| belongs(key))
        }
        Node::List(_) => true,
        _ => false,
    }
}

fn not_wanted(source: &Source, wanted: Document, message: String, hint: String) -> Finding {
    Finding::about_file(Code::WrongType, &source.name, message, wanted.expected(), Some(hint))
}

/// Returns the reason why a document cannot be included, and a hint, if it is plain text, a scenario, a fleet, a robot, a world, or a map
/// with none of these keys. `None` if it can be included.
pub fn not_to_include(document: &Node, keys: &[&'static str]) -> Option<(String, &'static str)> {
    let is_empty = matches!(document, Node::Map(entries) if entries.is_empty());
    if !is_empty && is_foreign(document, keys) {
        return Some(("this file has no keys that scenarios share".to_owned(), "check the path"));
    }
    let entries = match document {
        Node::Map(entries) => entries,
        // A finding in the file itself would quote the text, which may not be meant for the reader of the finding.
        Node::Text(_) => {
            return Some(("this file is text, not a map".to_owned(), "include a YAML file with shared keys"));
        }
        _ => return None,
    };
    let found = Document::of_entries(entries)?;
    let hint = match found {
        Document::Scenario => {
            "move the shared keys, such as `moves`, to a separate file, and include that file"
        }
        Document::Fleet => "write its path under `fleet` instead",
        Document::Robot => "write its path as the `init` of a robot in the fleet file",
        Document::World => "pass it with `--world FILE`",
    };
    Some((format!("this file is {}", found.name()), hint))
}

/// Returns a hint that shows how to create a document of the kind `wanted`.
pub fn begin(wanted: Document) -> String {
    let (what, name) = match wanted {
        Document::Scenario => ("a scenario", "show.yaml"),
        Document::Fleet => ("a fleet file", "fleet.yaml"),
        Document::Robot => ("the description of a robot", "robots/arm.yaml"),
        Document::World => {
            return "start a world file with `world: NAME`; docs/world.md lists its keys".to_owned();
        }
    };
    format!("run `downbeat init first-show` to create {what}: `first-show/{name}`")
}
