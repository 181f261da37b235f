//! Finds the faults of an initialization block device by device, so that all faults are reported together, each at its place.

use serde::de::DeserializeOwned;
use serde_yaml::{Mapping, Value};
use urrcp::{ControlTypes, DEVICES_MAX, InitializationBlock};

use super::EXPECTED;
use super::keys::{self, Level};
use downbeat_reader::fields::Reader;
use downbeat_yaml::composed::composed;
use downbeat_yaml::finding::{Code, Finding, PathStep, Place, did_you_mean_this};
use downbeat_yaml::locate::locate;
use downbeat_yaml::render::counted;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

/// Returns the faults of an initialization block, of its devices and of their control types. Empty if the text is not a map.
pub(super) fn of(source: &Source) -> Vec<Finding> {
    let Ok(Value::Mapping(block)) = serde_yaml::from_str::<Value>(&source.text) else { return Vec::new() };
    let mut findings = Reader::default();
    let mut bare = block.clone();
    let devices = match bare.insert("devices".into(), vec![Value::Mapping(any_device())].into()) {
        Some(Value::Sequence(devices)) => devices,
        Some(Value::Mapping(devices)) => {
            by_id(&mut findings, &devices);
            return locate(std::slice::from_ref(source), findings.finish());
        }
        None => {
            of_missing(
                &mut findings,
                &Whose::of("the robot", Level::Block),
                &Place::default(),
                "devices",
                &block,
            );
            return locate(std::slice::from_ref(source), findings.finish());
        }
        // Anything else is reported as a fault of the block itself.
        _ => return Vec::new(),
    };
    check::<InitializationBlock>(
        &mut findings,
        &Whose::of("the robot", Level::Block),
        &Place::default(),
        &bare,
    );
    let place = Place::default().of_key("devices");
    for (index, device) in devices.iter().enumerate() {
        let place = place.below(PathStep::Index(index));
        match device {
            Value::Mapping(device) => of_device(&mut findings, &place, device),
            other => {
                let hint = Some(
                    "start each device with a dash and its `id`, and write its other keys on the lines below"
                        .to_owned(),
                );
                add(
                    &mut findings,
                    place,
                    format!("found {} instead of a device", kind(other)),
                    "a map with an `id`",
                    hint,
                );
            }
        }
    }
    of_number(&mut findings, &place, devices.len());
    of_ids(&mut findings, &place, &devices);
    locate(std::slice::from_ref(source), findings.finish())
}

/// Reports devices that are written as a map by id instead of a list.
fn by_id(findings: &mut Reader, devices: &Mapping) {
    let first = devices.keys().find_map(Value::as_str).unwrap_or("elbow");
    let place = Place::default().of_key("devices");
    let before = findings.found.len();
    let message = "found a map with device ids as keys".to_owned();
    let hint = format!(
        "write a list of devices in brackets, each with its id: `[{{id: {}, ...}}]`",
        shortened(first)
    );
    add(findings, place, message, "a list of devices", Some(hint));
    if let Some(found) = findings.found.get_mut(before) {
        found.hint_in_block = Some(format!(
            "write `- id: {}` instead of `{0}:`, and the other keys of the device below it",
            shortened(first)
        ));
    }
}

/// Returns a minimal valid device. It replaces the real devices while the other keys of the block are checked.
fn any_device() -> Mapping {
    [("id", Value::from("any")), ("available_control_types", Mapping::new().into())]
        .map(|(key, value)| (key.into(), value))
        .into_iter()
        .collect()
}

fn of_number(findings: &mut Reader, place: &Place, count: usize) {
    if count == 0 || count > DEVICES_MAX {
        let expected = format!("1 to {DEVICES_MAX} devices");
        let hint = (count > 0).then(|| "move some of the devices to a separate robot".to_owned());
        add(findings, place.clone(), format!("found {}", counted(count, "device")), &expected, hint);
    }
}

/// Reports each duplicate id once, at the second device that has it.
fn of_ids(findings: &mut Reader, place: &Place, devices: &[Value]) {
    let mut known: Vec<(String, Vec<usize>)> = Vec::new();
    let mut index_of = std::collections::HashMap::new();
    for (index, device) in devices.iter().enumerate() {
        let Some(id) = device.get("id").and_then(Value::as_str) else { continue };
        let name = composed(id).into_owned();
        let at = *index_of.entry(name).or_insert_with(|| {
            known.push((id.to_owned(), Vec::new()));
            known.len() - 1
        });
        known[at].1.push(index);
    }
    for (id, places) in known.iter().filter(|(_, places)| places.len() > 1) {
        let message = format!("{} have the same id `{}`", counted(places.len(), "device"), shortened(id));
        let place = place.below(PathStep::Index(places[1])).of_key("id");
        let hint = Some("rename or remove the duplicates".to_owned());
        add(findings, place, message, "a unique id for each device", hint);
    }
}

