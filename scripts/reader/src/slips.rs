//! Hints for common mistakes: words, keys and notations of other programs, numbers with units, lists without brackets.

mod advice;
mod keyframes;
mod keys;

use std::collections::HashMap;

use urrcp::Device;

pub use keyframes::{OtherForm, as_keyframes};
pub use keys::{key, missing, parameter, word_of};

use crate::clock_time::{parse_instant, parse_time_of_day};
use crate::scope::Scope;
use downbeat_yaml::composed::{composed, is_same};
use downbeat_yaml::duration::parse_duration;
use downbeat_yaml::finding::{PathStep, Place, did_you_mean_this};
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

/// The devices of a fleet by name, each with its unit. The unit is `None` if it is not stated, or if it differs between robots with this
/// device.
#[derive(Debug, Default)]
pub struct Units(HashMap<String, Option<String>>);

impl Units {
    /// Collects the devices of all robots. The unit of a device is only known if it is the same on all robots that have the device.
    pub fn of<'d>(devices: impl IntoIterator<Item = &'d Device>) -> Self {
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

    /// Whether a robot of the fleet has a device of this name.
    pub fn has_device(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    /// Returns the device under whose key in `tracks` or `limits` a place is, and the unit of the device if it is known.
    fn at<'p>(&self, place: &'p Place) -> Option<(&'p str, Option<&str>)> {
        let at = place
            .path
            .iter()
            .rposition(|part| matches!(part, PathStep::Key(key, _) if key == "tracks" || key == "limits"))?;
        let PathStep::Key(device, _) = place.path.get(at + 1)? else { return None };
        Some((device, self.0.get(device)?.as_deref()))
    }
}

/// Words in the names of easings of other programs that Downbeat does not have.
const OTHER_EASINGS: [&str; 9] =
    ["cubicbezier", "bounce", "elastic", "spring", "overshoot", "expo", "circ", "quad", "quart"];

