//! A Zenoh session of a process. Zenoh blocks if its queues are full, so separate threads send: one sends urgent messages, which no other
//! message delays, and one sends other frames. A third thread opens and closes connections: each declaration takes longer the more robots
//! there are, and frames must not wait for it.

use std::any::Any;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fmt;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use ::zenoh::qos::{CongestionControl, Priority};
use ::zenoh::query::Query;
use ::zenoh::sample::Sample;
use ::zenoh::{Session, Wait};
use tokio::sync::{Semaphore, SemaphorePermit};

use super::config::{self, NetworkError};
use super::hearing::Hearing;
use super::keys::{Key, LinkId};
use super::offers::Offers;
use super::presence::Tokens;
use super::stream::{Shared, Target};

/// Priority of the messages on a connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Urgency {
    /// Normal priority.
    #[default]
    None,
    /// Precedence over all other messages at every router. Used for stops.
    Stop,
}

impl Urgency {
    pub(super) const fn priority(self) -> Priority {
        match self {
            Self::None => Priority::Data,
            Self::Stop => Priority::RealTime,
        }
    }
}

pub(super) type Call = Box<dyn FnOnce(&Session) + Send>;

/// Zenoh objects that are undeclared when they are dropped. They are wrapped in a lock if threads may not share them.
pub(super) type Kept = Box<dyn Any + Send + Sync>;

/// Access to a Zenoh network. Clones share one session, which ends when the last clone is dropped.
#[derive(Clone)]
pub struct Network(Arc<Inner>);

/// Limits the number of connections that are being opened at the same time; further ones wait. If thousands were opened at once, each
/// would exceed its time limit of two seconds, and messages on open connections would wait behind them at the routers.
#[derive(Debug)]
pub(super) struct Opening {
    calm: Semaphore,
    /// Permits for connections that are opened for stops. They do not wait for other connections.
    hasty: Semaphore,
}

/// Maximum number of connections that are being opened at the same time.
pub(super) const OPENING_MAX: usize = 64;
/// Maximum number of connections for stops that are being opened at the same time. Most connections for stops are opened in advance, and
/// they take precedence over all others.
const STOPS_OPENING_MAX: usize = 32;

impl Default for Opening {
    fn default() -> Self {
        Self { calm: Semaphore::new(OPENING_MAX), hasty: Semaphore::new(STOPS_OPENING_MAX) }
    }
}

struct Inner {
    id: String,
    opening: Arc<Opening>,
    calm: flume::Sender<Call>,
    hasty: flume::Sender<Call>,
    declaring: flume::Sender<Call>,
    connections: AtomicU64,
    /// Liveliness tokens of other sessions.
    tokens: Tokens,
    /// Declarations that last as long as the session, by their keys.
    lasting: Mutex<HashMap<String, Kept>>,
    /// What this session publishes for several robots at once, by key.
    offers: Mutex<HashMap<String, Arc<Offers>>>,
    /// This session's subscriptions to what schedulers publish for several robots at once, by key.
    hearings: Mutex<HashMap<String, Weak<Hearing>>>,
}

/// Maximum number of schedulers' sessions in one place (the robots' common key prefix) whose texts for several robots this session
/// receives. Further sessions of schedulers send complete messages instead.
pub(super) const HEARINGS_MAX: usize = 16;

impl Drop for Inner {
    fn drop(&mut self) {
        let lasting = std::mem::take(&mut self.lasting);
        // Zenoh may block, and the caller may be a thread of an asynchronous runtime.
        let _ended = self.declaring.send(Box::new(move |_| drop(lasting)));
    }
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Network").field(&self.0.id).finish()
    }
}

impl Network {
    /// Joins the network that a Zenoh configuration file describes. The session searches for other members by multicast only if the file
    /// enables this.
    ///
    /// # Errors
    /// [`NetworkError`] if the file cannot be used, or if none of its routers answers.
    pub fn open(file: &Path) -> Result<Self, NetworkError> {
        Self::with(config::read(file)?, &file.display().to_string(), Arc::default())
    }