fn of_device(findings: &mut Reader, place: &Place, device: &Mapping) {
    let key = "available_control_types";
    let whose = match device.get("id").and_then(Value::as_str) {
        Some(id) => format!("the device `{}`", shortened(id)),
        None => "a device".to_owned(),
    };
    let before = findings.found.len();
    if let Some(Value::Mapping(types)) = device.get(key) {
        of_control_types(findings, &whose, &place.of_key(key), types);
    }
    if findings.found.len() > before {
        return;
    }
    // Some rules for a device are checked by its block.
    let block = [
        ("id", "any".into()),
        ("api_version", "1".into()),
        ("devices", vec![Value::Mapping(device.clone())].into()),
    ];
    let block: Mapping = block.map(|(key, value): (&str, Value)| (key.into(), value)).into_iter().collect();
    check_as::<InitializationBlock>(findings, &Whose::of(&whose, Level::Device), place, &block, device);
}

/// Checks each control type except `script` separately. If all are valid, checks `script` together with the others, because a script
/// inherits values from them.
fn of_control_types(findings: &mut Reader, device: &str, place: &Place, types: &Mapping) {
    let before = findings.found.len();
    let whose =
        |name: &str| Whose::of(&format!("`{}` of {device}", shortened(name)), Level::of_control_type(name));
    for (name, parameters) in types.iter().filter(|(name, _)| name.as_str() != Some("script")) {
        let one: Mapping = std::iter::once((name.clone(), parameters.clone())).collect();
        let Some(name) = name.as_str() else { continue };
        let keys = parameters.as_mapping().cloned().unwrap_or_default();
        check_as::<ControlTypes>(findings, &whose(name), &place.of_key(name), &one, &keys);
    }
    if findings.found.len() == before
        && let Some(script) = types.get("script")
    {
        let keys = script.as_mapping().cloned().unwrap_or_default();
        check_as::<ControlTypes>(findings, &whose("script"), &place.of_key("script"), types, &keys);
    }
}

/// The map that is being checked: the name that messages use for it, and its kind.
struct Whose {
    name: String,
    level: Level,
}

impl Whose {
    fn of(name: &str, level: Level) -> Self {
        Self { name: name.to_owned(), level }
    }
}

fn check<T: DeserializeOwned>(findings: &mut Reader, whose: &Whose, place: &Place, map: &Mapping) {
    check_as::<T>(findings, whose, place, map, map);
}

/// Checks that a map can be deserialized. If serde's error message contains a key of the map or its value, the finding is at that key.
/// Otherwise, the finding is at the key that contains the map.
fn check_as<T: DeserializeOwned>(
    findings: &mut Reader,
    whose: &Whose,
    place: &Place,
    map: &Mapping,
    keys: &Mapping,
) {
    let Err(error) = serde_yaml::from_value::<T>(Value::Mapping(map.clone())) else { return };
    let whole = error.to_string();
    let message = whole.strip_prefix("devices[0]: ").unwrap_or(&whole);
    if let Some(missing) = message.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        return of_missing(findings, whose, place, missing, keys);
    }
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut words = message.split(|c: char| !is_word(c));
    let is = |value: &Value, word| value.as_str() == Some(word);
    let by_word =
        words.find_map(|word| keys.iter().find(|(key, value)| is(key, word) || is(value, word))?.0.as_str());
    let quoted = |value: &Value| match value {
        Value::Bool(value) => message.contains(&format!("`{value}`")),
        Value::Number(value) => message.contains(&format!("`{value}`")),
        _ => false,
    };
    let named = by_word.or_else(|| keys.iter().find(|(_, value)| quoted(value))?.0.as_str());
    let place = match named {
        Some(key) => place.of_key(key),
        None => Place { key: true, ..place.clone() },
    };
    let (message, expected, hint) = worded(message, whose, named.and_then(|key| keys.get(key)));
    add(findings, place, message, &expected, hint);
}

