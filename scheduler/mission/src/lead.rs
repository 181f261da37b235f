//! The lead time of an act: the time from sending to the start, and its components.

use serde::{Deserialize, Serialize};
use urrcp::Span;

use super::act::timing::Pace;

/// Minimum time between the end of all leases and the start, also added to the preparation time: a loaded machine wakes the scheduler
/// tens of milliseconds late.
pub const LEAD_MARGIN_MIN: Span = Span::from_millis(50);
/// Minimum pending lease: a few renewals must fit into it on the scheduler's millisecond timer.
const LEASE_MIN: Span = Span::from_millis(240);
/// The longest round trip that leads and leases allow for; longer ones are treated like it. If a lead and a lease followed every delay, a
/// show would wait for one bad link. The preparation time and the leases still leave room for at least twice as much.
const ROUND_TRIP_MAX: Span = Span::from_millis(500);
/// The longest accepted round trip. A robot with longer ones is refused: it could keep none of the leases.
pub(crate) const ROUND_TRIP_LONGEST: Span = Span::from_millis(3_000);
/// The longest pending lease of an act, and the longest margin after it. Round trips need at most 3 s; the rest is for early and late
/// starts because of clocks.
pub(crate) const LEASE_MAX: Span = Span::from_millis(10_000);
/// The number of bytes per second that any link and robot is assumed to receive, even on a host whose cores are all busy.
const BYTES_A_SECOND: i64 = 10_000_000;
/// Time to encode, send, check and answer one request, in addition to the transfer time of its bytes.
const EACH_REQUEST: Span = Span::from_micros(500);

/// The components of the lead time. Requests are sent and answered (`prepare`), then the decision is due. After that, the pending leases
/// can end (`lease`) before the start, and `margin` remains.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeadTime {
    /// Time from the sending timestamp to the decision.
    #[serde(rename = "prepare_ms")]
    pub prepare: Span,
    /// The pending lease: a robot that receives nothing for this long drops its script.
    #[serde(rename = "lease_ms")]
    pub lease: Span,
    /// Time between the end of the leases and the start.
    #[serde(rename = "margin_ms")]
    pub margin: Span,
}

impl LeadTime {
    /// The number of renewals per lease. A renewal may take as long as the interval between renewals to arrive, without being noticed.
    pub(crate) const RENEWALS_A_LEASE: i64 = 3;

    /// The lead time that this fleet needs.
    ///
    /// `round_trip` is the longest round trip that links nearly always keep. `requests` and `bytes` are the total to send. `lease` is the
    /// pending lease that requests carry.
    #[must_use]
    pub(crate) fn needed(round_trip: Span, requests: usize, bytes: usize, pace: &Pace, lease: Span) -> Self {
        let requests = i64::try_from(requests).unwrap_or(i64::MAX);
        let bytes = i64::try_from(bytes).unwrap_or(i64::MAX);
        let transfer =
            EACH_REQUEST * requests + Span::from_millis(bytes.saturating_mul(1_000) / BYTES_A_SECOND);
        Self {
            prepare: counted(round_trip) * 3 + transfer + LEAD_MARGIN_MIN,
            lease,
            margin: LEAD_MARGIN_MIN.max(pace.margin()).max(pace.needed() - lease),
        }
    }

    /// The shortest pending lease that survives the delays of this fleet.
    #[must_use]
    pub fn lease_needed(round_trip: Span) -> Span {
        LEASE_MIN.max(counted(round_trip) * (2 * Self::RENEWALS_A_LEASE))
    }

    /// Time from the sending timestamp to the start.
    #[must_use]
    pub fn total(&self) -> Span {
        self.prepare + self.lease + self.margin
    }

    /// The lead time for a later start. Additional time extends the *prepare* phase.
    #[must_use]
    pub fn stretched_to(self, total: Span) -> Self {
        Self { prepare: self.prepare + (total - self.total()).max(Span::ZERO), ..self }
    }
}

/// A round trip, limited to `ROUND_TRIP_MAX`.
pub(crate) fn counted(round_trip: Span) -> Span {
    round_trip.min(ROUND_TRIP_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::act::timing::{Leases, Measured};

    fn needed(round_trip: Span, bytes: usize) -> LeadTime {
        let lease = LeadTime::lease_needed(round_trip);
        let (early, late, record, lateness) = (Span::ZERO, Span::ZERO, Span::ZERO, Span::ZERO);
        let measured = Measured {
            robots: 6,
            scripts: 6,
            questions: 1,
            leases: Leases::Shortened,
            round_trip,
            early,
            late,
            record,
            lateness,
        };
        LeadTime::needed(round_trip, 6, bytes, &Pace::of(&measured, lease), lease)
    }

    #[test]
    fn slower_links_and_longer_scripts_need_a_longer_lead() {
        let near = needed(Span::from_millis(1), 6_000);
        let far = needed(Span::from_millis(160), 6_000);
        let long = needed(Span::from_millis(1), 60_000_000);
        assert!(far.total() > near.total());
        assert!(long.total() > near.total() + Span::from_millis(2_900));
        assert!(far.lease >= Span::from_millis(160 * 6));
    }

    #[test]
    fn a_very_slow_link_does_not_make_the_show_wait_without_bound() {
        assert_eq!(
            needed(Span::from_millis(10_000), 6_000).prepare,
            needed(Span::from_millis(500), 6_000).prepare
        );
        assert_eq!(LeadTime::lease_needed(Span::from_millis(10_000)), Span::from_millis(3_000));
    }

    #[test]
    fn a_longer_lead_gives_the_answers_more_time() {
        let needed = needed(Span::from_millis(1), 6_000);
        let stretched = needed.stretched_to(Span::from_millis(5_000));
        assert_eq!(stretched.total(), Span::from_millis(5_000));
        assert_eq!(stretched.lease, needed.lease);
    }
}
