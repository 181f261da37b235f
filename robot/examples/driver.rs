//! Template for a driver of hardware behind a socket. The hardware takes one line per command, and answers each command with one line.
//!
//! `cargo run --example driver -- robot.json 192.168.1.20:5000` runs the driver behind a robot on port 7401.

use std::error::Error;
use std::io::{self, BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::Duration;

use downbeat_robot::driver::{Driver, DriverError, DriverOptions, Lifeline};
use downbeat_robot::urrcp::{DeviceId, InitializationBlock, Setpoint};
use downbeat_robot::{HostOptions, Hosted, run};

/// Time limit for the hardware's answer. A driver may wait for its hardware, but not forever.
const ANSWER_WITHIN: Duration = Duration::from_millis(500);

/// Driver for hardware that is reached over the network: the hardware's address, and the open connection, if any.
struct LineDriver {
    address: String,
    connection: Option<BufReader<TcpStream>>,
}

impl LineDriver {
    fn connected(&self) -> io::Result<BufReader<TcpStream>> {
        let stream = TcpStream::connect(&self.address)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(ANSWER_WITHIN))?;
        Ok(BufReader::new(stream))
    }

    /// Sends a line to the hardware and returns its answer.
    fn ask(&mut self, line: &str) -> Result<String, DriverError> {
        let connection = self.connection.as_mut().ok_or_else(|| away("not connected"))?;
        connection.get_mut().write_all(format!("{line}\n").as_bytes()).map_err(away)?;
        let mut answer = String::new();
        match connection.read_line(&mut answer).map_err(away)? {
            0 => Err(away("it has closed the connection")),
            _ => Ok(answer.trim().to_owned()),
        }
    }
}

fn away(reason: impl ToString) -> DriverError {
    DriverError::Away(reason.to_string())
}

impl Driver for LineDriver {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.connection = Some(self.connected().map_err(away)?);
        self.ping()
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        match self.ask(&format!("set {device} {}", setpoint.value))?.as_str() {
            "ok" => Ok(()),
            refused => Err(DriverError::Refused(refused.to_owned())),
        }
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        let answer = self.ask(&format!("read {sensor}"))?;
        answer.parse().map_err(|_| DriverError::Refused(format!("`{answer}` is no number")))
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        self.ask("ping").map(drop)
    }

    fn lifeline(&self) -> Option<Lifeline> {
        Lifeline::of(self.connection.as_ref()?.get_ref(), "it has closed the connection")
    }
}

/// Returns a robot with the given JSON description. Its hardware is reached at `address`.
pub fn robot(description: &str, address: String) -> Result<Hosted, serde_json::Error> {
    let block: InitializationBlock = serde_json::from_str(description)?;
    let driver = LineDriver { address, connection: None };
    Ok(Hosted::driven(block, Box::new(driver), DriverOptions::default()))
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let (description, address) = words.next().zip(words.next()).ok_or("driver DESCRIPTION ADDRESS")?;
    let robot = robot(&std::fs::read_to_string(description)?, address)?;
    Ok(run(robot, "127.0.0.1:7401", HostOptions::default())?)
}
