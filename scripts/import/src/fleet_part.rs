//! Writes the fleet for an imported scenario: its robots, and initialization blocks derived from the range of the data. The user must
//! replace these blocks with the actual descriptions of the robots, including their limits.

use std::collections::BTreeMap;

use urrcp::InitializationBlock;

use super::grid::{self, Grid, grid_of};
use super::yaml::{Scenes, line, number, one_line, scalar, scenario_text};
use super::{Clearance, Course, DeviceMotion, Imported, Piece, bernstein, keyframes, position};

/// Minimum number of steps that a generated block declares.
const STEPS_MIN: usize = 2;
/// Upper limit of b l^2 / tolerance for a chord of duration l on a curve with the second derivative b. The error of the chord, b l^2 / 8,
/// may use half of the tolerance, because rounding to the grid uses the other half. This gives a limit of 4, reduced by a safety margin.
const CHORDS: f64 = 3.5;
/// Maximum number of steps that a polynomial piece is assumed to need.
const STEPS_PIECE_MAX: f64 = 1e6;

/// A file to be written by the caller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePart {
    /// The path relative to the output folder, with `/` as separator.
    pub path: String,
    /// The content of the file.
    pub text: String,
}

/// Returns the files of an import: the scenario, the fleet and the initialization blocks. If `init` is given, its text is used as the
/// initialization block.
#[must_use]
pub fn files_of(
    imported: &Imported,
    scenes: Scenes,
    init: Option<(&InitializationBlock, &str)>,
) -> Vec<FilePart> {
    let kinds = kinds(imported, init.is_some());
    let block = init.map(|(block, _)| block);
    let mut files = vec![
        FilePart {
            path: "scenario.yaml".into(),
            text: scenario_text(imported, scenes, block, Some("fleet.yaml")),
        },
        FilePart { path: "fleet.yaml".into(), text: fleet_text(imported, &kinds) },
    ];
    for kind in &kinds {
        let text = match init {
            Some((_, text)) => text.to_owned(),
            None => block_text(imported, kind),
        };
        files.push(FilePart { path: path_of(kind), text });
    }
    files
}

/// A kind of robot. All robots of a kind have the same devices.
struct RobotKind {
    name: String,
    devices: Vec<String>,
    robots: Vec<String>,
}

fn path_of(kind: &RobotKind) -> String {
    // The name becomes part of a path, so it must not contain path separators.
    let safe = |c: char| if c.is_alphanumeric() || "-_".contains(c) { c } else { '-' };
    format!("robots/{}.yaml", kind.name.chars().map(safe).collect::<String>())
}

fn kinds(imported: &Imported, all_alike: bool) -> Vec<RobotKind> {
    let mut devices: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for (robot, device) in imported.devices() {
        let known = devices.entry(&robot.robot).or_default();
        if !known.contains(&device.device) {
            known.push(device.device.clone());
        }
    }
    let mut kinds: Vec<RobotKind> = Vec::new();
    for robot in imported.robots() {
        let own = devices.remove(robot).unwrap_or_default();
        match kinds.iter_mut().find(|kind| all_alike || kind.devices == own) {
            Some(kind) => kind.robots.push(robot.to_owned()),
            None => {
                let name = match kinds.len() {
                    0 => imported.kind.clone(),
                    more => format!("{}-{}", imported.kind, more + 1),
                };
                kinds.push(RobotKind { name, devices: own, robots: vec![robot.to_owned()] });
            }
        }
    }
    kinds
}

fn fleet_text(imported: &Imported, kinds: &[RobotKind]) -> String {
    let mut text = format!(
        "# The robots of `{}`, simulated. Set `address: tcp://host:port` to drive a real robot.\n",
        one_line(&imported.name)
    );
    let flying = position::robots(imported);
    if !flying.is_empty() {
        let Clearance { metres, origin } = imported.clearance;
        let metres = number(metres);
        line(
            &mut text,
            format_args!(
                "# `check` reports robots whose centres come closer to each other than `distance`, in metres.\n\
                 # {metres} is {origin}: write the distance that your robots need, or a `radius` for each `body`.\n\
                 # Remove `body` from robots whose x, y and z do not have the same origin.\n\
                 space: {{distance: {metres}}}"
            ),
        );
    }
    text.push_str("robots:\n");
    for robot in imported.robots() {
        let kind = kinds.iter().find(|kind| kind.robots.iter().any(|name| name == robot));
        let path = kind.map(path_of).unwrap_or_default();
        let body = if flying.contains(robot) { ", body: {x: x, y: y, z: z}" } else { "" };
        line(&mut text, format_args!("  {}: {{init: {}, address: sim{body}}}", scalar(robot), scalar(&path)));
    }
    text
}

