//! What is remarkable about an import though nothing is wrong with it: robots that rest, scenes that do not meet.

use std::collections::{BTreeMap, HashMap};

use super::Scene;
use super::sink::Sink;

/// Scenes may end and begin so far apart without a word: rounding of the files' own digits.
const JOIN_TOLERANCE: f64 = 1e-9;
pub(super) fn note_absent(scenes: &[Scene], sink: &mut Sink) {
    let mut present: BTreeMap<&str, usize> = BTreeMap::new();
    for robot in scenes.iter().flat_map(|scene| &scene.robots) {
        *present.entry(&robot.robot).or_default() += 1;
    }
    for (robot, count) in present.into_iter().filter(|(_, count)| *count < scenes.len()).take(20) {
        sink.note(format!(
            "`{robot}` is in {count} of {} scenes and holds still in the others",
            scenes.len()
        ));
    }
}

pub(super) fn note_ends(scenes: &[Scene], sink: &mut Sink) {
    for scene in scenes {
        let ends = || scene.robots.iter().map(|robot| (robot.duration_ms(), robot.robot.as_str()));
        if let (Some((first, early)), Some((last, late))) = (ends().min(), ends().max())
            && first < last
        {
            sink.note(format!(
                "`{}`: robots end at different times, `{early}` at {} s, `{late}` at {} s",
                scene.name,
                first as f64 / 1_000.0,
                last as f64 / 1_000.0
            ));
        }
    }
}

/// The largest way that a device would have to go in no time where two scenes meet.
pub(super) fn note_joins(scenes: &[Scene], sink: &mut Sink) {
    let mut largest: Option<(f64, String)> = None;
    let mut last: HashMap<(&str, &str), f64> = HashMap::new();
    for scene in scenes {
        for (robot, device) in scene.robots.iter().flat_map(|r| r.devices.iter().map(move |d| (r, d))) {
            let key = (robot.robot.as_str(), device.device.as_str());
            let first = device.keyframes.first().filter(|keyframe| keyframe.at_ms == 0);
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
        sink.note(format!("scenes do not begin quite where the ones before ended, off by at most {text}"));
    }
}
