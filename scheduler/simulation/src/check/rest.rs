//! Checks invariant (c): a robot does not move after a confirmed stop, nor after the end of its leases.

use std::collections::HashMap;

use downbeat_robot::set_log::{LogEntry, MotionKind};
use urrcp::{ControlType, Server, Span, Timestamp};

use super::cause::Hit;
use super::facts::Facts;
use super::{DRIFT, Verdict};
use crate::braking::is_of;
use downbeat_mission::Record;

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    moved_after_a_stop(facts, verdict);
    for robot in (0..facts.drawn().robots.len()).filter(|robot| facts.honest(*robot)) {
        let beyond = beyond_lease(facts, robot);
        let beyond = beyond.into_iter().chain(turns_beyond_lease(facts, robot));
        beyond.for_each(|what| verdict.violated('c', what));
    }
}

fn moved_after_a_stop(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (at, record) in &facts.ran.records {
        let Record::StopConfirmed { robot } = record else { continue };
        let Some(robot) = facts.index_of(robot).filter(|robot| facts.rests_as_reported(*robot)) else {
            continue;
        };
        let next = facts.acts.iter().map(|act| act.at).filter(|next| next >= at).min();
        let moved = facts.ran.logs[robot].iter().find(|entry| {
            let moves = matches!(entry.motion, MotionKind::Set | MotionKind::Ramp);
            let when = Timestamp::<Server>::from_nanos(entry.true_ns);
            moves && when > *at && next.is_none_or(|next| when < next)
        });
        if let Some(entry) = moved {
            verdict.violated('c', format!("r{robot} moved after its stop was confirmed: {entry:?}"));
        }
        let turns = turning(facts, robot)
            .into_iter()
            .find(|(entry, until)| Timestamp::<Server>::from_nanos(entry.true_ns) < *at && *until > *at);
        if let Some((entry, _)) = turns {
            verdict.violated('c', format!("r{robot} confirmed its stop, but is still turning: {entry:?}"));
        }
    }
}

/// Returns the intervals in which a speed or an acceleration of a device was not zero. Each consists of the log entry that started it and
/// the end of the interval. A stop ends an interval as soon as the device begins to slow down.
fn turning<'a>(facts: &Facts<'a>, robot: usize) -> Vec<(&'a LogEntry, Timestamp<Server>)> {
    let log = &facts.ran.logs[robot];
    let rate = |entry: &&LogEntry| !is_of(entry, ControlType::Position);
    let turns = |entry: &LogEntry| entry.motion == MotionKind::Ramp || entry.is_set() && entry.value != 0.0;
    let mut intervals = Vec::new();
    for (index, entry) in log.iter().enumerate().filter(|(_, entry)| rate(entry) && turns(entry)) {
        let same = |next: &&LogEntry| next.device == entry.device && next.control_type == entry.control_type;
        let next = log[index + 1..].iter().find(same).map(|next| Timestamp::from_nanos(next.true_ns));
        intervals.push((entry, next.unwrap_or(facts.ran.watched_until)));
    }
    intervals
}

/// Finds a device that continues to move at a speed, although the robot has received nothing for longer than the lease of that movement.
fn turns_beyond_lease(facts: &Facts<'_>, robot: usize) -> Option<String> {
    let scripts = || facts.acts.iter().flat_map(|act| act.of(robot));
    let heard: Vec<Timestamp<Server>> = facts.heard(robot).collect();
    for (entry, until) in turning(facts, robot) {
        let from = Timestamp::<Server>::from_nanos(entry.true_ns);
        // If a process is gone or stalls, its behaviour and that of its hardware are unknown.
        let known = |hit: &Hit| !hit.is_of(robot) || hit.cause.is_of_link() || !hit.overlaps(from, until);
        if !facts.hits.iter().all(known) {
            continue;
        }
        let Some(name) = entry.request_id.as_deref().map(|id| facts.promised_name(robot, id)) else {
            continue;
        };
        let script = scripts().find(|script| script.promised.request_id.as_str() == name);
        let Some(lease) = script.and_then(|script| script.promised.running) else { continue };
        let renewed = heard.iter().copied().filter(|at| *at > from && *at < until);
        let before = heard.iter().copied().rfind(|at| *at <= from);
        let heard: Vec<_> = before.into_iter().chain(renewed).chain([until]).collect();
        let silent = heard.windows(2).map(|two| two[1] - two[0]).max().unwrap_or(Span::ZERO);
        if silent > lease.span() + DRIFT {
            let what = format!(
                "`{}` was still turning after a silence of {silent}, although its lease was {}",
                entry.device,
                lease.span()
            );
            return Some(format!("r{robot}: {what}"));
        }
    }
    None
}

/// Finds a movement that began although the robot had received nothing for longer than the current lease. A script starts only if neither
/// of its leases has expired: the pending lease, under which it waits, and the running lease, under which it plays.
fn beyond_lease(facts: &Facts<'_>, robot: usize) -> Option<String> {
    if facts.clock_was_set(robot) {
        return None;
    }
    let heard: Vec<Timestamp<Server>> = facts.heard(robot).collect();
    let leases: HashMap<&str, (Option<Span>, Option<Span>, Span)> = facts
        .acts
        .iter()
        .flat_map(|act| act.of(robot).map(move |script| (act, script)))
        .map(|(act, script)| {
            let running = script.promised.running.map(urrcp::Millis::span);
            // A script that follows another script of its device waits under the running lease of that script, if that is longer.
            let pending = match act.before(script) {
                Some(before) => before.promised.running.map(|lease| lease.span().max(act.promise.lease)),
                None => Some(act.promise.lease),
            };
            let first = script.written.and_then(|written| written.script.steps().first());
            let first = first.map_or(Span::ZERO, |step| step.offset.span());
            (script.promised.request_id.as_str(), (pending, running, first))
        })
        .collect();
    // The end of a lease may have become due while a process was stalled; the process handles it first when it continues.
    for entry in facts.ran.logs[robot].iter().filter(|entry| entry.is_set()) {
        let name = entry.request_id.as_deref().map(|id| facts.promised_name(robot, id));
        let Some((pending, running, first)) = name.and_then(|name| leases.get(name)) else { continue };
        let due = entry.true_ns - (entry.set_at - entry.due).as_nanos();
        let at = Timestamp::<Server>::from_nanos(due);
        // If the first step comes later than the script's start, the script already plays in between.
        let started = (entry.step == Some(0)).then_some((at - *first, *pending));
        for (at, lease) in started.into_iter().chain([(at, *running)]) {
            let last = heard.partition_point(|heard| *heard <= at).checked_sub(1).map(|last| heard[last]);
            if let (Some(lease), Some(last)) = (lease, last)
                && at - last > lease + DRIFT
            {
                let silent = at - last;
                return Some(format!(
                    "r{robot} moved {silent} after it had received its last message, although its lease was {lease}"
                ));
            }
        }
    }
    None
}
