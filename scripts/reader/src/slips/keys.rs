//! Hints for keys: names from other programs, keys that belong to another map, missing keys.

use super::Units;
use super::advice::ADVICE;
use downbeat_yaml::duration::parse_duration;
use downbeat_yaml::finding::did_you_mean_this;
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

/// Each entry is a map, synonyms that users write for one of its keys, and that key.
const KEYS: [(&str, &[&str], &str); 76] = [
    ("a keyframe", &["value", "position", "positions", "pos", "angle", "target", "val", "goal"], "to"),
    ("a keyframe", &["time", "t", "when", "start", "time_from_start"], "at"),
    ("a keyframe", &["easing", "curve", "interpolation", "interp", "transition"], "ease"),
    ("a point", &["value", "position", "pos", "angle", "target", "val"], "to"),
    ("a point", &["time", "t", "when", "start"], "at"),
    ("a cue", &["name", "id", "title", "label", "number"], "cue"),
    ("a cue", &["start", "time", "begin", "when"], "at"),
    ("a cue", &["group", "groups", "who", "cast"], "robots"),
    ("a cue", &["length"], "duration"),
    ("a cue", &["loop", "loops", "times", "count"], "repeat"),
    ("a cue", &["until", "end", "deadline", "finish", "stop"], "end_by"),
    ("a cue", &["zone", "zones", "needs"], "uses"),
    ("a cue", &["formation"], "form"),
    ("a cue", &["path"], "along"),
    ("a cue", &["rotate", "rotation"], "turn"),
    ("a cue", &["translate", "offset"], "shift"),
    ("a cue", &["args", "arguments"], "parameters"),
    ("a cue", &["depends_on", "requires", "follow", "follows"], "after"),
    ("a cue", &["simultaneous", "parallel", "sync", "together"], "with"),
    ("a cue", &["joints", "motors", "axes", "channels", "keyframes", "animation", "values"], "tracks"),
    ("a cue", &["action", "call"], "move"),
    ("a track", &["sine", "sin", "sinus", "oscillate", "oscillation"], "wave"),
    ("a track", &["curve", "bezier", "points"], "spline"),
    ("a track", &["keys", "frames", "fcurve"], "keyframes"),
    ("a track", &["csv", "file", "data"], "samples"),
    ("a track", &["expression", "function", "equation"], "formula"),
    ("a track", &["ramp", "velocity", "speed"], "travel"),
    ("a wave", &["amp", "size", "height"], "amplitude"),
    ("a wave", &["cycle", "cycle_time", "T"], "period"),
    ("an act", &["name", "id", "title", "label"], "act"),
    ("an act", &["then", "follow", "goto"], "next"),
    ("`wait`", &["max", "limit"], "timeout"),
    ("`wait`", &["at", "clock"], "time"),
    ("the scenario", &["name", "title", "show"], "scenario"),
    ("the scenario", &["bpm"], "tempo"),
    ("the scenario", &["meter", "time_signature"], "signature"),
    ("the scenario", &["scenes", "parts"], "acts"),
    ("the scenario", &["timeline", "steps", "actions", "events", "animation"], "cues"),
    ("a wave", &["length", "duration"], "for"),
    ("a wave", &["centre", "middle", "offset"], "center"),
    ("a wave", &["hz", "freq"], "frequency"),
    ("`travel`", &["length", "duration"], "for"),
    ("`travel`", &["velocity"], "speed"),
    ("a polynomial", &["length", "duration"], "for"),
    ("`circle`", &["r"], "radius"),
    ("`sphere`", &["r"], "radius"),
    ("`line`", &["distance", "gap"], "spacing"),
    ("`grid`", &["distance", "gap"], "spacing"),
    ("`v`", &["distance", "gap"], "spacing"),
    ("the formation", &["position", "center", "centre"], "at"),
    ("the formation", &["rotation"], "rotate"),
    ("the formation", &["ring"], "circle"),
    ("limits", &["velocity", "max_speed", "v", "vel", "max_velocity"], "speed"),
    ("limits", &["accel", "max_acceleration"], "acceleration"),
    ("robot", &["host", "ip", "url", "endpoint"], "address"),
    ("robot", &["description", "model", "file", "path"], "init"),
    ("`scale`", &["factor", "times", "to"], "by"),
    ("`mirror`", &["at", "around", "center", "centre", "value"], "about"),
    ("`turn`", &["around", "center", "centre", "at"], "about"),
    ("`turn`", &["angle", "degrees", "to"], "by"),
    ("`grid`", &["cols"], "columns"),
    ("`repeat`", &["count", "n"], "times"),
    ("`repeat`", &["interval", "period"], "every"),
    ("`repeat`", &["duration", "length"], "for"),
    ("`along`", &["name", "to"], "path"),
    ("`form`", &["formation", "name"], "to"),
    ("a cue", &["for"], "duration"),
    ("`canon`", &["delay", "time", "interval", "gap", "offset"], "step"),
    ("`canon`", &["duration"], "over"),
    ("`canon`", &["order", "axis"], "by"),
    ("`travel`", &["accel"], "acceleration"),
    ("the space", &["safety", "margin", "clearance", "separation"], "distance"),
    ("a tempo", &["tempo"], "bpm"),
    ("a tempo", &["meter", "time_signature"], "signature"),
    ("`samples`", &["path", "csv", "source"], "file"),
    ("`samples`", &["column"], "value"),
];

