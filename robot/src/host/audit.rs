//! Writes the audit trail of a host's robots in a thread of its own, so that the precise thread does not wait for a disk.
#![expect(clippy::disallowed_methods, reason = "records state the time of the calendar")]

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use urrcp::{ControlRequest, DeviceId, ErrorCode, Message, RobotId, Server, Timestamp};

use super::HostError;
use crate::audit::{Event, Record, hash};
use crate::parties::Claimant;
use crate::peer::Peer;
use crate::set_log::{LogEntry, MotionKind};

/// Maximum number of records that wait to be written. Further ones are lost, and counted.
const WAITING_MAX: usize = 65_536;
/// Maximum size of a file in bytes. A larger one gets the suffix `.1`.
pub(super) const FILE_BYTES_MAX: u64 = 8 * 1024 * 1024;
/// Number of full files that are kept, with the suffixes `.1` (the newest) and so on.
const FILES_KEPT: u32 = 8;
/// Maximum number of requests whose peers the writer remembers.
const REQUESTS_MAX: usize = 16_384;
/// Maximum number of refusals per second that are recorded in full. Further ones are only counted.
const REFUSALS_PER_SECOND: u32 = 20;
/// Beginning of the proven name of an operator.
const OPERATOR: &str = "operator ";
/// Maximum time until a record is on the disk.
const SYNC: Duration = Duration::from_secs(1);

/// The kind of a note.
#[derive(Clone, Copy, Debug)]
enum NoteKind {
    /// The event is recorded.
    Event(Event),
    /// A request that may move a device. Its movement is recorded once it begins, with the peer of the request.
    Request,
    /// The host stops: nothing is recorded any more.
    End,
}

/// What a robot notes for its trail.
#[derive(Debug)]
struct Note {
    robot: usize,
    at: Timestamp<Server>,
    kind: NoteKind,
    peer: Option<Peer>,
    session: Option<String>,
    device: Option<DeviceId>,
    request: Option<String>,
    reason: Option<String>,
}

/// The end of the channel to the thread that writes the trail. Clones refer to the same trail.
#[derive(Clone, Debug)]
pub(crate) struct Audit {
    notes: SyncSender<Note>,
    lost: Arc<AtomicU64>,
    /// For each robot, the last movement of each device that was noted.
    last: Arc<Mutex<Vec<Vec<Movement>>>>,
}

#[derive(Debug)]
struct Movement {
    device: DeviceId,
    request: Option<String>,
    event: Event,
}

/// Returns the current time.
fn now() -> Timestamp<Server> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Timestamp::from_nanos(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}

