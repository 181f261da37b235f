//! Reads the ROS message `trajectory_msgs/JointTrajectory` as YAML or JSON.

use urrcp::Span;

use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;
use downbeat_yaml::source::Source;

use super::hermite::{self, Point};
use super::input::Input;
use super::keyframes::{self, rounded};
use super::sink::Sink;
use super::units::OF_JOINTS;
use super::{Course, DeviceMotion, ImportOptions, Keyframe, Motion, Piece, RobotMotion, tree};

/// Number of decimal digits of sampled values.
const DIGITS: i32 = 7;

/// One point of a trajectory, with the positions of all joints.
struct JointPoint {
    at: Span,
    positions: Vec<f64>,
    velocities: Option<Vec<f64>>,
    /// Whether the point has accelerations or efforts, which the import ignores.
    has_more: bool,
}

/// How the motion between two points is converted.
#[derive(Clone, Copy, PartialEq)]
enum Between {
    Straight,
    Cubic,
    /// A cubic that is sampled with this frequency, in Hz.
    Sampled(f64),
}

impl Between {
    fn of(points: &[JointPoint], options: &ImportOptions) -> Self {
        match (are_curved(points), options.rate_hz) {
            (true, Some(rate)) => Self::Sampled(rate),
            (true, None) if points.len() > 1 && points[0].at == Span::ZERO => Self::Cubic,
            _ => Self::Straight,
        }
    }
}

fn are_curved(points: &[JointPoint]) -> bool {
    !points.is_empty() && points.iter().all(|point| point.velocities.is_some())
}

/// Reads one file, which contains one robot, and one scene per message. `ros2 topic echo` ends each message with `---`.
pub(super) fn read(input: &Input, source: &Source, options: &ImportOptions, sink: &mut Sink) -> Vec<Motion> {
    let messages = messages(source);
    let several = messages.len() > 1;
    if several {
        sink.note(format!("{}: {} messages, imported as one scene each", source.name, messages.len()));
    }
    let mut motions = Vec::new();
    for (index, (line, message)) in messages.iter().enumerate() {
        let found = sink.findings.len();
        let scene = match (several, input.scene.as_str()) {
            (false, scene) => scene.to_owned(),
            (true, "") => format!("message {}", index + 1),
            (true, scene) => format!("{scene}: message {}", index + 1),
        };
        motions.extend(read_message(&Input { scene, ..input.clone() }, message, options, sink));
        if sink.findings.len() > found {
            sink.findings[found..].iter_mut().for_each(|finding| finding.line += line);
            break;
        }
    }
    motions
}

/// Splits a text into its YAML documents. Returns each document with the number of lines before it.
fn messages(source: &Source) -> Vec<(usize, Source)> {
    let of = |text: String| Source { name: source.name.clone(), text };
    let mut messages = vec![(0, String::new())];
    for (index, line) in source.text.split_inclusive('\n').enumerate() {
        match (line.trim_end(), messages.last_mut()) {
            ("---", _) => messages.push((index + 1, String::new())),
            (_, Some((_, text))) => text.push_str(line),
            (_, None) => {}
        }
    }
    let is_empty =
        |text: &str| text.lines().all(|line| line.trim().is_empty() || line.trim_start().starts_with('#'));
    let mut filled: Vec<_> = messages
        .into_iter()
        .filter(|(_, text)| !is_empty(text))
        .map(|(line, text)| (line, of(text)))
        .collect();
    if filled.is_empty() {
        filled.push((0, of(source.text.clone())));
    }
    filled
}

fn read_message(input: &Input, source: &Source, options: &ImportOptions, sink: &mut Sink) -> Vec<Motion> {
    let read = tree::read(source, sink, |root, findings, _| read_points(root, findings));
    let Some((joints, points)) = read else { return Vec::new() };
    if points.first().is_some_and(|point| point.at == Span::ZERO) {
        sink.note(format!(
            "{}: the first point is at 0 s: the robot must be at this point before the start",
            source.name
        ));
    }
    let between = Between::of(&points, options);
    note(&points, between, options, source, sink);
    let times = times(&points, between, joints.len(), source, sink);
    let device = |(index, device): (usize, String)| DeviceMotion {
        device,
        unit: OF_JOINTS.to_owned(),
        keyframes: match between {
            Between::Sampled(_) => curve(&points, index, &times),
            _ => points.iter().map(|p| Keyframe { at: p.at, value: p.positions[index] + 0.0 }).collect(),
        },
        course: match between {
            Between::Cubic => Course::Pieces(pieces(&points, index)),
            _ => Course::Straight,
        },
    };
    let devices = joints.into_iter().enumerate().map(device).collect();
    vec![Motion { scene: input.scene.clone(), robot: RobotMotion { robot: input.robot.clone(), devices } }]
}

