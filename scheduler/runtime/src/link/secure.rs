//! The security layer of a TCP connection: none, TLS with certificates on both sides, or records authenticated by a shared secret.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use downbeat_robot::sealed::{self, Held, NotSealed, Passes, Refused, Sealed};
use downbeat_robot::tls::{Credentials, Identity, List, Name, Revoked, SERVER_NAME, client_config};
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

/// The reading end of a TCP connection.
pub(crate) type BareReadEnd =
    Either<OwnedReadHalf, Either<ReadHalf<TlsStream<TcpStream>>, ReadHalf<Sealed<TcpStream>>>>;
/// The writing end of a TCP connection. It must be flushed after a write, because it may buffer encrypted or sealed data.
pub(crate) type BareWriteEnd =
    Either<OwnedWriteHalf, Either<WriteHalf<TlsStream<TcpStream>>, WriteHalf<Sealed<TcpStream>>>>;

/// The credentials and the Zenoh network for connections to the robots of a site.
#[derive(Clone, Debug, Default)]
pub struct Site {
    config: Option<Arc<ClientConfig>>,
    identity: Option<Identity>,
    list: Option<Arc<List>>,
    passes: Arc<Passes>,
    zenoh: Arc<OfSite>,
}

impl Site {
    /// Reads the files that the fleet file names. `identity` replaces the identity file if given.
    ///
    /// # Errors
    /// Returns the fault of the files as a sentence.
    pub fn of(fleet: &Fleet, identity: Option<&Path>) -> Result<Self, String> {
        let site = Self::of_files(identity.or(fleet.identity.as_deref()), fleet.revoked.as_deref())?;
        Ok(site.with_zenoh(fleet.zenoh.clone()))
    }

    /// Returns this site with the Zenoh network described by the configuration `file`.
    #[must_use]
    pub fn with_zenoh(mut self, file: Option<PathBuf>) -> Self {
        self.zenoh = Arc::new(OfSite::new(file));
        self
    }

    /// Returns the Zenoh network. The first call joins it.
    ///
    /// # Errors
    /// Returns the reason why it cannot be joined, as a sentence.
    pub fn network(&self) -> Result<Network, String> {
        self.zenoh.joined()
    }

    /// Reads an identity file and a list of revoked certificates. Without an identity, only plain TCP is possible.
    ///
    /// # Errors
    /// Returns the fault of the files as a sentence.
    pub fn of_files(identity: Option<&Path>, revoked: Option<&Path>) -> Result<Self, String> {
        let Some(path) = identity else { return Ok(Self::default()) };
        let own = Credentials::read(path).map_err(|error| error.to_string())?;
        if let Name::Robot(id) = &own.identity().name {
            return Err(format!(
                "{}: this is the identity of robot `{id}`, expected an operator's identity; create one with `downbeat keys operator`",
                path.display()
            ));
        }
        let revoked = revoked.map(Revoked::in_file).transpose().map_err(|error| error.to_string())?;
        let list =
            revoked.map(|revoked| own.list(&revoked)).transpose().map_err(|error| error.to_string())?;
        let config = client_config(&own, list.as_ref())?;
        let passes = Passes::next_to(path);
        let passes = if passes.exists() { Passes::read(&passes) } else { Ok(Passes::default()) };
        let passes = Arc::new(passes.map_err(|error| error.to_string())?);
        let identity = Some(own.identity().clone());
        let list = list.map(Arc::new);
        Ok(Self { config: Some(Arc::new(config)), identity, list, passes, ..Self::default() })
    }

    /// The operator's identity. `None` without an identity file.
    #[must_use]
    pub const fn identity(&self) -> Option<&Identity> {
        self.identity.as_ref()
    }

    /// Whether another authority replaces the one that issued the operator's certificate.
    #[must_use]
    pub fn is_of_replaced_authority(&self) -> bool {
        let identity = self.identity.as_ref().zip(self.list.as_ref());
        identity.is_some_and(|(identity, list)| list.replaces(&identity.authority))
    }

    /// The operator's passes for robots with a secret.
    #[must_use]
    pub fn passes(&self) -> &Passes {
        &self.passes
    }

