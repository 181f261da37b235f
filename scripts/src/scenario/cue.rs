//! A cue: who moves what when, and what is done with the movement before.

use urrcp::{Millis, Span, StopCondition};

use super::acts::Defaults;
use super::library::Library;
use super::track::read_tracks;
use super::when::{When, instant, range};
use super::{Bounds, Cue, Motion, Movement, Name, OffGrid, Order, Reading, Track, nothing};
use crate::fields::{At, Reader};
use crate::finding::{Code, did_you_mean, names};
use crate::node::{Node, shortened};

pub(super) const OFF_GRID: [(&str, OffGrid); 2] = [("refuse", OffGrid::Refuse), ("snap", OffGrid::Snap)];
pub(super) const ORDER: [(&str, Order); 2] = [("given", Order::Given), ("auto", Order::Auto)];

/// Most times that a movement is repeated.
const REPEATS_MAX: u32 = 10_000_000;
/// Most knots of one repeated movement: no device takes scripts of that length.
const KNOTS_MAX: usize = 50_000_000;

pub(crate) const CUE_KEYS: [&str; 24] = [
    "cue",
    "at",
    "after",
    "with",
    "before",
    "end_by",
    "duration",
    "robots",
    "move",
    "parameters",
    "tracks",
    "devices",
    "mirror",
    "scale",
    "reverse",
    "repeat",
    "canon",
    "overrides",
    "uses",
    "apart",
    "stop_condition",
    "off_grid",
    "tolerance",
    "read",
];
pub(crate) const OVERRIDE_KEYS: [&str; 9] =
    ["move", "parameters", "tracks", "devices", "mirror", "scale", "reverse", "repeat", "delay"];

/// The keys that make a movement.
#[derive(Clone, Copy, Default)]
struct Shaping<'a> {
    named: Option<At<'a>>,
    parameters: Option<At<'a>>,
    tracks: Option<At<'a>>,
    devices: Option<At<'a>>,
    mirror: Option<At<'a>>,
    scale: Option<At<'a>>,
    reverse: Option<At<'a>>,
    repeat: Option<At<'a>>,
    delay: Option<At<'a>>,
    tolerance: Option<f64>,
}

pub(super) fn read(
    reader: &mut Reader,
    library: &Library<'_>,
    defaults: &Defaults<'_>,
    at: &At<'_>,
    index: usize,
) -> Option<Cue> {
    let [
        name,
        start,
        after,
        with,
        before,
        end_by,
        duration,
        robots,
        named,
        parameters,
        tracks,
        devices,
        mirror,
        scale,
        reverse,
        repeat,
        canon,
        overrides,
        uses,
        apart,
        stop_condition,
        off_grid,
        tolerance,
        readings,
    ] = reader.map(at, "a cue", CUE_KEYS, &[])?;
    let when = When { at: start, after, with, before, end_by };
    let (relations, fixed) = when.read(reader);
    reader.music.start = fixed;
    let tolerance = tolerance.and_then(|at| reader.positive(&at, "an error above 0, in the device's unit"));
    let shaping = Shaping {
        named,
        parameters,
        tracks,
        devices,
        mirror,
        scale,
        reverse,
        repeat,
        delay: None,
        tolerance,
    };
    let moves = named.is_some() || tracks.is_some() || readings.is_some();
    for (missing, key) in [(robots.is_none() && moves, "robots"), (robots.is_some() && !moves, "tracks")] {
        if missing {
            let message = format!("a cue has no `{key}`");
            let hint =
                Some("a cue with neither robots nor tracks is a mark that others can refer to".to_owned());
            reader.add(Code::MissingKey, at.place(), message, format!("a key `{key}`"), hint);
        }
    }
    let movement = movement(reader, library, &shaping);
    let overrides = overrides.map(|at| read_overrides(reader, library, &shaping, &at)).unwrap_or_default();
    let cue = Cue {
        name: name
            .and_then(|at| reader.name(&at, "the cue's name"))
            .unwrap_or_else(|| format!("cue {}", index + 1)),
        place: at.place(),
        relations,
        duration: duration.and_then(|at| bounds(reader, &at)),
        robots: robots.map(|at| robot_names(reader, &at)).unwrap_or_default(),
        robots_place: robots.map_or_else(|| at.place(), |at| at.place()),
        movement,
        overrides,
        canon: canon.and_then(|at| reader.duration(&at)).unwrap_or_default(),
        uses: uses.map(|at| name_list(reader, &at, "a zone, or a list of them")).unwrap_or_default(),
        apart: apart.map(|at| name_list(reader, &at, "a cue, or a list of them")).unwrap_or_default(),
        stop_condition: stop_condition.and_then(|at| lease(reader, &at, defaults.lease)),
        off_grid: off_grid.and_then(|at| reader.word(&at, &OFF_GRID)).unwrap_or(defaults.off_grid),
        readings: readings.map(|at| read_readings(reader, &at)).unwrap_or_default(),
    };
    reader.music.start = None;
    Some(cue)
}

