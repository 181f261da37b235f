//! Checks invariant (a): an act starts on all of its robots or on none.
//!
//! A robot that deviates from the others needs an excuse: a fault of its own link, process or clock. The fault must begin within the
//! window that was stated when this act was decided. All robots without an excuse must agree.
//!
//! If they do not, only two events excuse the whole act. One is that the scheduler ended or stalled between the commitment and the last
//! start. The other is a stop after the point of no return.

use std::collections::HashMap;

use urrcp::{Message, RequestId, Server, Span, Timestamp};

use super::cause::{Cause, Hit};
use super::facts::{Facts, SentAct, SentScript};
use super::{ActStarts, DRIFT, Starts, Verdict};
use crate::{DrawnRobot, Fault, Happened, Network};
use downbeat_mission::{ActNumber, ClockMode};
use downbeat_rehearsal::dry_run::BEGIN;

/// Maximum delay after which a robot still starts a script.
const START_LATE_MAX: Span = Span::from_millis(50);

/// Maximum time until an edge (a process that controls separate hardware) notices that its hardware has stopped answering.
const HARDWARE_SILENT: Span = Span::from_millis(150);

/// How long the mission waits for a report that was lost, including the remaining duration of the script.
const AWAITED: Span = Span::from_millis(2_500);

/// Assumed start of the first act if it was never sent, for the comparison with a "go" message.
const NEVER_SENT: Span = Span::from_millis(1_500);

/// Whether a robot started an act, and its excuse.
struct Started {
    robot: usize,
    began: bool,
    /// The robot's own fault that explains why it started or did not start.
    excuse: Option<Cause>,
}

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    if facts.acts.is_empty() {
        verdict.acts.extend(never_sent(facts));
    }
    for act in &facts.acts {
        let robots: Vec<usize> =
            act.robots().into_iter().filter(|robot| counts(facts, act, *robot)).collect();
        let started: Vec<Started> = robots.iter().map(|robot| started(facts, act, *robot)).collect();
        let began = started.iter().filter(|robot| robot.began).count();
        let starts = match began {
            0 => Starts::None,
            all if all == started.len() => Starts::All,
            _ => Starts::Mixed,
        };
        let (number, start) = (act.promise.number, act.promise.start);
        never_committed(facts, act, &started, verdict);
        verdict.acts.push(ActStarts { number, start, robots, starts });
        if starts == Starts::Mixed {
            match excuse(facts, act, &started) {
                Some(cause) => verdict.excused('a', cause),
                None => {
                    let missed = started.iter().filter(|robot| !robot.began && robot.excuse.is_none());
                    let missed: Vec<String> = missed.map(|robot| format!("r{}", robot.robot)).collect();
                    let what = format!(
                        "act {number} started on {began} of {} robots, but no fault excuses {}",
                        started.len(),
                        if missed.is_empty() {
                            "the robots that started".to_owned()
                        } else {
                            missed.join(", ")
                        }
                    );
                    verdict.violated('a', what);
                }
            }
        }
    }
}

/// Checks that a robot with `pending_until` starts no act before an inquiry has moved this limit beyond the start. At this limit, the
/// robot drops scripts that have not started. Only the commitment moves the limit. This holds regardless of the robot's link, its clock
/// and the scheduler.
fn never_committed(facts: &Facts<'_>, act: &SentAct<'_>, started: &[Started], verdict: &mut Verdict) {
    let knows = |robot: &&Started| facts.drawn().robots[robot.robot].block.inquiry;
    for robot in
        started.iter().filter(knows).filter(|robot| robot.began && !was_confirmed(facts, act, robot.robot))
    {
        let number = act.promise.number;
        verdict.violated(
            'a',
            format!("r{} started act {number}, although no inquiry had moved its `pending_until` beyond the start", robot.robot),
        );
    }
}

