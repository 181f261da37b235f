//! The published texts that a robot's process has received from one scheduler, and the connections that wait for texts. Decides which
//! texts are kept or requested, and which connections get them. Does no I/O.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use urrcp::ContentHash;

use super::stream::{Shared, WeakShared};

/// Maximum length in bytes of a text that is published for several robots. A longer text is not published; if it is published
/// nevertheless, it is ignored.
pub(super) const TEXT_MAX: usize = 4 * 1024 * 1024;
/// Maximum total size of the published texts that are kept, in bytes. The oldest texts are dropped first.
pub(super) const KEPT_BYTES_MAX: usize = 16 * 1024 * 1024;
/// Maximum number of published texts that are kept.
const KEPT_MAX: usize = 256;
/// Maximum number of missing texts for which connections may wait.
const AWAITED_MAX: usize = 64;

/// Texts that were received or published. The oldest is the first.
#[derive(Debug, Default)]
pub(super) struct Kept {
    texts: VecDeque<(ContentHash, Arc<[u8]>)>,
    bytes: usize,
}

impl Kept {
    pub(super) fn get(&self, hash: ContentHash) -> Option<&Arc<[u8]>> {
        self.texts.iter().rev().find(|(kept, _)| *kept == hash).map(|(_, text)| text)
    }

    /// Keeps a text that is not kept yet. If there is not enough room, drops the oldest texts.
    pub(super) fn keep(&mut self, hash: ContentHash, text: Arc<[u8]>) {
        self.bytes += text.len();
        self.texts.push_back((hash, text));
        while self.bytes > KEPT_BYTES_MAX || self.texts.len() > KEPT_MAX {
            let Some((_, oldest)) = self.texts.pop_front() else { return };
            self.bytes -= oldest.len();
        }
    }
}

/// What happened when a connection needed a published text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Supply {
    /// The text was available and was supplied to the connection.
    Filled,
    /// The connection waits for the text. The text has not been requested yet, so the caller must request it.
    Ask,
    /// The connection waits for the text. The text has already been requested.
    Waits,
    /// Connections already wait for too many texts, so this connection was broken.
    Refused,
}

/// The received texts, and the connections that wait for missing texts.
#[derive(Debug, Default)]
pub(super) struct Texts {
    kept: Kept,
    awaited: HashMap<ContentHash, Vec<WeakShared>>,
}

impl Texts {
    /// Supplies a connection with a text, if the text is kept. Otherwise, the connection waits for the text.
    pub(super) fn supply(&mut self, hash: ContentHash, pipe: &Shared) -> Supply {
        if let Some(text) = self.kept.get(hash) {
            pipe.lock().fill(hash, text);
            return Supply::Filled;
        }
        if self.awaited.len() >= AWAITED_MAX && !self.awaited.contains_key(&hash) {
            pipe.lock().lack(hash);
            return Supply::Refused;
        }
        let waiting = self.awaited.entry(hash).or_default();
        let supply = if waiting.is_empty() { Supply::Ask } else { Supply::Waits };
        waiting.retain(WeakShared::is_alive);
        waiting.push(pipe.downgrade());
        supply
    }

    /// Handles a received text. `hash` must be computed from the received bytes. It must not be taken from the request or the
    /// publication.
    pub(super) fn hear(&mut self, hash: ContentHash, text: &[u8]) {
        for pipe in self.awaited.remove(&hash).iter().flatten().filter_map(WeakShared::upgrade) {
            pipe.lock().fill(hash, text);
        }
        if self.kept.get(hash).is_none() && text.len() <= TEXT_MAX {
            self.kept.keep(hash, text.into());
        }
    }

