//! Reads keyframe animations of the RoboCup team Bit-Bots: `keyframes: [{duration, pause, goals: {joint: degrees}}]`.

use std::collections::{BTreeSet, HashMap, HashSet};

use urrcp::Span;

use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::{Code, names};
use downbeat_yaml::node::Node;
use downbeat_yaml::source::Source;

use super::input::Input;
use super::sink::Sink;
use super::{DeviceMotion, Keyframe, Motion, RobotMotion, keyframes, tree};

/// Maximum number of joints of an animation.
const JOINTS_MAX: usize = 1_000;

/// A keyframe of the file: the goals of joints, and the time for which the joints hold them.
struct Pose {
    /// The time at which the joints reach the goals.
    at: Span,
    /// The time until which the joints hold the goals.
    until: Span,
    goals: Vec<(String, f64)>,
}

/// Reads one file, which contains the motion of one robot in one scene.
pub(super) fn read(input: &Input, source: &Source, sink: &mut Sink) -> Vec<Motion> {
    let poses = tree::read(source, sink, |root, findings, _| read_poses(root, findings)).unwrap_or_default();
    let joints: HashSet<&str> =
        poses.iter().flat_map(|pose| &pose.goals).map(|(joint, _)| joint.as_str()).collect();
    if joints.len() > JOINTS_MAX {
        let message = format!("the animation has {} joints", joints.len());
        sink.about(&source.name, Code::ImportLimit, message, &format!("at most {JOINTS_MAX} joints"), None);
        return Vec::new();
    }
    let mut tracks = Tracks::default();
    for (index, pose) in poses.iter().enumerate() {
        tracks.add(index, pose);
    }
    tracks.note(&poses, source, sink);
    sink.held += tracks.held;
    let robot = RobotMotion { robot: input.robot.clone(), devices: tracks.devices };
    vec![Motion { scene: input.scene.clone(), robot }]
}

/// The joints, each with its keyframes so far.
#[derive(Default)]
struct Tracks {
    devices: Vec<DeviceMotion>,
    by_joint: HashMap<String, usize>,
    /// For each joint, the time until which it holds its last value if later poses do not contain the joint.
    held_until: Vec<Span>,
    held: usize,
    left_out: BTreeSet<String>,
    late: BTreeSet<String>,
}

impl Tracks {
    fn add(&mut self, index: usize, pose: &Pose) {
        let mut named = vec![false; self.devices.len()];
        for (joint, value) in &pose.goals {
            let device = match self.by_joint.get(joint) {
                Some(device) => *device,
                None => self.join(index, joint),
            };
            if let Some(named) = named.get_mut(device) {
                *named = true;
            }
            self.hold(device, self.held_until[device]);
            self.devices[device].keyframes.push(Keyframe { at: pose.at, value: value + 0.0 });
            self.hold(device, pose.until);
        }
        for device in (0..named.len()).filter(|device| !named[*device]) {
            self.left_out.insert(self.devices[device].device.clone());
            self.held_until[device] = pose.until;
        }
    }

    fn join(&mut self, index: usize, joint: &str) -> usize {
        if index > 0 {
            self.late.insert(joint.to_owned());
        }
        let device = self.devices.len();
        self.by_joint.insert(joint.to_owned(), device);
        self.devices.push(DeviceMotion {
            device: joint.to_owned(),
            unit: "deg".into(),
            ..DeviceMotion::default()
        });
        self.held_until.push(Span::ZERO);
        device
    }

    /// Repeats the device's last value at `until`, so that the device does not start moving to the next value before that time.
    fn hold(&mut self, device: usize, until: Span) {
        let keyframes = &mut self.devices[device].keyframes;
        if let Some(last) = keyframes.last().copied().filter(|last| last.at < until) {
            keyframes.push(Keyframe { at: until, ..last });
            self.held += 1;
        }
        self.held_until[device] = self.held_until[device].max(until);
    }

