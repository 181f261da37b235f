//! What the cues do with one device, joined into one chain of scripts.

use std::collections::{BTreeMap, HashMap};

use urrcp::{ControlType, Device, Interpolation, Millis, Script, Setpoint, Span, Step, StopCondition};

use super::cast::{Cast, Left, Rest};
use super::conflict::told;
use super::jumps::{First, Moved, Mover, Position};
use super::perform::capacity;
use super::segment::{Excess, Segment, Steps};
use super::together::{Together, Told};
use crate::budget::Budget;
use crate::duration::written;
use crate::fields::Reader;
use crate::finding::Code;
use crate::fleet::ClockMode;
use crate::plan::{DeviceScript, DeviceUse, RobotPlan, is_rate};
use crate::render::counted;
use crate::scenario::Scenario;

/// An act's scripts, how they came about, and where they leave the devices.
pub(super) struct Joined {
    pub(super) robots: Vec<RobotPlan>,
    pub(super) devices: Vec<DeviceUse>,
    pub(super) rest: Rest,
    /// Where devices are left.
    pub(super) places: Moved,
    /// The first segment of each device.
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
    let mut together = Together::default();
    for ((robot, index), mut segments) in segments {
        segments.sort_by_key(Segment::start);
        let device = &cast.devices(robot)[index];
        let speed = cast.limits(robot, device, ControlType::Position).speed;
        let corrected = cast.fleet.robots[robot].mission.clock == ClockMode::Measured;
        let longest = (corrected && device.script_queue > 1).then_some(CORRECTED_EVERY);
        let lane = Lane { scenario, robot: cast.id(robot), device, speed, longest, segments: &segments };
        lane.check_overlaps(&mut together);
        lane.check_jumps(&mut together);
        joined.first.extend(lane.segments.first().map(|first| First {
            robot,
            index,
            segment: first.clone(),
        }));
        lane.check_left_in_motion(&mut together);
        let Some((scripts, used)) = lane.scripts(findings) else { continue };
        joined.rest.insert((robot, index), Left::at(lane.last_value()));
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

/// One device of one robot, with everything that it does in an act.
struct Lane<'a> {
    scenario: &'a Scenario,
    robot: &'a urrcp::RobotId,
    device: &'a Device,
    /// Its largest speed, driven by position.
    speed: Option<f64>,
    /// The longest scripts, if the next one can be sent while one plays.
    longest: Option<Span>,
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

    /// Reports jumps from one cue of the act to the next.
    fn check_jumps(&self, together: &mut Together) {
        let mover = Mover { robot: self.robot, device: self.device, speed: self.speed };
        let mut position: Option<Position> = None;
        for segment in self.segments {
            let Steps::One(values) = &segment.part.steps else { return };
            if !self.moves() || segment.part.control_type != ControlType::Position {
                return;
            }
            let Some(last) = values.last() else { continue };
            if let Some(from) = &position {
                mover.arrives(together, segment, from);
            }
            let whence = format!("where `{}` leaves it", segment.cue);
            position = Some(Position { value: last.to, since: segment.end(), whence, is_sure: true });
        }
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

    fn last_position(&self) -> Option<f64> {
        let by_position = self.segments.last()?.part.control_type == ControlType::Position;
        self.last_value().filter(|_| by_position)
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

    /// As many scripts as needed.
    fn scripts(&self, findings: &mut Reader) -> Option<(Vec<DeviceScript>, DeviceUse)> {
        let start = self.segments.first()?.start();
        let script = self.device.available_control_types.script()?;
        let most = script.max_number_of_steps.max(1) as usize;
        let steps = self.count();
        let count = steps.div_ceil(most).max(1);
        let queue = self.device.script_queue.max(1) as usize;
        if count <= queue || queue > 1 {
            let all = self.steps();
            let at_rests = self.longest.map(|longest| cuts(&all, most, self.moves(), longest));
            for cuts in at_rests.into_iter().chain([every(most, all.len())]) {
                let scripts = self.split(&all, &cuts, start)?;
                if can_be_refilled(&scripts, queue) {
                    let used = self.used(all.len(), scripts.len(), most);
                    return Some((scripts, used));
                }
            }
        }
        self.too_many(findings, steps, most, count);
        let last = self.last_step();
        let used = self.used(last.len(), count, most);
        Some((self.split(&last, &[last.len()], start)?, used))
    }

    /// Cuts steps into scripts. Each index in `cuts` is that of the first step after a script.
    fn split(&self, steps: &[Step], cuts: &[usize], start: Span) -> Option<Vec<DeviceScript>> {
        let mut scripts = Vec::with_capacity(cuts.len());
        let mut from = 0;
        for &to in cuts {
            let begin = match from {
                0 => start,
                // Two scripts of a device never begin at the same instant.
                from if self.moves() && to - from == 1 => steps[from - 1].offset.span(),
                from => self.begin_after(&steps[from - 1], &steps[from]),
            };
            let relative =
                |step: &Step| Step { offset: Millis::from_span(step.offset.span() - begin), ..step.clone() };
            // Times out of order have been found already; then there is no plan.
            let script = Script::new(steps[from..to].iter().map(relative).collect()).ok()?;
            scripts.push(DeviceScript {
                device: self.device.id.clone(),
                start: Millis::from_span(begin),
                stop_condition: self.stop_condition(),
                script,
            });
            from = to;
        }
        Some(scripts)
    }

    /// When a script begins that continues after `last` with `next`. If the value does not change until then, it begins with
    /// that step: the pause leaves room for a start that is corrected because the robot's clock has drifted. Otherwise it begins
    /// where the script before it ends.
    fn begin_after(&self, last: &Step, next: &Step) -> Span {
        match rests(last, next, self.moves()) {
            true => next.offset.span(),
            false => last.offset.span(),
        }
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
            speed_max: self.speed,
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

/// Whether a device keeps its value from one step to the next one.
fn rests(last: &Step, next: &Step, moves: bool) -> bool {
    let is_position = |step: &Step| step.setpoint.control_type == ControlType::Position;
    is_position(last) && is_position(next) && (!moves || last.setpoint == next.setpoint)
}

/// A robot's clock that is measured may drift by 50 ppm, like any quartz clock: by 1.5 ms in this time. Scripts no longer than
/// this are corrected for the drift one after the other.
const CORRECTED_EVERY: Span = Span::from_millis(30_000);

/// Where to cut steps into scripts of at most `most` steps and about this length: at the last rest in the second half of a script,
/// if there is one.
fn cuts(steps: &[Step], most: usize, moves: bool, longest: Span) -> Vec<usize> {
    let mut cuts = Vec::with_capacity(steps.len().div_ceil(most));
    let mut from: usize = 0;
    loop {
        // A script begins where the one before ends.
        let begin = steps.get(from.saturating_sub(1)).map_or(Span::ZERO, |step| step.offset.span());
        // All scripts that are left are of about the same length, so that the last one is not a short one.
        let left = steps.last().map_or(Span::ZERO, |last| last.offset.span() - begin);
        let length =
            left / (left + longest - Span::from_nanos(1)).as_nanos().div_euclid(longest.as_nanos()).max(1);
        let end = (from + most).min(steps.len());
        let in_time = steps[from..end].partition_point(|step| step.offset.span() - begin <= length);
        let last = from + in_time.max(1);
        if last >= steps.len() {
            cuts.push(steps.len());
            return cuts;
        }
        let is_rest = |cut: &usize| rests(&steps[cut - 1], &steps[*cut], moves);
        from = (from + (last - from).div_ceil(2)..=last).rev().find(is_rest).unwrap_or(last);
        cuts.push(from);
    }
}

/// The same after every `most` steps.
fn every(most: usize, steps: usize) -> Vec<usize> {
    (1..=steps.div_ceil(most).max(1)).map(|count| (count * most).min(steps)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(of: &[(i64, f64)]) -> Vec<Step> {
        let step = |&(seconds, value): &(i64, f64)| Step {
            offset: Millis::from_span(Span::from_millis(seconds * 1_000)),
            setpoint: Setpoint::new(ControlType::Position, value),
            stop_condition: None,
        };
        of.iter().map(step).collect()
    }

    fn lengths(of: &[(i64, f64)], most: usize, moves: bool) -> Vec<usize> {
        let cuts = cuts(&steps(of), most, moves, Span::from_millis(30_000));
        cuts.iter().scan(0, |before, cut| Some(cut - std::mem::replace(before, *cut))).collect()
    }

    #[test]
    fn movements_are_cut_at_rests_into_scripts_of_about_one_length() {
        let ramp: Vec<_> = (0..=60).map(|at| (at, at as f64)).collect();
        assert_eq!(lengths(&ramp, 100, true), [31, 30], "without a rest");
        assert_eq!(lengths(&ramp[..32], 100, true), [16, 16], "the last script is not a short one");
        assert_eq!(lengths(&ramp, 20, true), [20, 20, 20, 1], "as many steps as a script takes");
        let mut rests = ramp.clone();
        rests[20].1 = rests[19].1;
        assert_eq!(lengths(&rests, 100, true), [20, 20, 21], "at a rest");
        assert_eq!(lengths(&ramp, 100, false), [31, 30], "a device that holds rests everywhere");
        assert_eq!(lengths(&ramp[..1], 100, true), [1]);
        assert_eq!(lengths(&[], 100, true), [0]);
        assert_eq!(lengths(&[(0, 0.0), (100, 1.0), (200, 0.0)], 100, true), [1, 1, 1], "long steps");
    }
}
