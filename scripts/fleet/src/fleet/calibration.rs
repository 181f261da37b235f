//! Reads the key `calibrate` of a robot, which states how the latency of the robot's devices may be measured.

use std::collections::BTreeMap;

use urrcp::{ControlType, DeviceId, InitializationBlock, Limits, Span};

use super::declared::device_named;
use super::moves::is_positioned;
use super::sensors::{sensor, sensor_at};
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::{keys, words};
use downbeat_yaml::finding::{self, Code};
use downbeat_yaml::shown::shortened;

/// Default distance after which a movement is visible, as a fraction of the whole movement.
const VISIBLE_SHARE: f64 = 0.01;
/// Largest distance after which a movement may count as visible, as a fraction of the whole movement.
const VISIBLE_SHARE_MAX: f64 = 0.5;
const SENSOR_DELAY_MAX: Span = Span::from_millis(1_000);
const TAKEN_WORDS: [(&str, Taken); 3] =
    [("request", Taken::AtRequest), ("answer", Taken::AtAnswer), ("between", Taken::Between)];

keys! {
    /// The calibration of a device.
    pub(crate) struct CalibrateKeys {
        /// The sensor that shows the position of the device, in its unit; by default the device itself.
        sensor: kinds::DEVICE,
        /// Where the movement starts; by default at the current position.
        from: kinds::PLAIN_NUMBER,
        /// The small safe distance by which it may be moved from there, in its unit; not 0.
        #[required]
        by: kinds::PLAIN_NUMBER,
        /// When the sensor's value is sampled: when the robot receives the request, when it answers, or somewhere in between.
        taken: words!(TAKEN_WORDS),
        /// The age of the value at that time, which no round trip shows.
        sensor_delay: kinds::TIME,
        /// The distance after which the device has visibly started to move, in its unit. By default a hundredth of `by`.
        visible: kinds::POSITIVE,
    }
}

/// How a device may be moved to measure its latency, and the sensor that shows the motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The sensor that shows the position of the device, in the unit of the device.
    pub sensor: DeviceId,
    /// The position at which the movement starts, in the device's unit. `None` if it starts at the current position.
    pub from: Option<f64>,
    /// The small safe distance by which the device may be moved from the start, in its unit; not 0.
    pub by: f64,
    /// The time between request and response at which the sensor's value is sampled.
    pub taken: Taken,
    /// The age of the value when it is sampled. This age cannot be derived from measured round trips.
    pub sensor_delay: Span,
    /// The distance after which the device has visibly started to move, in its unit. Above 0, and at most half of `by`.
    pub visible: f64,
}

/// The time between request and response at which a sensor's value is sampled, as far as it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Taken {
    /// When the robot receives the request. The sensor's processing time passes between the sampling and the response.
    AtRequest,
    /// When the robot sends its response, because the robot waits for the sensor's next value.
    AtAnswer,
    /// At an unknown time between request and response. The uncertainty is half of the sensor's processing time.
    #[default]
    Between,
}

/// Reads `calibrate`, such as `{elbow: {sensor: elbow_angle, from: 0, by: 2}}`.
pub(super) fn read(
    findings: &mut Reader,
    at: &At<'_>,
    init: &InitializationBlock,
) -> BTreeMap<DeviceId, Calibration> {
    let mut all = BTreeMap::new();
    for (name, at) in findings.entries(at, "a map from each device to the movement that measures it") {
        let device = device_by_position(findings, name, &at, init);
        let keys = findings.keys(&at, "the calibration of a device");
        let Some(CalibrateKeys { sensor, from, by, taken, sensor_delay: delay, visible }) = keys else {
            continue;
        };
        let taken = taken.and_then(|at| findings.word(&at, &TAKEN_WORDS)).unwrap_or_default();
        let Some(device) = device else { continue };
        let limits = init
            .device(device.as_str())
            .and_then(|device| device.available_control_types.limits(ControlType::Position));
        let expected = "a number, in the unit of the device";
        let from_value = from.as_ref().and_then(|at| findings.number(at, expected));
        let by_value = by.as_ref().and_then(|at| findings.number(at, expected));
        if let (Some(at), Some(by), Some(limits)) = (&by, by_value, &limits) {
            check_movement(findings, at, from_value, by, limits);
        }
        let sensor_delay = delay.and_then(|at| sensor_delay(findings, &at)).unwrap_or_default();
        let visible = visible
            .zip(by_value.filter(|by| *by != 0.0))
            .and_then(|(at, by)| visible_amount(findings, &at, by));
        let Some(sensor) = sensor_of(findings, sensor.as_ref(), &device, &at, init) else { continue };
        let Some(by) = by_value else { continue };
        let visible = visible.unwrap_or(by.abs() * VISIBLE_SHARE);
        all.insert(device, Calibration { sensor, from: from_value, by, taken, sensor_delay, visible });
    }
    all
}

