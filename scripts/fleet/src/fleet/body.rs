//! Reads the key `space` of a fleet, and the key `body` of a robot.

use std::collections::BTreeMap;

use urrcp::{Device, InitializationBlock};

use super::declared::device_named;
use super::drive::{DriveKeys, read_drive};
use super::joints::{JointKeys, read_arm};
use super::urdf::{UrdfKeys, Urdfs};
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys::Kind;
use downbeat_reader::{keys, named};
use downbeat_space::space::{Body, Coordinate, Drive, Joint, Shape, Space, Volume};
use downbeat_yaml::finding::{Code, one_of};
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

keys! {
    /// Requirements on the space that all robots share.
    pub(crate) struct SpaceKeys as "space" {
        /// Minimum distance between two bodies, from surface to surface, in metres.
        distance: kinds::POSITIVE,
        /// The volume that no body may leave.
        keep_in: VolumeKeys::KIND,
        /// The volumes that no body may enter, by name.
        keep_out: Kind::Entries(&VolumeKeys::KIND),
    }
}

keys! {
    /// A box with sides parallel to the axes, infinite along the axes that it leaves out.
    pub(crate) struct VolumeKeys as "volume" {
        /// The least and the largest x, in metres.
        x: Kind::List(&kinds::PLAIN_NUMBER, 2..=2),
        /// The least and the largest y, in metres.
        y: Kind::List(&kinds::PLAIN_NUMBER, 2..=2),
        /// The least and the largest z, in metres.
        z: Kind::List(&kinds::PLAIN_NUMBER, 2..=2),
    }
}

keys! {
    /// The body of a robot: the meaning of its devices in space, and its size.
    pub(crate) struct BodyKeys as "body" {
        /// Its x.
        x: COORDINATE,
        /// Its y.
        y: COORDINATE,
        /// Its height.
        z: COORDINATE,
        /// Its angle about z, from x to y.
        yaw: COORDINATE,
        drive: DriveKeys::KIND,
        /// The radius of a ball that encloses it, in metres; with `urdf` that of its links.
        radius: kinds::POSITIVE,
        /// Length, width and height of a box that encloses it and turns with it, in metres.
        size: Kind::List(&kinds::POSITIVE, 3..=3),
        /// Its arm: the joints from the base to the tip.
        joints: Kind::List(&JointKeys::KIND, 1..=64),
        /// The end of the last link in the frame of the last joint, in metres.
        tip: kinds::VECTOR,
        /// The URDF of its arm, relative to the fleet file, instead of `joints` and `tip`.
        urdf: kinds::FILE,
        /// The link of the URDF at which the arm ends.
        end: kinds::TEXT,
        /// The device of each joint of the URDF, or a number in degrees or metres if the joint does not move.
        devices: Kind::Entries(&kinds::DEVICE),
        /// Its largest speed in any direction, in metres per second.
        speed: kinds::POSITIVE,
        /// Its largest acceleration in any direction, in metres per second squared.
        acceleration: kinds::POSITIVE,
    }
    also {"allOf": [{"not": {"required": ["radius", "size"], "not": {"required": ["urdf"]}}}, {"not": {"required": ["urdf", "joints"]}}, {"not": {"required": ["drive", "x"]}}, {"not": {"required": ["drive", "y"]}}, {"not": {"required": ["drive", "yaw"]}}], "dependentRequired": {"joints": ["tip"], "tip": ["joints"], "end": ["urdf"], "devices": ["urdf"]}}
}

keys! {
    /// A device with a scale and an offset.
    pub(crate) struct CoordinateKeys {
        /// A device of the robot.
        #[required]
        device: kinds::DEVICE,
        /// Metres, or degrees, per unit of the device.
        scale: kinds::PLAIN_NUMBER,
        /// The position at the device's zero, in metres or degrees.
        offset: kinds::PLAIN_NUMBER,
    }
}

named! {
    /// A device, a number in metres or degrees, or a device with a scale.
    pub(crate) static COORDINATE = Kind::AnyOf(&[&kinds::DEVICE, &CoordinateKeys::KIND]);
}

