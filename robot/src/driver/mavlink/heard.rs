//! Vehicles whose heartbeats arrive.
#![expect(clippy::disallowed_methods, reason = "heartbeats in real time")]

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use mavlink::dialects::common::MavMessage;

use super::vehicle::messages;

/// A vehicle whose heartbeat was received.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub struct HeardVehicle {
    /// The address that the heartbeat came from.
    pub from: SocketAddr,
    /// The system id.
    pub system: u8,
    /// The kind of vehicle and its autopilot, as MAVLink names them.
    pub kind: String,
}

/// The port to which vehicles send heartbeats by default.
pub const MAVLINK_PORT: u16 = 14_550;

/// Returns the vehicles whose heartbeats arrive at [`MAVLINK_PORT`] within `wait`.
///
/// # Errors
/// Fails if no socket can be opened, for example because a ground station uses the port.
pub fn hear_mavlink(wait: Duration) -> io::Result<Vec<HeardVehicle>> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, MAVLINK_PORT))?;
    let until = Instant::now() + wait;
    let mut vehicles = Vec::new();
    let mut buffer = [0; 2_048];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(vehicles);
        }
        socket.set_read_timeout(Some(left))?;
        let Ok((length, from)) = socket.recv_from(&mut buffer) else { continue };
        messages(&buffer[..length], |header, message| {
            let MavMessage::HEARTBEAT(heartbeat) = message else { return };
            let Ok(system) = u8::try_from(header.system_id) else { return };
            let kind = format!("{:?}, {:?}", heartbeat.mavtype, heartbeat.autopilot);
            let vehicle = HeardVehicle { from, system, kind };
            if !vehicles.contains(&vehicle) {
                vehicles.push(vehicle);
            }
        });
    }
}
