//! Invariants of the instants of an act, as `docs/mission.md` computes them.

use urrcp::Span;

use super::{DELIVERY_MIN, Leases, PERIOD_MIN, PERIOD_MIN_FIXED, Timing};
use crate::invariants::holds;

const ROUND_TRIP_MAX: Span = Span::from_millis(500);

impl Timing {
    /// Panics if an invariant does not hold. `act` is the name of the act.
    pub(crate) fn check(&self, act: &str) {
        self.check_lead(act);
        self.check_approach(act);
        self.check_limits(act);
        assert!(self.start <= self.end, "{act}: an act starts before it ends");
    }

    fn check_lead(&self, act: &str) {
        holds!(self.start == self.timestamp + self.lead.total(), act, "Start = timestamp + lead.");
        holds!(
            self.decision == self.timestamp + self.lead.prepare,
            act,
            "A robot that has not accepted its scripts by the end of *prepare* has failed."
        );
        holds!(self.lead.lease > Span::ZERO, act, "the pending lease that is sent with the scripts");
        holds!(self.pace.round_trip <= ROUND_TRIP_MAX, act, "A single delay does not determine this value");
        let again = self.ask_again();
        holds!(
            self.timestamp <= again && again <= self.decision,
            act,
            "Requests that are not answered after two thirds of *prepare* are sent again"
        );
        holds!(
            self.gap.is_none_or(|gap| gap >= Span::ZERO),
            act,
            "An act waits for the end of the previous act, for a time"
        );
        let skew = self.skew.as_ref();
        holds!(
            skew.is_none_or(|skew| skew.predicted <= skew.tolerance),
            act,
            "If the budget exceeds `start_tolerance`, the robots that cause this fail."
        );
    }

    fn check_approach(&self, act: &str) {
        let pace = &self.pace;
        holds!(
            self.brink() == self.start - pace.early - pace.round_trip,
            act,
            "one common instant, the brink (start - early - one round trip)"
        );
        holds!(
            self.critical() == self.brink() - pace.final_lease,
            act,
            "which precedes the brink by the length of the last lease"
        );
        holds!(
            self.critical() <= self.brink(),
            act,
            "no robot starts because of a message sent before this instant"
        );
        holds!(
            self.commit_from() == self.critical() + pace.early + pace.late + pace.round_trip,
            act,
            "Early + late + one round trip later, a single message extends the lease of any robot beyond its start."
        );
        holds!(
            self.commit_from() + pace.final_lease >= self.begun(),
            act,
            "a single message extends the lease of any robot beyond its start"
        );
        let least = Span::from_millis(30).max(pace.round_trip * 4).max(pace.lateness * 3);
        holds!(
            pace.lease_least >= (pace.early + pace.late + pace.round_trip + least).min(self.lead.lease),
            act,
            "The last lease is early + late + one round trip + max(30 ms, 4 round trips, 3 times the lateness) + 2 rounds."
        );
        assert!(pace.final_lease <= self.lead.lease, "{act}: questions only shorten leases");
        match pace.leases {
            Leases::Shortened => {
                holds!(
                    pace.period >= PERIOD_MIN.max(pace.round_trip / 2),
                    act,
                    "half a round trip apart, at least 5 ms"
                );
            }
            Leases::Fixed => holds!(pace.period >= PERIOD_MIN_FIXED, act, "Rounds are at least 20 ms apart."),
        }
        let latest = DELIVERY_MIN.max(pace.round_trip * 2).max(pace.lateness);
        holds!(
            self.commit_by(self.critical()) <= self.brink() - latest,
            act,
            "is the brink, less the longest of 8 ms, two round trips and the lateness"
        );
        holds!(
            self.lease_at(self.brink()) == Span::ZERO,
            act,
            "Each inquiry carries a pending lease that ends at one common instant"
        );
    }

    fn check_limits(&self, act: &str) {
        let pace = &self.pace;
        let millis = Span::from_millis;
        holds!(
            self.no_return() == self.start - pace.early - pace.round_trip * 3 - millis(20),
            act,
            "If a failure is known at start - early - 3 round trips - 20 ms, the act is withdrawn before any robot starts"
        );
        holds!(
            self.last_withdrawal() == self.start - pace.early - pace.round_trip - millis(5),
            act,
            "the last instant at which a withdrawal can still arrive (start - early - round trip - 5 ms)"
        );
        holds!(
            self.no_return() <= self.last_withdrawal(),
            act,
            "Later, the mission can only stop the robots."
        );
        holds!(
            self.doubt()
                == pace.early + pace.round_trip * 2 + pace.final_lease + pace.period * 2 + millis(10),
            act,
            "The limit for silence is early + 2 round trips + last lease + two last rounds + 10 ms"
        );
        holds!(
            self.out_of_quiet(self.start) == self.start + millis(1),
            act,
            "They pause from a round trip and 1 ms before the planned start, but at most 5 ms, until 1 ms after it"
        );
        holds!(
            self.out_of_quiet(self.start - millis(5)) == self.start - millis(5),
            act,
            "They pause from a round trip and 1 ms before the planned start, but at most 5 ms, until 1 ms after it"
        );
        holds!(
            self.round.is_none_or(|(sent, answered)| sent <= answered),
            act,
            "The report states the time from the commitment to its last answer (`window_ms`)"
        );
    }
}
