//! Checks invariant (h): nothing waits forever. Silence is reported within a bound. A stop reaches every reachable robot and ends within
//! the operator's timeout. After a fault, acts follow each other nearly as soon as without the fault.

use std::iter;

use downbeat_plan::Wait;
use urrcp::{Command, Message, Server, Span, Timestamp};

use super::cause::{Cause, Hit};
use super::facts::{Facts, SentAct, SentScript};
use super::{DRIFT, Verdict};
use crate::world::PATIENCE;
use crate::{Fault, Happened};
use downbeat_mission::{ActNumber, Progress, Record};

/// Maximum time without a message from a robot whose scripts have no running lease.
const SILENCE_MAX: Span = Span::from_millis(3_000);
/// Time within which the scheduler reacts to received events.
const AT_ONCE: Span = Span::from_millis(2);
/// Maximum ratio of a lead or a gap to that in the same mission without faults. The lead extends from sending an act to its start, and
/// the gap from the end of the previous act. In addition, `MORE` is permitted.
const TIMES: i64 = 3;
const MORE: Span = Span::from_millis(500);
/// Additional lead of an act whose start time is known. Such an act is sent up to 2 s earlier, and its lease is up to 2 s longer.
const AHEAD: Span = Span::from_millis(2_000 + 2_000);
/// The minimum lead (time from sending an act to its start): one margin, the minimum pending lease and another margin.
pub(crate) const LEAD_LEAST: Span = Span::from_millis(50 + 240 + 50);
/// The number of round trips in a lead: three for the answers, six for the lease, and one and a half for the margin. They are based on
/// the round trip that the links nearly always achieve. `ROUND_TRIP_MAX` limits that round trip.
const ROUND_TRIPS: i64 = 11;
const ROUND_TRIP_MAX: Span = Span::from_millis(500);
const HELD_UP_LEAST: Span = Span::from_millis(40);
/// Maximum delay of a report, in addition to two round trips. If a report is missing after this time, the scheduler requests it. After
/// the same time again, it stops waiting.
const REPORT_GRACE: Span = Span::from_millis(500);

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    if facts.ran.hung {
        verdict.violated('h', "the mission never ended".to_owned());
    }
    for act in &facts.acts {
        for robot in act.robots() {
            silence(facts, act, robot, verdict);
        }
    }
    stops_end(facts, verdict);
    stops_arrive(facts, verdict);
    operator_is_heard(facts, verdict);
}

