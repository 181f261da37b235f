//! Situations that missions of the simulation have to reach. If no mission reaches a situation, the simulation does not test it.

use std::collections::BTreeSet;
use std::fmt;

use downbeat_plan::Wait;
use downbeat_robot::set_log::{LogEntry, MotionKind};
use urrcp::{Command, ControlType, Message, Robot, Server, Span, Timestamp};

use super::DRIFT;
use super::facts::{Facts, SentAct, SentScript};
use crate::braking::{acceleration, harder_at_limit, is_of};
use crate::draw::{ClockChange, shows_within};
use crate::{Fault, Happened, Names, Ran};
use downbeat_mission::{ClockMode, Failure, FailureKind, Progress};

/// A situation of a device, a robot or an act that the simulation has to reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Situation {
    /// A device slows its speed to zero within its declared acceleration.
    SpeedSlows,
    /// A device sets its speed to zero at once, because it declares no acceleration.
    SpeedStops,
    /// A device slows the change of its position within its declared acceleration.
    PositionSlows,
    /// A device brakes harder than its declared acceleration to stay within its position limit.
    SlowsAtLimit,
    /// A stop reaches a device that is already slowing down.
    StoppedAgain,
    /// A device continues to move at a speed after the end of its script.
    TurnsAfterScript,
    /// The lease of a device expires while the device continues to move after the end of its script.
    LeaseEndsTurning,
    /// An act starts at the time of day that it waits for.
    AtItsTime,
    /// An act waits for a time of day that occurs twice because the clocks are set back, and it starts.
    AtTimeShownTwice,
    /// An act starts at the instant at which the clocks are set forward and skip the time of day that it waits for.
    AtSkippedTime,
    /// An act waits for a time on another day.
    WaitsForAnotherDay,
    /// The clock of a robot drifts by more than the start tolerance while the robot plays.
    DriftsApart,
    /// An act does not start, because a sensor shows that a device that has moved before would jump.
    RefusedBySensor,
    /// A robot whose responses omit request ids plays, because sensors show the positions of its devices.
    ReadWithoutNames,
    /// A stop reaches a process that answers in place of a robot, and the robot moves afterwards.
    MovesBehindTwin,
}

impl Situation {
    /// All situations.
    pub const ALL: [Self; 15] = [
        Self::SpeedSlows,
        Self::SpeedStops,
        Self::PositionSlows,
        Self::SlowsAtLimit,
        Self::StoppedAgain,
        Self::TurnsAfterScript,
        Self::LeaseEndsTurning,
        Self::AtItsTime,
        Self::AtTimeShownTwice,
        Self::AtSkippedTime,
        Self::WaitsForAnotherDay,
        Self::DriftsApart,
        Self::RefusedBySensor,
        Self::ReadWithoutNames,
        Self::MovesBehindTwin,
    ];
}

impl fmt::Display for Situation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::SpeedSlows => "a speed goes to zero within its acceleration limit",
            Self::SpeedStops => "a speed goes to zero at once",
            Self::PositionSlows => "a position move slows down within its acceleration limit",
            Self::SlowsAtLimit => "a position move brakes harder near its position limit",
            Self::StoppedAgain => "a stop reaches a device that is already slowing down",
            Self::TurnsAfterScript => "a device keeps turning after its script",
            Self::AtItsTime => "an act starts at its time of day",
            Self::AtTimeShownTwice => "an act starts at a time of day that occurs twice",
            Self::AtSkippedTime => "an act starts when clocks skip its time of day",
            Self::WaitsForAnotherDay => "an act waits for a time on another day",
            Self::RefusedBySensor => "a sensor shows that a device would jump",
            Self::ReadWithoutNames => "a robot plays although its responses omit request ids",
            Self::MovesBehindTwin => "a robot moves after its twin was stopped",
            Self::DriftsApart => "a clock drifts beyond the tolerance during an act",
            Self::LeaseEndsTurning => "a lease ends while a device turns after its script",
        })
    }
}

