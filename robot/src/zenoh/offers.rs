//! Publishes texts once for several robots, on behalf of a scheduler: the publications for the robots of one place, and the answers to
//! their requests for texts.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ::zenoh::Wait;
use ::zenoh::qos::CongestionControl;
use ::zenoh::query::Query;
use urrcp::ContentHash;

use super::frame::TextPart;
use super::keys::{Audience, Key};
use super::network::{Call, Network, Urgency};
use super::stream::Target;
use super::texts::{Kept, TEXT_MAX};

/// A text that was published for several robots. A frame to one of these robots refers to the text instead of containing its bytes.
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
    /// Returns the length of the text in bytes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Whether the text is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Returns the bytes of the text.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns a reference to the bytes of the text from `from` to its end. A frame inserts these bytes after `at` bytes of its content.
    pub(super) fn part(&self, from: usize, at: usize) -> io::Result<TextPart> {
        let small = |size: usize| u32::try_from(size).map_err(io::Error::other);
        let count = small(self.len().saturating_sub(from))?;
        Ok(TextPart { text: self.hash, from: small(from)?, count, at: small(at)? })
    }
}

/// The texts that one session publishes for the robots of one place (robots whose keys differ only in the last chunk).
#[derive(Debug)]
pub(super) struct Offers {
    /// Key at which the session answers requests for texts. It publishes the texts at keys below this one.
    key: String,
    offered: Mutex<Offered>,
}

#[derive(Debug, Default)]
struct Offered {
    kept: Kept,
    /// Keys at which texts are published, by audience (a group of robots).
    targets: HashMap<Audience, Arc<Target>>,
    /// Hashes of texts that cannot be published, because they are too long.
    too_long: HashSet<ContentHash>,
    /// Keys of robots that did not receive a published text, even on request.
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

    /// Returns the text with this hash. Publishes it first for the audience, unless this session has already published it and still keeps
    /// it. `None` if the text is too long.
    pub(super) fn offer(
        &self,
        network: &Network,
        audience: Audience,
        hash: ContentHash,
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
        // The publication is queued before any other caller can refer to the text. Frames that refer to it are therefore published after
        // it.
        network.call(Urgency::None, move |session| {
            let put =
                session.put(target.declared(session), text).congestion_control(CongestionControl::Block);
            if let Err(error) = put.wait() {
                tracing::debug!("cannot publish a script, so each robot will request it: {error}");
            }
        });
        Some(Text { hash, bytes })
    }

    /// Answers a robot's request for a published text. If the text is no longer kept, the request is not answered.
    pub(super) fn answer(&self, query: Query, speaking: &flume::Sender<Call>) {
        let asked = query.payload().and_then(|asked| <[u8; 32]>::try_from(&*asked.to_bytes()).ok());
        let Some(text) = asked.and_then(|hash| self.lock().kept.get(hash.into()).cloned()) else { return };
        let own = query.key_expr().clone().into_owned();
        // Sending fails only if the network has ended, and its thread with it.
        let _ended = speaking.send(Box::new(move |_| {
            if let Err(error) = query.reply(own, text.to_vec()).wait() {
                tracing::debug!("cannot send a script that a robot requested: {error}");
            }
        }));
    }

    /// Records that a robot did not receive a published text. After that, this robot receives complete messages.
    pub(super) fn note_lack(&self, key: &Key) {
        tracing::debug!("the robot at {key} does not receive scripts that are published for several robots");
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
