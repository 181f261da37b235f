//! What lies between a link and its bytes: nothing, or TLS with certificates on both sides.

use std::io;
use std::path::Path;
use std::sync::Arc;

use downbeat_robot::tls::{Credentials, Identity, Name, Revoked, SERVER_NAME, client_config};
use downbeat_scripts::Fleet;
use rustls::ClientConfig;
use rustls::pki_types::ServerName;
use tokio::io::{ReadHalf, WriteHalf};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_util::either::Either;
use urrcp::RobotId;

/// The end of a connection from which is read.
pub(crate) type ReadEnd = Either<OwnedReadHalf, ReadHalf<TlsStream<TcpStream>>>;
/// The end of a connection to which is written.
pub(crate) type WriteEnd = Either<OwnedWriteHalf, WriteHalf<TlsStream<TcpStream>>>;

/// How a site's robots are spoken to.
#[derive(Clone, Debug, Default)]
pub struct Site {
    config: Option<Arc<ClientConfig>>,
    identity: Option<Identity>,
}

impl Site {
    /// As the fleet file says, or as another identity file does.
    ///
    /// # Errors
    /// What is wrong with the files, as a sentence.
    pub fn of(fleet: &Fleet, identity: Option<&Path>) -> Result<Self, String> {
        Self::of_files(identity.or(fleet.identity.as_deref()), fleet.revoked.as_deref())
    }

    /// With these files; without an identity nothing but plain TCP is spoken.
    ///
    /// # Errors
    /// What is wrong with them, as a sentence.
    pub fn of_files(identity: Option<&Path>, revoked: Option<&Path>) -> Result<Self, String> {
        let Some(path) = identity else { return Ok(Self::default()) };
        let own = Credentials::read(path).map_err(|error| error.to_string())?;
        if let Name::Robot(id) = &own.identity().name {
            return Err(format!(
                "{}: this is the identity of robot `{id}`; expected an operator's, which `downbeat keys operator` makes",
                path.display()
            ));
        }
        let revoked = revoked.map(Revoked::in_file).transpose().map_err(|error| error.to_string())?;
        let config = client_config(&own, revoked.as_ref())?;
        Ok(Self { config: Some(Arc::new(config)), identity: Some(own.identity().clone()) })
    }

    /// Who speaks; `None` without an identity.
    #[must_use]
    pub const fn identity(&self) -> Option<&Identity> {
        self.identity.as_ref()
    }

    /// For a robot that calls itself so.
    #[must_use]
    pub fn with(&self, robot: &RobotId) -> Security {
        match &self.config {
            Some(config) => {
                Security::Tls(Arc::new(Tls { config: Arc::clone(config), robot: Some(robot.clone()) }))
            }
            None => Security::Nameless,
        }
    }
}

impl Site {
    /// For a robot of the authority, whichever it is.
    #[must_use]
    pub fn with_any(&self) -> Security {
        match &self.config {
            Some(config) => Security::Tls(Arc::new(Tls { config: Arc::clone(config), robot: None })),
            None => Security::Nameless,
        }
    }
}

/// How one robot is spoken to.
#[derive(Clone, Debug)]
pub enum Security {
    /// Without TLS.
    Plain,
    /// With TLS, by a certificate that says so.
    Tls(Arc<Tls>),
    /// With TLS, for which there is no identity: nothing can be said.
    Nameless,
}

/// What TLS with one robot takes.
#[derive(Debug)]
pub struct Tls {
    config: Arc<ClientConfig>,
    /// Whom its certificate has to name; `None`: any robot of the authority.
    robot: Option<RobotId>,
}

/// Connects to a robot, makes sure that it is this one, and says whose certificate it has shown.
///
/// # Errors
/// The connection cannot be made, or the other side does not prove who it is.
pub(crate) async fn secured(
    stream: TcpStream,
    security: &Security,
) -> io::Result<((ReadEnd, WriteEnd), Option<Identity>)> {
    let denied = |what: String| io::Error::other(Denied(what));
    stream.set_nodelay(true)?;
    let tls = match security {
        Security::Plain => {
            let (reader, writer) = stream.into_split();
            return Ok(((Either::Left(reader), Either::Left(writer)), None));
        }
        Security::Nameless => {
            let hint = "name your identity file: `identity` in the fleet file, or DOWNBEAT_IDENTITY";
            return Err(denied(format!("TLS needs to know who you are: {hint}")));
        }
        Security::Tls(tls) => tls,
    };
    let name = ServerName::try_from(SERVER_NAME).map_err(io::Error::other)?;
    let connector = TlsConnector::from(Arc::clone(&tls.config));
    let stream = connector.connect(name, stream).await?;
    let certificates = stream.get_ref().1.peer_certificates().unwrap_or_default();
    let certificate = certificates.first().ok_or_else(|| denied("the robot showed no certificate".into()))?;
    let met = Identity::of_certificate(certificate).map_err(|error| denied(error.to_string()))?;
    if let Some(robot) = tls.robot.as_ref().filter(|robot| met.name != Name::Robot((*robot).clone())) {
        return Err(denied(format!("its certificate is that of {}, expected robot {robot}", met.name)));
    }
    let (reader, writer) = tokio::io::split(stream);
    Ok(((Either::Right(reader), Either::Right(writer)), Some(met)))
}

/// Why one side was not let in, in words of keys and certificates; `None` where the connection failed otherwise.
pub(crate) fn denial(error: &io::Error) -> Option<String> {
    use rustls::{AlertDescription as Alert, CertificateError as Certificate, Error};
    let inner = error.get_ref()?;
    if let Some(Denied(why)) = inner.downcast_ref() {
        return Some(why.clone());
    }
    let why = match inner.downcast_ref::<Error>()? {
        Error::InvalidCertificate(Certificate::UnknownIssuer | Certificate::BadSignature) => {
            "the robot's certificate is of another authority than yours"
        }
        Error::InvalidCertificate(Certificate::Expired | Certificate::ExpiredContext { .. }) => {
            "the robot's certificate has expired: `downbeat keys renew` makes a new one"
        }
        Error::InvalidCertificate(Certificate::Revoked) => "the robot's certificate is revoked",
        Error::InvalidMessage(_) => "what listens there does not speak TLS",
        Error::AlertReceived(Alert::UnknownCA | Alert::DecryptError) => {
            "the robot trusts another authority than yours"
        }
        Error::AlertReceived(Alert::CertificateExpired) => {
            "your certificate has expired: `downbeat keys renew` makes a new one"
        }
        Error::AlertReceived(Alert::CertificateRevoked) => "your certificate is revoked",
        other => return Some(format!("no TLS with the robot: {other}")),
    };
    Some(why.to_owned())
}

/// Not let in, for a reason of our own.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Denied(String);
