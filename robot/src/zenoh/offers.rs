//! The scheduler's side of texts that are published once for several robots: what was published in one place, and who asks for it.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ::zenoh::Wait;
use ::zenoh::qos::CongestionControl;
use ::zenoh::query::Query;
use urrcp::ContentHash;

use super::frame::Part;
use super::keys::{Audience, Key};
use super::network::{Call, Haste, Network};
use super::stream::Target;
use super::texts::{Kept, TEXT_MAX};

/// A text that was published where a robot stands. A frame to the robot names it instead of carrying its bytes.
#[derive(Clone, Debug)]
pub struct Text {
    pub(super) hash: ContentHash,
    pub(super) bytes: Arc<[u8]>,
}

impl From<Vec<u8>> for Text {
    fn from(bytes: Vec<u8>) -> Self {
        Self { hash: ContentHash::of(&bytes), bytes: bytes.into() }
    }
}

impl Text {
    /// Its length in bytes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Whether it has no bytes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Its bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// All of it from some byte on, behind so many bytes of a frame's content.
    pub(super) fn part(&self, from: usize, at: usize) -> io::Result<Part> {
        let small = |size: usize| u32::try_from(size).map_err(io::Error::other);
        let count = small(self.len().saturating_sub(from))?;
        Ok(Part { text: self.hash, from: small(from)?, count, at: small(at)? })
    }
}

/// What one session publishes for the robots of one place.
#[derive(Debug)]
pub(super) struct Offers {
    /// Where it is asked; it publishes below that.
    key: String,
    offered: Mutex<Offered>,
}

#[derive(Debug, Default)]
struct Offered {
    kept: Kept,
    /// By audience.
    targets: HashMap<Audience, Arc<Target>>,
    /// What was found to be too long.
    too_long: HashSet<ContentHash>,
    /// Robots that did not get what was published, also when they asked for it.
    without: HashSet<String>,
}

impl Offered {
    fn target(&mut self, key: &str, audience: Audience) -> Option<Arc<Target>> {
        match self.targets.entry(audience) {
            Entry::Occupied(known) => Some(Arc::clone(known.get())),
            Entry::Vacant(new) => {
                Some(Arc::clone(new.insert(Target::new(format!("{key}/{audience}")).ok()?)))
            }
        }
    }
}

impl Offers {
    pub(super) fn new(key: String) -> Arc<Self> {
        Arc::new(Self { key, offered: Mutex::default() })
    }

    fn lock(&self) -> MutexGuard<'_, Offered> {
        self.offered.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The text of this hash, which is published for an audience first where it was not, or has been forgotten since. `None` where it is
    /// too long.
    pub(super) fn offer(
        &self,
        network: &Network,
        (audience, hash): (Audience, ContentHash),
        text: impl FnOnce() -> Vec<u8>,
    ) -> Option<Text> {
        let mut offered = self.lock();
        if let Some(bytes) = offered.kept.get(hash) {
            return Some(Text { hash, bytes: Arc::clone(bytes) });
        }
        if offered.too_long.contains(&hash) {
            return None;
        }
        let text = text();
        if text.len() > TEXT_MAX || ContentHash::of(&text) != hash {
            offered.too_long.insert(hash);
            return None;
        }
        let target = offered.target(&self.key, audience)?;
        let bytes: Arc<[u8]> = text.as_slice().into();
        offered.kept.keep(hash, Arc::clone(&bytes));
        // Asked for before anyone else can name it: frames that do are published behind it.
        network.call(Haste::None, move |session| {
            let put =
                session.put(target.declared(session), text).congestion_control(CongestionControl::Block);
            if let Err(error) = put.wait() {
                tracing::debug!("a script was not published, robots ask for it: {error}");
            }
        });
        Some(Text { hash, bytes })
    }

    /// Answers a robot that asks for a text; what has been forgotten is not answered.
    pub(super) fn answer(&self, query: Query, speaking: &flume::Sender<Call>) {
        let asked = query.payload().and_then(|asked| <[u8; 32]>::try_from(&*asked.to_bytes()).ok());
        let Some(text) = asked.and_then(|hash| self.lock().kept.get(hash.into()).cloned()) else { return };
        let own = query.key_expr().clone().into_owned();
        // Its thread ends with the network.
        let _ended = speaking.send(Box::new(move |_| {
            if let Err(error) = query.reply(own, text.to_vec()).wait() {
                tracing::debug!("a script that a robot asks for was not sent: {error}");
            }
        }));
    }

    /// A robot did not get what was published: it is sent everything whole from now on.
    pub(super) fn note_lack(&self, key: &Key) {
        tracing::debug!("the robot at {key} does not get what is published for several robots");
        self.lock().without.insert(key.to_string());
    }

    #[cfg(test)]
    pub(super) fn forget(&self) {
        self.lock().kept = Kept::default();
    }

    pub(super) fn reach(&self, key: &Key) -> bool {
        !self.lock().without.contains(&key.to_string())
    }
}