/// Returns the first instant, after an act was sent, from which nothing more is expected of a robot. The robot has finished the act or
/// failed, all robots are being stopped, or the mission has ended.
fn settled(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Timestamp<Server> {
    let name = facts.name(robot);
    let words =
        facts.ran.history.iter().filter(|(at, _)| *at >= act.at).find(|(_, happened)| match happened {
            Happened::Told(progress) => match &**progress {
                Progress::Failed(failure) => failure.robot == *name,
                // The times are by the robot's own clock, which may be ahead of the clock of the process that sent the act.
                Progress::Finished { robot, number } => robot == name && *number == act.promise.number,
                Progress::Stopping { .. } => true,
                _ => false,
            },
            _ => false,
        });
    let ends =
        |(at, record): &&(Timestamp<Server>, Record)| *at >= act.at && matches!(record, Record::Ended { .. });
    let ended = facts.ran.records.iter().find(ends).map(|(at, _)| *at);
    let words = words.map(|(at, _)| *at).into_iter().chain(ended);
    words.chain(facts.dropped[robot]).min().unwrap_or(Timestamp::from_nanos(i64::MAX))
}

/// Returns the longest round trip of a robot until an instant, including delays by faults. Messages in transit at that instant do not
/// count. A message that arrives at the end of a partition, for example, took as long as the silence that it ends.
fn round_trip(facts: &Facts<'_>, robot: usize, until: Timestamp<Server>) -> Span {
    usual_round_trip(facts, robot) + slow_until(facts, robot, until)
}

/// The longest round trip of a robot without faults.
fn usual_round_trip(facts: &Facts<'_>, robot: usize) -> Span {
    let drawn = facts.drawn();
    drawn.delay.1 * 2 + drawn.robots[robot].slow + waited(facts, robot) * 2
}

/// The additional delay of a robot's messages by faults until an instant.
fn slow_until(facts: &Facts<'_>, robot: usize, until: Timestamp<Server>) -> Span {
    let slow = facts.hits.iter().filter(|hit| hit.is_of(robot) && hit.cause == Cause::Slow);
    let slow = slow.filter(|hit| hit.until <= until);
    slow.map(|hit| hit.until - hit.from).max().unwrap_or_default()
}

/// Returns the longest time that a message waited in the queue of a robot's link, if the link has a low bandwidth. In a measured round
/// trip, both messages may wait for this long.
fn waited(facts: &Facts<'_>, robot: usize) -> Span {
    let waited = facts.ran.history.iter().filter_map(|(_, happened)| match happened {
        Happened::Queued(r, waited) if *r == robot => Some(*waited),
        _ => None,
    });
    waited.max().unwrap_or_default()
}

/// Checks that the scheduler hears from a playing robot at least once per running lease plus a round trip, or reports its failure.
fn silence(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize, verdict: &mut Verdict) {
    if act.committed.is_none() {
        return;
    }
    let usual = usual_round_trip(facts, robot);
    let bound_at = |at| lease(act, robot, at) + usual + slow_until(facts, robot, at) + AT_ONCE;
    let ends = act.of(robot).map(|script| act.start_of(script) + script.promised.duration).max();
    let (Some(start), Some(end)) = (act.first_start(robot), ends) else { return };
    let heard = facts.between(start, end).iter().filter_map(|(at, happened)| match happened {
        Happened::FromRobot(r, _) if *r == robot => Some(*at),
        _ => None,
    });
    let instants: Vec<_> = iter::once(start).chain(heard).chain(iter::once(end)).collect();
    let settled = settled(facts, act, robot);
    for two in instants.windows(2) {
        let bound = bound_at(two[0]);
        if two[1] - two[0] <= bound {
            continue;
        }
        // A link that is down has a separate timeout, and a scheduler that was not running ignores missed answers.
        let down = |hit: &Hit| hit.is_of(robot) && hit.cause == Cause::LinkDown;
        let otherwise = facts
            .hits
            .iter()
            .any(|hit| (down(hit) || hit.robot.is_none()) && hit.overlaps(two[0] - bound, two[0] + bound));
        if settled > two[0] + bound && !otherwise {
            let silent = two[1] - two[0];
            let what = format!(
                "r{robot} was silent for {silent} while it played, but its failure was not reported within {bound}"
            );
            return verdict.violated('h', what);
        }
    }
}

/// Returns how long a robot may be silent at an instant: the longest running lease of its scripts. If none of its scripts plays, they are
/// lost only when their pending lease has expired as well, so the longer of the two applies.
fn lease(act: &SentAct<'_>, robot: usize, at: Timestamp<Server>) -> Span {
    let running = act.of(robot).map(|script| script.promised.running.map(urrcp::Millis::span));
    let running = running.map(|lease| lease.unwrap_or(SILENCE_MAX)).max().unwrap_or(SILENCE_MAX);
    let plays = |script: &SentScript<'_>| {
        let start = act.start_of(script);
        at >= start && at < start + script.promised.duration
    };
    if act.of(robot).any(plays) { running } else { running.max(act.promise.lease) }
}

/// Whether the scheduler had ended or stalled at any time between two instants.
fn scheduler_was_away(facts: &Facts<'_>, from: Timestamp<Server>, until: Timestamp<Server>) -> bool {
    facts.hits.iter().any(|hit| hit.robot.is_none() && hit.overlaps(from, until))
}

/// Checks that a stop ends, confirmed or not, within the operator's timeout. A later stop that brings robots to rest in a different way
/// has its own deadline. A repetition of the same stop does not extend the deadline.
fn stops_end(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (stopping, record) in &facts.ran.records {
        let Record::Stopping { rest: first, .. } = record else { continue };
        let by = *stopping + PATIENCE + AT_ONCE;
        let goes_on = facts.ran.records.iter().any(|(at, record)| {
            let ends = matches!(record, Record::Ended { .. } | Record::Prepared(_) | Record::ActEnded { .. });
            let otherwise = matches!(record, Record::Stopping { rest, .. } if rest != first);
            (ends || otherwise) && at >= stopping && *at <= by
        });
        let waits = facts.between(*stopping, by).iter().any(|(_, happened)| match happened {
            Happened::Told(progress) => matches!(**progress, Progress::Waiting { .. }),
            _ => false,
        });
        let goes_on = goes_on || waits;
        if !goes_on && !scheduler_was_away(facts, *stopping, by) {
            verdict.violated('h', format!("the stop at {stopping} did not end within {PATIENCE}"));
        }
    }
}

