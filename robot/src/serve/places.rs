//! The connections of a robot. A connection is new until its peer has proven an identity or sent a message; then it is established. The
//! host limits new connections, and this module limits established ones. A limited number of these have a place, which permits all
//! messages; others wait for a place, or must close. Connections of the session that owns the robot take precedence over strangers. A
//! stop needs no place.
#![expect(clippy::disallowed_methods, reason = "connections are silent in real time")]

use std::cmp::Reverse;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, watch};
use urrcp::Role;

use crate::hardware::Standing;
use crate::host::HostHandle;
use crate::newcomers::Newcomer;
use crate::parties::Claimant;
use crate::peer::Peer;
use crate::refusals::Reason;

/// Maximum number of places for connections that do not own the robot. Only on a connection with a place does the robot accept all
/// messages.
pub(super) const PLACES: usize = 16;
/// Number of additional places for connections of the session that owns the robot.
pub(super) const OWNER_PLACES: usize = 4;
/// Maximum number of established connections, not counting those of peers with the role `stop`. On a connection without a place, the
/// robot accepts only stops and some questions; all other messages wait for a place.
pub(super) const CONNECTIONS_MAX: usize = 64;
/// Maximum number of connections of peers that have proven the role `stop`. Other peers cannot take these.
pub(super) const STOP_CONNECTIONS_MAX: usize = 32;
/// Maximum number of established connections from one remote host, not counting those of the session that owns the robot.
const HOST_MAX: usize = 16;
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

    /// Whether the peer has proven that it has the role `stop`.
    fn may_stop(&self) -> bool {
        self.peer.proof().is_some_and(|proof| proof.roles.has(Role::Stop))
    }

    /// Returns the rank of the connection. The connection with the lowest rank is closed first.
    fn rank(&self) -> (Seat, bool, Instant) {
        (self.seat, self.spoke, self.heard)
    }

    /// Whether both connections belong to the same peer: to the same name if it is proven, otherwise to the same network.
    fn is_of_same_peer(&self, other: &Self) -> bool {
        match (self.peer.name(), other.peer.name()) {
            (None, None) => self.has_prefix_of(other, 0),
            (one, another) => one == another,
        }
    }

    fn is_of_same_host(&self, other: &Self) -> bool {
        self.has_prefix_of(other, 1)
    }

    fn has_prefix_of(&self, other: &Self, at: usize) -> bool {
        let prefix = |entry: &Self| entry.peer.prefixes().map(|prefixes| prefixes[at]);
        self.id == other.id || (prefix(self).is_some() && prefix(self) == prefix(other))
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

    /// Returns the connection that gives way to the new connection `id`, out of those that are `among`: of the peer with most of these
    /// connections, and of its host with most of them, the one with the lowest rank.
    fn weakest(&self, id: u64, among: impl Fn(&Entry) -> bool) -> Option<u64> {
        let candidates: Vec<&Entry> = self.standing().filter(|entry| among(entry)).collect();
        let count =
            |is_alike: &dyn Fn(&Entry) -> bool| candidates.iter().filter(|entry| is_alike(entry)).count();
        let order = |entry: &&&Entry| {
            let of_peer = count(&|other| entry.is_of_same_peer(other));
            let of_host = count(&|other| entry.is_of_same_host(other));
            (Reverse(of_peer), Reverse(of_host), entry.rank())
        };
        candidates.iter().filter(|entry| entry.id != id).min_by_key(order).map(|entry| entry.id)
    }
}

