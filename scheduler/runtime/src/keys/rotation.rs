//! Replaces the authority of a site while the site is in use.
//!
//! [`Authority::rotate`] makes a successor. The old authority signs the successor's certificate, and `revoked.pem` contains this
//! certificate and the lists of both authorities, so each robot and operator that gets the file trusts both. [`Authority::end`] makes the
//! final list of the old authority, which contains the authority's own certificate.
//!
//! The files decide how far the replacement has progressed, so that a process can be killed between any two writes:
//!
//! | stage | `successor.pem` | `ended.pem` contains `cross.pem` |
//! |---|---|---|
//! | the folder has one authority | no | |
//! | the authority is being replaced | yes | no |
//! | the old authority has ended, and the successor's files have yet to replace its files | yes | yes |
//!
//! [`Authority::open`] completes the remaining writes of a stage.

use std::path::PathBuf;

use downbeat_robot::tls::{self, Name, Revoked};
use pkcs8::der::zeroize::Zeroizing;
use rcgen::KeyPair;

use super::{
    AUTHORITY, AUTHORITY_KEY, Authority, Entry, Issued, KeysError, REVOKED, Signer, authority_params, files,
};

/// The key of the new authority, while it replaces the old one.
const SUCCESSOR_KEY: &str = "successor.key";
/// The certificate of the new authority. While this file exists, the new authority issues all certificates.
const SUCCESSOR: &str = "successor.pem";
/// The certificate by which the old authority introduces the new one.
const CROSS: &str = "cross.pem";
/// The final list of the previous authority, and the certificate by which it introduced its successor.
const ENDED: &str = "ended.pem";

/// What to do if names have only a certificate of the authority that ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Refuse to end the authority.
    IfRenewed,
    /// Shut these names out.
    Always,
}

/// The authority that issued a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Issuing {
    /// The authority that issues certificates at present.
    Current,
    /// The authority that is being replaced.
    Old,
    /// An authority that has ended.
    Ended,
}

/// The names of the authorities in a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Authorities {
    /// The authority that issues certificates.
    pub current: String,
    /// The authority that is being replaced. `None` if no replacement is in progress.
    pub old: Option<String>,
}

impl Authorities {
    /// Returns which authority has this name. A certificate without one is of the first authority of a folder that has only this one.
    #[must_use]
    pub fn issuing(&self, name: Option<&str>) -> Issuing {
        match name {
            None => Issuing::Current,
            Some(name) if name == self.current => Issuing::Current,
            Some(name) if self.old.as_deref() == Some(name) => Issuing::Old,
            Some(_) => Issuing::Ended,
        }
    }
}

/// What [`Authority::renew_all`] has done.
#[derive(Debug)]
pub struct Renewed {
    /// The names with a new key, and the paths of their identity files.
    pub made: Vec<(Name, PathBuf)>,
    /// The names whose keys are not in the folder. They have to request new certificates.
    pub requested: Vec<Name>,
}

/// How far the replacement of an authority has progressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Single,
    Rotating,
    Ended,
}

impl Authority {
    /// Begins to replace the authority. `now` is in seconds since 1970, UTC.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if the authority is already being replaced.
    pub fn rotate(&self, now: i64) -> Result<(), KeysError> {
        if self.stage()? != Stage::Single {
            return Err(KeysError::Rotating(self.folder.clone()));
        }
        let old = self.signer(AUTHORITY_KEY, AUTHORITY)?;
        let mut issued = self.issued()?;
        if issued.attribute(old.authority.name()) {
            issued.write(&self.folder)?;
        }
        let key = KeyPair::generate()?;
        let params = authority_params(&key, now)?;
        // Both certificates have the same serial number, which rcgen derives from the key.
        let cross = params.signed_by(&key, &old.issuer)?;
        self.write_key(SUCCESSOR_KEY, &Zeroizing::new(key.serialize_pem()))?;
        files::write_public(&self.path(CROSS), &cross.pem())?;
        files::write_public(&self.path(SUCCESSOR), &params.self_signed(&key)?.pem())?;
        self.complete(now)
    }

