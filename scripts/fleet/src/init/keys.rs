//! The keys of an initialization block, and hints for similar but unknown keys, which a robot ignores.

use serde_yaml::{Mapping, Value};

use downbeat_reader::fields::Reader;
use downbeat_yaml::finding::{Code, Finding, PathStep, Place, did_you_mean, did_you_mean_this, one_of};
use downbeat_yaml::locate::locate;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

/// The kind of a map in an initialization block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    Block,
    Device,
    ControlTypes,
    /// The control type `position`, `speed` or `acceleration`.
    Motion,
    Script,
    Sensor,
    /// A control type that the robot's manufacturer has defined.
    Custom,
}

impl Level {
    const ALL: [Self; 6] =
        [Self::Block, Self::Device, Self::ControlTypes, Self::Motion, Self::Script, Self::Sensor];

    pub(super) fn of_control_type(name: &str) -> Self {
        match name {
            "script" => Self::Script,
            "sensor" => Self::Sensor,
            "position" | "speed" | "acceleration" => Self::Motion,
            _ => Self::Custom,
        }
    }

    const fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Block => &[
                "id",
                "name",
                "type",
                "manufacture",
                "version",
                "api_version",
                "reports",
                "encodings",
                "inquiry",
                "pending_until",
                "devices",
            ],
            Self::Device => &[
                "id",
                "name",
                "unit",
                "default_value",
                "interpolation",
                "script_queue",
                "latency",
                "latency_spread",
                "channel",
                "available_control_types",
            ],
            Self::ControlTypes => &["position", "speed", "acceleration", "script", "sensor"],
            Self::Motion => &["min_value", "max_value", "granularity", "max_error"],
            Self::Script => &[
                "min_value",
                "max_value",
                "granularity",
                "max_error",
                "max_number_of_steps",
                "control_types",
            ],
            Self::Sensor => &["min_value", "max_value", "max_error", "max_delay"],
            Self::Custom => &[],
        }
    }

    const fn place(self) -> &'static str {
        match self {
            Self::Block => "at the top, next to `devices`",
            Self::Device => "next to the `id` of the device",
            Self::ControlTypes => "under `available_control_types`",
            Self::Motion => "under `position`, `speed` or `acceleration`",
            Self::Script => "under `script`",
            Self::Sensor => "under `sensor`",
            Self::Custom => "under the control type",
        }
    }
}

/// Returns the keys of an initialization block itself.
pub(super) const fn of_block() -> &'static [&'static str] {
    Level::Block.keys()
}

/// Synonyms that users may write instead of a key: the kind of map, the synonyms, and the correct key. Synonyms for keys of
/// [`Level::Motion`] also apply to scripts and sensors.
const WORDS: [(Level, &[&str], &str); 19] = [
    (Level::Block, &["joints", "motors", "axes", "actuators", "servos", "channels"], "devices"),
    (Level::Block, &["api", "protocol", "protocol_version"], "api_version"),
    (Level::Block, &["robot_id", "serial", "uid"], "id"),
    (Level::Block, &["manufacturer", "vendor", "maker", "brand"], "manufacture"),
    (Level::Device, &["default", "home", "initial", "zero", "rest"], "default_value"),
    (
        Level::Device,
        &["control_types", "types", "interfaces", "command_interfaces", "controls", "control"],
        "available_control_types",
    ),
    (Level::Device, &["label", "title", "description"], "name"),
    (Level::Device, &["queue", "buffer"], "script_queue"),
    (Level::Device, &["delay", "lag"], "latency"),
    (Level::ControlTypes, &["velocity", "vel"], "speed"),
    (Level::ControlTypes, &["angle", "pos"], "position"),
    (Level::ControlTypes, &["trajectory", "program", "scripts"], "script"),
    (Level::Motion, &["min", "lower", "low", "minimum"], "min_value"),
    (Level::Motion, &["max", "upper", "high", "maximum"], "max_value"),
    (Level::Motion, &["step", "resolution", "precision", "increment", "grid"], "granularity"),
    (Level::Motion, &["error", "accuracy", "tolerance"], "max_error"),
    (Level::Script, &["max_steps", "steps", "max_points", "length"], "max_number_of_steps"),
    (Level::Script, &["types", "modes"], "control_types"),
    (Level::Sensor, &["delay", "latency"], "max_delay"),
];

/// Synonyms for a speed limit, which a device declares as a control type.
const SPEEDS: [&str; 9] = [
    "velocity",
    "speed",
    "max_speed",
    "speed_max",
    "max_velocity",
    "velocity_max",
    "speed_limit",
    "velocity_limit",
    "limits",
];
const RANGES: [&str; 4] = ["range", "bounds", "limits", "interval"];
const ENDS: [&str; 6] = ["min", "max", "min_value", "max_value", "lower", "upper"];

