//! How the latency of a robot's devices may be measured: its key `calibrate`.

use std::collections::BTreeMap;

use urrcp::{ControlType, Device, DeviceId, InitializationBlock};

use super::moves::is_positioned;
use super::sensor;
use crate::fields::{At, Reader};
use crate::finding::{self, Code};
use crate::node::shortened;

const CALIBRATE_KEYS: [&str; 4] = ["sensor", "from", "by", "taken"];
const TAKEN_WORDS: [(&str, Taken); 3] =
    [("request", Taken::AtRequest), ("answer", Taken::AtAnswer), ("between", Taken::Between)];

/// How a device may be moved to measure its latency, and which sensor shows that.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The sensor that shows where the device is, in the unit of the device.
    pub sensor: DeviceId,
    /// Where the movement begins; `None`: where the device is.
    pub from: Option<f64>,
    /// The small safe amount by which the device may be moved from there, in its unit; not 0.
    pub by: f64,
    /// When the sensor's value is taken.
    pub taken: Taken,
}

/// Where between request and answer the value of a sensor is taken, as far as that is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Taken {
    /// When the robot receives the request: the sensor's delay lies between the value and the answer.
    AtRequest,
    /// When the robot sends its answer: it waits for the next value.
    AtAnswer,
    /// Anywhere in between: half of the sensor's delay is the uncertainty.
    #[default]
    Between,
}

/// `{elbow: {sensor: elbow_angle, from: 0, by: 2}}`
pub(super) fn read(
    findings: &mut Reader,
    at: &At<'_>,
    init: &InitializationBlock,
) -> BTreeMap<DeviceId, Calibration> {
    let mut all = BTreeMap::new();
    for (name, at) in findings.entries(at, "device to the movement by which it is measured") {
        let device = device_by_position(findings, name, &at, init);
        let keys = findings.map(&at, "the calibration of a device", CALIBRATE_KEYS, &["by"]);
        let Some([sensor, from, by, taken]) = keys else { continue };
        let taken = taken.and_then(|at| findings.word(&at, &TAKEN_WORDS)).unwrap_or_default();
        let Some(device) = device else { continue };
        let limits = init
            .device(device.as_str())
            .and_then(|device| device.available_control_types.limits(ControlType::Position));
        let expected = "a number, in the unit of the device";
        let from_value = from.as_ref().and_then(|at| findings.number(at, expected));
        let by_value = by.as_ref().and_then(|at| findings.number(at, expected));
        if let (Some(by), Some(limits)) = (&by, &limits) {
            let ends = [from_value, from_value.zip(by_value).map(|(from, by)| from + by)];
            let beyond =
                ends.into_iter().flatten().find(|v| !(limits.min_value..=limits.max_value).contains(v));
            let expected = format!("{} to {}, which the device declares", limits.min_value, limits.max_value);
            if let Some(beyond) = beyond {
                findings.add(
                    Code::OutOfRange,
                    by.place(),
                    format!("the movement would reach {beyond}"),
                    expected,
                    None,
                );
            } else if by_value == Some(0.0) {
                let hint = Some("a movement that can be seen, and that nothing is in the way of".to_owned());
                findings.add(
                    Code::WrongType,
                    by.place(),
                    "the device would not move",
                    "a number other than 0",
                    hint,
                );
            }
        }
        let Some(sensor) = sensor_of(findings, sensor.as_ref(), &device, &at, init) else { continue };
        let Some(by) = by_value else { continue };
        all.insert(device, Calibration { sensor, from: from_value, by, taken });
    }
    all
}

/// A device that is driven by position, or a finding where the name stands.
pub(super) fn device_by_position(
    findings: &mut Reader,
    name: &str,
    at: &At<'_>,
    init: &InitializationBlock,
) -> Option<DeviceId> {
    let driven =
        || init.devices.iter().filter(|device| is_positioned(device)).map(|device| device.id.as_str());
    let found = init.device(name).filter(|device| is_positioned(device)).map(|device| device.id.clone());
    if found.is_none() {
        let message = format!("the robot has no device `{}` that takes positions", shortened(name));
        let (expected, hint) = (finding::one_of(driven()), findings.did_you_mean(name, driven()));
        findings.add(Code::UnknownDevice, at.key_place(), message, expected, hint);
    }
    found
}

/// The sensor that is named, or else the device itself.
pub(super) fn sensor_of(
    findings: &mut Reader,
    named: Option<&At<'_>>,
    device: &DeviceId,
    at: &At<'_>,
    init: &InitializationBlock,
) -> Option<DeviceId> {
    let Some(named) = named else { return sensor(findings, device.as_str(), at, init) };
    let name = findings.name(named, "the id of a sensor")?;
    let is_sensor = |device: &&Device| device.available_control_types.sensor().is_some();
    let sensors = || init.devices.iter().filter(is_sensor).map(|device| device.id.as_str());
    let found = init.device(&name).filter(is_sensor).map(|device| device.id.clone());
    if found.is_none() {
        let message = format!("the robot has no sensor `{}`", shortened(&name));
        let (expected, hint) = (finding::one_of(sensors()), findings.did_you_mean(&name, sensors()));
        findings.add(Code::UnknownSensor, named.place(), message, expected, hint);
    }
    found
}