    /// Ends the authority that is being replaced: its certificates become invalid, and its key is deleted. `now` is in seconds since 1970,
    /// UTC.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if the authority is not being replaced, or if names have only one of its certificates.
    pub fn end(&self, end: End, now: i64) -> Result<(), KeysError> {
        if self.stage()? != Stage::Rotating {
            return Err(KeysError::NotRotating(self.folder.clone()));
        }
        let left = self.not_renewed(now)?;
        if end == End::IfRenewed && !left.is_empty() {
            return Err(KeysError::NotRenewed(left));
        }
        let old = self.signer(AUTHORITY_KEY, AUTHORITY)?;
        let list = self.final_list(&old, now)?;
        files::write_public(&self.path(ENDED), &format!("{list}{}", files::read(&self.path(CROSS))?))?;
        self.complete(now)
    }

    /// Makes the final list of an authority. It contains the revoked certificates too, for robots that check only certificates of peers.
    fn final_list(&self, old: &Signer, now: i64) -> Result<String, KeysError> {
        let serial = old.authority.serial().split(':').map(|byte| u8::from_str_radix(byte, 16));
        let serial = serial
            .collect::<Result<Vec<u8>, _>>()
            .map_err(|error| KeysError::Damaged { path: self.path(AUTHORITY), what: error.to_string() })?;
        let issued = self.issued()?;
        let revoked = issued.revoked_of(old.authority.name()).chain([(serial, now)]).collect();
        // There is no next list, so this one must not become overdue while the authority's certificate is valid.
        let next_update = old.authority.expires().max(now);
        old.list(revoked, self.list_number().saturating_add(1), now, next_update)
    }

    /// Returns the names of the authorities in the folder.
    ///
    /// # Errors
    /// Returns [`KeysError`] if their certificates cannot be read.
    pub fn authorities(&self) -> Result<Authorities, KeysError> {
        let name = |file| {
            let path = self.path(file);
            let authority = tls::Authority::of_pem(&files::read(&path)?);
            let authority = authority
                .map_err(|error| KeysError::Damaged { path: path.clone(), what: error.to_string() })?;
            Ok::<_, KeysError>(authority.name().to_owned())
        };
        Ok(match self.stage()? {
            Stage::Single => Authorities { current: name(AUTHORITY)?, old: None },
            Stage::Rotating => Authorities { current: name(SUCCESSOR)?, old: Some(name(AUTHORITY)?) },
            Stage::Ended => Authorities { current: name(SUCCESSOR)?, old: None },
        })
    }

    /// Returns the robots and operators that have a valid certificate, but none of the current authority. `now` is in seconds since 1970,
    /// UTC.
    ///
    /// # Errors
    /// Returns [`KeysError`].
    pub fn not_renewed(&self, now: i64) -> Result<Vec<Name>, KeysError> {
        let (issued, authorities) = (self.issued()?, self.authorities()?);
        let is_current = |entry: &Entry| authorities.issuing(entry.authority.as_deref()) == Issuing::Current;
        let left = issued.valid(now).into_iter().filter(|(_, entry)| !is_current(entry));
        Ok(left.map(|(name, _)| name).collect())
    }

    /// Makes a key of the current authority for each name that [`Authority::not_renewed`] returns, except for names whose keys were
    /// requested.
    ///
    /// # Errors
    /// Returns [`KeysError`]. If the process is interrupted, a second call continues.
    pub fn renew_all(&self, now: i64, days: i64) -> Result<Renewed, KeysError> {
        let issued = self.issued()?;
        let is_requested = |name: &Name| issued.latest(name).is_some_and(|entry| entry.requested);
        let (requested, own): (Vec<Name>, Vec<Name>) =
            self.not_renewed(now)?.into_iter().partition(is_requested);
        let renew = |name: Name| {
            let path = self.renew(&name, now, days)?;
            Ok((name, path))
        };
        Ok(Renewed { made: own.into_iter().map(renew).collect::<Result<_, KeysError>>()?, requested })
    }

