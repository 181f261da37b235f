//! Compensates actuation latency: each device is commanded earlier by its latency, so that motions begin at their written times. If a
//! script would then begin before its act, the act's motions are delayed by its `lead_in`.
//!
//! Before compensation, a script's start is the start of its motion; afterwards, it is the command time. [`Act::moves_at`] converts back.

use std::collections::{BTreeMap, HashMap};

use downbeat_fleet::fleet::Fleet;
use urrcp::{Millis, Span};

use crate::choreography::{Act, DeviceScript, Way};

/// Compensates the device latencies of the fleet file in acts that are not compensated yet.
pub fn compensate(acts: &mut [Act], fleet: &Fleet) {
    if fleet.robots.iter().all(|robot| robot.mission.latencies.is_empty()) {
        return;
    }
    let robots: HashMap<_, _> = fleet.robots.iter().map(|robot| (&robot.id, robot)).collect();
    for act in &mut *acts {
        for planned in &act.plan.robots {
            let Some(robot) = robots.get(&planned.robot) else { continue };
            let known = planned.scripts.iter().filter_map(|script| {
                let latency = robot.mission.latencies.get(&script.device)?;
                Some((script.device.clone(), *latency))
            });
            let known: BTreeMap<_, _> = known.collect();
            if !known.is_empty() {
                act.latencies.insert(planned.robot.clone(), known);
            }
        }
    }
    apply(acts);
}

/// Compensates the latencies in `latencies` of each act.
pub(crate) fn apply(acts: &mut [Act]) {
    for (act, lead_in) in lead_ins(acts).into_iter().enumerate() {
        shift(&mut acts[act], lead_in);
        acts[act].lead_in = lead_in;
        each_script(&mut acts[act], |script, median| {
            script.start = moved(script.start, lead_in - median);
        });
    }
}

/// Reverts the compensation of an act, so that its scripts start at motion times again.
pub fn undo(act: &mut Act) {
    let lead_in = std::mem::take(&mut act.lead_in);
    each_script(act, |script, median| script.start = moved(script.start, median - lead_in));
    shift(act, Span::ZERO - lead_in);
}

/// Returns the smallest sufficient lead-in for each act: no script begins before its act, and no motion begins before the motions of any
/// preceding act have ended. A device with a long latency still moves after its commands have ended.
fn lead_ins(acts: &[Act]) -> Vec<Span> {
    let mut lead_ins: Vec<Span> = acts.iter().map(needed).collect();
    for act in acts {
        let next = if let Way::Act(next) = act.next { Some(next) } else { None };
        for following in next.into_iter().chain(act.on_failure.then) {
            if let Some(lead_in) = lead_ins.get_mut(following) {
                *lead_in = (*lead_in).max(tail(act));
            }
        }
    }
    lead_ins
}

fn needed(act: &Act) -> Span {
    let early = scripts(act).map(|(script, median)| median - script.start.span());
    early.max().unwrap_or_default().max(Span::ZERO)
}

/// Returns the time by which an act's last motion ends later than its last command.
fn tail(act: &Act) -> Span {
    let ends = |script: &DeviceScript| script.start.span() + script.duration();
    let motions = scripts(act).map(|(script, _)| ends(script)).max();
    let commands = scripts(act).map(|(script, median)| ends(script) - median).max();
    motions.zip(commands).map_or(Span::ZERO, |(motions, commands)| motions - commands)
}

/// Returns all scripts of an act, each with the latency of its device.
fn scripts(act: &Act) -> impl Iterator<Item = (&DeviceScript, Span)> {
    act.plan.robots.iter().flat_map(|robot| {
        robot.scripts.iter().map(|script| (script, act.latency_of(&robot.robot, &script.device)))
    })
}

fn each_script(act: &mut Act, mut change: impl FnMut(&mut DeviceScript, Span)) {
    let mut robots = std::mem::take(&mut act.plan.robots);
    for robot in &mut robots {
        for script in &mut robot.scripts {
            change(script, act.latency_of(&robot.robot, &script.device));
        }
    }
    act.plan.robots = robots;
}

/// Returns `start` shifted by `by`. A start that does not change keeps its exact value.
fn moved(start: Millis, by: Span) -> Millis {
    if by == Span::ZERO { start } else { Millis::from_span(start.span() + by) }
}

/// Shifts all motion times of the act. Command times stay unchanged.
fn shift(act: &mut Act, by: Span) {
    for cue in &mut act.cues {
        (cue.start, cue.end) = (cue.start + by, cue.end + by);
    }
    for reading in &mut act.readings {
        reading.at += by;
    }
    for used in &mut act.devices {
        used.worst_at += by;
    }
    if let Some(closest) = &mut act.in_space.closest {
        closest.at += by;
    }
    for point in act.in_space.driven.iter_mut().flat_map(|path| &mut path.points) {
        point.at += by;
    }
}
