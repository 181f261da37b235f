//! A mission's socket. Through it, other terminals send `go` or `stop` and receive the result. Messages are lines of text.
//!
//! The mission sends `ready` on every connection. It answers `go`, or `go ACT`, with `started ACT` or `refused: REASON`. It answers
//! `stop`, or `home`, which sends robots to their default state, with `heard` once it has taken the command. It then sends `alive` four
//! times a second while it stops, and finally its report, a line of JSON. `superseded` precedes the report if a later command replaced
//! the client's: a `stop` by a `home`, or a `home` by a `stop`. The client therefore knows within a second whether the mission responds.
//!
//! A mission with an identity sends `ready NONCE`. A client with its own identity then sends the line `as CERTIFICATE SIGNATURE` before
//! its command, and may send the commands that its roles permit ([`super::desk`]). The mission answers any other command with `refused:
//! REASON`.

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustix::io::Errno;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::{AbortHandle, spawn_blocking};
use tokio::time::timeout;

use super::desk::{Challenge, Desk, Presented};
use crate::journal::private;
use crate::stop_lane::{Operator, OperatorHandle, StopLane};
use downbeat_mission::Rest;

/// Maximum length, in bytes, of a line that contains only a command and the name of an act.
const LINE_MAX: u64 = 4_096;
/// Maximum length, in bytes, of a line that presents an identity: a certificate and a signature.
const PRESENTED_MAX: u64 = 16_384;
/// Pause before the mission accepts connections again after the system failed to accept one.
const ACCEPT_AGAIN: Duration = Duration::from_millis(50);
/// Time of silence after which a client considers the scheduler unresponsive.
const SILENCE_MAX: Duration = Duration::from_secs(1);
/// Interval between `alive` messages while a mission stops.
const ALIVE_EVERY: Duration = Duration::from_millis(250);
/// Time without progress of a stopping mission's loop, after which the mission closes the connection. The client then contacts the robots
/// itself.
const STANDS_STILL: Duration = Duration::from_secs(2);
/// Interval between checks that the socket can still be found under its name.
const LOOK_EVERY: Duration = Duration::from_millis(250);
/// Interval between checks whether the mission has taken a command.
const TAKEN_RETRY: Duration = Duration::from_millis(2);

/// The line that precedes the report if a later command replaced the client's: `stop` by `home`, or `home` by `stop`.
const SUPERSEDED: &str = "superseded";

/// Returns the path of the socket in a mission's folder.
#[must_use]
pub fn socket(folder: &Path) -> PathBuf {
    folder.join(SOCKET)
}

const SOCKET: &str = "control";

/// Whether the peer of a connection is a process of this user or of root.
fn is_ours(stream: &UnixStream) -> bool {
    let own = rustix::process::geteuid().as_raw();
    stream.peer_cred().is_ok_and(|peer| peer.uid() == own || peer.uid() == 0)
}

/// Whether the peer is a process of root, while the mission belongs to another user.
fn is_root(stream: &UnixStream) -> bool {
    !rustix::process::geteuid().is_root() && stream.peer_cred().is_ok_and(|peer| peer.uid() == 0)
}

/// Listens for other terminals while a mission runs.
#[derive(Debug)]
pub struct Control {
    /// The task that accepts connections, and the task that checks the socket's name.
    listening: [AbortHandle; 2],
    report: watch::Sender<Option<String>>,
    /// The channel that closes once every client that requested a stop has received the result.
    told: mpsc::Receiver<()>,
}

impl Control {
    /// Listens until [`Control::end`]. If `desk` is given, it decides which commands operators with an identity may send. If the socket
    /// is removed or replaced, it is created again, together with its folder.
    ///
    /// # Errors
    /// Fails if the socket cannot be created, for example because its path is too long.
    pub fn listen(folder: &Path, lane: &StopLane, desk: Option<Desk>) -> io::Result<Self> {
        // The tasks run in the stop lane, so that a stop is received even if everything else is blocked.
        let _in_the_lane = lane.runtime().enter();
        let voice = lane.voice();
        let (place, listener) = Place::bind(folder)?;
        let mut listener = UnixListener::from_std(listener)?;
        let (made_again, mut again) = mpsc::channel(1);
        // The task ends with the mission.
        let keeping = tokio::spawn(keep(place, made_again));
        let (report, reported) = watch::channel(None);
        let (telling, told) = mpsc::channel(1);
        let (desk, mission) = (desk.map(Arc::new), mission_of(folder));
        let accepting = tokio::spawn(async move {
            loop {
                let accepted = tokio::select! {
                    accepted = listener.accept() => accepted,
                    Some(other) = again.recv() => {
                        listener = other;
                        continue;
                    }
                };
                let Ok((stream, _)) = accepted else {
                    // For example, too many files are open. That may be temporary.
                    tokio::time::sleep(ACCEPT_AGAIN).await;
                    continue;
                };
                if !is_ours(&stream) {
                    continue;
                }
                let by = is_root(&stream).then(|| "root".to_owned());
                let (reader, writer) = stream.into_split();
                let desk = desk.clone().map(|desk| (desk, Challenge::new(&mission)));
                let listener = Listener { writer, voice: voice.clone(), report: reported.clone(), desk, by };
                let telling = telling.clone();
                // The task ends with the mission or with the client.
                tokio::spawn(async move {
                    let _gone = listener.converse(reader).await;
                    drop(telling);
                });
            }
        });
        Ok(Self { listening: [accepting.abort_handle(), keeping.abort_handle()], report, told })
    }

