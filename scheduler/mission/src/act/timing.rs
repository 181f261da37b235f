//! The instants of an act that has been sent, and the leases with which it approaches its start.
//!
//! A robot drops its scripts when its lease ends. Before the start, all leases end at one instant, the *brink*, unless the act is
//! committed. Every message up to the *critical* instant carries a lease that ends at the brink. From the instant of the *commitment*, a
//! little later, a single message extends the lease of any robot beyond its start. Nothing is sent between these two instants. Therefore,
//! if a scheduler dies before the commitment, no robot starts; if it dies afterwards, every robot starts. `docs/mission.md` has a
//! diagram.

mod invariants;

use urrcp::{RobotId, Server, Span, Timestamp};

use crate::lead::LeadTime;
use crate::skew::SkewBudget;

/// Minimum time for answers that the pending lease of the last rounds allows: several scheduling delays of a busy host.
const FINAL_LEASE_MIN: Span = Span::from_millis(30);
/// Minimum time between two rounds of questions to robots that take inquiries about their scripts.
const PERIOD_MIN: Span = Span::from_millis(5);
/// Minimum time between two rounds of questions if a robot keeps the lease that was sent with its scripts.
const PERIOD_MIN_FIXED: Span = Span::from_millis(20);
/// Time that each robot adds to a round of questions: to write, send, read and answer one question.
const ROUND_EACH: Span = Span::from_micros(25);
/// Time that each script adds to a round of questions about it.
const ROUND_EACH_SCRIPT: Span = Span::from_micros(2);
/// Each question to a robot in a round extends the time between two rounds. More questions than this do not extend it further.
const QUESTIONS_MAX: usize = 3;
/// The minimum time that a robot has to receive the commitment before its lease ends.
const DELIVERY_MIN: Span = Span::from_millis(8);
/// How long before its latest useful time a withdrawal is sent because a robot's start is in doubt. The answers to the commitment have
/// arrived by then.
const WITHDRAWN_BY: Span = Span::from_millis(5);
/// Length of a short stall of a process, as it occurs on a busy host.
const STANDS_STILL: Span = Span::from_millis(10);
/// Duration of a withdrawal on this machine and on the robot, in addition to its travel time.
const WITHDRAWAL: Span = Span::from_millis(20);

/// The quiet period before the planned start lasts one round trip plus this time. Messages that can wait are not sent in this period.
/// They would wake threads, which take cores from robots that start on this host.
const QUIET_BEFORE: Span = Span::from_millis(1);
/// The quiet period begins at most this long before the start, however long a round trip takes.
const QUIET_BEFORE_MAX: Span = Span::from_millis(5);
/// The quiet period ends this long after the planned start.
const QUIET_AFTER: Span = Span::from_millis(1);

/// The maximum start error, early or late, that is assumed for a robot whose clock was not measured. A smaller tolerance of the scenario
/// takes precedence.
pub(crate) const CLOCK_UNKNOWN: Span = Span::from_millis(20);

/// Whether the scheduler can shorten the pending leases (of scripts that wait for their start) on robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Leases {
    /// All members take inquiries, which can shorten leases, and the scenario leaves the lease to the scheduler.
    Shortened,
    /// The leases stay as they were sent.
    Fixed,
}

/// Measurements of the fleet that plays an act.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    /// Number of robots.
    pub(crate) robots: usize,
    /// Number of scripts that a round of questions asks about.
    pub(crate) scripts: usize,
    /// The maximum number of questions per robot in a round of questions. Each different lease requires its own question.
    pub(crate) questions: usize,
    pub(crate) leases: Leases,
    /// The longest round trip among all links, without rare outliers.
    pub(crate) round_trip: Span,
    /// How much earlier than planned a robot may start, because its clock is ahead.
    pub(crate) early: Span,
    /// How much later than planned a robot may start.
    pub(crate) late: Span,
    /// How long the journal takes to put a record on the disk.
    pub(crate) record: Span,
    /// How late this machine wakes the scheduler, and therefore also the robots that run on the machine.
    pub(crate) lateness: Span,
}

