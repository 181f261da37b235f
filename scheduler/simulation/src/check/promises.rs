//! What the scheduler promises to do and not to do on the way, held against what reached the robots: (a) nothing starts that
//! was not committed, and nothing is committed that should have started; (c) only a stop cancels,
//! and only the end of a lease ends what plays; (d) only the intended robots move; (f) nothing is sent whose skew
//! budget is beyond the tolerance; (g) what was decided was accepted, what is said to have begun had hands to begin with, and
//! what was on the disk is read again; (h) a robot that is reached again is spoken to at once.

use urrcp::{Command, Message, RequestId, Server, Span, Timestamp};

use super::cause::{Cause, Hit};
use super::facts::{Facts, SentAct};
use super::{DRIFT, Verdict};
use crate::Happened;
use crate::world::PATIENCE;
use downbeat_mission::{FailureKind, Progress, Record};
use downbeat_rehearsal::dry_run::BEGIN;

/// What the scheduler and a robot take to continue where neither waits for anything.
const AT_ONCE: Span = Span::from_millis(2);
/// What clocks, and the way of a question that nothing was measured of, are taken to be before a lease of a process that took over.
const HUSHED_AHEAD: Span = Span::from_millis(30);
/// A robot that is delayed for longer drops its start.
const START_LATE_MAX: Span = Span::from_millis(50);

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    only_stops_cancel(facts, verdict);
    leases_are_left_to_run(facts, verdict);
    strangers_rest(facts, verdict);
    budgets_fit(facts, verdict);
    decisions_are_accepted(facts, verdict);
    hands_were_there(facts, verdict);
    what_was_written_is_read(facts, verdict);
    those_who_return_hear(facts, verdict);
    those_who_start_are_awaited(facts, verdict);
    starts_are_committed(facts, verdict);
    commitments_are_in_time(facts, verdict);
}

/// The commitment is not written down any more when the act should have started, by the clock of the process that writes: another one
/// would take robots for started that had lost what they held.
fn commitments_are_in_time(facts: &Facts<'_>, verdict: &mut Verdict) {
    for act in &facts.acts {
        let start = act.promise.start + act.ahead;
        if act.committed.is_some_and(|at| at + facts.ahead_at(at) > start) {
            let number = act.promise.number;
            return verdict.violated('a', format!("act {number} was committed after it should have started"));
        }
    }
}

/// No robot starts an act unless the commitment was written down, but for one that what was sent before reached too late, or whose
/// stop was cut off.
fn starts_are_committed(facts: &Facts<'_>, verdict: &mut Verdict) {
    for act in facts.acts.iter().filter(|act| act.committed.is_none()) {
        for script in act.scripts.iter().filter(|script| script.began() && facts.honest(script.robot)) {
            let robot = script.robot;
            let by = act.start_of(script) + START_LATE_MAX;
            let hit = facts
                .hits
                .iter()
                .any(|hit| hit.is_of(robot) && hit.cause != Cause::LinkDown && hit.overlaps(act.at, by));
            if !hit && !facts.clock_was_set(robot) && !facts.was_stopped_in_part(act, robot) {
                let number = act.promise.number;
                return verdict
                    .violated('a', format!("r{robot} started act {number}, which was never committed"));
            }
        }
    }
}

/// While robots are greeted, one that refuses connections may still be starting.
fn those_who_start_are_awaited(facts: &Facts<'_>, verdict: &mut Verdict) {
    /// For this long.
    const STARTS_WITHIN: Span = Span::from_millis(500);
    let first_act = facts.acts.first().map(|act| act.at);
    let mut lost: Vec<Option<Timestamp<Server>>> = vec![None; facts.drawn().robots.len()];
    for (at, happened) in &facts.ran.history {
        match happened {
            Happened::LinkDown(robot) => {
                lost[*robot].get_or_insert(*at);
            }
            Happened::TakenUp(_) => return,
            Happened::Told(progress) => {
                let Progress::Failed(failure) = &**progress else { continue };
                let robot = facts.index_of(&failure.robot).filter(|_| first_act.is_none_or(|act| *at < act));
                // Patience may end before.
                let robot = robot.filter(|_| *at < BEGIN + PATIENCE);
                let Some((robot, since)) = robot.and_then(|robot| Some((robot, lost[robot]?))) else {
                    continue;
                };
                if matches!(failure.kind, FailureKind::LinkDown { .. }) && *at - since < STARTS_WITHIN {
                    let what =
                        format!("r{robot} was given up {} after its first connection failed", *at - since);
                    return verdict.violated('h', what);
                }
            }
            _ => {}
        }
    }
}

