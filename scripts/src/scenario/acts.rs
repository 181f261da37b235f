//! Acts as written: their cues, the condition before they begin, the next act, and the reaction to a failure.

use std::sync::Arc;

use urrcp::{Span, StopCondition};

use super::cue::{CueKeys, ORDER};
use super::kinds;
use super::library::{self, Library};
use super::{Act, Name, OffGrid, Order, sequence};
use crate::clock_time::{parse_instant, parse_time_of_day};
use crate::duration::parse_duration;
use crate::fields::{At, Reader};
use crate::finding::{Code, Place};
use crate::node::Node;
use crate::plan::{OnDoubt, OnFailure, Wait};
use crate::sensor_range::sensor_range;
use crate::shown::shortened;
use downbeat_reader::keys::{Item, Keys, Kind, Naming};
use downbeat_reader::{keys, schema, words};

keys! {
    /// Cues that are prepared, decided and started together.
    pub(super) struct ActKeys as "act" {
        /// Its name.
        act: Kind::Name(Naming::Defines(Item::Act), &kinds::NAME),
        #[required]
        cues: kinds::CUES,
        #[default("`done`")]
        wait: kinds::WAIT,
        /// The following act, or `end`.
        #[default("the next act in the file")]
        next: kinds::ACT,
        on_failure: kinds::ON_FAILURE,
        on_doubt: kinds::ON_DOUBT,
        zones: kinds::ZONES,
        order: kinds::ORDER,
        tempo: kinds::TEMPO,
        signature: kinds::SIGNATURE,
    }
}

keys! {
    /// One of `for`, `time` and `sensor`.
    pub(super) struct WaitKeys {
        /// `done`: the previous act has ended; `operator`: the operator gives the go.
        r#for: words!(WAIT_WORDS),
        /// A time of day such as `19:30:00`, local time, or a date and time as in RFC 3339.
        time: kinds::TEXT,
        /// A robot and its sensor: `rover/range`.
        sensor: Kind::Name(Naming::Uses(Item::RobotDevice), &schema!({"type": "string", "pattern": "^[^/]+/.+$"})),
        /// Readings above this.
        above: kinds::NUMBER,
        /// Readings below this.
        below: kinds::NUMBER,
        /// Readings from the first to the second.
        within: Kind::List(&kinds::NUMBER, 2..=2),
        /// Longest wait.
        timeout: kinds::TIME,
        /// The act that follows after the timeout, or `end`.
        otherwise: kinds::ACT,
    }
}

keys! {
    /// By robot or group.
    pub(super) struct OnFailureKeys {
        /// For robots without an entry.
        default: kinds::FAILURE_WORD,
        /// The act that follows a failure, or `end`.
        then: kinds::ACT,
    }
}

type Condition = fn() -> Wait;

/// Wait conditions that are a single word.
pub(super) const WAIT_WORDS: [(&str, Condition); 2] =
    [("done", || Wait::Done), ("operator", || Wait::Operator)];

/// Settings of the scenario, for acts and cues that do not override them.
pub(super) struct Defaults<'a> {
    pub(super) lease: StopCondition,
    pub(super) off_grid: OffGrid,
    pub(super) order: Order,
    pub(super) zones: Option<At<'a>>,
    pub(super) on_failure: OnFailureRule,
    pub(super) on_doubt: OnDoubt,
}

/// Settings of the scenario that all acts share.
struct Shared {
    zones: Arc<[(String, Order)]>,
    rules: Arc<[(Name, OnFailure)]>,
    /// Number of faults in the scenario's zones.
    faults: usize,
}

/// The reaction of an act to a failure, as written.
#[derive(Clone, Debug, Default)]
pub(crate) struct OnFailureRule {
    pub(crate) default: Option<OnFailure>,
    pub(crate) robots: Vec<(Name, OnFailure)>,
    /// The scenario's rules for single robots; all acts share this list.
    pub(crate) inherited: Arc<[(Name, OnFailure)]>,
    pub(crate) then: Option<Name>,
}

/// The condition for which an act waits, as written.
#[derive(Clone, Debug, Default)]
pub(crate) struct WrittenWait {
    pub(crate) wait: Wait,
    pub(crate) timeout: Option<Span>,
    pub(crate) otherwise: Option<Name>,
    pub(crate) place: Place,
}

