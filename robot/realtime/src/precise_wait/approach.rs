//! Decides how a thread spends the last microseconds before a deadline: when it wakes, and whether other threads may run meanwhile. Reads
//! no clock.
//!
//! With `sched_yield`, other robots that wait for the same instant get the core within microseconds. If another program keeps the core
//! busy, however, the thread loses it for milliseconds. A thread therefore yields only while the machine has a core for every runnable
//! thread, and while its latest yields returned quickly.

use std::time::{Duration, Instant};

/// Time before a deadline at which a thread wakes if the cores are free. A thread that sleeps on an idle core of a virtual machine wakes
/// this much too late.
const LEAD_FREE: Duration = Duration::from_micros(200);
/// Margin that is added to the delay of a thread that woke too late. For the next `LATE_REMEMBERED`, the thread wakes this sum, but at
/// most `LEAD_MAX`, before a deadline.
const LEAD_MORE: Duration = Duration::from_micros(50);
const LEAD_MAX: Duration = Duration::from_millis(1);
/// Time before a deadline at which a thread wakes after a pause of at least `RESTED`, for example before a start. During the pause, the
/// core was halted, and the host of a virtual machine may take long to resume it.
const LEAD_RESTED: Duration = LEAD_MAX;
const RESTED: Duration = Duration::from_millis(15);
const LATE_REMEMBERED: Duration = Duration::from_secs(60);
/// Time before a deadline at which a thread wakes if the cores are busy: none. A thread that spins uses up its time slice and is then
/// interrupted for milliseconds. A thread that sleeps until the deadline wakes only a tenth of a millisecond late.
const LEAD_BUSY: Duration = Duration::ZERO;
/// Time that other processes need to move their robots that are due at the same instant as this thread's robots.
const OTHERS_MOVE: Duration = Duration::from_micros(500);
/// Minimum interval between two pauses that let other processes run. A thread with many deadlines needs the time in between for messages.
const REST_EVERY: Duration = Duration::from_millis(20);
/// Maximum duration of a yield to other robots. If a yield takes longer, another program must have used the core.
const YIELD_MAX: Duration = Duration::from_micros(500);
/// Time after a yield longer than `YIELD_MAX` in which the cores are considered busy, whatever a check reports.
const DISTRUST: Duration = Duration::from_secs(1);
/// Time for which the result of a check of the cores' load remains valid.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Earliest time, measured back from a deadline, at which the load of the cores is checked; `LOOK_LATEST` is the latest. A check between
/// the two delays no start.
const LOOK_EARLIEST: Duration = Duration::from_millis(12);
const LOOK_LATEST: Duration = Duration::from_millis(4);
/// Inverse of the maximum share of time that a thread may spend spinning: 4 means a quarter. Thus even a real-time thread with a deadline
/// every few microseconds leaves its core to others.
const SPIN_SHARE: u32 = 4;
/// Maximum time of continuous spinning after a pause.
const SPIN_CREDIT_MAX: Duration = Duration::from_millis(2);

/// Load of the cores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cores {
    /// There is a core for every runnable thread.
    Free,
    /// More threads are runnable than there are cores.
    Busy,
}

/// How the kernel schedules this thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scheduled {
    /// The thread has the same priority as all other threads.
    Fairly,
    /// The thread runs before all ordinary threads. When it yields, only threads of the same priority can get the core.
    First,
}

/// Decides how a thread waits, based on its previous waits.
#[derive(Debug)]
pub(super) struct Approach {
    scheduled: Scheduled,
    cores: Cores,
    looked: Option<Instant>,
    distrusted_until: Option<Instant>,
    rested: Option<Instant>,
    /// Time before a deadline at which the thread must wake because of its longest recent delay, and the instant at which this value
    /// expires.
    late: Option<(Duration, Instant)>,
    /// Time when the thread last spun.
    spun: Option<Instant>,
    credit: Duration,
    credited: Option<Instant>,
}

impl Approach {
    pub(super) const fn new(scheduled: Scheduled) -> Self {
        Self {
            scheduled,
            cores: Cores::Free,
            looked: None,
            distrusted_until: None,
            rested: None,
            late: None,
            spun: None,
            credit: SPIN_CREDIT_MAX,
            credited: None,
        }
    }

    pub(super) fn is_first(&self) -> bool {
        self.scheduled == Scheduled::First
    }

    /// Returns when to check the load of the cores before this deadline. `None`: no check is needed before it. Processes that wait for
    /// the same instant must not check at the same time, because they would count each other. `chance`, from 0 to 1, spreads their
    /// checks.
    pub(super) fn look_at(&self, now: Instant, deadline: Instant, chance: f64) -> Option<Instant> {
        let recently = |looked: Instant| now.saturating_duration_since(looked) < LOOK_EVERY;
        if self.scheduled == Scheduled::First || self.looked.is_some_and(recently) {
            return None;
        }
        let before = LOOK_LATEST + (LOOK_EARLIEST - LOOK_LATEST).mul_f64(chance.clamp(0.0, 1.0));
        let before = before.min(deadline.saturating_duration_since(now));
        if before >= LOOK_LATEST { deadline.checked_sub(before) } else { None }
    }