    fn note(&self, poses: &[Pose], source: &Source, sink: &mut Sink) {
        let file = &source.name;
        let pauses = poses.iter().filter(|pose| pose.until > pose.at).count();
        if pauses > 0 {
            sink.note(format!("{file}: held {}", downbeat_yaml::render::counted(pauses, "pause")));
        }
        if !self.left_out.is_empty() {
            let (count, joints) = (self.left_out.len(), names(self.left_out.iter().map(String::as_str)));
            let joints_held = downbeat_yaml::render::counted(count, "joint");
            sink.note(format!(
                "{file}: {joints_held} missing from some keyframes, and kept in place there: {joints}"
            ));
        }
        if !self.late.is_empty() {
            let joints = names(self.late.iter().map(String::as_str));
            sink.note(format!("{file}: joints missing from the first keyframe move to their first value from the start: {joints}"));
        }
    }
}

fn read_poses(root: &At<'_>, findings: &mut Reader) -> Option<Vec<Pose>> {
    let list = tree::required(root, "keyframes", "the animation", findings)?;
    let items = findings.list(&list, "a list of keyframes");
    if items.is_empty() && matches!(list.node, Node::List(_)) {
        let message = "the animation has no keyframes";
        findings.add(Code::NothingToDo, list.place(), message, "at least one keyframe", None);
    }
    let mut poses: Vec<Pose> = Vec::new();
    let mut end_s = 0.0;
    for (index, item) in items.iter().enumerate() {
        poses.extend(read_pose(item, index, &mut end_s, findings));
        if tree::is_full(findings) {
            return None;
        }
    }
    Some(poses)
}

fn read_pose(at: &At<'_>, index: usize, end_s: &mut f64, findings: &mut Reader) -> Option<Pose> {
    let what = format!("keyframe {}", index + 1);
    let duration_at = tree::required(at, "duration", &what, findings);
    let duration =
        duration_at.as_ref().and_then(|at| seconds(at, &format!("the duration of {what}"), findings));
    let pause = match tree::optional(at, "pause") {
        Some(at) => seconds(&at, &format!("the pause of {what}"), findings),
        None => Some(0.0),
    };
    let goals = tree::required(at, "goals", &what, findings).and_then(|at| read_goals(&at, &what, findings));
    let (duration_at, duration, pause) = (duration_at?, duration?, pause?);
    let start_s = *end_s;
    *end_s += duration + pause;
    let (Some(start), Some(reached), Some(until)) =
        (keyframes::span(start_s), keyframes::span(start_s + duration), keyframes::span(*end_s))
    else {
        let expected = format!("at most {} s in total", keyframes::SECONDS_MAX);
        findings.add(
            Code::ImportTime,
            duration_at.place(),
            format!("{what} ends at {end_s} s"),
            expected,
            None,
        );
        return None;
    };
    if reached <= start {
        let message = format!("{what} has a duration of {duration} s: it starts and ends at {start}");
        let hint = "add a duration above 0, or remove the keyframe";
        findings.add(
            Code::TimesCollide,
            duration_at.place(),
            message,
            "a duration above 0 s",
            Some(hint.into()),
        );
        return None;
    }
    Some(Pose { at: reached, until, goals: goals? })
}

fn seconds(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<f64> {
    let value = tree::number(at, what, findings)?;
    if value >= 0.0 {
        return Some(value);
    }
    findings.add(Code::ImportTime, at.place(), format!("{what} is {value} s"), "0 s or more", None);
    None
}

fn read_goals(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<Vec<(String, f64)>> {
    let entries = findings.entries(at, "a map from each joint to its angle in degrees");
    let mut goals = Vec::with_capacity(entries.len());
    for (joint, at) in &entries {
        let value =
            tree::number(at, &format!("`{}` of {what}", downbeat_yaml::shown::shortened(joint)), findings);
        goals.extend(value.map(|value| ((*joint).to_owned(), value)));
    }
    if entries.is_empty() && matches!(at.node, Node::Map(_)) {
        findings.add(
            Code::NothingToDo,
            at.place(),
            format!("{what} has no goals"),
            "at least one joint",
            None,
        );
        return None;
    }
    (goals.len() == entries.len()).then_some(goals)
}