    /// Returns the names of the files of all keys that sign lists.
    pub(super) fn key_files(&self) -> Result<&'static [&'static str], KeysError> {
        Ok(match self.stage()? {
            Stage::Single => &[AUTHORITY_KEY],
            Stage::Rotating | Stage::Ended => &[AUTHORITY_KEY, SUCCESSOR_KEY],
        })
    }

    /// Returns the authority that issues certificates.
    pub(super) fn current(&self) -> Result<Signer, KeysError> {
        match self.stage()? {
            Stage::Single => self.signer(AUTHORITY_KEY, AUTHORITY),
            Stage::Rotating | Stage::Ended => self.signer(SUCCESSOR_KEY, SUCCESSOR),
        }
    }

    /// Returns the certificate of the authority that is being replaced, in PEM. Empty if no replacement is in progress.
    pub(super) fn old_certificate(&self) -> Result<String, KeysError> {
        match self.stage()? {
            Stage::Rotating => files::read(&self.path(AUTHORITY)),
            Stage::Single | Stage::Ended => Ok(String::new()),
        }
    }

    /// Returns the lists of authorities other than the current one, and the certificates that introduce their successors, in PEM.
    pub(super) fn lists_of_predecessors(
        &self,
        issued: &Issued,
        number: u64,
        now: i64,
    ) -> Result<String, KeysError> {
        let ended = self.ended()?;
        if self.stage()? != Stage::Rotating {
            return Ok(ended);
        }
        let old = self.signer(AUTHORITY_KEY, AUTHORITY)?;
        let revoked = issued.revoked_of(old.authority.name()).collect();
        let list = old.list(revoked, number, now, now + super::LIST_DAYS * super::DAY)?;
        Ok(format!("{ended}{list}{}", files::read(&self.path(CROSS))?))
    }

    /// Completes changes that were interrupted. `now` is in seconds since 1970, UTC.
    pub(super) fn complete(&self, now: i64) -> Result<(), KeysError> {
        let stage = self.stage()?;
        if stage != Stage::Single {
            files::check_private(&self.folder, SUCCESSOR_KEY)?;
        }
        if !self.has_latest_lists(stage)? {
            self.write_revoked(&self.issued()?, now)?;
        }
        match stage {
            Stage::Rotating => Ok(()),
            Stage::Ended => {
                files::write_public(&self.path(AUTHORITY), &files::read(&self.path(SUCCESSOR))?)?;
                files::write_private(&self.path(AUTHORITY_KEY), &files::read(&self.path(SUCCESSOR_KEY))?)?;
                files::delete(&self.path(SUCCESSOR))?;
                self.delete_copies()
            }
            Stage::Single => self.delete_copies(),
        }
    }

    /// Deletes the files of a successor that has become the authority. Keeps a key that is not that of the authority.
    fn delete_copies(&self) -> Result<(), KeysError> {
        let (copy, key) = (self.path(SUCCESSOR_KEY), self.path(AUTHORITY_KEY));
        if copy.exists() && files::read(&copy)? == files::read(&key)? {
            files::delete(&self.path(CROSS))?;
            files::delete(&copy)?;
        }
        Ok(())
    }

    /// Whether the lists of revoked certificates and of revoked passes were written together, and contain all authorities.
    fn has_latest_lists(&self, stage: Stage) -> Result<bool, KeysError> {
        let Ok(list) = Revoked::in_file(&self.path(REVOKED)) else { return Ok(false) };
        let numbered = list.unverified_number() == Some(self.list_number());
        let required = match stage {
            Stage::Single => return Ok(numbered),
            Stage::Rotating => files::read(&self.path(CROSS))?,
            Stage::Ended => self.ended()?,
        };
        Ok(numbered && files::read(&self.path(REVOKED))?.contains(&required))
    }

    fn ended(&self) -> Result<String, KeysError> {
        let path = self.path(ENDED);
        if path.exists() { files::read(&path) } else { Ok(String::new()) }
    }

    fn stage(&self) -> Result<Stage, KeysError> {
        if !self.path(SUCCESSOR).exists() {
            return Ok(Stage::Single);
        }
        let has_ended = self.ended()?.contains(&files::read(&self.path(CROSS))?);
        Ok(if has_ended { Stage::Ended } else { Stage::Rotating })
    }
}
