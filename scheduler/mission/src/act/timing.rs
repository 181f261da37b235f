//! The instants of an act that has been sent, and the leases with which it approaches its start.
//!
//! All leases before the start end at one instant, the *brink*, unless the act is committed: whatever is sent to a robot up
//! to the *critical* instant carries a lease that ends there. From the instant of the *commitment* on, a little later, one
//! message carries the lease of any robot over its start. In between nothing is sent. A scheduler that dies before the
//! commitment therefore starts no robot, and one that dies after it every one. `docs/mission.md` draws it.

use urrcp::{RobotId, Server, Span, Timestamp};

use crate::lead::LeadTime;
use crate::skew::SkewBudget;

/// Least pending lease of the last rounds: several scheduling delays of a busy host.
const FINAL_LEASE_MIN: Span = Span::from_millis(30);
/// Least time between two rounds to robots that take inquiries.
const PERIOD_MIN: Span = Span::from_millis(5);
/// Least time between two rounds where a robot keeps the lease with which it was sent its scripts.
const PERIOD_MIN_FIXED: Span = Span::from_millis(20);
/// What a round takes for each robot: to write, send, read and answer one question.
const ROUND_EACH: Span = Span::from_micros(25);
/// What it takes for each script that is asked about.
const ROUND_EACH_SCRIPT: Span = Span::from_micros(2);
/// So many questions to one robot count towards the time between two rounds.
const QUESTIONS_MAX: usize = 3;
/// The commitment leaves a robot at least so long to receive it before its lease ends.
const DELIVERY_MIN: Span = Span::from_millis(8);
/// A withdrawal for doubt is sent so long before its last instant: later than the answers to the commitment come in.
const WITHDRAWN_BY: Span = Span::from_millis(5);
/// What a process may still do after it was stopped, as on a busy host.
const STANDS_STILL: Span = Span::from_millis(10);
/// What a withdrawal takes on this machine and on the robot, in addition to its way.
const WITHDRAWAL: Span = Span::from_millis(20);

/// What can wait is not sent from a round trip and so long before the planned start: messages wake threads, which take cores
/// from robots that start on this host.
const QUIET_BEFORE: Span = Span::from_millis(1);
/// However long a round trip takes, it is sent until so long before the start.
const QUIET_BEFORE_MAX: Span = Span::from_millis(5);
/// So long after the planned start it is sent again.
const QUIET_AFTER: Span = Span::from_millis(1);

/// A robot whose clock was not measured is taken to start this much early or late, at most, if the tolerance allows.
pub(crate) const CLOCK_UNKNOWN: Span = Span::from_millis(20);

/// Whether robots let the scheduler shorten their pending leases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Leases {
    /// All members take inquiries, and the scenario leaves the lease to the scheduler.
    Shortened,
    /// They stay as they were sent.
    Fixed,
}

/// What is known of the fleet that plays an act.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    /// How many robots.
    pub(crate) robots: usize,
    /// How many scripts a round asks about.
    pub(crate) scripts: usize,
    /// How many questions a round asks one robot, at most: one for each lease.
    pub(crate) questions: usize,
    pub(crate) leases: Leases,
    /// The longest of the round trips that links keep to nearly always.
    pub(crate) round_trip: Span,
    /// How much earlier than planned a robot may start, because its clock is ahead.
    pub(crate) early: Span,
    /// How much later.
    pub(crate) late: Span,
    /// How long the journal takes to put a record on the disk.
    pub(crate) record: Span,
    /// How late this machine calls the scheduler, and therefore also the robots that run on it.
    pub(crate) lateness: Span,
}

impl Measured {
    /// Of many questions the last rounds ask no more slowly than this: the interval of doubt would become long.
    fn questions(&self) -> i64 {
        i64::try_from(self.questions.clamp(1, QUESTIONS_MAX)).unwrap_or(1)
    }

    /// How long a round of questions takes.
    fn round(&self) -> Span {
        let count = |number: usize| i64::try_from(number).unwrap_or(i64::MAX);
        ROUND_EACH * count(self.robots) + ROUND_EACH_SCRIPT * count(self.scripts)
    }

    /// The shortest pending lease of the last rounds. It covers the time in which robots start and the time for which a message may
    /// still be under way, and leaves time for the answers of several rounds. On a busy machine, it also covers the delays of this
    /// process and of a robot.
    pub(crate) fn lease_least(&self) -> Span {
        let answers = FINAL_LEASE_MIN.max(self.round_trip * 4).max(self.lateness * 3);
        self.early + self.late + self.round_trip + answers + self.round() * 2
    }
}

