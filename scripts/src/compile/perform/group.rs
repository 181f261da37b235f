//! What the robots of a cue do as a group: into a formation, or turning, growing and shifting as one. It becomes a movement of
//! each device that is a coordinate of a body.

use std::cmp::Ordering;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use urrcp::{ControlType, Device, Limits, Span};

use super::{OnDevice, Performer, limits_of};
use crate::compile::cast::{Member, Members, Positions};
use crate::compile::schedule::CueTime;
use crate::compile::segment::{Segment, Steps};
use crate::exact::Exact;
use crate::finding::{Code, one_of};
use crate::formation::Point;
use crate::motion::{Between, Curve, Function, Knot, Shape, Stretch, Swept};
use crate::node::shortened;
use crate::render::counted;
use crate::scenario::{
    Act, Action, Cue, Form, Items, Motion, Spare, Target, Thin, Together, Track, WrittenFormation,
    WrittenPath,
};
use crate::space::{Body, Coordinate, Shape as BodyShape};
use crate::transit;

mod along;
mod sweep;
mod told;

/// Most robots of a group: an assignment takes time with the cube of their number.
const GROUP_MAX: usize = 1_000;
/// Places that differ less in height, in metres, have one height.
const LEVEL: f64 = 1e-9;
const COORDINATES: [&str; 3] = ["x", "y", "z"];

/// What groups need to know beyond their cues.
pub(in crate::compile) struct Ground<'a> {
    pub(in crate::compile) formations: &'a HashMap<String, WrittenFormation>,
    pub(in crate::compile) paths: &'a HashMap<String, WrittenPath>,
    /// Where devices are when the act begins.
    pub(in crate::compile) positions: &'a Positions<'a>,
}

/// A coordinate of a body.
#[derive(Clone, Copy)]
enum Axis<'a> {
    Fixed(f64),
    Moved {
        /// Of the robot.
        index: usize,
        device: &'a Device,
        /// Metres in one unit.
        scale: f64,
        offset: f64,
    },
}

impl<'a> Axis<'a> {
    fn limits(&self) -> Option<impl Iterator<Item = &'a Limits>> {
        match self {
            Self::Fixed(_) => None,
            Self::Moved { device, .. } => Some(limits_of(device, ControlType::Position)),
        }
    }

    /// The place nearest to one in metres to which the device can be set.
    fn nearest(&self, metres: f64) -> f64 {
        match *self {
            Self::Fixed(value) => value,
            Self::Moved { scale, offset, .. } => {
                let value = (metres - offset) / scale;
                let limits = self.limits().and_then(|mut limits| limits.next());
                offset + scale * limits.map_or(value, |limits| limits.nearest(value))
            }
        }
    }

    /// Metres in one unit, where its zero is, and its granularity.
    fn grid(&self) -> Option<[f64; 3]> {
        let Self::Moved { scale, offset, .. } = *self else { return None };
        let limits = self.limits().and_then(|mut limits| limits.next());
        Some([scale, offset, limits.map_or(0.0, |limits| limits.granularity)])
    }

    /// How far its steps may be off, in metres.
    fn error(&self, tolerance: Option<f64>) -> f64 {
        let Self::Moved { scale, .. } = self else { return 0.0 };
        let own = |limits: &Limits| limits.max_error.unwrap_or(0.0).max(limits.granularity);
        let own = || self.limits().into_iter().flatten().map(own).fold(0.0, f64::max);
        scale.abs() * tolerance.unwrap_or_else(own)
    }

    /// The least and the largest coordinate that the device reaches, in metres.
    fn ends(&self) -> Option<[f64; 2]> {
        let Self::Moved { scale, offset, .. } = *self else { return None };
        let all = self.limits()?;
        let (least, most) = all.fold((f64::NEG_INFINITY, f64::INFINITY), |(least, most), limits| {
            (least.max(limits.min_value), most.min(limits.max_value))
        });
        let ends = [offset + scale * least, offset + scale * most];
        Some(if scale < 0.0 { [ends[1], ends[0]] } else { ends })
    }
}

/// A robot of a group.
struct Dancer<'a> {
    member: Member,
    body: &'a Body,
    axes: [Axis<'a>; 3],
    from: Point,
}