    /// Records the result of a check of the cores' load.
    pub(super) const fn looked(&mut self, now: Instant, cores: Cores) {
        self.looked = Some(now);
        self.cores = cores;
    }

    /// Returns how long before the deadline the thread must wake.
    pub(super) fn lead(&mut self, now: Instant, deadline: Instant) -> Duration {
        self.earn(now);
        let is_rested = |spun: Instant| deadline.saturating_duration_since(spun) >= RESTED;
        let lead = match self.yields(now) {
            false => LEAD_BUSY,
            true if self.spun.is_none_or(is_rested) => LEAD_RESTED,
            true => self.lead_free(now),
        };
        let ahead = deadline.saturating_duration_since(now);
        lead.min(SPIN_CREDIT_MAX.min(self.credit + ahead / SPIN_SHARE))
    }

    fn lead_free(&self, now: Instant) -> Duration {
        self.late.filter(|(_, until)| now < *until).map_or(LEAD_FREE, |(lead, _)| lead)
    }

    /// Records that the thread woke `late` after the requested time.
    pub(super) fn woke(&mut self, now: Instant, late: Duration) {
        let lead = (late + LEAD_MORE).min(LEAD_MAX);
        if lead >= self.lead_free(now) && lead > LEAD_FREE {
            self.late = Some((lead, now + LATE_REMEMBERED));
        }
    }

    /// Whether the thread should yield to other threads while it waits for a deadline.
    pub(super) fn yields(&self, now: Instant) -> bool {
        let trusted = || self.distrusted_until.is_none_or(|until| now >= until);
        self.scheduled == Scheduled::First || (self.cores == Cores::Free && trusted())
    }

    /// Records the duration of a yield.
    pub(super) fn yielded(&mut self, now: Instant, took: Duration) {
        if took > YIELD_MAX {
            self.distrusted_until = Some(now + DISTRUST);
        }
    }

    /// Returns how long the thread should pause after a movement, so that other processes can move their robots. `next` is the next
    /// deadline.
    pub(super) fn rest(&mut self, now: Instant, next: Option<Instant>) -> Duration {
        let recently = |rested: Instant| now.saturating_duration_since(rested) < REST_EVERY;
        if self.rested.is_some_and(recently) {
            return Duration::ZERO;
        }
        self.rested = Some(now);
        let until = next.map(|next| next.saturating_duration_since(now).saturating_sub(self.lead(now, next)));
        until.map_or(OTHERS_MOVE, |until| until.min(OTHERS_MOVE))
    }

    /// Records that the thread has spun for `took` until `now`.
    pub(super) fn spun(&mut self, now: Instant, took: Duration) {
        self.earn(now);
        self.credit = self.credit.saturating_sub(took);
        self.spun = Some(now);
    }

    fn earn(&mut self, now: Instant) {
        let since = self.credited.map_or(Duration::ZERO, |at| now.saturating_duration_since(at));
        self.credit = SPIN_CREDIT_MAX.min(self.credit + since / SPIN_SHARE);
        self.credited = Some(now);
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "an instant to count from; no time passes")]
mod tests {
    use super::*;

    const fn millis(count: u64) -> Duration {
        Duration::from_millis(count)
    }

    const fn micros(count: u64) -> Duration {
        Duration::from_micros(count)
    }

    fn fair() -> (Approach, Instant) {
        (Approach::new(Scheduled::Fairly), Instant::now())
    }

    /// Returns how long before a deadline the thread wakes if its previous deadline was ten milliseconds earlier.
    fn lead(approach: &mut Approach, now: Instant) -> Duration {
        approach.spun(now, Duration::ZERO);
        approach.lead(now, now + millis(10))
    }

    #[test]
    fn on_free_cores_thread_wakes_early_and_yields() {
        let (mut approach, now) = fair();
        approach.looked(now, Cores::Free);
        assert!(approach.yields(now));
        assert_eq!(lead(&mut approach, now), LEAD_FREE);
    }

    #[test]
    fn late_wake_up_makes_the_thread_wake_earlier_for_a_minute() {
        let (mut approach, now) = fair();
        approach.woke(now, micros(150));
        assert_eq!(lead(&mut approach, now), LEAD_FREE);
        approach.woke(now, micros(300));
        assert_eq!(lead(&mut approach, now), micros(350));
        approach.woke(now + millis(30_000), micros(250));
        assert_eq!(lead(&mut approach, now + millis(59_999)), micros(350));
        assert_eq!(lead(&mut approach, now + millis(60_000)), LEAD_FREE);
        approach.woke(now + millis(60_000), millis(7));
        assert_eq!(lead(&mut approach, now + millis(60_000)), LEAD_MAX);
        // If the cores are busy, the delay is not caused by the sleep.
        approach.looked(now, Cores::Busy);
        assert_eq!(lead(&mut approach, now + millis(60_000)), LEAD_BUSY);
    }

