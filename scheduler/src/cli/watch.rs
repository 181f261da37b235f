//! Waits until files of a project change.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// Time between two looks at the files: shorter than a person notices, and little work.
const INTERVAL: Duration = Duration::from_millis(100);
/// Maximum number of files that are watched.
const FILES_MAX: usize = 10_000;
/// Maximum depth of folders that are watched.
const DEPTH_MAX: usize = 8;

/// The sizes and the times of the last changes of files.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Stamp(BTreeMap<PathBuf, Change>);

#[derive(Debug, PartialEq, Eq)]
struct Change {
    at: Option<SystemTime>,
    bytes: u64,
}

impl Stamp {
    /// Returns the present state of the files in a folder and its subfolders, except hidden ones and those of builds.
    pub(super) fn of(folder: &Path) -> Self {
        let mut stamp = Self(BTreeMap::new());
        stamp.add(folder, 0);
        stamp
    }

    fn add(&mut self, folder: &Path, depth: usize) {
        let Ok(entries) = folder.read_dir() else { return };
        for entry in entries.filter_map(Result::ok) {
            let name = entry.file_name();
            let Ok(about) = entry.path().metadata() else { continue };
            if name.to_string_lossy().starts_with('.') || self.0.len() >= FILES_MAX {
                continue;
            }
            if about.is_file() {
                self.0.insert(entry.path(), Change { at: about.modified().ok(), bytes: about.len() });
            } else if depth < DEPTH_MAX && name != "target" && name != "node_modules" {
                self.add(&entry.path(), depth + 1);
            }
        }
    }

    /// Waits until the files in the folder differ from this state, and then until they no longer change: an editor may write several.
    #[expect(clippy::disallowed_methods, reason = "waits for a person")]
    pub(super) fn wait_for_change(self, folder: &Path) -> Self {
        let mut before = self;
        let mut has_changed = false;
        loop {
            std::thread::sleep(INTERVAL);
            let now = Self::of(folder);
            if now == before && has_changed {
                return now;
            }
            has_changed |= now != before;
            before = now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamp_differs_after_a_change_of_a_file_in_a_subfolder() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("moves/.git")).unwrap();
        std::fs::write(folder.path().join("moves/a.yaml"), "a").unwrap();
        let before = Stamp::of(folder.path());
        std::fs::write(folder.path().join("moves/.git/index"), "x").unwrap();
        assert_eq!(Stamp::of(folder.path()), before);
        std::fs::write(folder.path().join("moves/a.yaml"), "ab").unwrap();
        assert_ne!(Stamp::of(folder.path()), before);
    }
}
