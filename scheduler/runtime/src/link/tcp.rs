//! Messages over TCP or another byte stream: the robot listens, and the scheduler connects.

use std::io::{self, ErrorKind};
use std::time::Duration;

use downbeat_scripts::{Attempt, Refusal};
use tokio::io::AsyncReadExt;
use tokio::sync::mpsc;
use urrcp::{Decoder, Encoding, Message, Script, Server, Span, Timestamp};

use super::batch::Batch;
use super::reach::{offer, write_out};
use super::{Budget, EventSink, Outgoing, Peer, Purpose, Queue, ReadEnd, WriteEnd, denial};
use crate::server_clock::ServerClock;
use downbeat_mission::{Event, Loss};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// How long to wait for responses on the separate connection of a stop.
const OVERTAKING_LISTENS: Duration = Duration::from_secs(10);
/// Number of bytes collected before one write, so that a burst of requests takes one system call.
const WRITE_BATCH: usize = 64 * 1024;

/// Connects to the robot and carries messages in both directions until either side closes.
pub(super) async fn carry(peer: Peer, queue: Queue) {
    let Peer { sink, reach, .. } = &peer;
    let connecting = reach.connect(Purpose::Link { audiences: peer.of.shared.audiences() });
    let ((reader, writer), met) = match tokio::time::timeout(CONNECT_TIMEOUT, connecting).await {
        Ok(Ok(ends)) => ends,
        Ok(Err(error)) => {
            if let Some(denial) = denial(&error) {
                return sink.down(Loss::Denied, format!("no connection to {reach}: {denial}")).await;
            }
            let loss = match error.kind() {
                ErrorKind::ConnectionRefused => Loss::Refused,
                _ => Loss::Unreachable,
            };
            let refusal = Refusal::of(Attempt::Connect, &error);
            return sink.down(loss, format!("no connection to {reach}: {refusal}")).await;
        }
        Err(_) => {
            let refusal = Refusal::of(Attempt::Connect, &ErrorKind::TimedOut.into());
            let reason = format!("no connection to {reach} within 3 s: {refusal}");
            return sink.down(Loss::Unreachable, reason).await;
        }
    };
    if let Some(met) = met {
        let until = met.until.map(|until| Timestamp::from_nanos(until.saturating_mul(1_000_000_000)));
        let is_of_replaced_authority = met.is_of_replaced_authority;
        sink.put(Event::Proven { robot: sink.robot, until, is_of_replaced_authority }).await;
    }
    sink.up().await;
    let reason = tokio::select! {
        reason = read(&peer, reader) => Some(reason),
        reason = write(writer, queue, &peer) => reason,
    };
    if let Some(reason) = reason {
        sink.down(reason.0, reason.1).await;
    }
}

/// Delay before an invalid line is reported. If the robot floods its link with invalid lines in this time, only the flooding is reported.
const GARBLED_AFTER: Span = Span::from_millis(50);

/// Invalid lines whose report is delayed; each is stored as a description of its fault.
#[derive(Debug, Default)]
struct Garbled {
    reasons: Vec<String>,
    until: Option<Timestamp<Server>>,
}

impl Garbled {
    fn hold(&mut self, now: Timestamp<Server>, reason: String) {
        self.until.get_or_insert(now + GARBLED_AFTER);
        self.reasons.push(reason);
    }

    async fn tell(&mut self, sink: &EventSink) {
        self.until = None;
        for reason in self.reasons.drain(..) {
            sink.put(Event::Garbled { robot: sink.robot, reason }).await;
        }
    }
}

/// Reads the robot's messages until the connection ends. Returns why it ended.
async fn read(peer: &Peer, mut reader: ReadEnd) -> (Loss, String) {
    let sink = &peer.sink;
    let mut decoder = Decoder::default().that_knows(peer.sent.clone());
    let mut budget = Budget::new(peer.of.asked.clone());
    let mut bytes = vec![0; 8 * 1024];
    let mut garbled = Garbled::default();
    loop {
        let left = garbled.until.map(|until| until - sink.clock.now());
        if left.is_some_and(|left| left <= Span::ZERO) {
            garbled.tell(sink).await;
            continue;
        }
        let read = reader.read(&mut bytes);
        let read = match left {
            None => read.await,
            Some(left) => match tokio::time::timeout(left.to_duration(), read).await {
                Ok(read) => read,
                Err(_) => continue,
            },
        };
        let came = match read {
            Ok(came @ 1..) => came,
            ended_or_failed => {
                garbled.tell(sink).await;
                return match ended_or_failed {
                    Err(error) => ended(&error),
                    Ok(_) => (Loss::Closed, "the robot closed the connection".to_owned()),
                };
            }
        };
        if let Err(loss) = budget.take_bytes(sink.clock.now(), came) {
            return flooding(loss);
        }
        if budget.is_sifted() {
            // The task yields, so that a robot that sends a lot does not starve others.
            tokio::task::yield_now().await;
        }
        decoder.push(&bytes[..came]);
        let mut held = decoder.buffered();
        while let Some(decoded) = decoder.next_message() {
            if let Err(loss) = budget.take_message() {
                return flooding(loss);
            }
            let length = held.saturating_sub(decoder.buffered());
            held = decoder.buffered();
            match decoded {
                Ok(message) if !budget.passes(&message) => {}
                Err(_) if budget.is_sifted() => {}
                Ok(message) => {
                    garbled.tell(sink).await;
                    peer.encoding.hear(&message);
                    sink.received(message, length).await;
                }
                Err(error) => garbled.hold(sink.clock.now(), error.to_string()),
            }
        }
    }
}

