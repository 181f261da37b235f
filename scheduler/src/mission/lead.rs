//! How far ahead the start lies, and why.

use serde::Serialize;
use urrcp::Span;

/// Least time kept free between the end of all leases and the start, and on top of what preparing needs: a loaded machine
/// wakes the scheduler tens of milliseconds late.
pub const LEAD_MARGIN_MIN: Span = Span::from_millis(50);
/// Least pending lease: a few renewals must fit into it on the scheduler's millisecond timer.
const LEASE_MIN: Span = Span::from_millis(240);
/// Bytes a second that any link and robot is trusted to take in.
const BYTES_A_SECOND: i64 = 20_000_000;
/// Time to encode, send, check and answer one request, besides its bytes.
const EACH_REQUEST: Span = Span::from_micros(200);

/// The parts of the lead time: requests travel and are answered (`prepare`), then the decision is due; from then on the
/// pending leases can run out (`lease`) before the start, and `margin` is left.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LeadTime {
    /// From the sending timestamp to the decision.
    #[serde(rename = "prepare_ms")]
    pub prepare: Span,
    /// The pending lease: a robot that hears nothing for so long drops its script.
    #[serde(rename = "lease_ms")]
    pub lease: Span,
    /// Between the end of the leases and the start.
    #[serde(rename = "margin_ms")]
    pub margin: Span,
}

impl LeadTime {
    /// A renewal may take up to this part of a lease to arrive without anyone noticing.
    pub(crate) const RENEWALS_A_LEASE: i64 = 3;

    /// What this fleet needs.
    ///
    /// `delay_max` is the longest measured round trip, `requests` and `bytes` what has to be sent in all, `lease` the
    /// pending lease that the scenario prescribes.
    #[must_use]
    pub fn needed(delay_max: Span, requests: usize, bytes: usize, lease: Option<Span>) -> Self {
        let requests = i64::try_from(requests).unwrap_or(i64::MAX);
        let bytes = i64::try_from(bytes).unwrap_or(i64::MAX);
        let transfer =
            EACH_REQUEST * requests + Span::from_millis(bytes.saturating_mul(1_000) / BYTES_A_SECOND);
        Self {
            prepare: delay_max * 3 + transfer + LEAD_MARGIN_MIN,
            lease: lease.unwrap_or_else(|| Self::lease_needed(delay_max)),
            margin: LEAD_MARGIN_MIN.max(delay_max / 2),
        }
    }

    /// The shortest pending lease that survives the delays of this fleet.
    #[must_use]
    pub fn lease_needed(delay_max: Span) -> Span {
        LEASE_MIN.max(delay_max * (2 * Self::RENEWALS_A_LEASE))
    }

    /// From the sending timestamp to the start.
    #[must_use]
    pub fn total(&self) -> Span {
        self.prepare + self.lease + self.margin
    }

    /// The same start further away: what is gained goes to the answers.
    #[must_use]
    pub fn stretched_to(self, total: Span) -> Self {
        Self { prepare: self.prepare + (total - self.total()).max(Span::ZERO), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slower_links_and_longer_scripts_need_a_longer_lead() {
        let near = LeadTime::needed(Span::from_millis(1), 6, 6_000, None);
        let far = LeadTime::needed(Span::from_millis(160), 6, 6_000, None);
        let long = LeadTime::needed(Span::from_millis(1), 6, 60_000_000, None);
        assert!(far.total() > near.total());
        assert!(long.total() > near.total() + Span::from_millis(2_900));
        assert!(far.lease >= Span::from_millis(160 * 6));
    }

    #[test]
    fn a_longer_lead_gives_the_answers_more_time() {
        let needed = LeadTime::needed(Span::from_millis(1), 6, 6_000, None);
        let stretched = needed.stretched_to(Span::from_millis(5_000));
        assert_eq!(stretched.total(), Span::from_millis(5_000));
        assert_eq!(stretched.lease, needed.lease);
    }
}
