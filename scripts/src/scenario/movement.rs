//! The movement of a cue: a move with its parameters, or tracks, and the changes that apply to them.

use urrcp::Span;

use super::cue::name_list;
use super::kinds;
use super::library::Library;
use super::nesting::{self, within};
use super::play;
use super::track::read_tracks;
use super::when::instant;
use super::{Change, Changed, Motion, Movement, Name, Track};
use crate::budget::longest;
use crate::duration::written;
use crate::exact::{Beginning, Exact, Laps};
use crate::fields::{At, Reader, Robot, is_spread};
use crate::finding::{Code, one_of};
use crate::node::Node;
use crate::plan::Repetition;
use crate::shown::shortened;
use downbeat_reader::keys::{Item, Keys, Kind, Naming};
use downbeat_reader::{keys, schema};

/// Maximum number of times that a movement is played.
const REPEATS_MAX: u32 = 10_000_000;

keys! {
    /// A movement of devices, with parameters.
    pub(super) struct MoveKeys as "move" {
        /// Description in words.
        doc: kinds::TEXT,
        /// Names with their defaults; `~` for none.
        parameters: Kind::NameKeys(Naming::Defines(Item::Parameter), &Kind::Entries(&Kind::AnyOf(&[&schema!({"type": ["number", "string", "boolean", "null"]}), &kinds::SPREAD]))),
        tracks: kinds::TRACKS,
        play: kinds::PLAY,
    }
    also {"oneOf": [{"required": ["tracks"]}, {"required": ["play"]}]}
}

keys! {
    /// about + by (value - about)
    pub(super) struct ScaleKeys {
        /// Factor.
        #[required]
        by: kinds::NUMBER,
        /// Default 0.
        about: kinds::NUMBER,
        /// Default: all.
        devices: kinds::DEVICE_NAMES,
    }
}

keys! {
    /// 2 about - value
    pub(super) struct MirrorKeys {
        /// Default 0.
        about: kinds::NUMBER,
        /// Default: all.
        devices: kinds::DEVICE_NAMES,
    }
}

keys! {
    /// A number of times, or as many whole repetitions as fit.
    pub(super) struct RepeatKeys {
        /// Number of times that the movement is played.
        times: Kind::AnyOf(&[&kinds::TURNS, &kinds::VARIABLE, &kinds::EXPRESSION, &kinds::SPREAD]),
        /// Time from the beginning of one repetition to that of the next. Default: the length of the movement.
        every: kinds::TIME,
        /// A time of the act or a position in the music; the cue needs a fixed `at`.
        until: kinds::INSTANT,
        /// Total duration.
        r#for: kinds::TIME,
    }
    also {"maxProperties": 2, "minProperties": 1}
}

/// The keys of a cue or a played move that define a movement.
#[derive(Clone, Copy, Default)]
pub(super) struct Shaping<'a> {
    pub(super) named: Option<At<'a>>,
    pub(super) parameters: Option<At<'a>>,
    pub(super) tracks: Option<At<'a>>,
    pub(super) devices: Option<At<'a>>,
    pub(super) mirror: Option<At<'a>>,
    pub(super) scale: Option<At<'a>>,
    pub(super) reverse: Option<At<'a>>,
    pub(super) repeat: Option<At<'a>>,
    pub(super) delay: Option<At<'a>>,
    pub(super) tolerance: Option<f64>,
}

/// Reads the movement of a cue.
pub(super) fn movement(reader: &mut Reader, library: &Library<'_>, shaping: &Shaping<'_>) -> Movement {
    reader.unset.clear();
    reader.nesting.renew_plays();
    let Some(Shaped { mut tracks, repetition }) = shaped(reader, library, shaping) else {
        return Movement::default();
    };
    if reader.nesting.has_too_many_plays() {
        return Movement::default();
    }
    for track in &mut tracks {
        track.starts = reader.music.start.lay(track.begin);
    }
    let delay = shaping.delay.and_then(|at| reader.duration(&at)).unwrap_or_default();
    let length = tracks.iter().map(|track| track.starts + track.motion.length()).max().unwrap_or_default();
    if let Some(at) = shaping.named.or(shaping.tracks).filter(|_| length > longest()) {
        let message = format!("the movement lasts {length}");
        let hint = Some("split it into several movements".to_owned());
        reader.add(Code::TooMuch, at.place(), message, format!("at most {}", longest()), hint);
        return Movement::default();
    }
    Movement { tracks, delay, length, repetition, unset: std::mem::take(&mut reader.unset) }
}

