//! The guard of a robot, which admits only peers with a proven identity.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use rustls::ServerConfig;
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

use super::config::server_config;
use super::credentials::Credentials;
use super::identity::Identity;
use super::list::List;
use super::revoked::{CurrentList, Revoked};

const NO_LIST: &str = "the robot has no list of revoked keys; start it with --revoked";

/// Proves a robot's identity to its peers, and checks theirs. Admits operators with a certificate that an authority of the robot
/// issued and that is not revoked.
#[derive(Debug)]
pub struct Guard {
    own: Credentials,
    revoked: Option<CurrentList>,
    /// TLS configuration, with the list of revoked certificates that it was created from.
    config: Mutex<(Option<Arc<List>>, Arc<ServerConfig>)>,
}

impl Guard {
    /// Creates a guard for a robot with this identity.
    ///
    /// # Errors
    /// A sentence with the reason why the identity or the list of revoked certificates cannot be used.
    pub fn new(own: Credentials, revoked: Option<Revoked>) -> Result<Self, String> {
        let current = |revoked| CurrentList::new(&revoked, &own.authorities)?.storing_number();
        let revoked = revoked.map(current).transpose()?;
        let list = revoked.as_ref().map(CurrentList::list);
        let config = server_config(&own, list.as_deref())?;
        Ok(Self { own, revoked, config: Mutex::new((list, Arc::new(config))) })
    }

    /// Returns the robot's identity.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        self.own.identity()
    }

    /// Returns the current list of revoked certificates. `None` if the robot has no list.
    #[must_use]
    pub fn list(&self) -> Option<Arc<List>> {
        self.revoked.as_ref().map(CurrentList::list)
    }

    /// Returns the list in use, like [`Guard::list`], but without accessing its file, which may have changed in the last second.
    #[must_use]
    pub fn latest_list(&self) -> Option<Arc<List>> {
        self.revoked.as_ref().map(CurrentList::latest)
    }

    /// Replaces the list of revoked certificates with this one, in PEM, if it is later.
    ///
    /// # Errors
    /// A sentence with the reason why the list is not used.
    pub fn replace_list(&self, text: &str) -> Result<(), String> {
        let revoked = self.revoked.as_ref().ok_or(NO_LIST)?;
        revoked.replace(text)
    }

    /// Returns the TLS configuration with the current list of revoked certificates.
    fn config(&self) -> Arc<ServerConfig> {
        let list = self.list();
        let mut config = self.config.lock().unwrap_or_else(PoisonError::into_inner);
        if config.0.as_ref().map(Arc::as_ptr) != list.as_ref().map(Arc::as_ptr) {
            match server_config(&self.own, list.as_deref()) {
                Ok(read) => *config = (list, Arc::new(read)),
                Err(error) => {
                    tracing::warn!("the previous list of revoked certificates remains in use: {error}")
                }
            }
        }
        Arc::clone(&config.1)
    }

    /// Accepts the TLS connection of an operator, and returns the operator's identity.
    ///
    /// # Errors
    /// The peer does not prove its identity.
    pub(crate) async fn accept(&self, stream: TcpStream) -> io::Result<(TlsStream<TcpStream>, Identity)> {
        let stream = TlsAcceptor::from(self.config()).accept(stream).await?;
        let certificates = stream.get_ref().1.peer_certificates().unwrap_or_default();
        let nameless = || io::Error::other("the certificate contains no name");
        let certificate = certificates.first().ok_or_else(nameless)?;
        let identity = Identity::of_certificate(certificate).map_err(io::Error::other)?;
        Ok((stream, identity))
    }
}