/// Returns a hint for the unknown word `wrong`. `known` are the words that are valid at that place.
pub fn word<'a>(wrong: &str, known: impl Iterator<Item = &'a str> + Clone) -> Option<String> {
    let plain: String = wrong.chars().filter(|c| c.is_alphanumeric()).collect::<String>().to_lowercase();
    let has = |word: &str| known.clone().any(|known| known == word);
    let meant = match plain.as_str() {
        "hold" | "constant" | "none" | "jump" | "discrete" | "stepped" | "instant" if has("step") => "step",
        "sine" | "sin" | "soft" | "ease" | "smoothstep" | "minimumjerk" | "minjerk" | "scurve" | "bezier"
            if has("smooth") =>
        {
            "smooth"
        }
        easing if has("smooth") && easing.starts_with("easeinout") => "smooth",
        easing if has("smooth") && OTHER_EASINGS.iter().any(|other| easing.contains(other)) => {
            return Some("for other curves, use more keyframes, a `spline` or a `formula`".to_owned());
        }
        easing if has("smooth") && ["ease", "in", "out"].iter().any(|begin| easing.starts_with(begin)) => {
            return Some("one-sided easing is not supported: `smooth` eases both in and out".to_owned());
        }
        "reverse" | "reversed" | "backwards" | "back" | "desc" | "descending" if has("backward") => {
            "backward"
        }
        "forwards" | "normal" | "asc" | "ascending" if has("forward") => "forward",
        "left" | "lefttoright" | "right" | "righttoleft" if has("backward") => {
            return Some(
                "write `by: x` with `direction: forward` (left to right) or `direction: backward` (right to left)"
                    .to_owned(),
            );
        }
        "left" | "lefttoright" | "right" | "righttoleft" if has("x") => "x",
        "continue" | "ignore" | "skip" | "goon" if has("without") => "without",
        "halt" | "abort" | "fail" if has("stop") => "stop",
        "round" | "nearest" | "clamp" | "adjust" | "correct" | "warn" if has("snap") => "snap",
        "error" | "strict" | "reject" | "forbid" | "deny" if has("snap") => "refuse",
        "automatic" | "any" | "free" | "optimal" | "optimize" | "best" | "shortest" | "parallel"
            if has("auto") =>
        {
            "auto"
        }
        "fifo" | "first" | "fixed" | "file" | "manual" | "listed" | "sequential" if has("auto") => "given",
        "exclusive" | "mutex" | "lock" | "single" | "shared" if has("auto") => {
            return Some(
                "only one cue at a time can use a zone: `given` keeps the order of the file, `auto` searches for an order that takes less time"
                    .to_owned(),
            );
        }
        "pause" | "freeze" | "hold" | "estop" | "emergencystop" if has("without") => "stop",
        "retry" | "restart" | "reconnect" if has("without") => {
            return Some(
                "a failed robot cannot restart during this act: use `without` to continue without it"
                    .to_owned(),
            );
        }
        "abort" | "cancel" | "wait" | "stop" | "refuse" if has("withdraw") => "withdraw",
        "continue" | "go" | "run" | "ignore" if has("withdraw") => "start",
        "park" | "rest" | "default" | "zero" | "reset" | "return" | "origin"
            if known.clone().eq(["home"]) =>
        {
            "home"
        }
        "robots" | "members" | "all" | "cue" | "index" if known.clone().eq(["group"]) => "group",
        "distance" | "sum" | "way" | "ways" | "mean" | "average" if has("longest") => "total",
        "max" | "maximum" | "worst" | "time" if has("longest") => "longest",
        "hold" | "wait" | "stop" | "keep" | "hover" if has("stay") => "stay",
        "land" | "park" | "return" if has("stay") => "home",
        "even" | "uniform" | "spread" if has("evenly") => "evenly",
        "closest" | "near" | "shortest" if has("evenly") => "nearest",
        "seconds" | "second" | "sec" if has("us") => "s",
        "milliseconds" | "millis" | "msec" if has("us") => "ms",
        "microseconds" | "micros" | "usec" if has("us") => "us",
        "order" | "number" | "name" | "id" if has("index") => "index",
        "shuffle" | "shuffled" if has("index") => "random",
        "distance" | "radius" | "place" | "position" | "center" | "centre" | "middle" if has("index") => {
            return Some("write the point from which distances are measured: `by: [0, 0, 0]`".to_owned());
        }
        "random" | "shuffle" if has("inward") => return Some("write `by: random` with a `seed`".to_owned()),
        "center" | "middle" | "centerout" | "centreout" | "out" if has("inward") => "outward",
        "in" | "edges" | "edgesin" if has("inward") => "inward",
        "velocity" | "vel" if has("speed") => "speed",
        "angle" | "pos" | "joint" if has("speed") => "position",
        "no" | "off" | "false" | "none" if has("skip") => "skip",
        "yes" | "on" | "true" if has("full") => "full",
        "stop" | "stay" | "none" | "hold" if known.clone().eq(["home"]) => {
            return Some("leave the key out: devices stay where they are".to_owned());
        }
        _ => return None,
    };
    Some(did_you_mean_this(meant))
}