pub(super) fn read(
    reader: &mut Reader,
    library: &Library<'_>,
    defaults: &Defaults<'_>,
    root: &At<'_>,
    [cues, acts]: [Option<At<'_>>; 2],
) -> Vec<Act> {
    match (cues, acts) {
        (Some(cues), None) => {
            let before = reader.found.len();
            let zones = defaults.zones.map(|at| zones(reader, &at, defaults.order)).unwrap_or_default();
            let read = read_cues(reader, library, defaults, &cues, "the scenario");
            vec![Act {
                name: String::new(),
                place: cues.place(),
                cues: read,
                faults: reader.found.len() - before,
                zones: zones.into(),
                order: defaults.order,
                wait: WrittenWait::default(),
                next: None,
                on_failure: defaults.on_failure.clone(),
                on_doubt: defaults.on_doubt,
            }]
        }
        (None, Some(acts)) => {
            let items = reader.list(&acts, "a list of acts");
            if items.is_empty() && matches!(acts.node, Node::List(_)) {
                super::nothing(reader, &acts, "the scenario has no acts", "at least one act");
            }
            let tempo = reader.music.clone();
            let before = reader.found.len();
            let zones = defaults.zones.map(|at| zones(reader, &at, defaults.order)).unwrap_or_default();
            let rules = defaults.on_failure.robots.as_slice().into();
            let shared = Shared { zones: zones.into(), rules, faults: reader.found.len() - before };
            let act = |(index, item)| {
                reader.music = tempo.clone();
                act(reader, library, defaults, &shared, item, index)
            };
            items.iter().enumerate().filter_map(act).collect()
        }
        (Some(_), Some(acts)) => {
            let hint = Some("move the cues into a separate act".to_owned());
            let message = "`cues` and `acts` cannot be combined";
            reader.add(Code::UnknownKey, acts.key_place(), message, "either `cues` or `acts`", hint);
            Vec::new()
        }
        (None, None) => {
            let hint =
                "write `cues:` and the movements below it; run `downbeat init first-show` for an example";
            if !["cues", "acts"].iter().any(|key| reader.is_miswritten(root, key)) {
                let message = "the scenario has no `cues`";
                reader.add(
                    Code::MissingKey,
                    root.place(),
                    message,
                    "a key `cues` or `acts`",
                    Some(hint.into()),
                );
            }
            Vec::new()
        }
    }
}

fn read_cues(
    reader: &mut Reader,
    library: &Library<'_>,
    defaults: &Defaults<'_>,
    at: &At<'_>,
    whose: &str,
) -> Vec<super::Cue> {
    let items = reader.list(at, "a list of cues");
    if items.is_empty() && matches!(at.node, Node::List(_)) {
        super::nothing(reader, at, &format!("{whose} has no cues"), "at least one cue");
    }
    let cue = |(index, item)| sequence::cues(reader, library, defaults, item, index);
    items.iter().enumerate().flat_map(cue).collect()
}

fn act(
    reader: &mut Reader,
    library: &Library<'_>,
    defaults: &Defaults<'_>,
    shared: &Shared,
    at: &At<'_>,
    index: usize,
) -> Option<Act> {
    let moves = ["robots", "tracks", "move", "sequence", "form", "turn", "grow", "shift", "along"];
    let own = without_cue(reader, at, "an act", ActKeys::NAMES, &moves);
    let at = &own.as_ref().map_or(*at, |own| at.with(own));
    let keys: ActKeys<'_> = reader.keys(at, "an act")?;
    let name = keys
        .act
        .and_then(|at| reader.name(&at, "the act's name"))
        .unwrap_or_else(|| format!("act {}", index + 1));
    library::music(reader, keys.tempo, keys.signature);
    let own_order = keys.order.and_then(|at| reader.word(&at, &ORDER));
    let order = own_order.unwrap_or(defaults.order);
    let zones_from = reader.found.len();
    let all = match (own_order, keys.zones) {
        (None, None) => shared.zones.clone(),
        (_, own) => {
            let mut all = defaults.zones.map(|at| zones(reader, &at, order)).unwrap_or_default();
            all.extend(own.map(|at| zones(reader, &at, order)).unwrap_or_default());
            all.into()
        }
    };
    let faults = shared.faults + reader.found.len() - zones_from;
    let whose = format!("the act `{}`", shortened(&name));
    let mut rule = keys.on_failure.map(|at| on_failure(reader, &at)).unwrap_or_default();
    rule.default = rule.default.or(defaults.on_failure.default);
    rule.inherited = shared.rules.clone();
    let before = reader.found.len();
    let cues = keys.cues.map(|at| read_cues(reader, library, defaults, &at, &whose)).unwrap_or_default();
    Some(Act {
        place: at.place(),
        cues,
        faults: faults + reader.found.len() - before,
        zones: all,
        order,
        wait: keys.wait.map(|at| read_wait(reader, &at)).unwrap_or_default(),
        next: keys.next.and_then(|at| {
            Some(Name { text: reader.name(&at, "the name of an act, or `end`")?, place: at.place() })
        }),
        on_failure: rule,
        on_doubt: keys.on_doubt.and_then(|at| reader.word(&at, &ON_DOUBT)).unwrap_or(defaults.on_doubt),
        name,
    })
}

/// Reports, in a single finding, the keys in a map that only cues accept, and returns the map without them. `None` if the map contains
/// none of the keys `moves`.
pub(super) fn without_cue(
    reader: &mut Reader,
    at: &At<'_>,
    what: &str,
    known: &[&str],
    moves: &[&str],
) -> Option<Node> {
    let Node::Map(entries) = at.node else { return None };
    let is_of_cue = |key: &str| CueKeys::NAMES.contains(&key) && !known.contains(&key);
    let (cue, own): (Vec<_>, Vec<_>) = entries.iter().partition(|(key, _)| is_of_cue(key));
    if !cue.iter().any(|(key, _)| moves.contains(&key.as_str())) {
        return None;
    }
    let (first, node) = cue.first()?;
    let keys: Vec<String> = cue.iter().map(|(key, _)| format!("`{key}`")).collect();
    let message = match keys.as_slice() {
        [key] => format!("{key} is a key of a cue, not of {what}"),
        [all @ .., last] => format!("{} and {last} are keys of a cue, not of {what}", all.join(", ")),
        [] => return None,
    };
    let shown: Vec<String> = cue.iter().map(|(key, node)| format!("{key}: {}", briefly(node))).collect();
    let hint = Some(format!("write it as an entry of `cues`: `cues: [{{{}}}]`", shown.join(", ")));
    let place = at.entry(first, 0, node).key_place();
    reader.add(Code::UnknownKey, place, message, "a cue", hint);
    Some(Node::Map(own.into_iter().cloned().collect()))
}

/// Returns a number or a text as written in the file; `...` for a list or a map.
fn briefly(node: &Node) -> String {
    match node {
        Node::Text(text) => shortened(text),
        Node::Number(number) => number.to_string(),
        _ => "...".to_owned(),
    }
}

/// Reads zones and the order of their cues, such as `[table, lift]` or `{table: auto, lift: given}`.
fn zones(reader: &mut Reader, at: &At<'_>, order: Order) -> Vec<(String, Order)> {
    let expected = "a list of zones, or a map from each zone to its order";
    match at.node {
        Node::Map(_) => {
            let entries = reader.entries(at, "a map from each zone to its order");
            let zone =
                |(name, at): &(&str, At<'_>)| ((*name).to_owned(), reader.word(at, &ORDER).unwrap_or(order));
            entries.iter().map(zone).collect()
        }
        _ => {
            let items = reader.list(at, expected);
            items.iter().filter_map(|item| Some((reader.name(item, "the name of a zone")?, order))).collect()
        }
    }
}

pub(super) const ON_FAILURE: [(&str, OnFailure); 3] =
    [("stop", OnFailure::Stop), ("home", OnFailure::Home), ("without", OnFailure::Without)];

pub(super) const ON_DOUBT: [(&str, OnDoubt); 2] =
    [("start", OnDoubt::Start), ("withdraw", OnDoubt::Withdraw)];

/// Reads the rule for failures: one word for all robots, or a map with `default`, `then` and words for robots or groups.
pub(super) fn on_failure(reader: &mut Reader, at: &At<'_>) -> OnFailureRule {
    let Node::Map(_) = at.node else {
        return OnFailureRule { default: reader.word(at, &ON_FAILURE), ..OnFailureRule::default() };
    };
    let mut rule = OnFailureRule::default();
    for (key, at) in reader.entries(at, "a map from each robot, `default` or `then` to its action") {
        match key {
            "default" => rule.default = reader.word(&at, &ON_FAILURE),
            "then" => {
                let text = reader.name(&at, "the name of an act");
                rule.then = text.map(|text| Name { text, place: at.place() });
            }
            robot => {
                let name = Name { text: robot.to_owned(), place: at.key_place() };
                rule.robots.extend(reader.word(&at, &ON_FAILURE).map(|word| (name, word)));
            }
        }
    }
    rule
}

/// Returns a hint for an unknown wait condition of an act.
fn wait_hint(text: &str) -> Option<String> {
    if parse_duration(text).is_some() {
        return Some(format!("to start later, add `at: {text}` to the first cue of the act"));
    }
    if parse_time(text).is_some() {
        return Some(format!("write `wait: {{time: \"{text}\"}}`"));
    }
    let operator = [
        "go", "manual", "key", "button", "cue", "user", "click", "keypress", "press", "space", "enter",
        "trigger", "hotkey", "input",
    ]
    .contains(&text.to_lowercase().as_str());
    operator.then(|| "write `operator`: the act starts when the operator runs `downbeat go`".to_owned())
}

fn read_wait(reader: &mut Reader, at: &At<'_>) -> WrittenWait {
    let Node::Map(_) = at.node else {
        let wait = reader.word_or(at, &WAIT_WORDS, wait_hint).map_or(Wait::Done, |wait| wait());
        return WrittenWait { wait, place: at.place(), ..WrittenWait::default() };
    };
    let Some(keys) = reader.keys::<WaitKeys<'_>>(at, "`wait`") else { return WrittenWait::default() };
    let wait = match (keys.r#for, keys.time, keys.sensor) {
        (Some(word), None, None) => reader.word_or(&word, &WAIT_WORDS, wait_hint).map(|wait| wait()),
        (None, Some(time), None) => time_of_day(reader, &time),
        (None, None, Some(sensor)) => sensor_wait(reader, at, &sensor, [keys.above, keys.below, keys.within]),
        _ if reader.is_miswritten(at, "for") => None,
        _ => {
            let message = "found none or several of `for`, `time` and `sensor`";
            reader.add(
                Code::MissingKey,
                at.place(),
                message,
                "exactly one of `for`, `time` and `sensor`",
                None,
            );
            None
        }
    };
    let timeout = keys.timeout.and_then(|at| reader.duration(&at));
    let otherwise = keys.otherwise.and_then(|at| {
        Some(Name { text: reader.name(&at, "the name of an act, or `end`")?, place: at.place() })
    });
    if let (None, Some(name)) = (timeout, &otherwise) {
        let message = "`otherwise` has no effect without a `timeout`";
        let hint = Some("add a timeout, such as `timeout: 30s`".to_owned());
        reader.add(Code::MissingKey, name.place.clone(), message, "a `timeout`", hint);
    }
    WrittenWait { wait: wait.unwrap_or_default(), timeout, otherwise, place: at.place() }
}

fn sensor_wait(
    reader: &mut Reader,
    at: &At<'_>,
    sensor: &At<'_>,
    [above, below, within]: [Option<At<'_>>; 3],
) -> Option<Wait> {
    let expected = "a robot and its sensor, such as rover/range";
    let text = reader.text(sensor, expected)?;
    let named = text.split_once('/').map(|(robot, sensor)| (robot.to_owned(), sensor.to_owned()));
    if named.is_none() {
        let message = format!("`{}` does not name a robot and a sensor", shortened(&text));
        let hint = Some(match text.split_once('.') {
            Some((robot, sensor)) => format!("write a slash: `{}/{}`", shortened(robot), shortened(sensor)),
            None => format!("write the robot and a slash before it: `ROBOT/{}`", shortened(&text)),
        });
        reader.add(Code::UnknownSensor, sensor.place(), message, expected, hint);
    }
    let range = sensor_range(reader, at, [above, below, within])?;
    named.map(|(robot, sensor)| Wait::Sensor { robot, sensor, range })
}

fn time_of_day(reader: &mut Reader, at: &At<'_>) -> Option<Wait> {
    let expected = "a time of day such as \"19:30:00\", or a date and time as in RFC 3339";
    let text = reader.text(at, expected)?;
    let parsed = parse_time(&text);
    if parsed.is_none() {
        let message = format!("`{}` is not a time of day", shortened(&text));
        let hint = meant_time(&text).map(|time| format!("write `\"{time}\"`"));
        reader.add(Code::BadDuration, at.place(), message, expected, hint);
    }
    parsed
}

/// Returns the time of day that a text in another notation means, such as `30 19 * * *` or `7:30 pm`.
fn meant_time(text: &str) -> Option<String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let (hour, minute) = match words.as_slice() {
        [minute, hour, _, _, _] => (hour.parse::<u8>().ok()?, minute.parse::<u8>().ok()?),
        _ => {
            let small = text.to_lowercase();
            let (time, later) = match small.strip_suffix("pm") {
                Some(time) => (time, 12),
                None => (small.strip_suffix("am")?, 0),
            };
            let (hour, minute) = time.trim().split_once(':').unwrap_or((time.trim(), "0"));
            let hour = hour.parse::<u8>().ok().filter(|hour| (1..=12).contains(hour))?;
            (hour % 12 + later, minute.parse().ok()?)
        }
    };
    let written = format!("{hour:02}:{minute:02}");
    parse_time(&written).map(|_| written)
}

/// Parses a time for which an act can wait: a time of day, `19:30` or `19:30:00.5`, or an instant as in RFC 3339.
#[must_use]
pub fn parse_time(text: &str) -> Option<Wait> {
    parse_instant(text).map(Wait::Instant).or_else(|| parse_time_of_day(text).map(Wait::TimeOfDay))
}
