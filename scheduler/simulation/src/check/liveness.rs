//! (h) Nothing waits forever: silence is reported within its bound, a stop reaches every robot that can be reached, it ends
//! within the operator's patience, and after a fault acts follow each other nearly as soon as without it.

use std::iter;

use downbeat_plan::Wait;
use urrcp::{Command, Message, Server, Span, Timestamp};

use super::cause::{Cause, Hit};
use super::facts::{Facts, SentAct, SentScript};
use super::{DRIFT, Verdict};
use crate::world::PATIENCE;
use crate::{Fault, Happened};
use downbeat_mission::{Progress, Record};

/// A robot without a running lease may owe an answer for this long.
const SILENCE_MAX: Span = Span::from_millis(3_000);
/// What the scheduler takes to act on what it has.
const AT_ONCE: Span = Span::from_millis(2);
/// A lead or a gap may be so many times that of the same mission without faults, and `MORE` beyond it.
const TIMES: i64 = 3;
const MORE: Span = Span::from_millis(500);
/// Where it is known when an act is to start, it is sent up to 2 s ahead, and with a lease that is longer by up to 2 s.
const AHEAD: Span = Span::from_millis(2_000 + 2_000);
/// No lead is shorter: one margin, the least pending lease and another margin.
pub(crate) const LEAD_LEAST: Span = Span::from_millis(50 + 240 + 50);
/// So many of the round trips that its links keep to nearly always are in a lead, of which the longest counts as this one: three
/// for the answers, six for the lease, and one and a half for the margin.
const ROUND_TRIPS: i64 = 11;
const ROUND_TRIP_MAX: Span = Span::from_millis(500);
const HELD_UP_LEAST: Span = Span::from_millis(40);
/// How long after its instant a report may arrive, in addition to two round trips: it is asked for then, and given up after as
/// long again.
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

/// The instant after the sending of an act at which nothing more is expected of a robot: it has finished the act or failed, or everything
/// is being stopped or has ended.
fn settled(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Timestamp<Server> {
    let name = facts.name(robot);
    let words =
        facts.ran.history.iter().filter(|(at, _)| *at >= act.at).find(|(_, happened)| match happened {
            Happened::Told(progress) => match &**progress {
                Progress::Failed(failure) => failure.robot == *name,
                // By its own clock, which may be ahead of the clock of the process that sent the act.
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

/// The longest that a round trip of a robot took until an instant, or takes without faults. What is under way then tells nothing
/// yet: a message that comes out of a partition at its end took as long as the silence that it ends.
fn round_trip(facts: &Facts<'_>, robot: usize, until: Timestamp<Server>) -> Span {
    usual_round_trip(facts, robot) + slow_until(facts, robot, until)
}

/// The longest that it takes without faults.
fn usual_round_trip(facts: &Facts<'_>, robot: usize) -> Span {
    let drawn = facts.drawn();
    drawn.delay.1 * 2 + drawn.robots[robot].slow + waited(facts, robot) * 2
}

/// What a fault added to it until an instant.
fn slow_until(facts: &Facts<'_>, robot: usize, until: Timestamp<Server>) -> Span {
    let slow = facts.hits.iter().filter(|hit| hit.is_of(robot) && hit.cause == Cause::Slow);
    let slow = slow.filter(|hit| hit.until <= until);
    slow.map(|hit| hit.until - hit.from).max().unwrap_or_default()
}

/// The longest that a message waited behind others on a link that carries little: a round trip as measured waits there and back.
fn waited(facts: &Facts<'_>, robot: usize) -> Span {
    let waited = facts.ran.history.iter().filter_map(|(_, happened)| match happened {
        Happened::Queued(r, waited) if *r == robot => Some(*waited),
        _ => None,
    });
    waited.max().unwrap_or_default()
}

/// While a robot plays, the scheduler hears of it at least once within its running lease and a round trip, or says that it has
/// failed.
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
        // A link that is down is given up in its own time, and a scheduler that was away forgives what it missed.
        let down = |hit: &Hit| hit.is_of(robot) && hit.cause == Cause::LinkDown;
        let otherwise = facts
            .hits
            .iter()
            .any(|hit| (down(hit) || hit.robot.is_none()) && hit.overlaps(two[0] - bound, two[0] + bound));
        if settled > two[0] + bound && !otherwise {
            let silent = two[1] - two[0];
            let what = format!(
                "r{robot} was silent for {silent} while it played, and {bound} after that nobody was told"
            );
            return verdict.violated('h', what);
        }
    }
}

/// The longest running lease of a robot's scripts. Where none of them plays, what waits is lost only when its pending lease has run
/// out as well.
fn lease(act: &SentAct<'_>, robot: usize, at: Timestamp<Server>) -> Span {
    let running = act.of(robot).map(|script| script.promised.running.map(urrcp::Millis::span));
    let running = running.map(|lease| lease.unwrap_or(SILENCE_MAX)).max().unwrap_or(SILENCE_MAX);
    let plays = |script: &SentScript<'_>| {
        let start = act.start_of(script);
        at >= start && at < start + script.promised.duration
    };
    if act.of(robot).any(plays) { running } else { running.max(act.promise.lease) }
}

/// The scheduler's own end or standstill between two instants.
fn scheduler_was_away(facts: &Facts<'_>, from: Timestamp<Server>, until: Timestamp<Server>) -> bool {
    facts.hits.iter().any(|hit| hit.robot.is_none() && hit.overlaps(from, until))
}

/// A stop ends, confirmed or not, when the operator's patience does. A later stop that brings robots to rest in another way
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

/// A robot that was sent something and can be reached hears of a stop within the longest delay of its link.
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
                    format!("r{robot} can be reached, and did not hear of the stop at {stopping}"),
                );
            }
        }
    }
}

