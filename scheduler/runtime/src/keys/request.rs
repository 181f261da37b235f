//! Keys that are made where they are used. The owner of a key makes a request for a certificate (PKCS#10), the authority signs it, and the
//! owner joins the certificate and the key to an identity file. The private key never leaves the owner's machine.

use std::path::{Path, PathBuf};

use downbeat_key_file::{read_private, read_regular};
use downbeat_robot::Roles;
use downbeat_robot::sealed::Passes;
use downbeat_robot::tls::{Identity, IdentityError, Name};
use rcgen::{KeyPair, PKCS_ECDSA_P256_SHA256, PublicKeyData, SubjectPublicKeyInfo};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, CertificateSigningRequestDer, PrivateKeyDer};
use x509_parser::certification_request::X509CertificationRequest;
use x509_parser::extensions::{GeneralName, ParsedExtension};
use x509_parser::prelude::{FromDer, X509Certificate};

use super::{AUTHORITY, Authority, Fingerprint, KeysError, check_operator_name, files, profile};

/// Maximum size of a request or a certificate file in bytes. Those of `downbeat keys` take less than two thousand.
const BYTES_MAX: u64 = 32 * 1024;

/// Why a request for a certificate, or the certificate itself, is not used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RequestError {
    /// The file contains no request.
    #[error(
        "this is not a request for a certificate; expected a file that `downbeat keys request` wrote (PKCS#10 in PEM)"
    )]
    NotARequest,
    /// The request was not signed by its own key.
    #[error(
        "the signature of the request does not match, so it was damaged or changed; make a new one with `downbeat keys request`"
    )]
    Signature,
    /// The key of the request is of another kind.
    #[error(
        "the request has a key of another kind; expected an ECDSA key on the curve P-256, as `downbeat keys request` makes"
    )]
    OtherKey,
    /// The request contains no valid name of a robot or an operator.
    #[error(
        "the request names no robot or operator: {0}; expected a file that `downbeat keys request` wrote"
    )]
    Nameless(String),
    /// The fingerprint is not the expected one.
    #[error(
        "the key has the fingerprint {found}, expected {expected}: this is another key, or the digits were misheard"
    )]
    OtherFingerprint {
        /// The fingerprint of the key in the file.
        found: Fingerprint,
        /// The fingerprint that the user stated.
        expected: Fingerprint,
    },
    /// The certificate file trusts a second authority whose fingerprint the user did not state.
    #[error(
        "this file also trusts an old authority, whose key has the fingerprint {0}; if `downbeat keys sign` printed this fingerprint too, add it as a second --fingerprint; otherwise, someone has changed the file"
    )]
    UnexpectedAuthority(Fingerprint),
    /// No roles were granted to an operator. Contains the operator and the roles in the request.
    #[error("{name} asks for {wished}; only you can grant roles: add --role, such as `--role observe`")]
    NoRoles {
        /// The operator.
        name: Name,
        /// The roles in the request, as text.
        wished: String,
    },
    /// The name already has a valid certificate.
    #[error(
        "{0} already has a certificate; if the request renews it, add --renew, which leaves the old one valid until it expires or is revoked"
    )]
    Certified(Name),
    /// The file does not contain a certificate and that of its authority.
    #[error(
        "this is not a certificate that `downbeat keys sign` wrote; expected a certificate, followed by that of the authority that signed it"
    )]
    NotACertificate,
    /// The certificate file also contains a private key.
    #[error("this file contains a private key; expected only certificates, as `downbeat keys sign` writes")]
    ContainsKey,
    /// The certificate is that of another key.
    #[error("this certificate does not belong to the key in {}; expected the certificate for the request that was made with this key", .0.display())]
    CertificateOfOtherKey(PathBuf),
    /// The file contains no usable private key.
    #[error("missing private key; expected a file that `downbeat keys request` wrote")]
    NoKey,
}

/// The files of a new key.
#[derive(Debug)]
pub struct Requested {
    /// The path of the private key.
    pub key: PathBuf,
    /// The path of the request.
    pub request: PathBuf,
    /// The fingerprint of the public key.
    pub fingerprint: Fingerprint,
}

