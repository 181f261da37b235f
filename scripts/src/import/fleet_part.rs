//! The fleet that goes with a scenario: which robots there are, and an initialization block for them from the data's own
//! range, to be replaced by what the robots really can do.

use std::collections::BTreeMap;

use urrcp::InitializationBlock;

use super::Imported;
use super::grid::{Grid, grid_of};
use super::yaml::{Scenes, line, number, one_line, scalar, scenario_text};

/// Most steps that a generated block asks for at least.
const STEPS_MIN: usize = 2;

/// A file to be written, by its path from the output folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePart {
    /// With `/` between its parts.
    pub path: String,
    /// All of it.
    pub text: String,
}

/// The scenario, the fleet and the initialization blocks. With `init`, that text is the block.
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

/// Robots with the same devices.
struct Kind {
    name: String,
    devices: Vec<String>,
    robots: Vec<String>,
}

fn path_of(kind: &Kind) -> String {
    // The name becomes a file name, so nothing in it may lead elsewhere.
    let safe = |c: char| if c.is_alphanumeric() || "-_".contains(c) { c } else { '-' };
    format!("robots/{}.yaml", kind.name.chars().map(safe).collect::<String>())
}

fn kinds(imported: &Imported, all_alike: bool) -> Vec<Kind> {
    let mut devices: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for (robot, device) in imported.devices() {
        let known = devices.entry(&robot.robot).or_default();
        if !known.contains(&device.device) {
            known.push(device.device.clone());
        }
    }
    let mut kinds: Vec<Kind> = Vec::new();
    for robot in imported.robots() {
        let own = devices.remove(robot).unwrap_or_default();
        match kinds.iter_mut().find(|kind| all_alike || kind.devices == own) {
            Some(kind) => kind.robots.push(robot.to_owned()),
            None => {
                let name = match kinds.len() {
                    0 => imported.kind.clone(),
                    more => format!("{}-{}", imported.kind, more + 1),
                };
                kinds.push(Kind { name, devices: own, robots: vec![robot.to_owned()] });
            }
        }
    }
    kinds
}

fn fleet_text(imported: &Imported, kinds: &[Kind]) -> String {
    let mut text = format!(
        "# The robots of `{}`, simulated. Give a robot `address: tcp://host:port` to drive a real one.\nrobots:\n",
        one_line(&imported.name)
    );
    for robot in imported.robots() {
        let kind = kinds.iter().find(|kind| kind.robots.iter().any(|name| name == robot));
        let path = kind.map(path_of).unwrap_or_default();
        line(&mut text, format_args!("  {}: {{init: {}, address: sim}}", scalar(robot), scalar(&path)));
    }
    text
}

/// Each device with its unit and the grid of all its values, over all robots.
pub(super) fn device_grids(imported: &Imported) -> Vec<(String, String, Grid)> {
    let mut order: Vec<String> = Vec::new();
    let mut values: BTreeMap<&str, (&str, Vec<f64>)> = BTreeMap::new();
    for (_, device) in imported.devices() {
        let known = values.entry(&device.device).or_insert_with(|| {
            order.push(device.device.clone());
            (&device.unit, Vec::new())
        });
        known.1.extend(device.keyframes.iter().map(|keyframe| keyframe.value));
    }
    let grid = |name: String| {
        let (unit, values) = values.get(name.as_str()).cloned().unwrap_or_default();
        let grid = grid_of(&values, unit);
        (name, unit.to_owned(), grid)
    };
    order.into_iter().map(grid).collect()
}

/// The most keyframes that one device has in all scenes together.
fn steps_of(imported: &Imported, name: &str) -> usize {
    let mut steps: BTreeMap<&str, usize> = BTreeMap::new();
    for (robot, device) in imported.devices().filter(|(_, device)| device.device == name) {
        *steps.entry(&robot.robot).or_default() += device.keyframes.len();
    }
    steps.into_values().max().unwrap_or(0).max(STEPS_MIN)
}

fn block_text(imported: &Imported, kind: &Kind) -> String {
    let mut text = format!(
        "# A robot that can do what {} asks for, and no more.\n\
         # min_value, max_value, granularity, max_error and max_number_of_steps below are taken from the DATA, not from a robot:\n\
         # replace them by the robot's own limits before anything moves.\n",
        one_line(&imported.origin)
    );
    line(&mut text, format_args!("id: {}\napi_version: \"1\"\nreports: true\ndevices:", scalar(&kind.name)));
    for (name, unit, grid) in device_grids(imported).iter().filter(|(name, ..)| kind.devices.contains(name)) {
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
        let steps = steps_of(imported, name);
        line(
            &mut text,
            format_args!(
                "    interpolation: linear\n    available_control_types:\n      position: {{{limits}}}\n      \
                 script: {{{limits}, max_number_of_steps: {steps}, control_types: [position]}}"
            ),
        );
    }
    text
}