    #[test]
    fn on_busy_cores_thread_sleeps_until_the_deadline_without_yielding() {
        let (mut approach, now) = fair();
        approach.looked(now, Cores::Busy);
        assert!(!approach.yields(now));
        assert_eq!(lead(&mut approach, now), LEAD_BUSY);
    }

    #[test]
    fn slow_yield_disables_yields_for_a_second_despite_free_cores() {
        let (mut approach, now) = fair();
        approach.yielded(now, micros(500));
        assert!(approach.yields(now));
        approach.yielded(now, micros(501));
        approach.looked(now, Cores::Free);
        assert!(!approach.yields(now + millis(999)));
        assert_eq!(lead(&mut approach, now + millis(999)), LEAD_BUSY);
        assert!(approach.yields(now + millis(1_000)));
    }

    #[test]
    fn thread_rests_after_a_movement_but_not_past_a_deadline_or_too_often() {
        let (mut approach, now) = fair();
        approach.looked(now, Cores::Free);
        approach.spun(now + REST_EVERY, Duration::ZERO);
        assert_eq!(approach.rest(now, None), OTHERS_MOVE);
        assert_eq!(approach.rest(now + millis(19), None), Duration::ZERO);
        let later = now + millis(20);
        assert_eq!(approach.rest(later, Some(later + micros(300))), micros(300) - LEAD_FREE);
        let later = later + REST_EVERY;
        assert_eq!(approach.rest(later, Some(later + micros(100))), Duration::ZERO);
        let later = later + REST_EVERY;
        assert_eq!(approach.rest(later, Some(later + millis(5))), OTHERS_MOVE);
    }

    #[test]
    fn real_time_thread_always_yields_and_never_checks_the_load() {
        let (_, now) = fair();
        let mut approach = Approach::new(Scheduled::First);
        approach.looked(now, Cores::Busy);
        approach.yielded(now, millis(5));
        assert!(approach.yields(now));
        assert_eq!(lead(&mut approach, now), LEAD_FREE);
        assert_eq!(approach.look_at(now, now + millis(500), 0.5), None);
    }

    #[test]
    fn load_check_precedes_the_deadline_by_milliseconds_and_stays_valid() {
        let (mut approach, now) = fair();
        let deadline = now + millis(100);
        assert_eq!(approach.look_at(now, deadline, 0.0), Some(deadline - LOOK_LATEST));
        assert_eq!(approach.look_at(now, deadline, 1.0), Some(deadline - LOOK_EARLIEST));
        approach.looked(now, Cores::Free);
        assert_eq!(approach.look_at(now + millis(49), deadline, 0.0), None);
        assert_eq!(approach.look_at(now + millis(50), deadline, 0.0), Some(deadline - LOOK_LATEST));
    }

    #[test]
    fn load_is_not_checked_just_before_a_deadline() {
        let (approach, now) = fair();
        assert_eq!(approach.look_at(now, now + LOOK_LATEST, 1.0), Some(now));
        assert_eq!(approach.look_at(now, now + LOOK_LATEST - micros(1), 0.0), None);
        assert_eq!(approach.look_at(now, now, 0.0), None);
    }

    #[test]
    fn thread_with_endless_deadlines_spins_for_a_quarter_of_the_time() {
        for scheduled in [Scheduled::Fairly, Scheduled::First] {
            let begin = Instant::now();
            let (mut approach, mut now, mut spun) = (Approach::new(scheduled), begin, Duration::ZERO);
            while now < begin + millis(1_000) {
                let deadline = now + micros(200);
                let lead = approach.lead(now, deadline);
                approach.spun(deadline, lead);
                spun += lead;
                now = deadline;
            }
            let share = spun.as_secs_f64() / (now - begin).as_secs_f64();
            assert!(share > 0.24 && share < 0.26, "{scheduled:?}: {share}");
        }
    }

    #[test]
    fn thread_spins_for_several_consecutive_deadlines_after_a_pause() {
        let (mut approach, now) = fair();
        let mut leads = Vec::new();
        // All waits take place at the same instant, so the thread earns no spinning time in between.
        for _ in 0..7 {
            let lead = approach.lead(now, now);
            approach.spun(now, lead);
            leads.push(lead);
        }
        let mut expected = vec![LEAD_RESTED];
        expected.extend([LEAD_FREE; 5]);
        expected.push(Duration::ZERO);
        assert_eq!(leads, expected);
        assert_eq!(approach.lead(now, now + micros(400)), micros(100));
        assert_eq!(approach.lead(now + 4 * LEAD_FREE, now + 4 * LEAD_FREE), LEAD_FREE);
    }

    #[test]
    fn thread_wakes_even_earlier_for_a_deadline_after_a_pause() {
        let (mut approach, now) = fair();
        assert_eq!(approach.lead(now, now + millis(500)), LEAD_RESTED);
        approach.spun(now, Duration::ZERO);
        assert_eq!(approach.lead(now, now + RESTED - micros(1)), LEAD_FREE);
        assert_eq!(approach.lead(now, now + RESTED), LEAD_RESTED);
        approach.looked(now, Cores::Busy);
        assert_eq!(approach.lead(now, now + RESTED), LEAD_BUSY);
    }
}
