//! Detects the end of a connection to hardware while no request is pending.

use std::io::{PipeReader, PipeWriter, pipe};
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::thread::JoinHandle;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;

use super::Mailbox;

/// A descriptor that reports the end of the connection to the hardware: its socket, or the pipe from its process.
#[derive(Debug)]
pub struct Lifeline {
    descriptor: OwnedFd,
    ended: String,
}

impl Lifeline {
    /// Copies the descriptor without reading from it. `ended` is the message to users when the connection ends. Returns `None` if the
    /// system has no free descriptors.
    pub fn of(descriptor: &impl AsFd, ended: impl Into<String>) -> Option<Self> {
        let copy = descriptor.as_fd().try_clone_to_owned();
        let copy = copy
            .inspect_err(|error| tracing::warn!("cannot monitor the connection to the hardware: {error}"));
        Some(Self { descriptor: copy.ok()?, ended: ended.into() })
    }
}

/// A thread that watches a lifeline. Dropping the watcher ends the thread and closes the descriptor.
pub(super) struct Watcher {
    thread: Option<JoinHandle<()>>,
    /// Write end of a pipe to the thread. When it is closed, the thread ends.
    over: Option<PipeWriter>,
}

impl Watcher {
    /// Starts a thread that reports the end of the connection to the mailbox.
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

/// Waits until the connection of the descriptor ends. Returns false if the watcher is dropped first.
fn has_ended(descriptor: &OwnedFd, over: &PipeReader) -> bool {
    // `poll` always reports ends and errors. `RDHUP` also reports a peer that has closed only its sending half: it sends nothing more
    // either.
    let mut both = [PollFd::new(descriptor, PollFlags::RDHUP), PollFd::new(over, PollFlags::empty())];
    loop {
        match poll(&mut both, None) {
            Ok(_) if !both[1].revents().is_empty() => return false,
            Ok(_) if !both[0].revents().is_empty() => return true,
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => {
                tracing::warn!("cannot monitor the connection to the hardware: {error}");
                return false;
            }
        }
    }
}
