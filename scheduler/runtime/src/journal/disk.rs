//! The storage of a journal: a file, or the disk of a simulation.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use rustix::io::Errno;

use super::lock;
use super::private::{self, How};

/// The parts of a disk that a journal needs: one file that grows at its end.
pub trait Disk {
    /// Returns all bytes of the file.
    ///
    /// # Errors
    /// Fails if the disk cannot be read.
    fn read(&mut self) -> io::Result<Vec<u8>>;

    /// Cuts the file to `length` bytes. The change is on the disk when this function returns.
    ///
    /// # Errors
    /// Fails if the disk refuses the change.
    fn truncate(&mut self, length: u64) -> io::Result<()>;

    /// Adds bytes to the end of the file. They may be lost until [`Disk::sync`] has returned.
    ///
    /// # Errors
    /// Fails if the disk refuses the bytes or accepts only some of them.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Writes all appended bytes to the disk. When this function returns, they would survive a power loss.
    ///
    /// # Errors
    /// If it fails, the appended bytes may be lost.
    fn sync(&mut self) -> io::Result<()>;

    /// Makes sure that the file can be found under its name. If the file was removed or replaced, writes its full contents there again
    /// and returns once they are on the disk.
    ///
    /// # Errors
    /// Fails if the file was removed or replaced and cannot be written again.
    fn keep_name(&mut self) -> io::Result<Name> {
        Ok(Name::Kept)
    }
}

/// The result of [`Disk::keep_name`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Name {
    /// The file can be found under its name.
    Kept,
    /// The file could not be found under its name, and has been written again.
    WrittenAgain,
}

/// Maximum number of earlier journal files that stay locked after someone moved them away.
const ELSEWHERE_MAX: usize = 8;

/// A journal file on a real disk. It stays locked while this value lives.
#[derive(Debug)]
pub struct FileDisk {
    folder: PathBuf,
    file: File,
    /// Earlier files of the same journal that someone moved away. They stay locked, which shows that the scheduler still runs.
    elsewhere: Vec<File>,
}

impl FileDisk {
    /// Opens or creates `journal` in a folder and locks it. Creates the folder if necessary. Folder and file are accessible to this user
    /// only.
    ///
    /// # Errors
    /// Fails if the file cannot be opened, if other users have access to it, or if another process holds the lock.
    pub fn open(folder: &Path) -> io::Result<Self> {
        private::create_folder(folder)?;
        let new = !folder.join(JOURNAL).exists();
        let file = private::file(folder, JOURNAL, How::Create)?;
        lock::take(&file)?;
        // Only syncing the parent folder puts the name of a new file or folder on the disk.
        for folder in [Some(folder), folder.parent()].into_iter().flatten().filter(|_| new) {
            // Some file systems cannot sync a folder.
            if let Err(error) = File::open(folder).and_then(|folder| folder.sync_all()) {
                tracing::debug!("cannot sync {}: {error}", folder.display());
            }
        }
        Ok(Self::of(folder, file))
    }

    /// Opens and locks an existing `journal`, without waiting for the disk.
    ///
    /// # Errors
    /// Fails if no writable journal exists, or if another process holds the lock.
    pub fn take_up(folder: &Path) -> io::Result<Self> {
        let file = private::file(folder, JOURNAL, How::Append)?;
        lock::take(&file)?;
        Ok(Self::of(folder, file))
    }

    fn of(folder: &Path, file: File) -> Self {
        Self { folder: folder.to_path_buf(), file, elsewhere: Vec::new() }
    }

    /// Whether the name `journal` in the folder still refers to the open file. An error that reports a missing file counts as `false`.
    /// Any other error, for example from an unreachable network file system, counts as `true`.
    fn is_named(&self) -> io::Result<bool> {
        let own = rustix::fs::fstat(&self.file)?;
        match rustix::fs::lstat(self.folder.join(JOURNAL)) {
            Ok(found) => Ok((found.st_dev, found.st_ino) == (own.st_dev, own.st_ino)),
            Err(Errno::NOENT | Errno::NOTDIR) => Ok(false),
            Err(error) => {
                tracing::debug!("cannot check the journal in {}: {error}", self.folder.display());
                Ok(true)
            }
        }
    }

    /// Writes the whole file under its name. A file that already has this name may contain only the beginning of the same contents.
    fn write_again(&mut self) -> io::Result<()> {
        let bytes = self.read()?;
        if let Some(state) = self.folder.parent() {
            private::create_folder(state)?;
        }
        let mut again = Self::open(&self.folder)?;
        let there = again.read()?;
        let Some(missing) = bytes.strip_prefix(&there[..]) else {
            return Err(io::Error::other("another file is in its place"));
        };
        again.append(missing)?;
        again.sync()?;
        let before = std::mem::replace(&mut self.file, again.file);
        if rustix::fs::fstat(&before).is_ok_and(|before| before.st_nlink > 0) {
            self.elsewhere.truncate(ELSEWHERE_MAX - 1);
            self.elsewhere.insert(0, before);
        }
        Ok(())
    }
}

const JOURNAL: &str = "journal";

impl Disk for FileDisk {
    fn read(&mut self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.file.seek(SeekFrom::Start(0))?;
        self.file.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.file.set_len(length)?;
        self.file.sync_all()
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.sync_data()
    }

    fn keep_name(&mut self) -> io::Result<Name> {
        if self.is_named()? {
            return Ok(Name::Kept);
        }
        self.write_again().map(|()| Name::WrittenAgain)
    }
}
