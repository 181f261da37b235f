//! The list of a robot's devices. All copies of the robot's description share one list in memory.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use serde::{Serialize, Serializer};

use super::Device;

/// The devices in an initialization block. A clone shares the list with its original until either is changed, so that cloning a
/// description with thousands of devices is cheap.
///
/// ```
/// use urrcp::{Device, DeviceId, Devices};
/// let devices: Devices = vec![Device::new(DeviceId::new("lamp")?)].into();
/// assert!(devices.clone().is_same(&devices));
/// assert_eq!(devices[0].id.as_str(), "lamp");
/// # Ok::<(), urrcp::LimitError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Devices(Arc<Vec<Device>>);

impl Devices {
    /// Whether `self` and `other` share one list in memory.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Deref for Devices {
    type Target = Vec<Device>;

    fn deref(&self) -> &Vec<Device> {
        &self.0
    }
}

impl DerefMut for Devices {
    fn deref_mut(&mut self) -> &mut Vec<Device> {
        Arc::make_mut(&mut self.0)
    }
}

impl PartialEq for Devices {
    fn eq(&self, other: &Self) -> bool {
        self.is_same(other) || self.0 == other.0
    }
}

impl Serialize for Devices {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl From<Vec<Device>> for Devices {
    fn from(devices: Vec<Device>) -> Self {
        Self(Arc::new(devices))
    }
}

impl FromIterator<Device> for Devices {
    fn from_iter<I: IntoIterator<Item = Device>>(devices: I) -> Self {
        Self(Arc::new(devices.into_iter().collect()))
    }
}

impl<'a> IntoIterator for &'a Devices {
    type Item = &'a Device;
    type IntoIter = std::slice::Iter<'a, Device>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DeviceId;

    #[test]
    fn copy_shares_its_devices_until_it_is_changed() {
        let original: Devices = std::iter::once(Device::new(DeviceId::new("lamp").unwrap())).collect();
        let mut copy = original.clone();
        assert!(copy.is_same(&original));
        copy[0].script_queue = 7;
        assert!(!copy.is_same(&original));
        assert_eq!((original[0].script_queue, copy[0].script_queue), (1, 7));
    }
}
