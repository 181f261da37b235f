//! The lead time of an act (the time from sending its scripts to its start) and the components of that time.

use serde::{Deserialize, Serialize};
use urrcp::Span;

use super::act::timing::Pace;

/// The minimum time between the end of all pending leases and the start of an act. It is also added to the preparation time, because a
/// loaded machine wakes the scheduler tens of milliseconds late.
pub const LEAD_MARGIN_MIN: Span = Span::from_millis(50);
/// The minimum pending lease (how long a robot keeps a waiting script without receiving anything). A few renewals, timed in milliseconds,
/// must fit into it.
const LEASE_MIN: Span = Span::from_millis(240);
/// The longest round trip for which lead times and leases allow; longer ones are treated as this long. Otherwise, one bad link would
/// delay the whole show. The preparation time and the leases tolerate delays of at least twice this value.
const ROUND_TRIP_MAX: Span = Span::from_millis(500);
/// The longest accepted round trip. A robot with a longer round trip is refused, because none of its leases could be renewed in time.
pub(crate) const ROUND_TRIP_LONGEST: Span = Span::from_millis(3_000);
/// The longest pending lease of an act, and the longest margin after it. Round trips need at most 3 s; the rest allows for starts that
/// are early or late because of clock errors.
pub(crate) const LEASE_MAX: Span = Span::from_millis(10_000);
/// The assumed transfer rate of every link and robot in bytes per second, even on a host whose cores are all busy.
const BYTES_A_SECOND: i64 = 10_000_000;
/// Time to encode, send, check and answer one request, in addition to the transfer time of its bytes.
const EACH_REQUEST: Span = Span::from_micros(500);

/// The components of an act's lead time. During `prepare`, requests are sent and answered; then the mission decides whether the act
/// starts. `lease` is the time in which all pending leases can end before the start. `margin` is the time that then remains until the
/// start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeadTime {
    /// Time from the sending timestamp to the decision whether the act starts.
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
    /// The number of renewals per lease. A renewal that arrives late by up to one interval between renewals therefore has no effect.
    pub(crate) const RENEWALS_A_LEASE: i64 = 3;

    /// The lead time that an act of this fleet needs.
    ///
    /// `round_trip` is a limit that the round trips of all links nearly always keep. `requests` and `bytes` are the total numbers of
    /// requests and bytes to send. `lease` is the pending lease in those requests.
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

    /// This lead time, extended to `total` for a later start. All of the additional time extends the *prepare* phase.
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
    fn very_slow_link_delays_the_show_by_a_bounded_time() {
        assert_eq!(
            needed(Span::from_millis(10_000), 6_000).prepare,
            needed(Span::from_millis(500), 6_000).prepare
        );
        assert_eq!(LeadTime::lease_needed(Span::from_millis(10_000)), Span::from_millis(3_000));
    }

    #[test]
    fn longer_lead_gives_responses_more_time() {
        let needed = needed(Span::from_millis(1), 6_000);
        let stretched = needed.stretched_to(Span::from_millis(5_000));
        assert_eq!(stretched.total(), Span::from_millis(5_000));
        assert_eq!(stretched.lease, needed.lease);
    }
}
