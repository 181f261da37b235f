//! Reads the key `drive` of a body, which lists the devices that determine the body's speed.

use urrcp::InitializationBlock;

use super::body::{length, of_device};
use super::declared::device_named;
use super::joints::vector;
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys::Kind;
use downbeat_reader::{keys, named};
use downbeat_space::space::{Coordinate, Drive, Steering};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;

keys! {
    /// The devices that drive it by speed: two wheels, or a speed and a turn.
    pub(crate) struct DriveKeys as "drive" {
        /// The left wheel.
        left: SIGNAL,
        /// The right wheel.
        right: SIGNAL,
        /// The radius of the wheels in metres, if the units of their devices are angles per second.
        wheel_radius: kinds::POSITIVE,
        /// The distance between the wheels, in metres.
        track: kinds::POSITIVE,
        /// The forward speed.
        speed: SIGNAL,
        /// The speed of turning to the left.
        turn: SIGNAL,
        /// x and y in metres and yaw in degrees at the start of the first act.
        start: kinds::VECTOR,
    }
    also {"oneOf": [{"required": ["left", "right", "track"]}, {"required": ["speed", "turn"]}]}
}

keys! {
    /// A device with a scale.
    pub(crate) struct SignalKeys {
        /// A device of the robot.
        #[required]
        device: kinds::DEVICE,
        /// Metres per second, or degrees per second, per unit of the device.
        scale: kinds::PLAIN_NUMBER,
    }
}

named! {
    /// A device, or a device with a scale.
    pub(crate) static SIGNAL = Kind::AnyOf(&[&kinds::DEVICE, &SignalKeys::KIND]);
}

/// Units of speed, each with its size in metres per second.
const SPEEDS: [(&str, f64); 3] = [("m/s", 1.0), ("cm/s", 0.01), ("mm/s", 0.001)];
const DEGREE: f64 = std::f64::consts::PI / 180.0;
/// Units of angular speed, each with its size in radians per second.
const TURNS: [(&str, f64); 4] =
    [("rad/s", 1.0), ("deg/s", DEGREE), ("°/s", DEGREE), ("rpm", std::f64::consts::TAU / 60.0)];

/// Reads a drive, such as `{left: left_wheel, right: right_wheel, track: 0.3, start: [0, 0, 90]}`.
pub(super) fn read_drive(findings: &mut Reader, at: &At<'_>, init: &InitializationBlock) -> Option<Drive> {
    let keys: DriveKeys<'_> = findings.keys(at, "a drive")?;
    let expected = "x and y in metres and yaw in degrees, such as [1, 0, 90]";
    let start = keys.start.map_or(Some([0.0; 3]), |at| vector(findings, &at, expected));
    let steering = match (keys.left.or(keys.right), keys.speed.or(keys.turn)) {
        (Some(_), None) => read_wheels(findings, at, &keys, init),
        (None, Some(_)) => read_twist(findings, at, &keys, init),
        (wheels, _) => {
            let message = match wheels {
                Some(_) => "the drive has both wheels and a `speed` or `turn`",
                None => "the drive has neither wheels nor `speed` and `turn`",
            };
            let expected = "`left`, `right` and `track`, or `speed` and `turn`";
            findings.add(Code::MissingKey, at.place(), message, expected, None);
            None
        }
    };
    let [x, y, yaw] = start?;
    Some(Drive { steering: steering?, start: [x, y, yaw.to_radians()] })
}

fn read_wheels(
    findings: &mut Reader,
    at: &At<'_>,
    keys: &DriveKeys<'_>,
    init: &InitializationBlock,
) -> Option<Steering> {
    // A wheel that turns by one radian rolls by the length of its radius.
    let radius = keys.wheel_radius.map(|at| length(findings, &at));
    let needs_radius = radius.is_none() && tell_turning(findings, at, [keys.left, keys.right], init);
    let turning = |radius: f64| TURNS.map(|(unit, scale)| (unit, scale * radius)).to_vec();
    let units = match radius {
        None if !needs_radius => SPEEDS.to_vec(),
        radius => turning(radius.flatten().unwrap_or(1.0)),
    };
    let [left, right] = [("left", keys.left), ("right", keys.right)].map(|(name, key)| {
        required(findings, at, name, key).and_then(|at| signal(findings, &at, &units, init))
    });
    let track = required(findings, at, "track", keys.track).and_then(|at| length(findings, &at));
    (radius != Some(None) && !needs_radius).then_some(Steering::Wheels {
        left: left?,
        right: right?,
        track: track?,
    })
}

/// Reports, in one finding, wheels whose devices have units of angular speed although the drive has no wheel radius.
fn tell_turning(
    findings: &mut Reader,
    at: &At<'_>,
    wheels: [Option<At<'_>>; 2],
    init: &InitializationBlock,
) -> bool {
    let unit = |wheel: &At<'_>| match wheel.node {
        Node::Text(name) => device_named(init, name)?.unit.as_ref().map(urrcp::Label::as_str),
        _ => None,
    };
    let units = wheels.iter().flatten().filter_map(unit);
    let turning = units.into_iter().find(|unit| TURNS.iter().any(|(known, _)| known == unit));
    if let Some(unit) = turning {
        let message = format!("the wheels are driven in {unit}, but the drive has no `wheel_radius`");
        findings.add(Code::MissingKey, at.place(), message, "the radius of the wheels in metres", None);
    }
    turning.is_some()
}

fn read_twist(
    findings: &mut Reader,
    at: &At<'_>,
    keys: &DriveKeys<'_>,
    init: &InitializationBlock,
) -> Option<Steering> {
    for (name, key) in [("wheel_radius", keys.wheel_radius), ("track", keys.track)] {
        if let Some(key) = key {
            let message = format!("`{name}` applies only to wheels");
            let hint = Some(format!("remove `{name}`"));
            findings.add(Code::UnknownKey, key.key_place(), message, "`speed` and `turn`", hint);
        }
    }
    let speed = required(findings, at, "speed", keys.speed);
    let speed = speed.and_then(|at| signal(findings, &at, &SPEEDS, init));
    let turn = required(findings, at, "turn", keys.turn);
    let turn = turn.and_then(|at| signal(findings, &at, &TURNS, init));
    Some(Steering::Twist { speed: speed?, turn: turn? })
}

fn required<'a>(findings: &mut Reader, at: &At<'_>, name: &str, key: Option<At<'a>>) -> Option<At<'a>> {
    if key.is_none() && !findings.is_miswritten(at, name) {
        let message = format!("the drive has no `{name}`");
        findings.add(Code::MissingKey, at.place(), message, format!("a key `{name}`"), None);
    }
    key
}

/// Reads a device that drives the body: `left_wheel`, or `{device: left_engine, scale: 0.01}`.
fn signal(
    findings: &mut Reader,
    at: &At<'_>,
    units: &[(&str, f64)],
    init: &InitializationBlock,
) -> Option<Coordinate> {
    let Node::Map(_) = at.node else {
        findings.text(at, "a device, or a map with a device")?;
        return of_device(findings, at, [None; 2], init, units);
    };
    let SignalKeys { device, scale } = findings.keys(at, "a signal")?;
    of_device(findings, &device?, [scale, None], init, units)
}
