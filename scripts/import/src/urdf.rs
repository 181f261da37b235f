//! Converts a robot's description in URDF to an initialization block: joints, limits, velocities and units.

use std::collections::BTreeMap;

use roxmltree::{Document, Node, ParsingOptions};
use urrcp::{DeviceId, RobotId};

use downbeat_yaml::finding::Code;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::description::{DescriptionOutcome, block_path};
use super::fleet_part::FilePart;
use super::sink::{Sink, Spot};
use super::yaml::{line, number, one_line, scalar};

/// Maximum size of a URDF file, in bytes.
const BYTES_MAX: usize = 8 << 20;
const NODES_MAX: u32 = 1_000_000;
/// Maximum number of attributes of an XML element. The parser compares all pairs of them, which takes quadratic time.
const ATTRIBUTES_MAX: usize = 1_000;
/// Maximum number of joints in a URDF file.
const JOINTS_MAX: usize = 1_000;
/// The assumed `granularity` and `max_error` of all devices, in their unit. A URDF states neither.
const GRANULARITY: f64 = 0.001;
const STEPS: usize = 256;
/// How far a continuous joint, which has no limits, may turn in each direction, in rad.
const TURN: f64 = std::f64::consts::TAU;

struct Joint {
    name: String,
    unit: &'static str,
    min: f64,
    max: f64,
    velocity: Option<f64>,
}

/// Properties of joints that are each reported in one note for all joints concerned.
#[derive(Default)]
struct JointRemarks {
    fixed: usize,
    left_out: Vec<String>,
    mimics: Vec<String>,
    endless: Vec<String>,
    slow: Vec<String>,
    away: Vec<String>,
    efforts: usize,
}

/// Converts a URDF to an initialization block. `id` is the id of the robot; if it is `None`, the robot's name in the URDF is used.
#[must_use]
pub fn urdf(source: &Source, id: Option<&str>) -> DescriptionOutcome {
    let mut sink = Sink::default();
    let read = read(source, id, &mut sink);
    let Some((id, joints)) = read.filter(|_| sink.findings.is_empty()) else {
        return DescriptionOutcome::refused(sink);
    };
    let path = block_path(&id);
    let files = vec![
        FilePart { path: path.clone(), text: block_text(&id, &source.name, &joints) },
        FilePart { path: "fleet.yaml".into(), text: fleet_text(&id, &path, &joints) },
    ];
    DescriptionOutcome { files, devices: joints.len(), notes: sink.notes, findings: sink.findings }
}

/// Parses a URDF. Adds a finding if the document does not describe a robot or is too large.
pub(super) fn parsed<'s>(source: &'s Source, sink: &mut Sink) -> Option<Document<'s>> {
    if source.text.len() > BYTES_MAX {
        let message = format!("the file has {} bytes", source.text.len());
        sink.about(&source.name, Code::ImportLimit, message, &format!("at most {BYTES_MAX} bytes"), None);
        return None;
    }
    let crowded = |tag: &str| tag.bytes().filter(|byte| *byte == b'=').count() > ATTRIBUTES_MAX;
    if source.text.split(['<', '>']).any(crowded) {
        let message = format!("an element has more than {ATTRIBUTES_MAX} attributes");
        sink.about(&source.name, Code::ImportLimit, message, "a robot description", None);
        return None;
    }
    let options = ParsingOptions { allow_dtd: false, nodes_limit: NODES_MAX, ..ParsingOptions::default() };
    let document = match Document::parse_with_options(&source.text, options) {
        Ok(document) => document,
        Err(error) => {
            let place = error.pos();
            let spot = spot_at(source, place.row as usize, place.col as usize);
            sink.found(source, spot, Code::Syntax, error.to_string(), "XML", None);
            return None;
        }
    };
    let robot = document.root_element();
    if robot.tag_name().name() != "robot" {
        let message = format!("the root element is `{}`", shortened(robot.tag_name().name()));
        found(robot, source, Code::ImportShape, message, "a `robot`", None, sink);
        return None;
    }
    if let Some(macros) =
        robot.descendants().find(|node| node.tag_name().namespace().is_some_and(|n| n.contains("xacro")))
    {
        let hint = Some("expand the macros first: `xacro robot.urdf.xacro > robot.urdf`");
        found(
            macros,
            source,
            Code::ImportShape,
            "the description contains xacro macros".into(),
            "plain URDF",
            hint,
            sink,
        );
        return None;
    }
    Some(document)
}

