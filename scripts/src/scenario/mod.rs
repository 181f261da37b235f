//! The scenario as written, variables and moves put in. Names of robots are resolved against the fleet in `compile`.
//!
//! `library` reads what cues share, `formations` places, `paths` ways, `cue` a cue, `when` its times, `track` the movement of one device, `acts` the graph.

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
use crate::finding::{Code, Finding, Part, Place};
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

/// Largest allowed spread of starts where the scenario names none.
const START_TOLERANCE: Span = Span::from_millis(10);
/// Running lease where the scenario names none: two seconds of silence.
const RUNNING_LEASE_MS: f64 = 2_000.0;

/// A choreography as written.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scenario {
    pub(crate) name: String,
    pub(crate) start_tolerance: Span,
    pub(crate) lead: Option<Span>,
    pub(crate) stop_condition: StopCondition,
    pub(crate) lease_place: Option<Place>,
    pub(crate) requirements: Requirements,
    /// Where the least distance of bodies is required.
    pub(crate) closest_place: Option<Place>,
    pub(crate) roles: HashMap<String, Vec<Name>>,
    pub(crate) formations: HashMap<String, WrittenFormation>,
    pub(crate) paths: HashMap<String, WrittenPath>,
    pub(crate) acts: Vec<Act>,
    pub(crate) at_end: Option<AtEnd>,
}

/// Devices move to their default values when the mission has ended well.
#[derive(Clone, Debug)]
pub(crate) struct AtEnd {
    /// Duration of the movement; computed from the limits of the devices if none is given.
    pub(crate) over: Option<Span>,
    pub(crate) place: Place,
}

/// What starts together.
#[derive(Clone, Debug)]
pub(crate) struct Act {
    pub(crate) name: String,
    pub(crate) place: Place,
    pub(crate) cues: Vec<Cue>,
    /// Faults that reading its cues has found: what they would have said of its times is missing.
    pub(crate) faults: usize,
    /// Zones with the way their cues are ordered, the act's own last. Acts without own ones share a list.
    pub(crate) zones: Arc<[(String, Order)]>,
    /// For cues that are kept apart.
    pub(crate) order: Order,
    pub(crate) wait: WrittenWait,
    pub(crate) next: Option<Name>,
    pub(crate) on_failure: OnFailureRule,
    pub(crate) on_doubt: OnDoubt,
}

/// How cues that need the same zone are put in order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Order {
    /// As they are in the file.
    #[default]
    Given,
    /// The best order that is found.
    Auto,
}

/// Some robots move some devices.
#[derive(Clone, Debug)]
pub(crate) struct Cue {
    pub(crate) name: String,
    pub(crate) place: Place,
    pub(crate) relations: Vec<Relation>,
    /// Fixed or bounded length to which its movement is stretched.
    pub(crate) duration: Option<Bounds>,
    pub(crate) robots: Vec<Name>,
    pub(crate) robots_place: Place,
    /// What the robots do that no override names.
    pub(crate) movement: Movement,
    pub(crate) overrides: Vec<(Name, Movement)>,
    /// The movements of robots that have one of their own, because it depends on which of them it is.
    pub(crate) own: Vec<Movement>,
    /// Which of them each robot of the cue has, in their order; empty where none has.
    pub(crate) own_of: Vec<Option<usize>>,
    /// How much later each robot begins than the cue.
    pub(crate) canon: Canon,
    pub(crate) uses: Vec<Name>,
    pub(crate) apart: Vec<Name>,
    pub(crate) stop_condition: Option<StopCondition>,
    pub(crate) off_grid: OffGrid,
    pub(crate) readings: Vec<Reading>,
    /// What the robots do as a group, in space.
    pub(crate) group: Option<Together>,
    /// The ways of the group, as far as its places were known when the cue was read.
    pub(crate) rehearsed: Option<Rehearsed>,
    /// For its tracks without one.
    pub(crate) tolerance: Option<f64>,
    pub(crate) text: CueText,
}

/// The tracks of a cue for some robots.
#[derive(Clone, Debug, Default)]
pub(crate) struct Movement {
    pub(crate) tracks: Vec<Track>,
    /// Later than the cue.
    pub(crate) delay: Span,
    pub(crate) length: Span,
    pub(crate) repetition: Option<Repetition>,
    /// Parameters without a value: faults only if some robot does it.
    pub(crate) unset: Vec<Unset>,
}

