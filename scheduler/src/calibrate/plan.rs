//! What would be moved, how far and how fast: from the fleet file alone.

use downbeat_scripts::{Calibration, Fleet, FleetRobot};
use serde::Serialize;
use urrcp::{ControlType, Device, DeviceId, Interpolation, Limits, RobotId, Span};

/// A movement lasts at least this long, whatever a device may do.
const LASTS_LEAST: Span = Span::from_millis(40);
/// Of the largest speed that a device may have.
const SPEED_SHARE: f64 = 0.5;

/// A robot with devices to measure.
#[derive(Clone, Debug)]
pub struct PlannedRobot<'a> {
    /// The robot.
    pub robot: &'a FleetRobot,
    /// Its devices that are measured, in the order of their names.
    pub devices: Vec<PlannedDevice>,
}

/// A device, and the movement by which it is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedDevice {
    /// The device.
    pub device: DeviceId,
    /// Its unit, if it declares one.
    pub unit: Option<String>,
    /// As the fleet file declares it.
    pub how: Calibration,
    /// Its largest speed, in its unit a second, where one is known.
    pub speed: Option<f64>,
    /// How long a movement takes at least: half of that speed is not exceeded.
    pub lasts: Span,
    /// Where it may be.
    pub limits: Limits,
    /// How it gets from one step to the next.
    pub interpolation: Interpolation,
    /// Steps of a script, at most.
    pub steps_max: u32,
    /// Lowest and highest reading of the sensor.
    pub sensor_range: (f64, f64),
}

/// A device that is not measured, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Unplanned {
    /// The robot.
    pub robot: RobotId,
    /// The device.
    pub device: DeviceId,
    /// Why not.
    pub reason: String,
}

/// What of a fleet would be measured: of all robots, or of these. Devices with `calibrate` that cannot be measured come with the reason,
/// and so do those that take positions and have none.
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

/// `None` for what is driven by no position.
fn of_device(robot: &FleetRobot, device: &Device) -> Result<Option<PlannedDevice>, String> {
    let Some(limits) = device.available_control_types.limits(ControlType::Position) else { return Ok(None) };
    let Some(how) = robot.mission.calibrate.get(&device.id) else {
        return Err("no sensor shows where it is: name one under `calibrate`, and the amount by which it may be moved".to_owned());
    };
    let sensor = robot.init.as_ref().and_then(|block| block.device(how.sensor.as_str()));
    let sensor = sensor.and_then(|sensor| sensor.available_control_types.sensor());
    let sensor = sensor.ok_or_else(|| format!("the robot has no sensor `{}`", how.sensor))?;
    let script = device.available_control_types.script();
    let script = script.ok_or("it takes no scripts, so a movement of limited speed is not possible")?;
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
    /// The nearest position that the device can be sent to.
    #[must_use]
    pub fn on_grid(&self, value: f64) -> f64 {
        self.limits.nearest_settable(value)
    }
}
