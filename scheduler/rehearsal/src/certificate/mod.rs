//! A certificate: which plan was played in virtual time against which faults, and that what is promised held each time.
//!
//! `subject` says what is certified, `differences` how another subject differs, `trials` what is played. This file is the
//! document. It protects against mistakes: its seal shows damage, and is no signature.

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

/// The version of the document that this program writes and reads.
pub const VERSION: u32 = 1;
/// Bytes of a document that are read at most.
const BYTES_MAX: u64 = 64 << 20;

/// What was played, and what became of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// Version of this document: [`VERSION`].
    pub certificate: u32,
    /// Version of the program that played it.
    pub downbeat: String,
    /// Seed of the random delays and clock errors of every trial.
    pub seed: u64,
    /// What was played.
    pub subject: Subject,
    /// Every fault, in the order in which they were played. The promise held in each.
    pub trials: Vec<Trial>,
    /// SHA-256 over the canonical JSON of all other keys: sorted keys, no white space.
    pub seal: ContentHash,
}

/// Why a file is no certificate that can be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertificateError {
    /// It cannot be read.
    #[error("cannot read the certificate `{file}`: {reason}")]
    Unreadable {
        /// The file as the user named it.
        file: String,
        /// Why, for people.
        reason: String,
    },
    /// It is not whole, or something else.
    #[error(
        "`{file}` is not a whole certificate: {reason}; write it again with `downbeat dry-run --certify`"
    )]
    Damaged {
        /// The file as the user named it.
        file: String,
        /// Why, for people.
        reason: String,
    },
    /// Another program wrote it.
    #[error("`{file}` is a certificate of version {version}, and this program reads version {VERSION}")]
    Version {
        /// The file as the user named it.
        file: String,
        /// The version found.
        version: u64,
    },
    /// What is in it was changed.
    #[error(
        "`{file}` was changed after it was written: its seal does not fit; write it again with `downbeat dry-run --certify`"
    )]
    Seal {
        /// The file as the user named it.
        file: String,
    },
}

impl Certificate {
    /// Of trials in all of which the promise held.
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

    /// Reads and verifies one.
    ///
    /// # Errors
    /// A file that cannot be read, is damaged, was changed, or has another version.
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

    /// The document, the same bytes for the same certificate.
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

/// As a tree with sorted keys. What cannot be one is null: no type of this module.
fn value_of(what: &impl Serialize) -> Value {
    sorted(serde_json::to_value(what).unwrap_or(Value::Null))
}

/// Whether maps of the JSON library keep an order depends on how it was built.
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

/// SHA-256 over canonical JSON.
fn hash_of(what: &impl Serialize) -> ContentHash {
    ContentHash::of(value_of(what).to_string().as_bytes())
}

#[cfg(test)]
mod tests;
