//! The record of all certificates that an authority has issued. Each line of the file is a JSON object for one certificate.

use std::collections::BTreeMap;
use std::path::Path;

use downbeat_robot::tls::{Identity, Name};
use downbeat_robot::{Role, Roles};
use serde::{Deserialize, Serialize};

use super::{KeysError, files};

const FILE: &str = "issued.jsonl";

/// The record of one issued certificate.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// The serial number, in hexadecimal digits with colons.
    pub serial: String,
    /// Whether the certificate belongs to a robot or an operator.
    pub kind: Kind,
    /// The robot's id, or the operator's name.
    pub name: String,
    /// The operator's roles. Empty for a robot.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub roles: Vec<String>,
    /// When the certificate was issued, in seconds since 1970, UTC.
    pub issued: i64,
    /// When the certificate expires, in seconds since 1970, UTC.
    pub expires: i64,
    /// When the certificate was revoked, in seconds since 1970, UTC. `None` if it was not revoked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revoked: Option<i64>,
    /// The name of the authority that issued the certificate. `None` in a record from before authorities could be replaced; it means
    /// the first authority of the folder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub authority: Option<String>,
    /// Whether the certificate was requested for a key that is not in the authority's folder.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub requested: bool,
}

/// The kind of a certificate's owner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The certificate of a robot.
    Robot,
    /// The certificate of an operator.
    Operator,
}

impl Entry {
    /// Returns the roles of the certificate's owner. Unknown roles are omitted.
    #[must_use]
    pub fn roles(&self) -> Roles {
        self.roles.iter().filter_map(|role| role.parse::<Role>().ok()).collect()
    }

    /// Returns the robot or operator to whom the certificate was issued. `None` if the record contains an invalid id.
    #[must_use]
    pub fn owner(&self) -> Option<Name> {
        match self.kind {
            Kind::Robot => self.name.parse().ok().map(Name::Robot),
            Kind::Operator => Some(Name::Operator(self.name.clone())),
        }
    }

    fn is_of(&self, name: &Name) -> bool {
        match name {
            Name::Robot(id) => self.kind == Kind::Robot && self.name == id.as_str(),
            Name::Operator(name) => self.kind == Kind::Operator && self.name == *name,
        }
    }

    /// Whether the certificate is neither revoked nor expired at `now`, in seconds since 1970, UTC. Its authority may have ended.
    #[must_use]
    pub fn is_valid(&self, now: i64) -> bool {
        self.revoked.is_none() && self.expires >= now
    }

    fn serial(&self) -> Option<Vec<u8>> {
        self.serial.split(':').map(|byte| u8::from_str_radix(byte, 16).ok()).collect()
    }
}

/// All issued certificates, in order of issue.
#[derive(Clone, Debug, Default)]
pub struct Issued {
    entries: Vec<Entry>,
}

impl Issued {
    pub(super) fn read(folder: &Path) -> Result<Self, KeysError> {
        let path = folder.join(FILE);
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = files::read(&path)?;
        let entry = |(number, line): (usize, &str)| {
            let entry = serde_json::from_str::<Entry>(line).ok().filter(|entry| entry.serial().is_some());
            let what = || {
                format!(
                    "line {}: invalid certificate entry, expected an entry written by `downbeat keys`",
                    number + 1
                )
            };
            entry.ok_or_else(|| KeysError::Damaged { path: path.clone(), what: what() })
        };
        Ok(Self { entries: text.lines().enumerate().map(entry).collect::<Result<_, _>>()? })
    }

    pub(super) fn write(&self, folder: &Path) -> Result<(), KeysError> {
        let path = folder.join(FILE);
        let lines: Result<Vec<String>, _> = self.entries.iter().map(serde_json::to_string).collect();
        let lines =
            lines.map_err(|error| KeysError::Damaged { path: path.clone(), what: error.to_string() })?;
        files::write_private(&path, &lines.iter().map(|line| format!("{line}\n")).collect::<String>())
    }