/// Returns the situations that a mission reached. Each is listed as often as it occurred.
pub(super) fn reached(facts: &Facts<'_>) -> Vec<Situation> {
    let mut met = Vec::new();
    for robot in 0..facts.drawn().robots.len() {
        brakings(facts.ran, robot, &mut met);
    }
    let scripts = facts.acts.iter().flat_map(|act| &act.scripts);
    scripts.for_each(|script| after_script(facts, script, &mut met));
    if let Some(change) = facts.drawn().clock_change.map(|index| ClockChange::ALL[index]) {
        met.extend(facts.acts.iter().filter_map(|act| at_its_time(change, act)));
        let waits_long = |(at, happened): &&(Timestamp<Server>, Happened)| match happened {
            Happened::Told(told) => matches!(&**told,
                Progress::Waiting { at: Some(target), .. } if *target - *at > Span::from_millis(12 * 3_600_000)),
            _ => false,
        };
        met.extend(facts.ran.history.iter().filter(waits_long).map(|_| Situation::WaitsForAnotherDay));
    }
    let drifts = |act: &&SentAct<'_>| {
        let off = act.robots().into_iter().filter_map(|robot| off_its_plan(facts, act, robot));
        off.into_iter().any(|off| off > act.written.plan.start_tolerance)
    };
    let shown = |failure: &&Failure| {
        let FailureKind::Position { device, .. } = &failure.kind else { return false };
        let drawn = facts.drawn().robots.iter().find(|drawn| drawn.block.id == failure.robot);
        let drawn = drawn.filter(|drawn| !drawn.block.inquiry);
        drawn.and_then(|drawn| drawn.block.device(device.as_str())).and_then(shows_within).is_some()
    };
    let failures = facts.ran.report.iter().flat_map(|report| report.failures.iter());
    met.extend(failures.filter(shown).map(|_| Situation::RefusedBySensor));
    let is_read = |robot: &&usize| {
        let drawn = &facts.drawn().robots[**robot];
        drawn.names == Names::LeftOut
            && drawn.block.devices.iter().any(|device| shows_within(device).is_some())
    };
    let committed = facts.acts.iter().filter(|act| act.committed.is_some());
    let played: BTreeSet<usize> = committed.flat_map(SentAct::robots).collect();
    met.extend(played.iter().filter(is_read).map(|_| Situation::ReadWithoutNames));
    met.extend(twins_stopped(facts).map(|_| Situation::MovesBehindTwin));
    met.extend(facts.acts.iter().filter(drifts).map(|_| Situation::DriftsApart));
    met
}

/// Returns the robots that move after a stop has reached their twins (processes that still answer in their place).
fn twins_stopped<'a>(facts: &'a Facts<'_>) -> impl Iterator<Item = usize> + 'a {
    let robots = (0..facts.drawn().robots.len()).filter(|robot| facts.has_twin(*robot));
    robots.filter(|robot| {
        let mut twin_answers = false;
        let stopped = facts.ran.history.iter().find_map(|(at, happened)| {
            match happened {
                Happened::Fault(Fault::Twin { robot: of, .. }) if of == robot => twin_answers = true,
                Happened::Back(of) if of == robot => twin_answers = false,
                Happened::AtRobot(of, Message::ControlRequest(request)) if of == robot && twin_answers => {
                    let is_stop = matches!(&request.command, Command::Script(script) if script.is_empty());
                    return is_stop.then_some(*at);
                }
                _ => {}
            }
            None
        });
        let moves = |entry: &LogEntry| matches!(entry.motion, MotionKind::Set | MotionKind::Ramp);
        stopped.is_some_and(|at| {
            let mut log = facts.ran.logs[*robot].iter();
            log.any(|entry| moves(entry) && Timestamp::<Server>::from_nanos(entry.true_ns) > at)
        })
    })
}

