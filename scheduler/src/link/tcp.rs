//! Messages over TCP: the robot listens, the scheduler connects.

use std::io::{self, ErrorKind};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::mpsc;
use urrcp::{Decoder, Message, Server, Span, Timestamp, encode_as};

use super::{Peer, Queue};
use crate::mission::{Event, Loss};
use crate::server_clock::ServerClock;

const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// After so many bytes as one batch has the robot may be busy reading for so long.
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
            return sink.down(loss, format!("no connection to {host}:{port}: {error}")).await;
        }
        Err(_) => {
            let reason = format!("no connection to {host}:{port} within 3 s");
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
                    peer.speech.hear(&message);
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
        let encoding = peer.speech.encoding();
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
        let encoding = self.speech.encoding();
        encode_as(encoding, first, &mut bytes);
        while let Ok(message) = more.try_recv() {
            encode_as(encoding, &message, &mut bytes);
        }
        let peer = self.clone();
        // Ends when the robot closes, or when nobody can be waiting for its answers any more.
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
mod tests {
    use tokio::io::AsyncBufReadExt;
    use urrcp::{Command, ControlRequest, Script};

    use super::*;
    use crate::link::{Endpoint, Link, Speech};

    #[tokio::test]
    async fn a_stop_never_waits_behind_an_upload_that_the_robot_does_not_read() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let (events, _happened) = mpsc::channel(64);
        let clock = ServerClock::anchored(Span::ZERO);
        let endpoint = Endpoint::Tcp { host: "127.0.0.1".into(), port, speech: Speech::default() };
        let link = Link::open(0, endpoint, clock, events, Duration::ZERO);
        let (_unread, _) = listener.accept().await.unwrap();
        let stop = |device: String| {
            let request =
                ControlRequest::immediate(device.parse().unwrap(), Command::Script(Script::cancel()));
            Message::ControlRequest(request)
        };
        // Far more than any socket buffers.
        for _ in 0..39_000 {
            link.send(stop("x".repeat(250)), false);
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
        link.send(stop("arm".to_owned()), true);
        let (second, _) =
            tokio::time::timeout(Duration::from_secs(5), listener.accept()).await.unwrap().unwrap();
        let line = tokio::io::BufReader::new(second).lines().next_line().await.unwrap().unwrap();
        assert!(line.contains(r#""device_id":"arm""#), "{line}");
    }

    /// What comes of a robot that writes these bytes, and of another that behaves.
    async fn events_of(bytes: Vec<u8>, count: usize) -> Vec<Event> {
        let clock = ServerClock::anchored(Span::ZERO);
        let (events, mut happened) = mpsc::channel(64);
        let mut links = Vec::new();
        for (robot, bytes) in [bytes, b"{\"initialization_request\":{}}\n".to_vec()].into_iter().enumerate() {
            let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
            let port = listener.local_addr().unwrap().port();
            let endpoint = Endpoint::Tcp { host: "127.0.0.1".into(), port, speech: Speech::default() };
            links.push(Link::open(robot, endpoint, clock, events.clone(), Duration::ZERO));
            // Ends when the link is dropped, at the end of the test.
            tokio::spawn(async move {
                let (mut stream, _) = listener.accept().await.unwrap();
                let _hung_up = stream.write_all(&bytes).await;
                let _until_dropped = stream.read(&mut [0]).await;
            });
        }
        let (mut of_hostile, mut of_other) = (Vec::new(), 0);
        while of_hostile.len() < count || of_other < 2 {
            let (_, event) =
                tokio::time::timeout(Duration::from_secs(60), happened.recv()).await.unwrap().unwrap();
            match event {
                Event::LinkUp { robot: 1 } | Event::Received { robot: 1, .. } => of_other += 1,
                of => of_hostile.push(of),
            }
        }
        assert_eq!(of_other, 2, "the other link is up and carries");
        of_hostile
    }

    #[tokio::test]
    async fn whatever_a_robot_writes_is_told_and_the_link_goes_on() {
        let device = |i: usize| format!(r#"{{"id":"d{i}","name":"","available_control_types":{{}}}}"#);
        let devices: Vec<_> = (0..32_001).map(device).collect();
        let block = |devices: &str| {
            format!(r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{devices}]}}}}"#)
        };
        let twice = device(1).replace("\"name\"", "\"id\":\"e\",\"name\"");
        let cases = [
            (block(&devices.join(",")), "32001 devices, expected 1 to 32000"),
            (block(""), "0 devices, expected 1 to 32000"),
            (block(&format!("{},{}", device(1), device(1))), "`d1` stands twice"),
            (block(&twice), "duplicate field `id`"),
            ("x".repeat(17 * 1024 * 1024), "a line longer than 16777216 bytes"),
            ("x".repeat(60 * 1024 * 1024), "a line longer than 16777216 bytes"),
            (r#"{"control_response":"#.repeat(100_000), "not JSON"),
            (format!(r#"{{"control_response":{}1}}"#, r#"{"status_value":["#.repeat(50_000)), ""),
            (
                r#"{"availability_response":{},"availability_response":{}}"#.to_owned(),
                "2 keys, expected exactly one",
            ),
            (block(&device(1)).replace("\"r\"", &format!("\"{}\"", "r".repeat(257))), "257 characters"),
            (block(&device(1)).replace("\"r\"", "\"\\ud800\""), "at `initialization_block.id`"),
        ];
        for (line, says) in cases {
            let bytes = format!("{line}\n{}\n", block(&device(1))).into_bytes();
            let events = events_of(bytes, 3).await;
            let [Event::LinkUp { .. }, Event::Garbled { robot: 0, reason }, Event::Received { message, .. }] =
                &events[..]
            else {
                panic!("{says}: {events:?}");
            };
            assert!(reason.contains(says) && reason.chars().count() < 600, "{reason}");
            assert!(matches!(message, Message::InitializationBlock(_)));
        }
        let cut = format!("\u{ff}\u{fe}{}", block(&device(1))).chars().map(|c| c as u8).collect::<Vec<_>>();
        let events = events_of([&cut[..], b"\n"].concat(), 2).await;
        assert!(
            matches!(&events[1], Event::Garbled { reason, .. } if reason.contains("not UTF-8")),
            "{events:?}"
        );
    }
}
