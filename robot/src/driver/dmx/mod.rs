//! Drives DMX512 fixtures over sACN (ANSI E1.31) and Art-Net 4.
//!
//! All robots of this process on the same universe share one [`Universe`], because receivers take each frame as the state of all channels.

mod patch;
mod transport;
mod universe;

use std::time::Duration;

use urrcp::{DeviceId, InitializationBlock, RobotId, Setpoint};

use self::patch::Patch;
pub use self::transport::Protocol;
use self::universe::{Lease, Universe};
use super::{Driver, DriverError, Ramp};

/// Frames per second of a universe whose channels move: slightly below the 44 of a full DMX512 universe.
pub const FRAMES_PER_SECOND: f64 = 40.0;
/// Default priority of an sACN source.
pub const PRIORITY: u8 = 100;

/// The place of a fixture: its protocol, universe and first channel, and how its universe is sent.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DmxAddress {
    /// The protocol by which frames are sent.
    pub protocol: Protocol,
    /// Number of the universe: 1 to 63,999 for sACN, 0 to 32,767 for Art-Net (net, sub-net and universe in one number).
    pub universe: u16,
    /// The fixture's first channel, 1 to 512.
    pub channel: u16,
    /// Host name or IP address of the receiver. `None`: the multicast address of the universe, only for sACN.
    pub host: Option<String>,
    /// Priority of the source, 0 to 200, only for sACN: receivers follow the source with the highest priority.
    pub priority: u8,
    /// What the fixture does when its edge ends.
    pub at_end: AtEnd,
}

/// What the channels of a fixture do when its edge ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum AtEnd {
    /// They keep their last values. When the last robot of a universe ends, receivers are informed that no further frames come.
    #[default]
    Hold,
    /// They go to zero.
    Blackout,
}

impl DmxAddress {
    /// Creates the address of the fixture with this first channel.
    #[must_use]
    pub const fn new(protocol: Protocol, universe: u16, channel: u16, host: Option<String>) -> Self {
        Self { protocol, universe, channel, host, priority: PRIORITY, at_end: AtEnd::Hold }
    }

    /// Sets the priority of the source.
    #[must_use]
    pub const fn with_priority(mut self, priority: u8) -> Self {
        self.priority = priority;
        self
    }

    /// Sets what the fixture does when its edge ends.
    #[must_use]
    pub const fn with_at_end(mut self, at_end: AtEnd) -> Self {
        self.at_end = at_end;
        self
    }
}

/// Drives one DMX fixture.
#[derive(Debug)]
pub struct DmxFixture {
    robot: RobotId,
    address: DmxAddress,
    patch: Patch,
    /// The fixture's share of its universe, while it is connected.
    lease: Option<Lease>,
}

impl DmxFixture {
    /// Creates the driver for a fixture with the devices of `block`. Devices without channels take the channels after those of the
    /// device before them.
    ///
    /// # Errors
    /// [`DriverError::Refused`] if the channels do not fit the devices or the universe.
    pub fn new(address: DmxAddress, block: &InitializationBlock) -> Result<Self, DriverError> {
        let patch = Patch::of(block, address.channel).map_err(DriverError::Refused)?;
        Ok(Self { robot: block.id.clone(), address, patch, lease: None })
    }

    fn lease(&self) -> Result<&Lease, DriverError> {
        self.lease.as_ref().ok_or_else(|| DriverError::Away("the universe is not connected".to_owned()))
    }
}

impl Driver for DmxFixture {
    /// Keeps the universe if it was connected before: its channels keep their levels.
    fn connect(&mut self) -> Result<(), DriverError> {
        if self.lease.is_none() {
            let universe = Universe::of(&self.address).map_err(DriverError::Away)?;
            let (channels, defaults) = (self.patch.channels(), self.patch.defaults());
            let lease = universe.lease(&self.robot, channels, &defaults, self.address.at_end);
            self.lease = Some(lease.map_err(DriverError::Refused)?);
        }
        self.lease()?.retry();
        self.ping()
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        self.set_frame(&[(device.clone(), setpoint.clone())])
    }

    fn set_frame(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), DriverError> {
        let mut levels = Vec::new();
        for (device, setpoint) in values {
            levels.extend(self.patch.levels(device, setpoint).map_err(DriverError::Refused)?);
        }
        self.lease()?.set(&levels);
        Ok(())
    }

    fn takes_frames(&self) -> bool {
        true
    }

    fn ramp(&mut self, device: &DeviceId, ramp: Ramp) -> Result<(), DriverError> {
        let target = Setpoint::new(ramp.control_type, ramp.to);
        let levels = self.patch.levels(device, &target).map_err(DriverError::Refused)?;
        self.lease()?.fade(&levels, ramp.duration);
        Ok(())
    }

    fn takes_ramps(&self) -> bool {
        true
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        Err(DriverError::Refused(format!("`{sensor}` cannot be read: DMX has no way back")))
    }

    /// Waits until everything set before has been sent. DMX has no answers, so this shows only that the network takes the frames.
    fn ping(&mut self) -> Result<(), DriverError> {
        self.lease()?.flush(FLUSH_MAX).map_err(DriverError::Away)
    }
}

/// Maximum time until a frame is sent; normally it takes at most the time of one frame.
const FLUSH_MAX: Duration = Duration::from_millis(500);

#[cfg(test)]
mod tests;
