//! From a robot's description in URDF to an initialization block: joints, limits, velocities and units.

use std::collections::BTreeMap;

use roxmltree::{Document, Node, ParsingOptions};
use urrcp::{DeviceId, RobotId};

use downbeat_yaml::finding::{Code, Finding};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::fleet_part::FilePart;
use super::sink::{Sink, Spot};
use super::yaml::{line, number, one_line, scalar};

/// Largest file, and most elements and attributes in it.
const BYTES_MAX: usize = 8 << 20;
const NODES_MAX: u32 = 1_000_000;
/// Most attributes of one: the time to compare them grows with their square.
const ATTRIBUTES_MAX: usize = 1_000;
/// Most joints.
const JOINTS_MAX: usize = 1_000;
/// What a URDF does not say.
const GRANULARITY: f64 = 0.001;
const STEPS: usize = 256;
/// How far a joint without limits turns each way, in rad.
const TURN: f64 = std::f64::consts::TAU;

/// What became of a description.
#[derive(Clone, Debug, Default)]
pub struct UrdfOutcome {
    /// The initialization block, and a fleet with one such robot and the limits of its speeds; none where something is wrong.
    pub files: Vec<FilePart>,
    /// How many devices it has.
    pub devices: usize,
    /// What was left out, and what was taken for what the file does not say.
    pub notes: Vec<String>,
    /// What is wrong.
    pub findings: Vec<Finding>,
}

struct Joint {
    name: String,
    unit: &'static str,
    min: f64,
    max: f64,
    velocity: Option<f64>,
}

/// What is reported once for all joints.
#[derive(Default)]
struct Told {
    fixed: usize,
    left_out: Vec<String>,
    mimics: Vec<String>,
    endless: Vec<String>,
    slow: Vec<String>,
    away: Vec<String>,
    efforts: usize,
}

/// Makes an initialization block of a description. `id` names the robot, otherwise its description does.
#[must_use]
pub fn urdf(source: &Source, id: Option<&str>) -> UrdfOutcome {
    let mut sink = Sink::default();
    let read = read(source, id, &mut sink);
    let Some((id, joints)) = read.filter(|_| sink.findings.is_empty()) else {
        return UrdfOutcome { findings: sink.findings, notes: sink.notes, ..UrdfOutcome::default() };
    };
    let safe = |c: char| if c.is_alphanumeric() || "-_".contains(c) { c } else { '-' };
    let path = format!("robots/{}.yaml", id.chars().take(48).map(safe).collect::<String>());
    let files = vec![
        FilePart { path: path.clone(), text: block_text(&id, &source.name, &joints) },
        FilePart { path: "fleet.yaml".into(), text: fleet_text(&id, &path, &joints) },
    ];
    UrdfOutcome { files, devices: joints.len(), notes: sink.notes, findings: sink.findings }
}

/// The document, if it is one of a robot and not too large; findings otherwise.
pub(super) fn parsed<'s>(source: &'s Source, sink: &mut Sink) -> Option<Document<'s>> {
    if source.text.len() > BYTES_MAX {
        let message = format!("the file has {} bytes", source.text.len());
        sink.about(&source.name, Code::ImportLimit, message, &format!("at most {BYTES_MAX} bytes"), None);
        return None;
    }
    let crowded = |tag: &str| tag.bytes().filter(|byte| *byte == b'=').count() > ATTRIBUTES_MAX;
    if source.text.split(['<', '>']).any(crowded) {
        let message = format!("an element has more than {ATTRIBUTES_MAX} attributes");
        sink.about(&source.name, Code::ImportLimit, message, "a description of a robot", None);
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
        let message = format!("the document is a `{}`", shortened(robot.tag_name().name()));
        found(robot, source, Code::ImportShape, message, "a `robot`", None, sink);
        return None;
    }
    if let Some(macros) =
        robot.descendants().find(|node| node.tag_name().namespace().is_some_and(|n| n.contains("xacro")))
    {
        let hint = Some("expand it first: xacro robot.urdf.xacro > robot.urdf");
        found(
            macros,
            source,
            Code::ImportShape,
            "the description has macros of xacro".into(),
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
        let hint = Some("name it with `--kind NAME`");
        found(robot, source, Code::ImportNames, message, "a name of 1 to 256 characters", hint, sink);
    }
    Some((name.to_owned(), joints))
}

