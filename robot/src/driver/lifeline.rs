//! Notices the end of a connection to hardware while nothing is asked of it.

use std::io::{PipeReader, PipeWriter, pipe};
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::thread::JoinHandle;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;

use super::Mailbox;

/// A descriptor whose end is that of the hardware: its socket, or the pipe from its process.
#[derive(Debug)]
pub struct Lifeline {
    descriptor: OwnedFd,
    ended: String,
}

impl Lifeline {
    /// A copy of the descriptor, from which nothing is read; `ended` tells people what its end means. `None` where the
    /// system gives no more descriptors.
    pub fn of(descriptor: &impl AsFd, ended: impl Into<String>) -> Option<Self> {
        let copy = descriptor.as_fd().try_clone_to_owned();
        let copy =
            copy.inspect_err(|error| tracing::warn!("the hardware's connection is not watched: {error}"));
        Some(Self { descriptor: copy.ok()?, ended: ended.into() })
    }
}

/// Watches a lifeline on a thread of its own. Dropping it lets the descriptor go.
pub(super) struct Watcher {
    thread: Option<JoinHandle<()>>,
    /// Its end wakes the thread.
    over: Option<PipeWriter>,
}

impl Watcher {
    /// Watches for the end of a connection, and tells the mailbox.
    pub(super) fn begin(lifeline: Lifeline, mailbox: Arc<Mailbox>, connection: u64) -> std::io::Result<Self> {
        let (over, end) = pipe()?;
        let thread = std::thread::Builder::new().name("lifeline".into()).spawn(move || {
            if has_ended(&lifeline.descriptor, &over) {
                mailbox.hung_up(connection, lifeline.ended);
            }
        })?;
        Ok(Self { thread: Some(thread), over: Some(end) })
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.over = None;
        if let Some(thread) = self.thread.take() {
            let _it_cannot_panic = thread.join();
        }
    }
}

/// Waits for the end of the descriptor, false when the watcher's own end comes first.
fn has_ended(descriptor: &OwnedFd, over: &PipeReader) -> bool {
    // Ends and errors are always told; a peer that closes its half says nothing more either.
    let mut both = [PollFd::new(descriptor, PollFlags::RDHUP), PollFd::new(over, PollFlags::empty())];
    loop {
        match poll(&mut both, None) {
            Ok(_) if !both[1].revents().is_empty() => return false,
            Ok(_) if !both[0].revents().is_empty() => return true,
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => {
                tracing::warn!("the hardware's connection is not watched: {error}");
                return false;
            }
        }
    }
}