/// `4s`, or `2s..4s`.
fn bounds(reader: &mut Reader, at: &At<'_>) -> Option<Bounds> {
    let (min, max) = match reader.scalar(at)?.as_ref() {
        Node::Text(text) => match range(reader, at, text)? {
            (min, Some(max)) => (min, Some(max)),
            (fixed, None) => (fixed, Some(fixed)),
        },
        _ => reader.duration(at).map(|fixed| (fixed, Some(fixed)))?,
    };
    Some(Bounds { min, max, place: at.place() })
}

pub(super) fn robot_names(reader: &mut Reader, at: &At<'_>) -> Vec<Name> {
    let expected = "a robot, a group or a list of them";
    if matches!(at.node, Node::List(items) if items.is_empty()) {
        nothing(reader, at, "the cue is for no robot", expected);
    }
    name_list(reader, at, expected)
}

fn name_list(reader: &mut Reader, at: &At<'_>, expected: &str) -> Vec<Name> {
    let items = match at.node {
        Node::List(_) => reader.list(at, expected),
        _ => vec![*at],
    };
    let name = |item: &At<'_>| Some(Name { text: reader.name(item, expected)?, place: item.place() });
    items.iter().filter_map(name).collect()
}

/// `2s` for both, or a map of pending and running, each a time or `none`.
pub(super) fn lease(reader: &mut Reader, at: &At<'_>, default: StopCondition) -> Option<StopCondition> {
    let Node::Map(_) = at.node else {
        return reader.duration(at).map(|span| StopCondition::both(Millis::from_span(span)));
    };
    let [pending, running] = reader.map(at, "`stop_condition`", ["pending", "running"], &[])?;
    let mut limit = |at: Option<At<'_>>, default: Option<Millis>| match at {
        None => default,
        Some(at) if matches!(at.node, Node::Text(text) if text == "none") => None,
        Some(at) => reader.duration(&at).map(Millis::from_span),
    };
    Some(StopCondition { pending: limit(pending, default.pending), running: limit(running, default.running) })
}