    /// Sends the mission's result to every client that requested a stop. Waits at most a second.
    pub async fn end(mut self, report: Option<String>) {
        let _nobody_waits = self.report.send(report);
        self.listening.iter().for_each(AbortHandle::abort);
        drop(self.report);
        let _too_slow = timeout(SILENCE_MAX, self.told.recv()).await;
    }
}

/// A mission's socket: the folder that contains it, and the identity of the socket's file.
struct Place {
    folder: PathBuf,
    /// The device number and inode of the socket.
    file: (u64, u64),
}

impl Place {
    fn bind(folder: &Path) -> io::Result<(Self, std::os::unix::net::UnixListener)> {
        let path = socket(folder);
        // A killed process may have left the old socket. This process holds the journal's lock, so it owns the folder.
        let _absent = std::fs::remove_file(&path);
        let listener = std::os::unix::net::UnixListener::bind(&path)?;
        // The folder is accessible to this user only as well.
        std::fs::set_permissions(&path, Permissions::from_mode(0o600))?;
        listener.set_nonblocking(true)?;
        let found = rustix::fs::lstat(&path)?;
        Ok((Self { folder: folder.to_path_buf(), file: (found.st_dev, found.st_ino) }, listener))
    }

    /// Whether the socket's name no longer refers to this socket. If the check itself fails, the socket is treated as present.
    fn is_gone(&self) -> bool {
        match rustix::fs::lstat(socket(&self.folder)) {
            Ok(found) => (found.st_dev, found.st_ino) != self.file,
            Err(error) => matches!(error, Errno::NOENT | Errno::NOTDIR),
        }
    }

    /// Creates the socket again if it is gone, together with the folders that it needs.
    fn make_again(&mut self) -> io::Result<Option<std::os::unix::net::UnixListener>> {
        if !self.is_gone() {
            return Ok(None);
        }
        if let Some(state) = self.folder.parent() {
            private::create_folder(state)?;
        }
        private::create_folder(&self.folder)?;
        let (place, listener) = Self::bind(&self.folder)?;
        *self = place;
        Ok(Some(listener))
    }
}

/// Checks the socket's name at regular intervals. If the socket had to be created again, sends the new one to `made_again`. Another
/// thread accesses the disk, because the disk may stall.
async fn keep(mut place: Place, made_again: mpsc::Sender<UnixListener>) {
    let mut before = None;
    loop {
        tokio::time::sleep(LOOK_EVERY).await;
        let looked = spawn_blocking(move || {
            let made = place.make_again();
            (place, made)
        });
        let Ok((back, made)) = looked.await else { return };
        place = back;
        match made.and_then(|made| made.map(UnixListener::from_std).transpose()) {
            Ok(None) => {}
            Ok(Some(listener)) => {
                tracing::warn!("the mission's socket was removed or replaced and has been restored");
                if made_again.send(listener).await.is_err() {
                    return;
                }
            }
            Err(error) => {
                let reason = error.to_string();
                if before.as_ref() != Some(&reason) {
                    tracing::warn!(
                        "the mission's socket was removed or replaced and cannot be restored, so `downbeat stop` cannot reach this mission: {reason}"
                    );
                }
                before = Some(reason);
            }
        }
    }
}

/// The mission's end of one connection.
struct Listener {
    writer: OwnedWriteHalf,
    voice: OperatorHandle,
    report: watch::Receiver<Option<String>>,
    /// The desk, which verifies the client's identity, and the challenge that the client must sign. `None` if the mission has no
    /// identity.
    desk: Option<(Arc<Desk>, Challenge)>,
    /// The operator who sends the command; `None` for the operator who began the mission.
    by: Option<String>,
}

