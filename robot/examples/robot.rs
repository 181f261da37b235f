//! A whole robot to copy: one joint, on TCP. In the place of `println!` stands what moves your motor.
//!
//! `cargo run --example robot`, and then `downbeat conformance tcp://127.0.0.1:7401 --device elbow`.
#![expect(clippy::print_stdout, reason = "an example for a terminal")]

use std::error::Error;

use downbeat_robot::driver::{Driver, DriverError, DriverOptions};
use downbeat_robot::{Host, HostOptions, Hosted, serve};
use tokio::net::TcpListener;
use urrcp::{
    Device, DeviceId, InitializationBlock, Interpolation, LimitError, Limits, ScriptParameters, Setpoint,
};

/// What the robot tells a scheduler about itself.
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

/// Sets the motor.
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

/// Runs the robot until Ctrl-C, or until the listener fails.
pub async fn run(listener: TcpListener) -> Result<(), Box<dyn Error>> {
    let robot = Hosted::driven(description()?, Box::new(Motor), DriverOptions::default());
    let host = Host::start(vec![robot], HostOptions::default())?;
    println!("{} listens on {}", host.handle().robots()[0], listener.local_addr()?);
    tokio::select! {
        ended = serve(listener, host.handle(), 0) => ended?,
        asked = tokio::signal::ctrl_c() => asked?,
    }
    // Devices that were moved go to their default state.
    host.stop().into_iter().next().map_or(Ok(()), |not_at_rest| Err(not_at_rest.into()))
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    run(TcpListener::bind("127.0.0.1:7401").await?).await
}