/// The pace at which an act approaches its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pace {
    pub(crate) leases: Leases,
    round_trip: Span,
    early: Span,
    pub(crate) late: Span,
    /// The pending lease of the last rounds.
    final_lease: Span,
    /// The shortest that it could be.
    lease_least: Span,
    /// Between two of the last rounds.
    pub(crate) period: Span,
    record: Span,
    lateness: Span,
}

impl Pace {
    /// For a fleet whose requests carry this pending lease.
    pub(crate) fn of(measured: &Measured, lease: Span) -> Self {
        let round = measured.round();
        let lease_least = measured.lease_least().min(lease);
        let (final_lease, period) = match measured.leases {
            Leases::Shortened => {
                // Several rounds may be under way at once, as far as a link that carries little lets them.
                (lease_least, PERIOD_MIN.max(measured.round_trip / 2) * measured.questions())
            }
            Leases::Fixed => (lease, PERIOD_MIN_FIXED),
        };
        Self {
            leases: measured.leases,
            round_trip: measured.round_trip,
            early: measured.early,
            late: measured.late,
            final_lease,
            lease_least,
            period: period.max(round),
            record: measured.record,
            lateness: measured.lateness,
        }
    }

    /// For a fleet that may start earlier and later than it was measured to; `None` where the last rounds cannot carry so
    /// long a lease: one message could no longer reach over all starts.
    fn widened(self, (early, late): (Span, Span), lease: Span) -> Option<Self> {
        let (early, late) = (self.early.max(early), self.late.max(late));
        let lease_least = self.lease_least + (early - self.early) + (late - self.late);
        let final_lease = match self.leases {
            Leases::Shortened => lease_least,
            Leases::Fixed => self.final_lease,
        };
        (lease_least <= lease).then_some(Self { early, late, final_lease, lease_least, ..self })
    }

    /// How long a robot may hear nothing around the critical instant: from the last round until the commitment, and what a message
    /// may travel longer than another.
    pub(crate) fn silence(&self) -> Span {
        self.period + self.early + self.late + self.round_trip * 3 / 2
    }

    /// From the decision to the start this is needed at least: four of the last rounds, in which the commitment is
    /// written down, and the last lease.
    pub(crate) fn needed(&self) -> Span {
        self.early + self.round_trip + self.final_lease + self.period * 4 + self.record
    }

    /// From the end of the leases with which requests were sent to the start at least this.
    pub(crate) fn margin(&self) -> Span {
        self.early + self.round_trip * 3 / 2
    }
}

/// The instants of an act that has been sent.
#[derive(Clone, Debug)]
pub(crate) struct Timing {
    /// The sending timestamp that all requests share.
    pub(crate) timestamp: Timestamp<Server>,
    pub(crate) start: Timestamp<Server>,
    pub(crate) lead: LeadTime,
    pub(crate) decision: Timestamp<Server>,
    /// When the last step is planned.
    pub(crate) end: Timestamp<Server>,
    pub(crate) pace: Pace,
    /// What spread the clocks allow.
    pub(crate) skew: Option<SkewBudget>,
    /// The doubt that the process before this one stated, where this one has taken the act up after its start.
    pub(crate) stated_doubt: Option<Span>,
    /// The robot whose link determines the lead, and its round trip.
    pub(crate) slowest: Option<(RobotId, Span)>,
    /// How much later it starts than it should: at the end of the act before, or at the time that it waits for.
    pub(crate) gap: Option<Span>,
    /// The shortest lease under which its robots may still play an act before it: they are not left alone for longer while this
    /// one is to be committed.
    pub(crate) played: Option<Span>,
    /// When the last acceptance came.
    pub(crate) accepted_at: Option<Timestamp<Server>>,
    /// When the commitment was sent, and when its last answer came; `None` until all have answered.
    pub(crate) round: Option<(Timestamp<Server>, Timestamp<Server>)>,
}

impl Timing {
    /// Of an act that is sent at `timestamp` and plays for `duration`.
    pub(crate) fn new(timestamp: Timestamp<Server>, lead: LeadTime, pace: Pace, duration: Span) -> Self {
        let start = timestamp + lead.total();
        Self {
            timestamp,
            start,
            lead,
            decision: timestamp + lead.prepare,
            end: start + duration,
            pace,
            skew: None,
            stated_doubt: None,
            slowest: None,
            gap: None,
            played: None,
            accepted_at: None,
            round: None,
        }
    }

