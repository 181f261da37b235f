//! Signs of life: when the hardware is pinged, and how long it may be silent.
//!
//! While the robot holds no command, the hardware is pinged occasionally. While it holds a command, the hardware is pinged often, and
//! most often just before a start. A start thus relies on a recent sign of life. Pings take at most half of the hardware's time. No ping
//! is sent right before a movement, because the movement would have to wait.

use std::time::{Duration, Instant};

use crate::hardware::START_NEAR;

/// Minimum ping interval while the robot holds no command.
const IDLE: Duration = Duration::from_millis(500);
/// Ping interval while a command waits or runs, as a multiple of the ping interval near a start.
const HELD: u32 = 2;
/// Maximum period before a movement during which no ping is sent. The period is shorter if the hardware answers fast.
pub(crate) const QUIET: Duration = Duration::from_millis(20);
const QUIET_LEAST: Duration = Duration::from_millis(2);
/// Time without an answer after which a ping is sent even if a movement is near: the first value applies near a start, the second at
/// other times.
const OVERDUE: (Duration, Duration) = (Duration::from_millis(60), Duration::from_secs(2));

/// State of the robot's state machine that determines how often the hardware is pinged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Demand {
    /// Whether a command is running, or waiting for its start.
    pub(crate) held: bool,
    pub(crate) start: Option<Instant>,
    /// Time of the next action of the robot's state machine.
    pub(crate) next_due: Option<Instant>,
    /// Whether the report about the end of a command is delayed until the hardware has answered.
    pub(crate) confirmation: bool,
}

/// Signs of life of the hardware during one connection.
#[derive(Debug)]
pub(super) struct Pulse {
    /// Interval between two pings near a start.
    near: Duration,
    /// Time of the driver's last answer.
    answered: Instant,
    /// Time of the hardware's last sign of life.
    seen: Instant,
    /// Whether the driver reports the hardware's signs of life. If so, the driver's other answers do not count as signs of life.
    reports_signs: bool,
    /// Maximum time without a sign of life, as declared by a driver that reports these signs. Zero for other drivers.
    signs_max: Duration,
    /// Duration of the longest recent call to the driver.
    took: Duration,
    demand: Demand,
    held_since: Option<Instant>,
    /// Whether a sensor is being read. A reading has no time limit here.
    reading: bool,
    /// Time since which the driver's thread has been busy; `None` if it is idle.
    busy_since: Option<Instant>,
}

impl Pulse {
    pub(super) const fn new(now: Instant, near: Duration) -> Self {
        let demand = Demand { held: false, start: None, next_due: None, confirmation: false };
        Self {
            near,
            answered: now,
            seen: now,
            reports_signs: false,
            signs_max: Duration::ZERO,
            took: Duration::ZERO,
            demand,
            held_since: None,
            reading: false,
            busy_since: None,
        }
    }

    /// Records that the driver's thread has started an action that the hardware has to answer (`Some`), or is idle again (`None`).
    pub(super) const fn busy(&mut self, since: Option<Instant>) {
        self.busy_since = since;
    }

    /// Records a new state of the state machine. Returns true if it changes the time of the next ping.
    pub(super) fn demand(&mut self, now: Instant, demand: Demand) -> bool {
        let before = std::mem::replace(&mut self.demand, demand);
        self.held_since = demand.held.then(|| self.held_since.unwrap_or(now));
        let asks = |demand: Demand| (demand.held, demand.start, demand.confirmation);
        asks(before) != asks(demand)
    }

    /// Sets the maximum time without a sign of life, as the driver declares it.
    pub(super) fn signs_within(&mut self, silence_max: Option<Duration>) {
        self.signs_max = silence_max.unwrap_or_default();
    }

    /// Records that the driver has answered.
    pub(super) fn answered(&mut self, now: Instant) {
        self.answered = now;
        if !self.reports_signs {
            self.seen = now;
        }
    }

    /// Records that the driver has answered, and that it reported a sign of life of the hardware `ago` before its answer.
    pub(super) fn seen(&mut self, now: Instant, ago: Duration) {
        self.reports_signs = true;
        self.answered = now;
        self.seen = now.checked_sub(ago).unwrap_or(self.seen);
    }

