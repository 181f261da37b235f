//! The missions that have a folder on this machine. Only the first and the last lines of their journals are read. Otherwise, a stop would
//! have to wait until years of old journals are read.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use urrcp::{Server, Timestamp};

use super::private::{self, How, NotPrivate};
use super::read::{begin_of, bytes_of};
use super::{Contents, Opened, Unreadable, lock, read};
use downbeat_mission::{Record, sound};

/// A mission that has a folder on this machine.
#[derive(Clone, Debug)]
pub struct Found {
    /// The mission's folder.
    pub folder: PathBuf,
    /// The first line of the mission's journal.
    pub opened: Opened,
    /// When the first line was written.
    pub opened_at: Timestamp<Server>,
    /// Whether the mission is running, was cut off, or has ended.
    pub life: MissionState,
    /// Size of the mission's journal in bytes.
    size: u64,
}

/// Whether a mission is running, was cut off, or has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MissionState {
    /// The mission's scheduler is alive.
    Running,
    /// The mission's scheduler died before the mission ended.
    CutOff,
    /// The mission has ended.
    Ended,
}

/// All missions that have a folder on this machine.
#[derive(Debug, Default)]
pub struct Missions {
    /// The missions whose first journal line is valid, newest last.
    pub found: Vec<Found>,
    /// Journals whose first line is damaged or has another version. The robots of these missions are unknown.
    pub damaged: Vec<PathBuf>,
    /// Folders and journals to which other users have access. Their contents are not read.
    pub refused: Vec<NotPrivate>,
}

impl Missions {
    /// Reads all mission folders in the folder `state`. Returns no missions if `state` does not exist.
    ///
    /// # Errors
    /// Returns [`NotPrivate`] if other users have access to the state folder; otherwise the operating system's error.
    pub fn of(state: &Path) -> io::Result<Self> {
        let mut missions = Self::default();
        let entries = match private::folder(state).and_then(|_own| std::fs::read_dir(state)) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(missions),
            Err(error) => return Err(error),
        };
        for entry in entries {
            let entry = entry?;
            // Files belong to no mission. Links are refused by name.
            if entry.file_type()?.is_file() {
                continue;
            }
            match Found::look_at(&entry.path()) {
                Ok(Some(found)) => missions.found.push(found),
                Ok(None) => missions.damaged.push(entry.path().join("journal")),
                Err(error) => match NotPrivate::of(&error) {
                    Some(refused) => missions.refused.push(refused.clone()),
                    None => tracing::debug!("{}: {error}", entry.path().display()),
                },
            }
        }
        missions.found.sort_by_key(|found| found.opened_at);
        Ok(missions)
    }

    /// Number of folders whose missions are unknown, because the journal is damaged or refused.
    #[must_use]
    pub fn unread(&self) -> usize {
        self.damaged.len() + self.refused.len()
    }
}

impl Found {
    /// Reads the first and last lines of one mission's journal. Returns `None` if the first line of its journal is damaged.
    ///
    /// # Errors
    /// Fails if the journal does not exist, is still empty, or is accessible to other users ([`NotPrivate`]).
    pub fn look_at(folder: &Path) -> io::Result<Option<Self>> {
        let file = private::file(folder, "journal", How::Read)?;
        let running = lock::is_taken(&file);
        let mut first = Vec::new();
        let mut reader = BufReader::new(&file);
        reader.read_until(b'\n', &mut first)?;
        let size = file.metadata()?.len();
        let Ok((opened, opened_at)) = begin_of(&first) else {
            // If a first line is cut off, nothing was sent yet, unless the scheduler lives and its control socket exists.
            let hears = running && folder.join("control").exists();
            return if size == first.len() as u64 && !hears {
                Err(io::ErrorKind::UnexpectedEof.into())
            } else {
                Ok(None)
            };
        };
        let life = match running {
            true => MissionState::Running,
            false if has_ended(&file, first.len() as u64, size)? => MissionState::Ended,
            false => MissionState::CutOff,
        };
        Ok(Some(Self { folder: folder.to_path_buf(), opened, opened_at, life, size }))
    }

    /// Reads the mission's whole journal.
    ///
    /// # Errors
    /// Returns [`Unreadable`] if even the first line is no longer whole.
    pub fn read(&self) -> Result<Contents, Unreadable> {
        read(&self.folder.join("journal"))
    }
}

/// Whether the mission of this folder has checked its fleet. It then plays an act or waits for its first one.
#[must_use]
pub fn has_begun(folder: &Path) -> bool {
    let journal = bytes_of(&folder.join("journal")).unwrap_or_default();
    let mut records = journal.split_inclusive(|byte| *byte == b'\n').filter_map(record);
    records.any(|record| matches!(record, Record::Checked))
}

/// Number of bytes read from the end of a journal. The record of a mission's end is short and among the last lines.
const TAIL: u64 = 64 * 1024;

fn has_ended(mut file: &File, begin: u64, size: u64) -> io::Result<bool> {
    let from = size.saturating_sub(TAIL).max(begin);
    file.seek(SeekFrom::Start(from))?;
    let mut tail = Vec::new();
    file.read_to_end(&mut tail)?;
    // If the tail starts within a line, the rest of that line fails its checksum.
    let lines = tail.split_inclusive(|byte| *byte == b'\n');
    Ok(lines.filter_map(record).any(|record| matches!(record, Record::Ended { .. })))
}

fn record(line: &[u8]) -> Option<Record> {
    serde_json::from_slice(sound(line)?).ok()
}

/// Maximum number of ended missions whose folders are kept.
const ENDED_KEPT: usize = 50;
/// Maximum total size, in bytes, of the kept journals of ended missions. The latest journal is kept even if it is larger.
const ENDED_BYTES: u64 = 64 * 1024 * 1024;

/// Removes folders of old ended missions. Keeps the latest 50, and fewer if their journals together exceed 64 MiB, but at least one.
/// Missions that were cut off stay until they are resumed or stopped.
pub fn forget_old(state: &Path) {
    let found = Missions::of(state).unwrap_or_default().found;
    let ended = found.into_iter().rev().filter(|found| found.life == MissionState::Ended);
    let mut bytes = 0;
    for (index, found) in ended.enumerate() {
        bytes += found.size;
        let kept = index == 0 || (index < ENDED_KEPT && bytes <= ENDED_BYTES);
        if kept {
            continue;
        }
        if let Err(error) = std::fs::remove_dir_all(&found.folder) {
            tracing::debug!("cannot remove {}: {error}", found.folder.display());
        }
    }
}