    /// Breaks the connections that wait for a text, because the text will not arrive.
    pub(super) fn give_up(&mut self, hash: ContentHash) {
        for pipe in self.awaited.remove(&hash).iter().flatten().filter_map(WeakShared::upgrade) {
            pipe.lock().lack(hash);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::{Frame, Next, TextPart};
    use super::*;

    /// Returns a connection that waits for this text, and the hash of the text.
    fn waiting_for(text: &[u8]) -> (Shared, ContentHash) {
        let (pipe, hash) = (Shared::default(), ContentHash::of(text));
        let part = TextPart { text: hash, from: 0, count: 1, at: 0 };
        let frame = Frame { number: 0, read: 0, next: Next::More, part: Some(part), content: b"" };
        assert_eq!(pipe.lock().receive(&frame.encode()), Some(hash));
        (pipe, hash)
    }

    fn hear(texts: &mut Texts, text: &[u8]) {
        texts.hear(ContentHash::of(text), text);
    }

    #[track_caller]
    fn check(pipe: &Shared, waits: bool, is_broken: bool) {
        let pipe = pipe.lock();
        assert_eq!((pipe.waits_for_a_text(), pipe.is_broken()), (waits, is_broken));
    }

    #[test]
    fn text_is_requested_once_and_fills_only_the_connections_that_await_it() {
        let mut texts = Texts::default();
        let ((first, hash), (second, _), (other, another)) =
            (waiting_for(b"text"), waiting_for(b"text"), waiting_for(b"other"));
        assert_eq!(texts.supply(hash, &first), Supply::Ask);
        assert_eq!(texts.supply(hash, &second), Supply::Waits);
        assert_eq!(texts.supply(another, &other), Supply::Ask);
        hear(&mut texts, b"text");
        check(&first, false, false);
        check(&second, false, false);
        check(&other, true, false);
        texts.give_up(hash);
        check(&first, false, false);
        texts.give_up(another);
        check(&other, true, true);
        let (late, hash) = waiting_for(b"text");
        assert_eq!(texts.supply(hash, &late), Supply::Filled);
        check(&late, false, false);
    }

    #[test]
    fn bytes_with_a_different_hash_fill_nothing() {
        let mut texts = Texts::default();
        let (pipe, hash) = waiting_for(b"text");
        texts.supply(hash, &pipe);
        hear(&mut texts, b"tex!");
        check(&pipe, true, false);
    }

    #[test]
    fn kept_texts_are_bounded_in_bytes_and_number_and_the_newest_remains() {
        let (mut texts, long) = (Texts::default(), vec![0; TEXT_MAX - 8]);
        for i in 0..20_u64 {
            hear(&mut texts, &[&i.to_le_bytes()[..], &long].concat());
            assert!(texts.kept.bytes <= KEPT_BYTES_MAX);
        }
        assert_eq!(texts.kept.texts.len(), KEPT_BYTES_MAX / TEXT_MAX);
        hear(&mut texts, &vec![1; TEXT_MAX + 1]);
        hear(&mut texts, b"last");
        hear(&mut texts, b"last");
        assert_eq!(texts.kept.texts.len(), KEPT_BYTES_MAX / TEXT_MAX, "kept once");
        (0..1_000_u64).for_each(|i| hear(&mut texts, &i.to_le_bytes()));
        assert_eq!(texts.kept.texts.len(), KEPT_MAX);
        assert!(texts.kept.get(ContentHash::of(&999_u64.to_le_bytes())).is_some());
        assert!(texts.kept.get(ContentHash::of(b"last")).is_none());
    }

    #[test]
    fn connection_that_names_too_many_awaited_texts_is_disconnected() {
        let mut texts = Texts::default();
        let waiting: Vec<_> = (0..AWAITED_MAX).map(|i| waiting_for(&i.to_le_bytes())).collect();
        assert!(waiting.iter().all(|(pipe, hash)| texts.supply(*hash, pipe) == Supply::Ask));
        let (further, hash) = waiting_for(b"further");
        assert_eq!(texts.supply(hash, &further), Supply::Refused);
        check(&further, true, true);
        let (same, hash) = waiting_for(&0_usize.to_le_bytes());
        assert_eq!(texts.supply(hash, &same), Supply::Waits);
    }
}
