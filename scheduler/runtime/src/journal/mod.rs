//! The journal of a mission: an append-only file of lines, each with a checksum. The mission decides which lines must be on the disk
//! before it sends requests. Each mission has a folder with `journal`, which is locked while its scheduler lives, and `control`, its
//! socket.

mod disk;
mod found;
mod lock;
pub mod private;
mod read;
pub mod simulated;
mod writer;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use downbeat_scripts::{Approach, Attempt, RateLimits, Refusal};
use serde::{Deserialize, Serialize};
use urrcp::{ContentHash, InitializationBlock, RobotId, Server, SessionId, Span, Timestamp};

pub use disk::{Disk, FileDisk, Name};
use downbeat_mission::session::{Session, SessionKey};
use downbeat_mission::{FixedStarts, Greeting, Record, dated_line, whole_length};
pub use found::{Found, MissionState, Missions, forget_old, has_begun};
pub use private::NotPrivate;
pub use read::{Contents, Records, Unreadable, read, records};
pub use writer::{News, QueueError, WAITING_MAX, Writer, append_all};

/// Format version of journals and recordings. A program reads only files of its own version.
pub const VERSION: u32 = 1;

/// The first line of a journal: the session, the robots and the plan. It contains everything that a stop needs, because files may change
/// while a mission plays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opened {
    /// The name of the mission, which identifies its session to people.
    pub session: SessionId,
    /// The key that follows the session's name in the session id on the wire. `None` in simulations, where robots know only the name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub key: Option<SessionKey>,
    /// The id of the process that runs the mission.
    pub pid: u32,
    /// The scenario's name; `None` in simulations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The path of the scenario file.
    pub scenario: PathBuf,
    /// The path of the fleet file.
    pub fleet: PathBuf,
    /// The working directory, where programs that drive robots are started. `None` if the folder was removed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// The folder that must contain all files named by the scenario and the fleet. `None` if the operator named no such folder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub project: Option<PathBuf>,
    /// The operator's other choices: acts, robots, speed and approach.
    pub asked: OperatorChoices,
    /// SHA-256 of the plan, as in certificates. `None` in simulations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plan_hash: Option<ContentHash>,
    /// The start time that the operator fixed for an act, and the permitted delay of starts at fixed times.
    pub fixed: FixedStarts,
    /// Whether the mission asks robots for their identity, in handshake steps 1 to 4.
    pub greeting: Greeting,
    /// Server time minus this machine's time, as NTP reported when the mission began.
    #[serde(rename = "clock_offset_ms")]
    pub clock_offset: Span,
    /// The files for TLS and Zenoh. Empty if the mission uses neither.
    #[serde(default, skip_serializing_if = "OpenedKeys::is_empty")]
    pub keys: OpenedKeys,
    /// The robots of the mission.
    pub robots: Vec<OpenedRobot>,
}

/// The files that an operator needs for robots with TLS and for a Zenoh network. The journal does not contain their contents.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenedKeys {
    /// The path of the operator's identity file. `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identity: Option<PathBuf>,
    /// The path of the list of revoked certificates. `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revoked: Option<PathBuf>,
    /// The path of the Zenoh network's configuration. `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zenoh: Option<PathBuf>,
}

impl OpenedKeys {
    /// Whether no file is set.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.identity.is_none() && self.revoked.is_none() && self.zenoh.is_none()
    }
}

impl Opened {
    /// Returns the session as the mission's robots know it: with its key, except in simulations.
    #[must_use]
    pub fn drives_as(&self) -> Session {
        let name = || self.session.clone();
        let with_key = self.key.as_ref().and_then(|key| Session::with_key(name(), key).ok());
        with_key.unwrap_or_else(|| Session::named(name()))
    }
}

/// A robot of a mission, with all data needed to reach the robot without the fleet file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OpenedRobot {
    /// The robot's id in the fleet file.
    pub robot: RobotId,
    /// The id that the robot uses for itself. `None` if it is the same as in the fleet file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own_id: Option<RobotId>,
    /// The robot's address, as written in the fleet file.
    pub address: String,
    /// The description of the robot's devices, if a driver on this machine needs it to reach the hardware.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub init: Option<InitializationBlock>,
    /// The robot's `limits` in the fleet file, by device id, if a driver on this machine must respect them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub limits: BTreeMap<String, RateLimits>,
}

