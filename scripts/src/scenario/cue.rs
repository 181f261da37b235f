//! A cue: its robots, their movement and its time, and the changes that apply to the movement.

use urrcp::{Millis, Span, StopCondition};

use super::acts::Defaults;
use super::canon;
use super::each::movements;
use super::form::{AlongKeys, FormKeys, TurnKeys};
use super::kinds;
use super::library::Library;
use super::movement::Shaping;
use super::when::{Timing, When, range};
use super::{Bounds, Cue, Name, OffGrid, Order, Reading, form, nothing, standing};
use crate::exact::Beginning;
use crate::fields::{At, Reader};
use crate::finding::{Code, Place};
use crate::node::Node;
use crate::plan::CueText;
use downbeat_reader::keys::{Item, Kind, Naming};
use downbeat_reader::{keys, schema};

pub(super) const OFF_GRID: [(&str, OffGrid); 2] = [("refuse", OffGrid::Refuse), ("snap", OffGrid::Snap)];
pub(super) const ORDER: [(&str, Order); 2] = [("given", Order::Given), ("auto", Order::Auto)];

keys! {
    /// Robots move devices from some time on. Without robots and tracks, it is a mark that others can refer to.
    pub(crate) struct CueKeys as "cue" {
        /// Its name, for other cues and messages.
        cue: Kind::Name(Naming::Defines(Item::Cue), &kinds::NAME),
        /// When it starts: a time or position, exactly; or a range.
        at: kinds::INSTANTS,
        /// Starts when these have ended, or later.
        ///
        /// `NAME`, `NAME + 500ms` (or more), `NAME + 0s..1s`; from the end of the cue, or `start of NAME`.
        after: kinds::RELATION,
        /// Starts together with these.
        ///
        /// `NAME`, `NAME + 500ms` (exactly), `NAME - 500ms`, `NAME + -2s..3s`; from the start of the cue, or `end of NAME`.
        with: kinds::RELATION,
        /// Ends before these start: `finish - 1s`.
        ///
        /// `NAME`, `NAME - 500ms`, `NAME - 0s..1s`; to the start of the cue, or `end of NAME`.
        before: kinds::RELATION,
        /// A deadline for its end.
        end_by: kinds::INSTANT,
        /// Its movement is stretched to this length; within bounds it is as short as devices and neighbours allow.
        ///
        /// It includes all [repetitions](#the-order-of-changes).
        duration: kinds::TIMES,
        /// A robot, a group, a role, or a list of them.
        robots: kinds::ROBOTS,
        /// The name of a move.
        r#move: kinds::MOVE,
        /// The name of a sequence, whose cues it plays.
        ///
        /// It takes `parameters` and `robots`.
        sequence: Kind::Name(Naming::Uses(Item::Sequence), &kinds::NAME),
        parameters: kinds::PARAMETERS,
        tracks: kinds::TRACKS,
        devices: kinds::DEVICES,
        mirror: kinds::MIRROR,
        scale: kinds::SCALE,
        reverse: kinds::REVERSE,
        repeat: kinds::REPEAT,
        /// Delay from each robot to the next.
        ///
        /// See [patterns over a group](#patterns-over-a-group).
        canon: kinds::CANON,
        /// Other values for some robots.
        overrides: Kind::NameKeys(Naming::Uses(Item::Robot), &Kind::Entries(&OverrideKeys::KIND)),
        /// Zones that it needs.
        uses: Kind::Name(Naming::Uses(Item::Zone), &kinds::NAMES),
        /// Cues that it must not overlap.
        apart: Kind::Name(Naming::Uses(Item::Cue), &kinds::NAMES),
        stop_condition: kinds::LEASE,
        off_grid: kinds::OFF_GRID,
        /// Largest permitted error of its tracks, in the devices' unit.
        tolerance: kinds::NUMBER,
        /// Sensors to be read, with the times from the cue's start.
        read: Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&Kind::AnyOf(&[&kinds::TIME, &Kind::List(&kinds::TIME, 0..=usize::MAX)]))),
        /// The robots move into this formation without coming too close to each other.
        form: Kind::AnyOf(&[&Kind::Name(Naming::Uses(Item::Formation), &kinds::NAME), &FormKeys::KIND]),
        /// The robots turn as one body about the vertical, in degrees from x to y.
        turn: Kind::AnyOf(&[&kinds::NUMBER, &TurnKeys::KIND]),
        /// The robots move away from their middle by this factor, or towards it if it is less than 1.
        grow: kinds::NUMBER,
        /// The robots move as one body, in metres along x, y and z.
        shift: Kind::List(&kinds::NUMBER, 3..=3),
        /// The robots are carried along this path as one body, from where they are.
        along: Kind::AnyOf(&[&Kind::Name(Naming::Uses(Item::Path), &kinds::NAME), &AlongKeys::KIND]),
        /// Time for each robot for `form`, `turn`, `grow`, `shift` and `along`.
        over: kinds::TIME,
        /// A remark, which `plan` prints next to the cue.
        note: kinds::TEXT,
    }
}

