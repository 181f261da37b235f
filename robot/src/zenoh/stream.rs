//! One connection, as a readable and writable byte stream.

use std::any::Any;
use std::fmt;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::task::{Context, Poll};

use ::zenoh::key_expr::KeyExpr;
use ::zenoh::sample::Sample;
use ::zenoh::{Session, Wait};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use urrcp::ContentHash;

use super::frame::TextPart;
use super::keys::{Key, LinkId};
use super::network::{Network, Urgency};
use super::offers::{Offers, Text};
use super::pipe::{Pipe, Written};

/// One end of a connection, which two parts share: the network adds received data, and a stream reads it.
#[derive(Clone, Debug, Default)]
pub(super) struct Shared(Arc<Mutex<Pipe>>);

impl Shared {
    pub(super) fn lock(&self) -> MutexGuard<'_, Pipe> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Handles a received frame. If the frame refers to a published text, returns the hash of this text, which must be supplied.
    #[must_use]
    pub(super) fn receive(&self, sample: &Sample) -> Option<ContentHash> {
        self.lock().receive(&sample.payload().to_bytes())
    }

    pub(super) fn downgrade(&self) -> WeakShared {
        WeakShared(Arc::downgrade(&self.0))
    }
}

/// Like [`Shared`], but does not keep the end of the connection alive.
#[derive(Debug)]
pub(super) struct WeakShared(Weak<Mutex<Pipe>>);

impl WeakShared {
    pub(super) fn upgrade(&self) -> Option<Shared> {
        self.0.upgrade().map(Shared)
    }

    pub(super) fn is_alive(&self) -> bool {
        self.0.strong_count() > 0
    }
}

/// Returns the id of the connection to which a received frame belongs. `None` if the frame has no valid id.
pub(super) fn link_of(sample: &Sample) -> Option<LinkId> {
    LinkId::decode(&sample.attachment()?.to_bytes())
}

/// Key at which one side of a connection publishes. The session declares the key with the first frame. Zenoh then computes the route of
/// the key once, and compares later frames with no other keys.
#[derive(Debug)]
pub(super) struct Target {
    key: KeyExpr<'static>,
    declared: OnceLock<KeyExpr<'static>>,
}

impl Target {
    /// Creates a target with this key, which is not declared yet.
    ///
    /// # Errors
    /// The text is not a valid key.
    pub(super) fn new(key: String) -> io::Result<Arc<Self>> {
        let key = KeyExpr::try_from(key).map_err(io::Error::other)?;
        Ok(Arc::new(Self { key, declared: OnceLock::new() }))
    }

    pub(super) fn declared(&self, session: &Session) -> &KeyExpr<'static> {
        self.declared.get_or_init(|| {
            let declared = session.declare_keyexpr(self.key.clone()).wait();
            declared.unwrap_or_else(|_| self.key.clone())
        })
    }
}

/// A connection between a scheduler and a robot. It ends when the stream and its split halves are dropped. The other side then reads all
/// bytes written before, and after them the end of the stream.
pub struct Stream(Arc<Ends>);

struct Ends {
    network: Network,
    pipe: Shared,
    link: LinkId,
    target: Arc<Target>,
    haste: Urgency,
    /// Zenoh declarations of the connection. They end with the connection, because they are dropped with it.
    kept: Mutex<Option<Box<dyn Any + Send>>>,
    /// Key of the robot, and the publications for several robots that the robot receives. Unset if it receives no such publications.
    hears: OnceLock<(Key, Arc<Offers>)>,
}

impl fmt::Debug for Stream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stream")
            .field("link", &self.0.link)
            .field("key", &self.0.target.key)
            .field("haste", &self.0.haste)
            .finish_non_exhaustive()
    }
}

impl Stream {
    pub(super) fn new(
        network: Network,
        pipe: Shared,
        link: LinkId,
        target: Arc<Target>,
        haste: Urgency,
    ) -> Self {
        let (kept, hears) = (Mutex::default(), OnceLock::new());
        Self(Arc::new(Ends { network, pipe, link, target, haste, kept, hears }))
    }

