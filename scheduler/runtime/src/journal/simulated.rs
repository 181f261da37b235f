//! A disk that can lose power, tear the data being written, and become full.

use std::io;

use super::disk::Disk;

/// The file of a journal on a simulated disk.
#[derive(Clone, Debug, Default)]
pub struct SimulatedDisk {
    bytes: Vec<u8>,
    /// Number of bytes at the beginning of the file that survive a power loss.
    synced: usize,
    /// Maximum size of the file in bytes. `None` for no limit.
    capacity: Option<usize>,
}

impl SimulatedDisk {
    /// Creates an empty file that cannot grow beyond `capacity` bytes. `None` sets no limit.
    #[must_use]
    pub fn with_capacity(capacity: Option<usize>) -> Self {
        Self { capacity, ..Self::default() }
    }

    /// Returns the contents of the file.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the number of bytes that a power loss may destroy.
    #[must_use]
    pub const fn at_risk(&self) -> usize {
        self.bytes.len() - self.synced
    }

    /// Returns the number of bytes at the beginning of the file that survive a power loss.
    #[must_use]
    pub const fn synced(&self) -> usize {
        self.synced
    }

    /// Simulates a power loss. Only the first `survive` unsynced bytes remain.
    pub fn lose_power(&mut self, survive: usize) {
        self.bytes.truncate(self.synced + survive);
        self.synced = self.bytes.len();
    }

    /// Removes the size limit.
    pub const fn make_room(&mut self) {
        self.capacity = None;
    }
}

impl Disk for SimulatedDisk {
    fn read(&mut self) -> io::Result<Vec<u8>> {
        Ok(self.bytes.clone())
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.bytes.truncate(usize::try_from(length).unwrap_or(usize::MAX));
        self.synced = self.bytes.len();
        Ok(())
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let room = self.capacity.map_or(bytes.len(), |capacity| capacity.saturating_sub(self.bytes.len()));
        self.bytes.extend_from_slice(&bytes[..bytes.len().min(room)]);
        if bytes.len() <= room { Ok(()) } else { Err(io::ErrorKind::StorageFull.into()) }
    }

    fn sync(&mut self) -> io::Result<()> {
        self.synced = self.bytes.len();
        Ok(())
    }
}