    /// Returns the security of a connection to a robot. `robot` is the id that the robot uses for itself; `None` stands for any robot.
    #[must_use]
    pub fn with(&self, protection: Protection, robot: Option<&RobotId>) -> Security {
        let robot = robot.cloned();
        match (protection, &self.config) {
            (Protection::Open, _) => Security::Plain,
            (_, None) => Security::Nameless,
            (Protection::Tls, Some(config)) => {
                Security::Tls(Arc::new(Tls { config: Arc::clone(config), list: self.list.clone(), robot }))
            }
            (Protection::Hmac, Some(_)) => {
                Security::Hmac(Arc::new(Hmac { passes: Arc::clone(&self.passes), robot }))
            }
        }
    }
}

/// The security of the connection to one robot.
#[derive(Clone, Debug)]
pub enum Security {
    /// Plain TCP.
    Plain,
    /// TLS with the operator's certificate.
    Tls(Arc<Tls>),
    /// Authenticated records with the operator's pass.
    Hmac(Arc<Hmac>),
    /// The robot requires authentication, but the operator has no identity, so no connection is possible.
    Nameless,
}

/// The parameters of authenticated records with one robot.
#[derive(Debug)]
pub struct Hmac {
    passes: Arc<Passes>,
    /// The robot that the pass must be valid for. `None` for any robot.
    robot: Option<RobotId>,
}

impl Hmac {
    /// Returns these parameters, restricted to this robot.
    #[must_use]
    pub fn for_robot(&self, robot: RobotId) -> Self {
        Self { passes: Arc::clone(&self.passes), robot: Some(robot) }
    }

    /// Returns the pass to present first: the expected robot's pass, or the first pass if any robot is permitted.
    ///
    /// # Errors
    /// Fails if the operator has no pass. The error message describes how to make one.
    pub fn pass(&self) -> io::Result<&Held> {
        self.first().map_err(io::Error::other)
    }

    fn first(&self) -> Result<&Held, Denied> {
        let none = |of: String| {
            Denied(format!(
                "you have no pass for {of}: create one with `downbeat keys secret`, and keep the passes file next to your identity file"
            ))
        };
        match &self.robot {
            Some(robot) => self.passes.of(robot).ok_or_else(|| none(format!("robot {robot}"))),
            None => self.passes.held().first().ok_or_else(|| none("any robot".to_owned())),
        }
    }

    /// Connects with the first pass. If that pass is for another robot, the robot refuses it and returns its own id. If any robot is
    /// permitted, connects again with the pass for that id.
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

/// The parameters of TLS with one robot.
#[derive(Debug)]
pub struct Tls {
    config: Arc<ClientConfig>,
    list: Option<Arc<List>>,
    /// The robot that the certificate must name. `None` for any robot of the authority.
    robot: Option<RobotId>,
}

impl Tls {
    /// The TLS configuration that this side uses to authenticate.
    #[must_use]
    pub const fn config(&self) -> &Arc<ClientConfig> {
        &self.config
    }
}

/// Secures an established TCP connection and verifies that the other side is the expected robot. Also returns the authenticated robot
/// with the expiry of its certificate, or `None` for plain TCP.
///
/// # Errors
/// Fails if the connection cannot be secured, or if the other side does not authenticate.
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
            let hint = "set `identity` in the fleet file, or DOWNBEAT_IDENTITY, to your identity file";
            return Err(denied(format!("the robot requires your identity: {hint}")));
        }
        Security::Hmac(hmac) => {
            let (reader, writer) = tokio::io::split(hmac.connect(stream).await?);
            return Ok((
                (Either::Right(Either::Right(reader)), Either::Right(Either::Right(writer))),
                Some(Met { until: None, is_of_replaced_authority: false }),
            ));
        }
        Security::Tls(tls) => tls,
    };
    let name = ServerName::try_from(SERVER_NAME).map_err(io::Error::other)?;
    let connector = TlsConnector::from(Arc::clone(&tls.config));
    let stream = connector.connect(name, stream).await?;
    let certificates = stream.get_ref().1.peer_certificates().unwrap_or_default();
    let certificate =
        certificates.first().ok_or_else(|| denied("the robot presented no certificate".into()))?;
    let met = Identity::of_certificate(certificate).map_err(|error| denied(error.to_string()))?;
    if let Some(robot) = tls.robot.as_ref().filter(|robot| met.name != Name::Robot((*robot).clone())) {
        return Err(denied(format!("its certificate belongs to {}, expected robot {robot}", met.name)));
    }
    let (reader, writer) = tokio::io::split(stream);
    let is_of_replaced_authority = tls.list.as_ref().is_some_and(|list| list.replaces(&met.authority));
    Ok((
        (Either::Right(Either::Left(reader)), Either::Right(Either::Left(writer))),
        Some(Met { until: Some(met.expires), is_of_replaced_authority }),
    ))
}

