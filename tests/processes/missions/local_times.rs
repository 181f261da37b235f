//! Times of day while clocks change to or from daylight saving time. Each test uses a time zone whose clocks change close to now.

use chrono::{DateTime, Datelike, SubsecRound, TimeDelta, Timelike, Utc};
use stage::held_up;
use stage::session::{Ran, Session};

use super::missions::{evening, start_command};

#[derive(Clone, Copy)]
enum Clocks {
    GoForward,
    GoBack,
}

/// Returns a time zone, in POSIX form. Its clocks show UTC or one hour more, and change at the instant `at`.
fn zone(clocks: Clocks, at: DateTime<Utc>) -> String {
    let rule = |local: DateTime<Utc>| format!("{}/{}", local.ordinal0(), local.format("%H:%M:%S"));
    let months = TimeDelta::days(120);
    let other = if at.ordinal0() < 180 { at + months } else { at - months };
    match clocks {
        Clocks::GoForward => format!("STD0DST-1,{},{}", rule(at), rule(other)),
        Clocks::GoBack => format!("STD0DST-1,{},{}", rule(other), rule(at + TimeDelta::hours(1))),
    }
}

fn ahead(seconds: i64) -> DateTime<Utc> {
    Utc::now().trunc_subsecs(0) + TimeDelta::seconds(seconds)
}

fn time(local: DateTime<Utc>) -> String {
    local.format("%H:%M:%S").to_string()
}

fn run_in(zone: &str, session: &Session, args: &[&str]) -> Ran {
    Ran(session.command(args).env("TZ", zone).output().unwrap())
}

#[test]
fn start_after_clock_change_uses_the_new_local_time() {
    let session = evening("wait: done");
    let mut start = ahead(0);
    let ran = held_up::played(
        || {
            let change = ahead(4);
            start = change + TimeDelta::seconds(10);
            let at = time(start + TimeDelta::hours(1));
            let args = ["run", "evening.yaml", "--at", &at, "--format", "json"];
            run_in(&zone(Clocks::GoForward, change), &session, &args)
        },
        Ran::text,
    );
    let report = ran.json();
    assert_eq!(report["start"], start.format("%Y-%m-%dT%H:%M:%S.000000000Z").to_string(), "{report:#}");
}

#[test]
fn nonexistent_start_time_is_refused_with_the_nearest_times() {
    let change = ahead(3_600);
    let zone = zone(Clocks::GoForward, change);
    let at = time(change + TimeDelta::minutes(30));
    let after = time(change + TimeDelta::hours(1));
    let skipped = format!("{at} does not exist on ");
    let nearest = format!(" and {after}");
    let parts = [&*skipped, "the nearest existing times are ", &nearest];
    let session = evening("wait: done");
    run_in(&zone, &session, &["run", "evening.yaml", "--at", &at]).says(2, &parts);
    let session = evening(&format!("wait: {{time: \"{at}\"}}"));
    for command in ["run", "preflight"] {
        let ran = run_in(&zone, &session, &[command, "evening.yaml"]);
        ran.says(1, &parts);
        ran.says(1, &["evening.yaml: act `finale` cannot wait for its time of day: "]);
    }
}

#[test]
fn ambiguous_start_time_uses_first_occurrence_and_names_both() {
    let change = ahead(3_600);
    let shown = change + TimeDelta::minutes(30);
    let session = evening("wait: done");
    let mut command = session.command(&["run", "evening.yaml", "--at", &time(shown)]);
    command.env("TZ", zone(Clocks::GoBack, change));
    let (_mission, told) = start_command(command, "waits for");
    let [first, second] =
        ["+01:00", "+00:00"].map(|offset| shown.format(&format!("%FT%T{offset}")).to_string());
    let told = told.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        told.contains(&format!("the first time, {first}; for the other one, write --at {second}")),
        "{told}"
    );
    assert!(told.contains(&format!("`opening` waits for {}.000 UTC+01:00", time(shown))), "{told}");
}

#[test]
fn start_tomorrow_is_reported_with_its_date() {
    // In a time zone where it is noon, a minute ago is today.
    let passed = ahead(-60);
    let west = i64::from(passed.hour()) - 12;
    let local = passed - TimeDelta::hours(west);
    let session = evening("wait: done");
    let mut command = session.command(&["run", "evening.yaml", "--at", &time(local)]);
    command.env("TZ", format!("STD{west}"));
    let (_mission, told) = start_command(command, "waits for");
    let tomorrow = local + TimeDelta::days(1);
    assert!(told.contains(&tomorrow.format("waits for %T.000 on %-d %b %Y").to_string()), "{told}");
}
