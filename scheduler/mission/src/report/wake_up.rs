//! How late this host wakes its robots, compared with what the scenario tolerates.

use serde::Serialize;
use urrcp::Span;

/// The part of `start_tolerance` that waking up may take before it is worth a warning: one in so many. The clocks need most
/// of it.
const SHARE: i64 = 4;

/// What a preflight measured on this host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct HostWakeUp {
    /// Half of the times it woke later.
    #[serde(rename = "median_ms")]
    pub median: Span,
    /// One time in a hundred it woke later.
    #[serde(rename = "p99_ms")]
    pub p99: Span,
    /// It never woke later.
    #[serde(rename = "longest_ms")]
    pub longest: Span,
    /// What the measuring thread was granted, for people.
    pub scheduling: String,
    /// Why that may be too late.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
}

impl HostWakeUp {
    /// Adds a warning if this host may be too late for `tolerance`, within which its robots have to start; `None` if it drives
    /// none.
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

    /// Sentences for people.
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
    fn a_host_that_uses_up_a_quarter_of_the_tolerance_is_warned_of_if_it_drives_robots() {
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
