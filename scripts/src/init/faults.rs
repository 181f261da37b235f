//! What is wrong with an initialization block, device by device, so that all of it is reported at once and where it stands.

use serde::de::DeserializeOwned;
use serde_yaml::{Mapping, Value};
use urrcp::{ControlTypes, Device, InitializationBlock};

use super::EXPECTED;
use crate::fields::Reader;
use crate::finding::{Code, Finding, Part, Place};
use crate::locate::locate;
use crate::source::Source;

/// The faults of the block itself, of its devices and of their control types; none where it is no map.
pub(super) fn of(source: &Source) -> Vec<Finding> {
    let Ok(Value::Mapping(block)) = serde_yaml::from_str::<Value>(&source.text) else { return Vec::new() };
    let mut findings = Reader::default();
    let mut bare = block.clone();
    let devices = match bare.insert("devices".into(), Value::Sequence(Vec::new())) {
        Some(Value::Sequence(devices)) => devices,
        // Left out or something else: the block itself says so.
        _ => return Vec::new(),
    };
    check::<InitializationBlock>(&mut findings, &Place::default(), &bare);
    for (index, device) in devices.iter().enumerate() {
        let place = Place::default().of_key("devices").below(Part::Index(index));
        match device {
            Value::Mapping(device) => of_device(&mut findings, &place, device),
            other => add(&mut findings, place, format!("a device that is {}", kind(other))),
        }
    }
    locate(std::slice::from_ref(source), findings.finish())
}

fn of_device(findings: &mut Reader, place: &Place, device: &Mapping) {
    let key = "available_control_types";
    let before = findings.found.len();
    if let Some(Value::Mapping(types)) = device.get(key) {
        of_control_types(findings, &place.of_key(key), types);
    }
    if findings.found.len() == before {
        check::<Device>(findings, place, device);
    }
}

/// Each by itself; then all together, since a script inherits from the others.
fn of_control_types(findings: &mut Reader, place: &Place, types: &Mapping) {
    let before = findings.found.len();
    for (name, parameters) in types.iter().filter(|(name, _)| name.as_str() != Some("script")) {
        let one: Mapping = std::iter::once((name.clone(), parameters.clone())).collect();
        let Some(name) = name.as_str() else { continue };
        let keys = parameters.as_mapping().cloned().unwrap_or_default();
        check_as::<ControlTypes>(findings, &place.of_key(name), &one, &keys);
    }
    if findings.found.len() == before
        && let Some(script) = types.get("script")
    {
        let keys = script.as_mapping().cloned().unwrap_or_default();
        check_as::<ControlTypes>(findings, &place.of_key("script"), types, &keys);
    }
}

fn check<T: DeserializeOwned>(findings: &mut Reader, place: &Place, map: &Mapping) {
    check_as::<T>(findings, place, map, map);
}

/// Whether a map can be read; where the fault stands is the key that it names, or whose value it names, or else what leads to the map.
fn check_as<T: DeserializeOwned>(findings: &mut Reader, place: &Place, map: &Mapping, keys: &Mapping) {
    let Err(error) = serde_yaml::from_value::<T>(Value::Mapping(map.clone())) else { return };
    let message = error.to_string();
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut words = message.split(|c: char| !is_word(c));
    let is = |value: &Value, word| value.as_str() == Some(word);
    let named =
        words.find_map(|word| keys.iter().find(|(key, value)| is(key, word) || is(value, word))?.0.as_str());
    let place = match named {
        Some(key) => place.of_key(key),
        None => Place { key: true, ..place.clone() },
    };
    add(findings, place, message);
}

fn add(findings: &mut Reader, place: Place, message: String) {
    findings.add(Code::InitializationBlock, place, message, EXPECTED, None);
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "nothing",
        Value::Sequence(_) => "a list",
        _ => "a single value",
    }
}