fn read(source: &Source, id: Option<&str>, sink: &mut Sink) -> Option<(String, Vec<Joint>)> {
    let document = parsed(source, sink)?;
    let robot = document.root_element();
    let joints = joints(robot, source, sink);
    let name = id.or(robot.attribute("name")).unwrap_or("robot");
    if let Err(error) = RobotId::new(name) {
        let message = format!("robot `{}`: {error}", shortened(name));
        let hint = Some("set the name with `--kind NAME`");
        found(robot, source, Code::ImportNames, message, "a name of 1 to 256 characters", hint, sink);
    }
    Some((name.to_owned(), joints))
}

fn joints(robot: Node<'_, '_>, source: &Source, sink: &mut Sink) -> Vec<Joint> {
    let mut told = JointRemarks::default();
    let mut joints = Vec::new();
    let mut seen = std::collections::HashSet::new();
    // Only direct children are joints: transmissions also name joints, one level deeper.
    for node in robot.children().filter(|node| node.has_tag_name("joint")) {
        let Some(joint) = read_joint(node, &mut told, source, sink) else {
            if sink.is_full(source) {
                break;
            }
            continue;
        };
        if !seen.insert(joint.name.clone()) {
            let message = format!("duplicate joint name `{}`", shortened(&joint.name));
            found(node, source, Code::ImportNames, message, "unique names", None, sink);
        }
        joints.push(joint);
    }
    if joints.len() > JOINTS_MAX {
        let message = format!("the robot has {} joints", joints.len());
        sink.about(&source.name, Code::ImportLimit, message, &format!("at most {JOINTS_MAX} joints"), None);
    }
    if joints.is_empty() && sink.findings.is_empty() {
        let message = "the robot has no movable joints".to_owned();
        sink.about(
            &source.name,
            Code::NothingToDo,
            message,
            "at least one revolute, continuous or prismatic joint",
            None,
        );
    }
    told.note(&source.name, sink);
    joints
}

fn read_joint(
    node: Node<'_, '_>,
    told: &mut JointRemarks,
    source: &Source,
    sink: &mut Sink,
) -> Option<Joint> {
    let name = node.attribute("name").unwrap_or("").to_owned();
    if let Err(error) = DeviceId::new(name.as_str()) {
        let message = format!("joint `{}`: {error}", shortened(&name));
        found(node, source, Code::ImportNames, message, "a name of 1 to 256 characters", None, sink);
        return None;
    }
    let kind = node.attribute("type").unwrap_or("");
    let unit = match kind {
        "revolute" | "continuous" => "rad",
        "prismatic" => "m",
        "fixed" => {
            told.fixed += 1;
            return None;
        }
        "floating" | "planar" | "spherical" => {
            told.left_out.push(format!("{name} ({kind})"));
            return None;
        }
        other => {
            let message =
                format!("the joint `{}` has the unknown type `{}`", shortened(&name), shortened(other));
            let expected = "revolute, continuous, prismatic, fixed, floating or planar";
            found(node, source, Code::ImportShape, message, expected, None, sink);
            return None;
        }
    };
    let child = |tag: &str| node.children().find(|child| child.has_tag_name(tag));
    if let Some(mimic) = child("mimic") {
        told.mimics.push(format!("{name} (follows {})", shortened(mimic.attribute("joint").unwrap_or("?"))));
        return None;
    }
    let limit = child("limit");
    let (min, max) = range(node, limit, &name, kind, told, source, sink)?;
    let velocity = match limit {
        Some(limit) => attribute(limit, "velocity", source, sink)?,
        None => None,
    };
    told.efforts += usize::from(limit.is_some_and(|limit| limit.has_attribute("effort")));
    let velocity = velocity.filter(|velocity| *velocity > 0.0);
    if velocity.is_none() {
        told.slow.push(name.clone());
    }
    if min > 0.0 || max < 0.0 {
        told.away.push(name.clone());
    }
    Some(Joint { name, unit, min, max, velocity })
}

