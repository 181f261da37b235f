//! (c) After a stop that was confirmed, and beyond the end of its leases, a robot does not move.

use std::collections::HashMap;

use downbeat_robot::set_log::MotionKind;
use urrcp::{Server, Span, Timestamp};

use super::facts::Facts;
use super::{DRIFT, Verdict};
use downbeat_mission::Record;

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    moved_after_a_stop(facts, verdict);
    for robot in (0..facts.drawn().robots.len()).filter(|robot| facts.honest(*robot)) {
        let beyond = beyond_lease(facts, robot);
        beyond.into_iter().for_each(|what| verdict.violated('c', what));
    }
}

fn moved_after_a_stop(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (at, record) in &facts.ran.records {
        let Record::StopConfirmed { robot } = record else { continue };
        let Some(robot) = facts.index_of(robot).filter(|robot| facts.honest(*robot)) else { continue };
        let next = facts.acts.iter().map(|act| act.at).filter(|next| next >= at).min();
        let moved = facts.ran.logs[robot].iter().find(|entry| {
            let moves = matches!(entry.motion, MotionKind::Set | MotionKind::Ramp);
            let when = Timestamp::<Server>::from_nanos(entry.true_ns);
            moves && when > *at && next.is_none_or(|next| when < next)
        });
        if let Some(entry) = moved {
            verdict.violated('c', format!("r{robot} moved after its stop was confirmed: {entry:?}"));
        }
    }
}

/// A movement at which the robot had heard nothing for longer than the lease that held then. A script starts only if neither of
/// its leases has run out: not the one under which it waits, nor the one under which it would play.
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
            // One that follows another of its device waits under the lease under which that one plays, if that is longer.
            let pending = match act.before(script) {
                Some(before) => before.promised.running.map(|lease| lease.span().max(act.promise.lease)),
                None => Some(act.promise.lease),
            };
            let first = script.written.and_then(|written| written.script.steps().first());
            let first = first.map_or(Span::ZERO, |step| step.offset.span());
            (script.promised.request_id.as_str(), (pending, running, first))
        })
        .collect();
    // A process that stood still may have been due for its lease's end meanwhile; it acts on it first when it continues.
    for entry in facts.ran.logs[robot].iter().filter(|entry| entry.is_set()) {
        let name = entry.request_id.as_deref().map(|id| facts.promised_name(robot, id));
        let Some((pending, running, first)) = name.and_then(|name| leases.get(name)) else { continue };
        let due = entry.true_ns - (entry.set_at - entry.due).as_nanos();
        let at = Timestamp::<Server>::from_nanos(due);
        // If the first step comes later than its script starts, the script already plays in between.
        let started = (entry.step == Some(0)).then_some((at - *first, *pending));
        for (at, lease) in started.into_iter().chain([(at, *running)]) {
            let last = heard.partition_point(|heard| *heard <= at).checked_sub(1).map(|last| heard[last]);
            if let (Some(lease), Some(last)) = (lease, last)
                && at - last > lease + DRIFT
            {
                let silent = at - last;
                return Some(format!(
                    "r{robot} moved {silent} after it was last heard of, its lease was {lease}"
                ));
            }
        }
    }
    None
}
