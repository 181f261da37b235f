//! Fingerprints of public keys, which people compare by telephone.

use std::fmt;
use std::str::FromStr;

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use sha2::{Digest, Sha256};
use x509_parser::prelude::{FromDer, X509Certificate};

/// The SHA-256 of a public key in DER (`SubjectPublicKeyInfo`), in hexadecimal digits with colons.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fingerprint(String);

impl Fingerprint {
    /// Returns the fingerprints of the public keys of certificates in PEM. `None` if one of them is damaged.
    pub(super) fn of_certificates(pem: &str) -> Option<Vec<Self>> {
        let of = |der: Result<CertificateDer<'static>, _>| {
            let der = der.ok()?;
            let (_, certificate) = X509Certificate::from_der(&der).ok()?;
            Some(Self::of(certificate.public_key().raw))
        };
        CertificateDer::pem_slice_iter(pem.as_bytes()).map(of).collect()
    }

    pub(super) fn of(public_key: &[u8]) -> Self {
        let bytes: Vec<String> =
            Sha256::digest(public_key).iter().map(|byte| format!("{byte:02x}")).collect();
        Self(bytes.join(":"))
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for Fingerprint {
    type Err = String;

    /// Accepts upper case, and digits with or without colons and spaces.
    fn from_str(text: &str) -> Result<Self, String> {
        let digits: Vec<char> =
            text.chars().filter(|c| !matches!(c, ':' | ' ')).map(|c| c.to_ascii_lowercase()).collect();
        if digits.len() != 64 || !digits.iter().all(char::is_ascii_hexdigit) {
            return Err(
                "expected the 64 hexadecimal digits of a SHA-256 fingerprint, such as `3f:a2:…`".into()
            );
        }
        let bytes: Vec<String> = digits.chunks(2).map(|byte| byte.iter().collect()).collect();
        Ok(Self(bytes.join(":")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fingerprint_is_read_in_each_usual_form_and_never_in_part() {
        let own = Fingerprint::of(b"a key");
        let text = own.to_string();
        let bare = text.replace(':', "");
        for form in [&text, &text.to_uppercase(), &bare, &text.replace(':', " ")] {
            assert_eq!(form.parse::<Fingerprint>().as_ref(), Ok(&own), "{form}");
        }
        for wrong in ["", &text[..94], &format!("{text}:00"), &bare.replace(&bare[..1], "g")] {
            assert!(wrong.parse::<Fingerprint>().is_err(), "{wrong}");
        }
    }
}
