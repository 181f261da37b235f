//! Sequences: cues that can be played repeatedly, under other names, with other parameters, by other robots.
//!
//! A cue that plays a sequence becomes a separate cue without robots. It begins no later than the cues of the sequence and ends no
//! earlier. The names of the sequence's cues begin with the name of this cue and a dot.

use urrcp::Span;

use super::acts::Defaults;
use super::cue::{self, CueKeys, robot_names};
use super::kinds;
use super::library::Library;
use super::nesting::{self, Used, within};
use super::when::{Anchor, Relation};
use super::{Bounds, Cue, nothing};

use crate::fields::{At, Reader};
use crate::finding::{Code, Place, names};
use crate::node::Node;
use crate::shown::shortened;
use downbeat_reader::keys;
use downbeat_reader::keys::Keys;

/// Keys that are permitted in a cue that plays a sequence.
const CALL_KEYS: [&str; 10] =
    ["cue", "at", "after", "with", "before", "end_by", "sequence", "parameters", "robots", "note"];

keys! {
    /// Cues that are played as a whole, with parameters.
    pub(super) struct SequenceKeys as "sequence" {
        /// Description in words.
        doc: kinds::TEXT,
        /// Names with their defaults; `~` for none.
        parameters: kinds::DEFAULTS,
        #[required]
        cues: kinds::CUES,
    }
}

/// Reads a cue. If the cue plays a sequence, the result also contains the cues of the sequence.
pub(super) fn cues(
    reader: &mut Reader,
    library: &Library<'_>,
    defaults: &Defaults<'_>,
    at: &At<'_>,
    index: usize,
) -> Vec<Cue> {
    let entries = match at.node {
        Node::Map(entries) if entries.iter().any(|(key, _)| key == "sequence") => entries,
        _ => return cue::read(reader, library, defaults, at, index).into_iter().collect(),
    };
    let value = |wanted: &str| {
        let (key, node) = entries.iter().find(|(key, _)| key == wanted)?;
        Some(at.entry(key, 0, node))
    };
    let own = Node::Map(entries.iter().filter(|(key, _)| is_own(reader, at, key)).cloned().collect());
    let Some(mut own) = cue::read(reader, library, defaults, &at.with(&own), index) else {
        return Vec::new();
    };
    own.duration = Some(Bounds { min: Span::ZERO, max: None, place: at.place() });
    let begin = reader.nesting.began;
    let robots = value("robots").map(|at| robot_names(reader, &at));
    let robots = robots.map(|names| library.cast(reader, names).into());
    let outer = (reader.origin, reader.nesting.robots.clone());
    (reader.origin, reader.nesting.robots) = (begin, robots.or(outer.1.clone()));
    let inner = played(reader, library, defaults, [value("sequence"), value("parameters")]);
    (reader.origin, reader.nesting.robots) = outer;
    let place = own.place.clone();
    let inner = inner.into_iter().map(|cue| cue.of(&own.name, &place)).collect::<Vec<_>>();
    std::iter::once(own).chain(inner).collect()
}

/// Whether a key belongs to the cue itself that plays a sequence, not to its call of the sequence. Reports keys that such a cue does not
/// accept.
fn is_own(reader: &mut Reader, at: &At<'_>, key: &str) -> bool {
    let is_of_call = CALL_KEYS.contains(&key);
    if !is_of_call && CueKeys::NAMES.contains(&key) {
        let message = format!("`{}` is not supported in a cue that plays a sequence", shortened(key));
        let hint =
            Some("write it in the cues of the sequence, with a parameter if the values differ".to_owned());
        let place = at.entry(key, 0, &Node::Null).key_place();
        reader.add(Code::UnknownKey, place, message, format!("one of {}", names(CALL_KEYS)), hint);
        return false;
    }
    !is_of_call || !["sequence", "parameters", "robots"].contains(&key)
}

/// A cue of a sequence, or of a sequence within that sequence.
struct Inner {
    cue: Cue,
    /// Whether the cue already has a relation to the cue that plays its sequence.
    is_bound: bool,
}

