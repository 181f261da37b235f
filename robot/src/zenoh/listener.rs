//! The robot's side of a connection, which accepts it.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use ::zenoh::query::Query;
use ::zenoh::sample::Sample;
use ::zenoh::{Session, Wait};
use tokio::sync::{mpsc, oneshot};

use super::hearing::Hearing;
use super::keys::{HEARS, Key, LinkId, STOPS, asked_to_hear};
use super::network::{Kept, Network, Urgency};
use super::presence::Following;
use super::stream::{Shared, Stream, Target, link_of};

/// Maximum number of opened connections that the robot has not accepted yet. If there are more, requests to open a connection are not
/// answered.
const WAITING_MAX: usize = 64;

/// A robot that is reachable in a Zenoh network. Dropping the listener makes the robot unreachable; existing connections remain.
#[derive(Debug)]
pub struct Listener {
    key: Key,
    network: Network,
    opened: mpsc::Receiver<Stream>,
    kept: Option<Kept>,
}

impl Listener {
    /// Makes the robot reachable at a key.
    ///
    /// # Errors
    /// Another robot already uses the key, or the network does not carry messages.
    pub async fn bind(network: &Network, key: Key) -> io::Result<Self> {
        let (told, declared) = oneshot::channel();
        let (accept, opened) = mpsc::channel(WAITING_MAX);
        let links = Links(Arc::new(Inner {
            key: key.clone(),
            network: network.clone(),
            open: Mutex::default(),
            accept,
        }));
        if is_taken(network, &key).await? {
            let why = "another robot already uses this key; each robot needs its own key";
            return Err(io::Error::new(io::ErrorKind::AddrInUse, why));
        }
        network.declare(Urgency::None, move |session| {
            let _waits = told.send(links.declare(session).map_err(|error| error.to_string()));
        });
        let kept = declared.await.map_err(|_| ended())?.map_err(io::Error::other)?;
        Ok(Self { key, network: network.clone(), opened, kept: Some(kept) })
    }

    /// Returns the key of the robot.
    #[must_use]
    pub const fn key(&self) -> &Key {
        &self.key
    }

    /// Waits for the next connection and accepts it.
    ///
    /// # Errors
    /// The Zenoh session has ended.
    pub async fn accept(&mut self) -> io::Result<Stream> {
        self.opened.recv().await.ok_or_else(ended)
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        let kept = self.kept.take();
        self.network.declare(Urgency::None, move |_| drop(kept));
    }
}

fn ended() -> io::Error {
    io::Error::other("the Zenoh session has ended")
}

/// Whether a robot that belongs to another Zenoh session already uses this key.
async fn is_taken(network: &Network, key: &Key) -> io::Result<bool> {
    let (found, mut tokens) = mpsc::unbounded_channel();
    let (told, asked) = oneshot::channel();
    let tokens_at = key.robot("*");
    network.declare(Urgency::None, move |session| {
        let reply = move |_| {
            let _gave_up = found.send(());
        };
        let asking = session.liveliness().get(tokens_at).callback(reply).wait();
        let _waits = told.send(asking.map_err(|error| error.to_string()));
    });
    asked.await.map_err(|_| ended())?.map_err(io::Error::other)?;
    Ok(tokens.recv().await.is_some())
}

#[derive(Clone)]
struct Links(Arc<Inner>);

struct Inner {
    key: Key,
    network: Network,
    open: Mutex<HashMap<LinkId, Open>>,
    accept: mpsc::Sender<Stream>,
}

#[derive(Clone)]
struct Open {
    pipe: Shared,
    /// Texts that the scheduler publishes for several robots. `None` if the connection does not use any.
    hearing: Option<Arc<Hearing>>,
}