/// The requirements for the devices with a given name, combined over all robots.
pub(super) struct DeviceNeeds<'a> {
    name: &'a str,
    unit: &'a str,
    /// How the value of the device changes between keyframes, in the first robot's first scene.
    course: &'a Course,
    pub(super) grid: Grid,
    /// The largest number of steps that one robot needs in all scenes together.
    steps: usize,
}

/// Returns the requirements for each device name, in the order in which the names first occur in the import.
pub(super) fn asked(imported: &Imported) -> Vec<DeviceNeeds<'_>> {
    let mut order: Vec<&str> = Vec::new();
    let mut motions: BTreeMap<&str, Vec<(&str, &DeviceMotion)>> = BTreeMap::new();
    for (robot, device) in imported.devices() {
        let known = motions.entry(&device.device).or_insert_with(|| {
            order.push(&device.device);
            Vec::new()
        });
        known.push((&robot.robot, device));
    }
    order.into_iter().filter_map(|name| asked_of(name, motions.get(name)?)).collect()
}

fn asked_of<'a>(name: &'a str, motions: &[(&'a str, &'a DeviceMotion)]) -> Option<DeviceNeeds<'a>> {
    let (_, first) = motions.first()?;
    let values: Vec<f64> = motions.iter().flat_map(|(_, motion)| motion.values()).collect();
    let grid = match first.course {
        Course::Pieces(_) => grid::of_curves(&values, &first.unit),
        _ => grid_of(&values, &first.unit),
    };
    let mut steps: BTreeMap<&str, usize> = BTreeMap::new();
    for (robot, motion) in motions {
        *steps.entry(robot).or_default() += steps_of(motion, grid.granularity);
    }
    let steps = steps.into_values().max().unwrap_or(0).max(STEPS_MIN);
    Some(DeviceNeeds { name, unit: &first.unit, course: &first.course, grid, steps })
}

/// Returns a number of steps that is sufficient to follow a motion within the tolerance. The error of a chord is an eighth of the curve's
/// second derivative times the squared duration of the chord. Half of the tolerance is reserved for rounding to the grid.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is clamped")]
fn steps_of(motion: &DeviceMotion, tolerance: f64) -> usize {
    let Course::Pieces(pieces) = &motion.course else { return motion.keyframes.len() };
    let chords = |piece: &Piece| {
        let seconds = keyframes::seconds(piece.length);
        seconds * (bernstein::bend(piece) / (CHORDS * tolerance)).sqrt()
    };
    pieces.iter().map(|piece| chords(piece).clamp(0.0, STEPS_PIECE_MAX).ceil() as usize + 2).sum()
}

fn block_text(imported: &Imported, kind: &RobotKind) -> String {
    let mut text = format!(
        "# A robot with exactly the capabilities that {} needs.\n\
         # min_value, max_value, granularity, max_error and max_number_of_steps below are derived from the DATA, not from a robot:\n\
         # replace them with the limits of the real robot before anything moves.\n",
        one_line(&imported.origin)
    );
    line(&mut text, format_args!("id: {}\napi_version: \"1\"\nreports: true\ndevices:", scalar(&kind.name)));
    let own = |asked: &DeviceNeeds<'_>| kind.devices.iter().any(|device| device == asked.name);
    for DeviceNeeds { name, unit, course, grid, steps } in asked(imported).into_iter().filter(own) {
        line(&mut text, format_args!("  - id: {}\n    name: {}", scalar(name), scalar(name)));
        if !unit.is_empty() {
            line(&mut text, format_args!("    unit: {}", scalar(unit)));
        }
        let limits = format!(
            "min_value: {}, max_value: {}, granularity: {}, max_error: {}",
            number(grid.min),
            number(grid.max),
            number(grid.granularity),
            number(grid.granularity)
        );
        let (interpolation, control, own) = match course {
            Course::Straight | Course::Pieces(_) => ("linear", "position", limits.as_str()),
            Course::Held => ("hold", "position", limits.as_str()),
            Course::Several(_) => ("hold", "custom_1", ""),
        };
        line(
            &mut text,
            format_args!(
                "    interpolation: {interpolation}\n    available_control_types:\n      {control}: {{{own}}}\n      \
                 script: {{{limits}, max_number_of_steps: {steps}, control_types: [{control}]}}"
            ),
        );
    }
    text
}
