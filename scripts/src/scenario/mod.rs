//! A scenario as written, with variables and moves expanded. `compile` resolves the names of robots against the fleet.
//!
//! `library` reads the parts that cues share, `formations` places, and `paths` paths. `cue` reads a cue, `when` the times of a cue, and
//! `track` the movement of one device. `acts` reads the graph of acts.

mod acts;
mod canon;
mod cue;
mod data;
mod each;
mod form;
mod formations;
mod formulas;
mod given;
mod includes;
mod kinds;
mod library;
mod movement;
mod nesting;
mod paths;
mod play;
mod require;
mod sequence;
mod standing;
mod track;
mod vectors;
mod when;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use urrcp::{ControlType, Millis, Span, StopCondition};

use crate::budget::{LEADS, longest};
use crate::ensemble::{Ground, Rehearsed, Together, WrittenFormation, WrittenPath};
use crate::exact::Exact;
use crate::fields::{At, Name, Reader, Unset};
use crate::files::Files;
use crate::finding::{Code, Finding, PathStep, Place};
use crate::fleet::{Fleet, devices_of};
use crate::locate::locate;
use crate::motion::Curve;
use crate::node::{self, Node};
use crate::plan::{CueText, OnDoubt, Repetition, Requirements};
use crate::slips::Units;
use crate::source::Source;
use acts::ActKeys;
use downbeat_reader::keys::{Declaration, Keys, Kind};
use downbeat_reader::{keys, schema};
use require::RequireKeys;

pub use acts::parse_time;
pub(crate) use acts::{OnFailureRule, WrittenWait};
pub(crate) use canon::Canon;
pub(crate) use cue::CueKeys;
pub(crate) use given::{Change, Changed, Given, Givens};
pub(crate) use library::{Documents, Shared};
pub(crate) use vectors::{Vector, Vectors};
pub(crate) use when::{Anchor, Relation};

/// Default value of the largest permitted spread of starts.
const START_TOLERANCE: Span = Span::from_millis(10);
/// Default running lease in milliseconds: two seconds of silence.
const RUNNING_LEASE_MS: f64 = 2_000.0;

/// A scenario as written.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scenario {
    pub(crate) name: String,
    pub(crate) start_tolerance: Span,
    pub(crate) lead: Option<Span>,
    pub(crate) stop_condition: StopCondition,
    pub(crate) lease_place: Option<Place>,
    pub(crate) requirements: Requirements,
    /// Place in the file of the required minimum distance between bodies; `None` if the scenario requires none.
    pub(crate) closest_place: Option<Place>,
    pub(crate) roles: HashMap<String, Vec<Name>>,
    pub(crate) formations: HashMap<String, WrittenFormation>,
    pub(crate) paths: HashMap<String, WrittenPath>,
    pub(crate) acts: Vec<Act>,
    pub(crate) at_end: Option<AtEnd>,
}

/// What the scenario requires under `at_end`: devices move to their default values after a successful mission.
#[derive(Clone, Debug)]
pub(crate) struct AtEnd {
    /// Duration of the movement to the default values; `None` if it follows from the limits of the devices.
    pub(crate) over: Option<Span>,
    pub(crate) place: Place,
}

/// A group of cues that start together.
#[derive(Clone, Debug)]
pub(crate) struct Act {
    pub(crate) name: String,
    pub(crate) place: Place,
    pub(crate) cues: Vec<Cue>,
    /// Number of faults that were found in the act's cues. If there are any, the times of the cues may be incomplete.
    pub(crate) faults: usize,
    /// Zones, each with the order of its cues; the act's own zones are last. Acts without their own zones share one list.
    pub(crate) zones: Arc<[(String, Order)]>,
    /// Order of cues that must not overlap because of their key `apart`.
    pub(crate) order: Order,
    pub(crate) wait: WrittenWait,
    pub(crate) next: Option<Name>,
    pub(crate) on_failure: OnFailureRule,
    pub(crate) on_doubt: OnDoubt,
}

/// Order of cues that need the same zone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Order {
    /// Cues occupy the zone in the order of the file.
    #[default]
    Given,
    /// Cues occupy the zone in the best order that a search finds.
    Auto,
}

