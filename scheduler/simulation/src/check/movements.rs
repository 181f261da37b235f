//! Checks invariant (m): every movement has a reason. The reason is an unaltered step of a script, coming to rest after such a step, or a
//! stop with `home`, which requests the default state.

use std::collections::{HashMap, HashSet};

use downbeat_plan::OnFailure;
use downbeat_robot::set_log::LogEntry;
use urrcp::{ControlType, Device, DeviceId, Interpolation, Message, Server, Span, Timestamp};

use super::Verdict;
use super::facts::{Facts, SentScript};
use crate::braking::is_of;
use crate::draw::{BEGINS_AT, Hands, shows_within};
use crate::trajectory::{JUMP, JumpAfterStop, Promised, Resting, jumps_after_stops, unexplained};
use crate::{DrawnRobot, Fault, Happened};
use downbeat_mission::Progress;
use downbeat_rehearsal::dry_run::BEGIN;

const fn states_positions(drawn: &DrawnRobot) -> bool {
    drawn.block.inquiry && matches!(drawn.hands, Hands::Own)
}

/// Whether the mission must recognize that a device jumps. This is so if the robot states its positions, or if a sensor shows the
/// position with sufficient accuracy.
fn has_to_be_seen(drawn: &DrawnRobot, jump: &JumpAfterStop<'_>) -> bool {
    if states_positions(drawn) {
        return true;
    }
    let Some(device) = drawn.block.device(jump.entry.device.as_str()) else { return false };
    let limits = device.available_control_types.limits(ControlType::Position);
    let error = limits.and_then(|limits| Some(2.0 * limits.granularity.max(limits.max_error?)));
    let linear = device.interpolation == Interpolation::Linear && drawn.hands == Hands::Own;
    let within = shows_within(device).zip(error).filter(|_| linear).map(|(shows, error)| shows + error);
    within.is_some_and(|within| (jump.entry.value - jump.stop.value).abs() > within)
}

/// Whether a device that has not moved yet would jump to its first value, `first`. `false` if the device does not move linearly, belongs
/// to separate hardware behind an edge, or has no position that the robot states.
pub(super) fn jumps_from_the_beginning(drawn: &DrawnRobot, device: &DeviceId, first: f64) -> bool {
    let is_linear =
        |device: &Device| device.interpolation == Interpolation::Linear && device.default_value.is_some();
    let is_known = states_positions(drawn) && drawn.block.device(device.as_str()).is_some_and(is_linear);
    is_known && (first - BEGINS_AT).abs() > JUMP
}

/// Checks that the first movement of a device, in any act, is not a jump. Checks only robots that state their positions.
fn no_jumps(facts: &Facts<'_>, verdict: &mut Verdict) {
    for robot in (0..facts.drawn().robots.len()).filter(|robot| facts.honest(*robot)) {
        let drawn = &facts.drawn().robots[robot];
        // If a robot is absent at first, its first process starts when it arrives.
        let comes_later = drawn.there_from > Span::ZERO;
        let began_anew = begins(facts, robot).nth(usize::from(comes_later)).map(Timestamp::as_nanos);
        let mut moved = HashSet::new();
        let position = |entry: &&LogEntry| is_of(entry, ControlType::Position);
        for entry in facts.ran.logs[robot].iter().filter(position) {
            if began_anew.is_some_and(|at| at <= entry.true_ns) {
                break;
            }
            let is_first = moved.insert(&entry.device);
            let jumps = is_first && entry.is_set();
            let jumps = jumps && jumps_from_the_beginning(drawn, &entry.device, entry.value);
            if jumps && !was_sent_home(facts, robot, entry) {
                let what = format!("r{robot} jumped from {BEGINS_AT} to its first value: {entry:?}");
                verdict.violated('m', what);
            }
        }
    }
}

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    no_jumps(facts, verdict);
    let scripts: HashMap<&str, Promised<'_>> = facts
        .acts
        .iter()
        .flat_map(|act| &act.scripts)
        .map(|script| {
            let written = script.written.map(|written| &written.script);
            (script.promised.request_id.as_str(), Promised { device: &script.promised.device, written })
        })
        .collect();
    for robot in (0..facts.drawn().robots.len()).filter(|robot| facts.honest(*robot)) {
        let homes = if may_go_home(facts) { homes(facts, robot) } else { Vec::new() };
        for process in processes(facts, robot) {
            let unexplained = unexplained(
                process,
                |id| scripts.get(facts.promised_name(robot, id)).copied(),
                |entry| homes.contains(&(&entry.device, entry.true_ns)),
                |entry| resting(facts, robot, entry),
            );
            let jumps = jumps_after_stops(process).into_iter();
            let jumps = jumps.filter(|jump| has_to_be_seen(&facts.drawn().robots[robot], jump));
            let jumps = jumps.filter(|jump| !begins_at_home(facts, robot, jump));
            let jumps = jumps.map(|jump| format!("jumped from where a stop had left it: {:?}", jump.entry));
            for what in unexplained.into_iter().chain(jumps) {
                verdict.violated('m', format!("r{robot} {what}"));
            }
        }
    }
}