/// A script of an act has reached a robot before an instant.
fn was_sent(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize, before: Timestamp<Server>) -> bool {
    facts.between(act.at, before - Span::from_nanos(1)).iter().any(|(_, happened)| match happened {
        Happened::AtRobot(r, Message::ControlRequest(request)) if *r == robot => {
            act.of(robot).any(|script| request.request_id.as_ref() == Some(&script.promised.request_id))
        }
        _ => false,
    })
}

/// How long a stop waited behind other messages for a link that carries little even without faults.
fn queued(facts: &Facts<'_>, robot: usize, stopping: Timestamp<Server>) -> Span {
    let of_stops =
        facts.between(stopping, stopping + AT_ONCE).iter().filter_map(|(_, happened)| match happened {
            Happened::StopQueued(r, queued) if *r == robot => Some(*queued),
            _ => None,
        });
    of_stops.max().unwrap_or_default()
}

/// An earlier stop has confirmed that nothing of an act moves a robot any more.
fn came_to_rest(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize, by: Timestamp<Server>) -> bool {
    let name = facts.name(robot);
    facts.between(act.at, by).iter().any(|(_, happened)| match happened {
        Happened::Told(progress) => matches!(&**progress, Progress::AtRest { robot } if robot == name),
        _ => false,
    })
}

/// An act that has not ended by then: its robots may still have something of it.
fn is_open(facts: &Facts<'_>, act: &SentAct<'_>, at: Timestamp<Server>) -> bool {
    let ended = facts.ran.records.iter().any(|(when, record)| match record {
        Record::ActEnded { report, .. } => *when < at && report.number == act.promise.number,
        _ => false,
    });
    act.at <= at && !ended
}

/// When the operator says stop, everything is stopped at once, or nothing was under way any more.
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
            verdict.violated('h', format!("the operator said stop at {at}, and nothing was stopped"));
        }
    }
}

/// Leads and gaps of acts that the same robots play in both missions.
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
        // Nothing waits for an act that is sent while the previous one still plays and that starts when it ends, by the clock of
        // the process that sends it.
        let ahead = before(facts, act).is_some_and(|before| {
            let clocks = (act.ahead - before.ahead).abs();
            gap(before, act) <= DRIFT + clocks
        });
        let allowed = without * TIMES + lead_allowed(facts, act);
        if with > allowed && !ahead && Some(with) != asked_for(act) {
            let what = format!("act {number} had a lead of {with}, without faults it has {without}");
            verdict.violated('h', what);
        }
        let (before, other_before) = (before(facts, act), before(undisturbed, other));
        let Some((before, other_before)) = before.zip(other_before) else { continue };
        // A robot that has come only in one of them leaves its devices free for the next act in the other.
        if before.promise.act != other_before.promise.act || before.robots() != other_before.robots() {
            continue;
        }
        let (gap, other_gap) = (gap(before, act), gap(other_before, other));
        // An act is sent as soon as its devices have room. What its lead is longer by, which is bounded above, it starts later.
        // After a stop the whole lead comes after it and no longer overlaps the act before.
        let longer = if was_stopped(facts, before, act) || waited_for_room(facts, before, act) {
            with
        } else {
            (with - without).max(Span::ZERO)
        };
        if gap > other_gap.max(Span::ZERO) * TIMES + longer + gap_allowed(facts, before, act) {
            verdict.violated(
                'h',
                format!("act {number} came after a gap of {gap}, without faults after {other_gap}"),
            );
        }
    }
}