/// Returns the cubic curves through the positions of a joint, with the joint's velocities as slopes.
fn pieces(points: &[JointPoint], joint: usize) -> Vec<Piece> {
    let at = |point: &JointPoint| Point {
        at_s: keyframes::seconds(point.at),
        value: point.positions[joint],
        slope: point.velocities.as_ref().map_or(0.0, |velocities| velocities[joint]),
    };
    let piece = |pair: &[JointPoint]| Piece {
        length: pair[1].at - pair[0].at,
        coefficients: hermite::coefficients(at(&pair[0]), at(&pair[1])),
    };
    points.windows(2).map(piece).collect()
}

fn note(points: &[JointPoint], between: Between, options: &ImportOptions, source: &Source, sink: &mut Sink) {
    let file = &source.name;
    match between {
        Between::Cubic => {
            sink.note(format!("{file}: the path between points is a cubic curve through their positions and velocities"));
        }
        Between::Straight if are_curved(points) => sink.note(format!(
            "{file}: velocities are ignored, so the path between points is straight; use --rate to sample the curve"
        )),
        Between::Straight if options.rate_hz.is_some() => {
            sink.note(format!("{file}: the points have no velocities, so --rate has no effect"));
        }
        _ => {}
    }
    let more = points.iter().filter(|point| point.has_more).count();
    if more > 0 {
        let points = downbeat_yaml::render::counted(more, "point");
        sink.note(format!("{file}: ignored accelerations and efforts of {points}"));
    }
}

fn times(
    points: &[JointPoint],
    between: Between,
    joints: usize,
    source: &Source,
    sink: &mut Sink,
) -> Vec<Span> {
    let (Between::Sampled(rate), Some(last)) = (between, points.last()) else { return Vec::new() };
    let last_s = keyframes::seconds(last.at);
    let samples = (last_s * rate + 2.0) * joints as f64;
    if !sink.has_room_for(samples) {
        sink.too_many(&source.name, samples);
        return Vec::new();
    }
    keyframes::sampled_times(last_s, rate)
}

/// Returns samples of a joint's curve, beginning at the first point. Before the time of that point, the robot moves to it.
fn curve(points: &[JointPoint], joint: usize, times: &[Span]) -> Vec<Keyframe> {
    let point = |p: &JointPoint| {
        let slope = p.velocities.as_ref().map_or(0.0, |velocities| velocities[joint]);
        Point { at_s: keyframes::seconds(p.at), value: p.positions[joint], slope }
    };
    let joint: Vec<Point> = points.iter().map(point).collect();
    let first = points.first().map_or(Span::ZERO, |point| point.at);
    let begin = (!times.contains(&first)).then_some(first);
    let times = begin.into_iter().chain(times.iter().copied().filter(|at| *at >= first));
    let sample = |at: Span| {
        let value = hermite::value(&joint, keyframes::seconds(at)).unwrap_or(0.0);
        Keyframe { at, value: rounded(value, DIGITS) }
    };
    times.map(sample).collect()
}

