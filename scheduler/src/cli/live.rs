//! Live progress of a mission: a bar on a terminal, lines elsewhere, nothing with JSON.

use std::cell::Cell;
use std::time::Duration;

use downbeat_scripts::counted;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use urrcp::{Server, Span, Timestamp};

use super::{Format, console};
use crate::mission::{Progress, SkewBudget, Verdict};
use crate::report::preflight_table;
use crate::server_clock::ServerClock;

pub(super) struct Live {
    format: Format,
    clock: ServerClock,
    robots: usize,
    bar: ProgressBar,
    accepted: Cell<usize>,
    finished: Cell<usize>,
}

impl Live {
    pub(super) fn new(format: Format, clock: ServerClock, robots: usize) -> Self {
        let target = match format {
            Format::Text => ProgressDrawTarget::stderr(),
            Format::Json => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(None, target);
        bar.set_style(ProgressStyle::default_spinner());
        let (accepted, finished) = (Cell::new(0), Cell::new(0));
        Self { format, clock, robots, bar, accepted, finished }
    }

    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }

    fn line(&self, text: &str) {
        if self.format == Format::Text {
            self.bar.suspend(|| console::note(text));
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
                    self.line(preflight_table(preflight, false).trim_end());
                }
            }
            Progress::Waiting { act, awaits } => self.line(&format!("`{act}` waits for {awaits}")),
            Progress::Preparing { act, start, lead, skew, .. } => {
                self.accepted.set(0);
                self.finished.set(0);
                self.line(&format!(
                    "preparing `{act}`, start at {start} (lead {}: {} to prepare, {} of lease, {} of margin{})",
                    lead.total(),
                    lead.prepare,
                    lead.lease,
                    lead.margin,
                    skew.as_ref().map(skew_text).unwrap_or_default()
                ));
            }
            Progress::Accepted { .. } => {
                self.accepted.set(self.accepted.get() + 1);
                let message = format!("{}/{} robots have accepted", self.accepted.get(), self.robots);
                self.bar.set_message(message);
                self.bar.tick();
            }
            Progress::Decided { act, start, duration, no_return, doubt } => {
                self.decided(at, act, *start, *duration, *no_return, *doubt);
            }
            Progress::Committed { window: Some(window), .. } => {
                self.line(&format!("every lease reaches over the start, confirmed within {window}"));
            }
            Progress::ActSkipped { act, fate } => self.line(&format!("`{act}` {fate}")),
            Progress::Committed { .. } | Progress::ActEnded { .. } => {}
            Progress::Started { .. } => self.bar.tick(),
            Progress::Finished { .. } => {
                self.finished.set(self.finished.get() + 1);
                self.bar.set_message(format!("{}/{} robots have finished", self.finished.get(), self.robots));
            }
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
        duration: Span,
        no_return: Timestamp<Server>,
        doubt: Span,
    ) {
        self.line(&format!(
            "all have accepted: `{act}` starts in {}; for {} more a known failure still withdraws it, \
             and silence is noticed if it begins {doubt} before the start or earlier",
            start - at,
            no_return - at
        ));
        let total = duration.to_duration();
        self.bar.set_length(u64::try_from(total.as_millis()).unwrap_or(u64::MAX));
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos:>6}/{len} ms  {msg}") {
            self.bar.set_style(style);
        }
        if self.bar.is_hidden() {
            return;
        }
        let (bar, clock) = (self.bar.clone(), self.clock);
        // Moves the bar with the act; ends with it.
        tokio::spawn(async move {
            while !bar.is_finished() && clock.now() < start + duration {
                let played = (clock.now() - start).to_duration().min(total);
                bar.set_position(u64::try_from(played.as_millis()).unwrap_or(u64::MAX));
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        });
    }
}

fn skew_text(skew: &SkewBudget) -> String {
    format!("; starts within {} of each other, {} allowed", skew.predicted, skew.tolerance)
}
