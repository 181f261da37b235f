//! When a cue starts and ends: at fixed times, or relative to other cues.

use urrcp::Span;

use super::acts::parse_time;
use super::canon::Late;
use crate::duration::{self, parse_duration, written};
use crate::exact::{Beginning, Exact};
use crate::fields::{At, Reader, Robot};
use crate::finding::{Code, Place};
use crate::node::Node;
use crate::render::counted;
use crate::shown::shortened;
use crate::slips;

/// Bounds on the time between two anchors: min <= to - from <= max.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Relation {
    pub(crate) from: Anchor,
    pub(crate) to: Anchor,
    pub(crate) min: Option<Span>,
    pub(crate) max: Option<Span>,
    pub(crate) place: Place,
}

/// An instant to which a relation refers.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Anchor {
    /// The act's start.
    Origin,
    /// The start of the cue that has the relation.
    Start,
    /// The end of the cue that has the relation.
    End,
    StartOf(String),
    EndOf(String),
}

/// The keys of a cue that determine its times.
#[derive(Clone, Copy)]
pub(super) struct When<'a> {
    pub(super) at: Option<At<'a>>,
    pub(super) after: Option<At<'a>>,
    pub(super) with: Option<At<'a>>,
    pub(super) before: Option<At<'a>>,
    pub(super) end_by: Option<At<'a>>,
}

/// The relations and the start of a cue, as read from its keys.
pub(super) struct Timing {
    pub(super) relations: Vec<Relation>,
    /// The start of the cue, if it is a single fixed time.
    pub(super) start: Beginning,
    /// Delays of the robots, if `at` has a different value for each robot; `None` otherwise.
    pub(super) late: Option<Late>,
}

impl When<'_> {
    pub(super) fn read(&self, reader: &mut Reader) -> Timing {
        let mut relations = Vec::new();
        let (mut fixed, mut late) = (None, None);
        if let Some(at) = self.at
            && let Some((min, max)) = of_each(reader, &at, &mut late)
        {
            let origin = reader.origin;
            fixed = origin.0.filter(|_| max == Some(min)).map(|origin| origin.plus(min));
            let (from, to) = (Anchor::Origin, Anchor::Start);
            let (min, max) = (Some(laid(origin, min)), max.map(|max| laid(origin, max)));
            relations.push(Relation { from, to, min, max, place: at.place() });
        }
        if let Some(at) = self.end_by
            && let Some((last, _)) = instants(reader, &at)
        {
            let (from, to) = (Anchor::Origin, Anchor::End);
            let max = Some(laid(reader.origin, last));
            relations.push(Relation { from, to, min: None, max, place: at.place() });
        }
        each(reader, self.after, '+', &mut relations, |target, gap, place| {
            let (min, max) = gap.unwrap_or((Span::ZERO, None));
            Relation { from: target.or_end(), to: Anchor::Start, min: Some(min), max, place }
        });
        each(reader, self.with, '+', &mut relations, |target, gap, place| {
            let (min, max) =
                gap.map_or((Span::ZERO, Some(Span::ZERO)), |(min, max)| (min, max.or(Some(min))));
            Relation { from: target.or_start(), to: Anchor::Start, min: Some(min), max, place }
        });
        each(reader, self.before, '-', &mut relations, |target, gap, place| {
            let (min, max) = gap.unwrap_or((Span::ZERO, None));
            Relation { from: Anchor::End, to: target.or_start(), min: Some(min), max, place }
        });
        Timing { relations, start: Beginning(fixed), late }
    }
}

/// Like [`instants`], for each robot of the cue. If the times differ between robots, returns the earliest one, and stores the delay of
/// each robot in `late`.
fn of_each(reader: &mut Reader, at: &At<'_>, late: &mut Option<Late>) -> Option<(Exact, Option<Exact>)> {
    let count = reader.group.count();
    if count == 0 {
        return instants(reader, at);
    }
    let mut all = Vec::with_capacity(1);
    for index in 0..count {
        let (found, differs) = reader.as_robot(Robot { index, count }, |reader| instants(reader, at));
        let found = found?;
        if !differs {
            return Some(found);
        }
        if found.1 != Some(found.0) {
            let message = "a range that differs between robots is not supported";
            let hint = Some("write one time for each robot, or the same range for all".to_owned());
            reader.add(Code::WrongType, at.place(), message, "one time, such as `2s + 500ms * $index`", hint);
            return None;
        }
        all.push(found.0);
    }
    let first = all.iter().min().copied()?;
    let by = all.into_iter().map(|time| time.minus(first)).collect();
    *late = Some(Late {
        by,
        from: Beginning(reader.origin.0.map(|origin| origin.plus(first))),
        place: at.place(),
    });
    Some((first, Some(first)))
}

/// Rounds the duration `time`, which begins at `origin`, to nanoseconds. If `origin` is known, its end is rounded instead, so that
/// consecutive durations add up.
fn laid(origin: Beginning, time: Exact) -> Span {
    match origin.0 {
        Some(start) => start.plus(time).rounded() - start.rounded(),
        None => time.rounded(),
    }
}

