//! Reading a journal back, as far as it is whole.

use std::io;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;
use urrcp::{RobotId, Server, Timestamp};

use super::Opened;
use crate::mission::Promise;

/// What a journal says.
#[derive(Clone, Debug)]
pub struct Kept {
    /// Its first line.
    pub opened: Opened,
    /// When that was.
    pub opened_at: Timestamp<Server>,
    /// Acts that were promised and have not ended, in order: with how far they came.
    pub promises: Vec<(Promise, Progressed)>,
    /// Acts that have ended.
    pub ended_acts: u32,
    /// Robots that were left out.
    pub dropped: Vec<RobotId>,
    /// Robots that do not know requests by their names.
    pub unnamed: Vec<RobotId>,
    /// Stops were being sent.
    pub stopping: bool,
    /// Robots that have confirmed their stop.
    pub stopped: Vec<RobotId>,
    /// How it ended, as it stands in the report; `None` for a mission that was cut off.
    pub outcome: Option<Value>,
    /// Where it stops being whole.
    pub torn: Option<Torn>,
    /// Every robot that was ever sent anything, with its devices.
    pub touched: std::collections::BTreeMap<RobotId, std::collections::BTreeSet<urrcp::DeviceId>>,
}

/// How far an act came that was promised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progressed {
    /// Its requests were sent, or were about to be.
    Prepared,
    /// All robots had accepted.
    Decided,
    /// Leases were carried over its start, or were about to be.
    Committed,
}

/// A journal that does not even say whose it is.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// The file cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// Its first line is not whole.
    #[error("{} does not begin with a whole line of a journal", path.display())]
    NoBegin {
        /// Which file.
        path: PathBuf,
    },
}

/// A journal with a line that was cut off or changed. What that line and those after it said is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Torn {
    /// Which line, counted from 1.
    pub line: usize,
    /// Bytes from there to the end of the file.
    pub bytes: usize,
    /// Whole lines behind it: the file was damaged, not only cut off.
    pub whole_after: usize,
}

/// Reads a journal up to the first line that is not whole.
///
/// # Errors
/// [`Unreadable`] where not even the first line is whole.
pub fn read(path: &Path) -> Result<Kept, Unreadable> {
    let bytes = std::fs::read(path).map_err(|error| Unreadable::Io { path: path.to_path_buf(), error })?;
    Kept::of_bytes(&bytes).ok_or_else(|| Unreadable::NoBegin { path: path.to_path_buf() })
}

/// Bytes of the whole lines at the beginning.
pub(super) fn whole_length(bytes: &[u8]) -> usize {
    let lines = bytes.split_inclusive(|byte| *byte == b'\n');
    lines.take_while(|line| whole(line).is_some()).map(<[u8]>::len).sum()
}

fn whole(line: &[u8]) -> Option<Value> {
    let line = line.strip_suffix(b"\n")?;
    let (sum, json) = line.split_at_checked(9)?;
    let sum = u32::from_str_radix(std::str::from_utf8(sum.strip_suffix(b" ")?).ok()?, 16).ok()?;
    (crc32fast::hash(json) == sum).then(|| serde_json::from_slice(json).ok())?
}

/// What becomes of a mission that was cut off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// Its acts were decided: it can be played to its end.
    Resume,
    /// What was promised has to be taken back, and why.
    Withdraw(&'static str),
}

impl Kept {
    /// What the bytes of a journal say; `None` where not even the first line is whole.
    pub(crate) fn of_bytes(bytes: &[u8]) -> Option<Self> {
        let (believed, rest) = bytes.split_at(whole_length(bytes));
        let mut lines = believed.split_inclusive(|byte| *byte == b'\n').filter_map(whole);
        let first = lines.next()?;
        let opened = Opened::deserialize(&first).ok()?;
        let mut kept = Self::new(opened, Timestamp::deserialize(&first["at"]).ok()?);
        let mut count = 1;
        for record in lines {
            kept.take(&record);
            count += 1;
        }
        if !rest.is_empty() {
            let after: Vec<Value> = rest.split_inclusive(|byte| *byte == b'\n').filter_map(whole).collect();
            // Of records behind damage only this is believed: these robots may hold something.
            let promises = after.iter().filter_map(|record| Promise::deserialize(record).ok());
            promises.for_each(|promise| kept.touch(&promise));
            kept.torn = Some(Torn { line: count + 1, bytes: rest.len(), whole_after: after.len() });
        }
        Some(kept)
    }

    /// Of a mission of which nothing but its begin is known.
    fn new(opened: Opened, opened_at: Timestamp<Server>) -> Self {
        Self {
            opened,
            opened_at,
            promises: Vec::new(),
            ended_acts: 0,
            dropped: Vec::new(),
            unnamed: Vec::new(),
            stopping: false,
            stopped: Vec::new(),
            outcome: None,
            torn: None,
            touched: std::collections::BTreeMap::new(),
        }
    }

    /// What becomes of it, if it was cut off here.
    #[must_use]
    pub fn fate(&self) -> Fate {
        if self.stopping {
            return Fate::Withdraw("it was being stopped");
        }
        if self.torn.is_some_and(|torn| torn.whole_after > 0) {
            return Fate::Withdraw("its journal is damaged");
        }
        if self.promises.iter().any(|(_, progressed)| *progressed == Progressed::Prepared) {
            return Fate::Withdraw("an act was sent and not decided");
        }
        match self.promises.is_empty() {
            true => Fate::Withdraw("no act was under way"),
            false => Fate::Resume,
        }
    }

    fn touch(&mut self, promise: &Promise) {
        for script in &promise.scripts {
            self.touched.entry(script.robot.clone()).or_default().insert(script.device.clone());
        }
    }

    fn came_to(&mut self, number: Option<u64>, reached: Progressed) {
        let of_number = self.promises.iter_mut().find(|(p, _)| Some(u64::from(p.number)) == number);
        if let Some((_, progressed)) = of_number {
            *progressed = reached;
        }
    }

    fn take(&mut self, record: &Value) {
        let robot = || RobotId::deserialize(&record["robot"]).ok();
        let number = record["number"].as_u64();
        match record["record"].as_str().unwrap_or_default() {
            "prepared" => {
                let Ok(promise) = Promise::deserialize(record) else { return };
                self.touch(&promise);
                self.promises.push((promise, Progressed::Prepared));
            }
            "decided" => {
                self.came_to(number, Progressed::Decided);
                self.unnamed.extend(Vec::deserialize(&record["unnamed"]).unwrap_or_default());
            }
            "committed" => self.came_to(number, Progressed::Committed),
            "act_ended" => {
                let number = record["report"]["number"].as_u64();
                self.promises.retain(|(promise, _)| Some(u64::from(promise.number)) != number);
                self.ended_acts += 1;
            }
            "dropped" => self.dropped.extend(robot()),
            "stopping" => self.stopping = true,
            "stop_confirmed" => self.stopped.extend(robot()),
            "ended" => self.outcome = Some(record["outcome"].clone()),
            _ => {}
        }
    }
}
