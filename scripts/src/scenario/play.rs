//! Moves that play other moves, one after another or at the same time: the key `play`.

use super::kinds;
use super::library::Library;
use super::movement::{Shaped, Shaping, length, shaped};
use super::nesting::may_play;
use super::{Motion, Piece, Track, Vectors, nothing};
use crate::budget::longest;
use crate::exact::{Beginning, Exact};
use crate::fields::{At, Reader};
use crate::finding::Code;
use crate::motion::{Curve, Stretch};
use crate::node::Node;
use crate::shown::shortened;
use downbeat_reader::keys;

const EXPECTED: &str =
    "a list of moves such as {move: bow}, with a nested list for moves that start together";

keys! {
    /// A move that a move plays.
    pub(super) struct PlayKeys as "played" {
        /// The name of a move.
        r#move: kinds::MOVE,
        parameters: kinds::PARAMETERS,
        tracks: kinds::TRACKS,
        devices: kinds::DEVICES,
        scale: kinds::SCALE,
        mirror: kinds::MIRROR,
        reverse: kinds::REVERSE,
        repeat: kinds::REPEAT,
        /// It is stretched to this length.
        duration: kinds::TIME,
        /// Its start, from the beginning of the whole move.
        #[default("the end of the previous entry")]
        at: kinds::TIME,
        /// Additional delay of its start.
        delay: kinds::TIME,
    }
}

/// Reads the tracks of a move that plays other moves. Each entry begins when the previous one has ended, unless it has an `at`; entries
/// of an inner list begin together.
pub(super) fn read(reader: &mut Reader, library: &Library<'_>, at: &At<'_>, whose: &str) -> Vec<Track> {
    let items = reader.list(at, EXPECTED);
    if items.is_empty() && matches!(at.node, Node::List(_)) {
        nothing(reader, at, &format!("{whose} plays nothing"), "at least one move");
    }
    let mut played: Vec<Track> = Vec::new();
    let mut done = Exact::ZERO;
    for item in &items {
        let together = match item.node {
            Node::List(_) => reader.list(item, EXPECTED),
            _ => vec![*item],
        };
        let mut end = done;
        for entry in &together {
            if !may_play(reader, entry) {
                return Vec::new();
            }
            let Some((tracks, ended)) = self::entry(reader, library, entry, done) else { continue };
            end = end.max(ended);
            played.extend(tracks);
        }
        done = end;
        if done.rounded_down() > longest() {
            let message = format!("{whose} lasts {} up to here", done.rounded_down());
            let hint = Some("split the move into several moves".to_owned());
            reader.add(Code::TooMuch, item.place(), message, format!("at most {}", longest()), hint);
            return Vec::new();
        }
    }
    by_device(reader, played, whose)
}

/// Returns the tracks of an entry and the time at which the entry ends, both relative to the start of the move.
fn entry(
    reader: &mut Reader,
    library: &Library<'_>,
    at: &At<'_>,
    done: Exact,
) -> Option<(Vec<Track>, Exact)> {
    let keys: PlayKeys<'_> = reader.keys(at, "an entry of `play`")?;
    if keys.r#move.is_none()
        && keys.tracks.is_none()
        && !["move", "tracks"].iter().any(|key| reader.is_miswritten(at, key))
    {
        let message = "an entry of `play` moves nothing";
        reader.add(Code::MissingKey, at.place(), message, "a key `move` or `tracks`", None);
    }
    let shaping = Shaping {
        named: keys.r#move,
        parameters: keys.parameters,
        tracks: keys.tracks,
        devices: keys.devices,
        mirror: keys.mirror,
        scale: keys.scale,
        reverse: keys.reverse,
        repeat: keys.repeat,
        delay: None,
        tolerance: None,
    };
    let whole = reader.music.start;
    let mut begin = keys.at.map_or(Some(done), |at| reader.exact(&at))?;
    reader.music.start = later(whole, begin);
    if let Some(delay) = keys.delay.and_then(|at| reader.exact(&at)) {
        begin = begin.plus(delay);
        reader.music.start = later(whole, begin);
    }
    let read = shaped(reader, library, &shaping).map(|Shaped { mut tracks, .. }| {
        let mut length = length(&tracks);
        if let Some(wanted) = keys.duration.and_then(|at| reader.exact(&at)) {
            stretch(reader, &mut tracks, length, wanted);
            length = wanted;
        }
        tracks.iter_mut().for_each(|track| track.begin = track.begin.plus(begin));
        (tracks, begin.plus(length))
    });
    reader.music.start = whole;
    read
}

fn later(start: Beginning, by: Exact) -> Beginning {
    Beginning(start.0.map(|start| start.plus(by)))
}

/// Stretches the tracks, including their pieces, from the length `from` to the length `to`.
fn stretch(reader: &Reader, tracks: &mut [Track], from: Exact, to: Exact) {
    let Some(factor) = to.divided_by(from) else { return };
    let start = reader.music.start;
    let stretch = Stretch { from: start.lay(from), to: start.lay(to) };
    for track in tracks {
        let (begin, laid) = (track.begin.times(factor), start.lay(track.begin));
        match &mut track.motion {
            Motion::Curve(curve) => curve.stretch(stretch, laid),
            Motion::Vectors(vectors) => {
                let first = stretch.of(laid);
                *vectors = std::mem::take(vectors).moved(|at| stretch.of(laid + at) - first);
            }
        }
        (track.begin, track.length) = (begin, track.length.times(factor));
    }
}