/// A referenced cue, and whether its end is meant; `None` if neither start nor end is written.
struct Target {
    cue: String,
    end: Option<bool>,
}

impl Target {
    fn or_start(self) -> Anchor {
        if self.end == Some(true) { Anchor::EndOf(self.cue) } else { Anchor::StartOf(self.cue) }
    }

    fn or_end(self) -> Anchor {
        if self.end == Some(false) { Anchor::StartOf(self.cue) } else { Anchor::EndOf(self.cue) }
    }
}

type Gap = (Span, Option<Span>);

fn each(
    reader: &mut Reader,
    at: Option<At<'_>>,
    sign: char,
    relations: &mut Vec<Relation>,
    relation: impl Fn(Target, Option<Gap>, Place) -> Relation,
) {
    let Some(at) = at else { return };
    let expected = format!("a cue, such as `raise` or `start of raise {sign} 500ms`, or a list of cues");
    let items = match at.node {
        Node::List(_) => reader.list(&at, &expected),
        _ => vec![at],
    };
    for item in items {
        let Some(text) = reader.name(&item, &expected) else { continue };
        if let Some((target, gap)) = target(reader, &item, &text, sign) {
            relations.push(relation(target, gap, item.place()));
        }
    }
}

/// Parses `[start of|end of] CUE [+ GAP]`; the cue may have any name. `sign` precedes a positive gap; after the opposite sign, the gap
/// is negative.
fn target(reader: &mut Reader, at: &At<'_>, text: &str, sign: char) -> Option<(Target, Option<Gap>)> {
    let last = text.rmatch_indices([' ']).find_map(|(space, _)| {
        let (name, rest) = (&text[..space], &text[space + 1..]);
        let (found, gap) = (rest.chars().next()?, rest.get(1..)?.strip_prefix(' ')?);
        (matches!(found, '+' | '-') && looks_like_time(gap)).then_some((name, found, gap))
    });
    let (name, gap) = match last {
        Some((name, found, gap)) => (name, Some(lag(reader, at, gap, found != sign)?)),
        None => (text, None),
    };
    let name = name.trim();
    if let (Some((cue, sum)), Some((least, None))) = (gap_before(name), gap) {
        let whole = sum + if sign == '-' { -least } else { least };
        let (by, size) = if whole < Span::ZERO { ('-', -whole) } else { ('+', whole) };
        let message = format!("`{}` contains two times", shortened(text));
        let hint = Some(format!("write `{} {by} {}`", shortened(cue), written(size)));
        reader.add(Code::BadDuration, at.place(), message, "one time after the name of a cue", hint);
        return None;
    }
    let (end, name) = match (name.strip_prefix("start of "), name.strip_prefix("end of ")) {
        (Some(rest), _) => (Some(false), rest.trim()),
        (_, Some(rest)) => (Some(true), rest.trim()),
        _ => (None, name),
    };
    Some((Target { cue: name.to_owned(), end }, gap))
}

/// Splits a text such as `a + 1s` into the cue and the signed time, to detect a second time after it. The name of a cue may itself
/// contain a sign, as in `part - 1`.
fn gap_before(text: &str) -> Option<(&str, Span)> {
    let (name, gap) = text.rsplit_once(' ')?;
    let (name, sign) = name.rsplit_once(' ')?;
    let gap = parse_duration(gap)?;
    match sign {
        "+" => Some((name, gap)),
        "-" => Some((name, -gap)),
        _ => None,
    }
}

fn looks_like_time(text: &str) -> bool {
    let text = text.trim_start();
    let text = text.strip_prefix(['-', '+']).unwrap_or(text);
    text.starts_with(|c: char| c.is_ascii_digit() || c == '$' || c == '.')
}

/// Reads a gap that may be negative, such as `-2s` or `-2s..3s`. `negated` reverses its sign.
fn lag(reader: &mut Reader, at: &At<'_>, text: &str, negated: bool) -> Option<Gap> {
    let turned = |span: Span| if negated { -span } else { span };
    let Some((least, largest)) = text.split_once("..") else {
        return Some((turned(signed(reader, at, text)?), None));
    };
    let (least, largest) = (signed(reader, at, least)?, signed(reader, at, largest)?);
    let (least, largest) = in_order(reader, at, least, largest)?;
    Some(match (negated, largest) {
        (true, Some(largest)) => (-largest, Some(-least)),
        _ => (least, largest),
    })
}

fn signed(reader: &mut Reader, at: &At<'_>, text: &str) -> Option<Span> {
    let text = text.trim();
    match text.strip_prefix('-') {
        Some(rest) => reader.time(at, rest).map(|span| -span),
        None => reader.time(at, text.strip_prefix('+').unwrap_or(text)),
    }
}

/// Reads `500ms` as a minimum gap, or `0s..1s` as bounds.
pub(super) fn range(reader: &mut Reader, at: &At<'_>, text: &str) -> Option<Gap> {
    if bare_range(reader, at, text) {
        return None;
    }
    match text.split_once("..") {
        None => Some((reader.time(at, text)?, None)),
        Some((least, largest)) => {
            let (least, largest) = (reader.time(at, least)?, reader.time(at, largest)?);
            in_order(reader, at, least, largest)
        }
    }
}

