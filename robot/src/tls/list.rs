//! Lists of revoked certificates (RFC 5280, section 5), one for each authority of a site.
//!
//! While an authority is replaced, a file contains its list, the certificate by which it introduces its successor, and the successor's
//! list. An authority ends when its list contains its own certificate: none of its certificates is accepted afterwards.

use std::collections::BTreeSet;
use std::path::Path;

use downbeat_key_file::Versioned;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, CertificateRevocationListDer};
use x509_parser::prelude::{CertificateRevocationList, FromDer};

use super::authority::Authority;
use super::credentials::CredentialsError;

/// The lists of all authorities that a robot or an operator trusts.
#[derive(Clone, Debug)]
pub struct List {
    parts: Vec<Part>,
    /// The authorities whose certificates are accepted.
    accepted: Vec<Authority>,
    /// Names of the authorities that have introduced a successor.
    replaced: BTreeSet<String>,
}

/// The list of one authority.
#[derive(Clone, Debug)]
struct Part {
    /// Name of the authority.
    authority: String,
    der: CertificateRevocationListDer<'static>,
    /// Serial numbers of the revoked certificates, in hexadecimal digits with colons.
    serials: BTreeSet<String>,
    /// Number of the list, as big-endian bytes without leading zeros. A newer list has a larger number.
    number: Vec<u8>,
    /// When the authority signed the list, in seconds since 1970, UTC.
    issued: i64,
    /// When the authority intends to sign the next list, in seconds since 1970, UTC. `None` if the list does not state this.
    next_update: Option<i64>,
    has_ended: bool,
}

/// Reason why a list excludes a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exclusion {
    /// The certificate was revoked.
    Revoked,
    /// The authority that issued the certificate has ended, or the list does not contain it.
    AuthorityEnded,
}

impl Part {
    /// Reads the list of one of the `trusted` authorities. `None` if it names another authority as its issuer.
    fn of(
        der: CertificateRevocationListDer<'static>,
        path: &Path,
        trusted: &[Authority],
    ) -> Result<Option<Self>, CredentialsError> {
        let no_list = || CredentialsError::NoList { path: path.into() };
        let (_, list) = CertificateRevocationList::from_der(&der).map_err(|_| no_list())?;
        let Some(authority) = trusted.iter().find(|authority| authority.has_signed_list(&list)) else {
            let is_forged = trusted.iter().any(|authority| authority.is_named_by(&list));
            let other = CredentialsError::OtherAuthority { path: path.into() };
            return if is_forged { Err(other) } else { Ok(None) };
        };
        let revoked = list.iter_revoked_certificates();
        let serials: BTreeSet<String> = revoked.map(|entry| entry.raw_serial_as_string()).collect();
        Ok(Some(Self {
            authority: authority.name().to_owned(),
            has_ended: serials.contains(authority.serial()),
            serials,
            number: list.crl_number().map(|number| number.to_bytes_be()).unwrap_or_default(),
            issued: list.last_update().timestamp(),
            next_update: list.next_update().map(|at| at.timestamp()),
            der: der.clone(),
        }))
    }

    /// Returns a value that is larger for a newer list of the same authority.
    fn order(&self) -> (usize, &[u8]) {
        (self.number.len(), &self.number)
    }

    /// Whether this list was made before the other one of the same authority. The end of an authority is final.
    fn is_older_than(&self, other: &Self) -> bool {
        self.order() < other.order() || other.has_ended && !self.has_ended
    }

    /// Returns the number of the list; `None` if it does not fit into 64 bits.
    fn number(&self) -> Option<u64> {
        (self.number.len() <= 8)
            .then(|| self.number.iter().fold(0, |number, byte| number << 8 | u64::from(*byte)))
    }
}

impl List {
    /// Reads the text of a file. Errors name `path` as the file. `authorities` are those of an identity file.
    pub(super) fn of_pem(
        text: &[u8],
        path: &Path,
        authorities: &[Authority],
    ) -> Result<Self, CredentialsError> {
        let unusable = |what| CredentialsError::Unusable { path: path.into(), what };
        let known = Known::of_pem(text, authorities).map_err(unusable)?;
        let mut parts: Vec<Part> = Vec::new();
        for der in ders(text, path)? {
            let Some(part) = Part::of(der, path, &known.trusted)? else { continue };
            if parts.iter().any(|other| other.authority == part.authority) {
                return Err(unusable("it contains two lists of the same authority"));
            }
            parts.push(part);
        }
        let has_list = |authority: &&Authority| parts.iter().any(|part| part.authority == authority.name());
        if !authorities.first().is_some_and(|own| has_list(&own)) {
            return Err(CredentialsError::OtherAuthority { path: path.into() });
        }
        if !known.trusted.iter().skip(authorities.len()).all(|introduced| has_list(&introduced)) {
            return Err(unusable("it contains a new authority without a list of this authority"));
        }
        let list = Self { parts, accepted: known.trusted, replaced: known.replaced }.without_ended();
        if list.accepted.is_empty() {
            return Err(unusable("it ends every authority"));
        }
        Ok(list)
    }

    /// Removes the authorities that have ended, or have no list, from those whose certificates are accepted.
    fn without_ended(mut self) -> Self {
        let parts = &self.parts;
        let counts = |authority: &Authority| {
            parts.iter().any(|part| part.authority == authority.name() && !part.has_ended)
        };
        self.accepted.retain(counts);
        self
    }

