//! Reads nested parts (moves within moves, cues of sequences, files with parameters), with their parameters and the names that are
//! visible to them. Limits stop the reading of parts that use themselves, or that double at each level.

use std::collections::HashMap;
use std::sync::Arc;

use super::library::{Library, Shared, plain_name, scalar};
use crate::budget::{Budget, DEPTH_MAX, PLAYS_IN_ALL_MAX, PLAYS_MAX, SEQUENCE_CUES_MAX};
use crate::duration::parse_duration;
use crate::expression;
use crate::fields::{At, Reader, Unset, is_spread};
use crate::finding::{Code, Place, Use, did_you_mean_this, one_of};
use crate::node::Node;
use crate::shown::shortened;

/// A move or a sequence, and the place where it is used.
pub(super) struct Used<'a> {
    /// Kind of the part: `move` or `sequence`.
    pub(super) kind: &'static str,
    pub(super) name: String,
    pub(super) part: Shared<'a>,
    /// Place of the name that refers to the part.
    pub(super) place: Place,
}

impl Used<'_> {
    /// Describes the part, for example `the move `wave``.
    pub(super) fn what(&self) -> String {
        format!("the {} `{}`", self.kind, shortened(&self.name))
    }

    /// Returns the use of the part that findings in the part mention. If a cue of the scenario uses a move directly, that use is omitted:
    /// findings in the move are the same for all cues.
    pub(super) fn told(&self, reader: &Reader, library: &Library<'_>) -> Option<Arc<Use>> {
        if self.kind == "move" && self.place.used.is_none() && reader.nesting.inside.is_empty() {
            return library.copies[self.part.copy].used.clone();
        }
        let (by, place) = (reader.nesting.inside.last().cloned(), self.place.clone());
        Some(Arc::new(Use { what: self.what(), by, place }))
    }
}