/// A cue: some robots move some devices.
#[derive(Clone, Debug)]
pub(crate) struct Cue {
    pub(crate) name: String,
    pub(crate) place: Place,
    pub(crate) relations: Vec<Relation>,
    /// Fixed or bounded length to which the cue's movement is stretched; `None` if it keeps its length.
    pub(crate) duration: Option<Bounds>,
    pub(crate) robots: Vec<Name>,
    pub(crate) robots_place: Place,
    /// The movement of robots that have neither an override nor a movement of their own.
    pub(crate) movement: Movement,
    pub(crate) overrides: Vec<(Name, Movement)>,
    /// Movements of single robots, if the movement depends on the robot's index.
    pub(crate) own: Vec<Movement>,
    /// For each robot of the cue, in order, the index of its movement in `own`; empty if there are none.
    pub(crate) own_of: Vec<Option<usize>>,
    /// Delay of each robot's start, since the start of the cue.
    pub(crate) canon: Canon,
    pub(crate) uses: Vec<Name>,
    pub(crate) apart: Vec<Name>,
    pub(crate) stop_condition: Option<StopCondition>,
    pub(crate) off_grid: OffGrid,
    pub(crate) readings: Vec<Reading>,
    /// The movement of the robots as a group in space; `None` if the cue has none.
    pub(crate) group: Option<Together>,
    /// The group's movements; `None` if the robots' places were unknown when the cue was read.
    pub(crate) rehearsed: Option<Rehearsed>,
    /// Default tolerance of the cue's tracks; `None` if the cue sets none.
    pub(crate) tolerance: Option<f64>,
    pub(crate) text: CueText,
}

/// The tracks that a cue plays on all or some of its robots.
#[derive(Clone, Debug, Default)]
pub(crate) struct Movement {
    pub(crate) tracks: Vec<Track>,
    /// Delay of the movement after the start of the cue.
    pub(crate) delay: Span,
    pub(crate) length: Span,
    pub(crate) repetition: Option<Repetition>,
    /// Parameters without a value. They are reported only if a robot plays the movement.
    pub(crate) unset: Vec<Unset>,
}

/// A minimum and a maximum length.
#[derive(Clone, Debug)]
pub(crate) struct Bounds {
    pub(crate) min: Span,
    pub(crate) max: Option<Span>,
    pub(crate) place: Place,
}

/// The movement of one device.
#[derive(Clone, Debug)]
pub(crate) struct Track {
    pub(crate) device: String,
    pub(crate) control: Option<ControlType>,
    pub(crate) motion: Motion,
    /// Exact length of the track, before it is rounded to nanoseconds.
    pub(crate) length: Exact,
    /// Exact delay between the start of the movement and the start of the track, before it is rounded to nanoseconds.
    pub(crate) begin: Exact,
    /// Delay between the start of the movement and the start of the track, rounded to nanoseconds.
    pub(crate) starts: Span,
    /// The movements that the track consists of, if a move plays several movements on the device; otherwise empty.
    pub(crate) pieces: Vec<Piece>,
    pub(crate) tolerance: Option<f64>,
    pub(crate) steps_max: Option<u32>,
    /// Place of the track's key in the file.
    pub(crate) place: Place,
    /// Total number of times that the track is played.
    pub(crate) turns: u32,
    /// Kind of the track's items: keyframes, points, pieces or rows.
    pub(crate) items: Items,
    /// Place of the list of the track's items in the file.
    pub(crate) list: Place,
    /// Items that depend on a parameter, each with the place of the parameter's argument.
    pub(crate) given: Givens,
    /// The last change that the cue makes to all values of the track; `None` without such a change.
    pub(crate) changed: Option<Changed>,
}

/// One of several movements in a track.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    /// Index of the piece's first item among all items of the track.
    pub(crate) first: u32,
    pub(crate) items: Items,
    /// Place in the file of the list that contains the piece's items.
    pub(crate) list: Place,
}

/// The kind of items in which a movement is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Items {
    Keyframes,
    Points,
    Pieces,
    Rows,
    /// The movement has no items.
    Whole,
}

impl Items {
    /// Returns the singular word for an item, for messages.
    pub(crate) const fn one(self) -> &'static str {
        match self {
            Self::Keyframes => "keyframe",
            Self::Points => "point",
            Self::Pieces => "piece",
            Self::Rows => "row",
            Self::Whole => "movement",
        }
    }
}

/// The values of a track: one value over time, or several values at certain times.
#[derive(Clone, Debug)]
pub(crate) enum Motion {
    Curve(Curve),
    Vectors(Vectors),
}

/// How values off a device's grid are handled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum OffGrid {
    /// The value is reported as an error.
    #[default]
    Refuse,
    /// The device takes the nearest value on its grid, with a warning.
    Snap,
}

/// A sensor reading at a time after the start of a cue.
#[derive(Clone, Debug)]
pub(crate) struct Reading {
    pub(crate) sensor: String,
    pub(crate) at: Span,
    pub(crate) place: Place,
}