/// The operator's changes to the choreography for this mission.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OperatorChoices {
    /// The only act to play. `None` for all acts.
    pub act: Option<String>,
    /// The act to start with. `None` for the first act.
    pub from: Option<String>,
    /// The only robots to move. Empty for all robots.
    pub only: Vec<RobotId>,
    /// Speed factor relative to the choreography file. `None` for the file's own speed.
    pub speed: Option<f64>,
    /// The additional first act that moves devices to their first positions. `None` without `--approach`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub approach: Option<Approach>,
}

/// The error for a journal that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the journal {}: {}", path.display(), Refusal::of(Attempt::Write(path), error).reason)]
pub struct JournalError {
    /// The journal file.
    pub path: PathBuf,
    /// The operating system's error.
    pub error: io::Error,
}

/// The reason why a journal takes no further records, as a sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct JournalBroken(String);

/// The journal of a running mission.
#[derive(Debug)]
pub struct Journal<D = FileDisk> {
    disk: D,
    path: PathBuf,
    contents: Option<Contents>,
    /// Number of durable records (those that must survive a power loss) appended since the journal was opened.
    appended: u64,
    /// Number of appended durable records that have reached the disk.
    on_disk: u64,
    /// The first write failure. `None` until a write fails; after that, all records are refused.
    broken: Option<JournalBroken>,
}

impl Journal {
    /// Opens and locks the journal in a mission's folder. Cuts off anything after the last whole record.
    ///
    /// # Errors
    /// Returns [`JournalError`], also if another process holds the lock.
    pub fn open(folder: &Path) -> Result<Self, JournalError> {
        let path = folder.join("journal");
        match FileDisk::open(folder) {
            Ok(disk) => Self::on(disk, path),
            Err(error) => Err(JournalError { path, error }),
        }
    }
}

impl<D: Disk> Journal<D> {
    /// Continues a journal whose contents were already read while it was locked. Cuts off anything after the last whole record. `path` is
    /// for error messages.
    ///
    /// # Errors
    /// Returns [`JournalError`] if the disk cannot be truncated.
    pub fn taken_up(mut disk: D, path: PathBuf, contents: Contents) -> Result<Self, JournalError> {
        if contents.kept.torn.is_some()
            && let Err(error) = disk.truncate(contents.kept.whole() as u64)
        {
            return Err(JournalError { path, error });
        }
        Ok(Self { disk, path, contents: Some(contents), appended: 0, on_disk: 0, broken: None })
    }

    /// Opens the journal on a disk. Cuts off anything after the last whole record. `path` is for error messages.
    ///
    /// # Errors
    /// Returns [`JournalError`] if the disk cannot be read or truncated.
    pub fn on(mut disk: D, path: PathBuf) -> Result<Self, JournalError> {
        let mut cut = || {
            let bytes = disk.read()?;
            let whole = whole_length(&bytes);
            if whole < bytes.len() {
                disk.truncate(whole as u64)?;
            }
            Ok(Contents::of_bytes(&bytes).ok())
        };
        match cut() {
            Ok(contents) => Ok(Self { disk, path, contents, appended: 0, on_disk: 0, broken: None }),
            Err(error) => Err(JournalError { path, error }),
        }
    }

    /// The contents that the journal had when it was opened. `None` for a new journal.
    pub const fn contents(&self) -> Option<&Contents> {
        self.contents.as_ref()
    }

