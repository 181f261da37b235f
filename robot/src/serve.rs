//! Messages over TCP round a robot of a host: lines of JSON, or frames of MessagePack to whoever writes them.

use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::OwnedReadHalf;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use urrcp::{Decoder, Encoding, LINE_BYTES_MAX, encode_as};

use crate::host::{HostHandle, LinkEvent, LinkSender, RobotLink};
use crate::robot::Input;

/// Servers that may be connected to one robot at a time; more have to wait.
const CONNECTIONS_MAX: usize = 16;
/// Where somebody waits, a connection that has been silent for so long makes room: its peer may be long gone.
const SILENCE_MAX: Duration = Duration::from_secs(30);
/// How often it is looked for one.
const ROOM_RETRY: Duration = Duration::from_millis(50);
/// How long a peer may refuse to read before it is hung up on.
const WRITE_WAIT_MAX: Duration = Duration::from_secs(10);
/// Before the next try when the system has no file descriptor left: others must close first.
const ACCEPT_RETRY: Duration = Duration::from_millis(50);

/// Accepts servers for one robot until the host stops.
///
/// # Errors
/// When the listening socket fails.
pub async fn serve(listener: TcpListener, host: HostHandle, robot: usize) -> io::Result<()> {
    serve_with(listener, host, robot, SILENCE_MAX).await
}

async fn serve_with(
    listener: TcpListener,
    host: HostHandle,
    robot: usize,
    silence_max: Duration,
) -> io::Result<()> {
    let mut connections = Vec::new();
    loop {
        let (stream, peer) = accept(&listener).await?;
        make_room(&mut connections, silence_max).await;
        let Some(link) = host.connect(robot) else { return Ok(()) };
        let heard = Arc::new(Mutex::new(now()));
        let last = Arc::clone(&heard);
        // One task a connection, so that a slow or broken peer harms only itself; ends when either side closes, or when
        // its place is needed.
        let task = tokio::spawn(async move {
            if let Err(error) = carry(stream, link, &last).await {
                tracing::debug!(%peer, "connection ended: {error}");
            }
        });
        connections.push(Connection { task, heard });
    }
}

/// A connection that stands, and when its peer was last heard.
struct Connection {
    task: JoinHandle<()>,
    heard: Arc<Mutex<Instant>>,
}

impl Connection {
    fn silence(&self) -> Duration {
        now().saturating_duration_since(*self.heard.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[expect(clippy::disallowed_methods, reason = "real sockets are silent in real time")]
fn now() -> Instant {
    Instant::now()
}

/// Waits until another connection may be served.
async fn make_room(connections: &mut Vec<Connection>, silence_max: Duration) {
    loop {
        connections.retain(|connection| !connection.task.is_finished());
        if connections.len() < CONNECTIONS_MAX {
            return;
        }
        let silent = connections.iter().max_by_key(|connection| connection.silence());
        if let Some(silent) = silent.filter(|connection| connection.silence() >= silence_max) {
            silent.task.abort();
        }
        tokio::time::sleep(ROOM_RETRY).await;
    }
}

/// The next connection. One that breaks before it is accepted, or a system short of file descriptors, is no reason to
/// serve nobody any more.
async fn accept(listener: &TcpListener) -> io::Result<(TcpStream, SocketAddr)> {
    loop {
        match listener.accept().await {
            Ok(accepted) => return Ok(accepted),
            Err(error) if is_passing(&error) => {
                tracing::warn!("a connection was not accepted: {error}");
                tokio::time::sleep(ACCEPT_RETRY).await;
            }
            Err(error) => return Err(error),
        }
    }
}

fn is_passing(error: &io::Error) -> bool {
    use rustix::io::Errno;
    let passing = [Errno::CONNABORTED, Errno::INTR, Errno::MFILE, Errno::NFILE, Errno::NOBUFS, Errno::NOMEM];
    Errno::from_io_error(error).is_some_and(|errno| passing.contains(&errno))
}

/// Carries both ways. While the peer does not read, nothing more is read from it either.
async fn carry(stream: TcpStream, mut link: RobotLink, last: &Mutex<Instant>) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (reader, mut writer) = stream.into_split();
    // How the peer wrote last is how it is answered.
    let (heard, encoding) = watch::channel(Encoding::Json);
    let reading = read(reader, link.sender(), heard, last);
    tokio::pin!(reading);
    let mut bytes = Vec::new();
    loop {
        tokio::select! {
            ended = &mut reading => return ended,
            event = link.recv() => {
                let Some(LinkEvent::Message(message)) = event else { return Ok(()) };
                let encoding = *encoding.borrow();
                encode_as(encoding, &message, &mut bytes);
                let open = encode_waiting(&mut link, encoding, &mut bytes);
                tokio::time::timeout(WRITE_WAIT_MAX, writer.write_all(&bytes)).await??;
                bytes.clear();
                if !open {
                    return Ok(());
                }
            }
        }
    }
}

/// Adds what else the robot has said already; false once the robot has closed the link.
fn encode_waiting(link: &mut RobotLink, encoding: Encoding, bytes: &mut Vec<u8>) -> bool {
    while bytes.len() < 64 * 1024 {
        match link.try_recv() {
            Some(LinkEvent::Message(message)) => encode_as(encoding, &message, bytes),
            Some(LinkEvent::Closed) => return false,
            None => return true,
        }
    }
    true
}

async fn read(
    mut reader: OwnedReadHalf,
    robot: LinkSender,
    heard: watch::Sender<Encoding>,
    last: &Mutex<Instant>,
) -> io::Result<()> {
    let mut decoder = Decoder::new(LINE_BYTES_MAX);
    let mut bytes = vec![0; 8 * 1024];
    loop {
        let n = reader.read(&mut bytes).await?;
        if n == 0 {
            return Ok(());
        }
        *last.lock().unwrap_or_else(PoisonError::into_inner) = now();
        decoder.push(&bytes[..n]);
        while let Some(decoded) = decoder.next_message() {
            heard.send_replace(decoder.encoding());
            robot.send(decoded.map_or_else(Input::Undecodable, Input::read)).await;
        }
    }
}

#[cfg(test)]
mod tests;
