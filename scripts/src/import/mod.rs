//! Other people's choreography files: each format has a reader, all give one [`Imported`], and one writer makes a readable
//! scenario with its fleet of it. Which rule applies to what: `docs/import.md`. Writing files is left to the caller.

mod assemble;
mod bitbots;
mod crazyswarm;
mod fleet_part;
mod grid;
mod hermite;
mod input;
mod joint_trajectory;
mod keyframes;
mod natural;
mod play_motion2;
mod polynomial;
mod remarks;
mod sink;
mod table;
mod timed_csv;
mod tree;
mod units;
mod waypoints;
mod yaml;

use std::path::PathBuf;

use urrcp::InitializationBlock;

use crate::finding::Finding;
use crate::source::Source;
use input::Input;
use sink::Sink;

pub use fleet_part::{FilePart, files_of};
pub use yaml::{Scenes, scenario_text, steps_written};

/// Most keyframes of one import: two million, far beyond what any device takes.
const KEYFRAMES_MAX: usize = 2_000_000;

/// Whose files they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImportFormat {
    /// Crazyswarm: one CSV of polynomial pieces a robot, or a folder of numbered scenes a robot.
    Crazyswarm,
    /// `id,x[m],y[m],z[m],t[s]`.
    Waypoints,
    /// The fields of the ROS message `trajectory_msgs/JointTrajectory`, as YAML or JSON.
    JointTrajectory,
    /// The motions of PAL Robotics' `play_motion2`, YAML.
    PlayMotion2,
    /// Keyframe animations of the RoboCup team Bit-Bots, JSON.
    Bitbots,
    /// Any CSV with a column of times.
    Csv,
}

impl ImportFormat {
    /// All of them with the names that people type.
    pub const WORDS: [(&'static str, Self); 6] = [
        ("crazyswarm", Self::Crazyswarm),
        ("waypoints", Self::Waypoints),
        ("joint-trajectory", Self::JointTrajectory),
        ("play-motion2", Self::PlayMotion2),
        ("bitbots", Self::Bitbots),
        ("csv", Self::Csv),
    ];

    /// As it is typed.
    #[must_use]
    pub fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(_, format)| *format == self).map_or("", |(word, _)| word)
    }

    fn has_curves(self) -> bool {
        matches!(self, Self::Crazyswarm | Self::JointTrajectory)
    }

    /// What kind of robot plays such files, where the user says nothing else.
    fn kind(self) -> &'static str {
        match self {
            Self::Crazyswarm | Self::Waypoints => "crazyflie",
            Self::JointTrajectory | Self::Csv => "robot",
            Self::PlayMotion2 => "tiago",
            Self::Bitbots => "humanoid",
        }
    }
}

/// What the user wishes.
#[derive(Clone, Debug, Default)]
pub struct ImportOptions {
    /// Samples a second for curves, from 0.001 to 1000; piece boundaries or points where absent.
    pub rate_hz: Option<f64>,
    /// Most polynomial pieces that a robot holds.
    pub pieces_max: Option<usize>,
    /// The name of the scenario.
    pub name: Option<String>,
    /// Names for the robots, in order.
    pub robots: Vec<String>,
    /// The kind of robot, which names the initialization block.
    pub kind: Option<String>,
    /// The scenes to take; all where empty.
    pub only: Vec<String>,
    /// Factors for the values: `device=factor` or `robot/device=factor`.
    pub scales: Vec<(String, f64)>,
    /// The column of times of a CSV, by name or by number from 1.
    pub time_column: Option<String>,
    /// `robot/device` and its column.
    pub columns: Vec<(String, String)>,
    /// The block of the robots that shall play it.
    pub init: Option<InitializationBlock>,
}

/// Choreography, whatever it came from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Imported {
    /// Of the scenario.
    pub name: String,
    /// From where, for the comment at the top.
    pub origin: String,
    /// The kind of robot.
    pub kind: String,
    /// One after the other.
    pub scenes: Vec<Scene>,
    /// Values that repeat the one before, because the file pauses or leaves a device out.
    pub held: usize,
}

/// A part that is played as a whole.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// For people.
    pub name: String,
    /// All at once.
    pub robots: Vec<RobotMotion>,
}

