//! The file by which a robot or an operator proves who it is.

use std::io::Read;
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags, Stat};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};

use super::identity::{Identity, IdentityError};

/// Bytes of an identity file at most: a key and two certificates are some three thousand.
const BYTES_MAX: u64 = 64 * 1024;

/// An identity file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CredentialsError {
    /// It cannot be read.
    #[error("{}: {error}", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// The error of the system.
        error: std::io::Error,
    },
    /// Others may read the key.
    #[error("{}: others may read this key (mode {mode:03o}); make it yours alone: chmod 600 {}", path.display(), path.display())]
    NotPrivate {
        /// Which file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
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

fn read_private(path: &Path) -> Result<Vec<u8>, CredentialsError> {
    let unreadable = |error: std::io::Error| CredentialsError::Unreadable { path: path.into(), error };
    let (file, stat) = open_regular(path).map_err(unreadable)?;
    let mode = stat.st_mode & 0o777;
    // A file of root may be handed to a service by its group, as systemd does with credentials.
    let handed_over = stat.st_uid == 0 && !rustix::process::geteuid().is_root();
    if mode & if handed_over { 0o037 } else { 0o077 } != 0 {
        return Err(CredentialsError::NotPrivate { path: path.into(), mode });
    }
    let mut text = Vec::new();
    file.take(BYTES_MAX).read_to_end(&mut text).map_err(unreadable)?;
    Ok(text)
}

/// Opens a file, and nothing else in its place: a pipe would not be waited for.
pub(super) fn open_regular(path: &Path) -> std::io::Result<(std::fs::File, Stat)> {
    let file = rustix::fs::open(path, OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NONBLOCK, Mode::empty())?;
    let stat = rustix::fs::fstat(&file)?;
    if !rustix::fs::FileType::from_raw_mode(stat.st_mode).is_file() {
        return Err(std::io::Error::other("it is no regular file"));
    }
    Ok((file.into(), stat))
}
