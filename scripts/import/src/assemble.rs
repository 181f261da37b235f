//! Assembles the motions of all files into one choreography: names, scenes, units, and notes.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

use urrcp::{DeviceId, InitializationBlock, RobotId, Span};

use downbeat_yaml::finding::{Code, did_you_mean, names, one_of};
use downbeat_yaml::shown::shortened;

use super::input::stem;
use super::natural::natural_order;
use super::sink::Sink;
use super::{
    Course, DeviceMotion, ImportFormat, ImportOptions, Imported, Motion, RobotMotion, Scene, keyframes,
    position, remarks, units,
};

/// Maximum number of robots of an import, and maximum number of devices of a robot in a scene.
const ROBOTS_MAX: usize = 10_000;
pub(super) const DEVICES_MAX: usize = 1_000;
/// Maximum length of the name of a kind of robot, in characters. It is limited because the name becomes a file name.
const KIND_CHARS_MAX: usize = 48;
/// Maximum number of file names in the text that states the origin of an imported choreography.
const ORIGINS_MAX: usize = 6;

/// Assembles the choreography from the motions of all files; `None` if there is nothing to play.
pub(super) fn assemble(
    format: ImportFormat,
    paths: &[PathBuf],
    motions: Vec<Motion>,
    options: &ImportOptions,
    sink: &mut Sink,
) -> Option<Imported> {
    let name = options.name.clone().unwrap_or_else(|| scenario_name(paths));
    let file = paths.first().map(|path| path.display().to_string()).unwrap_or_default();
    if !is_bounded(&motions, &file, sink) {
        return None;
    }
    let mut scenes = scenes(motions, &name, format, &file, sink);
    select(&mut scenes, options, &file, sink);
    rename(&mut scenes, format, options, &file, sink);
    unwrap(&mut scenes, options, &file, sink);
    remarks::note_turns(&scenes, sink);
    scale(&mut scenes, options, &file, sink);
    start(&mut scenes, options, &file, sink);
    if let Some(init) = &options.init {
        fit(&mut scenes, init, sink);
    }
    // Without an initialization block, the applicable unit is unknown.
    let devices = scenes.iter_mut().flat_map(|scene| &mut scene.robots).flat_map(|robot| &mut robot.devices);
    devices.filter(|device| device.unit == units::OF_JOINTS).for_each(|device| device.unit.clear());
    check_names(&scenes, &file, sink);
    remarks::note_ends(&scenes, sink);
    remarks::note_joins(&scenes, sink);
    let kind = options.kind.clone().filter(|kind| !kind.is_empty()).unwrap_or_else(|| match &options.init {
        Some(init) => init.id.to_string(),
        None => format.facts().kind.to_owned(),
    });
    let kind = kind.chars().take(KIND_CHARS_MAX).collect();
    let origin = format!("{} {}", format.word(), origin(paths));
    let clearance = sink.clearance.unwrap_or_default();
    let imported = Imported { name, origin, kind, scenes, held: sink.held, clearance };
    position::note_unknown(&imported, sink);
    (imported.steps() > 0).then_some(imported)
}

fn is_bounded(motions: &[Motion], file: &str, sink: &mut Sink) -> bool {
    let robots: HashSet<&str> = motions.iter().map(|motion| motion.robot.robot.as_str()).collect();
    let devices = motions.iter().map(|motion| motion.robot.devices.len()).max().unwrap_or(0);
    if robots.len() <= ROBOTS_MAX && devices <= DEVICES_MAX {
        return true;
    }
    let message = format!("the import has {} robots with up to {devices} devices", robots.len());
    let expected = format!("at most {ROBOTS_MAX} robots with up to {DEVICES_MAX} devices each");
    sink.about(
        file,
        Code::ImportLimit,
        message,
        &expected,
        Some("check that the file is in the selected format (see `docs/import.md`)"),
    );
    false
}

fn scenario_name(paths: &[PathBuf]) -> String {
    match paths {
        [one] => stem(one),
        [first, ..] => match first.parent().filter(|parent| *parent != Path::new("")) {
            Some(parent) => stem(parent),
            None => "imported".to_owned(),
        },
        [] => "imported".to_owned(),
    }
}

