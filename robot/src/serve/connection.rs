//! One connection of a robot: reads the peer's messages within the peer's budget, forwards them to the robot, and writes the robot's
//! messages.
#![expect(clippy::disallowed_methods, reason = "real sockets are silent in real time")]

use std::future::poll_fn;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::Poll;
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::{OwnedSemaphorePermit, watch};
use urrcp::{
    Command, DecodeError, Decoder, Encoding, InitializationBlock, LINE_BYTES_MAX, Message, RevocationList,
    SessionId, encode_as,
};

use super::described::Described;
use super::door::Door;
#[cfg(any(feature = "sealed", feature = "tls"))]
use super::keys::Keys;
use super::places::Ticket;
use crate::budget::{Budget, Strangers};
use crate::hardware::Standing;
use crate::host::{HostHandle, LinkEvent, LinkSender, RobotLink};
use crate::parties::Claimant;
use crate::peer::Peer;
use crate::refusals::Reason;
use crate::robot::Input;

/// Maximum length in bytes of a line or frame from a peer while the robot belongs to a session other than the peer's.
pub(super) const STRANGERS_LINE_MAX: usize = 64 * 1024;
/// Maximum length in bytes of a line or frame from any peer while the robot belongs to no session. Longer ones need a permission, of
/// which a host grants two at a time.
pub(super) const FREE_LINE_MAX: usize = 1024 * 1024;
/// Length in bytes above which a message is decoded on another thread, so that no other connection waits for it.
const READ_AT_ONCE: usize = 64 * 1024;
/// Maximum pause in reading before the peer's budget is checked again. The budget may change in the meantime, for example because the
/// peer now owns the robot.
const PAUSE_MAX: Duration = Duration::from_millis(100);
/// Maximum time for which a peer may accept no bytes before it is disconnected.
const WRITE_WAIT_MAX: Duration = Duration::from_secs(10);
/// Maximum time for which the end of a connection may wait for the peer.
const CLOSE_WAIT: Duration = Duration::from_secs(1);
/// Maximum number of bytes per write.
const WRITE_BATCH: usize = 64 * 1024;

/// Time limits for peers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patience {
    /// Silence after which a connection may be closed to give its place to another one, because the peer may no longer exist.
    pub(super) silence: Duration,
    /// Time limit for the first complete message.
    pub(super) first_message: Duration,
    /// Time limit from the first byte of a message to its end, for a peer that does not own the robot.
    pub(super) message: Duration,
    /// Maximum time to wait for the robot's decision on the peer's claim. After that, the line that follows the claim is treated as too
    /// long.
    pub(super) claim: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            silence: Duration::from_secs(30),
            first_message: Duration::from_secs(5),
            message: Duration::from_secs(10),
            claim: Duration::from_secs(2),
        }
    }
}

/// State that all connections of one robot share.
#[derive(Clone, Debug)]
pub(super) struct Shared {
    pub(super) host: HostHandle,
    pub(super) described: Arc<Described>,
    pub(super) strangers: Arc<Strangers>,
    pub(super) patience: Patience,
    pub(super) door: Door,
    #[cfg(any(feature = "sealed", feature = "tls"))]
    pub(super) keys: Arc<Keys>,
}

impl Shared {
    pub(super) fn new(host: HostHandle, patience: Patience, door: Door) -> Self {
        Self {
            described: Arc::default(),
            strangers: host.strangers(),
            #[cfg(any(feature = "sealed", feature = "tls"))]
            keys: Arc::default(),
            host,
            patience,
            door,
        }
    }
}

/// Transfers messages in both directions until either side closes the connection, or another connection needs its place. While the peer
/// does not read the robot's messages, the robot's side reads no further input.
pub(super) async fn carry<R, W>(
    reader: R,
    writer: W,
    peer: Peer,
    mut link: RobotLink,
    ticket: Ticket,
    shared: Shared,
) -> io::Result<()>
where
    R: AsyncRead + Unpin,
    W: AsyncWrite + Unpin,
{
    let hung_up = ticket.hung_up();
    let longest = shared.host.longest_command(&link);
    // Responses use the encoding of the peer's last message.
    let (heard, encoding) = watch::channel(Encoding::Json);
    let being_written = AtomicBool::new(false);
    let list_refused = Mutex::new(None);
    let reading = Reading {
        reader,
        decoder: Decoder::new(LINE_BYTES_MAX).that_knows(shared.host.scripts().clone()),
        robot: link.sender(),
        peer: peer.clone(),
        heard,
        budget: Budget::new(Instant::now(), ticket.standing(None)),
        ticket,
        shared: shared.clone(),
        speaks_for: None,
        spoke: false,
        until: Some(Instant::now() + shared.patience.first_message),
        long_line: None,
        longest,
        being_written: &being_written,
        list_refused: &list_refused,
    };
    let mut writing = Writing { writer, peer, shared, bytes: Vec::new(), list_refused: &list_refused };
    // Both directions must always make progress: when it is the peer's turn among strangers, its input must take the turn at once, or it
    // would block the others.
    let writing = async {
        loop {
            let event = link.recv().await;
            being_written.store(true, Ordering::Relaxed);
            let encoding = *encoding.borrow();
            let open = writing.tell(event, &mut link, encoding).await?;
            writing.flush().await?;
            being_written.store(false, Ordering::Relaxed);
            if !open {
                return writing.close().await;
            }
        }
    };
    tokio::select! {
        biased;
        () = hung_up => Ok(()),
        // Polled before `reading`, which checks at each poll whether a write is in progress.
        ended = writing => ended,
        ended = reading.run() => ended,
    }
}

