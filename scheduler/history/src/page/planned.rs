//! Converts a plan for the page: robots, groups, and acts with their cues and steps.

use std::collections::HashMap;

use downbeat_scripts as scripts;
use downbeat_scripts::{
    Choreography, DrivenPath, Fleet, FleetRobot, JointKind, Outline, Severity, WrittenCue,
};
use urrcp::{ControlType, DeviceId, Interpolation, RobotId};

use super::columns::{Columns, Points};
use super::document::{
    Body, BodyUse, Closest, Coordinate, Cue, Device, Finding, Group, Joint, Lane, NamedVolume, Plan, Robot,
    Script, Shape, Source, Space, StepBudget, Volume,
};
use downbeat_show::waits;

/// Maps robots and devices to their indices in the page's data.
#[derive(Debug, Default)]
pub(super) struct Places {
    robots: HashMap<RobotId, usize>,
    devices: HashMap<(usize, String), usize>,
}

impl Places {
    pub(super) fn robot(&self, id: &RobotId) -> Option<usize> {
        self.robots.get(id).copied()
    }

    pub(super) fn device(&self, robot: usize, id: &DeviceId) -> Option<usize> {
        self.named(robot, id.as_str())
    }

    pub(super) fn named(&self, robot: usize, device: &str) -> Option<usize> {
        self.devices.get(&(robot, device.to_owned())).copied()
    }

    /// Adds the next robot with its devices.
    pub(super) fn add(&mut self, id: &RobotId, devices: impl Iterator<Item = String>) {
        let robot = self.robots.len();
        self.robots.insert(id.clone(), robot);
        self.devices.extend(devices.enumerate().map(|(index, device)| ((robot, device), index)));
    }
}

pub(super) fn places(robots: &[&FleetRobot]) -> Places {
    let mut places = Places::default();
    for robot in robots {
        let devices = robot.init.iter().flat_map(|init| &init.devices).map(|device| device.id.to_string());
        let driven = driven(robot).into_iter().map(|device| device.id);
        places.add(&robot.id, devices.chain(driven));
    }
    places
}

pub(super) fn robots(robots: &[&FleetRobot], places: &Places) -> Vec<Robot> {
    let robot = |(index, robot): (usize, &&FleetRobot)| Robot {
        id: robot.id.to_string(),
        devices: robot.init.iter().flat_map(|init| &init.devices).map(device).chain(driven(robot)).collect(),
        body: robot.body.as_ref().map(|body| self::body(body, index, places)),
    };
    robots.iter().enumerate().map(robot).collect()
}

/// Names and units of pseudo-devices that represent a body driven by speeds.
const DRIVEN: [(&str, &str); 3] =
    [("x of its drive", "m"), ("y of its drive", "m"), ("yaw of its drive", "rad")];

fn driven(robot: &FleetRobot) -> Vec<Device> {
    let Some(drive) = robot.body.as_ref().and_then(|body| body.drive.as_ref()) else { return Vec::new() };
    let device = |((name, unit), start): ((&str, &str), f64)| Device {
        id: name.to_owned(),
        name: String::new(),
        unit: unit.to_owned(),
        interpolation: "linear",
        granularity: None,
        min: None,
        max: None,
        default: Some(start),
        sensor: false,
    };
    DRIVEN.into_iter().zip(drive.start).map(device).collect()
}

fn driven_lanes(act: &scripts::Act, places: &Places, columns: &mut Columns) -> Vec<Lane> {
    let mut lanes = Vec::new();
    for path in &act.in_space.driven {
        let Some(robot) = places.robot(&path.robot) else { continue };
        for (index, (name, _)) in DRIVEN.into_iter().enumerate() {
            let Some(device) = places.named(robot, name) else { continue };
            let points =
                path.points.iter().map(|point| (point.at.as_millis_f64(), rounded(point.pose[index])));
            lanes.push(Lane {
                robot,
                device,
                control: "position".to_owned(),
                value: 0,
                worst_error: DrivenPath::DRAWN,
                worst_at: 0.0,
                scripts: vec![Script { start: 0.0, steps: columns.series(&points.collect()) }],
            });
        }
    }
    lanes
}

/// Rounds a length in metres to a tenth of a millimetre, which is small compared with the error of the path.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

pub(super) fn groups(fleet: &Fleet, places: &Places) -> Vec<Group> {
    let of_mission = |(name, ids): (&String, &Vec<RobotId>)| Group {
        name: name.clone(),
        robots: ids.iter().filter_map(|id| places.robot(id)).collect(),
    };
    fleet.groups.iter().map(of_mission).filter(|group| !group.robots.is_empty()).collect()
}

