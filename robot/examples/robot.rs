//! Template for a complete robot with one joint, reachable over TCP. Replace `println!` with the code that moves your motor.
//!
//! Run `cargo run --example robot`, and then `downbeat conformance tcp://127.0.0.1:7401 --device elbow`.
#![expect(clippy::print_stdout, reason = "an example for a terminal")]

use std::error::Error;

use downbeat_robot::driver::{Driver, DriverError, DriverOptions};
use downbeat_robot::urrcp::{
    Device, DeviceId, InitializationBlock, Interpolation, LimitError, Limits, ScriptParameters, Setpoint,
};
use downbeat_robot::{HostOptions, Hosted, run};

/// Returns the description that the robot sends to a scheduler.
fn description() -> Result<InitializationBlock, LimitError> {
    let degrees = Limits::new(-150.0, 150.0, 0.1)?;
    let mut elbow = Device::new(DeviceId::new("elbow")?)
        .with_position(degrees.clone())
        .with_scripts(ScriptParameters::new(degrees, 10_000));
    elbow.interpolation = Interpolation::Linear;
    elbow.default_value = Some(0.0);
    elbow.script_queue = 2;
    InitializationBlock::new("arm-1".parse()?, vec![elbow])
}

/// Driver of the motor.
struct Motor;

impl Driver for Motor {
    fn connect(&mut self) -> Result<(), DriverError> {
        Ok(())
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        println!("{device}: {} {:.1}", setpoint.control_type, setpoint.value);
        Ok(())
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        Err(DriverError::Refused(format!("there is no sensor `{sensor}`")))
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        Ok(())
    }
}

/// Returns the robot, including the driver of its motor.
pub fn arm() -> Result<Hosted, LimitError> {
    Ok(Hosted::driven(description()?, Box::new(Motor), DriverOptions::default()))
}

fn main() -> Result<(), Box<dyn Error>> {
    // Runs until Ctrl-C. The elbow then moves to its default value.
    Ok(run(arm()?, "127.0.0.1:7401", HostOptions::default())?)
}
