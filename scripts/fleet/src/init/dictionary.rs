//! Converts the description of a Thrift robot to an initialization block. In such a description, `devices` is a dictionary with a range
//! for each device.
//!
//! Missing values have defaults: a device is driven by position, and holds two scripts of at most 1000 steps each. Its default
//! granularity is the largest power of ten that fits into its range a thousand times. Unknown keys, such as those of the robot's own
//! software, are ignored.

use serde_json::{Map, Value, json};
use urrcp::{ControlType, Device, InitializationBlock, Label, RobotId, RobotType};

use super::Supplement;
use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

/// Default maximum number of steps per script. The edge (the process that drives the robot's hardware) plays the steps itself, and there
/// they take little memory.
const STEPS: u32 = 1_000;
/// Default number of scripts that a device holds: one plays while the next one waits.
const QUEUE: u32 = 2;

/// The protocol version of the edge (the process that drives a Thrift robot).
const API_VERSION: &str = "1";

const SETTER: &str = "set_device_double_value";
const READERS: [&str; 2] = ["get_sensor_double_value", "get_sensor_string_value"];

/// Whether a document is the description of a Thrift robot: a map with a dictionary of devices.
pub(super) fn is_one(document: &Node) -> bool {
    matches!(value(document, "devices"), Some(Node::Map(_)))
}

/// Whether the devices of a document declare control types, as in an initialization block.
pub(super) fn is_block(document: &Node) -> bool {
    let Some(Node::Map(devices)) = value(document, "devices") else { return false };
    devices.iter().any(|(_, device)| value(device, "available_control_types").is_some())
}

fn value<'a>(node: &'a Node, key: &str) -> Option<&'a Node> {
    let Node::Map(entries) = node else { return None };
    entries.iter().find(|(name, _)| name == key).map(|(_, value)| value)
}

/// Returns the ids of the devices and sensors in a description.
pub(super) fn device_ids(document: &Node) -> Vec<&str> {
    let named = ["devices", "sensors"].into_iter().filter_map(|key| value(document, key));
    let entries = named.filter_map(|node| match node {
        Node::Map(entries) => Some(entries),
        _ => None,
    });
    entries.flatten().map(|(id, _)| id.as_str()).collect()
}

/// Returns the value of a key; `None` if the key is missing or its value is null.
fn at<'a>(parent: &'a At<'a>, key: &'a str) -> Option<At<'a>> {
    value(parent.node, key).filter(|node| **node != Node::Null).map(|node| parent.entry(key, 0, node))
}

pub(super) fn block(
    findings: &mut Reader,
    root: &At<'_>,
    supplements: &[(String, Supplement)],
) -> Option<InitializationBlock> {
    let id = required(findings, root, "id").and_then(|text| valid(findings, root, "id", RobotId::new(text)));
    // The version in the description is that of the Thrift protocol, but the scheduler communicates with the edge.
    let api_version = valid(findings, root, "api_version", Label::new(API_VERSION));
    let mut label = |key| {
        let text = findings.name(&at(root, key)?, "a text")?;
        valid(findings, root, key, Label::new(text))
    };
    let (name, manufacture, version) = (label("name"), label("manufacture"), label("version"));
    let robot_type = label("type").map(|text| robot_type(text.as_str()));
    let mut devices = Vec::new();
    for (group, otherwise) in [("devices", SETTER), ("sensors", READERS[0])] {
        let Some(group) = at(root, group) else { continue };
        for (id, at) in
            findings.entries(&group, "a map from each device id to the driver and range of the device")
        {
            let supplement = supplements.iter().find(|(device, _)| device == id).map(|(_, added)| added);
            let added = supplement.cloned().unwrap_or_default();
            devices.extend(device(findings, id, &at, otherwise, &added));
        }
    }
    let (id, api_version) = (id?, api_version?);
    let described = |block: InitializationBlock| {
        let block = block.and_answers_inquiries();
        InitializationBlock { name, robot_type, manufacture, version, api_version, reports: true, ..block }
    };
    let block = InitializationBlock::new(id, devices).map(described).map_err(|error| error.to_string());
    // A round trip through JSON applies the protocol's own checks to every device.
    let through = |block| serde_json::to_value(&block).and_then(serde_json::from_value);
    match block.and_then(|block: InitializationBlock| through(block).map_err(|error| error.to_string())) {
        Ok(block) => Some(block),
        Err(error) => {
            invalid(findings, root, &error);
            None
        }
    }
}

fn required(findings: &mut Reader, root: &At<'_>, key: &'static str) -> Option<String> {
    match at(root, key) {
        Some(at) => findings.name(&at, "a text"),
        None => {
            let message = format!("the description has no `{key}`");
            findings.add(Code::MissingKey, root.place(), message, format!("a key `{key}`"), None);
            None
        }
    }
}

fn valid<T>(
    findings: &mut Reader,
    root: &At<'_>,
    key: &str,
    read: Result<T, urrcp::LimitError>,
) -> Option<T> {
    read.map_err(|error| {
        let place = at(root, key).map_or_else(|| root.place(), |at| at.place());
        findings.add(Code::WrongType, place, error.to_string(), "a text of 1 to 256 characters", None);
    })
    .ok()
}

