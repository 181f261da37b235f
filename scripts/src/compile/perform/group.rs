//! Turns group movements of a cue into movements of the devices that are coordinates of bodies. `ensemble` computes the movements.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use urrcp::{ControlType, Device, Span};

use super::{OnDevice, Performer, room};
use crate::compile::ahead::{WAYS_MIN, together};
use crate::compile::cast::{Members, Positions};
use crate::compile::check_values;
use crate::compile::overlap::Overlap;
use crate::compile::schedule::CueTime;
use crate::compile::segment::{Segment, Steps};
use crate::ensemble::{self, Action, Axis, Dancer, DancerMovement, Fault, GroupTask, Together};
use crate::exact::Exact;
use crate::finding::{Code, Pending};
use crate::fleet::settable_limits;
use crate::motion::{Actuator, Between, Curve, Function, Knot, Played, Shape, Stretch, Swept};
use crate::scenario::{Act, Cue, Items, Motion, Track};

use fixes::Fixes;

mod fixes;
mod told;

/// The data that determine the movement of a group, apart from its cue.
#[derive(Clone, Copy)]
pub(in crate::compile) struct Ground<'g> {
    pub(in crate::compile) of_scenario: ensemble::Ground<'g>,
    /// Positions of devices at the beginning of the act.
    pub(in crate::compile) positions: &'g Positions<'g>,
}

/// A cue that moves a group, with its robots and its time.
#[derive(Clone, Copy)]
struct Grouped<'g> {
    cue: &'g Cue,
    group: &'g Together,
    members: &'g Members,
    time: &'g CueTime,
}

/// A group in the queue of groups that are processed one after the other.
struct Turn<'g> {
    grouped: Grouped<'g>,
    /// Whether its robots' starting places are known: every group that moves one of the robots earlier is processed earlier.
    is_known: bool,
}

