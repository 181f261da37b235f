//! A disk that loses power, tears what is being written, and runs full.

use std::io;

use super::disk::Disk;

/// The file of a journal on a simulated disk.
#[derive(Clone, Debug, Default)]
pub struct SimulatedDisk {
    bytes: Vec<u8>,
    /// Bytes from the beginning that survive a loss of power.
    synced: usize,
    /// The file cannot grow beyond this many bytes.
    capacity: Option<usize>,
}

impl SimulatedDisk {
    /// An empty file that cannot grow beyond `capacity` bytes.
    #[must_use]
    pub fn with_capacity(capacity: Option<usize>) -> Self {
        Self { capacity, ..Self::default() }
    }

    /// What the file contains.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Bytes that a loss of power may tear off.
    #[must_use]
    pub const fn at_risk(&self) -> usize {
        self.bytes.len() - self.synced
    }

    /// Bytes from the beginning that survive a loss of power.
    #[must_use]
    pub const fn synced(&self) -> usize {
        self.synced
    }

    /// The power fails. Only the first `survive` bytes of those that were not synced remain.
    pub fn lose_power(&mut self, survive: usize) {
        self.bytes.truncate(self.synced + survive);
        self.synced = self.bytes.len();
    }

    /// The file can grow again.
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