/// An empty script comes to a robot only once it was left out or everything was being stopped.
fn only_stops_cancel(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (at, happened) in &facts.ran.history {
        let Happened::AtRobot(robot, Message::ControlRequest(request)) = happened else { continue };
        let cancels = matches!(&request.command, Command::Script(script) if script.is_empty());
        let dropped = facts.dropped[*robot].is_some_and(|dropped| dropped <= *at);
        // A stop is sent first and written down afterwards, in the same instant, unless the process dies between the two.
        let stopped = facts.stopping.iter().any(|stopping| stopping <= at);
        let died = facts.hits.iter().any(|hit| hit.cause == Cause::SchedulerCrash && hit.from <= *at);
        if cancels && !dropped && !stopped && !died {
            return verdict
                .violated('c', format!("r{robot} was sent a cancel at {at}, and nothing was being stopped"));
        }
    }
}

/// A robot says that the server was silent for longer than its lease only if nothing came to it for this long.
fn leases_are_left_to_run(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (at, happened) in &facts.ran.history {
        let Happened::Told(progress) = happened else { continue };
        let Progress::Failed(failure) = &**progress else { continue };
        let FailureKind::Script { error, .. } = &failure.kind else { continue };
        let Some(robot) = facts.index_of(&failure.robot).filter(|robot| facts.honest(*robot)) else {
            continue;
        };
        if error.code != urrcp::ErrorCode::LinkLost || facts.clock_was_set(robot) {
            continue;
        }
        let Some((from, lease)) = least_lease(facts, robot, *at) else { continue };
        // It begins at some time in between, and a lease that has run out by then ends it at once.
        let planned = from - START_LATE_MAX;
        let last = facts.heard(robot).filter(|heard| *heard <= planned).last().unwrap_or(planned);
        let heard = facts.heard(robot).filter(|heard| *heard > planned && heard <= at);
        let instants: Vec<_> = std::iter::once(last).chain(heard).chain(std::iter::once(*at)).collect();
        let longest = instants.windows(2).map(|two| two[1] - two[0]).max().unwrap_or_default();
        if longest + DRIFT < lease {
            let what = format!(
                "r{robot} says that it heard nothing for a lease of {lease}, and heard after {longest}"
            );
            return verdict.violated('c', what);
        }
    }
}

/// Of a robot that has begun all that it was sent: since when, and the shortest lease under which it plays. `None` where it
/// may have lost something that had not begun.
fn least_lease(facts: &Facts<'_>, robot: usize, at: Timestamp<Server>) -> Option<(Timestamp<Server>, Span)> {
    let mut acts = facts.acts.iter().filter(|act| act.at <= at && act.of(robot).next().is_some());
    let act = acts.next_back()?;
    let mut devices: Vec<_> = act.of(robot).map(|script| &script.promised.device).collect();
    devices.dedup();
    let first = |device: &urrcp::DeviceId| {
        act.of(robot)
            .filter(move |script| script.promised.device == *device)
            .map(|script| act.start_of(script))
            .min()
    };
    if act.of(robot).any(|script| act.before(script).is_none() && !script.began()) {
        return None;
    }
    let begun = devices.into_iter().filter_map(first).max()? + START_LATE_MAX;
    let leases: Option<Vec<Span>> =
        act.of(robot).map(|script| script.promised.running.map(urrcp::Millis::span)).collect();
    (begun < at).then_some((begun, leases?.into_iter().min()?))
}

/// Another robot at the address of one that is meant gets nothing that moves it.
fn strangers_rest(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (robot, log) in facts.ran.logs_of_strangers.iter().enumerate() {
        if let Some(entry) = log.iter().find(|entry| entry.request_id.is_some()) {
            verdict.violated('d', format!("another robot at the address of r{robot} moved: {entry:?}"));
        }
    }
}

fn budgets_fit(facts: &Facts<'_>, verdict: &mut Verdict) {
    for act in &facts.acts {
        if let Some(skew) = act.skew.filter(|skew| skew.predicted > skew.tolerance) {
            let (number, predicted, tolerance) = (act.promise.number, skew.predicted, skew.tolerance);
            let what = format!(
                "act {number} was sent, its starts may be {predicted} apart of {tolerance} tolerated"
            );
            verdict.violated('f', what);
        }
    }
}

/// When an act is decided, the first script of each device has come to its robot.
fn decisions_are_accepted(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (at, record) in &facts.ran.records {
        let Record::Decided { number, .. } = record else { continue };
        let of_number = |act: &&SentAct<'_>| act.promise.number == *number && act.at <= *at;
        let Some(act) = facts.acts.iter().rfind(of_number) else { continue };
        for script in
            act.scripts.iter().filter(|script| facts.honest(script.robot) && act.before(script).is_none())
        {
            let robot = script.robot;
            let came = facts.between(act.at, *at).iter().any(|(_, happened)| match happened {
                Happened::AtRobot(r, Message::ControlRequest(request)) if *r == robot => {
                    request.request_id.as_ref() == Some(&script.promised.request_id)
                }
                _ => false,
            });
            let out = facts.dropped[robot].is_some_and(|dropped| dropped <= *at);
            if !came && !out {
                let (device, number) = (&script.promised.device, act.promise.number);
                let what = format!("act {number} was decided, and `{device}` of r{robot} had not come to it");
                return verdict.violated('g', what);
            }
        }
    }
}

