//! The certificate authority of a site: a folder that contains a key, and issues the keys of robots and operators.
//!
//! Only the owner has access to the folder. It contains `authority.key`, `authority.pem`, the list of revoked certificates `revoked.pem`,
//! and a record of all issued certificates (`issued.rs`). It also contains an identity file for each robot and operator: the private key,
//! its certificate, and the authority's certificate. The contents of a certificate are defined in `downbeat_robot::tls`. For robots
//! without TLS, the folder contains secrets, and operators' passes made from them (`secrets.rs`). Keys that are made elsewhere are only
//! certified (`request.rs`). The authority's key may have a passphrase (`passphrase.rs`, `unlocked.rs`). While the authority is replaced,
//! the folder contains its successor as well (`rotation.rs`).

mod files;
mod fingerprint;
mod issued;
mod location;
mod passphrase;
mod request;
mod rotation;
mod secrets;
#[cfg(test)]
mod tests;
mod unlocked;

use std::collections::BTreeSet;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use downbeat_robot::sealed::{self, RevokedSerials, Secret, SecretError};
use downbeat_robot::tls::{self, Credentials, Identity, Name, Revoked, SERVER_NAME};
use downbeat_robot::{Door, KeyFileError, Roles};
use downbeat_scripts::Protection;
use pkcs8::der::zeroize::Zeroizing;
use rcgen::{
    BasicConstraints, CertificateParams, CertificateRevocationListParams, DistinguishedName, DnType,
    ExtendedKeyUsagePurpose, IsCa, Issuer, KeyIdMethod, KeyPair, KeyUsagePurpose, PublicKeyData,
    RevokedCertParams, SanType, SerialNumber,
};
use time::OffsetDateTime;
use urrcp::RobotId;

use crate::journal::private::NotPrivate;
pub use files::file_name;
pub use fingerprint::Fingerprint;
pub use issued::{Entry, Issued, Kind};
pub use location::Location;
pub use passphrase::{Ask, Passphrase, PassphraseError};
pub use request::{Installed, Request, RequestError, Requested, Signed, Terms, install, request};
pub use rotation::{Authorities, End, Issuing, Renewed};
pub use secrets::IfThere;
use unlocked::Unlocked;

const AUTHORITY_KEY: &str = "authority.key";
const AUTHORITY: &str = "authority.pem";
/// The keys with another passphrase, while the files of two keys are being replaced.
const CHANGED_KEYS: &str = "changed.key";
const PEM_BEGIN: &str = "-----BEGIN ";
const REVOKED: &str = "revoked.pem";
const REVOKED_SERIALS: &str = "revoked.serials";
/// Validity of an authority in days.
const AUTHORITY_DAYS: i64 = 3_650;
/// A list of revoked certificates states when the next list is due: after this number of days. `keys push` makes a new one in time.
const LIST_DAYS: i64 = 365;
/// The validity of a certificate starts this number of seconds before its issue, because clocks differ.
const BACKDATED: i64 = 300;
const DAY: i64 = 24 * 3_600;
/// Maximum length of a common name (RFC 5280, appendix A.1: `ub-common-name`). The common name is only for people to read.
const COMMON_NAME_MAX: usize = 64;