pub(super) fn space(fleet: &Fleet) -> Space {
    let scripts::Space { distance, keep_in, keep_out } = &fleet.space;
    let volume = |volume: &scripts::Volume| Volume { least: volume.least, most: volume.most };
    let named =
        |(name, out): (&String, &scripts::Volume)| NamedVolume { name: name.clone(), volume: volume(out) };
    Space {
        distance: *distance,
        keep_in: keep_in.as_ref().map(volume),
        keep_out: keep_out.iter().map(named).collect(),
    }
}

pub(super) fn device(device: &urrcp::Device) -> Device {
    let types = &device.available_control_types;
    let limits = device.primary_control_type().and_then(|primary| types.limits(primary));
    // Control types with several values, such as colours, have no limits of their own.
    let limits = limits.or_else(|| types.script().map(|script| &script.limits));
    Device {
        id: device.id.to_string(),
        name: device.name.as_ref().map(ToString::to_string).unwrap_or_default(),
        unit: device.unit.as_ref().map(ToString::to_string).unwrap_or_default(),
        interpolation: match device.interpolation {
            Interpolation::Linear => "linear",
            _ => "hold",
        },
        granularity: limits.map(|limits| limits.granularity),
        min: limits.map(|limits| limits.min_value),
        max: limits.map(|limits| limits.max_value),
        default: device.default_value,
        sensor: types.sensor().is_some(),
    }
}

fn body(body: &scripts::Body, robot: usize, places: &Places) -> Body {
    let coordinate = |coordinate: &scripts::Coordinate| self::coordinate(coordinate, robot, places);
    let [mut x, mut y, z, mut yaw] = body.coordinates.each_ref().map(coordinate);
    if body.drive.is_some() {
        let driven = DRIVEN.map(|(name, ..)| places.named(robot, name));
        [x, y, yaw] = driven.map(|device| Coordinate { device, scale: 1.0, offset: 0.0 });
    }
    let shape = match body.shape {
        scripts::Shape::Box { size } => Shape::Box(size),
        scripts::Shape::Ball { radius } => Shape::Ball(radius),
    };
    let joint = |joint: &scripts::Joint| Joint {
        name: joint.name.clone(),
        kind: match joint.kind {
            JointKind::Revolute => "revolute",
            JointKind::Prismatic => "prismatic",
        },
        xyz: joint.xyz,
        rpy: joint.rpy,
        axis: joint.axis,
        value: coordinate(&joint.value),
        radius: joint.radius,
    };
    let mut joints: Vec<Joint> = body.joints.iter().map(joint).collect();
    joints.extend(body.joints.last().map(|last| tip(body.tip, last.radius)));
    Body { x, y, z, yaw, shape, joints, speed: body.speed, acceleration: body.acceleration }
}

/// Represents the end of the last link as a fixed joint.
fn tip(xyz: [f64; 3], radius: f64) -> Joint {
    let value = Coordinate { device: None, scale: 0.0, offset: 0.0 };
    let (rpy, axis) = ([0.0; 3], [0.0, 0.0, 1.0]);
    Joint { name: "tip".to_owned(), kind: "fixed", xyz, rpy, axis, value, radius }
}

fn coordinate(coordinate: &scripts::Coordinate, robot: usize, places: &Places) -> Coordinate {
    match coordinate {
        scripts::Coordinate::Device { device, scale, offset } => {
            Coordinate { device: places.device(robot, device), scale: *scale, offset: *offset }
        }
        scripts::Coordinate::Fixed(value) => Coordinate { device: None, scale: 0.0, offset: *value },
    }
}

pub(super) fn plans(
    choreography: &Choreography,
    outline: &Outline,
    places: &Places,
    columns: &mut Columns,
) -> Vec<Plan> {
    choreography.acts.iter().map(|act| plan_of(act, outline, places, columns)).collect()
}

/// Converts an act for the page. Finds the act's cues by its name, because not all acts of the file need to be played.
pub(super) fn plan_of(act: &scripts::Act, outline: &Outline, places: &Places, columns: &mut Columns) -> Plan {
    let written = outline.acts.iter().find(|written| written.name == act.name);
    plan(act, written.map_or(&[], |written| &written.cues), places, columns)
}

