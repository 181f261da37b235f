//! The robot's side of texts that are published once for several robots: what this process hears of one scheduler, and asks it for.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use ::zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use ::zenoh::sample::Sample;
use ::zenoh::{Session, Wait};
use urrcp::ContentHash;

use super::keys::Audience;
use super::network::{Call, Haste, Kept, Network};
use super::stream::Shared;
use super::texts::{Supply, TEXT_MAX, Texts};

/// How long the answer of a scheduler may take that is asked for a text.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Audiences of one scheduler to which the robots of this process may belong.
const SUBSCRIBERS_MAX: usize = 4_096;

/// What is heard of one scheduler's session, for as long as a connection needs it.
pub(super) struct Hearing {
    /// Where it is asked.
    key: String,
    texts: Mutex<Texts>,
    /// One for each audience, undeclared with this.
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

    /// Hears from now on what is published for these audiences.
    pub(super) fn begin(self: &Arc<Self>, session: &Session, audiences: &[Audience]) -> ::zenoh::Result<()> {
        let mut subscribers = self.subscribers.lock().unwrap_or_else(PoisonError::into_inner);
        for audience in audiences {
            if subscribers.len() >= SUBSCRIBERS_MAX {
                return Err("too many audiences".into());
            }
            if let Entry::Vacant(new) = subscribers.entry(*audience) {
                new.insert(self.subscriber(session, *audience)?);
            }
        }
        Ok(())
    }

    fn subscriber(self: &Arc<Self>, session: &Session, audience: Audience) -> ::zenoh::Result<Kept> {
        let hearing = Arc::downgrade(self);
        // Declared by itself, so that Zenoh compares what is published with no other keys.
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

    /// Fills in a text that a connection needs, now or once it has come; breaks the connection if it does not come.
    pub(super) fn supply(self: &Arc<Self>, hash: ContentHash, pipe: &Shared, network: &Network) {
        if self.texts().supply(hash, pipe) != Supply::Ask {
            return;
        }
        // It was published ahead of the frame that names it, on the same way: what has not come by now does not come any more.
        let asking = Asking { hearing: Arc::downgrade(self), hash };
        let key = self.key.clone();
        network.call(Haste::None, move |session| {
            let reply = move |reply: Reply| asking.answered(&reply);
            let asked = session.get(key).payload(hash.bytes()).target(QueryTarget::All);
            // An answer that is not the text must not stand in for one that is.
            let asked = asked.consolidation(ConsolidationMode::None).timeout(ANSWERS_WITHIN);
            if let Err(error) = asked.callback(reply).wait() {
                tracing::debug!("a script is not asked for: {error}");
            }
        });
    }
}

#[cfg(test)]
impl Hearing {
    /// Hears nothing that is published from now on.
    pub(super) fn withhold(&self) {
        self.subscribers.lock().unwrap().values_mut().for_each(|subscriber| *subscriber = Box::new(()));
        *self.texts() = Texts::default();
    }
}

impl Drop for Hearing {
    fn drop(&mut self) {
        let subscribers =
            std::mem::take(&mut *self.subscribers.lock().unwrap_or_else(PoisonError::into_inner));
        // Zenoh may wait. Its thread ends with the network, which takes all that was declared with it.
        let _ended = self.declaring.send(Box::new(move |_| drop(subscribers)));
    }
}

/// A text that was asked for. Zenoh drops this when all answers are in, or none has come in time.
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
