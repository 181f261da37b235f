//! (m) Every movement has one reason: an unaltered step of a script, coming to rest from such a step, or a stop with `home`.

use std::collections::{HashMap, HashSet};

use downbeat_robot::set_log::LogEntry;
use downbeat_scripts::{FailurePolicy, OnFailure};
use urrcp::{ControlType, DeviceId, Interpolation, Message, Robot, Server, Span, Timestamp};

use super::Verdict;
use super::facts::{Facts, SentScript};
use crate::simulation::draw::{BEGINS_AT, Hands};
use crate::simulation::{Fault, Happened};

/// The largest relative difference, by rounding, between two computations of the same value.
const ROUNDING: f64 = 1e-6;

/// The longest time in which a device slows down, or goes home at its own speed.
const SLOWS_DOWN_MAX: Span = Span::from_millis(600_000);

/// The last movement of a device. Times are those of its robot's clock.
#[derive(Clone, Copy)]
struct Way {
    /// `None` if the start of the movement is unknown, as for the first movement of a process.
    from: Option<f64>,
    since: Timestamp<Robot>,
    to: f64,
    until: Timestamp<Robot>,
}

impl Way {
    const fn at(value: f64, since: Timestamp<Robot>) -> Self {
        Self { from: Some(value), since, to: value, until: since }
    }

    fn value(&self, at: Timestamp<Robot>) -> Option<f64> {
        if at >= self.until {
            return Some(self.to);
        }
        let from = self.from?;
        let part = (at - self.since).as_millis_f64() / (self.until - self.since).as_millis_f64();
        Some(from + (self.to - from) * part)
    }
}

/// Distance from the first value above which a device jumps to it: twice its granularity.
const JUMP: f64 = 2.0;

/// The devices that would have to jump at the start of an act if their robot has not moved before. Includes only devices that
/// move linearly, are not behind an edge, and have a position that the robot states.
pub(super) fn jumps_of(facts: &Facts<'_>, robot: usize, act: usize) -> Vec<DeviceId> {
    let (choreography, drawn) = (&facts.drawn().choreography, &facts.drawn().robots[robot]);
    let states_positions = drawn.block.inquiry && drawn.hands == Hands::Own;
    let act = choreography.acts.get(act).filter(|_| states_positions).into_iter();
    let planned = act.flat_map(|act| &act.plan.robots).filter(|planned| planned.robot == drawn.block.id);
    let mut devices = Vec::new();
    let mut jumping = Vec::new();
    for script in planned.flat_map(|planned| &planned.scripts) {
        if devices.contains(&script.device) {
            continue;
        }
        devices.push(script.device.clone());
        let device = drawn.block.device(script.device.as_str());
        let linear = device.is_some_and(|device| {
            device.interpolation == Interpolation::Linear && device.default_value.is_some()
        });
        let at_once = script.script.steps().first().filter(|step| step.offset.span() == Span::ZERO);
        if linear && at_once.is_some_and(|step| (step.setpoint.value - BEGINS_AT).abs() > JUMP) {
            jumping.push(script.device.clone());
        }
    }
    jumping
}

/// Index, in the choreography, of the first act in which a robot moved.
fn first_act_of(facts: &Facts<'_>, robot: usize) -> Option<usize> {
    let moved = |script: &SentScript<'_>| script.robot == robot && !script.log.is_empty();
    facts.acts.iter().find(|act| act.scripts.iter().any(moved)).map(|act| act.promise.act)
}

/// Checks that no robot that states its positions jumps at the start of a mission or when it joins one.
fn no_jumps(facts: &Facts<'_>, verdict: &mut Verdict) {
    for robot in (0..facts.drawn().robots.len()).filter(|robot| facts.honest(*robot)) {
        let act = if facts.drawn().joins(robot) { first_act_of(facts, robot) } else { Some(0) };
        let Some(act) = act else { continue };
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
            if is_first && jumping.contains(&entry.device) && entry.motion == "set" {
                let what = format!("r{robot} jumped from {BEGINS_AT} to its first value: {entry:?}");
                verdict.violated('m', what);
            }
        }
    }
}

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    no_jumps(facts, verdict);
    let scripts: HashMap<&str, &SentScript<'_>> = facts
        .acts
        .iter()
        .flat_map(|act| &act.scripts)
        .map(|script| (script.promised.request_id.as_str(), script))
        .collect();
    for robot in (0..facts.drawn().robots.len()).filter(|robot| facts.honest(*robot)) {
        let homes = if may_go_home(facts) { homes(facts, robot) } else { Vec::new() };
        let mut begun = begins(facts, robot).peekable();
        let mut ways: HashMap<&DeviceId, Way> = HashMap::new();
        for entry in &facts.ran.logs[robot] {
            while begun.next_if(|begun| begun.as_nanos() <= entry.true_ns).is_some() {
                ways.clear();
            }
            let script = entry.request_id.as_deref().and_then(|id| scripts.get(id)).copied();
            let before = ways.get(&entry.device).copied();
            let goes_home = homes.contains(&(&entry.device, entry.true_ns));
            match reason(entry, script, before, goes_home) {
                Ok(way) => drop(ways.insert(&entry.device, way)),
                Err(why) => verdict.violated('m', format!("r{robot} {why}: {entry:?}")),
            }
        }
    }
}