keys! {
    /// Differences for one robot.
    pub(super) struct OverrideKeys as "override" {
        /// The name of a move.
        r#move: kinds::MOVE,
        parameters: kinds::PARAMETERS,
        tracks: kinds::TRACKS,
        devices: kinds::DEVICES,
        mirror: kinds::MIRROR,
        scale: kinds::SCALE,
        reverse: kinds::REVERSE,
        repeat: kinds::REPEAT,
        /// Its delay relative to the cue.
        delay: kinds::TIME,
    }
}

keys! {
    /// Separate leases for waiting and for running scripts.
    pub(super) struct LeaseKeys {
        /// Longest silence of the server before a script that has not started is dropped.
        pending: Kind::AnyOf(&[&kinds::TIME, &schema!({"const": "none"})]),
        /// Longest silence of the server before a running script ends. With `none`, shows continue without a link.
        running: Kind::AnyOf(&[&kinds::TIME, &schema!({"const": "none"})]),
    }
}

pub(super) fn read(
    reader: &mut Reader,
    library: &Library<'_>,
    defaults: &Defaults<'_>,
    at: &At<'_>,
    index: usize,
) -> Option<Cue> {
    let keys: CueKeys<'_> = reader.keys(at, "a cue")?;
    let CueKeys { r#move: named, tracks, robots, duration, .. } = keys;
    let grouped = [keys.form, keys.turn, keys.grow, keys.shift, keys.along].iter().any(Option::is_some);
    let moves = named.is_some() || tracks.is_some() || keys.read.is_some() || grouped;
    let cast = reader.nesting.robots.clone().filter(|_| robots.is_none() && moves);
    for (missing, key) in
        [(robots.is_none() && moves && cast.is_none(), "robots"), (robots.is_some() && !moves, "tracks")]
    {
        let is_moved = || {
            ["move", "form", "turn", "grow", "shift", "along", "over"]
                .iter()
                .any(|key| reader.is_miswritten(at, key))
        };
        if missing && !reader.is_miswritten(at, key) && (key == "robots" || !is_moved()) {
            let message = format!("a cue has no `{key}`");
            let hint = Some(match key {
                "robots" => {
                    "a cue with neither robots nor tracks is a marker that other cues can refer to".to_owned()
                }
                _ => {
                    "define what its robots do: add `tracks`, `move`, `form`, `turn`, `grow`, `shift` or `along`"
                        .to_owned()
                }
            });
            reader.add(Code::MissingKey, at.place(), message, format!("a key `{key}`"), hint);
        }
    }
    let robots_place = robots.map_or_else(|| at.place(), |at| at.place());
    let names = match cast {
        Some(cast) => cast.to_vec(),
        None => {
            let names = robots.map(|at| robot_names(reader, &at)).unwrap_or_default();
            library.cast(reader, names)
        }
    };
    reader.group.enter(library.robots(&names));
    let CueKeys { after, with, before, end_by, .. } = keys;
    let when = When { at: keys.at, after, with, before, end_by };
    let Timing { relations, start: fixed, late } = when.read(reader);
    (reader.music.start, reader.nesting.began) = (fixed, fixed);
    let tolerance =
        keys.tolerance.and_then(|at| reader.positive(&at, "an error above 0, in the device's unit"));
    let shaping = Shaping {
        named,
        parameters: keys.parameters,
        tracks,
        devices: keys.devices,
        mirror: keys.mirror,
        scale: keys.scale,
        reverse: keys.reverse,
        repeat: keys.repeat,
        delay: None,
        tolerance,
    };
    let mut group = form::read(reader, at, &keys);
    if let Some(group) = &mut group {
        library.form_name(reader, group);
    }
    let entries =
        keys.overrides.as_ref().map(|at| reader.entries(at, "a map from each robot to its override"));
    let entries = entries.unwrap_or_default();
    let mut overriding = read_overrides(reader, &shaping, &entries);
    overriding.iter_mut().for_each(|overriding| library.cast_name(reader, &mut overriding.name));
    let mut read = movements(reader, library, &shaping, &overriding, &names);
    if let Some(group) = &group {
        read.last_at_least(group.over);
    }
    let mut cue = Cue {
        name: keys
            .cue
            .and_then(|at| reader.name(&at, "the cue's name"))
            .unwrap_or_else(|| format!("cue {}", index + 1)),
        place: at.place(),
        relations,
        duration: duration.and_then(|at| bounds(reader, &at)),
        robots: names,
        robots_place,
        movement: read.shared,
        overrides: read.overrides,
        own: read.own,
        own_of: read.own_of,
        canon: canon::read(reader, keys.canon.as_ref()).delayed(late),
        uses: keys.uses.map(|at| name_list(reader, &at, "a zone or a list of zones")).unwrap_or_default(),
        apart: keys.apart.map(|at| name_list(reader, &at, "a cue or a list of cues")).unwrap_or_default(),
        stop_condition: keys.stop_condition.and_then(|at| lease(reader, &at, defaults.lease)),
        off_grid: keys.off_grid.and_then(|at| reader.word(&at, &OFF_GRID)).unwrap_or(defaults.off_grid),
        readings: keys.read.map(|at| read_readings(reader, &at)).unwrap_or_default(),
        group,
        rehearsed: None,
        tolerance,
        text: CueText { note: keys.note.and_then(|at| reader.text(&at, "a remark as text")).map(Into::into) },
    };
    reader.music.start = Beginning::default();
    cue.rehearsed = standing::leave(&mut reader.group, library, &cue);
    Some(cue)
}

/// Reads a duration `4s`, or bounds `2s..4s`.
fn bounds(reader: &mut Reader, at: &At<'_>) -> Option<Bounds> {
    let (min, max) = match reader.scalar(at)?.as_ref() {
        Node::Text(text) => match range(reader, at, text)? {
            (min, Some(max)) => (min, Some(max)),
            (fixed, None) => (fixed, Some(fixed)),
        },
        _ => reader.duration(at).map(|fixed| (fixed, Some(fixed)))?,
    };
    if max == Some(Span::ZERO) {
        let hint = Some("leave `duration` out to keep the length of the movement".to_owned());
        reader.add(Code::BadMotion, at.place(), "a movement of length 0", "a time above 0", hint);
        return None;
    }
    Some(Bounds { min, max, place: at.place() })
}

pub(super) fn robot_names(reader: &mut Reader, at: &At<'_>) -> Vec<Name> {
    let expected = "a robot, a group or a list of robots and groups";
    if matches!(at.node, Node::List(items) if items.is_empty()) {
        nothing(reader, at, "the list of robots is empty", expected);
    }
    name_list(reader, at, expected)
}

pub(super) fn name_list(reader: &mut Reader, at: &At<'_>, expected: &str) -> Vec<Name> {
    let items = match at.node {
        Node::List(_) => reader.list(at, expected),
        _ => vec![*at],
    };
    let name = |item: &At<'_>| {
        let text = reader.name(item, expected)?;
        let place = reader.given_at(item).map_or_else(|| item.place(), |given| Place::clone(&given));
        Some(Name { text, place })
    };
    items.iter().filter_map(name).collect()
}

