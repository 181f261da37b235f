//! The door of a robot: who comes in has to prove who it is.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use rustls::ServerConfig;
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

use super::config::server_config;
use super::credentials::Credentials;
use super::identity::Identity;
use super::revoked::Revoked;
use urrcp::Proof;

/// What a robot proves itself with, and whom it lets in: operators with a certificate of its authority that is not revoked.
#[derive(Debug)]
pub struct Guard {
    own: Credentials,
    revoked: Option<Revoked>,
    /// Made from the list of revoked certificates that was written then.
    config: Mutex<(Option<SystemTime>, Arc<ServerConfig>)>,
}

impl Guard {
    /// A door for a robot with this identity.
    ///
    /// # Errors
    /// The identity or the list cannot be used, as a sentence.
    pub fn new(own: Credentials, revoked: Option<Revoked>) -> Result<Self, String> {
        let written = revoked.as_ref().and_then(Revoked::written);
        let config = server_config(&own, revoked.as_ref())?;
        Ok(Self { own, revoked, config: Mutex::new((written, Arc::new(config))) })
    }

    /// Whose door it is.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        self.own.identity()
    }

    /// With the list of revoked certificates as it is now. One that cannot be read does not open the door to those that were
    /// revoked, nor shut it to those that would stop the robot: the last one counts.
    fn config(&self) -> Arc<ServerConfig> {
        let written = self.revoked.as_ref().and_then(Revoked::written);
        let mut config = self.config.lock().unwrap_or_else(PoisonError::into_inner);
        if config.0 != written {
            match server_config(&self.own, self.revoked.as_ref()) {
                Ok(read) => *config = (written, Arc::new(read)),
                Err(error) => tracing::warn!("the last list of revoked certificates counts: {error}"),
            }
        }
        Arc::clone(&config.1)
    }

    /// Lets an operator in.
    ///
    /// # Errors
    /// The peer does not prove who it is.
    pub(crate) async fn accept(&self, stream: TcpStream) -> io::Result<(TlsStream<TcpStream>, Proof)> {
        let stream = TlsAcceptor::from(self.config()).accept(stream).await?;
        let certificates = stream.get_ref().1.peer_certificates().unwrap_or_default();
        let nameless = || io::Error::other("the certificate names nobody");
        let certificate = certificates.first().ok_or_else(nameless)?;
        let identity = Identity::of_certificate(certificate).map_err(io::Error::other)?;
        let proof = identity.proof().ok_or_else(nameless)?;
        Ok((stream, proof))
    }
}
