//! Files that hold a key: nobody else may read them.

use std::io::Read;
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};

/// Bytes of such a file at most: a key and two certificates are some three thousand.
const BYTES_MAX: u64 = 64 * 1024;

/// A file with a key cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyFileError {
    /// It cannot be read.
    #[error("{}: {error}", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// The error of the system.
        error: std::io::Error,
    },
    /// Others may read the key.
    #[error("{}: others may read this key (mode {mode:03o}); make it yours alone: chmod 600 {}", path.display(), path.display())]
    NotPrivate {
        /// Which file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
}

/// What is in the file, if it is a regular one that others cannot read.
pub(crate) fn read_private(path: &Path) -> Result<Vec<u8>, KeyFileError> {
    let unreadable = |error: std::io::Error| KeyFileError::Unreadable { path: path.into(), error };
    // A pipe in its place is not waited for.
    let file = rustix::fs::open(path, OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NONBLOCK, Mode::empty());
    let file = std::fs::File::from(file.map_err(|error| unreadable(error.into()))?);
    let stat = rustix::fs::fstat(&file).map_err(|error| unreadable(error.into()))?;
    if !rustix::fs::FileType::from_raw_mode(stat.st_mode).is_file() {
        return Err(unreadable(std::io::Error::other("it is no regular file")));
    }
    let mode = stat.st_mode & 0o777;
    // A file of root may be handed to a service by its group, as systemd does with credentials.
    let handed_over = stat.st_uid == 0 && !rustix::process::geteuid().is_root();
    if mode & if handed_over { 0o037 } else { 0o077 } != 0 {
        return Err(KeyFileError::NotPrivate { path: path.into(), mode });
    }
    let mut text = Vec::new();
    file.take(BYTES_MAX).read_to_end(&mut text).map_err(unreadable)?;
    Ok(text)
}
