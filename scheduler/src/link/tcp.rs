//! Messages over TCP: the robot listens, the scheduler connects.

use std::io::{self, ErrorKind};
use std::time::Duration;

use downbeat_scripts::{Attempt, Refusal};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::mpsc;
use urrcp::{Decoder, Message, Server, Span, Timestamp, encode_as};

use super::{Peer, Queue};
use crate::mission::{Event, Loss};
use crate::server_clock::ServerClock;

const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// After this many bytes as one batch has the robot may be busy reading for this long.
const LONG_UPLOAD: Span = Span::from_millis(2_000);
/// For how long answers to an overtaking stop are awaited.
const OVERTAKING_LISTENS: Duration = Duration::from_secs(10);
/// Bytes gathered before one write, so that a burst of requests is one system call.
const WRITE_BATCH: usize = 64 * 1024;

/// Connects and carries messages both ways until either side closes.
pub(super) async fn carry(peer: Peer, queue: Queue) {
    let Peer { sink, host, port, .. } = &peer;
    let (host, port) = (host.as_str(), *port);
    let stream = match tokio::time::timeout(CONNECT_TIMEOUT, TcpStream::connect((host, port))).await {
        Ok(Ok(stream)) => stream,
        Ok(Err(error)) => {
            let loss = match error.kind() {
                ErrorKind::ConnectionRefused => Loss::Refused,
                _ => Loss::Unreachable,
            };
            let refusal = Refusal::of(Attempt::Connect, &error);
            return sink.down(loss, format!("no connection to {host}:{port}: {refusal}")).await;
        }
        Err(_) => {
            let refusal = Refusal::of(Attempt::Connect, &ErrorKind::TimedOut.into());
            let reason = format!("no connection to {host}:{port} within 3 s: {refusal}");
            return sink.down(Loss::Unreachable, reason).await;
        }
    };
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!("TCP_NODELAY: {error}");
    }
    let (reader, writer) = stream.into_split();
    sink.up().await;
    let reason = tokio::select! {
        reason = read(&peer, reader) => Some(reason),
        reason = write(writer, queue, &peer) => reason,
    };
    if let Some(reason) = reason {
        sink.down(reason.0, reason.1).await;
    }
}

/// Ends with the reason for which no more can be read.
async fn read(peer: &Peer, mut reader: OwnedReadHalf) -> (Loss, String) {
    let sink = &peer.sink;
    let mut decoder = Decoder::default();
    let mut bytes = vec![0; 8 * 1024];
    loop {
        match reader.read(&mut bytes).await {
            Ok(0) => return (Loss::Closed, "the robot closed the connection".to_owned()),
            Ok(n) => decoder.push(&bytes[..n]),
            Err(error) => return ended(&error),
        }
        while let Some(decoded) = decoder.next_message() {
            match decoded {
                Ok(message) => {
                    peer.encoding.hear(&message);
                    sink.received(message).await;
                }
                Err(error) => {
                    sink.put(Event::Garbled { robot: sink.robot, reason: error.to_string() }).await;
                }
            }
        }
    }
}

/// Ends with a reason when writing fails, without one when the mission has let go of the link.
async fn write(mut writer: OwnedWriteHalf, mut queue: Queue, peer: &Peer) -> Option<(Loss, String)> {
    let mut bytes = Vec::new();
    let clock: &ServerClock = &peer.sink.clock;
    let mut long_until: Option<Timestamp<Server>> = None;
    while let Some((message, urgent)) = queue.next().await {
        // Behind a long upload the robot may still be reading when a stop comes: that goes by a connection of its own.
        if urgent && long_until.is_some_and(|until| clock.now() < until) {
            peer.overtake(&message, &mut queue.urgent);
            continue;
        }
        let encoding = peer.encoding.current();
        encode_as(encoding, &message, &mut bytes);
        while bytes.len() < WRITE_BATCH {
            let Some(message) = queue.try_next() else { break };
            encode_as(encoding, &message, &mut bytes);
        }
        if bytes.len() >= WRITE_BATCH {
            long_until = Some(clock.now() + LONG_UPLOAD);
        }
        let mut write = std::pin::pin!(writer.write_all(&bytes));
        loop {
            tokio::select! {
                written = &mut write => match written {
                    Ok(()) => break,
                    Err(error) => return Some(ended(&error)),
                },
                Some(first) = queue.urgent.recv() => peer.overtake(&first, &mut queue.urgent),
            }
        }
        bytes.clear();
    }
    None
}

/// What the error of an established connection says.
fn ended(error: &io::Error) -> (Loss, String) {
    let loss = match error.kind() {
        ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted | ErrorKind::BrokenPipe => Loss::Closed,
        _ => Loss::Unreachable,
    };
    (loss, error.to_string())
}

impl Peer {
    /// Sends all that is urgent by a connection of its own, and hands on what is answered there. What it carries may be
    /// carried twice: the robot knows it by its id.
    fn overtake(&self, first: &Message, more: &mut mpsc::UnboundedReceiver<Message>) {
        let mut bytes = Vec::new();
        let encoding = self.encoding.current();
        encode_as(encoding, first, &mut bytes);
        while let Ok(message) = more.try_recv() {
            encode_as(encoding, &message, &mut bytes);
        }
        let mut peer = self.clone();
        peer.sink.link = None;
        // Ends when the robot closes, or when no request can be waiting for its answers any more.
        tokio::spawn(async move {
            let stream = TcpStream::connect((peer.host.as_str(), peer.port));
            let Ok(Ok(stream)) = tokio::time::timeout(CONNECT_TIMEOUT, stream).await else { return };
            let _slower_then = stream.set_nodelay(true);
            let (reader, mut writer) = stream.into_split();
            if let Err(error) = writer.write_all(&bytes).await {
                return tracing::debug!("the stop that overtakes: {error}");
            }
            let _robot_closed = tokio::time::timeout(OVERTAKING_LISTENS, read(&peer, reader)).await;
        });
    }
}

#[cfg(test)]
mod tests;