/// The tracks of a movement after all changes, with their repetition.
pub(super) struct Shaped {
    pub(super) tracks: Vec<Track>,
    repetition: Option<Repetition>,
}

/// Reads the tracks of a move and the cue's own tracks, then maps, scales, mirrors, reverses and repeats them.
pub(super) fn shaped(reader: &mut Reader, library: &Library<'_>, shaping: &Shaping<'_>) -> Option<Shaped> {
    if reader.knots.is_overdrawn() || reader.is_full() {
        return None;
    }
    let mut tracks =
        shaping.named.map(|at| of_move(reader, library, &at, shaping.parameters)).unwrap_or_default();
    if let (None, Some(at)) = (shaping.named, shaping.parameters) {
        let expected = "a `move` with these parameters";
        reader.add(
            Code::MissingKey,
            at.key_place(),
            "`parameters` has no effect without a `move`",
            expected,
            None,
        );
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
    if !taken(reader, shaping, &tracks) {
        return None;
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
    if let Some(at) = shaping.reverse
        && reader.truth(&at) == Some(true)
    {
        reverse(reader, &at, &mut tracks);
    }
    let repetition = shaping.repeat.and_then(|at| repeat(reader, &at, &mut tracks));
    Some(Shaped { tracks, repetition })
}

/// Returns the exact end of the last track, before it is rounded to nanoseconds.
pub(super) fn length(tracks: &[Track]) -> Exact {
    tracks.iter().map(Track::end).max().unwrap_or_default()
}

/// Reverses each track in time. The longest track determines the instant that becomes the start of all of them.
fn reverse(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track]) {
    let exact = length(tracks);
    let starts = |track: &Track| reader.music.start.lay(track.begin);
    let longest = tracks.iter().map(|track| starts(track) + track.motion.length()).max().unwrap_or_default();
    for track in tracks {
        // The movement of a played move keeps its time: nothing moves the device before or after it.
        let is_played = !track.pieces.is_empty();
        let within = if is_played { track.motion.length() } else { longest };
        curves(std::slice::from_mut(track), at, reader, |curve| curve.reverse(within));
        let own = track.motion.length();
        if is_played {
            track.begin = exact.minus(track.end())
        } else {
            track.length = if own == longest { exact } else { own.into() }
        }
    }
}

/// Whether the budget has room for the tracks of a cue; each cue has its own copy of its move. Reports the first cue that exceeds the
/// budget.
fn taken(reader: &mut Reader, shaping: &Shaping<'_>, tracks: &[Track]) -> bool {
    // Played movements were already counted when they were read.
    let own = tracks.iter().filter(|track| track.pieces.is_empty());
    let size = own.map(|track| track.motion.size()).fold(0, usize::saturating_add);
    let sound = reader.knots.take(size);
    if let (false, Some(at)) = (sound, shaping.named.or(shaping.tracks)) {
        let most = reader.knots.most();
        let message = format!("with this movement, the scenario has more than {most} keyframes");
        let hint =
            Some("use one cue for several robots, or split the scenario into several scenarios".to_owned());
        reader.add(Code::TooMuch, at.place(), message, format!("at most {most} across all cues"), hint);
    }
    sound
}

fn of_move(reader: &mut Reader, library: &Library<'_>, at: &At<'_>, given: Option<At<'_>>) -> Vec<Track> {
    let Some(name) = reader.name(at, "the name of a move") else { return Vec::new() };
    let Some(used) = library.get(reader, at, &name) else { return Vec::new() };
    let told = used.told(reader, library);
    let root = At::used(&Node::Null, used.part.file, told.as_ref());
    let moves = root.entry("moves", 0, &Node::Null);
    let body = moves.entry(used.part.name, 0, used.part.node);
    let keys = reader.keys(&body, &used.what());
    let Some(MoveKeys { doc, parameters, tracks, play }) = keys else { return Vec::new() };
    if let Some(at) = doc {
        reader.text(&at, "a description of the move");
    }
    match (tracks, play) {
        (Some(_), None) | (None, Some(_)) => {}
        (Some(_), Some(play)) => {
            let message = format!("{} has both `tracks` and `play`", used.what());
            let hint = Some("write the tracks as another entry under `play`".to_owned());
            reader.add(Code::UnknownKey, play.key_place(), message, "one of the two", hint);
        }
        (None, None) if reader.is_miswritten(&body, "tracks") || reader.is_miswritten(&body, "play") => {}
        (None, None) => {
            let message = format!("{} has no `tracks`", used.what());
            reader.add(Code::MissingKey, body.place(), message, "a key `tracks` or `play`", None);
        }
    }
    let read = |reader: &mut Reader| match (tracks, play) {
        (Some(at), _) => read_tracks(reader, library, &at),
        (None, Some(at)) => play::read(reader, library, &at, &used.what()),
        (None, None) => Vec::new(),
    };
    within(reader, library, &used, [parameters, given], read).unwrap_or_default()
}

/// Checks a move that no cue uses, except for parts that depend on parameters without a value.
pub(super) fn check_unused(reader: &mut Reader, library: &Library<'_>, name: &str) {
    let Some(part) = library.moves.get(name) else { return };
    let root = At::document(&Node::Null, part.file);
    let moves = root.entry("moves", 0, &Node::Null);
    let body = moves.entry(part.name, 0, part.node);
    let Node::Map(entries) = part.node else {
        reader.wrong_type(&body, "a move: a map with `parameters` and `tracks`");
        return;
    };
    let known = |key: &str| MoveKeys::NAMES.contains(&key);
    if nesting::is_complete(part.node) || !entries.iter().all(|(key, _)| known(key)) {
        let own = Node::Text(name.to_owned());
        let at = body.entry("tracks", 0, &own);
        reader.robots.current = Some(Robot { index: 0, count: 1 });
        reader.nesting.renew_plays();
        reader.group.enter(Vec::new());
        drop(of_move(reader, library, &at, None));
        reader.robots.current = None;
        reader.unset.clear();
    }
}

fn rename(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track]) {
    let entries = reader.entries(at, "a map from each device of the move to a device of the robot");
    let mut renamed = vec![None; tracks.len()];
    for (from, at) in entries {
        let Some(to) = reader.name(&at, "the id of a device") else { continue };
        match tracks.iter().position(|track| track.device == from) {
            Some(index) => renamed[index] = Some((to, at.place())),
            None => {
                let known = || tracks.iter().map(|track| track.device.as_str());
                let message = format!("no track is named `{}`", shortened(from));
                let expected = one_of(known());
                let hint = reader.did_you_mean(from, known());
                reader.add(Code::UnknownDevice, at.key_place(), message, expected, hint);
            }
        }
    }
    for (track, renamed) in tracks.iter_mut().zip(renamed) {
        if let Some((device, place)) = renamed {
            (track.device, track.place) = (device, place);
        }
    }
}

