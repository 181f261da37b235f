//! A file that may be replaced while it is in use.

use std::fmt::Display;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{KeyFileError, number, read_regular, replace};

/// Identifies a version of a file. Programs cannot set the time of the last status change (`ctime`). Therefore a change of the content
/// changes the stamp even if the modification time remains the same.
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

/// Content whose versions have an order.
pub trait Versioned {
    /// Whether this version was made before the other one.
    fn is_older_than(&self, other: &Self) -> bool;

    /// Returns the number of this version. A newer version has a larger number. `None` if the number does not fit into 64 bits.
    fn number(&self) -> Option<u64>;

    /// Returns this version with everything from the previous one that must remain in force.
    #[must_use]
    fn after(self, _previous: &Self) -> Self
    where
        Self: Sized,
    {
        self
    }
}

/// The content of a file. [`Watched::refresh`] reads the file again if it has changed. An older or unusable version does not replace the
/// version in use.
#[derive(Debug)]
pub struct Watched<T> {
    path: PathBuf,
    latest: Mutex<Latest<T>>,
    /// Whether the largest number of all versions in use is stored next to the file.
    stores_number: bool,
}

#[derive(Debug)]
struct Latest<T> {
    /// Stamp of the version that was read last, usable or not.
    seen: Option<Stamp>,
    content: Arc<T>,
}

impl<T: Versioned> Watched<T> {
    /// Reads a file for the first time.
    ///
    /// # Errors
    /// Those of `read`.
    pub fn new<E>(path: &Path, read: impl FnOnce(&Path) -> Result<T, E>) -> Result<Self, E> {
        // The stamp is taken before the file is read: if the file changes in between, `refresh` reads it again.
        let seen = Stamp::of(path);
        let content = Arc::new(read(path)?);
        Ok(Self { path: path.into(), latest: Mutex::new(Latest { seen, content }), stores_number: false })
    }

    /// Refuses versions that are older than one that was in use before the process started. For this purpose, stores the largest number
    /// of all versions in use next to the file, in `revoked.pem.number` for `revoked.pem`. If this file is missing, damaged or cannot be
    /// written, logs that.
    ///
    /// # Errors
    /// [`KeyFileError::Older`]: the version in use is such an older version.
    pub fn storing_number(mut self) -> Result<Self, KeyFileError> {
        if let Some(number) = self.latest().number() {
            number::check(&self.path, number)?;
            number::raise(&self.path, number);
        }
        self.stores_number = true;
        Ok(self)
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the version in use, without accessing the file.
    pub fn latest(&self) -> Arc<T> {
        Arc::clone(&self.lock().content)
    }

    /// Reads the file again if it has changed, and returns the version in use. Logs the reason once if a version is not used.
    pub fn refresh<E: Display>(&self, read: impl FnOnce(&Path) -> Result<T, E>) -> Arc<T> {
        let mut latest = self.lock();
        let stamp = Stamp::of(&self.path);
        if latest.seen != stamp {
            latest.seen = stamp;
            match read(&self.path) {
                Ok(content) if content.is_older_than(&latest.content) => {
                    tracing::warn!(
                        "{}: it is older than the version in use, which is kept",
                        self.path.display()
                    );
                }
                Ok(content) => latest.content = self.used(content.after(&latest.content)),
                Err(error) => tracing::warn!("{error}; the previous version remains in use"),
            }
        }
        Arc::clone(&latest.content)
    }

    /// Stores a version in the file and uses it if it is newer than the version in use. Does nothing if both are equally new.
    ///
    /// # Errors
    /// A sentence with the reason: the version is older than the one in use, or the file cannot be written.
    pub fn replace(&self, text: &str, content: T) -> Result<(), String> {
        let mut latest = self.lock();
        if content.is_older_than(&latest.content) {
            return Err("it is older than the version in use".to_owned());
        }
        // A version that is as new is stored too if the file does not contain it, for example because it was replaced by an older one.
        let stored = read_regular(&self.path, u64::try_from(text.len()).unwrap_or(u64::MAX));
        let is_stored = stored.is_ok_and(|stored| stored == text.as_bytes());
        if !is_stored {
            replace(&self.path, text.as_bytes(), 0o644)
                .map_err(|error| format!("cannot write {}: {error}", self.path.display()))?;
            // Makes `refresh` read the file again, because another process may have replaced it meanwhile.
            latest.seen = None;
            latest.content = self.used(content.after(&latest.content));
        }
        Ok(())
    }

    /// Stores the number of a version that will be used.
    fn used(&self, content: T) -> Arc<T> {
        if let Some(number) = content.number().filter(|_| self.stores_number) {
            number::raise(&self.path, number);
        }
        Arc::new(content)
    }

    fn lock(&self) -> MutexGuard<'_, Latest<T>> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Versioned for u32 {
        fn is_older_than(&self, other: &Self) -> bool {
            self < other
        }

        fn number(&self) -> Option<u64> {
            Some(u64::from(*self))
        }
    }

