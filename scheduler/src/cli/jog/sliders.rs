//! The devices that can be moved by hand.

use downbeat_scripts::{FleetRobot, PoseDevice, settable_limits};
use urrcp::{ControlType, DeviceId, Interpolation, Limits};

/// A device that can be moved by hand, and its place.
#[derive(Clone, Debug)]
pub(super) struct Slider {
    pub(super) device: DeviceId,
    pub(super) unit: Option<String>,
    /// The positions that scripts can set.
    pub(super) limits: Limits,
    pub(super) moves_linearly: bool,
    /// The device's own sensor, or the sensor that measures it for `downbeat calibrate`.
    pub(super) sensor: Option<DeviceId>,
    /// The commanded position. `None` if the robot does not know it.
    pub(super) at: Option<f64>,
    /// The last reading of the sensor, in the sensor's unit.
    pub(super) reading: Option<f64>,
    /// Where the operator wants the device to be.
    pub(super) target: Option<f64>,
}

/// Returns the devices of a robot that take scripts of positions.
pub(super) fn of(robot: &FleetRobot) -> Vec<Slider> {
    let slider = |device: &urrcp::Device| {
        let types = &device.available_control_types;
        types.script()?;
        let own = types.sensor().map(|_| device.id.clone());
        let measured = || robot.mission.calibrate.get(&device.id).map(|how| how.sensor.clone());
        Some(Slider {
            device: device.id.clone(),
            unit: device.unit.as_ref().map(ToString::to_string),
            limits: settable_limits(device, ControlType::Position)?,
            moves_linearly: device.interpolation == Interpolation::Linear,
            sensor: own.or_else(measured),
            at: device.default_value,
            reading: None,
            target: None,
        })
    };
    robot.init.iter().flat_map(|block| &block.devices).filter_map(slider).collect()
}

/// Returns the pose of a robot: the position of each device by its own sensor, or else the commanded position, on the device's grid. Devices
/// whose position is unknown have none.
pub(super) fn pose(sliders: &[Slider]) -> Vec<PoseDevice> {
    let position = |slider: &Slider| {
        let own = slider.reading.filter(|_| slider.sensor.as_ref() == Some(&slider.device));
        own.or(slider.at).map(|position| slider.limits.nearest_settable(position))
    };
    let device = |slider: &Slider| {
        let (device, moves_linearly) = (slider.device.clone(), slider.moves_linearly);
        position(slider).map(|position| PoseDevice { device, position, moves_linearly })
    };
    sliders.iter().filter_map(device).collect()
}

impl Slider {
    /// Returns why the device cannot be set to a position. `None` if it can.
    pub(super) fn refuses(&self, to: f64) -> Option<String> {
        let Limits { min_value, max_value, granularity, .. } = self.limits;
        if !(min_value..=max_value).contains(&to) {
            return Some(format!("expected {min_value} to {max_value}"));
        }
        let nearest = self.limits.nearest_settable(to);
        let off = (nearest - to).abs() > granularity * 1e-6;
        off.then(|| format!("expected a multiple of {granularity}, such as {nearest}"))
    }

    /// Moves the target by a share of the range, and by at least one step of the grid.
    pub(super) fn nudge(&mut self, share: f64) {
        let Limits { min_value, max_value, granularity, .. } = self.limits;
        let Some(from) = self.target.or(self.at) else { return };
        let by = (max_value - min_value) * share;
        let by = by.signum() * by.abs().max(granularity);
        self.target = Some(self.limits.nearest_settable((from + by).clamp(min_value, max_value)));
    }

    /// Returns the place of a value in the range, from 0 to 1.
    pub(super) fn share(&self, value: f64) -> f64 {
        let Limits { min_value, max_value, .. } = self.limits;
        if max_value > min_value {
            ((value - min_value) / (max_value - min_value)).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }
}
