//! Joins one device's movements from all cues of an act into one chain of scripts.

use std::collections::{BTreeMap, HashMap};

use urrcp::{ControlType, Device, Interpolation, Millis, Setpoint, Span, Step, StopCondition};

use super::cast::{Cast, Left, Rest};
use super::cut::{
    CORRECTED_EVERY, Cutting, REFILL, can_be_refilled, cuts, divided, every, longest_corrected,
};
use super::jumps::{FinalPositions, First, Mover, Position};
use super::overlap;
use super::perform::capacity;
use super::segment::{Excess, Segment, Steps};
use crate::budget::Budget;
use crate::fields::Reader;
use crate::finding::{Code, SharedFault};
use crate::fleet::ClockMode;
use crate::plan::{DeviceScript, DeviceUse, RobotPlan, is_rate};
use crate::render::counted;
use crate::scenario::Scenario;
use crate::space::Coordinate;

/// An act's scripts, statistics about them, and the resulting positions of devices.
pub(super) struct Joined {
    pub(super) robots: Vec<RobotPlan>,
    pub(super) devices: Vec<DeviceUse>,
    pub(super) rest: Rest,
    /// Final positions of the moved devices.
    pub(super) places: FinalPositions,
    /// The first segment of each device in the act.
    pub(super) first: Vec<First>,
}

pub(super) fn join(
    findings: &mut Reader,
    scenario: &Scenario,
    cast: &Cast<'_>,
    segments: BTreeMap<(usize, usize), Vec<Segment>>,
    room: &mut Budget,
) -> Joined {
    let mut joined = Joined {
        robots: Vec::new(),
        devices: Vec::new(),
        rest: HashMap::new(),
        places: HashMap::new(),
        first: Vec::new(),
    };
    if !taken(findings, cast, &segments, room) {
        return joined;
    }
    let mut last_robot = None;
    for ((robot, index), mut segments) in segments {
        segments.sort_by_key(|segment| (segment.start(), segment.end()));
        let device = &cast.devices(robot)[index];
        let speed = cast.limits(robot, device, ControlType::Position).speed;
        let corrected = cast.fleet.robots[robot].mission.clock == ClockMode::Measured;
        let longest =
            (corrected && device.script_queue > 1).then(|| longest_corrected(scenario.start_tolerance));
        let is_limited = speed.is_some() || moves_limited_body(cast, robot, device);
        let id = cast.id(robot);
        let lane = Lane { scenario, robot: id, device, speed, is_limited, longest, segments: &segments };
        lane.check_overlaps(findings);
        let factor_max = lane.check_jumps(findings);
        joined.first.extend(lane.segments.first().map(|first| First {
            robot,
            index,
            segment: first.clone(),
        }));
        lane.check_left_in_motion(findings);
        let Some((scripts, mut used)) = lane.scripts(findings) else { continue };
        used.factor_max = used.factor_max.min(factor_max);
        joined.rest.insert((robot, index), Left::at(lane.rest()));
        joined.places.insert((robot, index), lane.last_position());
        if last_robot != Some(robot) {
            joined.robots.push(RobotPlan { robot: cast.id(robot).clone(), scripts: Vec::new() });
            last_robot = Some(robot);
        }
        if let Some(plan) = joined.robots.last_mut() {
            plan.scripts.extend(scripts);
        }
        joined.devices.push(used);
    }
    joined
}

/// Whether the budget has room for the steps of an act. Steps beyond the capacity of a device do not count, because they are never
/// created.
fn taken(
    findings: &mut Reader,
    cast: &Cast<'_>,
    segments: &BTreeMap<(usize, usize), Vec<Segment>>,
    room: &mut Budget,
) -> bool {
    let size = |(&(robot, index), segments): (&(usize, usize), &Vec<Segment>)| {
        let steps = segments.iter().map(|segment| segment.part.steps.len()).sum::<usize>();
        let fits = steps <= capacity(&cast.devices(robot)[index]);
        let sizes = segments.iter().map(|segment| segment.part.steps.size());
        if fits { sizes.sum() } else { 0 }
    };
    let all = segments.iter().map(size).fold(0, usize::saturating_add);
    let (told, sound) = (room.is_overdrawn(), room.take(all));
    if let (false, false, Some(first)) = (sound, told, segments.values().flatten().next()) {
        let message = format!("the scenario has too many steps: this act adds {all}");
        let hint = Some("split the scenario into several scenarios".to_owned());
        let expected = format!("at most {}", room.most());
        findings.add(Code::TooMuch, first.part.place.clone(), message, expected, hint);
    }
    sound
}

