//! Messages over TCP round a robot of a host: lines of JSON, or frames of MessagePack to a peer that writes these.

use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::OwnedReadHalf;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinHandle;
use urrcp::{Command, Decoder, Encoding, LINE_BYTES_MAX, Message, encode_as};

use crate::host::{HostHandle, LinkEvent, LinkSender, RobotLink};
use crate::robot::Input;

/// Connections that have a place at the same time: the robot accepts everything that arrives on them.
const PLACES: usize = 16;
/// Further connections: the robot accepts stops and questions for its identity on them; everything else waits for a place.
const WAITING_MAX: usize = 8;
/// If all of these are taken and one more arrives, a connection without a place is closed once it is this old.
const WAITS_MIN: Duration = Duration::from_secs(1);
/// If another connection waits for a place, one that has been silent for this long is closed: its peer may be long gone.
const SILENCE_MAX: Duration = Duration::from_secs(30);
/// How often it is looked for one.
const ROOM_RETRY: Duration = Duration::from_millis(50);
/// How long a peer may refuse to read before it is hung up on.
const WRITE_WAIT_MAX: Duration = Duration::from_secs(10);
/// Before the next try when the system has no file descriptor left: others must close first.
const ACCEPT_RETRY: Duration = Duration::from_millis(50);

/// Accepts servers for one robot of a host, by its index in the list that the host was started with, until the host stops.
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
    let mut connections = Connections { all: Vec::new(), silence_max };
    let places = Arc::new(Semaphore::new(PLACES));
    loop {
        let accepted = tokio::select! {
            accepted = accept(&listener) => Some(accepted?),
            () = tokio::time::sleep(ROOM_RETRY), if connections.one_has_no_place() => None,
        };
        connections.tidy();
        let Some((stream, peer)) = accepted else { continue };
        connections.await_room().await;
        let Some(link) = host.connect(robot) else { return Ok(()) };
        let seen = Arc::new(Mutex::new(Seen { heard: now(), seat: Seat::None }));
        let chair = Chair::new(Arc::clone(&places), Arc::clone(&seen));
        // One task a connection, so that a slow or broken peer harms only itself; ends when either side closes, or when
        // its place is needed.
        let task = tokio::spawn(async move {
            if let Err(error) = carry(stream, link, chair).await {
                tracing::debug!(%peer, "connection ended: {error}");
            }
        });
        connections.all.push(Connection { task, since: now(), seen });
    }
}

/// What is seen of a connection from outside its task.
struct Seen {
    /// When its peer was last heard.
    heard: Instant,
    seat: Seat,
}

/// Whether a connection has a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seat {
    /// It has none, and has not needed one.
    None,
    /// Something came that waits for one.
    Wanted,
    Taken,
}

/// A connection that stands.
struct Connection {
    task: JoinHandle<()>,
    since: Instant,
    seen: Arc<Mutex<Seen>>,
}

impl Connection {
    fn seat(&self) -> Seat {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).seat
    }

    fn silence(&self) -> Duration {
        now().saturating_duration_since(self.seen.lock().unwrap_or_else(PoisonError::into_inner).heard)
    }
}

#[expect(clippy::disallowed_methods, reason = "real sockets are silent in real time")]
fn now() -> Instant {
    Instant::now()
}

/// All that stand.
struct Connections {
    all: Vec<Connection>,
    silence_max: Duration,
}

impl Connections {
    /// It may want one at any time.
    fn one_has_no_place(&self) -> bool {
        self.all.iter().any(|connection| connection.seat() != Seat::Taken)
    }

    fn one_wants_a_place(&self) -> bool {
        self.all.iter().any(|connection| connection.seat() == Seat::Wanted)
    }

    /// Forgets those that have ended. Where a place is wanted, the one that has been silent for longest gives its own up.
    fn tidy(&mut self) {
        self.all.retain(|connection| !connection.task.is_finished());
        if self.one_wants_a_place() {
            let seated = self.all.iter().filter(|connection| connection.seat() == Seat::Taken);
            let silent = seated.max_by_key(|connection| connection.silence());
            let silent = silent.filter(|connection| connection.silence() >= self.silence_max);
            silent.into_iter().for_each(|connection| connection.task.abort());
        }
    }

    /// Waits until another connection may be served: the oldest without a place gives way.
    async fn await_room(&mut self) {
        while self.all.len() >= PLACES + WAITING_MAX {
            let standing = self.all.iter().filter(|connection| connection.seat() != Seat::Taken);
            let oldest = standing.min_by_key(|connection| connection.since);
            let old_enough =
                |connection: &&Connection| now().saturating_duration_since(connection.since) >= WAITS_MIN;
            oldest.filter(old_enough).into_iter().for_each(|connection| connection.task.abort());
            tokio::time::sleep(ROOM_RETRY).await;
            self.tidy();
        }
    }
}

/// The place of a connection, if it has one.
struct Chair {
    places: Arc<Semaphore>,
    /// Given back with the connection.
    permit: Option<OwnedSemaphorePermit>,
    seen: Arc<Mutex<Seen>>,
}

impl Chair {
    fn new(places: Arc<Semaphore>, seen: Arc<Mutex<Seen>>) -> Self {
        let permit = Arc::clone(&places).try_acquire_owned().ok();
        let chair = Self { places, permit, seen };
        if chair.permit.is_some() {
            chair.note(Seat::Taken);
        }
        chair
    }

    fn note(&self, seat: Seat) {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).seat = seat;
    }

    fn heard(&self) {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).heard = now();
    }

    /// Waits for a place.
    async fn take(&mut self) {
        if self.permit.is_none() {
            self.note(Seat::Wanted);
            // The semaphore is never closed.
            self.permit = Arc::clone(&self.places).acquire_owned().await.ok();
            self.note(Seat::Taken);
        }
    }
}

/// Whether a connection without a place may send it: a stop, or a question for the robot's identity.
fn needs_no_place(message: &Message) -> bool {
    match message {
        Message::InitializationRequest(_) => true,
        // With a session it claims the robot.
        Message::AvailabilityRequest(request) => request.session.is_none(),
        Message::ControlRequest(request) => {
            let stops = matches!(&request.command, Command::Script(script) if script.is_empty());
            stops && request.starts_at().is_none()
        }
        _ => false,
    }
}

/// The next connection. One that breaks before it is accepted, or a system short of file descriptors, is no reason to
/// stop serving.
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
async fn carry(stream: TcpStream, mut link: RobotLink, chair: Chair) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (reader, mut writer) = stream.into_split();
    // How the peer wrote last is how it is answered.
    let (heard, encoding) = watch::channel(Encoding::Json);
    let reading = read(reader, link.sender(), heard, chair);
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
    mut chair: Chair,
) -> io::Result<()> {
    let mut decoder = Decoder::new(LINE_BYTES_MAX);
    let mut bytes = vec![0; 8 * 1024];
    loop {
        let n = reader.read(&mut bytes).await?;
        if n == 0 {
            return Ok(());
        }
        chair.heard();
        decoder.push(&bytes[..n]);
        while let Some(decoded) = decoder.next_message() {
            heard.send_replace(decoder.encoding());
            if !decoded.as_ref().is_ok_and(needs_no_place) {
                chair.take().await;
            }
            robot.send(decoded.map_or_else(Input::Undecodable, Input::read)).await;
        }
    }
}

#[cfg(test)]
mod tests;
