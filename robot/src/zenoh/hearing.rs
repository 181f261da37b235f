//! Receives texts that one scheduler publishes once for several robots, on behalf of the robots of this process. Requests texts that did
//! not arrive.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use ::zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use ::zenoh::sample::Sample;
use ::zenoh::{Session, Wait};
use urrcp::ContentHash;

use super::keys::Audience;
use super::network::{Call, Kept, Network, Urgency};
use super::stream::Shared;
use super::texts::{Supply, TEXT_MAX, Texts};

/// Time limit for a scheduler's answer to a robot's request for a published text.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Maximum number of a scheduler's audiences (groups of robots) to which the robots of this process may belong.
const SUBSCRIBERS_MAX: usize = 4_096;

/// The texts that one scheduler's session publishes for several robots. Exists as long as a connection needs the texts.
pub(super) struct Hearing {
    /// Key at which the scheduler answers requests for published texts.
    key: String,
    texts: Mutex<Texts>,
    /// One subscriber for each audience (a group of robots). Dropping the `Hearing` undeclares the subscribers.
    subscribers: Mutex<HashMap<Audience, Kept>>,
    declaring: flume::Sender<Call>,
}

impl Hearing {
    pub(super) fn new(key: String, declaring: flume::Sender<Call>) -> Arc<Self> {
        Arc::new(Self { key, texts: Mutex::default(), subscribers: Mutex::default(), declaring })
    }

    fn texts(&self) -> MutexGuard<'_, Texts> {
        self.texts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Subscribes to the texts that are published for these audiences (groups of robots).
    pub(super) fn begin(self: &Arc<Self>, session: &Session, audiences: &[Audience]) -> ::zenoh::Result<()> {
        let mut subscribers = self.subscribers.lock().unwrap_or_else(PoisonError::into_inner);
        for audience in audiences {
            if subscribers.len() >= SUBSCRIBERS_MAX {
                return Err("too many groups that share published scripts".into());
            }
            if let Entry::Vacant(new) = subscribers.entry(*audience) {
                new.insert(self.subscriber(session, *audience)?);
            }
        }
        Ok(())
    }

    fn subscriber(self: &Arc<Self>, session: &Session, audience: Audience) -> ::zenoh::Result<Kept> {
        let hearing = Arc::downgrade(self);
        // Declared separately, so that Zenoh compares publications with no other keys.
        let key = session.declare_keyexpr(format!("{}/{audience}", self.key)).wait()?;
        let declared = session.declare_subscriber(key.clone()).callback(move |sample: Sample| {
            hearing.upgrade().into_iter().for_each(|hearing| hearing.hear(&sample));
        });
        Ok(Box::new(Mutex::new((declared.wait()?, key))))
    }

    fn hear(&self, sample: &Sample) {
        if sample.payload().len() <= TEXT_MAX {
            let text = sample.payload().to_bytes();
            let hash = ContentHash::of(&text);
            self.texts().hear(hash, &text);
        }
    }

    /// Supplies a connection with a published text that it needs, at once or when the text arrives. If the text does not arrive, the
    /// connection breaks.
    pub(super) fn supply(self: &Arc<Self>, hash: ContentHash, pipe: &Shared, network: &Network) {
        if self.texts().supply(hash, pipe) != Supply::Ask {
            return;
        }
        // The text was published on the same route before the frame that refers to it. If it has not arrived by then, it will not arrive.
        let asking = Asking { hearing: Arc::downgrade(self), hash };
        let key = self.key.clone();
        network.call(Urgency::None, move |session| {
            let reply = move |reply: Reply| asking.answered(&reply);
            let asked = session.get(key).payload(hash.bytes()).target(QueryTarget::All);
            // An answer with another content must not replace an answer with the requested text.
            let asked = asked.consolidation(ConsolidationMode::None).timeout(ANSWERS_WITHIN);
            if let Err(error) = asked.callback(reply).wait() {
                tracing::debug!("cannot request a script: {error}");
            }
        });
    }
}

#[cfg(test)]
impl Hearing {
    /// Stops receiving published texts, for a test.
    pub(super) fn withhold(&self) {
        self.subscribers.lock().unwrap().values_mut().for_each(|subscriber| *subscriber = Box::new(()));
        *self.texts() = Texts::default();
    }
}

impl Drop for Hearing {
    fn drop(&mut self) {
        let subscribers =
            std::mem::take(&mut *self.subscribers.lock().unwrap_or_else(PoisonError::into_inner));
        // Zenoh may block here. The thread ends with the network, which then undeclares everything.
        let _ended = self.declaring.send(Box::new(move |_| drop(subscribers)));
    }
}

/// A request for a published text. Zenoh drops it when all answers have arrived, or when its time limit expires.
struct Asking {
    hearing: Weak<Hearing>,
    hash: ContentHash,
}

impl Asking {
    fn answered(&self, reply: &Reply) {
        if let (Some(hearing), Ok(sample)) = (self.hearing.upgrade(), reply.result()) {
            hearing.hear(sample);
        }
    }
}

impl Drop for Asking {
    fn drop(&mut self) {
        self.hearing.upgrade().into_iter().for_each(|hearing| hearing.texts().give_up(self.hash));
    }
}