/// Checks that a reachable robot that received scripts receives a stop within the maximum delay of its link.
fn stops_arrive(facts: &Facts<'_>, verdict: &mut Verdict) {
    for stopping in &facts.stopping {
        for robot in 0..facts.drawn().robots.len() {
            let by = *stopping + facts.drawn().delay.1 + queued(facts, robot, *stopping) + AT_ONCE;
            let stopped = facts.between(*stopping, by).iter().any(|(_, happened)| match happened {
                Happened::AtRobot(r, Message::ControlRequest(request)) if *r == robot => {
                    matches!(&request.command, Command::Script(script) if script.is_empty())
                }
                _ => false,
            });
            let out = facts.dropped[robot].is_some_and(|at| at <= *stopping);
            let has = |act: &SentAct<'_>| {
                is_open(facts, act, *stopping)
                    && was_sent(facts, act, robot, *stopping)
                    && !came_to_rest(facts, act, robot, *stopping)
            };
            let sent = facts.acts.iter().any(has);
            let was_hit =
                facts.hits.iter().any(|hit| hit.is_of(robot) && hit.overlaps(*stopping - PATIENCE, by));
            let away = scheduler_was_away(facts, *stopping - PATIENCE, by);
            if sent && !out && !was_hit && !away && facts.honest(robot) && !stopped {
                verdict.violated(
                    'h',
                    format!("r{robot} is reachable but did not receive the stop at {stopping}"),
                );
            }
        }
    }
}

/// Whether a script of an act reached a robot before an instant.
fn was_sent(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize, before: Timestamp<Server>) -> bool {
    facts.between(act.at, before - Span::from_nanos(1)).iter().any(|(_, happened)| match happened {
        Happened::AtRobot(r, Message::ControlRequest(request)) if *r == robot => {
            act.of(robot).any(|script| request.request_id.as_ref() == Some(&script.promised.request_id))
        }
        _ => false,
    })
}

/// Returns how long a stop waited in the queue of a robot's link. It waits only if the link has a low bandwidth even without faults.
fn queued(facts: &Facts<'_>, robot: usize, stopping: Timestamp<Server>) -> Span {
    let of_stops =
        facts.between(stopping, stopping + AT_ONCE).iter().filter_map(|(_, happened)| match happened {
            Happened::StopQueued(r, queued) if *r == robot => Some(*queued),
            _ => None,
        });
    of_stops.max().unwrap_or_default()
}

/// Whether the robot has confirmed an earlier stop, so that no part of an act moves it any longer.
fn came_to_rest(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize, by: Timestamp<Server>) -> bool {
    let name = facts.name(robot);
    facts.between(act.at, by).iter().any(|(_, happened)| match happened {
        Happened::Told(progress) => matches!(&**progress, Progress::AtRest { robot } if robot == name),
        _ => false,
    })
}

/// Whether an act has not ended by an instant, so that its robots may still have scripts of it.
fn is_open(facts: &Facts<'_>, act: &SentAct<'_>, at: Timestamp<Server>) -> bool {
    let ended = facts.ran.records.iter().any(|(when, record)| match record {
        Record::ActEnded { report, .. } => *when < at && report.number == act.promise.number,
        _ => false,
    });
    act.at <= at && !ended
}

/// Checks that a stop by the operator stops all robots at once, unless the mission was already over.
fn operator_is_heard(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (at, happened) in &facts.ran.history {
        if !matches!(happened, Happened::Fault(Fault::Stop | Fault::Home | Fault::StopByJournal)) {
            continue;
        }
        let over = facts.ran.records.iter().any(|(when, record)| {
            matches!(record, Record::Stopping { .. } | Record::Ended { .. }) && *when <= *at + AT_ONCE
        });
        let crashed = |hit: &Hit| hit.cause == Cause::SchedulerCrash && hit.from <= *at;
        let away = facts.hits.iter().any(crashed) || scheduler_was_away(facts, *at, *at + AT_ONCE);
        if !over && !away {
            verdict.violated('h', format!("the operator requested a stop at {at}, but nothing was stopped"));
        }
    }
}

