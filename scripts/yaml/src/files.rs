//! Where other files come from: includes and data of a scenario.

use std::path::PathBuf;

use crate::finding::{Code, Finding};
use crate::project::Project;
use crate::source::Source;

/// Finds files by the names that are in a scenario.
pub trait Files {
    /// Reads a file.
    ///
    /// # Errors
    /// A finding when it cannot be read.
    fn read(&self, name: &str) -> Result<Source, Finding>;

    /// Reads a file that need not be text.
    ///
    /// # Errors
    /// A finding when it cannot be read.
    fn read_bytes(&self, name: &str) -> Result<Vec<u8>, Finding> {
        self.read(name).map(|source| source.text.into_bytes())
    }
}

/// Files of a folder: names count from there, and lead to files of one project.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    project: Project,
}

impl Folder {
    /// A folder, with the project that is found for it ([`Project::of_folder`]).
    #[must_use]
    pub fn new(path: PathBuf) -> Self {
        let project = Project::of_folder(&path);
        Self { path, project }
    }

    /// A folder in a project.
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

/// No files at all.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoFiles;

impl Files for NoFiles {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        let message = "there are no files here".to_owned();
        Err(Finding::about_file(Code::Unreadable, name, message, "a scenario in one file", None))
    }
}
