//! JSON lines over TCP: the robot listens, the scheduler connects.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::mpsc;
use urrcp::{LineDecoder, Message, encode};

use super::EventSink;
use crate::mission::Event;

const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Bytes gathered before one write, so that a burst of requests is one system call.
const WRITE_BATCH: usize = 64 * 1024;

/// Connects and carries messages both ways until either side closes.
pub(super) async fn carry(sink: EventSink, host: String, port: u16, queue: mpsc::Receiver<Message>) {
    let stream = match tokio::time::timeout(CONNECT_TIMEOUT, TcpStream::connect((host.as_str(), port))).await
    {
        Ok(Ok(stream)) => stream,
        Ok(Err(error)) => return sink.down(format!("no connection to {host}:{port}: {error}")).await,
        Err(_) => return sink.down(format!("no connection to {host}:{port} within 3 s")).await,
    };
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!("TCP_NODELAY: {error}");
    }
    let (reader, writer) = stream.into_split();
    sink.up().await;
    let reason = tokio::select! {
        reason = read(&sink, reader) => Some(reason),
        reason = write(writer, queue) => reason,
    };
    if let Some(reason) = reason {
        sink.down(reason).await;
    }
}

/// Ends with the reason for which no more can be read.
async fn read(sink: &EventSink, mut reader: OwnedReadHalf) -> String {
    let mut decoder = LineDecoder::default();
    let mut bytes = vec![0; 8 * 1024];
    loop {
        match reader.read(&mut bytes).await {
            Ok(0) => return "the robot closed the connection".to_owned(),
            Ok(n) => decoder.push(&bytes[..n]),
            Err(error) => return error.to_string(),
        }
        while let Some(decoded) = decoder.next_message() {
            match decoded {
                Ok(message) => sink.received(message).await,
                Err(error) => {
                    sink.put(Event::Garbled { robot: sink.robot, reason: error.to_string() }).await;
                }
            }
        }
    }
}

/// Ends with a reason when writing fails, without one when the mission has let go of the link.
async fn write(mut writer: OwnedWriteHalf, mut queue: mpsc::Receiver<Message>) -> Option<String> {
    let mut bytes = Vec::new();
    while let Some(message) = queue.recv().await {
        encode(&message, &mut bytes);
        while bytes.len() < WRITE_BATCH {
            let Ok(message) = queue.try_recv() else { break };
            encode(&message, &mut bytes);
        }
        if let Err(error) = writer.write_all(&bytes).await {
            return Some(error.to_string());
        }
        bytes.clear();
    }
    None
}
