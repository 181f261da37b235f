//! Asks a robot for its description, and moves the robot's first movable device to the middle of its range.
//!
//! `cargo run --example ask -- 127.0.0.1:7401`
#![expect(clippy::print_stdout, reason = "an example for a terminal")]

use std::error::Error;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use urrcp::{
    Command, ControlRequest, Decoder, InitializationBlock, InitializationRequest, Limits, Message, Setpoint,
    encode,
};

/// A connection to a robot, with a decoder for the received bytes.
struct Robot {
    stream: TcpStream,
    decoder: Decoder,
}

impl Robot {
    /// Sends a message and returns the next message that arrives.
    fn ask(&mut self, message: impl Into<Message>) -> Result<Message, Box<dyn Error>> {
        let mut bytes = Vec::new();
        encode(&message.into(), &mut bytes);
        self.stream.write_all(&bytes)?;
        let mut buffer = [0; 4_096];
        loop {
            if let Some(message) = self.decoder.next_message() {
                return Ok(message?);
            }
            match self.stream.read(&mut buffer)? {
                0 => return Err("the robot has closed the connection".into()),
                count => self.decoder.push(&buffer[..count]),
            }
        }
    }
}

/// Returns a request that moves the first movable device to the middle of its range; `None` if no device can be moved.
fn to_the_middle(block: &InitializationBlock) -> Option<ControlRequest> {
    let middle = |limits: &Limits| limits.nearest(f64::midpoint(limits.min_value, limits.max_value));
    block.devices.iter().find_map(|device| {
        let control_type = device.primary_control_type()?;
        let limits = device.available_control_types.limits(control_type)?;
        let command = Command::Set(Setpoint::new(control_type, middle(limits)));
        Some(ControlRequest::immediate(device.id.clone(), command))
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let address = std::env::args().nth(1).ok_or("ask HOST:PORT")?;
    let stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(Duration::from_secs(2)))?;
    let mut robot = Robot { stream, decoder: Decoder::default() };
    let Message::InitializationBlock(block) = robot.ask(InitializationRequest::default())? else {
        return Err("the robot does not say who it is".into());
    };
    println!("{} has {} devices", block.id, block.devices.len());
    let request = to_the_middle(&block).ok_or("no device can be moved")?;
    if let Message::ControlResponse(response) = robot.ask(request)? {
        println!("{}: {}", response.device_id, response.status);
    }
    Ok(())
}