    pub(super) fn add(&mut self, identity: &Identity, now: i64) {
        let (kind, name) = match &identity.name {
            Name::Robot(id) => (Kind::Robot, id.to_string()),
            Name::Operator(name) => (Kind::Operator, name.clone()),
        };
        let roles = identity.roles.iter().map(|role| role.to_string()).collect();
        let (serial, expires) = (identity.serial.clone(), identity.expires);
        let authority = Some(identity.authority.clone());
        self.entries.push(Entry {
            serial,
            kind,
            name,
            roles,
            issued: now,
            expires,
            revoked: None,
            authority,
            requested: false,
        });
    }

    /// Like [`Self::add`], for a key that is not in the authority's folder.
    pub(super) fn add_requested(&mut self, identity: &Identity, now: i64) {
        self.add(identity, now);
        if let Some(entry) = self.entries.last_mut() {
            entry.requested = true;
        }
    }

    /// Attributes certificates without an authority to this one. Returns whether there were any.
    pub(super) fn attribute(&mut self, authority: &str) -> bool {
        let nameless = self.entries.iter_mut().filter(|entry| entry.authority.is_none());
        nameless.map(|entry| entry.authority = Some(authority.to_owned())).count() > 0
    }

    /// Returns for each robot and operator the latest certificate that is valid at `now`, in seconds since 1970, UTC.
    pub(super) fn valid(&self, now: i64) -> BTreeMap<Name, &Entry> {
        let valid = self.entries.iter().filter(|entry| entry.is_valid(now));
        valid.filter_map(|entry| Some((entry.owner()?, entry))).collect()
    }

    /// All entries, in order of issue.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Returns the certificate last issued to this robot or operator; `None` if none was issued.
    #[must_use]
    pub fn latest(&self, name: &Name) -> Option<&Entry> {
        self.entries.iter().rev().find(|entry| entry.is_of(name))
    }

    /// Revokes all certificates of a robot or operator. Returns the number of certificates that were not revoked before.
    pub(super) fn revoke(&mut self, name: &Name, now: i64) -> usize {
        let counts = self.entries.iter_mut().filter(|entry| entry.is_of(name) && entry.revoked.is_none());
        counts.map(|entry| entry.revoked = Some(now)).count()
    }

    /// Revokes one certificate. Returns false if it is unknown or already revoked.
    pub(super) fn revoke_serial(&mut self, serial: &str, now: i64) -> bool {
        let mut entries = self.entries.iter_mut();
        let found = entries.find(|entry| entry.serial == serial && entry.revoked.is_none());
        found.map(|entry| entry.revoked = Some(now)).is_some()
    }

    /// Returns the latest certificate of each operator, unless it is revoked.
    pub(super) fn operators(&self) -> impl Iterator<Item = &Entry> + '_ {
        let is_last = |entry: &&Entry| {
            self.latest(&Name::Operator(entry.name.clone())).is_some_and(|last| last.serial == entry.serial)
        };
        let operators = self.entries.iter().filter(|entry| entry.kind == Kind::Operator);
        operators.filter(|entry| entry.revoked.is_none()).filter(is_last)
    }

    /// Returns the serial number and the time of revocation of each certificate that this authority issued and that was revoked.
    pub(super) fn revoked_of<'a>(&'a self, authority: &'a str) -> impl Iterator<Item = (Vec<u8>, i64)> + 'a {
        let is_of = move |entry: &&Entry| entry.authority.as_deref().is_none_or(|name| name == authority);
        self.entries.iter().filter(is_of).filter_map(|entry| entry.serial().zip(entry.revoked))
    }

    pub(super) fn unknown(&self, name: &Name) -> KeysError {
        let mut known: Vec<&str> = self.entries.iter().map(|entry| entry.name.as_str()).collect();
        known.sort_unstable();
        known.dedup();
        KeysError::unknown(name, &known)
    }
}