/// Makes a key in `folder`, and a request for its certificate. `wished` are roles that the authority may grant.
///
/// # Errors
/// Returns [`KeysError`], also if one of the files exists. Nothing is made in that case.
pub fn request(folder: &Path, name: &Name, wished: &Roles) -> Result<Requested, KeysError> {
    let path = |extension: &str| folder.join(format!("{}.{extension}", files::name_of(name)));
    let (key_path, request_path) = (path("pem"), path("csr"));
    for path in [&key_path, &request_path] {
        files::check_new(path)?;
    }
    let key = KeyPair::generate()?;
    let request = profile(name, wished)?.serialize_request(&key)?.pem()?;
    files::write_new(&key_path, &key.serialize_pem(), 0o600)?;
    if let Err(error) = files::write_new(&request_path, &request, 0o644) {
        files::delete(&key_path)?;
        return Err(error);
    }
    let fingerprint = Fingerprint::of(&key.subject_public_key_info());
    Ok(Requested { key: key_path, request: request_path, fingerprint })
}

/// A request for a certificate, signed by the key that it contains.
#[derive(Debug)]
pub struct Request {
    path: PathBuf,
    name: Name,
    wished: Roles,
    key: SubjectPublicKeyInfo,
}

impl Request {
    /// Reads a request and verifies its signature.
    ///
    /// # Errors
    /// Returns [`KeysError::Request`] if the file is no usable request.
    pub fn read(path: &Path) -> Result<Self, KeysError> {
        let text = read_regular(path, BYTES_MAX)?;
        Self::of_pem(path, &text).map_err(|error| error.at(path))
    }

    fn of_pem(path: &Path, text: &[u8]) -> Result<Self, RequestError> {
        let der =
            CertificateSigningRequestDer::from_pem_slice(text).map_err(|_| RequestError::NotARequest)?;
        let (rest, request) =
            X509CertificationRequest::from_der(&der).map_err(|_| RequestError::NotARequest)?;
        if !rest.is_empty() {
            return Err(RequestError::NotARequest);
        }
        let key = SubjectPublicKeyInfo::from_der(request.certification_request_info.subject_pki.raw)
            .map_err(|_| RequestError::OtherKey)?;
        if key.algorithm() != &PKCS_ECDSA_P256_SHA256 {
            return Err(RequestError::OtherKey);
        }
        request.verify_signature().map_err(|_| RequestError::Signature)?;
        let (name, wished) = Identity::named(uris(&request)).map_err(nameless)?;
        if let Name::Operator(operator) = &name {
            check_operator_name(operator).map_err(RequestError::Nameless)?;
        }
        Ok(Self { path: path.into(), name, wished, key })
    }

    /// The robot or operator that the request names.
    #[must_use]
    pub const fn name(&self) -> &Name {
        &self.name
    }

    /// The roles that the request asks for. They have no effect.
    #[must_use]
    pub const fn wished(&self) -> &Roles {
        &self.wished
    }

    /// The fingerprint of the public key.
    #[must_use]
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of(&self.key.subject_public_key_info())
    }

    /// Checks that the public key has this fingerprint.
    ///
    /// # Errors
    /// Returns [`RequestError::OtherFingerprint`] if it has another one.
    pub fn check_fingerprint(&self, expected: &Fingerprint) -> Result<(), KeysError> {
        compare(self.fingerprint(), expected).map_err(|error| error.at(&self.path))
    }

    fn check_roles(&self, granted: &Roles) -> Result<(), KeysError> {
        let grants_none = granted.iter().next().is_none();
        match &self.name {
            Name::Robot(_) if grants_none => Ok(()),
            Name::Robot(_) => Err(KeysError::RolesOfRobot),
            Name::Operator(_) if grants_none => {
                let error = RequestError::NoRoles { name: self.name.clone(), wished: self.wish() };
                Err(error.at(&self.path))
            }
            Name::Operator(_) => Ok(()),
        }
    }

    /// Returns the roles that the request asks for, as text.
    #[must_use]
    pub fn wish(&self) -> String {
        match self.wished.iter().count() {
            0 => "no roles".to_owned(),
            1 => format!("the role {}", self.wished),
            _ => format!("the roles {}", self.wished),
        }
    }
}