fn joints(robot: Node<'_, '_>, source: &Source, sink: &mut Sink) -> Vec<Joint> {
    let mut told = Told::default();
    let mut joints = Vec::new();
    let mut seen = std::collections::HashSet::new();
    // Transmissions name joints too, one level down.
    for node in robot.children().filter(|node| node.has_tag_name("joint")) {
        let Some(joint) = read_joint(node, &mut told, source, sink) else {
            if sink.is_full(source) {
                break;
            }
            continue;
        };
        if !seen.insert(joint.name.clone()) {
            let message = format!("two joints are named `{}`", shortened(&joint.name));
            found(node, source, Code::ImportNames, message, "each name once", None, sink);
        }
        joints.push(joint);
    }
    if joints.len() > JOINTS_MAX {
        let message = format!("the robot has {} joints", joints.len());
        sink.about(&source.name, Code::ImportLimit, message, &format!("at most {JOINTS_MAX} joints"), None);
    }
    if joints.is_empty() && sink.findings.is_empty() {
        let message = "the robot has no joint that moves".to_owned();
        sink.about(
            &source.name,
            Code::NothingToDo,
            message,
            "a revolute, continuous or prismatic joint",
            None,
        );
    }
    told.note(&source.name, sink);
    joints
}

fn read_joint(node: Node<'_, '_>, told: &mut Told, source: &Source, sink: &mut Sink) -> Option<Joint> {
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
            let message = format!("the joint `{}` is of type `{}`", shortened(&name), shortened(other));
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
    told: &mut Told,
    source: &Source,
    sink: &mut Sink,
) -> Option<(f64, f64)> {
    if kind == "continuous" {
        told.endless.push(name.to_owned());
        return Some((-TURN, TURN));
    }
    let Some(limit) = limit else {
        let message = format!("the joint `{}` is {kind} and has no limit", shortened(name));
        found(
            node,
            source,
            Code::MissingKey,
            message,
            "<limit lower= upper= velocity= effort=/>",
            None,
            sink,
        );
        return None;
    };
    // URDF takes 0 for a bound that is not written.
    let lower = attribute(limit, "lower", source, sink)?.unwrap_or(0.0);
    let upper = attribute(limit, "upper", source, sink)?.unwrap_or(0.0);
    if lower < upper {
        return Some((lower, upper));
    }
    let message = format!("the joint `{}` goes from {lower} to {upper}", shortened(name));
    found(limit, source, Code::ImportShape, message, "a lower limit below the upper one", None, sink);
    None
}

/// Three numbers, or none where they are not written; nothing where they are something else, which is found.
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

/// A number, or none where it is not written; nothing where it is no number, which is found.
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

impl Told {
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
            (&self.left_out, "left out, since they have more than one value"),
            (&self.mimics, "left out, since they follow another joint"),
            (&self.endless, "turn without end: one turn either way is taken, correct it"),
            (&self.slow, "have no velocity: their speed is not limited"),
            (&self.away, "cannot be at 0: their default_value is the limit next to it"),
        ] {
            if !list.is_empty() {
                sink.note(format!("{file}: {text}: {}", listed(list)));
            }
        }
        if self.efforts > 0 {
            sink.note(format!("{file}: left out {}", downbeat_yaml::render::counted(self.efforts, "effort")));
        }
        sink.note(format!(
            "{file}: a URDF says nothing about granularity and max_error ({GRANULARITY} is taken), nor about \
             max_number_of_steps ({STEPS}): correct them. Left out links, meshes, masses and transmissions"
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
    let mut text = String::from(
        "# Simulated. Give the robot `address: tcp://host:port` to drive a real one.\nrobots:\n",
    );
    line(&mut text, format_args!("  {}:\n    init: {}\n    address: sim", scalar(id), scalar(path)));
    let limits: BTreeMap<&str, f64> =
        joints.iter().filter_map(|joint| Some((joint.name.as_str(), joint.velocity?))).collect();
    if !limits.is_empty() {
        text.push_str("    limits: # the description's velocities, in the joint's unit a second\n");
        for joint in joints.iter().filter(|joint| limits.contains_key(joint.name.as_str())) {
            let speed = number(limits[joint.name.as_str()]);
            line(&mut text, format_args!("      {}: {{speed: {speed}}}", scalar(&joint.name)));
        }
    }
    text
}