fn read_readings(reader: &mut Reader, at: &At<'_>) -> Vec<Reading> {
    let mut readings = Vec::new();
    for (sensor, at) in reader.entries(at, "sensor to the times at which it is read") {
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

fn read_overrides(
    reader: &mut Reader,
    library: &Library<'_>,
    base: &Shaping<'_>,
    at: &At<'_>,
) -> Vec<(Name, Movement)> {
    let mut overrides = Vec::new();
    for (robot, at) in reader.entries(at, "robot to what is different for it") {
        let Some([named, parameters, tracks, devices, mirror, scale, reverse, repeat, delay]) =
            reader.map(&at, "an override", OVERRIDE_KEYS, &[])
        else {
            continue;
        };
        let own = Shaping {
            named: named.or(base.named),
            parameters: parameters.or(base.parameters),
            tracks: tracks.or(base.tracks),
            devices: devices.or(base.devices),
            mirror: mirror.or(base.mirror),
            scale: scale.or(base.scale),
            reverse: reverse.or(base.reverse),
            repeat: repeat.or(base.repeat),
            delay,
            tolerance: base.tolerance,
        };
        let name = Name { text: robot.to_owned(), place: at.key_place() };
        overrides.push((name, movement(reader, library, &own)));
    }
    overrides
}

/// Reads the tracks of a move and of the cue itself, then maps, scales, mirrors, reverses and repeats them.
fn movement(reader: &mut Reader, library: &Library<'_>, shaping: &Shaping<'_>) -> Movement {
    let mut tracks =
        shaping.named.map(|at| of_move(reader, library, &at, shaping.parameters)).unwrap_or_default();
    if let (None, Some(at)) = (shaping.named, shaping.parameters) {
        let expected = "a `move` that takes them";
        reader.add(Code::MissingKey, at.key_place(), "parameters without a move", expected, None);
    }
    if let Some(at) = shaping.tracks {
        for track in read_tracks(reader, library, &at) {
            if let Some(same) = tracks.iter().position(|known| known.device == track.device) {
                tracks[same] = track;
            } else {
                tracks.push(track);
            }
        }
    }
    for track in &mut tracks {
        track.tolerance = track.tolerance.or(shaping.tolerance);
    }
    if let Some(at) = shaping.devices {
        rename(reader, &at, &mut tracks);
    }
    if let Some(at) = shaping.scale {
        scale(reader, &at, &mut tracks);
    }
    if let Some(at) = shaping.mirror {
        mirror(reader, &at, &mut tracks);
    }
    let length =
        |tracks: &[Track]| tracks.iter().map(|track| track.motion.length()).max().unwrap_or_default();
    if let Some(at) = shaping.reverse
        && reader.truth(&at) == Some(true)
    {
        let length = length(&tracks);
        curves(&mut tracks, &at, reader, |curve| curve.reverse(length));
    }
    if let Some(at) = shaping.repeat {
        let length = length(&tracks);
        repeat(reader, &at, &mut tracks, length);
    }
    let delay = shaping.delay.and_then(|at| reader.duration(&at)).unwrap_or_default();
    let length = length(&tracks);
    Movement { tracks, delay, length }
}

fn of_move(reader: &mut Reader, library: &Library<'_>, at: &At<'_>, given: Option<At<'_>>) -> Vec<Track> {
    let Some(name) = reader.name(at, "the name of a move") else { return Vec::new() };
    let Some((file, node)) = library.get(reader, at, &name) else { return Vec::new() };
    let root = At::document(&Node::Null, file);
    let moves = root.entry("moves", 0, &Node::Null);
    let body = moves.entry(&name, 0, node);
    let what = format!("the move `{}`", shortened(&name));
    let Some([parameters, tracks]) = reader.map(&body, &what, ["parameters", "tracks"], &["tracks"]) else {
        return Vec::new();
    };
    let mark = reader.scope.mark();
    let values = arguments(reader, at, &name, parameters, given);
    for (parameter, value) in values {
        reader.scope.set(parameter, value);
    }
    let tracks = tracks.map(|at| read_tracks(reader, library, &at)).unwrap_or_default();
    reader.scope.forget(mark);
    tracks
}

/// Reads a move that no cue uses, as far as its parameters have values.
pub(super) fn check_unused(reader: &mut Reader, library: &Library<'_>, name: &str) {
    let Some((file, node)) = library.moves.get(name).copied() else { return };
    let root = At::document(&Node::Null, file);
    let moves = root.entry("moves", 0, &Node::Null);
    let body = moves.entry(name, 0, node);
    let Node::Map(entries) = node else {
        reader.wrong_type(&body, "a move: a map with `parameters` and `tracks`");
        return;
    };
    let parameters = entries.iter().find(|(key, _)| key == "parameters").map(|(_, node)| node);
    let known = |key: &str| matches!(key, "parameters" | "tracks");
    let complete = matches!(parameters, None | Some(Node::Map(_)))
        && !matches!(parameters, Some(Node::Map(all)) if all.iter().any(|(_, node)| *node == Node::Null));
    if complete || !entries.iter().all(|(key, _)| known(key)) {
        let own = Node::Text(name.to_owned());
        let at = body.entry("tracks", 0, &own);
        drop(of_move(reader, library, &at, None));
    }
}

/// The value of each parameter: the one that is given, or its default.
fn arguments(
    reader: &mut Reader,
    at: &At<'_>,
    name: &str,
    parameters: Option<At<'_>>,
    given: Option<At<'_>>,
) -> Vec<(String, Node)> {
    let declared =
        parameters.as_ref().map(|at| reader.entries(at, "parameter to its default")).unwrap_or_default();
    let given = given.as_ref().map(|at| reader.entries(at, "parameter to its value")).unwrap_or_default();
    for (parameter, at) in &given {
        if !declared.iter().any(|(known, _)| known == parameter) {
            let known = || declared.iter().map(|(known, _)| *known);
            let hint = did_you_mean(parameter, known());
            let message =
                format!("the move `{}` has no parameter `{}`", shortened(name), shortened(parameter));
            reader.add(Code::UnknownKey, at.key_place(), message, format!("one of {}", names(known())), hint);
        }
    }
    let mut values = Vec::new();
    for (parameter, default) in &declared {
        let value = match given.iter().find(|(known, _)| known == parameter) {
            Some((_, at)) => super::library::scalar(reader, at),
            None if *default.node == Node::Null => {
                let message = format!("the move `{}` needs a value for `{parameter}`", shortened(name));
                let hint = Some(format!("add `parameters: {{{parameter}: ...}}`"));
                reader.add(Code::Variable, at.place(), message, "every parameter without default", hint);
                None
            }
            None => super::library::scalar(reader, default),
        };
        // One fault, one finding: what uses the parameter shall not find it missing again.
        values.push(((*parameter).to_owned(), value.unwrap_or(Node::Number(0.0))));
    }
    values
}

fn rename(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track]) {
    let entries = reader.entries(at, "device of the move to the robot's device");
    let mut renamed = vec![None; tracks.len()];
    for (from, at) in entries {
        let Some(to) = reader.name(&at, "the id of a device") else { continue };
        match tracks.iter().position(|track| track.device == from) {
            Some(index) => renamed[index] = Some((to, at.place())),
            None => {
                let known = || tracks.iter().map(|track| track.device.as_str());
                let message = format!("no track is called `{}`", shortened(from));
                let expected = format!("one of {}", names(known()));
                reader.add(
                    Code::UnknownDevice,
                    at.key_place(),
                    message,
                    expected,
                    did_you_mean(from, known()),
                );
            }
        }
    }
    for (track, renamed) in tracks.iter_mut().zip(renamed) {
        if let Some((device, place)) = renamed {
            (track.device, track.place) = (device, place);
        }
    }
}

/// What a transformation applies to: some devices, about a value.
struct Aim {
    about: f64,
    devices: Option<Vec<Name>>,
}

fn aim(reader: &mut Reader, about: Option<At<'_>>, devices: Option<At<'_>>) -> Aim {
    Aim {
        about: about.and_then(|at| reader.number(&at, "a value in the device's unit")).unwrap_or(0.0),
        devices: devices.map(|at| name_list(reader, &at, "the ids of devices")),
    }
}

fn scale(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track]) {
    let (factor, aim) = match at.node {
        Node::Map(_) => {
            let Some([by, about, devices]) = reader.map(at, "`scale`", ["by", "about", "devices"], &["by"])
            else {
                return;
            };
            let factor = by.and_then(|at| reader.number(&at, "a factor"));
            (factor, aim(reader, about, devices))
        }
        _ => (reader.number(at, "a factor, or {by, about, devices}"), aim(reader, None, None)),
    };
    if let Some(factor) = factor {
        affine(reader, at, tracks, &aim, factor);
    }
}