impl Reading {
    /// Returns the place of the sensor's name in the file.
    pub(crate) fn key_place(&self) -> Place {
        let is_sensor = |part: &PathStep| matches!(part, PathStep::Key(key, _) if *key == self.sensor);
        let path = &self.place.path;
        let end = path.iter().rposition(is_sensor).map_or(path.len(), |sensor| sensor + 1);
        Place { key: true, path: path[..end].to_vec(), ..self.place.clone() }
    }
}

impl Scenario {
    /// Returns the latest time at which an act may end, since its start. The lead (time from the sending of scripts to the start) reduces
    /// this time: a script is sent with the sum of its start and the lead.
    pub(crate) fn horizon(&self) -> Span {
        longest() - self.lead.unwrap_or_default().max(LEADS.1)
    }

    /// Returns the fleet, formations and paths, on which group movements depend.
    pub(crate) fn ground<'a>(&'a self, fleet: &'a Fleet) -> Ground<'a> {
        Ground { fleet, formations: &self.formations, paths: &self.paths }
    }
}

impl Track {
    /// Returns the kind of the item with this index in the track, its index in its own list, and its place. The index in the list counts
    /// from 0; it is `None` for a whole movement.
    pub(crate) fn item(&self, item: u32) -> (Items, Option<u32>, Place) {
        let (items, own, list) = match self.pieces.iter().rfind(|piece| piece.first <= item) {
            Some(piece) if item != u32::MAX => (piece.items, item - piece.first, &piece.list),
            _ => (self.items, item, &self.list),
        };
        match own {
            u32::MAX => (items, None, list.clone()),
            _ if items == Items::Whole => (items, None, list.clone()),
            own => (items, Some(own), list.below(PathStep::Index(own as usize))),
        }
    }

    /// Returns the place of the argument on which an item depends; `None` if it depends on none.
    pub(crate) fn given(&self, item: u32) -> Option<&Place> {
        self.given_as(item).map(|given| given.place.as_ref())
    }

    pub(crate) fn given_as(&self, item: u32) -> Option<&Given> {
        self.given.iter().find(|(known, _)| *known == item).map(|(_, given)| given)
    }

    /// Returns the exact end of the track, before it is rounded to nanoseconds.
    pub(crate) fn end(&self) -> Exact {
        self.begin.plus(self.length)
    }
}

impl Motion {
    /// Returns the memory that the motion takes, expressed as a number of knots.
    pub(crate) fn size(&self) -> usize {
        match self {
            Self::Curve(curve) => curve.size(),
            Self::Vectors(vectors) => vectors.len() + vectors.values().len() / 6,
        }
    }

    pub(crate) fn length(&self) -> Span {
        match self {
            Self::Curve(curve) => curve.length(),
            Self::Vectors(vectors) => vectors.last().map_or(Span::ZERO, |vector| vector.at),
        }
    }
}

/// Returns the path of the fleet file that a scenario names, relative to the scenario's folder.
#[must_use]
pub fn fleet_named_by(source: &Source) -> Option<PathBuf> {
    // This check is cheap compared with parsing the text.
    if !source.text.contains("fleet") {
        return None;
    }
    let Ok(Node::Map(entries)) = node::parse(source) else { return None };
    entries.into_iter().find_map(|(key, node)| match node {
        Node::Text(path) if key == "fleet" => Some(PathBuf::from(path)),
        _ => None,
    })
}

/// Moves a finding about the fleet file to the place in the scenario where the scenario names this file.
#[must_use]
pub fn place_at_fleet(source: &Source, about: Finding) -> Finding {
    let mut reader = Reader::default();
    reader.add_named(Place::default().of_key("fleet"), about.clone());
    locate(std::slice::from_ref(source), reader.finish()).pop().unwrap_or(about)
}

