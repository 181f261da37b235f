//! The host's true clock: the system's, carried on by the monotonic clock, so that a step of the system's clock does not
//! move what is scheduled. The robot's one door to real clocks.
#![expect(clippy::disallowed_methods, reason = "the door through which a robot's host reads the time")]

use std::time::{Instant, SystemTime};

use urrcp::{Span, Timestamp};

use crate::simulated::True;

/// Reads the true time.
#[derive(Clone, Copy, Debug)]
pub struct HostClock {
    instant: Instant,
    timestamp: Timestamp<True>,
}

impl HostClock {
    /// Anchored to the system's clock now.
    #[must_use]
    pub fn anchored() -> Self {
        let reading = || {
            let before = Instant::now();
            let wall = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
            let width = before.elapsed();
            (width, before + width / 2, i64::try_from(wall.as_nanos()).unwrap_or(i64::MAX))
        };
        // Of a few tries the one in which both readings lay closest together.
        let best = (0..4).map(|_| reading()).fold(reading(), |a, b| if b.0 < a.0 { b } else { a });
        Self { instant: best.1, timestamp: Timestamp::from_nanos(best.2) }
    }

    /// The time now.
    #[must_use]
    pub fn now(&self) -> Timestamp<True> {
        self.timestamp + Span::from(self.instant.elapsed())
    }

    /// The monotonic instant of a timestamp; instants before the anchor become the anchor.
    #[must_use]
    pub fn instant_of(&self, timestamp: Timestamp<True>) -> Instant {
        self.instant + (timestamp - self.timestamp).to_duration()
    }
}