/// A least and a largest length.
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
    /// How long it is, before it is laid on the clock.
    pub(crate) length: Exact,
    /// How much later than the movement it begins, before that is laid on the clock.
    pub(crate) begin: Exact,
    /// The same on the clock.
    pub(crate) starts: Span,
    /// The movements that it consists of, if a move plays several.
    pub(crate) pieces: Vec<Piece>,
    pub(crate) tolerance: Option<f64>,
    pub(crate) steps_max: Option<u32>,
    /// Place of the track's key.
    pub(crate) place: Place,
    /// How often it has been repeated in all.
    pub(crate) turns: u32,
    /// What its items are called: keyframes, points, pieces, rows.
    pub(crate) items: Items,
    /// Place of the list of its keyframes.
    pub(crate) list: Place,
    /// Items that depend on a parameter, and where that is given.
    pub(crate) given: Givens,
    /// The last change of all its values.
    pub(crate) changed: Option<Changed>,
}

/// A movement of its own within a track.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    /// The number of its first item among those of the track.
    pub(crate) first: u32,
    pub(crate) items: Items,
    /// Place of the list of its items.
    pub(crate) list: Place,
}

/// What a movement is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Items {
    Keyframes,
    Points,
    Pieces,
    Rows,
    /// It has no items.
    Whole,
}

impl Items {
    /// One of them, for messages.
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

/// One value over time, or several at times.
#[derive(Clone, Debug)]
pub(crate) enum Motion {
    Curve(Curve),
    Vectors(Vectors),
}

/// What happens to values off a device's grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum OffGrid {
    /// A finding.
    #[default]
    Refuse,
    /// The nearest value on the grid, with a warning.
    Snap,
}

/// A sensor is read at some time of a cue.
#[derive(Clone, Debug)]
pub(crate) struct Reading {
    pub(crate) sensor: String,
    pub(crate) at: Span,
    pub(crate) place: Place,
}

impl Reading {
    /// The place of the sensor's name.
    pub(crate) fn key_place(&self) -> Place {
        let is_sensor = |part: &Part| matches!(part, Part::Key(key, _) if *key == self.sensor);
        let path = &self.place.path;
        let end = path.iter().rposition(is_sensor).map_or(path.len(), |sensor| sensor + 1);
        Place { key: true, path: path[..end].to_vec(), ..self.place.clone() }
    }
}

impl Scenario {
    /// Until when its acts have ended: a script is sent with its start and the lead added up.
    pub(crate) fn horizon(&self) -> Span {
        longest() - self.lead.unwrap_or_default().max(LEADS.1)
    }

    /// What its groups need to know.
    pub(crate) fn ground<'a>(&'a self, fleet: &'a Fleet) -> Ground<'a> {
        Ground { fleet, formations: &self.formations, paths: &self.paths }
    }
}

impl Track {
    /// The item of this number: what it is called, its own number from 0 unless it is a whole movement, and its place.
    pub(crate) fn item(&self, item: u32) -> (Items, Option<u32>, Place) {
        let (items, own, list) = match self.pieces.iter().rfind(|piece| piece.first <= item) {
            Some(piece) if item != u32::MAX => (piece.items, item - piece.first, &piece.list),
            _ => (self.items, item, &self.list),
        };
        match own {
            u32::MAX => (items, None, list.clone()),
            _ if items == Items::Whole => (items, None, list.clone()),
            own => (items, Some(own), list.below(Part::Index(own as usize))),
        }
    }

    /// Where the parameter on which an item depends is given.
    pub(crate) fn given(&self, item: u32) -> Option<&Place> {
        self.given_as(item).map(|given| given.place.as_ref())
    }

    pub(crate) fn given_as(&self, item: u32) -> Option<&Given> {
        self.given.iter().find(|(known, _)| *known == item).map(|(_, given)| given)
    }

    /// When it ends, before that is laid on the clock.
    pub(crate) fn end(&self) -> Exact {
        self.begin.plus(self.length)
    }
}

