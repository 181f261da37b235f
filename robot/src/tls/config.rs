//! The TLS configuration of robots and operators: only version 1.3, and only connections whose peer has a certificate that a trusted
//! authority issued.

use std::sync::Arc;

use rustls::client::WebPkiServerVerifier;
use rustls::crypto::CryptoProvider;
use rustls::pki_types::CertificateRevocationListDer;
use rustls::server::WebPkiClientVerifier;
use rustls::server::danger::ClientCertVerifier;
use rustls::version::TLS13;
use rustls::{ClientConfig, RootCertStore, ServerConfig};

use super::credentials::Credentials;
use super::list::List;

/// DNS name in the certificate of every robot. A client requests this name, which marks the certificate as that of a robot. A URI in the
/// certificate identifies the robot, because ids need not be DNS names. `.invalid` is no real domain (RFC 2606).
pub const SERVER_NAME: &str = "robot.urrcp.invalid";

pub(super) fn provider() -> Arc<CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}

/// Returns the authorities whose certificates are accepted. Without a list of revoked certificates, these are all authorities of the
/// identity file; with a list, those that have a list of their own and have not ended.
fn roots(own: &Credentials, revoked: Option<&List>) -> Result<Arc<RootCertStore>, rustls::Error> {
    let mut roots = RootCertStore::empty();
    let trusted = revoked.map_or(own.authorities.as_slice(), List::accepted);
    trusted.iter().try_for_each(|authority| roots.add(authority.der.clone()))?;
    Ok(Arc::new(roots))
}

fn lists(revoked: Option<&List>) -> impl Iterator<Item = CertificateRevocationListDer<'static>> + '_ {
    revoked.into_iter().flat_map(List::ders)
}

/// Returns a verifier that accepts operators whose certificate was issued by a trusted authority and is not revoked.
pub(super) fn client_verifier(
    own: &Credentials,
    revoked: Option<&List>,
) -> Result<Arc<dyn ClientCertVerifier>, String> {
    let roots = roots(own, revoked).map_err(|error| error.to_string())?;
    let mut verifier = WebPkiClientVerifier::builder_with_provider(roots, provider());
    if revoked.is_some() {
        verifier = verifier.with_crls(lists(revoked)).only_check_end_entity_revocation();
    }
    verifier.build().map_err(|error| error.to_string())
}

/// Returns the TLS configuration that a robot uses to accept operators of the authorities that it trusts.
///
/// # Errors
/// The key does not belong to the certificate, or the content of the files cannot be used.
pub fn server_config(own: &Credentials, revoked: Option<&List>) -> Result<ServerConfig, String> {
    let of_tls = |error: rustls::Error| error.to_string();
    let verifier = client_verifier(own, revoked)?;
    let mut config = ServerConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&TLS13])
        .map_err(of_tls)?
        .with_client_cert_verifier(verifier)
        .with_single_cert(vec![own.certificate.clone()], own.key.clone_key())
        .map_err(of_tls)?;
    // A resumed session would not check the list of revoked certificates again.
    config.send_tls13_tickets = 0;
    Ok(config)
}

/// Returns the TLS configuration that an operator uses to connect to robots of the authorities that it trusts.
///
/// # Errors
/// Those of [`server_config`].
pub fn client_config(own: &Credentials, revoked: Option<&List>) -> Result<ClientConfig, String> {
    let of_tls = |error: rustls::Error| error.to_string();
    let roots = roots(own, revoked).map_err(of_tls)?;
    let mut verifier = WebPkiServerVerifier::builder_with_provider(roots, provider());
    if revoked.is_some() {
        verifier = verifier.with_crls(lists(revoked)).only_check_end_entity_revocation();
    }
    let verifier = verifier.build().map_err(|error| error.to_string())?;
    let mut config = ClientConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&TLS13])
        .map_err(of_tls)?
        .with_webpki_verifier(verifier)
        .with_client_auth_cert(vec![own.certificate.clone()], own.key.clone_key())
        .map_err(of_tls)?;
    config.resumption = rustls::client::Resumption::disabled();
    Ok(config)
}
