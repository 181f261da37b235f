//! The journal of a mission: lines, each with its checksum, that are only ever appended. Which of them must be on the disk
//! before a promise is made, the mission decides. A folder a mission, in it `journal`, locked as long as its scheduler lives,
//! and `control`, its socket.

mod disk;
mod read;
pub(crate) mod simulated;
mod writer;

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use urrcp::{RobotId, Server, SessionId, Timestamp};

use crate::mission::Record;
pub use disk::{Disk, FileDisk};
pub use read::{Fate, Kept, Progressed, Torn, Unreadable, read};
pub use writer::{Writer, Written};

/// The first line: who drives whom with what.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opened {
    /// The session that the robots know.
    pub session: SessionId,
    /// The process that drives them.
    pub pid: u32,
    /// The scenario file.
    pub scenario: PathBuf,
    /// The fleet file.
    pub fleet: PathBuf,
    /// What was asked for besides.
    pub asked: Asked,
    /// The robots and where they are reached.
    pub robots: Vec<(RobotId, String)>,
}

/// What changes a choreography between its file and the mission.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Asked {
    /// Only this act.
    pub act: Option<String>,
    /// Beginning with this act.
    pub from: Option<String>,
    /// Only these robots.
    pub only: Vec<RobotId>,
    /// Slower or faster than written.
    pub speed: Option<f64>,
}

/// One line.
#[derive(Serialize)]
struct Line<'a, T> {
    at: Timestamp<Server>,
    #[serde(flatten)]
    record: &'a T,
}

/// A journal could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the journal {}: {error}", path.display())]
pub struct JournalError {
    /// Which file.
    pub path: PathBuf,
    /// Why.
    pub error: io::Error,
}

/// The journal of a mission that runs.
#[derive(Debug)]
pub struct Journal<D = FileDisk> {
    disk: D,
    path: PathBuf,
    kept: Option<Kept>,
    /// Durable records appended since it was opened.
    appended: u64,
    /// Those of them that are on the disk.
    on_disk: u64,
    /// The first failure to write: from then on nothing is taken any more.
    broken: Option<String>,
}

impl Journal {
    /// Opens the journal of a mission in its folder, and locks it. What follows its last whole record is cut off.
    ///
    /// # Errors
    /// [`JournalError`], also when another process holds it.
    pub fn open(folder: &Path) -> Result<Self, JournalError> {
        let path = folder.join("journal");
        match FileDisk::open(folder) {
            Ok(disk) => Self::on(disk, path),
            Err(error) => Err(JournalError { path, error }),
        }
    }
}

impl<D: Disk> Journal<D> {
    /// The journal on a disk. What follows its last whole record is cut off. `path` is for error messages.
    ///
    /// # Errors
    /// [`JournalError`] when the disk cannot be read or does not take the cut.
    pub fn on(mut disk: D, path: PathBuf) -> Result<Self, JournalError> {
        let mut cut = || {
            let bytes = disk.read()?;
            let whole = read::whole_length(&bytes);
            if whole < bytes.len() {
                disk.truncate(whole as u64)?;
            }
            Ok(Kept::of_bytes(&bytes))
        };
        match cut() {
            Ok(kept) => Ok(Self { disk, path, kept, appended: 0, on_disk: 0, broken: None }),
            Err(error) => Err(JournalError { path, error }),
        }
    }

    /// What it said when it was opened; `None` for a new one.
    pub const fn kept(&self) -> Option<&Kept> {
        self.kept.as_ref()
    }