fn origin(paths: &[PathBuf]) -> String {
    let name =
        |path: &PathBuf| path.file_name().map_or_else(|| stem(path), |n| n.to_string_lossy().into_owned());
    let shown: Vec<_> = paths.iter().take(ORIGINS_MAX).map(name).collect();
    match paths.len().saturating_sub(ORIGINS_MAX) {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// Groups the motions by scene. Adds a finding if a robot occurs twice in a scene.
fn scenes(motions: Vec<Motion>, name: &str, format: ImportFormat, file: &str, sink: &mut Sink) -> Vec<Scene> {
    let mut scenes: Vec<Scene> = Vec::new();
    let mut places: HashMap<String, usize> = HashMap::new();
    let mut seen = HashSet::new();
    for Motion { scene, robot } in motions {
        let scene = if scene.is_empty() { name.to_owned() } else { scene };
        if !seen.insert((scene.clone(), robot.robot.clone())) {
            let message = format!(
                "two files move the robot `{}` in the scene `{}`",
                shortened(&robot.robot),
                shortened(&scene)
            );
            sink.about(
                file,
                Code::ImportNames,
                message,
                "each robot at most once per scene",
                Some("rename a file"),
            );
            continue;
        }
        let place = *places.entry(scene.clone()).or_insert_with(|| {
            scenes.push(Scene { name: scene, robots: Vec::new() });
            scenes.len() - 1
        });
        scenes[place].robots.push(robot);
    }
    if format == ImportFormat::Crazyswarm {
        scenes.sort_by(|a, b| natural_order(&a.name, &b.name));
    }
    remarks::note_absent(&scenes, sink);
    scenes
}

fn select(scenes: &mut Vec<Scene>, options: &ImportOptions, file: &str, sink: &mut Sink) {
    if options.only.is_empty() {
        return;
    }
    for wanted in &options.only {
        if !scenes.iter().any(|scene| scene.name == *wanted) {
            let known = || scenes.iter().map(|scene| scene.name.as_str());
            let message = format!("no scene `{}`", shortened(wanted));
            let expected = one_of(known());
            let hint = did_you_mean(wanted, known());
            sink.about(file, Code::ImportNames, message, &expected, hint.as_deref());
        }
    }
    scenes.retain(|scene| options.only.contains(&scene.name));
}

fn rename(scenes: &mut [Scene], format: ImportFormat, options: &ImportOptions, file: &str, sink: &mut Sink) {
    if options.robots.is_empty() {
        return;
    }
    let mut old: Vec<String> = Vec::new();
    for robot in scenes.iter().flat_map(|scene| &scene.robots) {
        if !old.contains(&robot.robot) {
            old.push(robot.robot.clone());
        }
    }
    if old.len() != options.robots.len() && !scenes.is_empty() {
        let message = format!("--robots lists {} names for {} robots", options.robots.len(), old.len());
        let expected = format!("{} names, in the order {}", old.len(), names(old.iter().map(String::as_str)));
        let one = format.facts().is_single;
        let hint =
            one.then_some("give one name for each file, or one name if all files are scenes of one robot");
        sink.about(file, Code::ImportNames, message, &expected, hint);
        return;
    }
    let mut seen = HashSet::new();
    for name in options.robots.iter().filter(|name| !seen.insert(*name)) {
        let message = format!("duplicate name `{}` in --robots", shortened(name));
        sink.about(file, Code::ImportNames, message, "a different name for each robot", None);
    }
    for robot in scenes.iter_mut().flat_map(|scene| &mut scene.robots) {
        if let Some(index) = old.iter().position(|name| *name == robot.robot) {
            robot.robot.clone_from(&options.robots[index]);
        }
    }
}

/// Unwraps values that wrap around, such as headings that jump from 360° to 0°.
fn unwrap(scenes: &mut [Scene], options: &ImportOptions, file: &str, sink: &mut Sink) {
    for (target, period) in &options.unwraps {
        let (mut used, mut turns) = (false, 0_usize);
        for RobotMotion { robot, devices } in scenes.iter_mut().flat_map(|scene| &mut scene.robots) {
            let meant = |device: &str| *target == device || *target == format!("{robot}/{device}");
            let flat = |device: &DeviceMotion| matches!(device.course, Course::Straight | Course::Held);
            for device in devices.iter_mut().filter(|device| meant(&device.device) && flat(device)) {
                used = true;
                turns += keyframes::unwrap(&mut device.keyframes, *period);
            }
        }
        if used || scenes.is_empty() {
            sink.note(format!(
                "`{target}` continues past {period}: {}",
                downbeat_yaml::render::counted(turns, "turn")
            ))
        } else {
            let message =
                format!("--unwrap lists `{}`, but no keyframes move this device", shortened(target));
            sink.about(file, Code::ImportNames, message, "DEVICE or ROBOT/DEVICE", None);
        }
    }
}

/// A note reports scenes whose first value is at this time or later, because they may come from the middle of a timeline.
const LATE: Span = Span::from_millis(1_000);

/// Shifts each scene so that its first value is at the time that the user specifies; if the times are dates, by default at 0 s. Adds a
/// note about a scene that is not shifted if its first value is at [`LATE`] or later.
fn start(scenes: &mut [Scene], options: &ImportOptions, file: &str, sink: &mut Sink) {
    for scene in scenes {
        let mut devices: Vec<_> = scene.robots.iter_mut().flat_map(|robot| &mut robot.devices).collect();
        let firsts = devices.iter().filter_map(|device| device.keyframes.first().map(|first| first.at));
        let Some(first) = firsts.min() else { continue };
        // Curves start at the beginning of their scene.
        let are_points = devices.iter().all(|device| !matches!(device.course, Course::Pieces(_)));
        let name = shortened(&scene.name);
        if options.start.is_none() && keyframes::is_date(first) {
            sink.note(format!("`{name}`: the times are dates, so they are counted from the first value"));
        } else if options.start.is_none() && are_points && first >= LATE {
            sink.note(format!(
                "the first value of `{name}` is at {} s, and devices move to it from 0 s on; use --start 0s to start with this value",
                keyframes::seconds(first)
            ));
        }
        let start = options.start.filter(|_| are_points);
        if let Some(start) = start.or(keyframes::is_date(first).then_some(Span::ZERO)) {
            let keyframes = devices.iter_mut().flat_map(|device| &mut device.keyframes);
            keyframes.for_each(|keyframe| keyframe.at = keyframe.at - first + start);
        }
        if keyframes::seconds(scene.duration()) > keyframes::SECONDS_MAX {
            let message = format!("`{name}` lasts {} s", keyframes::seconds(scene.duration()));
            let expected = format!("at most {} s", keyframes::SECONDS_MAX);
            let hint = Some("import files of different days as separate scenes");
            sink.about(file, Code::ImportTime, message, &expected, hint);
        }
    }
}

fn scale(scenes: &mut [Scene], options: &ImportOptions, file: &str, sink: &mut Sink) {
    for (target, factor) in &options.scales {
        let mut used = false;
        for robot in scenes.iter_mut().flat_map(|scene| &mut scene.robots) {
            let RobotMotion { robot, devices } = robot;
            let meant = |device: &str| *target == device || *target == format!("{robot}/{device}");
            for device in devices.iter_mut().filter(|device| meant(&device.device)) {
                used = true;
                // Only the user knows the unit of scaled values.
                device.unit.clear();
                device.scale(*factor);
            }
        }
        if !used && !scenes.is_empty() {
            let message = format!("--scale lists `{}`, but nothing moves this device", shortened(target));
            sink.about(file, Code::ImportNames, message, "DEVICE or ROBOT/DEVICE", None);
        }
    }
}

/// Checks the imported devices against the initialization block of the robots, and converts values to the units in that block.
fn fit(scenes: &mut [Scene], init: &InitializationBlock, sink: &mut Sink) {
    let known = || init.devices.iter().map(|device| device.id.as_str());
    let mut missing: BTreeMap<String, Option<String>> = BTreeMap::new();
    let mut converted: BTreeMap<String, String> = BTreeMap::new();
    for device in scenes.iter_mut().flat_map(|scene| &mut scene.robots).flat_map(|robot| &mut robot.devices) {
        let Some(block) = init.device(&device.device) else {
            missing.entry(device.device.clone()).or_insert_with(|| did_you_mean(&device.device, known()));
            continue;
        };
        let Some(unit) = block.unit.as_ref().map(ToString::to_string).filter(|unit| *unit != device.unit)
        else {
            continue;
        };
        let text = match units::factor(&device.unit, &unit) {
            Some(1.0) => {
                device.unit = unit;
                continue;
            }
            Some(factor) => {
                device.scale(factor);
                device.keyframes.iter_mut().for_each(|k| k.value = keyframes::rounded(k.value, 7));
                format!("`{}` is converted from {} to {unit}", device.device, device.unit)
            }
            None if device.unit.is_empty() => {
                format!("the unit of `{}` is unknown, so {unit} is assumed", device.device)
            }
            None => format!(
                "`{}` is in {}, which cannot be converted to {unit}, its unit in the initialization block",
                device.device, device.unit
            ),
        };
        device.unit = unit;
        converted.insert(device.device.clone(), text);
    }
    for (device, hint) in missing {
        let message =
            format!("the initialization block `{}` has no device `{}`", init.id, shortened(&device));
        let expected = one_of(known());
        sink.about(init.id.as_str(), Code::UnknownDevice, message, &expected, hint.as_deref());
    }
    converted.into_values().take(20).for_each(|text| sink.note(text));
}

fn check_names(scenes: &[Scene], file: &str, sink: &mut Sink) {
    let mut wrong = BTreeSet::new();
    for robot in scenes.iter().flat_map(|scene| &scene.robots) {
        if let Err(error) = RobotId::new(robot.robot.as_str()) {
            wrong.insert(format!("robot `{}`: {error}", shortened(&robot.robot)));
        }
        for device in &robot.devices {
            if let Err(error) = DeviceId::new(device.device.as_str()) {
                wrong.insert(format!("device `{}`: {error}", shortened(&device.device)));
            }
        }
        let mut seen = HashSet::new();
        for device in robot.devices.iter().filter(|device| !seen.insert(&device.device)) {
            wrong.insert(format!("two columns move `{}` of `{}`", device.device, robot.robot));
        }
    }
    for message in wrong {
        sink.about(file, Code::ImportNames, message, "unique names of 1 to 256 characters", None);
    }
}
