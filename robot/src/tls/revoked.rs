//! Revoked certificates, which are invalid although they have not expired. The authority lists them in a file, which may be replaced
//! while a robot runs.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, CertificateRevocationListDer};
use x509_parser::prelude::{CertificateRevocationList, FromDer, X509Certificate};

use super::config::provider;
use super::credentials::CredentialsError;
use downbeat_key_file::{Versioned, Watched, read_regular};

/// Maximum size of a list of revoked certificates, in bytes. An entry takes about 40 bytes.
const BYTES_MAX: u64 = 8 * 1024 * 1024;

/// A file with a list of revoked certificates (RFC 5280, section 5). If the file is replaced, the new list applies within a second, even
/// to open connections.
#[derive(Clone, Debug)]
pub struct Revoked {
    path: PathBuf,
}

impl Revoked {
    /// Returns the list in this file. The authority's signature is not checked until the list is used.
    ///
    /// # Errors
    /// The file cannot be read at present.
    pub fn in_file(path: &Path) -> Result<Self, CredentialsError> {
        der(&read_regular(path, BYTES_MAX)?, path)?;
        Ok(Self { path: path.into() })
    }

    /// Reads the current list from the file.
    ///
    /// # Errors
    /// The file cannot be read, or the authority did not sign the list.
    pub fn read(&self, authority: &CertificateDer<'_>) -> Result<List, CredentialsError> {
        List::read(&self.path, authority)
    }
}

/// A list of revoked certificates that the authority signed.
#[derive(Clone, Debug)]
pub struct List {
    pub(super) der: CertificateRevocationListDer<'static>,
    /// Serial numbers of the revoked certificates, in hexadecimal digits with colons.
    serials: BTreeSet<String>,
    /// Number of the list, as big-endian bytes without leading zeros. A newer list has a larger number.
    number: Vec<u8>,
    /// When the authority signed the list, in seconds since 1970, UTC.
    issued: i64,
    /// When the authority intends to sign the next list, in seconds since 1970, UTC. `None` if the list does not state this.
    next_update: Option<i64>,
}

impl List {
    fn read(path: &Path, authority: &CertificateDer<'_>) -> Result<Self, CredentialsError> {
        Self::of_pem(&read_regular(path, BYTES_MAX)?, path, authority)
    }

    /// Parses the text of a list. Errors name `path` as its file.
    fn of_pem(text: &[u8], path: &Path, authority: &CertificateDer<'_>) -> Result<Self, CredentialsError> {
        let der = der(text, path)?;
        let no_list = || CredentialsError::NoList { path: path.into() };
        let (_, list) = CertificateRevocationList::from_der(&der).map_err(|_| no_list())?;
        if !is_signed_by(&list, authority) {
            return Err(CredentialsError::OtherAuthority { path: path.into() });
        }
        let revoked = list.iter_revoked_certificates();
        Ok(Self {
            serials: revoked.map(|entry| entry.raw_serial_as_string()).collect(),
            number: list.crl_number().map(|number| number.to_bytes_be()).unwrap_or_default(),
            issued: list.last_update().timestamp(),
            next_update: list.next_update().map(|at| at.timestamp()),
            der: der.clone(),
        })
    }

    /// Whether the list contains the certificate with this serial number.
    #[must_use]
    pub fn contains(&self, serial: &str) -> bool {
        self.serials.contains(serial)
    }

    /// Returns the number of the list; `None` if it does not fit into 64 bits. A newer list has a larger number.
    #[must_use]
    pub fn number(&self) -> Option<u64> {
        (self.number.len() <= 8)
            .then(|| self.number.iter().fold(0, |number, byte| number << 8 | u64::from(*byte)))
    }

    /// Returns the time at which the authority signed the list, in seconds since 1970, UTC.
    #[must_use]
    pub const fn issued(&self) -> i64 {
        self.issued
    }

    /// Whether the authority should have signed a newer list before `now` (in seconds since 1970, UTC).
    #[must_use]
    pub fn is_overdue(&self, now: i64) -> bool {
        self.next_update.is_some_and(|at| at < now)
    }
}

impl Versioned for List {
    fn is_older_than(&self, other: &Self) -> bool {
        (self.number.len(), &self.number) < (other.number.len(), &other.number)
    }

    fn number(&self) -> Option<u64> {
        Self::number(self)
    }
}

fn der(text: &[u8], path: &Path) -> Result<CertificateRevocationListDer<'static>, CredentialsError> {
    CertificateRevocationListDer::from_pem_slice(text)
        .map_err(|_| CredentialsError::NoList { path: path.into() })
}

fn is_signed_by(list: &CertificateRevocationList<'_>, authority: &CertificateDer<'_>) -> bool {
    let Ok((_, authority)) = X509Certificate::from_der(authority) else { return false };
    if list.issuer().as_raw() != authority.subject().as_raw() {
        return false;
    }
    let key = &authority.public_key().subject_public_key.data;
    let (signed, signature) = (list.tbs_cert_list.as_ref(), &list.signature_value.data);
    let algorithms = provider().signature_verification_algorithms.all;
    algorithms.iter().any(|algorithm| algorithm.verify_signature(key, signed, signature).is_ok())
}

/// A list that is read again when its file changes. An older list, or one of another authority, does not replace it. Therefore no such
/// list can readmit revoked operators, or exclude operators who would stop the robot.
#[derive(Debug)]
pub(super) struct CurrentList {
    authority: CertificateDer<'static>,
    file: Watched<List>,
    /// Whether the log already contains a warning that this list is overdue.
    warned: AtomicBool,
}

impl CurrentList {
    pub(super) fn new(revoked: &Revoked, authority: &CertificateDer<'static>) -> Result<Self, String> {
        let file = Watched::new(&revoked.path, |path| List::read(path, authority));
        let file = file.map_err(|error| error.to_string())?;
        Ok(Self { authority: authority.clone(), file, warned: AtomicBool::new(false) })
    }

    /// Refuses lists that are older than one that was in use before the process started.
    pub(super) fn storing_number(self) -> Result<Self, String> {
        let file = self.file.storing_number().map_err(|error| error.to_string())?;
        Ok(Self { file, ..self })
    }

    /// Stores this list in the file and uses it if it is newer than the list in use. Does nothing if both are equally new.
    pub(super) fn replace(&self, text: &str) -> Result<(), String> {
        let list = List::of_pem(text.as_bytes(), self.file.path(), &self.authority);
        self.file.replace(text, list.map_err(|error| error.to_string())?)
    }

    /// Returns the list in use, without accessing the file.
    pub(super) fn latest(&self) -> Arc<List> {
        self.file.latest()
    }

    /// Reads the file again if it has changed, and returns the list in use.
    pub(super) fn list(&self) -> Arc<List> {
        let list = self.file.refresh(|path| List::read(path, &self.authority));
        let is_overdue = list.is_overdue(super::calendar());
        if is_overdue && !self.warned.swap(true, Ordering::Relaxed) {
            tracing::warn!(
                "the list of revoked certificates is overdue; get the current one from the authority"
            );
        } else if !is_overdue {
            self.warned.store(false, Ordering::Relaxed);
        }
        list
    }
}
