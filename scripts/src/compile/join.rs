//! What the cues do with one device, joined into one chain of scripts.

use std::collections::{BTreeMap, HashMap};

use urrcp::{
    ControlType, Device, DeviceId, Interpolation, Millis, Script, Setpoint, Span, Step, StopCondition,
};

use super::cast::{Cast, Left, Positions, Rest};
use super::conflict::told;
use super::perform::capacity;
use super::segment::{Excess, Segment, Steps};
use super::together::{Together, Told};
use crate::budget::Budget;
use crate::duration::{seconds, written};
use crate::fields::Reader;
use crate::finding::Code;
use crate::motion::Value;
use crate::plan::{DeviceScript, DeviceUse, RobotPlan, is_rate};
use crate::render::counted;
use crate::scenario::{Items, Scenario};

/// An act's scripts, how they came about, and where they leave the devices.
pub(super) struct Joined {
    pub(super) robots: Vec<RobotPlan>,
    pub(super) devices: Vec<DeviceUse>,
    pub(super) rest: Rest,
}

pub(super) fn join(
    findings: &mut Reader,
    scenario: &Scenario,
    cast: &Cast<'_>,
    segments: BTreeMap<(usize, usize), Vec<Segment>>,
    positions: &Positions<'_>,
    room: &mut Budget,
) -> Joined {
    let mut joined = Joined { robots: Vec::new(), devices: Vec::new(), rest: HashMap::new() };
    if !taken(findings, cast, &segments, room) {
        return joined;
    }
    let mut last_robot = None;
    let mut together = Together::default();
    for ((robot, index), mut segments) in segments {
        segments.sort_by_key(Segment::start);
        let device = &cast.devices(robot)[index];
        let speed = cast.limits(robot, device, ControlType::Position).speed;
        let lane = Lane { scenario, robot: cast.id(robot), device, speed, segments: &segments };
        lane.check_overlaps(&mut together);
        lane.check_jumps(&mut together, positions.of(robot, index));
        lane.check_left_in_motion(&mut together);
        let Some((scripts, used)) = lane.scripts(findings) else { continue };
        joined.rest.insert((robot, index), Left::at(lane.last_value()));
        if last_robot != Some(robot) {
            joined.robots.push(RobotPlan { robot: cast.id(robot).clone(), scripts: Vec::new() });
            last_robot = Some(robot);
        }
        if let Some(plan) = joined.robots.last_mut() {
            plan.scripts.extend(scripts);
        }
        joined.devices.push(used);
    }
    together.tell(findings);
    joined
}

/// Whether there is room for the steps of an act. What its device does not take is never made.
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
        let message = format!("with the {all} steps of this act there are too many for one scenario");
        let hint = Some("cut the scenario into several".to_owned());
        let expected = format!("at most {}", room.most());
        findings.add(Code::TooMuch, first.part.place.clone(), message, expected, hint);
    }
    sound
}

/// Where a device is when a cue begins.
struct Position {
    value: f64,
    /// Since when.
    since: Span,
    whence: String,
    sure: Sure,
}

/// How sure that is.
#[derive(Clone, Copy)]
enum Sure {
    /// A cue of the same act has moved it there.
    Told,
    /// Its description says so, or the act before.
    Assumed,
}

/// One device of one robot, with everything that it does in an act.
struct Lane<'a> {
    scenario: &'a Scenario,
    robot: &'a urrcp::RobotId,
    device: &'a Device,
    /// Its largest speed, driven by position.
    speed: Option<f64>,
    segments: &'a [Segment],
}