/// Returns how far the last step of a robot in an act deviated from the plan, in true time. `None` if the robot did not finish the act,
/// lies or follows NTP, or if its clock was set.
pub(super) fn off_its_plan(facts: &Facts<'_>, act: &SentAct<'_>, robot: usize) -> Option<Span> {
    let measured = facts.drawn().robots[robot].clock == ClockMode::Measured;
    if !measured || !facts.honest(robot) || facts.clock_was_set(robot) || !act.is_whole_on(robot) {
        return None;
    }
    let last = act.of(robot).max_by_key(|script| script.promised.start.span())?;
    let entry = last.steps().last()?;
    let step = last.written?.script.steps().get(entry.step? as usize)?;
    let planned = act.start_of(last) + step.offset.span();
    let late = entry.set_at - entry.due;
    Some((Timestamp::<Server>::from_nanos(entry.true_ns) - late - planned).abs())
}

/// Returns which situation the start of an act is, if the act waits for a time of day; `None` for other acts.
fn at_its_time(change: ClockChange, act: &SentAct<'_>) -> Option<Situation> {
    let Wait::TimeOfDay(time) = act.written.wait else { return None };
    let start = act.promise.start + act.ahead;
    if start == change.at() && change.time_of_day(start) != time {
        return Some(Situation::AtSkippedTime);
    }
    let other = [start + change.forward(), start - change.forward()];
    let twice = other.into_iter().any(|other| change.time_of_day(other) == time);
    let shows = change.time_of_day(start) == time;
    shows.then_some(if twice { Situation::AtTimeShownTwice } else { Situation::AtItsTime })
}

fn brakings(ran: &Ran, robot: usize, met: &mut Vec<Situation>) {
    let block = &ran.drawn.robots[robot].block;
    for braking in &ran.brakings[robot] {
        let Some(device) = block.device(braking.device.as_str()) else { continue };
        let rate = braking.rate(braking.since).map_or(0.0, |(rate, _)| rate);
        let limit = harder_at_limit(device, braking.values.first().copied().unwrap_or_default(), rate);
        met.push(match braking.control_type {
            ControlType::Position if acceleration(device).is_some_and(|declared| limit > declared) => {
                Situation::SlowsAtLimit
            }
            ControlType::Position => Situation::PositionSlows,
            _ => Situation::SpeedSlows,
        });
        let slows = |at: Timestamp<Robot>| braking.since < at && at < braking.since + braking.lasts;
        let again = ran.logs[robot].iter().any(|entry| {
            let is_stop = matches!(entry.motion, MotionKind::Slow | MotionKind::Rest);
            is_stop && entry.device == braking.device && slows(entry.due)
        });
        met.extend(again.then_some(Situation::StoppedAgain));
    }
}

/// Adds the situations of a device whose script has set a nonzero speed.
fn after_script(facts: &Facts<'_>, script: &SentScript<'_>, met: &mut Vec<Situation>) {
    let is_speed = |entry: &&LogEntry| is_of(entry, ControlType::Speed);
    let last = script.steps().filter(is_speed).last();
    let Some(last) = last.filter(|last| last.value != 0.0) else { return };
    let later = facts.ran.logs[script.robot].iter().filter(|entry| entry.true_ns > last.true_ns);
    let next = later.filter(is_speed).find(|entry| entry.device == last.device);
    let stopped = next.filter(|next| next.motion == MotionKind::Rest);
    met.extend(stopped.map(|_| Situation::SpeedStops));
    if script.steps_set() < script.steps_written() {
        return;
    }
    met.push(Situation::TurnsAfterScript);
    let Some((next, lease)) = next.zip(script.promised.running) else { return };
    let at = Timestamp::<Server>::from_nanos(next.true_ns);
    let heard = facts.heard(script.robot).filter(|heard| *heard < at).last();
    let ended = heard.is_some_and(|heard| (at - heard - lease.span()).abs() < DRIFT);
    met.extend((ended && next.request_id.is_none()).then_some(Situation::LeaseEndsTurning));
}
