//! Adds notes about valid but remarkable properties of an import: for example, robots that do not move in a scene, and scenes that do not
//! continue where the previous scene ended.

use std::collections::{BTreeMap, HashMap};

use urrcp::Span;

use downbeat_yaml::finding::names;

use super::sink::Sink;
use super::{Course, Scene, keyframes, units};

/// Largest difference between a device's values in two scenes for which there is no note, because it results from rounding in the files.
const JOIN_TOLERANCE: f64 = 1e-9;
/// If an angle changes by this fraction of a turn within `TURN_TIME`, it has wrapped around at an end of its range.
const TURN_SHARE: f64 = 0.75;
const TURN_TIME: Span = Span::from_millis(100);
/// Maximum number of devices that the note about angles that wrap around lists by name.
const TURNING_MAX: usize = 6;

pub(super) fn note_absent(scenes: &[Scene], sink: &mut Sink) {
    let mut present: BTreeMap<&str, usize> = BTreeMap::new();
    for robot in scenes.iter().flat_map(|scene| &scene.robots) {
        *present.entry(&robot.robot).or_default() += 1;
    }
    for (robot, count) in present.into_iter().filter(|(_, count)| *count < scenes.len()).take(20) {
        sink.note(format!(
            "`{robot}` is in {count} of {} scenes and does not move in the others",
            scenes.len()
        ));
    }
}

/// Adds a note about angles that jump by about one turn, with the option that removes these jumps.
pub(super) fn note_turns(scenes: &[Scene], sink: &mut Sink) {
    let mut turning: Vec<(&str, f64)> = Vec::new();
    let (mut count, mut first) = (0_usize, Span::MAX);
    let devices = scenes.iter().flat_map(|scene| &scene.robots).flat_map(|robot| &robot.devices);
    for device in devices.filter(|device| device.course == Course::Straight) {
        let Some(turn) = units::turn(&device.unit) else { continue };
        let jumps = device.keyframes.windows(2).filter(|pair| {
            let way = (pair[1].value - pair[0].value).abs();
            way >= TURN_SHARE * turn && pair[1].at - pair[0].at <= TURN_TIME
        });
        let times: Vec<Span> = jumps.map(|pair| pair[1].at).collect();
        let Some(own) = times.first() else { continue };
        (count, first) = (count + times.len(), first.min(*own));
        if !turning.iter().any(|(known, _)| *known == device.device) {
            turning.push((&device.device, turn));
        }
    }
    if turning.is_empty() {
        return;
    }
    let named = turning.iter().take(TURNING_MAX);
    let options: Vec<_> = named.clone().map(|(device, turn)| format!("--unwrap {device}={turn}")).collect();
    let mut devices = names(named.map(|(device, _)| *device));
    if turning.len() > TURNING_MAX {
        devices.push_str(&format!(" and {} more", turning.len() - TURNING_MAX));
    }
    let how_often = if count == 1 { "once".to_owned() } else { format!("{count} times") };
    sink.note(format!(
        "angles jump by about one turn {how_often}, first at {first}: {devices}; use {} to remove the jumps",
        options.join(" ")
    ));
}

pub(super) fn note_ends(scenes: &[Scene], sink: &mut Sink) {
    for scene in scenes {
        let ends = || scene.robots.iter().map(|robot| (robot.duration(), robot.robot.as_str()));
        if let (Some((first, early)), Some((last, late))) = (ends().min(), ends().max())
            && first < last
        {
            sink.note(format!(
                "`{}`: robots end at different times, `{early}` at {} s, `{late}` at {} s",
                scene.name,
                keyframes::seconds(first),
                keyframes::seconds(last)
            ));
        }
    }
}

/// Adds a note about the largest distance that a device would have to cover in no time between two scenes.
pub(super) fn note_joins(scenes: &[Scene], sink: &mut Sink) {
    let mut largest: Option<(f64, String)> = None;
    let mut last: HashMap<(&str, &str), f64> = HashMap::new();
    for scene in scenes {
        for (robot, device) in scene.robots.iter().flat_map(|r| r.devices.iter().map(move |d| (r, d))) {
            let key = (robot.robot.as_str(), device.device.as_str());
            let first = device.keyframes.first().filter(|keyframe| keyframe.at == Span::ZERO);
            if let (Some(first), Some(before)) = (first, last.get(&key)) {
                let gap = (first.value - before).abs();
                if gap > JOIN_TOLERANCE && largest.as_ref().is_none_or(|(most, _)| gap > *most) {
                    let unit = &device.unit;
                    largest = Some((
                        gap,
                        format!("{gap:.7} {unit}, `{}` of `{}` in `{}`", key.1, key.0, scene.name),
                    ));
                }
            }
            if let Some(keyframe) = device.keyframes.last() {
                last.insert(key, keyframe.value);
            }
        }
    }
    if let Some((_, text)) = largest {
        sink.note(format!(
            "scenes do not start exactly where the previous scene ended: the largest difference is {text}"
        ));
    }
}