/// Sends the robot's messages to a peer.
struct Writing<'a, W> {
    writer: W,
    peer: Peer,
    shared: Shared,
    bytes: Vec<u8>,
    /// Why the last list of revoked keys that the peer sent is not used.
    list_refused: &'a Mutex<Option<String>>,
}

impl<W: AsyncWrite + Unpin> Writing<'_, W> {
    /// Writes an event and all further available messages of the robot. Returns false once the robot has closed the link.
    async fn tell(
        &mut self,
        event: Option<LinkEvent>,
        link: &mut RobotLink,
        encoding: Encoding,
    ) -> io::Result<bool> {
        let mut next = event;
        loop {
            match next {
                Some(LinkEvent::Message(Message::InitializationBlock(block))) => {
                    self.describe(block, encoding).await?;
                }
                Some(LinkEvent::Message(mut message)) => {
                    if let Message::AvailabilityResponse(response) = &mut message {
                        response.revocation_list = self.revocation_list();
                    }
                    encode_as(encoding, &message, &mut self.bytes);
                }
                Some(LinkEvent::Closed) | None => return Ok(false),
            }
            if self.bytes.len() >= WRITE_BATCH {
                return Ok(true);
            }
            next = match link.try_recv() {
                None => return Ok(true),
                more => more,
            };
        }
    }

    fn revocation_list(&self) -> Option<RevocationList> {
        let refused = self.list_refused.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let number = self.shared.door.list_number();
        (number.is_some() || refused.is_some())
            .then(|| RevocationList { number: number.unwrap_or_default(), refused })
    }

    /// Sends the robot's description. It is encoded once for all connections, and not copied.
    async fn describe(&mut self, block: InitializationBlock, encoding: Encoding) -> io::Result<()> {
        self.flush().await?;
        let described = Arc::clone(&self.shared.described);
        let bytes = described.bytes(block, encoding).await;
        self.write(&bytes).await
    }

    /// Ends the connection so that the peer can tell it from one that broke.
    async fn close(&mut self) -> io::Result<()> {
        tokio::time::timeout(CLOSE_WAIT, self.writer.shutdown()).await.unwrap_or(Ok(()))
    }

    async fn flush(&mut self) -> io::Result<()> {
        // Does not keep the buffer: a robot has many connections, and a host many robots.
        let bytes = std::mem::take(&mut self.bytes);
        self.write(&bytes).await
    }

    async fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        for batch in bytes.chunks(WRITE_BATCH) {
            let writing = async {
                self.writer.write_all(batch).await?;
                // The writer may have buffered sealed or encrypted data.
                self.writer.flush().await
            };
            let written = tokio::time::timeout(WRITE_WAIT_MAX, writing).await;
            let Ok(written) = written else {
                self.shared.host.refusals().note(Reason::Stuck, &self.peer);
                return Err(io::ErrorKind::TimedOut.into());
            };
            written?;
        }
        Ok(())
    }
}

/// Reads a peer's messages and sends them to the robot.
struct Reading<'a, R> {
    reader: R,
    decoder: Decoder,
    robot: LinkSender,
    peer: Peer,
    heard: watch::Sender<Encoding>,
    ticket: Ticket,
    shared: Shared,
    budget: Budget,
    /// The session that the peer named last.
    speaks_for: Option<Claimant>,
    /// Whether the peer has sent a complete message.
    spoke: bool,
    /// Deadline of the first message, or of the message that is incomplete. `None` if there is no deadline.
    until: Option<Instant>,
    /// Permission for the incomplete message to exceed [`FREE_LINE_MAX`].
    long_line: Option<OwnedSemaphorePermit>,
    /// Maximum length in bytes of a line that has permission to exceed [`FREE_LINE_MAX`]. No command for the robot is longer.
    longest: usize,
    /// Whether messages of the robot are being written to the peer.
    being_written: &'a AtomicBool,
    list_refused: &'a Mutex<Option<String>>,
}

