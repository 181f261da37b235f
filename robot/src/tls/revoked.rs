//! The file with the lists of revoked certificates, which are invalid although they have not expired. The file may be replaced while a
//! robot runs.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use x509_parser::prelude::{CertificateRevocationList, FromDer};

use super::authority::Authority;
use super::credentials::CredentialsError;
use super::list::{List, ders};
use downbeat_key_file::{Watched, read_regular};

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
        ders(&read_regular(path, BYTES_MAX)?, path)?;
        Ok(Self { path: path.into() })
    }

    /// Reads the current list from the file. `authorities` are those of an identity file.
    pub(super) fn read(&self, authorities: &[Authority]) -> Result<List, CredentialsError> {
        read(&self.path, authorities)
    }

    /// Returns the largest number of a list in the file, without verifying any signature. `None` if the file cannot be read.
    #[must_use]
    pub fn unverified_number(&self) -> Option<u64> {
        let lists = ders(&read_regular(&self.path, BYTES_MAX).ok()?, &self.path).ok()?;
        let number = |der: &[u8]| {
            let (_, list) = CertificateRevocationList::from_der(der).ok()?;
            u64::try_from(list.crl_number()?).ok()
        };
        lists.iter().filter_map(|der| number(der)).max()
    }
}

fn read(path: &Path, authorities: &[Authority]) -> Result<List, CredentialsError> {
    List::of_pem(&read_regular(path, BYTES_MAX)?, path, authorities)
}

/// A list that is read again when its file changes. An older list, or one of another authority, does not replace it. Therefore no such
/// list can readmit revoked operators, or exclude operators who would stop the robot.
#[derive(Debug)]
pub(super) struct CurrentList {
    authorities: Vec<Authority>,
    file: Watched<List>,
    /// Whether the log already contains a warning that this list is overdue.
    warned: AtomicBool,
}

impl CurrentList {
    pub(super) fn new(revoked: &Revoked, authorities: &[Authority]) -> Result<Self, String> {
        let file = Watched::new(&revoked.path, |path| read(path, authorities));
        let file = file.map_err(|error| error.to_string())?;
        Ok(Self { authorities: authorities.to_vec(), file, warned: AtomicBool::new(false) })
    }

    /// Refuses lists that are older than one that was in use before the process started.
    pub(super) fn storing_number(self) -> Result<Self, String> {
        let file = self.file.storing_number().map_err(|error| error.to_string())?;
        Ok(Self { file, ..self })
    }

    /// Stores this list in the file and uses it if it is newer than the list in use. Does nothing if both are equally new.
    pub(super) fn replace(&self, text: &str) -> Result<(), String> {
        let list = List::of_pem(text.as_bytes(), self.file.path(), &self.authorities);
        self.file.replace(text, list.map_err(|error| error.to_string())?)
    }

    /// Returns the list in use, without accessing the file.
    pub(super) fn latest(&self) -> Arc<List> {
        self.file.latest()
    }

    /// Reads the file again if it has changed, and returns the list in use.
    pub(super) fn list(&self) -> Arc<List> {
        let list = self.file.refresh(|path| read(path, &self.authorities));
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