/// The number of the last act whose lead, or the gap before it, is longer than what is allowed whatever the mission without faults
/// does: of later ones [`compare`] cannot find anything.
pub(super) fn last_to_compare(facts: &Facts<'_>) -> Option<u32> {
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

/// How much a lead may exceed its share of a lead without faults. It contains twice the time that the disk took recently, for the
/// promise and for the commitment, and the delays of links as slow as they were. No other fault is in it. Nobody waits for an act
/// that starts at its own time: after a fault it is sent sooner than without, if those before it do not play, and no later.
fn lead_allowed(facts: &Facts<'_>, act: &SentAct<'_>) -> Span {
    let slow = (slow_again(facts, act) + held_up(facts, act)).min(ROUND_TRIP_MAX) * ROUND_TRIPS;
    let ahead = if starts_at_its_time(act) { AHEAD } else { Span::ZERO };
    MORE + disk_stood_still(facts, act) * 4 + clocks_set(facts, act, act.at) * 2 + slow + ahead
}

/// The addition to the longest round trip after acts were withdrawn because this machine was too slow, and prepared again: twice the
/// delay, at least `HELD_UP_LEAST`, and at least twice the previous addition.
fn held_up(facts: &Facts<'_>, act: &SentAct<'_>) -> Span {
    let withdrawn = facts.acts.iter().filter(|before| before.repeated && before.at < act.at).count();
    let of_this_machine = |hit: &&Hit| hit.robot.is_none() && hit.from <= act.at;
    let delay = facts.hits.iter().filter(of_this_machine).map(|hit| hit.until - hit.from).max();
    let first = (delay.unwrap_or_default() * 2).max(HELD_UP_LEAST);
    (0..withdrawn).fold(Span::ZERO, |addition, _| first.max(addition * 2))
}

/// Its start is judged by that time alone: after a delay, it may be that of the next day.
const fn waits_for_a_time_of_day(act: &SentAct<'_>) -> bool {
    matches!(act.written.wait, Wait::TimeOfDay(_))
}

/// It waits for an instant, and is not late for it.
fn starts_at_its_time(act: &SentAct<'_>) -> bool {
    matches!(act.written.wait, Wait::Instant(at) if act.promise.start + act.ahead <= at)
}

/// How much a gap may exceed its share of a gap without faults and the excess of the lead: an act is sent later by the amount by
/// which a clock was set back.
fn gap_allowed(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> Span {
    let lasted = disk_stood_still(facts, act) * 2 + lasted(facts, before, act);
    let lasted = lasted + report_awaited(facts, before, act);
    MORE + lasted + clocks_set(facts, act, act.at) + clocks_set(facts, before, act.at)
}

/// An act waits this long for a report of the one before it that may be lost, alone or with its connection.
fn report_awaited(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> Span {
    let lost = |hit: &&Hit| {
        let may_lose = matches!(hit.cause, Cause::Lost | Cause::LinkDown);
        may_lose && hit.from >= before.promise.start && hit.from <= act.at
    };
    let robots = facts.hits.iter().filter(lost).filter_map(|hit| hit.robot);
    // So is what a robot that lies never reports.
    let liars = (0..facts.drawn().robots.len()).filter(|robot| !facts.honest(*robot));
    let robots = robots.chain(liars).filter(|robot| before.robots().contains(robot));
    robots
        .map(|robot| (REPORT_GRACE + round_trip(facts, robot, Timestamp::from_nanos(i64::MAX)) * 2) * 2)
        .max()
        .unwrap_or_default()
}

/// Everything was being stopped between two acts.
fn was_stopped(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> bool {
    facts.stopping.iter().any(|at| *at > before.at && *at <= act.at)
}

/// An act whose time had passed was sent only once the preceding act had ended, because a link of one of its robots had been slow: a
/// script that follows the preceding act on its device might have arrived late.
fn waited_for_room(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> bool {
    let has_passed = matches!(act.written.wait, Wait::Instant(at) if at < act.promise.start + act.ahead);
    let slow = |hit: &Hit| {
        let of_act = hit.robot.is_some_and(|robot| act.robots().contains(&robot));
        of_act && hit.cause == Cause::Slow && hit.from <= act.at
    };
    has_passed && gap(before, act) >= lead(act) - DRIFT && facts.hits.iter().any(slow)
}

/// The act that was sent before another.
fn before<'f, 'a>(facts: &'f Facts<'a>, act: &SentAct<'_>) -> Option<&'f SentAct<'a>> {
    facts.acts.iter().rfind(|before| before.promise.number < act.promise.number)
}

/// By how much the clocks of an act's robots by then, and of the process that sent it, were set. How early a robot may start by
/// its clock is in the lead twice: within the last lease, and after it. How late it ends by its clock is in the gap after it.
fn clocks_set(facts: &Facts<'_>, act: &SentAct<'_>, by: Timestamp<Server>) -> Span {
    let robots = act.robots();
    let of_act = |hit: &&Hit| {
        hit.cause == Cause::ClockSet && hit.from <= by && robots.iter().any(|robot| hit.is_of(*robot))
    };
    let of_robots = facts.hits.iter().filter(of_act).fold(Span::ZERO, |sum, hit| sum + hit.by.abs());
    of_robots + act.ahead.abs()
}

/// How long a link of an act's robots was slow the second time, if it was slow at two moments before the act was sent: one alone
/// leaves the lead as it is, two are what its link is like.
fn slow_again(facts: &Facts<'_>, act: &SentAct<'_>) -> Span {
    let of_robot = |robot: usize| {
        let slow = |hit: &&Hit| {
            hit.is_of(robot) && hit.from <= act.at && matches!(hit.cause, Cause::Slow | Cause::RobotPause)
        };
        let slow: Vec<&Hit> = facts.hits.iter().filter(slow).collect();
        let lasts = |hit: &Hit| hit.until - hit.from;
        // A question that is asked at the end of a moment meets the rest of what overlaps with it.
        let mut rests: Vec<Span> = Vec::new();
        let mut until = Timestamp::from_nanos(0);
        for hit in &slow {
            rests.push((hit.until - hit.from.max(until)).max(Span::ZERO));
            until = until.max(hit.until);
        }
        rests.sort_unstable();
        // On a link that carries little, each message overlaps with the one before. Two that do not overlap are two moments.
        let apart = slow.iter().enumerate().flat_map(|(index, first)| {
            let others = slow[index + 1..].iter().filter(move |second| second.from >= first.until);
            others.map(move |second| lasts(first).min(lasts(second)))
        });
        let slow = apart.max().max(rests.into_iter().rev().nth(1));
        // A link with long delays has them both ways, and a moment is the way of one message.
        let lags = |(_, fault): &(Span, Fault)| matches!(fault, Fault::Lag { robot: of, .. } if *of == robot);
        slow.map(|slow| if facts.drawn().faults.iter().any(lags) { slow * 2 } else { slow })
    };
    act.robots().into_iter().filter_map(of_robot).max().unwrap_or_default()
}

fn lead(act: &SentAct<'_>) -> Span {
    act.promise.start - act.promise.timestamp
}

/// The lead that the scenario asks for: it is kept where no act before it still plays.
const fn asked_for(act: &SentAct<'_>) -> Option<Span> {
    act.written.plan.lead
}

/// For how long the disk stood still before an act was sent.
fn disk_stood_still(facts: &Facts<'_>, act: &SentAct<'_>) -> Span {
    let stalls = facts.hits.iter().filter(|hit| hit.cause == Cause::Disk && hit.from <= act.at);
    stalls.map(|hit| hit.until - hit.from).fold(Span::ZERO, |sum, lasts| sum + lasts)
}

/// From the planned end of the act before to the start of this one.
fn gap(before: &SentAct<'_>, act: &SentAct<'_>) -> Span {
    // As written: what a robot would have played that was left out leaves a gap of its own.
    act.promise.start - (before.promise.start + before.written.plan.duration())
}

/// For how long something was wrong with the scheduler or a robot since the act before was sent: the later one waits for that.
fn lasted(facts: &Facts<'_>, before: &SentAct<'_>, act: &SentAct<'_>) -> Span {
    // Robots of any act so far: an act that has not ended delays later ones.
    let so_far = facts.acts.iter().filter(|other| other.promise.number <= act.promise.number);
    let waited_for = match &act.written.wait {
        Wait::Sensor { robot, .. } => {
            facts.drawn().robots.iter().position(|drawn| drawn.block.id.as_str() == robot)
        }
        _ => None,
    };
    // And the one whose sensor this one waits for, which may play in none.
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
