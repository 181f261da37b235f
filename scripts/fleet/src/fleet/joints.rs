//! Reads the keys `joints` and `tip` of a body, which describe its arm.

use urrcp::InitializationBlock;

use super::body::{ANGLES, LENGTHS, fixed, length, of_device};
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys::Kind;
use downbeat_reader::{keys, words};
use downbeat_space::space::{Coordinate, Joint, JointKind};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;

/// Maximum number of joints of a body. It is limited because each joint is compared with all joints of the other bodies.
pub(super) const JOINTS_MAX: usize = 64;
const KINDS: [(&str, JointKind); 2] =
    [("revolute", JointKind::Revolute), ("prismatic", JointKind::Prismatic)];
const AXES: [(&str, [f64; 3]); 6] = [
    ("x", [1.0, 0.0, 0.0]),
    ("y", [0.0, 1.0, 0.0]),
    ("z", [0.0, 0.0, 1.0]),
    ("-x", [-1.0, 0.0, 0.0]),
    ("-y", [0.0, -1.0, 0.0]),
    ("-z", [0.0, 0.0, -1.0]),
];

keys! {
    /// A joint, with the link from it to the next joint or to the tip.
    pub(crate) struct JointKeys as "joint" {
        /// The device that moves it.
        device: kinds::DEVICE,
        /// The angle or the displacement of a joint that does not move, in degrees or metres.
        value: kinds::PLAIN_NUMBER,
        /// Degrees, or metres, per unit of the device.
        scale: kinds::PLAIN_NUMBER,
        /// The position at the device's zero, in degrees or metres.
        offset: kinds::PLAIN_NUMBER,
        /// The axis about which it turns or along which it slides, in its own frame.
        #[required]
        axis: Kind::AnyOf(&[&words!(AXES), &kinds::VECTOR]),
        /// Its origin in the frame of the previous link, in metres.
        at: kinds::VECTOR,
        /// Roll, pitch and yaw of its frame in that of the previous link, about fixed axes, in degrees.
        rpy: kinds::VECTOR,
        /// Whether it turns or slides; it turns by default.
        kind: words!(KINDS),
        /// The radius of the capsule about its link, in metres.
        #[required]
        radius: kinds::POSITIVE,
    }
    also {"oneOf": [{"required": ["device"]}, {"required": ["value"]}]}
}