/// Why keys could not be made or used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeysError {
    /// A file cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// The path of the file.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// Other users may have changed the folder or a file in it.
    #[error(transparent)]
    NotPrivate(NotPrivate),
    /// The folder already contains a certificate authority.
    #[error("{} already contains an authority, and robots that trust it would not accept a second one; use it, or set another folder with --keys", .0.display())]
    Exists(PathBuf),
    /// The folder contains no certificate authority.
    #[error("{} contains no authority; create one with `downbeat keys init`, or set its folder with --keys", .0.display())]
    NoAuthority(PathBuf),
    /// No variable of the environment names a folder for keys.
    #[error(
        "no folder for keys: HOME is not set; set HOME, set DOWNBEAT_KEYS to a folder of your own, or name a folder with --keys"
    )]
    NoFolder,
    /// The default folder, named here, contains no authority, but the default folder of earlier versions does.
    #[error("{} contains no authority, but the folder `keys` does, which was the default of earlier versions; use it with `--keys keys`, or name another folder with --keys", .0.display())]
    FormerDefault(PathBuf),
    /// The contents of a file cannot be used.
    #[error("{}: {what}", path.display())]
    Damaged {
        /// The path of the file.
        path: PathBuf,
        /// The fault in the contents.
        what: String,
    },
    /// These names already have a key.
    #[error("{}; create a new one with `downbeat keys renew`", have_keys(.0))]
    Taken(Vec<Name>),
    /// These robots already have a secret.
    #[error("{}; --renew replaces and invalidates it", have_secrets(.0))]
    SecretTaken(Vec<RobotId>),
    /// A secret or a pass cannot be read or made.
    #[error(transparent)]
    Secret(#[from] SecretError),
    /// A file with a private key cannot be used.
    #[error(transparent)]
    KeyFile(#[from] KeyFileError),
    /// The authority's key has a passphrase that is not known, or cannot have this one.
    #[error(transparent)]
    Passphrase(#[from] PassphraseError),
    /// A file that would be written exists.
    #[error("{} exists, and is not replaced; move it away, or name another folder with --out", .0.display())]
    FileExists(PathBuf),
    /// A request for a certificate, or a certificate, is not used.
    #[error("{}: {error}", path.display())]
    Request {
        /// The path of the file.
        path: PathBuf,
        /// The reason.
        error: RequestError,
    },
    /// The private key of this name is not in the authority's folder, because its certificate was requested.
    #[error("the private key of {0} is on the machine that requested its certificate; make another key there with `downbeat keys request {kind} {name}`, and sign the request here with `downbeat keys sign --renew`", kind = kind_and_name(.0).0, name = kind_and_name(.0).1)]
    KeyElsewhere(Name),
    /// A text cannot be the name of a robot or an operator.
    #[error("`{name}` cannot be a name: {error}")]
    Name {
        /// The text.
        name: String,
        /// The reason, or the expected form.
        error: String,
    },
    /// Roles were requested for a robot.
    #[error("robots have no roles; leave out --role")]
    RolesOfRobot,
    /// No key was issued under this name.
    #[error("{name} has no key in this folder; names with a key: {known}")]
    Unknown {
        /// The requested name.
        name: String,
        /// The existing names, as text.
        known: String,
    },
    /// All certificates of this name are already revoked.
    #[error("every certificate of {0} is already revoked")]
    RevokedAlready(Name),
    /// No certificate has this serial number.
    #[error("no certificate has the serial number `{0}`; list the serial numbers with `downbeat keys list`")]
    NoSerial(String),
    /// Several certificates have a serial number that begins in this way.
    #[error("several certificates have a serial number that begins with `{0}`; specify more digits")]
    AmbiguousSerial(String),
    /// The authority is already being replaced.
    #[error("the authority in {} is already being replaced; create the remaining keys with `downbeat keys renew --all`, then shut out the old authority with `downbeat keys rotate --end`", .0.display())]
    Rotating(PathBuf),
    /// The authority is not being replaced.
    #[error("the authority in {} is not being replaced; begin with `downbeat keys rotate`", .0.display())]
    NotRotating(PathBuf),
    /// These names have valid certificates of the old authority, and none of the new one.
    #[error("{} only a key of the old authority; create new ones with `downbeat keys renew --all`, or shut these out with --force", have_only(.0))]
    NotRenewed(Vec<Name>),
    /// The certificate could not be signed.
    #[error("cannot create a certificate: {0}")]
    Signing(#[from] rcgen::Error),
}

impl KeysError {
    fn unknown(name: &Name, known: &[&str]) -> Self {
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        Self::Unknown { name: name.to_string(), known }
    }
}

fn no_passphrase(key: &Path) -> Result<Passphrase, PassphraseError> {
    Err(PassphraseError::Unknown(key.into()))
}

/// Returns a name as two words of a command.
fn kind_and_name(name: &Name) -> (&'static str, &str) {
    match name {
        Name::Robot(id) => ("robot", id.as_str()),
        Name::Operator(name) => ("operator", name),
    }
}

fn have_keys(names: &[Name]) -> String {
    have(names.iter().map(Name::to_string), "key")
}

fn have_secrets(robots: &[RobotId]) -> String {
    have(robots.iter().map(|robot| format!("robot {robot}")), "secret")
}

fn have_only(names: &[Name]) -> String {
    let listed: Vec<String> = names.iter().map(Name::to_string).collect();
    format!("{} {}", listed.join(", "), if names.len() == 1 { "has" } else { "have" })
}

fn have(names: impl Iterator<Item = String>, what: &str) -> String {
    let listed: Vec<String> = names.collect();
    if let [one] = listed.as_slice() {
        format!("{one} already has a {what}")
    } else {
        format!("{} already have {what}s", listed.join(", "))
    }
}

/// An open certificate authority. Its folder is locked.
#[derive(Debug)]
pub struct Authority {
    folder: PathBuf,
    /// Lock that admits only one process to the folder at a time. It is held while this value lives.
    _lock: File,
    /// The keys in the folder, whose passphrase is asked for at most once.
    keys: Unlocked,
}

impl Authority {
    /// Creates a new authority in a folder. `now` is in seconds since 1970, UTC.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if an authority already exists.
    pub fn create(folder: &Path, now: i64) -> Result<Self, KeysError> {
        Self::create_with(folder, now, None)
    }

    /// Creates a new authority in a folder. If `new_passphrase` is given, it is called for the passphrase of the key. `now` is in seconds
    /// since 1970, UTC.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if an authority already exists.
    pub fn create_with(folder: &Path, now: i64, new_passphrase: Option<Ask>) -> Result<Self, KeysError> {
        files::make_private_folder(folder)?;
        let own = Self::in_folder(folder, no_passphrase)?;
        if own.path(AUTHORITY_KEY).exists() || own.path(AUTHORITY).exists() {
            return Err(KeysError::Exists(folder.into()));
        }
        files::keep_out_of_git(folder)?;
        let key = KeyPair::generate()?;
        let certificate = authority_params(&key, now)?.self_signed(&key)?;
        own.keys.protect_with(new_passphrase.map(|ask| ask(&own.path(AUTHORITY_KEY))).transpose()?);
        own.write_key(AUTHORITY_KEY, &Zeroizing::new(key.serialize_pem()))?;
        files::write_public(&own.path(AUTHORITY), &certificate.pem())?;
        own.write_revoked(&Issued::default(), now)?;
        Ok(own)
    }

    /// Opens an existing authority whose key has no passphrase, or will not be needed. Completes changes that were interrupted.
    ///
    /// # Errors
    /// Returns [`KeysError`] if the folder contains no authority, or if its files cannot be used.
    pub fn open(folder: &Path) -> Result<Self, KeysError> {
        Self::open_with(folder, no_passphrase)
    }

    /// Opens an existing authority. Completes changes that were interrupted. `ask` is called at most once for the passphrase of the key,
    /// when the key is needed.
    ///
    /// # Errors
    /// Returns [`KeysError`] if the folder contains no authority, or if its files cannot be used.
    pub fn open_with(folder: &Path, ask: Ask) -> Result<Self, KeysError> {
        if !folder.join(AUTHORITY_KEY).exists() {
            return Err(KeysError::NoAuthority(folder.into()));
        }
        files::check_private(folder, AUTHORITY_KEY)?;
        let own = Self::in_folder(folder, ask)?;
        own.complete_passphrase()?;
        own.complete(calendar())?;
        Ok(own)
    }

    fn in_folder(folder: &Path, ask: Ask) -> Result<Self, KeysError> {
        Ok(Self { folder: folder.into(), _lock: files::lock(folder)?, keys: Unlocked::new(ask) })
    }

    /// Whether the authority's key has a passphrase.
    ///
    /// # Errors
    /// Fails if the key cannot be read.
    pub fn has_passphrase(&self) -> Result<bool, KeysError> {
        Ok(passphrase::is_encrypted(&files::read(&self.path(AUTHORITY_KEY))?))
    }

    /// Gives the key a new passphrase, for which `new` is called after the present one has been verified. While the authority is replaced,
    /// both keys get it. Returns the paths of the keys.
    ///
    /// # Errors
    /// Returns [`KeysError`]. If the process is interrupted, [`Authority::open`] completes the change.
    pub fn set_passphrase(
        &self,
        new: impl FnOnce(&Path) -> Result<Passphrase, PassphraseError>,
    ) -> Result<Vec<PathBuf>, KeysError> {
        self.unlock()?;
        self.change_passphrase(Some(new(&self.path(AUTHORITY_KEY))?))
    }

    /// Stores the key without a passphrase; while the authority is replaced, both keys. Returns their paths.
    ///
    /// # Errors
    /// Returns [`KeysError`]. If the process is interrupted, [`Authority::open`] completes the change.
    pub fn remove_passphrase(&self) -> Result<Vec<PathBuf>, KeysError> {
        self.change_passphrase(None)
    }

    fn change_passphrase(&self, passphrase: Option<Passphrase>) -> Result<Vec<PathBuf>, KeysError> {
        let files = self.key_files()?;
        let paths: Vec<PathBuf> = files.iter().map(|name| self.path(name)).collect();
        let keys = self.unlock()?;
        self.keys.protect_with(passphrase);
        match keys.as_slice() {
            [key] => self.write_key(AUTHORITY_KEY, key)?,
            keys => {
                // Two files cannot be replaced at once, and keys with different passphrases would be unusable.
                let stored = keys.iter().map(|key| self.keys.stored(key));
                let stored = stored.collect::<Result<Vec<_>, _>>()?;
                let text = Zeroizing::new(stored.iter().map(|key| key.as_str()).collect::<String>());
                files::write_private(&self.path(CHANGED_KEYS), &text)?;
                self.complete_passphrase()?;
            }
        }
        Ok(paths)
    }

    /// Completes a change of the passphrase of two keys that was interrupted.
    fn complete_passphrase(&self) -> Result<(), KeysError> {
        let changed = self.path(CHANGED_KEYS);
        if !changed.exists() {
            return Ok(());
        }
        files::check_private(&self.folder, CHANGED_KEYS)?;
        let text = Zeroizing::new(files::read(&changed)?);
        for (name, key) in self.key_files()?.iter().zip(text.split(PEM_BEGIN).skip(1)) {
            files::write_private(&self.path(name), &Zeroizing::new(format!("{PEM_BEGIN}{key}")))?;
        }
        files::delete(&changed).map(drop)
    }

    /// Writes a key, with the passphrase of the other keys, if they have one.
    fn write_key(&self, name: &str, key: &Zeroizing<String>) -> Result<(), KeysError> {
        files::write_private(&self.path(name), &self.keys.stored(key)?)
    }

    /// Returns all keys that sign, in PEM. Asks for their passphrase if that is necessary.
    fn unlock(&self) -> Result<Vec<Zeroizing<String>>, KeysError> {
        self.key_files()?.iter().map(|name| self.keys.read(&self.path(name))).collect()
    }

    /// Returns the record of the certificates that the authority has issued.
    ///
    /// # Errors
    /// Fails if the record cannot be read.
    pub fn issued(&self) -> Result<Issued, KeysError> {
        Issued::read(&self.folder)
    }

    /// Makes the keys and certificates of robots or of an operator, valid for `days` days from `now` (seconds since 1970, UTC). Returns
    /// the paths of the identity files.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if any of the names already has a key. Nothing is made in that case.
    pub fn issue(
        &self,
        names: &BTreeSet<Name>,
        roles: &Roles,
        now: i64,
        days: i64,
    ) -> Result<Vec<PathBuf>, KeysError> {
        let issued = self.issued()?;
        let has_key = |name: &&Name| issued.latest(name).is_some_and(|entry| entry.revoked.is_none());
        let taken: Vec<Name> = names.iter().filter(has_key).cloned().collect();
        if !taken.is_empty() {
            return Err(KeysError::Taken(taken));
        }
        names.iter().map(|name| self.write_identity(name, roles, now, days)).collect()
    }

    /// Makes a new key and certificate for a robot or operator, with the roles of its latest certificate. The old certificate remains
    /// valid until it expires or is revoked.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if the name has no key, or if its key is not in this folder.
    pub fn renew(&self, name: &Name, now: i64, days: i64) -> Result<PathBuf, KeysError> {
        let issued = self.issued()?;
        let known = issued.latest(name).ok_or_else(|| issued.unknown(name))?;
        if known.requested {
            return Err(KeysError::KeyElsewhere(name.clone()));
        }
        self.write_identity(name, &known.roles(), now, days)
    }

    /// Revokes all certificates of a name and writes the list of revoked certificates. For an operator, this also revokes the passes. For
    /// a robot, this also deletes the secret and the passes made from it. Returns the number of revoked keys.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if the name has no key, or only revoked ones.
    pub fn revoke(&self, name: &Name, now: i64) -> Result<usize, KeysError> {
        let mut issued = self.issued()?;
        let has_secret = match name {
            Name::Robot(robot) => self.robots_with_secret()?.contains(robot),
            Name::Operator(_) => false,
        };
        if issued.latest(name).is_none() && !has_secret {
            return Err(issued.unknown(name));
        }
        // Nothing is revoked in part because a passphrase is wrong.
        self.unlock()?;
        let secret = match name {
            Name::Robot(robot) => self.delete_secret(robot)?,
            Name::Operator(_) => 0,
        };
        let revoked = issued.revoke(name, now) + secret;
        if revoked == 0 {
            return Err(KeysError::RevokedAlready(name.clone()));
        }
        self.write_revocation(&issued, now)?;
        Ok(revoked)
    }

    /// Returns the certificate whose serial number begins with these digits, and its owner.
    ///
    /// # Errors
    /// Returns [`KeysError`] if no certificate or several have such a serial number.
    pub fn with_serial(&self, serial: &str) -> Result<(Name, Entry), KeysError> {
        let issued = self.issued()?;
        let digits = serial.to_ascii_lowercase();
        let found = issued.entries().iter().filter(|entry| entry.serial.starts_with(&digits));
        let mut found = found.filter_map(|entry| Some((entry.owner()?, entry.clone())));
        match (found.next(), found.next()) {
            (Some(found), None) => Ok(found),
            (None, _) => Err(KeysError::NoSerial(serial.to_owned())),
            (Some(_), Some(_)) => Err(KeysError::AmbiguousSerial(serial.to_owned())),
        }
    }

    /// Revokes one certificate, and for an operator the passes with the same number. Writes the lists of revoked keys.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if the certificate is already revoked.
    pub fn revoke_certificate(&self, owner: &Name, certificate: &Entry, now: i64) -> Result<(), KeysError> {
        let mut issued = self.issued()?;
        if !issued.revoke_serial(&certificate.serial, now) {
            return Err(KeysError::RevokedAlready(owner.clone()));
        }
        self.write_revocation(&issued, now)
    }

    /// Writes the record of a revocation, and what follows from it.
    fn write_revocation(&self, issued: &Issued, now: i64) -> Result<(), KeysError> {
        // The list that robots read is written first. If the record were first, a failure could leave a revocation that robots do not
        // know.
        self.write_revoked(issued, now)?;
        issued.write(&self.folder)?;
        self.write_passes(issued)
    }

    /// Returns the path of the list of revoked certificates.
    #[must_use]
    pub fn revoked(&self) -> PathBuf {
        self.path(REVOKED)
    }

    /// Returns the path of the list of revoked passes.
    #[must_use]
    pub fn revoked_serials(&self) -> PathBuf {
        self.path(REVOKED_SERIALS)
    }

    /// Makes new lists of revoked keys if the current ones are older than half of the time after which the next ones are due.
    ///
    /// # Errors
    /// Returns [`KeysError`].
    pub fn renew_lists(&self, now: i64) -> Result<(), KeysError> {
        let made = i64::try_from(self.list_number()).unwrap_or(i64::MAX);
        if now.saturating_sub(made) > LIST_DAYS * DAY / 2 {
            self.write_revoked(&self.issued()?, now)
        } else {
            Ok(())
        }
    }

    /// Returns the text of the list of revoked keys that this robot accepts from `downbeat keys push`.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if the robot has no secret but should.
    pub fn list_for(&self, robot: &RobotId, protection: Protection) -> Result<String, KeysError> {
        match protection {
            Protection::Open | Protection::Tls => files::read(&self.revoked()),
            Protection::Hmac => {
                let known = self.robots_with_secret()?;
                if !known.contains(robot) {
                    let known: Vec<&str> = known.iter().map(RobotId::as_str).collect();
                    return Err(KeysError::unknown(&Name::Robot(robot.clone()), &known));
                }
                let secret = Secret::read(&files::secret_path(&self.folder, robot))?;
                Ok(secret.proven_list(&files::read(&self.revoked_serials())?))
            }
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Reads a key and its certificate, which can sign certificates and lists.
    fn signer(&self, key: &str, certificate: &str) -> Result<Signer, KeysError> {
        let (key_path, path) = (self.path(key), self.path(certificate));
        let damaged = |path: &Path, error: String| KeysError::Damaged {
            path: path.into(),
            what: format!("invalid authority key or certificate: {error}"),
        };
        let key = KeyPair::from_pem(&self.keys.read(&key_path)?)
            .map_err(|error| damaged(&key_path, error.to_string()))?;
        let pem = files::read(&path)?;
        let issuer =
            Issuer::from_ca_cert_pem(&pem, key).map_err(|error| damaged(&path, error.to_string()))?;
        let authority = tls::Authority::of_pem(&pem).map_err(|error| damaged(&path, error.to_string()))?;
        Ok(Signer { issuer, authority, pem })
    }

    fn write_identity(&self, name: &Name, roles: &Roles, now: i64, days: i64) -> Result<PathBuf, KeysError> {
        let key = KeyPair::generate()?;
        let certified = self.certify(name, roles, &key, now, days)?;
        let path = files::identity_path(&self.folder, name);
        path.parent().map(files::make_private_folder).transpose()?;
        // The record is written first, because a certificate that is not in the record cannot be revoked.
        let mut issued = self.issued()?;
        issued.add(&certified.identity, now);
        issued.write(&self.folder)?;
        let Certified { certificate, authorities, .. } = certified;
        files::write_private(&path, &format!("{}{certificate}{authorities}", key.serialize_pem()))?;
        self.write_passes(&issued)?;
        Ok(path)
    }

    /// Makes a certificate for a public key. The caller has to record it.
    fn certify(
        &self,
        name: &Name,
        roles: &Roles,
        key: &impl PublicKeyData,
        now: i64,
        days: i64,
    ) -> Result<Certified, KeysError> {
        let (signer, old) = (self.current()?, self.old_certificate()?);
        let mut params = profile(name, roles)?;
        set_validity(&mut params, now, days)?;
        params.use_authority_key_identifier_extension = true;
        let certificate = params.signed_by(key, &signer.issuer)?;
        let identity = Identity::of_certificate(certificate.der())
            .map_err(|error| KeysError::Damaged { path: self.path(AUTHORITY), what: error.to_string() })?;
        let authorities = format!("{}{old}", signer.pem);
        Ok(Certified { certificate: certificate.pem(), identity, authorities })
    }

    /// Returns the number of the next list. Robots accept a list only if its number is larger than that of the list in use, so it is larger
    /// even if two lists are made within a second, or the clock was set back.
    fn next_number(&self, now: i64) -> u64 {
        u64::try_from(now).unwrap_or_default().max(self.list_number().saturating_add(1))
    }

    /// Returns the number of the current lists of revoked keys; 0 if it cannot be read.
    #[must_use]
    pub fn list_number(&self) -> u64 {
        let list = RevokedSerials::in_file(&self.revoked_serials()).and_then(|list| list.read());
        list.map_or(0, |list| list.number())
    }

    fn write_revoked(&self, issued: &Issued, now: i64) -> Result<(), KeysError> {
        let number = self.next_number(now);
        let mut text = self.lists_of_predecessors(issued, number, now)?;
        let signer = self.current()?;
        let revoked = issued.revoked_of(signer.authority.name()).collect();
        text += &signer.list(revoked, number, now, now + LIST_DAYS * DAY)?;
        files::write_public(&self.path(REVOKED), &text)?;
        self.write_revoked_serials(issued, number)
    }
}

/// A key that signs certificates and lists, with the certificate of its authority.
struct Signer {
    issuer: Issuer<'static, KeyPair>,
    authority: tls::Authority,
    /// The certificate in PEM.
    pem: String,
}

impl Signer {
    /// Makes a list of revoked certificates, in PEM. `revoked` contains serial numbers with the times of revocation; all times are in
    /// seconds since 1970, UTC.
    fn list(
        &self,
        revoked: Vec<(Vec<u8>, i64)>,
        number: u64,
        now: i64,
        next_update: i64,
    ) -> Result<String, KeysError> {
        let revoked = revoked.into_iter().map(|(serial, at)| {
            Ok::<_, KeysError>(RevokedCertParams {
                serial_number: SerialNumber::from(serial),
                revocation_time: instant(at)?,
                reason_code: None,
                invalidity_date: None,
            })
        });
        let list = CertificateRevocationListParams {
            this_update: instant(now - BACKDATED)?,
            next_update: instant(next_update)?,
            crl_number: SerialNumber::from(number),
            issuing_distribution_point: None,
            revoked_certs: revoked.collect::<Result<_, _>>()?,
            key_identifier_method: KeyIdMethod::Sha256,
        };
        Ok(list.signed_by(&self.issuer)?.pem()?)
    }
}

/// Returns the calendar time in seconds since 1970, UTC. This time determines whether certificates are valid.
#[must_use]
#[expect(clippy::disallowed_methods, reason = "certificates count by the calendar")]
pub fn calendar() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}

/// Returns the access control ([`Door`]) of a robot whose keys are in the authority's folder.
///
/// # Errors
/// Returns the reason as a sentence if the robot has no usable key in that folder.
pub fn door_of(folder: &Path, robot: &RobotId, protection: Protection) -> Result<Door, String> {
    match protection {
        Protection::Open => Ok(Door::Open),
        Protection::Tls => {
            let path = files::identity_path(folder, &Name::Robot(robot.clone()));
            let own = Credentials::read(&path).map_err(|error| error.to_string())?;
            let revoked = Revoked::in_file(&folder.join(REVOKED)).map_err(|error| error.to_string())?;
            Ok(Door::Tls(Arc::new(tls::Guard::new(own, Some(revoked))?)))
        }
        Protection::Hmac => {
            let secret =
                Secret::read(&files::secret_path(folder, robot)).map_err(|error| error.to_string())?;
            let revoked = RevokedSerials::in_file(&folder.join(REVOKED_SERIALS));
            let revoked = revoked.map_err(|error| error.to_string())?;
            let guard = sealed::Guard::new(robot.clone(), secret, Some(&revoked));
            Ok(Door::Sealed(Arc::new(guard.map_err(|error| error.to_string())?)))
        }
    }
}

/// Returns the certificate of a new authority with this key.
fn authority_params(key: &KeyPair, now: i64) -> Result<CertificateParams, KeysError> {
    // The name contains a mark from the key, to distinguish this authority from others.
    let mark: String = key.public_key_raw().iter().rev().take(4).map(|byte| format!("{byte:02x}")).collect();
    let mut params = named(&format!("Downbeat authority {mark}"))?;
    set_validity(&mut params, now, AUTHORITY_DAYS)?;
    // An authority may introduce its successor, which issues certificates in turn.
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(1));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    Ok(params)
}

/// A new certificate, and the authority that has signed it.
struct Certified {
    /// The certificate, in PEM.
    certificate: String,
    identity: Identity,
    /// The certificate of the authority, and while it is replaced that of the old one, in PEM.
    authorities: String,
}

/// Maximum length of an operator's name in characters. A robot's id has the same limit.
const OPERATOR_NAME_MAX: usize = 256;

/// Checks that a text can be the name of an operator.
///
/// # Errors
/// Returns the expected form as a sentence if it cannot.
pub fn check_operator_name(text: &str) -> Result<(), String> {
    let length = text.chars().count();
    if text.trim().is_empty() || length > OPERATOR_NAME_MAX || text.chars().any(char::is_control) {
        return Err(format!("expected a name of 1 to {OPERATOR_NAME_MAX} characters, without line breaks"));
    }
    Ok(())
}

fn named(common_name: &str) -> Result<CertificateParams, KeysError> {
    let mut params = CertificateParams::new(Vec::new())?;
    params.distinguished_name = DistinguishedName::new();
    let common_name: String = common_name.chars().take(COMMON_NAME_MAX).collect();
    params.distinguished_name.push(DnType::CommonName, common_name);
    Ok(params)
}

/// Returns the contents of a robot's or operator's certificate, without its validity.
fn profile(name: &Name, roles: &Roles) -> Result<CertificateParams, KeysError> {
    let mut params = named(&name.to_string())?;
    for uri in Identity::uris(name, roles) {
        params.subject_alt_names.push(SanType::URI(uri.try_into()?));
    }
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = match name {
        Name::Robot(_) => {
            params.subject_alt_names.push(SanType::DnsName(SERVER_NAME.try_into()?));
            vec![ExtendedKeyUsagePurpose::ServerAuth]
        }
        Name::Operator(_) => vec![ExtendedKeyUsagePurpose::ClientAuth],
    };
    Ok(params)
}

fn set_validity(params: &mut CertificateParams, now: i64, days: i64) -> Result<(), KeysError> {
    params.not_before = instant(now - BACKDATED)?;
    params.not_after = instant(now + days * DAY)?;
    Ok(())
}

fn instant(seconds: i64) -> Result<OffsetDateTime, KeysError> {
    OffsetDateTime::from_unix_timestamp(seconds).map_err(|_| KeysError::Signing(rcgen::Error::Time))
}
