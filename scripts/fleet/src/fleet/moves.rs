//! Reads the key `moves` under `simulate`, which states how the body of a simulated robot follows its devices.

use urrcp::{ControlType, DeviceId, InitializationBlock, Span};

use super::calibration::{device_by_position, sensor_of};
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::{keys, schema};
use downbeat_yaml::finding::Code;

keys! {
    /// The movement of a device.
    pub(crate) struct MovesKeys {
        /// The time from setting a value to the first motion.
        latency: kinds::TIME,
        /// 95 % of all movements begin within the latency ± this.
        spread: kinds::TIME,
        /// The time constant of the first-order lag with which it follows afterwards.
        time_constant: kinds::TIME,
        /// The sensor that shows the position of the body; by default the device itself.
        sensor: kinds::DEVICE,
        /// Standard deviation of the sensor's readings, in its unit.
        noise: schema!({"type": "number", "minimum": 0}),
        /// The time that the sensor takes to answer. It reports the value at the time of the question.
        delay: kinds::TIME,
    }
}

/// How the body follows the values that a device is set to, and how a sensor shows the position of the body.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedMoves {
    /// The device that drives the body.
    pub device: DeviceId,
    /// The time from setting a value to the first motion.
    pub latency: Span,
    /// Half-width of the interval around `latency` within which 95 % of all movements begin.
    pub spread: Span,
    /// The time constant of the first-order lag with which the body follows the device after the first motion.
    pub time_constant: Span,
    /// The sensor that shows the position of the body; it may be the device itself.
    pub sensor: DeviceId,
    /// Standard deviation of the sensor's readings, in its unit.
    pub noise: f64,
    /// The time that the sensor takes to respond. The response contains the value at the time of the request.
    pub delay: Span,
}

/// Reads `moves`, such as `{elbow: {latency: 40ms, spread: 2ms, time_constant: 20ms, sensor: elbow_angle, noise: 0.1, delay: 5ms}}`.
pub(super) fn read(findings: &mut Reader, at: &At<'_>, init: &InitializationBlock) -> Vec<SimulatedMoves> {
    let mut moves = Vec::new();
    for (name, at) in findings.entries(at, "a map from each device to its simulated motion") {
        let device = device_by_position(findings, name, &at, init);
        let keys = findings.keys(&at, "the simulated motion of a device");
        let Some(MovesKeys { latency, spread, time_constant, sensor, noise, delay }) = keys else { continue };
        let Some(device) = device else { continue };
        let mut time = |at: Option<At<'_>>| at.and_then(|at| findings.duration(&at)).unwrap_or_default();
        let (latency, spread) = (time(latency), time(spread));
        let (time_constant, delay) = (time(time_constant), time(delay));
        let noise = noise.and_then(|at| read_noise(findings, &at));
        let Some(sensor) = sensor_of(findings, sensor.as_ref(), &device, &at, init) else { continue };
        let noise = noise.unwrap_or_default();
        moves.push(SimulatedMoves { device, latency, spread, time_constant, sensor, noise, delay });
    }
    moves
}

fn read_noise(findings: &mut Reader, at: &At<'_>) -> Option<f64> {
    let expected = "a number of at least 0, in the sensor's unit";
    let noise = findings.number(at, expected)?;
    if noise < 0.0 {
        findings.add(Code::WrongType, at.place(), format!("found the number {noise}"), expected, None);
    }
    Some(noise.max(0.0))
}

/// Whether a device can be driven by position.
pub(super) fn is_positioned(device: &urrcp::Device) -> bool {
    device.available_control_types.limits(ControlType::Position).is_some()
}
