//! What a mission says while it goes on, as sentences with local times.

use downbeat_scripts::counted;
use urrcp::{Server, Timestamp};

use crate::mission::{Preflight, Progress, Rest, SkewBudget, Verdict};
use crate::show::local::{time_as_of, time_of_day};

/// The sentence of an event, if there is one.
pub(super) fn sentence(at: Timestamp<Server>, progress: &Progress) -> Option<String> {
    Some(match progress {
        Progress::Connected { robots } => format!("{} connected", counted(*robots, "robot")),
        Progress::Greeted { clock_offset_max: Some(offset), .. } => format!("clocks agree to {offset}"),
        Progress::Waiting { act, awaits, .. } => format!("`{act}` waits for {awaits}"),
        Progress::Preparing { act, start, lead, skew, .. } => format!(
            "preparing `{act}`, start at {} (lead {}: {} to prepare, {} of lease, {} of margin{})",
            time_as_of(*start, at),
            lead.total(),
            lead.prepare,
            lead.lease,
            lead.margin,
            skew.as_ref().map(skew_text).unwrap_or_default()
        ),
        Progress::Decided { act, start, no_return, doubt, .. } => format!(
            "all have accepted: `{act}` starts in {}; for {} more a known failure still withdraws it, \
             and silence is noticed if it begins {doubt} before the start or earlier",
            *start - at,
            *no_return - at
        ),
        Progress::Committed { window: Some(window), .. } => {
            format!("every lease reaches over the start, confirmed within {window}")
        }
        Progress::ActSkipped { act, fate } => format!("`{act}` {fate}"),
        Progress::Failed(failure) => format!("{}: {}", failure.robot, failure.kind),
        Progress::LinkLost { robot, reason, until } => {
            let until =
                until.map_or_else(String::new, |until| format!(", given up at {}", time_of_day(until)));
            format!("{robot}: link lost ({reason}); it goes on by its script{until}")
        }
        Progress::Reattached { robot } => format!("{robot}: back"),
        Progress::GoingHome { act, .. } => format!("`{act}` moves the robots at rest to their default positions"),
        Progress::AtHome => "no device has to move to its default position".to_owned(),
        Progress::Approaching { act, to, .. } => {
            format!("`{act}` moves the robots at rest to the first positions of `{to}`")
        }
        Progress::NotApproached { act, reason } => format!("`{act}` is not played: {reason}"),
        Progress::NotHome { reason } => format!("the robots stay where they are: {reason}"),
        Progress::Dropped { robot } => format!("going on without {robot}"),
        Progress::NtpLost { since } => format!(
            "no answer from the NTP server since {}; this machine's clock goes on by itself",
            time_of_day(*since)
        ),
        Progress::NtpBack { offset_change } => {
            format!("the NTP server answers again; this machine's clock has strayed by {offset_change}")
        }
        Progress::JournalWrittenAgain => {
            "the journal was removed or replaced, and is written again; `downbeat stop` reaches this mission again"
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

/// The table of the checks, if one of them did not simply pass. What is wrong with which robot is told as it is found.
pub(super) fn table_worth_showing(progress: &Progress) -> Option<&Preflight> {
    let Progress::Greeted { preflight, .. } = progress else { return None };
    let plain = |verdict: &Verdict| matches!(verdict, Verdict::Pass(_) | Verdict::NotChecked);
    let all_plain = preflight.rows.iter().all(|row| row.checks.iter().all(|(_, verdict)| plain(verdict)));
    (!all_plain).then_some(preflight)
}

fn skew_text(skew: &SkewBudget) -> String {
    format!("; starts within {} of each other, {} allowed{}", skew.predicted, skew.tolerance, skew.parts())
}