fn plan(act: &scripts::Act, written: &[WrittenCue], places: &Places, columns: &mut Columns) -> Plan {
    let closest = act.in_space.closest.as_ref().and_then(|closest| {
        let [a, b] = closest.robots.each_ref().map(|robot| places.robot(robot));
        Some(Closest { robots: [a?, b?], at: closest.at.as_millis_f64(), distance: closest.distance })
    });
    Plan {
        name: act.name.clone(),
        duration: act.duration().as_millis_f64(),
        start_tolerance: act.plan.start_tolerance.as_millis_f64(),
        cues: act.cues.iter().zip(written).map(|(cue, written)| self::cue(cue, written, places)).collect(),
        lanes: lanes(act, places, columns),
        closest,
        bodies: act.in_space.bodies.iter().filter_map(|used| body_use(used, places)).collect(),
        budgets: act.devices.iter().filter_map(|used| step_budget(used, places)).collect(),
        waits: waits(&act.wait),
    }
}

fn body_use(used: &scripts::BodyUse, places: &Places) -> Option<BodyUse> {
    let robot = places.robot(&used.robot)?;
    Some(BodyUse { robot, speed: used.speed, acceleration: used.acceleration })
}

fn step_budget(used: &scripts::DeviceUse, places: &Places) -> Option<StepBudget> {
    let robot = places.robot(&used.robot)?;
    let device = places.device(robot, &used.device)?;
    Some(StepBudget { robot, device, steps: used.steps, budget: used.budget })
}

fn cue(cue: &scripts::PlannedCue, written: &WrittenCue, places: &Places) -> Cue {
    Cue {
        name: cue.name.clone(),
        start: cue.start.as_millis_f64(),
        end: cue.end.as_millis_f64(),
        slack: cue.slack.as_millis_f64(),
        critical: cue.critical,
        note: cue.text.note.clone(),
        robots: written.robots.iter().filter_map(|robot| places.robot(robot)).collect(),
        source: written.source,
        first_line: written.first_line,
        last_line: written.last_line,
        relations: written.relations.clone(),
    }
}

pub(super) fn lanes(act: &scripts::Act, places: &Places, columns: &mut Columns) -> Vec<Lane> {
    let used: HashMap<_, _> = act.devices.iter().map(|used| ((&used.robot, &used.device), used)).collect();
    let mut lanes: Vec<Lane> = Vec::new();
    for planned in &act.plan.robots {
        let Some(robot) = places.robot(&planned.robot) else { continue };
        for script in &planned.scripts {
            let Some(device) = places.device(robot, &script.device) else { continue };
            let used = used.get(&(&planned.robot, &script.device));
            let start = act.moves_at(&planned.robot, script).as_millis_f64();
            for (value, (control, steps)) in values_of(&script.script).into_iter().enumerate() {
                let control = named(control, value);
                let script = Script { start, steps: columns.series(&steps) };
                let of_device = |lane: &&mut Lane| {
                    lane.robot == robot && lane.device == device && lane.control == control
                };
                // The lanes of the current robot are adjacent and at the end of the list.
                match lanes.iter_mut().rev().take_while(|lane| lane.robot == robot).find(of_device) {
                    Some(lane) => lane.scripts.push(script),
                    None => lanes.push(Lane {
                        robot,
                        device,
                        control,
                        value,
                        worst_error: used.map_or(0.0, |used| used.worst_error),
                        worst_at: used.map_or(0.0, |used| used.worst_at.as_millis_f64()),
                        scripts: vec![script],
                    }),
                }
            }
        }
    }
    lanes.append(&mut driven_lanes(act, places, columns));
    lanes
}

fn named(control: ControlType, value: usize) -> String {
    match value {
        0 => control.to_string(),
        further => format!("{control}, value {}", further + 1),
    }
}

/// Converts the steps of a script to points. The values at the same index within their steps form one series, with the control type of
/// the first step that has that index.
fn values_of(script: &urrcp::Script) -> Vec<(ControlType, Points)> {
    let mut all: Vec<(ControlType, Points)> = Vec::new();
    for step in script.steps() {
        for (index, value) in step.setpoint.values().enumerate() {
            if all.len() == index {
                all.push((step.setpoint.control_type, Points::default()));
            }
            all[index].1.push(step.offset.get(), value);
        }
    }
    all
}

pub(super) fn sources(outline: &Outline) -> Vec<Source> {
    let source = |source: &scripts::Source| Source { name: source.name.clone(), text: source.text.clone() };
    outline.sources.iter().map(source).collect()
}

pub(super) fn findings(findings: &[scripts::Finding], outline: &Outline) -> Vec<Finding> {
    let finding = |finding: &scripts::Finding| Finding {
        code: finding.code.as_str(),
        severity: match finding.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        },
        message: finding.message.clone(),
        hint: finding.hint.clone(),
        source: outline.sources.iter().position(|source| source.name == finding.file),
        line: finding.line,
        column: finding.column,
    };
    findings.iter().map(finding).collect()
}