    /// Like [`Network::open`], but takes the configuration as a JSON5 text.
    ///
    /// # Errors
    /// Those of [`Network::open`].
    pub fn open_with(json5: &str) -> Result<Self, NetworkError> {
        Self::with(config::parse(json5)?, "the configuration", Arc::default())
    }

    pub(super) fn with(
        config: ::zenoh::Config,
        named: &str,
        opening: Arc<Opening>,
    ) -> Result<Self, NetworkError> {
        let (tell, opened) = flume::bounded(1);
        let calm = speak("zenoh", move || {
            let session = ::zenoh::open(config).wait().map(|session| (session.clone(), session));
            let (told, session) =
                session.map_or_else(|error| (Err(error), None), |(one, two)| (Ok(one), Some(two)));
            let _waits = tell.send(told);
            session
        })?;
        let session = match opened.recv() {
            Ok(Ok(session)) => session,
            Ok(Err(error)) => return Err(NetworkError::not_joined(named, error.as_ref())),
            Err(_) => {
                return Err(NetworkError::not_joined(
                    named,
                    "the thread that opens the Zenoh session has ended",
                ));
            }
        };
        let id = session.zid().to_string();
        let another = session.clone();
        let hasty = speak("zenoh-haste", move || Some(session))?;
        let declaring = speak("zenoh-declare", move || Some(another))?;
        Ok(Self(Arc::new(Inner {
            id,
            opening,
            calm,
            hasty,
            declaring,
            connections: AtomicU64::new(0),
            tokens: Tokens::default(),
            lasting: Mutex::default(),
            offers: Mutex::default(),
            hearings: Mutex::default(),
        })))
    }

    /// Returns the id of the Zenoh session.
    #[must_use]
    pub fn id(&self) -> &str {
        &self.0.id
    }

