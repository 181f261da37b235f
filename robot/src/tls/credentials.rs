//! The identity file that a robot or an operator uses to prove its identity.

use std::path::{Path, PathBuf};

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};

use super::authority::Authority;
use super::identity::{Identity, IdentityError};
use super::list::List;
use super::revoked::Revoked;
use downbeat_key_file::{KeyFileError, read_private};

/// An error in an identity file or a list of revoked certificates.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CredentialsError {
    /// The file cannot be read, or other users can read it too.
    #[error(transparent)]
    File(#[from] KeyFileError),
    /// A file that should contain a list of revoked certificates contains none.
    #[error("{}: missing list of revoked certificates; expected the file `revoked.pem` that `downbeat keys` wrote", path.display())]
    NoList {
        /// Path of the file.
        path: PathBuf,
    },
    /// A list of revoked certificates is not signed by the authority of the identity.
    #[error("{}: this list of revoked certificates is signed by another authority; expected the `revoked.pem` of the authority that issued the identity", path.display())]
    OtherAuthority {
        /// Path of the file.
        path: PathBuf,
    },
    /// A part of a list of revoked certificates is missing or cannot be trusted.
    #[error("{}: {what}; expected the `revoked.pem` that `downbeat keys` wrote", path.display())]
    Unusable {
        /// Path of the file.
        path: PathBuf,
        /// The fault.
        what: &'static str,
    },
    /// A part of the identity is missing or damaged.
    #[error("{}: {what}; expected a file that `downbeat keys` wrote, with a private key, its certificate and the authority's certificate", path.display())]
    Incomplete {
        /// Path of the file.
        path: PathBuf,
        /// Name of the missing or damaged part.
        what: String,
    },
    /// The certificate contains no valid name of a robot or an operator.
    #[error("{}: {error}", path.display())]
    Nameless {
        /// Path of the file.
        path: PathBuf,
        /// Reason why the name cannot be used.
        error: IdentityError,
    },
}

/// Maximum number of authorities in an identity file: the one that issued the certificate, and the one that it replaces.
const AUTHORITIES_MAX: usize = 2;

/// A private key with its certificate, and the certificates of the trusted authorities.
#[derive(Debug)]
pub struct Credentials {
    pub(super) certificate: CertificateDer<'static>,
    pub(super) key: PrivateKeyDer<'static>,
    /// The first one issued the certificate. A second one is the authority that the first one replaces.
    pub(super) authorities: Vec<Authority>,
    identity: Identity,
}

impl Credentials {
    /// Reads an identity file: PEM with the private key, then the key's certificate, then the certificate of the authority, and
    /// while the authority is replaced that of its predecessor.
    ///
    /// # Errors
    /// [`CredentialsError`]; also if other users can read the file.
    pub fn read(path: &Path) -> Result<Self, CredentialsError> {
        let incomplete = |what: &str| CredentialsError::Incomplete { path: path.into(), what: what.into() };
        let text = read_private(path)?;
        let key = PrivateKeyDer::from_pem_slice(&text).map_err(|_| incomplete("missing private key"))?;
        let damaged = || incomplete("it contains a damaged certificate");
        let certificates: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
        let mut certificates = certificates.map_err(|_| damaged())?.into_iter();
        let found = certificates.len();
        let certificate = certificates.next().filter(|_| (2..=1 + AUTHORITIES_MAX).contains(&found));
        let certificate = certificate
            .ok_or_else(|| incomplete(&format!("it contains {found} certificates, expected two or three")))?;
        let authorities = certificates.map(Authority::of_certificate).collect::<Result<_, _>>();
        let authorities: Vec<Authority> = authorities.map_err(|_| damaged())?;
        // A robot that trusted the root would accept the certificates of all its intermediate authorities.
        if let [issuer, other] = authorities.as_slice()
            && other.has_signed(issuer)
        {
            return Err(incomplete("it contains the root of an intermediate authority"));
        }
        let identity = Identity::of_certificate(&certificate)
            .map_err(|error| CredentialsError::Nameless { path: path.into(), error })?;
        Ok(Self { certificate, key, authorities, identity })
    }

    /// Reads the lists of revoked certificates in a file. The authority of this identity must have signed one of them.
    ///
    /// # Errors
    /// The file cannot be read, or it is not that of this identity's authority.
    pub fn list(&self, revoked: &Revoked) -> Result<List, CredentialsError> {
        revoked.read(&self.authorities)
    }

    /// Returns the identity that the certificate contains.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        &self.identity
    }
}
