//! The devices that a robot declares, and their limits.

use urrcp::{ControlType, Device, InitializationBlock, Limits};

use super::FleetRobot;
use downbeat_yaml::composed::is_same;

/// Returns the devices of a robot. Empty if the robot's initialization block is not known.
pub fn devices_of(robot: &FleetRobot) -> &[Device] {
    robot.init.as_ref().map_or(&[], |block| &block.devices)
}

/// Returns the device with this name, whether the name is composed or decomposed in Unicode.
pub(super) fn device_named<'a>(init: &'a InitializationBlock, name: &str) -> Option<&'a Device> {
    init.devices.iter().find(|device| is_same(device.id.as_str(), name))
}

/// Returns the limits of the values that a script can set for a control type: the range that all its limits ([`limits_of`]) have in
/// common, with the coarsest granularity. If they have no values in common, the control type's own limits apply.
pub fn settable_limits(device: &Device, control_type: ControlType) -> Option<Limits> {
    let own = device.available_control_types.limits(control_type)?;
    let all = || limits_of(device, control_type);
    let most = |value: fn(&Limits) -> f64| all().map(value).fold(f64::NEG_INFINITY, f64::max);
    let least = all().map(|limits| limits.max_value).fold(f64::INFINITY, f64::min);
    let common = Limits::new(most(|limits| limits.min_value), least, most(|limits| limits.granularity));
    Some(common.map_or_else(|_| own.clone(), |common| Limits { max_error: own.max_error, ..common }))
}

/// Returns all limits that apply to a control type in a script: its own, and those that the device declares for scripts.
pub fn limits_of(device: &Device, control_type: ControlType) -> impl Iterator<Item = &Limits> {
    let own = device.available_control_types.limits(control_type);
    let inherited = device.available_control_types.script().map(|script| &script.limits);
    own.into_iter().chain(inherited)
}
