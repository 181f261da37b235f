//! A Zenoh session of a process. Threads of its own speak on it, because Zenoh waits where its queues are full: one for what is
//! in haste, which nothing else keeps waiting, one for other frames, and one on which connections begin and end: a declaration
//! takes the longer the more robots there are, and frames do not wait behind it.

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

/// Whether what is sent on a connection goes ahead of all others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Haste {
    /// In its turn.
    #[default]
    None,
    /// Ahead of everything else, at every router: for stops.
    Stop,
}

impl Haste {
    pub(super) const fn priority(self) -> Priority {
        match self {
            Self::None => Priority::Data,
            Self::Stop => Priority::RealTime,
        }
    }
}

pub(super) type Call = Box<dyn FnOnce(&Session) + Send>;

/// What has to be undeclared by being dropped, behind a lock, because what Zenoh hands back may not be shared between threads.
pub(super) type Kept = Box<dyn Any + Send + Sync>;

/// A way into a Zenoh network. Clones are the same session, which ends with the last of them.
#[derive(Clone)]
pub struct Network(Arc<Inner>);

/// Connections that are being opened; others wait. If thousands were opened at once, each would take longer than the two seconds that it has,
/// and what is said on those that are open already would wait behind them at the routers.
#[derive(Debug)]
pub(super) struct Opening {
    calm: Semaphore,
    /// No stop waits for others.
    hasty: Semaphore,
}

/// How many connections are opened at the same time.
pub(super) const OPENING_MAX: usize = 64;
/// The same for stops, which go ahead of all others: most are opened in advance.
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
    /// What other sessions show this one.
    tokens: Tokens,
    /// What was declared for as long as the session lasts, by its keys.
    lasting: Mutex<HashMap<String, Kept>>,
    /// What it publishes for several robots, by its keys.
    offers: Mutex<HashMap<String, Arc<Offers>>>,
    /// What it hears of schedulers that do so, by their keys.
    hearings: Mutex<HashMap<String, Weak<Hearing>>>,
}

/// Sessions of schedulers of which a session hears what they publish for several robots of one place; others send everything whole.
pub(super) const HEARINGS_MAX: usize = 16;

impl Drop for Inner {
    fn drop(&mut self) {
        let lasting = std::mem::take(&mut self.lasting);
        // Zenoh may wait, and this may be a thread of an asynchronous runtime.
        let _ended = self.declaring.send(Box::new(move |_| drop(lasting)));
    }
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Network").field(&self.0.id).finish()
    }
}

impl Network {
    /// Joins the network that a configuration file of Zenoh describes. It looks for no other members by multicast, unless the
    /// file says so.
    ///
    /// # Errors
    /// [`NetworkError`]: the file cannot be used, or no router of it answers.
    pub fn open(file: &Path) -> Result<Self, NetworkError> {
        Self::with(config::read(file)?, &file.display().to_string(), Arc::default())
    }

    /// The same with a configuration in JSON5.
    ///
    /// # Errors
    /// As [`Network::open`].
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
            Err(_) => return Err(NetworkError::not_joined(named, "its thread has ended")),
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

    /// The id of the session.
    #[must_use]
    pub fn id(&self) -> &str {
        &self.0.id
    }

    /// Waits until a connection may be opened, which is being opened as long as what this returns is kept.
    pub(super) async fn may_open(&self, haste: Haste) -> io::Result<SemaphorePermit<'_>> {
        let opening = match haste {
            Haste::None => &self.0.opening.calm,
            Haste::Stop => &self.0.opening.hasty,
        };
        opening.acquire().await.map_err(io::Error::other)
    }

    /// A name that no other connection has.
    pub(super) fn connection(&self) -> io::Result<LinkId> {
        let number = self.0.connections.fetch_add(1, Ordering::Relaxed);
        LinkId::new(self.id(), number).ok_or_else(|| io::Error::other("the Zenoh session has an unusual id"))
    }

    /// What other sessions show this one.
    pub(super) fn tokens(&self) -> &Tokens {
        &self.0.tokens
    }

    /// Hears of the tokens at these keys, for as long as the session lasts.
    pub(super) fn watch(&self, session: &Session, keys: String) -> ::zenoh::Result<()> {
        self.once(keys, |keys| {
            let tokens = self.tokens().clone();
            let told = session.liveliness().declare_subscriber(keys).history(true);
            Ok(Box::new(Mutex::new(told.callback(move |sample: Sample| tokens.hear(&sample)).wait()?)))
        })
    }

    /// Shows a token to other sessions, for as long as this one lasts.
    pub(super) fn show(&self, session: &Session, token: String) -> ::zenoh::Result<()> {
        self.once(token, |token| Ok(Box::new(Mutex::new(session.liveliness().declare_token(token).wait()?))))
    }

    /// What this session publishes for several robots that stand where this one does; it answers who asks for it.
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

    /// What this session hears of what a scheduler publishes at a key for several robots; `None` where it hears too many there already.
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

    /// Begins or ends something with the session, which may take its time.
    pub(super) fn declare(&self, haste: Haste, call: impl FnOnce(&Session) + Send + 'static) {
        let calls = match haste {
            Haste::None => &self.0.declaring,
            Haste::Stop => &self.0.hasty,
        };
        // Its thread ends with this.
        let _ended = calls.send(Box::new(call));
    }

    /// Does this with the session, behind what it was asked for before.
    pub(super) fn call(&self, haste: Haste, call: impl FnOnce(&Session) + Send + 'static) {
        let calls = match haste {
            Haste::None => &self.0.calm,
            Haste::Stop => &self.0.hasty,
        };
        // Its thread ends with this.
        let _ended = calls.send(Box::new(call));
    }

    /// Ends the session at once, as if its process had ended.
    #[cfg(test)]
    pub(super) fn cut(&self) {
        self.call(Haste::None, |session| session.close().wait().unwrap_or_default());
    }

    /// Publishes a frame of a connection, which breaks if that fails.
    pub(super) fn publish(
        &self,
        haste: Haste,
        (link, target): (LinkId, Arc<Target>),
        frame: Vec<u8>,
        pipe: &Shared,
    ) {
        let pipe = pipe.clone();
        self.call(haste, move |session| {
            let put = session.put(target.declared(session), frame).attachment(link.encode());
            let put = put.congestion_control(CongestionControl::Block).priority(haste.priority());
            if let Err(error) = put.wait() {
                pipe.lock().break_off(&format!("Zenoh does not send: {error}"));
            }
        });
    }
}

/// A thread that does what it is asked for with a session, until nobody can ask any more.
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
