//! By which way a robot that listens is connected to: all that the bytes of a link come and go by.

use std::fmt;
use std::io;

#[cfg(feature = "zenoh")]
use downbeat_robot::zenoh::{Key, Network, Stream};
#[cfg(feature = "zenoh")]
use tokio::io::{ReadHalf, WriteHalf};
use tokio::net::TcpStream;
#[cfg(feature = "zenoh")]
use tokio_util::either::Either;

use super::Security;
use super::secure::{BareReadEnd, BareWriteEnd, Met, secured};

/// The end of a connection from which is read.
#[cfg(not(feature = "zenoh"))]
pub(crate) type ReadEnd = BareReadEnd;
/// The end of a connection to which is written, and then flushed: what is encrypted or sealed may wait in it.
#[cfg(not(feature = "zenoh"))]
pub(crate) type WriteEnd = BareWriteEnd;

/// The end of a connection from which is read.
#[cfg(feature = "zenoh")]
pub(crate) type ReadEnd = Either<BareReadEnd, ReadHalf<Stream>>;
/// The end of a connection to which is written, and then flushed: what is encrypted or sealed may wait in it.
#[cfg(feature = "zenoh")]
pub(crate) type WriteEnd = Either<BareWriteEnd, WriteHalf<Stream>>;

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
pub(crate) enum Purpose {
    /// All that a mission says.
    Link,
    /// A stop, which nothing else may keep waiting.
    Stop,
}

pub(crate) type Ends = ((ReadEnd, WriteEnd), Option<Met>);

impl Reach {
    pub(crate) async fn connect(&self, purpose: Purpose) -> io::Result<Ends> {
        // Over TCP all go the same way.
        #[cfg(not(feature = "zenoh"))]
        let _alike = purpose;
        match self {
            Self::Tcp { host, port, security } => {
                over(TcpStream::connect((host.as_str(), *port)).await?, security).await
            }
            #[cfg(feature = "zenoh")]
            Self::Zenoh { network, key } => {
                use downbeat_robot::zenoh::{Haste, connect};
                let haste = match purpose {
                    Purpose::Link => Haste::None,
                    Purpose::Stop => Haste::Stop,
                };
                let (reader, writer) = tokio::io::split(connect(network, key, haste).await?);
                Ok(((Either::Right(reader), Either::Right(writer)), None))
            }
        }
    }
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
