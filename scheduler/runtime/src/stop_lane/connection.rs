//! A connection of the stop lane (the thread that only stops robots) to one robot. It is kept open for a possible stop.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use downbeat_robot::{LinkEvent, RobotLink};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use urrcp::{AvailabilityRequest, Decoder, Message, encode_as};

use crate::link::{Budget, Endpoint, LinkEncoding, ReadEnd, SharedAllowance, WriteEnd, over};
#[cfg(feature = "zenoh")]
use crate::link::{Purpose, Reach};
use crate::server_clock::ServerClock;
use downbeat_mission::session;

const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Interval between requests that check an idle connection. It is well below 30 s, after which a robot closes a silent connection if
/// others wait.
const ASK_EVERY: Duration = Duration::from_secs(10);
/// Maximum time for the response to a request that checks an idle connection.
const ANSWERS_WITHIN: Duration = Duration::from_secs(3);

/// A connection of the stop lane to a robot.
pub(super) enum Connection {
    InProcess(RobotLink),
    Bytes(Box<Bytes>),
}

/// A byte stream, over TCP or through a Zenoh network.
pub(super) struct Bytes {
    reader: ReadEnd,
    writer: WriteEnd,
    encoding: LinkEncoding,
    decoder: Decoder,
    bytes: Vec<u8>,
    clock: ServerClock,
    asked: SharedAllowance,
    budget: Budget,
    /// Whether the last message was written only in part, so that the robot cannot decode further messages.
    torn: bool,
}

impl Connection {
    /// Connects to the robot. `known` is the robot's resolved address, so that a stop does not wait for a name server.
    pub(super) async fn open(
        endpoint: &Endpoint,
        clock: ServerClock,
        asked: &SharedAllowance,
        known: &mut Option<SocketAddr>,
    ) -> io::Result<Self> {
        match endpoint {
            Endpoint::InProcess { host, index } => {
                let gone = || io::Error::other("the robot in this process is no longer running");
                host.connect(*index).map(Self::InProcess).ok_or_else(gone)
            }
            Endpoint::Tcp { host, port, encoding, security } => {
                let connect = async {
                    let stream = match known {
                        Some(address) => TcpStream::connect(*address).await,
                        None => TcpStream::connect((host.as_str(), *port)).await,
                    }?;
                    *known = stream.peer_addr().ok();
                    over(stream, security).await
                };
                let ((reader, writer), _) = tokio::time::timeout(CONNECT_TIMEOUT, connect).await??;
                Ok(Self::of(reader, writer, encoding, clock, asked))
            }
            #[cfg(feature = "zenoh")]
            Endpoint::Zenoh { network, key, encoding } => {
                let reach = Reach::Zenoh { network: network.clone(), key: key.clone() };
                let connect = reach.connect(Purpose::Stop);
                let ((reader, writer), _) = tokio::time::timeout(CONNECT_TIMEOUT, connect).await??;
                Ok(Self::of(reader, writer, encoding, clock, asked))
            }
        }
    }

    fn of(
        reader: ReadEnd,
        writer: WriteEnd,
        encoding: &LinkEncoding,
        clock: ServerClock,
        asked: &SharedAllowance,
    ) -> Self {
        Self::Bytes(Box::new(Bytes {
            reader,
            writer,
            encoding: encoding.clone(),
            decoder: Decoder::default(),
            bytes: vec![0; 8 * 1024],
            clock,
            asked: asked.clone(),
            budget: Budget::new(asked.clone()),
            torn: false,
        }))
    }

    /// Sends all messages in one write.
    pub(super) async fn send(&mut self, messages: impl Iterator<Item = &Message>) -> io::Result<()> {
        match self {
            Self::InProcess(link) => {
                messages.for_each(|message| link.send(message.clone()));
                Ok(())
            }
            Self::Bytes(bytes) => bytes.send(messages).await,
        }
    }

    /// Returns the robot's next message, or `None` once the connection has ended.
    pub(super) async fn next(&mut self) -> Option<Message> {
        match self {
            Self::InProcess(link) => match link.recv().await? {
                LinkEvent::Message(message) => Some(message),
                LinkEvent::Closed => None,
            },
            Self::Bytes(bytes) => bytes.next().await,
        }
    }

    /// Checks the connection with requests at regular intervals. Returns once the robot does not answer one or the connection ends.
    pub(super) async fn stay(&mut self) {
        // Because it contains no session, the request does not claim the robot and renews no lease.
        let ask = Message::AvailabilityRequest(AvailabilityRequest {
            timestamp: None,
            session: None,
            seize: false,
            revocation_list: None,
        });
        loop {
            let asked = self.send(std::iter::once(&ask)).await.is_ok();
            let answered = async { asked && self.next().await.is_some() };
            if !matches!(tokio::time::timeout(ANSWERS_WITHIN, answered).await, Ok(true)) {
                return;
            }
            // Messages in the meantime are discarded.
            let ended = async { while self.next().await.is_some() {} };
            if tokio::time::timeout(ASK_EVERY, ended).await.is_ok() {
                return;
            }
        }
    }
}

impl Bytes {
    async fn send(&mut self, messages: impl Iterator<Item = &Message>) -> io::Result<()> {
        if std::mem::replace(&mut self.torn, true) {
            return Err(io::Error::other("only part of the last message was sent"));
        }
        let mut bytes = Vec::new();
        for message in messages {
            let before = bytes.len();
            encode_as(self.encoding.current(), message, &mut bytes);
            self.asked.note(message, bytes.len() - before);
        }
        self.writer.write_all(&bytes).await?;
        self.writer.flush().await?;
        self.torn = false;
        Ok(())
    }

    /// Returns the next message. Returns `None` once the connection has ended, or if the robot sends more than requested and the
    /// connection must be closed.
    async fn next(&mut self) -> Option<Message> {
        loop {
            let decoded = self.decoder.next_message();
            if decoded.is_some() {
                self.budget.take_message().ok()?;
            }
            match decoded {
                Some(Ok(message)) if !self.budget.passes(&message) => {}
                Some(Ok(message)) => return Some(session::told_without_keys(message)),
                Some(Err(error)) => {
                    tracing::debug!("unreadable message on the connection for stops: {error}")
                }
                None => {
                    // The task yields, so that a robot that sends a lot does not starve others.
                    tokio::task::yield_now().await;
                    match self.reader.read(&mut self.bytes).await {
                        Ok(0) | Err(_) => return None,
                        Ok(came) => {
                            self.budget.take_bytes(self.clock.now(), came).ok()?;
                            self.decoder.push(&self.bytes[..came]);
                        }
                    }
                }
            }
        }
    }
}
