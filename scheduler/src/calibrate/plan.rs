//! Plans the movements of a calibration, with their range and speed, from the fleet file alone.

use downbeat_scripts::{Calibration, Fleet, FleetRobot};
use serde::Serialize;
use urrcp::{ControlType, Device, DeviceId, Interpolation, Limits, RobotId, Span};

/// Minimum duration of a movement, however fast the device may move.
const LASTS_LEAST: Span = Span::from_millis(40);
/// Maximum speed of a movement, as a share of the device's maximum speed.
const SPEED_SHARE: f64 = 0.5;

/// A robot with devices to measure.
#[derive(Clone, Debug)]
pub struct PlannedRobot<'a> {
    /// The robot in the fleet file.
    pub robot: &'a FleetRobot,
    /// The devices to measure, in the order of the robot's description.
    pub devices: Vec<PlannedDevice>,
}

/// A device to measure, with all data needed for its movements.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedDevice {
    /// The device's id.
    pub device: DeviceId,
    /// The device's unit. `None` if its description states none.
    pub unit: Option<String>,
    /// The settings from the key `calibrate` in the fleet file.
    pub how: Calibration,
    /// The device's maximum speed, in its unit per second. `None` if it is unknown.
    pub speed: Option<f64>,
    /// Minimum duration of a movement, so that half of the maximum speed is not exceeded.
    pub lasts: Span,
    /// The device's position limits.
    pub limits: Limits,
    /// How the device moves from one step to the next.
    pub interpolation: Interpolation,
    /// Maximum number of steps in a script for the device.
    pub steps_max: u32,
    /// The lowest and the highest reading of the sensor.
    pub sensor_range: (f64, f64),
}

/// A device that is not measured, and the reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Unplanned {
    /// The robot's id.
    pub robot: RobotId,
    /// The device's id.
    pub device: DeviceId,
    /// Why the device is not measured.
    pub reason: String,
}

/// Plans the measurement of a fleet: of the robots in `only`, or of all robots if it is `None`. The second returned list contains devices
/// that are not measured, each with the reason. These are devices with `calibrate` that cannot be measured, and devices that accept
/// positions but have no `calibrate`.
#[must_use]
pub fn plan<'a>(fleet: &'a Fleet, only: Option<&[RobotId]>) -> (Vec<PlannedRobot<'a>>, Vec<Unplanned>) {
    let (mut planned, mut unplanned) = (Vec::new(), Vec::new());
    let chosen = |robot: &&FleetRobot| only.is_none_or(|only| only.contains(&robot.id));
    for robot in fleet.robots.iter().filter(chosen) {
        let Some(block) = &robot.init else { continue };
        let mut devices = Vec::new();
        for device in &block.devices {
            match of_device(robot, device) {
                Ok(planned) => devices.extend(planned),
                Err(reason) => {
                    let (robot, device) = (robot.id.clone(), device.id.clone());
                    unplanned.push(Unplanned { robot, device, reason });
                }
            }
        }
        if !devices.is_empty() {
            planned.push(PlannedRobot { robot, devices });
        }
    }
    (planned, unplanned)
}

/// Plans the measurement of one device. Returns `None` for a device that does not accept positions, and an error with the reason if the
/// device cannot be measured.
fn of_device(robot: &FleetRobot, device: &Device) -> Result<Option<PlannedDevice>, String> {
    let Some(limits) = device.available_control_types.limits(ControlType::Position) else { return Ok(None) };
    let Some(how) = robot.mission.calibrate.get(&device.id) else {
        return Err("no sensor measures its position; under `calibrate`, name a sensor and the amount by which the device may be moved".to_owned());
    };
    let sensor = robot.init.as_ref().and_then(|block| block.device(how.sensor.as_str()));
    let sensor = sensor.and_then(|sensor| sensor.available_control_types.sensor());
    let sensor = sensor.ok_or_else(|| format!("the robot has no sensor `{}`", how.sensor))?;
    let script = device.available_control_types.script();
    let script =
        script.ok_or("the robot does not support scripts, so the speed of the movement cannot be limited")?;
    let rates = robot.limits.get(device.id.as_str()).copied().unwrap_or_default();
    let speed = rates.or_declared(device, ControlType::Position).speed;
    let at_speed = speed.map(|speed| Span::from_millis_f64(1000.0 * how.by.abs() / (speed * SPEED_SHARE)));
    Ok(Some(PlannedDevice {
        device: device.id.clone(),
        unit: device.unit.as_ref().map(ToString::to_string),
        how: how.clone(),
        speed,
        lasts: at_speed.unwrap_or_default().max(LASTS_LEAST),
        limits: limits.clone(),
        interpolation: device.interpolation,
        steps_max: script.max_number_of_steps,
        sensor_range: (sensor.min_value, sensor.max_value),
    }))
}

impl PlannedDevice {
    /// Returns the position nearest to `value` that the device can be set to.
    #[must_use]
    pub fn on_grid(&self, value: f64) -> f64 {
        self.limits.nearest_settable(value)
    }
}