type Decoded = Result<Message, DecodeError>;

impl<R: AsyncRead + Unpin> Reading<'_, R> {
    async fn run(mut self) -> io::Result<()> {
        let mut bytes = vec![0; 8 * 1024];
        loop {
            self.pause().await;
            self.until_written().await;
            let Some(n) = self.read(&mut bytes).await? else { return Ok(()) };
            self.budget.came(Instant::now(), n);
            self.decoder.push(&bytes[..n]);
            loop {
                self.bound_line().await;
                let Some(decoded) = self.decode().await else { break };
                let encoding = self.decoder.encoding();
                self.heard.send_if_modified(|heard| std::mem::replace(heard, encoding) != encoding);
                self.deliver(decoded).await;
                self.pause().await;
                self.until_written().await;
            }
            self.set_deadline();
        }
    }

    /// Waits while the peer does not read the robot's messages. Extends the deadline of the peer's message by the waiting time.
    async fn until_written(&mut self) {
        let is_written = || !self.being_written.load(Ordering::Relaxed);
        if is_written() {
            return;
        }
        let begin = Instant::now();
        // The same task also writes to the peer, and polls this future whenever writing makes progress.
        poll_fn(|_| if is_written() { Poll::Ready(()) } else { Poll::Pending }).await;
        self.until = self.until.map(|until| until + begin.elapsed());
    }

    fn standing(&self) -> Standing {
        self.ticket.standing(self.speaks_for.as_ref())
    }

    fn note(&self, reason: Reason) {
        self.shared.host.refusals().note(reason, &self.peer);
    }

    /// Reads bytes from the peer, and returns their number. Returns `None` at the end of the input, or if a message has taken too long.
    async fn read(&mut self, bytes: &mut [u8]) -> io::Result<Option<usize>> {
        let reading = self.reader.read(bytes);
        let n = match self.until {
            None => reading.await?,
            Some(until) => match tokio::time::timeout_at(until.into(), reading).await {
                Ok(n) => n?,
                Err(_) => {
                    self.note(if self.spoke { Reason::HalfAMessage } else { Reason::SaidNothing });
                    return Ok(None);
                }
            },
        };
        Ok(Some(n).filter(|n| *n > 0))
    }

    /// Sets the deadline of the incomplete message. A peer that owns the robot has no deadline: its script may be long and its connection
    /// slow, and leases detect silence.
    fn set_deadline(&mut self) {
        let owns = self.standing() == Standing::Owner;
        if owns {
            self.ticket.heard();
        }
        if self.spoke {
            let begun = self.decoder.buffered() > 0 || self.decoder.is_skipping();
            self.until = if begun && !owns {
                self.until.or_else(|| Some(Instant::now() + self.shared.patience.message))
            } else {
                None
            };
        }
    }

    /// Pauses reading while the peer exceeds its budget.
    async fn pause(&mut self) {
        let (begin, mut noted) = (Instant::now(), false);
        loop {
            let now = Instant::now();
            self.budget.follow(now, self.standing());
            let pause = self.budget.pause(now, &self.shared.strangers);
            if pause.is_zero() {
                break;
            }
            if !std::mem::replace(&mut noted, true) {
                self.note(Reason::Paused);
            }
            tokio::time::sleep(pause.min(PAUSE_MAX)).await;
        }
        // The pause does not count towards the deadline of a message.
        self.until = self.until.map(|until| until + begin.elapsed());
    }

    /// Limits the length of the incomplete message, depending on whether the robot belongs to the peer's session, to another session or
    /// to none.
    async fn bound_line(&mut self) {
        let Some(front) = self.decoder.front().filter(|front| front.bytes > STRANGERS_LINE_MAX) else {
            return;
        };
        let limit = |standing| match standing {
            Standing::Owner => LINE_BYTES_MAX,
            Standing::Free => FREE_LINE_MAX,
            Standing::Stranger => STRANGERS_LINE_MAX,
        };
        if front.bytes > limit(self.standing()) {
            // The session of the previous owner may be over, and this peer's claim may still be pending.
            self.ticket.look().await;
            if let (true, Some(claimant)) = (front.bytes > limit(self.standing()), &self.speaks_for) {
                self.ticket.await_claim(claimant, self.shared.patience.claim).await;
            }
        }
        let mut limit = limit(self.standing());
        if front.bytes > limit && front.bytes <= self.longest && self.standing() == Standing::Free {
            if self.long_line.is_none() {
                self.long_line = self.shared.strangers.long_line(self.shared.patience.message).await;
            }
            limit = if self.long_line.is_some() { self.longest } else { limit };
        }
        if front.bytes > limit {
            self.note(Reason::LongLine);
        }
        self.decoder.set_limit(limit);
    }

    /// Decodes the next message. Of the peers that do not own the robot, one at a time may decode. A long message is decoded on another
    /// thread, so that no other connection waits.
    async fn decode(&mut self) -> Option<Decoded> {
        let Some(front) = self.decoder.front().filter(|front| front.whole) else {
            return self.decoder.next_message();
        };
        let strangers = Arc::clone(&self.shared.strangers);
        let _turn = match self.standing() {
            Standing::Owner => None,
            Standing::Free | Standing::Stranger => strangers.turn().await,
        };
        let begin = Instant::now();
        let decoded = if front.bytes <= READ_AT_ONCE {
            self.decoder.next_message()
        } else {
            self.decode_elsewhere().await
        };
        let answer = match &decoded {
            Some(Ok(Message::InitializationRequest(_))) => self.shared.described.length(),
            _ => 0,
        };
        self.budget.read(Instant::now(), &strangers, begin.elapsed(), answer);
        self.long_line = None;
        decoded
    }

    async fn decode_elsewhere(&mut self) -> Option<Decoded> {
        let mut decoder = std::mem::take(&mut self.decoder);
        let reading = tokio::task::spawn_blocking(move || {
            let decoded = decoder.next_message();
            if let Some(Ok(Message::ControlRequest(request))) = &decoded
                && request.content_hash.is_some()
            {
                // The script caches the hash.
                let _computed = request.command.content_hash();
            }
            (decoder, decoded)
        });
        // The call fails only if the runtime ends.
        let (decoder, decoded) = reading.await.ok()?;
        self.decoder = decoder;
        decoded
    }

    /// Takes over a list of revoked keys that the peer sends with a request.
    async fn take_list(&self, decoded: &mut Decoded) {
        let Ok(Message::AvailabilityRequest(request)) = decoded else { return };
        let Some(list) = request.revocation_list.take() else { return };
        let door = self.shared.door.clone();
        // Storing the list waits for the disk.
        let taken = tokio::task::spawn_blocking(move || door.replace_list(&list)).await;
        let refused = taken.ok().and_then(Result::err);
        if let Some(reason) = &refused {
            tracing::warn!(peer = %self.peer, "the previous list of revoked keys remains in use: {reason}");
        }
        *self.list_refused.lock().unwrap_or_else(PoisonError::into_inner) = refused;
    }

    async fn deliver(&mut self, mut decoded: Decoded) {
        self.ticket.establish(&self.peer);
        self.take_list(&mut decoded).await;
        if let Ok(message) = &decoded {
            if let Some(session) = session_of(message) {
                let peer = self.peer.name().cloned();
                self.speaks_for = Some(Claimant { session: session.clone(), peer });
            }
            self.spoke = true;
            self.until = None;
            self.ticket.spoke(self.speaks_for.as_ref());
        }
        if !decoded.as_ref().is_ok_and(needs_no_place) {
            self.ticket.take(decoded.as_ref().is_ok_and(claims)).await;
        }
        let input = decoded.map_or_else(Input::Undecodable, Input::read);
        if let Input::Hashed(request, _) = &input
            && self.standing() != Standing::Stranger
        {
            self.shared.host.scripts().note(request);
        }
        self.robot.send(input).await;
    }
}

fn session_of(message: &Message) -> Option<&SessionId> {
    match message {
        Message::AvailabilityRequest(request) => request.session.as_ref(),
        Message::ControlRequest(request) => request.session.as_ref(),
        Message::Inquiry(inquiry) => inquiry.session.as_ref(),
        _ => None,
    }
}

/// Whether the message claims the robot for a session.
fn claims(message: &Message) -> bool {
    !matches!(message, Message::Inquiry(_)) && session_of(message).is_some()
}

/// Whether a peer may send this message even if its connection has none of the limited places. This applies to a stop, and to a request
/// for the robot's description or availability.
fn needs_no_place(message: &Message) -> bool {
    match message {
        Message::InitializationRequest(_) => true,
        // A request with a session would claim the robot.
        Message::AvailabilityRequest(request) => request.session.is_none(),
        Message::ControlRequest(request) => {
            let stops = matches!(&request.command, Command::Script(script) if script.is_empty());
            stops && request.starts_at().is_none()
        }
        _ => false,
    }
}
