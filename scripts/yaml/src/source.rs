//! Reads UTF-8 text files of limited size.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

use crate::finding::{Code, Finding, did_you_mean};
use crate::formats;
use crate::open::open;
use crate::refusal::{Attempt, Refusal};

/// Maximum size of a file that is read, in bytes (64 MiB).
pub const FILE_BYTES_MAX: u64 = 64 * 1024 * 1024;

/// Maximum number of files in a folder whose names are compared with that of a missing file.
const SIMILAR_MAX: usize = 1_000;

/// The byte order mark, which some editors write at the beginning of a file.
pub const BYTE_ORDER_MARK: char = '\u{feff}';
const BYTE_ORDER_MARK_BYTES: &[u8] = &[0xef, 0xbb, 0xbf];

/// The text of a file, and the name that messages use for the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// The name of the file, for messages.
    pub name: String,
    /// The text of the file.
    pub text: String,
}

impl Source {
    /// Reads a file of at most 64 MiB that the user has named: a regular file, or a pipe of the user's shell.
    ///
    /// # Errors
    /// Returns a finding if the file cannot be read, is larger than 64 MiB, or is not UTF-8 text.
    pub fn read(path: &Path) -> Result<Self, Finding> {
        Self::of_bytes(&path.display().to_string(), read_bytes(path)?)
    }

    /// Decodes bytes as text.
    ///
    /// # Errors
    /// Returns a finding if the bytes are not UTF-8 text.
    pub fn of_bytes(name: &str, mut bytes: Vec<u8>) -> Result<Self, Finding> {
        // The byte order mark of some editors carries no information in UTF-8.
        if bytes.starts_with(BYTE_ORDER_MARK_BYTES) {
            bytes.drain(..BYTE_ORDER_MARK_BYTES.len());
        }
        let text = String::from_utf8(bytes).map_err(|error| {
            let valid = error.utf8_error().valid_up_to();
            not_text(name, error.as_bytes(), valid)
        })?;
        Ok(Self { name: name.to_owned(), text })
    }
}

const USE_A_TEXT_FILE: &str = "use a text file";
const USE_A_FILE_IN_IT: &str = "use a file in this folder";

/// Whether `hint` comes from this module and states only the kind of file that is needed. A more specific hint may then replace it.
#[must_use]
pub fn is_general(hint: &str) -> bool {
    [USE_A_TEXT_FILE, USE_A_FILE_IN_IT].contains(&hint)
}

/// Returns the finding for a file that is not UTF-8 text. `valid` is the number of valid bytes at its beginning.
fn not_text(name: &str, bytes: &[u8], valid: usize) -> Finding {
    let in_excel = if name.ends_with(".csv") { "; in Excel, as `CSV UTF-8`" } else { "" };
    let save = || format!("save the file with UTF-8 encoding{in_excel}");
    let line = 1 + bytes[..valid].iter().filter(|byte| **byte == b'\n').count();
    let (message, hint) = match formats::binary(bytes) {
        Some(what) => {
            let hint = formats::importing(name).unwrap_or_else(|| USE_A_TEXT_FILE.to_owned());
            (format!("this is {what}, not a text file"), hint)
        }
        None if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") => {
            ("the encoding of this file is UTF-16".to_owned(), save())
        }
        None if bytes.contains(&0) => {
            // A CSV file would be text.
            let import = formats::importing(name).filter(|_| !name.ends_with(".csv"));
            ("this is not a text file".to_owned(), import.unwrap_or_else(|| USE_A_TEXT_FILE.to_owned()))
        }
        None => (format!("line {line} contains a character that is not encoded in UTF-8"), save()),
    };
    Finding::about_file(Code::Unreadable, name, message, "a text file in UTF-8", Some(hint))
}