fn uris<'a>(request: &'a X509CertificationRequest<'_>) -> Vec<&'a str> {
    let extensions = request.requested_extensions().into_iter().flatten();
    let names = extensions.filter_map(|extension| match extension {
        ParsedExtension::SubjectAlternativeName(names) => Some(&names.general_names),
        _ => None,
    });
    let uris = names.flatten().filter_map(|name| match name {
        GeneralName::URI(uri) => Some(*uri),
        _ => None,
    });
    uris.collect()
}

fn nameless(error: IdentityError) -> RequestError {
    RequestError::Nameless(match error {
        IdentityError::Names(count) => {
            format!("it has {count} names that begin with `urrcp:robot:` or `urrcp:operator:`, expected one")
        }
        IdentityError::Unreadable(name) => {
            format!("it contains the invalid name `{}`", downbeat_scripts::shown::shortened(&name))
        }
        IdentityError::NotACertificate => "it cannot be read".to_owned(),
    })
}

fn compare(found: Fingerprint, expected: &Fingerprint) -> Result<(), RequestError> {
    if found == *expected {
        return Ok(());
    }
    Err(RequestError::OtherFingerprint { found, expected: expected.clone() })
}

impl RequestError {
    fn at(self, path: &Path) -> KeysError {
        KeysError::Request { path: path.into(), error: self }
    }
}

/// What a certificate for a request grants.
#[derive(Debug)]
pub struct Terms {
    /// The operator's roles. Empty for a robot.
    pub roles: Roles,
    /// When the certificate is issued, in seconds since 1970, UTC.
    pub from: i64,
    /// The number of days for which the certificate is valid.
    pub days: i64,
    /// Whether the name may already have a valid certificate.
    pub is_renewal: bool,
}

/// A signed certificate.
#[derive(Debug)]
pub struct Signed {
    /// The path of the certificate, followed by the authority's.
    pub certificate: PathBuf,
    /// The contents of the certificate.
    pub identity: Identity,
    /// The operator's passes for robots without TLS. `None` if there are none.
    pub passes: Option<PathBuf>,
    /// The fingerprint of the authority's public key, and while the authority is replaced that of the old one.
    pub authorities: Vec<Fingerprint>,
}

impl Authority {
    /// Signs a request, and writes the certificate into `folder`.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if the certificate's file exists. Nothing is signed in that case.
    pub fn sign(&self, request: &Request, terms: &Terms, folder: &Path) -> Result<Signed, KeysError> {
        let Terms { roles, from, days, is_renewal } = terms;
        request.check_roles(roles)?;
        let (name, mut issued) = (&request.name, self.issued()?);
        match issued.latest(name) {
            None if *is_renewal => return Err(issued.unknown(name)),
            Some(entry) if !is_renewal && entry.revoked.is_none() => {
                return Err(RequestError::Certified(name.clone()).at(&request.path));
            }
            _ => {}
        }
        let path = folder.join(format!("{}.crt", files::name_of(name)));
        files::check_new(&path)?;
        let certified = self.certify(name, roles, &request.key, *from, *days)?;
        let authorities = Fingerprint::of_certificates(&certified.authorities).ok_or_else(|| {
            let what = "it contains a damaged certificate".to_owned();
            KeysError::Damaged { path: self.path(AUTHORITY), what }
        })?;
        // The folder of the passes, which are next to the keys that the authority has made itself.
        files::identity_path(&self.folder, name).parent().map(files::make_private_folder).transpose()?;
        // The record is written first, because a certificate that is not in the record cannot be revoked.
        issued.add_requested(&certified.identity, *from);
        issued.write(&self.folder)?;
        files::write_new(&path, &format!("{}{}", certified.certificate, certified.authorities), 0o644)?;
        self.write_passes(&issued)?;
        let passes = Passes::next_to(&files::identity_path(&self.folder, name));
        let passes = Some(passes).filter(|path| matches!(name, Name::Operator(_)) && path.exists());
        Ok(Signed { certificate: path, identity: certified.identity, passes, authorities })
    }
}