/// What a transformation applies to: the devices (`None` for all), and the reference value.
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
    let before = reader.found.len();
    let (factor, aim) = match at.node {
        Node::Map(_) if !is_spread(at.node) => {
            let Some(ScaleKeys { by, about, devices }) = reader.keys(at, "`scale`") else { return };
            let factor = by.and_then(|at| reader.number(&at, "a factor"));
            (factor, aim(reader, about, devices))
        }
        _ => (reader.number(at, "a factor, or {by, about, devices}"), aim(reader, None, None)),
    };
    if let Some(factor) = factor.filter(|_| reader.found.len() == before) {
        scale_tracks(reader, at, tracks, &aim, Change::Scale, factor);
    }
}

fn mirror(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track]) {
    let before = reader.found.len();
    let aim = match at.node {
        Node::Map(_) => {
            let Some(MirrorKeys { about, devices }) = reader.keys(at, "`mirror`") else { return };
            aim(reader, about, devices)
        }
        _ if reader.truth(at) == Some(true) => aim(reader, None, None),
        _ => return,
    };
    // An incomplete change would produce wrong values.
    if reader.found.len() > before {
        return;
    }
    scale_tracks(reader, at, tracks, &aim, Change::Mirror, -1.0);
}

fn scale_tracks(
    reader: &mut Reader,
    at: &At<'_>,
    tracks: &mut [Track],
    aim: &Aim,
    change: Change,
    factor: f64,
) {
    for device in aim.devices.iter().flatten() {
        if !tracks.iter().any(|track| track.device == device.text) {
            let known = || tracks.iter().map(|track| track.device.as_str());
            let message = format!("the cue has no track `{}`", shortened(&device.text));
            let expected = one_of(known());
            let hint = reader.did_you_mean(&device.text, known());
            reader.add(Code::UnknownDevice, device.place.clone(), message, expected, hint);
        }
    }
    let chosen = |track: &&mut Track| {
        aim.devices.as_ref().is_none_or(|devices| devices.iter().any(|device| device.text == track.device))
    };
    for track in tracks.iter_mut().filter(chosen) {
        curves(std::slice::from_mut(track), at, reader, |curve| curve.scale(aim.about, factor));
        track.changed = Some(Changed { change, about: aim.about, factor, place: at.place() });
    }
}

