//! A statement that an operator signs where there is no TLS, as on a socket of this machine, and the check of who did.

use std::sync::{Arc, Mutex, PoisonError};

use rustls::SignatureScheme;
use rustls::pki_types::{CertificateDer, UnixTime};
use rustls::server::danger::ClientCertVerifier;
use x509_parser::prelude::{FromDer, X509Certificate};

use super::config::{client_verifier, provider};
use super::credentials::Credentials;
use super::identity::{Identity, Name};
use super::revoked::Revoked;

/// ECDSA on P-256 with SHA-256, as all keys of `downbeat keys` have it.
const SCHEME: SignatureScheme = SignatureScheme::ECDSA_NISTP256_SHA256;

/// Who has signed a statement, and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signed {
    /// The certificate of the one who signed, in DER.
    pub certificate: Vec<u8>,
    /// The signature, in the form that X.509 gives it (ASN.1).
    pub signature: Vec<u8>,
}

impl Credentials {
    /// Signs a statement.
    ///
    /// # Errors
    /// The key is of another kind, as a sentence.
    pub fn sign(&self, statement: &[u8]) -> Result<Signed, String> {
        let key = provider().key_provider.load_private_key(self.key.clone_key());
        let key = key.map_err(|error| error.to_string())?;
        let signer = key.choose_scheme(&[SCHEME]).ok_or("the key is of another kind than ECDSA P-256")?;
        let signature = signer.sign(statement).map_err(|error| error.to_string())?;
        Ok(Signed { certificate: self.certificate.to_vec(), signature })
    }
}

/// Knows whose statements count: those of operators of one authority.
#[derive(Debug)]
pub struct Witness {
    own: Credentials,
    revoked: Option<Revoked>,
    /// The last that could be made: a list that cannot be read any more keeps nobody from a stop.
    verifier: Mutex<Arc<dyn ClientCertVerifier>>,
}

impl Witness {
    /// Of the authority of this identity, and with its list of revoked certificates.
    ///
    /// # Errors
    /// The files cannot be used, as a sentence.
    pub fn new(own: Credentials, revoked: Option<Revoked>) -> Result<Self, String> {
        let verifier = Mutex::new(client_verifier(&own, revoked.as_ref())?);
        Ok(Self { own, revoked, verifier })
    }

    /// With the list as it is now, or as it was when it could be read last.
    fn verifier(&self) -> Arc<dyn ClientCertVerifier> {
        let mut last = self.verifier.lock().unwrap_or_else(PoisonError::into_inner);
        match client_verifier(&self.own, self.revoked.as_ref()) {
            Ok(verifier) => *last = verifier,
            Err(error) => {
                tracing::warn!("the list of revoked certificates counts as it was read last: {error}")
            }
        }
        Arc::clone(&last)
    }

    /// Whose authority it is.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        self.own.identity()
    }

    /// Who has signed this statement. The list of revoked certificates counts as it is now, or was when it could be read last.
    ///
    /// # Errors
    /// Why the statement is nobody's, as a sentence.
    pub fn who(&self, statement: &[u8], signed: &Signed) -> Result<Identity, String> {
        let certificate = CertificateDer::from(signed.certificate.as_slice());
        self.verifier()
            .verify_client_cert(&certificate, &[], UnixTime::now())
            .map_err(|error| format!("its certificate does not count here: {error}"))?;
        let (_, parsed) = X509Certificate::from_der(&certificate)
            .map_err(|_| "its certificate cannot be read".to_owned())?;
        let algorithms = provider().signature_verification_algorithms.mapping;
        let key = &parsed.public_key().subject_public_key.data;
        let of_scheme = algorithms.iter().filter(|(scheme, _)| *scheme == SCHEME).flat_map(|(_, all)| *all);
        let right = of_scheme
            .into_iter()
            .any(|algorithm| algorithm.verify_signature(key, statement, &signed.signature).is_ok());
        if !right {
            return Err("it has not signed what it says".to_owned());
        }
        let identity = Identity::of_certificate(&certificate).map_err(|error| error.to_string())?;
        match identity.name {
            Name::Operator(_) => Ok(identity),
            Name::Robot(_) => Err(format!("{} is no operator", identity.name)),
        }
    }
}