fn range(
    node: Node<'_, '_>,
    limit: Option<Node<'_, '_>>,
    name: &str,
    kind: &str,
    told: &mut JointRemarks,
    source: &Source,
    sink: &mut Sink,
) -> Option<(f64, f64)> {
    if kind == "continuous" {
        told.endless.push(name.to_owned());
        return Some((-TURN, TURN));
    }
    let Some(limit) = limit else {
        let message = format!("missing limits of the joint `{}`, which is {kind}", shortened(name));
        found(
            node,
            source,
            Code::MissingKey,
            message,
            "a `<limit>` with `lower`, `upper`, `velocity` and `effort`",
            None,
            sink,
        );
        return None;
    };
    // In URDF, missing bounds are 0.
    let lower = attribute(limit, "lower", source, sink)?.unwrap_or(0.0);
    let upper = attribute(limit, "upper", source, sink)?.unwrap_or(0.0);
    if lower < upper {
        return Some((lower, upper));
    }
    let message = format!("invalid limits of the joint `{}`: from {lower} to {upper}", shortened(name));
    found(limit, source, Code::ImportShape, message, "a lower limit below the upper one", None, sink);
    None
}

/// Parses an attribute of three numbers. Returns `Some(None)` if the attribute is missing. Adds a finding and returns `None` if it is
/// invalid.
pub(super) fn numbers(
    node: Node<'_, '_>,
    name: &str,
    source: &Source,
    sink: &mut Sink,
) -> Option<Option<[f64; 3]>> {
    let Some(attribute) = node.attribute_node(name) else { return Some(None) };
    let parts = attribute.value().split_ascii_whitespace().map(|part| part.parse::<f64>().ok());
    let parts: Option<Vec<f64>> = parts.map(|part| part.filter(|part| part.is_finite())).collect();
    let parts = parts.and_then(|parts| <[f64; 3]>::try_from(parts).ok());
    if parts.is_none() {
        let message = format!("`{name}` is `{}`", shortened(attribute.value()));
        let place = node.document().text_pos_at(attribute.range_value().start);
        let spot = spot_at(source, place.row as usize, place.col as usize);
        sink.found(source, spot, Code::ImportNumber, message, "three finite numbers", None);
    }
    parts.map(Some)
}

/// Parses an attribute that is a number. Returns `Some(None)` if the attribute is missing. Adds a finding and returns `None` if it is
/// invalid.
pub(super) fn attribute(
    node: Node<'_, '_>,
    name: &str,
    source: &Source,
    sink: &mut Sink,
) -> Option<Option<f64>> {
    let Some(attribute) = node.attribute_node(name) else { return Some(None) };
    let number = attribute.value().trim().parse::<f64>().ok().filter(|number| number.is_finite());
    if number.is_none() {
        let message = format!("`{name}` is `{}`", shortened(attribute.value()));
        let place = node.document().text_pos_at(attribute.range_value().start);
        let spot = spot_at(source, place.row as usize, place.col as usize);
        sink.found(source, spot, Code::ImportNumber, message, "a finite number", None);
        return None;
    }
    Some(number)
}

pub(super) fn found(
    node: Node<'_, '_>,
    source: &Source,
    code: Code,
    message: String,
    expected: &str,
    hint: Option<&str>,
    sink: &mut Sink,
) {
    let place = node.document().text_pos_at(node.range().start);
    let spot = spot_at(source, place.row as usize, place.col as usize);
    sink.found(source, spot, code, message, expected, hint);
}

