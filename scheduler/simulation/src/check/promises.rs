//! Compares what the scheduler promised during a mission with the messages that reached the robots.
//!
//! (a) Nothing starts that was not committed, and nothing is committed after its planned start. (c) Only a stop cancels, and only the end
//! of a lease ends a playing script. (d) Only the intended robots move. (f) Nothing is sent whose skew budget exceeds the tolerance.
//!
//! (g) Robots had accepted an act that was decided. Hardware worked when a script is reported as begun. Data that is on the disk is read
//! again. (h) A robot that is reachable again receives messages at once.

use urrcp::{Command, Message, RequestId, Server, Span, Timestamp};

use super::cause::{Cause, Hit};
use super::facts::{Facts, SentAct};
use super::{DRIFT, Verdict};
use crate::Happened;
use crate::world::PATIENCE;
use downbeat_mission::{FailureKind, Progress, Record};
use downbeat_rehearsal::dry_run::BEGIN;

/// Time within which the scheduler or a robot reacts if there is nothing to wait for.
const AT_ONCE: Span = Span::from_millis(2);
/// Additional time before the last lease for which a process that resumes a mission sends nothing. It covers the error of the clocks and
/// the travel time of an inquiry that was not measured.
const HUSHED_AHEAD: Span = Span::from_millis(30);
/// Maximum delay after which a robot still starts a script.
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

/// Checks that the commitment is recorded no later than the planned start of the act, by the clock of the process that records it.
/// Otherwise, a process that resumes the mission would assume that robots have started, although they had lost their scripts.
fn commitments_are_in_time(facts: &Facts<'_>, verdict: &mut Verdict) {
    for act in &facts.acts {
        let start = act.promise.start + act.ahead;
        if act.committed.is_some_and(|at| at + facts.ahead_at(at) > start) {
            let number = act.promise.number;
            return verdict.violated('a', format!("act {number} was committed after it should have started"));
        }
    }
}

/// Checks that no robot starts an act without a recorded commitment. Exceptions are robots that earlier messages reached too late, and
/// robots whose scheduler died before it had sent all their stops.
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

/// Checks that, during the greeting (the first exchange with each robot), the mission waits for a robot that refuses connections. The
/// robot may still be starting.
fn those_who_start_are_awaited(facts: &Facts<'_>, verdict: &mut Verdict) {
    /// Minimum time for which the mission waits for such a robot.
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
                // The operator's patience may end earlier.
                let robot = robot.filter(|_| *at < BEGIN + PATIENCE);
                let Some((robot, since)) = robot.and_then(|robot| Some((robot, lost[robot]?))) else {
                    continue;
                };
                if matches!(failure.kind, FailureKind::LinkDown { .. }) && *at - since < STARTS_WITHIN {
                    let what = format!(
                        "the mission gave up on r{robot} only {} after its first connection failed",
                        *at - since
                    );
                    return verdict.violated('h', what);
                }
            }
            _ => {}
        }
    }
}

/// Checks that an empty script, which cancels, reaches a robot only after the robot was left out or while all robots are being stopped.
fn only_stops_cancel(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (at, happened) in &facts.ran.history {
        let Happened::AtRobot(robot, Message::ControlRequest(request)) = happened else { continue };
        let cancels = matches!(&request.command, Command::Script(script) if script.is_empty());
        let dropped = facts.dropped[*robot].is_some_and(|dropped| dropped <= *at);
        // A stop is sent first and recorded afterwards, in the same instant, unless the process dies between the two.
        let stopped = facts.stopping.iter().any(|stopping| stopping <= at);
        let died = facts.hits.iter().any(|hit| hit.cause == Cause::SchedulerCrash && hit.from <= *at);
        if cancels && !dropped && !stopped && !died {
            return verdict.violated(
                'c',
                format!("r{robot} was sent a cancellation at {at}, but nothing was being stopped"),
            );
        }
    }
}

