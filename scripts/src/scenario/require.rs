//! The requirements of a scenario for the spread of starts, for successful missions and for distances. They are checked, but not enforced
//! while the scenario plays.

use super::kinds;
use crate::duration;
use crate::fields::{At, Reader};
use crate::finding::{Code, Place, names};
use crate::node::Node;
use crate::plan::{AllOrNone, Ceiling, Floor, Requirements, Share};
use crate::shown::shortened;
use downbeat_reader::{keys, words};

keys! {
    /// Requirements that `check` and `dry-run` check. If one is not met, they end with exit code 1.
    pub(super) struct RequireKeys as "require" {
        /// The true spread of starts; half of the trials may exceed it.
        spread_p50: kinds::CEILING,
        /// The true spread of starts; one trial in a hundred may exceed it.
        spread_p99: kinds::CEILING,
        /// The largest true spread of starts.
        spread_max: kinds::CEILING,
        /// Share of the trials in which the mission starts.
        starts: kinds::LEAST_SHARE,
        /// Share of the trials whose mission is done.
        finishes: kinds::LEAST_SHARE,
        /// The closest approach of any two bodies, from surface to surface.
        closest: kinds::LEAST_DISTANCE,
        /// `run` and `preflight` reject robots that do not declare `pending_until`, because they could start a script that was not
        /// decided.
        all_or_none: words!(STRICT),
    }
}

const SPREAD: &str = "a maximum time, such as `below 5ms` or `at most 5ms`";
const SHARE: &str = "a minimum share of the trials, such as `above 99.9%` or `at least 100%`";
const DISTANCE: &str = "a minimum distance with its unit, such as `above 0.3m` or `at least 30cm`";

/// Distance units with their length in metres.
const METRES: [(&str, f64); 3] = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)];
const STRICT: [(&str, AllOrNone); 1] = [("strict", AllOrNone::Strict)];
/// Number of billionths in one percent.
const OF_PERCENT: u32 = 10_000_000;

/// Reads the required bounds, and the place of the key `closest`.
pub(super) fn read(reader: &mut Reader, at: &At<'_>) -> (Requirements, Option<Place>) {
    let Some(keys) = reader.keys(at, "`require`") else { return Default::default() };
    let RequireKeys { spread_p50, spread_p99, spread_max, starts, finishes, closest, all_or_none } = keys;
    let place = closest.map(|at| at.place());
    let requirements = Requirements {
        spread_p50: spread_p50.and_then(|at| ceiling(reader, &at)),
        spread_p99: spread_p99.and_then(|at| ceiling(reader, &at)),
        spread_max: spread_max.and_then(|at| ceiling(reader, &at)),
        starts: starts.and_then(|at| floor(reader, &at, SHARE, share)),
        finishes: finishes.and_then(|at| floor(reader, &at, SHARE, share)),
        closest: closest.and_then(|at| floor(reader, &at, DISTANCE, metres)),
        all_or_none: all_or_none.and_then(|at| reader.word(&at, &STRICT)),
    };
    (requirements, place)
}

/// The comparison before a bound, such as `below`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    Below,
    AtMost,
    Above,
    AtLeast,
}

const WORDS: [(&str, Word); 4] =
    [("below", Word::Below), ("at most", Word::AtMost), ("above", Word::Above), ("at least", Word::AtLeast)];

/// Splits a text such as `below 5ms` into its comparison and its bound; `None` if either is missing.
fn cut(text: &str) -> Option<(Word, &str)> {
    let text = text.trim();
    let rest_of = |word: &str| {
        word.split(' ').try_fold(text, |rest, part| {
            let rest = rest.strip_prefix(part)?;
            rest.starts_with(char::is_whitespace).then(|| rest.trim_start())
        })
    };
    WORDS.iter().find_map(|(word, bound)| Some((*bound, rest_of(word)?)))
}

/// Returns the comparison as written in a scenario.
fn word_of(word: Word) -> &'static str {
    WORDS.iter().find(|(_, of)| *of == word).map_or("", |(text, _)| *text)
}

/// Splits a text such as `below 5ms` into its comparison and its bound. Reports a text that does not begin with one of the comparisons
/// in `fitting`.
fn bound<'t>(
    reader: &mut Reader,
    at: &At<'_>,
    text: &'t str,
    fitting: [Word; 2],
    expected: &str,
) -> Option<(Word, &'t str)> {
    let wrong = match cut(text) {
        Some((word, rest)) if fitting.contains(&word) => return Some((word, rest)),
        Some((word, rest)) => {
            // In each pair of words, `below` or `above` comes first.
            let other = word_of(fitting[usize::from(matches!(word, Word::AtMost | Word::AtLeast))]);
            (
                format!("`{}` is not supported here", word_of(word)),
                Some(format!("write `{other} {}`", shortened(rest))),
            )
        }
        None => {
            let value = text.trim().trim_start_matches(['<', '>', '=', ' ']);
            let hint = value.starts_with(|c: char| c.is_ascii_digit());
            // In each pair of words, `below` or `above` comes first.
            let word = word_of(fitting[usize::from(text.contains('='))]);
            let hint = hint.then(|| format!("write `{word} {}`", shortened(value)));
            (format!("missing comparison before `{}`", shortened(text)), hint)
        }
    };
    reader.add(Code::WrongType, at.place(), wrong.0, expected, wrong.1);
    None
}