    /// Returns the authorities whose certificates are accepted.
    pub(super) fn accepted(&self) -> &[Authority] {
        &self.accepted
    }

    /// Returns the list of each authority in DER.
    pub(super) fn ders(&self) -> impl Iterator<Item = CertificateRevocationListDer<'static>> + '_ {
        self.parts.iter().map(|part| part.der.clone())
    }

    /// Returns the reason why the certificate with this serial number is not accepted, although it has not expired. `authority` is the
    /// name of its issuer. `None` if it is accepted.
    #[must_use]
    pub fn exclusion(&self, authority: &str, serial: &str) -> Option<Exclusion> {
        match self.parts.iter().find(|part| part.authority == authority) {
            Some(part) if part.has_ended => Some(Exclusion::AuthorityEnded),
            Some(part) => part.serials.contains(serial).then_some(Exclusion::Revoked),
            None => Some(Exclusion::AuthorityEnded),
        }
    }

    /// Whether another authority replaces the one with this name.
    #[must_use]
    pub fn replaces(&self, authority: &str) -> bool {
        self.replaced.contains(authority)
    }

    fn in_force(&self) -> impl Iterator<Item = &Part> {
        self.parts.iter().filter(|part| !part.has_ended)
    }

    /// Returns the number of the oldest list that is in force; `None` if it does not fit into 64 bits. `downbeat keys` gives the same
    /// number to the lists of all authorities that have not ended. A newer list has a larger number.
    #[must_use]
    pub fn number(&self) -> Option<u64> {
        self.in_force().min_by_key(|part| part.order()).and_then(Part::number)
    }

    /// Returns the time at which the newest list was signed, in seconds since 1970, UTC.
    #[must_use]
    pub fn issued(&self) -> i64 {
        self.in_force().map(|part| part.issued).max().unwrap_or_default()
    }

    /// Whether an authority should have signed a newer list before `now` (in seconds since 1970, UTC).
    #[must_use]
    pub fn is_overdue(&self, now: i64) -> bool {
        self.in_force().any(|part| part.next_update.is_some_and(|at| at < now))
    }
}

impl Versioned for List {
    fn number(&self) -> Option<u64> {
        Self::number(self)
    }

    /// A list is older if it is older for one authority. It may omit only authorities that have ended.
    fn is_older_than(&self, other: &Self) -> bool {
        let part = |authority: &str| self.parts.iter().find(|part| part.authority == authority);
        other.parts.iter().any(|theirs| match part(&theirs.authority) {
            Some(own) => own.is_older_than(theirs),
            None => !theirs.has_ended,
        })
    }

    /// Remembers which authorities have ended, so that a later list cannot restore them.
    fn after(mut self, previous: &Self) -> Self {
        let has_part = |part: &&Part| self.parts.iter().any(|own| own.authority == part.authority);
        let ended = previous.parts.iter().filter(|part| part.has_ended);
        let omitted: Vec<Part> = ended.filter(|part| !has_part(part)).cloned().collect();
        self.parts.extend(omitted);
        self
    }
}

/// The authorities that are known to the owner of an identity file.
struct Known {
    /// Those of the identity file, then those that they have introduced.
    trusted: Vec<Authority>,
    replaced: BTreeSet<String>,
}

impl Known {
    /// Adds to `authorities` those that the certificates in the text introduce. Each of these certificates must be signed by an authority
    /// that is already trusted, unless its owner is trusted itself.
    fn of_pem(text: &[u8], authorities: &[Authority]) -> Result<Self, &'static str> {
        let mut known = Self { trusted: authorities.to_vec(), replaced: BTreeSet::new() };
        for certificate in CertificateDer::pem_slice_iter(text) {
            let introduced = certificate.ok().and_then(|der| Authority::of_certificate(der).ok());
            known.add(introduced.ok_or("it contains a damaged certificate")?)?;
        }
        Ok(known)
    }

    fn add(&mut self, introduced: Authority) -> Result<(), &'static str> {
        let is_trusted = self.trusted.iter().any(|authority| authority.is(&introduced));
        let signer = self.trusted.iter().find(|authority| authority.has_signed(&introduced));
        if !is_trusted {
            if signer.is_none() {
                return Err("it contains a new authority that no trusted authority has signed");
            }
            if !introduced.may_issue() {
                return Err(
                    "it contains a new authority whose certificate is not that of an authority (CA:TRUE)",
                );
            }
            if introduced.expires() < super::calendar() {
                return Err("it contains a new authority whose certificate has expired");
            }
        }
        self.replaced
            .extend(signer.filter(|signer| !signer.is(&introduced)).map(|signer| signer.name().to_owned()));
        if !is_trusted {
            self.trusted.push(introduced);
        }
        Ok(())
    }
}

/// Returns all lists in a text in PEM. Errors name `path` as its file.
pub(super) fn ders(
    text: &[u8],
    path: &Path,
) -> Result<Vec<CertificateRevocationListDer<'static>>, CredentialsError> {
    let lists: Result<Vec<_>, _> = CertificateRevocationListDer::pem_slice_iter(text).collect();
    lists.ok().filter(|lists| !lists.is_empty()).ok_or_else(|| CredentialsError::NoList { path: path.into() })
}