/// Units of length, each with its size in metres.
pub(super) const LENGTHS: [(&str, f64); 3] = [("m", 1.0), ("cm", 0.01), ("mm", 0.001)];
/// Units of angle, each with its size in radians.
pub(super) const ANGLES: [(&str, f64); 3] =
    [("rad", 1.0), ("deg", std::f64::consts::PI / 180.0), ("°", std::f64::consts::PI / 180.0)];

pub(super) fn read_space(findings: &mut Reader, at: &At<'_>) -> Space {
    let Some(SpaceKeys { distance, keep_in, keep_out }) = findings.keys(at, "the space") else {
        return Space::default();
    };
    let mut volumes = BTreeMap::new();
    if let Some(at) = keep_out {
        for (name, at) in findings.entries(&at, "a map from each name to a volume that no body may enter") {
            volumes.extend(volume(findings, &at).map(|volume| (name.to_owned(), volume)));
        }
    }
    Space {
        distance: distance.and_then(|at| length(findings, &at)),
        keep_in: keep_in.and_then(|at| volume(findings, &at)),
        keep_out: volumes,
    }
}

/// Reads a volume, such as `{x: [-2, 2], z: [0, 3]}`.
fn volume(findings: &mut Reader, at: &At<'_>) -> Option<Volume> {
    let VolumeKeys { x, y, z } = findings.keys(at, "a volume")?;
    let (mut volume, mut sound) = (Volume::default(), true);
    for (axis, side) in [x, y, z].into_iter().enumerate() {
        let Some(side) = side else { continue };
        let expected = "the minimum and maximum coordinate in metres, such as [-2, 2.5]";
        let ends = findings.list(&side, expected);
        let numbers: Vec<f64> = ends.iter().filter_map(|end| findings.number(end, expected)).collect();
        match *numbers {
            [least, most] if ends.len() == 2 && least < most => {
                (volume.least[axis], volume.most[axis]) = (least, most);
            }
            _ if numbers.len() < ends.len() || !matches!(side.node, Node::List(_)) => sound = false,
            _ => {
                let message = match *numbers {
                    [least, most] => format!("the minimum {least} is not less than the maximum {most}"),
                    _ => format!("found {} entries", ends.len()),
                };
                let swapped = match *numbers {
                    [least, most] if least > most => Some(format!("write `[{most}, {least}]`")),
                    _ => None,
                };
                findings.add(Code::WrongType, side.place(), message, expected, swapped);
                sound = false;
            }
        }
    }
    sound.then_some(volume)
}

pub(super) fn length(findings: &mut Reader, at: &At<'_>) -> Option<f64> {
    findings.positive(at, "a length above 0 in metres")
}

pub(super) fn read_body(
    findings: &mut Reader,
    at: &At<'_>,
    init: &InitializationBlock,
    urdfs: &mut Urdfs,
) -> Option<Body> {
    let keys: BodyKeys<'_> = findings.keys(at, "a body")?;
    let mut coordinate = |at: Option<At<'_>>, units: &[(&str, f64)]| match at {
        Some(at) => read_coordinate(findings, &at, init, units),
        None => Some(Coordinate::Fixed(0.0)),
    };
    let (x, y, z) =
        (coordinate(keys.x, &LENGTHS), coordinate(keys.y, &LENGTHS), coordinate(keys.z, &LENGTHS));
    let yaw = coordinate(keys.yaw, &ANGLES);
    let drive = keys.drive.map(|at| read_drive(findings, &at, init));
    if drive.is_some() {
        tell_placed(findings, [("x", keys.x), ("y", keys.y), ("yaw", keys.yaw)]);
    }
    let shape = read_shape(findings, &keys);
    let arm = match keys.urdf {
        Some(urdf) => read_urdf(findings, urdf, &keys, init, urdfs).map(|joints| (joints, [0.0; 3])),
        None => {
            tell_without_urdf(findings, [("end", keys.end), ("devices", keys.devices)]);
            read_arm(findings, at, [keys.joints, keys.tip], init)
        }
    };
    let mut rate = |at: Option<At<'_>>, expected| at.and_then(|at| findings.positive(&at, expected));
    let speed = rate(keys.speed, "a speed above 0 in metres per second");
    let acceleration = rate(keys.acceleration, "an acceleration above 0 in metres per second squared");
    let (joints, tip) = arm?;
    let (drive, mut coordinates) = (drive.map_or(Some(None), |drive| drive.map(Some))?, [x?, y?, z?, yaw?]);
    if let Some(Drive { start, .. }) = &drive {
        [coordinates[0], coordinates[1], coordinates[3]] = start.map(Coordinate::Fixed);
    }
    Some(Body { coordinates, drive, shape: shape?, joints, tip, speed, acceleration })
}