/// Reports a range whose bounds have no units. Returns whether `text` is such a range.
fn bare_range(reader: &mut Reader, at: &At<'_>, text: &str) -> bool {
    let Some(hint) = duration::bare_range(text) else { return false };
    let message = format!("invalid range `{}`", shortened(text));
    reader.add(
        Code::BadDuration,
        at.place(),
        message,
        "two times with their units, such as 2s..4s",
        Some(hint),
    );
    true
}

/// Returns a hint for a start that only an act can have: a time of day, or a word that means the operator.
fn begin_of_act(text: &str) -> Option<String> {
    if ["operator", "go", "manual", "click", "trigger"].contains(&text) {
        return Some("only an act can wait: write `wait: operator` next to the `cues` of an act".to_owned());
    }
    let parts: Vec<&str> = text.split(':').collect();
    let [a, b] = parts.as_slice() else { return None };
    let (first, second) = (a.parse::<u8>().ok()?, b.parse::<u8>().ok().filter(|second| *second < 60)?);
    let (hours, minutes) = (first / 60, first % 60);
    let times = format!(
        "times of a cue are counted from the start of its act: write `{hours:02}:{minutes:02}:{second:02}`"
    );
    match parse_time(text) {
        Some(_) => {
            Some(format!("{times}, or `{first:02}:{second:02}:00` for hours; {}", slips::instant(text)))
        }
        None => Some(times),
    }
}

/// Checks that the first bound is not larger than the second one.
fn in_order<T: PartialOrd + Copy + Into<Exact>>(
    reader: &mut Reader,
    at: &At<'_>,
    least: T,
    largest: T,
) -> Option<(T, Option<T>)> {
    if least <= largest {
        return Some((least, Some(largest)));
    }
    let shown = |time: T| written(time.into().rounded());
    let message = format!("{} is later than {}", shown(least), shown(largest));
    reader.add(Code::TimeOrder, at.place(), message, "the earlier time first", None);
    None
}

/// Reads a time or a range of times. Each is a duration since the act's start or a position in the music.
fn instants(reader: &mut Reader, at: &At<'_>) -> Option<(Exact, Option<Exact>)> {
    let Some(text) = reader.scalar(at).and_then(|node| match node.as_ref() {
        Node::Text(text) => Some(text.clone()),
        _ => None,
    }) else {
        return reader.exact(at).map(|time| (time, Some(time)));
    };
    if bare_range(reader, at, &text) {
        return None;
    }
    match text.split_once("..") {
        Some((least, largest)) => {
            let (least, largest) = (instant(reader, at, least.trim()), instant(reader, at, largest.trim()));
            let (least, largest) = (least?, largest?);
            in_order(reader, at, least, largest)
        }
        None => instant(reader, at, &text).map(|time| (time, Some(time))),
    }
}

pub(super) fn instant(reader: &mut Reader, at: &At<'_>, text: &str) -> Option<Exact> {
    let position = reader.music.position(text);
    if position.is_some() && reader.nesting.is_in_sequence() {
        let message = format!("the position `{}` is not supported in a sequence", shortened(text));
        let hint = Some("in a sequence, times are counted from its beginning: `at: 2 bars`".to_owned());
        reader.add(Code::Music, at.place(), message, "a time from the beginning of the sequence", hint);
        return None;
    }
    if let Some((beats, meant)) = reader.music.beyond_bar(text) {
        let message = format!(
            "`{}` is beyond the end of its bar, which has {}",
            shortened(text),
            counted(beats.into(), "beat")
        );
        let expected = format!("a beat of at least 1 and below {}", beats.saturating_add(1));
        reader.add(Code::Music, at.place(), message, expected, Some(format!("write `{meant}`")));
        return None;
    }
    match position {
        Some(Ok(time)) => reader.no_longer(at, text, time),
        Some(Err(why)) => {
            let hint = Some(why.hint().to_owned());
            reader.add(Code::Music, at.place(), why.message(text), "a `tempo`", hint);
            None
        }
        None if text.starts_with("bar") => {
            let message = format!("invalid position `{}`", shortened(text));
            let expected = "a position such as `bar 3 beat 2`";
            let hint = duration::position(text).filter(|_| !text.contains(" 0"));
            let hint = hint.or_else(|| Some("bars and beats are whole numbers, counted from 1".to_owned()));
            reader.add(Code::BadDuration, at.place(), message, expected, hint);
            None
        }
        None => {
            // The time is relative to the act's start, regardless of the cue's start.
            let start = std::mem::replace(&mut reader.music.start, reader.origin);
            let time = match (duration::parse_duration(text), begin_of_act(text)) {
                (Some(span), _) => Some(span.into()),
                (None, Some(hint)) => {
                    let message = format!("invalid time `{}`", shortened(text));
                    reader.add(Code::BadDuration, at.place(), message, duration::EXPECTED, Some(hint));
                    None
                }
                (None, None) => reader.exact_time(at, text),
            };
            reader.music.start = start;
            time
        }
    }
}