    /// A clock that was set since the act was sent may let its robot start earlier or later than planned, within the tolerance:
    /// leases are to end before it and to reach beyond it, if two of the last rounds can still see to it, and robots that still play
    /// are not left alone for too long by that. Returns whether it is so.
    pub(crate) fn allow_for(&mut self, now: Timestamp<Server>, early_and_late: (Span, Span)) -> bool {
        let before = self.pace;
        let widened = before.widened(early_and_late, self.lead.lease);
        let Some(pace) = widened.filter(|pace| self.played.is_none_or(|lease| pace.silence() <= lease))
        else {
            return false;
        };
        self.pace = pace;
        let in_time = now + pace.period * 2 <= self.critical();
        if !in_time {
            self.pace = before;
        }
        in_time
    }

    /// How much earlier than planned a robot may start and lose its lease before, if a message to it does not travel longer
    /// than the half of a round trip.
    pub(crate) fn early_at_most(&self) -> Span {
        self.pace.early + self.pace.round_trip / 2
    }

    /// How much earlier than planned a robot may start, because its clock is ahead.
    pub(crate) const fn early(&self) -> Span {
        self.pace.early
    }

    /// When a robot whose clock is ahead may start.
    pub(crate) fn earliest_start(&self) -> Timestamp<Server> {
        self.start - self.pace.early
    }

    /// All leases end here unless the act is committed: what was sent before may arrive up to a round trip later, and a
    /// robot whose clock is ahead starts before the others.
    pub(crate) fn brink(&self) -> Timestamp<Server> {
        self.earliest_start() - self.pace.round_trip
    }

    /// What is sent later may carry the lease of a robot over its start: nothing is sent before the commitment.
    pub(crate) fn critical(&self) -> Timestamp<Server> {
        self.brink() - self.pace.final_lease
    }

    /// From here on one message carries the lease of any robot over its start, also of one that starts late.
    pub(crate) fn commit_from(&self) -> Timestamp<Server> {
        self.begun() - self.pace.final_lease
    }

    /// The latest instant at which the commitment still reaches every robot before its lease ends. `last_round` was the last
    /// time that anything was sent.
    pub(crate) fn commit_by(&self, last_round: Timestamp<Server>) -> Timestamp<Server> {
        let leases_end = self.brink().min(last_round + self.lease_at(last_round));
        leases_end - DELIVERY_MIN.max(self.pace.round_trip * 2).max(self.pace.lateness)
    }

    /// When those that still play must be spoken to again at the latest, if nothing was sent since `last_round`.
    pub(crate) fn speak_by(&self, last_round: Timestamp<Server>) -> Option<Timestamp<Server>> {
        Some(last_round + self.played? - DELIVERY_MIN.max(self.pace.round_trip * 2))
    }

    /// The pending lease that whatever is sent at this instant has to carry.
    pub(crate) fn lease_at(&self, at: Timestamp<Server>) -> Span {
        (self.brink() - at).max(Span::ZERO).min(self.lead.lease)
    }

    /// Whether a message may go to a robot after the critical instant, behind a question with a lease that still ends at the
    /// brink: there has to be time left for the commitment.
    pub(crate) fn lets_through(&self, at: Timestamp<Server>) -> bool {
        self.pace.leases == Leases::Shortened && self.lease_at(at) >= DELIVERY_MIN * 2
    }

    /// The pending lease of the last rounds, for a script that begins with the act.
    pub(crate) const fn final_lease(&self) -> Span {
        self.pace.final_lease
    }

    /// When the round after one at `now` is due, while the act approaches its start.
    pub(crate) fn round_after(&self, now: Timestamp<Server>) -> Timestamp<Server> {
        let left = (self.critical() - now) / 3;
        let interval = (self.lease_at(now) / 4).min(left).max(self.pace.period);
        // The last one comes a period before the critical instant, so that its answers are there by then.
        let last = self.critical() - self.pace.period;
        match now + interval {
            next if now < last && next > last => last,
            next => next,
        }
    }

    /// How long the record of the commitment may take.
    pub(crate) const fn recording(&self) -> Span {
        self.pace.record
    }

    /// From here on the commitment is written down as soon as every robot holds its scripts.
    pub(crate) fn record_from(&self) -> Timestamp<Server> {
        self.critical() - self.pace.record - self.pace.period * 2
    }

