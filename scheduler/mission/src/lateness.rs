//! Measures how late this machine calls the mission: the delay from the requested to the actual time of a call. On a host whose cores are
//! all busy, the robots that run there are called as late as the scheduler.

use urrcp::{Server, Span, Timestamp};

use super::clock::NtpState;

/// The interval at which the mission asks to be called during the greeting, so that it knows the lateness before the first act.
const PROBED_EVERY: Span = Span::from_millis(10);
/// The minimum time for which a measured lateness remains in effect. It remains in effect for at most twice this time.
const COUNTS_FOR: Span = Span::from_millis(5_000);
/// The shortest delay that counts as lateness. Shorter delays are usual, and the shortest leases already allow for them.
const LATENESS_MIN: Span = Span::from_millis(5);
/// The largest lateness that is assumed. A longer delay is a stall, not the usual delay of a busy machine. An act that fails because of a
/// stall is prepared again.
const LATENESS_MAX: Span = Span::from_millis(100);

/// This machine, as far as it delays the mission.
#[derive(Debug)]
pub(super) struct Machine {
    /// How late this machine calls the mission.
    pub(super) lateness: Lateness,
    /// The allowance for delays of this machine, added to the round trip of the slowest link. It is at least twice the delay because of
    /// which the last act was withdrawn.
    pub(super) hold_up: Span,
    /// Number of rounds of questions to robots that this machine started too late.
    pub(super) rounds_held_up: u64,
    pub(super) ntp: Option<NtpState>,
}

impl Machine {
    pub(super) const fn new(now: Timestamp<Server>) -> Self {
        Self { lateness: Lateness::new(now), hold_up: Span::ZERO, rounds_held_up: 0, ntp: None }
    }
}

/// The largest lateness of recent calls: how long after the requested time this machine called the mission.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lateness {
    /// The time at which the mission asked to be called; `None` once it has been called.
    due: Option<Timestamp<Server>>,
    /// The time of the next call that only measures the lateness.
    probe: Timestamp<Server>,
    since: Timestamp<Server>,
    /// The largest lateness since `since`, and the largest lateness of the previous period.
    largest: [Span; 2],
}

impl Lateness {
    pub(super) const fn new(now: Timestamp<Server>) -> Self {
        Self { due: None, probe: now, since: now, largest: [Span::ZERO; 2] }
    }

    /// Notes that the mission asks to be called at `due`.
    pub(super) fn asks(&mut self, now: Timestamp<Server>, due: Option<Timestamp<Server>>) {
        self.due = due.filter(|due| *due > now);
    }

    /// Notes that the mission is called at `now`, and measures how late this call is.
    pub(super) fn called(&mut self, now: Timestamp<Server>) {
        if now >= self.since + COUNTS_FOR {
            let before = if now < self.since + COUNTS_FOR * 2 { self.largest[0] } else { Span::ZERO };
            (self.since, self.largest) = (now, [Span::ZERO, before]);
        }
        if let Some(due) = self.due.take_if(|due| now >= *due) {
            let late = Some(now - due).filter(|late| *late >= LATENESS_MIN).unwrap_or_default();
            self.largest[0] = self.largest[0].max(late.min(LATENESS_MAX));
        }
        if now >= self.probe {
            self.probe = now + PROBED_EVERY;
        }
    }

    pub(super) const fn probe(&self) -> Timestamp<Server> {
        self.probe
    }

    pub(super) fn largest(&self) -> Span {
        self.largest[0].max(self.largest[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::{at, ms};

    /// Simulates a mission that asks to be called at `due` and is called at `now`.
    fn is_called(lateness: &mut Lateness, due: i64, now: i64) {
        lateness.asks(at(due - 1), Some(at(due)));
        lateness.called(at(now));
    }

    #[test]
    fn largest_lateness_is_remembered_for_five_to_ten_seconds() {
        let mut lateness = Lateness::new(at(0));
        is_called(&mut lateness, 10, 34);
        is_called(&mut lateness, 50, 52);
        assert_eq!(lateness.largest(), ms(24));
        is_called(&mut lateness, 6_000, 6_008);
        assert_eq!(lateness.largest(), ms(24));
        is_called(&mut lateness, 11_500, 11_501);
        assert_eq!(lateness.largest(), ms(8));
        is_called(&mut lateness, 40_000, 40_004);
        assert_eq!(lateness.largest(), ms(0));
    }

    #[test]
    fn early_call_has_no_lateness_and_lateness_of_a_stall_is_capped() {
        let mut lateness = Lateness::new(at(0));
        lateness.asks(at(0), Some(at(20)));
        lateness.called(at(5));
        assert_eq!(lateness.largest(), ms(0));
        lateness.called(at(2_020));
        assert_eq!(lateness.largest(), LATENESS_MAX);
        lateness.asks(at(2_030), Some(at(2_030)));
        lateness.called(at(2_031));
        assert_eq!(lateness.largest(), LATENESS_MAX, "it was due at once");
    }
}
