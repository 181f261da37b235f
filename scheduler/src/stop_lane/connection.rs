//! A connection of the lane with one robot, kept for a stop.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use downbeat_robot::{LinkEvent, RobotLink};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use urrcp::{AvailabilityRequest, Decoder, Message, encode_as};

use crate::link::{Endpoint, LinkEncoding};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// How often a connection that is kept is asked for a sign of life: well within the 30 s after which robots let go of a
/// silent one where others wait.
const ASK_EVERY: Duration = Duration::from_secs(10);
/// How long the answer may take.
const ANSWERS_WITHIN: Duration = Duration::from_secs(3);

/// A way to a robot.
pub(super) enum Connection {
    InProcess(RobotLink),
    Tcp(Box<Tcp>),
}

pub(super) struct Tcp {
    stream: TcpStream,
    encoding: LinkEncoding,
    decoder: Decoder,
    bytes: Vec<u8>,
    /// Something was written in part, so that what follows would not be understood.
    torn: bool,
}

impl Connection {
    /// Connects. `known` is the robot's address, once it has been resolved: a stop must not wait for a name server.
    pub(super) async fn open(endpoint: &Endpoint, known: &mut Option<SocketAddr>) -> io::Result<Self> {
        match endpoint {
            Endpoint::InProcess { host, index } => {
                let gone = || io::Error::other("the robot in this process is gone");
                host.connect(*index).map(Self::InProcess).ok_or_else(gone)
            }
            Endpoint::Tcp { host, port, encoding } => {
                let connect = async {
                    match known {
                        Some(address) => TcpStream::connect(*address).await,
                        None => TcpStream::connect((host.as_str(), *port)).await,
                    }
                };
                let stream = tokio::time::timeout(CONNECT_TIMEOUT, connect).await??;
                *known = stream.peer_addr().ok();
                stream.set_nodelay(true)?;
                let (decoder, bytes) = (Decoder::default(), vec![0; 8 * 1024]);
                Ok(Self::Tcp(Box::new(Tcp {
                    stream,
                    encoding: encoding.clone(),
                    decoder,
                    bytes,
                    torn: false,
                })))
            }
        }
    }

    /// Writes all of them at once.
    pub(super) async fn send(&mut self, messages: impl Iterator<Item = &Message>) -> io::Result<()> {
        match self {
            Self::InProcess(link) => {
                messages.for_each(|message| link.send(message.clone()));
                Ok(())
            }
            Self::Tcp(tcp) => tcp.send(messages).await,
        }
    }

    /// What the robot says next; `None` once the connection has ended.
    pub(super) async fn next(&mut self) -> Option<Message> {
        match self {
            Self::InProcess(link) => match link.recv().await? {
                LinkEvent::Message(message) => Some(message),
                LinkEvent::Closed => None,
            },
            Self::Tcp(tcp) => tcp.next().await,
        }
    }

    /// Asks for signs of life until there is none.
    pub(super) async fn stay(&mut self) {
        // Without a session it claims nothing and renews no lease.
        let ask = Message::AvailabilityRequest(AvailabilityRequest { timestamp: None, session: None });
        loop {
            let asked = self.send(std::iter::once(&ask)).await.is_ok();
            let answered = async { asked && self.next().await.is_some() };
            if !matches!(tokio::time::timeout(ANSWERS_WITHIN, answered).await, Ok(true)) {
                return;
            }
            // What it says meanwhile is not asked for.
            let ended = async { while self.next().await.is_some() {} };
            if tokio::time::timeout(ASK_EVERY, ended).await.is_ok() {
                return;
            }
        }
    }
}

impl Tcp {
    async fn send(&mut self, messages: impl Iterator<Item = &Message>) -> io::Result<()> {
        if std::mem::replace(&mut self.torn, true) {
            return Err(io::Error::other("the last message was written in part"));
        }
        let mut bytes = Vec::new();
        messages.for_each(|message| encode_as(self.encoding.current(), message, &mut bytes));
        self.stream.write_all(&bytes).await?;
        self.torn = false;
        Ok(())
    }

    async fn next(&mut self) -> Option<Message> {
        loop {
            match self.decoder.next_message() {
                Some(Ok(message)) => return Some(message),
                Some(Err(error)) => tracing::debug!("on the connection for stops: {error}"),
                None => {
                    // However much one robot says, the others have their turn.
                    tokio::task::yield_now().await;
                    match self.stream.read(&mut self.bytes).await {
                        Ok(0) | Err(_) => return None,
                        Ok(n) => self.decoder.push(&self.bytes[..n]),
                    }
                }
            }
        }
    }
}
