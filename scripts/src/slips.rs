//! Hints for what people write where the language has another word, key or form: words of other programs, units, lists without brackets.

mod advice;
mod keyframes;
mod keys;

use std::collections::HashMap;

use urrcp::Device;

pub(crate) use keyframes::{OtherForm, as_keyframes};
pub(crate) use keys::{key, missing, parameter, word_of};

use crate::composed::{composed, is_same};
use crate::duration::parse_duration;
use crate::fields::Reader;
use crate::finding::{Part, Place, did_you_mean_this};
use crate::node::{Node, shortened};
use crate::scope::Scope;

/// The devices of a fleet by name, each with its unit if all robots that have it agree.
#[derive(Debug, Default)]
pub(crate) struct Units(HashMap<String, Option<String>>);

impl Units {
    /// A device of several robots has a unit if it is the same on all of them.
    pub(crate) fn of<'d>(devices: impl IntoIterator<Item = &'d Device>) -> Self {
        let mut units: HashMap<String, Option<String>> = HashMap::new();
        for device in devices {
            let unit = device.unit.as_ref().map(ToString::to_string);
            units
                .entry(composed(device.id.as_str()).into_owned())
                .and_modify(|known| {
                    if *known != unit {
                        *known = None;
                    }
                })
                .or_insert(unit);
        }
        Self(units)
    }

    pub(crate) fn has_device(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    /// The device that a place in a track is about, and its unit.
    fn at<'p>(&self, place: &'p Place) -> Option<(&'p str, Option<&str>)> {
        let at = place
            .path
            .iter()
            .rposition(|part| matches!(part, Part::Key(key, _) if key == "tracks" || key == "limits"))?;
        let Part::Key(device, _) = place.path.get(at + 1)? else { return None };
        Some((device, self.0.get(device)?.as_deref()))
    }
}

/// A hint for an unknown word.
pub(crate) fn word<'a>(wrong: &str, known: impl Iterator<Item = &'a str> + Clone) -> Option<String> {
    let plain: String = wrong.chars().filter(|c| c.is_alphanumeric()).collect::<String>().to_lowercase();
    let has = |word: &str| known.clone().any(|known| known == word);
    let meant = match plain.as_str() {
        "hold" | "constant" | "none" | "jump" | "discrete" | "stepped" if has("step") => "step",
        "sine" | "sin" | "soft" | "ease" | "smoothstep" | "minimumjerk" | "bezier" if has("smooth") => {
            "smooth"
        }
        easing if has("smooth") && easing.starts_with("easeinout") => "smooth",
        easing if has("smooth") && easing.starts_with("ease") => {
            return Some("no easing is soft at one end only: `smooth` begins and ends softly".to_owned());
        }
        "reverse" | "reversed" | "backwards" | "back" | "desc" | "descending" if has("backward") => {
            "backward"
        }
        "forwards" | "normal" | "asc" | "ascending" if has("forward") => "forward",
        "left" | "lefttoright" | "right" | "righttoleft" if has("backward") => {
            return Some(
                "write `by: x`, in the `direction` `forward` from left to right, or `backward`".to_owned(),
            );
        }
        "left" | "lefttoright" | "right" | "righttoleft" if has("x") => "x",
        "continue" | "ignore" | "skip" | "goon" if has("without") => "without",
        "halt" | "abort" | "fail" if has("stop") => "stop",
        "no" | "off" | "false" | "none" if has("skip") => "skip",
        "yes" | "on" | "true" if has("full") => "full",
        "stop" | "stay" | "none" | "hold" if known.clone().eq(["home"]) => {
            return Some("leave the key out: devices stay where they are".to_owned());
        }
        _ => return None,
    };
    Some(did_you_mean_this(meant))
}

