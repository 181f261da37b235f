//! The properties of devices that a robot declares.

use urrcp::{ControlType, Device, InitializationBlock, Limits};

use super::FleetRobot;
use downbeat_yaml::composed::is_same;

/// The devices of a robot. Empty if its initialization block is not known.
pub fn devices_of(robot: &FleetRobot) -> &[Device] {
    robot.init.as_ref().map_or(&[], |block| &block.devices)
}

/// The device of this name, regardless of its Unicode encoding.
pub(super) fn device_named<'a>(init: &'a InitializationBlock, name: &str) -> Option<&'a Device> {
    init.devices.iter().find(|device| is_same(device.id.as_str(), name))
}

/// The values that a script can set: those within all limits of a control type, on the coarser grid. If the type's own limits and those
/// of scripts have no values in common, the type's own limits.
pub fn settable_limits(device: &Device, control_type: ControlType) -> Option<Limits> {
    let own = device.available_control_types.limits(control_type)?;
    let all = || limits_of(device, control_type);
    let most = |value: fn(&Limits) -> f64| all().map(value).fold(f64::NEG_INFINITY, f64::max);
    let least = all().map(|limits| limits.max_value).fold(f64::INFINITY, f64::min);
    let common = Limits::new(most(|limits| limits.min_value), least, most(|limits| limits.granularity));
    Some(common.map_or_else(|_| own.clone(), |common| Limits { max_error: own.max_error, ..common }))
}

/// The limits of a control type: its own, and those of scripts, which apply as well.
pub fn limits_of(device: &Device, control_type: ControlType) -> impl Iterator<Item = &Limits> {
    let own = device.available_control_types.limits(control_type);
    let inherited = device.available_control_types.script().map(|script| &script.limits);
    own.into_iter().chain(inherited)
}
