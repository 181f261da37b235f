//! One connection, as bytes that are read and written.

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

use super::keys::LinkId;
use super::network::{Haste, Network};
use super::pipe::Pipe;

/// An end of a connection that the network writes to and a stream reads.
#[derive(Clone, Debug, Default)]
pub(super) struct Shared(Arc<Mutex<Pipe>>);

impl Shared {
    pub(super) fn lock(&self) -> MutexGuard<'_, Pipe> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn receive(&self, sample: &Sample) {
        self.lock().receive(&sample.payload().to_bytes());
    }

    pub(super) fn downgrade(&self) -> WeakShared {
        WeakShared(Arc::downgrade(&self.0))
    }
}

/// The same, which keeps nothing alive.
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

/// The connection whose frame this is.
pub(super) fn link_of(sample: &Sample) -> Option<LinkId> {
    LinkId::decode(&sample.attachment()?.to_bytes())
}

/// Where one side of a connection publishes. The session declares the key with the first frame: Zenoh computes its route then, and
/// compares the frames behind it with no other keys.
pub(super) struct Target {
    key: KeyExpr<'static>,
    declared: OnceLock<KeyExpr<'static>>,
}

impl Target {
    /// # Errors
    /// It is no key.
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

/// A connection between a scheduler and a robot. Dropping it ends it: the other side reads what was written, and then the end.
pub struct Stream {
    network: Network,
    pipe: Shared,
    link: LinkId,
    target: Arc<Target>,
    haste: Haste,
    /// What the network has to be told when the connection ends, by being dropped.
    kept: Option<Box<dyn Any + Send>>,
}

impl fmt::Debug for Stream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stream")
            .field("link", &self.link)
            .field("key", &self.target.key)
            .field("haste", &self.haste)
            .finish_non_exhaustive()
    }
}

impl Stream {
    pub(super) fn new(
        network: Network,
        pipe: Shared,
        (link, target): (LinkId, Arc<Target>),
        haste: Haste,
    ) -> Self {
        Self { network, pipe, link, target, haste, kept: None }
    }

    pub(super) fn keeping(mut self, kept: Box<dyn Any + Send>) -> Self {
        self.kept = Some(kept);
        self
    }

    /// The name of the connection, which begins with the id of the session that has opened it.
    #[must_use]
    pub fn name(&self) -> String {
        self.link.to_string()
    }

    fn publish(&self, frame: Vec<u8>) {
        self.network.publish(self.haste, (self.link, self.target.clone()), frame, &self.pipe);
    }
}

impl AsyncRead for Stream {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut pipe = self.pipe.lock();
        let read = pipe.poll_read(context, into);
        if let Some(frame) = pipe.acknowledgement() {
            self.publish(frame);
        }
        read
    }
}

impl AsyncWrite for Stream {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        // Handed on before another frame can have the next number.
        let mut pipe = self.pipe.lock();
        let (n, frame) = std::task::ready!(pipe.poll_write(context, bytes))?;
        self.publish(frame);
        Poll::Ready(Ok(n))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        let mut pipe = self.pipe.lock();
        if let Some(frame) = pipe.ending() {
            self.publish(frame);
        }
        Poll::Ready(Ok(()))
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        let mut pipe = self.pipe.lock();
        if let Some(frame) = pipe.ending() {
            self.publish(frame);
        }
        drop(pipe);
        if let Some(kept) = self.kept.take() {
            self.network.declare(self.haste, move |_| drop(kept));
        }
    }
}