impl Inner {
    fn lock(&self) -> MutexGuard<'_, HashMap<LinkId, Open>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Entry of a connection in the robot's list. When the connection ends, this value is dropped, which removes the connection from the
/// list.
struct Listed {
    link: LinkId,
    links: Weak<Inner>,
    _following: Following,
}

impl Drop for Listed {
    fn drop(&mut self) {
        self.links.upgrade().and_then(|links| links.lock().remove(&self.link));
    }
}

impl Links {
    /// Declares everything that makes the robot reachable. The liveliness token is declared last.
    fn declare(self, session: &Session) -> ::zenoh::Result<Kept> {
        let Inner { key, network, .. } = &*self.0;
        network.watch(session, key.scheduler("*"))?;
        let links = self.clone();
        // Declared separately, so that Zenoh delivers frames to this robot without comparing them with other keys.
        let to = session.declare_keyexpr(key.to()).wait()?;
        let frames = session.declare_subscriber(to.clone());
        let frames = frames.callback(move |sample: Sample| links.hear(&sample)).wait()?;
        let links = self.clone();
        let open = session.declare_queryable(key.open()).complete(true);
        let open = open.callback(move |query: Query| links.open(query)).wait()?;
        let token = session.liveliness().declare_token(key.robot(network.id())).wait()?;
        Ok(Box::new(Mutex::new((frames, to, open, token))))
    }

    fn hear(&self, sample: &Sample) {
        // Frames may still arrive for a connection that has ended.
        let open = link_of(sample).and_then(|link| self.0.lock().get(&link).cloned());
        let Some(Open { pipe, hearing }) = open else { return };
        let Some(text) = pipe.receive(sample) else { return };
        match hearing {
            Some(hearing) => hearing.supply(text, &pipe, &self.0.network),
            None => pipe.lock().break_off("the peer refers to a script that is not published"),
        }
    }

    fn open(&self, query: Query) {
        let asked = query.payload().map(|asked| String::from_utf8_lossy(&asked.to_bytes()).into_owned());
        let Some(asked) = asked else { return };
        let (name, how) = asked.split_once(' ').unwrap_or((&asked, ""));
        let haste = match how {
            STOPS => Urgency::Stop,
            "" => Urgency::None,
            _ => return,
        };
        let Ok(link) = name.parse::<LinkId>() else { return };
        let Inner { key, network, accept, .. } = &*self.0;
        let Ok(place) = accept.try_reserve() else { return };
        let pipe = Shared::default();
        let Ok(target) = Target::new(key.from(&link.session())) else { return };
        let audiences = asked_to_hear(query.attachment());
        let hears = haste == Urgency::None && !audiences.is_empty();
        let hearing = hears.then(|| network.hearing(key.shared(&link.session()))).flatten();
        match self.0.lock().entry(link) {
            // A peer opens each connection only once.
            Entry::Occupied(_) => return,
            Entry::Vacant(new) => new.insert(Open { pipe: pipe.clone(), hearing: hearing.clone() }),
        };
        let following = network.tokens().follow(&key.scheduler(&link.session()), &pipe);
        let answer = Answer { query, robot: network.id().to_owned() };
        match hearing {
            None => network.call(haste, move |_| answer.send(None)),
            // The answer is sent after this declaration, so that the robot receives every text that is published after the answer.
            Some(hearing) => {
                network.declare(haste, move |session| match hearing.begin(session, &audiences) {
                    Ok(()) => answer.send(Some(HEARS)),
                    Err(error) => {
                        tracing::debug!(
                            "cannot receive scripts that are published for several robots: {error}"
                        );
                        answer.send(None);
                    }
                })
            }
        }
        let listed = Listed { link, links: Arc::downgrade(&self.0), _following: following };
        place.send(Stream::new(network.clone(), pipe, link, target, haste).keeping(Box::new(listed)));
    }
}

/// The answer to a peer that opens a connection. It has not been sent yet.
struct Answer {
    query: Query,
    robot: String,
}

impl Answer {
    fn send(self, hears: Option<&'static str>) {
        let Self { query, robot } = self;
        let reply = query.reply(query.key_expr().clone().into_owned(), robot);
        if let Err(error) = reply.attachment(hears).wait() {
            tracing::debug!("cannot answer a connection request over Zenoh: {error}");
        }
    }
}
