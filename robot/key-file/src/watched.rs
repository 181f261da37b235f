//! A file that may be replaced while it is in use.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Identifies a version of a file. The time of the last status change (`ctime`) cannot be set by programs, so even a file that keeps its
/// modification time gets another stamp when its content changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stamp {
    device: u64,
    inode: u64,
    bytes: u64,
    modified: (i64, i64),
    changed: (i64, i64),
}

impl Stamp {
    /// Returns the stamp of the current version. `None` if there is no such file.
    fn of(path: &Path) -> Option<Self> {
        let data = std::fs::metadata(path).ok()?;
        Some(Self {
            device: data.dev(),
            inode: data.ino(),
            bytes: data.size(),
            modified: (data.mtime(), data.mtime_nsec()),
            changed: (data.ctime(), data.ctime_nsec()),
        })
    }
}

/// The content of a file, which is read again when the file changes. A version that cannot be used does not replace the previous one.
#[derive(Debug)]
pub struct Watched<T> {
    path: PathBuf,
    latest: Mutex<Latest<T>>,
}

#[derive(Debug)]
struct Latest<T> {
    /// Stamp of the version that was read last, usable or not.
    seen: Option<Stamp>,
    content: Arc<T>,
}

impl<T> Watched<T> {
    /// Reads a file for the first time.
    ///
    /// # Errors
    /// Those of `read`.
    pub fn new<E>(path: &Path, read: impl FnOnce(&Path) -> Result<T, E>) -> Result<Self, E> {
        // The stamp is taken first: if the file changes meanwhile, it is read again.
        let seen = Stamp::of(path);
        let content = Arc::new(read(path)?);
        Ok(Self { path: path.into(), latest: Mutex::new(Latest { seen, content }) })
    }

    /// Returns the last usable content, without looking at the file.
    pub fn latest(&self) -> Arc<T> {
        Arc::clone(&self.lock().content)
    }

    /// Returns the content, after reading the file again if it has changed. `read` gets the path and the previous content.
    ///
    /// # Errors
    /// Those of `read`, once for each version of the file. The previous content remains in use.
    pub fn refresh<E>(&self, read: impl FnOnce(&Path, &T) -> Result<T, E>) -> Result<Arc<T>, E> {
        let mut latest = self.lock();
        let stamp = Stamp::of(&self.path);
        if latest.seen != stamp {
            latest.seen = stamp;
            latest.content = Arc::new(read(&self.path, &latest.content)?);
        }
        Ok(Arc::clone(&latest.content))
    }

    fn lock(&self) -> MutexGuard<'_, Latest<T>> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(path: &Path) -> Result<String, String> {
        let text = std::fs::read_to_string(path).map_err(|error| error.to_string())?;
        if text.contains("bad") { Err("bad".to_owned()) } else { Ok(text) }
    }

    #[test]
    fn each_version_of_a_file_is_read_once_and_a_bad_one_does_not_replace_a_good_one() {
        let path = std::env::temp_dir().join(format!("downbeat-watched-{}", std::process::id()));
        std::fs::write(&path, "1").unwrap();
        let modified = std::fs::metadata(&path).unwrap().modified().unwrap();
        let watched = Watched::new(&path, read).unwrap();
        let reads = std::cell::Cell::new(0);
        let refresh = || {
            watched.refresh(|path, _| {
                reads.set(reads.get() + 1);
                read(path)
            })
        };
        let write = |text: &str| {
            std::fs::write(&path, text).unwrap();
            std::fs::File::options().write(true).open(&path).unwrap().set_modified(modified).unwrap();
        };
        assert_eq!((refresh().unwrap().as_str(), reads.get()), ("1", 0));
        // As long and as old as before.
        write("2");
        assert_eq!((refresh().unwrap().as_str(), reads.get()), ("2", 1));
        write("bad");
        assert_eq!((refresh().unwrap_err().as_str(), reads.get()), ("bad", 2));
        assert_eq!((refresh().unwrap().as_str(), reads.get()), ("2", 2), "reported once");
        std::fs::remove_file(&path).unwrap();
        assert!(refresh().is_err());
        assert_eq!((refresh().unwrap().as_str(), watched.latest().as_str()), ("2", "2"));
        std::fs::write(&path, "3").unwrap();
        assert_eq!(refresh().unwrap().as_str(), "3");
        std::fs::remove_file(&path).unwrap();
    }
}
