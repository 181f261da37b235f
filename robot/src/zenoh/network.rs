//! The Zenoh session of a process. Two threads of its own speak on it, because Zenoh waits where its queues are full: one for
//! what is in haste, which nothing else keeps waiting, and one for the rest.

use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use ::zenoh::qos::{CongestionControl, Priority};
use ::zenoh::{Session, Wait};

use super::config::{self, NetworkError};
use super::stream::Shared;

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

type Call = Box<dyn FnOnce(&Session) + Send>;

/// A way into a Zenoh network. Clones are the same session, which ends with the last of them.
#[derive(Clone)]
pub struct Network(Arc<Inner>);

struct Inner {
    id: String,
    open_endpoint: Option<String>,
    calm: flume::Sender<Call>,
    hasty: flume::Sender<Call>,
    connections: AtomicU64,
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
        Self::with(config::read(file)?, &file.display().to_string())
    }

    /// The same with a configuration in JSON5.
    ///
    /// # Errors
    /// As [`Network::open`].
    pub fn open_with(json5: &str) -> Result<Self, NetworkError> {
        Self::with(config::parse(json5)?, "the configuration")
    }

    fn with(config: ::zenoh::Config, named: &str) -> Result<Self, NetworkError> {
        let open_endpoint = config::open_endpoint(&config);
        let ((calm, calls), (hasty, hasty_calls)) = (flume::unbounded::<Call>(), flume::unbounded::<Call>());
        let (tell, opened) = flume::bounded(1);
        let thread = std::thread::Builder::new().name("zenoh".to_owned());
        let speaking = thread.spawn(move || {
            let session = ::zenoh::open(config).wait().map(|session| (session.clone(), session));
            let (told, session) =
                session.map_or_else(|error| (Err(error), None), |(one, two)| (Ok(one), Some(two)));
            let _waits = tell.send(told);
            session.iter().for_each(|session| calls.iter().for_each(|call| call(session)));
        });
        speaking.map_err(NetworkError::Thread)?;
        let session = match opened.recv() {
            Ok(Ok(session)) => session,
            Ok(Err(error)) => return Err(NetworkError::not_joined(named, error.as_ref())),
            Err(_) => return Err(NetworkError::not_joined(named, "its thread has ended")),
        };
        let id = session.zid().to_string();
        let thread = std::thread::Builder::new().name("zenoh-haste".to_owned());
        let speaking = thread.spawn(move || hasty_calls.iter().for_each(|call| call(&session)));
        speaking.map_err(NetworkError::Thread)?;
        Ok(Self(Arc::new(Inner { id, open_endpoint, calm, hasty, connections: AtomicU64::new(0) })))
    }

    /// The id of the session.
    #[must_use]
    pub fn id(&self) -> &str {
        &self.0.id
    }

    /// An endpoint of its configuration that is neither on this machine nor protected by TLS.
    #[must_use]
    pub fn open_endpoint(&self) -> Option<&str> {
        self.0.open_endpoint.as_deref()
    }

    /// A name that no other connection has.
    pub(super) fn connection(&self) -> String {
        format!("{}.{}", self.0.id, self.0.connections.fetch_add(1, Ordering::Relaxed))
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
    pub(super) fn publish(&self, haste: Haste, key: String, frame: Vec<u8>, pipe: &Shared) {
        let pipe = pipe.clone();
        self.call(haste, move |session| {
            let put = session.put(key, frame);
            let put = put.congestion_control(CongestionControl::Block).priority(haste.priority());
            if let Err(error) = put.wait() {
                pipe.lock().break_off(&format!("Zenoh does not send: {error}"));
            }
        });
    }
}