/// Returns advice for an unknown key that no single known key can replace.
pub(super) fn advice(level: Level, key: &str, value: &Value) -> Option<String> {
    let is_motion = matches!(level, Level::Motion | Level::Script | Level::Sensor);
    if is_motion && RANGES.contains(&key) {
        return Some(match value.as_sequence().map(Vec::as_slice) {
            Some([least, largest]) if [least, largest].iter().all(|end| end.is_number()) => {
                let end = |value: &Value| value.as_f64().unwrap_or_default();
                format!("write `min_value: {}, max_value: {}`", end(least), end(largest))
            }
            _ => "write `min_value` and `max_value`".to_owned(),
        });
    }
    if level == Level::Device && (RANGES[..2].contains(&key) || ENDS.contains(&key)) {
        return Some(
            "write `min_value` and `max_value` under each control type in `available_control_types`"
                .to_owned(),
        );
    }
    let is_speed =
        SPEEDS.contains(&key) && !value.is_mapping() || (key == "limits" && level == Level::Device);
    (is_speed && (is_motion || level == Level::Device)).then(|| {
        "limit the speed under `available_control_types` with `speed: {min_value: -30, max_value: 30, granularity: \
         1}`, or in the fleet file with `limits: {DEVICE: {speed: 30}}`"
            .to_owned()
    })
}

/// Returns the known key that the user probably meant by an unknown key of a map.
pub(super) fn meant(level: Level, key: &str) -> Option<&'static str> {
    let known = level.keys();
    if known.contains(&key) {
        return None;
    }
    let hint = did_you_mean(key, known.iter().copied());
    let near = known.iter().find(|name| hint.as_ref() == Some(&did_you_mean_this(name)));
    let is_like =
        |of: Level| of == level || (of == Level::Motion && matches!(level, Level::Script | Level::Sensor));
    let other =
        WORDS.iter().find(|(of, words, name)| is_like(*of) && words.contains(&key) && known.contains(name));
    let word = other.map(|(.., name)| *name);
    word.or_else(|| near.or_else(|| known.iter().find(|name| name.split('_').next() == Some(key))).copied())
}

/// Returns warnings about keys that have no effect because they are misplaced or misspelt. Keys that resemble no known key belong to the
/// robot's own software and cause no warning.
pub(super) fn ignored(source: &Source) -> Vec<Finding> {
    let Ok(Value::Mapping(block)) = serde_yaml::from_str::<Value>(&source.text) else { return Vec::new() };
    let mut findings = Reader::default();
    check(&mut findings, Level::Block, &Place::default(), &block);
    let devices = block.get("devices").and_then(Value::as_sequence).into_iter().flatten();
    for (index, device) in devices.enumerate() {
        let Value::Mapping(device) = device else { continue };
        let place = Place::default().of_key("devices").below(PathStep::Index(index));
        check(&mut findings, Level::Device, &place, device);
        let Some(Value::Mapping(types)) = device.get("available_control_types") else { continue };
        let place = place.of_key("available_control_types");
        for (name, parameters) in types {
            let (Some(name), Value::Mapping(parameters)) = (name.as_str(), parameters) else { continue };
            check(&mut findings, Level::of_control_type(name), &place.of_key(name), parameters);
        }
    }
    locate(std::slice::from_ref(source), findings.finish())
}

fn check(findings: &mut Reader, level: Level, place: &Place, map: &Mapping) {
    if level == Level::Custom {
        return;
    }
    let keys = map.keys().filter_map(Value::as_str);
    for key in keys.filter(|key| !level.keys().contains(key)) {
        let elsewhere = Level::ALL.into_iter().find(|other| other.keys().contains(&key));
        // A key is only treated as misspelt if the key that was probably meant is missing.
        let meant = meant(level, key).filter(|meant| !map.contains_key(*meant));
        let advice = advice(level, key, map.get(key).unwrap_or(&Value::Null));
        let hint = match (advice, elsewhere, meant) {
            (Some(advice), ..) => advice,
            (None, Some(other), _) => format!("write it {}", other.place()),
            (None, None, Some(meant)) => did_you_mean_this(meant),
            (None, None, None) => continue,
        };
        let message = format!("the key `{}` is ignored here", shortened(key));
        let place = Place { key: true, ..place.of_key(key) };
        findings.add(Code::IgnoredKey, place, message, one_of(level.keys().iter().copied()), Some(hint));
    }
}
