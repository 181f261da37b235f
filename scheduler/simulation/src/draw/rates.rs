//! Draws missions with devices that are driven by their speed, and with devices whose acceleration is limited. One seed in fifty is such
//! a mission.

use downbeat_plan::Choreography;
use fastrand::Rng;
use urrcp::{ControlType, Device, Interpolation, RobotId, Script, Setpoint, Step};

use super::staged::instant;
use super::{Drawn, Fault, FaultKind, Hands, MISPLACED_ONE_IN, choreography, millis, one_in};
use crate::{Stage, play};

/// The position that becomes a speed of zero when positions are converted to speeds.
const MIDDLE: f64 = 45.0;

/// Replaces devices by devices that are driven by their speed or limited in their acceleration, and changes their scripts. In most
/// missions, also adds faults during movements.
pub(super) fn drive_by_rates(rng: &mut Rng, mut drawn: Drawn) -> Drawn {
    for robot in &mut drawn.robots {
        for device in robot.block.devices.iter_mut() {
            let moves = device.available_control_types.limits(ControlType::Position).is_some();
            let other = match rng.u8(0..5) {
                _ if !moves => None,
                0..=1 => wheel(rng, device),
                2..=3 => with_acceleration(rng, device),
                _ => None,
            };
            if let Some(other) = other {
                *device = other;
            }
        }
        let wheels = robot.block.devices.iter().filter(|device| is_wheel(device));
        for wheel in wheels {
            turn(rng, &mut drawn.choreography, &robot.block.id, wheel);
        }
    }
    if !drawn.seed.is_multiple_of(MISPLACED_ONE_IN) {
        choreography::begin_where_devices_are(&mut drawn.choreography, &drawn.robots);
    }
    if !one_in(rng, 3) {
        strike_while_it_plays(rng, &mut drawn);
    }
    drawn
}

fn is_wheel(device: &Device) -> bool {
    device.primary_control_type() == Some(ControlType::Speed)
}

/// Changes a device so that it is driven by its speed. Half of these devices declare an acceleration.
fn wheel(rng: &mut Rng, device: &Device) -> Option<Device> {
    let acceleration = if rng.bool() { rate(rng, 10.0, 200.0) } else { String::new() };
    let default = device.default_value.map(|_| if one_in(rng, 4) { 10.0 } else { 0.0 });
    let speed = r#""speed": {"min_value": -90, "max_value": 90, "granularity": 1}"#;
    described(device, &format!("{speed}{acceleration}"), device.interpolation, default)
}

/// Changes a device so that it moves linearly with a limited acceleration. Half of these devices also declare a speed.
fn with_acceleration(rng: &mut Rng, device: &Device) -> Option<Device> {
    let acceleration = rate(rng, 20.0, 200.0);
    let speed = r#", "speed": {"min_value": -200, "max_value": 200, "granularity": 1}"#;
    let speed = if rng.bool() { speed } else { "" };
    let position = r#""position": {"min_value": 0, "max_value": 90, "granularity": 1}"#;
    described(
        device,
        &format!("{position}{speed}{acceleration}"),
        Interpolation::Linear,
        device.default_value,
    )
}

/// Draws a maximum acceleration, evenly distributed on a logarithmic scale from `least` to `least * times`. Returns it as JSON.
fn rate(rng: &mut Rng, least: f64, times: f64) -> String {
    let largest = (least * times.powf(rng.f64())).round();
    format!(r#", "acceleration": {{"min_value": -{largest}, "max_value": {largest}, "granularity": 1}}"#)
}

fn described(
    device: &Device,
    types: &str,
    interpolation: Interpolation,
    default: Option<f64>,
) -> Option<Device> {
    let (id, queue) = (&device.id, device.script_queue);
    let steps = device.available_control_types.script()?.max_number_of_steps;
    let interpolation = if interpolation == Interpolation::Linear { "linear" } else { "hold" };
    let default = default.map_or(String::new(), |default| format!(r#""default_value": {default}, "#));
    let json = format!(
        r#"{{"id": "{id}", "name": "{id}", {default}"interpolation": "{interpolation}", "script_queue": {queue},
          "available_control_types": {{{types},
            "script": {{"min_value": -90, "max_value": 90, "granularity": 1, "max_number_of_steps": {steps}}}}}}}"#
    );
    serde_json::from_str(&json).ok()
}

/// Converts the positions in the scripts of a device to speeds. Most scripts end with a speed of zero; after the others, the device
/// continues to move.
fn turn(rng: &mut Rng, choreography: &mut Choreography, robot: &RobotId, device: &Device) {
    let plans = choreography.acts.iter_mut().flat_map(|act| &mut act.plan.robots);
    let scripts = plans.filter(|plan| plan.robot == *robot).flat_map(|plan| &mut plan.scripts);
    for script in scripts.filter(|script| script.device == device.id) {
        let mut steps: Vec<Step> = script.script.steps().to_vec();
        for step in &mut steps {
            step.setpoint = Setpoint::new(ControlType::Speed, step.setpoint.value - MIDDLE);
        }
        if let Some(last) = steps.last_mut().filter(|_| !one_in(rng, 3)) {
            last.setpoint.value = 0.0;
        }
        if let Ok(turns) = Script::new(steps) {
            script.script = turns;
        }
    }
}

/// Replaces the faults of a mission by a fault while robots play, often followed soon by a second fault.
fn strike_while_it_plays(rng: &mut Rng, drawn: &mut Drawn) {
    use FaultKind::{DeadLink, HardwareDies, Home, Partition, RobotPause, SchedulerCrash, Stop};
    let robot = rng.usize(0..drawn.robots.len());
    let ends = [Stop, Stop, Home, Home, Partition, DeadLink, SchedulerCrash, HardwareDies, RobotPause];
    let Some(kind) = rng.choice(ends) else { return };
    if kind == HardwareDies {
        drawn.robots[robot].hands = Hands::Hardware;
    }
    let Some(at) = instant(rng, &play(drawn.clone().without_faults()), Stage::Plays) else { return };
    drawn.faults = vec![(at, kind.draw(rng, robot))];
    if one_in(rng, 2) {
        // A second stop is sent only if it brings robots to rest in a different way.
        let second = if kind == Stop { Fault::Home } else { Fault::Stop };
        drawn.plans_transfers &= one_in(rng, 3);
        drawn.faults.push((at + millis(rng, 5, 100), second));
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FAMILIES, RATES, reached};
    use crate::Situation::{
        LeaseEndsTurning, PositionSlows, SlowsAtLimit, SpeedSlows, SpeedStops, StoppedAgain, TurnsAfterScript,
    };

    #[test]
    fn devices_turn_and_slow_down_within_declared_limits() {
        let reached = reached((RATES, 20_000), FAMILIES);
        let all = [
            SpeedSlows,
            SpeedStops,
            PositionSlows,
            SlowsAtLimit,
            StoppedAgain,
            TurnsAfterScript,
            LeaseEndsTurning,
        ];
        let seldom = all.iter().find(|situation| reached.get(situation).is_none_or(|count| *count < 3));
        assert_eq!(seldom, None, "{reached:?}");
    }
}