/// Returns a hint for a value of the wrong type. `expected` describes the value that belongs there.
pub fn value(scope: &Scope, units: &Units, place: &Place, node: &Node, expected: &str) -> Option<String> {
    match node {
        Node::Text(text) if scope.get(text).is_some() => Some(format!("write the variable as `${text}`")),
        Node::Text(text) if is_value(place) && STATES.contains(&text.to_lowercase().as_str()) => {
            Some("write the number that the device expects, such as `0` or `1`".to_owned())
        }
        Node::Text(text) if expected.starts_with("robot `") && text.ends_with(".yaml") => {
            Some(format!("write `{{init: {}, address: sim}}`", shortened(text)))
        }
        Node::Bool(_) if expected.starts_with("`simulate`") => {
            Some("leave it out: `address: sim` alone simulates the robot".to_owned())
        }
        Node::Text(text) if expected == "true or false" => truth(text, place),
        Node::Text(text) if expected.starts_with("an entry of `play`") => {
            Some(format!("write `{{move: {text}}}`"))
        }
        Node::Text(text) if expected == "a finite number" && colour(text).is_some() => colour(text)
            .map(|values| format!("if the device takes several values, write a list: `{values:?}`")),
        Node::Number(value) if expected == "true or false" => Some(match place.path.last() {
            Some(PathStep::Key(key, _)) if key == "mirror" => format!("write `{{about: {value}}}`"),
            _ => format!("write `{}`", *value != 0.0),
        }),
        Node::Number(value) if expected == "a list of finite numbers" => Some(format!("write `[{value}]`")),
        Node::Number(value) if expected.starts_with("the minimum and maximum coordinate") => {
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
        Node::List(_) if expected.starts_with("the name of an act") => Some(
            "write only one act; to go to another act after a timeout, use `otherwise` under `wait`"
                .to_owned(),
        ),
        Node::List(_) if expected.starts_with("the name of a formation") => {
            Some("write a separate cue for each formation".to_owned())
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
            if expected.starts_with("the minimum and maximum delay") && parse_duration(text).is_some() =>
        {
            Some(format!("write `[{text}, {text}]`"))
        }
        Node::Text(text)
            if expected.starts_with("a whole number")
                && is_repeat(place)
                && parse_duration(text).is_some() =>
        {
            Some(format!(
                "write `{{for: {text}}}` to repeat it for this time, or only the number of repetitions"
            ))
        }
        Node::Text(text) => number(units, place, text, expected)
            .or_else(|| {
                metres(text)
                    .and_then(|length| in_a_map(expected, length))
                    .filter(|_| !expected.starts_with("limits"))
            })
            .or_else(|| {
                expected
                    .contains(": a map")
                    .then(|| downbeat_yaml::syntax::without_space_at_all(text))
                    .flatten()
            }),
        Node::Map(entries) if expected.starts_with("a place in metres") => coordinates(entries),
        Node::Map(_) if expected.starts_with("a list of") => {
            Some("put brackets around it: `[{...}]`".to_owned())
        }
        Node::Map(_) if expected.starts_with("the path of an initialization block") => {
            Some("move the description to a separate file, and write its path here".to_owned())
        }
        Node::Map(entries) if expected.starts_with("a robot, a group or a list") => {
            let names: Vec<&str> = entries.iter().map(|(key, _)| key.as_str()).collect();
            Some(format!("write a list: `[{}]`", names.join(", ")))
        }
        Node::Number(value) if expected.starts_with("a list of keyframes") => {
            Some(format!("add the time at which the value is reached, as in `[{{at: 1s, to: {value}}}]`"))
        }
        Node::Number(_)
            if expected.starts_with("a place in metres")
                && matches!(place.path.last(), Some(PathStep::Index(_))) =>
        {
            Some("put each place in its own brackets: `[[0, 0, 1], [1, 0, 1]]`".to_owned())
        }
        Node::Number(value) if expected.starts_with("a place in metres") => {
            Some(format!("write all three coordinates: `[0, 0, {value}]`"))
        }
        Node::Number(value) if expected.starts_with("metres along x, y and z") => {
            Some(format!("write all three coordinates: `[0, 0, {value}]`"))
        }
        Node::Number(value) if expected.starts_with("a time signature") => Some(format!("write `{value}/4`")),
        Node::Number(value) if expected.starts_with("a whole number") => times(place, *value),
        Node::Number(value) => in_a_list(expected, *value).or_else(|| in_a_map(expected, *value)),
        Node::Bool(true) if expected == "`strict`" => Some("write `strict`".to_owned()),
        Node::Bool(false) if expected == "`strict`" => Some("leave the key out".to_owned()),
        Node::Bool(_) | Node::Null if wants_number(expected) && is_value(place) => {
            Some("write the number that the device expects, such as `0` or `1`".to_owned())
        }
        Node::List(items) if wants_number(expected) => Some(one_number(place, items)),
        Node::List(items) if expected.starts_with("a time signature") => match &items[..] {
            [Node::Number(beats), Node::Number(unit)] => Some(format!("write `{beats}/{unit}`")),
            _ => None,
        },
        Node::List(_) if expected.starts_with("a map from each robot id") => {
            Some("write a map: `{left: {init: arm.yaml, address: sim}}`".to_owned())
        }
        Node::List(_) if expected.starts_with("a map from each device to its keyframes") => {
            Some("write a map: `{elbow: [{at: 0s, to: 0}]}`".to_owned())
        }
        Node::List(items) if expected == "a map from each parameter to its default" => {
            let name = |item: &Node| match item {
                Node::Text(name) => Some(format!("{}: ~", shortened(name))),
                _ => None,
            };
            let names: Option<Vec<String>> = items.iter().map(name).collect();
            Some(format!(
                "write each parameter with its default, or `~` for none: `{{{}}}`",
                names?.join(", ")
            ))
        }
        Node::List(_) if expected.starts_with("a map from each") => {
            Some("write a map, with a name for each entry: `{name: ...}`".to_owned())
        }
        Node::List(_) if expected == "the name of a move" => {
            Some("write a cue for each move, or define a move that lists them under `play`".to_owned())
        }
        Node::List(_) if expected.starts_with("the path of a fleet file") => {
            Some("write the path of one file that lists all robots".to_owned())
        }
        Node::Null if expected.starts_with("a list of keyframes") => {
            Some("add the keyframes, as in `[{at: 0s, to: 0}, {at: 1s, to: 45}]`".to_owned())
        }
        Node::Null if expected.starts_with("`sim`") => Some("write `sim` to simulate the robot".to_owned()),
        Node::Tagged(_) => Some("remove the tag: tags are not supported".to_owned()),
        _ => None,
    }
}

/// Returns the hint for a value of the wrong type that is written in block style (without brackets). `None` if the hint of [`value`]
/// applies there as well.
pub fn in_block(node: &Node, expected: &str) -> Option<&'static str> {
    match node {
        Node::Map(_) if expected.starts_with("a list of") => {
            Some("start every entry of the list with a dash: `- `")
        }
        Node::List(_) if expected.starts_with("a map from each robot id") => {
            Some("write `left: {init: arm.yaml, address: sim}` for each robot, without a dash")
        }
        Node::List(_) if expected.starts_with("a map from each device to its keyframes") => {
            Some("write `elbow: [{at: 0s, to: 0}]` for each device, without a dash")
        }
        Node::List(_) if expected == "a map from each parameter to its default" => {
            Some("write each parameter without a dash, and with its default or `~` for none: `height: ~`")
        }
        Node::List(_) if expected.starts_with("a map from each") => {
            Some("write `name: ...` for each entry instead of a dash")
        }
        _ => None,
    }
}

/// Returns a hint to write `true` or `false` instead of a text such as `yes` or `no`, which YAML does not read as a boolean.
fn truth(text: &str, place: &Place) -> Option<String> {
    let is_mirror = matches!(place.path.last(), Some(PathStep::Key(key, _)) if key == "mirror");
    let value = match text.to_lowercase().as_str() {
        "yes" | "on" | "y" | "ja" => true,
        "no" | "off" | "n" | "nein" => false,
        _ if is_mirror => {
            return Some("`true` mirrors about 0, and `{about: 45}` mirrors about 45".to_owned());
        }
        _ => return None,
    };
    Some(format!("write `{value}`"))
}

/// The hint for a movement that is meant to repeat endlessly.
const ENDLESS: &str = "endless repetition is not supported: write a number or `{for: 60s}`; to repeat an act until the operator continues, add \
                       `wait: {for: operator, timeout: 1s, otherwise: NAME}` to the next act";

/// Returns a hint for `value`, a number that must be above 0 but is not.
pub fn not_positive(expected: &str, value: f64) -> Option<String> {
    match (expected.starts_with("a frequency"), value < 0.0) {
        (true, true) => Some(format!("write `{}`; to invert the wave, add `phase: 180`", -value)),
        (true, false) => Some(
            "write cycles per second, as in `frequency: 0.5`; use a keyframe for a constant value".to_owned(),
        ),
        (false, true) => Some(format!("write `{}`", -value)),
        (false, false) => None,
    }
}

/// Returns a hint for a list where one time is expected.
pub fn one_time(place: &Place, node: &Node) -> Option<String> {
    let Node::List(items) = node else { return None };
    let time = |item: &Node| match item {
        Node::Text(text) => Some(shortened(text)),
        _ => None,
    };
    let is_of_cue = !place.path.iter().any(|part| matches!(part, PathStep::Key(key, _) if key == "tracks"));
    match &items[..] {
        [from, to] if is_of_cue => {
            Some(format!("write one time, or a range: `{}..{}`", time(from)?, time(to)?))
        }
        [first, ..] => Some(format!("write one time, as in `{}`", time(first)?)),
        [] => None,
    }
}

/// Returns a hint for an endless or a negative time. It depends on the key that has this time.
pub fn time(place: &Place, text: &str) -> Option<String> {
    let keys: Vec<&str> = place
        .path
        .iter()
        .rev()
        .filter_map(|part| match part {
            PathStep::Key(key, _) => Some(key.as_str()),
            PathStep::Index(_) => None,
        })
        .collect();
    if is_endless(text) || text == "never" {
        return match keys.as_slice() {
            [_, "repeat", ..] => Some(ENDLESS.to_owned()),
            ["stop_condition", ..] | ["running", ..] => Some(
                "write `stop_condition: {running: none}` to let robots continue without the server"
                    .to_owned(),
            ),
            _ => None,
        };
    }
    let positive = text.strip_prefix('-').filter(|rest| parse_duration(rest).is_some())?;
    match *keys.first()? {
        "period" => Some(format!("write `{positive}`; to invert the wave, add `phase: 180`")),
        "every" => {
            Some("leave `every` out: each repetition then starts when the previous one ends".to_owned())
        }
        "canon" => {
            Some(format!("write `{{step: {positive}, direction: backward}}` to start with the last robot"))
        }
        "step" => Some(format!("write `{positive}`, and `direction: backward` to start with the last robot")),
        _ => None,
    }
}

/// Returns a hint for an instant, a date or a time of day where a duration is expected.
pub fn instant(text: &str) -> String {
    let is_day = text.len() == 10 && text.as_bytes().get(4) == Some(&b'-');
    let at = match () {
        () if parse_instant(text).is_some() || parse_time_of_day(text).is_some() => text.to_owned(),
        () if is_day => format!("{text}T20:00:00Z"),
        () => "20:00".to_owned(),
    };
    format!(
        "use `downbeat run --at {at}` to start the show at a given time, or `wait: {{time: \"{at}\"}}` to start an act at that time"
    )
}

/// Returns a hint for an invalid number of repetitions: 0, negative, infinite, or with a fraction.
pub fn times(place: &Place, value: f64) -> Option<String> {
    match value {
        _ if !is_repeat(place) => None,
        0.0 => Some(format!("leave `repeat` out to play it once; {ENDLESS}")),
        value if value < 0.0 || value == f64::INFINITY => Some(ENDLESS.to_owned()),
        value if value.fract() != 0.0 => Some(
            "only whole repetitions are supported: `{for: 10s}` plays the movement as often as it fits"
                .to_owned(),
        ),
        _ => None,
    }
}

/// Whether the place is the value of a key `repeat` or `times`.
fn is_repeat(place: &Place) -> bool {
    matches!(place.path.last(), Some(PathStep::Key(key, _)) if key == "repeat" || key == "times")
}

/// Parses a length such as `3m` or `30cm`, and converts it to metres.
fn metres(text: &str) -> Option<f64> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let (_, scale) = LENGTHS.iter().find(|(unit, _)| text[digits.len()..] == **unit)?;
    let value: f64 = digits.trim().parse().ok()?;
    value.is_finite().then(|| (value * scale * 1e4).round() / 1e4)
}