    pub(super) fn keeping(self, kept: Box<dyn Any + Send>) -> Self {
        *self.0.kept.lock().unwrap_or_else(PoisonError::into_inner) = Some(kept);
        self
    }

    pub(super) fn heard_by(self, key: Key, offers: Arc<Offers>) -> Self {
        // Only called once, when the connection is opened.
        let _set = self.0.hears.set((key, offers));
        self
    }

    /// Returns the name of the connection, which starts with the id of the session that has opened it.
    #[must_use]
    pub fn name(&self) -> String {
        self.0.link.to_string()
    }

    /// Returns two handles to this connection: one to read from, and one to write to.
    #[must_use]
    pub fn split(self) -> (Self, Self) {
        (Self(Arc::clone(&self.0)), self)
    }

    /// Publishes a text for all robots of an audience (a group of robots), unless it was published before. Returns the text for
    /// [`Stream::write_with`]. Returns `None` if this robot receives no such texts, or if the text is longer than 4 MiB; the caller must
    /// then write the text itself.
    #[must_use]
    pub fn offer(&self, audience: u32, hash: ContentHash, text: impl FnOnce() -> Vec<u8>) -> Option<Text> {
        let (_, offers) = self.0.hears.get()?;
        offers.offer(&self.0.network, audience, hash, text)
    }

    /// Writes `bytes`, and inserts texts that were offered by [`Stream::offer`]. Each text is inserted before its position in `bytes`;
    /// positions must not decrease.
    ///
    /// # Errors
    /// The connection has ended.
    pub async fn write_with(&mut self, bytes: &[u8], texts: &[(usize, Text)]) -> io::Result<()> {
        let mut done = 0;
        for (index, (place, text)) in texts.iter().enumerate() {
            let end = texts.get(index + 1).map_or(bytes.len(), |(next, _)| *next);
            let mut from = 0;
            while from < text.len() {
                let part = text.part(from, place.saturating_sub(done))?;
                let written = self.write_part(&bytes[done..end], Some(part)).await?;
                done += written.content;
                from += written.text;
            }
        }
        while done < bytes.len() {
            done += self.write_part(&bytes[done..], None).await?.content;
        }
        Ok(())
    }

    async fn write_part(&self, bytes: &[u8], part: Option<TextPart>) -> io::Result<Written> {
        std::future::poll_fn(|context| self.0.poll_write(context, bytes, part)).await
    }
}

#[cfg(test)]
impl Stream {
    /// Forgets all offered texts, so that requests for them are not answered. Only for tests.
    pub(super) fn forget_offers(&self) {
        self.0.hears.get().unwrap().1.forget();
    }
}

impl Ends {
    fn publish(&self, frame: Vec<u8>) {
        self.network.publish(self.haste, self.link, self.target.clone(), frame, &self.pipe);
    }

    fn poll_write(
        &self,
        context: &Context<'_>,
        bytes: &[u8],
        part: Option<TextPart>,
    ) -> Poll<io::Result<Written>> {
        // The frame is published before another frame can get the next number.
        let mut pipe = self.pipe.lock();
        let (written, frame) = std::task::ready!(pipe.poll_write(context, bytes, part))?;
        self.publish(frame);
        Poll::Ready(Ok(written))
    }

    fn end(&self) {
        let mut pipe = self.pipe.lock();
        if let Some(frame) = pipe.ending() {
            self.publish(frame);
        }
    }
}

impl AsyncRead for Stream {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut pipe = self.0.pipe.lock();
        let read = pipe.poll_read(context, into);
        if let Some(frame) = pipe.acknowledgement() {
            self.0.publish(frame);
        }
        read
    }
}

impl AsyncWrite for Stream {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.0.poll_write(context, bytes, None).map_ok(|written| written.content)
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.0.end();
        Poll::Ready(Ok(()))
    }
}

impl Drop for Ends {
    fn drop(&mut self) {
        self.end();
        if let Some((key, offers)) = self.hears.get()
            && self.pipe.lock().is_lacked()
        {
            offers.note_lack(key);
        }
        if let Some(kept) = self.kept.lock().unwrap_or_else(PoisonError::into_inner).take() {
            self.network.declare(self.haste, move |_| drop(kept));
        }
    }
}