fn spot_at(source: &Source, line: usize, column: usize) -> Spot<'_> {
    let text = source.text.lines().nth(line.saturating_sub(1)).unwrap_or("");
    let start = text.char_indices().nth(column.saturating_sub(1)).map_or(text.len(), |(at, _)| at);
    let width = text[start..].chars().next().map_or(0, char::len_utf8);
    Spot { line, text, start, width }
}

impl JointRemarks {
    fn note(&self, file: &str, sink: &mut Sink) {
        let listed =
            |names: &[String]| downbeat_yaml::finding::names(names.iter().take(20).map(String::as_str));
        if self.fixed > 0 {
            sink.note(format!(
                "{file}: left out {}",
                downbeat_yaml::render::counted(self.fixed, "fixed joint")
            ));
        }
        for (list, text) in [
            (&self.left_out, "left out joints with more than one degree of freedom"),
            (&self.mimics, "left out joints that mimic another joint"),
            (
                &self.endless,
                "continuous joints, limited to one turn in each direction (adjust the limits as needed)",
            ),
            (&self.slow, "joints without a velocity limit (their speed is not limited)"),
            (&self.away, "joints that cannot be at 0 (their default_value is the limit closest to 0)"),
        ] {
            if !list.is_empty() {
                sink.note(format!("{file}: {text}: {}", listed(list)));
            }
        }
        if self.efforts > 0 {
            sink.note(format!("{file}: left out {}", downbeat_yaml::render::counted(self.efforts, "effort")));
        }
        sink.note(format!(
            "{file}: a URDF does not specify granularity, max_error (both set to {GRANULARITY}) or \
             max_number_of_steps (set to {STEPS}): adjust these values to your robot. Links, meshes, masses and transmissions are ignored"
        ));
    }
}

fn block_text(id: &str, origin: &str, joints: &[Joint]) -> String {
    let mut text = format!(
        "# From {}. Granularity, max_error and max_number_of_steps are not in a URDF: correct them.\n",
        one_line(origin)
    );
    line(&mut text, format_args!("id: {}\napi_version: \"1\"\nreports: true\ndevices:", scalar(id)));
    for Joint { name, unit, min, max, .. } in joints {
        let (name, home) = (scalar(name), number(0_f64.clamp(*min, *max)));
        let limits = format!(
            "min_value: {}, max_value: {}, granularity: {GRANULARITY}, max_error: {GRANULARITY}",
            number(*min),
            number(*max)
        );
        line(
            &mut text,
            format_args!(
                "  - id: {name}\n    name: {name}\n    unit: {unit}\n    default_value: {home}\n    interpolation: linear\n    \
                 available_control_types:\n      position: {{{limits}}}\n      \
                 script: {{{limits}, max_number_of_steps: {STEPS}, control_types: [position]}}"
            ),
        );
    }
    text
}

fn fleet_text(id: &str, path: &str, joints: &[Joint]) -> String {
    let mut text =
        String::from("# Simulated. Set `address: tcp://host:port` to drive a real robot.\nrobots:\n");
    line(&mut text, format_args!("  {}:\n    init: {}\n    address: sim", scalar(id), scalar(path)));
    let limits: BTreeMap<&str, f64> =
        joints.iter().filter_map(|joint| Some((joint.name.as_str(), joint.velocity?))).collect();
    if !limits.is_empty() {
        text.push_str("    limits: # the velocity limits of the URDF, in the joint's unit per second\n");
        for joint in joints.iter().filter(|joint| limits.contains_key(joint.name.as_str())) {
            let speed = number(limits[joint.name.as_str()]);
            line(&mut text, format_args!("      {}: {{speed: {speed}}}", scalar(&joint.name)));
        }
    }
    text
}
