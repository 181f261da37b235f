//! What lies between a link and its bytes: nothing, TLS with certificates on both sides, or records with codes by a shared secret.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use downbeat_robot::sealed::{self, Held, NotSealed, Passes, Refused, Sealed};
use downbeat_robot::tls::{Credentials, Identity, Name, Revoked, SERVER_NAME, client_config};
use downbeat_scripts::{Fleet, Protection};
use rustls::ClientConfig;
use rustls::pki_types::ServerName;
use tokio::io::{ReadHalf, WriteHalf};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_util::either::Either;
use urrcp::RobotId;

use super::by_key::{Network, OfSite};

/// The end of a connection over TCP from which is read.
pub(crate) type BareReadEnd =
    Either<OwnedReadHalf, Either<ReadHalf<TlsStream<TcpStream>>, ReadHalf<Sealed<TcpStream>>>>;
/// The end of a connection over TCP to which is written, and then flushed: what is encrypted or sealed may wait in it.
pub(crate) type BareWriteEnd =
    Either<OwnedWriteHalf, Either<WriteHalf<TlsStream<TcpStream>>, WriteHalf<Sealed<TcpStream>>>>;

/// How a site's robots are spoken to.
#[derive(Clone, Debug, Default)]
pub struct Site {
    config: Option<Arc<ClientConfig>>,
    identity: Option<Identity>,
    passes: Arc<Passes>,
    zenoh: Arc<OfSite>,
}

impl Site {
    /// As the fleet file says, or as another identity file does.
    ///
    /// # Errors
    /// What is wrong with the files, as a sentence.
    pub fn of(fleet: &Fleet, identity: Option<&Path>) -> Result<Self, String> {
        let site = Self::of_files(identity.or(fleet.identity.as_deref()), fleet.revoked.as_deref())?;
        Ok(site.with_zenoh(fleet.zenoh.clone()))
    }

    /// The same with the Zenoh network of this configuration.
    #[must_use]
    pub fn with_zenoh(mut self, file: Option<PathBuf>) -> Self {
        self.zenoh = Arc::new(OfSite::new(file));
        self
    }

    /// The Zenoh network, which is joined when it is asked for first.
    ///
    /// # Errors
    /// Why it cannot be joined, as a sentence.
    pub(crate) fn network(&self) -> Result<Network, String> {
        self.zenoh.joined()
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
        let passes = Passes::next_to(path);
        let passes = if passes.exists() { Passes::read(&passes) } else { Ok(Passes::default()) };
        let passes = Arc::new(passes.map_err(|error| error.to_string())?);
        let identity = Some(own.identity().clone());
        Ok(Self { config: Some(Arc::new(config)), identity, passes, ..Self::default() })
    }

    /// Who speaks; `None` without an identity.
    #[must_use]
    pub const fn identity(&self) -> Option<&Identity> {
        self.identity.as_ref()
    }

    /// The operator's passes for robots with a secret.
    #[must_use]
    pub fn passes(&self) -> &Passes {
        &self.passes
    }

    /// For a robot that calls itself so; `None`: whichever robot it is.
    #[must_use]
    pub fn with(&self, protection: Protection, robot: Option<&RobotId>) -> Security {
        let robot = robot.cloned();
        match (protection, &self.config) {
            (Protection::Open, _) => Security::Plain,
            (_, None) => Security::Nameless,
            (Protection::Tls, Some(config)) => {
                Security::Tls(Arc::new(Tls { config: Arc::clone(config), robot }))
            }
            (Protection::Hmac, Some(_)) => {
                Security::Hmac(Arc::new(Hmac { passes: Arc::clone(&self.passes), robot }))
            }
        }
    }
}

/// How one robot is spoken to.
#[derive(Clone, Debug)]
pub enum Security {
    /// As it is.
    Plain,
    /// With TLS, by a certificate that says so.
    Tls(Arc<Tls>),
    /// In records with codes, by a pass that says so.
    Hmac(Arc<Hmac>),
    /// Not as it is, but there is no identity: nothing can be said.
    Nameless,
}