/// Parses a robot type, in upper or lower case. An unknown type is [`RobotType::Other`].
fn robot_type(text: &str) -> RobotType {
    match text.to_ascii_lowercase().as_str() {
        "industrial" => RobotType::Industrial,
        "transport" => RobotType::Transport,
        "anthropomorphic" => RobotType::Anthropomorphic,
        "military" => RobotType::Military,
        _ => RobotType::Other,
    }
}

fn invalid(findings: &mut Reader, at: &At<'_>, message: &str) {
    findings.add(
        Code::InitializationBlock,
        at.place(),
        message,
        "a description within the limits of URRCP",
        None,
    );
}

fn device(
    findings: &mut Reader,
    id: &str,
    at_device: &At<'_>,
    otherwise: &str,
    added: &Supplement,
) -> Option<Device> {
    let Node::Map(_) = at_device.node else {
        findings.wrong_type(at_device, "a map with `type`, `min_value` and `max_value`");
        return None;
    };
    let call = match at(at_device, "type") {
        Some(at) => findings.text(&at, "the name of the call that drives or reads the device")?.into_owned(),
        None => otherwise.to_owned(),
    };
    let is_sensor = READERS.contains(&call.as_str());
    if !is_sensor && call != SETTER {
        let message = format!("unknown call `{}`", shortened(&call));
        let expected = format!("{SETTER}, {} or {}", READERS[0], READERS[1]);
        let place = at(at_device, "type").map_or_else(|| at_device.place(), |at| at.place());
        findings.add(Code::UnknownWord, place, message, expected, None);
        return None;
    }
    let mut number = |key| at(at_device, key).and_then(|at| findings.number(&at, "a number"));
    let min = added.min_value.or_else(|| number("min_value"));
    let max = added.max_value.or_else(|| number("max_value"));
    let default = added.default_value.or_else(|| number("default_value"));
    let (Some(min), Some(max)) = (min, max) else {
        missing_range(findings, id, at_device, &call);
        return None;
    };
    if !is_sensor && default.is_some_and(|default| !(min..=max).contains(&default)) {
        invalid(
            findings,
            at_device,
            &format!("the `default_value` of `{id}` is outside the range from {min} to {max}"),
        );
        return None;
    }
    let types = if is_sensor { sensor(min, max, added) } else { driven(min, max, added) };
    let mut device = json!({"id": id, "name": id, "available_control_types": types});
    if !is_sensor {
        device["script_queue"] = json!(added.script_queue.unwrap_or(QUEUE));
        device["interpolation"] = json!(added.interpolation.unwrap_or_default());
        device["default_value"] = default.map_or(Value::Null, |default| json!(default));
    }
    device["unit"] = added.unit.as_ref().map_or(Value::Null, |unit| json!(unit));
    // Deserialized as if received over the network, so that all limits of the protocol are checked.
    serde_json::from_value(device).map_err(|error| invalid(findings, at_device, &error.to_string())).ok()
}

/// Reports a missing range. Reports nothing for a sensor that responds with text: it has no range, and is left out because it cannot be
/// read as a number.
fn missing_range(findings: &mut Reader, id: &str, at: &At<'_>, call: &str) {
    if call == READERS[1] {
        return;
    }
    for key in ["min_value", "max_value"] {
        if value(at.node, key).is_none() {
            let message = format!("device `{}` has no `{key}`", shortened(id));
            let hint = Some(format!(
                "add the key in the fleet file: `devices: {{{}: {{{key}: ...}}}}`",
                shortened(id)
            ));
            findings.add(Code::MissingKey, at.place(), message, format!("a key `{key}`"), hint);
        }
    }
}

fn sensor(min: f64, max: f64, added: &Supplement) -> Value {
    let mut limits = json!({"min_value": min, "max_value": max});
    if let Some(error) = added.max_error {
        limits["max_error"] = json!(error);
    }
    json!({"sensor": limits})
}

fn driven(min: f64, max: f64, added: &Supplement) -> Value {
    let control_type = added.control_type.unwrap_or(ControlType::Position);
    let granularity = added.granularity.unwrap_or_else(|| granularity(min, max));
    let mut limits = json!({"min_value": min, "max_value": max, "granularity": granularity});
    if let Some(error) = added.max_error {
        limits["max_error"] = json!(error);
    }
    let mut script = limits.clone();
    script["max_number_of_steps"] = json!(added.max_number_of_steps.unwrap_or(STEPS));
    let types = [(control_type.to_string(), limits), (ControlType::Script.to_string(), script)];
    Value::Object(types.into_iter().collect::<Map<_, _>>())
}

/// Returns the default granularity: the largest power of ten that fits into the range a thousand times. Values that people write are
/// multiples of it.
fn granularity(min: f64, max: f64) -> f64 {
    let thousandth = (max - min) / 1_000.0;
    if !thousandth.is_normal() || thousandth < 0.0 {
        return 0.001;
    }
    let exponent = thousandth.log10().floor();
    // Parsed from text, so that 0.1 is exactly 0.1.
    format!("1e{exponent}").parse().unwrap_or(thousandth)
}