/// A script begins only if the hardware is not known to be dead, where there was time to ask.
fn hands_were_there(facts: &Facts<'_>, verdict: &mut Verdict) {
    /// A script that came so shortly before its start is begun unasked.
    const NOTICE: Span = Span::from_millis(250);
    for (robot, names) in
        facts.ran.starts_of_dead.iter().enumerate().filter(|(robot, _)| facts.honest(*robot))
    {
        for act in &facts.acts {
            for script in act.of(robot) {
                let is_it =
                    |name: &&String| facts.promised_name(robot, name) == script.promised.request_id.as_str();
                let Some(name) = names.iter().find(is_it) else { continue };
                let came = facts.ran.history.iter().rev().find_map(|(at, happened)| match happened {
                    Happened::AtRobot(r, Message::ControlRequest(request)) if *r == robot => {
                        (request.request_id.as_ref().map(RequestId::as_str) == Some(name.as_str()))
                            .then_some(*at)
                    }
                    _ => None,
                });
                let due = act.start_of(script);
                if came.is_some_and(|came| due - came > NOTICE) && !facts.clock_was_set(robot) {
                    let device = &script.promised.device;
                    verdict.violated('g', format!("r{robot} began `{device}` with dead hardware"));
                }
            }
        }
    }
}

fn what_was_written_is_read(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (at, happened) in &facts.ran.history {
        if let Happened::Forgotten(bytes) = happened {
            verdict.violated(
                'g',
                format!("{bytes} bytes of records were on the disk at {at}, and are not read again"),
            );
        }
    }
}

/// From the critical instant on nothing is sent until the commitment: a question would carry scripts over the start. It lies
/// within the doubt that was told. A process that takes an act up knows no shorter lease than that with which it was sent, so
/// it is silent from a lease before the start on. Clocks and the way are in that lease as well.
fn is_hushed(facts: &Facts<'_>, act: &SentAct<'_>, at: Timestamp<Server>, by: Timestamp<Server>) -> bool {
    let history = facts.between(act.at, at);
    let taken_up = history.iter().rfind(|(_, what)| matches!(what, Happened::TakenUp(_)));
    let hushed_from = act.promise.start - act.promise.lease - HUSHED_AHEAD;
    match taken_up {
        Some((taken_up, _)) => {
            // A process that takes the act up before that leaves a commitment that was recorded ahead of time unsent.
            let counts = |committed: Timestamp<Server>| {
                committed <= by && (committed >= *taken_up || *taken_up >= hushed_from)
            };
            !act.committed.is_some_and(counts) && by >= hushed_from && at < act.promise.start
        }
        None => act.decided.is_some() && by >= act.doubtful_from() && at < act.promise.start,
    }
}

/// A robot that holds something and is reached again hears more than the question for its name as soon as that is answered.
fn those_who_return_hear(facts: &Facts<'_>, verdict: &mut Verdict) {
    let drawn = facts.drawn();
    for (at, happened) in &facts.ran.history {
        let Happened::LinkUp(robot) = happened else { continue };
        let by = *at + drawn.delay.1 * 3 + drawn.robots[*robot].slow + AT_ONCE;
        let mut held = facts.acts.iter().filter(|act| {
            let ends = act.of(*robot).map(|script| act.start_of(script) + script.promised.duration).max();
            act.at < *at && ends.is_some_and(|ends| by < ends)
        });
        // Every message renews all leases of a robot, so one act silences the others.
        let holds = held.clone().next().is_some() && !held.any(|act| is_hushed(facts, act, *at, by));
        let over = |until: Timestamp<Server>| until <= by;
        let done = facts.stopping.iter().any(|at| over(*at)) || facts.dropped[*robot].is_some_and(over);
        let links = |hit: &Hit| hit.cause == Cause::LinkDown && hit.from < *at;
        let hit = facts.hits.iter().any(|hit| {
            let counts = hit.is_of(*robot) || hit.robot.is_none();
            // What was wrong with the robot until this link stands no longer keeps anything from it. A process that has just taken
            // the mission up may have to be silent.
            let goes_on = hit.robot.is_none() || hit.until > *at || hit.from >= *at;
            counts && !links(hit) && goes_on && hit.overlaps(*at - Span::from_nanos(1), by)
        });
        let failed = facts.between(*at, by).iter().any(|(_, happened)| {
            matches!(happened, Happened::Told(progress) if matches!(&**progress, Progress::Failed(_)))
        });
        let bounded = drawn.robots[*robot].bandwidth.is_none() && drawn.tail == 0.0 && facts.honest(*robot);
        let heard = facts.between(*at, by).iter().any(|(_, happened)| match happened {
            Happened::AtRobot(r, message) => {
                r == robot && !matches!(message, Message::InitializationRequest(_))
            }
            _ => false,
        });
        if holds && bounded && !done && !hit && !failed && !heard {
            return verdict.violated(
                'h',
                format!("r{robot} was reached again at {at}, and hears nothing of its scripts"),
            );
        }
    }
}
