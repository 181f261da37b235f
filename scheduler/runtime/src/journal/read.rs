//! Reads the whole lines of a journal.

use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use urrcp::{Server, Timestamp};

use super::private::{self, How};
use super::{Opened, OpenedRobot, VERSION};
use downbeat_mission::{Kept, Left, Record, Torn, sound, whole};

/// Why a journal cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// The file cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// The journal file.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// The first line is incomplete or damaged.
    #[error("{} is not a valid journal: its first line is incomplete or damaged", path.display())]
    NoBegin {
        /// The journal file.
        path: PathBuf,
    },
    /// The journal was written by another version of Downbeat.
    #[error("{} is a version {found} journal, expected version {VERSION}; open it with the version of Downbeat that wrote it", path.display())]
    OtherVersion {
        /// The journal file.
        path: PathBuf,
        /// The version that the journal states.
        found: u32,
    },
}

/// Why the first line of a journal cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BadBegin {
    Damaged,
    OtherVersion(u32),
}

impl BadBegin {
    fn of(self, path: &Path) -> Unreadable {
        let path = path.to_path_buf();
        match self {
            Self::Damaged => Unreadable::NoBegin { path },
            Self::OtherVersion(found) => Unreadable::OtherVersion { path, found },
        }
    }
}

/// Parses the first line of a journal. Also returns the time at which it was written.
pub(super) fn begin_of(line: &[u8]) -> Result<(Opened, Timestamp<Server>), BadBegin> {
    let line = whole(line).ok_or(BadBegin::Damaged)?;
    let version = line["version"].as_u64().and_then(|version| u32::try_from(version).ok());
    let version = version.ok_or(BadBegin::Damaged)?;
    if version != VERSION {
        return Err(BadBegin::OtherVersion(version));
    }
    let opened_at = Timestamp::deserialize(&line["at"]);
    let opened_at = opened_at.map_err(|_| BadBegin::Damaged)?;
    Ok((Opened::deserialize(line).map_err(|_| BadBegin::Damaged)?, opened_at))
}

/// The contents of a journal.
#[derive(Clone, Debug)]
pub struct Contents {
    /// The journal's first line.
    pub opened: Opened,
    /// When the first line was written.
    pub opened_at: Timestamp<Server>,
    /// The state of the mission that the other lines record.
    pub kept: Kept,
}

impl Contents {
    pub(crate) fn of_bytes(bytes: &[u8]) -> Result<Self, BadBegin> {
        let first = bytes.split_inclusive(|byte| *byte == b'\n').next().unwrap_or_default();
        let (opened, opened_at) = begin_of(first)?;
        Ok(Self { opened, opened_at, kept: Kept::of_bytes(bytes) })
    }

    /// Returns the state in which the mission left its robots, including the ids that the robots use for themselves.
    #[must_use]
    pub fn left(&self) -> Left {
        let own_id = |opened: &OpenedRobot| Some((opened.robot.clone(), opened.own_id.clone()?));
        let own_ids = self.opened.robots.iter().filter_map(own_id).collect();
        Left { own_ids, ..self.kept.left() }
    }
}

/// Reads a journal of this user up to the first damaged or incomplete line.
///
/// # Errors
/// Returns [`Unreadable`] if the file cannot be read, or if even its first line cannot be used.
pub fn read(path: &Path) -> Result<Contents, Unreadable> {
    let bytes = bytes_of(path).map_err(|error| Unreadable::Io { path: path.to_path_buf(), error })?;
    Contents::of_bytes(&bytes).map_err(|bad| bad.of(path))
}

/// Reads the bytes of a journal in the state folder.
pub(super) fn bytes_of(path: &Path) -> io::Result<Vec<u8>> {
    let name = path.file_name().and_then(std::ffi::OsStr::to_str).ok_or(io::ErrorKind::NotFound)?;
    let mut bytes = Vec::new();
    private::file(path.parent().unwrap_or(Path::new(".")), name, How::Read)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// All records of a journal, for reports and pages.
#[derive(Clone, Debug)]
pub struct Records {
    /// The first line of the journal.
    pub opened: Opened,
    /// The other lines with their times, up to the first damaged or incomplete line.
    pub all: Vec<(Timestamp<Server>, Record)>,
    /// The position of the first damaged or incomplete line. `None` if all lines are whole.
    pub torn: Option<Torn>,
}

/// Parses the bytes of a journal up to the first damaged or incomplete line. `path` is for error messages.
///
/// # Errors
/// Returns [`Unreadable`] if the file cannot be read, or if even its first line cannot be used.
pub fn records(bytes: &[u8], path: &Path) -> Result<Records, Unreadable> {
    #[derive(Deserialize)]
    struct Dated {
        at: Timestamp<Server>,
        #[serde(flatten)]
        record: Record,
    }
    let contents = Contents::of_bytes(bytes).map_err(|bad| bad.of(path))?;
    let lines =
        bytes[..contents.kept.whole()].split_inclusive(|byte| *byte == b'\n').skip(1).filter_map(sound);
    let record = |line| serde_json::from_slice(line).ok().map(|Dated { at, record }| (at, record));
    Ok(Records { opened: contents.opened, all: lines.filter_map(record).collect(), torn: contents.kept.torn })
}