/// Returns why one side denied access, as a sentence about keys and certificates. Returns `None` if the connection failed for another
/// reason.
#[must_use]
pub fn denial(error: &io::Error) -> Option<String> {
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
            "the robot's certificate was issued by a different authority than yours: if the authority was replaced, use its latest `revoked.pem`"
        }
        Error::InvalidCertificate(Certificate::Expired | Certificate::ExpiredContext { .. }) => {
            "the robot's certificate has expired: create a new one with `downbeat keys renew`"
        }
        Error::InvalidCertificate(Certificate::Revoked) => "the robot's certificate is revoked",
        Error::InvalidMessage(_) => "the program at this address does not use TLS",
        Error::AlertReceived(Alert::UnknownCA | Alert::DecryptError) => {
            "the robot trusts a different authority than yours: if the authority was replaced, renew your key, and send the robot the latest list with `downbeat keys push`"
        }
        Error::AlertReceived(Alert::CertificateExpired) => {
            "your certificate has expired: create a new one with `downbeat keys renew`"
        }
        Error::AlertReceived(Alert::CertificateRevoked) => "your certificate is revoked",
        other => return Some(format!("TLS with the robot failed: {other}")),
    };
    Some(why.to_owned())
}

/// A robot that has proven its identity on a connection.
pub(crate) struct Met {
    /// When the robot's certificate expires, in seconds since 1970, UTC. `None` if it authenticated without a certificate.
    pub(crate) until: Option<i64>,
    /// Whether another authority replaces the one that issued the robot's certificate.
    pub(crate) is_of_replaced_authority: bool,
}

