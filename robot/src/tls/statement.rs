//! Statements that an operator signs where TLS is not available, for example on a local socket, and the verification of their signatures.

use std::sync::Arc;

use rustls::SignatureScheme;
use rustls::pki_types::{CertificateDer, UnixTime};
use rustls::server::danger::ClientCertVerifier;
use x509_parser::prelude::{FromDer, X509Certificate};

use super::config::{client_verifier, provider};
use super::credentials::Credentials;
use super::identity::{Identity, Name};
use super::revoked::{CurrentList, Revoked};

/// Signature scheme of all keys that `downbeat keys` creates: ECDSA on P-256 with SHA-256.
const SCHEME: SignatureScheme = SignatureScheme::ECDSA_NISTP256_SHA256;

/// Signature of a statement, with the signer's certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signed {
    /// The signer's certificate, in DER.
    pub certificate: Vec<u8>,
    /// The signature, in the X.509 encoding (ASN.1).
    pub signature: Vec<u8>,
}

impl Credentials {
    /// Signs a statement with the private key.
    ///
    /// # Errors
    /// A sentence with the reason if the key is not an ECDSA P-256 key.
    pub fn sign(&self, statement: &[u8]) -> Result<Signed, String> {
        let key = provider().key_provider.load_private_key(self.key.clone_key());
        let key = key.map_err(|error| error.to_string())?;
        let signer = key.choose_scheme(&[SCHEME]).ok_or("the key is not an ECDSA P-256 key")?;
        let signature = signer.sign(statement).map_err(|error| error.to_string())?;
        Ok(Signed { certificate: self.certificate.to_vec(), signature })
    }
}

/// Verifies signed statements. A statement is valid if an authority that the witness trusts has certified its signer as an operator.
#[derive(Debug)]
pub struct Witness {
    own: Credentials,
    revoked: Option<CurrentList>,
}

impl Witness {
    /// Creates a witness that trusts the certificates that the authorities of `own` issued, and those of authorities that
    /// `revoked` introduces, except for revoked ones.
    ///
    /// # Errors
    /// A sentence with the reason why the files cannot be used.
    pub fn new(own: Credentials, revoked: Option<Revoked>) -> Result<Self, String> {
        let revoked = revoked.map(|revoked| CurrentList::new(&revoked, &own.authorities)).transpose()?;
        let own = Self { own, revoked };
        own.verifier()?;
        Ok(own)
    }

    fn verifier(&self) -> Result<Arc<dyn ClientCertVerifier>, String> {
        let list = self.revoked.as_ref().map(CurrentList::list);
        client_verifier(&self.own, list.as_deref())
    }

    /// Returns the witness's own identity. The witness trusts the authority that issued it.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        self.own.identity()
    }

    /// Returns the signer of a statement. The current list of revoked certificates applies or, if it cannot be read, the last list that
    /// could be read.
    ///
    /// # Errors
    /// A sentence with the reason why the statement is invalid.
    pub fn who(&self, statement: &[u8], signed: &Signed) -> Result<Identity, String> {
        let certificate = CertificateDer::from(signed.certificate.as_slice());
        self.verifier()?
            .verify_client_cert(&certificate, &[], UnixTime::now())
            .map_err(|error| format!("its certificate is not valid here: {error}"))?;
        let (_, parsed) = X509Certificate::from_der(&certificate)
            .map_err(|_| "its certificate cannot be read".to_owned())?;
        let algorithms = provider().signature_verification_algorithms.mapping;
        let key = &parsed.public_key().subject_public_key.data;
        let of_scheme = algorithms.iter().filter(|(scheme, _)| *scheme == SCHEME).flat_map(|(_, all)| *all);
        let right = of_scheme
            .into_iter()
            .any(|algorithm| algorithm.verify_signature(key, statement, &signed.signature).is_ok());
        if !right {
            return Err("its signature does not match".to_owned());
        }
        let identity = Identity::of_certificate(&certificate).map_err(|error| error.to_string())?;
        match identity.name {
            Name::Operator(_) => Ok(identity),
            Name::Robot(_) => Err(format!("{} is not an operator", identity.name)),
        }
    }
}
