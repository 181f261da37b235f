//! The kinds of values that several keys of a scenario share.

use super::acts::{
    ON_DOUBT as ON_DOUBT_WORDS, ON_FAILURE as ON_FAILURE_WORDS, OnFailureKeys, WAIT_WORDS, WaitKeys,
};
use super::canon::CanonKeys;
use super::cue::{CueKeys, LeaseKeys, OFF_GRID as OFF_GRID_WORDS, ORDER as ORDER_WORDS};
use super::formations::FormationKeys;
use super::includes::IncludeKeys;
use super::library::TempoKeys;
use super::movement::{MirrorKeys, MoveKeys, RepeatKeys, ScaleKeys};
use super::paths::PathKeys;
use super::play::PlayKeys;
use super::sequence::SequenceKeys;
use super::track::{KeyframeKeys, TrackKeys};
use crate::keys::{Item, Kind, Naming};
pub(super) use downbeat_reader::kinds::{
    BOOLEAN, BY, DIRECTION, EXPRESSION, FILE, NAME, NAMES, NUMBER, PLACE, PLAIN_NUMBER, SPREAD, TEXT, TIME,
    TRUTH, VARIABLE,
};
use downbeat_reader::{named, schema, words};

named! {
    /// A time from the start of the act, such as `20s`, or a position in the music, such as `bar 3 beat 2`.
    pub(super) static INSTANT = Kind::AnyOf(&[
        &TIME,
        &schema!({"type": "string", "pattern": "^\\s*bar\\s+\\d+(\\s+beat\\s+\\d+(\\.\\d+)?)?\\s*$"}),
    ]);

    /// A time from the start of the act or a position in the music; or a range `2s..4s`.
    pub(super) static INSTANTS = Kind::AnyOf(&[&INSTANT, &RANGE]);

    /// A length `5s`, or bounds `2s..5s`.
    pub(super) static TIMES = Kind::AnyOf(&[&TIME, &RANGE]);

    /// A cue of the same act, or a list of them: `raise`, `start of raise + 500ms`, `raise + 0s..1s`.
    pub(super) static RELATION =
        Kind::Name(Naming::Uses(Item::Cue), &Kind::AnyOf(&[&TEXT, &PLAIN_NUMBER, &Kind::List(&NAME, 0..=usize::MAX)]));

    /// Longest silence of the server before the robot stops by itself.
    pub(super) static LEASE = Kind::AnyOf(&[&TIME, &LeaseKeys::KIND]);

    /// Order of cues that share a zone: as in the file, or the best order found.
    pub(super) static ORDER = words!(ORDER_WORDS);

    /// Values off a device's grid: refuse them, or take the nearest and warn.
    pub(super) static OFF_GRID = words!(OFF_GRID_WORDS);

    /// Reaction to a failure.
    pub(super) static FAILURE_WORD = words!(ON_FAILURE_WORDS);

    /// Reaction to a robot's failure: `stop` all where they are, send all `home`, or continue `without` it.
    pub(super) static ON_FAILURE =
        Kind::AnyOf(&[&FAILURE_WORD, &Kind::NameKeys(Naming::Uses(Item::Robot), &Kind::KeysAnd(OnFailureKeys::declaration, &FAILURE_WORD))]);

    /// Reaction of the others if a robot is silent shortly before the start and may or may not start: they `start` (default), or
    /// `withdraw` and do not move.
    pub(super) static ON_DOUBT = words!(ON_DOUBT_WORDS);

    /// `below` or `at most` a time, as in `below 5ms`.
    pub(super) static CEILING = Kind::AnyOf(&[
        &schema!({
            "type": "string",
            "pattern": "^\\s*(below|at\\s+most)\\s+(\\d+(\\.\\d+)?(h|m|min|s|ms|us))+\\s*$"
        }),
        &VARIABLE,
    ]);

    /// `above` or `at least` a percentage from 0 to 100, as in `above 99.9%`.
    pub(super) static LEAST_SHARE = Kind::AnyOf(&[
        &schema!({
            "type": "string",
            "pattern": "^\\s*(above|at\\s+least)\\s+(100(\\.0+)?|\\d{1,2}(\\.\\d{1,7})?)\\s*%\\s*$"
        }),
        &VARIABLE,
    ]);

    /// `above` or `at least` a distance in m, cm or mm, as in `above 0.3m`.
    pub(super) static LEAST_DISTANCE = Kind::AnyOf(&[
        &schema!({"type": "string", "pattern": "^\\s*(above|at\\s+least)\\s+\\d+(\\.\\d+)?\\s*(mm|cm|m)\\s*$"}),
        &VARIABLE,
    ]);

    /// Beats per minute, or a list of tempos with the bars from which they apply.
    pub(super) static TEMPO = Kind::AnyOf(&[
        &schema!({"type": "number", "minimum": 1, "maximum": 10000}),
        &VARIABLE,
        &Kind::List(&TempoKeys::KIND, 0..=usize::MAX),
    ]);

    /// A time signature such as `3/4`: beats per bar, and the note value of a beat.
    pub(super) static SIGNATURE = schema!({"type": "string", "pattern": "^\\s*\\d+\\s*/\\s*\\d+\\s*$"});

    /// Things that only one cue can use at a time: a list of names, or a map from name to order.
    pub(super) static ZONES = Kind::AnyOf(&[
        &Kind::Name(Naming::Defines(Item::Zone), &Kind::List(&NAME, 0..=usize::MAX)),
        &Kind::NameKeys(Naming::Defines(Item::Zone), &Kind::Entries(&ORDER)),
    ]);

    /// The movement of a device.
    pub(super) static TRACK =
        Kind::AnyOf(&[&Kind::List(&KeyframeKeys::KIND, 0..=usize::MAX), &TrackKeys::KIND]);

    /// A map from device to its movement.
    pub(super) static TRACKS = Kind::NameKeys(Naming::Uses(Item::Device), &Kind::SomeEntries(&TRACK));

    /// Other moves, one after another; those of a list within the list begin together.
    pub(super) static PLAY = Kind::List(
        &Kind::AnyOf(&[&PlayKeys::KIND, &Kind::List(&PlayKeys::KIND, 0..=usize::MAX)]),
        1..=usize::MAX,
    );

    /// Values for the parameters of the move.
    pub(super) static PARAMETERS =
        Kind::NameKeys(Naming::Uses(Item::Parameter), &Kind::Entries(&Kind::AnyOf(&[&schema!({"type": ["number", "string", "boolean"]}), &SPREAD])));

    /// The move's device names on this robot: `{shoulder_lift: wrist_1}`.
    pub(super) static DEVICES = Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&Kind::Name(Naming::Uses(Item::Device), &NAME)));

    /// Values mirrored about 0 or another value.
    pub(super) static MIRROR = Kind::AnyOf(&[&BOOLEAN, &EXPRESSION, &MirrorKeys::KIND]);

    /// Values scaled by a factor.
    pub(super) static SCALE = Kind::AnyOf(&[&NUMBER, &ScaleKeys::KIND]);

    /// The movement backwards.
    pub(super) static REVERSE = Kind::AnyOf(&[&BOOLEAN, &EXPRESSION]);

    /// Number of times that the movement is played.
    pub(super) static REPEAT = Kind::AnyOf(&[&TURNS, &EXPRESSION, &SPREAD, &RepeatKeys::KIND]);

    /// The cues.
    pub(super) static CUES = Kind::List(&CueKeys::KIND, 1..=usize::MAX);

    /// Condition for the act's beginning: done (the default), operator, a time of day, or a sensor.
    pub(super) static WAIT = Kind::AnyOf(&[&words!(WAIT_WORDS), &WaitKeys::KIND]);

    /// Files with variables, moves, sequences and roles, from the scenario's folder; `{file, as, parameters}` includes a file under its
    /// own name.
    pub(super) static INCLUDE = Kind::AnyOf(&[&FILE, &IncludeKeys::KIND, &Kind::List(&ONE_INCLUDE, 0..=usize::MAX)]);

    /// Names with values; `$name` stands for the value.
    pub(super) static VARIABLES = Kind::NameKeys(Naming::Defines(Item::Variable), &Kind::Entries(&schema!({"type": ["number", "string", "boolean"]})));

    /// Moves by name.
    ///
    /// A move has `doc`, `parameters`, and `tracks` or `play`.
    pub(super) static MOVES = Kind::NameKeys(Naming::Defines(Item::Move), &Kind::Entries(&MoveKeys::KIND));

    /// Sequences of cues by name.
    ///
    /// A sequence has `doc`, `parameters` and `cues`.
    pub(super) static SEQUENCES = Kind::NameKeys(Naming::Defines(Item::Sequence), &Kind::Entries(&SequenceKeys::KIND));

    /// Names for robots and groups.
    pub(super) static ROLES = Kind::NameKeys(Naming::Defines(Item::Robot), &Kind::Entries(&ROBOTS));

    /// Formations by name: places for any number of robots.
    pub(super) static FORMATIONS = Kind::NameKeys(Naming::Defines(Item::Formation), &Kind::Entries(&FormationKeys::KIND));

    /// Paths by name: routes through space along which groups of robots move.
    pub(super) static PATHS = Kind::NameKeys(Naming::Defines(Item::Path), &Kind::Entries(&PathKeys::KIND));

    /// Degrees about the vertical, or roll, pitch and yaw; of a formation about its middle.
    pub(super) static ROTATION = Kind::AnyOf(&[&NUMBER, &Kind::List(&NUMBER, 3..=3)]);

    /// Delay from each robot to the next.
    pub(super) static CANON = Kind::AnyOf(&[&TIME, &CanonKeys::KIND]);
}