/// Returns a hint with the file in the same folder that the user probably meant.
fn similar(path: &Path) -> Option<String> {
    let wanted = path.file_name()?.to_str()?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).ok()?.take(SIMILAR_MAX).filter_map(Result::ok);
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    let with_ending =
        names.iter().find(|name| Path::new(name).file_stem().is_some_and(|stem| stem == wanted));
    match with_ending {
        Some(name) => Some(format!("did you mean `{}`?", path.with_file_name(name).display())),
        None => {
            let question = did_you_mean(wanted, names.iter().map(String::as_str))?;
            let name = question.split('`').nth(1)?;
            Some(format!("did you mean `{}`?", path.with_file_name(name).display()))
        }
    }
}

/// Reads the bytes of a file that the user has named. Returns a finding if the file cannot be read or is larger than 64 MiB.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, Finding> {
    bytes_of(path, open(path).map_err(|error| refused(path, &error))?)
}

/// Reads the bytes of an open file. Returns a finding if the file cannot be read or is larger than 64 MiB. `path` is only used in
/// messages.
pub fn bytes_of(path: &Path, file: File) -> Result<Vec<u8>, Finding> {
    let refused = |error| refused(path, &error);
    let size = file.metadata().map_err(refused)?.len();
    let too_large = |size: u64| {
        let message = format!("the file has {size} bytes, but the limit is {FILE_BYTES_MAX}");
        unreadable(path, message, Some("split it into several files".to_owned()))
    };
    if size > FILE_BYTES_MAX {
        return Err(too_large(size));
    }
    let mut bytes = Vec::new();
    // The size of a pipe is not known in advance.
    file.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes).map_err(refused)?;
    if bytes.len() as u64 > FILE_BYTES_MAX {
        return Err(too_large(bytes.len() as u64));
    }
    // A finding would quote the content, and its reader may publish the finding.
    if formats::is_secret(&bytes) {
        let message = "this file contains a private key, a secret or passes, so it is not read".to_owned();
        return Err(unreadable(path, message, Some("check the path".to_owned())));
    }
    Ok(bytes)
}

/// Returns the finding for a file that cannot be opened or read.
pub fn refused(path: &Path, error: &io::Error) -> Finding {
    if error.kind() == ErrorKind::IsADirectory {
        let hint = Some(USE_A_FILE_IN_IT.to_owned());
        return unreadable(path, "this is a folder, not a file".to_owned(), hint);
    }
    let Refusal { reason, remedy } = Refusal::of(Attempt::Read(path), error);
    let hint = remedy.or_else(|| similar(path).filter(|_| error.kind() == ErrorKind::NotFound));
    unreadable(path, reason, hint)
}

fn unreadable(path: &Path, message: String, hint: Option<String>) -> Finding {
    Finding::about_file(Code::Unreadable, &path.display().to_string(), message, "a readable file", hint)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn byte_order_mark_is_removed_from_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("show.yaml");
        std::fs::write(&path, "\u{feff}scenario: show\n").unwrap();
        assert_eq!(Source::read(&path).unwrap().text, "scenario: show\n");
    }

    #[test]
    fn files_with_secrets_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_bytes(&path)
        };
        let digits = "0123456789abcdef".repeat(4);
        for secret in [
            "-----BEGIN PRIVATE KEY-----\nMIGH\n-----END PRIVATE KEY-----\n".to_owned(),
            "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n-----BEGIN EC PRIVATE KEY-----\nMIGH\n".to_owned(),
            "-----BEGIN OPENSSH PRIVATE KEY-----\r\nb3Bl\r\n".to_owned(),
            format!("# The secret of robot r0. Copy it only to this robot.\n{digits}\n"),
            digits.to_uppercase(),
            "# Passes for robots with a secret, written by `downbeat keys`: robot, claim, pass.\nr0 ab cd\n".to_owned(),
        ] {
            let finding = read(&secret).unwrap_err();
            assert!(finding.message.contains("so it is not read"), "{secret}: {finding:?}");
            assert!(!format!("{finding:?}").contains(&secret[secret.len() - 10..secret.len() - 1]));
        }
        for other in [
            "doc: about -----BEGIN CERTIFICATE-----\n".to_owned(),
            format!("id: {digits}\n"),
            digits[1..].to_owned(),
        ] {
            assert!(read(&other).is_ok(), "{other}");
        }
    }
}