    /// Records the duration of a call. A single long call is forgotten after some dozens of short ones.
    pub(super) fn called(&mut self, took: Duration) {
        self.took = took.max(self.took - self.took / 16);
    }

    pub(super) const fn begin_reading(&mut self) {
        self.reading = true;
    }

    pub(super) const fn end_reading(&mut self) {
        self.reading = false;
    }

    /// Returns the time of the next ping.
    pub(super) fn next_ping(&self, now: Instant) -> Instant {
        let every = match self.demand {
            Demand { held: false, .. } => IDLE.max(self.near * HELD),
            _ if self.demand.confirmation || self.start_is_near(now) => self.near,
            _ => self.near * HELD,
        };
        self.answered + every.max(self.took)
    }

    /// Whether the hardware has not answered for so long that a ping is sent even if a movement is near.
    pub(super) fn is_overdue(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.answered) >= self.overdue(now)
    }

    fn overdue(&self, now: Instant) -> Duration {
        let near = OVERDUE.0.max(self.near * 2);
        let overdue = if self.demand.confirmation || self.start_is_near(now) { near } else { OVERDUE.1 };
        overdue.max(self.took * 2)
    }

    fn start_is_near(&self, now: Instant) -> bool {
        self.demand.start.is_some_and(|start| start <= now + START_NEAR)
    }

    /// Whether a ping can be answered without delaying the next movement.
    pub(super) fn is_quiet(&self, now: Instant) -> bool {
        self.nothing_within(now, self.quiet())
    }

    /// Whether a sensor can be read without delaying the next movement.
    pub(super) fn is_quiet_for_readings(&self, now: Instant) -> bool {
        self.nothing_within(now, QUIET)
    }

    fn nothing_within(&self, now: Instant, margin: Duration) -> bool {
        self.demand.next_due.is_none_or(|due| due > now + margin)
    }

    pub(super) fn quiet(&self) -> Duration {
        (self.took * 4).clamp(QUIET_LEAST, QUIET)
    }

    /// Returns how long the driver or the hardware has been silent, if a command is held and the silence is too long. The limit is
    /// `silence_max`, or more if calls are slow. `None` within the limit.
    ///
    /// Time in which this process was delayed and sent no ping does not count as silence. The exception is a start before the next
    /// possible ping, because a start relies on a recent sign of life.
    pub(super) fn silence(&self, now: Instant, silence_max: Duration) -> Option<Duration> {
        let held_since = self.held_since.filter(|_| !self.reading)?;
        let start_is_due = self.demand.start.is_some_and(|start| start <= now + QUIET);
        let asked = self.busy_since.unwrap_or(now);
        let on_time = asked.checked_sub(self.overdue(asked)).filter(|_| !start_is_due);
        let unasked = on_time
            .map(|on_time| on_time.saturating_duration_since(self.answered.max(held_since)))
            .unwrap_or_default();
        let since = |last: Instant, most: Duration| {
            let silent = now.saturating_duration_since(last.max(held_since)).saturating_sub(unasked);
            let too_long = silent > most.max(self.near * 3) + 2 * self.took;
            too_long.then(|| now.saturating_duration_since(last))
        };
        since(self.answered, silence_max).or_else(|| since(self.seen, silence_max.max(self.signs_max)))
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "an instant to begin with")]
mod tests {
    use super::*;
    use crate::tolerance::SILENCE_MAX;

    const NEAR: Duration = Duration::from_millis(25);

    const MS: Duration = Duration::from_millis(1);

    fn holding(start: Option<Duration>) -> (Pulse, Instant) {
        let begin = Instant::now();
        let mut pulse = Pulse::new(begin, NEAR);
        let start = start.map(|start| begin + start);
        pulse.demand(begin, Demand { held: true, start, next_due: start, confirmation: false });
        (pulse, begin)
    }

    #[test]
    fn ping_rate_rises_with_demand_and_uses_at_most_half_of_the_time() {
        let begin = Instant::now();
        let mut pulse = Pulse::new(begin, NEAR);
        assert_eq!(pulse.next_ping(begin), begin + IDLE);
        let far = Demand { held: true, start: Some(begin + 2 * START_NEAR), ..Demand::default() };
        assert!(pulse.demand(begin, far));
        assert_eq!(pulse.next_ping(begin), begin + 2 * NEAR);
        assert_eq!(pulse.next_ping(begin + START_NEAR), begin + NEAR);
        pulse.called(200 * MS);
        assert_eq!(pulse.next_ping(begin + START_NEAR), begin + 200 * MS);
    }

