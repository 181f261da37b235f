//! Zip archives of other programs, within bounds: how many files, how large each is when unpacked, and all of them.

use std::io::{Cursor, Read};

use memchr::memmem;
use zip::ZipArchive;
use zip::result::ZipError;

/// Most files of an archive.
const FILES_MAX: usize = 50_000;
/// Largest file that is unpacked, and all that are, in bytes.
const FILE_BYTES_MAX: u64 = 8 << 20;
const ALL_BYTES_MAX: u64 = 128 << 20;
/// What stands before every entry of a zip's directory.
const ENTRY: &[u8] = b"PK\x01\x02";

/// An archive that is being read.
pub(super) struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    left: u64,
}

impl<'a> Archive<'a> {
    /// Opens it, or says why not.
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self, String> {
        let entries = memmem::find_iter(bytes, ENTRY).take(FILES_MAX + 1).count();
        if entries > FILES_MAX {
            return Err(format!("the archive has more than {FILES_MAX} files"));
        }
        let zip = ZipArchive::new(Cursor::new(bytes))
            .map_err(|error| format!("this is not a ZIP archive: {error}"))?;
        Ok(Self { zip, left: ALL_BYTES_MAX })
    }

    /// The files in it, in the order of the archive.
    pub(super) fn names(&self) -> impl Iterator<Item = String> {
        let names = self.zip.file_names().filter_map(Result::ok);
        names.filter(|name| !name.ends_with('/')).map(std::borrow::Cow::into_owned)
    }

    /// Unpacks one file, or says why not.
    pub(super) fn file(&mut self, name: &str) -> Result<Vec<u8>, String> {
        let file = self.zip.by_name(name).map_err(|error| match error {
            ZipError::FileNotFound => "the archive has no such file".to_owned(),
            other => format!("the archive cannot be unpacked: {other}"),
        })?;
        let most = FILE_BYTES_MAX.min(self.left);
        let mut bytes = Vec::new();
        // What a file claims as its size is not believed.
        let read = file.take(most + 1).read_to_end(&mut bytes);
        read.map_err(|error| format!("the archive cannot be unpacked: {error}"))?;
        let size = bytes.len() as u64;
        self.left = self.left.saturating_sub(size);
        match size > most {
            false => Ok(bytes),
            true if most < FILE_BYTES_MAX => {
                Err(format!("more than {ALL_BYTES_MAX} bytes are to be unpacked"))
            }
            true => Err(format!("the file has more than {FILE_BYTES_MAX} bytes when it is unpacked")),
        }
    }
}