fn is_endless(text: &str) -> bool {
    ["forever", "infinite", "infinitely", "infinity", "inf", "endless", "always", "loop"]
        .contains(&text.to_lowercase().as_str())
}

/// Splits a list that lacks brackets into words: `left, right`, `left and right`, `left right`.
pub fn words(text: &str) -> Vec<String> {
    let plain = text.trim_matches(['[', ']', '{', '}']).replace(" and ", ",").replace(['&', '+', ';'], ",");
    let separator = if plain.contains(',') { ',' } else { ' ' };
    let words = plain.split(separator).map(str::trim).filter(|word| !word.is_empty());
    words.map(str::to_owned).collect()
}

/// Returns a hint for a text that contains several known names, or one known name in quotation marks that YAML does not remove.
pub fn several_names<'a>(text: &str, known: impl Iterator<Item = &'a str> + Clone) -> Option<String> {
    let is_known = |name: &str| known.clone().any(|known| is_same(known, name));
    let words = match text.split_once('-') {
        Some((first, second))
            if is_known(first) && is_known(second) && !first.ends_with(|c: char| c.is_ascii_digit()) =>
        {
            vec![first.to_owned(), second.to_owned()]
        }
        _ => words(text),
    };
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

/// Returns the text within the braces of `{{ x }}`, `"{{ x }}"` or `{$x}`; `None` for any other node. YAML reads `{{ x }}` as a map whose
/// key is a map.
pub fn template(node: &Node) -> Option<String> {
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

/// Returns the text with `$` before each name of a variable. A text of one word always gets a `$`.
pub fn bare(scope: &Scope, inner: &str) -> String {
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

/// Returns a hint for coordinates that are written as a map, such as `{x: 0, y: 0, z: 3}`.
fn coordinates(entries: &[(String, Node)]) -> Option<String> {
    let value = |axis: &str| match entries.iter().find(|(key, _)| key == axis) {
        Some((_, Node::Number(value))) => Some(*value),
        Some(_) => None,
        None => Some(0.0),
    };
    let [x, y, z] = [value("x")?, value("y")?, value("z")?];
    Some(format!("write `[{x}, {y}, {z}]`"))
}

/// Words that users write as values of a device, where only numbers are valid.
const STATES: [&str; 12] =
    ["on", "off", "yes", "no", "min", "max", "home", "default", "open", "closed", "high", "low"];

/// Whether the place is the value (`to`) of a keyframe in `tracks`.
fn is_value(place: &Place) -> bool {
    matches!(place.path.last(), Some(PathStep::Key(key, _)) if key == "to")
        && place.path.iter().any(|part| matches!(part, PathStep::Key(key, _) if key == "tracks"))
}

/// Returns a hint for a list where one number is expected: `radius: [1, 2]`.
fn one_number(place: &Place, items: &[Node]) -> String {
    let key = place.path.iter().rev().find_map(|part| match part {
        PathStep::Key(key, _) => Some(key.as_str()),
        PathStep::Index(_) => None,
    });
    let first = items.iter().find_map(|item| match item {
        Node::Number(value) => Some(*value),
        _ => None,
    });
    let (key, first) = (key.unwrap_or("to"), first.unwrap_or(2.0));
    match key {
        "to" => {
            format!("write one number, `to: {first}`: only `custom_N` control types accept several values")
        }
        _ => format!("write one number, as in `{}: {first}`", shortened(key)),
    }
}

/// Returns a hint for a number where a list or a map with several keys is expected: `points: 3`, `wave: 20`.
fn in_a_list(expected: &str, value: f64) -> Option<String> {
    let begins = |begin: &str| expected.starts_with(begin);
    if begins("a list of places") || begins("a list of points such as [") {
        return Some("write three numbers for each place, as in `[[0, 0, 1], [1, 0, 1]]`".to_owned());
    }
    if begins("a list of points such as {at") {
        return Some(format!(
            "add the time at which each value is reached: `[{{at: 0s, to: 0}}, {{at: 1s, to: {value}}}]`"
        ));
    }
    if begins("a list of numbers") {
        return Some(format!("write `[{value}]`"));
    }
    if begins("a list of pieces") || begins("a polynomial: a map") {
        return Some(format!("add the duration of each piece: `{{for: 2s, coefficients: [{value}]}}`"));
    }
    if begins("a wave: a map") {
        return Some(format!("write `{{amplitude: {value}, period: 2s, for: 8s}}`"));
    }
    if begins("a tempo: a map") {
        return Some(format!(
            "write `tempo: {value}`, or, if the tempo changes, `[{{at: bar 1, bpm: {value}}}]`"
        ));
    }
    if begins("the minimum and maximum reading") {
        return Some(format!("write both: `[{}, {}]`", value.min(0.0), value.max(0.0)));
    }
    begins("a map from each sensor to the times")
        .then(|| format!("add the time at which the sensor is read: `{{SENSOR: {value}s}}`"))
}

/// Returns a hint for a number where a map is expected that usually has one key: `limits: {elbow: 90}`, `circle: 4`.
fn in_a_map(expected: &str, value: f64) -> Option<String> {
    let (what, keys) = expected.split_once(": a map with `")?;
    let of_one_number = ["limits", "`line`", "`circle`", "`grid`", "`v`", "`sphere`"];
    let key = keys.split('`').next().filter(|_| of_one_number.contains(&what))?;
    Some(format!("write `{{{key}: {value}}}`"))
}

/// Returns the red, green and blue values (0 to 255) of a colour such as `red` or `#ff8800`; `None` for any other text.
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

/// Returns a hint that lists the robots of a range, such as `d1-d6` or `d1..d6`, or of a prefix, such as `d*`.
pub fn range_of_robots<'a>(text: &str, ids: impl Iterator<Item = &'a str> + Clone) -> Option<String> {
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

/// Returns a hint for a reference to the previous cue, such as `previous`, or to a cue by its number.
pub fn earlier_cue(text: &str) -> Option<String> {
    let is_number = text.parse::<u32>().is_ok();
    let is_above = ["previous", "prev", "last", "before", "above"].contains(&text);
    (is_number || is_above)
        .then(|| "give that cue a name, such as `cue: rise`, and refer to it: `after: rise`".to_owned())
}

/// Returns a hint for a range whose robots cannot be listed: `r1-r3`, `1..3` or `arms[0]`.
pub fn as_a_range(text: &str) -> Option<String> {
    let ends_in_digit = |part: &str| part.ends_with(|c: char| c.is_ascii_digit());
    let is_range = text.contains("..")
        || (text.contains('[') && text.ends_with(']'))
        || text.split_once('-').is_some_and(|(from, to)| ends_in_digit(from) && ends_in_digit(to));
    is_range.then(|| {
        "ranges of robots are not supported: list the robots, or use a group of the fleet file".to_owned()
    })
}

/// Maximum number of robots that a hint lists.
const LISTED_MAX: usize = 20;

/// Whether `expected`, the description of a value in a message, is about one or several numbers.
fn names_number(expected: &str) -> bool {
    ["number", "device's unit", "metres", "degrees", "hertz", "beats per minute", "factor"]
        .iter()
        .any(|word| expected.contains(word))
}

/// Whether `expected`, the description of a value in a message, is about a single number.
fn wants_number(expected: &str) -> bool {
    names_number(expected)
        && !expected.contains('[')
        && !["a list", "a map", "texts"].iter().any(|word| expected.contains(word))
}

/// Returns a hint for a number with thousands separators, such as `1,000` or `1,000.5`.
fn of_thousands(text: &str) -> Option<String> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let mut groups = whole.trim_start_matches('-').split(',');
    let is_digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    let first = groups.next().filter(|first| (1..=3).contains(&first.len()) && is_digits(first))?;
    let others: Vec<&str> = groups.collect();
    let is_grouped = !others.is_empty() && others.iter().all(|group| group.len() == 3 && is_digits(group));
    let is_certain = others.len() > 1 || !fraction.is_empty();
    let plain = text.replace(',', "");
    match (is_grouped && first != "0", is_certain) {
        (true, true) => Some(format!("write the number without commas: `{plain}`")),
        (true, false) => Some(format!(
            "write the number without the comma, `{plain}`, or with a decimal point, `{}`",
            text.replace(',', ".")
        )),
        (false, _) => None,
    }
}

/// Returns a hint for a number in a form that only people understand: `45,5`, `45deg`, `"45"`.
fn number(units: &Units, place: &Place, text: &str, expected: &str) -> Option<String> {
    let wants = |word: &str| expected.contains(word);
    if !names_number(expected) {
        return None;
    }
    let parsed = |text: &str| text.parse::<f64>().ok().filter(|value| value.is_finite());
    if parsed(text.trim()).is_some() {
        return Some(format!("write it without quotation marks: `{}`", text.trim()));
    }
    if let Some(hint) = of_thousands(text.trim()) {
        return Some(hint);
    }
    let with_point = text.trim().replacen(',', ".", 1);
    if parsed(&with_point).is_some() {
        return Some(format!("write a decimal point: `{with_point}`"));
    }
    let digits = with_point.trim_end_matches(|c: char| !c.is_ascii_digit()).trim();
    let (value, unit) = (parsed(digits)?, with_point[digits.len()..].trim());
    let (unit, per) = unit.find('/').map_or((unit, ""), |slash| unit.split_at(slash));
    let is_acceleration = matches!(place.path.last(), Some(PathStep::Key(key, _)) if key == "acceleration");
    let per = if is_acceleration && !per.is_empty() { "/s^2" } else { per };
    if wants("degrees") && matches!(unit, "turn" | "turns") {
        return Some(format!("write `{}`", value * 360.0));
    }
    if wants("hertz")
        || wants("beats per minute")
        || wants("whole number")
        || (wants("factor") && unit == "x")
    {
        return Some(format!("write only the number: `{digits}`"));
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
    let Some((device, own)) = units.at(place) else {
        return wants("unit")
            .then(|| format!("write only the number, in the unit of the device, without `{unit}{per}`"));
    };
    let Some(own) = own else {
        return Some(format!("write only the number: the description of `{device}` has no unit"));
    };
    if own == unit {
        return Some(format!("`{device}` takes numbers in {own}{per}: write `{digits}`"));
    }
    let scales =
        [&LENGTHS[..], &ANGLES[..]].into_iter().find(|scales| scales.iter().any(|(known, _)| *known == own));
    let hint = scales.and_then(|scales| converted(value, unit, own, scales));
    Some(hint.map_or_else(
        || format!("`{device}` takes numbers in {own}{per}: write only the number, in that unit"),
        |hint| format!("`{device}` takes numbers in {own}{per}: {hint}"),
    ))
}

/// Whether a text is a rate such as `90deg/s`, that is, a number with a unit per second, and not a division.
pub fn is_rate(text: &str) -> bool {
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

/// Returns a hint with a value converted from the unit `from` to the unit `to` and rounded to four decimals. `None` if `scales` lacks a
/// unit.
fn converted(value: f64, from: &str, to: &str, scales: &[(&str, f64)]) -> Option<String> {
    let scale = |unit: &str| scales.iter().find(|(known, _)| *known == unit).map(|(_, scale)| *scale);
    let value = value * scale(from)? / scale(to)?;
    Some(format!("write `{}`", (value * 1e4).round() / 1e4))
}
