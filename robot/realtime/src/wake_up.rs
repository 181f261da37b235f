//! Measures how late a thread wakes that waits in the same way as the thread that wakes robots.
#![expect(clippy::disallowed_methods, reason = "compares an instant with the one that was asked for")]

use std::io;
use std::time::{Duration, Instant};

use urrcp::Span;

use crate::precise_wait::{PreciseWait, Woken};
use crate::scheduling::{Realtime, Scheduling};

const WAITS: usize = 100;
/// Interval between two deadlines, long enough that the thread sleeps in between.
const INTERVAL: Duration = Duration::from_millis(6);

/// Measured wake-up delays of a thread that waits in the same way as the thread that wakes robots.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WakeUp {
    /// The scheduling that the thread was granted.
    pub scheduling: Scheduling,
    /// Median wake-up delay.
    pub median: Span,
    /// 99th percentile of the wake-up delay.
    pub p99: Span,
    /// Maximum wake-up delay.
    pub longest: Span,
}

impl WakeUp {
    /// Measures a hundred wake-ups of a separate thread; takes 0.6 s.
    ///
    /// # Errors
    /// The system cannot create a thread.
    pub fn measure(realtime: Realtime) -> io::Result<Self> {
        let thread = std::thread::Builder::new().name("wake-up".into());
        let measuring = thread.spawn(move || {
            let scheduling = Scheduling::of_this_thread(realtime);
            let late = lateness(&scheduling);
            Self::of(scheduling, late)
        })?;
        measuring.join().map_err(|_| io::Error::other("the thread that measures wake-ups panicked"))
    }

    fn of(scheduling: Scheduling, mut late: Vec<Span>) -> Self {
        late.sort_unstable();
        // By the nearest-rank method, the 99th percentile of 100 values is the second largest.
        let rank = |percent: usize| {
            let index = (late.len() * percent).div_ceil(100).saturating_sub(1);
            late.get(index).copied().unwrap_or(Span::ZERO)
        };
        Self { scheduling, median: rank(50), p99: rank(99), longest: rank(100) }
    }
}

fn lateness(scheduling: &Scheduling) -> Vec<Span> {
    // No message is ever sent; a sender keeps the channel open.
    let (_open, messages) = flume::unbounded::<()>();
    let mut waits = PreciseWait::new(scheduling);
    let wait = |_| {
        let deadline = Instant::now() + INTERVAL;
        while !matches!(waits.wait(&messages, Some(deadline)), Woken::Deadline) {}
        Span::from(deadline.elapsed())
    };
    (0..WAITS).map(wait).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_use_the_nearest_rank() {
        let scheduling = Scheduling::of_this_thread(Realtime::Off);
        let wake_up = WakeUp::of(scheduling, (1..=100).rev().map(Span::from_micros).collect());
        assert_eq!(wake_up.median, Span::from_micros(50));
        assert_eq!(wake_up.p99, Span::from_micros(99));
        assert_eq!(wake_up.longest, Span::from_micros(100));
    }

    #[test]
    fn measurement_reports_the_scheduling_and_ordered_figures() {
        let wake_up = WakeUp::measure(Realtime::Off).unwrap();
        assert!(!wake_up.scheduling.lacks_something());
        assert!(
            wake_up.median >= Span::ZERO && wake_up.median <= wake_up.p99 && wake_up.p99 <= wake_up.longest
        );
    }
}