/// Whether a policy of this mission, or its operator, sends robots to their default state.
fn may_go_home(facts: &Facts<'_>) -> bool {
    let drawn = facts.drawn();
    let sends_home = |policy: &FailurePolicy| {
        policy.default == OnFailure::Home || policy.robots.iter().any(|(_, own)| *own == OnFailure::Home)
    };
    drawn.choreography.acts.iter().any(|act| sends_home(&act.on_failure))
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

/// The times at which a new process of the robot started. The new process does not know the movements of the previous one.
fn begins<'a>(facts: &'a Facts<'_>, robot: usize) -> impl Iterator<Item = Timestamp<Server>> + 'a {
    let is_of = move |happened: &Happened| matches!(happened, Happened::Back(of) if *of == robot);
    facts.ran.history.iter().filter(move |(_, happened)| is_of(happened)).map(|(at, _)| *at)
}

/// Returns the new movement of the device if it has a reason, or else a description of the violation.
fn reason(
    entry: &LogEntry,
    script: Option<&SentScript<'_>>,
    before: Option<Way>,
    goes_home: bool,
) -> Result<Way, String> {
    let resting = match entry.motion {
        // The log does not contain the time of arrival.
        "slow" => Way { from: None, until: entry.due + SLOWS_DOWN_MAX, ..Way::at(entry.value, entry.due) },
        _ => Way::at(entry.value, entry.due),
    };
    match entry.motion {
        "set" | "ramp" => of_a_step(entry, script, before),
        // A device that goes home may be sent home again, and a device that slows down may be stopped again.
        _ if goes_home => Ok(resting),
        "default" => Err("went to its default state, and no stop said home".to_owned()),
        "rest" | "slow" if entry.control_type != ControlType::Position.to_string() => match entry.value {
            0.0 => Ok(resting),
            _ => Err("came to rest at a speed".to_owned()),
        },
        "rest" | "slow" => {
            let before = before.filter(|way| entry.due < way.until);
            let way = before.ok_or("was moved by a stop although it rested")?;
            let Some(value) = way.value(entry.due) else { return Ok(resting) };
            let off = entry.value - value;
            let rounded = off.abs() <= ROUNDING * (1.0 + value.abs());
            let goes_on = entry.motion == "slow" && off * (way.to - value) >= 0.0;
            if rounded || goes_on { Ok(resting) } else { Err(format!("was at {value} when a stop moved it")) }
        }
        other => Err(format!("moved by `{other}`")),
    }
}

fn of_a_step(entry: &LogEntry, script: Option<&SentScript<'_>>, before: Option<Way>) -> Result<Way, String> {
    let script = script.ok_or("moved without a script of this mission")?;
    if script.promised.device != entry.device {
        return Err("moved by a script of another device".to_owned());
    }
    let index = entry.step.unwrap_or_default() as usize;
    let Some(written) = script.written else { return Ok(Way::at(entry.value, entry.due)) };
    let step = written.script.steps().get(index).ok_or("did a step that was not written")?;
    if (step.setpoint.value - entry.value).abs() > 0.0 {
        return Err(format!("did step {index}, written as {}", step.setpoint.value));
    }
    if entry.motion == "set" {
        return Ok(Way::at(entry.value, entry.due));
    }
    let previous = index.checked_sub(1).and_then(|previous| written.script.steps().get(previous));
    let offset = step.offset.span() - previous.map_or(Span::ZERO, |previous| previous.offset.span());
    let from = before.and_then(|way| way.value(entry.due));
    Ok(Way { from, since: entry.due, to: entry.value, until: entry.due + offset })
}