/// Whether an inquiry reached the robot and set `pending_until` of a script of the act beyond the script's start, by the robot's own
/// clock.
fn was_confirmed(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> bool {
    let beyond = |inquiry: &urrcp::Inquiry| {
        let Some((until, named)) = inquiry.pending_until.zip(inquiry.requests.first()) else { return false };
        let of_act = act.of(robot).find(|script| script.promised.request_id == *named);
        of_act.is_some_and(|script| until > (act.start_as_told(script) + script.shift).assume_clock())
    };
    facts.between(act.at, Timestamp::from_nanos(i64::MAX)).iter().any(|(_, happened)| match happened {
        Happened::AtRobot(r, Message::Inquiry(inquiry)) => *r == robot && beyond(inquiry),
        _ => false,
    })
}

/// Returns the starts of the first act of a mission that sent no act: no robot started it.
fn never_sent(facts: &Facts<'_>) -> Option<ActStarts> {
    let plan = &facts.drawn().choreography.acts.first()?.plan;
    let robots = plan.robots.iter().filter_map(|robot| facts.index_of(&robot.robot));
    let robots = robots.filter(|robot| facts.honest(*robot)).collect();
    let start = BEGIN + NEVER_SENT;
    Some(ActStarts { number: ActNumber::new(0), start, robots, starts: Starts::None })
}

/// Whether a robot takes part in the act at its start. A robot that was left out before the act's start does not, unless it moves
/// nevertheless. A robot that was left out later, because it missed its start, does take part. If the act was stopped before the planned
/// start of a robot, that robot does not take part.
fn counts(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> bool {
    let Some(first) = act.first_movement(robot).filter(|_| facts.honest(robot)) else { return false };
    let began = act.of(robot).any(SentScript::began);
    let left_out = facts.dropped[robot].is_some_and(|at| at < act.promise.start);
    let stopped = facts.stopping.iter().any(|at| *at > act.at && *at >= act.promise.start && *at <= first);
    began || !(left_out || stopped)
}

fn started(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Started {
    let began = act.of(robot).any(SentScript::began);
    let excuse = if began { why_it_started(facts, act, robot) } else { why_it_missed(facts, act, robot) };
    Started { robot, began, excuse }
}

fn excuse(facts: &Facts<'_>, act: &SentAct<'_>, started: &[Started]) -> Option<Cause> {
    let left: Vec<bool> =
        started.iter().filter(|robot| robot.excuse.is_none()).map(|robot| robot.began).collect();
    let agree = left.windows(2).all(|two| two[0] == two[1]);
    if agree {
        // Only robots that behaved differently from those without an excuse need an excuse.
        let common = left.first().copied();
        let differs = |robot: &&Started| common.is_none_or(|common| robot.began != common);
        return started.iter().filter(differs).filter_map(|robot| robot.excuse).min();
    }
    why_the_scheduler(facts, act).or_else(|| late_stop(facts, act))
}

/// Returns the latest instant at which a robot can start the act; `None` if the robot has no script in it.
fn latest_start(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Timestamp<Server>> {
    let (_, late) = early_and_late(facts, robot);
    Some(act.first_movement(robot)? + late + START_LATE_MAX)
}

/// Returns the cause with the highest precedence among a robot's faults that satisfy `counts` and begin between two instants.
fn own_fault(
    facts: &Facts<'_>,
    robot: usize,
    from: Timestamp<Server>,
    until: Timestamp<Server>,
    counts: impl Fn(&Hit) -> bool,
) -> Option<Cause> {
    let begins = |hit: &&Hit| hit.is_of(robot) && hit.from >= from && hit.from <= until;
    facts.hits.iter().filter(begins).filter(|hit| counts(hit)).map(|hit| hit.cause).min()
}

/// Returns the robot's own fault that made it miss its start, if any. The fault must begin within the window of the act.
fn why_it_missed(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Cause> {
    let (from, until) = (act.doubtful_from(), latest_start(facts, act, robot)?);
    let hardware =
        own_fault(facts, robot, from - HARDWARE_SILENT, until, |hit| died_without_a_word(facts, hit));
    // The lease of a script with a later start must be renewed until then.
    let with_the_others = act.first_start(robot) == Some(act.promise.start);
    let heard_in_time =
        with_the_others && heard_the_commitment(facts, act, robot) && heard_lately(facts, act, robot);
    let known = known_to_be_gone(facts, act, robot);
    let counts = |hit: &Hit| match hit.cause {
        Cause::RobotCrash => known.is_none_or(|by| hit.from > by),
        cause => !(cause.is_of_link() && heard_in_time),
    };
    let own = own_fault(facts, robot, from, until, counts);
    own.or(hardware).or_else(|| left_out_on_the_way(facts, act, robot))
}

/// Returns the latest instant at which the scheduler can still withdraw the act if the robot's process ends: three round trips before the
/// point of no return. `None` unless the robot's operating system closes its connection and refuses the next one, and neither its link
/// nor the scheduler has another fault.
fn known_to_be_gone(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Timestamp<Server>> {
    let drawn = facts.drawn();
    let usual = drawn.network == Network::Stream && drawn.tail == 0.0;
    let by = act.decided?.no_return - (drawn.delay.1 * 2 + drawn.robots[robot].slow) * 3;
    let told = |happened: &Happened| match happened {
        Happened::Fault(Fault::RobotCrash { robot: r, told, .. }) => *r != robot || *told,
        _ => true,
    };
    let all_told = facts.ran.history.iter().all(|(_, happened)| told(happened));
    let other = |hit: &Hit| {
        let of_both = hit.robot.is_none() || hit.is_of(robot) && hit.cause != Cause::RobotCrash;
        of_both && hit.cause != Cause::LinkDown && hit.overlaps(by, act.promise.start)
    };
    (usual && all_told && !facts.hits.iter().any(other)).then_some(by)
}

/// Returns the excuse of a robot that was left out between the act's start and its own, later start. That start is later as planned, or
/// because the robot's clock is slow. The fault may have begun earlier: for example, a report was lost, and the mission stopped waiting
/// for it.
fn left_out_on_the_way(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Cause> {
    let (_, late) = early_and_late(facts, robot);
    let first = act.first_movement(robot)? + late;
    let dropped = facts.dropped[robot].filter(|at| *at >= act.promise.start && *at < first)?;
    let from = dropped - AWAITED;
    own_fault(facts, robot, from, dropped, |_| true).or_else(|| told_nobody(facts, robot, from, dropped))
}

/// Returns the excuse that the scheduler's process was not running when the robot sent its report. It applies only to robots that send
/// each report once.
fn told_nobody(
    facts: &Facts<'_>,
    robot: usize,
    from: Timestamp<Server>,
    until: Timestamp<Server>,
) -> Option<Cause> {
    let ended = |hit: &&Hit| hit.cause == Cause::SchedulerCrash && hit.overlaps(from, until);
    let found = facts.hits.iter().find(ended).filter(|_| !facts.counts_steps(robot));
    found.map(|hit| hit.cause)
}

/// Whether a fault is that hardware stopped answering without closing its connection to the edge.
fn died_without_a_word(facts: &Facts<'_>, hit: &Hit) -> bool {
    let untold =
        |fault: &Fault| matches!(fault, Fault::HardwareDies { robot, told: false, .. } if hit.is_of(*robot));
    let at_once = facts.between(hit.from, hit.from).iter();
    hit.cause == Cause::Hardware
        && at_once.into_iter().any(|(_, what)| matches!(what, Happened::Fault(fault) if untold(fault)))
}

/// Returns the robot's own fault that explains why it started although the others did not. For example, its clock was set, or a stop did
/// not reach it in time.
fn why_it_started(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Cause> {
    let until = latest_start(facts, act, robot)?;
    let set = own_fault(facts, robot, act.doubtful_from(), until, |hit| hit.cause == Cause::ClockSet)
        .or_else(|| set_unseen(facts, act, robot));
    if facts.drawn().robots[robot].block.inquiry && act.committed.is_none() {
        // The robot respects `pending_until`, and no inquiry has moved that limit. So it drops the script, regardless of its link and the
        // processes.
        return set;
    }
    let set = set
        .or_else(|| came_late(facts, act, robot, until))
        .or_else(|| carried_over(facts, act, robot))
        .or_else(|| outlived_the_first(facts, act, robot))
        .or_else(|| facts.was_stopped_in_part(act, robot).then_some(Cause::SchedulerCrash));
    let dropped = facts.dropped[robot].filter(|at| *at >= act.at);
    let Some(stop) = facts.stopping.iter().copied().filter(|at| *at >= act.at).chain(dropped).min() else {
        return set;
    };
    let missed_the_stop =
        |hit: &&Hit| hit.is_of(robot) && hit.cause != Cause::RobotCrash && hit.overlaps(stop, until);
    set.or_else(|| facts.hits.iter().filter(missed_the_stop).map(|hit| hit.cause).min())
}

/// Returns the excuse for starting an act that was never decided, because a script arrived late. The robot's link carried nothing, or its
/// process stalled. Therefore the script's lease extended beyond the start, or the robot had dropped the preceding script. The scheduler
/// was not running to withdraw the act.
fn came_late(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize, until: Timestamp<Server>) -> Option<Cause> {
    let lasts = |hit: &&Hit| hit.overlaps(act.at, until);
    let away = facts.hits.iter().filter(lasts).any(|hit| hit.robot.is_none());
    let keeps_waiting = |cause: Cause| cause.is_of_link() || cause == Cause::RobotPause;
    let late = |hit: &&Hit| hit.is_of(robot) && keeps_waiting(hit.cause);
    let hits = facts.hits.iter().filter(|_| away && act.decided.is_none());
    hits.filter(lasts).filter(late).map(|hit| hit.cause).min()
}

/// Returns the excuse of a robot that accepts no inquiries, which could limit its lease, in an act that was not committed. A message was
/// sent in time, but the robot's own link or process delayed it. So it renewed the lease beyond the start. The scheduler was not running
/// to withdraw the act.
fn carried_over(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Cause> {
    let first = |script: &SentScript<'_>| {
        let entry = script.log.first()?;
        Some(Timestamp::<Server>::from_nanos(entry.true_ns) - script.starts_after)
    };
    let began = act.of(robot).filter_map(first).min()?;
    let stood_still = |cause: Cause| matches!(cause, Cause::SchedulerCrash | Cause::SchedulerPause);
    let away = |hit: &Hit| stood_still(hit.cause) && hit.overlaps(act.doubtful_from(), began);
    let uncommitted = act.committed.is_none_or(|at| at > began);
    if facts.drawn().robots[robot].block.inquiry || !uncommitted || !facts.hits.iter().any(away) {
        return None;
    }
    // A message that is sent after `latest` extends the lease beyond the start even without a delay, so only messages sent until then
    // count.
    let (early, _) = early_and_late(facts, robot);
    let latest = act.promise.start - early - act.promise.lease;
    let kept = |at: Timestamp<Server>, message: &Message| {
        let Message::AvailabilityRequest(question) = message else { return None };
        let sent = question.timestamp? - facts.ahead_at(at);
        let keeps = |hit: &Hit| match hit.cause {
            Cause::Slow => hit.from == sent,
            cause => cause == Cause::RobotPause,
        };
        let own = |hit: &&Hit| hit.is_of(robot) && hit.overlaps(at, at) && keeps(hit);
        let mut causes = facts.hits.iter().filter(own).map(|hit| hit.cause);
        causes.next().filter(|_| sent <= latest)
    };
    let carries = |(at, happened): &(Timestamp<Server>, Happened)| match happened {
        Happened::AtRobot(_, Message::InitializationRequest(_)) => None,
        Happened::AtRobot(r, message) if *r == robot => Some(kept(*at, message)),
        _ => None,
    };
    let causes: Option<Vec<Cause>> = facts.between(latest, began).iter().filter_map(carries).collect();
    causes?.into_iter().min()
}

/// Returns the excuse for a script that begins without the preceding script of its device, in an act that was not committed. Such a
/// script normally waits under the running lease of the preceding one.
///
/// The robot accepts no inquiries. Its link or process delayed the script until the robot had dropped the preceding script, whose pending
/// lease had ended. The scheduler was not running to withdraw the act.
fn outlived_the_first(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Cause> {
    let begins = |script: &SentScript<'_>| {
        let entry = script.log.first()?;
        Some(Timestamp::<Server>::from_nanos(entry.true_ns) - script.starts_after)
    };
    let first_began = || act.of(robot).any(|script| script.began() && act.before(script).is_none());
    if facts.drawn().robots[robot].block.inquiry || first_began() {
        return None;
    }
    let (began, script) =
        act.of(robot).filter_map(|script| Some((begins(script)?, script))).min_by_key(|it| it.0)?;
    let uncommitted = act.committed.is_none_or(|at| at > began);
    let arrived = |script: &SentScript<'_>| {
        let is_it = |happened: &Happened| match happened {
            Happened::AtRobot(r, Message::ControlRequest(request)) => {
                *r == robot && request.request_id.as_ref() == Some(&script.promised.request_id)
            }
            _ => false,
        };
        facts.between(act.at, began).iter().find(|(_, happened)| is_it(happened)).map(|(at, _)| *at)
    };
    let (first, came) = (arrived(act.before(script)?)?, arrived(script)?);
    let heard: Vec<_> = facts.heard(robot).filter(|at| *at >= first && *at <= came).collect();
    let was_dropped = heard.windows(2).any(|two| two[1] - two[0] + DRIFT > act.promise.lease);
    let stood_still = |cause: Cause| matches!(cause, Cause::SchedulerCrash | Cause::SchedulerPause);
    let away = facts.hits.iter().any(|hit| stood_still(hit.cause) && hit.overlaps(came, began));
    let keeps = |cause: Cause| cause.is_of_link() || cause == Cause::RobotPause;
    let own = |hit: &&Hit| hit.is_of(robot) && keeps(hit.cause) && hit.overlaps(came, came);
    let hits = facts.hits.iter().filter(|_| uncommitted && was_dropped && away);
    hits.filter(own).map(|hit| hit.cause).min()
}

/// Returns the excuse of a robot whose clock was set shortly before it started. No inquiry could reveal the change in time for a stop to
/// arrive before the start.
fn set_unseen(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Cause> {
    let first = act.of(robot).flat_map(|script| script.log.first()).map(|entry| entry.true_ns).min()?;
    let began = Timestamp::<Server>::from_nanos(first);
    let stopped_by = began - facts.drawn().delay.1;
    let unseen = |hit: &Hit| hit.cause == Cause::ClockSet && !facts.was_asked(robot, hit.from, stopped_by);
    own_fault(facts, robot, Timestamp::from_nanos(0), began, unseen)
}

/// The end of a pending lease, the send time of the inquiry that set this end, and the length of the lease. A script waits for its start
/// under its pending lease. An older inquiry that arrives later does not remove the end.
type LeaseEnd = (Timestamp<Server>, Option<Timestamp<Server>>, Span);

/// Whether the message that permits the robot to start arrived well before the end of the robot's lease, and the lease extended beyond
/// the start. Renewals of the lease by later messages count. If so, the robot's link does not excuse a missed start.
fn heard_the_commitment(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> bool {
    let offset = facts.drawn().robots[robot].settings.clock_offset;
    let last = facts.heard(robot).take_while(|at| *at <= act.promise.start).last();
    let mut leases: HashMap<&RequestId, LeaseEnd> = HashMap::new();
    for (at, happened) in facts.between(act.at, act.promise.start) {
        let Happened::AtRobot(r, Message::Inquiry(inquiry)) = happened else { continue };
        let Some(named) = inquiry.requests.first().filter(|_| *r == robot) else { continue };
        let until = inquiry.pending_until.map(|until| (until - offset).assume_clock::<Server>());
        // The lease of a device that begins later may end after the start of the act and before its own start.
        let script = act.of(robot).find(|script| script.promised.request_id == *named);
        let start = script.map_or(act.promise.start, |script| act.start_of(script));
        match until.filter(|until| *until < start) {
            // A lease that has ended is not renewed.
            Some(_) if leases.get(named).is_some_and(|(ends, ..)| at > ends) => {}
            Some(until) => {
                let lease = inquiry.pending_lease.map_or(act.promise.lease, urrcp::Millis::span);
                let ends = until.min(*at + lease) - DRIFT * 2;
                leases.insert(named, (ends, inquiry.timestamp, lease));
            }
            // An inquiry without an instant leaves the leases unchanged.
            None if until.is_none() => {}
            None => {
                // Devices that begin at different instants have separate leases. If one of these leases has ended, the robot has lost its
                // scripts.
                let lifts = |(ends, asked, _): &(_, _, _)| at < ends && inquiry.timestamp >= *asked;
                if leases.contains_key(named) && leases.values().all(lifts) {
                    return last.is_some_and(|last| {
                        leases.values().all(|(.., lease)| last + *lease - DRIFT > act.promise.start)
                    });
                }
            }
        }
    }
    false
}

/// Whether the robot received a message so shortly before the act's start that its running lease extended beyond the latest possible
/// start.
fn heard_lately(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> bool {
    let running = act.of(robot).filter_map(|script| script.promised.running).map(urrcp::Millis::span).min();
    let last = facts.heard(robot).take_while(|at| *at <= act.promise.start).last();
    running.zip(last).is_none_or(|(lease, last)| last + lease > act.promise.start + START_LATE_MAX)
}

/// Returns the excuse that the scheduler ended or stalled after the commitment was recorded and before every robot had started. Once all
/// robots have answered the commitment, their leases extend beyond the start of the act. Robots that start at that instant do not need
/// the scheduler afterwards.
fn why_the_scheduler(facts: &Facts<'_>, act: &SentAct<'_>) -> Option<Cause> {
    let committed = act.committed?;
    let last = act.robots().into_iter().filter_map(|robot| latest_start(facts, act, robot)).max()?;
    let starts_later = |robot: usize| act.first_start(robot) != Some(act.promise.start);
    let answered = act.answered.filter(|_| !act.robots().into_iter().any(starts_later));
    let last = answered.map_or(last, |answered| answered.min(last));
    let own = |hit: &&Hit| hit.robot.is_none() && hit.from >= committed && hit.from <= last;
    facts.hits.iter().filter(own).map(|hit| hit.cause).min()
}

/// Returns the excuse of a stop after the point of no return. Such a stop may reach some robots before their start and others after it.
fn late_stop(facts: &Facts<'_>, act: &SentAct<'_>) -> Option<Cause> {
    let no_return = act.decided?.no_return;
    let last = act.robots().into_iter().filter_map(|robot| latest_start(facts, act, robot)).max()?;
    let late = facts.stopping.iter().any(|at| *at >= no_return && *at <= last);
    late.then_some(Cause::LateStop)
}

/// Returns how much earlier and how much later than planned a robot may start. This is the offset of its clock or, if the offset is
/// measured, half of the possible asymmetry of the network path. Each value includes an allowance for drift.
fn early_and_late(facts: &Facts<'_>, robot: usize) -> (Span, Span) {
    let DrawnRobot { clock, settings, slow, .. } = &facts.drawn().robots[robot];
    let paths = (facts.drawn().delay.1 + *slow) / 2;
    let (early, late) = match clock {
        ClockMode::Measured => (paths, paths),
        ClockMode::Ntp => {
            (settings.clock_offset.max(Span::ZERO), (Span::ZERO - settings.clock_offset).max(Span::ZERO))
        }
    };
    (early + DRIFT, late + DRIFT)
}
