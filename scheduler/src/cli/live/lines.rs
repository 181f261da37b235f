//! Formats the progress reports of a running mission as sentences with local times.

use downbeat_scripts::counted;
use urrcp::{Server, Span, Timestamp};

use crate::mission::{LeadTime, Preflight, Progress, Rest, SkewBudget, Verdict};
use crate::show::local::{time_as_of, time_of_day};
use crate::show::{Detail, rounded};

/// Returns the sentence for a progress report. Returns `None` if nothing is printed for it.
pub(super) fn sentence(at: Timestamp<Server>, progress: &Progress, detail: Detail) -> Option<String> {
    Some(match progress {
        Progress::Connected { robots } => format!("{} connected", counted(*robots, "robot")),
        Progress::Greeted { clock_offset_max: Some(offset), .. } => {
            format!("clocks agree within {}", duration(*offset, detail))
        }
        Progress::Waiting { act, awaits, .. } => format!("`{act}` waits for {awaits}"),
        Progress::Preparing { act, start, lead, skew, .. } => {
            let lead = if detail == Detail::Full { lead_text(lead, skew.as_ref()) } else { String::new() };
            format!("preparing `{act}`, start at {}{lead}", time_as_of(*start, at))
        }
        Progress::Decided { act, start, no_return, doubt, .. } => {
            let silence = format!("; silence is detected if it begins at least {doubt} before the start");
            format!(
                "all robots have accepted: `{act}` starts in {}; if a robot fails in the next {}, no robot starts{}",
                duration(*start - at, detail),
                duration(*no_return - at, detail),
                if detail == Detail::Full { &silence } else { "" }
            )
        }
        Progress::Committed { act, window: Some(window), .. } => {
            let leases = format!(": every lease extends beyond the start, confirmed within {window}");
            format!("starting `{act}`{}", if detail == Detail::Full { &leases } else { "" })
        }
        Progress::ActSkipped { act, fate } => format!("`{act}` {fate}"),
        Progress::Failed(failure) => format!("{}: {}", failure.robot, failure.kind),
        Progress::LinkLost { robot, reason, until } => {
            let until =
                until.map_or_else(String::new, |until| format!(", and will be given up at {}", time_of_day(until)));
            format!("{robot}: link lost ({reason}); it continues its script{until}")
        }
        Progress::Reattached { robot } => format!("{robot}: reconnected"),
        Progress::GoingHome { act, .. } => format!("`{act}` moves the robots that are at rest to their default positions"),
        Progress::AtHome => "no device has to move to its default position".to_owned(),
        Progress::Approaching { act, to, .. } => {
            format!("`{act}` moves the robots that are at rest to the first positions of `{to}`")
        }
        Progress::NotApproached { act, reason } => format!("`{act}` is not played: {reason}"),
        Progress::NotHome { reason } => format!("the robots stay where they are: {reason}"),
        Progress::Dropped { robot } => format!("continuing without {robot}"),
        Progress::NtpLost { since } => format!(
            "no answer from the NTP server since {}; this machine's clock is no longer synchronized",
            time_of_day(*since)
        ),
        Progress::NtpBack { offset_change } => {
            format!("the NTP server answers again; this machine's clock has drifted by {offset_change}")
        }
        Progress::JournalWrittenAgain => {
            "the journal was removed or replaced and has been restored; `downbeat stop` can reach this mission again"
                .to_owned()
        }
        Progress::JournalLost { reason } => format!("{reason}; stopping"),
        Progress::Stopping { reason, rest: Rest::InPlace } => format!("stopping all robots: {reason}"),
        Progress::Stopping { reason, rest: Rest::Home } => {
            format!("sending all robots to their default state: {reason}")
        }
        _ => return None,
    })
}

/// Returns the preflight checks for printing as a table, unless every check either passed or was not made. Faults of robots are printed
/// separately when they are found.
pub(super) fn table_worth_showing(progress: &Progress) -> Option<&Preflight> {
    let Progress::Greeted { preflight, .. } = progress else { return None };
    let plain = |verdict: &Verdict| matches!(verdict, Verdict::Pass(_) | Verdict::NotChecked);
    let all_plain = preflight.rows.iter().all(|row| row.checks.iter().all(|(_, verdict)| plain(verdict)));
    (!all_plain).then_some(preflight)
}

fn duration(span: Span, detail: Detail) -> String {
    if detail == Detail::Full { span.to_string() } else { rounded(span) }
}

fn lead_text(lead: &LeadTime, skew: Option<&SkewBudget>) -> String {
    let spread = skew.map_or_else(String::new, |skew| {
        format!(
            "; starts within {} of each other, {} allowed{}",
            skew.predicted,
            skew.tolerance,
            skew.parts()
        )
    });
    let LeadTime { prepare, lease, margin } = lead;
    format!(" (lead {}: {prepare} to prepare, {lease} lease, {margin} margin{spread})", lead.total())
}
