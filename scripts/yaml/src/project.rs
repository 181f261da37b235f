//! The project: the folder that must contain all files that scenarios and fleets name. A file from someone else can therefore not cause
//! arbitrary files to be read, or quoted in findings.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::Metadata;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::composed::is_same;
use crate::finding::{Code, Finding};
use crate::open::open_regular;
use crate::source::{Source, bytes_of, refused};

/// A folder, with everything in it and in its subfolders.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Project {
    /// The canonical path of the folder, without symbolic links.
    root: PathBuf,
    /// Texts that are read instead of the files at these canonical paths.
    unsaved: Arc<BTreeMap<PathBuf, String>>,
}

impl Project {
    /// Returns the project of a file that the user has named. It is the nearest enclosing folder with `.git`, otherwise the nearest one
    /// with `fleet.yaml`, otherwise the file's own folder. Folders of other users, world-writable folders, and the home folder are never
    /// the project of files in their subfolders.
    #[must_use]
    pub fn of(file: &Path) -> Self {
        Self::of_folder(folder_of(file))
    }

    /// Returns the project of a folder. It is the same as for a file in that folder.
    #[must_use]
    pub fn of_folder(folder: &Path) -> Self {
        let Ok(own) = real(folder) else {
            // The folder does not exist, so reading fails anyway.
            return Self::at(std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf()));
        };
        let Ok(owned) = own.metadata() else { return Self::at(own) };
        let home = std::env::home_dir().and_then(|home| home.canonicalize().ok());
        let may_hold = |above: &&Path| {
            let same = |above: Metadata| above.uid() == owned.uid() && above.mode() & 0o002 == 0;
            **above == own || Some(*above) != home.as_deref() && above.metadata().is_ok_and(same)
        };
        let above: Vec<&Path> = own.ancestors().take_while(may_hold).collect();
        let with = |mark: &str| above.iter().find(|folder| folder.join(mark).symlink_metadata().is_ok());
        let root = with(".git").or_else(|| with("fleet.yaml")).map(|root| root.to_path_buf());
        Self::at(root.unwrap_or(own))
    }

    fn at(root: PathBuf) -> Self {
        Self { root, unsaved: Arc::default() }
    }

    /// Returns this project with texts that an editor has not yet saved. They are read instead of the files at these canonical paths.
    #[must_use]
    pub fn with_unsaved(self, unsaved: Arc<BTreeMap<PathBuf, String>>) -> Self {
        Self { unsaved, ..self }
    }

    /// Creates a project from a folder that the user names explicitly.
    ///
    /// # Errors
    /// Returns an error if there is no such folder.
    pub fn within(folder: &Path) -> io::Result<Self> {
        let root = real(folder)?;
        if root.is_dir() { Ok(Self::at(root)) } else { Err(io::ErrorKind::NotADirectory.into()) }
    }

    /// The folder of the project.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Whether a path leads to a file or folder in the project.
    #[must_use]
    pub fn holds(&self, path: &Path) -> bool {
        path.canonicalize().is_ok_and(|real| real.starts_with(&self.root))
    }

    /// Reads a file that another file names.
    ///
    /// # Errors
    /// Returns a finding if the file cannot be read or is outside the project, directly or through symbolic links.
    pub fn read(&self, path: &Path) -> Result<Source, Finding> {
        Source::of_bytes(&path.display().to_string(), self.read_bytes(path)?)
    }

    /// Like [`Self::read`], but for a file that may be binary.
    pub fn read_bytes(&self, path: &Path) -> Result<Vec<u8>, Finding> {
        let real = self.real(path)?;
        if let Some(text) = self.unsaved.get(&real) {
            return Ok(text.clone().into_bytes());
        }
        let file = open_regular(&real).map_err(|error| refused(path, &error))?;
        bytes_of(path, file)
    }

    /// Returns the canonical form of `path`, or a finding if the path is not in this project or does not exist.
    fn real(&self, path: &Path) -> Result<PathBuf, Finding> {
        match path.canonicalize() {
            Ok(real) if real.starts_with(&self.root) => Ok(real),
            Ok(_) => Err(outside(path)),
            // For paths outside, the finding does not reveal whether the file exists.
            Err(error) => match existing(path).filter(|existing| existing.starts_with(&self.root)) {
                Some(folder) => self.respelled(&folder, path).ok_or_else(|| refused(path, &error)),
                None => Err(outside(path)),
            },
        }
    }
}

impl Project {
    /// Returns the file in `folder` whose name differs from that of `path` only in its Unicode encoding, if such a file exists.
    fn respelled(&self, folder: &Path, path: &Path) -> Option<PathBuf> {
        let name = path.file_name()?.to_str().filter(|name| !name.is_ascii())?;
        if path.parent().and_then(|parent| real(parent).ok())? != *folder {
            return None;
        }
        let alike = |entry: &PathBuf| {
            entry.file_name().and_then(OsStr::to_str).is_some_and(|other| is_same(name, other))
        };
        let found = folder.read_dir().ok()?.filter_map(|entry| Some(entry.ok()?.path())).find(alike)?;
        found.canonicalize().ok().filter(|real| real.starts_with(&self.root))
    }
}