/// Reports a missing key. If the map contains a misspelling of that key, the finding is at the misspelling.
fn of_missing(findings: &mut Reader, whose: &Whose, place: &Place, missing: &str, keys: &Mapping) {
    let message = format!("{} has no `{missing}`", whose.name);
    let written =
        keys.keys().filter_map(Value::as_str).find(|key| keys::meant(whose.level, key) == Some(missing));
    let (place, hint) = match written {
        Some(key) => (
            Place { key: true, ..place.of_key(key) },
            Some(format!("unknown key `{}`: did you mean `{missing}`?", shortened(key))),
        ),
        None => {
            let mut all = keys.iter().filter(|_| matches!(missing, "min_value" | "max_value"));
            let advice = all.find_map(|(key, value)| keys::advice(whose.level, key.as_str()?, value));
            let by_name = || match (whose.level, keys.iter().next()) {
                (Level::Device, Some((Value::String(id), _))) if missing == "id" && keys.len() == 1 => {
                    Some(format!("write `id: {}`, and the other keys below it", shortened(id)))
                }
                _ => None,
            };
            (Place { key: true, ..place.clone() }, advice.or_else(by_name))
        }
    };
    add(findings, place, message, &format!("a key `{missing}`"), hint);
}

/// Rewords an error message of serde in the style of other findings. Returns the message, the expectation and a hint.
fn worded(message: &str, whose: &Whose, value: Option<&Value>) -> (String, String, Option<String>) {
    let number = |text: &str| {
        let digits = text.trim_end_matches(|c: char| !c.is_ascii_digit()).trim().replacen(',', ".", 1);
        digits.parse::<f64>().is_ok().then(|| format!("write only the number: `{digits}`"))
    };
    // Some messages already name the device.
    let of = |found: &str| {
        if found.contains("device `") { found.to_owned() } else { format!("{found}, for {}", whose.name) }
    };
    let Some((found, expected)) = message.split_once(", expected ") else {
        let is_swapped = message.contains("is greater than");
        let expected = if is_swapped { "a `min_value` that does not exceed `max_value`" } else { EXPECTED };
        return (
            of(message),
            expected.to_owned(),
            is_swapped.then(|| "swap `min_value` and `max_value`".to_owned()),
        );
    };
    let expected = match expected {
        "u32" | "u64" | "usize" => "a whole number",
        "f64" => "a number",
        "a boolean" => "true or false",
        // `interpolation` is the only key of a device with named values.
        "a Value::Tagged enum" if whose.level == Level::Device => "`hold` or `linear`",
        "a Value::Tagged enum" => "a word",
        _ => expected,
    };
    let truth = |text: &str| match text.to_lowercase().as_str() {
        "yes" | "on" => Some("write `true`".to_owned()),
        "no" | "off" => Some("write `false`".to_owned()),
        _ => None,
    };
    if let Some(hint) = value.and_then(Value::as_str).filter(|_| expected == "true or false").and_then(truth)
    {
        let found = format!("found the text `{}`", value.and_then(Value::as_str).unwrap_or_default());
        return (of(&found), expected.to_owned(), Some(hint));
    }
    let hint = value.and_then(Value::as_str).filter(|_| expected.contains("number")).and_then(number);
    let found = match found.strip_prefix("invalid type: string ") {
        Some(text) => format!("found the text `{}`", text.trim_matches('"')),
        None => found
            .replace("unknown variant", "unknown word")
            .replace("invalid type: ", "found ")
            .replace("found boolean", "found the truth value")
            .replace("found floating point", "found the number"),
    };
    let found = match found.as_str() {
        "found sequence" => "found a list".to_owned(),
        "found map" => "found a map".to_owned(),
        _ => found,
    };
    if expected == "field identifier" {
        let hint = Some("write numbers with a decimal point: a comma separates keys".to_owned());
        return (format!("{found} instead of a key in {}", whose.name), "a key".to_owned(), hint);
    }
    let is_grid = found.starts_with("invalid granularity");
    let control_type = found.strip_prefix("unknown control type `").and_then(|rest| rest.strip_suffix('`'));
    let near = control_type.and_then(|name| keys::meant(Level::ControlTypes, name));
    let hint = hint.or_else(|| near.map(did_you_mean_this));
    let hint = hint.or_else(|| {
        is_grid.then(|| "set the granularity to the smallest step that the device can make".to_owned())
    });
    (of(&found), expected.to_owned(), hint)
}

fn add(findings: &mut Reader, place: Place, message: String, expected: &str, hint: Option<String>) {
    findings.add(Code::InitializationBlock, place, message, expected, hint);
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "nothing",
        Value::Sequence(_) => "a list",
        _ => "a single value",
    }
}