    /// Waits for permission to open a connection. The returned permit must be kept while the connection is being opened.
    pub(super) async fn may_open(&self, haste: Urgency) -> io::Result<SemaphorePermit<'_>> {
        let opening = match haste {
            Urgency::None => &self.0.opening.calm,
            Urgency::Stop => &self.0.opening.hasty,
        };
        opening.acquire().await.map_err(io::Error::other)
    }

    /// Returns an id that no other connection has.
    pub(super) fn connection(&self) -> io::Result<LinkId> {
        let number = self.0.connections.fetch_add(1, Ordering::Relaxed);
        LinkId::new(self.id(), number).ok_or_else(|| io::Error::other("unexpected id of the Zenoh session"))
    }

    /// Returns the liveliness tokens of other sessions that this session observes.
    pub(super) fn tokens(&self) -> &Tokens {
        &self.0.tokens
    }

    /// Observes the liveliness tokens at these keys until the session ends.
    pub(super) fn watch(&self, session: &Session, keys: String) -> ::zenoh::Result<()> {
        self.once(keys, |keys| {
            let tokens = self.tokens().clone();
            let told = session.liveliness().declare_subscriber(keys).history(true);
            Ok(Box::new(Mutex::new(told.callback(move |sample: Sample| tokens.hear(&sample)).wait()?)))
        })
    }

    /// Declares a liveliness token of this session, which exists until the session ends.
    pub(super) fn show(&self, session: &Session, token: String) -> ::zenoh::Result<()> {
        self.once(token, |token| Ok(Box::new(Mutex::new(session.liveliness().declare_token(token).wait()?))))
    }

    /// Returns what this session publishes for several robots in the place of the robot at `key`. The first call creates this, and starts
    /// to answer robots' requests for published texts.
    pub(super) fn offers(&self, session: &Session, key: &Key) -> ::zenoh::Result<Arc<Offers>> {
        let key = key.shared(self.id());
        let mut all = self.0.offers.lock().unwrap_or_else(PoisonError::into_inner);
        let offers = match all.entry(key.clone()) {
            Entry::Occupied(known) => Arc::clone(known.get()),
            Entry::Vacant(new) => Arc::clone(new.insert(Offers::new(key.clone()))),
        };
        drop(all);
        self.once(key, |key| {
            let (offers, speaking) = (Arc::clone(&offers), self.0.calm.clone());
            let declared = session.declare_queryable(key);
            let declared = declared.callback(move |query: Query| offers.answer(query, &speaking));
            Ok(Box::new(Mutex::new(declared.wait()?)))
        })?;
        Ok(offers)
    }

    /// Returns this session's subscription to what a scheduler publishes for several robots. `None` if the session already has
    /// [`HEARINGS_MAX`] subscriptions in this place.
    pub(super) fn hearing(&self, key: String) -> Option<Arc<Hearing>> {
        let mut all = self.0.hearings.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = all.get(&key).and_then(Weak::upgrade) {
            return Some(known);
        }
        all.retain(|_, hearing| hearing.strong_count() > 0);
        let place = |key: &str| key.rsplit_once('/').map_or(0, |(place, _)| place.len());
        let beside = all.keys().filter(|other| key[..place(&key)] == other[..place(other)]).count();
        (beside < HEARINGS_MAX).then(|| {
            let hearing = Hearing::new(key.clone(), self.0.declaring.clone());
            all.insert(key, Arc::downgrade(&hearing));
            hearing
        })
    }

    fn once(
        &self,
        key: String,
        declare: impl FnOnce(String) -> ::zenoh::Result<Kept>,
    ) -> ::zenoh::Result<()> {
        let mut lasting = self.0.lasting.lock().unwrap_or_else(PoisonError::into_inner);
        if let Entry::Vacant(new) = lasting.entry(key) {
            let kept = declare(new.key().clone())?;
            new.insert(kept);
        }
        Ok(())
    }

    /// Executes a slow call: a declaration, or the end of one. A separate thread of the session executes it, or, if it is urgent, the
    /// thread for urgent messages.
    pub(super) fn declare(&self, haste: Urgency, call: impl FnOnce(&Session) + Send + 'static) {
        let calls = match haste {
            Urgency::None => &self.0.declaring,
            Urgency::Stop => &self.0.hasty,
        };
        // Sending fails only if the network has ended, and its thread with it.
        let _ended = calls.send(Box::new(call));
    }

    /// Executes a call on the session, after all earlier calls of the same urgency.
    pub(super) fn call(&self, haste: Urgency, call: impl FnOnce(&Session) + Send + 'static) {
        let calls = match haste {
            Urgency::None => &self.0.calm,
            Urgency::Stop => &self.0.hasty,
        };
        // Sending fails only if the network has ended, and its thread with it.
        let _ended = calls.send(Box::new(call));
    }

    /// Ends the session at once, as if its process had ended. Only for tests.
    #[cfg(test)]
    pub(super) fn cut(&self) {
        self.call(Urgency::None, |session| session.close().wait().unwrap_or_default());
    }

    /// Publishes a frame of a connection. If this fails, the connection breaks.
    pub(super) fn publish(
        &self,
        haste: Urgency,
        link: LinkId,
        target: Arc<Target>,
        frame: Vec<u8>,
        pipe: &Shared,
    ) {
        let pipe = pipe.clone();
        self.call(haste, move |session| {
            let put = session.put(target.declared(session), frame).attachment(link.encode());
            let put = put.congestion_control(CongestionControl::Block).priority(haste.priority());
            if let Err(error) = put.wait() {
                pipe.lock().break_off(&format!("Zenoh cannot send: {error}"));
            }
        });
    }
}

/// Starts a thread that executes calls on a session. It runs until all senders of calls are dropped.
fn speak(
    name: &str,
    session: impl FnOnce() -> Option<Session> + Send + 'static,
) -> Result<flume::Sender<Call>, NetworkError> {
    let (asks, calls) = flume::unbounded::<Call>();
    let thread = std::thread::Builder::new().name(name.to_owned());
    let speaking = thread.spawn(move || {
        let session = session();
        session.iter().for_each(|session| calls.iter().for_each(|call| call(session)));
    });
    speaking.map(|_| asks).map_err(NetworkError::Thread)
}