    /// A failure that is known by then is withdrawn before any robot starts.
    pub(crate) fn no_return(&self) -> Timestamp<Server> {
        self.start - self.pace.early - self.pace.round_trip * 3 - WITHDRAWAL
    }

    /// A withdrawal that is sent now should still reach every robot before it starts.
    pub(crate) fn last_withdrawal(&self) -> Timestamp<Server> {
        self.start - self.pace.early - self.pace.round_trip - WITHDRAWN_BY
    }

    /// A robot that goes silent without a word later than so long before the start may be noticed too late.
    pub(crate) fn doubt(&self) -> Span {
        self.start - (self.critical() - self.pace.period * 2) + self.pace.round_trip + STANDS_STILL
    }

    /// Silence that begins later may be noticed too late.
    pub(crate) fn doubtful_from(&self) -> Timestamp<Server> {
        self.start - self.doubt()
    }

    /// When robots that have not answered are asked again, in time for the decision.
    pub(crate) fn ask_again(&self) -> Timestamp<Server> {
        self.timestamp + (self.decision - self.timestamp) * 2 / 3
    }

    /// When something that can wait may be sent if it is due at `at`: the same instant, or the end of the quiet around the start.
    pub(crate) fn out_of_quiet(&self, at: Timestamp<Server>) -> Timestamp<Server> {
        let before = (self.pace.round_trip + QUIET_BEFORE).min(QUIET_BEFORE_MAX);
        let until = self.start + QUIET_AFTER;
        if at > self.start - before && at < until { until } else { at }
    }

    /// Before it no robot starts.
    pub(crate) fn begins(&self) -> Timestamp<Server> {
        self.start - self.pace.early
    }