impl Dancer<'_> {
    /// Of the ball about its middle that holds it, in metres.
    fn radius(&self) -> f64 {
        match self.body.shape {
            BodyShape::Ball { radius } => radius,
            BodyShape::Box { size: [x, y, z] } => x.hypot(y).hypot(z) / 2.0,
        }
    }

    /// Whether it cannot change its height.
    const fn is_flat(&self) -> bool {
        matches!(self.axes[2], Axis::Fixed(_))
    }
}

impl<'a> Performer<'_, 'a> {
    /// The groups of an act, in the order of time: each begins where the movements before it end.
    pub(in crate::compile) fn groups(
        &mut self,
        act: &Act,
        members: &[Members],
        times: &[CueTime],
        ground: &Ground<'_>,
    ) {
        let cues = act.cues.iter().zip(members).zip(times);
        let mut groups: Vec<_> = cues.filter(|((cue, _), _)| cue.group.is_some()).collect();
        groups.sort_by_key(|(_, time)| time.start);
        // Robots of a group that could not move: where later groups find them is not known.
        let mut lost: HashSet<usize> = HashSet::new();
        for ((cue, members), time) in groups {
            let Some(group) = &cue.group else { continue };
            let is_lost = members.all.iter().any(|member| lost.contains(&member.robot));
            let danced = match is_lost {
                true => None,
                false => self.group(cue, group, members, time, ground),
            };
            if let (true, Action::Form(Form { to: Target::Formation(name), .. })) = (is_lost, &group.action) {
                self.places(group, name, members.all.len(), ground);
            }
            if danced.is_none() {
                lost.extend(members.all.iter().map(|member| member.robot));
            }
        }
    }

    fn group(
        &mut self,
        cue: &Cue,
        group: &Together,
        members: &Members,
        time: &CueTime,
        ground: &Ground<'_>,
    ) -> Option<()> {
        if members.all.len() > GROUP_MAX {
            let message = format!("a group of {}", counted(members.all.len(), "robot"));
            let hint = Some("cut it into several groups".to_owned());
            let expected = format!("at most {GROUP_MAX} robots");
            self.findings.add(Code::TooMuch, group.place.clone(), message, expected, hint);
            return None;
        }
        let dancers = self.dancers(cue, group, members, time, ground)?;
        let ways = match &group.action {
            Action::Sweep(sweep) => self.swept(group, sweep, &dancers, cue.tolerance, ground)?,
            Action::Form(form) => self.formed(cue, group, form, &dancers, ground)?,
        };
        for (dancer, moved) in dancers.iter().zip(ways) {
            self.dance(cue, group, time, dancer, &moved);
        }
        Some(())
    }

    /// The robots with where they are when the cue begins for each of them.
    fn dancers(
        &mut self,
        cue: &Cue,
        group: &Together,
        members: &Members,
        time: &CueTime,
        ground: &Ground<'_>,
    ) -> Option<Vec<Dancer<'a>>> {
        let cast = self.cast;
        let (mut dancers, mut without, mut unknown) = (Vec::new(), Vec::new(), Vec::new());
        for member in &members.all {
            let robot = &cast.fleet.robots[member.robot];
            let axes =
                robot.body.as_ref().and_then(|body| Some((body, axes(body, cast.devices(member.robot))?)));
            let Some((body, axes)) = axes else {
                without.push(member.robot);
                continue;
            };
            let begin = time.start + member.delay;
            let at = |axis: &Axis<'_>| self.standing(member.robot, axis, begin, ground.positions);
            match axes.each_ref().map(at) {
                [Some(x), Some(y), Some(z)] => {
                    dancers.push(Dancer { member: *member, body, axes, from: [x, y, z] });
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

    /// Each robot's way into a formation, with how much later it begins, in seconds.
    fn formed(
        &mut self,
        cue: &Cue,
        group: &Together,
        form: &Form,
        dancers: &[Dancer<'_>],
        ground: &Ground<'_>,
    ) -> Option<Vec<Moved>> {
        let (goals, own) = match &form.to {
            Target::Home => (self.homes(group, dancers)?, true),
            Target::Formation(name) => {
                let places = self.places(group, name, dancers.len(), ground)?;
                if !self.reaches(group, name, dancers, &places) {
                    return None;
                }
                let places = settable(level(places, dancers), dancers);
                if self.tell_crowded(group, name, dancers, &places) {
                    return None;
                }
                (places, false)
            }
        };
        let spare = match form.spare {
            Some(Spare::Home) if !own && goals.len() < dancers.len() => self.homes(group, dancers)?,
            _ => dancers.iter().map(|dancer| dancer.from).collect(),
        };
        let bodies = self.bodies(cue, dancers, &goals);
        let over = group.over.as_millis_f64() / 1_000.0;
        let goals = if own { transit::Goals::Own(&goals) } else { transit::Goals::Any(&goals, &spare) };
        let crossing = transit::Crossing { bodies: &bodies, goals, least: form.least, over };
        match transit::cross(&crossing) {
            Ok(ways) => {
                Some(ways.into_iter().zip(dancers).map(|(way, dancer)| Moved::of_way(&way, dancer)).collect())
            }
            Err(refused) => {
                self.tell_refused(cue, group, form, dancers, &refused);
                None
            }
        }
    }

    /// The places of a formation, as many as there are robots or a choice is made.
    fn places(
        &mut self,
        group: &Together,
        name: &str,
        robots: usize,
        ground: &Ground<'_>,
    ) -> Option<Vec<Point>> {
        let Action::Form(form) = &group.action else { return None };
        let Some(written) = ground.formations.get(name) else {
            let mut known: Vec<&str> = ground.formations.keys().map(String::as_str).collect();
            known.push("home");
            known.sort_unstable();
            let hint = self.findings.did_you_mean(name, known.iter().copied());
            let message = format!("no formation `{}`", shortened(name));
            self.findings.add(Code::UnknownFormation, group.place.clone(), message, one_of(known), hint);
            return None;
        };
        // What is wrong with a formation or makes it too large is told where it stands.
        let mut places = written.formation.as_ref()?.places(robots).ok()?;
        match (places.len().cmp(&robots), form.spare, form.thin) {
            (Ordering::Less, None, _) | (Ordering::Greater, _, None) => {
                self.tell_count(group, name, robots, places.len());
                return None;
            }
            (Ordering::Greater, _, Some(Thin::Evenly)) => {
                let all = places.len();
                places = (0..robots).map(|index| places[index * all / robots]).collect();
            }
            _ => {}
        }
        Some(places)
    }

    /// Whether all robots can be at the heights of the places.
    fn reaches(&mut self, group: &Together, name: &str, dancers: &[Dancer<'_>], places: &[Point]) -> bool {
        let differ = |height: f64| places.iter().any(|place| (place[2] - height).abs() > LEVEL);
        let all_flat = dancers.iter().all(Dancer::is_flat);
        // Robots that are all flat take a level formation to their own height.
        let cannot = |dancer: &&Dancer<'_>| {
            let height = if all_flat { places[0][2] } else { dancer.from[2] };
            dancer.is_flat() && differ(height)
        };
        let flat = dancers.iter().find(cannot);
        if let Some(dancer) = flat {
            let what = match differ(places[0][2]) {
                true => format!("the places of `{}` differ in height", shortened(name)),
                false => format!("the places of `{}` are at another height", shortened(name)),
            };
            self.tell_flat(group, &what, dancer.member.robot);
        }
        flat.is_none()
    }

    /// Where the devices of each robot are in its default state.
    fn homes(&mut self, group: &Together, dancers: &[Dancer<'_>]) -> Option<Vec<Point>> {
        let of_axis = |axis: &Axis<'_>| match *axis {
            Axis::Fixed(value) => Some(value),
            Axis::Moved { device, scale, offset, .. } => {
                device.default_value.map(|value| offset + scale * value)
            }
        };
        let homes: Vec<Option<Point>> = dancers
            .iter()
            .map(|dancer| match dancer.axes.each_ref().map(of_axis) {
                [Some(x), Some(y), Some(z)] => Some([x, y, z]),
                _ => None,
            })
            .collect();
        let homeless = dancers.iter().zip(&homes).filter(|(_, home)| home.is_none());
        let homeless: Vec<usize> = homeless.map(|(dancer, _)| dancer.member.robot).collect();
        if !homeless.is_empty() {
            self.tell_homeless(group, &homeless);
        }
        homes.into_iter().collect()
    }

    fn bodies(&self, cue: &Cue, dancers: &[Dancer<'_>], goals: &[Point]) -> Vec<transit::Body> {
        let space = &self.cast.fleet.space;
        let apart = space.distance.unwrap_or(0.0) / 2.0;
        let heights = dancers.iter().map(|dancer| dancer.from[2]).chain(goals.iter().map(|goal| goal[2]));
        let lowest = heights.fold(f64::INFINITY, f64::min);
        let body = |dancer: &Dancer<'_>| {
            let radius = dancer.radius();
            let [x, y, z] = dancer.axes.each_ref().map(|axis| axis.error(cue.tolerance));
            let keep_in = space.keep_in.as_ref().map_or(f64::INFINITY, |volume| volume.most[2] - radius);
            transit::Body {
                from: dancer.from,
                keep: apart + radius + x.hypot(y).hypot(z),
                begin: dancer.member.delay.as_millis_f64() / 1_000.0,
                limits: self.limits(dancer),
                heights: dancer.axes[2].ends().map(|[low, high]| [low.max(lowest), high.min(keep_in)]),
            }
        };
        dancers.iter().map(body).collect()
    }

    /// How fast a robot may be along each axis, and altogether.
    fn limits(&self, dancer: &Dancer<'_>) -> transit::Limits {
        let of_axis = |axis: &Axis<'_>| {
            let Axis::Moved { device, scale, .. } = axis else { return [f64::INFINITY; 2] };
            let limits = self.cast.limits(dancer.member.robot, device, ControlType::Position);
            [limits.speed, limits.acceleration]
                .map(|limit| limit.map_or(f64::INFINITY, |limit| limit * scale.abs()))
        };
        let body = [dancer.body.speed, dancer.body.acceleration].map(|limit| limit.unwrap_or(f64::INFINITY));
        transit::Limits { axes: dancer.axes.each_ref().map(of_axis), body }
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
            let robots = [dancer.member.robot];
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
            self.segments.entry((dancer.member.robot, index)).or_default().push(segment);
        }
    }
}

/// The places at the height of the robots, if none of these can change it.
fn level(mut places: Vec<Point>, dancers: &[Dancer<'_>]) -> Vec<Point> {
    if let Some(first) = dancers.first()
        && dancers.iter().all(|dancer| dancer.is_flat())
    {
        places.iter_mut().for_each(|place| place[2] = first.from[2]);
    }
    places
}

/// The places to which the devices can be set, if they are the same for all robots: ways are judged to where they end.
fn settable(mut places: Vec<Point>, dancers: &[Dancer<'_>]) -> Vec<Point> {
    let grids = |dancer: &Dancer<'_>| dancer.axes.each_ref().map(Axis::grid);
    let Some(first) = dancers.first() else { return places };
    if dancers.iter().all(|dancer| grids(dancer) == grids(first)) {
        for place in &mut places {
            *place = std::array::from_fn(|axis| first.axes[axis].nearest(place[axis]));
        }
    }
    places
}

/// How one robot moves.
struct Moved {
    /// In seconds since the cue's start.
    begin: f64,
    length: f64,
    /// x, y and z in metres.
    axes: [Swept; 3],
}

impl Moved {
    fn of_way(way: &transit::Way, dancer: &Dancer<'_>) -> Self {
        let lifts = [0.0, 0.0, 4.0 * way.lift];
        let axes = std::array::from_fn(|axis| {
            let (from, lift) = (way.from[axis], lifts[axis]);
            let to = dancer.axes[axis].nearest(way.to[axis]);
            Swept { line: [from, to - from + lift, -lift], ..Swept::default() }
        });
        Self { begin: way.begin, length: way.length, axes }
    }
}

/// x, y and z of a body; none if x or y is no device, or if speeds drive it.
fn axes<'a>(body: &Body, devices: &'a [Device]) -> Option<[Axis<'a>; 3]> {
    if body.drive.is_some() {
        return None;
    }
    let axis = |coordinate: &Coordinate| match coordinate {
        Coordinate::Fixed(value) => Some(Axis::Fixed(*value)),
        Coordinate::Device { device, scale, offset } => {
            let index = devices.iter().position(|other| other.id == *device)?;
            Some(Axis::Moved { index, device: &devices[index], scale: *scale, offset: *offset })
        }
    };
    let [x, y, z, _] = &body.coordinates;
    let axes = [axis(x)?, axis(y)?, axis(z)?];
    axes[..2].iter().all(|axis| matches!(axis, Axis::Moved { .. })).then_some(axes)
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