    /// Writes the journal's first line. The line is on the disk when this function returns.
    ///
    /// # Errors
    /// Returns [`JournalError`] if the disk refuses the line.
    pub fn begin(&mut self, at: Timestamp<Server>, opened: &Opened) -> Result<(), JournalError> {
        #[derive(Serialize)]
        struct Begin<'a> {
            record: &'static str,
            version: u32,
            #[serde(flatten)]
            opened: &'a Opened,
        }
        let line = dated_line(at, &Begin { record: "opened", version: VERSION, opened });
        let written = line.and_then(|line| self.disk.append(&line)).and_then(|()| self.disk.sync());
        written.map_err(|error| JournalError { path: self.path.clone(), error })
    }

    /// Appends a record as a line. The line may be lost until [`Journal::sync`] has returned.
    ///
    /// # Errors
    /// Returns the reason why the disk refuses the record. After one lost record, all records are refused.
    pub fn append(&mut self, at: Timestamp<Server>, record: &Record) -> Result<(), JournalBroken> {
        self.unless_broken(|disk| dated_line(at, record).and_then(|line| disk.append(&line)))?;
        self.appended += u64::from(record.is_durable());
        Ok(())
    }

    /// Syncs the disk if it may still lack a durable record (one that must survive a power loss). Returns the number of durable records
    /// written to the disk since the journal was opened.
    ///
    /// # Errors
    /// Returns the reason why written records may be lost.
    pub fn sync(&mut self) -> Result<u64, JournalBroken> {
        let due = self.on_disk < self.appended;
        self.unless_broken(|disk| if due { disk.sync() } else { Ok(()) })?;
        self.on_disk = self.appended;
        Ok(self.on_disk)
    }

    /// Makes sure that other commands can find the journal. If the journal was removed or replaced, writes all of it again.
    ///
    /// # Errors
    /// Returns the reason why the journal cannot be written again. It then takes no further records.
    pub fn keep_name(&mut self) -> Result<Name, JournalBroken> {
        if let Some(broken) = &self.broken {
            return Err(broken.clone());
        }
        self.disk.keep_name().map_err(|error| {
            let reason = Refusal::of(Attempt::Write(&self.path), &error).reason;
            self.breaks(format!(
                "the journal {} was removed or replaced and cannot be restored: {reason}",
                self.path.display()
            ))
        })
    }

    fn unless_broken(&mut self, write: impl FnOnce(&mut D) -> io::Result<()>) -> Result<(), JournalBroken> {
        if let Some(broken) = &self.broken {
            return Err(broken.clone());
        }
        write(&mut self.disk).map_err(|error| {
            self.breaks(format!("cannot write the journal {}: {error}", self.path.display()))
        })
    }

    fn breaks(&mut self, reason: String) -> JournalBroken {
        let broken = JournalBroken(reason);
        self.broken = Some(broken.clone());
        broken
    }

    /// Returns all bytes of the journal, for [`ended_acts`](downbeat_mission::ended_acts).
    ///
    /// # Errors
    /// Returns [`JournalError`] if the disk cannot be read.
    pub fn bytes(&mut self) -> Result<Vec<u8>, JournalError> {
        self.disk.read().map_err(|error| JournalError { path: self.path.clone(), error })
    }

    /// Returns the disk in its current state, as if the process had ended.
    pub fn into_disk(self) -> D {
        self.disk
    }
}

/// The folder for missions is unknown. A folder that every user can write to cannot replace it, because anyone could have put files
/// there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "no folder for mission journals: HOME is not set; set HOME, or set DOWNBEAT_STATE to a folder of your own"
)]
pub struct NoStateFolder;

/// Returns the parent of all mission folders: `$DOWNBEAT_STATE`, else `$XDG_STATE_HOME/downbeat`, else `~/.local/state/downbeat`.
///
/// # Errors
/// Fails if none of the variables (including `HOME`) is set. Except in `DOWNBEAT_STATE`, a path that is not absolute is ignored.
pub fn state_folder() -> Result<PathBuf, NoStateFolder> {
    let from = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let absolute = |name: &str| from(name).filter(|path| path.is_absolute());
    from("DOWNBEAT_STATE")
        .or_else(|| absolute("XDG_STATE_HOME").map(|folder| folder.join("downbeat")))
        .or_else(|| absolute("HOME").map(|home| home.join(".local/state/downbeat")))
        .ok_or(NoStateFolder)
}

/// Creates the parent of all mission folders, accessible to this user only, if it does not exist.
///
/// # Errors
/// Returns [`NotPrivate`] if other users have or had access to that folder; otherwise the operating system's error.
pub fn create_state_folder(state: &Path) -> io::Result<()> {
    private::create_folder(state).map(drop)
}

#[cfg(test)]
mod tests;
