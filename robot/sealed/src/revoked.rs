//! Revoked passes, which are invalid although they have not expired. The authority lists their serial numbers.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use downbeat_key_file::{KeyFileError, Versioned, Watched, read_regular};

/// Maximum size of a list in bytes. A serial number takes about 60 bytes.
const BYTES_MAX: u64 = 8 * 1024 * 1024;
/// Last line of a list. A list without it is incomplete.
const END: &str = "# end\n";
/// Text before the number of a list.
const NUMBER: &str = "# number ";

/// A file that lists revoked passes, one serial number per line. Lines that start with `#` are ignored, except `# number N`, which states
/// the number of the list: a list with a smaller number does not replace this one. If the file is replaced, the new list applies within
/// a second, even to open connections.
#[derive(Clone, Debug)]
pub struct RevokedSerials {
    path: PathBuf,
}

impl RevokedSerials {
    /// Returns the list in this file.
    ///
    /// # Errors
    /// The file cannot be read at present, or is not a list of serial numbers.
    pub fn in_file(path: &Path) -> Result<Self, KeyFileError> {
        Serials::read(path)?;
        Ok(Self { path: path.into() })
    }

    /// Reads the current list from the file.
    ///
    /// # Errors
    /// Those of [`RevokedSerials::in_file`].
    pub fn read(&self) -> Result<Serials, KeyFileError> {
        Serials::read(&self.path)
    }
}

/// The content of a list of revoked passes.
#[derive(Clone, Debug, Default)]
pub struct Serials {
    number: u64,
    revoked: BTreeSet<String>,
}

impl Serials {
    fn read(path: &Path) -> Result<Self, KeyFileError> {
        let text = read_regular(path, BYTES_MAX)?;
        Self::of_text(&String::from_utf8_lossy(&text), path)
    }

    /// Parses the text of a list. Errors name `path` as its file.
    fn of_text(text: &str, path: &Path) -> Result<Self, KeyFileError> {
        let unreadable = |reason: &str| {
            let error = std::io::Error::other(reason.to_owned());
            Err(KeyFileError::Unreadable { path: path.into(), error })
        };
        // A list that was cut off would admit operators that it no longer contains.
        let Some(text) = text.strip_suffix(END) else { return unreadable("it does not end with `# end`") };
        let number = text.lines().find_map(|line| line.strip_prefix(NUMBER)?.parse().ok());
        let lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
        let is_serial =
            |line: &str| line.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f' | b':'));
        let mut revoked = BTreeSet::new();
        for line in lines {
            if !is_serial(line) {
                return unreadable("it is not a list of revoked passes such as revoked.serials");
            }
            revoked.insert(line.to_owned());
        }
        Ok(Self { number: number.unwrap_or_default(), revoked })
    }

    /// Returns the number of the list; 0 if it has none. A newer list has a larger number.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// Whether the list contains the pass with this serial number.
    #[must_use]
    pub fn contains(&self, serial: &str) -> bool {
        self.revoked.contains(serial)
    }
}

impl Versioned for Serials {
    fn is_older_than(&self, other: &Self) -> bool {
        self.number < other.number
    }

    fn number(&self) -> Option<u64> {
        Some(self.number)
    }
}

/// A list that is read again when its file changes. An older list does not replace it.
#[derive(Debug)]
pub(super) struct CurrentSerials {
    file: Watched<Serials>,
}

impl CurrentSerials {
    pub(super) fn new(revoked: &RevokedSerials) -> Result<Self, KeyFileError> {
        Ok(Self { file: Watched::new(&revoked.path, Serials::read)?.storing_number()? })
    }

    /// Stores this list in the file and uses it if it is newer than the list in use. Does nothing if both are equally new.
    pub(super) fn replace(&self, text: &str) -> Result<(), String> {
        let list = Serials::of_text(text, self.file.path()).map_err(|error| error.to_string())?;
        self.file.replace(text, list)
    }

    /// Returns the list in use, without accessing the file.
    pub(super) fn latest(&self) -> Arc<Serials> {
        self.file.latest()
    }

    /// Reads the file again if it has changed, and returns the list in use.
    pub(super) fn list(&self) -> Arc<Serials> {
        self.file.refresh(Serials::read)
    }
}
