//! Certificates that are invalid although they have not expired. The authority lists them in a file that may be replaced while a robot
//! runs.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rustls::pki_types::CertificateRevocationListDer;
use rustls::pki_types::pem::PemObject;

use super::credentials::CredentialsError;
use downbeat_key_file::read_regular;

/// Maximum size of a list in bytes. An entry takes about 40 bytes.
const BYTES_MAX: u64 = 8 * 1024 * 1024;

/// A list of revoked certificates (RFC 5280, section 5) in a file. After the file is replaced, the new list applies from the next
/// connection.
#[derive(Clone, Debug)]
pub struct Revoked {
    path: PathBuf,
}

impl Revoked {
    /// Returns the list that is in this file.
    ///
    /// # Errors
    /// The file cannot be read now.
    pub fn in_file(path: &Path) -> Result<Self, CredentialsError> {
        let revoked = Self { path: path.into() };
        revoked.read()?;
        Ok(revoked)
    }

    /// Reads the current list from the file.
    pub(super) fn read(&self) -> Result<CertificateRevocationListDer<'static>, CredentialsError> {
        let text = read_regular(&self.path, BYTES_MAX)?;
        CertificateRevocationListDer::from_pem_slice(&text)
            .map_err(|_| CredentialsError::NoList { path: self.path.clone() })
    }

    /// Returns when the file was last written. `None` if this is unknown.
    #[must_use]
    pub fn written(&self) -> Option<SystemTime> {
        std::fs::metadata(&self.path).and_then(|data| data.modified()).ok()
    }
}