/// Reads a used part with its parameters and the names that are visible in its own file. If the part uses itself or is nested too deeply,
/// reports this and returns `None`.
pub(super) fn within<R>(
    reader: &mut Reader,
    library: &Library<'_>,
    used: &Used<'_>,
    [parameters, given]: [Option<At<'_>>; 2],
    read: impl FnOnce(&mut Reader) -> R,
) -> Option<R> {
    let what = used.what();
    if leads_back(reader, used, &what) {
        return None;
    }
    let arguments = arguments(reader, used, parameters.as_ref(), given.as_ref());
    let places = [parameters, given].into_iter().flatten().flat_map(|at| places(reader, &at));
    let places: HashMap<String, Arc<Place>> = places.collect();
    let hidden = reader.scope.hide(library.globals);
    let copy = std::mem::replace(&mut reader.nesting.copy, used.part.copy);
    reader.scope.restore(library.copies[used.part.copy].values.iter().cloned());
    let values = with_defaults(reader, used, parameters.as_ref(), arguments);
    for (name, value) in values {
        let place = places.get(&name).cloned();
        reader.scope.set_given(name, value, place);
    }
    reader.nesting.inside.push(what);
    let result = read(reader);
    reader.nesting.inside.pop();
    reader.nesting.copy = copy;
    reader.scope.forget(library.globals);
    reader.scope.restore(hidden);
    Some(result)
}

/// Returns the place of each parameter's value. If a part passes on its own parameter, the place is where that parameter received its
/// value.
fn places(reader: &Reader, given: &At<'_>) -> Vec<(String, Arc<Place>)> {
    let Node::Map(entries) = given.node else { return Vec::new() };
    let place = |(name, node): &(String, Node)| {
        let at = given.entry(name, 0, node);
        (name.clone(), reader.given_at(&at).unwrap_or_else(|| Arc::new(at.place())))
    };
    entries.iter().map(place).collect()
}

/// Whether the part is already being read, or is nested too deeply. Reports both faults.
fn leads_back(reader: &mut Reader, used: &Used<'_>, what: &str) -> bool {
    let inside = &reader.nesting.inside;
    let (place, depth) = (used.place.clone(), inside.len());
    if let Some(first) = inside.iter().position(|known| known == what) {
        let message = around(&inside[first..]);
        let told = reader.nesting.circles.get(&message).and_then(|index| reader.found.get(*index));
        if told.is_none_or(|told| told.message != message) {
            reader.nesting.circles.insert(message.clone(), reader.found.len());
            let hint = Some("remove one of these references".to_owned());
            reader.add(Code::PlaysItself, place, message, "a definition that does not use itself", hint);
        }
        return true;
    }
    if depth >= DEPTH_MAX {
        let message = format!("{what} is nested {depth} levels deep");
        // Stops the reading of parts that double at each level.
        (reader.nesting.plays, reader.nesting.cues) =
            (Budget::overdrawn(PLAYS_MAX), Budget::overdrawn(SEQUENCE_CUES_MAX));
        let hint = Some("replace some nested definitions with their contents".to_owned());
        reader.add(Code::TooMuch, place, message, format!("at most {DEPTH_MAX} nested levels"), hint);
        return true;
    }
    false
}

/// Describes a cycle of parts that use each other. The text does not depend on the part at which the cycle was entered.
fn around(inside: &[String]) -> String {
    let least = (0..inside.len()).min_by_key(|index| &inside[*index]).unwrap_or(0);
    let mut chain = inside.iter().cycle().skip(least).take(inside.len());
    let first = chain.next().map_or("it", String::as_str);
    let others: Vec<&str> = chain.map(String::as_str).collect();
    if others.is_empty() {
        format!("{first} uses itself")
    } else {
        format!("{first} uses itself via {}", others.join(", "))
    }
}

/// Whether one more move may be played. Reports the first move that exceeds the maximum.
pub(super) fn may_play(reader: &mut Reader, at: &At<'_>) -> bool {
    if reader.nesting.has_too_many_plays() {
        return false;
    }
    let (one, all) = (reader.nesting.plays.take(1), reader.nesting.all_plays.take(1));
    let most = match (one, all) {
        (true, true) => return true,
        (false, _) => format!("at most {PLAYS_MAX} moves in one cue"),
        (_, false) => format!("at most {PLAYS_IN_ALL_MAX} moves across all cues"),
    };
    let hint = Some("moves that play several others multiply quickly: use `repeat` instead".to_owned());
    reader.add(Code::TooMuch, at.place(), "too many nested moves", most, hint);
    false
}

/// Returns the arguments that a use passes to the part's parameters. Variables in the arguments have the values that they have where the
/// part is used.
pub(super) fn arguments(
    reader: &mut Reader,
    used: &Used<'_>,
    parameters: Option<&At<'_>>,
    given: Option<&At<'_>>,
) -> Vec<(String, Option<Node>)> {
    let given =
        given.map(|at| reader.entries(at, "a map from each parameter to its value")).unwrap_or_default();
    let (mut values, mut meant) = (Vec::with_capacity(given.len()), Vec::new());
    for (parameter, at) in &given {
        match declared(parameters).find(|(known, _)| known == parameter) {
            Some((_, default)) => {
                let value = if ends_suit(reader, at, parameter, default) {
                    scalar(reader, at).filter(|value| suits(reader, at, parameter, default, value))
                } else {
                    None
                };
                values.push(((*parameter).to_owned(), value));
            }
            // A wrong value of `parameters` as a whole already has a finding.
            None if parameters.is_some_and(|at| !matches!(at.node, Node::Map(_))) => {}
            None => {
                let known = || declared(parameters).map(|(known, _)| known.as_str());
                let hint = reader.did_you_mean(parameter, known());
                // A misspelt parameter is not reported as missing as well.
                let is_meant = |name: &&str| hint.as_ref() == Some(&did_you_mean_this(name));
                meant.extend(known().find(is_meant).map(|name| (name.to_owned(), None)));
                let message = format!("{} has no parameter `{}`", used.what(), shortened(parameter));
                reader.add(Code::UnknownKey, at.key_place(), message, one_of(known()), hint);
            }
        }
    }
    values.extend(meant);
    values
}

/// Returns the parameters that a part declares, with their defaults.
fn declared<'a>(parameters: Option<&'a At<'a>>) -> impl Iterator<Item = &'a (String, Node)> {
    let entries: &[(String, Node)] = match parameters.map(|at| at.node) {
        Some(Node::Map(entries)) => entries,
        _ => &[],
    };
    entries.iter()
}

/// The kind of a value, as far as it can be recognized from the text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LiteralKind {
    Number,
    Time,
    Truth,
    Word,
}

impl LiteralKind {
    fn of(node: &Node) -> Option<Self> {
        match node {
            Node::Number(_) => Some(Self::Number),
            Node::Bool(_) => Some(Self::Truth),
            Node::Text(text) if parse_duration(text).is_some() => Some(Self::Time),
            // What a word names, such as a device or a move, is known only where it is used.
            Node::Text(text) if is_word(text) => Some(Self::Word),
            _ => None,
        }
    }

    const fn told(self) -> &'static str {
        match self {
            Self::Number => "a number",
            Self::Time => "a time",
            Self::Truth => "true or false",
            Self::Word => "a word",
        }
    }
}