/// A hint for a value of another kind than is expected there.
pub(crate) fn value(reader: &Reader, place: &Place, node: &Node, expected: &str) -> Option<String> {
    match node {
        Node::Text(text) if reader.scope.get(text).is_some() => {
            Some(format!("the variable is written `${text}`"))
        }
        Node::Text(text) if expected == "true or false" => truth(text, place),
        Node::Text(text) if expected.starts_with("an entry of `play`") => {
            Some(format!("write `{{move: {text}}}`"))
        }
        Node::Text(text) if expected == "a finite number" && colour(text).is_some() => colour(text)
            .map(|values| format!("write a list, if the device takes several values: `{values:?}`")),
        Node::Number(value) if expected == "true or false" => Some(match place.path.last() {
            Some(Part::Key(key, _)) if key == "mirror" => format!("write `{{about: {value}}}`"),
            _ => format!("write `{}`", *value != 0.0),
        }),
        Node::Number(value) if expected == "a list of finite numbers" => Some(format!("write `[{value}]`")),
        Node::Number(value) if expected.starts_with("the least and the largest coordinate") => {
            Some(format!("write both: `[{}, {}]`", -value.abs(), value.abs()))
        }
        Node::Number(value) if expected.starts_with("`above` or `below`") => {
            Some(format!("write `above {value}`"))
        }
        Node::Map(entries) if expected.starts_with("metres along x, y and z") => coordinates(entries),
        Node::Map(entries) if expected.starts_with("a factor") => match entries.as_slice() {
            [(key, Node::Number(value))] if key == "by" => Some(format!("write `{value}`")),
            _ => None,
        },
        Node::Map(entries) if expected == "the name of a move" => match entries.as_slice() {
            [(name, _)] => {
                Some(format!("write `move: {}`, and its values under `parameters`", shortened(name)))
            }
            _ => None,
        },
        Node::Map(_) if expected.starts_with("beats per minute") => {
            Some("put brackets around it: `[{at: bar 1, bpm: 120}]`".to_owned())
        }
        Node::List(_) if expected.starts_with("the move `") || expected.starts_with("a move: a map") => {
            Some("name the device: `{tracks: {elbow: [{at: 0s, to: 0}]}}`".to_owned())
        }
        Node::List(_) if expected.starts_with("the sequence `") => {
            Some("write the list below `cues:`".to_owned())
        }
        Node::List(_) if expected.starts_with("the name of an act") => {
            Some("name one act; `otherwise` of a `wait` names another one".to_owned())
        }
        Node::List(_) if expected.starts_with("the name of a formation") => {
            Some("write a cue for each of them".to_owned())
        }
        Node::List(items) if expected == "`home`" => match &items[..] {
            [Node::Text(home), Node::Text(over)] if home == "home" => {
                Some(format!("write `{{home: {over}}}`"))
            }
            _ => None,
        },
        Node::Text(text) if expected.starts_with("a whole number") && is_endless(text) => {
            Some(ENDLESS.to_owned())
        }
        Node::Bool(true) if expected.starts_with("a whole number") && is_repeat(place) => {
            Some(ENDLESS.to_owned())
        }
        Node::Text(text) if expected.starts_with("a list of") => {
            Some(format!("write a list: `[{}]`", words(text).join(", ")))
        }
        Node::Text(text)
            if expected.starts_with("the least and the largest delay") && parse_duration(text).is_some() =>
        {
            Some(format!("write `[{text}, {text}]`"))
        }
        Node::Text(text)
            if expected.starts_with("a whole number")
                && is_repeat(place)
                && parse_duration(text).is_some() =>
        {
            Some(format!("write `{{for: {text}}}` to repeat it for that long, or how often alone"))
        }
        Node::Text(text) => number(reader, place, text, expected)
            .or_else(|| {
                metres(text)
                    .and_then(|length| in_a_map(expected, length))
                    .filter(|_| !expected.starts_with("limits"))
            })
            .or_else(|| {
                expected.contains(": a map").then(|| crate::syntax::without_space_at_all(text)).flatten()
            }),
        Node::Map(entries) if expected.starts_with("a place in metres") => coordinates(entries),
        Node::Map(_) if expected.starts_with("a list of") => {
            Some("put brackets around it: `[{...}]`".to_owned())
        }
        Node::Map(_) if expected.starts_with("the path of an initialization block") => {
            Some("write the description into a file of its own, and name that".to_owned())
        }
        Node::Map(entries) if expected.starts_with("a robot, a group or a list") => {
            let names: Vec<&str> = entries.iter().map(|(key, _)| key.as_str()).collect();
            Some(format!("write a list: `[{}]`", names.join(", ")))
        }
        Node::Number(value) if expected.starts_with("a list of keyframes") => {
            Some(format!("write at which time it gets there, as in `[{{at: 1s, to: {value}}}]`"))
        }
        Node::Number(value) if expected.starts_with("a place in metres") => {
            Some(format!("write all three: `[0, 0, {value}]`"))
        }
        Node::Number(value) if expected.starts_with("metres along x, y and z") => {
            Some(format!("write all three: `[0, 0, {value}]`"))
        }
        Node::Number(value) if expected.starts_with("a time signature") => Some(format!("write `{value}/4`")),
        Node::Number(value) => in_a_map(expected, *value),
        Node::List(_) if expected.starts_with("a map from robot id") => {
            Some("write a map: `{left: {init: arm.yaml, address: sim}}`".to_owned())
        }
        Node::List(_) if expected.starts_with("a map from device to its keyframes") => {
            Some("write a map: `{elbow: [{at: 0s, to: 0}]}`".to_owned())
        }
        Node::List(items) if expected == "a map from parameter to its default" => {
            let name = |item: &Node| match item {
                Node::Text(name) => Some(format!("{}: ~", shortened(name))),
                _ => None,
            };
            let names: Option<Vec<String>> = items.iter().map(name).collect();
            Some(format!("write each with its default, or `~` for none: `{{{}}}`", names?.join(", ")))
        }
        Node::List(_) if expected.starts_with("a map from") => {
            Some("write a map, with a name for each entry: `{name: ...}`".to_owned())
        }
        Node::List(_) if expected == "the name of a move" => {
            Some("write a cue for each move, or a move that has `play` with a list of them".to_owned())
        }
        Node::List(_) if expected.starts_with("the path of a fleet file") => {
            Some("name one file that lists all robots".to_owned())
        }
        Node::Null if expected.starts_with("a list of keyframes") => {
            Some("write its keyframes below it, as in `[{at: 0s, to: 0}, {at: 1s, to: 45}]`".to_owned())
        }
        Node::Null if expected.starts_with("`sim`") => Some("write `sim` to simulate it".to_owned()),
        Node::Tagged(_) => Some("remove the tag: no tags are supported".to_owned()),
        _ => None,
    }
}