impl Listener {
    async fn converse(mut self, reader: OwnedReadHalf) -> io::Result<()> {
        match &self.desk {
            Some((_, challenge)) => self.say(&format!("ready {}", challenge.nonce())).await?,
            None => self.say("ready").await?,
        }
        let limit = if self.desk.is_some() { PRESENTED_MAX } else { LINE_MAX };
        let mut reader = BufReader::new(reader.take(limit));
        let mut line = String::new();
        reader.read_line(&mut line).await?;
        if let (Some(presented), Some((desk, challenge))) = (line.strip_prefix("as "), &self.desk) {
            let presented = presented.trim().to_owned();
            line.clear();
            reader.read_line(&mut line).await?;
            match desk.admits(challenge, &presented, line.trim()) {
                Ok(name) => self.by = name,
                Err(reason) => {
                    tracing::warn!(
                        "refused the command `{}` from the mission's socket: {reason}",
                        line.trim()
                    );
                    return self.say(&format!("refused: {reason}")).await;
                }
            }
        }
        if let Some(by) = &self.by {
            tracing::warn!("`{}` by {by}", line.trim());
        }
        match line.trim().split_once(' ').unwrap_or((line.trim(), "")) {
            ("go", act) => self.go(act).await,
            ("stop", "") => self.stop(Rest::InPlace).await,
            ("home", "") => self.stop(Rest::Home).await,
            _ => self.say("unknown").await,
        }
    }

    async fn say(&mut self, line: &str) -> io::Result<()> {
        self.writer.write_all(format!("{line}\n").as_bytes()).await
    }

    async fn go(&mut self, act: &str) -> io::Result<()> {
        let act = Some(act).filter(|act| !act.is_empty()).map(str::to_owned);
        let (answer, answered) = oneshot::channel();
        let _over = self.voice.say(Operator::Go { act, by: self.by.take(), answer }).await;
        match answered.await {
            Ok(Ok(act)) => self.say(&format!("started {act}")).await,
            Ok(Err(reason)) => self.say(&format!("refused: {reason}")).await,
            Err(_) => self.say("refused: the mission is over").await,
        }
    }

    async fn stop(&mut self, rest: Rest) -> io::Result<()> {
        let _over = self.voice.say(Operator::Stop { rest, by: self.by.take() }).await;
        while !self.voice.is_heard() {
            tokio::time::sleep(TAKEN_RETRY).await;
        }
        self.say("heard").await?;
        let (mut turns, mut still) = (self.voice.turns(), Duration::ZERO);
        loop {
            let reported = timeout(ALIVE_EVERY, self.report.wait_for(Option::is_some)).await;
            match reported.map(|report| report.ok().and_then(|report| report.clone())) {
                Ok(Some(report)) => {
                    if !self.voice.latest_is(rest) {
                        self.say(SUPERSEDED).await?;
                    }
                    return self.say(&report).await;
                }
                // The mission ended without a report.
                Ok(None) => return Ok(()),
                // The mission asks robots again at least once a second, so its loop must make progress.
                Err(_) if still >= STANDS_STILL => return Ok(()),
                Err(_) => {
                    let now = self.voice.turns();
                    still = if now == turns && now.is_some() { still + ALIVE_EVERY } else { Duration::ZERO };
                    turns = now;
                    self.say("alive").await?;
                }
            }
        }
    }
}