/// Orders the groups of an act. Of two groups that share a robot, the one in which the robot begins first comes first.
fn in_turn(mut groups: Vec<Grouped<'_>>) -> Vec<Turn<'_>> {
    groups.sort_by_key(|grouped| grouped.time.start);
    let mut of_robot: HashMap<usize, Vec<(Span, usize)>> = HashMap::new();
    for (index, grouped) in groups.iter().enumerate() {
        for member in &grouped.members.all {
            of_robot.entry(member.robot).or_default().push((grouped.time.start + member.delay, index));
        }
    }
    let mut before = vec![0usize; groups.len()];
    let mut after = vec![Vec::new(); groups.len()];
    for turns in of_robot.values_mut() {
        turns.sort_unstable();
        for pair in turns.windows(2).filter(|pair| pair[0].1 != pair[1].1) {
            before[pair[1].1] += 1;
            after[pair[0].1].push(pair[1].1);
        }
    }
    let mut waiting: BTreeSet<usize> = (0..groups.len()).collect();
    let mut ready: BTreeSet<usize> = (0..groups.len()).filter(|index| before[*index] == 0).collect();
    let mut turns = Vec::with_capacity(groups.len());
    while let Some(index) = ready.pop_first().or_else(|| waiting.first().copied()) {
        if !waiting.remove(&index) {
            continue;
        }
        turns.push(Turn { grouped: groups[index], is_known: before[index] == 0 });
        for next in std::mem::take(&mut after[index]) {
            before[next] = before[next].saturating_sub(1);
            if before[next] == 0 {
                ready.insert(next);
            }
        }
    }
    turns
}

impl<'a> Performer<'_, 'a> {
    /// Processes the groups of an act in order of time, because each group begins where the previous movements end.
    pub(in crate::compile) fn groups(
        &mut self,
        act: &Act,
        members: &[Members],
        times: &[CueTime],
        ground: Ground<'_>,
    ) {
        // Cues without robots are already reported.
        let cues =
            act.cues.iter().zip(members).zip(times).filter(|((_, members), _)| !members.all.is_empty());
        let groups = cues.filter_map(|((cue, members), time)| {
            Some(Grouped { cue, group: cue.group.as_ref()?, members, time })
        });
        for Turn { grouped, is_known } in in_turn(groups.collect()) {
            let Grouped { cue, group, members, .. } = grouped;
            let robots: Vec<usize> = members.all.iter().map(|member| member.robot).collect();
            if !is_known {
                self.tell_entangled(cue, group);
            }
            let danced = if is_known && !robots.iter().any(|robot| self.incomplete.contains(robot)) {
                self.group(grouped, ground)
            } else {
                if let Err(fault) = ensemble::places(group, robots.len(), ground.of_scenario) {
                    self.tell(cue, group, &robots, &fault, ground, None);
                }
                false
            };
            if !danced {
                self.incomplete.extend(robots);
            }
        }
    }

    /// Computes the movements of a group. Returns `false` if they are impossible.
    fn group(&mut self, grouped: Grouped<'_>, ground: Ground<'_>) -> bool {
        let Some(dancers) = self.dancers(grouped, ground) else { return false };
        let Grouped { cue, group, time, .. } = grouped;
        // A formation sets every coordinate of its robots, even those that do not change.
        let is_formed = matches!(group.action, Action::Form(_));
        if is_formed && self.tell_moving(grouped, &dancers, |_, _| true) {
            return false;
        }
        let asked = GroupTask { together: group, tolerance: cue.tolerance };
        let rehearsed = cue.rehearsed.as_ref().and_then(|rehearsed| rehearsed.of(&dancers));
        match rehearsed.unwrap_or_else(|| ensemble::ways(asked, &dancers, ground.of_scenario)) {
            Ok(ways) => {
                let moves = |dancer: usize, axis: usize| !ways[dancer].axes[axis].is_still();
                if self.tell_moving(grouped, &dancers, moves) {
                    return false;
                }
                let before = self.findings.found.len();
                let all: Vec<Dance<'_>> = dancers
                    .iter()
                    .zip(&ways)
                    .flat_map(|(dancer, moved)| dances(cue, group, dancer, moved))
                    .collect();
                self.fit_ahead(&all);
                all.into_iter().for_each(|dance| self.dance(cue, time, &dance));
                // If hints were added, later movements would begin at impossible places, and their findings would have the same cause.
                !self.hint_within_limits(grouped, &dancers, &ways, ground, before)
            }
            // A longer time does not help if the movement leaves the limits of the devices.
            Err(fault @ Fault::TooShort { .. }) if self.leads_out(grouped, &dancers, &fault, ground) => false,
            Err(fault) => {
                let robots: Vec<usize> = dancers.iter().map(|dancer| dancer.robot).collect();
                let fix = Fixes::of(cue, group, &dancers, ground).hint(&fault);
                self.tell(cue, group, &robots, &fault, ground, fix);
                false
            }
        }
    }

    /// For a group with too little time, reports the places beyond the limits of devices to which it would move with enough time. Returns
    /// whether there are any.
    fn leads_out(
        &mut self,
        grouped: Grouped<'_>,
        dancers: &[Dancer<'a>],
        fault: &Fault,
        ground: Ground<'_>,
    ) -> bool {
        let Fault::TooShort { seconds, .. } = fault else { return false };
        let Grouped { cue, group, .. } = grouped;
        let longer = Together { over: fixes::up(*seconds), ..group.clone() };
        let asked = GroupTask { together: &longer, tolerance: cue.tolerance };
        let Ok(ways) = ensemble::ways(asked, dancers, ground.of_scenario) else { return false };
        let before = self.findings.found.len();
        for (dancer, moved) in dancers.iter().zip(&ways) {
            for dance in dances(cue, group, dancer, moved) {
                let robots = [dance.robot];
                let on = OnDevice::new(cue, &dance.track, dance.device, &robots, self.cast);
                if let Motion::Curve(curve) = &dance.track.motion {
                    check_values::check(self.findings, &on, ControlType::Position, curve);
                }
            }
        }
        self.hint_within_limits(grouped, dancers, &ways, ground, before)
    }

    /// Sets the same hint for all findings from the index `before` on that are about places beyond the limits. Returns whether there are
    /// such places.
    fn hint_within_limits(
        &mut self,
        Grouped { cue, group, .. }: Grouped<'_>,
        dancers: &[Dancer<'a>],
        ways: &[DancerMovement],
        ground: Ground<'_>,
        before: usize,
    ) -> bool {
        let is_out = |found: &Pending| found.code == Code::OutOfRange;
        let fixes = Fixes::of(cue, group, dancers, ground);
        if !self.findings.found.iter().skip(before).any(is_out) {
            // The findings may have been merged into a finding about another cue with the same formation.
            return !fixes.are_within(ways);
        }
        let fix = fixes.within_limits(ways);
        let hint = fix.unwrap_or_else(|| {
            match group.action {
                Action::Form(_) => "make the formation smaller, or move it with `at`",
                Action::Sweep(_) => "make the movement smaller, or start the group elsewhere",
            }
            .to_owned()
        });
        let out = self.findings.found.iter_mut().skip(before).filter(|found| is_out(found));
        out.for_each(|found| found.hint = Some(hint.clone()));
        true
    }

    /// Returns the robots of a group, each with its place at the instant at which it begins to move. `None` if a place is unknown.
    fn dancers(&mut self, grouped: Grouped<'_>, ground: Ground<'_>) -> Option<Vec<Dancer<'a>>> {
        let Grouped { cue, group, members, time } = grouped;
        let cast = self.cast;
        let (mut dancers, mut without, mut unknown) = (Vec::new(), Vec::new(), Vec::new());
        for member in &members.all {
            let robot = &cast.fleet.robots[member.robot];
            let axes = robot
                .body
                .as_ref()
                .and_then(|body| Some((body, ensemble::axes(body, cast.devices(member.robot))?)));
            let Some((body, axes)) = axes else {
                without.push(member.robot);
                continue;
            };
            let begin = time.start + member.delay;
            let at = |axis: &Axis<'_>| self.standing(member.robot, axis, begin, ground.positions);
            match axes.each_ref().map(at) {
                [Some(x), Some(y), Some(z)] => {
                    let (robot, delay) = (member.robot, member.delay);
                    dancers.push(Dancer { robot, delay, body, axes, from: [x, y, z] });
                }
                _ => unknown.push(member.robot),
            }
        }
        self.tell_excluded(cue, group, &without, &unknown);
        (without.is_empty() && unknown.is_empty()).then_some(dancers)
    }

    /// Reports coordinates that an earlier movement still changes when the cue begins, if `counts` returns `true` for them. Returns
    /// whether there are any.
    fn tell_moving(
        &mut self,
        grouped: Grouped<'_>,
        dancers: &[Dancer<'_>],
        counts: impl Fn(usize, usize) -> bool,
    ) -> bool {
        let Grouped { cue, group, time, .. } = grouped;
        let mut is_moving = false;
        for (number, dancer) in dancers.iter().enumerate() {
            let begin = time.start + dancer.delay;
            for (axis, coordinate) in dancer.axes.iter().enumerate() {
                let Axis::Moved { index, device, .. } = *coordinate else { continue };
                let segments = self.segments.get(&(dancer.robot, index)).into_iter().flatten();
                let moving = segments.filter(|segment| segment.start() < begin && begin < segment.end());
                let Some(last) = moving.max_by_key(|segment| segment.end()) else { continue };
                if counts(number, axis) {
                    let robot = self.cast.id(dancer.robot).clone();
                    let (before, end) = (&*last.cue, last.end());
                    let overlap = Overlap { cue: &cue.name, start: begin, before, end };
                    let fault = overlap.fault(device, robot, group.place.clone());
                    self.findings.add_shared(fault);
                    is_moving = true;
                }
            }
        }
        is_moving
    }

    /// Returns a coordinate of a robot, in metres, at the time `at` since the act's start: where the last preceding movement has left it.
    /// `None` if this is unknown.
    fn standing(&self, robot: usize, axis: &Axis<'_>, at: Span, positions: &Positions<'_>) -> Option<f64> {
        let (index, scale, offset) = match *axis {
            Axis::Fixed(value) => return Some(value),
            Axis::Moved { index, scale, offset, .. } => (index, scale, offset),
        };
        let segments = self.segments.get(&(robot, index)).into_iter().flatten();
        let last = segments.filter(|segment| segment.end() <= at).max_by_key(|segment| segment.end());
        let value = match last {
            None => positions.certain(robot, index)?,
            Some(segment) => match &segment.part.steps {
                Steps::One(values) if segment.part.control_type == ControlType::Position => values.last()?.to,
                _ => return None,
            },
        };
        Some(offset + scale * value)
    }

    /// Fits the movements ahead, on all processors, if there are many of them.
    fn fit_ahead(&mut self, dances: &[Dance<'_>]) {
        if dances.len() < WAYS_MIN {
            return;
        }
        let left = self.steps.left();
        let fits = together(dances, |dance, fits| {
            let limits = settable_limits(dance.device, ControlType::Position);
            let room = room(dance.device, left);
            let actuator = Actuator::new(dance.device, ControlType::Position, limits.as_ref(), room);
            if let Motion::Curve(curve) = &dance.track.motion {
                let tolerance = dance.track.tolerance.unwrap_or_else(|| actuator.tolerance());
                let thinned = dance.track.tolerance.is_some();
                actuator.steps(&Played::new(curve, Vec::new()), tolerance, thinned, fits);
            }
            true
        });
        self.fits.extend(fits);
    }

    fn dance(&mut self, cue: &Cue, time: &CueTime, dance: &Dance<'_>) {
        let Dance { robot, index, device, begin, length, track } = dance;
        let robots = [*robot];
        let on = OnDevice::new(cue, track, device, &robots, self.cast);
        let part = self.part(&on, Stretch { from: *length, to: *length });
        let Some(part) = part.filter(|_| self.used(cue, 1)) else {
            self.incomplete.insert(*robot);
            return;
        };
        let segment = Segment {
            begin: time.start + *begin,
            cue: cue.name.as_str().into(),
            stop_condition: cue.stop_condition,
            part: Arc::new(part),
        };
        self.segments.entry((*robot, *index)).or_default().push(segment);
    }
}

/// The movement of one device that is part of the movement of a group.
struct Dance<'a> {
    robot: usize,
    /// Index of the device in the robot's list of devices.
    index: usize,
    device: &'a Device,
    /// Start of the movement, since the cue's start.
    begin: Span,
    length: Span,
    track: Track,
}

/// Returns the movements of the devices of one robot in a group.
fn dances<'a>(cue: &Cue, group: &Together, dancer: &Dancer<'a>, moved: &DancerMovement) -> Vec<Dance<'a>> {
    // A robot that begins late ends with the others, to the nanosecond.
    let begin = Span::from_millis_f64(moved.begin * 1_000.0);
    let length = Span::from_millis_f64((moved.begin + moved.length) * 1_000.0) - begin;
    let of_axis = |(axis, swept): (&Axis<'a>, &Swept)| {
        let Axis::Moved { index, device, scale, offset } = *axis else { return None };
        let moves = !swept.is_still();
        moves.then(|| {
            let curve = curve(swept.in_units(scale, offset), length);
            let track = track(group, device, curve, axis.tolerance(cue.tolerance, moved.error_share));
            Dance { robot: dancer.robot, index, device, begin, length, track }
        })
    };
    dancer.axes.iter().zip(&moved.axes).filter_map(of_axis).collect()
}

fn curve(swept: Swept, length: Span) -> Curve {
    let function = Function::Swept(Box::new(swept));
    let (from, to) = (function.at(0.0), function.at(1.0));
    let item = u32::MAX;
    let shape = Shape::Function { index: 0, gain: 1.0, offset: 0.0, reversed: false };
    let begin = Knot { at: Span::ZERO, to: from, shape: Shape::Sampled(Between::Linear), item };
    Curve::new(vec![begin, Knot { at: length, to, shape, item }], vec![function])
}

fn track(group: &Together, device: &Device, curve: Curve, tolerance: Option<f64>) -> Track {
    Track {
        device: device.id.to_string(),
        control: Some(ControlType::Position),
        length: curve.length().into(),
        motion: Motion::Curve(curve),
        begin: Exact::ZERO,
        starts: Span::ZERO,
        pieces: Vec::new(),
        tolerance,
        steps_max: None,
        place: group.place.clone(),
        turns: 1,
        items: Items::Whole,
        list: group.place.clone(),
        given: Vec::new(),
        changed: None,
    }
}