/// The hint for a value that is written in lines, if it differs.
pub(crate) fn in_block(node: &Node, expected: &str) -> Option<&'static str> {
    match node {
        Node::Map(_) if expected.starts_with("a list of") => {
            Some("begin every entry of the list with a dash: `- `")
        }
        Node::List(_) if expected.starts_with("a map from robot id") => {
            Some("write `left: {init: arm.yaml, address: sim}` for each robot, without a dash")
        }
        Node::List(_) if expected.starts_with("a map from device to its keyframes") => {
            Some("write `elbow: [{at: 0s, to: 0}]` for each device, without a dash")
        }
        Node::List(_) if expected == "a map from parameter to its default" => {
            Some("write each with its default, or `~` for none, without a dash: `height: ~`")
        }
        Node::List(_) if expected.starts_with("a map from") => {
            Some("write `name: ...` for each entry instead of a dash")
        }
        _ => None,
    }
}

/// `yes` and `no` are texts.
fn truth(text: &str, place: &Place) -> Option<String> {
    let is_mirror = matches!(place.path.last(), Some(Part::Key(key, _)) if key == "mirror");
    let value = match text.to_lowercase().as_str() {
        "yes" | "on" | "y" | "ja" => true,
        "no" | "off" | "n" | "nein" => false,
        _ if is_mirror => return Some("`true` mirrors about 0, and `{about: 45}` about 45".to_owned()),
        _ => return None,
    };
    Some(format!("write `{value}`"))
}