    /// Writes the first line, which is on the disk when this returns.
    ///
    /// # Errors
    /// [`JournalError`] when the disk does not take it.
    pub fn begin(&mut self, at: Timestamp<Server>, opened: &Opened) -> Result<(), JournalError> {
        #[derive(Serialize)]
        struct Begin<'a> {
            record: &'static str,
            #[serde(flatten)]
            opened: &'a Opened,
        }
        let line = line(&Line { at, record: &Begin { record: "opened", opened } });
        let written = line.and_then(|line| self.disk.append(&line)).and_then(|()| self.disk.sync());
        written.map_err(|error| JournalError { path: self.path.clone(), error })
    }

    /// Writes a line. It may be lost until [`Journal::sync`] has returned.
    ///
    /// # Errors
    /// Why the disk does not take it; also for every record after one that was lost.
    pub fn append(&mut self, at: Timestamp<Server>, record: &Record) -> Result<(), String> {
        self.unless_broken(|disk| line(&Line { at, record }).and_then(|line| disk.append(&line)))?;
        self.appended += u64::from(record.is_durable());
        Ok(())
    }

    /// Waits for the disk, if a durable record may not be on it yet. Returns how many durable records are on it since the
    /// journal was opened.
    ///
    /// # Errors
    /// Why what was written may be lost.
    pub fn sync(&mut self) -> Result<u64, String> {
        let due = self.on_disk < self.appended;
        self.unless_broken(|disk| if due { disk.sync() } else { Ok(()) })?;
        self.on_disk = self.appended;
        Ok(self.on_disk)
    }

    fn unless_broken(&mut self, write: impl FnOnce(&mut D) -> io::Result<()>) -> Result<(), String> {
        if let Some(broken) = &self.broken {
            return Err(broken.clone());
        }
        write(&mut self.disk).map_err(|error| {
            let reason = format!("cannot write the journal {}: {error}", self.path.display());
            self.broken = Some(reason.clone());
            reason
        })
    }

    /// Gives the disk back, as when the process ends.
    pub fn into_disk(self) -> D {
        self.disk
    }
}

/// The checksum, then JSON.
fn line(line: &impl Serialize) -> io::Result<Vec<u8>> {
    let json = serde_json::to_vec(line)?;
    let mut bytes = format!("{:08x} ", crc32fast::hash(&json)).into_bytes();
    bytes.extend_from_slice(&json);
    bytes.push(b'\n');
    Ok(bytes)
}

/// Where missions leave their folders: `$DOWNBEAT_STATE`, else `$XDG_STATE_HOME/downbeat`, else `~/.local/state/downbeat`.
#[must_use]
pub fn state_folder() -> PathBuf {
    let from = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    from("DOWNBEAT_STATE")
        .or_else(|| from("XDG_STATE_HOME").map(|folder| folder.join("downbeat")))
        .or_else(|| from("HOME").map(|home| home.join(".local/state/downbeat")))
        .unwrap_or_else(|| std::env::temp_dir().join("downbeat"))
}

/// A mission that left a folder.
#[derive(Clone, Debug)]
pub struct Found {
    /// Its folder.
    pub folder: PathBuf,
    /// Its scheduler lives.
    pub alive: bool,
    /// What it wrote down.
    pub kept: Kept,
}

/// All missions that left a folder here and can be read, the newest last.
#[must_use]
pub fn missions(state: &Path) -> Vec<Found> {
    let Ok(entries) = std::fs::read_dir(state) else { return Vec::new() };
    let mut found: Vec<Found> = entries.flatten().filter_map(|entry| look_at(&entry.path())).collect();
    found.sort_by_key(|found| found.kept.opened_at);
    found
}

/// Ended missions whose folders are kept.
const ENDED_KEPT: usize = 50;

/// Removes the folders of missions that ended long ago. Those that were cut off stay until they are resumed or stopped.
pub fn forget_old(state: &Path) {
    let ended = missions(state).into_iter().filter(|found| !found.alive && found.kept.outcome.is_some());
    let mut ended: Vec<Found> = ended.collect();
    ended.truncate(ended.len().saturating_sub(ENDED_KEPT));
    for found in ended {
        if let Err(error) = std::fs::remove_dir_all(&found.folder) {
            tracing::debug!("cannot remove {}: {error}", found.folder.display());
        }
    }
}

fn look_at(folder: &Path) -> Option<Found> {
    let path = folder.join("journal");
    let file = File::open(&path).ok()?;
    let alive = matches!(file.try_lock_shared(), Err(std::fs::TryLockError::WouldBlock));
    let kept = read(&path).ok()?;
    Some(Found { folder: folder.to_path_buf(), alive, kept })
}

#[cfg(test)]
mod tests;