/// An identity file that is complete.
#[derive(Debug)]
pub struct Installed {
    /// The path of the identity file.
    pub file: PathBuf,
    /// The contents of the certificate.
    pub identity: Identity,
    /// The fingerprints of the public keys of the authorities, which the identity file trusts. The first one signed the certificate.
    pub authorities: Vec<Fingerprint>,
}

/// Adds a certificate to the file with its private key, which makes it an identity file. `authorities` are the expected fingerprints of
/// the authorities' keys; empty if all are accepted.
///
/// # Errors
/// Returns [`KeysError`], also if the certificate is that of another key. The file is unchanged in that case.
pub fn install(certificate: &Path, key: &Path, authorities: &[Fingerprint]) -> Result<Installed, KeysError> {
    let text = read_regular(certificate, BYTES_MAX)?;
    let found = Certified::of_pem(&text, authorities).map_err(|error| error.at(certificate))?;
    let own = String::from_utf8(read_private(key)?).ok().and_then(|text| KeyPair::from_pem(&text).ok());
    let own = own.ok_or_else(|| RequestError::NoKey.at(key))?;
    if own.subject_public_key_info() != found.public_key {
        return Err(RequestError::CertificateOfOtherKey(key.into()).at(certificate));
    }
    let text = String::from_utf8_lossy(&text);
    files::write_private(key, &format!("{}{text}", own.serialize_pem()))?;
    Ok(Installed { file: key.into(), identity: found.identity, authorities: found.authorities })
}

/// The contents of a certificate file.
struct Certified {
    identity: Identity,
    public_key: Vec<u8>,
    authorities: Vec<Fingerprint>,
}

impl Certified {
    fn of_pem(text: &[u8], expected: &[Fingerprint]) -> Result<Self, RequestError> {
        if PrivateKeyDer::from_pem_slice(text).is_ok() {
            return Err(RequestError::ContainsKey);
        }
        let damaged = || RequestError::NotACertificate;
        let certificates: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(text).collect();
        let certificates = certificates.map_err(|_| damaged())?;
        let parsed = certificates.iter().map(|der| X509Certificate::from_der(der).map(|(_, found)| found));
        let parsed = parsed.collect::<Result<Vec<_>, _>>().map_err(|_| damaged())?;
        let ([own, issuer] | [own, issuer, _]) = parsed.as_slice() else { return Err(damaged()) };
        let identity = Identity::of_certificate(&certificates[0])
            .map_err(|error| RequestError::Nameless(error.to_string()))?;
        own.verify_signature(Some(issuer.public_key())).map_err(|_| damaged())?;
        if parsed.get(2).is_some_and(|old| !may_be_replaced(old, issuer)) {
            return Err(damaged());
        }
        let of = |authority: &X509Certificate<'_>| Fingerprint::of(authority.public_key().raw);
        let authorities: Vec<Fingerprint> = parsed[1..].iter().map(of).collect();
        check_authorities(&authorities, expected)?;
        Ok(Self { identity, public_key: own.public_key().raw.to_vec(), authorities })
    }
}

/// Whether `old` can be an authority that `new` replaces. It must not have signed the certificate of `new`: in that case, it would be the
/// root of an intermediate authority.
fn may_be_replaced(old: &X509Certificate<'_>, new: &X509Certificate<'_>) -> bool {
    old.is_ca() && new.verify_signature(Some(old.public_key())).is_err()
}

fn check_authorities(found: &[Fingerprint], expected: &[Fingerprint]) -> Result<(), RequestError> {
    let Some(first) = expected.first() else { return Ok(()) };
    let unexpected = found.iter().position(|authority| !expected.contains(authority));
    match unexpected.and_then(|index| Some((index, found.get(index)?.clone()))) {
        None => Ok(()),
        Some((0, found)) => Err(RequestError::OtherFingerprint { found, expected: first.clone() }),
        Some((_, found)) => Err(RequestError::UnexpectedAuthority(found)),
    }
}