    #[test]
    fn ping_avoids_movements_by_the_answer_time_until_it_is_overdue() {
        let (mut pulse, begin) = holding(Some(100 * MS));
        assert!(pulse.is_quiet(begin + 97 * MS) && !pulse.is_quiet(begin + 98 * MS));
        pulse.called(4 * MS);
        assert!(pulse.is_quiet(begin + 83 * MS) && !pulse.is_quiet(begin + 84 * MS));
        assert!(!pulse.is_overdue(begin + 59 * MS) && pulse.is_overdue(begin + 60 * MS));
    }

    #[test]
    fn held_command_starts_silence_that_allows_slow_calls_and_readings() {
        let (mut pulse, begin) = holding(None);
        pulse.busy(Some(begin));
        assert_eq!(pulse.silence(begin + SILENCE_MAX, SILENCE_MAX), None);
        assert_eq!(pulse.silence(begin + SILENCE_MAX + MS, SILENCE_MAX), Some(SILENCE_MAX + MS));
        pulse.called(50 * MS);
        assert_eq!(pulse.silence(begin + SILENCE_MAX + 100 * MS, SILENCE_MAX), None);
        assert_eq!(pulse.silence(begin + SILENCE_MAX + 101 * MS, SILENCE_MAX), Some(SILENCE_MAX + 101 * MS));
        pulse.begin_reading();
        assert_eq!(pulse.silence(begin + 900 * MS, SILENCE_MAX), None);
        pulse.end_reading();
        pulse.answered(begin + 900 * MS);
        assert_eq!(pulse.silence(begin + 900 * MS, SILENCE_MAX), None);
        pulse.demand(begin, Demand::default());
        assert_eq!(pulse.silence(begin + 9_000 * MS, SILENCE_MAX), None, "nothing depends on it");
    }

    #[test]
    fn time_without_pings_on_a_delayed_machine_is_not_silence() {
        let (mut pulse, begin) = holding(Some(2_000 * MS));
        assert_eq!(pulse.silence(begin + 1_200 * MS, SILENCE_MAX), None, "it was not asked");
        pulse.busy(Some(begin + 1_200 * MS));
        assert_eq!(pulse.silence(begin + 1_290 * MS, SILENCE_MAX), None);
        let silent = Some(1_291 * MS);
        assert_eq!(pulse.silence(begin + 1_291 * MS, SILENCE_MAX), silent, "asked 60 ms too late, at least");
        pulse.busy(None);
        assert_eq!(pulse.silence(begin + 2_000 * MS, SILENCE_MAX), Some(2_000 * MS), "a start is due");
        let near = begin + 2_000 * MS - QUIET;
        assert_eq!(pulse.silence(near - MS, SILENCE_MAX), None, "there is time for a ping before the start");
        assert!(pulse.silence(near, SILENCE_MAX).is_some(), "no ping begins before the start");
        pulse.busy(Some(begin));
        assert_eq!(pulse.silence(begin + 1_200 * MS, SILENCE_MAX), Some(1_200 * MS), "it was asked");
    }

    #[test]
    fn hardware_unseen_by_its_driver_is_silent_although_the_driver_answers() {
        let (mut pulse, begin) = holding(Some(500 * MS));
        pulse.seen(begin + 100 * MS, 20 * MS);
        pulse.answered(begin + 200 * MS);
        assert_eq!(pulse.next_ping(begin + 200 * MS), begin + 200 * MS + NEAR, "asked as often as before");
        assert_eq!(pulse.silence(begin + 80 * MS + SILENCE_MAX, SILENCE_MAX), None);
        pulse.seen(begin + 300 * MS, 220 * MS);
        assert_eq!(pulse.silence(begin + 300 * MS, SILENCE_MAX), Some(220 * MS));
        pulse.seen(begin + 310 * MS, MS);
        assert_eq!(pulse.silence(begin + 310 * MS, SILENCE_MAX), None);
        pulse.signs_within(Some(9_000 * MS));
        pulse.seen(begin + 320 * MS, 400 * MS);
        assert_eq!(pulse.silence(begin + 320 * MS, SILENCE_MAX), None, "the hardware reports that rarely");
        assert_eq!(
            pulse.silence(begin + 520 * MS, SILENCE_MAX),
            Some(200 * MS),
            "the driver does not answer"
        );
    }

