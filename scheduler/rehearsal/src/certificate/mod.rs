//! A certificate states that a plan was played in virtual time with a list of faults, and that all promises were kept each time: robots
//! start an act together or not at all, they come to rest, and the report is true.
//!
//! `subject` lists the certified properties, `differences` compares two subjects, `trials` plays the faults. This file contains the
//! certificate itself. Its seal, a hash, detects damage and mistakes, but is not a signature.

mod differences;
mod subject;
mod trials;

use std::io::Read;
use std::path::Path;

use downbeat_scripts::{Attempt, Refusal};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use urrcp::ContentHash;

pub use self::differences::differences;
pub use self::subject::{CertifiedAct, CertifiedRobot, Options, Subject, plan_hash};
pub use self::trials::{Injected, Trial, faults, play};

/// The certificate version that this program writes and reads.
pub const VERSION: u32 = 1;
/// Maximum size of a certificate file in bytes.
const BYTES_MAX: u64 = 64 << 20;

/// A certified plan and the trials that it passed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// Version of the certificate format: [`VERSION`].
    pub certificate: u32,
    /// Version of Downbeat that played the trials.
    pub downbeat: String,
    /// Seed of the random delays and clock errors of every trial.
    pub seed: u64,
    /// The plan and the fleet with which the trials were played.
    pub subject: Subject,
    /// One trial per fault, in the order of play. No trial broke a promise.
    pub trials: Vec<Trial>,
    /// SHA-256 over the canonical JSON of all other keys: sorted keys, no white space.
    pub seal: ContentHash,
}

/// Why a file is not a usable certificate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertificateError {
    /// The file cannot be read.
    #[error("cannot read the certificate `{file}`: {reason}")]
    Unreadable {
        /// The path of the file, as the user gave it.
        file: String,
        /// The reason for the error, for people.
        reason: String,
    },
    /// The file is incomplete or not a certificate.
    #[error(
        "`{file}` is not a complete certificate: {reason}; create it again with `downbeat dry-run --certify`"
    )]
    Damaged {
        /// The path of the file, as the user gave it.
        file: String,
        /// The reason for the error, for people.
        reason: String,
    },
    /// The version of the certificate is not [`VERSION`].
    #[error(
        "`{file}` is a version {version} certificate, expected version {VERSION}; create it again with `downbeat dry-run --certify`"
    )]
    Version {
        /// The path of the file, as the user gave it.
        file: String,
        /// The version stated in the file.
        version: u64,
    },
    /// The content was changed after the certificate was written.
    #[error(
        "`{file}` was changed after it was written: its seal does not match; create it again with `downbeat dry-run --certify`"
    )]
    Seal {
        /// The path of the file, as the user gave it.
        file: String,
    },
}

impl Certificate {
    /// Creates a certificate from trials in which no promise was broken.
    #[must_use]
    pub fn new(seed: u64, subject: Subject, trials: Vec<Trial>) -> Self {
        let mut certificate = Self {
            certificate: VERSION,
            downbeat: env!("CARGO_PKG_VERSION").to_owned(),
            seed,
            subject,
            trials,
            seal: ContentHash::of(&[]),
        };
        certificate.seal = certificate.sealed();
        certificate
    }

    /// Reads and verifies a certificate.
    ///
    /// # Errors
    /// [`CertificateError`] if the file cannot be read, is damaged, was changed, or has another version.
    pub fn read(path: &Path) -> Result<Self, CertificateError> {
        let file = path.display().to_string();
        let unreadable = |error: std::io::Error| {
            let reason = Refusal::of(Attempt::Read(path), &error).to_string();
            CertificateError::Unreadable { file: file.clone(), reason }
        };
        let mut bytes = Vec::new();
        let opened = downbeat_scripts::open(path).map_err(unreadable)?;
        opened.take(BYTES_MAX + 1).read_to_end(&mut bytes).map_err(unreadable)?;
        if bytes.len() as u64 > BYTES_MAX {
            let reason = format!("it is larger than {} MiB", BYTES_MAX >> 20);
            return Err(CertificateError::Damaged { file, reason });
        }
        Self::parsed(&bytes, file)
    }

    fn parsed(bytes: &[u8], file: String) -> Result<Self, CertificateError> {
        let document: Value = match serde_json::from_slice(bytes) {
            Ok(document) => document,
            Err(error) => return Err(CertificateError::Damaged { file, reason: error.to_string() }),
        };
        match document.get("certificate").and_then(Value::as_u64) {
            Some(version) if version == u64::from(VERSION) => {}
            Some(version) => return Err(CertificateError::Version { file, version }),
            None => {
                let reason = "it has no key `certificate` with a version".to_owned();
                return Err(CertificateError::Damaged { file, reason });
            }
        }
        let certificate: Self = match serde_json::from_value(document) {
            Ok(certificate) => certificate,
            Err(error) => return Err(CertificateError::Damaged { file, reason: error.to_string() }),
        };
        if certificate.seal == certificate.sealed() {
            Ok(certificate)
        } else {
            Err(CertificateError::Seal { file })
        }
    }

    /// Returns the certificate as the text of its file. Equal certificates give the same bytes.
    #[must_use]
    pub fn text(&self) -> String {
        format!("{:#}\n", value_of(self))
    }

    fn sealed(&self) -> ContentHash {
        let mut document = value_of(self);
        if let Value::Object(keys) = &mut document {
            keys.remove("seal");
        }
        hash_of(&document)
    }
}

/// Serializes with sorted keys. Cannot fail for the types of this module.
fn value_of(what: &impl Serialize) -> Value {
    sorted(serde_json::to_value(what).unwrap_or(Value::Null))
}

/// Sorts the keys of all objects, because the key order of the JSON library depends on its build features.
fn sorted(value: Value) -> Value {
    match value {
        Value::Object(map) => {
            let ordered: std::collections::BTreeMap<String, Value> =
                map.into_iter().map(|(key, value)| (key, sorted(value))).collect();
            Value::Object(ordered.into_iter().collect())
        }
        Value::Array(items) => Value::Array(items.into_iter().map(sorted).collect()),
        other => other,
    }
}

/// SHA-256 over the canonical JSON of `what`.
fn hash_of(what: &impl Serialize) -> ContentHash {
    ContentHash::of(value_of(what).to_string().as_bytes())
}

#[cfg(test)]
mod tests;