/// Values by parameter of the defining item, or nothing for a parameter without a default.
pub(super) static DEFAULTS: Kind = Kind::NameKeys(
    Naming::Defines(Item::Parameter),
    &Kind::Entries(&schema!({"type": ["number", "string", "boolean", "null"]})),
);
/// The name of a move.
pub(super) static MOVE: Kind = Kind::Name(Naming::Uses(Item::Move), &NAME);
/// The name of an act.
pub(super) static ACT: Kind = Kind::Name(Naming::Uses(Item::Act), &NAME);
/// Names of robots, groups and roles.
pub(super) static ROBOTS: Kind = Kind::Name(Naming::Uses(Item::Robot), &NAMES);
/// Names of devices.
pub(super) static DEVICE_NAMES: Kind = Kind::Name(Naming::Uses(Item::Device), &NAMES);
/// An entry under `include`: a file, plain or under its own name.
static ONE_INCLUDE: Kind = Kind::AnyOf(&[&FILE, &IncludeKeys::KIND]);
/// Number of times that a movement is played, as an integer.
pub(super) static TURNS: Kind = schema!({"type": "integer", "minimum": 1, "maximum": 10000000});
/// A range: two bounds separated by two dots.
static RANGE: Kind = schema!({"type": "string", "pattern": "^.+\\.\\..+$"});