fn read_points(root: &At<'_>, findings: &mut Reader) -> Option<(Vec<String>, Vec<JointPoint>)> {
    // Goals of actions and display messages contain the trajectory in one of these fields.
    let inner = tree::optional(root, "trajectory").or_else(|| tree::optional(root, "joint_trajectory"));
    let root = inner.as_ref().unwrap_or(root);
    if tree::optional(root, "name").is_some() && tree::optional(root, "position").is_some() {
        let message = "this is a joint state message, not a joint trajectory";
        let hint = "record the topic with `ros2 bag record --storage mcap`, and import the recording as mcap";
        findings.add(
            Code::MissingKey,
            root.place(),
            message,
            "`joint_names` and `points`",
            Some(hint.into()),
        );
        return None;
    }
    let what = "a joint trajectory";
    let joints = tree::required(root, "joint_names", what, findings);
    let joints = joints.and_then(|at| tree::unique_names(&at, "joint", findings));
    let list = tree::required(root, "points", what, findings)?;
    let items = tree::points(&list, findings);
    let joints = joints?;
    let mut points: Vec<JointPoint> = Vec::new();
    for (index, item) in items.iter().enumerate() {
        let point = read_point(item, index, joints.len(), points.last(), findings);
        points.extend(point);
        if tree::is_full(findings) {
            break;
        }
    }
    Some((joints, points))
}

fn read_point(
    at: &At<'_>,
    index: usize,
    joints: usize,
    before: Option<&JointPoint>,
    findings: &mut Reader,
) -> Option<JointPoint> {
    let what = format!("point {}", index + 1);
    let positions = tree::required(at, "positions", &what, findings);
    let positions = positions.and_then(|at| one_a_joint(&at, &what, "positions", joints, findings));
    let velocities = tree::optional(at, "velocities").filter(|at| !is_empty(at.node));
    let velocities = match velocities {
        Some(at) => Some(one_a_joint(&at, &what, "velocities", joints, findings)?),
        None => None,
    };
    let given = |key| tree::optional(at, key).is_some_and(|at| !is_empty(at.node));
    let has_more = given("accelerations") || given("effort");
    let time = tree::required(at, "time_from_start", &what, findings)?;
    let at_s = read_time(&time, &what, findings)?;
    let at = checked_time(&time, &what, at_s, before, findings)?;
    Some(JointPoint { at, positions: positions?, velocities, has_more })
}

fn is_empty(node: &Node) -> bool {
    matches!(node, Node::Null) || matches!(node, Node::List(items) if items.is_empty())
}

fn one_a_joint(
    at: &At<'_>,
    what: &str,
    list: &str,
    joints: usize,
    findings: &mut Reader,
) -> Option<Vec<f64>> {
    let values = tree::numbers(at, &format!("`{list}` of {what}"), findings)?;
    if values.len() == joints {
        return Some(values);
    }
    let message = format!("{what} has {} {list} for {joints} joints", values.len());
    findings.add(Code::ImportShape, at.place(), message, format!("{joints} numbers"), None);
    None
}

/// Reads a time: seconds as a number, or seconds and nanoseconds as in ROS 1 (`secs`, `nsecs`) and ROS 2 (`sec`, `nanosec`).
fn read_time(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<f64> {
    let Node::Map(_) = at.node else { return tree::number(at, &format!("the time of {what}"), findings) };
    let mut seconds = 0.0;
    let mut found = false;
    for (key, factor) in [("sec", 1.0), ("secs", 1.0), ("nanosec", 1e-9), ("nsecs", 1e-9)] {
        if let Some(part) = tree::optional(at, key) {
            seconds += tree::number(&part, &format!("`{key}` of {what}"), findings)? * factor;
            found = true;
        }
    }
    if !found {
        let expected = "seconds, or a map of `sec` and `nanosec`, or of `secs` and `nsecs`";
        findings.add(
            Code::MissingKey,
            at.place(),
            format!("the time of {what} has no seconds"),
            expected,
            None,
        );
    }
    found.then_some(seconds)
}

fn checked_time(
    at: &At<'_>,
    what: &str,
    at_s: f64,
    before: Option<&JointPoint>,
    findings: &mut Reader,
) -> Option<Span> {
    let Some(time) = keyframes::span(at_s) else {
        let expected = format!("a time from 0 to {} s", keyframes::SECONDS_MAX);
        findings.add(Code::ImportTime, at.place(), format!("{what} is at {at_s} s"), expected, None);
        return None;
    };
    let before = before.map(|point| point.at);
    if let Some((code, message, hint)) = before.and_then(|before| keyframes::check_later(before, time)) {
        let expected = format!("a time after {} s", before.map_or(0.0, keyframes::seconds));
        findings.add(code, at.place(), format!("{what}: {message}"), expected, Some(hint.into()));
        return None;
    }
    Some(time)
}
