//! Accepts only valid answers of a robot. A valid answer belongs to a question that is still open, answers it only once, and contains
//! possible times.
//!
//! The times in an answer decide how long all robots wait for each other. An answer to a question that was never asked could contain any
//! instant.

use std::collections::VecDeque;

use urrcp::{Robot, Server, Span, Timestamp};

use crate::clock::{ClockSample, resolution};

/// The maximum number of open questions that are remembered. Only a stalled link has more; then the newest are kept.
const OPEN_MAX: usize = 1_024;
/// A question that is still unanswered after this time is forgotten.
const OPEN_FOR: Span = Span::from_millis(60_000);

/// The questions to one robot that it has not answered.
#[derive(Clone, Debug, Default)]
pub(crate) struct Exchanges {
    /// The sending times of open questions, oldest first, each with the number of messages that were sent at that time.
    open: VecDeque<(Timestamp<Server>, usize)>,
    ignored: u64,
}

/// The times in a robot's answer to a question.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    /// The sending time of the question, as the robot repeats it; `None` if the robot does not repeat it.
    pub(crate) originate: Option<Timestamp<Server>>,
    /// The time at which the robot received the question.
    pub(crate) received: Timestamp<Robot>,
    /// The time at which the robot answered.
    pub(crate) answered: Timestamp<Robot>,
    /// The time at which the answer arrived.
    pub(crate) arrived: Timestamp<Server>,
}

impl Exchanges {
    /// Notes that a question is sent at `now`, in `messages` messages.
    pub(crate) fn asked(&mut self, now: Timestamp<Server>, messages: usize) {
        match self.open.back_mut().filter(|(at, _)| *at == now) {
            Some((_, open)) => *open += messages,
            None => self.open.push_back((now, messages)),
        }
        while self.open.len() > OPEN_MAX || self.open.front().is_some_and(|(at, _)| now - *at > OPEN_FOR) {
            self.open.pop_front();
        }
    }

    /// Processes an answer. Returns `None` if it answers no open question or its times are impossible; such an answer is counted and
    /// ignored. If an answer does not repeat its question's sending time, it is assigned to the oldest question. A question that was sent
    /// later is then not wrongly considered received.
    pub(crate) fn answered(&mut self, times: Times) -> Option<ClockSample> {
        let sample = self.settle(times.originate).and_then(|sent| plausible(sent, times));
        self.ignored += u64::from(sample.is_none());
        sample
    }

    fn settle(&mut self, originate: Option<Timestamp<Server>>) -> Option<Timestamp<Server>> {
        let place = match originate {
            Some(sent) => self.place_of(sent)?,
            None => 0,
        };
        let (sent, open) = self.open.get_mut(place)?;
        let sent = *sent;
        *open -= 1;
        if *open == 0 {
            self.open.remove(place);
        }
        Some(sent)
    }

    /// Returns the index of the open question that was sent at `originate`, within the resolution of the robot's clock.
    fn place_of(&self, originate: Timestamp<Server>) -> Option<usize> {
        if let Ok(place) = self.open.binary_search_by_key(&originate, |(at, _)| *at) {
            return Some(place);
        }
        let counts_in = |step: &i64| originate.as_nanos() % step == 0;
        let step = Span::from_nanos([1_000_000, 1_000].into_iter().find(counts_in)?);
        let place = self.open.partition_point(|(at, _)| *at <= originate - step);
        self.open.get(place).filter(|(at, _)| *at < originate + step).map(|_| place)
    }

    /// Counts a message that answers no question.
    pub(crate) const fn ignore(&mut self) {
        self.ignored += 1;
    }

    /// Returns the number of answers that matched no question, or whose times were impossible.
    pub(crate) const fn ignored(&self) -> u64 {
        self.ignored
    }

    /// Discards the open questions, because they cannot be answered on a new link.
    pub(crate) fn begin_again(&mut self) {
        self.open.clear();
    }
}

