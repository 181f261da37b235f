//! Files as they are read: bounded in size, UTF-8.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::finding::{Code, Finding};

/// Largest file that is read, in bytes: 64 MiB.
pub(crate) const FILE_BYTES_MAX: u64 = 64 * 1024 * 1024;

const BYTE_ORDER_MARK: &[u8] = &[0xef, 0xbb, 0xbf];

/// The text of a file with the name by which the user knows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// For messages.
    pub name: String,
    /// The text.
    pub text: String,
}

impl Source {
    /// Reads a file of at most 64 MiB.
    ///
    /// # Errors
    /// A finding when it cannot be read, is larger, or is not UTF-8 text.
    pub fn read(path: &Path) -> Result<Self, Finding> {
        Self::of_bytes(&path.display().to_string(), read_bytes(path)?)
    }

    /// The text that some bytes are.
    ///
    /// # Errors
    /// A finding when they are not UTF-8 text.
    pub(crate) fn of_bytes(name: &str, mut bytes: Vec<u8>) -> Result<Self, Finding> {
        // Some editors begin a file with a mark of its byte order, which says nothing here.
        if bytes.starts_with(BYTE_ORDER_MARK) {
            bytes.drain(..BYTE_ORDER_MARK.len());
        }
        let text = String::from_utf8(bytes).map_err(|error| {
            let at = error.utf8_error().valid_up_to();
            let hint = Some("save the file as UTF-8 text".to_owned());
            let message = format!("byte {} is not UTF-8: this is no text", at + 1);
            Finding::about_file(Code::Unreadable, name, message, "a text file", hint)
        })?;
        Ok(Self { name: name.to_owned(), text })
    }
}

/// The bytes of a file of at most 64 MiB, or a finding when it cannot be read or is larger.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>, Finding> {
    let name = path.display().to_string();
    let unreadable = |message: String, hint: Option<&str>| {
        let hint = hint.map(str::to_owned);
        Finding::about_file(Code::Unreadable, &name, message, "a readable file", hint)
    };
    let file = File::open(path).map_err(|error| unreadable(error.to_string(), None))?;
    let metadata = file.metadata().map_err(|error| unreadable(error.to_string(), None))?;
    if metadata.is_dir() {
        return Err(unreadable("this is a directory".into(), Some("name a file in it")));
    }
    let size = metadata.len();
    let too_large = |size: u64| {
        let message = format!("the file has {size} bytes, the limit is {FILE_BYTES_MAX}");
        unreadable(message, Some("split it into several files"))
    };
    if size > FILE_BYTES_MAX {
        return Err(too_large(size));
    }
    let mut bytes = Vec::new();
    // A pipe has no size to ask for beforehand.
    let read = file.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes);
    read.map_err(|error| unreadable(error.to_string(), None))?;
    if bytes.len() as u64 > FILE_BYTES_MAX {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_order_mark_is_no_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("show.yaml");
        std::fs::write(&path, "\u{feff}scenario: show\n").unwrap();
        assert_eq!(Source::read(&path).unwrap().text, "scenario: show\n");
    }
}
