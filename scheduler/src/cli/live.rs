//! What a mission says while it goes on: lines, nothing with JSON.

use downbeat_scripts::counted;
use urrcp::{Server, Span, Timestamp};

use super::{Format, console};
use crate::mission::{Progress, SkewBudget, Verdict};
use crate::report::preflight_table;

pub(super) struct Live {
    format: Format,
}

impl Live {
    pub(super) const fn new(format: Format) -> Self {
        Self { format }
    }

    fn line(&self, text: &str) {
        if self.format == Format::Text {
            console::note(text);
        }
    }

    fn block(&self, text: &str) {
        if self.format == Format::Text {
            console::note_block(text);
        }
    }

    pub(super) fn tell(&self, at: Timestamp<Server>, progress: &Progress) {
        match progress {
            Progress::Connected { robots } => self.line(&format!("{} connected", counted(*robots, "robot"))),
            Progress::Greeted { clock_offset_max, preflight } => {
                if let Some(offset) = clock_offset_max {
                    self.line(&format!("clocks agree to {offset}"));
                }
                let plain = |verdict: &Verdict| matches!(verdict, Verdict::Pass(_) | Verdict::NotChecked);
                if preflight.rows.iter().any(|row| !row.checks.iter().all(|(_, verdict)| plain(verdict))) {
                    // What is wrong with whom is told as it is found, and in the report.
                    self.block(&preflight_table(preflight, false, crate::report::UNBOUNDED));
                }
            }
            Progress::Waiting { act, awaits } => self.line(&format!("`{act}` waits for {awaits}")),
            Progress::Preparing { act, start, lead, skew, .. } => {
                self.line(&format!(
                    "preparing `{act}`, start at {start} (lead {}: {} to prepare, {} of lease, {} of margin{})",
                    lead.total(),
                    lead.prepare,
                    lead.lease,
                    lead.margin,
                    skew.as_ref().map(skew_text).unwrap_or_default()
                ));
            }
            Progress::Decided { act, start, no_return, doubt, .. } => {
                self.decided(at, act, *start, *no_return, *doubt);
            }
            Progress::Committed { window: Some(window), .. } => {
                self.line(&format!("every lease reaches over the start, confirmed within {window}"));
            }
            Progress::Committed { .. }
            | Progress::Accepted { .. }
            | Progress::Started { .. }
            | Progress::Finished { .. }
            | Progress::ActEnded { .. } => {}
            Progress::Failed(failure) => self.line(&format!("{}: {}", failure.robot, failure.kind)),
            Progress::LinkLost { robot, reason, until } => {
                let until = until.map_or("".to_owned(), |until| format!(", given up at {until}"));
                self.line(&format!("{robot}: link lost ({reason}); it goes on by its script{until}"));
            }
            Progress::Reattached { robot } => self.line(&format!("{robot}: back")),
            Progress::Dropped { robot } => self.line(&format!("going on without {robot}")),
            Progress::NtpLost { since } => {
                self.line(&format!(
                    "no answer from the NTP server since {since}; this machine's clock goes on by itself"
                ));
            }
            Progress::NtpBack { offset_change } => {
                self.line(&format!(
                    "the NTP server answers again; this machine's clock has strayed by {offset_change}"
                ));
            }
            Progress::JournalLost { reason } => self.line(&format!("{reason}; stopping")),
            Progress::Stopping { reason } => self.line(&format!("stopping all robots: {reason}")),
        }
    }

    fn decided(
        &self,
        at: Timestamp<Server>,
        act: &str,
        start: Timestamp<Server>,
                no_return: Timestamp<Server>,
        doubt: Span,
    ) {
        self.line(&format!(
            "all have accepted: `{act}` starts in {}; for {} more a known failure still withdraws it, \
             and silence is noticed if it begins {doubt} before the start or earlier",
            start - at,
            no_return - at
        ));
    }
}

fn skew_text(skew: &SkewBudget) -> String {
    format!("; starts within {} of each other, {} allowed", skew.predicted, skew.tolerance)
}
