//! Multicopters that speak MAVLink 2, with ArduPilot: their addresses, and the driver for builds with the feature `mavlink`.

#[cfg(feature = "mavlink")]
mod heard;
#[cfg(feature = "mavlink")]
mod vehicle;

#[cfg(feature = "mavlink")]
pub use self::heard::{HeardVehicle, MAVLINK_PORT, hear_mavlink};
#[cfg(feature = "mavlink")]
pub use self::vehicle::MavlinkVehicle;

/// How a vehicle is reached, and what it does at the end.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct MavlinkAddress {
    /// Host name or IP address at which this process listens for the vehicle.
    pub host: String,
    /// UDP port at which this process listens for the vehicle.
    pub port: u16,
    /// System id of the vehicle. `None`: that of the first vehicle whose heartbeat arrives.
    pub system: Option<u8>,
    /// Height of a take-off, in millimetres above the place of the take-off.
    pub takeoff_mm: u32,
    /// What the vehicle does when its edge ends.
    pub at_end: VehicleEnd,
}

/// What a vehicle does when its edge ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum VehicleEnd {
    /// It keeps its last position, until the failsafe of its autopilot.
    #[default]
    Hold,
    /// It lands where it is.
    Land,
    /// It returns to where it took off, and lands there.
    ReturnToLaunch,
}

/// Height of a take-off if the address states none, in millimetres.
pub const TAKEOFF_MM: u32 = 1_000;

impl MavlinkAddress {
    /// Creates the address of a vehicle whose heartbeats arrive at this host and port.
    #[must_use]
    pub const fn new(host: String, port: u16) -> Self {
        Self { host, port, system: None, takeoff_mm: TAKEOFF_MM, at_end: VehicleEnd::Hold }
    }

    /// Sets the system id of the vehicle.
    #[must_use]
    pub const fn with_system(mut self, system: Option<u8>) -> Self {
        self.system = system;
        self
    }

    /// Sets the height of a take-off, in millimetres.
    #[must_use]
    pub const fn with_takeoff(mut self, takeoff_mm: u32) -> Self {
        self.takeoff_mm = takeoff_mm;
        self
    }

    /// Sets what the vehicle does when its edge ends.
    #[must_use]
    pub const fn with_at_end(mut self, at_end: VehicleEnd) -> Self {
        self.at_end = at_end;
        self
    }
}
