//! The current duration of round trips: a high quantile of the latest ones, so that old ones are forgotten. `docs/clocks.md` explains
//! why.

use std::collections::VecDeque;

use urrcp::{Server, Span, Timestamp};

/// The maximum number of round trips considered. The third largest of them is above their 95th percentile.
const EXCHANGES_MAX: usize = 64;
/// Exchanges that are older than this are ignored.
const WINDOW: Span = Span::from_millis(30_000);
/// The minimum number of exchanges that are kept, whatever their age. On a rarely used link, several exchanges are therefore known, not
/// only a slow one.
const EXCHANGES_KEPT: usize = 3;
/// From this number of exchanges on, two of them may be outliers; below it, only one.
const EXCHANGES_MANY: usize = 32;

/// The latest round trips with one robot, in bounded memory.
#[derive(Clone, Debug, Default)]
pub(super) struct RoundTrips {
    /// The end and the duration of each round trip, in order of arrival.
    latest: VecDeque<(Timestamp<Server>, Span)>,
    high: Span,
}

impl RoundTrips {
    /// Adds an exchange that ended at `at`, and discards those that are too old. Exchanges that began during another one describe the
    /// same moment of the link. They are merged into one exchange with the longest duration. This also applies to a second answer to a
    /// question, however many other questions were answered before it.
    pub(super) fn add(&mut self, at: Timestamp<Server>, delay: Span) {
        let (began, outliers) = (at - delay, self.outliers());
        let later = self.latest.back().is_none_or(|(ended, _)| began >= *ended);
        let same = if later { None } else { self.latest.iter().position(|(ended, _)| began < *ended) };
        let mut largest_forgotten = Span::ZERO;
        match same {
            Some(same) if delay > self.latest[same].1 => {
                let ended = at.max(self.latest[same].0);
                self.latest[same] = (ended, delay);
                largest_forgotten = self.forget_between(same, ended);
            }
            Some(_) => {}
            None => self.latest.push_back((at, delay)),
        }
        while self.latest.len() > EXCHANGES_MAX
            || (self.latest.len() > EXCHANGES_KEPT
                && self.latest.front().is_some_and(|(ended, _)| at - *ended > WINDOW))
        {
            let forgotten = self.latest.pop_front();
            largest_forgotten =
                forgotten.map_or(largest_forgotten, |(_, delay)| delay.max(largest_forgotten));
        }
        // Changes below the current value have no effect.
        if delay > self.high || largest_forgotten >= self.high || self.outliers() != outliers {
            self.high = self.above_outliers();
        }
    }

    /// Discards the exchanges after the one at index `same` that began before `ended`, because they describe the same moment. Returns the
    /// longest of their durations.
    fn forget_between(&mut self, same: usize, ended: Timestamp<Server>) -> Span {
        let mut largest = Span::ZERO;
        while let Some((at, delay)) =
            self.latest.get(same + 1).copied().filter(|(at, delay)| *at - *delay < ended)
        {
            self.latest.remove(same + 1);
            self.latest[same].0 = ended.max(at);
            largest = largest.max(delay);
        }
        largest
    }

    /// Returns the current duration of round trips. Isolated outliers do not change it; three in a row raise it immediately.
    pub(super) const fn high(&self) -> Span {
        self.high
    }

    /// Whether there are enough exchanges to leave out an outlier.
    pub(super) fn tell_outliers(&self) -> bool {
        self.latest.len() >= EXCHANGES_KEPT
    }

    fn outliers(&self) -> usize {
        match self.latest.len() {
            EXCHANGES_MANY.. => 2,
            EXCHANGES_KEPT.. => 1,
            _ => 0,
        }
    }