/// Returns the limits and the braking of a device that comes to rest. `None` if the device's hardware has just returned: it may have
/// missed the last values, so its speeds are set to zero again.
fn resting<'a>(facts: &Facts<'a>, robot: usize, entry: &LogEntry) -> Option<Resting<'a>> {
    let is_back = |(at, fault): &(Span, Fault)| match fault {
        Fault::HardwareDies { robot: of, back_after: Some(after), .. } => {
            *of == robot && (BEGIN + *at + *after).as_nanos() == entry.true_ns
        }
        _ => false,
    };
    let drawn = facts.drawn();
    let device = drawn.robots[robot].block.device(entry.device.as_str())?;
    let braking = facts.ran.brakings[robot].iter().find(|braking| braking.is_of(entry));
    (!drawn.faults.iter().any(is_back)).then_some(Resting { device, braking })
}

/// Whether the device was at its default position before it jumped. A stop left it there, and the mission sent all robots home before it
/// promised the act in which the device jumps.
fn begins_at_home(facts: &Facts<'_>, robot: usize, jump: &JumpAfterStop<'_>) -> bool {
    let device = facts.drawn().robots[robot].block.device(jump.stop.device.as_str());
    let is_there = device.is_some_and(|device| {
        let limits = device.available_control_types.limits(ControlType::Position);
        let rests_at = limits.map(|limits| limits.nearest_settable(jump.stop.value));
        let away = rests_at.zip(device.default_value).map(|(rests_at, default)| (rests_at - default).abs());
        away.is_some_and(|away| away <= 0.0)
    });
    is_there && were_sent_home(facts, robot, Timestamp::from_nanos(jump.stop.true_ns), jump.entry)
}

/// Whether an earlier act with a script for the device of `entry` was withdrawn before the device moved, and the mission then sent all
/// robots home.
fn was_sent_home(facts: &Facts<'_>, robot: usize, entry: &LogEntry) -> bool {
    let of_device = |script: &SentScript<'_>| script.promised.device == entry.device;
    let first = facts.acts.iter().find(|act| act.of(robot).any(of_device));
    first.is_some_and(|act| were_sent_home(facts, robot, act.at, entry))
}

/// Whether the mission sent all robots home between `since` and the promise of the act of `entry`, without an approach afterwards. The
/// act then begins as the scenario specifies, just as if the device had moved home. An approach would have moved the device to the first
/// position of the act.
fn were_sent_home(facts: &Facts<'_>, robot: usize, since: Timestamp<Server>, entry: &LogEntry) -> bool {
    let id = entry.request_id.as_deref();
    let is_it = |script: &SentScript<'_>| id == Some(script.promised.request_id.as_str());
    let Some(act) = facts.acts.iter().find(|act| act.of(robot).any(is_it)) else { return false };
    let home = facts.between(since, act.at).iter().rev().find_map(|(_, happened)| match happened {
        Happened::Told(told) => match **told {
            Progress::GoingHome { .. } | Progress::AtHome => Some(true),
            Progress::Approaching { .. } => Some(false),
            _ => None,
        },
        _ => None,
    });
    home == Some(true)
}

/// Divides the log of a robot by process. A new process does not know the movements of the previous one.
fn processes<'a>(facts: &'a Facts<'_>, robot: usize) -> Vec<&'a [LogEntry]> {
    let mut rest = facts.ran.logs[robot].as_slice();
    let mut processes = Vec::new();
    for begun in begins(facts, robot) {
        let (before, after) = rest.split_at(rest.partition_point(|entry| entry.true_ns < begun.as_nanos()));
        processes.push(before);
        rest = after;
    }
    processes.push(rest);
    processes
}

/// Whether robots may be sent to their default state, by a failure policy of the mission or by the operator.
fn may_go_home(facts: &Facts<'_>) -> bool {
    let drawn = facts.drawn();
    let mut acts = drawn.choreography.acts.iter();
    acts.any(|act| act.on_failure.policies().any(|policy| policy == OnFailure::Home))
        || drawn.faults.iter().any(|(_, fault)| matches!(fault, Fault::Home))
}

/// Returns the devices that received a stop with `home`, and the times of these stops in nanoseconds.
fn homes<'a>(facts: &'a Facts<'_>, robot: usize) -> Vec<(&'a DeviceId, i64)> {
    let home = |(at, happened): &'a (Timestamp<Server>, Happened)| match happened {
        Happened::AtRobot(to, Message::ControlRequest(request)) if *to == robot && request.home => {
            Some((&request.device_id, at.as_nanos()))
        }
        _ => None,
    };
    facts.ran.history.iter().filter_map(home).collect()
}

/// The times at which a new process of the robot started.
fn begins<'a>(facts: &'a Facts<'_>, robot: usize) -> impl Iterator<Item = Timestamp<Server>> + 'a {
    let is_of = move |happened: &Happened| matches!(happened, Happened::Back(of) if *of == robot);
    facts.ran.history.iter().filter(move |(_, happened)| is_of(happened)).map(|(at, _)| *at)
}
