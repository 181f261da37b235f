//! Recognises, by Downbeat's own report, missions for which this machine was too slow.
//!
//! Only for these reasons, a test may play a mission again. Any other failure is a fault.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Sentences or words of a report by which a slow machine is recognised, each with the outcome or failure that it indicates.
const REASONS: [(&str, &str); 8] = [
    ("a late command is never started", "failure `late` of a robot on this machine"),
    ("this machine was delayed", "outcome `decision_late`"),
    ("this machine or its disk was delayed", "outcome `commitment_late`"),
    ("_late\":{\"by_ms\"", "outcome `decision_late` or `commitment_late`"),
    ("played to the end, but steps were up to", "late steps of a robot on this machine"),
    ("\"steps_late\":{\"late_ms\"", "late steps of a robot on this machine"),
    ("the link to the robot is too slow", "failure `too_slow` on a link of this machine"),
    ("\"failure\":\"too_slow\"", "failure `too_slow` on a link of this machine"),
];

/// Maximum number of times that a mission is played.
pub const ATTEMPTS: usize = 5;

/// Words of a report about starts out of tolerance, as text and as JSON. Only in connection with late steps do they indicate a slow machine.
const OUT_OF_TOLERANCE: [&str; 2] =
    ["played to the end, but out of tolerance", "\"out_of_tolerance\":{\"spread_ms\""];

/// Returns why this machine was too slow, if the report states such a reason.
pub fn reason(report: &str) -> Option<&'static str> {
    // Ignores white space, because sentences may be wrapped and JSON may be indented.
    let without_spaces = |text: &str| text.split_whitespace().collect::<String>();
    let report = without_spaces(report);
    let has = |words: &str| report.contains(&without_spaces(words));
    let found = REASONS.iter().find(|(words, _)| has(words)).map(|(_, reason)| *reason);
    let started_late = || OUT_OF_TOLERANCE.iter().any(|words| has(words)) && has_late_steps(&report);
    found.or_else(|| {
        started_late()
            .then_some("late starts of robots on this machine, which report their first steps as late")
    })
}

/// Whether robots have reported late steps. The report contains no white space.
fn has_late_steps(report: &str) -> bool {
    let counted = report.split("\"late_steps\":").skip(1).any(|rest| !rest.starts_with('0'));
    counted || report.contains("morethan1mslate,byatmost")
}

/// Returns why this machine was too slow to start the mission, if the report states such a reason. In this case nothing has moved.
fn reason_of_no_start(report: &str) -> Option<&'static str> {
    reason(report).filter(|reason| reason.starts_with("outcome"))
}

/// Plays a mission by calling `play`, and plays it again if its report states that this machine was too slow. Prints each repetition to
/// standard error.
#[track_caller]
pub fn played<T>(play: impl FnMut() -> T, report: impl Fn(&T) -> String) -> T {
    played_unless(None, play, |played| reason(&report(played)))
}

/// Like [`played`], but before a mission is played again, removes the previous attempt from the state folder.
#[track_caller]
pub fn played_in<T>(state: &Path, play: impl FnMut() -> T, report: impl Fn(&T) -> String) -> T {
    played_unless(Some(state), play, |played| reason(&report(played)))
}

/// Like [`played_in`], but plays the mission again only if this machine was too slow to start it.
#[track_caller]
pub fn begun_in<T>(state: &Path, play: impl FnMut() -> T, report: impl Fn(&T) -> String) -> T {
    played_unless(Some(state), play, |played| reason_of_no_start(&report(played)))
}

#[track_caller]
fn played_unless<T>(
    state: Option<&Path>,
    mut play: impl FnMut() -> T,
    reason: impl Fn(&T) -> Option<&'static str>,
) -> T {
    let before = state.map(missions).unwrap_or_default();
    for attempt in 2..=ATTEMPTS {
        let played = play();
        let Some(reason) = reason(&played) else { return played };
        eprintln!("attempt {attempt} of {ATTEMPTS} at {}: {reason}", std::panic::Location::caller());
        let after = state.map(missions).unwrap_or_default();
        after.difference(&before).for_each(|mission| std::fs::remove_dir_all(mission).unwrap());
    }
    play()
}

fn missions(state: &Path) -> BTreeSet<PathBuf> {
    std::fs::read_dir(state)
        .into_iter()
        .flatten()
        .map(|entry| entry.unwrap().path())
        .filter(|entry| entry.is_dir())
        .collect()
}

#[test]
fn mission_is_repeated_only_if_the_machine_is_reported_too_slow() {
    let attempts = |reports: &[&str]| {
        let mut count = 0;
        let play = || {
            count += 1;
            reports.get(count - 1).copied().unwrap_or("show: failed").to_owned()
        };
        let last = played(play, Clone::clone);
        (count, last)
    };
    let slow = "show: not started: this machine or its disk was delayed, and the commitment came too late";
    assert_eq!(attempts(&["show: done"]).0, 1);
    assert_eq!(attempts(&["show: failed and stopped", "show: done"]).0, 1);
    assert_eq!(attempts(&[slow, "show: done"]), (2, "show: done".to_owned()));
    assert_eq!(attempts(&[slow; 9]), (ATTEMPTS, slow.to_owned()));
    assert!(reason("{\"outcome\": {\n  \"commitment_late\": {\n    \"by_ms\": 3}}}").is_some());
    assert!(reason("{\"failures\": [{\"robot\": \"r0\", \"failure\": \"silent\"}]}").is_none());
    let apart = "swap: played to the end, but out of tolerance: robots started 12.4 ms apart or off schedule";
    assert!(reason(apart).is_none(), "a start that no robot reports as late is a fault");
    assert!(
        reason(&format!("{apart}\ncf6: 1 step of `x` more than 1 ms late, by at most 12.4 ms")).is_some()
    );
    let json = |late: u32| {
        format!(
            "{{\"outcome\": {{\"out_of_tolerance\": {{\"spread_ms\": 12.4}}}}, \"robots\": [{{\"late_steps\": {late}}}]}}"
        )
    };
    assert!(reason(&json(1)).is_some() && reason(&json(0)).is_none());
}

#[test]
fn repeated_mission_leaves_only_its_last_attempt_behind() {
    let state = tempfile::tempdir().unwrap();
    std::fs::create_dir(state.path().join("earlier")).unwrap();
    let mut count = 0;
    let play = || {
        count += 1;
        std::fs::create_dir(state.path().join(count.to_string())).unwrap();
        ["this machine was delayed", "show: done"][count - 1]
    };
    assert_eq!(played_in(state.path(), play, |report| (*report).to_owned()), "show: done");
    assert_eq!(missions(state.path()), ["2", "earlier"].map(|name| state.path().join(name)).into());
}
