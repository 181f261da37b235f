//! Access to the other files that a scenario uses: includes and data files.

use std::path::PathBuf;

use crate::finding::{Code, Finding};
use crate::project::Project;
use crate::source::Source;

/// Reads files by the names that a scenario uses for them.
pub trait Files {
    /// Reads a file.
    ///
    /// # Errors
    /// Returns a finding if the file cannot be read.
    fn read(&self, name: &str) -> Result<Source, Finding>;

    /// Reads a file that may be binary.
    ///
    /// # Errors
    /// Returns a finding if the file cannot be read.
    fn read_bytes(&self, name: &str) -> Result<Vec<u8>, Finding> {
        self.read(name).map(|source| source.text.into_bytes())
    }
}

/// The files in a folder. Names are relative to the folder, and must lead to files of one project.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    project: Project,
}

impl Folder {
    /// Creates the files of a folder, in the project that [`Project::of_folder`] finds for the folder.
    #[must_use]
    pub fn new(path: PathBuf) -> Self {
        let project = Project::of_folder(&path);
        Self { path, project }
    }

    /// Creates the files of a folder, whose names must lead to files of the given project.
    #[must_use]
    pub const fn within(path: PathBuf, project: Project) -> Self {
        Self { path, project }
    }
}

impl Files for Folder {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        self.project.read(&self.path.join(name))
    }

    fn read_bytes(&self, name: &str) -> Result<Vec<u8>, Finding> {
        self.project.read_bytes(&self.path.join(name))
    }
}

/// An implementation of [`Files`] that has no files, so every read fails.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoFiles;

impl Files for NoFiles {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        let message = "other files cannot be read here".to_owned();
        Err(Finding::about_file(Code::Unreadable, name, message, "a scenario in one file", None))
    }
}
