//! Reads ZIP archives of other programs, with limits for the number of files, the unpacked size of each, and their total size.

use std::io::{Cursor, Read};

use memchr::memmem;
use zip::ZipArchive;
use zip::result::ZipError;

use super::malformed::Malformed;

/// Maximum number of files in an archive.
const FILES_MAX: usize = 50_000;
/// Maximum unpacked size of a file, and of all files together, in bytes.
const FILE_BYTES_MAX: u64 = 8 << 20;
const ALL_BYTES_MAX: u64 = 128 << 20;
/// The signature at the start of each entry in the directory of a ZIP archive.
const ENTRY: &[u8] = b"PK\x01\x02";

/// An archive that is being read.
pub(super) struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    left: u64,
}

impl<'a> Archive<'a> {
    /// Opens an archive. If this fails, returns the reason.
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self, Malformed> {
        let entries = memmem::find_iter(bytes, ENTRY).take(FILES_MAX + 1).count();
        if entries > FILES_MAX {
            return Err(format!("the archive has more than {FILES_MAX} files").into());
        }
        let zip = ZipArchive::new(Cursor::new(bytes))
            .map_err(|error| format!("this is not a ZIP archive: {error}"))?;
        Ok(Self { zip, left: ALL_BYTES_MAX })
    }

    /// Returns the names of the files, in the order of the archive.
    pub(super) fn names(&self) -> impl Iterator<Item = String> {
        let names = self.zip.file_names().filter_map(Result::ok);
        names.filter(|name| !name.ends_with('/')).map(std::borrow::Cow::into_owned)
    }

    /// Unpacks one file. If this fails, returns the reason.
    pub(super) fn file(&mut self, name: &str) -> Result<Vec<u8>, Malformed> {
        let file = self.zip.by_name(name).map_err(|error| match error {
            ZipError::FileNotFound => "the archive has no such file".to_owned(),
            other => format!("the archive cannot be unpacked: {other}"),
        })?;
        let most = FILE_BYTES_MAX.min(self.left);
        let mut bytes = Vec::new();
        // The size that the archive states for a file is not trusted.
        let read = file.take(most + 1).read_to_end(&mut bytes);
        read.map_err(|error| format!("the archive cannot be unpacked: {error}"))?;
        let size = bytes.len() as u64;
        self.left = self.left.saturating_sub(size);
        match size > most {
            false => Ok(bytes),
            true if most < FILE_BYTES_MAX => {
                Err(format!("the unpacked archive has more than {ALL_BYTES_MAX} bytes").into())
            }
            true => Err(format!("the unpacked file has more than {FILE_BYTES_MAX} bytes").into()),
        }
    }
}