/// Returns a hint for the unknown key `key` of the map that messages call `what`.
pub fn key(units: &Units, what: &str, key: &str, value: &Node) -> Option<String> {
    let known = KEYS.iter().find(|(place, words, _)| is_named(what, place) && words.contains(&key));
    if let Some((.., meant)) = known {
        return Some(did_you_mean_this(meant));
    }
    let given = match value {
        Node::Number(number) => number.to_string(),
        Node::Text(text) => shortened(text),
        _ => "...".to_owned(),
    };
    if let Some(place) = elsewhere(what, key) {
        return Some(format!("write it {place}"));
    }
    if units.has_device(key)
        && let Some(place) = of_devices(what, key)
    {
        return Some(format!("`{key}` is a device: write it {place}"));
    }
    if matches!(key, "wait" | "delay" | "pause") && what == "a cue" && parse_duration(&given).is_none() {
        return advice(what, "trigger", &given);
    }
    if let Some(advice) = advice(what, key, &given) {
        return Some(advice);
    }
    match (what, key) {
        (
            "`line`" | "`circle`" | "`v`" | "`sphere`" | "`grid`",
            "count" | "number" | "n" | "robots" | "drones",
        ) => Some("leave it out: the formation has one place for each robot of the cue".to_owned()),
        ("a tempo", "bar" | "from_bar" | "start") => Some(format!("write `at: bar {given}`")),
        ("`wait`", "operator" | "done") if *value == Node::Null => Some(format!("write `for: {key}`")),
        ("`circle`", "diameter") => Some(match value {
            Node::Number(diameter) => format!("write half of the diameter: `radius: {}`", diameter / 2.0),
            _ => "write half of the diameter as the `radius`".to_owned(),
        }),
        _ => None,
    }
}

/// Returns where to write the device `key`, if `what` is a map that moves devices.
fn of_devices(what: &str, key: &str) -> Option<String> {
    match what {
        "a cue" | "an override" | "an entry of `play`" => Some("below `tracks:`".to_owned()),
        "an act" => Some(format!("in a cue, `cues: [{{robots: NAME, tracks: {{{key}: ...}}}}]`")),
        _ => what.starts_with("the move ").then(|| "below `tracks:`".to_owned()),
    }
}

/// Returns advice for a key of another program that has no equivalent in Downbeat.
fn advice(what: &str, key: &str, given: &str) -> Option<String> {
    let found = ADVICE.iter().find(|(place, keys, _)| is_named(what, place) && keys.contains(&key));
    found.map(|(.., advice)| advice.replace("{key}", key).replace("{given}", given))
}

/// Returns a hint for an unknown key next to the use of a move or a sequence. The key may be meant as a parameter of that move or
/// sequence.
pub fn parameter(
    what: &str,
    key: &str,
    value: &Node,
    entries: &[(String, Node)],
    cue_keys: &[&str],
) -> Option<String> {
    let value = match value {
        Node::Number(number) => number.to_string(),
        Node::Text(text) => shortened(text),
        _ => return None,
    };
    let plays = || entries.iter().any(|(key, _)| key == "move" || key == "sequence");
    let is_use =
        ["a cue", "an override", "an entry of `play`"].contains(&what) && !cue_keys.contains(&key) && plays();
    is_use.then(|| format!("write the value of a parameter as `parameters: {{{}: {value}}}`", shortened(key)))
}