keys! {
    /// A choreography: which robots move which devices when.
    pub(crate) struct ScenarioKeys {
        /// Its name.
        #[required]
        scenario: kinds::NAME,
        /// The fleet file, from the scenario's folder.
        #[default("`./fleet.yaml`, or `--fleet`")]
        fleet: kinds::FILE,
        include: kinds::INCLUDE,
        /// Names with values; `$name` stands for the value.
        ///
        /// Values are numbers, times, words, and expressions of variables before them. `-$name` stands for the negative value.
        variables: kinds::VARIABLES,
        moves: kinds::MOVES,
        sequences: kinds::SEQUENCES,
        /// Names for robots and groups.
        ///
        /// They are used in cues and must differ from the names of robots and groups.
        roles: kinds::ROLES,
        /// Formations by name: places for any number of robots.
        ///
        /// See [formations](#a-formation).
        formations: kinds::FORMATIONS,
        /// Paths by name: routes through space along which groups of robots move.
        ///
        /// See [paths](#a-path).
        paths: kinds::PATHS,
        tempo: kinds::TEMPO,
        signature: kinds::SIGNATURE,
        zones: kinds::ZONES,
        /// Order of cues that share a zone: as in the file, or the best order found.
        ///
        /// It applies to zones without their own order, and to `apart`.
        #[default("`given`")]
        order: kinds::ORDER,
        #[default("`refuse`")]
        off_grid: kinds::OFF_GRID,
        /// Largest permitted spread of starts.
        ///
        /// A fleet whose clocks permit a larger spread does not start. If the starts were further apart, the mission ends
        /// `out_of_tolerance`; if a step was later than that, it ends `steps_late`.
        #[default("10ms")]
        start_tolerance: kinds::TIME,
        /// Time from sending to the start.
        #[default("computed from the measured delays")]
        lead: kinds::TIME,
        /// Longest silence of the server before the robot stops by itself.
        ///
        /// A plain time sets both parts. If you set the pending part, leases cannot become short near the start
        /// ([mission.md](mission.md)).
        #[default("running 2s, pending computed")]
        stop_condition: kinds::LEASE,
        /// Reaction to a robot's failure: `stop` all where they are, send all `home`, or continue `without` it.
        ///
        /// With `home`, all robots stop, then move to their default positions together.
        #[default("`stop`")]
        on_failure: kinds::ON_FAILURE,
        #[default("`start`")]
        on_doubt: kinds::ON_DOUBT,
        /// After the last act, devices move to their default values: with `home`, in the shortest time that their limits permit; with
        /// `{home: time}`, in this time.
        #[default("devices stay where they are")]
        at_end: Kind::AnyOf(&[&schema!({"const": "home"}), &AtEndKeys::KIND]),
        require: RequireKeys::KIND,
        /// The cues.
        ///
        /// A scenario has either `cues` or `acts`.
        cues: kinds::CUES,
        /// Acts, each started separately.
        acts: Kind::List(&ActKeys::KIND, 1..=usize::MAX),
    }
    also {"oneOf": [{"required": ["cues"]}, {"required": ["acts"]}]}
}

impl<'a> ScenarioKeys<'a> {
    const fn parts(&self) -> library::Parts<'a> {
        let Self { variables, moves, sequences, roles, formations, paths, .. } = *self;
        library::Parts { variables, moves, sequences, roles, formations, paths }
    }
}

keys! {
    /// Behaviour at the end of the show.
    pub(super) struct AtEndKeys {
        /// Duration of the movement home.
        #[required]
        home: kinds::TIME,
    }
}

/// Returns the declaration of the keys of a scenario.
#[must_use]
pub fn scenario_keys() -> &'static Declaration {
    ScenarioKeys::declaration()
}

/// Returns the declaration of the keys of a file that scenarios include.
#[must_use]
pub fn included_keys() -> &'static Declaration {
    library::IncludedKeys::declaration()
}

