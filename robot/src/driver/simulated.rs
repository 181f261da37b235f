//! A driver without hardware: it accepts and logs all values.

use std::collections::HashMap;

use urrcp::{DeviceId, InitializationBlock, Setpoint};

use super::{Driver, DriverError};

/// Simulated hardware. The reading of a device is the last value that was set; the reading of a sensor that cannot be set is the middle
/// of its range.
#[derive(Clone, Debug)]
pub struct SimulatedDriver {
    readings: HashMap<DeviceId, f64>,
}

impl SimulatedDriver {
    /// Creates a driver for the devices of this robot.
    #[must_use]
    pub fn new(block: &InitializationBlock) -> Self {
        let middle = |device: &urrcp::Device| {
            let sensor = device.available_control_types.sensor()?;
            Some((device.id.clone(), f64::midpoint(sensor.min_value, sensor.max_value)))
        };
        Self { readings: block.devices.iter().filter_map(middle).collect() }
    }
}

impl Driver for SimulatedDriver {
    fn connect(&mut self) -> Result<(), DriverError> {
        Ok(())
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        tracing::info!(%device, control_type = %setpoint.control_type, value = setpoint.value, "set");
        self.readings.insert(device.clone(), setpoint.value);
        Ok(())
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        let reading = self.readings.get(sensor).copied();
        reading.ok_or_else(|| DriverError::Refused(format!("`{sensor}` is not a sensor")))
    }

    fn set_is_acknowledged(&self) -> bool {
        true
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        Ok(())
    }
}
