//! The journal of a mission on disk: append-only lines, each with its checksum, on the disk before what they promise is
//! done. A folder a mission, in it `journal`, locked as long as its scheduler lives, and `control`, its socket.

mod read;

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use urrcp::{RobotId, Server, SessionId, Timestamp};

use crate::mission::Record;
pub use read::{Fate, Kept, Progressed, Unreadable, read};

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
pub struct Journal {
    path: PathBuf,
    file: File,
    /// The first failure to write: from then on nothing is promised any more.
    broken: Option<String>,
}

impl Journal {
    /// Opens the journal of a mission in its folder, and locks it.
    ///
    /// # Errors
    /// [`JournalError`], also when another process holds it.
    pub fn open(folder: &Path) -> Result<Self, JournalError> {
        let path = folder.join("journal");
        let open = || {
            std::fs::create_dir_all(folder)?;
            let file = OpenOptions::new().create(true).append(true).read(true).open(&path)?;
            file.try_lock().map_err(io::Error::from)?;
            Ok(file)
        };
        match open() {
            Ok(file) => Ok(Self { path, file, broken: None }),
            Err(error) => Err(JournalError { path, error }),
        }
    }

    /// Writes the first line.
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
        let written = self.append(&Line { at, record: &Begin { record: "opened", opened } }, true);
        written.map_err(|error| JournalError { path: self.path.clone(), error })
    }

    /// Writes a line, and waits for the disk where the record asks for that.
    ///
    /// # Errors
    /// Why the disk does not take it; also for every record after one that was lost.
    pub fn write(&mut self, at: Timestamp<Server>, record: &Record) -> Result<(), String> {
        if let Some(broken) = &self.broken {
            return Err(broken.clone());
        }
        self.append(&Line { at, record }, record.is_durable()).map_err(|error| {
            let reason = format!("cannot write the journal {}: {error}", self.path.display());
            self.broken = Some(reason.clone());
            reason
        })
    }

    fn append(&mut self, line: &impl Serialize, durable: bool) -> io::Result<()> {
        let json = serde_json::to_vec(line)?;
        let mut bytes = format!("{:08x} ", crc32fast::hash(&json)).into_bytes();
        bytes.extend_from_slice(&json);
        bytes.push(b'\n');
        self.file.write_all(&bytes)?;
        if durable { self.file.sync_data() } else { Ok(()) }
    }
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