/// Reads a lease (longest silence of the server): `2s` for both parts, or a map of `pending` and `running`, each a time or `none`.
pub(super) fn lease(reader: &mut Reader, at: &At<'_>, default: StopCondition) -> Option<StopCondition> {
    let Node::Map(_) = at.node else {
        return reader.duration(at).map(|span| StopCondition::both(Millis::from_span(span)));
    };
    let LeaseKeys { pending, running } = reader.keys(at, "`stop_condition`")?;
    let mut limit = |at: Option<At<'_>>, default: Option<Millis>| match at {
        None => default,
        Some(at) if matches!(at.node, Node::Text(text) if text == "none") => None,
        Some(at) => reader.duration(&at).map(Millis::from_span),
    };
    Some(StopCondition { pending: limit(pending, default.pending), running: limit(running, default.running) })
}

fn read_readings(reader: &mut Reader, at: &At<'_>) -> Vec<Reading> {
    let mut readings = Vec::new();
    for (sensor, at) in reader.entries(at, "a map from each sensor to the times at which it is read") {
        let times = match at.node {
            Node::List(_) => reader.list(&at, "a list of times"),
            _ => vec![at],
        };
        let reading = |item: &At<'_>| {
            Some(Reading { sensor: sensor.to_owned(), at: reader.duration(item)?, place: item.place() })
        };
        readings.extend(times.iter().filter_map(reading).collect::<Vec<_>>());
    }
    readings
}

/// An override of a cue: other values for some of its robots.
pub(super) struct Overriding<'a> {
    pub(super) name: Name,
    pub(super) shaping: Shaping<'a>,
}

fn read_overrides<'a>(
    reader: &mut Reader,
    base: &Shaping<'a>,
    entries: &'a [(&'a str, At<'a>)],
) -> Vec<Overriding<'a>> {
    let mut overrides = Vec::new();
    for (robot, at) in entries {
        let Some(keys) = reader.keys::<OverrideKeys<'_>>(at, "an override") else { continue };
        let shaping = Shaping {
            named: keys.r#move.or(base.named),
            parameters: keys.parameters.or(base.parameters),
            tracks: keys.tracks.or(base.tracks),
            devices: keys.devices.or(base.devices),
            mirror: keys.mirror.or(base.mirror),
            scale: keys.scale.or(base.scale),
            reverse: keys.reverse.or(base.reverse),
            repeat: keys.repeat.or(base.repeat),
            delay: keys.delay,
            tolerance: base.tolerance,
        };
        let name = Name { text: (*robot).to_owned(), place: at.key_place() };
        overrides.push(Overriding { name, shaping });
    }
    overrides
}