/// Checks that the movement of a calibration is not 0 and stays within the limits of the device. If the start of the movement is not
/// given, checks only its length.
fn check_movement(findings: &mut Reader, at: &At<'_>, from: Option<f64>, by: f64, limits: &Limits) {
    let (least, largest) = (limits.min_value, limits.max_value);
    let within = least..=largest;
    let reached = from.and_then(|from| [from, from + by].into_iter().find(|end| !within.contains(end)));
    if let Some(reached) = reached {
        let message = format!("the movement would reach {reached}, which is outside the range of the device");
        let expected = format!("{least} to {largest}, the declared range of the device");
        findings.add(Code::OutOfRange, at.place(), message, expected, None);
    } else if by.abs() > largest - least {
        let message = format!("the device cannot move by {by}");
        let expected = format!("a movement within {least} to {largest}, the declared range of the device");
        findings.add(Code::OutOfRange, at.place(), message, expected, None);
    } else if by == 0.0 {
        let hint = Some("choose a visible movement without obstacles in its way".to_owned());
        let message = "the device would not move";
        findings.add(Code::WrongType, at.place(), message, "a number other than 0", hint);
    }
}

fn sensor_delay(findings: &mut Reader, at: &At<'_>) -> Option<Span> {
    let delay = findings.duration(at)?;
    if delay <= SENSOR_DELAY_MAX {
        return Some(delay);
    }
    let message = format!("{delay} is too long for a sensor delay");
    findings.add(Code::BadDuration, at.place(), message, format!("at most {SENSOR_DELAY_MAX}"), None);
    None
}

fn visible_amount(findings: &mut Reader, at: &At<'_>, by: f64) -> Option<f64> {
    let most = by.abs() * VISIBLE_SHARE_MAX;
    let expected = "a number above 0, in the unit of the device";
    let visible = findings.positive(at, expected)?;
    if visible <= most {
        return Some(visible);
    }
    let message = format!("{visible} is more than half of the movement of {by}");
    let hint = Some("`visible` is how far the device has moved when the movement becomes visible".to_owned());
    findings.add(Code::OutOfRange, at.place(), message, format!("at most {most}"), hint);
    None
}

/// Returns the id of the named device if it is driven by position. Otherwise, adds a finding at the key that names the device.
pub(super) fn device_by_position(
    findings: &mut Reader,
    name: &str,
    at: &At<'_>,
    init: &InitializationBlock,
) -> Option<DeviceId> {
    let driven =
        || init.devices.iter().filter(|device| is_positioned(device)).map(|device| device.id.as_str());
    let found =
        device_named(init, name).filter(|device| is_positioned(device)).map(|device| device.id.clone());
    if found.is_none() {
        let message = format!("the robot has no device `{}` that is driven by position", shortened(name));
        let (expected, hint) = (finding::one_of(driven()), findings.did_you_mean(name, driven()));
        findings.add(Code::UnknownDevice, at.key_place(), message, expected, hint);
    }
    found
}

/// Returns the id of the named sensor or, if no sensor is named, of the device itself.
pub(super) fn sensor_of(
    findings: &mut Reader,
    named: Option<&At<'_>>,
    device: &DeviceId,
    at: &At<'_>,
    init: &InitializationBlock,
) -> Option<DeviceId> {
    let Some(named) = named else { return sensor(findings, device.as_str(), at, init) };
    let name = findings.name(named, "the id of a sensor")?;
    sensor_at(findings, &name, named.place(), init)
}