/// Compares leads and gaps with those in the same mission without faults. The lead extends from sending an act to its start, and the gap
/// from the end of the previous act. Compares only acts that the same robots play in both missions.
pub(super) fn compare(facts: &Facts<'_>, undisturbed: &Facts<'_>, verdict: &mut Verdict) {
    for act in facts.acts.iter().filter(|act| !waits_for_a_time_of_day(act)) {
        let same = |other: &&SentAct<'_>| {
            other.promise.number == act.promise.number
                && other.promise.act == act.promise.act
                && other.robots() == act.robots()
        };
        let Some(other) = undisturbed.acts.iter().find(same) else { continue };
        let number = act.promise.number;
        let (with, without) = (lead(act), lead(other));
        // No act is delayed if it is sent while the previous one still plays and starts when that ends, by the clock of the process that
        // sends it.
        let ahead = before(facts, act).is_some_and(|before| {
            let clocks = (act.ahead - before.ahead).abs();
            gap(before, act) <= DRIFT + clocks
        });
        let allowed = without * TIMES + lead_allowed(facts, act);
        if with > allowed && !ahead && Some(with) != asked_for(act) {
            let what = format!(
                "act {number} had a lead of {with}, compared with {without} in the mission without faults"
            );
            verdict.violated('h', what);
        }
        let (before, other_before) = (before(facts, act), before(undisturbed, other));
        let Some((before, other_before)) = before.zip(other_before) else { continue };
        // A robot that joined in only one of the missions leaves its devices free for the next act in the other.
        if before.promise.act != other_before.promise.act || before.robots() != other_before.robots() {
            continue;
        }
        let (gap, other_gap) = (gap(before, act), gap(other_before, other));
        // An act is sent as soon as its devices have room. Its start is delayed by the excess of its lead, which is bounded above. After
        // a stop, the whole lead follows the stop and no longer overlaps the previous act.
        let longer = if was_stopped(facts, before, act) || waited_for_room(facts, before, act) {
            with
        } else {
            (with - without).max(Span::ZERO)
        };
        if gap > other_gap.max(Span::ZERO) * TIMES + longer + gap_allowed(facts, before, act) {
            verdict.violated(
                'h',
                format!("act {number} started after a gap of {gap}, compared with {other_gap} in the mission without faults"),
            );
        }
    }
}

/// Returns the number of the last act whose lead, or the gap before it, may be too long: it exceeds the smallest limit that is possible.
/// For later acts, [`compare`] cannot find a violation.
pub(super) fn last_to_compare(facts: &Facts<'_>) -> Option<ActNumber> {
    let compared = facts.acts.iter().filter(|act| !waits_for_a_time_of_day(act));
    let long = compared.filter(|act| {
        let late = |before: &SentAct<'_>| {
            let waited = was_stopped(facts, before, act) || waited_for_room(facts, before, act);
            let longer = if waited { lead(act) } else { Span::ZERO };
            gap(before, act) > longer + gap_allowed(facts, before, act)
        };
        lead(act) > LEAD_LEAST * TIMES + lead_allowed(facts, act) || before(facts, act).is_some_and(late)
    });
    long.map(|act| act.promise.number).max()
}

/// Returns how much a lead may exceed the permitted multiple of the lead without faults. Includes recent stalls of the disk, which delay
/// the promise and the commitment, earlier delays of links, and changes of clocks. Other faults do not count.
///
/// After a fault, an act that starts at a fixed time may be sent earlier if the previous acts do not play, but not later.
fn lead_allowed(facts: &Facts<'_>, act: &SentAct<'_>) -> Span {
    let slow = (slow_again(facts, act) + held_up(facts, act)).min(ROUND_TRIP_MAX) * ROUND_TRIPS;
    let ahead = if starts_at_its_time(act) { AHEAD } else { Span::ZERO };
    MORE + disk_stood_still(facts, act) * 4 + clocks_set(facts, act, act.at) * 2 + slow + ahead
}

