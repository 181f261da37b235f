//! Finds the sensors that a fleet file names.

use urrcp::{Device, DeviceId, InitializationBlock};

use super::declared::device_named;
use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::{Code, Place, did_you_mean, one_of};
use downbeat_yaml::shown::shortened;

/// Returns the id of the robot's sensor with the given name. If the robot has no such sensor, adds a finding at the key that names the
/// sensor.
pub fn sensor(
    findings: &mut Reader,
    name: &str,
    at: &At<'_>,
    init: &InitializationBlock,
) -> Option<DeviceId> {
    sensor_at(findings, name, at.key_place(), init)
}

/// Like [`sensor`], but adds the finding at a given place.
pub(super) fn sensor_at(
    findings: &mut Reader,
    name: &str,
    place: Place,
    init: &InitializationBlock,
) -> Option<DeviceId> {
    let is_sensor = |device: &&Device| device.available_control_types.sensor().is_some();
    let sensors = || init.devices.iter().filter(is_sensor).map(|device| device.id.as_str());
    let found = device_named(init, name).filter(is_sensor).map(|device| device.id.clone());
    if found.is_none() {
        let message = format!("the robot has no sensor `{}`", shortened(name));
        let expected = match sensors().next() {
            Some(_) => one_of(sensors()),
            None => {
                "a device with the control type `sensor`, but the robot's description has none".to_owned()
            }
        };
        let hint = did_you_mean(name, sensors());
        findings.add(Code::UnknownSensor, place, message, expected, hint);
    }
    found
}
