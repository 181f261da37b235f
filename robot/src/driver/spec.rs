//! The choice of a driver, in the form used on the command line and in the fleet file.

use std::str::FromStr;

use urrcp::InitializationBlock;

#[cfg(feature = "thrift")]
use super::ThriftRobot;
use super::{Driver, DriverError, Program, SimulatedDriver, Timeouts};

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
    },
    /// `program:COMMAND`: a program that receives lines on its standard input.
    Program {
        /// Command line that a shell executes.
        command: String,
    },
}

/// Error for a text that does not name a driver.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown driver `{0}`, expected sim, thrift://host:port or program:COMMAND")]
pub struct DriverSpecError(String);

impl FromStr for DriverSpec {
    type Err = DriverSpecError;

    fn from_str(text: &str) -> Result<Self, DriverSpecError> {
        let unknown = || DriverSpecError(text.to_owned());
        if text == "sim" {
            return Ok(Self::Simulated);
        }
        if let Some(command) = text.strip_prefix("program:") {
            let command = command.trim().to_owned();
            return if command.is_empty() { Err(unknown()) } else { Ok(Self::Program { command }) };
        }
        let (host, port) =
            text.strip_prefix("thrift://").and_then(|rest| rest.rsplit_once(':')).ok_or_else(unknown)?;
        let port = port.parse().ok().filter(|port| *port > 0).ok_or_else(unknown)?;
        let host = host.trim_start_matches('[').trim_end_matches(']');
        if host.is_empty() {
            return Err(unknown());
        }
        Ok(Self::Thrift { host: host.to_owned(), port })
    }
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
            Self::Thrift { host, port } => Box::new(ThriftRobot::new(host, *port, block)?),
            #[cfg(not(feature = "thrift"))]
            Self::Thrift { .. } => {
                return Err(DriverError::Refused("this program was built without Thrift support".to_owned()));
            }
            Self::Program { command } => Box::new(Program::new(command, block)?.within(timeouts)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driver_can_be_specified_in_three_ways() {
        let thrift = |host: &str| DriverSpec::Thrift { host: host.into(), port: 9090 };
        assert_eq!("sim".parse(), Ok(DriverSpec::Simulated));
        assert_eq!("thrift://tank.local:9090".parse(), Ok(thrift("tank.local")));
        assert_eq!("thrift://[::1]:9090".parse(), Ok(thrift("::1")));
        let command = "python3 drive.py".to_owned();
        assert_eq!("program: python3 drive.py".parse(), Ok(DriverSpec::Program { command }));
    }

    #[test]
    fn invalid_driver_is_refused_with_the_valid_forms() {
        for text in ["", "Sim", "tcp://a:1", "thrift://a", "thrift://:9090", "thrift://a:0", "program: "] {
            let error = text.parse::<DriverSpec>().unwrap_err().to_string();
            assert!(error.contains("expected sim, thrift://host:port or program:COMMAND"), "{text}: {error}");
        }
    }
}