/// This side denied access, for the contained reason.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Denied(String);

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;
    use std::time::Duration;

    use downbeat_robot::simulated::{Settings, SimulatedRobot};
    use downbeat_robot::{Door, Host, HostOptions, serve_behind};
    use rustls::{AlertDescription, CertificateError, Error, InvalidMessage};
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::sync::mpsc;

    use super::*;
    use crate::link::{Endpoint, Link, LinkEncoding};
    use crate::server_clock::ServerClock;
    use downbeat_mission::drive::{Happened, LinkNumber};
    use downbeat_mission::{Event, Loss, RobotIndex};

    #[test]
    fn tls_failure_is_explained_in_terms_of_certificates_and_their_owners() {
        for (error, expected) in [
            (
                Error::InvalidCertificate(CertificateError::UnknownIssuer),
                "issued by a different authority than yours",
            ),
            (
                Error::InvalidCertificate(CertificateError::BadSignature),
                "issued by a different authority than yours",
            ),
            (Error::InvalidCertificate(CertificateError::Expired), "the robot's certificate has expired"),
            (Error::InvalidCertificate(CertificateError::Revoked), "the robot's certificate is revoked"),
            (Error::InvalidMessage(InvalidMessage::InvalidContentType), "does not use TLS"),
            (
                Error::AlertReceived(AlertDescription::UnknownCA),
                "the robot trusts a different authority than yours",
            ),
            (
                Error::AlertReceived(AlertDescription::DecryptError),
                "the robot trusts a different authority than yours",
            ),
            (Error::AlertReceived(AlertDescription::CertificateExpired), "your certificate has expired"),
            (Error::AlertReceived(AlertDescription::CertificateRevoked), "your certificate is revoked"),
            (Error::AlertReceived(AlertDescription::InternalError), "TLS with the robot failed"),
        ] {
            let told = denial(&io::Error::other(error.clone())).unwrap();
            assert!(told.contains(expected), "{error:?}: {told}");
        }
    }

    #[test]
    fn broken_connection_is_not_a_denial() {
        assert_eq!(denial(&io::ErrorKind::ConnectionReset.into()), None);
        assert_eq!(denial(&io::Error::other("no route")), None);
    }

    #[test]
    fn without_identity_only_open_robots_are_contacted() {
        let site = Site::of_files(None, None).unwrap();
        assert!(site.identity().is_none() && site.passes().held().is_empty());
        assert!(matches!(site.with(Protection::Open, None), Security::Plain));
        for protection in [Protection::Tls, Protection::Hmac] {
            assert!(matches!(site.with(protection, None), Security::Nameless), "{protection:?}");
        }
    }

    #[tokio::test]
    async fn protected_robot_is_not_contacted_without_an_identity() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        let error = secured(stream, &Security::Nameless).await.err().unwrap();
        assert!(denial(&error).is_some_and(|why| why.contains("DOWNBEAT_IDENTITY")), "{error}");
    }

    /// Returns a pass from a newly generated secret.
    fn held(robot: &str) -> Held {
        held_by(&sealed::Secret::generate().unwrap(), robot)
    }

    fn held_by(secret: &sealed::Secret, robot: &str) -> Held {
        let claim: sealed::Claim = format!("operator eve - {} 1", i64::MAX).parse().unwrap();
        Held { robot: robot.parse().unwrap(), pass: secret.pass(&claim), claim }
    }

    /// Starts robot `b`, which requires passes made from `secret`. It runs until the host is dropped.
    async fn robot_b(secret: sealed::Secret) -> (Host, SocketAddr) {
        let block = r#"{"id": "b", "api_version": "1", "devices": [{"id": "eye", "name": "eye",
            "available_control_types": {"sensor": {"min_value": 0, "max_value": 9}}}]}"#;
        let block = serde_json::from_str(block).unwrap();
        let robots = vec![SimulatedRobot::new(block, Settings::default())];
        let host = Host::start(robots, HostOptions::default()).unwrap();
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let door = Door::Sealed(Arc::new(sealed::Guard::new("b".parse().unwrap(), secret, None).unwrap()));
        tokio::spawn(serve_behind(listener, host.handle(), 0, door));
        (host, address)
    }

    #[tokio::test]
    async fn robot_is_retried_with_its_own_pass_unless_another_robot_is_intended() {
        let secret = sealed::Secret::generate().unwrap();
        let (host, address) = robot_b(secret.clone()).await;
        let other = "it is robot b, but your pass is for a different robot";
        for (meant, passes, expected) in [
            (None, vec![held("a"), held_by(&secret, "b")], None),
            (None, vec![held_by(&secret, "b")], None),
            (None, vec![held("a")], Some(other)),
            (
                None,
                vec![held("a"), held("b")],
                Some("the robot does not have the secret that matches your pass"),
            ),
            (
                None,
                vec![held("b"), held_by(&secret, "b")],
                Some("the robot does not have the secret that matches your pass"),
            ),
            (Some("a"), vec![held("a"), held_by(&secret, "b")], Some(other)),
            (Some("b"), vec![held("a"), held_by(&secret, "b")], None),
        ] {
            let robot = meant.map(|robot| robot.parse().unwrap());
            let named: Vec<_> = passes.iter().map(|held| held.robot.to_string()).collect();
            let hmac = Hmac { passes: Arc::new(Passes::new(passes)), robot };
            let stream = TcpStream::connect(address).await.unwrap();
            let refused = secured(stream, &Security::Hmac(Arc::new(hmac))).await.err();
            let why = refused.as_ref().and_then(denial);
            let told = why.as_deref().zip(expected).is_some_and(|(why, part)| why.starts_with(part));
            assert!(told || refused.is_none() && expected.is_none(), "{meant:?}, {named:?}: {refused:?}");
        }
        drop(host);
    }

    /// Starts a listener that poses as the robot and sends `line` on the first connection. Returns its address.
    async fn forged(line: String) -> SocketAddr {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let mut hello = [0; 1];
            stream.read_exact(&mut hello).await.unwrap();
            stream.write_all(line.as_bytes()).await.unwrap();
            // Until the operator hangs up.
            let _gone = tokio::io::copy(&mut stream, &mut tokio::io::sink()).await;
        });
        address
    }

    /// Opens a link to robot `b` and waits for its first event.
    async fn link_to_b(at: SocketAddr, security: &Security) -> (Link, mpsc::Receiver<Happened>, Event) {
        let endpoint = Endpoint::Tcp {
            host: at.ip().to_string(),
            port: at.port(),
            encoding: LinkEncoding::default(),
            security: security.clone(),
        };
        let (events, mut happened) = mpsc::channel(9);
        let clock = ServerClock::anchored(urrcp::Span::ZERO);
        let link = Link::open((RobotIndex::new(0), LinkNumber(0)), endpoint, clock, events, Duration::ZERO);
        let Some(Happened::OnLink { event, .. }) = happened.recv().await else { panic!("nothing happened") };
        (link, happened, *event)
    }

    #[tokio::test]
    async fn forged_refusal_results_only_in_denied_access() {
        let secret = sealed::Secret::generate().unwrap();
        let (host, address) = robot_b(secret.clone()).await;
        let passes = Arc::new(Passes::new(vec![held_by(&secret, "b")]));
        let security = Security::Hmac(Arc::new(Hmac { passes, robot: Some("b".parse().unwrap()) }));
        for refused in [
            Refused::Expired,
            Refused::Revoked,
            Refused::Unreadable,
            Refused::OtherRobot("a".parse().unwrap()),
        ] {
            let (_link, _more, event) = link_to_b(forged(refused.line()).await, &security).await;
            // The event implies neither that the robot has no process, nor that another robot has its address.
            assert!(matches!(event, Event::LinkDown { loss: Loss::Denied, .. }), "{refused:?}: {event:?}");
            let (_link, _more, event) = link_to_b(address, &security).await;
            assert!(
                matches!(event, Event::Proven { .. }),
                "the pass counts as before {refused:?}: {event:?}"
            );
        }
        drop(host);
    }

    #[test]
    fn pass_of_intended_robot_is_used_or_first_pass_if_none_is_intended() {
        let passes = Arc::new(Passes::new(vec![held("a"), held("b")]));
        let any = Hmac { passes: Arc::clone(&passes), robot: None };
        assert_eq!(any.pass().unwrap().robot.as_str(), "a");
        assert_eq!(any.for_robot("b".parse().unwrap()).pass().unwrap().robot.as_str(), "b");
        let of_other = any.for_robot("c".parse().unwrap());
        let why = of_other.pass().map(|_| ()).unwrap_err().to_string();
        assert!(why.contains("no pass for robot c"), "{why}");
        let none = Hmac { passes: Arc::default(), robot: None };
        let why = none.pass().map(|_| ()).unwrap_err().to_string();
        assert!(why.contains("no pass for any robot"), "{why}");
    }

    #[test]
    fn site_uses_its_identity_file_and_the_protection_of_each_robot() {
        let folder = tempfile::TempDir::new().unwrap();
        let now = crate::keys::calendar();
        let authority = crate::keys::Authority::create(&folder.path().join("keys"), now).unwrap();
        let file = |name: Name| {
            let roles = downbeat_robot::Roles::default();
            authority.issue(&[name].into(), &roles, now, 10).unwrap().remove(0)
        };
        let eve = Name::Operator("eve".to_owned());
        let site = Site::of_files(Some(&file(eve.clone())), None).unwrap().with_zenoh(None);
        assert_eq!(site.identity().map(|identity| &identity.name), Some(&eve));
        assert!(matches!(site.with(Protection::Open, None), Security::Plain));
        let robot: RobotId = "arm".parse().unwrap();
        let Security::Tls(tls) = site.with(Protection::Tls, Some(&robot)) else { panic!("no TLS") };
        assert_eq!(tls.robot.as_ref(), Some(&robot));
        let Security::Hmac(hmac) = site.with(Protection::Hmac, Some(&robot)) else { panic!("no codes") };
        assert_eq!(hmac.robot.as_ref(), Some(&robot));
        let refused = Site::of_files(Some(&file(Name::Robot(robot))), None).unwrap_err();
        assert!(refused.contains("the identity of robot `arm`"), "{refused}");
    }

    #[test]
    fn without_configuration_zenoh_network_is_refused_with_a_reason() {
        let why = Site::default().with_zenoh(None).network().err();
        assert!(why.as_deref().is_some_and(|why| why.contains("`zenoh:` addresses")), "{why:?}");
    }
}