fn played(
    reader: &mut Reader,
    library: &Library<'_>,
    defaults: &Defaults<'_>,
    [named, given]: [Option<At<'_>>; 2],
) -> Vec<Inner> {
    let Some(named) = named else { return Vec::new() };
    let Some(name) = reader.name(&named, "the name of a sequence") else { return Vec::new() };
    let Some(used) = library.sequence(reader, &named, &name) else { return Vec::new() };
    body(reader, library, defaults, &used, given)
}

fn body(
    reader: &mut Reader,
    library: &Library<'_>,
    defaults: &Defaults<'_>,
    used: &Used<'_>,
    given: Option<At<'_>>,
) -> Vec<Inner> {
    let told = used.told(reader, library);
    let root = At::used(&Node::Null, used.part.file, told.as_ref());
    let sequences = root.entry("sequences", 0, &Node::Null);
    let body = sequences.entry(used.part.name, 0, used.part.node);
    let keys = reader.keys(&body, &used.what());
    let Some(SequenceKeys { doc, parameters, cues }) = keys else { return Vec::new() };
    if let Some(at) = doc {
        reader.text(&at, "a description of the sequence");
    }
    let Some(at) = cues else { return Vec::new() };
    let read = |reader: &mut Reader| {
        let items = reader.list(&at, "a list of cues");
        if items.is_empty() && matches!(at.node, Node::List(_)) {
            nothing(reader, &at, &format!("{} has no cues", used.what()), "at least one cue");
        }
        let mut all = Vec::new();
        for (index, item) in items.iter().enumerate() {
            if !has_room(reader, item) {
                break;
            }
            let cues = self::cues(reader, library, defaults, item, index).into_iter().enumerate();
            all.extend(cues.map(|(index, cue)| Inner { cue, is_bound: index > 0 }));
        }
        all
    };
    reader.nesting.sequences += 1;
    let inner = within(reader, library, used, [parameters, given], read).unwrap_or_default();
    reader.nesting.sequences -= 1;
    inner
}

/// Whether one more cue may be created. Reports the first cue that exceeds the maximum.
fn has_room(reader: &mut Reader, at: &At<'_>) -> bool {
    if reader.nesting.cues.is_overdrawn() {
        return false;
    }
    let has_room = reader.nesting.cues.take(1);
    if !has_room {
        let most = reader.nesting.cues.most();
        let message = format!("with this cue, the sequences contain more than {most} cues");
        let hint = Some("sequences that play several others multiply quickly: play fewer of them".to_owned());
        reader.add(Code::TooMuch, at.place(), message, format!("at most {most} in total"), hint);
    }
    has_room
}

impl Inner {
    /// Turns a cue of a sequence into a cue of the act. `whole` is the name of the cue that plays the sequence.
    fn of(self, whole: &str, place: &Place) -> Cue {
        let Self { mut cue, is_bound } = self;
        let named = |name: &str| format!("{whole}.{name}");
        cue.name = named(&cue.name);
        cue.apart.iter_mut().for_each(|name| name.text = named(&name.text));
        for relation in &mut cue.relations {
            for anchor in [&mut relation.from, &mut relation.to] {
                match anchor {
                    Anchor::StartOf(name) | Anchor::EndOf(name) => *name = named(name),
                    Anchor::Origin => *anchor = Anchor::StartOf(whole.to_owned()),
                    Anchor::Start | Anchor::End => {}
                }
            }
        }
        if !is_bound {
            let bound =
                |from, to| Relation { from, to, min: Some(Span::ZERO), max: None, place: place.clone() };
            cue.relations.push(bound(Anchor::StartOf(whole.to_owned()), Anchor::Start));
            cue.relations.push(bound(Anchor::End, Anchor::EndOf(whole.to_owned())));
        }
        cue
    }
}

/// Checks a sequence that no cue plays, except for parts that depend on parameters without a value.
pub(super) fn check_unused(reader: &mut Reader, library: &Library<'_>, defaults: &Defaults<'_>, name: &str) {
    let Some(part) = library.sequences.get(name).copied() else { return };
    let root = At::document(&Node::Null, part.file);
    let sequences = root.entry("sequences", 0, &Node::Null);
    let at = sequences.entry(part.name, 0, part.node);
    let Node::Map(entries) = part.node else {
        reader.wrong_type(&at, "a sequence: a map with `parameters` and `cues`");
        return;
    };
    if nesting::is_complete(part.node)
        || !entries.iter().all(|(key, _)| SequenceKeys::NAMES.contains(&key.as_str()))
    {
        let Some(room) = reader.nesting.unused_sequence() else { return };
        let own = Node::Text(name.to_owned());
        reader.nesting.robots = Some([].into());
        drop(played(reader, library, defaults, [Some(at.entry("cues", 0, &own)), None]));
        reader.nesting.robots = None;
        reader.nesting.end_unused(room);
    }
}
