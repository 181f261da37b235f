//! One connection, as bytes that are read and written.

use std::any::Any;
use std::fmt;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::network::{Haste, Network};
use super::pipe::Pipe;

/// An end of a connection that the network writes to and a stream reads.
#[derive(Clone, Debug, Default)]
pub(super) struct Shared(Arc<Mutex<Pipe>>);

impl Shared {
    pub(super) fn lock(&self) -> MutexGuard<'_, Pipe> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn receive(&self, sample: &::zenoh::sample::Sample) {
        self.lock().receive(&sample.payload().to_bytes());
    }
}

/// A connection between a scheduler and a robot. Dropping it ends it: the other side reads what was written, and then the end.
pub struct Stream {
    network: Network,
    pipe: Shared,
    /// Where this side publishes.
    key: String,
    haste: Haste,
    /// What the network has to be told when the connection ends, by being dropped.
    kept: Option<Box<dyn Any + Send>>,
}

impl fmt::Debug for Stream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stream").field("key", &self.key).field("haste", &self.haste).finish_non_exhaustive()
    }
}

impl Stream {
    pub(super) fn new(network: Network, pipe: Shared, key: String, haste: Haste) -> Self {
        Self { network, pipe, key, haste, kept: None }
    }

    pub(super) fn keeping(mut self, kept: Box<dyn Any + Send>) -> Self {
        self.kept = Some(kept);
        self
    }

    /// The name of the connection, which begins with the id of the session that has opened it.
    #[must_use]
    pub fn name(&self) -> &str {
        super::keys::link_of(&self.key).unwrap_or_default()
    }

    fn publish(&self, frame: Vec<u8>) {
        self.network.publish(self.haste, self.key.clone(), frame, &self.pipe);
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
            // Behind the last frame.
            self.network.call(self.haste, move |_| drop(kept));
        }
    }
}
