//! The connections of a robot. A limited number of them have a place, which permits all messages; others wait for a place, or must close.
//! Connections of the session that owns the robot take precedence over strangers. A stop needs no place.
#![expect(clippy::disallowed_methods, reason = "connections are silent in real time")]

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, watch};

use crate::hardware::Standing;
use crate::host::HostHandle;
use crate::parties::Claimant;
use crate::peer::Peer;
use crate::refusals::Reason;

/// Maximum number of places for connections that do not own the robot. Only on a connection with a place does the robot accept all
/// messages.
pub(super) const PLACES: usize = 16;
/// Number of additional places for connections of the session that owns the robot.
pub(super) const OWNER_PLACES: usize = 4;
/// Maximum number of connections. On a connection without a place, the robot accepts only stops and some questions; all other messages
/// wait for a place.
pub(super) const CONNECTIONS_MAX: usize = 64;
/// Maximum number of connections from one remote host, not counting those of the session that owns the robot.
const HOST_MAX: usize = 16;
/// Minimum age of a connection before it may be closed for another one, so that it has time to send a message.
const YOUNG: Duration = Duration::from_millis(50);
/// Interval at which a waiting connection tries to get a place.
const ROOM_RETRY: Duration = Duration::from_millis(50);
/// Number of failed attempts to get a place after which the robot checks again whether the session that owns it is over.
const LOOK_EVERY: u32 = 20;

/// Whether a connection has a place, which permits all messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Seat {
    None,
    Taken,
}

#[derive(Debug)]
struct Entry {
    id: u64,
    peer: Peer,
    since: Instant,
    heard: Instant,
    /// Whether a complete message has arrived on the connection.
    spoke: bool,
    seat: Seat,
    speaks_for: Option<Claimant>,
    /// Whether the connection was asked to close. It no longer counts as a connection.
    leaving: bool,
    hang_up: Arc<Notify>,
}

impl Entry {
    fn owns(&self, owner: Option<&Claimant>) -> bool {
        owner.is_some() && self.speaks_for.as_ref() == owner
    }

    /// Returns the rank of the connection. The connection with the lowest rank is closed first.
    fn rank(&self) -> (Seat, bool, Instant) {
        (self.seat, self.spoke, self.heard)
    }
}

#[derive(Debug, Default)]
struct Entries {
    all: Vec<Entry>,
    last: u64,
}

impl Entries {
    fn standing(&self) -> impl Iterator<Item = &Entry> {
        self.all.iter().filter(|entry| !entry.leaving)
    }

    fn get(&mut self, id: u64) -> Option<&mut Entry> {
        self.all.iter_mut().find(|entry| entry.id == id)
    }
}

/// The connections of one robot.
#[derive(Debug)]
pub(super) struct Places {
    entries: Mutex<Entries>,
    changed: Notify,
    owner: watch::Receiver<Option<Claimant>>,
    host: HostHandle,
    robot: usize,
    silence_max: Duration,
}

impl Places {
    /// Creates the list of connections. Returns `None` if the robot does not exist.
    pub(super) fn new(host: HostHandle, robot: usize, silence_max: Duration) -> Option<Arc<Self>> {
        let owner = host.owner(robot)?;
        let (entries, changed) = (Mutex::default(), Notify::new());
        Some(Arc::new(Self { entries, changed, owner, host, robot, silence_max }))
    }

