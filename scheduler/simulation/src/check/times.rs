//! Checks a part of invariant (h): an act that waits for a time of day starts when the clocks next show or skip that time, and never
//! earlier.

use downbeat_plan::Wait;
use urrcp::{Server, Span, Timestamp};

use super::Verdict;
use super::facts::Facts;
use crate::Happened;
use crate::draw::ClockChange;
use downbeat_mission::Progress;

const DAY: Span = Span::from_millis(24 * 3_600_000);

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    let Some(change) = facts.drawn().clock_change.map(|index| ClockChange::ALL[index]) else { return };
    let waits = |name: &str| {
        let act = facts.drawn().choreography.acts.iter().find(|act| act.name == name)?;
        if let Wait::TimeOfDay(time) = act.wait { Some(time) } else { None }
    };
    for (at, happened) in &facts.ran.history {
        let Happened::Told(told) = happened else { continue };
        let Progress::Waiting { act, at: Some(target), .. } = &**told else { continue };
        let Some(time) = waits(act) else { continue };
        let since = *at + facts.ahead_at(*at);
        let next = next(change, time, since);
        if *target != next {
            let what = format!(
                "`{act}` waits for {target}, but after {since} the clocks first show {time} at {next}"
            );
            verdict.violated('h', what);
        }
    }
    for act in &facts.acts {
        let Wait::TimeOfDay(time) = act.written.wait else { continue };
        // A withdrawn act is prepared again as soon as possible.
        let told = facts.ran.history.iter().filter(|(at, _)| *at <= act.at);
        let target = told.rev().find_map(|(_, happened)| match happened {
            Happened::Told(told) => match &**told {
                Progress::Waiting { act: name, at, .. } if *name == act.written.name => *at,
                _ => None,
            },
            _ => None,
        });
        let start = act.promise.start + act.ahead;
        if target.is_none_or(|target| start < target) {
            let what = format!(
                "act {} starts at {start}, but its time of day {time} is at {target:?}",
                act.promise.number
            );
            verdict.violated('h', what);
        }
    }
}

/// Returns the first instant, at or after `since`, at which the clocks show or skip the time of day `time`.
fn next(change: ClockChange, time: Span, since: Timestamp<Server>) -> Timestamp<Server> {
    let offset = |seconds: i32| Span::from_millis(i64::from(seconds) * 1_000);
    let midnight = Timestamp::<Server>::from_nanos(since.as_nanos() / DAY.as_nanos() * DAY.as_nanos());
    let days = (-2..=2).map(|day| midnight + DAY * day);
    let instants =
        days.flat_map(|day| [change.before_s, change.after_s].map(|seconds| day + time - offset(seconds)));
    let shown = instants.filter(|at| change.time_of_day(*at) == time);
    // The time that the clocks show just before the change.
    let before = change.time_of_day(change.at() - Span::from_nanos(1)) + Span::from_nanos(1);
    let into = Span::from_nanos((time - before).as_nanos().rem_euclid(DAY.as_nanos()));
    let skipped = (into < change.forward()).then(|| change.at());
    let all = shown.chain(skipped).filter(|at| *at >= since);
    all.min().unwrap_or(since)
}
