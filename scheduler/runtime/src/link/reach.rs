//! By which way a robot that listens is connected to: all that the bytes of a link come and go by.

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

/// The end of a connection from which is read.
#[cfg(not(feature = "zenoh"))]
pub(crate) type ReadEnd = BareReadEnd;
/// The end of a connection to which is written, and then flushed: what is encrypted or sealed may wait in it.
#[cfg(not(feature = "zenoh"))]
pub(crate) type WriteEnd = BareWriteEnd;

/// The end of a connection from which is read.
#[cfg(feature = "zenoh")]
pub(crate) type ReadEnd = Either<BareReadEnd, Stream>;
/// The end of a connection to which is written, and then flushed: what is encrypted or sealed may wait in it.
#[cfg(feature = "zenoh")]
pub(crate) type WriteEnd = Either<BareWriteEnd, Stream>;

/// What was published for several robots: nothing, without Zenoh.
#[cfg(not(feature = "zenoh"))]
#[derive(Debug)]
pub(crate) enum Text {}

#[cfg(not(feature = "zenoh"))]
impl Text {
    pub(crate) const fn len(&self) -> usize {
        match *self {}
    }
}

/// A way to one robot.
#[derive(Clone, Debug)]
pub(crate) enum Reach {
    /// It listens on TCP.
    Tcp { host: String, port: u16, security: Security },
    /// It is at a key.
    #[cfg(feature = "zenoh")]
    Zenoh { network: Network, key: Key },
}

/// What a connection is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose<'a> {
    /// All that a mission says; some of it is published for these audiences, to which the robot belongs.
    Link { audiences: &'a [u32] },
    /// A stop, which nothing else may keep waiting.
    Stop,
}

pub(crate) type Ends = ((ReadEnd, WriteEnd), Option<Met>);

impl Reach {
    pub(crate) async fn connect(&self, purpose: Purpose<'_>) -> io::Result<Ends> {
        // Over TCP all go the same way.
        #[cfg(not(feature = "zenoh"))]
        let _alike = purpose;
        match self {
            Self::Tcp { host, port, security } => {
                over(TcpStream::connect((host.as_str(), *port)).await?, security).await
            }
            #[cfg(feature = "zenoh")]
            Self::Zenoh { network, key } => {
                use downbeat_robot::zenoh::{Haste, connect, connect_sharing};
                let connected = match purpose {
                    Purpose::Link { audiences } => connect_sharing(network, key, audiences).await,
                    Purpose::Stop => connect(network, key, Haste::Stop).await,
                };
                let (reader, writer) = connected?.split();
                Ok(((Either::Right(reader), Either::Right(writer)), None))
            }
        }
    }
}

/// Writes messages, and then flushes.
pub(crate) async fn write_out(writer: &mut WriteEnd, batch: &Batch) -> io::Result<()> {
    #[cfg(feature = "zenoh")]
    if let Either::Right(stream) = writer {
        return stream.write_with(batch.bytes(), batch.texts()).await;
    }
    // A text is put in only where it was offered by a stream of Zenoh.
    writer.write_all(batch.bytes()).await?;
    writer.flush().await
}

/// Publishes a script for an audience, once; `None` where it has to be written to each robot.
#[cfg(feature = "zenoh")]
pub(crate) fn offer(writer: &WriteEnd, audience: u32, script: &Script) -> Option<Text> {
    let Either::Right(stream) = writer else { return None };
    let text = || serde_json::to_vec(script).unwrap_or_default();
    stream.offer((audience, Command::Script(script.clone()).content_hash()), text)
}

/// Publishes a script for an audience, once; `None` where it has to be written to each robot.
#[cfg(not(feature = "zenoh"))]
pub(crate) const fn offer(_: &WriteEnd, _: u32, _: &Script) -> Option<Text> {
    None
}

/// The same over a connection that is made.
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