fn mirror(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track]) {
    let aim = match at.node {
        Node::Map(_) => {
            let Some([about, devices]) = reader.map(at, "`mirror`", ["about", "devices"], &[]) else {
                return;
            };
            aim(reader, about, devices)
        }
        _ if reader.truth(at) == Some(true) => aim(reader, None, None),
        _ => return,
    };
    affine(reader, at, tracks, &aim, -1.0);
}

fn affine(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track], aim: &Aim, factor: f64) {
    for device in aim.devices.iter().flatten() {
        if !tracks.iter().any(|track| track.device == device.text) {
            let known = || tracks.iter().map(|track| track.device.as_str());
            let message = format!("the cue has no track `{}`", shortened(&device.text));
            let expected = format!("one of {}", names(known()));
            let hint = did_you_mean(&device.text, known());
            reader.add(Code::UnknownDevice, device.place.clone(), message, expected, hint);
        }
    }
    let chosen = |track: &&mut Track| {
        aim.devices.as_ref().is_none_or(|devices| devices.iter().any(|device| device.text == track.device))
    };
    for track in tracks.iter_mut().filter(chosen) {
        curves(std::slice::from_mut(track), at, reader, |curve| curve.scale(aim.about, factor));
    }
}

/// Applies a transformation to the tracks that it can be applied to.
fn curves(
    tracks: &mut [Track],
    at: &At<'_>,
    reader: &mut Reader,
    change: impl Fn(&mut crate::motion::Curve),
) {
    for track in tracks {
        match &mut track.motion {
            Motion::Curve(curve) => change(curve),
            Motion::Vectors(_) => {
                let message = format!("`{}` has several values a keyframe", shortened(&track.device));
                let expected = "tracks of one value";
                reader.add(Code::BadMotion, at.key_place(), message, expected, None);
            }
        }
    }
}