/// Applies `change` to each track with one value at a time. Reports tracks with several values per keyframe, which cannot be changed.
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
                let message = format!("`{}` has several values per keyframe", shortened(&track.device));
                let expected = "tracks with one value per keyframe";
                reader.add(Code::BadMotion, at.key_place(), message, expected, None);
            }
        }
    }
}

fn repeat(reader: &mut Reader, at: &At<'_>, tracks: &mut [Track]) -> Option<Repetition> {
    let once = length(tracks);
    let end = |track: &Track| reader.music.start.lay(track.begin) + track.motion.length();
    let longest_track = tracks.iter().map(end).max().unwrap_or_default();
    let Turns { times, cycle: every } = repeats(reader, at, once)?;
    let laps = reader.laps(every);
    // The last repetition is not followed by a wait.
    let rest = laps.begin(1) - longest_track;
    let (cycle, whole) = (laps.begin(1), laps.begin(times) - rest);
    if whole > longest() {
        let message = format!("{times} repetitions of a movement of {cycle} last {whole}");
        let hint = Some("repeat it less often".to_owned());
        reader.add(Code::TooMuch, at.place(), message, format!("at most {}", longest()), hint);
        return None;
    }
    let added = tracks.iter().map(|track| match &track.motion {
        Motion::Curve(curve) => curve.added_by_repeating(times, cycle),
        Motion::Vectors(_) => 0,
    });
    let added = added.fold(0, usize::saturating_add);
    if !reader.knots.take(added) {
        let message = format!("{times} repetitions add {added} keyframes");
        let expected = format!("at most {} across all cues", reader.knots.most());
        reader.add(Code::TooMuch, at.place(), message, expected, Some("repeat it less often".to_owned()));
        return None;
    }
    for track in tracks {
        let from = Beginning(laps.from.0.map(|start| start.plus(track.begin)));
        let (laps, once) = (Laps { from, ..laps }, track.length);
        curves(std::slice::from_mut(track), at, reader, |curve| curve.repeat(times, &laps, once));
        (track.length, track.turns) = (track.motion.length().into(), times);
    }
    (times > 1).then_some(Repetition { times, length: longest_track, every: cycle })
}