    #[test]
    fn single_slow_call_is_forgotten() {
        let (mut pulse, _) = holding(None);
        pulse.called(500 * MS);
        (0..100).for_each(|_| pulse.called(MS));
        assert_eq!(pulse.quiet(), (4 * pulse.took).max(QUIET_LEAST));
        assert!(pulse.took < 5 * MS, "{:?}", pulse.took);
    }

    #[test]
    fn reading_keeps_more_distance_from_movements_than_a_ping() {
        let (pulse, begin) = holding(Some(100 * MS));
        assert!(pulse.is_quiet_for_readings(begin + 79 * MS));
        assert!(!pulse.is_quiet_for_readings(begin + 80 * MS) && pulse.is_quiet(begin + 80 * MS));
        assert!(holding(None).0.is_quiet_for_readings(begin), "nothing is due");
    }

    #[test]
    fn demand_that_changes_the_ping_time_wakes_the_thread() {
        let begin = Instant::now();
        let mut pulse = Pulse::new(begin, NEAR);
        let held = Demand { held: true, ..Demand::default() };
        assert!(!pulse.demand(begin, Demand::default()) && pulse.demand(begin, held));
        let due = Demand { next_due: Some(begin), ..held };
        assert!(!pulse.demand(begin, due), "movements alone change nothing");
        assert!(pulse.demand(begin, Demand { start: Some(begin), ..due }));
        assert!(pulse.demand(begin, Demand { confirmation: true, ..held }));
    }

    #[test]
    fn hardware_is_pinged_as_often_for_a_confirmation_as_for_a_start() {
        let begin = Instant::now();
        let mut pulse = Pulse::new(begin, NEAR);
        let confirmation = Demand { held: true, confirmation: true, ..Demand::default() };
        pulse.demand(begin, confirmation);
        assert_eq!(pulse.next_ping(begin), begin + NEAR);
        assert!(!pulse.is_overdue(begin + 59 * MS) && pulse.is_overdue(begin + 60 * MS));
        pulse.demand(begin, Demand { held: true, ..Demand::default() });
        assert!(!pulse.is_overdue(begin + 1_999 * MS) && pulse.is_overdue(begin + 2_000 * MS));
        pulse.called(1_500 * MS);
        assert!(!pulse.is_overdue(begin + 2_999 * MS) && pulse.is_overdue(begin + 3_000 * MS));
    }

    #[test]
    fn hardware_with_a_low_ping_rate_is_overdue_and_silent_later() {
        let begin = Instant::now();
        let mut pulse = Pulse::new(begin, 100 * MS);
        assert_eq!(pulse.next_ping(begin), begin + IDLE);
        assert_eq!(Pulse::new(begin, 400 * MS).next_ping(begin), begin + 800 * MS);
        pulse.demand(begin, Demand { held: true, start: Some(begin), ..Demand::default() });
        assert!(!pulse.is_overdue(begin + 199 * MS) && pulse.is_overdue(begin + 200 * MS));
        assert_eq!(pulse.silence(begin + 300 * MS, SILENCE_MAX), None);
        assert_eq!(pulse.silence(begin + 301 * MS, SILENCE_MAX), Some(301 * MS));
    }

    #[test]
    fn silence_begins_with_the_first_held_command_and_continues_with_more() {
        let begin = Instant::now();
        let mut pulse = Pulse::new(begin, NEAR);
        let held = Demand { held: true, ..Demand::default() };
        pulse.demand(begin + 1_000 * MS, held);
        pulse.demand(begin + 1_100 * MS, Demand { start: Some(begin), ..held });
        assert_eq!(pulse.silence(begin + 1_000 * MS + SILENCE_MAX, SILENCE_MAX), None);
        let beyond = 1_001 * MS + SILENCE_MAX;
        assert_eq!(pulse.silence(begin + beyond, SILENCE_MAX), Some(beyond), "since it last answered");
    }
}
