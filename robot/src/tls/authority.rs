//! The certificate of an authority, which issues the certificates of robots and operators, or the certificate by which one authority
//! introduces its successor.

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use x509_parser::prelude::{CertificateRevocationList, FromDer, X509Certificate};

use super::config::provider;
use super::identity::IdentityError;

/// An authority, as its certificate describes it.
#[derive(Clone, Debug)]
pub struct Authority {
    pub(super) der: CertificateDer<'static>,
    name: String,
    /// The name in DER.
    subject: Vec<u8>,
    /// The public key, without its algorithm.
    key: Vec<u8>,
    serial: String,
    expires: i64,
}

impl Authority {
    /// Reads the first certificate of a text in PEM.
    ///
    /// # Errors
    /// [`IdentityError::NotACertificate`].
    pub fn of_pem(text: &str) -> Result<Self, IdentityError> {
        let der = CertificateDer::from_pem_slice(text.as_bytes());
        Self::of_certificate(der.map_err(|_| IdentityError::NotACertificate)?)
    }

    pub(super) fn of_certificate(der: CertificateDer<'static>) -> Result<Self, IdentityError> {
        let (_, certificate) = X509Certificate::from_der(&der).map_err(|_| IdentityError::NotACertificate)?;
        let subject = certificate.subject();
        Ok(Self {
            name: subject.to_string(),
            subject: subject.as_raw().to_vec(),
            key: certificate.public_key().subject_public_key.data.to_vec(),
            serial: certificate.raw_serial_as_string(),
            expires: certificate.validity().not_after.timestamp(),
            der: der.clone(),
        })
    }

    /// Returns the authority's name, such as `CN=Downbeat authority 1a2b3c4d`. Certificates name their issuer in this form.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the serial number of the certificate, in hexadecimal digits with colons.
    #[must_use]
    pub fn serial(&self) -> &str {
        &self.serial
    }

    /// Returns the time after which the certificate is invalid, in seconds since 1970 in UTC.
    #[must_use]
    pub const fn expires(&self) -> i64 {
        self.expires
    }

    /// Whether both certificates describe the same authority: they have the same name and the same key.
    pub(super) fn is(&self, other: &Self) -> bool {
        (&self.subject, &self.key) == (&other.subject, &other.key)
    }

    /// Whether a list of revoked certificates names this authority as its issuer. The signature may still be wrong.
    pub(super) fn is_named_by(&self, list: &CertificateRevocationList<'_>) -> bool {
        list.issuer().as_raw() == self.subject
    }

    pub(super) fn has_signed_list(&self, list: &CertificateRevocationList<'_>) -> bool {
        self.is_named_by(list) && self.verifies(list.tbs_cert_list.as_ref(), &list.signature_value.data)
    }

    /// Whether this authority has signed the certificate of another one.
    pub(super) fn has_signed(&self, other: &Self) -> bool {
        X509Certificate::from_der(&other.der).is_ok_and(|(_, certificate)| {
            certificate.issuer().as_raw() == self.subject
                && self.verifies(certificate.tbs_certificate.as_ref(), &certificate.signature_value.data)
        })
    }

    /// Whether the certificate permits its owner to issue certificates (RFC 5280, sections 4.2.1.3 and 4.2.1.9).
    pub(super) fn may_issue(&self) -> bool {
        X509Certificate::from_der(&self.der).is_ok_and(|(_, certificate)| {
            let usage = certificate.key_usage();
            certificate.is_ca()
                && usage.is_ok_and(|usage| usage.is_none_or(|usage| usage.value.key_cert_sign()))
        })
    }

    fn verifies(&self, signed: &[u8], signature: &[u8]) -> bool {
        let algorithms = provider().signature_verification_algorithms.all;
        algorithms.iter().any(|algorithm| algorithm.verify_signature(&self.key, signed, signature).is_ok())
    }
}