impl Measured {
    /// Returns the number of questions that slow down the last rounds, at most [`QUESTIONS_MAX`]. Slower rounds would make the interval
    /// of doubt long, in which a robot's silence is noticed too late.
    fn questions(&self) -> i64 {
        i64::try_from(self.questions.clamp(1, QUESTIONS_MAX)).unwrap_or(1)
    }

    /// Returns how long a round of questions takes.
    fn round(&self) -> Span {
        let count = |number: usize| i64::try_from(number).unwrap_or(i64::MAX);
        ROUND_EACH * count(self.robots) + ROUND_EACH_SCRIPT * count(self.scripts)
    }

    /// Returns the shortest pending lease of the last rounds. It covers the time in which robots start, the travel time of a message, and
    /// the time for answers to several rounds. On a busy machine, it also covers the delays of this process and of a robot.
    pub(crate) fn lease_least(&self) -> Span {
        let answers = FINAL_LEASE_MIN.max(self.round_trip * 4).max(self.lateness * 3);
        self.early + self.late + self.round_trip + answers + self.round() * 2
    }
}

/// The pace at which an act approaches its start: its leases and the time between rounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pace {
    pub(crate) leases: Leases,
    round_trip: Span,
    early: Span,
    pub(crate) late: Span,
    /// The pending lease that the last rounds of questions set.
    final_lease: Span,
    /// The shortest possible value of `final_lease`.
    lease_least: Span,
    /// Time between two of the last rounds of questions.
    pub(crate) period: Span,
    record: Span,
    lateness: Span,
}