/// A hint for a cue that is meant to repeat endlessly.
const ENDLESS: &str =
    "a cue ends: give a number, `{for: 60s}` or `{until: 60s}`, or let an act follow itself by `next`";

/// Whether this is the value of `repeat`.
fn is_repeat(place: &Place) -> bool {
    matches!(place.path.last(), Some(Part::Key(key, _)) if key == "repeat" || key == "times")
}

/// The metres in `3m` or `30cm`.
fn metres(text: &str) -> Option<f64> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let (_, scale) = LENGTHS.iter().find(|(unit, _)| text[digits.len()..] == **unit)?;
    let value: f64 = digits.trim().parse().ok()?;
    value.is_finite().then(|| (value * scale * 1e4).round() / 1e4)
}

fn is_endless(text: &str) -> bool {
    ["forever", "infinite", "infinitely", "endless", "always", "loop"].contains(&text.to_lowercase().as_str())
}

/// The words of a list without brackets: `left, right`, `left and right`, `left right`.
pub(crate) fn words(text: &str) -> Vec<String> {
    let plain = text.trim_matches(['[', ']', '{', '}']).replace(" and ", ",").replace(['&', '+', ';'], ",");
    let separator = if plain.contains(',') { ',' } else { ' ' };
    let words = plain.split(separator).map(str::trim).filter(|word| !word.is_empty());
    words.map(str::to_owned).collect()
}

/// A hint for a text that has several of the known names, or one within marks that YAML keeps.
pub(crate) fn several_names<'a>(text: &str, known: impl Iterator<Item = &'a str> + Clone) -> Option<String> {
    let is_known = |name: &str| known.clone().any(|known| is_same(known, name));
    let words = words(text);
    if words.len() > 1 && words.iter().all(|word| is_known(word)) {
        return Some(format!("write a list: `[{}]`", words.join(", ")));
    }
    let bare = text.trim_matches(['\u{201c}', '\u{201d}', '\u{201e}', '\u{2018}', '\u{2019}', '"', '\'']);
    if bare != text && is_known(bare) {
        return Some(format!("write it without these quotation marks: `{bare}`"));
    }
    let (name, rest) = text.split_once(' ')?;
    let comments = rest.trim_start().starts_with("//") || rest.trim_start().starts_with("--");
    (comments && is_known(name)).then(|| format!("a comment begins with `#`: `{name} # ...`"))
}

/// The text within the braces of `{{ x }}`, which YAML reads as a map whose key is a map, of `"{{ x }}"` or of `{$x}`.
pub(crate) fn template(node: &Node) -> Option<String> {
    let inner = match node {
        Node::Text(text) => text.trim().strip_prefix("{{")?.strip_suffix("}}")?,
        Node::Map(entries) => match entries.as_slice() {
            [(key, Node::Null)] if key.starts_with('$') => key,
            [(key, Node::Null)] => key.strip_prefix('{')?.strip_suffix('}')?,
            _ => return None,
        },
        _ => return None,
    };
    let inner = inner.trim();
    (!inner.is_empty() && !inner.contains(['{', '}'])).then(|| inner.to_owned())
}

/// Adds `$` before each name that is a variable, or before the whole text if it is one word.
pub(crate) fn bare(scope: &Scope, inner: &str) -> String {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    if inner.chars().all(is_part) && !inner.starts_with(|c: char| c.is_ascii_digit()) {
        return format!("${inner}");
    }
    let mut written = String::new();
    for word in inner.split_inclusive(|c| !is_part(c)) {
        let name = word.trim_end_matches(|c| !is_part(c));
        if !written.ends_with('$') && scope.get(name).is_some() {
            written.push('$');
        }
        written.push_str(word);
    }
    written
}

