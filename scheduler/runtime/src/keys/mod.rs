//! The certificate authority of a site: a folder that contains a key, and issues the keys of robots and operators.
//!
//! Only the owner has access to the folder. It contains `authority.key`, `authority.pem`, the list of revoked certificates `revoked.pem`,
//! and a record of all issued certificates (`issued.rs`). It also contains an identity file for each robot and operator: the private key,
//! its certificate, and the authority's certificate. The contents of a certificate are defined in `downbeat_robot::tls`. For robots
//! without TLS, the folder contains secrets, and operators' passes made from them (`secrets.rs`). Keys that are made elsewhere are only
//! certified (`request.rs`). The authority's key may have a passphrase (`passphrase.rs`).

mod files;
mod fingerprint;
mod issued;
mod location;
mod passphrase;
mod request;
mod secrets;
#[cfg(test)]
mod tests;

use std::cell::OnceCell;
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
pub use secrets::IfThere;

const AUTHORITY_KEY: &str = "authority.key";
const AUTHORITY: &str = "authority.pem";
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
    /// Asks for the passphrase of the key, if it has one.
    ask: Ask,
    /// The authority's key, in PEM without a passphrase, once it was needed.
    key: OnceCell<Zeroizing<String>>,
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
        let own = Self::in_folder(folder)?;
        if own.path(AUTHORITY_KEY).exists() || own.path(AUTHORITY).exists() {
            return Err(KeysError::Exists(folder.into()));
        }
        files::keep_out_of_git(folder)?;
        let key = KeyPair::generate()?;
        // The name contains a mark from the key, to distinguish this authority from others.
        let mark: String =
            key.public_key_raw().iter().rev().take(4).map(|byte| format!("{byte:02x}")).collect();
        let mut of_authority = named(&format!("Downbeat authority {mark}"))?;
        set_validity(&mut of_authority, now, AUTHORITY_DAYS)?;
        of_authority.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        of_authority.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let certificate = of_authority.self_signed(&key)?;
        let (path, pem) = (own.path(AUTHORITY_KEY), Zeroizing::new(key.serialize_pem()));
        let passphrase = new_passphrase.map(|ask| ask(&path)).transpose()?;
        own.write_key(&pem, passphrase.as_ref())?;
        let _was_empty = own.key.set(pem);
        files::write_public(&own.path(AUTHORITY), &certificate.pem())?;
        own.write_revoked(&Issued::default(), now)?;
        Ok(own)
    }

    /// Opens an existing authority.
    ///
    /// # Errors
    /// Returns [`KeysError`] if the folder contains no authority, or if its files cannot be used.
    pub fn open(folder: &Path) -> Result<Self, KeysError> {
        if !folder.join(AUTHORITY_KEY).exists() {
            return Err(KeysError::NoAuthority(folder.into()));
        }
        files::check_private(folder, AUTHORITY_KEY)?;
        Self::in_folder(folder)
    }

    fn in_folder(folder: &Path) -> Result<Self, KeysError> {
        let ask: Ask = |path| Err(PassphraseError::Unknown(path.into()));
        Ok(Self { folder: folder.into(), _lock: files::lock(folder)?, ask, key: OnceCell::new() })
    }

    /// Returns the authority with a function that asks for the passphrase of its key. It is called at most once, when the key is needed.
    #[must_use]
    pub fn with_passphrase(self, ask: Ask) -> Self {
        Self { ask, ..self }
    }

    /// Whether the authority's key has a passphrase.
    ///
    /// # Errors
    /// Fails if the key cannot be read.
    pub fn has_passphrase(&self) -> Result<bool, KeysError> {
        Ok(passphrase::is_encrypted(&files::read(&self.path(AUTHORITY_KEY))?))
    }

    /// Gives the key a new passphrase, for which `new` is called after the present one has been verified. Returns the path of the key.
    ///
    /// # Errors
    /// Returns [`KeysError`]. The key is unchanged in that case.
    pub fn set_passphrase(
        &self,
        new: impl FnOnce(&Path) -> Result<Passphrase, PassphraseError>,
    ) -> Result<PathBuf, KeysError> {
        let (path, key) = (self.path(AUTHORITY_KEY), self.key()?);
        self.write_key(key, Some(&new(&path)?))?;
        Ok(path)
    }

    /// Stores the key without a passphrase. Returns its path.
    ///
    /// # Errors
    /// Returns [`KeysError`]. The key is unchanged in that case.
    pub fn remove_passphrase(&self) -> Result<PathBuf, KeysError> {
        self.write_key(self.key()?, None)?;
        Ok(self.path(AUTHORITY_KEY))
    }

    fn write_key(&self, pem: &str, passphrase: Option<&Passphrase>) -> Result<(), KeysError> {
        let path = self.path(AUTHORITY_KEY);
        match passphrase {
            Some(passphrase) => files::write_private(&path, &passphrase::encrypt(pem, passphrase)?),
            None => files::write_private(&path, pem),
        }
    }

    /// Returns the authority's key in PEM. Asks for its passphrase if that is necessary.
    fn key(&self) -> Result<&str, KeysError> {
        if let Some(key) = self.key.get() {
            return Ok(key);
        }
        let path = self.path(AUTHORITY_KEY);
        let text = Zeroizing::new(files::read(&path)?);
        let key = if passphrase::is_encrypted(&text) {
            passphrase::decrypt(&text, &(self.ask)(&path)?, &path)?
        } else {
            text
        };
        Ok(self.key.get_or_init(|| key))
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
        self.key()?;
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

    fn issuer(&self) -> Result<(Issuer<'static, KeyPair>, String), KeysError> {
        let (key_path, path) = (self.path(AUTHORITY_KEY), self.path(AUTHORITY));
        let damaged = |path: &Path, error: rcgen::Error| KeysError::Damaged {
            path: path.into(),
            what: format!("invalid authority key or certificate: {error}"),
        };
        let key = KeyPair::from_pem(self.key()?).map_err(|error| damaged(&key_path, error))?;
        let certificate = files::read(&path)?;
        let issuer = Issuer::from_ca_cert_pem(&certificate, key).map_err(|error| damaged(&path, error))?;
        Ok((issuer, certificate))
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
        let Certified { certificate, authority, .. } = certified;
        files::write_private(&path, &format!("{}{certificate}{authority}", key.serialize_pem()))?;
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
        let (issuer, authority) = self.issuer()?;
        let mut params = profile(name, roles)?;
        set_validity(&mut params, now, days)?;
        params.use_authority_key_identifier_extension = true;
        let certificate = params.signed_by(key, &issuer)?;
        let identity = Identity::of_certificate(certificate.der())
            .map_err(|error| KeysError::Damaged { path: self.path(AUTHORITY), what: error.to_string() })?;
        let issuer = Fingerprint::of(&issuer.key().subject_public_key_info());
        Ok(Certified { certificate: certificate.pem(), identity, authority, issuer })
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
        let (issuer, _) = self.issuer()?;
        let number = self.next_number(now);
        let revoked = |(serial, at): (Vec<u8>, i64)| {
            Ok::<_, KeysError>(RevokedCertParams {
                serial_number: SerialNumber::from(serial),
                revocation_time: instant(at)?,
                reason_code: None,
                invalidity_date: None,
            })
        };
        let list = CertificateRevocationListParams {
            this_update: instant(now - BACKDATED)?,
            next_update: instant(now + LIST_DAYS * DAY)?,
            crl_number: SerialNumber::from(number),
            issuing_distribution_point: None,
            revoked_certs: issued.revoked().map(revoked).collect::<Result<_, _>>()?,
            key_identifier_method: KeyIdMethod::Sha256,
        };
        files::write_public(&self.path(REVOKED), &list.signed_by(&issuer)?.pem()?)?;
        self.write_revoked_serials(issued, number)
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

/// A new certificate, and the authority that has signed it.
struct Certified {
    /// The certificate, in PEM.
    certificate: String,
    identity: Identity,
    /// The authority's certificate, in PEM.
    authority: String,
    /// The fingerprint of the authority's public key.
    issuer: Fingerprint,
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