fn repeat(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track], cycle: Span) {
    let Some(times) = repeats(reader, at, cycle) else { return };
    let knots = tracks.iter().map(|track| match &track.motion {
        Motion::Curve(curve) => curve.knots.len(),
        Motion::Vectors(_) => 0,
    });
    let most = knots.max().unwrap_or(0).saturating_mul(times as usize);
    if most > KNOTS_MAX {
        let message = format!("{times} times makes {most} keyframes of one device");
        let expected = format!("at most {KNOTS_MAX}");
        reader.add(Code::TooMuch, at.place(), message, expected, Some("repeat it less often".to_owned()));
        return;
    }
    curves(tracks, at, reader, |curve| curve.repeat(times, cycle));
}

/// A number of times, or as many whole cycles as fit.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
fn repeats(reader: &mut Reader, at: &At<'_>, cycle: Span) -> Option<u32> {
    let Node::Map(_) = at.node else { return reader.count(at, 1, REPEATS_MAX) };
    let [until, during] = reader.map(at, "`repeat`", ["until", "for"], &[])?;
    let time = match (until, during) {
        (Some(until), None) => {
            let text = reader.text(&until, "a time of the act, such as 20s or `bar 9`")?;
            let end = instant(reader, &until, &text)?;
            let Some(start) = reader.music.start else {
                let message = "how often it fits depends on when the cue begins";
                let hint = Some("give the cue a fixed `at`, or use `for`".to_owned());
                reader.add(Code::BadMotion, until.place(), message, "a cue with a fixed start", hint);
                return None;
            };
            end - start
        }
        (None, Some(during)) => reader.duration(&during)?,
        _ => {
            let expected = "a number of times, {until: 20s} or {for: 8s}";
            reader.add(Code::WrongType, at.place(), "found both or neither of until and for", expected, None);
            return None;
        }
    };
    let times = (time.as_millis_f64() / cycle.as_millis_f64() + 1e-9).floor();
    if times >= 1.0 && times <= f64::from(REPEATS_MAX) {
        return Some(times as u32);
    }
    let message = format!("{time} is not enough for a movement of {cycle}, or far too much");
    reader.add(Code::BadMotion, at.place(), message, "time for at least one whole cycle", None);
    None
}
