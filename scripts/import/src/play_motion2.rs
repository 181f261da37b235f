//! Reads the motions of PAL Robotics' `play_motion2`, with the keys `joints`, `positions` (one flat list) and `times_from_start`. Each
//! motion becomes a scene.

use urrcp::Span;

use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;
use downbeat_yaml::source::Source;

use super::input::Input;
use super::sink::Sink;
use super::{DeviceMotion, Keyframe, Motion, RobotMotion, keyframes, tree};

/// Reads one file, which contains one robot, and one scene per motion.
pub(super) fn read(input: &Input, source: &Source, sink: &mut Sink) -> Vec<Motion> {
    let motions =
        tree::read(source, sink, |root, findings, _| read_motions(root, findings)).unwrap_or_default();
    let at_zero = |(_, devices): &&(String, Vec<DeviceMotion>)| {
        devices.iter().any(|device| device.keyframes.first().is_some_and(|k| k.at == Span::ZERO))
    };
    let from_zero: Vec<_> = motions.iter().filter(at_zero).map(|(name, _)| name.as_str()).collect();
    if !from_zero.is_empty() {
        let names = downbeat_yaml::finding::names(from_zero);
        sink.note(format!(
            "{}: the first time in {names} is 0 s: the robot must be at the first position before the start",
            source.name
        ));
    }
    let motion = |(name, devices): (String, Vec<DeviceMotion>)| {
        let scene = if input.scene.is_empty() { name } else { format!("{}: {name}", input.scene) };
        Motion { scene, robot: RobotMotion { robot: input.robot.clone(), devices } }
    };
    motions.into_iter().map(motion).collect()
}

fn read_motions(root: &At<'_>, findings: &mut Reader) -> Option<Vec<(String, Vec<DeviceMotion>)>> {
    // The parameters of a ROS 2 node are below its name and `ros__parameters`; older files begin with `motions`.
    let node = match root.node {
        Node::Map(entries) => entries
            .iter()
            .find(|(_, node)| matches!(node, Node::Map(inner) if inner.iter().any(|(key, _)| key == "ros__parameters")))
            .map(|(key, node)| root.entry(key, 0, node)),
        _ => None,
    };
    let node = node.as_ref().unwrap_or(root);
    let parameters = tree::optional(node, "ros__parameters").or_else(|| tree::optional(node, "play_motion"));
    let parameters = parameters.as_ref().unwrap_or(node);
    let list = tree::required(parameters, "motions", "the file", findings)?;
    let entries =
        findings.entries(&list, "a map from each motion to its `joints`, `positions` and `times_from_start`");
    if entries.is_empty() && matches!(list.node, Node::Map(_)) {
        findings.add(Code::NothingToDo, list.place(), "the file has no motions", "at least one motion", None);
    }
    let mut motions = Vec::new();
    for (name, at) in &entries {
        motions.extend(read_motion(name, at, findings).map(|devices| ((*name).to_owned(), devices)));
        if tree::is_full(findings) {
            return None;
        }
    }
    Some(motions)
}

fn read_motion(name: &str, at: &At<'_>, findings: &mut Reader) -> Option<Vec<DeviceMotion>> {
    let what = format!("the motion `{}`", downbeat_yaml::shown::shortened(name));
    let joints = tree::required(at, "joints", &what, findings)
        .and_then(|at| tree::unique_names(&at, "joint", findings));
    let positions_at = tree::required(at, "positions", &what, findings);
    let positions =
        positions_at.as_ref().and_then(|at| tree::numbers(at, &format!("`positions` of {what}"), findings));
    let times = tree::required(at, "times_from_start", &what, findings)
        .and_then(|at| read_times(&at, &what, findings));
    let (joints, positions, times, positions_at) = (joints?, positions?, times?, positions_at?);
    if positions.len() != joints.len() * times.len() {
        let (found, joints, times) = (positions.len(), joints.len(), times.len());
        let message = format!("{what} has {found} positions for {joints} joints at {times} times");
        let expected = format!("{joints} x {times} = {} positions", joints * times);
        let hint = "`positions` is a flat list: all joints at the first time, then all joints at the second";
        findings.add(Code::ImportShape, positions_at.place(), message, expected, Some(hint.into()));
        return None;
    }
    let count = joints.len();
    let device = |(index, device): (usize, String)| {
        let values = positions.iter().skip(index).step_by(count);
        let keyframes = times.iter().zip(values).map(|(at, value)| Keyframe { at: *at, value: value + 0.0 });
        DeviceMotion {
            unit: unit_of(&device).to_owned(),
            device,
            keyframes: keyframes.collect(),
            ..DeviceMotion::default()
        }
    };
    Some(joints.into_iter().enumerate().map(device).collect())
}

fn read_times(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<Vec<Span>> {
    let seconds = tree::numbers(at, &format!("`times_from_start` of {what}"), findings)?;
    if seconds.is_empty() {
        findings.add(
            Code::NothingToDo,
            at.place(),
            format!("{what} has no times"),
            "at least one time",
            None,
        );
        return None;
    }
    let mut times: Vec<Span> = Vec::with_capacity(seconds.len());
    for (index, at_s) in seconds.iter().enumerate() {
        let place = || match at.node {
            Node::List(items) => at.item(index, &items[index]).place(),
            _ => at.place(),
        };
        let Some(time) = keyframes::span(*at_s) else {
            let expected = format!("a time from 0 to {} s", keyframes::SECONDS_MAX);
            let message = format!("{what} has the time {at_s} s");
            findings.add(Code::ImportTime, place(), message, expected, None);
            return None;
        };
        let before = times.last().copied();
        if let Some((code, message, hint)) = before.and_then(|before| keyframes::check_later(before, time)) {
            let expected = format!("a time after {} s", before.map_or(0.0, keyframes::seconds));
            findings.add(code, place(), format!("{what}: {message}"), expected, Some(hint.into()));
        }
        times.push(time);
        if tree::is_full(findings) {
            return None;
        }
    }
    (times.len() == seconds.len()).then_some(times)
}

/// Returns the unit of a joint: metres for joints that slide (TIAGo's torso and fingers), and radians for joints that turn.
fn unit_of(joint: &str) -> &'static str {
    match joint {
        "torso_lift_joint" | "gripper_left_finger_joint" | "gripper_right_finger_joint" => "m",
        _ => "rad",
    }
}
