//! The claim: a statement about an operator, which the operator proves with a pass (a secret key).

use std::fmt;
use std::str::FromStr;

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};
use urrcp::{Label, RobotId};

use urrcp::{Proof, Roles};

/// The characters that are percent-encoded in a name: all except the unreserved characters of RFC 3986. An encoded name therefore
/// contains no space and no line end.
const ENCODED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');

pub(super) fn encoded(name: &str) -> String {
    utf8_percent_encode(name, ENCODED).to_string()
}

/// Decodes a percent-encoded name. Each name has only one valid encoding. `None` if the text is not the valid encoding of any name.
pub(super) fn decoded(text: &str) -> Option<String> {
    let name = percent_decode_str(text).decode_utf8().ok()?.into_owned();
    (!name.is_empty() && encoded(&name) == text).then_some(name)
}

pub(super) fn robot_id(text: &str) -> Option<RobotId> {
    decoded(text)?.parse().ok()
}

/// What an operator claims to be. Its text form is `operator NAME ROLES EXPIRES SERIAL`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    /// The operator's name.
    pub name: String,
    /// The operator's roles.
    pub roles: Roles,
    /// Time after which the claim is invalid, in seconds since 1970 in UTC.
    pub expires: i64,
    /// Serial number of the operator's certificate, used for revocation. It consists of hexadecimal digits and colons.
    pub serial: String,
}

/// Error for a text that is not a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("invalid claim, expected `operator NAME ROLES EXPIRES SERIAL`")]
pub struct NoClaim;

impl Claim {
    /// Returns the operator's identity in the form that links use. `None` if the name or the serial number is too long for the protocol.
    #[must_use]
    pub fn proof(&self) -> Option<Proof> {
        let name = Label::new(format!("operator {}", self.name)).ok()?;
        Some(Proof { name, roles: self.roles.clone(), serial: Some(Label::new(&self.serial).ok()?) })
    }
}

impl fmt::Display for Claim {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let roles: Vec<&str> = self.roles.iter().map(|role| role.as_str()).collect();
        let roles = if roles.is_empty() { "-".to_owned() } else { roles.join(",") };
        write!(f, "operator {} {roles} {} {}", encoded(&self.name), self.expires, self.serial)
    }
}

impl FromStr for Claim {
    type Err = NoClaim;

    /// Parses a claim in exactly the form that `Display` writes. Any other form is an error.
    fn from_str(text: &str) -> Result<Self, NoClaim> {
        let words: Vec<&str> = text.split(' ').collect();
        let ["operator", name, roles, expires, serial] = words.as_slice() else { return Err(NoClaim) };
        let roles = match *roles {
            "-" => Ok(Roles::default()),
            roles => roles.split(',').map(|role| role.parse().map_err(|_| NoClaim)).collect(),
        };
        let is_serial = |byte: u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f' | b':');
        let claim = Self {
            name: decoded(name).ok_or(NoClaim)?,
            roles: roles?,
            expires: expires.parse().map_err(|_| NoClaim)?,
            serial: (*serial).to_owned(),
        };
        let counts = !serial.is_empty() && serial.bytes().all(is_serial) && claim.to_string() == text;
        if counts { Ok(claim) } else { Err(NoClaim) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use urrcp::Role;

    #[test]
    fn claim_has_exactly_one_text_form() {
        let text = "operator anna%20%C3%B6 observe,drive 1795450000 0a:1b";
        let claim: Claim = text.parse().unwrap();
        assert_eq!(claim.name, "anna ö");
        assert!(claim.roles.has(Role::Drive) && !claim.roles.has(Role::Stop));
        assert_eq!(claim.to_string(), text);
        assert_eq!("operator a - 0 1".parse::<Claim>().unwrap().roles, Roles::default());
        for wrong in [
            "",
            "operator anna observe 1",
            "operator anna observe 1 2 3",
            "operator  observe 1 2",
            "operator anna  1 2",
            "operator anna king 1 2",
            "operator anna drive,observe 1 2",
            "operator anna observe,observe 1 2",
            "operator anna observe +1 2",
            "operator anna observe 01 2",
            "operator anna observe 1 ",
            "operator anna observe 1 2\n",
            "operator anna observe 1 AB",
            "operator an%6ea observe 1 2",
            "operator an%c3%b6 observe 1 2",
            "operator an/na observe 1 2",
            "operator %FF observe 1 2",
            "robot anna observe 1 2",
        ] {
            assert_eq!(wrong.parse::<Claim>(), Err(NoClaim), "{wrong:?}");
        }
    }
}