/// Returns the time that the scheduler adds to the longest round trip if its machine was too slow. In that case, acts were withdrawn and
/// prepared again. It is twice the longest delay of the machine, but at least `HELD_UP_LEAST`. Each further withdrawn act at least
/// doubles it.
fn held_up(facts: &Facts<'_>, act: &SentAct<'_>) -> Span {
    let withdrawn = facts.acts.iter().filter(|before| before.repeated && before.at < act.at).count();
    let of_this_machine = |hit: &&Hit| hit.robot.is_none() && hit.from <= act.at;
    let delay = facts.hits.iter().filter(of_this_machine).map(|hit| hit.until - hit.from).max();
    let first = (delay.unwrap_or_default() * 2).max(HELD_UP_LEAST);
    (0..withdrawn).fold(Span::ZERO, |addition, _| first.max(addition * 2))
}

/// Whether an act waits for a time of day. Such an act is not compared: after a delay, it may start on the next day.
const fn waits_for_a_time_of_day(act: &SentAct<'_>) -> bool {
    matches!(act.written.wait, Wait::TimeOfDay(_))
}

/// Whether an act waits for a fixed instant and starts no later than that.
fn starts_at_its_time(act: &SentAct<'_>) -> bool {
    matches!(act.written.wait, Wait::Instant(at) if act.promise.start + act.ahead <= at)
}