impl Motion {
    /// How much memory it takes, in knots.
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

/// The fleet file that a scenario names, relative to the scenario's own folder.
#[must_use]
pub fn fleet_named_by(source: &Source) -> Option<PathBuf> {
    // The key stands at the left margin of a block map, or nowhere that is found so cheaply.
    if !source.text.contains("fleet") {
        return None;
    }
    let Ok(Node::Map(entries)) = node::parse(source) else { return None };
    entries.into_iter().find_map(|(key, node)| match node {
        Node::Text(path) if key == "fleet" => Some(PathBuf::from(path)),
        _ => None,
    })
}

/// A finding about the fleet file that a scenario names, at the place at which it names it.
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
        fleet: kinds::TEXT,
        include: kinds::INCLUDE,
        /// Names with values; `$name` stands for the value.
        ///
        /// Values are numbers, times, words, and expressions of variables before them. `-$name` stands for the negative value.
        variables: kinds::VARIABLES,
        moves: kinds::MOVES,
        sequences: kinds::SEQUENCES,
        /// Names for robots and groups.
        ///
        /// They are for use in cues, and differ from the names of robots and groups.
        roles: kinds::ROLES,
        /// Formations by name: places for any number of robots.
        ///
        /// See [formations](#a-formation).
        formations: kinds::FORMATIONS,
        /// Paths by name: ways through space along which groups of robots go.
        ///
        /// See [paths](#a-path).
        paths: kinds::PATHS,
        tempo: kinds::TEMPO,
        signature: kinds::SIGNATURE,
        zones: kinds::ZONES,
        /// How cues that share a zone follow each other: as they stand in the file, or in the best order that is found.
        ///
        /// It is for zones that do not set an order of their own, and for `apart`.
        #[default("`given`")]
        order: kinds::ORDER,
        #[default("`refuse`")]
        off_grid: kinds::OFF_GRID,
        /// Largest allowed spread of starts.
        ///
        /// A fleet whose clocks allow more does not start; if starts were further apart, the mission ends `out_of_tolerance`; if
        /// a step was later than that, it ends `steps_late`.
        #[default("10ms")]
        start_tolerance: kinds::TIME,
        /// From sending to the start.
        #[default("computed from the measured delays")]
        lead: kinds::TIME,
        /// How long the server may be silent before the robot stops by itself.
        ///
        /// A plain time sets both parts. If you set the pending part, leases cannot become short near the start
        /// ([mission.md](mission.md)).
        #[default("running 2s, pending computed")]
        stop_condition: kinds::LEASE,
        /// What a robot's failure does: `stop` all where they are, send all `home`, or go on `without` it.
        ///
        /// With `home`, all stop, and then move to their default positions together.
        #[default("`stop`")]
        on_failure: kinds::ON_FAILURE,
        #[default("`start`")]
        on_doubt: kinds::ON_DOUBT,
        /// After the last act, devices move to their default values: with `home`, in the shortest time that their limits permit;
        /// with `{home: time}`, in this time.
        #[default("devices stay where they are")]
        at_end: Kind::AnyOf(&[&schema!({"const": "home"}), &AtEndKeys::KIND]),
        require: RequireKeys::KIND,
        /// What happens.
        ///
        /// A scenario has either `cues` or `acts`.
        cues: kinds::CUES,
        /// Acts, each started by itself.
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
    /// What happens when the show ends.
    pub(super) struct AtEndKeys {
        /// How long the way home takes.
        #[required]
        home: kinds::TIME,
    }
}

/// The keys of scenarios.
pub(crate) fn scenario_keys() -> &'static Declaration {
    ScenarioKeys::declaration()
}

/// The keys of files that scenarios include.
pub(crate) fn included_keys() -> &'static Declaration {
    library::IncludedKeys::declaration()
}

/// Reads the trees of a scenario and its includes. What is wrong is left out and found.
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

/// `home`, or `home` with a duration.
fn read_at_end(reader: &mut Reader, at: &At<'_>) -> Option<AtEnd> {
    let place = at.place();
    let Node::Map(_) = at.node else {
        return reader.word(at, &[("home", ())]).map(|()| AtEnd { over: None, place });
    };
    let AtEndKeys { home } = reader.keys(at, "`at_end`")?;
    let over = Some(reader.duration(&home?)?);
    Some(AtEnd { over, place })
}

/// What cues share, of all files.
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
            library.include(reader, node, file, (name, place));
        }
    }
    library.add(reader, keys.include, &keys.parts());
    library.globals = reader.scope.mark();
    includes::copies(reader, &mut library, documents);
    library
}

/// What the cues of a scenario share, without the cues.
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

/// Scripts are sent that much ahead: what remains is for the act.
fn read_lead(reader: &mut Reader, at: &At<'_>) -> Option<Span> {
    let (lead, (most, _)) = (reader.duration(at)?, LEADS);
    if lead > most {
        let hint = Some("wait for a time of day with an act's `wait`".to_owned());
        reader.add(Code::TooMuch, at.place(), format!("a lead of {lead}"), format!("at most {most}"), hint);
    }
    Some(lead.min(most))
}

/// Reads a scenario's file and everything that it includes.
///
/// # Errors
/// The findings when one of them cannot be read or is not YAML.
pub(crate) fn documents<'a>(source: &'a Source, files: &dyn Files) -> Result<Documents<'a>, Vec<Finding>> {
    library::documents(source, files)
}

fn nothing(reader: &mut Reader, at: &At<'_>, message: &str, expected: &str) {
    reader.add(Code::NothingToDo, at.place(), message, expected, None);
}
