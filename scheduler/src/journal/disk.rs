//! Where the bytes of a journal lie: in a file, or on the disk of a simulation.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

use super::lock;
use super::private::{self, How};

/// As much of a disk as a journal needs: one file that grows at its end.
pub trait Disk {
    /// All bytes of the file.
    ///
    /// # Errors
    /// The disk cannot be read.
    fn read(&mut self) -> io::Result<Vec<u8>>;

    /// Cuts the file to this length in bytes, on the disk when this returns.
    ///
    /// # Errors
    /// The disk does not take it.
    fn truncate(&mut self, length: u64) -> io::Result<()>;

    /// Adds bytes to the end of the file. They may be lost until [`Disk::sync`] has returned.
    ///
    /// # Errors
    /// The disk does not take them, or only some of them.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Returns once everything appended survives a loss of power.
    ///
    /// # Errors
    /// What was appended may be lost.
    fn sync(&mut self) -> io::Result<()>;
}

/// A file, locked as long as this lives.
#[derive(Debug)]
pub struct FileDisk(File);

impl FileDisk {
    /// Opens or creates `journal` in a folder, which is created as well, and locks it. Both are for this user alone.
    ///
    /// # Errors
    /// The file cannot be opened, is not for this user alone, or another process holds the lock.
    pub fn open(folder: &Path) -> io::Result<Self> {
        private::create_folder(folder)?;
        let new = !folder.join("journal").exists();
        let file = private::file(folder, "journal", How::Create)?;
        lock::take(&file)?;
        // The names of a new file and a new folder are on the disk only then.
        for folder in [Some(folder), folder.parent()].into_iter().flatten().filter(|_| new) {
            // Some file systems cannot do it.
            if let Err(error) = File::open(folder).and_then(|folder| folder.sync_all()) {
                tracing::debug!("cannot sync {}: {error}", folder.display());
            }
        }
        Ok(Self(file))
    }

    /// Opens and locks a `journal` that is there, without waiting for the disk.
    ///
    /// # Errors
    /// There is none that can be written, or another process holds the lock.
    pub fn take_up(folder: &Path) -> io::Result<Self> {
        let file = private::file(folder, "journal", How::Append)?;
        lock::take(&file)?;
        Ok(Self(file))
    }
}

impl Disk for FileDisk {
    fn read(&mut self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.0.seek(SeekFrom::Start(0))?;
        self.0.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.0.set_len(length)?;
        self.0.sync_all()
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.0.sync_data()
    }
}