fn read_shape(findings: &mut Reader, keys: &BodyKeys<'_>) -> Option<Shape> {
    // With a URDF, the key `radius` applies to the links.
    let radius = keys.radius.filter(|_| keys.urdf.is_none());
    if let (Some(radius), Some(_)) = (&radius, &keys.size) {
        let hint = Some("remove one of them".to_owned());
        let message = "`radius` and `size` cannot be combined";
        findings.add(
            Code::WrongType,
            radius.key_place(),
            message,
            "`radius` for a ball, or `size` for a box",
            hint,
        );
    }
    match (radius, keys.size) {
        (_, Some(at)) => read_box(findings, &at),
        (Some(at), None) => length(findings, &at).map(|radius| Shape::Ball { radius }),
        (None, None) => Some(Shape::Ball { radius: 0.0 }),
    }
}

/// Reads an arm from a URDF file. The last link of the arm has length 0.
fn read_urdf(
    findings: &mut Reader,
    urdf: At<'_>,
    keys: &BodyKeys<'_>,
    init: &InitializationBlock,
    urdfs: &mut Urdfs,
) -> Option<Vec<Joint>> {
    for (name, at) in [("joints", keys.joints), ("tip", keys.tip)] {
        let Some(at) = at else { continue };
        let message = format!("the URDF already defines `{name}`");
        findings.add(Code::WrongType, at.key_place(), message, "`urdf`, or `joints` and `tip`", None);
    }
    let radius = keys.radius.map(|at| length(findings, &at));
    let arm = UrdfKeys { urdf, end: keys.end, devices: keys.devices, radius: radius.flatten() };
    if radius == Some(None) { None } else { urdfs.read_arm(findings, &arm, init) }
}