/// Reads the joints from the base to the tip of an arm, and the position of the tip.
pub(super) fn read_arm(
    findings: &mut Reader,
    body: &At<'_>,
    [joints, tip]: [Option<At<'_>>; 2],
    init: &InitializationBlock,
) -> Option<(Vec<Joint>, [f64; 3])> {
    let end = "the end of the last link, in metres, such as [0, 0, 0.1]";
    match (joints, tip) {
        (None, None) => Some((Vec::new(), [0.0; 3])),
        (None, Some(tip)) => {
            let message = "`tip` needs `joints`";
            findings.add(Code::MissingKey, tip.key_place(), message, "a key `joints`", None);
            None
        }
        (Some(joints), tip) => {
            let all = read_joints(findings, &joints, init);
            if tip.is_none() {
                let message = "the body has no `tip`".to_owned();
                findings.add(Code::MissingKey, body.place(), message, "a key `tip`", Some(end.to_owned()));
            }
            let tip = tip.and_then(|at| vector(findings, &at, end));
            all.zip(tip)
        }
    }
}

fn read_joints(findings: &mut Reader, at: &At<'_>, init: &InitializationBlock) -> Option<Vec<Joint>> {
    let all = findings.list(at, "a list of joints, from the base to the tip");
    let many = all.len();
    if matches!(at.node, Node::List(_)) && !(1..=JOINTS_MAX).contains(&many) {
        let code = if many == 0 { Code::WrongType } else { Code::TooMuch };
        let message = format!("the arm has {}", downbeat_yaml::render::counted(many, "joint"));
        findings.add(code, at.place(), message, format!("1 to {JOINTS_MAX} joints"), None);
        return None;
    }
    let joints: Vec<Option<Joint>> =
        all.iter().enumerate().map(|(index, at)| read_joint(findings, index, at, init)).collect();
    joints.into_iter().collect()
}

/// Reads a joint, such as `{device: elbow, axis: y, at: [0, 0, 0.425], radius: 0.05}`.
fn read_joint(findings: &mut Reader, index: usize, at: &At<'_>, init: &InitializationBlock) -> Option<Joint> {
    let what = format!("joint {}", index + 1);
    let keys: JointKeys<'_> = findings.keys(at, &what)?;
    let kind = keys.kind.map_or(Some(JointKind::default()), |at| findings.word(&at, &KINDS));
    let name = keys.device.and_then(|at| match at.node {
        Node::Text(text) => Some(text.clone()),
        _ => None,
    });
    let value = read_value(findings, at, &keys, kind.unwrap_or_default(), &what, init);
    let axis = keys.axis.and_then(|at| read_axis(findings, &at));
    let place = "the position of the joint in the frame of the previous link, in metres, such as [0, 0, 0.4]";
    let xyz = keys.at.map_or(Some([0.0; 3]), |at| vector(findings, &at, place));
    let turned = "roll, pitch and yaw in degrees, such as [0, 90, 0]";
    let rpy = keys.rpy.map_or(Some([0.0; 3]), |at| vector(findings, &at, turned));
    let radius = keys.radius.and_then(|at| length(findings, &at));
    Some(Joint {
        name: name.unwrap_or(what),
        kind: kind?,
        xyz: xyz?,
        rpy: rpy?.map(f64::to_radians),
        axis: axis?,
        value: value?,
        radius: radius?,
    })
}

/// Reads the position of a joint: either a device sets it, or it is fixed.
fn read_value(
    findings: &mut Reader,
    at: &At<'_>,
    keys: &JointKeys<'_>,
    kind: JointKind,
    what: &str,
    init: &InitializationBlock,
) -> Option<Coordinate> {
    let units: &[(&str, f64)] = match kind {
        JointKind::Revolute => &ANGLES,
        JointKind::Prismatic => &LENGTHS,
    };
    match (&keys.device, &keys.value) {
        (Some(device), None) => of_device(findings, device, [keys.scale, keys.offset], init, units),
        (None, Some(value)) => fixed(findings, value, units),
        (device, _) => {
            let message = match device {
                Some(_) => format!("{what} has both a device and a value"),
                None => format!("{what} has neither a device nor a value"),
            };
            let expected = "`device`, or `value` for a joint that does not move";
            findings.add(Code::MissingKey, at.place(), message, expected, None);
            None
        }
    }
}

/// Reads an axis, such as `z`, `-z` or `[0, 0.6, 0.8]`, as a unit vector.
fn read_axis(findings: &mut Reader, at: &At<'_>) -> Option<[f64; 3]> {
    let Node::List(_) = at.node else { return findings.word(at, &AXES) };
    let expected = "x, y, z, -x, -y, -z, or a vector such as [0, 0.6, 0.8]";
    let axis = vector(findings, at, expected)?;
    let long = axis.iter().map(|part| part * part).sum::<f64>().sqrt();
    if !(long >= 1e-9 && long.is_finite()) {
        let message = format!("an axis of length {long} has no direction");
        findings.add(Code::WrongType, at.place(), message, expected, None);
        return None;
    }
    Some(axis.map(|part| part / long))
}

/// Reads a list of three numbers.
pub(super) fn vector(findings: &mut Reader, at: &At<'_>, expected: &str) -> Option<[f64; 3]> {
    let parts = findings.list(at, expected);
    let numbers: Vec<f64> = parts.iter().filter_map(|part| findings.number(part, expected)).collect();
    if parts.len() != 3 && matches!(at.node, Node::List(_)) {
        let message = format!("found {} entries", parts.len());
        findings.add(Code::WrongType, at.place(), message, expected, None);
    }
    <[f64; 3]>::try_from(numbers).ok().filter(|_| parts.len() == 3)
}
