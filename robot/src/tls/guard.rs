//! The guard of a robot that admits only peers with a proven identity.

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

/// Proves a robot's identity and checks that of its peers. Admits operators with a certificate that the robot's authority issued and that
/// is not revoked.
#[derive(Debug)]
pub struct Guard {
    own: Credentials,
    revoked: Option<Revoked>,
    /// TLS configuration, with the modification time of the list of revoked certificates that it was created from.
    config: Mutex<(Option<SystemTime>, Arc<ServerConfig>)>,
}

impl Guard {
    /// Creates a guard for a robot with this identity.
    ///
    /// # Errors
    /// A sentence with the reason why the identity or the list cannot be used.
    pub fn new(own: Credentials, revoked: Option<Revoked>) -> Result<Self, String> {
        let written = revoked.as_ref().and_then(Revoked::written);
        let config = server_config(&own, revoked.as_ref())?;
        Ok(Self { own, revoked, config: Mutex::new((written, Arc::new(config))) })
    }

    /// Returns the robot's identity.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        self.own.identity()
    }

    /// Returns the TLS configuration with the current list of revoked certificates. If the list cannot be read, the previous list
    /// applies. It neither admits revoked operators nor excludes operators that would stop the robot.
    fn config(&self) -> Arc<ServerConfig> {
        let written = self.revoked.as_ref().and_then(Revoked::written);
        let mut config = self.config.lock().unwrap_or_else(PoisonError::into_inner);
        if config.0 != written {
            match server_config(&self.own, self.revoked.as_ref()) {
                Ok(read) => *config = (written, Arc::new(read)),
                Err(error) => {
                    tracing::warn!("the previous list of revoked certificates remains in use: {error}")
                }
            }
        }
        Arc::clone(&config.1)
    }

    /// Accepts the TLS connection of an operator, and returns the operator's proof.
    ///
    /// # Errors
    /// The peer does not prove its identity.
    pub(crate) async fn accept(&self, stream: TcpStream) -> io::Result<(TlsStream<TcpStream>, Proof)> {
        let stream = TlsAcceptor::from(self.config()).accept(stream).await?;
        let certificates = stream.get_ref().1.peer_certificates().unwrap_or_default();
        let nameless = || io::Error::other("the certificate contains no name");
        let certificate = certificates.first().ok_or_else(nameless)?;
        let identity = Identity::of_certificate(certificate).map_err(io::Error::other)?;
        let proof = identity.proof().ok_or_else(nameless)?;
        Ok((stream, proof))
    }
}