    fn read(path: &Path) -> Result<u32, String> {
        let text = std::fs::read_to_string(path).map_err(|error| error.to_string())?;
        text.parse().map_err(|_| "bad".to_owned())
    }

    /// Removes the file when a test ends.
    struct File(PathBuf);

    impl Drop for File {
        fn drop(&mut self) {
            let _removed_already = std::fs::remove_file(&self.0);
            let _not_written = std::fs::remove_file(number::file_of(&self.0));
        }
    }

    impl File {
        fn new(test: &str) -> Self {
            let path = std::env::temp_dir().join(format!("downbeat-watched-{test}-{}", std::process::id()));
            std::fs::write(&path, "1").unwrap();
            Self(path)
        }
    }

    #[test]
    fn each_version_is_read_once_and_replaces_only_an_earlier_one() {
        let file = File::new("read");
        let modified = std::fs::metadata(&file.0).unwrap().modified().unwrap();
        let watched = Watched::new(&file.0, read).unwrap();
        let reads = std::cell::Cell::new(0);
        let refresh = || {
            let content = watched.refresh(|path| {
                reads.set(reads.get() + 1);
                read(path)
            });
            (*content, reads.get())
        };
        assert_eq!(refresh(), (1, 0));
        for (text, expected) in [("2", (2, 1)), ("x", (2, 2)), ("1", (2, 3)), ("3", (3, 4))] {
            // Each version has the same size and modification time as the previous one.
            std::fs::write(&file.0, text).unwrap();
            std::fs::File::options().write(true).open(&file.0).unwrap().set_modified(modified).unwrap();
            assert_eq!(refresh(), expected, "{text}");
            assert_eq!(refresh(), expected, "read once");
        }
        std::fs::remove_file(&file.0).unwrap();
        assert_eq!((refresh().0, *watched.latest()), (3, 3));
        std::fs::write(&file.0, "4").unwrap();
        assert_eq!(refresh().0, 4);
    }

    #[test]
    fn newer_version_is_stored_and_older_version_is_refused() {
        let file = File::new("stored");
        let watched = Watched::new(&file.0, read).unwrap();
        let stored = || std::fs::read_to_string(&file.0).unwrap();
        watched.replace("5", 5).unwrap();
        std::fs::write(&file.0, "2").unwrap();
        assert_eq!(*watched.refresh(read), 5);
        watched.replace("5", 5).unwrap();
        assert_eq!(stored(), "5", "restored");
        assert_eq!(watched.replace("4", 4).unwrap_err(), "it is older than the version in use");
        assert_eq!((stored().as_str(), *watched.latest(), *watched.refresh(read)), ("5", 5, 5));
        let nowhere = Watched::new(&file.0.join("file"), |_| Ok::<_, String>(1)).unwrap();
        let error = nowhere.replace("2", 2).unwrap_err();
        assert!(error.starts_with("cannot write ") && *nowhere.latest() == 1, "{error}");
    }

    #[test]
    fn older_version_is_refused_after_a_restart() {
        let file = File::new("restarted");
        let stored = || std::fs::read_to_string(number::file_of(&file.0)).unwrap();
        let start = |version: &str| {
            std::fs::write(&file.0, version).unwrap();
            Watched::new(&file.0, read).unwrap().storing_number()
        };
        let refused = |version: &str| start(version).unwrap_err().to_string();
        let watched = start("1").unwrap();
        assert_eq!(stored(), "1\n");
        std::fs::write(&file.0, "5").unwrap();
        assert_eq!((*watched.refresh(read), stored().as_str()), (5, "5\n"));
        let error = refused("4");
        assert!(error.contains("this is list 4, but list 5 was already in use here"), "{error}");
        assert!(error.contains(".number"), "it names the file to delete: {error}");
        start("5").unwrap().replace("7", 7).unwrap();
        assert_eq!(stored(), "7\n");
        assert!(refused("6").contains("this is list 6, but list 7 was"));
        // The number never becomes smaller, not even if another process uses an older version.
        number::raise(&file.0, 3);
        assert_eq!(stored(), "7\n");
        // A damaged or missing number is no reason to refuse a version.
        for damage in ["", "x", "-1", "99999999999999999999999999999999999"] {
            std::fs::write(number::file_of(&file.0), damage).unwrap();
            assert_eq!(*start("2").unwrap().latest(), 2, "{damage:?}");
            assert_eq!(stored(), "2\n");
        }
        std::fs::remove_file(number::file_of(&file.0)).unwrap();
        let without = Watched::new(&file.0, read).unwrap();
        std::fs::write(&file.0, "9").unwrap();
        assert_eq!((*without.refresh(read), number::file_of(&file.0).exists()), (9, false));
        start("1").unwrap();
    }
}