impl Pace {
    /// Returns the pace for a fleet whose requests carry the pending lease `lease`.
    pub(crate) fn of(measured: &Measured, lease: Span) -> Self {
        let round = measured.round();
        let lease_least = measured.lease_least().min(lease);
        let (final_lease, period) = match measured.leases {
            Leases::Shortened => {
                // Several rounds may be under way at once, as far as a link with little bandwidth permits it.
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

    /// Returns the pace for a fleet that may start earlier or later than measured, and so needs a longer last lease. `None` if that
    /// exceeds `lease`, because a single message could no longer extend a lease beyond all starts.
    fn widened(self, early: Span, late: Span, lease: Span) -> Option<Self> {
        let (early, late) = (self.early.max(early), self.late.max(late));
        let lease_least = self.lease_least + (early - self.early) + (late - self.late);
        let final_lease = match self.leases {
            Leases::Shortened => lease_least,
            Leases::Fixed => self.final_lease,
        };
        (lease_least <= lease).then_some(Self { early, late, final_lease, lease_least, ..self })
    }

    /// Returns how long a robot may receive no message around the critical instant. This is the time from the last round to the
    /// commitment, plus the variation of the travel time.
    pub(crate) fn silence(&self) -> Span {
        self.period + self.early + self.late + self.round_trip * 3 / 2
    }

    /// Returns the minimum time from the decision to the start. It covers the final lease and four of the last rounds of questions,
    /// during which the commitment is written to disk.
    pub(crate) fn needed(&self) -> Span {
        self.early + self.round_trip + self.final_lease + self.period * 4 + self.record
    }

    /// Returns the minimum time between the end of the leases that the requests carry and the start.
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
    /// The planned time of the last step.
    pub(crate) end: Timestamp<Server>,
    pub(crate) pace: Pace,
    /// How far apart the robots may start because of their clocks; `None` if unknown.
    pub(crate) skew: Option<SkewBudget>,
    /// The interval of doubt before the start, as the previous process stated it. `None` unless this process has taken over the act after
    /// its start.
    pub(crate) stated_doubt: Option<Span>,
    /// The robot whose slow link determines the lead (from sending to the start), and its round trip.
    pub(crate) slowest: Option<(RobotId, Span)>,
    /// How much later than intended the act starts. The intended start is the end of the previous act, or the time that the act waits
    /// for.
    pub(crate) gap: Option<Span>,
    /// The shortest lease under which robots of this act may still play an earlier act; `None` if no robot does. While this act is being
    /// committed, those robots receive messages at shorter intervals than this.
    pub(crate) played: Option<Span>,
    /// Arrival time of the last acceptance.
    pub(crate) accepted_at: Option<Timestamp<Server>>,
    /// The sending time of the commitment, and the arrival time of the last answer to it; `None` until all robots have answered.
    pub(crate) round: Option<(Timestamp<Server>, Timestamp<Server>)>,
}

impl Timing {
    /// Returns the instants of an act that is sent at `timestamp` and plays for `duration`.
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

    /// Adapts the leases to a clock that was set since the act was sent. Its robot may start earlier or later than planned, within the
    /// tolerance. The leases must end before that start, or the commitment must extend them beyond it. Two of the last rounds must remain
    /// for this, and robots that still play must not be left without a message for too long. Returns whether all of this is possible.
    pub(crate) fn allow_for(&mut self, now: Timestamp<Server>, early: Span, late: Span) -> bool {
        let before = self.pace;
        let widened = before.widened(early, late, self.lead.lease);
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

    /// Returns how early, at most, a robot may start so that its lease still ends before its start if the act is not committed. A message
    /// to the robot is assumed to travel for at most half a round trip.
    pub(crate) fn early_at_most(&self) -> Span {
        self.pace.early + self.pace.round_trip / 2
    }

    /// Returns how much earlier than planned a robot may start, because its clock is ahead.
    pub(crate) const fn early(&self) -> Span {
        self.pace.early
    }

    /// Returns the earliest start of a robot whose clock is ahead.
    pub(crate) fn earliest_start(&self) -> Timestamp<Server> {
        self.start - self.pace.early
    }

    /// Returns the brink: the instant at which all leases end, unless the act is committed. It precedes the earliest start by one round
    /// trip, because messages sent before it may arrive that much later.
    pub(crate) fn brink(&self) -> Timestamp<Server> {
        self.earliest_start() - self.pace.round_trip
    }

    /// Returns the critical instant. A message sent later may extend a robot's lease beyond its start. Nothing is therefore sent from
    /// this instant until the commitment.
    pub(crate) fn critical(&self) -> Timestamp<Server> {
        self.brink() - self.pace.final_lease
    }

    /// Returns the earliest instant at which a single message extends the lease of any robot beyond its start, even if the robot starts
    /// late.
    pub(crate) fn commit_from(&self) -> Timestamp<Server> {
        self.begun() - self.pace.final_lease
    }

    /// Returns the latest time to send the commitment so that it reaches every robot before its lease ends. `last_round` is the time of
    /// the last message before it.
    pub(crate) fn commit_by(&self, last_round: Timestamp<Server>) -> Timestamp<Server> {
        let leases_end = self.brink().min(last_round + self.lease_at(last_round));
        leases_end - DELIVERY_MIN.max(self.pace.round_trip * 2).max(self.pace.lateness)
    }

    /// Returns the latest time for the next message to robots that still play another act, if the last one was sent at `last_round`.
    /// `None` if no robot still plays under a lease.
    pub(crate) fn speak_by(&self, last_round: Timestamp<Server>) -> Option<Timestamp<Server>> {
        Some(last_round + self.played? - DELIVERY_MIN.max(self.pace.round_trip * 2))
    }

    /// Returns the pending lease that a message sent at `at` must carry, so that it ends at the brink.
    pub(crate) fn lease_at(&self, at: Timestamp<Server>) -> Span {
        (self.brink() - at).max(Span::ZERO).min(self.lead.lease)
    }

    /// Whether an urgent message may still be sent to a robot after the critical instant. It follows a question whose lease ends at the
    /// brink, and must leave enough time for the commitment.
    pub(crate) fn lets_through(&self, at: Timestamp<Server>) -> bool {
        self.pace.leases == Leases::Shortened && self.lease_at(at) >= DELIVERY_MIN * 2
    }

    /// Returns the pending lease of the last rounds, for a script that begins with the act.
    pub(crate) const fn final_lease(&self) -> Span {
        self.pace.final_lease
    }

    /// Returns when the next round of questions is due after a round at `now`, while the act approaches its start.
    pub(crate) fn round_after(&self, now: Timestamp<Server>) -> Timestamp<Server> {
        let left = (self.critical() - now) / 3;
        let interval = (self.lease_at(now) / 4).min(left).max(self.pace.period);
        // The last round comes a period before the critical instant, so that its answers arrive before it.
        let last = self.critical() - self.pace.period;
        match now + interval {
            next if now < last && next > last => last,
            next => next,
        }
    }

    /// Returns the time that writing the record of the commitment may take.
    pub(crate) const fn recording(&self) -> Span {
        self.pace.record
    }

    /// Returns the earliest time to write the record of the commitment. It is written then, or later, once every robot holds its scripts.
    pub(crate) fn record_from(&self) -> Timestamp<Server> {
        self.critical() - self.pace.record - self.pace.period * 2
    }

    /// Returns the latest time at which the act can be withdrawn after a failure, before any robot starts.
    pub(crate) fn no_return(&self) -> Timestamp<Server> {
        self.start - self.pace.early - self.pace.round_trip * 3 - WITHDRAWAL
    }

    /// Returns the latest time to send a withdrawal that should still reach every robot before it starts.
    pub(crate) fn last_withdrawal(&self) -> Timestamp<Server> {
        self.start - self.pace.early - self.pace.round_trip - WITHDRAWN_BY
    }

    /// Returns the length of the interval before the start in which a robot's sudden silence may be noticed too late to prevent the
    /// start.
    pub(crate) fn doubt(&self) -> Span {
        self.start - (self.critical() - self.pace.period * 2) + self.pace.round_trip + STANDS_STILL
    }

    /// Returns the instant from which a robot's silence may be noticed too late to prevent the start.
    pub(crate) fn doubtful_from(&self) -> Timestamp<Server> {
        self.start - self.doubt()
    }

    /// Returns when requests are sent again to robots that have not answered them, in time for the decision.
    pub(crate) fn ask_again(&self) -> Timestamp<Server> {
        self.timestamp + (self.decision - self.timestamp) * 2 / 3
    }

    /// Returns when to send a message that is due at `at` but can wait: at that instant, or at the end of the quiet period around the
    /// start.
    pub(crate) fn out_of_quiet(&self, at: Timestamp<Server>) -> Timestamp<Server> {
        let before = (self.pace.round_trip + QUIET_BEFORE).min(QUIET_BEFORE_MAX);
        let until = self.start + QUIET_AFTER;
        if at > self.start - before && at < until { until } else { at }
    }

    /// Returns the earliest instant at which a robot may start.
    pub(crate) fn begins(&self) -> Timestamp<Server> {
        self.start - self.pace.early
    }

    /// Returns the instant by which the last robot has started.
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

    /// Returns the timing on a machine with this lateness.
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
    fn commitment_delivery_allows_for_the_lateness_of_this_machine() {
        let left = |millis| {
            let timing = timing_on(Leases::Shortened, Span::from_millis(1), Span::from_millis(millis));
            let last_round = timing.critical();
            timing.brink().min(last_round + timing.lease_at(last_round)) - timing.commit_by(last_round)
        };
        assert_eq!([0, 8, 9, 60].map(left), [8, 8, 9, 60].map(Span::from_millis));
    }

    #[test]
    fn leases_sent_before_critical_instant_end_before_the_start() {
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
    fn margin_before_start_covers_an_early_start_and_three_one_way_delays() {
        let pace = timing(Leases::Shortened, Span::from_millis(8)).pace;
        assert_eq!(pace.margin(), Span::from_millis(1 + 12));
    }

    #[test]
    fn playing_robots_receive_a_message_two_round_trips_before_lease_end() {
        let mut timing = timing(Leases::Shortened, Span::from_millis(160));
        let last_round = Timestamp::from_nanos(5_000_000_000);
        assert_eq!(timing.speak_by(last_round), None);
        timing.played = Some(Span::from_millis(1_000));
        assert_eq!(timing.speak_by(last_round), Some(last_round + Span::from_millis(680)));
    }

    #[test]
    fn clock_is_not_allowed_for_if_playing_robots_would_lose_their_lease() {
        let timing = timing(Leases::Shortened, Span::from_millis(8));
        let early = Span::from_millis(60);
        let allows = |played: Option<i64>| {
            let mut timing = Timing { played: played.map(Span::from_millis), ..timing.clone() };
            let allows = timing.allow_for(timing.decision, early, Span::ZERO);
            assert_eq!(timing.pace.early == early, allows, "{played:?}");
            allows
        };
        assert!(allows(None) && allows(Some(90)) && !allows(Some(70)));
    }

    #[test]
    fn deferrable_messages_are_not_sent_while_robots_start() {
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
            // A lease that was renewed just before still ends much later.
            assert!(start - before + timing.final_lease() > end + millis(20));
        }
    }

    #[test]
    fn doubt_is_short_on_a_fast_link_and_long_with_a_fixed_lease() {
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
    fn round_takes_longer_with_more_robots_and_scripts() {
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
    fn more_requests_per_round_lengthen_the_period_up_to_a_bound() {
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
    fn instants_of_an_example_act() {
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
    fn rounds_get_closer_and_end_one_period_before_the_critical_instant() {
        let timing = timing(Leases::Shortened, Span::from_millis(8));
        let next = |at: Timestamp<Server>| timing.round_after(at) - at;
        let (last, period) = (timing.critical() - timing.pace.period, timing.pace.period);
        assert_eq!(next(timing.decision), Span::from_millis(60), "a quarter of the lease");
        let near = timing.critical() - Span::from_millis(30);
        assert_eq!(next(near), Span::from_millis(10), "a third of the remaining time");
        assert_eq!(timing.round_after(last - Span::from_millis(2)), last);
        assert_eq!(timing.round_after(last), timing.critical());
        assert_eq!(timing.round_after(last + Span::from_millis(1)), last + Span::from_millis(1) + period);
    }

    #[test]
    fn message_is_sent_after_critical_instant_while_commitment_still_fits() {
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
    fn clock_is_allowed_for_while_two_rounds_remain_and_the_lease_suffices() {
        let before = timing(Leases::Shortened, Span::from_millis(8));
        let (early, late) = (Span::from_millis(20), Span::from_millis(30));
        let mut widened = before.clone();
        assert!(widened.allow_for(before.decision, early, late));
        assert_eq!(widened.final_lease(), before.final_lease() + Span::from_millis(19 + 28));
        assert_eq!((widened.early_at_most(), widened.pace.late), (early + Span::from_millis(4), late));
        let last = widened.critical() - widened.pace.period * 2;
        for (now, allowed) in [(last, true), (last + Span::from_nanos(1), false)] {
            let mut timing = before.clone();
            assert_eq!(timing.allow_for(now, early, late), allowed);
            assert_eq!(timing.pace == before.pace, !allowed, "what is not allowed for changes nothing");
        }
        let longest = before.lead.lease - before.final_lease() + Span::from_millis(2);
        let mut timing = Timing { start: before.start + Span::from_millis(1_000), ..before.clone() };
        assert!(!timing.allow_for(before.decision, Span::ZERO, longest + Span::from_nanos(1)));
        assert!(timing.allow_for(before.decision, Span::ZERO, longest));
        assert_eq!(timing.early_at_most(), before.early_at_most(), "no earlier than it was");
    }
}