/// Whether a text is a word: neither an expression nor a length in the music.
fn is_word(text: &str) -> bool {
    text.starts_with(char::is_alphabetic) && !expression::is_one(text)
}

/// Whether both ends of a value that is spread over the robots (`from` and `to`) have the kind of the parameter's default. Reports each
/// end that does not.
fn ends_suit(reader: &mut Reader, at: &At<'_>, parameter: &str, default: &Node) -> bool {
    let Node::Map(entries) = at.node else { return true };
    let ends = entries.iter().filter(|(key, _)| is_spread(at.node) && (key == "from" || key == "to"));
    ends.fold(true, |all, (key, end)| suits(reader, &at.entry(key, 0, end), parameter, default, end) && all)
}

/// Whether a value has the kind of the parameter's default. Also true if the text of either does not show its kind. Reports a mismatch.
fn suits(reader: &mut Reader, at: &At<'_>, parameter: &str, default: &Node, value: &Node) -> bool {
    let (Some(wanted), Some(found)) = (LiteralKind::of(default), LiteralKind::of(value)) else { return true };
    if wanted == found || wanted == LiteralKind::Word {
        return true;
    }
    let hint = match (wanted, value) {
        (LiteralKind::Time, Node::Number(value)) => Some(format!("add the unit: `{value}s` or `{value}ms`")),
        (LiteralKind::Number, Node::Text(_)) if found == LiteralKind::Time => {
            Some("write only the number, without a unit".to_owned())
        }
        (_, Node::Text(word)) if reader.scope.get(word).is_some() => {
            Some(format!("write the variable as `${}`", shortened(word)))
        }
        _ => None,
    };
    let message = format!(
        "the parameter `{}` needs {}, but its value is {}",
        shortened(parameter),
        wanted.told(),
        value.kind()
    );
    let expected = match default {
        Node::Text(default) => format!("{}, like its default {default}", wanted.told()),
        Node::Number(default) => format!("{}, like its default {default}", wanted.told()),
        _ => wanted.told().to_owned(),
    };
    reader.add(Code::WrongKind, at.place(), message, expected, hint);
    false
}

/// Returns the value of each parameter: its argument or, without one, its default.
pub(super) fn with_defaults(
    reader: &mut Reader,
    used: &Used<'_>,
    parameters: Option<&At<'_>>,
    mut given: Vec<(String, Option<Node>)>,
) -> Vec<(String, Node)> {
    let declared = parameters
        .map(|at| reader.entries(at, "a map from each parameter to its default"))
        .unwrap_or_default();
    let mut values = Vec::with_capacity(declared.len());
    if let Some(Node::List(items)) = parameters.map(|at| at.node) {
        values.extend(items.iter().filter_map(|item| match item {
            Node::Text(name) => Some((name.clone(), Node::Null)),
            _ => None,
        }));
    }
    for (parameter, default) in &declared {
        let parameter = &plain_name(reader, default, parameter, "parameter");
        let value = match given.iter_mut().find(|(known, _)| known == parameter) {
            Some((_, Some(value))) => Some(std::mem::replace(value, Node::Null)),
            Some((_, None)) if *default.node == Node::Null => None,
            None if *default.node == Node::Null => {
                missing(reader, used, parameter);
                None
            }
            _ => scalar(reader, default),
        };
        // One fault leads to one finding: uses of the parameter must not report it as missing again.
        values.push(((*parameter).to_owned(), value.unwrap_or(Node::Null)));
    }
    values
}

/// Reports a missing parameter of a sequence. In a move, it is a fault only if a robot plays the move.
fn missing(reader: &mut Reader, used: &Used<'_>, parameter: &str) {
    let (place, parameter) = (used.place.clone(), parameter.to_owned());
    if used.kind == "move" {
        reader.unset.push(Unset { place, of_move: used.name.clone(), parameter });
        return;
    }
    let message = format!("{} needs a value for `{parameter}`", used.what());
    let hint = Some(format!("add `parameters: {{{parameter}: ...}}`"));
    reader.add(Code::Variable, place, message, "a value for every parameter without a default", hint);
}

/// Whether a move or a sequence can be read without arguments, because all of its parameters have defaults.
pub(super) fn is_complete(node: &Node) -> bool {
    let Node::Map(entries) = node else { return false };
    let parameters = entries.iter().find(|(key, _)| key == "parameters").map(|(_, node)| node);
    matches!(parameters, None | Some(Node::Map(_)))
        && !matches!(parameters, Some(Node::Map(all)) if all.iter().any(|(_, node)| *node == Node::Null))
}