fn ceiling(reader: &mut Reader, at: &At<'_>) -> Option<Ceiling> {
    let text = reader.text(at, SPREAD)?;
    let (word, rest) = bound(reader, at, &text, [Word::Below, Word::AtMost], SPREAD)?;
    let Some(span) = duration::parse_duration(rest) else {
        let with_unit = || format!("add the unit: `{} {rest}ms`", word_of(word));
        // The finding's place is that of the whole bound, so the hint contains the word as well.
        let whole = |hint: String| hint.replacen('`', &format!("`{} ", word_of(word)), 1);
        let hint = duration::hint(rest).map(whole).or_else(|| rest.parse::<f64>().is_ok().then(with_unit));
        let found = format!("invalid time `{}`", shortened(rest));
        reader.add(Code::BadDuration, at.place(), found, duration::EXPECTED, hint);
        return None;
    };
    if span <= urrcp::Span::ZERO {
        let found = format!("`{}` is out of range", shortened(&text));
        reader.add(Code::WrongType, at.place(), found, "a time above 0", None);
        return None;
    }
    Some(if word == Word::Below { Ceiling::Below(span) } else { Ceiling::AtMost(span) })
}

/// The reason why a value cannot be a bound, and an optional hint.
type Unfit = (String, Option<String>);

fn floor<T: Copy>(
    reader: &mut Reader,
    at: &At<'_>,
    expected: &str,
    value: fn(&str, Word) -> Result<T, Unfit>,
) -> Option<Floor<T>> {
    let text = match at.node {
        // In the message, a plain number is clearer than its type.
        Node::Number(number) => number.to_string().into(),
        _ => reader.text(at, expected)?,
    };
    let (word, rest) = bound(reader, at, &text, [Word::Above, Word::AtLeast], expected)?;
    match value(rest, word) {
        Ok(value) => Some(if word == Word::Above { Floor::Above(value) } else { Floor::AtLeast(value) }),
        Err((found, hint)) => {
            reader.add(Code::WrongType, at.place(), found, expected, hint);
            None
        }
    }
}

/// Suggests a decimal point if a bound contains a comma.
fn with_point(text: &str, word: Word) -> Option<String> {
    text.contains(',')
        .then(|| format!("write a decimal point: `{} {}`", word_of(word), text.replace(',', ".")))
}

/// Parses a percentage such as `99.9%` or `99.9 %`, with up to seven decimals. The unit is mandatory, so that 0.99 and 99 cannot be
/// confused.
fn share(text: &str, word: Word) -> Result<Share, Unfit> {
    let Some(number) = text.strip_suffix('%') else {
        let is_number = text.parse::<f64>().is_ok();
        let hint = is_number.then(|| format!("add the unit: `{} {text}%`", word_of(word)));
        return Err((format!("`{}` is not a percentage", shortened(text)), hint));
    };
    let Some(billionths) = billionths(number.trim()) else {
        let hint = with_point(text, word);
        return Err((format!("`{}` is not a percentage from 0 to 100", shortened(text)), hint));
    };
    if billionths == 100 * OF_PERCENT && word == Word::Above {
        let hint = Some("write `at least 100%`".to_owned());
        return Err(("a share cannot be above 100%".to_owned(), hint));
    }
    Ok(Share::from_billionths(billionths))
}

/// Parses a percentage from 0 to 100 exactly, as billionths of the whole.
fn billionths(number: &str) -> Option<u32> {
    let (whole, fraction) = number.split_once('.').unwrap_or((number, "0"));
    let plain = |digits: &str| !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    if !plain(whole) || !plain(fraction) || fraction.len() > 7 || whole.len() > 3 {
        return None;
    }
    let sum = whole.parse::<u32>().ok()?.checked_mul(OF_PERCENT)?;
    let sum = sum.checked_add(format!("{fraction:0<7}").parse::<u32>().ok()?)?;
    (sum <= 100 * OF_PERCENT).then_some(sum)
}

fn metres(text: &str, word: Word) -> Result<f64, Unfit> {
    let cut = METRES.iter().find_map(|(unit, metres)| Some((text.strip_suffix(unit)?.trim(), *metres)));
    let Some((number, metres)) = cut else {
        let hint = text.parse::<f64>().is_ok();
        let hint = hint.then(|| format!("add the unit: `{} {text}m`", word_of(word)));
        let units = names(METRES.map(|(unit, _)| unit));
        return Err((format!("`{}` needs one of the units {units}", shortened(text)), hint));
    };
    match number.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value * metres),
        Ok(_) => Err((format!("the distance `{}` must be at least 0", shortened(text)), None)),
        Err(_) => Err((format!("invalid distance `{}`", shortened(text)), with_point(text, word))),
    }
}