/// Checks that a robot reports the loss of its link only if it received no message for longer than its lease.
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
        // The script begins at some time in between, and a lease that has already expired ends it at once.
        let planned = from - START_LATE_MAX;
        let last = facts.heard(robot).filter(|heard| *heard <= planned).last().unwrap_or(planned);
        let heard = facts.heard(robot).filter(|heard| *heard > planned && heard <= at);
        let instants: Vec<_> = std::iter::once(last).chain(heard).chain(std::iter::once(*at)).collect();
        let longest = instants.windows(2).map(|two| two[1] - two[0]).max().unwrap_or_default();
        if longest + DRIFT < lease {
            let what = format!(
                "r{robot} reported that it received nothing for longer than its lease of {lease}, but the longest gap was {longest}"
            );
            return verdict.violated('c', what);
        }
    }
}

/// Returns the time since which a robot has been playing, and the shortest of its leases. `None` unless the robot has begun all its
/// scripts: a script that has not begun may have been lost.
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

/// Checks that another robot that answers at the address of the intended one receives no command that moves it.
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
                "act {number} was sent, although its starts may be {predicted} apart and only {tolerance} is allowed"
            );
            verdict.violated('f', what);
        }
    }
}

/// Checks that the first script of each device has reached its robot by the time its act is decided.
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
                let what = format!(
                    "act {number} was decided, but the script of `{device}` had not reached r{robot}"
                );
                return verdict.violated('g', what);
            }
        }
    }
}

/// Checks that no script begins after an edge could have noticed that its hardware is dead, provided that there was time for an inquiry.
fn hands_were_there(facts: &Facts<'_>, verdict: &mut Verdict) {
    /// A script that arrives within this time before its start begins without an inquiry.
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
                    verdict.violated(
                        'g',
                        format!("r{robot} started a script of `{device}`, although its hardware had failed"),
                    );
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
                format!("{bytes} bytes of records were on the disk at {at}, but are no longer readable"),
            );
        }
    }
}

/// Whether the scheduler has to send nothing to the robots of an act until the commitment. This silence begins at the critical instant,
/// because a later inquiry would extend the leases of scripts beyond the start. The critical instant is no earlier than the reported
/// doubt before the start.
///
/// A process that resumes an act assumes the lease with which the act was sent. So it is silent from one lease before the start, and a
/// little earlier to cover clock errors and travel times.
fn is_hushed(facts: &Facts<'_>, act: &SentAct<'_>, at: Timestamp<Server>, by: Timestamp<Server>) -> bool {
    let history = facts.between(act.at, at);
    let taken_up = history.iter().rfind(|(_, what)| matches!(what, Happened::TakenUp(_)));
    let hushed_from = act.promise.start - act.promise.lease - HUSHED_AHEAD;
    match taken_up {
        Some((taken_up, _)) => {
            // A process that resumes the act before that does not send a commitment that was recorded ahead of time.
            let counts = |committed: Timestamp<Server>| {
                committed <= by && (committed >= *taken_up || *taken_up >= hushed_from)
            };
            !act.committed.is_some_and(counts) && by >= hushed_from && at < act.promise.start
        }
        None => act.decided.is_some() && by >= act.doubtful_from() && at < act.promise.start,
    }
}

/// Checks that a robot with scripts, after it has reconnected and described itself, receives further messages at once.
fn those_who_return_hear(facts: &Facts<'_>, verdict: &mut Verdict) {
    let drawn = facts.drawn();
    for (at, happened) in &facts.ran.history {
        let Happened::LinkUp(robot) = happened else { continue };
        let by = *at + drawn.delay.1 * 3 + drawn.robots[*robot].slow + AT_ONCE;
        let mut held = facts.acts.iter().filter(|act| {
            let ends = act.of(*robot).map(|script| act.start_of(script) + script.promised.duration).max();
            act.at < *at && ends.is_some_and(|ends| by < ends)
        });
        // Every message renews all leases of a robot, so one act that requires silence silences the others.
        let holds = held.clone().next().is_some() && !held.any(|act| is_hushed(facts, act, *at, by));
        let over = |until: Timestamp<Server>| until <= by;
        let done = facts.stopping.iter().any(|at| over(*at)) || facts.dropped[*robot].is_some_and(over);
        let links = |hit: &Hit| hit.cause == Cause::LinkDown && hit.from < *at;
        let hit = facts.hits.iter().any(|hit| {
            let counts = hit.is_of(*robot) || hit.robot.is_none();
            // Faults of the robot that end with this link no longer block messages. A process that has just resumed the mission may have
            // to be silent.
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
                format!("r{robot} was reachable again at {at}, but received no message about its scripts"),
            );
        }
    }
}
