//! The one door to the operating system's timer: waits for a message or a deadline, to microseconds.
//!
//! The thread sleeps on its channel until shortly before the deadline and spins the rest, since the system wakes a
//! sleeper tens of microseconds late even with the least timer slack, and a millisecond late from an asynchronous
//! runtime's timer wheel.
#![expect(clippy::disallowed_methods, reason = "spins on the monotonic clock")]

use std::num::NonZeroU64;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

/// How long before a deadline spinning begins. An idle core of a virtual machine wakes up to 300 us late.
const SPIN: Duration = Duration::from_micros(500);

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
            // Where more threads wait for one instant than there are cores each has to get its turn.
            Err(TryRecvError::Empty) => std::thread::yield_now(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn a_deadline_is_never_met_early() {
        let (_sender, receiver) = channel::<()>();
        for micros in [0, 1, 150, 1_000, 5_000] {
            let deadline = Instant::now() + Duration::from_micros(micros);
            assert!(matches!(wait(&receiver, Some(deadline)), Woken::Deadline));
            assert!(Instant::now() >= deadline);
        }
    }

    #[test]
    fn a_message_ends_a_wait_and_a_deadline_that_is_here_comes_before_it() {
        let (sender, receiver) = channel();
        sender.send(1).unwrap();
        sender.send(2).unwrap();
        let now = Instant::now();
        assert!(matches!(wait(&receiver, Some(now + Duration::from_secs(3_600))), Woken::Message(1)));
        assert!(matches!(wait(&receiver, Some(now)), Woken::Deadline));
        assert!(matches!(wait(&receiver, None), Woken::Message(2)));
    }

    #[test]
    fn a_wait_ends_when_its_last_sender_is_gone() {
        let (sender, receiver) = channel::<()>();
        drop(sender);
        assert!(matches!(wait(&receiver, None), Woken::Closed));
        let far = Instant::now() + Duration::from_secs(3_600);
        assert!(matches!(wait(&receiver, Some(far)), Woken::Closed));
    }
}
