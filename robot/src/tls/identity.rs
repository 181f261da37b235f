//! The identity and the roles that a certificate contains.
//!
//! Both are URIs among the certificate's alternative names (RFC 5280, section 4.2.1.6): one `urrcp:robot:ID` or `urrcp:operator:NAME`,
//! and for an operator one `urrcp:role:ROLE` for each role. Ids and names are percent-encoded (RFC 3986), so any text of the protocol has
//! exactly one form in a certificate.

use std::fmt;

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};
use urrcp::{Label, RobotId};
use x509_parser::extensions::GeneralName;
use x509_parser::prelude::{FromDer, X509Certificate};

use urrcp::{Proof, Role, Roles};

/// All characters that are percent-encoded. The unreserved characters of RFC 3986 are not.
const ENCODED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');

/// The name that a certificate contains.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Name {
    /// Id of a robot.
    Robot(RobotId),
    /// Name of a person, or of a program that acts for a person.
    Operator(String),
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Robot(id) => write!(f, "robot {id}"),
            Self::Operator(name) => write!(f, "operator {name}"),
        }
    }
}

/// Reason why a certificate contains no valid identity.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IdentityError {
    /// The bytes are not a certificate.
    #[error("not an X.509 certificate")]
    NotACertificate,
    /// The number of URIs that name a robot or an operator is not 1. Contains this number.
    #[error(
        "the certificate has {0} names that begin with `urrcp:robot:` or `urrcp:operator:`, expected one"
    )]
    Names(usize),
    /// A URI of this protocol in the certificate cannot be read. Contains the URI.
    #[error("the certificate contains the invalid name `{0}`")]
    Unreadable(String),
}

/// The identity that a certificate contains.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Name of the certificate's owner.
    pub name: Name,
    /// Roles of the certificate's owner; robots have none.
    pub roles: Roles,
    /// Time after which the certificate is invalid, in seconds since 1970 in UTC.
    pub expires: i64,
    /// Serial number of the certificate, in hexadecimal digits.
    pub serial: String,
    /// Name of the authority that issued the certificate.
    pub authority: String,
}

impl Identity {
    /// Reads the identity from a certificate in DER. TLS verifies separately that the certificate is genuine.
    ///
    /// # Errors
    /// [`IdentityError`].
    pub fn of_certificate(der: &[u8]) -> Result<Self, IdentityError> {
        let (_, certificate) = X509Certificate::from_der(der).map_err(|_| IdentityError::NotACertificate)?;
        let names = certificate.subject_alternative_name().map_err(|_| IdentityError::NotACertificate)?;
        let names = names.map(|names| names.value.general_names.as_slice()).unwrap_or_default();
        let uris = names.iter().filter_map(|name| match name {
            GeneralName::URI(uri) => Some(*uri),
            _ => None,
        });
        let (name, roles) = Self::named(uris)?;
        let expires = certificate.validity().not_after.timestamp();
        let authority = certificate.issuer().to_string();
        Ok(Self { name, roles, expires, serial: certificate.raw_serial_as_string(), authority })
    }

    /// Reads the name and the roles from the URIs of a certificate, or of a request for one.
    ///
    /// # Errors
    /// [`IdentityError`].
    pub fn named<'a>(uris: impl IntoIterator<Item = &'a str>) -> Result<(Name, Roles), IdentityError> {
        let (mut named, mut roles) = (Vec::new(), Vec::new());
        for uri in uris.into_iter().filter_map(|uri| uri.strip_prefix("urrcp:")) {
            match Self::part(uri).ok_or_else(|| IdentityError::Unreadable(format!("urrcp:{uri}")))? {
                Part::Name(name) => named.push(name),
                Part::Role(role) => roles.push(role),
            }
        }
        let count = named.len();
        let name = named.pop().filter(|_| count == 1).ok_or(IdentityError::Names(count))?;
        let roles =
            if matches!(name, Name::Robot(_)) { Roles::default() } else { roles.into_iter().collect() };
        Ok((name, roles))
    }

    fn part(uri: &str) -> Option<Part> {
        let (kind, text) = uri.split_once(':')?;
        let text = percent_decode_str(text).decode_utf8().ok()?;
        match kind {
            "robot" => Some(Part::Name(Name::Robot(text.parse().ok()?))),
            "operator" => Some(Part::Name(Name::Operator(text.into_owned()))),
            "role" => Some(Part::Role(text.parse().ok()?)),
            _ => None,
        }
    }

    /// Returns the identity as a proof, the form in which links to robots use it. `None` if the name is too long for the protocol.
    #[must_use]
    pub fn proof(&self) -> Option<Proof> {
        let name = Label::new(self.name.to_string()).ok()?;
        Some(Proof { name, roles: self.roles.clone(), serial: Some(Label::new(&self.serial).ok()?) })
    }

    /// Returns the URIs that represent a name and roles in a certificate.
    #[must_use]
    pub fn uris(name: &Name, roles: &Roles) -> Vec<String> {
        let encoded = |text: &str| utf8_percent_encode(text, ENCODED).to_string();
        let name = match name {
            Name::Robot(id) => format!("urrcp:robot:{}", encoded(id.as_str())),
            Name::Operator(name) => format!("urrcp:operator:{}", encoded(name)),
        };
        std::iter::once(name).chain(roles.iter().map(|role| format!("urrcp:role:{role}"))).collect()
    }
}

enum Part {
    Name(Name),
    Role(Role),
}