    /// Admits a new connection. If necessary, closes another connection for it. Returns `None` if no other connection can be closed yet.
    pub(super) fn admit(self: &Arc<Self>, peer: &Peer) -> Option<Ticket> {
        let now = Instant::now();
        let owner = self.owner.borrow().clone();
        let mut entries = self.lock();
        let without_session = |entry: &&Entry| !entry.owns(owner.as_ref());
        if let Some(host) = peer.quota_key() {
            let of_host = |entry: &&Entry| entry.peer.quota_key() == Some(host);
            if entries.standing().filter(of_host).filter(without_session).count() >= HOST_MAX {
                let weakest =
                    entries.standing().filter(of_host).filter(without_session).min_by_key(|e| e.rank());
                let weakest = weakest.map(|entry| entry.id);
                weakest.into_iter().for_each(|id| self.hang_up(&mut entries, id, Reason::ManyFromOneHost));
            }
        }
        if entries.standing().count() >= CONNECTIONS_MAX {
            let old = |entry: &&Entry| now.saturating_duration_since(entry.since) >= YOUNG;
            let weakest = entries.standing().filter(old).filter(without_session).min_by_key(|e| e.rank());
            let weakest = weakest.map(|entry| entry.id)?;
            self.hang_up(&mut entries, weakest, Reason::MadeRoom);
        }
        // A connection that was asked to end does so as soon as its task runs.
        if entries.all.len() >= 2 * CONNECTIONS_MAX {
            return None;
        }
        entries.last += 1;
        let (id, hang_up) = (entries.last, Arc::new(Notify::new()));
        entries.all.push(Entry {
            id,
            peer: peer.clone(),
            since: now,
            heard: now,
            spoke: false,
            seat: Seat::None,
            speaks_for: None,
            leaving: false,
            hang_up: Arc::clone(&hang_up),
        });
        Some(Ticket { places: Arc::clone(self), id, hang_up })
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn hang_up(&self, entries: &mut Entries, id: u64, reason: Reason) {
        if let Some(entry) = entries.get(id) {
            entry.leaving = true;
            entry.hang_up.notify_one();
            self.host.refusals().note(reason, &entry.peer);
        }
    }

    /// Assigns a place to a connection, if one is available for it. Returns whether the connection has a place. `claims` is whether the
    /// connection claims the robot. While the robot belongs to no session, such a connection takes precedence over the others.
    fn try_take(&self, id: u64, claims: bool) -> bool {
        let now = Instant::now();
        let owner = self.owner.borrow().clone();
        let mut entries = self.lock();
        let Some(own) = entries.standing().find(|entry| entry.id == id) else { return false };
        let comes_first = own.owns(owner.as_ref()) || (claims && owner.is_none());
        if own.seat == Seat::Taken {
            return true;
        }
        let seated = |entry: &&Entry| entry.seat == Seat::Taken;
        let strangers = |entry: &&Entry| seated(entry) && !entry.owns(owner.as_ref());
        let all = entries.standing().filter(seated).count();
        let free = all < PLACES + OWNER_PLACES
            && (comes_first || entries.standing().filter(strangers).count() < PLACES);
        if !free {
            let silence = |entry: &Entry| now.saturating_duration_since(entry.heard);
            let longest = |of: &dyn Fn(&Entry) -> bool| {
                let seated = entries.standing().filter(seated).filter(|entry| of(entry));
                seated.max_by_key(|entry| silence(entry)).map(|entry| (entry.id, silence(entry)))
            };
            let stranger = longest(&|entry| !entry.owns(owner.as_ref())).filter(|_| comes_first);
            // The peers of the owner's own connections may no longer exist either.
            let silent = || longest(&|_| true).filter(|(_, silence)| *silence >= self.silence_max);
            let Some((gives_way, _)) = stranger.or_else(silent) else { return false };
            self.hang_up(&mut entries, gives_way, Reason::MadeRoom);
        }
        if let Some(own) = entries.get(id) {
            own.seat = Seat::Taken;
        }
        true
    }
}

/// One admitted connection. Dropping the ticket removes the connection.
#[derive(Debug)]
pub(super) struct Ticket {
    places: Arc<Places>,
    id: u64,
    hang_up: Arc<Notify>,
}

impl Ticket {
    /// Waits until this connection must close because another one needs its place.
    pub(super) fn hung_up(&self) -> impl Future<Output = ()> + use<> {
        let hang_up = Arc::clone(&self.hang_up);
        async move { hang_up.notified().await }
    }

    /// Returns whether the robot is free, belongs to the session `speaks_for` (which the peer named last), or belongs to another session.
    pub(super) fn standing(&self, speaks_for: Option<&Claimant>) -> Standing {
        match (&*self.places.owner.borrow(), speaks_for) {
            (None, _) => Standing::Free,
            (Some(owner), Some(claimant)) if owner == claimant => Standing::Owner,
            (Some(_), _) => Standing::Stranger,
        }
    }

    /// Waits until this claimant owns the robot, but at most for `patience`.
    pub(super) async fn await_claim(&self, claimant: &Claimant, patience: Duration) {
        let mut owner = self.places.owner.clone();
        let claimed = owner.wait_for(|owner| owner.as_ref() == Some(claimant));
        let _over = tokio::time::timeout(patience, claimed).await;
    }

    /// Makes the robot check whether the session that owns it is over.
    pub(super) async fn look(&self) {
        self.places.host.look(self.places.robot).await;
    }

    /// Records that input has arrived, which shows that the peer is alive.
    pub(super) fn heard(&self) {
        if let Some(entry) = self.places.lock().get(self.id) {
            entry.heard = Instant::now();
        }
    }

    /// Records that a complete message has arrived. `speaks_for` is the session that the peer named last.
    pub(super) fn spoke(&self, speaks_for: Option<&Claimant>) {
        if let Some(entry) = self.places.lock().get(self.id) {
            entry.heard = Instant::now();
            entry.spoke = true;
            if entry.speaks_for.as_ref() != speaks_for {
                entry.speaks_for = speaks_for.cloned();
            }
        }
    }

    /// Waits until the connection has a place. `claims` is whether the connection claims the robot.
    pub(super) async fn take(&self, claims: bool) {
        if self.places.try_take(self.id, claims) {
            return;
        }
        for tried in 0_u32.. {
            let mut changed = std::pin::pin!(self.places.changed.notified());
            changed.as_mut().enable();
            if self.places.try_take(self.id, claims) {
                return;
            }
            if tried % LOOK_EVERY == 0 {
                self.look().await;
                if self.places.try_take(self.id, claims) {
                    return;
                }
            }
            let _again = tokio::time::timeout(ROOM_RETRY, changed).await;
        }
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        self.places.lock().all.retain(|entry| entry.id != self.id);
        self.places.changed.notify_waiters();
    }
}
