//! What a document is that was taken for another one, such as the fleet for the scenario.

use crate::finding::{Code, Finding, did_you_mean};
use crate::formats::importing;
use crate::node::Node;
use crate::source::Source;

/// The documents that people write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Document {
    /// A choreography.
    Scenario,
    /// A list of robots.
    Fleet,
    /// The initialization block of a robot.
    Robot,
    /// Delays, losses and clocks for dry runs.
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
pub fn mistaken(source: &Source, document: &Node, wanted: Document) -> Option<Finding> {
    match document {
        Node::Map(entries) => {
            let found = Document::of(entries).filter(|found| *found != wanted)?;
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

/// The same where a scenario was wanted, of which these are the keys: a map with none of them, not even misspelt, is not one.
pub fn mistaken_for_scenario(source: &Source, document: &Node, keys: &[&'static str]) -> Option<Finding> {
    let wanted = Document::Scenario;
    let belongs = |key: &str| keys.contains(&key) || did_you_mean(key, keys.iter().copied()).is_some();
    mistaken(source, document, wanted).or_else(|| {
        let Node::Map(entries) = document else { return None };
        let is_foreign = Document::of(entries).is_none() && !entries.iter().any(|(key, _)| belongs(key));
        let message = || format!("this is not {}", wanted.name());
        is_foreign.then(|| not_wanted(source, wanted, message(), begin(wanted)))
    })
}

fn not_wanted(source: &Source, wanted: Document, message: String, hint: String) -> Finding {
    Finding::about_file(Code::WrongType, &source.name, message, wanted.expected(), Some(hint))
}

/// Why a file cannot be included, and a hint, if it is a document of its own.
pub fn not_to_include(document: &Node) -> Option<(String, &'static str)> {
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

/// How to get a document of this kind.
pub fn begin(wanted: Document) -> String {
    let (what, name) = match wanted {
        Document::Scenario => ("a scenario", "show.yaml"),
        Document::Fleet => ("a fleet file", "fleet.yaml"),
        Document::Robot => ("the description of a robot", "robots/arm.yaml"),
        Document::World => return "`world: NAME` begins a world file; docs/world.md has its keys".to_owned(),
    };
    format!("`downbeat init first-show` writes {what} to begin with: `first-show/{name}`")
}
