//! How late this host wakes its robots, compared with what the scenario tolerates.

use serde::Serialize;
use urrcp::Span;

/// A wake-up that is late by more than `start_tolerance` divided by this number causes a warning. Clock errors need the rest of the
/// tolerance.
const SHARE: i64 = 4;

/// How late this host wakes its robots, as a preflight measured it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct HostWakeUp {
    /// Half of the wake-ups were later than this.
    #[serde(rename = "median_ms")]
    pub median: Span,
    /// One in a hundred wake-ups was later than this.
    #[serde(rename = "p99_ms")]
    pub p99: Span,
    /// No wake-up was later than this.
    #[serde(rename = "longest_ms")]
    pub longest: Span,
    /// The scheduling that the measuring thread was granted, for users.
    pub scheduling: String,
    /// The reason why wake-ups may be too late; `None` if they are not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
}

impl HostWakeUp {
    /// Adds a warning if this host may wake its robots too late. They must start within `tolerance`; `None` if this host drives no
    /// robots.
    #[must_use]
    pub fn judged_by(mut self, tolerance: Option<Span>) -> Self {
        let too_late = |tolerance: &Span| self.p99 > *tolerance / SHARE;
        self.warning = tolerance.filter(too_late).map(|tolerance| {
            format!(
                "robots of this process may start {} late, which leaves little of start_tolerance {tolerance}: keep the \
                 cores free, allow real-time scheduling, or raise start_tolerance",
                self.p99
            )
        });
        self
    }

    /// The measurement and the warning as sentences for users.
    pub fn sentences(&self) -> impl Iterator<Item = String> {
        let measured = format!(
            "this host wakes up {} late (median), {} (p99), {} at most; {}",
            self.median, self.p99, self.longest, self.scheduling
        );
        let warning = self.warning.iter().map(|warning| format!("warning: {warning}"));
        std::iter::once(measured).chain(warning)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn host_exceeding_a_quarter_of_tolerance_is_warned_if_it_drives_robots() {
        let (median, longest) = (Span::ZERO, Span::from_millis(50));
        let measured =
            |p99| HostWakeUp { median, p99, longest, scheduling: "as it comes".to_owned(), warning: None };
        let tolerance = Some(Span::from_millis(10));
        let just_so = measured(Span::from_micros(2_500)).judged_by(tolerance);
        assert_eq!(just_so.warning, None);
        let late = measured(Span::from_micros(2_501)).judged_by(tolerance);
        let warning = late.warning.as_deref().unwrap();
        assert!(warning.contains("2.501 ms late") && warning.contains("start_tolerance 10 ms"), "{warning}");
        assert_eq!(late.sentences().count(), 2);
        assert_eq!(measured(Span::from_millis(40)).judged_by(None).warning, None);
    }
}
