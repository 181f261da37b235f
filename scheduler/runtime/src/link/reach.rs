//! Connections to robots that listen on the network. They transport the bytes of links and stops.

use std::fmt;
use std::io;

#[cfg(feature = "zenoh")]
pub(crate) use downbeat_robot::zenoh::Text;
#[cfg(feature = "zenoh")]
use downbeat_robot::zenoh::{Key, Network, Stream};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
#[cfg(feature = "zenoh")]
use tokio_util::either::Either;

#[cfg(feature = "zenoh")]
use urrcp::Command;
use urrcp::Script;

use super::Security;
use super::batch::Batch;
use super::secure::{BareReadEnd, BareWriteEnd, Met, secured};

/// The reading end of a connection.
#[cfg(not(feature = "zenoh"))]
pub(crate) type ReadEnd = BareReadEnd;
/// The writing end of a connection. It must be flushed after a write, because it may buffer encrypted or sealed data.
#[cfg(not(feature = "zenoh"))]
pub(crate) type WriteEnd = BareWriteEnd;

/// The reading end of a connection.
#[cfg(feature = "zenoh")]
pub(crate) type ReadEnd = Either<BareReadEnd, Stream>;
/// The writing end of a connection. It must be flushed after a write, because it may buffer encrypted or sealed data.
#[cfg(feature = "zenoh")]
pub(crate) type WriteEnd = Either<BareWriteEnd, Stream>;

/// A text published for several robots. Without Zenoh, no value of this type exists.
#[cfg(not(feature = "zenoh"))]
#[derive(Debug)]
pub(crate) enum Text {}

#[cfg(not(feature = "zenoh"))]
impl Text {
    pub(crate) const fn len(&self) -> usize {
        match *self {}
    }
}

/// The transport and address of one robot.
#[derive(Clone, Debug)]
pub(crate) enum Reach {
    /// The robot listens on TCP.
    Tcp { host: String, port: u16, security: Security },
    /// The robot is reached through a key of a Zenoh network.
    #[cfg(feature = "zenoh")]
    Zenoh { network: Network, key: Key },
}

/// The purpose of a connection to a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose<'a> {
    /// A link for all messages of a mission. `audiences` are the numbers of the robot's audiences. An audience is a set of robots for
    /// which a script is published once.
    Link { audiences: &'a [u32] },
    /// A separate connection for a stop, so that no other message delays it.
    Stop,
}

pub(crate) type Ends = ((ReadEnd, WriteEnd), Option<Met>);

impl Reach {
    pub(crate) async fn connect(&self, purpose: Purpose<'_>) -> io::Result<Ends> {
        // TCP connections do not depend on the purpose.
        #[cfg(not(feature = "zenoh"))]
        let _alike = purpose;
        match self {
            Self::Tcp { host, port, security } => {
                over(TcpStream::connect((host.as_str(), *port)).await?, security).await
            }
            #[cfg(feature = "zenoh")]
            Self::Zenoh { network, key } => {
                use downbeat_robot::zenoh::{Urgency, connect, connect_sharing};
                let connected = match purpose {
                    Purpose::Link { audiences } => connect_sharing(network, key, audiences).await,
                    Purpose::Stop => connect(network, key, Urgency::Stop).await,
                };
                let (reader, writer) = connected?.split();
                Ok(((Either::Right(reader), Either::Right(writer)), None))
            }
        }
    }
}

/// Writes the messages of a batch and flushes.
pub(crate) async fn write_out(writer: &mut WriteEnd, batch: &Batch) -> io::Result<()> {
    #[cfg(feature = "zenoh")]
    if let Either::Right(stream) = writer {
        return stream.write_with(batch.bytes(), batch.texts()).await;
    }
    // Only a Zenoh stream offers texts, so the batch contains none here.
    writer.write_all(batch.bytes()).await?;
    writer.flush().await
}

/// Publishes a script once for an audience, a set of robots, and returns the published text. Returns `None` if the script must be written
/// to each robot instead.
#[cfg(feature = "zenoh")]
pub(crate) fn offer(writer: &WriteEnd, audience: u32, script: &Script) -> Option<Text> {
    let Either::Right(stream) = writer else { return None };
    let text = || serde_json::to_vec(script).unwrap_or_default();
    stream.offer(audience, Command::Script(script.clone()).content_hash(), text)
}

/// Publishes a script once for an audience, a set of robots, and returns the published text. Without Zenoh, always returns `None`, so the
/// script is written to each robot instead.
#[cfg(not(feature = "zenoh"))]
pub(crate) const fn offer(_: &WriteEnd, _: u32, _: &Script) -> Option<Text> {
    None
}

/// Adds TLS or authenticated records to an established TCP connection, as `security` requires.
pub(crate) async fn over(stream: TcpStream, security: &Security) -> io::Result<Ends> {
    let ((reader, writer), met) = secured(stream, security).await?;
    #[cfg(feature = "zenoh")]
    let (reader, writer) = (Either::Left(reader), Either::Left(writer));
    Ok(((reader, writer), met))
}

impl fmt::Display for Reach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp { host, port, .. } => write!(f, "{host}:{port}"),
            #[cfg(feature = "zenoh")]
            Self::Zenoh { key, .. } => write!(f, "zenoh:{key}"),
        }
    }
}
