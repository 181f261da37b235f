//! The audit trail of a robot: who connected, claimed, moved and stopped it, and who was refused. Each record contains the hash of the
//! record before it, so that a record that was changed or removed is detected.

use std::fmt;
use std::io::{self, BufRead};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use urrcp::{Server, Timestamp};

/// Maximum length of a record that [`Chain::check`] reads, in bytes.
const RECORD_BYTES_MAX: u64 = 64 * 1024;

/// Maximum number of faults that [`Chain::faults`] contains.
const FAULTS_MAX: usize = 20;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Event {
    /// The robot's process started.
    Started,
    /// An operator proved its identity.
    Connected,
    /// A peer was not admitted, or one of its requests was refused.
    Refused,
    /// A session claimed the robot.
    Claimed,
    /// The robot no longer belongs to a session.
    Released,
    /// A request began to move a device.
    Moved,
    /// A device began to come to rest, because of a stop, a lease or a failure.
    Rested,
    /// A peer sent a stop.
    Stopped,
    /// An operator's key was revoked or expired while it was in use.
    Barred,
    /// Some records could not be kept, because they came too fast.
    Lost,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Started => "started",
            Self::Connected => "connected",
            Self::Refused => "refused",
            Self::Claimed => "claimed",
            Self::Released => "released",
            Self::Moved => "moved",
            Self::Rested => "rested",
            Self::Stopped => "stopped",
            Self::Barred => "barred",
            Self::Lost => "lost",
        })
    }
}

/// A record of the audit trail, in the file as one line of JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Record {
    /// Number of the record. It increases by one with each record, across all files of the trail.
    pub number: u64,
    /// When it happened, by the clock of the robot's machine.
    pub at: Timestamp<Server>,
    /// The robot's id.
    pub robot: String,
    /// What happened.
    pub event: Event,
    /// Name that the peer has proven. `None` if it has proven none, or if no peer caused the event.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// Serial number of the certificate or pass with which the peer has proven its name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Where the peer connects from: an IP address and a port, or its name in a Zenoh network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peer: Option<String>,
    /// The session of the request, or of the robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// The device that moved, or that the request addresses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Id of the request that caused the event.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request: Option<String>,
    /// Explains the event as a sentence without a full stop.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// SHA-256 of the previous line without its end, in hexadecimal digits. `None` in the first record of a trail.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub previous: Option<String>,
}

impl Record {
    pub(crate) const fn new(at: Timestamp<Server>, robot: String, event: Event) -> Self {
        Self {
            number: 0,
            at,
            robot,
            event,
            operator: None,
            serial: None,
            peer: None,
            session: None,
            device: None,
            request: None,
            reason: None,
            previous: None,
        }
    }
}

/// Returns the hash of a line, by which the next line refers to it.
#[must_use]
pub fn hash(line: &[u8]) -> String {
    Sha256::digest(line).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Checks the chain of hashes through the files of a trail.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chain {
    /// Number of the first record. `None` without records.
    pub first: Option<u64>,
    /// Number of the last record. `None` without records.
    pub last: Option<u64>,
    /// Hash of the last line. `None` without lines.
    pub hash: Option<String>,
    /// The first places at which the chain is broken, each as a sentence without a full stop.
    pub faults: Vec<String>,
    /// Number of further places at which the chain is broken.
    pub further_faults: u64,
}

impl Chain {
    /// Reads the next file of the trail, from the oldest file to the newest, and hands each record with its hash to `keep`. `name` is the name of the
    /// file in [`Chain::faults`].
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn check(
        &mut self,
        name: &str,
        mut lines: impl BufRead,
        mut keep: impl FnMut(Record, &str),
    ) -> io::Result<()> {
        for number in 1_u64.. {
            let mut line = Vec::new();
            let length = io::Read::take(&mut lines, RECORD_BYTES_MAX).read_until(b'\n', &mut line)?;
            if length == 0 {
                break;
            }
            let is_whole = line.pop_if(|byte| *byte == b'\n').is_some();
            let fault = match serde_json::from_slice::<Record>(&line) {
                Ok(record) => {
                    let fault = self.fault_of(&record);
                    self.first = self.first.or(Some(record.number));
                    self.last = Some(record.number);
                    keep(record, &hash(&line));
                    fault
                }
                Err(_) => Some("is not a record, or is incomplete".to_owned()),
            };
            let incomplete = (!is_whole).then(|| "has no end".to_owned());
            if let Some(fault) = fault.or(incomplete) {
                if self.faults.len() < FAULTS_MAX {
                    self.faults.push(format!("{name}, line {number}: {fault}"));
                } else {
                    self.further_faults += 1;
                }
            }
            self.hash = Some(hash(&line));
        }
        Ok(())
    }

    fn fault_of(&self, record: &Record) -> Option<String> {
        let (Some(last), Some(hash)) = (self.last, &self.hash) else { return None };
        if record.previous.as_ref() != Some(hash) {
            return Some(format!("the previous line was changed or removed (record {})", record.number));
        }
        (record.number != last + 1).then(|| format!("record {} follows record {last}", record.number))
    }
}