/// The folder that contains the file.
pub fn folder_of(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

fn real(folder: &Path) -> io::Result<PathBuf> {
    let here = folder.as_os_str() == OsStr::new("");
    if here { Path::new(".").canonicalize() } else { folder.canonicalize() }
}

/// Returns the nearest folder above a path that exists.
fn existing(path: &Path) -> Option<PathBuf> {
    path.ancestors().skip(1).find_map(|above| real(above).ok())
}

fn outside(path: &Path) -> Finding {
    let name = path.display().to_string();
    if path.is_dir() || path.as_os_str().is_empty() {
        let message = "this is a folder".to_owned();
        return Finding::about_file(Code::OutsideProject, &name, message, "the name of a file", None);
    }
    let message = "this file is outside the project".to_owned();
    let hint =
        "move it into the project, or pass `--project DIR` with a folder that contains both files".to_owned();
    Finding::about_file(Code::OutsideProject, &name, message, EXPECTED, Some(hint))
}

/// What is expected instead of a file outside the project, for messages.
const EXPECTED: &str = "a file in the project: the nearest folder with `.git`, otherwise with `fleet.yaml`, otherwise the folder of this file";

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    struct Stage(tempfile::TempDir);

    impl Stage {
        /// Creates a temporary folder with these files. Each file contains its own name; a name that ends with a slash is a folder.
        fn of(names: &[&str]) -> Self {
            let stage = Self(tempfile::tempdir().unwrap());
            for name in names {
                let path = stage.0.path().join(name);
                if name.ends_with('/') {
                    std::fs::create_dir_all(path).unwrap()
                } else {
                    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                    std::fs::write(path, name).unwrap();
                }
            }
            stage
        }

        fn path(&self, name: &str) -> PathBuf {
            self.0.path().canonicalize().unwrap().join(name)
        }

        #[track_caller]
        fn check(&self, file: &str, root: &str) {
            let root = self.path(root).components().collect::<PathBuf>();
            assert_eq!(Project::of(&self.path(file)).root(), root);
        }
    }

    #[test]
    fn project_is_repository_else_fleet_folder_else_file_folder() {
        let stage = Stage::of(&[
            "a/fleet.yaml",
            "a/shows/x.yaml",
            "b/.git/",
            "b/c/fleet.yaml",
            "b/c/d/x.yaml",
            "e/f/x.yaml",
        ]);
        stage.check("a/shows/x.yaml", "a");
        stage.check("b/c/d/x.yaml", "b");
        stage.check("e/f/x.yaml", "e/f");
    }

    #[test]
    fn unsaved_text_is_read_instead_of_its_file() {
        let stage = Stage::of(&["a/fleet.yaml", "a/x.yaml", "b/x.yaml"]);
        let unsaved =
            [(stage.path("a/x.yaml"), "new".to_owned()), (stage.path("b/x.yaml"), "new".to_owned())];
        let project = Project::of(&stage.path("a/x.yaml")).with_unsaved(Arc::new(unsaved.into()));
        assert_eq!(project.read(&stage.path("a/x.yaml")).unwrap().text, "new");
        assert_eq!(project.read(&stage.path("a/fleet.yaml")).unwrap().text, "a/fleet.yaml");
        assert_eq!(project.read(&stage.path("b/x.yaml")).unwrap_err().code, Code::OutsideProject);
    }

    #[test]
    fn folder_writable_by_every_user_is_not_a_project() {
        let stage = Stage::of(&["t/.git/", "t/show/x.yaml"]);
        stage.check("t/show/x.yaml", "t");
        std::fs::set_permissions(stage.path("t"), std::fs::Permissions::from_mode(0o1777)).unwrap();
        stage.check("t/show/x.yaml", "t/show");
    }

    #[test]
    fn folder_of_another_user_is_not_a_project() {
        let stage = Stage::of(&["t/.git/", "t/show/x.yaml"]);
        if !rustix::process::geteuid().is_root() {
            // Only root can give a folder away.
            return;
        }
        std::os::unix::fs::chown(stage.path("t"), Some(65_534), None).unwrap();
        stage.check("t/show/x.yaml", "t/show");
    }

    #[test]
    fn paths_outside_project_are_not_read_whether_they_exist_or_not() {
        let stage = Stage::of(&["in/x.yaml", "in/deep/y.yaml", "out/secret"]);
        symlink(stage.path("out/secret"), stage.path("in/link")).unwrap();
        symlink(stage.path("out"), stage.path("in/folder")).unwrap();
        symlink("deep/y.yaml", stage.path("in/inner")).unwrap();
        let project = Project::of(&stage.path("in/x.yaml"));
        let code = |name: &str| project.read(&stage.path(name)).map_err(|finding| finding.code);
        for name in [
            "out/secret",
            "in/../out/secret",
            "in/link",
            "in/folder/secret",
            "out/none",
            "in/folder/none",
            "in/../none",
        ] {
            assert_eq!(code(name).unwrap_err(), Code::OutsideProject, "{name}");
        }
        assert_eq!(code("in/inner").unwrap().text, "in/deep/y.yaml");
        assert_eq!(code("in/deep/../x.yaml").unwrap().text, "in/x.yaml");
        assert_eq!(code("in/none").unwrap_err(), Code::Unreadable);
        assert_eq!(code("in/none/none").unwrap_err(), Code::Unreadable);
        let wide = Project::within(&stage.path("")).unwrap();
        assert_eq!(wide.read(&stage.path("in/link")).unwrap().text, "out/secret");
    }
}