/// Reads the trees of a scenario and its included files. Reports and skips invalid parts.
pub(crate) fn read(
    reader: &mut Reader,
    documents: &Documents<'_>,
    files: &dyn Files,
    fleet: &Fleet,
) -> Option<Scenario> {
    let root = documents.nodes.first()?;
    let at = At::document(root, 0);
    let own = acts::without_cue(reader, &at, "the scenario", ScenarioKeys::NAMES, &["tracks", "form"]);
    let at = own.as_ref().map_or(at, |own| at.with(own));
    let keys: ScenarioKeys<'_> = reader.keys(&at, "the scenario")?;
    keys.fleet.and_then(|at| reader.text(&at, "the path of a fleet file").map(drop));
    reader.cue_keys = CueKeys::NAMES;
    reader.group = standing::at_first(fleet);
    reader.units = Units::of(fleet.robots.iter().flat_map(devices_of));
    let library = shared(reader, documents, files, fleet, &keys);
    library::music(reader, keys.tempo, keys.signature);
    let (requirements, closest_place) = keys.require.map(|at| require::read(reader, &at)).unwrap_or_default();
    let default = StopCondition { pending: None, running: Millis::new(RUNNING_LEASE_MS).ok() };
    let lease = keys.stop_condition.and_then(|at| cue::lease(reader, &at, default));
    let mut scenario = Scenario {
        name: keys.scenario.and_then(|at| reader.name(&at, "the scenario's name")).unwrap_or_default(),
        start_tolerance: keys.start_tolerance.and_then(|at| reader.duration(&at)).unwrap_or(START_TOLERANCE),
        lead: keys.lead.and_then(|at| read_lead(reader, &at)),
        stop_condition: lease.unwrap_or(default),
        lease_place: keys.stop_condition.filter(|_| lease.is_some()).map(|at| at.place()),
        requirements,
        closest_place,
        at_end: keys.at_end.and_then(|at| read_at_end(reader, &at)),
        ..Scenario::default()
    };
    let defaults = acts::Defaults {
        lease: scenario.stop_condition,
        off_grid: keys.off_grid.and_then(|at| reader.word(&at, &cue::OFF_GRID)).unwrap_or_default(),
        order: keys.order.and_then(|at| reader.word(&at, &cue::ORDER)).unwrap_or_default(),
        zones: keys.zones,
        on_failure: keys.on_failure.map(|at| acts::on_failure(reader, &at)).unwrap_or_default(),
        on_doubt: keys.on_doubt.and_then(|at| reader.word(&at, &acts::ON_DOUBT)).unwrap_or_default(),
    };
    scenario.acts = acts::read(reader, &library, &defaults, &at, [keys.cues, keys.acts]);
    for name in library.unused("move") {
        movement::check_unused(reader, &library, &name);
    }
    for name in library.unused("sequence") {
        sequence::check_unused(reader, &library, &defaults, &name);
    }
    scenario.roles = library.roles;
    (scenario.formations, scenario.paths) = (library.formations, library.paths);
    Some(scenario)
}

/// Reads the key `at_end`: `home`, or a map of `home` with a duration.
fn read_at_end(reader: &mut Reader, at: &At<'_>) -> Option<AtEnd> {
    let place = at.place();
    let Node::Map(_) = at.node else {
        return reader.word(at, &[("home", ())]).map(|()| AtEnd { over: None, place });
    };
    let AtEndKeys { home } = reader.keys(at, "`at_end`")?;
    let over = Some(reader.duration(&home?)?);
    Some(AtEnd { over, place })
}

/// Reads the parts that cues share, such as moves and formations, from all files.
fn shared<'a>(
    reader: &mut Reader,
    documents: &'a Documents<'_>,
    files: &'a dyn Files,
    fleet: &'a Fleet,
    keys: &ScenarioKeys<'_>,
) -> library::Library<'a> {
    let mut library = library::Library::new(documents, files, fleet);
    let included = documents.nodes.iter().zip(&documents.names).zip(&documents.plain);
    for (file, ((node, name), place)) in (0u16..).zip(included).skip(1) {
        if let Some(place) = place {
            library.include(reader, node, file, name, place);
        }
    }
    library.add(reader, keys.include, &keys.parts());
    library.globals = reader.scope.mark();
    includes::copies(reader, &mut library, documents);
    library
}

/// Returns the parts that a scenario's cues share, without reading the cues.
pub(crate) fn library_of<'a>(
    reader: &mut Reader,
    documents: &'a Documents<'_>,
    files: &'a dyn Files,
    fleet: &'a Fleet,
) -> Option<library::Library<'a>> {
    let at = At::document(documents.nodes.first()?, 0);
    let keys: ScenarioKeys<'_> = reader.keys(&at, "the scenario")?;
    Some(shared(reader, documents, files, fleet, &keys))
}

/// Reads the lead (the time from the sending of scripts to the start). A longer lead leaves less time for the act.
fn read_lead(reader: &mut Reader, at: &At<'_>) -> Option<Span> {
    let (lead, (most, _)) = (reader.duration(at)?, LEADS);
    if lead > most {
        let hint = Some("use the `wait` of an act to wait for a time of day".to_owned());
        reader.add(Code::TooMuch, at.place(), format!("a lead of {lead}"), format!("at most {most}"), hint);
    }
    Some(lead.min(most))
}

/// Reads a scenario and everything that it includes.
///
/// # Errors
/// Returns the findings if a file cannot be read or is not YAML.
pub(crate) fn documents<'a>(source: &'a Source, files: &dyn Files) -> Result<Documents<'a>, Vec<Finding>> {
    library::documents(source, files)
}

fn nothing(reader: &mut Reader, at: &At<'_>, message: &str, expected: &str) {
    reader.add(Code::NothingToDo, at.place(), message, expected, None);
}
