//! From a scenario and a fleet to one script a device, checked against what each robot declares.

use std::collections::{BTreeMap, HashMap, HashSet};

use urrcp::{
    ControlType, Device, DeviceId, Interpolation, Millis, RobotId, Script, Span, Step, StopCondition,
};

use crate::fields::Findings;
use crate::finding::{Code, Finding, Part, Place, did_you_mean, names};
use crate::fleet::{Fleet, FleetRobot};
use crate::locate::locate;
use crate::motion::Actuator;
use crate::node;
use crate::render::counted;
use crate::scenario::{self, Cue, Keyframe, Scenario, Track};
use crate::source::Source;

/// What has to be sent for a whole scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The scenario's name.
    pub scenario: String,
    /// Largest allowed spread of starts.
    pub start_tolerance: Span,
    /// Lead time that the scenario prescribes.
    pub lead: Option<Span>,
    /// The leases; without a pending one the scheduler computes it.
    pub stop_condition: StopCondition,
    /// The robots that move, in the order of the fleet.
    pub robots: Vec<RobotPlan>,
}

/// The scripts of one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotPlan {
    /// Which.
    pub robot: RobotId,
    /// One a device, in the order of the robot's devices.
    pub scripts: Vec<DeviceScript>,
}

/// One script for one device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceScript {
    /// Which.
    pub device: DeviceId,
    /// When it starts, from the start of the scenario.
    pub start: Millis,
    /// Its leases.
    pub stop_condition: StopCondition,
    /// What it does.
    pub script: Script,
}

impl Plan {
    /// From the start of the scenario to its last step.
    #[must_use]
    pub fn duration(&self) -> Span {
        let scripts = self.robots.iter().flat_map(|robot| &robot.scripts);
        scripts.map(|script| script.start.span() + script.script.duration()).max().unwrap_or_default()
    }
}

/// What became of a scenario.
#[derive(Clone, Debug)]
pub struct Compiled {
    /// The plan; there only without errors.
    pub plan: Option<Plan>,
    /// Everything that is wrong, in the order of the file.
    pub findings: Vec<Finding>,
}

/// Reads, checks and compiles a scenario for a fleet.
#[must_use]
pub fn compile(source: &Source, fleet: &Fleet) -> Compiled {
    let document = match node::parse(source) {
        Ok(document) => document,
        Err(finding) => return Compiled { plan: None, findings: vec![finding] },
    };
    let mut findings = Findings::default();
    let scenario = scenario::read(&mut findings, &document);
    drop(document);
    let plan = scenario.map(|scenario| Compiler::new(fleet, findings_of(&mut findings)).compile(&scenario));
    let plan = plan.map(|(plan, mut found)| {
        findings.0.append(&mut found.0);
        plan
    });
    let findings = locate(source, findings.0);
    Compiled { plan: plan.filter(|_| findings.is_empty()), findings }
}

fn findings_of(findings: &mut Findings) -> Findings {
    std::mem::take(findings)
}

/// A stretch of one device's time that a cue has taken.
struct Segment {
    start: Span,
    end: Span,
    moves_from_anywhere: bool,
    stop_condition: Option<StopCondition>,
    /// Offsets from the start of the scenario.
    steps: Vec<Step>,
    cue: String,
    place: Place,
}

struct Compiler<'a> {
    fleet: &'a Fleet,
    index_of: HashMap<&'a str, usize>,
    findings: Findings,
    /// By robot and device, in the order of both.
    segments: BTreeMap<(usize, usize), Vec<Segment>>,
}

impl<'a> Compiler<'a> {
    fn new(fleet: &'a Fleet, findings: Findings) -> Self {
        let index_of = fleet.robots.iter().enumerate().map(|(i, robot)| (robot.id.as_str(), i)).collect();
        Self { fleet, index_of, findings, segments: BTreeMap::new() }
    }