/// Returns the clock sample of an exchange, or `None` if its times are impossible. The robot's processing time must be at least zero, and
/// at most the duration of the whole exchange.
fn plausible(sent: Timestamp<Server>, times: Times) -> Option<ClockSample> {
    let Times { received, answered, arrived, .. } = times;
    let step = resolution(received, answered);
    let (round_trip, took) = (arrived - sent, answered - received);
    let possible = round_trip >= Span::ZERO && took >= Span::ZERO - step && took <= round_trip + step;
    possible.then(|| ClockSample::from_exchange(sent, received, answered, arrived))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::{at, by_robot, ms};

    /// Returns the round trip of an answer with these times that arrives at `arrived`; `None` if the answer is ignored.
    fn answered(
        exchanges: &mut Exchanges,
        originate: Option<i64>,
        received: i64,
        answered: i64,
        arrived: i64,
    ) -> Option<Span> {
        let (received, answered) = (by_robot(at(received)), by_robot(at(answered)));
        let times = Times { originate: originate.map(at), received, answered, arrived: at(arrived) };
        exchanges.answered(times).map(|sample| sample.delay)
    }

    #[test]
    fn response_is_accepted_once_and_only_for_a_sent_request() {
        let mut exchanges = Exchanges::default();
        [10, 20].into_iter().for_each(|asked| exchanges.asked(at(asked), 1));
        for never_asked in [-60_000, 9, 11, 30] {
            assert_eq!(answered(&mut exchanges, Some(never_asked), 20, 20, 40), None, "{never_asked}");
        }
        assert_eq!(answered(&mut exchanges, Some(20), 30, 30, 40), Some(ms(20)));
        assert_eq!(answered(&mut exchanges, Some(20), 30, 30, 41), None, "again");
        assert_eq!(answered(&mut exchanges, Some(10), 30, 30, 42), Some(ms(32)), "overtaken");
        assert_eq!(exchanges.ignored(), 5);
    }

    #[test]
    fn request_in_several_messages_can_be_answered_as_many_times() {
        let mut exchanges = Exchanges::default();
        exchanges.asked(at(10), 2);
        exchanges.asked(at(10), 1);
        let count = (0..9).filter(|_| answered(&mut exchanges, Some(10), 11, 11, 12).is_some()).count();
        assert_eq!(count, 3);
    }

    #[test]
    fn response_without_echoed_time_matches_oldest_request() {
        let mut exchanges = Exchanges::default();
        [10, 20].into_iter().for_each(|asked| exchanges.asked(at(asked), 1));
        let delays: Vec<_> = (0..3).map(|_| answered(&mut exchanges, None, 25, 25, 30)).collect();
        assert_eq!(delays, [Some(ms(20)), Some(ms(10)), None]);
    }

    #[test]
    fn robot_may_repeat_the_time_of_a_request_in_its_own_resolution() {
        let asked = at(10) + Span::from_nanos(123_456);
        for (told, understood) in
            [(123_456, true), (123_000, true), (0, true), (124_000, true), (123_455, false)]
        {
            let mut exchanges = Exchanges::default();
            exchanges.asked(asked, 1);
            let originate = Some(at(10) + Span::from_nanos(told));
            let (received, arrived) = (by_robot(at(11)), at(12));
            let sample = exchanges.answered(Times { originate, received, answered: received, arrived });
            assert_eq!(sample.map(|sample| sample.sent), understood.then_some(asked), "{told}");
        }
    }

    #[test]
    fn responses_with_impossible_times_are_ignored() {
        for (received, told, possible) in [
            (10, 10, true),
            (10, 19, true),
            (11, 10, true),
            (10, 23, false),
            (10, 7, false),
            (60_000, 10, false),
        ] {
            let mut exchanges = Exchanges::default();
            exchanges.asked(at(10), 1);
            let taken = answered(&mut exchanges, Some(10), received, told, 20);
            assert_eq!(taken.is_some(), possible, "received at {received}, answered at {told}: {taken:?}");
        }
    }

    #[test]
    fn memory_is_bounded_and_old_requests_are_forgotten() {
        let mut exchanges = Exchanges::default();
        (0..100_000).for_each(|asked| exchanges.asked(at(asked), 1));
        assert_eq!(exchanges.open.len(), OPEN_MAX);
        exchanges.asked(at(1_000_000), 1);
        assert_eq!(exchanges.open.len(), 1);
        exchanges.begin_again();
        assert_eq!(answered(&mut exchanges, Some(1_000_000), 0, 0, 1_000_001), None);
    }
}
