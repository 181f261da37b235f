//! The file by which a robot or an operator proves who it is.

use std::path::{Path, PathBuf};

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};

use super::identity::{Identity, IdentityError};
use downbeat_key_file::{KeyFileError, read_private};

/// An identity file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CredentialsError {
    /// It cannot be read, or others may read it too.
    #[error(transparent)]
    File(#[from] KeyFileError),
    /// A file that is to list revoked certificates does not.
    #[error("{}: there is no list of revoked certificates in it; expected the file `revoked.pem` that `downbeat keys` wrote", path.display())]
    NoList {
        /// Which file.
        path: PathBuf,
    },
    /// It does not hold what it has to.
    #[error("{}: {what}; expected a file that `downbeat keys` wrote: a private key, its certificate, and the authority's", path.display())]
    Incomplete {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// Its certificate names nobody.
    #[error("{}: {error}", path.display())]
    Nameless {
        /// Which file.
        path: PathBuf,
        /// Why not.
        error: IdentityError,
    },
}

/// A key with its certificate, and the authority that is trusted.
#[derive(Debug)]
pub struct Credentials {
    pub(super) certificate: CertificateDer<'static>,
    pub(super) key: PrivateKeyDer<'static>,
    pub(super) authority: CertificateDer<'static>,
    identity: Identity,
}

impl Credentials {
    /// Reads an identity file: PEM with the private key, its certificate, and behind that the authority's.
    ///
    /// # Errors
    /// [`CredentialsError`], also where others may read the file.
    pub fn read(path: &Path) -> Result<Self, CredentialsError> {
        let incomplete = |what: &str| CredentialsError::Incomplete { path: path.into(), what: what.into() };
        let text = read_private(path)?;
        let key = PrivateKeyDer::from_pem_slice(&text).map_err(|_| incomplete("there is no private key"))?;
        let certificates: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
        let certificates = certificates.map_err(|_| incomplete("a certificate in it is damaged"))?;
        let [certificate, authority] = <[_; 2]>::try_from(certificates)
            .map_err(|found| incomplete(&format!("there are {} certificates in it", found.len())))?;
        let identity = Identity::of_certificate(&certificate)
            .map_err(|error| CredentialsError::Nameless { path: path.into(), error })?;
        Ok(Self { certificate, key, authority, identity })
    }

    /// Whose it is.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        &self.identity
    }
}
