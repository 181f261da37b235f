//! Writes the fields of `trajectory_msgs/JointTrajectory` as YAML: one point for each step of a device, so that no step is lost.

use std::fmt::Write;

use downbeat_import::{FilePart, scalar};
use downbeat_yaml::finding::names;
use downbeat_yaml::shown::shortened;
use urrcp::Interpolation;

use crate::track::{Robot, Track};
use crate::{LINES_MAX, file_name};

/// Returns one file per robot, and adds messages about omitted or changed data to `notes`.
pub(crate) fn files(robots: &[Robot<'_>], notes: &mut Vec<String>) -> Result<Vec<FilePart>, String> {
    let mut files = Vec::new();
    let mut lines = 0;
    for robot in robots {
        let single = |track: &&Track<'_>| track.points.iter().all(|(_, values)| values.len() == 1);
        let joints: Vec<&Track<'_>> = robot.tracks.iter().filter(single).collect();
        let left: Vec<&str> =
            robot.tracks.iter().filter(|track| !single(track)).map(|track| track.device).collect();
        if !left.is_empty() {
            let left = names(left);
            notes.push(format!("`{}`: left out devices with several values: {left}", robot.name));
        }
        if joints.is_empty() {
            continue;
        }
        let times = times(&joints);
        lines += times.len();
        if lines.saturating_mul(joints.len()) > LINES_MAX {
            return Err(format!("the files would have more positions than the limit of {LINES_MAX}"));
        }
        let held: Vec<&str> = joints
            .iter()
            .filter(|track| track.interpolation == Interpolation::Hold)
            .map(|t| t.device)
            .collect();
        if !held.is_empty() {
            let held = names(held);
            notes.push(format!(
                "`{}`: devices that hold their value move to the next value within the last millisecond before each step: {held}",
                robot.name
            ));
        }
        files.push(FilePart { path: file_name(robot.name, "yaml"), text: text(robot, &joints, &times) });
    }
    if files.is_empty() {
        Err("no device with a single value is moved, so there is nothing to export".into())
    } else {
        Ok(files)
    }
}

/// Returns the times of all steps of the joints, in milliseconds. If a joint jumps at a step, also returns the time 1 ms before the step.
fn times(joints: &[&Track<'_>]) -> Vec<f64> {
    let mut times: Vec<f64> = Vec::new();
    for joint in joints {
        for (at_ms, _) in &joint.points {
            times.push(*at_ms);
            if joint.interpolation == Interpolation::Hold && *at_ms >= 1.0 {
                times.push(at_ms - 1.0);
            }
        }
    }
    times.sort_by(f64::total_cmp);
    // Times less than a nanosecond apart are equal.
    times.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    times
}

fn text(robot: &Robot<'_>, joints: &[&Track<'_>], times: &[f64]) -> String {
    let names: Vec<String> = joints.iter().map(|joint| scalar(joint.device).into_owned()).collect();
    let mut text = String::new();
    let name = shortened(robot.name).replace(char::is_control, " ");
    // Writing to a string does not fail.
    let _infallible = writeln!(
        text,
        "# `{name}`, from the steps that are sent to the robot.\njoint_names: [{}]\npoints:",
        names.join(", ")
    );
    for at_ms in times {
        let positions: Vec<String> =
            joints.iter().map(|joint| format!("{}", joint.value(*at_ms) + 0.0)).collect();
        let (seconds, nanos) = split(*at_ms);
        let _infallible = writeln!(
            text,
            "- {{positions: [{}], time_from_start: {{sec: {seconds}, nanosec: {nanos}}}}}",
            positions.join(", ")
        );
    }
    text
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "times are not negative")]
fn split(at_ms: f64) -> (u64, u64) {
    let nanos = (at_ms * 1e6).round() as u64;
    (nanos / 1_000_000_000, nanos % 1_000_000_000)
}
