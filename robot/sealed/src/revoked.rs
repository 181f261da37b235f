//! Passes that are invalid although they have not expired. The authority lists their serial numbers.

use std::path::{Path, PathBuf};

use downbeat_key_file::{KeyFileError, read_regular};

/// Maximum size of a list in bytes. A serial number takes about 60 bytes.
const BYTES_MAX: u64 = 8 * 1024 * 1024;

/// A file that lists revoked passes, one serial number per line. Lines that start with `#` are ignored. After the file is replaced, the
/// new list applies from the next connection.
#[derive(Clone, Debug)]
pub struct RevokedSerials {
    path: PathBuf,
}

impl RevokedSerials {
    /// Returns the list that is in this file.
    ///
    /// # Errors
    /// The file cannot be read now, or is not a list of serial numbers.
    pub fn in_file(path: &Path) -> Result<Self, KeyFileError> {
        let revoked = Self { path: path.into() };
        revoked.read()?;
        Ok(revoked)
    }

    /// Reads the current serial numbers from the file.
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
                        "it is not a list of revoked passes such as revoked.serials",
                    )))
                }
            })
            .collect()
    }
}
