//! The side of the robot, which connections are opened to.

use std::any::Any;
use std::collections::HashMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use ::zenoh::query::Query;
use ::zenoh::sample::{Sample, SampleKind};
use ::zenoh::{Session, Wait};
use tokio::sync::{mpsc, oneshot};

use super::keys::{Key, STOPS, link_of};
use super::network::{Haste, Network};
use super::stream::{Shared, Stream};

/// Connections that were opened and not yet accepted; others are not answered.
const WAITING_MAX: usize = 64;
/// The longest name of a connection, in bytes.
const NAME_MAX: usize = 64;

/// A robot's place in a Zenoh network. Dropping it makes the robot unreachable there; connections stay.
#[derive(Debug)]
pub struct Listener {
    key: Key,
    network: Network,
    opened: mpsc::Receiver<Stream>,
    kept: Option<Kept>,
}

/// Behind a lock, because what Zenoh hands back may not be shared between threads.
type Kept = Box<dyn Any + Send + Sync>;

impl Listener {
    /// Makes a robot reachable at a key.
    ///
    /// # Errors
    /// Another robot is there already, or the network does not carry.
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
            let why = "another robot is there: each needs a key of its own";
            return Err(io::Error::new(io::ErrorKind::AddrInUse, why));
        }
        network.call(Haste::None, move |session| {
            let _waits = told.send(links.declare(session).map_err(|error| error.to_string()));
        });
        let kept = declared.await.map_err(|_| ended())?.map_err(io::Error::other)?;
        Ok(Self { key, network: network.clone(), opened, kept: Some(kept) })
    }

    /// Where the robot is reached.
    #[must_use]
    pub const fn key(&self) -> &Key {
        &self.key
    }

    /// The next connection.
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
        self.network.call(Haste::None, move |_| drop(kept));
    }
}

fn ended() -> io::Error {
    io::Error::other("the Zenoh session has ended")
}

/// Whether another session says that its robot is there.
async fn is_taken(network: &Network, key: &Key) -> io::Result<bool> {
    let (found, mut tokens) = mpsc::unbounded_channel();
    let (told, asked) = oneshot::channel();
    let tokens_at = key.robot("*");
    network.call(Haste::None, move |session| {
        let reply = move |_| {
            let _gave_up = found.send(());
        };
        let asking = session.liveliness().get(tokens_at).callback(reply).wait();
        let _waits = told.send(asking.map_err(|error| error.to_string()));
    });
    asked.await.map_err(|_| ended())?.map_err(io::Error::other)?;
    Ok(tokens.recv().await.is_some())
}

/// The connections of one robot, by their names.
#[derive(Clone)]
struct Links(Arc<Inner>);

struct Inner {
    key: Key,
    network: Network,
    open: Mutex<HashMap<String, Shared>>,
    accept: mpsc::Sender<Stream>,
}

impl Inner {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, Shared>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Takes a connection that has ended out of the list.
struct Listed {
    name: String,
    links: Weak<Inner>,
}

impl Drop for Listed {
    fn drop(&mut self) {
        self.links.upgrade().and_then(|links| links.lock().remove(&self.name));
    }
}

impl Links {
    /// Declares all that a robot is reached by; its token last.
    fn declare(self, session: &Session) -> ::zenoh::Result<Kept> {
        let key = self.0.key.clone();
        let links = self.clone();
        let frames = session.declare_subscriber(key.to("*"));
        let frames = frames.callback(move |sample: Sample| links.hear(&sample)).wait()?;
        let links = self.clone();
        let schedulers = session.liveliness().declare_subscriber(key.scheduler("*"));
        let schedulers = schedulers.callback(move |sample: Sample| links.scheduler(&sample)).wait()?;
        let links = self;
        let open = session.declare_queryable(key.open()).complete(true);
        let open = open.callback(move |query: Query| links.open(query)).wait()?;
        let token = session.liveliness().declare_token(key.robot(&session.zid().to_string())).wait()?;
        Ok(Box::new(Mutex::new((frames, schedulers, open, token))))
    }

    fn find(&self, sample: &Sample) -> Option<Shared> {
        self.0.lock().get(link_of(sample.key_expr().as_str())?).cloned()
    }

    fn hear(&self, sample: &Sample) {
        // Of a connection that has ended, something may still be on its way.
        self.find(sample).into_iter().for_each(|pipe| pipe.receive(sample));
    }

    fn scheduler(&self, sample: &Sample) {
        if sample.kind() == SampleKind::Delete
            && let Some(pipe) = self.find(sample)
        {
            pipe.lock().break_off("the scheduler's process has ended, or the way to it has");
        }
    }

    fn open(&self, query: Query) {
        let asked = query.payload().map(|asked| String::from_utf8_lossy(&asked.to_bytes()).into_owned());
        let (name, haste) = match asked.as_deref().map(|asked| asked.split_once(' ').unwrap_or((asked, ""))) {
            Some((name, STOPS)) => (Some(name.to_owned()), Haste::Stop),
            Some((name, "")) => (Some(name.to_owned()), Haste::None),
            _ => return,
        };
        let is_name = |name: &String| {
            name.len() <= NAME_MAX && !name.contains(['/', '*', '$', '?', '#']) && !name.is_empty()
        };
        let Some(name) = name.filter(is_name) else { return };
        let Inner { key, network, accept, .. } = &*self.0;
        let Ok(place) = accept.try_reserve() else { return };
        let pipe = Shared::default();
        if self.0.lock().insert(name.clone(), pipe.clone()).is_some() {
            // Nobody but its owner knows the name of a connection, and he opens it once.
            return;
        }
        let answer = network.id().to_owned();
        let own = query.key_expr().clone().into_owned();
        network.call(haste, move |_| {
            if let Err(error) = query.reply(own, answer).wait() {
                tracing::debug!("a connection by Zenoh was not answered: {error}");
            }
        });
        let listed = Listed { name: name.clone(), links: Arc::downgrade(&self.0) };
        place.send(Stream::new(network.clone(), pipe, key.from(&name), haste).keeping(Box::new(listed)));
    }
}
