//! The one door to the operating system's timer: waits for a message or a deadline, to microseconds.
//!
//! The thread sleeps on its channel until shortly before the deadline and spins the rest, since the system wakes a
//! sleeper tens of microseconds late even with the least timer slack, and a millisecond late from an asynchronous
//! runtime's timer wheel.
#![expect(clippy::disallowed_methods, reason = "spins on the monotonic clock")]

use std::num::NonZeroU64;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

/// How long before a deadline spinning begins. Twice the usual lateness of a wake-up.
const SPIN: Duration = Duration::from_micros(200);

/// Why a wait ended.
pub(crate) enum Woken<T> {
    /// A message came.
    Message(T),
    /// The deadline is here.
    Deadline,
    /// All senders are gone.
    Closed,
}

/// Asks for the least timer slack for this thread, and for real-time scheduling if wanted. Without the right to either
/// the thread goes on as it is.
pub(crate) fn prepare_thread(realtime: bool) {
    if let Err(error) = rustix::thread::set_current_timer_slack(NonZeroU64::new(1)) {
        tracing::warn!("timer slack stays as it is: {error}");
    }
    if realtime {
        use thread_priority::{RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy};
        let outcome = ThreadPriority::try_from(50u8).map_err(|e| e.to_string()).and_then(|priority| {
            thread_priority::unix::set_thread_priority_and_policy(
                thread_priority::unix::thread_native_id(),
                priority,
                ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
            )
            .map_err(|e| e.to_string())
        });
        if let Err(error) = outcome {
            tracing::warn!("no real-time scheduling: {error}");
        }
    }
}

/// Waits for the next message, until the deadline if there is one.
pub(crate) fn wait<T>(messages: &Receiver<T>, deadline: Option<Instant>) -> Woken<T> {
    let Some(deadline) = deadline else {
        return messages.recv().map_or(Woken::Closed, Woken::Message);
    };
    let sleep_until = deadline.checked_sub(SPIN).unwrap_or(deadline);
    let sleep = sleep_until.saturating_duration_since(Instant::now());
    if !sleep.is_zero() {
        match messages.recv_timeout(sleep) {
            Ok(message) => return Woken::Message(message),
            Err(RecvTimeoutError::Disconnected) => return Woken::Closed,
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
    loop {
        if Instant::now() >= deadline {
            return Woken::Deadline;
        }
        match messages.try_recv() {
            Ok(message) => return Woken::Message(message),
            Err(TryRecvError::Disconnected) => return Woken::Closed,
            Err(TryRecvError::Empty) => std::hint::spin_loop(),
        }
    }
}