fn tell_without_urdf(findings: &mut Reader, keys: [(&str, Option<At<'_>>); 2]) {
    for (name, at) in keys.into_iter().filter_map(|(name, key)| Some((name, key?))) {
        let message = format!("`{name}` needs an arm from a URDF");
        let hint = Some(format!("remove `{name}`, or add the path of the URDF as `urdf`"));
        findings.add(Code::MissingKey, at.key_place(), message, "a key `urdf`", hint);
    }
}

/// Reports coordinates of the body that are given although its drive already determines them.
fn tell_placed(findings: &mut Reader, keys: [(&str, Option<At<'_>>); 3]) {
    for (name, at) in keys.into_iter().filter_map(|(name, key)| Some((name, key?))) {
        let message = format!("the drive already determines `{name}`");
        let hint = Some("write the start position of the body as `start` in `drive`".to_owned());
        findings.add(Code::WrongType, at.key_place(), message, "`drive` without x, y and yaw", hint);
    }
}

/// Reads the sides of a box, such as `[0.4, 0.3, 0.2]`.
fn read_box(findings: &mut Reader, at: &At<'_>) -> Option<Shape> {
    let expected = "length, width and height above 0 in metres, such as [0.4, 0.3, 0.2]";
    let sides = findings.list(at, expected);
    let size: Vec<f64> = sides.iter().filter_map(|side| findings.positive(side, expected)).collect();
    if sides.len() != 3 && matches!(at.node, Node::List(_)) {
        let message = format!("found {} entries", sides.len());
        findings.add(Code::WrongType, at.place(), message, expected, None);
    }
    <[f64; 3]>::try_from(size).ok().filter(|_| sides.len() == 3).map(|size| Shape::Box { size })
}

/// Reads a coordinate: `x`, `1.5`, or `{device: x, scale: 0.001, offset: 1.5}`. A number is in metres, or in degrees for an angle.
fn read_coordinate(
    findings: &mut Reader,
    at: &At<'_>,
    init: &InitializationBlock,
    units: &[(&str, f64)],
) -> Option<Coordinate> {
    if let Node::Number(_) = at.node {
        return fixed(findings, at, units);
    }
    let Node::Map(_) = at.node else {
        findings.text(at, "a device, a number, or a map with a device")?;
        return of_device(findings, at, [None; 2], init, units);
    };
    let CoordinateKeys { device, scale, offset } = findings.keys(at, "a coordinate")?;
    of_device(findings, &device?, [scale, offset], init, units)
}

/// Returns the factor that converts values as users write them to the base unit: from degrees to radians for angles, otherwise 1.
fn own_unit(units: &[(&str, f64)]) -> f64 {
    units.iter().find(|(unit, _)| ["deg", "deg/s"].contains(unit)).map_or(1.0, |(_, scale)| *scale)
}

/// Reads a fixed coordinate: a number in metres, or in degrees for an angle.
pub(super) fn fixed(findings: &mut Reader, at: &At<'_>, units: &[(&str, f64)]) -> Option<Coordinate> {
    let value = findings.number(at, "a number in metres, or in degrees")?;
    Some(Coordinate::Fixed(value * own_unit(units)))
}

/// Returns a coordinate that a device sets. Its scale is the given one or, by default, the size of the device's unit.
pub(super) fn of_device(
    findings: &mut Reader,
    name: &At<'_>,
    [scale, offset]: [Option<At<'_>>; 2],
    init: &InitializationBlock,
    units: &[(&str, f64)],
) -> Option<Coordinate> {
    let text = findings.text(name, "a device of the robot")?;
    let device = device(findings, name, &text, init)?;
    let scale = match scale {
        Some(at) => {
            findings.number(&at, "the number of metres or degrees per unit of the device")? * own_unit(units)
        }
        None => scale_of(findings, name, device, units)?,
    };
    let offset = match offset {
        Some(at) => {
            findings.number(&at, "the position of the device's zero, in metres or degrees")? * own_unit(units)
        }
        None => 0.0,
    };
    Some(Coordinate::Device { device: device.id.clone(), scale, offset })
}

/// Returns a coordinate that the named device sets. Its scale is the size of the device's unit.
pub(super) fn by_name(
    findings: &mut Reader,
    at: &At<'_>,
    name: &str,
    init: &InitializationBlock,
    units: &[(&str, f64)],
) -> Option<Coordinate> {
    let device = device(findings, at, name, init)?;
    let scale = scale_of(findings, at, device, units)?;
    Some(Coordinate::Device { device: device.id.clone(), scale, offset: 0.0 })
}

fn device<'a>(
    findings: &mut Reader,
    at: &At<'_>,
    name: &str,
    init: &'a InitializationBlock,
) -> Option<&'a Device> {
    let moves = |device: &&Device| device.available_control_types.sensor().is_none();
    let found = device_named(init, name).filter(moves);
    if found.is_none() {
        let known = || init.devices.iter().filter(moves).map(|device| device.id.as_str());
        let message = format!("the robot has no device `{}` that moves", shortened(name));
        let metres = name.trim_end_matches('m').trim();
        let fixed = metres.parse::<f64>().ok().filter(|metres| metres.is_finite());
        let fixed = fixed.map(|_| format!("write a fixed coordinate as a number in metres: `{metres}`"));
        let hint = fixed.or_else(|| findings.did_you_mean(name, known()));
        findings.add(Code::UnknownDevice, at.place(), message, one_of(known()), hint);
    }
    found
}

fn scale_of(findings: &mut Reader, at: &At<'_>, device: &Device, units: &[(&str, f64)]) -> Option<f64> {
    let unit = device.unit.as_ref().map(urrcp::Label::as_str).unwrap_or_default();
    let known = units.iter().find(|(known, _)| *known == unit);
    if known.is_none() {
        let names = one_of(units.iter().map(|(unit, _)| *unit));
        let message = format!("the device `{}` has the unsupported unit `{}`", device.id, shortened(unit));
        let hint = format!("add the size of one unit, as in `{{device: {}, scale: 0.001}}`", device.id);
        findings.add(Code::UnknownWord, at.place(), message, names, Some(hint));
    }
    known.map(|(_, scale)| *scale)
}