/// What it takes to seal what is said to one robot.
#[derive(Debug)]
pub struct Hmac {
    passes: Arc<Passes>,
    /// Whose secret its pass is made from; `None`: any robot's.
    robot: Option<RobotId>,
}

impl Hmac {
    /// The same for one robot alone.
    pub(crate) fn for_robot(&self, robot: RobotId) -> Self {
        Self { passes: Arc::clone(&self.passes), robot: Some(robot) }
    }

    /// The pass to begin with, or why there is none.
    pub(crate) fn pass(&self) -> io::Result<&Held> {
        self.first().map_err(io::Error::other)
    }

    fn first(&self) -> Result<&Held, Denied> {
        let none = |of: String| {
            Denied(format!(
                "you have no pass for {of}: `downbeat keys secret` makes one, in a file next to your identity file"
            ))
        };
        match &self.robot {
            Some(robot) => self.passes.of(robot).ok_or_else(|| none(format!("robot {robot}"))),
            None => self.passes.held().first().ok_or_else(|| none("any robot".to_owned())),
        }
    }

    /// Connects. A robot that refuses the pass of another names itself; if any robot is meant, it is asked again with its own.
    async fn connect(&self, stream: TcpStream) -> io::Result<Sealed<TcpStream>> {
        let address = stream.peer_addr()?;
        let held = self.pass()?;
        let error = match sealed::connect(stream, held).await {
            Err(error) if self.robot.is_none() => error,
            connected => return connected,
        };
        let named = match error.get_ref().and_then(|inner| inner.downcast_ref()) {
            Some(NotSealed::Refused(Refused::OtherRobot(own))) => self.passes.of(own),
            _ => None,
        };
        let Some(held) = named else { return Err(error) };
        let stream = TcpStream::connect(address).await?;
        stream.set_nodelay(true)?;
        sealed::connect(stream, held).await
    }
}

/// What TLS with one robot takes.
#[derive(Debug)]
pub struct Tls {
    config: Arc<ClientConfig>,
    /// Whom its certificate has to name; `None`: any robot of the authority.
    robot: Option<RobotId>,
}

impl Tls {
    /// How this side proves who it is.
    pub(crate) const fn config(&self) -> &Arc<ClientConfig> {
        &self.config
    }
}

/// Connects to a robot, makes sure that it is this one, and says whose certificate it has shown.
///
/// # Errors
/// The connection cannot be made, or the other side does not prove who it is.
pub(crate) async fn secured(
    stream: TcpStream,
    security: &Security,
) -> io::Result<((BareReadEnd, BareWriteEnd), Option<Met>)> {
    let denied = |what: String| io::Error::other(Denied(what));
    stream.set_nodelay(true)?;
    let tls = match security {
        Security::Plain => {
            let (reader, writer) = stream.into_split();
            return Ok(((Either::Left(reader), Either::Left(writer)), None));
        }
        Security::Nameless => {
            let hint = "name your identity file: `identity` in the fleet file, or DOWNBEAT_IDENTITY";
            return Err(denied(format!("the robot needs to know who you are: {hint}")));
        }
        Security::Hmac(hmac) => {
            let (reader, writer) = tokio::io::split(hmac.connect(stream).await?);
            return Ok((
                (Either::Right(Either::Right(reader)), Either::Right(Either::Right(writer))),
                Some(Met { until: None }),
            ));
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
    Ok((
        (Either::Right(Either::Left(reader)), Either::Right(Either::Left(writer))),
        Some(Met { until: Some(met.expires) }),
    ))
}

/// Why one side was not let in, in words of keys and certificates; `None` where the connection failed otherwise.
pub(crate) fn denial(error: &io::Error) -> Option<String> {
    use rustls::{AlertDescription as Alert, CertificateError as Certificate, Error};
    let inner = error.get_ref()?;
    if let Some(Denied(why)) = inner.downcast_ref() {
        return Some(why.clone());
    }
    if let Some(why) = inner.downcast_ref::<NotSealed>() {
        return Some(why.to_string());
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

/// A robot that has proven who it is.
pub(crate) struct Met {
    /// Until when its certificate counts, if it has one, in seconds since 1970.
    pub(crate) until: Option<i64>,
}

/// Not let in, for a reason of this side.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Denied(String);