/// Each entry is a map that contains keys by mistake, these keys, and the place where they belong.
const ELSEWHERE: [(&str, &[&str], &str); 18] = [
    (
        "an act",
        &["moves", "sequences", "variables", "roles", "formations", "paths"],
        "at the top of the scenario: all acts share it",
    ),
    (
        "an act",
        &["to", "value", "keyframes"],
        "in a keyframe of a cue: `cues: [{robots: NAME, tracks: {DEVICE: [{at: 1s, to: 45}]}}]`",
    ),
    ("a cue", &["variables", "roles", "start_tolerance"], "at the top of the scenario"),
    ("a cue", &["tempo", "bpm", "signature"], "at the top of the scenario, or in an act"),
    ("a cue", &["next", "on_failure", "on_doubt", "timeout", "otherwise"], "in an act, next to its `cues`"),
    ("a cue", &["limits"], "in the fleet file, for each robot"),
    ("a cue", &["to", "value"], "in a keyframe: `tracks: {DEVICE: [{at: 1s, to: 45}]}`"),
    (
        "a keyframe",
        &["tolerance", "max_steps", "control"],
        "next to the keyframes: `DEVICE: {keyframes: [...], tolerance: 1}`",
    ),
    (
        "the move",
        &["at", "canon", "devices", "duration", "mirror", "repeat", "reverse", "robots", "scale"],
        "in the cue that plays the move",
    ),
    ("the scenario", &["tracks"], "in a cue, below `cues`"),
    ("the scenario", &["wait", "next"], "in an act, below `acts`"),
    ("the scenario", &["space", "ntp", "handshake", "limits"], "in the fleet file"),
    ("the fleet file", &["cues", "acts", "moves", "roles", "tempo", "variables"], "in the scenario"),
    ("the fleet file", &["distance", "keep_in", "keep_out"], "under `space`"),
    ("robot", &["distance", "keep_in", "keep_out"], "under `space`, next to `robots`"),
    ("robot", &["speed", "acceleration"], "for each device: `limits: {DEVICE: {speed: 50}}`"),
    ("robot", &["x", "y", "z", "yaw", "radius", "size", "joints", "tip", "drive", "urdf"], "under `body`"),
    ("robot", &["clock_offset", "drift", "jitter", "ntp_error", "fault", "readings"], "under `simulate`"),
];

/// Returns the place where a misplaced key of the map `what` belongs, if it is known.
fn elsewhere(what: &str, key: &str) -> Option<&'static str> {
    let found = ELSEWHERE.iter().find(|(place, keys, _)| is_named(what, place) && keys.contains(&key));
    found.map(|(.., belongs)| *belongs)
}

/// Whether the map that messages call `what` is of the kind `place`: ``robot `left` `` is of the kind `robot`.
fn is_named(what: &str, place: &str) -> bool {
    what.strip_prefix(place).is_some_and(|rest| rest.is_empty() || rest.starts_with(" `"))
}

/// Suggests a known key that is one word of the unknown key: `control` for `control_type`.
pub fn word_of(wrong: &str, known: impl IntoIterator<Item = &'static str>) -> Option<String> {
    let mut known = known.into_iter().filter(|name| name.len() > 3);
    known.find(|name| wrong.split(['_', '-', ' ']).any(|word| word == *name)).map(did_you_mean_this)
}

/// Returns a hint for the missing key `key` of the map `what`, if beginners often omit it.
pub fn missing(what: &str, key: &str) -> Option<&'static str> {
    match (what, key) {
        ("the scenario", "scenario") => {
            Some("give the show a name in the first line, such as `scenario: my-show`")
        }
        ("the fleet file", "robots") => {
            Some("list the robots, as in `robots: {arm-1: {init: arm.yaml, address: sim}}`")
        }
        (_, "address") => {
            Some("use `address: sim` to simulate the robot, or `address: tcp://HOST:PORT` for a real one")
        }
        (_, "init") => {
            Some("add the path of the file that describes the robot, as in `init: robots/arm.yaml`")
        }
        ("a keyframe", _) => Some("a keyframe needs a time and a value, as in `{at: 1s, to: 45}`"),
        ("a spread", "across") => Some("add what the values are spread over, as in `across: group`"),
        ("a wave", "for") => Some("add the duration, as in `for: 8s`"),
        ("`grid`", "spacing") => Some("add the distance between neighbours in metres, as in `spacing: 1`"),
        _ => None,
    }
}