/// Number of times that a movement is played, and the interval between the starts of its repetitions.
struct Turns {
    times: u32,
    cycle: Exact,
}

/// Reads how often a movement is played, or computes how many whole repetitions fit into a given time.
fn repeats(reader: &mut Reader, at: &At<'_>, once: Exact) -> Option<Turns> {
    if is_spread(at.node) || !matches!(at.node, Node::Map(_)) {
        return reader.count(at, 1, REPEATS_MAX).map(|times| Turns { times, cycle: once });
    }
    let RepeatKeys { times, every, until, r#for: during } = reader.keys(at, "`repeat`")?;
    let cycle = every.map_or(Some(once), |every| cycle(reader, &every, once));
    let time = match (times, until, during) {
        (Some(times), None, None) => {
            let times = reader.count(&times, 1, REPEATS_MAX);
            return Some(Turns { times: times?, cycle: cycle? });
        }
        (None, Some(until), None) => until_time(reader, &until)?,
        (None, None, Some(during)) => reader.exact(&during)?,
        _ => {
            let expected = "a number of times, {times: 3, every: 4s}, {until: 20s} or {for: 8s}";
            let message = "found none or several of `times`, `until` and `for`";
            let hint = (times.is_none() && until.is_none())
                .then(|| "add the number of repetitions, `times: 3`, or the duration, `for: 20s`".to_owned());
            reader.add(Code::WrongType, at.place(), message, expected, hint);
            return None;
        }
    };
    let cycle = cycle?;
    // The last repetition is not followed by a wait.
    let times = time.minus(once).divided_by(cycle).map(|times| times.floor() + 1);
    let times = times.and_then(|times| u32::try_from(times.to_integer()).ok());
    if let Some(times) = times.filter(|times| (1..=REPEATS_MAX).contains(times)) {
        return Some(Turns { times, cycle });
    }
    let (time, once) = (time.rounded(), once.rounded());
    let (message, expected, hint) = if time < once {
        let message = format!("{time} is too short for a movement of {once}");
        let hint = format!("use at least `{}`, or leave `repeat` out", written(once));
        (message, "time for at least one whole cycle".to_owned(), Some(hint))
    } else {
        let message = format!("a movement of {once} fits into {time} more than {REPEATS_MAX} times");
        (message, format!("at most {REPEATS_MAX} repetitions"), None)
    };
    reader.add(Code::BadMotion, at.place(), message, expected, hint);
    None
}

/// Reads the interval between the starts of repetitions, which must be at least the length of the movement.
fn cycle(reader: &mut Reader, at: &At<'_>, once: Exact) -> Option<Exact> {
    let cycle = reader.exact(at)?;
    if cycle >= once {
        return Some(cycle);
    }
    let (cycle, once) = (cycle.rounded(), once.rounded());
    let message = format!("a movement of {once} cannot be repeated every {cycle}");
    let hint = Some(if cycle == Span::ZERO {
        "leave `every` out: then each repetition starts when the previous one has ended".to_owned()
    } else {
        "shorten the movement, or increase the time between its repetitions".to_owned()
    });
    reader.add(Code::BadMotion, at.place(), message, format!("at least {once}"), hint);
    None
}

fn until_time(reader: &mut Reader, until: &At<'_>) -> Option<Exact> {
    let end = match reader.scalar(until)?.as_ref() {
        Node::Text(text) => instant(reader, until, text)?,
        _ => {
            reader.wrong_type(until, "a time in the act, such as 20s or `bar 9`");
            return None;
        }
    };
    let Some(start) = reader.music.start.0 else {
        let message = "the number of repetitions depends on when the cue starts";
        let hint = Some("give the cue a fixed `at`, or use `for`".to_owned());
        reader.add(Code::BadMotion, until.place(), message, "a cue with a fixed start", hint);
        return None;
    };
    Some(reader.origin.0.map_or(end, |origin| origin.plus(end)).minus(start))
}