/// `{x: 0, y: 0, z: 3}`
fn coordinates(entries: &[(String, Node)]) -> Option<String> {
    let value = |axis: &str| match entries.iter().find(|(key, _)| key == axis) {
        Some((_, Node::Number(value))) => Some(*value),
        Some(_) => None,
        None => Some(0.0),
    };
    let [x, y, z] = [value("x")?, value("y")?, value("z")?];
    Some(format!("write `[{x}, {y}, {z}]`"))
}

/// A number where a map with one usual key belongs: `limits: {elbow: 90}`, `circle: 4`.
fn in_a_map(expected: &str, value: f64) -> Option<String> {
    let (what, keys) = expected.split_once(": a map with `")?;
    let of_one_number = ["limits", "`line`", "`circle`", "`grid`", "`v`", "`sphere`"];
    let key = keys.split('`').next().filter(|_| of_one_number.contains(&what))?;
    Some(format!("write `{{{key}: {value}}}`"))
}

/// The red, green and blue values, up to 255, of a colour such as `red` or `#ff8800`.
fn colour(text: &str) -> Option<[u8; 3]> {
    const NAMED: [(&str, [u8; 3]); 8] = [
        ("red", [255, 0, 0]),
        ("green", [0, 255, 0]),
        ("blue", [0, 0, 255]),
        ("white", [255, 255, 255]),
        ("black", [0, 0, 0]),
        ("yellow", [255, 255, 0]),
        ("cyan", [0, 255, 255]),
        ("magenta", [255, 0, 255]),
    ];
    if let Some((_, values)) = NAMED.iter().find(|(name, _)| text.eq_ignore_ascii_case(name)) {
        return Some(*values);
    }
    let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6)?;
    let [_, r, g, b] = u32::from_str_radix(digits, 16).ok()?.to_be_bytes();
    Some([r, g, b])
}

/// A hint that lists the robots of a range, `d1-d6` or `d1..d6`, or those whose names begin alike, `d*`.
pub(crate) fn range_of_robots<'a>(text: &str, ids: impl Iterator<Item = &'a str> + Clone) -> Option<String> {
    let listed: Vec<&str> = match text.strip_suffix('*') {
        Some(begin) => ids.filter(|id| id.starts_with(begin)).collect(),
        None => {
            let (from, to) = text.split_once("..").or_else(|| text.split_once('-'))?;
            let is_digit = |c: char| c.is_ascii_digit();
            let word = from.trim_end_matches(is_digit);
            let number = |id: &str| id.strip_prefix(word)?.parse::<u32>().ok();
            // `d1-6`
            let last = number(to).or_else(|| to.parse().ok())?;
            let range = number(from)?..=last;
            let mut within: Vec<(u32, &str)> = ids.filter_map(|id| Some((number(id)?, id))).collect();
            within.retain(|(number, _)| range.contains(number));
            within.sort_unstable();
            within.into_iter().map(|(_, id)| id).collect()
        }
    };
    (2..=LISTED_MAX).contains(&listed.len()).then(|| format!("write a list: `[{}]`", listed.join(", ")))
}

/// The largest number of robots that a hint lists.
const LISTED_MAX: usize = 20;

