//! Passes that count no more, though they have not expired: the authority's list of their numbers.

use std::path::{Path, PathBuf};

use downbeat_key_file::{KeyFileError, read_regular};

/// Bytes of a list at most: a number takes some 60.
const BYTES_MAX: u64 = 8 * 1024 * 1024;

/// A file with the number of a revoked pass in each line; lines that begin with `#` say nothing. Replace the file, and the next
/// connection obeys it.
#[derive(Clone, Debug)]
pub struct RevokedSerials {
    path: PathBuf,
}

impl RevokedSerials {
    /// A list in this file.
    ///
    /// # Errors
    /// It cannot be read now, or is something else.
    pub fn in_file(path: &Path) -> Result<Self, KeyFileError> {
        let revoked = Self { path: path.into() };
        revoked.read()?;
        Ok(revoked)
    }

    /// The numbers as they are now.
    pub(super) fn read(&self) -> Result<Vec<String>, KeyFileError> {
        let unreadable = |error| KeyFileError::Unreadable { path: self.path.clone(), error };
        let text = read_regular(&self.path, BYTES_MAX)?;
        let text = String::from_utf8_lossy(&text);
        let lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
        let is_serial =
            |line: &str| line.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f' | b':'));
        lines
            .map(|line| {
                if is_serial(line) {
                    Ok(line.to_owned())
                } else {
                    Err(unreadable(std::io::Error::other(
                        "this is no list of revoked passes, as `downbeat keys` writes it to revoked.serials",
                    )))
                }
            })
            .collect()
    }
}
