//! What a robot declares of its devices.

use urrcp::{ControlType, Device, Limits};

use super::FleetRobot;

/// The devices of a robot; none if its initialization block is not known.
pub(crate) fn devices_of(robot: &FleetRobot) -> &[Device] {
    robot.init.as_ref().map_or(&[], |block| &block.devices)
}

/// The limits of a control type: its own, and those of scripts, which hold as well.
pub(crate) fn limits_of(device: &Device, control_type: ControlType) -> impl Iterator<Item = &Limits> {
    let own = device.available_control_types.limits(control_type);
    let inherited = device.available_control_types.script().map(|script| &script.limits);
    own.into_iter().chain(inherited)
}