/// How a number is written that a person would understand: `45,5`, `45deg`, `"45"`.
fn number(reader: &Reader, place: &Place, text: &str, expected: &str) -> Option<String> {
    let wants = |word: &str| expected.contains(word);
    let is_number = wants("number")
        || ["device's unit", "metres", "degrees", "hertz", "beats per minute", "factor"]
            .iter()
            .any(|word| wants(word));
    if !is_number {
        return None;
    }
    let parsed = |text: &str| text.parse::<f64>().ok().filter(|value| value.is_finite());
    if parsed(text.trim()).is_some() {
        return Some(format!("write it without quotation marks: `{}`", text.trim()));
    }
    let with_point = text.trim().replacen(',', ".", 1);
    if parsed(&with_point).is_some() {
        return Some(format!("write a decimal point: `{with_point}`"));
    }
    let digits = with_point.trim_end_matches(|c: char| !c.is_ascii_digit()).trim();
    let (value, unit) = (parsed(digits)?, with_point[digits.len()..].trim());
    let (unit, per) = unit.find('/').map_or((unit, ""), |slash| unit.split_at(slash));
    let is_acceleration = matches!(place.path.last(), Some(Part::Key(key, _)) if key == "acceleration");
    let per = if is_acceleration && !per.is_empty() { "/s^2" } else { per };
    if wants("degrees") && matches!(unit, "turn" | "turns") {
        return Some(format!("write `{}`", value * 360.0));
    }
    if wants("hertz")
        || wants("beats per minute")
        || wants("whole number")
        || (wants("factor") && unit == "x")
    {
        return Some(format!("write the number alone: `{digits}`"));
    }
    if wants("metres") {
        return Some(
            converted(value, unit, "m", &LENGTHS).unwrap_or_else(|| "write a number in metres".to_owned()),
        );
    }
    if wants("degrees") {
        return Some(
            converted(value, unit, "deg", &ANGLES).unwrap_or_else(|| "write a number in degrees".to_owned()),
        );
    }
    let Some((device, own)) = reader.units.at(place) else {
        return wants("unit")
            .then(|| format!("write the number alone, in the unit of the device, without `{unit}{per}`"));
    };
    let Some(own) = own else {
        return Some(format!("write the number alone: the description of `{device}` names no unit"));
    };
    if own == unit {
        return Some(format!("`{device}` takes numbers in {own}{per}: write `{digits}`"));
    }
    let scales =
        [&LENGTHS[..], &ANGLES[..]].into_iter().find(|scales| scales.iter().any(|(known, _)| *known == own));
    let hint = scales.and_then(|scales| converted(value, unit, own, scales));
    Some(hint.map_or_else(
        || format!("`{device}` takes numbers in {own}{per}: write the number alone, in this unit"),
        |hint| format!("`{device}` takes numbers in {own}{per}: {hint}"),
    ))
}

/// `90deg/s`: a number with a unit for a time, which is no quotient.
pub(crate) fn is_rate(text: &str) -> bool {
    let number =
        text.trim().trim_start_matches(|c: char| c.is_ascii_digit() || matches!(c, '.' | '-')).trim();
    let is_unit = |unit: &str| LENGTHS.iter().chain(&ANGLES).any(|(known, _)| *known == unit);
    let is_time = |time: &str| matches!(time, "s" | "s2" | "s^2" | "s**2" | "s\u{b2}");
    number.len() < text.trim().len()
        && number.split_once('/').is_some_and(|(unit, time)| is_unit(unit) && is_time(time))
}

const LENGTHS: [(&str, f64); 3] = [("m", 1.0), ("cm", 0.01), ("mm", 0.001)];
const ANGLES: [(&str, f64); 4] = [
    ("rad", 1.0),
    ("deg", std::f64::consts::PI / 180.0),
    ("\u{b0}", std::f64::consts::PI / 180.0),
    ("degrees", std::f64::consts::PI / 180.0),
];

/// A value in another unit, to four decimals.
fn converted(value: f64, from: &str, to: &str, scales: &[(&str, f64)]) -> Option<String> {
    let scale = |unit: &str| scales.iter().find(|(known, _)| *known == unit).map(|(_, scale)| *scale);
    let value = value * scale(from)? / scale(to)?;
    Some(format!("write `{}`", (value * 1e4).round() / 1e4))
}