impl Audit {
    fn send(&self, note: Note) {
        if matches!(self.notes.try_send(note), Err(TrySendError::Full(_))) {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn note(&self, robot: usize, kind: NoteKind, peer: Option<&Peer>, fill: impl FnOnce(&mut Note)) {
        let peer = peer.cloned();
        let mut note =
            Note { robot, at: now(), kind, peer, session: None, device: None, request: None, reason: None };
        fill(&mut note);
        self.send(note);
    }

    /// Ends the trail.
    pub(super) fn end(&self) {
        self.note(0, NoteKind::End, None, |_| {});
    }

    /// Notes that a peer has proven its identity.
    pub(super) fn connected(&self, robot: usize, peer: &Peer) {
        if peer.proof().is_some() {
            self.note(robot, NoteKind::Event(Event::Connected), Some(peer), |_| {});
        }
    }

    /// Notes that a peer was not admitted.
    #[cfg(any(test, feature = "sealed", feature = "tls"))]
    pub(crate) fn not_admitted(&self, robot: usize, peer: &Peer, reason: &str) {
        self.note(robot, NoteKind::Event(Event::Refused), Some(peer), |note| {
            note.reason = Some(reason.to_owned())
        });
    }

    /// Notes the new owner of the robot; `None` if it belongs to no session.
    pub(super) fn owner(&self, robot: usize, claimant: Option<&Claimant>, peer: Option<&Peer>) {
        let event = if claimant.is_some() { Event::Claimed } else { Event::Released };
        self.note(robot, NoteKind::Event(event), peer, |note| {
            note.session = claimant.map(|claimant| claimant.session.to_string());
        });
    }

    /// Notes a request before the robot receives it.
    pub(super) fn request(&self, robot: usize, peer: &Peer, request: &ControlRequest) {
        let kind = if request.is_stop() { NoteKind::Event(Event::Stopped) } else { NoteKind::Request };
        self.note(robot, kind, Some(peer), |note| {
            note.session = request.session.as_ref().map(ToString::to_string);
            note.device = Some(request.device_id.clone());
            note.request = request.request_id.as_ref().map(ToString::to_string);
        });
    }

    /// Notes that a key is no longer valid.
    #[cfg(any(feature = "sealed", feature = "tls"))]
    pub(super) fn barred(&self, robot: usize, peer: Option<&Peer>, serial: &str, reason: &str) {
        self.note(robot, NoteKind::Event(Event::Barred), peer, |note| {
            note.reason = Some(format!("{reason} ({serial})"))
        });
    }

    /// Notes a response if it refuses a request.
    pub(super) fn response(&self, robot: usize, peer: &Peer, message: &Message) {
        let (error, device, request) = match message {
            Message::ControlResponse(response) => {
                (&response.error, Some(response.device_id.clone()), response.request_id.as_ref())
            }
            Message::AvailabilityResponse(response) => (&response.error, None, None),
            _ => return,
        };
        let Some(error) = error else { return };
        // These end an accepted command.
        if matches!(error.code, ErrorCode::Cancelled | ErrorCode::LinkLost) {
            return;
        }
        self.note(robot, NoteKind::Event(Event::Refused), Some(peer), |note| {
            note.reason = Some(error.message.to_string());
            note.device = device;
            note.request = request.map(ToString::to_string);
        });
    }

    /// Notes the movements in the log of values: one for each request and device, not one for each step.
    pub(super) fn values(&self, robot: usize, entries: &[LogEntry]) {
        let mut last = self.last.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        for entry in entries {
            let event = match entry.motion {
                MotionKind::Set | MotionKind::Ramp | MotionKind::Default => Event::Moved,
                MotionKind::Slow | MotionKind::Rest => Event::Rested,
            };
            let known = last[robot].iter_mut().find(|movement| movement.device == entry.device);
            let is_direct = entry.request_id.is_none() && entry.step.is_none_or(|step| step == 0);
            let is_alike = |movement: &Movement| {
                !is_direct && movement.event == event && movement.request == entry.request_id
            };
            let movement =
                || Movement { device: entry.device.clone(), request: entry.request_id.clone(), event };
            match known {
                Some(known) if is_alike(known) => continue,
                Some(known) => *known = movement(),
                None => last[robot].push(movement()),
            }
            self.send(Note {
                robot,
                at: Timestamp::from_nanos(entry.true_ns),
                kind: NoteKind::Event(event),
                peer: None,
                session: None,
                device: Some(entry.device.clone()),
                request: entry.request_id.clone(),
                reason: (entry.motion == MotionKind::Default).then(|| "to the default value".to_owned()),
            });
        }
    }
}

/// Opens or continues the trail in this file, and starts the thread that writes it. The thread ends with the last [`Audit`].
pub(super) fn start(path: PathBuf, robots: Arc<[RobotId]>) -> Result<(Audit, JoinHandle<()>), HostError> {
    let count = robots.len();
    let trail = Trail::open(path.clone()).map_err(|error| HostError::Audit { path, error })?;
    let (notes, inbox) = sync_channel(WAITING_MAX);
    let lost = Arc::new(AtomicU64::new(0));
    let mut writer = Writer {
        trail,
        robots,
        lost: Arc::clone(&lost),
        requests: Requests::default(),
        refusals: Refusals::default(),
    };
    let thread = std::thread::Builder::new().name("audit".into());
    let thread = thread.spawn(move || writer.run(&inbox)).map_err(HostError::Thread)?;
    let last = Arc::new(Mutex::new((0..count).map(|_| Vec::new()).collect()));
    Ok((Audit { notes, lost, last }, thread))
}

/// The files of a trail.
struct Trail {
    path: PathBuf,
    file: File,
    bytes: u64,
    number: u64,
    previous: Option<String>,
}

impl Trail {
    fn open(path: PathBuf) -> io::Result<Self> {
        let file = Self::locked(&path)?;
        let bytes = file.metadata()?.len();
        let mut trail = Self { path, file, bytes, number: 0, previous: None };
        trail.resume()?;
        Ok(trail)
    }

    fn locked(path: &Path) -> io::Result<File> {
        let file = OpenOptions::new().read(true).append(true).create(true).mode(0o600).open(path)?;
        if !file.metadata()?.is_file() {
            return Err(io::Error::other("it is not a regular file"));
        }
        file.try_lock().map_err(|_| io::Error::other("another process writes this audit trail"))?;
        Ok(file)
    }

    /// Continues after the last line of the newest file that has lines.
    fn resume(&mut self) -> io::Result<()> {
        let mut text = Vec::new();
        self.file.seek(SeekFrom::Start(0))?;
        self.file.read_to_end(&mut text)?;
        if text.is_empty() {
            text = fs::read(numbered(&self.path, 1)).unwrap_or_default();
        } else if !text.ends_with(b"\n") {
            // The process was killed, or the disk was full. The reader of the trail finds the incomplete line.
            self.file.write_all(b"\n")?;
            self.bytes += 1;
        }
        let number = |line: &[u8]| serde_json::from_slice::<Record>(line).ok().map(|record| record.number);
        let lines = || text.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
        self.previous = lines().next_back().map(hash);
        self.number = lines().rev().find_map(number).unwrap_or(0);
        Ok(())
    }

    fn write(&mut self, mut record: Record) -> io::Result<()> {
        if self.bytes > FILE_BYTES_MAX {
            self.rotate()?;
        }
        self.number += 1;
        record.number = self.number;
        record.previous.clone_from(&self.previous);
        let mut line = serde_json::to_vec(&record)?;
        self.previous = Some(hash(&line));
        line.push(b'\n');
        self.bytes += line.len() as u64;
        self.file.write_all(&line)
    }

    fn rotate(&mut self) -> io::Result<()> {
        self.file.sync_data()?;
        for number in (1..FILES_KEPT).rev() {
            match fs::rename(numbered(&self.path, number), numbered(&self.path, number + 1)) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        fs::rename(&self.path, numbered(&self.path, 1))?;
        self.file = Self::locked(&self.path)?;
        self.bytes = 0;
        Ok(())
    }
}

/// Returns the path of a full file of a trail; 1 is the newest one.
#[must_use]
pub fn numbered(path: &Path, number: u32) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(format!(".{number}"));
    path.into()
}

/// The index of the robot, the device and the id of a request.
type RequestKey = (usize, DeviceId, Option<String>);

/// A request that may move a device.
struct Requested {
    number: u64,
    peer: Peer,
    session: Option<String>,
}

/// The latest requests that were not refused.
#[derive(Default)]
struct Requests {
    by_key: HashMap<RequestKey, Requested>,
    /// The requests by number, from the oldest to the newest.
    by_number: BTreeMap<u64, RequestKey>,
    last: u64,
}

impl Requests {
    fn key(note: &Note) -> Option<RequestKey> {
        Some((note.robot, note.device.clone()?, note.request.clone()))
    }

    /// Remembers a request. A request without an id replaces the previous one for the device. A second request with the same id is a
    /// repetition, or comes from another peer, whose request the robot refuses.
    fn add(&mut self, note: &Note) {
        let (Some(key), Some(peer)) = (Self::key(note), &note.peer) else { return };
        if note.request.is_some() && self.by_key.contains_key(&key) {
            return;
        }
        self.last += 1;
        let requested = Requested { number: self.last, peer: peer.clone(), session: note.session.clone() };
        if let Some(replaced) = self.by_key.insert(key.clone(), requested) {
            self.by_number.remove(&replaced.number);
        }
        self.by_number.insert(self.last, key);
        if self.by_number.len() > REQUESTS_MAX
            && let Some((_, oldest)) = self.by_number.pop_first()
        {
            self.by_key.remove(&oldest);
        }
    }

    /// Forgets a request that the robot refused, so that refused requests do not displace others.
    fn refused(&mut self, note: &Note) {
        let Some(key) = Self::key(note) else { return };
        if self.by_key.get(&key).is_some_and(|requested| note.peer.as_ref() == Some(&requested.peer))
            && let Some(requested) = self.by_key.remove(&key)
        {
            self.by_number.remove(&requested.number);
        }
    }

    /// Adds the peer and the session of the request to the note of a movement.
    fn complete(&self, note: &mut Note) {
        if let Some(requested) = Self::key(note).and_then(|key| self.by_key.get(&key)) {
            note.peer = Some(requested.peer.clone());
            note.session.clone_from(&requested.session);
        }
    }
}

/// Limits the number of recorded refusals.
struct Refusals {
    second: Instant,
    count: u32,
    omitted: u64,
}

impl Default for Refusals {
    fn default() -> Self {
        Self { second: Instant::now(), count: 0, omitted: 0 }
    }
}

/// Minimum number of hexadecimal digits in a row that are taken for a key.
const KEY_DIGITS: usize = 16;

/// Returns a text with `…` in place of keys: a scheduler names its session `NAME/KEY`, and anyone with the key may use the session.
fn without_keys(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut rest = text;
    while !rest.is_empty() {
        let digits = rest.bytes().take_while(u8::is_ascii_hexdigit).count();
        let other = rest[digits..].find(|c: char| c.is_ascii_hexdigit()).unwrap_or(rest.len() - digits);
        let (run, after) = rest.split_at(digits);
        kept.push_str(if digits >= KEY_DIGITS { "…" } else { run });
        kept.push_str(&after[..other]);
        rest = &after[other..];
    }
    kept
}

struct Writer {
    trail: Trail,
    robots: Arc<[RobotId]>,
    lost: Arc<AtomicU64>,
    requests: Requests,
    refusals: Refusals,
}

impl Writer {
    fn run(&mut self, inbox: &Receiver<Note>) {
        let begin = |robot: &RobotId| Record::new(now(), robot.to_string(), Event::Started);
        let begun: Vec<_> = self.robots.iter().map(begin).collect();
        let mut written = begun.into_iter().try_for_each(|record| self.trail.write(record));
        let mut synced = Instant::now();
        while written.is_ok() {
            let note = inbox.recv_timeout(SYNC);
            written = match note {
                Ok(Note { kind: NoteKind::End, .. }) => break,
                Ok(note) => self.write(note),
                Err(RecvTimeoutError::Timeout) => self.write_omitted(),
                Err(RecvTimeoutError::Disconnected) => break,
            };
            if synced.elapsed() >= SYNC {
                written = written.and_then(|()| self.trail.file.sync_data());
                synced = Instant::now();
            }
        }
        let ended = written.and_then(|()| self.write_omitted()).and_then(|()| self.trail.file.sync_data());
        if let Err(error) = ended {
            tracing::error!("the audit trail {} ends: {}", self.trail.path.display(), error.kind());
        }
    }

    fn write(&mut self, mut note: Note) -> io::Result<()> {
        let event = match note.kind {
            NoteKind::Event(event) => event,
            NoteKind::Request => {
                self.requests.add(&note);
                return Ok(());
            }
            NoteKind::End => return Ok(()),
        };
        match event {
            Event::Moved | Event::Rested => self.requests.complete(&mut note),
            Event::Refused => {
                self.requests.refused(&note);
                if self.refusals.second.elapsed() >= Duration::from_secs(1) {
                    self.write_omitted()?;
                    self.refusals = Refusals::default();
                }
                self.refusals.count += 1;
                if self.refusals.count > REFUSALS_PER_SECOND {
                    self.refusals.omitted += 1;
                    return Ok(());
                }
            }
            _ => {}
        }
        let record = self.record(note, event);
        self.trail.write(record)
    }

    /// Records how many refusals and other events were not recorded.
    fn write_omitted(&mut self) -> io::Result<()> {
        let refusals = std::mem::take(&mut self.refusals.omitted);
        let lost = self.lost.swap(0, Ordering::Relaxed);
        let Some(robot) = self.robots.first().filter(|_| refusals + lost > 0) else { return Ok(()) };
        let mut record = Record::new(now(), robot.to_string(), Event::Lost);
        record.reason = Some(format!("{refusals} further refusals and {lost} other events are not recorded"));
        self.trail.write(record)
    }

    fn record(&self, note: Note, event: Event) -> Record {
        let session = note.session.as_deref().map(without_keys);
        let robot = self.robots.get(note.robot).map(ToString::to_string).unwrap_or_default();
        let proof = note.peer.as_ref().and_then(Peer::proof);
        Record {
            operator: proof.map(|proof| {
                let name = proof.name.to_string();
                name.strip_prefix(OPERATOR).map_or(name.clone(), str::to_owned)
            }),
            serial: proof.and_then(|proof| proof.serial.as_ref()).map(ToString::to_string),
            peer: note.peer.as_ref().map(Peer::origin),
            session: session.map(|session| session.trim_end_matches("/…").to_owned()),
            device: note.device.map(|device| device.to_string()),
            request: note.request,
            reason: note.reason.as_deref().map(without_keys),
            ..Record::new(note.at, robot, event)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::audit::Chain;

    /// A folder for the files of one test.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("downbeat-audit-{name}-{}", std::process::id()));
            let _left_by_an_earlier_test = fs::remove_dir_all(&path);
            fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn trail(&self) -> PathBuf {
            self.0.join("r0.jsonl")
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _already_gone = fs::remove_dir_all(&self.0);
        }
    }

    fn robots() -> Arc<[RobotId]> {
        ["r0".parse().unwrap()].into()
    }

    /// Writes a trail with this number of refusals, besides its first record.
    fn write(path: &Path, refusals: usize) {
        let (audit, thread) = start(path.to_owned(), robots()).unwrap();
        let peer = Peer::at("192.0.2.7:1000".parse().unwrap());
        (0..refusals).for_each(|_| audit.not_admitted(0, &peer, "it proved nothing"));
        audit.end();
        thread.join().unwrap();
    }

    fn check(texts: &[&str]) -> (Chain, Vec<Record>) {
        let (mut chain, mut records) = (Chain::default(), Vec::new());
        for text in texts {
            chain.check("trail", text.as_bytes(), |record, _| records.push(record)).unwrap();
        }
        (chain, records)
    }

    #[test]
    fn changed_and_removed_records_are_detected() {
        let folder = Folder::new("changed");
        write(&folder.trail(), 4);
        let text = fs::read_to_string(folder.trail()).unwrap();
        let (chain, records) = check(&[&text]);
        assert_eq!((chain.first, chain.last, chain.faults.len()), (Some(1), Some(5), 0));
        let events: Vec<_> = records.iter().map(|record| record.event).collect();
        assert_eq!(events, [Event::Started, Event::Refused, Event::Refused, Event::Refused, Event::Refused]);
        assert_eq!(records[1].peer.as_deref(), Some("192.0.2.7:1000"));
        let lines: Vec<&str> = text.lines().collect();
        let without = |index: usize| {
            let mut lines = lines.clone();
            lines.remove(index);
            lines.join("\n") + "\n"
        };
        assert!(
            check(&[&without(2)]).0.faults[0].starts_with("trail, line 3: the previous line was changed")
        );
        // The beginning may have been rotated away. Its number shows that.
        assert_eq!(check(&[&without(0)]).0.first, Some(2));
        let changed = text.replacen("192.0.2.7", "192.0.2.8", 1);
        assert_eq!(check(&[&changed]).0.faults.len(), 1);
        let swapped = [lines[0], lines[2], lines[1]].join("\n");
        assert!(check(&[&swapped]).0.faults.len() >= 2);
        let cut = &text[..text.len() - 10];
        assert!(check(&[cut]).0.faults[0].contains("line 5: is not a record, or is incomplete"));
    }

    #[test]
    fn trail_continues_after_a_restart_and_after_an_incomplete_line() {
        let folder = Folder::new("restart");
        write(&folder.trail(), 1);
        write(&folder.trail(), 1);
        let text = fs::read_to_string(folder.trail()).unwrap();
        assert_eq!(check(&[&text]).0.last, Some(4));
        assert!(check(&[&text]).0.faults.is_empty());
        fs::write(folder.trail(), &text[..text.len() - 10]).unwrap();
        write(&folder.trail(), 0);
        let (chain, records) = check(&[&fs::read_to_string(folder.trail()).unwrap()]);
        assert_eq!(chain.faults.len(), 1, "{chain:?}");
        assert_eq!(records.last().map(|record| record.event), Some(Event::Started));
    }

    #[test]
    fn full_files_are_kept_and_belong_to_the_chain() {
        let folder = Folder::new("rotation");
        let mut trail = Trail::open(folder.trail()).unwrap();
        let record = || {
            let mut record = Record::new(Timestamp::from_nanos(0), "r0".to_owned(), Event::Refused);
            record.reason = Some("x".repeat(30_000));
            record
        };
        let per_file = FILE_BYTES_MAX / 30_000 + 2;
        for _ in 0..per_file * (u64::from(FILES_KEPT) + 2) {
            trail.write(record()).unwrap();
        }
        drop(trail);
        let numbers: Vec<u32> =
            (1..20).filter(|number| numbered(&folder.trail(), *number).exists()).collect();
        assert_eq!(numbers, (1..=FILES_KEPT).collect::<Vec<_>>());
        let paths = numbers.iter().rev().map(|number| numbered(&folder.trail(), *number));
        let texts: Vec<_> =
            paths.chain([folder.trail()]).map(|path| fs::read_to_string(path).unwrap()).collect();
        let (chain, _) = check(&texts.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(chain.faults, [""; 0]);
        assert!(chain.first > Some(1), "the oldest file was removed");
        // A process that is killed directly after a rotation continues the chain of the full file.
        fs::write(folder.trail(), "").unwrap();
        write(&folder.trail(), 0);
        let text = fs::read_to_string(folder.trail()).unwrap();
        let before = fs::read_to_string(numbered(&folder.trail(), 1)).unwrap();
        assert_eq!(check(&[&before, &text]).0.faults, [""; 0]);
    }

    #[test]
    fn many_refusals_are_counted_instead_of_recorded() {
        let folder = Folder::new("refusals");
        write(&folder.trail(), 10_000);
        let (chain, records) = check(&[&fs::read_to_string(folder.trail()).unwrap()]);
        assert!(chain.faults.is_empty());
        assert!(records.len() < 1_000, "{}", records.len());
        let counted = |record: &Record| {
            let reason = record.reason.as_deref().filter(|_| record.event == Event::Lost)?;
            reason.split(' ').next()?.parse::<usize>().ok()
        };
        let omitted: usize = records.iter().filter_map(counted).sum();
        let refused = records.iter().filter(|record| record.event == Event::Refused).count();
        assert_eq!(omitted + refused, 10_000);
    }

    #[test]
    fn refused_requests_of_others_do_not_hide_the_peer_of_a_movement() {
        let mut requests = Requests::default();
        let peer = |port: u16| Peer::at(([192, 0, 2, 7], port).into());
        let note = |port: Option<u16>, request: String| Note {
            robot: 0,
            at: Timestamp::from_nanos(0),
            kind: NoteKind::Request,
            peer: port.map(peer),
            session: None,
            device: Some(DeviceId::new("arm").unwrap()),
            request: Some(request),
            reason: None,
        };
        requests.add(&note(Some(1), "act-1".to_owned()));
        for i in 0..2 * REQUESTS_MAX {
            let other = note(Some(2), format!("flood-{i}"));
            requests.add(&other);
            requests.refused(&other);
        }
        // Another peer uses the same id.
        requests.add(&note(Some(2), "act-1".to_owned()));
        requests.refused(&note(Some(2), "act-1".to_owned()));
        let mut moved = note(None, "act-1".to_owned());
        requests.complete(&mut moved);
        assert_eq!(moved.peer, Some(peer(1)));
        (0..2 * REQUESTS_MAX).for_each(|i| requests.add(&note(Some(3), format!("more-{i}"))));
        assert_eq!((requests.by_key.len(), requests.by_number.len()), (REQUESTS_MAX, REQUESTS_MAX));
    }

    #[test]
    fn movement_is_attributed_despite_a_flood_of_refused_requests() {
        let folder = Folder::new("flood");
        let (audit, thread) = start(folder.trail(), robots()).unwrap();
        let note = |kind, port, request: &str| Note {
            robot: 0,
            at: Timestamp::from_nanos(0),
            kind,
            peer: Some(Peer::at(([192, 0, 2, 7], port).into())),
            session: None,
            device: Some(DeviceId::new("arm").unwrap()),
            request: Some(request.to_owned()),
            reason: None,
        };
        audit.send(note(NoteKind::Request, 1, "act-1"));
        for i in 0..REQUESTS_MAX + 10 {
            audit.send(note(NoteKind::Request, 2, &format!("flood-{i}")));
            audit.send(note(NoteKind::Event(Event::Refused), 2, &format!("flood-{i}")));
        }
        audit.send(Note { peer: None, ..note(NoteKind::Event(Event::Moved), 0, "act-1") });
        audit.end();
        thread.join().unwrap();
        let (_, records) = check(&[&fs::read_to_string(folder.trail()).unwrap()]);
        let moved = records.iter().find(|record| record.event == Event::Moved).unwrap();
        assert_eq!(moved.peer.as_deref(), Some("192.0.2.7:1"));
    }

    #[test]
    fn keys_of_sessions_are_not_recorded() {
        let key = "0123456789abcdef0123456789abcdef";
        assert_eq!(
            without_keys(&format!("show@host-20261130T150000123/{key}")),
            "show@host-20261130T150000123/…"
        );
        assert_eq!(without_keys(&format!("`é/{key}` owns face, {key}")), "`é/…` owns face, …");
        assert_eq!(without_keys(""), "");
    }

    #[test]
    fn only_one_process_writes_a_trail() {
        let folder = Folder::new("lock");
        let (audit, thread) = start(folder.trail(), robots()).unwrap();
        let second = start(folder.trail(), robots());
        assert!(second.err().unwrap().to_string().ends_with("another process writes this audit trail"));
        audit.end();
        thread.join().unwrap();
    }
}
