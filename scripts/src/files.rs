//! Where other files come from: includes and data of a scenario.

use std::path::PathBuf;

use crate::finding::Finding;
use crate::source::Source;

/// Finds files by the names that are in a scenario.
pub trait Files {
    /// Reads a file.
    ///
    /// # Errors
    /// A finding when it cannot be read.
    fn read(&self, name: &str) -> Result<Source, Finding>;
}

/// Files of a folder: names count from there.
#[derive(Clone, Debug, Default)]
pub struct Folder(pub PathBuf);

impl Files for Folder {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        Source::read(&self.0.join(name))
    }
}

/// No files at all.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoFiles;

impl Files for NoFiles {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        let message = "there are no files here".to_owned();
        Err(Finding::about_file(crate::Code::Unreadable, name, message, "a scenario in one file", None))
    }
}
