//! What the robots of a cue do as a group becomes a movement of each device that is a coordinate of a body. `ensemble` finds the ways.

use std::collections::HashSet;
use std::sync::Arc;

use urrcp::{ControlType, Device, Span};

use super::{OnDevice, Performer};
use crate::compile::cast::{Members, Positions};
use crate::compile::schedule::CueTime;
use crate::compile::segment::{Segment, Steps};
use crate::ensemble::{self, Asked, Axis, Dancer, Moved};
use crate::exact::Exact;
use crate::motion::{Between, Curve, Function, Knot, Shape, Stretch, Swept};
use crate::scenario::{Act, Cue, Items, Motion, Together, Track};

mod told;

/// What groups need to know beyond their cues.
#[derive(Clone, Copy)]
pub(in crate::compile) struct Ground<'g> {
    pub(in crate::compile) of_scenario: ensemble::Ground<'g>,
    /// Where devices are when the act begins.
    pub(in crate::compile) positions: &'g Positions<'g>,
}

impl<'a> Performer<'_, 'a> {
    /// The groups of an act, in the order of time: each begins where the movements before it end.
    pub(in crate::compile) fn groups(
        &mut self,
        act: &Act,
        members: &[Members],
        times: &[CueTime],
        ground: Ground<'_>,
    ) {
        let cues = act.cues.iter().zip(members).zip(times);
        let mut groups: Vec<_> = cues.filter(|((cue, _), _)| cue.group.is_some()).collect();
        groups.sort_by_key(|(_, time)| time.start);
        // Robots of a group that could not move: where later groups find them is not known.
        let mut lost: HashSet<usize> = HashSet::new();
        for ((cue, members), time) in groups {
            let Some(group) = &cue.group else { continue };
            let robots: Vec<usize> = members.all.iter().map(|member| member.robot).collect();
            let danced = match robots.iter().any(|robot| lost.contains(robot)) {
                false => self.group(cue, group, members, time, ground),
                true => {
                    if let Err(fault) = ensemble::places(group, robots.len(), ground.of_scenario) {
                        self.tell(cue, group, &robots, &fault, ground);
                    }
                    false
                }
            };
            if !danced {
                lost.extend(robots);
            }
        }
    }

    /// Whether it can be done.
    fn group(
        &mut self,
        cue: &Cue,
        group: &Together,
        members: &Members,
        time: &CueTime,
        ground: Ground<'_>,
    ) -> bool {
        let Some(dancers) = self.dancers(cue, group, members, time, ground) else { return false };
        let asked = Asked { together: group, tolerance: cue.tolerance };
        let rehearsed = cue.rehearsed.as_ref().and_then(|rehearsed| rehearsed.of(&dancers));
        match rehearsed.unwrap_or_else(|| ensemble::ways(asked, &dancers, ground.of_scenario)) {
            Ok(ways) => {
                for (dancer, moved) in dancers.iter().zip(&ways) {
                    self.dance(cue, group, time, dancer, moved);
                }
                true
            }
            Err(fault) => {
                let robots: Vec<usize> = dancers.iter().map(|dancer| dancer.robot).collect();
                self.tell(cue, group, &robots, &fault, ground);
                false
            }
        }
    }

    /// The robots with where they are when the cue begins for each of them.
    fn dancers(
        &mut self,
        cue: &Cue,
        group: &Together,
        members: &Members,
        time: &CueTime,
        ground: Ground<'_>,
    ) -> Option<Vec<Dancer<'a>>> {
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

    /// Where a coordinate is at a time of the act: where the last movement before that has left it. In metres.
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

    /// One robot's part in it: a movement of each of its devices that moves.
    fn dance(&mut self, cue: &Cue, group: &Together, time: &CueTime, dancer: &Dancer<'_>, moved: &Moved) {
        for (axis, swept) in dancer.axes.iter().zip(&moved.axes) {
            let Axis::Moved { index, device, scale, offset } = *axis else { continue };
            if swept.is_still() {
                continue;
            }
            // What begins late ends with the others, to the nanosecond.
            let begin = Span::from_millis_f64(moved.begin * 1_000.0);
            let length = Span::from_millis_f64((moved.begin + moved.length) * 1_000.0) - begin;
            let track = track(cue, group, device, curve(swept.in_units(scale, offset), length));
            let robots = [dancer.robot];
            let on = OnDevice { cue, track: &track, device, robots: &robots, cast: self.cast };
            let Some(part) = self.part(&on, Stretch { from: length, to: length }) else { continue };
            if !self.used(cue, 1) {
                return;
            }
            let segment = Segment {
                begin: time.start + begin,
                cue: cue.name.as_str().into(),
                stop_condition: cue.stop_condition,
                part: Arc::new(part),
            };
            self.segments.entry((dancer.robot, index)).or_default().push(segment);
        }
    }
}

fn curve(swept: Swept, length: Span) -> Curve {
    let function = Function::Swept(Box::new(swept));
    let (from, to) = (function.at(0.0), function.at(1.0));
    let item = u32::MAX;
    let shape = Shape::Function { index: 0, gain: 1.0, offset: 0.0, reversed: false };
    let begin = Knot { at: Span::ZERO, to: from, shape: Shape::Sampled(Between::Linear), item };
    Curve::new(vec![begin, Knot { at: length, to, shape, item }], vec![function])
}

fn track(cue: &Cue, group: &Together, device: &Device, curve: Curve) -> Track {
    Track {
        device: device.id.to_string(),
        control: Some(ControlType::Position),
        length: curve.length().into(),
        motion: Motion::Curve(curve),
        begin: Exact::ZERO,
        starts: Span::ZERO,
        pieces: Vec::new(),
        tolerance: cue.tolerance,
        steps_max: None,
        place: group.place.clone(),
        turns: 1,
        items: Items::Whole,
        list: group.place.clone(),
    }
}