/// What one robot does in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RobotMotion {
    /// Its name in the fleet.
    pub robot: String,
    /// In the order of the file.
    pub devices: Vec<DeviceMotion>,
}

/// What one device does in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceMotion {
    /// Its id in the initialization block.
    pub device: String,
    /// Of the values; empty where unknown.
    pub unit: String,
    /// In order of time, each later than the one before.
    pub keyframes: Vec<Keyframe>,
}

/// A value and when it is reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// Milliseconds since the scene began.
    pub at_ms: u64,
    /// In the device's unit.
    pub value: f64,
}

impl Imported {
    /// All devices of all robots in all scenes.
    pub fn devices(&self) -> impl Iterator<Item = (&RobotMotion, &DeviceMotion)> {
        let robots = self.scenes.iter().flat_map(|scene| &scene.robots);
        robots.flat_map(|robot| robot.devices.iter().map(move |device| (robot, device)))
    }

    /// The names of the robots, each once, in order.
    #[must_use]
    pub fn robots(&self) -> Vec<&str> {
        let mut seen = std::collections::HashSet::new();
        let all = self.scenes.iter().flat_map(|scene| &scene.robots).map(|robot| robot.robot.as_str());
        all.filter(|name| seen.insert(*name)).collect()
    }

    /// How many keyframes there are.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.devices().map(|(_, device)| device.keyframes.len()).sum()
    }

    /// The length of all scenes one after the other, in milliseconds.
    #[must_use]
    pub fn duration_ms(&self) -> u64 {
        self.scenes.iter().map(Scene::duration_ms).sum()
    }
}

impl Scene {
    /// The time of the last keyframe, in milliseconds.
    #[must_use]
    pub fn duration_ms(&self) -> u64 {
        self.robots.iter().map(RobotMotion::duration_ms).max().unwrap_or(0)
    }
}

impl RobotMotion {
    /// The time of the last keyframe, in milliseconds.
    #[must_use]
    pub fn duration_ms(&self) -> u64 {
        self.devices.iter().filter_map(|device| device.keyframes.last()).map(|k| k.at_ms).max().unwrap_or(0)
    }
}

/// What became of an import.
#[derive(Clone, Debug, Default)]
pub struct ImportOutcome {
    /// There only without errors.
    pub imported: Option<Imported>,
    /// Which rules were applied to what.
    pub notes: Vec<String>,
    /// What is wrong, in all files at once.
    pub findings: Vec<Finding>,
}

/// Reads files and folders of one format.
#[must_use]
pub fn import(format: ImportFormat, paths: &[PathBuf], options: &ImportOptions) -> ImportOutcome {
    let mut sink = Sink::default();
    let inputs = input::gather(format, paths, options, &mut sink);
    if options.rate_hz.is_some() && !format.has_curves() {
        sink.note(format!("{} has no curves: --rate samples nothing", format.word()));
    }
    let mut motions = Vec::new();
    for input in &inputs {
        match Source::read(&input.path) {
            Ok(source) => motions.extend(read(format, input, &source, options, &mut sink)),
            Err(finding) => sink.findings.push(finding),
        }
    }
    let imported = assemble::assemble(format, paths, motions, options, &mut sink);
    let Sink { findings, notes, .. } = sink;
    ImportOutcome { imported: imported.filter(|_| findings.is_empty()), notes, findings }
}

/// One robot's part of one scene.
#[derive(Clone, Debug)]
struct Motion {
    scene: String,
    robot: RobotMotion,
}

fn read(
    format: ImportFormat,
    input: &Input,
    source: &Source,
    options: &ImportOptions,
    sink: &mut Sink,
) -> Vec<Motion> {
    let motions = match format {
        ImportFormat::Crazyswarm => crazyswarm::read(input, source, options, sink),
        ImportFormat::Waypoints => waypoints::read(input, source, sink),
        ImportFormat::JointTrajectory => joint_trajectory::read(input, source, options, sink),
        ImportFormat::PlayMotion2 => play_motion2::read(input, source, sink),
        ImportFormat::Bitbots => bitbots::read(input, source, sink),
        ImportFormat::Csv => timed_csv::read(input, source, options, sink),
    };
    sink.count(&motions, &source.name);
    motions
}

#[cfg(test)]
mod tests;