    fn compile(mut self, scenario: &Scenario) -> (Plan, Findings) {
        for cue in &scenario.cues {
            let robots = self.robots_of(cue);
            for track in &cue.tracks {
                self.track(cue, track, &robots);
            }
        }
        let mut robots: BTreeMap<usize, Vec<DeviceScript>> = BTreeMap::new();
        for ((robot, device), segments) in std::mem::take(&mut self.segments) {
            let script = self.script(scenario, robot, device, segments);
            robots.entry(robot).or_default().extend(script);
        }
        let robots = robots
            .into_iter()
            .map(|(index, scripts)| RobotPlan { robot: self.fleet.robots[index].id.clone(), scripts })
            .collect();
        let plan = Plan {
            scenario: scenario.name.clone(),
            start_tolerance: scenario.start_tolerance,
            lead: scenario.lead,
            stop_condition: scenario.stop_condition,
            robots,
        };
        (plan, self.findings)
    }

    /// The robots that a cue names, groups resolved, each once.
    fn robots_of(&mut self, cue: &Cue) -> Vec<usize> {
        let mut robots = Vec::new();
        let mut seen = HashSet::new();
        for (name, place) in &cue.robots {
            let members: Vec<usize> = match (self.index_of.get(name.as_str()), self.fleet.groups.get(name)) {
                (Some(&index), _) => vec![index],
                (None, Some(members)) => {
                    members.iter().filter_map(|id| self.index_of.get(id.as_str()).copied()).collect()
                }
                (None, None) => {
                    self.unknown_robot(name, place);
                    continue;
                }
            };
            for index in members {
                if seen.insert(index) {
                    robots.push(index);
                } else {
                    let message = format!("robot `{}` is in this cue already", self.fleet.robots[index].id);
                    let place = place.clone();
                    self.findings.add(Code::ListedTwice, place, message, "each robot once in a cue", None);
                }
            }
        }
        robots
    }

    fn unknown_robot(&mut self, name: &str, place: &Place) {
        let known = || self.index_of.keys().copied().chain(self.fleet.groups.keys().map(String::as_str));
        let hint = did_you_mean(name, known());
        let mut all: Vec<_> = known().collect();
        all.sort_unstable();
        let expected = format!("one of {}", names(all));
        let message = format!("no robot or group `{}` in the fleet", node::shortened(name));
        self.findings.add(Code::UnknownRobot, place.clone(), message, expected, hint);
    }