/// One device of one robot, with all its movements in an act.
struct Lane<'a> {
    scenario: &'a Scenario,
    robot: &'a urrcp::RobotId,
    device: &'a Device,
    /// The device's largest speed under position control; `None` if unlimited.
    speed: Option<f64>,
    /// Whether `speed` or the device's body limits the device.
    is_limited: bool,
    /// Maximum length of scripts; `None` if the next script cannot be sent while one plays.
    longest: Option<Span>,
    segments: &'a [Segment],
}

/// Whether a device is a coordinate of a body that has a speed limit.
fn moves_limited_body(cast: &Cast<'_>, robot: usize, device: &Device) -> bool {
    let is_own = |coordinate: &Coordinate| matches!(coordinate, Coordinate::Device { device: own, .. } if *own == device.id);
    cast.fleet.robots[robot]
        .body
        .as_ref()
        .is_some_and(|body| body.speed.is_some() && body.coordinates.iter().any(is_own))
}

impl Lane<'_> {
    fn moves(&self) -> bool {
        self.device.interpolation == Interpolation::Linear
    }

    fn is_positioned(&self) -> bool {
        self.segments.iter().any(|segment| segment.part.control_type == ControlType::Position)
    }

    fn check_overlaps(&self, findings: &mut Reader) {
        let mut latest: Option<&Segment> = None;
        for segment in self.segments {
            if let Some(before) = latest {
                let fault = overlap::of_segments(self.device, self.robot, segment, before);
                fault.into_iter().for_each(|fault| findings.add_shared(fault));
            }
            latest = latest.filter(|before| before.end() > segment.end()).or(Some(segment));
        }
    }

    /// Reports jumps of the device between cues of the act. Returns the largest show speed factor (speed of the show relative to the
    /// file) that the movements between cues permit.
    fn check_jumps(&self, findings: &mut Reader) -> f64 {
        let mover = Mover { robot: self.robot, device: self.device, speed: self.speed };
        let mut position: Option<Position> = None;
        let mut factor_max = f64::INFINITY;
        for segment in self.segments.iter().filter(|_| self.moves()) {
            let Steps::One(values) = &segment.part.steps else { return factor_max };
            if segment.part.control_type != ControlType::Position {
                position = None;
                continue;
            }
            let Some(last) = values.last() else { continue };
            if let Some(from) = &position {
                factor_max = factor_max.min(mover.arrives(findings, segment, from));
            }
            let whence = format!("where `{}` leaves it", segment.cue);
            position = Some(Position { value: last.to, since: segment.end(), whence, is_sure: true });
        }
        factor_max
    }

    /// Reports a speed or acceleration that nothing ends: there is neither a final step with the resting value nor a lease that expires.
    fn check_left_in_motion(&self, findings: &mut Reader) {
        let Some(last) = self.segments.last() else { return };
        let value = match &last.part.steps {
            Steps::One(values) => values.last().map(|value| value.to),
            Steps::Several(_) => None,
        };
        // The default value of a device that usually takes positions is a position.
        let is_usual = self.device.primary_control_type() == Some(last.part.control_type);
        let resting = self.device.default_value.filter(|_| is_usual).unwrap_or(0.0);
        let lease = self.stop_condition().running;
        if let Some(value) = value.filter(|value| *value != resting)
            && is_rate(last.part.control_type)
            && lease.is_none()
        {
            let end = format!(
                " is left at {} {value} at the end, and no `stop_condition` stops it",
                last.part.control_type
            );
            findings.add_shared(SharedFault {
                code: Code::LeftInMotion,
                cause: format!("{:?}\n{value} {resting}", last.part.place),
                size: 0.0,
                device: self.device.id.to_string(),
                robots: [self.robot.clone()].into(),
                place: last.part.place.clone(),
                message: [format!("`{}` of ", self.device.id), end],
                expected: format!("a final value of {resting}"),
                hint: Some(format!("end with {resting}, or give the cue a `stop_condition`")),
            });
        }
    }

    fn stop_condition(&self) -> StopCondition {
        match self.segments {
            [only] => only.stop_condition.unwrap_or(self.scenario.stop_condition),
            _ => self.scenario.stop_condition,
        }
    }

    fn last_value(&self) -> Option<f64> {
        match &self.segments.last()?.part.steps {
            Steps::One(values) => values.last().map(|value| value.to),
            Steps::Several(_) => None,
        }
    }

    /// Returns the device's final position. `None` if the last value is a speed or another quantity, although the device is usually
    /// controlled by position.
    fn rest(&self) -> Option<f64> {
        let control_type = self.segments.last()?.part.control_type;
        self.last_value().filter(|_| self.device.primary_control_type() == Some(control_type))
    }

    fn last_position(&self) -> Option<f64> {
        let by_position = self.segments.last()?.part.control_type == ControlType::Position;
        self.last_value().filter(|_| by_position)
    }

    /// Returns the end of the device's movements; its last step may be earlier.
    fn end(&self) -> Span {
        self.segments.iter().map(Segment::end).max().unwrap_or_default()
    }

    /// Returns all steps of the device in the act, with times since the act's start.
    fn steps(&self) -> Vec<Step> {
        let count: usize = self.segments.iter().map(|segment| segment.part.steps.len() + 1).sum();
        let mut steps: Vec<Step> = Vec::with_capacity(count);
        let several = self.segments.len() > 1;
        for segment in self.segments {
            let held = steps.last().filter(|last| self.is_held(last.offset.span(), &last.setpoint, segment));
            if let Some(last) = held {
                let (offset, setpoint) = (Millis::from_span(segment.start()), last.setpoint.clone());
                steps.push(Step { offset, setpoint, stop_condition: None });
            }
            let stop_condition = segment.stop_condition.filter(|_| several);
            let step = |at: Span, setpoint: Setpoint| Step {
                offset: Millis::from_span(segment.begin + at),
                setpoint,
                stop_condition,
            };
            let control_type = segment.part.control_type;
            match &segment.part.steps {
                Steps::One(values) => {
                    steps.extend(values.iter().map(|v| step(v.at, Setpoint::new(control_type, v.to))));
                }
                Steps::Several(vectors) => {
                    steps.extend(vectors.iter().map(|v| step(v.at, segment.part.setpoint(v.values))));
                }
            }
        }
        steps
    }

    /// Returns only the last step, for a device with too many steps, so that the act keeps its length.
    fn last_step(&self) -> Vec<Step> {
        let last = self.segments.iter().max_by_key(|segment| segment.end());
        let step = last.and_then(|last| {
            let (offset, setpoint) = (Millis::from_span(last.end()), last.last_setpoint()?);
            Some(Step { offset, setpoint, stop_condition: None })
        });
        step.into_iter().collect()
    }

    /// Whether an extra step that holds the value is needed before the next cue. Without the extra step, a linear device would creep
    /// through the gap between two cues instead of waiting.
    fn is_held(&self, at: Span, last: &Setpoint, next: &Segment) -> bool {
        let value = match &next.part.steps {
            Steps::One(values) => values.first().map(|value| value.to),
            Steps::Several(vectors) => vectors.first().and_then(|vector| vector.values.first().copied()),
        };
        self.moves()
            && next.part.control_type == last.control_type
            && next.start() > at
            && value.is_some_and(|value| next.part.moves_from_anywhere || value != last.value)
    }

    /// Returns the number of steps in [`Self::steps`] without creating them.
    fn count(&self) -> usize {
        let own: usize = self.segments.iter().map(|segment| segment.part.steps.len()).sum();
        let held = self.segments.windows(2).filter(|pair| {
            let last = pair[0].last_setpoint();
            last.is_some_and(|last| self.is_held(pair[0].end(), &last, &pair[1]))
        });
        own + held.count()
    }

    /// Divides the device's steps into as many scripts as needed.
    fn scripts(&self, findings: &mut Reader) -> Option<(Vec<DeviceScript>, DeviceUse)> {
        let start = self.segments.first()?.start();
        let script = self.device.available_control_types.script()?;
        let most = script.max_number_of_steps.max(1) as usize;
        let steps = self.count();
        let count = steps.div_ceil(most).max(1);
        let queue = self.device.script_queue.max(1) as usize;
        if count <= queue || queue > 1 {
            let all = match self.longest.filter(|_| self.moves()) {
                Some(longest) => divided(self.steps(), self.device, longest),
                None => self.steps(),
            };
            let lengths = self.longest.into_iter().flat_map(|longest| [longest, CORRECTED_EVERY]);
            let at_rests = lengths.map(|longest| cuts(&all, most, self.moves(), longest));
            for cuts in at_rests.chain([every(most, all.len())]) {
                let scripts = self.cutting().split(&all, &cuts, start)?;
                if can_be_refilled(&scripts, queue) {
                    let used = self.used(all.len(), scripts.len(), most);
                    return Some((scripts, used));
                }
            }
        }
        self.too_many(findings, steps, most, count);
        let last = self.last_step();
        let used = self.used(last.len(), count, most);
        Some((self.cutting().split(&last, &[last.len()], start)?, used))
    }

    fn cutting(&self) -> Cutting {
        let (device, moves, corrected) = (self.device.id.clone(), self.moves(), self.longest.is_some());
        Cutting { device, moves, stop_condition: self.stop_condition(), corrected, end: self.end() }
    }

    fn used(&self, steps: usize, scripts: usize, most: usize) -> DeviceUse {
        let parts = || self.segments.iter().map(|segment| (&segment.part, segment.begin));
        let worst = parts().max_by(|a, b| a.0.worst.total_cmp(&b.0.worst));
        let fitted: usize = parts().map(|(part, _)| part.steps.len()).sum();
        let at_least: usize = parts().map(|(part, _)| part.at_least).sum();
        DeviceUse {
            robot: self.robot.clone(),
            device: self.device.id.clone(),
            steps,
            at_least: at_least + (steps - fitted.min(steps)),
            scripts,
            budget: most as u64 * u64::from(self.device.script_queue.max(1)),
            worst_error: worst.map_or(0.0, |(part, _)| part.worst),
            worst_at: worst.map_or(Span::ZERO, |(part, begin)| begin + part.worst_at),
            factor_max: parts().map(|(part, _)| part.factor_max).fold(f64::INFINITY, f64::min),
            entry_factor_max: f64::INFINITY,
            speed_max: self.speed,
            is_unlimited: !self.is_limited && self.moves() && self.is_positioned(),
        }
    }

    fn too_many(&self, findings: &mut Reader, steps: usize, most: usize, count: usize) {
        let device = &self.device.id;
        let queue = self.device.script_queue.max(1);
        let place = self.segments[0].part.place.clone();
        let over = steps - most * queue as usize;
        let longest = self.segments.iter().max_by_key(|segment| segment.part.steps.len());
        let less = match longest.map(|segment| (segment.part.excess, &segment.cue)) {
            Some((Excess::Turns, cue)) => format!("reduce the number of repetitions in `{cue}`"),
            Some((Excess::Eases, _)) => "use `ease: linear`".to_owned(),
            Some((Excess::Curve, _)) => {
                format!("use {over} fewer {}", if over == 1 { "step" } else { "steps" })
            }
            _ => format!("remove {}", counted(over, "keyframe")),
        };
        let hint = format!("{less}, allow a larger error with `tolerance`, or split the scenario into acts");
        let (code, message, expected) = match queue {
            1 => (
                Code::TooManySteps,
                [format!("the script for `{device}` of "), format!(" has {steps} steps")],
                format!("at most {} (max_number_of_steps)", counted(most, "step")),
            ),
            _ => (
                Code::QueueTooShort,
                [format!("`{device}` of "), format!(" needs {count} scripts for its {steps} steps")],
                format!(
                    "at most {queue} scripts (script_queue) of {most} steps (max_number_of_steps), or scripts long enough to leave {REFILL} for sending the next one"
                ),
            ),
        };
        findings.add_shared(SharedFault {
            code,
            cause: format!("{place:?} {expected}"),
            size: over as f64,
            device: device.to_string(),
            robots: [self.robot.clone()].into(),
            place,
            message,
            expected,
            hint: Some(hint),
        });
    }
}
