//! Reads files that contain a key, and refuses those that other users can read. Watches files that are replaced while they are in use.

mod number;
mod replaced;
mod watched;

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

pub use replaced::replace;
use rustix::fs::{Mode, OFlags, Stat};
pub use watched::{Versioned, Watched};

/// Maximum size of a key file in bytes. A key and two certificates take about three thousand bytes.
const BYTES_MAX: u64 = 64 * 1024;

/// An error in a key file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyFileError {
    /// The file cannot be read.
    #[error("{}: {error}; expected a file that `downbeat keys` wrote", path.display())]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
    /// Other users can read the key.
    #[error("{}: other users can read this key (mode {mode:03o}); restrict access with `chmod 600 {}`", path.display(), path.display())]
    NotPrivate {
        /// Path of the file.
        path: PathBuf,
        /// Permission bits of the file.
        mode: u32,
    },
    /// A later version of the file was in use before.
    #[error("{}: this is list {number}, but list {latest} was already in use here; copy the latest list of the authority to this path, or delete {} if you have replaced the authority", path.display(), number::file_of(path).display())]
    Older {
        /// Path of the file.
        path: PathBuf,
        /// Number of the version in the file.
        number: u64,
        /// Largest number of all versions that were in use.
        latest: u64,
    },
}

/// Reads a regular file that contains a key. Refuses a file that other users can read.
pub fn read_private(path: &Path) -> Result<Vec<u8>, KeyFileError> {
    read_private_of(path, BYTES_MAX)
}

/// Like [`read_private`], for a file of at most `bytes_max` bytes.
pub fn read_private_of(path: &Path, bytes_max: u64) -> Result<Vec<u8>, KeyFileError> {
    let (file, stat) = open_regular(path)?;
    let mode = stat.st_mode & 0o777;
    // The group of a file that belongs to root may be the service that uses it, as with systemd's credentials.
    let handed_over = stat.st_uid == 0 && !rustix::process::geteuid().is_root();
    if mode & if handed_over { 0o037 } else { 0o077 } != 0 {
        return Err(KeyFileError::NotPrivate { path: path.into(), mode });
    }
    read(path, file, bytes_max)
}

/// Reads a regular file of at most `bytes_max` bytes. Other users may be able to read it.
pub fn read_regular(path: &Path, bytes_max: u64) -> Result<Vec<u8>, KeyFileError> {
    read(path, open_regular(path)?.0, bytes_max)
}

fn read(path: &Path, file: File, bytes_max: u64) -> Result<Vec<u8>, KeyFileError> {
    let unreadable = |error| KeyFileError::Unreadable { path: path.into(), error };
    let mut bytes = Vec::new();
    let read = file.take(bytes_max + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    // A truncated file could have a different meaning.
    if u64::try_from(read).is_ok_and(|read| read > bytes_max) {
        return Err(unreadable(io::Error::other(format!("the file is larger than {bytes_max} bytes"))));
    }
    Ok(bytes)
}

/// Opens a file only if it is a regular file, because reading from a pipe would block.
fn open_regular(path: &Path) -> Result<(File, Stat), KeyFileError> {
    let unreadable = |error: io::Error| KeyFileError::Unreadable { path: path.into(), error };
    let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    let file = rustix::fs::open(path, flags, Mode::empty()).map_err(|error| unreadable(error.into()))?;
    let stat = rustix::fs::fstat(&file).map_err(|error| unreadable(error.into()))?;
    if !rustix::fs::FileType::from_raw_mode(stat.st_mode).is_file() {
        return Err(unreadable(io::Error::other("this is not a regular file")));
    }
    Ok((file.into(), stat))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// Creates a file of `bytes` bytes with this mode, and reads it as a private file of at most `bytes_max` bytes. Returns the number of
    /// bytes read, or the error.
    fn read_of(bytes: usize, mode: u32, bytes_max: u64) -> Result<usize, String> {
        let name = format!("downbeat-key-file-{}-{bytes}-{mode:o}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, vec![b'a'; bytes]).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        let read = read_private_of(&path, bytes_max);
        std::fs::remove_file(&path).unwrap();
        read.map(|bytes| bytes.len()).map_err(|error| error.to_string())
    }

    #[test]
    fn key_readable_by_other_users_is_refused() {
        for mode in [0o600, 0o400, 0o700] {
            assert_eq!(read_of(3, mode, 10), Ok(3), "{mode:o}");
        }
        for mode in [0o640, 0o604, 0o620, 0o601, 0o677] {
            let error = read_of(3, mode, 10).unwrap_err();
            assert!(error.contains(&format!("other users can read this key (mode {mode:o})")), "{error}");
        }
    }

    #[test]
    fn file_is_read_completely_or_refused() {
        assert_eq!(read_of(10, 0o600, 10), Ok(10));
        assert!(read_of(11, 0o600, 10).is_err_and(|error| error.contains("larger than 10 bytes")));
    }

    #[test]
    fn path_without_regular_file_is_refused_without_waiting() {
        for path in [std::env::temp_dir(), "/dev/null".into(), "/no/such/file".into()] {
            assert!(
                matches!(read_private(&path), Err(KeyFileError::Unreadable { .. })),
                "{}",
                path.display()
            );
            assert!(read_regular(&path, 10).is_err());
        }
    }
}
