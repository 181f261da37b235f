//! Draws missions with sensors that show the positions of devices with noise and a delay, and with bodies that follow their commands with
//! a lag. Many of the robots accept no inquiries, so that the mission knows positions only from sensors. One seed in fifty is such a
//! mission.

use downbeat_plan::OnFailure;
use downbeat_robot::simulated::Moves;
use fastrand::Rng;
use urrcp::{ControlType, Device, Interpolation, Span};

use super::staged::instant;
use super::{Drawn, Fault, millis, one_in};
use crate::{Stage, play};

/// The noise of a sensor, as a fraction of the device's declared error.
const NOISE: f64 = 0.125;

/// Gives most devices a sensor that shows their position, and a body that follows commands with a lag. In most missions, also adds a stop
/// before another act.
pub(super) fn show_positions(rng: &mut Rng, mut drawn: Drawn) -> Drawn {
    for robot in &mut drawn.robots {
        if one_in(rng, 2) {
            (robot.block.inquiry, robot.block.pending_until) = (false, false);
        }
        for device in robot.block.devices.iter_mut() {
            let error = 0.5 + 2.5 * rng.f64();
            let Some(shown) = with_sensor(device, error).filter(|_| !one_in(rng, 4)) else { continue };
            *device = shown;
            robot.settings.moves.push(Moves {
                device: device.id.clone(),
                latency: millis(rng, 0, 60),
                spread: Span::ZERO,
                time_constant: if one_in(rng, 3) { Span::ZERO } else { millis(rng, 1, 80) },
                sensor: device.id.clone(),
                noise: error * NOISE,
                delay: millis(rng, 0, 40),
            });
        }
    }
    let acts = drawn.choreography.acts.len();
    for act in drawn.choreography.acts.iter_mut().take(acts - 1).filter(|_| !one_in(rng, 3)) {
        (act.on_failure.default, act.on_failure.then) = (OnFailure::Stop, Some(acts - 1));
    }
    if !one_in(rng, 3)
        && let Some(at) = instant(rng, &play(drawn.clone().without_faults()), Stage::Plays)
    {
        let robot = rng.usize(0..drawn.robots.len());
        let back_after = rng.bool().then(|| millis(rng, 20, 500));
        let fault =
            if one_in(rng, 2) { Fault::RobotCrash { robot, back_after, told: true } } else { Fault::Home };
        drawn.faults = vec![(at, fault)];
    }
    drawn
}

/// Returns the device with a sensor that shows its position, and with `error` as its declared position error.
fn with_sensor(device: &Device, error: f64) -> Option<Device> {
    device.available_control_types.limits(ControlType::Position)?;
    let (id, queue) = (&device.id, device.script_queue);
    let steps = device.available_control_types.script()?.max_number_of_steps;
    let interpolation = if device.interpolation == Interpolation::Linear { "linear" } else { "hold" };
    let default =
        device.default_value.map_or(String::new(), |default| format!(r#""default_value": {default}, "#));
    let json = format!(
        r#"{{"id": "{id}", "name": "{id}", {default}"interpolation": "{interpolation}", "script_queue": {queue},
          "available_control_types": {{
            "position": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_error": {error}}},
            "sensor": {{"min_value": -20, "max_value": 120}},
            "script": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": {steps}}}}}}}"#
    );
    serde_json::from_str(&json).ok()
}

/// Returns how far the reading of a device's sensor may be from the position of the device at rest. This limit is exceeded only with
/// negligible probability. `None` without a sensor.
pub(crate) fn shows_within(device: &Device) -> Option<f64> {
    device.available_control_types.sensor()?;
    let error = device.available_control_types.limits(ControlType::Position)?.max_error?;
    Some(error * NOISE * 6.0)
}

#[cfg(test)]
mod tests {
    use super::super::{FAMILIES, SENSORS, reached};
    use crate::Situation::{ReadWithoutNames, RefusedBySensor};

    #[test]
    fn missions_learn_positions_from_sensors_of_moving_devices() {
        let reached = reached((SENSORS, 20_000), FAMILIES);
        for situation in [RefusedBySensor, ReadWithoutNames] {
            assert!(reached.get(&situation).is_some_and(|count| *count > 3), "{reached:?}");
        }
    }
}