/// Joins the movements of each device into one track per device.
fn by_device(reader: &mut Reader, played: Vec<Track>, whose: &str) -> Vec<Track> {
    let mut by_device: Vec<Vec<Track>> = Vec::new();
    let mut index_of = std::collections::HashMap::new();
    for track in played {
        let index = *index_of.entry(track.device.clone()).or_insert_with(|| {
            by_device.push(Vec::new());
            by_device.len() - 1
        });
        by_device[index].push(track);
    }
    by_device.into_iter().filter_map(|tracks| joined(reader, tracks, whose)).collect()
}

fn joined(reader: &mut Reader, mut tracks: Vec<Track>, whose: &str) -> Option<Track> {
    tracks.sort_by_key(|track| track.begin);
    let before = reader.found.len();
    for (index, track) in tracks.iter().enumerate().skip(1) {
        if !follows(reader, &tracks[..index], track, whose) {
            break;
        }
    }
    if reader.found.len() > before {
        tracks.truncate(1);
    }
    let begin = tracks.first()?.begin;
    let start = later(reader.music.start, begin);
    let length = tracks.iter().map(Track::end).max()?.minus(begin);
    let (mut pieces, mut firsts, mut items): (Vec<Piece>, Vec<u32>, u32) = (Vec::new(), Vec::new(), 0);
    let mut given = Vec::new();
    for track in &tracks {
        let own = |item: u32| if item == u32::MAX { items } else { items.saturating_add(item) };
        given.extend(track.given.iter().map(|(item, given)| (own(*item), given.clone())));
        firsts.push(items);
        pieces.extend(pieces_of(track, items));
        items = items.saturating_add(items_of(track));
    }
    let laid = |track: &Track| start.lay(track.begin.minus(begin));
    let motion = match &tracks.first()?.motion {
        Motion::Curve(_) => {
            let curves = tracks.iter().zip(&firsts).filter_map(|(track, first)| match &track.motion {
                Motion::Curve(curve) => Some((curve, laid(track), *first)),
                Motion::Vectors(_) => None,
            });
            Motion::Curve(Curve::joined(curves))
        }
        Motion::Vectors(_) => {
            let vectors = tracks.iter().zip(&firsts).filter_map(|(track, first)| match &track.motion {
                Motion::Vectors(vectors) => Some((vectors, laid(track), *first)),
                Motion::Curve(_) => None,
            });
            Motion::Vectors(Vectors::joined(vectors))
        }
    };
    let tolerance = tracks.iter().filter_map(|track| track.tolerance).reduce(f64::min);
    let first = tracks.swap_remove(0);
    Some(Track { motion, length, pieces, tolerance, given, turns: 1, ..first })
}

/// Whether a movement can follow the previous ones on its device. Reports overlaps and other faults.
fn follows(reader: &mut Reader, before: &[Track], track: &Track, whose: &str) -> bool {
    let Some(last) = before.iter().max_by_key(|track| track.end()) else { return true };
    let device = shortened(&track.device);
    let (code, message, expected, hint) = if track.begin < last.end() {
        let time = |exact: Exact| exact.rounded();
        let message = format!(
            "{whose} moves `{device}` from {} to {}, and again from {}",
            time(last.begin),
            time(last.end()),
            time(track.begin)
        );
        (
            Code::Overlap,
            message,
            "one movement of a device at a time",
            "start one of them later, with `at` or `delay`",
        )
    } else if std::mem::discriminant(&last.motion) != std::mem::discriminant(&track.motion) {
        let message = format!("{whose} moves `{device}` both with single values and with lists of values");
        (Code::BadMotion, message, "either single values or lists of values", "play them in two cues")
    } else if last.control != track.control {
        let message = format!("{whose} moves `{device}` with two control types");
        (Code::BadMotion, message, "one control type per device", "play them in two cues")
    } else if last.steps_max.is_some() || track.steps_max.is_some() {
        let message = format!("{whose} plays several movements of `{device}`, one of them with `max_steps`");
        (
            Code::BadMotion,
            message,
            "`max_steps` only if the device has a single movement",
            "use `tolerance` instead, or play the movements in two cues",
        )
    } else {
        return true;
    };
    reader.add(code, track.place.clone(), message, expected, Some(hint.to_owned()));
    false
}

/// Number of items of a track.
fn items_of(track: &Track) -> u32 {
    let last = match &track.motion {
        Motion::Curve(curve) => {
            curve.knots.iter().map(|knot| knot.item).filter(|item| *item != u32::MAX).max()
        }
        Motion::Vectors(vectors) => vectors.iter().map(|vector| vector.item).max(),
    };
    last.map_or(1, |last| last.saturating_add(1))
}

/// Returns the pieces of a track that becomes part of a longer track. The index of their first item there is `first`.
fn pieces_of(track: &Track, first: u32) -> Vec<Piece> {
    if track.pieces.is_empty() {
        return vec![Piece { first, items: track.items, list: track.list.clone() }];
    }
    let later = |piece: &Piece| Piece { first: first.saturating_add(piece.first), ..piece.clone() };
    track.pieces.iter().map(later).collect()
}