    /// Compiles a track once for all robots whose device is the same, so that a fault is found once and not once a robot.
    fn track(&mut self, cue: &Cue, track: &Track, robots: &[usize]) {
        let mut alike: Vec<(usize, &'a Device, Vec<usize>)> = Vec::new();
        let mut without = Vec::new();
        for &robot in robots {
            let devices = devices_of(&self.fleet.robots[robot]);
            let Some(device) = devices.iter().position(|device| device.id.as_str() == track.device) else {
                without.push(robot);
                continue;
            };
            match alike.iter_mut().find(|(index, known, _)| *index == device && **known == devices[device]) {
                Some((_, _, robots)) => robots.push(robot),
                None => alike.push((device, &devices[device], vec![robot])),
            }
        }
        self.unknown_device(track, &without);
        for (index, device, robots) in alike {
            let Some(segment) = self.segment(cue, track, device, &robots) else { continue };
            for robot in robots {
                self.segments.entry((robot, index)).or_default().push(segment.clone_for_robot());
            }
        }
    }

    fn unknown_device(&mut self, track: &Track, robots: &[usize]) {
        let Some(&first) = robots.first() else { return };
        let known: Vec<_> =
            devices_of(&self.fleet.robots[first]).iter().map(|device| device.id.as_str()).collect();
        let message = format!("{} no device `{}`", self.have(robots), node::shortened(&track.device));
        let hint = did_you_mean(&track.device, known.iter().copied());
        let expected = format!("one of {}", names(known));
        self.findings.add(Code::UnknownDevice, track.place.clone(), message, expected, hint);
    }

    fn have(&self, robots: &[usize]) -> String {
        match robots {
            [one] => format!("robot `{}` has", self.fleet.robots[*one].id),
            _ => format!("robots {} have", self.names(robots)),
        }
    }

    fn names(&self, robots: &[usize]) -> String {
        names(robots.iter().map(|index| self.fleet.robots[*index].id.as_str()))
    }

    fn segment(&mut self, cue: &Cue, track: &Track, device: &Device, robots: &[usize]) -> Option<Segment> {
        let control_type = self.control_type(track, device, robots)?;
        self.check_values(track, device, control_type, robots);
        let actuator = Actuator::new(device, control_type);
        let first = track.keyframes.first()?;
        if actuator.lacks_beginning(first) {
            let message =
                format!("device `{}` has to move to its first keyframe from an unknown value", device.id);
            let hint = Some("put a keyframe at 0s ahead of it, or `ease: step`".to_owned());
            let expected = "a keyframe at 0s";
            self.findings.add(Code::UnknownBeginning, first.place.clone(), message, expected, hint);
        }
        let mut steps = actuator.steps(&track.keyframes);
        for step in &mut steps {
            step.offset = Millis::from_span(step.offset.span() + cue.at);
        }
        let moves_from_anywhere = actuator.moves_from_anywhere(first);
        let start = cue.at + if moves_from_anywhere { Span::ZERO } else { first.at };
        let end = steps.last().map_or(start, |step| step.offset.span());
        let place = track.place.clone();
        let cue_name = cue.name.clone();
        let stop_condition = cue.stop_condition;
        Some(Segment { start, end, moves_from_anywhere, stop_condition, steps, cue: cue_name, place })
    }

    fn control_type(&mut self, track: &Track, device: &Device, robots: &[usize]) -> Option<ControlType> {
        let available = device.script_control_types();
        let control_type = track.control.or_else(|| device.primary_control_type());
        if let Some(control_type) = control_type.filter(|t| available.contains(t)) {
            return Some(control_type);
        }
        let what = match (device.available_control_types.script(), control_type) {
            (None, _) => "scripts".to_owned(),
            (Some(_), Some(control_type)) => format!("{control_type} in scripts"),
            (Some(_), None) => "being moved".to_owned(),
        };
        let available: Vec<_> = available.iter().map(ToString::to_string).collect();
        let message = format!("device `{}` of {} does not support {what}", device.id, self.names(robots));
        let expected =
            format!("a device that takes scripts of {}", names(available.iter().map(String::as_str)));
        self.findings.add(Code::ControlType, track.place.clone(), message, expected, None);
        None
    }

    fn check_values(&mut self, track: &Track, device: &Device, control_type: ControlType, robots: &[usize]) {
        let own = device.available_control_types.limits(control_type);
        let inherited = device.available_control_types.script().map(|script| &script.limits);
        let Some(own) = own else { return };
        for (index, keyframe) in track.keyframes.iter().enumerate() {
            let value = keyframe.to;
            let broken = [Some(own), inherited].into_iter().flatten().find(|limits| !limits.contains(value));
            let who = || format!("{control_type} of `{}` on {}", device.id, self.names(robots));
            if let Some(limits) = broken {
                let message = format!("keyframe {index}: {value} lies outside the limits for {}", who());
                let expected = format!("{} to {}", limits.min_value, limits.max_value);
                let nearest = limits.nearest(value.clamp(limits.min_value, limits.max_value));
                let inward = match limits.contains(nearest) {
                    true => nearest,
                    false => nearest - limits.granularity.copysign(nearest),
                };
                let hint = Some(format!("the nearest value that it can take is {}", tidy(inward)));
                self.findings.add(Code::OutOfRange, value_place(keyframe), message, expected, hint);
            } else if let Some(limits) =
                [Some(own), inherited].into_iter().flatten().find(|l| !l.on_grid(value))
            {
                let granularity = limits.granularity;
                let message = format!("keyframe {index}: {value} lies off the grid for {}", who());
                let below = tidy((value / granularity).floor() * granularity);
                let above = tidy((value / granularity).ceil() * granularity);
                let hint = Some(format!("the nearest values on the grid are {below} and {above}"));
                let expected = format!("a multiple of {granularity}");
                self.findings.add(Code::OffGranularity, value_place(keyframe), message, expected, hint);
            }
        }
    }

    /// Joins the segments of one device into its one script.
    fn script(
        &mut self,
        scenario: &Scenario,
        robot: usize,
        device_index: usize,
        mut segments: Vec<Segment>,
    ) -> Option<DeviceScript> {
        let robot = &self.fleet.robots[robot];
        let device = &devices_of(robot)[device_index];
        segments.sort_by_key(|segment| segment.start);
        self.check_overlaps(robot, device, &segments);
        let start = segments.first()?.start;
        let stop_condition = match segments.as_slice() {
            [only] => only.stop_condition.unwrap_or(scenario.stop_condition),
            _ => scenario.stop_condition,
        };
        let place = segments.first().map(|segment| segment.place.clone()).unwrap_or_default();
        let several = segments.len() > 1;
        let mut steps: Vec<Step> = Vec::new();
        for mut segment in segments {
            if let Some(held) = steps.last().and_then(|last| held_until(device, last, &segment)) {
                steps.push(held);
            }
            if let (true, Some(lease)) = (several, segment.stop_condition) {
                segment.steps.iter_mut().for_each(|step| step.stop_condition = Some(lease));
            }
            steps.append(&mut segment.steps);
        }
        for step in &mut steps {
            step.offset = Millis::from_span(step.offset.span() - start);
        }
        self.check_length(robot, device, steps.len(), place);
        // Times out of order have been found already; then there is no plan.
        let script = Script::new(steps).ok()?;
        Some(DeviceScript {
            device: device.id.clone(),
            start: Millis::from_span(start),
            stop_condition,
            script,
        })
    }

    fn check_overlaps(&mut self, robot: &FleetRobot, device: &Device, segments: &[Segment]) {
        let mut latest: Option<&Segment> = None;
        for segment in segments {
            if let Some(before) = latest.filter(|before| segment.start < before.end) {
                let message = format!(
                    "`{}` moves `{}` of `{}` from {} on, but `{}` moves it until {}",
                    segment.cue, device.id, robot.id, segment.start, before.cue, before.end
                );
                let expected = format!("a start at {} or later", before.end);
                let hint = Some(format!("start `{}` {} later", segment.cue, before.end - segment.start));
                self.findings.add(Code::Overlap, segment.place.clone(), message, expected, hint);
            }
            latest = latest.filter(|before| before.end > segment.end).or(Some(segment));
        }
    }

    fn check_length(&mut self, robot: &FleetRobot, device: &Device, steps: usize, place: Place) {
        let Some(script) = device.available_control_types.script() else { return };
        let most = script.max_number_of_steps as usize;
        if steps > most {
            let message = format!("the script for `{}` of `{}` has {steps} steps", device.id, robot.id);
            let hint =
                Some(format!("take out {}, or allow a larger max_error", counted(steps - most, "keyframe")));
            let expected = format!("at most {most} steps (max_number_of_steps)");
            self.findings.add(Code::TooManySteps, place, message, expected, hint);
        }
    }
}

impl Segment {
    fn clone_for_robot(&self) -> Self {
        Self {
            start: self.start,
            end: self.end,
            moves_from_anywhere: self.moves_from_anywhere,
            stop_condition: self.stop_condition,
            steps: self.steps.clone(),
            cue: self.cue.clone(),
            place: self.place.clone(),
        }
    }
}

fn devices_of(robot: &FleetRobot) -> &[Device] {
    robot.init.as_ref().map_or(&[], |block| &block.devices)
}

/// A device that moves linearly would creep through the gap between two cues; this step makes it wait.
fn held_until(device: &Device, last: &Step, next: &Segment) -> Option<Step> {
    let first = next.steps.first()?;
    let until = if next.moves_from_anywhere { next.start } else { first.offset.span() };
    let creeps = device.interpolation == Interpolation::Linear
        && first.setpoint.control_type == last.setpoint.control_type
        && until > last.offset.span()
        && (next.moves_from_anywhere || first.setpoint.value != last.setpoint.value);
    creeps.then(|| Step {
        offset: Millis::from_span(until),
        setpoint: last.setpoint.clone(),
        stop_condition: None,
    })
}

fn value_place(keyframe: &Keyframe) -> Place {
    let mut place = keyframe.place.clone();
    place.path.push(Part::Key("to".to_owned(), 0));
    place
}

/// A number without the dust of its multiplication.
fn tidy(value: f64) -> f64 {
    let rounded = (value * 1e9).round() / 1e9;
    if rounded.is_finite() { rounded } else { value }
}