/// The established connections of one robot.
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

    /// Admits a new connection. If the host has too many new connections, closes another one. Returns `None` if that is not possible yet.
    pub(super) fn admit(self: &Arc<Self>, peer: &Peer) -> Option<Ticket> {
        let hang_up = Arc::new(Notify::new());
        let (newcomer, gives_way) = self.host.newcomers().admit(self.robot, peer, &hang_up)?;
        if let Some(gives_way) = gives_way {
            self.host.refusals().note(Reason::MadeRoom, &gives_way);
        }
        let newcomer = Mutex::new(Some(newcomer));
        Some(Ticket { places: Arc::clone(self), hang_up, newcomer, id: OnceLock::new() })
    }

    /// Adds an established connection, and returns its number. If necessary, asks another connection to close.
    fn establish(&self, peer: Peer, hang_up: &Arc<Notify>) -> u64 {
        let owner = self.owner.borrow().clone();
        let mut entries = self.lock();
        entries.last += 1;
        let id = entries.last;
        entries.all.push(Entry {
            id,
            peer,
            heard: Instant::now(),
            spoke: false,
            seat: Seat::None,
            speaks_for: None,
            leaving: false,
            hang_up: Arc::clone(hang_up),
        });
        let Some(own) = entries.all.last() else { return id };
        let of_host = |entry: &Entry| !entry.owns(owner.as_ref()) && entry.is_of_same_host(own);
        let of_kind = |entry: &Entry| !entry.owns(owner.as_ref()) && entry.may_stop() == own.may_stop();
        let count = |among: &dyn Fn(&Entry) -> bool| entries.standing().filter(|entry| among(entry)).count();
        let most = if own.may_stop() { STOP_CONNECTIONS_MAX } else { CONNECTIONS_MAX };
        let (weakest, reason) = if count(&of_host) > HOST_MAX {
            (entries.weakest(id, of_host), Reason::ManyFromOneHost)
        } else if count(&|entry| entry.may_stop() == own.may_stop()) > most {
            // The owner's own connections give way only to each other.
            (entries.weakest(id, of_kind).or_else(|| entries.weakest(id, |_| true)), Reason::MadeRoom)
        } else {
            (None, Reason::MadeRoom)
        };
        weakest.into_iter().for_each(|weakest| self.hang_up(&mut entries, weakest, reason));
        // Connections that were asked to close do so as soon as their tasks run.
        if entries.all.len() > 2 * (CONNECTIONS_MAX + STOP_CONNECTIONS_MAX) {
            self.hang_up(&mut entries, id, Reason::MadeRoom);
        }
        id
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
    hang_up: Arc<Notify>,
    /// `None` once the connection is established.
    newcomer: Mutex<Option<Newcomer>>,
    /// Number of the connection, once it is established.
    id: OnceLock<u64>,
}

impl Ticket {
    /// Makes a new connection an established one, because its peer has proven its identity or sent a message.
    pub(super) fn establish(&self, peer: &Peer) {
        self.id.get_or_init(|| self.places.establish(peer.clone(), &self.hang_up));
        drop(self.newcomer.lock().unwrap_or_else(PoisonError::into_inner).take());
    }

    fn update(&self, update: impl FnOnce(&mut Entry)) {
        let Some(id) = self.id.get() else { return };
        if let Some(entry) = self.places.lock().get(*id) {
            update(entry);
        }
    }

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
        self.update(|entry| entry.heard = Instant::now());
    }

    /// Records that a complete message has arrived. `speaks_for` is the session that the peer named last.
    pub(super) fn spoke(&self, speaks_for: Option<&Claimant>) {
        self.update(|entry| {
            entry.heard = Instant::now();
            entry.spoke = true;
            if entry.speaks_for.as_ref() != speaks_for {
                entry.speaks_for = speaks_for.cloned();
            }
        });
    }

    /// Waits until the established connection has a place. `claims` is whether the connection claims the robot.
    pub(super) async fn take(&self, claims: bool) {
        let Some(&id) = self.id.get() else { return };
        if self.places.try_take(id, claims) {
            return;
        }
        for tried in 0_u32.. {
            let mut changed = std::pin::pin!(self.places.changed.notified());
            changed.as_mut().enable();
            if self.places.try_take(id, claims) {
                return;
            }
            if tried % LOOK_EVERY == 0 {
                self.look().await;
                if self.places.try_take(id, claims) {
                    return;
                }
            }
            let _again = tokio::time::timeout(ROOM_RETRY, changed).await;
        }
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        let Some(id) = self.id.get() else { return };
        self.places.lock().all.retain(|entry| entry.id != *id);
        self.places.changed.notify_waiters();
    }
}
