//! The missions that left a folder here, as far as the first and the last lines of their journals tell: a stop must not wait
//! until years of old journals are read.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use urrcp::{Server, Timestamp};

use super::private::{self, How, NotPrivate};
use super::read::{begin_of, bytes_of};
use super::{Contents, Opened, Unreadable, lock, read};
use downbeat_mission::{Record, sound};

/// A mission that left a folder.
#[derive(Clone, Debug)]
pub struct Found {
    /// Its folder.
    pub folder: PathBuf,
    /// Its first line.
    pub opened: Opened,
    /// When that was.
    pub opened_at: Timestamp<Server>,
    /// What became of it.
    pub life: Life,
    /// Bytes of its journal.
    size: u64,
}

/// What became of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Life {
    /// Its scheduler lives.
    Running,
    /// Its scheduler was gone before it had ended.
    CutOff,
    /// It has ended.
    Ended,
}

/// All missions that left a folder here.
#[derive(Debug, Default)]
pub struct Missions {
    /// Those that can be read, the newest last.
    pub found: Vec<Found>,
    /// Journals whose first line is damaged or of another version: their robots are not known.
    pub damaged: Vec<PathBuf>,
    /// Folders and journals that are not for this user alone. Nothing in them is read.
    pub refused: Vec<NotPrivate>,
}

impl Missions {
    /// Looks at all folders; there are none while the folder in which they are does not exist.
    ///
    /// # Errors
    /// [`NotPrivate`] where that folder is not for this user alone; else what the system says.
    pub fn of(state: &Path) -> io::Result<Self> {
        let mut missions = Self::default();
        let entries = match private::folder(state).and_then(|_own| std::fs::read_dir(state)) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(missions),
            Err(error) => return Err(error),
        };
        for entry in entries {
            let entry = entry?;
            // Files are of no mission; links are refused by their names.
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

    /// How many folders there are of which nothing else is known.
    #[must_use]
    pub fn unread(&self) -> usize {
        self.damaged.len() + self.refused.len()
    }
}

impl Found {
    /// Looks at one folder; `None` where the first line of its journal is damaged.
    ///
    /// # Errors
    /// There is no journal, or nothing in it yet, or it is not for this user alone ([`NotPrivate`]).
    pub fn look_at(folder: &Path) -> io::Result<Option<Self>> {
        let file = private::file(folder, "journal", How::Read)?;
        let running = lock::is_taken(&file);
        let mut first = Vec::new();
        let mut reader = BufReader::new(&file);
        reader.read_until(b'\n', &mut first)?;
        let size = file.metadata()?.len();
        let Ok((opened, opened_at)) = begin_of(&first) else {
            // Cut off while it began: nothing had been sent yet, unless it is there and hears words.
            let hears = running && folder.join("control").exists();
            return if size == first.len() as u64 && !hears {
                Err(io::ErrorKind::UnexpectedEof.into())
            } else {
                Ok(None)
            };
        };
        let life = match running {
            true => Life::Running,
            false if has_ended(&file, first.len() as u64, size)? => Life::Ended,
            false => Life::CutOff,
        };
        Ok(Some(Self { folder: folder.to_path_buf(), opened, opened_at, life, size }))
    }

    /// Reads its whole journal.
    ///
    /// # Errors
    /// [`Unreadable`] where not even the first line is whole any more.
    pub fn read(&self) -> Result<Contents, Unreadable> {
        read(&self.folder.join("journal"))
    }
}

/// Whether the mission of this folder has checked its fleet: it plays, or waits for its first act.
#[must_use]
pub fn has_begun(folder: &Path) -> bool {
    let journal = bytes_of(&folder.join("journal")).unwrap_or_default();
    let mut records = journal.split_inclusive(|byte| *byte == b'\n').filter_map(record);
    records.any(|record| matches!(record, Record::Checked))
}

/// So many bytes at the end of a journal are looked at: that a mission has ended is one of its last lines, and a short one.
const TAIL: u64 = 64 * 1024;

fn has_ended(mut file: &File, begin: u64, size: u64) -> io::Result<bool> {
    let from = size.saturating_sub(TAIL).max(begin);
    file.seek(SeekFrom::Start(from))?;
    let mut tail = Vec::new();
    file.read_to_end(&mut tail)?;
    // Where that falls into a line, the rest of it is no whole one.
    let lines = tail.split_inclusive(|byte| *byte == b'\n');
    Ok(lines.filter_map(record).any(|record| matches!(record, Record::Ended { .. })))
}

fn record(line: &[u8]) -> Option<Record> {
    serde_json::from_slice(sound(line)?).ok()
}

/// Ended missions whose folders are kept at most.
const ENDED_KEPT: usize = 50;
/// Bytes of the journals of ended missions that are kept at most, except that of the last one.
const ENDED_BYTES: u64 = 64 * 1024 * 1024;

/// Removes the folders of missions that ended: of those beyond the last 50, and of the older ones where their journals are
/// longer than 64 MiB together. Those that were cut off stay until they are resumed or stopped.
pub fn forget_old(state: &Path) {
    let found = Missions::of(state).unwrap_or_default().found;
    let ended = found.into_iter().rev().filter(|found| found.life == Life::Ended);
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