impl Lane<'_> {
    fn moves(&self) -> bool {
        self.device.interpolation == Interpolation::Linear
    }

    /// `elbow` of `left`, as a name in a list.
    fn who(&self) -> String {
        format!("{}` of `{}", self.device.id, self.robot)
    }

    fn check_overlaps(&self, together: &mut Together) {
        let mut latest: Option<&Segment> = None;
        for segment in self.segments {
            if let Some(before) = latest.filter(|before| segment.start() < before.end()) {
                self.overlap(together, segment, before);
            }
            latest = latest.filter(|before| before.end() > segment.end()).or(Some(segment));
        }
    }

    fn overlap(&self, together: &mut Together, segment: &Segment, before: &Segment) {
        let later = before.end() - segment.start();
        together.add(Told {
            code: Code::Overlap,
            cause: format!("{}\n{}", segment.cue, before.cue),
            size: later.as_millis_f64(),
            who: self.who(),
            place: segment.part.place.clone(),
            message: format!(
                "`{}` moves `{}` of `{}` from {} on, but `{}` moves it until {}",
                segment.cue,
                self.device.id,
                self.robot,
                told(segment.start()),
                before.cue,
                told(before.end())
            ),
            expected: format!("a start at {} or later", told(before.end())),
            hint: Some(format!(
                "start `{}` {} later, as with `after: {}`",
                segment.cue,
                written(later),
                before.cue
            )),
        });
    }

    /// A device that moves linearly, told to be somewhere else at once.
    fn check_jumps(&self, together: &mut Together, begin: Option<f64>) {
        let whence = "where it is when the act begins".to_owned();
        let mut position =
            begin.map(|value| Position { value, since: Span::ZERO, whence, sure: Sure::Assumed });
        for segment in self.segments {
            let Steps::One(values) = &segment.part.steps else { return };
            let position_control = segment.part.control_type == ControlType::Position;
            if !self.moves() || !position_control {
                return;
            }
            let (Some(first), Some(last)) = (values.first(), values.last()) else { continue };
            // A segment that overlaps the previous one is reported already.
            if let Some(from) = position.as_ref().filter(|from| segment.start() >= from.since) {
                let way = (first.to - from.value).abs();
                match segment.part.moves_from_anywhere {
                    true => self.check_way_there(together, segment, from, first),
                    false if way > segment.part.tolerance.max(1e-9) => {
                        self.jump(together, segment, from, first);
                    }
                    false => {}
                }
            }
            let whence = format!("where `{}` leaves it", segment.cue);
            position = Some(Position { value: last.to, since: segment.end(), whence, sure: Sure::Told });
        }
    }

    /// Where the device is moved to by a cue of the act it has to be in time; of where it is at the act's start only what
    /// its description says is known.
    fn code_of(&self, from: &Position) -> Code {
        match from.sure {
            Sure::Told if self.speed.is_some() => Code::TooFast,
            _ => Code::Jump,
        }
    }

    fn jump(&self, together: &mut Together, segment: &Segment, position: &Position, first: &Value) {
        let at = segment.begin + first.at;
        let (device, robot, to, from) = (&self.device.id, self.robot, first.to, position.value);
        let whence = &position.whence;
        let needed = self.speed.map(|speed| seconds((to - from).abs() / speed));
        let hint = match (segment.part.items, needed) {
            (Items::Keyframes, Some(needed)) => {
                format!("put the first keyframe at {needed} or later: it is reached by moving there")
            }
            (Items::Keyframes, None) => {
                "a first keyframe later than 0s is reached by moving there".to_owned()
            }
            (_, Some(needed)) => format!("let a cue before it move there, which takes {needed} or more"),
            (_, None) => "let a cue before it move there".to_owned(),
        };
        let expected = match segment.part.items {
            Items::Keyframes => format!("a first keyframe of {from}, or one later than 0s"),
            _ => format!("a movement that begins at {from}"),
        };
        together.add(Told {
            code: self.code_of(position),
            cause: format!("{:?}\n{from} {to} {whence}", segment.part.place),
            size: (to - from).abs(),
            who: self.who(),
            place: segment.part.place.clone(),
            message: format!("`{device}` of `{robot}` has to jump from {from}, {whence}, to {to} at {at}"),
            expected,
            hint: Some(hint),
        });
    }

    /// The way to a first keyframe later than 0s, from where the device is.
    fn check_way_there(
        &self,
        together: &mut Together,
        segment: &Segment,
        position: &Position,
        first: &Value,
    ) {
        let (from, length) = (position.value, first.at.as_millis_f64() / 1_000.0);
        let needed = (first.to - from).abs() / length;
        let Some(speed) = self.speed.filter(|speed| needed > speed * (1.0 + 1e-6)) else { return };
        together.add(Told {
            code: self.code_of(position),
            cause: format!("{:?}\n{from} {} way", segment.part.place, first.to),
            size: needed,
            who: self.who(),
            place: segment.part.place.clone(),
            message: format!(
                "`{}` of `{}` has {} to get from {from} to its first keyframe, {}: a speed of {needed:.4}",
                self.device.id, self.robot, first.at, first.to
            ),
            expected: format!("at most {speed}"),
            hint: Some(format!("put the first keyframe at {} or later", seconds(length * needed / speed))),
        });
    }

    /// A rate that nothing ends: neither a last step of the resting value nor a lease.
    fn check_left_in_motion(&self, together: &mut Together) {
        let Some(last) = self.segments.last() else { return };
        let value = match &last.part.steps {
            Steps::One(values) => values.last().map(|value| value.to),
            Steps::Several(_) => None,
        };
        let resting = self.device.default_value.unwrap_or(0.0);
        let lease = self.stop_condition().running;
        if let Some(value) = value.filter(|value| *value != resting)
            && is_rate(last.part.control_type)
            && lease.is_none()
        {
            together.add(Told {
                code: Code::LeftInMotion,
                cause: format!("{:?}\n{value} {resting}", last.part.place),
                size: 0.0,
                who: self.who(),
                place: last.part.place.clone(),
                message: format!(
                    "`{}` of `{}` is left at {} {value} at the end, and no stop_condition ends it",
                    self.device.id, self.robot, last.part.control_type
                ),
                expected: format!("a last value of {resting}"),
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

    /// Every step with its time from the act's start.
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

    /// Stands for steps that are too many: the act still has its length.
    fn last_step(&self) -> Vec<Step> {
        let last = self.segments.iter().max_by_key(|segment| segment.end());
        let step = last.and_then(|last| {
            let (offset, setpoint) = (Millis::from_span(last.end()), last.last_setpoint()?);
            Some(Step { offset, setpoint, stop_condition: None })
        });
        step.into_iter().collect()
    }

    /// A device that moves linearly would creep through the gap between two cues; this step makes it wait.
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

    /// As many steps as [`Self::steps`] makes.
    fn count(&self) -> usize {
        let own: usize = self.segments.iter().map(|segment| segment.part.steps.len()).sum();
        let held = self.segments.windows(2).filter(|pair| {
            let last = pair[0].last_setpoint();
            last.is_some_and(|last| self.is_held(pair[0].end(), &last, &pair[1]))
        });
        own + held.count()
    }

    /// As many scripts as needed, each beginning where the one before ends.
    fn scripts(&self, findings: &mut Reader) -> Option<(Vec<DeviceScript>, DeviceUse)> {
        let start = self.segments.first()?.start();
        let script = self.device.available_control_types.script()?;
        let most = script.max_number_of_steps.max(1) as usize;
        let steps = self.count();
        let count = steps.div_ceil(most).max(1);
        let queue = self.device.script_queue.max(1) as usize;
        if count <= queue || queue > 1 {
            let all = self.steps();
            let used = self.used(all.len(), count, most);
            let scripts = split(&self.device.id, all, most, start, self.stop_condition())?;
            if can_be_refilled(&scripts, queue) {
                return Some((scripts, used));
            }
        }
        self.too_many(findings, steps, most, count);
        let last = self.last_step();
        let used = self.used(last.len(), count, most);
        Some((split(&self.device.id, last, most, start, self.stop_condition())?, used))
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
        }
    }

    fn too_many(&self, findings: &mut Reader, steps: usize, most: usize, count: usize) {
        let (device, robot) = (&self.device.id, self.robot);
        let queue = self.device.script_queue.max(1);
        let place = self.segments[0].part.place.clone();
        let over = steps - most * queue as usize;
        let longest = self.segments.iter().max_by_key(|segment| segment.part.steps.len());
        let less = match longest.map(|segment| (segment.part.excess, &segment.cue)) {
            Some((Excess::Turns, cue)) => format!("`{cue}` repeats it: repeat it less often"),
            Some((Excess::Curve, _)) => format!("save {}", counted(over, "step")),
            _ => format!("take out {}", counted(over, "keyframe")),
        };
        let hint = format!("{less}, allow a larger error with `tolerance`, or cut the scenario into acts");
        let (code, message, expected) = match queue {
            1 => (
                Code::TooManySteps,
                format!("the script for `{device}` of `{robot}` has {steps} steps"),
                format!("at most {most} steps (max_number_of_steps)"),
            ),
            _ => (
                Code::QueueTooShort,
                format!("`{device}` of `{robot}` needs {count} scripts for its {steps} steps"),
                format!(
                    "at most {queue} scripts (script_queue) of {most} steps (max_number_of_steps), or scripts that leave {REFILL} to send the next"
                ),
            ),
        };
        findings.add(code, place, message, expected, Some(hint));
    }
}

/// While a script plays the one behind those that the device holds is sent; that long it may take.
const REFILL: Span = Span::from_millis(1_000);

/// Whether every script that the device cannot hold from the start can be sent in time: when one has ended there is room,
/// and those that it still holds play long enough.
fn can_be_refilled(scripts: &[DeviceScript], queue: usize) -> bool {
    let end = |script: &DeviceScript| script.start.span() + script.script.duration();
    scripts.len() <= queue
        || scripts.windows(queue + 1).all(|held| held[queue].start.span() - end(&held[0]) >= REFILL)
}

/// Cuts steps into scripts without a gap: each begins when the one before ends.
fn split(
    device: &DeviceId,
    steps: Vec<Step>,
    most: usize,
    start: Span,
    stop_condition: StopCondition,
) -> Option<Vec<DeviceScript>> {
    let mut scripts = Vec::with_capacity(steps.len().div_ceil(most));
    let mut begin = start;
    let mut add = |mut steps: Vec<Step>| {
        let end = steps.last().map_or(begin, |step| step.offset.span());
        for step in &mut steps {
            step.offset = Millis::from_span(step.offset.span() - begin);
        }
        // Times out of order have been found already; then there is no plan.
        let script = Script::new(steps).ok()?;
        scripts.push(DeviceScript {
            device: device.clone(),
            start: Millis::from_span(begin),
            stop_condition,
            script,
        });
        begin = end;
        Some(())
    };
    if steps.len() <= most {
        add(steps)?;
        return Some(scripts);
    }
    let mut steps = steps.into_iter();
    while steps.len() > 0 {
        add(steps.by_ref().take(most).collect())?;
    }
    Some(scripts)
}
