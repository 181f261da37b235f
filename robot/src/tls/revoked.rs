//! Certificates that count no more, though they have not expired: the authority's list, as a file that may be replaced.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rustls::pki_types::CertificateRevocationListDer;
use rustls::pki_types::pem::PemObject;

use super::credentials::CredentialsError;
use downbeat_key_file::read_regular;

/// Bytes of a list at most: an entry takes some 40.
const BYTES_MAX: u64 = 8 * 1024 * 1024;

/// A list of revoked certificates (RFC 5280, section 5) in a file. Replace the file, and the next connection obeys it.
#[derive(Clone, Debug)]
pub struct Revoked {
    path: PathBuf,
}

impl Revoked {
    /// A list in this file.
    ///
    /// # Errors
    /// It cannot be read now.
    pub fn in_file(path: &Path) -> Result<Self, CredentialsError> {
        let revoked = Self { path: path.into() };
        revoked.read()?;
        Ok(revoked)
    }

    /// The list as it is now.
    pub(super) fn read(&self) -> Result<CertificateRevocationListDer<'static>, CredentialsError> {
        let text = read_regular(&self.path, BYTES_MAX)?;
        CertificateRevocationListDer::from_pem_slice(&text)
            .map_err(|_| CredentialsError::NoList { path: self.path.clone() })
    }

    /// When the file was last written; `None` where that is not known.
    #[must_use]
    pub fn written(&self) -> Option<SystemTime> {
        std::fs::metadata(&self.path).and_then(|data| data.modified()).ok()
    }
}