fn flooding(loss: Loss) -> (Loss, String) {
    (loss, "the robot is sending far more data than requested".to_owned())
}

/// Writes queued messages to the robot. Returns the reason if writing fails, or `None` once the mission has dropped the link.
async fn write(mut writer: WriteEnd, mut queue: Queue, peer: &Peer) -> Option<(Loss, String)> {
    let clock: &ServerClock = &peer.sink.clock;
    let mut long_until: Option<Timestamp<Server>> = None;
    while let Some((message, urgent)) = queue.next().await {
        // The robot may still be reading a long upload when a stop comes, so the stop is sent on a separate connection.
        if urgent && long_until.is_some_and(|until| clock.now() < until) {
            peer.overtake(&message, &mut queue.urgent);
            continue;
        }
        let encoding = peer.encoding.current();
        // The batch is not reused for the next write, because thousands of links may be idle.
        let mut batch = Batch::default();
        peer.encode(encoding, &message, &mut batch, &writer);
        while batch.len() < WRITE_BATCH {
            let Some(message) = queue.try_next() else { break };
            peer.encode(encoding, &message, &mut batch, &writer);
        }
        if batch.len() >= WRITE_BATCH {
            long_until = Some(clock.now() + peer.of.long_upload.0);
        }
        {
            let mut write = std::pin::pin!(write_out(&mut writer, &batch));
            loop {
                tokio::select! {
                    written = &mut write => match written {
                        Ok(()) => break,
                        Err(error) => return Some(ended(&error)),
                    },
                    Some(first) = queue.urgent.recv() => peer.overtake(&first, &mut queue.urgent),
                }
            }
        }
    }
    None
}

/// Classifies the error that ended an established connection.
fn ended(error: &io::Error) -> (Loss, String) {
    if let Some(denial) = denial(error) {
        // Data that was altered on its way shows nothing about the robot.
        let is_altered = !matches!(tls_error(error), None | Some(rustls::Error::AlertReceived(_)));
        return (if is_altered { Loss::Unreachable } else { Loss::Denied }, denial);
    }
    let loss = match error.kind() {
        ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted | ErrorKind::BrokenPipe => Loss::Closed,
        _ => Loss::Unreachable,
    };
    (loss, error.to_string())
}

fn tls_error(error: &io::Error) -> Option<&rustls::Error> {
    error.get_ref()?.downcast_ref()
}

impl Peer {
    /// Appends a message to the batch and permits the robot's responses to it.
    fn encode(&self, encoding: Encoding, message: &Message, batch: &mut Batch, writer: &WriteEnd) {
        let shared = |script: &Script| offer(writer, self.of.shared.audience(script)?, script);
        let bytes = batch.push(encoding, message, shared);
        self.of.asked.note(message, bytes);
        if let Message::ControlRequest(request) = message {
            self.sent.note(request);
        }
    }

    /// Like [`Peer::encode`], but for a stop, whose script is never published for several robots.
    fn encode_stop(&self, encoding: Encoding, message: &Message, batch: &mut Batch) {
        let bytes = batch.push(encoding, message, |_| None);
        self.of.asked.note(message, bytes);
    }

    /// Sends all urgent messages on a separate connection and forwards the responses that arrive on it. A message may be sent twice; the
    /// robot recognizes the duplicate by its id.
    fn overtake(&self, first: &Message, more: &mut mpsc::UnboundedReceiver<Outgoing>) {
        let mut batch = Batch::default();
        let encoding = self.encoding.current();
        self.encode_stop(encoding, first, &mut batch);
        while let Ok(message) = more.try_recv() {
            self.encode_stop(encoding, &message, &mut batch);
        }
        let mut peer = self.clone();
        peer.sink.link = None;
        // The task ends when the robot closes the connection, or after `OVERTAKING_LISTENS`, when no response is expected any longer.
        tokio::spawn(async move {
            let connected = tokio::time::timeout(CONNECT_TIMEOUT, peer.reach.connect(Purpose::Stop)).await;
            let Ok(Ok(((reader, mut writer), _))) = connected else { return };
            if let Err(error) = write_out(&mut writer, &batch).await {
                return tracing::debug!("cannot send the stop on a separate connection: {error}");
            }
            let _robot_closed = tokio::time::timeout(OVERTAKING_LISTENS, read(&peer, reader)).await;
        });
    }
}

#[cfg(test)]
mod tests;
