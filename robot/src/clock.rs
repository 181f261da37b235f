//! The host's clock: starts at the time of the system clock, and then follows the monotonic clock. A later change of the system clock
//! therefore does not move scheduled events. Robots access real clocks only through this module.
#![expect(clippy::disallowed_methods, reason = "the door through which a robot's host reads the time")]

use std::time::{Instant, SystemTime};

use urrcp::{Span, Timestamp};

/// Marker type for timestamps on the clock of a host and its robots.
#[derive(Clone, Copy, Debug)]
pub enum HostTime {}

/// Marker type for timestamps on the system clock, `CLOCK_REALTIME`, which other programs read.
#[derive(Clone, Copy, Debug)]
pub enum SystemClock {}

/// A clock that shows the time of a host and its robots.
#[derive(Clone, Copy, Debug)]
pub struct HostClock {
    instant: Instant,
    timestamp: Timestamp<HostTime>,
}

impl HostClock {
    /// Returns a clock that is anchored now: from the current time of the system clock, it follows the monotonic clock.
    #[must_use]
    pub fn anchored() -> Self {
        let reading = || {
            let before = Instant::now();
            let wall = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
            let width = before.elapsed();
            (width, before + width / 2, i64::try_from(wall.as_nanos()).unwrap_or(i64::MAX))
        };
        // Keeps the best of five attempts: the one whose two readings are closest together.
        let best = (0..4).map(|_| reading()).fold(reading(), |a, b| if b.0 < a.0 { b } else { a });
        Self { instant: best.1, timestamp: Timestamp::from_nanos(best.2) }
    }

    /// Returns the current time.
    #[must_use]
    pub fn now(&self) -> Timestamp<HostTime> {
        self.timestamp + Span::from(self.instant.elapsed())
    }

    /// Returns how far the system clock is ahead of the host's clock: zero, unless the system clock was set after this clock was
    /// anchored.
    #[must_use]
    pub fn system_ahead(&self) -> Span {
        Self::anchored().timestamp_at(self.instant) - self.timestamp
    }

    /// Returns a clock that is ahead of this one by `ahead`.
    #[cfg(test)]
    pub(crate) fn ahead_by(self, ahead: Span) -> Self {
        Self { timestamp: self.timestamp + ahead, ..self }
    }

    /// Returns the host's time at `instant`, which may be before the clock was anchored.
    pub(crate) fn timestamp_at(&self, instant: Instant) -> Timestamp<HostTime> {
        match instant.checked_duration_since(self.instant) {
            Some(after) => self.timestamp + Span::from(after),
            None => self.timestamp - Span::from(self.instant.duration_since(instant)),
        }
    }

    /// Returns the monotonic instant that corresponds to a timestamp. A timestamp before the clock was anchored maps to the instant at
    /// which it was anchored.
    #[must_use]
    pub fn instant_of(&self, timestamp: Timestamp<HostTime>) -> Instant {
        self.instant + (timestamp - self.timestamp).to_duration()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instant_and_its_timestamp_are_equally_far_from_the_anchor() {
        let clock = HostClock::anchored();
        let later = clock.timestamp + Span::from_millis(1_500);
        assert_eq!(Span::from(clock.instant_of(later) - clock.instant), Span::from_millis(1_500));
    }

    #[test]
    fn instant_before_the_anchor_is_clamped_to_the_anchor() {
        let clock = HostClock::anchored();
        assert_eq!(clock.instant_of(clock.timestamp - Span::from_millis(1)), clock.instant);
    }

    #[test]
    fn clock_agrees_with_the_system_clock_at_its_anchor() {
        // The system clock is read before and after the host's clock, so the test needs no bound on speed.
        let system = || Span::from(SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap());
        let before = system();
        let anchored = Span::from_nanos(HostClock::anchored().now().as_nanos());
        let after = system();
        let slack = Span::from_micros(100);
        assert!(anchored >= before - slack && anchored <= after + slack, "{before} {anchored} {after}");
    }

    #[test]
    fn timestamps_before_and_after_the_anchor_keep_their_distance() {
        let clock = HostClock::anchored();
        let second = std::time::Duration::from_secs(1);
        let shown =
            [clock.instant - second, clock.instant, clock.instant + second].map(|at| clock.timestamp_at(at));
        assert_eq!(shown.map(|shown| shown - clock.timestamp), [-1_000, 0, 1_000].map(Span::from_millis));
    }

    #[test]
    fn system_clock_set_after_the_anchor_is_ahead_by_the_change() {
        let hour = Span::from_millis(3_600_000);
        let clock = HostClock::anchored();
        let before = clock.ahead_by(Span::ZERO - hour);
        assert!((before.system_ahead() - hour).abs() < Span::from_millis(60_000));
        assert!(clock.system_ahead().abs() < Span::from_millis(60_000));
    }

    #[test]
    fn clock_advances_from_its_anchor() {
        let clock = HostClock::anchored();
        let early = HostClock { instant: clock.instant - std::time::Duration::from_secs(600), ..clock };
        let since = early.now() - early.timestamp;
        assert!(since >= Span::from_millis(600_000) && since < Span::from_millis(1_200_000), "{since}");
    }
}
