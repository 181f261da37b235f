//! Reads Webots' `.motion` files. The header is `#WEBOTS_MOTION,V1.0,joint,..`. Each further line is a pose: its time, its name, and one
//! value per joint.

use urrcp::Span;

use downbeat_yaml::finding::Code;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::input::Input;
use super::sink::Sink;
use super::table::{Row, every_row};
use super::units::OF_JOINTS;
use super::{DeviceMotion, Keyframe, Motion, RobotMotion, keyframes};

const MAGIC: &str = "#WEBOTS_MOTION";
const VERSION: &str = "V1.0";
/// Number of columns (time and name) before the columns of the joints.
const AHEAD: usize = 2;

/// A joint with its motion so far. `untold` is the time of the last pose, if that pose has no value for the joint.
struct Joint {
    motion: DeviceMotion,
    untold: Option<Span>,
    gaps: usize,
}

/// Reads one file. Returns the motion of its only robot, as one scene.
pub(super) fn read(input: &Input, source: &Source, sink: &mut Sink) -> Vec<Motion> {
    let mut rows = every_row(source, ',').filter(|row| !row.text.trim().is_empty());
    let Some(mut header) = rows.next() else {
        sink.about(&source.name, Code::ImportTable, "the file is empty".into(), "a Webots motion file", None);
        return Vec::new();
    };
    header.drop_trailing(header.cells.len().saturating_sub(1));
    let Some(mut joints) = joints(&header, source, sink) else { return Vec::new() };
    let found = sink.findings.len();
    let mut before = None;
    for mut row in rows {
        row.drop_trailing(header.cells.len());
        read_pose(&row, &mut joints, &mut before, source, sink);
        let keyframes = joints.iter().map(|joint| joint.motion.keyframes.len()).sum::<usize>();
        if sink.is_full(source) || !sink.has_room_for(keyframes as f64) {
            break;
        }
    }
    if before.is_none() && sink.findings.len() == found {
        sink.about(
            &source.name,
            Code::NothingToDo,
            "the motion has no poses".into(),
            "one pose per line",
            None,
        );
    }
    note(&joints, source, sink);
    let devices = joints.into_iter().map(|joint| joint.motion).filter(|motion| !motion.keyframes.is_empty());
    let robot = RobotMotion { robot: input.robot.clone(), devices: devices.collect() };
    vec![Motion { scene: input.scene.clone(), robot }]
}

fn joints(header: &Row<'_>, source: &Source, sink: &mut Sink) -> Option<Vec<Joint>> {
    for (index, expected) in [MAGIC, VERSION].into_iter().enumerate() {
        let text = header.cells.get(index).map_or("", |cell| cell.text.as_ref());
        if text != expected {
            let message = format!("unexpected `{}` in the header", shortened(text));
            let hint = Some("the header must be #WEBOTS_MOTION,V1.0 and the names of the joints");
            sink.found(source, header.spot(index), Code::ImportTable, message, format!("`{expected}`"), hint);
            return None;
        }
    }
    let joint = |name: &str| Joint {
        motion: DeviceMotion {
            device: name.to_owned(),
            unit: OF_JOINTS.to_owned(),
            ..DeviceMotion::default()
        },
        untold: None,
        gaps: 0,
    };
    let joints: Vec<Joint> = header.cells[AHEAD..].iter().map(|cell| joint(&cell.text)).collect();
    if joints.is_empty() {
        let message = "the header lists no joints";
        sink.found(source, header.spot(AHEAD), Code::ImportTable, message, "at least one joint", None);
        return None;
    }
    Some(joints)
}

fn read_pose(
    row: &Row<'_>,
    joints: &mut [Joint],
    before: &mut Option<Span>,
    source: &Source,
    sink: &mut Sink,
) {
    if !row.has(AHEAD + joints.len(), source, sink) {
        return;
    }
    let text = row.cells[0].text.as_ref();
    let Some(at) = millis(text) else {
        let message = format!("the time is `{}`", shortened(text));
        let expected = "minutes:seconds:milliseconds";
        sink.found(source, row.spot(0), Code::ImportNumber, message, expected, None);
        return;
    };
    if let Some((code, message, hint)) = before.and_then(|before| keyframes::check_later(before, at)) {
        let expected = format!("a time after {} s", before.map_or(0.0, keyframes::seconds));
        sink.found(source, row.spot(0), code, message, expected, Some(hint));
        return;
    }
    *before = Some(at);
    for (index, joint) in joints.iter_mut().enumerate() {
        if row.cells[AHEAD + index].text == "*" {
            joint.skip(at);
            continue;
        }
        let what = format!("`{}`", shortened(&joint.motion.device));
        if let Some(value) = row.number(AHEAD + index, &what, source, sink) {
            joint.add(at, value + 0.0);
        }
    }
}

impl Joint {
    /// Handles a pose that has no value for the joint. For such a pose, Webots sends no command to the motor, so the joint keeps its
    /// position.
    fn skip(&mut self, at: Span) {
        self.gaps += 1;
        self.untold = Some(at);
    }

    fn add(&mut self, at: Span, value: f64) {
        if let (Some(until), Some(last)) = (self.untold.take(), self.motion.keyframes.last().copied()) {
            self.motion.keyframes.push(Keyframe { at: until, ..last });
        }
        self.motion.keyframes.push(Keyframe { at, value });
    }
}

fn note(joints: &[Joint], source: &Source, sink: &mut Sink) {
    let gaps: usize = joints.iter().map(|joint| joint.gaps).sum();
    if gaps > 0 {
        let gaps = downbeat_yaml::render::counted(gaps, "value");
        sink.note(format!(
            "{}: {gaps} written as `*`: the joint keeps its previous value until the next number",
            source.name
        ));
    }
    for joint in joints.iter().filter(|joint| joint.motion.keyframes.is_empty() && joint.gaps > 0) {
        let name = shortened(&joint.motion.device);
        sink.note(format!("{}: left out `{name}`, which has no values", source.name));
    }
    sink.note(format!(
        "{}: pose names are ignored; values are in rad or m, depending on the joint",
        source.name
    ));
}

/// Parses a time of the form `[[minutes:]seconds:]milliseconds`. Seconds may exceed 59, and milliseconds may exceed 999.
fn millis(text: &str) -> Option<Span> {
    let mut sum = 0_i64;
    let parts: Vec<&str> = text.trim().split(':').collect();
    if parts.len() > 3 {
        return None;
    }
    for (part, size) in parts.iter().rev().zip([1, 1_000, 60_000]) {
        let digits = !part.is_empty() && part.len() <= 9 && part.bytes().all(|byte| byte.is_ascii_digit());
        let number: i64 = digits.then(|| part.parse().ok())??;
        sum += number * size;
    }
    keyframes::span(sum as f64 / 1_000.0).map(|_| Span::from_millis(sum))
}
