//! (m) Every movement has one reason: an unaltered step of a script, coming to rest from such a step, or a stop with `home`.

use std::collections::{HashMap, HashSet};

use downbeat_robot::set_log::LogEntry;
use downbeat_scripts::{Choreography, DeviceScript, FirstUse, OnFailure};
use urrcp::{ControlType, DeviceId, Interpolation, Message, Server, Span, Timestamp};

use super::Verdict;
use super::facts::{Facts, SentScript};
use crate::mission::Progress;
use crate::simulation::draw::{BEGINS_AT, Hands};
use crate::simulation::trajectory::{JUMP, JumpAfterStop, Promised, jumps_after_stops, unexplained};
use crate::simulation::{DrawnRobot, Fault, Happened};

const fn states_positions(drawn: &DrawnRobot) -> bool {
    drawn.block.inquiry && matches!(drawn.hands, Hands::Own)
}

/// The devices that would have to jump to their first value if their robot has not moved before: the first value in `act` or, if
/// that is `None`, in the mission. Includes only devices that move linearly, are not behind an edge, and have a position that the robot
/// states.
pub(super) fn jumps_of(facts: &Facts<'_>, robot: usize, act: Option<usize>) -> HashSet<DeviceId> {
    let (choreography, drawn) = (&facts.drawn().choreography, &facts.drawn().robots[robot]);
    let firsts: Vec<_> = match act {
        Some(act) => {
            let alone = Choreography::of_plan(choreography.acts[act].plan.clone());
            let firsts = alone.first_uses(0).into_iter();
            firsts.map(|first| FirstUse { act, ..first }).collect()
        }
        None => choreography.first_uses(0),
    };
    let scripts = firsts.into_iter().filter_map(|first| {
        let planned = &choreography.acts[first.act].plan.robots[first.robot];
        (planned.robot == drawn.block.id).then(|| &planned.scripts[first.script])
    });
    let jumps = |script: &&DeviceScript| {
        let device = drawn.block.device(script.device.as_str());
        let linear = device.is_some_and(|device| {
            device.interpolation == Interpolation::Linear && device.default_value.is_some()
        });
        let at_once = script.script.steps().first().filter(|step| step.offset.span() == Span::ZERO);
        linear && at_once.is_some_and(|step| (step.setpoint.value - BEGINS_AT).abs() > JUMP)
    };
    let jumping = scripts.filter(|_| states_positions(drawn)).filter(jumps);
    jumping.map(|script| script.device.clone()).collect()
}

/// Index, in the choreography, of the first act in which a robot moved.
fn first_act_of(facts: &Facts<'_>, robot: usize) -> Option<usize> {
    let moved = |script: &SentScript<'_>| script.robot == robot && !script.log.is_empty();
    facts.acts.iter().find(|act| act.scripts.iter().any(moved)).map(|act| act.promise.act)
}

/// Checks that no robot that states its positions jumps at the start of a mission or when it joins one.
fn no_jumps(facts: &Facts<'_>, verdict: &mut Verdict) {
    for robot in (0..facts.drawn().robots.len()).filter(|robot| facts.honest(*robot)) {
        let act = first_act_of(facts, robot).filter(|_| facts.drawn().joins(robot));
        // The way home and the approach are planned from where the robot is.
        if act.is_some_and(|act| act >= facts.drawn().choreography.acts.len()) {
            continue;
        }
        let jumping = jumps_of(facts, robot, act);
        // If a robot is absent at first, its first process starts when it arrives.
        let comes_later = facts.drawn().robots[robot].there_from > Span::ZERO;
        let began_anew = begins(facts, robot).nth(usize::from(comes_later)).map(Timestamp::as_nanos);
        let mut moved = HashSet::new();
        for entry in &facts.ran.logs[robot] {
            if began_anew.is_some_and(|at| at <= entry.true_ns) {
                break;
            }
            let is_first = moved.insert(&entry.device);
            if is_first && jumping.contains(&entry.device) && entry.is_set() {
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
            );
            let states = states_positions(&facts.drawn().robots[robot]);
            let jumps = jumps_after_stops(process).into_iter();
            let jumps = jumps.filter(|jump| states && !begins_at_home(facts, robot, jump));
            let jumps = jumps.map(|jump| format!("jumped from where a stop had left it: {:?}", jump.entry));
            for what in unexplained.into_iter().chain(jumps) {
                verdict.violated('m', format!("r{robot} {what}"));
            }
        }
    }
}

/// Whether the way home had nothing to move here: a stop left the device at its default position, and before the act in which the
/// device jumps was promised, the mission sent all robots home. The act begins as the scenario says, as it does after a way home that
/// moves the device. An approach would have moved it to the first position of the act.
fn begins_at_home(facts: &Facts<'_>, robot: usize, jump: &JumpAfterStop<'_>) -> bool {
    let device = facts.drawn().robots[robot].block.device(jump.stop.device.as_str());
    let is_there = device.is_some_and(|device| {
        let limits = device.available_control_types.limits(ControlType::Position);
        let rests_at = limits.map(|limits| limits.nearest_settable(jump.stop.value));
        let away = rests_at.zip(device.default_value).map(|(rests_at, default)| (rests_at - default).abs());
        away.is_some_and(|away| away <= 0.0)
    });
    let id = jump.entry.request_id.as_deref();
    let is_it = |script: &SentScript<'_>| id == Some(script.promised.request_id.as_str());
    let mut acts = facts.acts.iter().filter(|_| is_there);
    let Some(act) = acts.find(|act| act.of(robot).any(is_it)) else { return false };
    let since = facts.between(Timestamp::from_nanos(jump.stop.true_ns), act.at).iter();
    let home = since.rev().find_map(|(_, happened)| match happened {
        Happened::Told(told) => match **told {
            Progress::GoingHome { .. } | Progress::AtHome => Some(true),
            Progress::Approaching { .. } => Some(false),
            _ => None,
        },
        _ => None,
    });
    home == Some(true)
}

/// The log of a robot, divided among its processes. A new process does not know the movements of the previous one.
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

/// Whether a policy of this mission, or its operator, sends robots to their default state.
fn may_go_home(facts: &Facts<'_>) -> bool {
    let drawn = facts.drawn();
    let mut acts = drawn.choreography.acts.iter();
    acts.any(|act| act.on_failure.policies().any(|policy| policy == OnFailure::Home))
        || drawn.faults.iter().any(|(_, fault)| matches!(fault, Fault::Home))
}

/// The devices that received a stop with `home`, and the times of these stops.
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