    /// Returns the third largest of 32 or more round trips, the second largest of three or more, else the largest.
    fn above_outliers(&self) -> Span {
        let largest = self.latest.iter().fold([Span::ZERO; 3], |[first, second, third], (_, delay)| {
            let (delay, first) = (first.min(*delay), first.max(*delay));
            let (delay, second) = (second.min(delay), second.max(delay));
            [first, second, third.max(delay)]
        });
        largest[self.outliers()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn millis(millis: i64) -> Span {
        Span::from_millis(millis)
    }

    /// Round trips that end `pause` apart, with these delays in milliseconds.
    fn after(pause: Span, delays: impl IntoIterator<Item = i64>) -> (RoundTrips, Timestamp<Server>) {
        let mut trips = RoundTrips::default();
        let mut at = Timestamp::from_nanos(0);
        for delay in delays {
            at = at + pause;
            trips.add(at, millis(delay));
        }
        (trips, at)
    }

    #[test]
    fn single_pause_of_two_seconds_among_fast_exchanges_is_ignored() {
        for slow in 0..100 {
            let delays = (0..100).map(|k| if k == slow { 2_000 } else { 1 });
            let mut trips = RoundTrips::default();
            for (k, delay) in (0..).zip(delays) {
                trips.add(Timestamp::from_nanos(0) + millis(2_100) * k, millis(delay));
                // Either of the first two exchanges may be the outlier.
                assert!(k < 2 || trips.high() < millis(10), "pause at {slow}, exchange {k}: {trips:?}");
            }
        }
    }

    #[test]
    fn all_requests_during_one_pause_are_counted_as_one() {
        let (mut trips, at) = after(millis(100), std::iter::repeat_n(1, 5));
        let pause_ends = at + millis(2_000);
        for k in 0..19 {
            trips.add(pause_ends, millis(1_950 - 100 * k));
        }
        assert_eq!(trips.high(), millis(1), "{trips:?}");
    }

    #[test]
    fn pause_that_began_during_an_answered_request_is_counted_once() {
        let (mut trips, at) = after(millis(100), std::iter::repeat_n(1, 5));
        // Asked before and after the last answer came. Both are answered when the pause ends.
        let pause_ends = at + millis(2_000);
        trips.add(pause_ends, millis(2_000) + Span::from_micros(500));
        trips.add(pause_ends + millis(1), millis(1_900));
        assert_eq!(trips.high(), millis(1), "{trips:?}");
    }

    #[test]
    fn second_answer_to_a_slow_request_is_not_a_second_slow_moment() {
        let (mut trips, at) = after(millis(100), std::iter::repeat_n(1, 5));
        trips.add(at + millis(500), millis(400));
        trips.add(at + millis(510), millis(1));
        trips.add(at + millis(520), millis(420));
        assert_eq!(trips.high(), millis(1), "{trips:?}");
    }

    #[test]
    fn requests_spanning_one_pause_are_one_moment_however_often_answered() {
        let mut trips = RoundTrips::default();
        let exchanges = [
            (21, 42),
            (21, 43),
            (42, 66),
            (43, 68),
            (66, 1_194),
            (68, 1_195),
            (1_194, 1_216),
            (1_195, 1_218),
            (1_216, 1_242),
            (1_216, 1_242),
            (2_218, 2_239),
        ];
        for (sent, at) in exchanges {
            trips.add(Timestamp::from_nanos(0) + millis(at), millis(at - sent));
        }
        assert!(trips.high() < millis(30), "{trips:?}");
    }

    #[test]
    fn pause_is_one_moment_regardless_of_the_order_of_answers() {
        // One question is under way when the pause begins, and others follow until it ends.
        let sent = [331, 411, 491, 621, 826];
        for first in 0..sent.len() {
            let mut trips = RoundTrips::default();
            let order = (first..sent.len()).chain(0..first);
            let late = order.enumerate().map(|(place, index)| (sent[index], 861 + place as i64));
            let before = [(302, 316), (316, 338)];
            let after = [(867, 880), (908, 925), (949, 966)];
            for (sent, at) in before.into_iter().chain(late).chain(after) {
                trips.add(Timestamp::from_nanos(0) + millis(at), millis(at - sent));
            }
            assert!(trips.high() < millis(60), "from {first}: {trips:?}");
            assert_eq!(trips.high(), trips.above_outliers(), "from {first}: {trips:?}");
        }
    }

    #[test]
    fn consistently_slow_link_is_known_as_slow_from_the_first_exchange() {
        for count in 1..200 {
            let (trips, _) = after(millis(100), (0..count).map(|k| 79 + k % 3));
            assert!((millis(79)..=millis(81)).contains(&trips.high()), "{count}: {trips:?}");
        }
    }

    #[test]
    fn link_that_becomes_slow_is_detected_within_three_exchanges() {
        for before in 0..200 {
            let (trips, _) = after(millis(100), std::iter::repeat_n(1, before).chain([80, 80, 80]));
            assert_eq!(trips.high(), millis(80), "after {before}");
        }
    }

    #[test]
    fn exchanges_outside_the_window_are_ignored() {
        // On a rarely used link, the window is the last three exchanges.
        let (mut trips, at) = after(millis(2_100), (0..40).map(|k| if k < 20 { 1 } else { 2_000 }));
        assert_eq!(trips.high(), millis(2_000));
        for k in 1..=2 {
            trips.add(at + millis(40_000) * k, millis(1));
        }
        assert_eq!(trips.high(), millis(1), "{trips:?}");
        // On a frequently used link, the window is the last 64.
        let (trips, _) = after(millis(2_100), (0..84).map(|k| if k < 20 { 2_000 } else { 1 }));
        assert_eq!(trips.high(), millis(1), "{trips:?}");
    }

    #[test]
    fn at_most_two_exchanges_in_the_window_take_longer_on_an_uneven_link() {
        let mut rng = fastrand::Rng::with_seed(1);
        for count in 3..200 {
            let (trips, _) = after(millis(100), (0..count).map(|_| rng.i64(1..80)));
            let longer = trips.latest.iter().filter(|(_, delay)| *delay > trips.high()).count();
            assert!(longer <= 2, "{trips:?}");
        }
    }

    #[test]
    fn high_delay_is_current_after_every_exchange() {
        let mut rng = fastrand::Rng::with_seed(2);
        for longest in [2, 10, 1_000] {
            let (mut trips, mut at) = (RoundTrips::default(), Timestamp::from_nanos(0));
            for _ in 0..2_000 {
                // Some overlap, some leave the window.
                at = at + millis([1, 20, 100, 2_000, 40_000][rng.usize(0..5)]);
                trips.add(at, millis(rng.i64(0..longest)));
                assert_eq!(trips.high(), trips.above_outliers(), "{trips:?}");
            }
        }
    }

    #[test]
    fn memory_is_bounded() {
        let (trips, _) = after(Span::from_nanos(1), std::iter::repeat_n(1, 100_000));
        assert!(trips.latest.len() <= EXCHANGES_MAX && trips.latest.capacity() <= 4 * EXCHANGES_MAX);
    }

    #[test]
    fn two_outliers_are_excluded_among_many_exchanges_and_one_among_few() {
        for (count, high) in [(EXCHANGES_MANY - 1, 90), (EXCHANGES_MANY, 1)] {
            let delays = (0..count).map(|k| [100, 90].get(k).copied().unwrap_or(1));
            assert_eq!(after(millis(200), delays).0.high(), millis(high), "{count}");
        }
    }

    #[test]
    fn longest_of_overlapping_exchanges_is_counted() {
        let mut trips = RoundTrips::default();
        for (sent, at) in [(0, 10), (100, 120), (105, 165), (106, 130)] {
            trips.add(Timestamp::from_nanos(0) + millis(at), millis(at - sent));
        }
        assert_eq!((trips.latest.len(), trips.high()), (2, millis(60)), "{trips:?}");
    }
}
