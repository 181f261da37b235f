//! The largest number of all versions of a file that were in use. It is stored next to the file, so that an old version is detected even
//! after a restart.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::{KeyFileError, read_regular, replace};

/// Maximum size of a file with a number, in bytes.
const BYTES_MAX: u64 = 32;

/// Returns the path of the file with the number: `revoked.pem.number` for `revoked.pem`.
pub(super) fn file_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".number");
    name.into()
}

/// Returns the stored number. `None` if the file with the number is missing or damaged.
fn stored(path: &Path) -> Option<u64> {
    let text = read_regular(&file_of(path), BYTES_MAX).ok()?;
    std::str::from_utf8(&text).ok()?.trim().parse().ok()
}

/// Checks a version that is used for the first time since the process started.
///
/// # Errors
/// The number is smaller than the stored one.
pub(super) fn check(path: &Path, number: u64) -> Result<(), KeyFileError> {
    match stored(path) {
        Some(latest) if number < latest => Err(KeyFileError::Older { path: path.into(), number, latest }),
        Some(_) => Ok(()),
        None => {
            tracing::warn!(
                "{}: no number of an earlier list is stored here, so an old list cannot be detected; list {number} is used",
                file_of(path).display()
            );
            Ok(())
        }
    }
}

/// Stores the number of a version in use, unless it is smaller than the stored one. If it cannot be stored, logs the reason.
pub(super) fn raise(path: &Path, number: u64) {
    // Robots of one process may share a file.
    static WRITING: Mutex<()> = Mutex::new(());
    let _writing = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    if number <= stored(path).unwrap_or(0) {
        return;
    }
    let file = file_of(path);
    if let Err(error) = replace(&file, format!("{number}\n").as_bytes(), 0o644) {
        tracing::warn!(
            "cannot write {}: {error}; after a restart, a list older than list {number} will not be detected",
            file.display()
        );
    }
}
