//! Writes one CSV file per drone in Skybrush Studio's format: `Time [msec],x [m],y [m],z [m]` and, for a lamp with three values,
//! `Red,Green,Blue`.

use std::fmt::Write;

use downbeat_import::FilePart;
use downbeat_yaml::finding::names;

use crate::track::{Robot, Track};
use crate::{LINES_MAX, file_name};

/// Default sampling rate, in lines per second.
const RATE_HZ: f64 = 10.0;
const AXES: [&str; 3] = ["x", "y", "z"];

/// Returns one file per drone, and adds messages about omitted data to `notes`.
pub(crate) fn files(
    robots: &[Robot<'_>],
    rate_hz: Option<f64>,
    notes: &mut Vec<String>,
) -> Result<Vec<FilePart>, String> {
    let rate = rate_hz.unwrap_or(RATE_HZ);
    let drones: Vec<(&Robot<'_>, [&Track<'_>; 3])> =
        robots.iter().filter_map(|robot| Some((robot, axes(robot)?))).collect();
    if drones.is_empty() {
        return Err("drone-csv needs robots with the devices `x`, `y` and `z`, but no robot of this scenario has them; joint-trajectory supports any robot".into());
    }
    let all = drones.iter().flat_map(|(robot, _)| &robot.tracks);
    let end_ms = all.filter_map(|track| track.points.last()).map(|(at_ms, _)| *at_ms).fold(0.0, f64::max);
    let lines = (end_ms / 1_000.0 * rate + 2.0) * drones.len() as f64;
    if lines > LINES_MAX as f64 {
        return Err(format!(
            "the files would have {lines:.0} lines, but the limit is {LINES_MAX}: use a lower --rate"
        ));
    }
    let times = times(end_ms, rate);
    notes.push(format!("sampled at {rate} Hz and at the end; times are rounded to whole milliseconds"));
    let others: Vec<&str> =
        robots.iter().filter(|robot| axes(robot).is_none()).map(|robot| robot.name).collect();
    if !others.is_empty() {
        notes.push(format!("left out robots without `x`, `y` and `z`: {}", names(others)));
    }
    Ok(drones.into_iter().map(|(robot, axes)| file(robot, axes, &times, notes)).collect())
}

fn axes<'a, 'b>(robot: &'b Robot<'a>) -> Option<[&'b Track<'a>; 3]> {
    let axis = |name: &str| robot.tracks.iter().find(|track| track.device == name);
    Some([axis(AXES[0])?, axis(AXES[1])?, axis(AXES[2])?])
}

/// Returns the sampling times in whole milliseconds, in strictly increasing order. The last one is `end_ms`, rounded up.
fn times(end_ms: f64, rate: f64) -> Vec<f64> {
    let mut times: Vec<f64> = (0_u32..)
        .map(|index| (f64::from(index) * 1_000.0 / rate).round())
        .take_while(|at_ms| *at_ms < end_ms)
        .collect();
    times.push(end_ms.ceil());
    times.dedup();
    times
}

fn file(robot: &Robot<'_>, axes: [&Track<'_>; 3], times: &[f64], notes: &mut Vec<String>) -> FilePart {
    let lamp = robot.tracks.iter().find(|track| track.points.iter().all(|(_, values)| values.len() == 3));
    let used = |track: &&Track<'_>| {
        !AXES.contains(&track.device) && lamp.is_none_or(|lamp| lamp.device != track.device)
    };
    let left: Vec<&str> = robot.tracks.iter().filter(used).map(|track| track.device).collect();
    if !left.is_empty() {
        notes.push(format!("`{}`: left out {}", robot.name, names(left)));
    }
    let mut text = String::from("Time [msec],x [m],y [m],z [m]");
    text.push_str(if lamp.is_some() { ",Red,Green,Blue\n" } else { "\n" });
    for at_ms in times {
        // Writing to a string does not fail.
        let _infallible = write!(text, "{at_ms}");
        for axis in axes {
            let _infallible = write!(text, ",{:.6}", axis.value(*at_ms) + 0.0);
        }
        for color in lamp.map(|lamp| lamp.values(*at_ms)).unwrap_or_default() {
            let _infallible = write!(text, ",{:.0}", color.clamp(0.0, 255.0));
        }
        text.push('\n');
    }
    FilePart { path: file_name(robot.name, "csv"), text }
}