/// Why a scheduler did not execute a command.
#[derive(Debug, thiserror::Error)]
pub enum Undelivered {
    /// No process listens on the mission's socket.
    #[error("no process is listening on the mission's socket: {0}")]
    NobodyListens(#[from] io::Error),
    /// The scheduler did not answer within 1 s.
    #[error("no answer within 1 s")]
    Silent,
    /// The scheduler closed the connection without an answer.
    #[error("it ended without answering")]
    Ended,
    /// The scheduler does not permit this operator to send the command.
    #[error("refused: {0}")]
    Refused(String),
}

/// Returns the name of the mission to which this folder belongs.
fn mission_of(folder: &Path) -> String {
    folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Begins the act that waits for the operator. If `act` is given, it must be that act's name. Returns the name of the act that begins, or
/// the reason why none begins.
///
/// # Errors
/// Returns [`Undelivered`]. No act begins in that case, unless the scheduler became silent during the exchange.
pub async fn go(
    folder: &Path,
    act: Option<&str>,
    presented: Option<&Presented>,
) -> Result<Result<String, String>, Undelivered> {
    if act.is_some_and(|act| act.contains(['\n', '\r']) || act.len() as u64 > LINE_MAX / 2) {
        return Ok(Err("invalid act name: it is too long or contains a line break".to_owned()));
    }
    let mut speaker = Speaker::to(folder).await?;
    // Wait for `ready` first. Otherwise, a suspended scheduler would read the `go` when it continues, and begin the act at an unexpected
    // time.
    let ready = speaker.hear().await?;
    let word = format!("go {}", act.unwrap_or_default());
    speaker.present(folder, &ready, presented, word.trim()).await?;
    speaker.say(&word).await?;
    let answer = speaker.hear().await?;
    match (answer.strip_prefix("started "), answer.strip_prefix("refused: ")) {
        (Some(act), _) => Ok(Ok(act.to_owned())),
        (_, reason) => Ok(Err(reason.unwrap_or(&answer).to_owned())),
    }
}

/// The result of a mission that was stopped through its socket.
#[derive(Clone, Debug)]
pub struct Ending {
    /// The mission's report, a line of JSON.
    pub report: String,
    /// Whether a later command replaced the client's: `stop` by `home`, or `home` by `stop`.
    pub superseded: bool,
}

/// Stops a mission through its socket, waits for its end and returns the result.
///
/// # Errors
/// Returns [`Undelivered`], for example once the mission is silent for 1 s. The stop may still take effect in that case.
pub async fn stop(folder: &Path, rest: Rest, presented: Option<&Presented>) -> Result<Ending, Undelivered> {
    let mut speaker = Speaker::to(folder).await?;
    let mut superseded = false;
    let word = match rest {
        Rest::InPlace => "stop",
        Rest::Home => "home",
    };
    // Without an identity to present, there is no need to wait for `ready`.
    if presented.is_some() {
        let ready = speaker.hear().await?;
        speaker.present(folder, &ready, presented, word).await?;
    }
    speaker.say(word).await?;
    loop {
        let line = speaker.hear().await?;
        if line.starts_with('{') {
            return Ok(Ending { report: line, superseded });
        }
        superseded |= line == SUPERSEDED;
        if let Some(reason) = line.strip_prefix("refused: ") {
            return Err(Undelivered::Refused(reason.to_owned()));
        }
    }
}

/// The client's end of a connection.
struct Speaker {
    reader: BufReader<OwnedReadHalf>,
    writer: OwnedWriteHalf,
}

impl Speaker {
    async fn to(folder: &Path) -> Result<Self, Undelivered> {
        let stream = UnixStream::connect(private::socket(folder, SOCKET)?);
        let stream = timeout(SILENCE_MAX, stream).await.map_err(|_| Undelivered::Silent)??;
        if !is_ours(&stream) {
            return Err(io::Error::other("the listening process belongs to another user").into());
        }
        let (reader, writer) = stream.into_split();
        Ok(Self { reader: BufReader::new(reader), writer })
    }

    /// Sends the client's identity to the mission, if the mission asks for one.
    async fn present(
        &mut self,
        folder: &Path,
        ready: &str,
        presented: Option<&Presented>,
        word: &str,
    ) -> Result<(), Undelivered> {
        let (Some(presented), Some(nonce)) = (presented, ready.strip_prefix("ready ")) else { return Ok(()) };
        match presented.signed(&Challenge::of(&mission_of(folder), nonce), word) {
            Ok(signed) => self.say(&format!("as {signed}")).await,
            Err(error) if word.starts_with("go") => Err(Undelivered::Refused(error)),
            // A stop is sent even without a usable key.
            Err(error) => {
                tracing::warn!("sending the stop without an identity: {error}");
                Ok(())
            }
        }
    }

    async fn say(&mut self, line: &str) -> Result<(), Undelivered> {
        let line = format!("{line}\n");
        match timeout(SILENCE_MAX, self.writer.write_all(line.as_bytes())).await {
            Ok(written) => written.map_err(|_| Undelivered::Ended),
            Err(_) => Err(Undelivered::Silent),
        }
    }

    async fn hear(&mut self) -> Result<String, Undelivered> {
        let mut line = String::new();
        match timeout(SILENCE_MAX, self.reader.read_line(&mut line)).await {
            Err(_) => Err(Undelivered::Silent),
            Ok(Ok(n)) if n > 0 => Ok(line.trim_end().to_owned()),
            Ok(_) => Err(Undelivered::Ended),
        }
    }
}