/// Returns how much a gap may exceed the permitted multiple of the gap without faults. The excess of the lead is permitted in addition.
/// If a clock was set back, the act is sent later by that amount.
fn gap_allowed(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> Span {
    let lasted = disk_stood_still(facts, act) * 2 + lasted(facts, before, act);
    let lasted = lasted + report_awaited(facts, before, act);
    MORE + lasted + clocks_set(facts, act, act.at) + clocks_set(facts, before, act.at)
}

/// Returns how long an act may wait for a report on the previous act. The report may have been lost, alone or together with its
/// connection.
fn report_awaited(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> Span {
    let lost = |hit: &&Hit| {
        let may_lose = matches!(hit.cause, Cause::Lost | Cause::LinkDown);
        may_lose && hit.from >= before.promise.start && hit.from <= act.at
    };
    let robots = facts.hits.iter().filter(lost).filter_map(|hit| hit.robot);
    // The same applies to reports that a lying robot never sends.
    let liars = (0..facts.drawn().robots.len()).filter(|robot| !facts.honest(*robot));
    let robots = robots.chain(liars).filter(|robot| before.robots().contains(robot));
    robots
        .map(|robot| (REPORT_GRACE + round_trip(facts, robot, Timestamp::from_nanos(i64::MAX)) * 2) * 2)
        .max()
        .unwrap_or_default()
}

/// Whether all robots were stopped between two acts.
fn was_stopped(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> bool {
    facts.stopping.iter().any(|at| *at > before.at && *at <= act.at)
}

/// Whether an act was sent only after the previous act had ended, although the time that it waits for had passed. This happens if a link
/// of one of its robots had been slow. A script that was sent during the previous act might then have arrived too late.
fn waited_for_room(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> bool {
    let has_passed = matches!(act.written.wait, Wait::Instant(at) if at < act.promise.start + act.ahead);
    let slow = |hit: &Hit| {
        let of_act = hit.robot.is_some_and(|robot| act.robots().contains(&robot));
        of_act && hit.cause == Cause::Slow && hit.from <= act.at
    };
    has_passed && gap(before, act) >= lead(act) - DRIFT && facts.hits.iter().any(slow)
}

/// The act that was sent before the act `act`; `None` for the first act.
fn before<'f, 'a>(facts: &'f Facts<'a>, act: &SentAct<'_>) -> Option<&'f SentAct<'a>> {
    facts.acts.iter().rfind(|before| before.promise.number < act.promise.number)
}

/// Returns the total amount by which clocks were set: those of the act's robots until `by`, and that of the process that sent the act. A
/// robot that starts early by its clock affects the lead twice: within the last lease, and after it. A robot that ends late by its clock
/// affects the gap after the act.
fn clocks_set(facts: &Facts<'_>, act: &SentAct<'_>, by: Timestamp<Server>) -> Span {
    let robots = act.robots();
    let of_act = |hit: &&Hit| {
        hit.cause == Cause::ClockSet && hit.from <= by && robots.iter().any(|robot| hit.is_of(*robot))
    };
    let of_robots = facts.hits.iter().filter(of_act).fold(Span::ZERO, |sum, hit| sum + hit.by.abs());
    of_robots + act.ahead.abs()
}

/// Returns the delay by the second slow period of a link of the act's robots, before the act was sent. A single slow period leaves the
/// lead unchanged. After two, the mission considers such delays typical of the link.
fn slow_again(facts: &Facts<'_>, act: &SentAct<'_>) -> Span {
    let of_robot = |robot: usize| {
        let slow = |hit: &&Hit| {
            hit.is_of(robot) && hit.from <= act.at && matches!(hit.cause, Cause::Slow | Cause::RobotPause)
        };
        let slow: Vec<&Hit> = facts.hits.iter().filter(slow).collect();
        let lasts = |hit: &Hit| hit.until - hit.from;
        // An inquiry at the end of a slow period is affected by the rest of overlapping ones.
        let mut rests: Vec<Span> = Vec::new();
        let mut until = Timestamp::from_nanos(0);
        for hit in &slow {
            rests.push((hit.until - hit.from.max(until)).max(Span::ZERO));
            until = until.max(hit.until);
        }
        rests.sort_unstable();
        // On a link with low bandwidth, each message overlaps with the previous one. Two that do not overlap are separate periods.
        let apart = slow.iter().enumerate().flat_map(|(index, first)| {
            let others = slow[index + 1..].iter().filter(move |second| second.from >= first.until);
            others.map(move |second| lasts(first).min(lasts(second)))
        });
        let slow = apart.max().max(rests.into_iter().rev().nth(1));
        // A link with long delays has them in both directions, and a period covers one message.
        let lags = |(_, fault): &(Span, Fault)| matches!(fault, Fault::Lag { robot: of, .. } if *of == robot);
        slow.map(|slow| if facts.drawn().faults.iter().any(lags) { slow * 2 } else { slow })
    };
    act.robots().into_iter().filter_map(of_robot).max().unwrap_or_default()
}

fn lead(act: &SentAct<'_>) -> Span {
    act.promise.start - act.promise.timestamp
}

/// Returns the lead that the scenario specifies, if any. It applies if no previous act still plays.
const fn asked_for(act: &SentAct<'_>) -> Option<Span> {
    act.written.plan.lead
}

/// Total duration of the stalls of the scheduler's disk before an act was sent.
fn disk_stood_still(facts: &Facts<'_>, act: &SentAct<'_>) -> Span {
    let stalls = facts.hits.iter().filter(|hit| hit.cause == Cause::Disk && hit.from <= act.at);
    stalls.map(|hit| hit.until - hit.from).fold(Span::ZERO, |sum, lasts| sum + lasts)
}

/// Time from the planned end of the act `before` to the start of `act`.
fn gap(before: &SentAct<'_>, act: &SentAct<'_>) -> Span {
    // The planned end is used because a robot that was left out leaves a gap of its own.
    act.promise.start - (before.promise.start + before.written.plan.duration())
}

/// Returns the total duration of faults of the scheduler or of robots from the sending of the previous act to the start of `act`. The
/// later act waits until such faults end.
fn lasted(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> Span {
    // Robots of any act so far: an act that has not ended delays later ones.
    let so_far = facts.acts.iter().filter(|other| other.promise.number <= act.promise.number);
    let waited_for = match &act.written.wait {
        Wait::Sensor { robot, .. } => {
            facts.drawn().robots.iter().position(|drawn| drawn.block.id.as_str() == robot)
        }
        _ => None,
    };
    // Includes the robot whose sensor this act waits for, which may not play in any act.
    let robots: Vec<usize> = so_far.flat_map(SentAct::robots).chain(waited_for).collect();
    let (begins, until) = (before.at, act.promise.start);
    let mut from = begins;
    let mut lasted = Span::ZERO;
    let counts = |hit: &&Hit| hit.robot.is_none_or(|robot| robots.contains(&robot));
    for hit in facts.hits.iter().filter(|hit| hit.overlaps(begins, until)).filter(counts) {
        lasted += (hit.until.min(until) - hit.from.max(from)).max(Span::ZERO);
        from = from.max(hit.until.min(until));
    }
    lasted
}