    /// When the last robot has started.
    pub(crate) fn begun(&self) -> Timestamp<Server> {
        self.start + self.pace.late
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timing(leases: Leases, round_trip: Span) -> Timing {
        timing_on(leases, round_trip, Span::ZERO)
    }

    /// On a machine that is so late.
    fn timing_on(leases: Leases, round_trip: Span, lateness: Span) -> Timing {
        let (early, late) = (Span::from_millis(1), Span::from_millis(2));
        let record = Span::from_millis(20);
        let measured = Measured {
            robots: 6,
            scripts: 6,
            questions: 1,
            leases,
            round_trip,
            early,
            late,
            record,
            lateness,
        };
        let lease = LeadTime::lease_needed(round_trip);
        let pace = Pace::of(&measured, lease);
        let lead = LeadTime::needed(round_trip, 6, 6_000, &pace, lease);
        Timing::new(Timestamp::from_nanos(0), lead, pace, Span::ZERO)
    }

    #[test]
    fn a_commitment_has_the_lateness_of_this_machine_for_its_delivery() {
        let left = |millis| {
            let timing = timing_on(Leases::Shortened, Span::from_millis(1), Span::from_millis(millis));
            let last_round = timing.critical();
            timing.brink().min(last_round + timing.lease_at(last_round)) - timing.commit_by(last_round)
        };
        assert_eq!([0, 8, 9, 60].map(left), [8, 8, 9, 60].map(Span::from_millis));
    }

    #[test]
    fn whatever_is_sent_before_the_critical_instant_carries_a_lease_that_ends_before_the_start() {
        for leases in [Leases::Shortened, Leases::Fixed] {
            for round_trip in [Span::from_micros(300), Span::from_millis(8), Span::from_millis(160)] {
                let timing = timing(leases, round_trip);
                let mut now = timing.decision;
                let mut rounds = 0;
                while now <= timing.critical() {
                    assert!(now + timing.lease_at(now) <= timing.brink(), "{leases:?} {round_trip}");
                    let next = timing.round_after(now);
                    assert!(next > now && next - now < timing.lease_at(now), "{leases:?} {round_trip}");
                    (now, rounds) = (next, rounds + 1);
                }
                assert!((3..100).contains(&rounds), "{rounds} rounds, {leases:?} {round_trip}");
                let commit_by = timing.commit_by(timing.critical() - timing.pace.period);
                assert!(commit_by > timing.commit_from() + timing.pace.period, "{leases:?} {round_trip}");
                assert!(timing.commit_from() > timing.critical(), "{leases:?} {round_trip}");
                assert!(
                    timing.commit_from() + timing.final_lease() >= timing.begun(),
                    "{leases:?} {round_trip}"
                );
            }
        }
    }

    #[test]
    fn an_early_start_and_three_ways_lie_between_the_leases_and_the_start() {
        let pace = timing(Leases::Shortened, Span::from_millis(8)).pace;
        assert_eq!(pace.margin(), Span::from_millis(1 + 12));
    }

    #[test]
    fn robots_that_still_play_hear_something_two_round_trips_before_their_lease_ends() {
        let mut timing = timing(Leases::Shortened, Span::from_millis(160));
        let last_round = Timestamp::from_nanos(5_000_000_000);
        assert_eq!(timing.speak_by(last_round), None);
        timing.played = Some(Span::from_millis(1_000));
        assert_eq!(timing.speak_by(last_round), Some(last_round + Span::from_millis(680)));
    }

    #[test]
    fn a_clock_is_not_allowed_for_where_robots_that_still_play_would_lose_their_lease() {
        let timing = timing(Leases::Shortened, Span::from_millis(8));
        let early = Span::from_millis(60);
        let allows = |played: Option<i64>| {
            let mut timing = Timing { played: played.map(Span::from_millis), ..timing.clone() };
            let allows = timing.allow_for(timing.decision, (early, Span::ZERO));
            assert_eq!(timing.pace.early == early, allows, "{played:?}");
            allows
        };
        assert!(allows(None) && allows(Some(90)) && !allows(Some(70)));
    }

    #[test]
    fn what_can_wait_is_not_sent_while_robots_start() {
        let millis = Span::from_millis;
        for (round_trip, before) in [(millis(2), millis(3)), (millis(160), millis(5))] {
            let timing = timing(Leases::Shortened, round_trip);
            let (start, end) = (timing.start, timing.start + millis(1));
            for at in [start - before, end, end + millis(1)] {
                assert_eq!(timing.out_of_quiet(at), at);
            }
            for at in [start - before + Span::from_nanos(1), start, end - Span::from_nanos(1)] {
                assert_eq!(timing.out_of_quiet(at), end);
            }
            // A lease that was renewed just before is still far from its end.
            assert!(start - before + timing.final_lease() > end + millis(20));
        }
    }

    #[test]
    fn on_a_fast_link_doubt_is_short_and_a_fixed_lease_makes_it_long() {
        let round_trip = Span::from_micros(300);
        assert!(timing(Leases::Shortened, round_trip).doubt() < Span::from_millis(70));
        assert!(timing(Leases::Fixed, round_trip).doubt() > Span::from_millis(240));
    }

    fn measured(robots: usize, scripts: usize, questions: usize) -> Measured {
        let (early, late, record) = (Span::from_millis(1), Span::from_millis(2), Span::from_millis(20));
        let (leases, round_trip) = (Leases::Shortened, Span::from_millis(8));
        let lateness = Span::ZERO;
        Measured { robots, scripts, questions, leases, round_trip, early, late, record, lateness }
    }

    #[test]
    fn a_round_takes_longer_the_more_robots_and_scripts_there_are() {
        assert_eq!(measured(1_000, 500, 1).round(), Span::from_millis(26));
        let lease = Span::from_millis(240);
        assert_eq!(Pace::of(&measured(1_000, 500, 1), lease).period, Span::from_millis(26));
        assert_eq!(measured(1_000, 500, 1).lease_least(), Span::from_millis(1 + 2 + 8 + 32 + 2 * 26));
        let near = Measured { round_trip: Span::from_millis(1), ..measured(0, 0, 1) };
        assert_eq!(near.lease_least(), Span::from_millis(1 + 2 + 1 + 30));
        let busy = Measured { lateness: Span::from_millis(20), ..near };
        assert_eq!(busy.lease_least(), Span::from_millis(1 + 2 + 1 + 60));
    }

    #[test]
    fn a_robot_that_is_asked_several_questions_a_round_is_asked_less_often_up_to_a_bound() {
        let period = |questions, round_trip| {
            let measured =
                Measured { round_trip: Span::from_millis(round_trip), ..measured(6, 6, questions) };
            Pace::of(&measured, Span::from_millis(3_000)).period
        };
        let periods = [0, 1, 2, 3, 9].map(|questions| period(questions, 8));
        assert_eq!(periods, [5, 5, 10, 15, 15].map(Span::from_millis));
        assert_eq!(period(2, 160), Span::from_millis(160), "two halves of a round trip");
    }

    #[test]
    fn the_instants_of_an_act_by_an_example() {
        let timing = timing(Leases::Shortened, Span::from_millis(8));
        let after = |at: Timestamp<Server>| at - timing.timestamp;
        let micros = Span::from_micros;
        // Three round trips, six requests and a margin; a lease of 240 ms; a margin of 50 ms.
        assert_eq!((after(timing.decision), after(timing.start)), (micros(77_000), micros(367_000)));
        assert_eq!(timing.final_lease(), micros(1_000 + 2_000 + 8_000 + 32_000 + 2 * 162));
        assert_eq!(
            (after(timing.earliest_start()), after(timing.begun())),
            (micros(366_000), micros(369_000))
        );
        assert_eq!(timing.early_at_most(), micros(5_000));
        assert_eq!((after(timing.brink()), after(timing.critical())), (micros(358_000), micros(314_676)));
        assert_eq!(after(timing.commit_from()), micros(325_676));
        assert_eq!(after(timing.commit_by(timing.critical())), micros(342_000));
        assert_eq!(after(timing.record_from()), micros(284_676));
        assert_eq!(after(timing.no_return()), micros(322_000));
        assert_eq!(after(timing.last_withdrawal()), micros(353_000));
        assert_eq!(timing.doubt(), micros(80_324));
        assert_eq!(after(timing.ask_again()), micros(77_000) * 2 / 3);
        assert_eq!((timing.pace.silence(), timing.pace.needed()), (micros(20_000), micros(92_324)));
        assert_eq!(timing.recording(), micros(20_000));
    }

    #[test]
    fn rounds_come_closer_to_each_other_and_the_last_one_is_a_period_before_the_critical_instant() {
        let timing = timing(Leases::Shortened, Span::from_millis(8));
        let next = |at: Timestamp<Server>| timing.round_after(at) - at;
        let (last, period) = (timing.critical() - timing.pace.period, timing.pace.period);
        assert_eq!(next(timing.decision), Span::from_millis(60), "a quarter of the lease");
        let near = timing.critical() - Span::from_millis(30);
        assert_eq!(next(near), Span::from_millis(10), "a third of what is left");
        assert_eq!(timing.round_after(last - Span::from_millis(2)), last);
        assert_eq!(timing.round_after(last), timing.critical());
        assert_eq!(timing.round_after(last + Span::from_millis(1)), last + Span::from_millis(1) + period);
    }

    #[test]
    fn a_message_passes_after_the_critical_instant_while_there_is_time_for_the_commitment_behind_it() {
        for leases in [Leases::Shortened, Leases::Fixed] {
            let timing = timing(leases, Span::from_millis(8));
            let last = timing.brink() - Span::from_millis(16);
            let shortened = leases == Leases::Shortened;
            assert_eq!(timing.lets_through(last), shortened);
            assert!(!timing.lets_through(last + Span::from_nanos(1)));
            assert_eq!(timing.lease_at(timing.brink() + Span::from_millis(1)), Span::ZERO);
        }
    }

    #[test]
    fn a_clock_is_allowed_for_while_two_rounds_are_left_and_the_lease_can_carry_it() {
        let before = timing(Leases::Shortened, Span::from_millis(8));
        let (early, late) = (Span::from_millis(20), Span::from_millis(30));
        let mut widened = before.clone();
        assert!(widened.allow_for(before.decision, (early, late)));
        assert_eq!(widened.final_lease(), before.final_lease() + Span::from_millis(19 + 28));
        assert_eq!((widened.early_at_most(), widened.pace.late), (early + Span::from_millis(4), late));
        let last = widened.critical() - widened.pace.period * 2;
        for (now, allowed) in [(last, true), (last + Span::from_nanos(1), false)] {
            let mut timing = before.clone();
            assert_eq!(timing.allow_for(now, (early, late)), allowed);
            assert_eq!(timing.pace == before.pace, !allowed, "what is not allowed for changes nothing");
        }
        let longest = before.lead.lease - before.final_lease() + Span::from_millis(2);
        let mut timing = Timing { start: before.start + Span::from_millis(1_000), ..before.clone() };
        assert!(!timing.allow_for(before.decision, (Span::ZERO, longest + Span::from_nanos(1))));
        assert!(timing.allow_for(before.decision, (Span::ZERO, longest)));
        assert_eq!(timing.early_at_most(), before.early_at_most(), "no earlier than it was");
    }
}
