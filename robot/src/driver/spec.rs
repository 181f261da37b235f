//! The choice of a driver.

use urrcp::{InitializationBlock, RobotId};

#[cfg(feature = "mavlink")]
use super::MavlinkVehicle;
#[cfg(feature = "thrift")]
use super::ThriftRobot;
#[cfg(feature = "dmx")]
use super::{DmxAddress, DmxFixture};
use super::{Driver, DriverError, MavlinkAddress, Program, SimulatedDriver, Timeouts};
#[cfg(feature = "osc")]
use super::{OscAddress, OscRobot};

/// A kind of driver, and the hardware or program that it addresses.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DriverSpec {
    /// `sim`: a simulation without hardware.
    Simulated,
    /// `thrift://host:port`: a robot that speaks the early Thrift form of URRCP.
    Thrift {
        /// Host name or IP address of the robot.
        host: String,
        /// TCP port of the robot.
        port: u16,
        /// The id that the hardware reports, if it differs from the robot's: several robots may come with the same.
        id: Option<RobotId>,
    },
    /// `sacn:...` or `artnet:...`: a DMX fixture.
    #[cfg(feature = "dmx")]
    Dmx(DmxAddress),
    /// `osc:...`: a receiver of Open Sound Control.
    #[cfg(feature = "osc")]
    Osc(OscAddress),
    /// `mavlink:...`: a vehicle that speaks MAVLink.
    Mavlink(MavlinkAddress),
    /// `program:COMMAND`: a program that receives lines on its standard input.
    Program {
        /// Command line that a shell executes.
        command: String,
    },
}

impl DriverSpec {
    /// Creates the driver for a robot, without connecting.
    ///
    /// # Errors
    /// [`DriverError::Refused`] if this driver cannot drive a robot with this description, or is not part of this build.
    pub fn driver(&self, block: &InitializationBlock) -> Result<Box<dyn Driver>, DriverError> {
        self.driver_within(block, Timeouts::default())
    }

    /// Creates the driver for a robot; `timeouts` are the time limits for a driver that is an external program.
    ///
    /// # Errors
    /// Those of [`DriverSpec::driver`].
    pub fn driver_within(
        &self,
        block: &InitializationBlock,
        timeouts: Timeouts,
    ) -> Result<Box<dyn Driver>, DriverError> {
        Ok(match self {
            Self::Simulated => Box::new(SimulatedDriver::new(block)),
            #[cfg(feature = "thrift")]
            Self::Thrift { host, port, id } => {
                Box::new(ThriftRobot::new(host, *port, block)?.identified_as(id.clone()))
            }
            #[cfg(not(feature = "thrift"))]
            Self::Thrift { .. } => {
                return Err(DriverError::Refused("this program was built without Thrift support".to_owned()));
            }
            #[cfg(feature = "dmx")]
            Self::Dmx(address) => Box::new(DmxFixture::new(address.clone(), block)?),
            #[cfg(feature = "osc")]
            Self::Osc(address) => Box::new(OscRobot::new(address.clone(), block)?),
            #[cfg(feature = "mavlink")]
            Self::Mavlink(address) => Box::new(MavlinkVehicle::new(address.clone(), block)?),
            #[cfg(not(feature = "mavlink"))]
            Self::Mavlink(_) => {
                let reason = "this program was built without MAVLink; build it with `cargo build --release --features mavlink`";
                return Err(DriverError::Refused(reason.to_owned()));
            }
            Self::Program { command } => Box::new(Program::new(command, block)?.within(timeouts)),
        })
    }
}
