//! Imports choreography files of other tools. Each format has a reader that returns an [`Imported`]. A single writer converts an
//! [`Imported`] to a readable scenario with its fleet. `docs/import.md` describes the rules of each format. The caller writes the files.

mod archive;
mod assemble;
mod bernstein;
mod bitbots;
mod bvh;
mod columns;
mod crazyswarm;
mod description;
pub mod dialect;
mod fixture;
mod fleet_part;
mod fseq;
mod grid;
mod hermite;
mod input;
mod joint_states;
mod joint_trajectory;
mod keyframes;
mod light_program;
mod malformed;
mod midi;
mod moments;
mod natural;
mod play_motion2;
mod polynomial;
mod position;
mod remarks;
mod sink;
mod skybrush;
mod standard_midi;
pub mod table;
mod text;
mod timed_csv;
mod tree;
mod units;
mod urdf;
pub mod urdf_tree;
mod waypoints;
mod webots;
mod yaml;

use std::ops::Add;
use std::path::PathBuf;

use urrcp::{InitializationBlock, Span};

use downbeat_yaml::finding::{Code, Finding};
use downbeat_yaml::formats::format_of;
use downbeat_yaml::source::{Source, read_bytes};
use input::Input;
use sink::Sink;

pub use description::DescriptionOutcome;
pub use dialect::Decimal;
pub use downbeat_yaml::formats::{FormatFacts, ImportFormat};
pub use fixture::fixture;
pub use fleet_part::{FilePart, files_of};
pub use moments::TimeUnit;
pub use position::Clearance;
pub use urdf::urdf;
#[doc(hidden)]
pub use yaml::scalar;
pub use yaml::{Scenes, scenario_text, steps_written};

/// Maximum number of keyframes of one import, far more than any device accepts.
const KEYFRAMES_MAX: usize = 2_000_000;

/// The options of an import that the user may set.
#[derive(Clone, Debug, Default)]
pub struct ImportOptions {
    /// Number of samples per second for curves, from 0.001 to 1000. If it is `None`, curves are not sampled: the boundaries of their
    /// pieces, or their points, are used. For a CSV whose times are frame numbers or timecodes, this is the number of frames per second.
    pub rate_hz: Option<f64>,
    /// Maximum number of polynomial pieces that a robot can hold; `None` for the default.
    pub pieces_max: Option<usize>,
    /// The name of the scenario; `None` to derive it from the files.
    pub name: Option<String>,
    /// New names for the robots, in the order in which the robots occur. Empty to keep their names.
    pub robots: Vec<String>,
    /// The kind of robot, after which the initialization block is named. `None` for the format's default.
    pub kind: Option<String>,
    /// The names of the scenes to import; empty to import all scenes.
    pub only: Vec<String>,
    /// Devices, as `device` or `robot/device`, each with the factor by which its values are multiplied.
    pub scales: Vec<(String, f64)>,
    /// The column of times in a CSV, by name or by number, counted from 1.
    pub time_column: Option<String>,
    /// The unit of the times in a CSV. `None` if its header states the unit.
    pub time_unit: Option<TimeUnit>,
    /// Number of lines of a CSV before its header.
    pub skip: usize,
    /// The decimal mark of a CSV. `None` to detect it from the numbers.
    pub decimal: Option<Decimal>,
    /// Devices, as `robot/device` (or `device`, if each file is one robot), each with its columns, separated by commas. A `*` in both the
    /// device and the columns stands for the part of the names that varies.
    pub columns: Vec<(String, String)>,
    /// Devices of a CSV, as `device` or `robot/device`, that hold each value until the next value.
    pub holds: Vec<String>,
    /// Devices, as `device` or `robot/device`, with the period after which their values wrap around, such as 360.
    pub unwraps: Vec<(String, f64)>,
    /// The time of the first value of each scene. `None` to keep the time in the file.
    pub start: Option<Span>,
    /// The initialization block of the robots that will play the scenario, if it is known.
    pub init: Option<InitializationBlock>,
}

/// An imported choreography, independent of its format.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Imported {
    /// The name of the scenario.
    pub name: String,
    /// A description of the imported files, for the comment at the top of the scenario.
    pub origin: String,
    /// The kind of robot, after which the initialization block is named.
    pub kind: String,
    /// The scenes, in the order in which they are played.
    pub scenes: Vec<Scene>,
    /// Number of values that repeat the previous value, because the file contains a pause or leaves a device out.
    pub held: usize,
    /// The minimum distance between robots that have a position in space.
    pub clearance: Clearance,
}

/// A part of the choreography that is played as a unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// The name of the scene, for human readers.
    pub name: String,
    /// The robots, which move simultaneously.
    pub robots: Vec<RobotMotion>,
}

/// The motion of one robot in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RobotMotion {
    /// The name of the robot in the fleet.
    pub robot: String,
    /// The motions of the robot's devices, in the order of the file.
    pub devices: Vec<DeviceMotion>,
}

/// The motion of one device in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceMotion {
    /// The id of the device in the initialization block.
    pub device: String,
    /// Unit of the values; empty if unknown.
    pub unit: String,
    /// Keyframes with strictly increasing times. If the course consists of polynomial pieces, there is a keyframe at each boundary of the
    /// pieces.
    pub keyframes: Vec<Keyframe>,
    /// How the value changes between keyframes.
    pub course: Course,
}

/// How the value of a device changes between its keyframes.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Course {
    /// Linear interpolation.
    #[default]
    Straight,
    /// Constant: each value is held until the next keyframe.
    Held,
    /// Like `Held`, but each keyframe has several values; the keyframe's own value is the first of them.
    Several(Vec<Vec<f64>>),
    /// Consecutive polynomials. The first one begins at the start of the scene.
    Pieces(Vec<Piece>),
}

/// A polynomial: p(t) = sum of c_i t^i, with t in seconds since the beginning of the piece.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// The duration of the piece.
    pub length: Span,
    /// The coefficients in the device's unit, starting with the constant.
    pub coefficients: Vec<f64>,
}

/// A value, and the time at which the device reaches it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// The time since the beginning of the scene.
    pub at: Span,
    /// The value in the device's unit.
    pub value: f64,
}

impl Imported {
    /// Returns all devices of all robots in all scenes, each with its robot.
    pub fn devices(&self) -> impl Iterator<Item = (&RobotMotion, &DeviceMotion)> {
        let robots = self.scenes.iter().flat_map(|scene| &scene.robots);
        robots.flat_map(|robot| robot.devices.iter().map(move |device| (robot, device)))
    }

    /// Returns the distinct names of the robots, in the order in which they first occur.
    #[must_use]
    pub fn robots(&self) -> Vec<&str> {
        let mut seen = std::collections::HashSet::new();
        let all = self.scenes.iter().flat_map(|scene| &scene.robots).map(|robot| robot.robot.as_str());
        all.filter(|name| seen.insert(*name)).collect()
    }

    /// Returns the number of keyframes of all devices in all scenes.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.devices().map(|(_, device)| device.keyframes.len()).sum()
    }

    /// Returns the total duration of all scenes.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.scenes.iter().map(Scene::duration).fold(Span::ZERO, Add::add)
    }
}

impl Scene {
    /// Returns the duration of the scene: the time at which its last motion ends.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.robots.iter().map(RobotMotion::duration).max().unwrap_or_default()
    }
}

impl RobotMotion {
    /// Returns the time at which the robot's motion ends, counted from the start of the scene.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.devices.iter().map(DeviceMotion::duration).max().unwrap_or_default()
    }
}

impl DeviceMotion {
    /// Returns the time at which the motion ends, counted from the start of the scene.
    #[must_use]
    pub fn duration(&self) -> Span {
        match &self.course {
            Course::Pieces(pieces) => pieces.iter().map(|piece| piece.length).fold(Span::ZERO, Add::add),
            _ => self.keyframes.last().map_or(Span::ZERO, |keyframe| keyframe.at),
        }
    }

    /// Multiplies all values of the motion by a factor.
    fn scale(&mut self, factor: f64) {
        self.keyframes.iter_mut().for_each(|keyframe| keyframe.value *= factor);
        match &mut self.course {
            Course::Pieces(pieces) => {
                pieces.iter_mut().flat_map(|piece| &mut piece.coefficients).for_each(|c| *c *= factor);
            }
            Course::Several(values) => values.iter_mut().flatten().for_each(|value| *value *= factor),
            Course::Straight | Course::Held => {}
        }
    }

    /// If the device holds its values, removes keyframes that repeat the previous value, except for the last keyframe. Returns the number
    /// of removed keyframes.
    fn thin(&mut self) -> usize {
        let count = self.keyframes.len();
        let changes = |index: usize, same: bool| index == 0 || index + 1 == count || !same;
        let keep: Vec<bool> = match &self.course {
            Course::Held => {
                let same = |i: usize| i > 0 && self.keyframes[i].value == self.keyframes[i - 1].value;
                (0..count).map(|i| changes(i, same(i))).collect()
            }
            Course::Several(all) => {
                let same = |i: usize| i > 0 && all[i] == all[i - 1];
                (0..count).map(|i| changes(i, same(i))).collect()
            }
            Course::Straight | Course::Pieces(_) => return 0,
        };
        let mut kept = keep.iter();
        self.keyframes.retain(|_| kept.next().is_none_or(|keep| *keep));
        if let Course::Several(all) = &mut self.course {
            let mut kept = keep.iter();
            all.retain(|_| kept.next().is_none_or(|keep| *keep));
        }
        count - self.keyframes.len()
    }

    /// Returns all values of the motion. For polynomial pieces, returns bounds that contain the values.
    fn values(&self) -> Vec<f64> {
        match &self.course {
            Course::Pieces(pieces) => pieces.iter().flat_map(bernstein::bounds).collect(),
            Course::Several(values) => values.concat(),
            Course::Straight | Course::Held => self.keyframes.iter().map(|keyframe| keyframe.value).collect(),
        }
    }

    /// Returns the number of keyframes or polynomial pieces that are written to the scenario.
    fn written(&self) -> usize {
        match &self.course {
            Course::Pieces(pieces) => pieces.len(),
            _ => self.keyframes.len(),
        }
    }
}

/// The result of an import.
#[derive(Clone, Debug, Default)]
pub struct ImportOutcome {
    /// The imported choreography; `None` if there are errors.
    pub imported: Option<Imported>,
    /// Notes about the rules that the import applied.
    pub notes: Vec<String>,
    /// The errors in all files.
    pub findings: Vec<Finding>,
}

/// Imports files and folders of one format.
#[must_use]
pub fn import(format: ImportFormat, paths: &[PathBuf], options: &ImportOptions) -> ImportOutcome {
    let mut sink = Sink::default();
    let inputs = input::gather(format, paths, options, &mut sink);
    if options.rate_hz.is_some() && !format.facts().has_curves && format != ImportFormat::Csv {
        sink.note(format!("the format {} has no curves, so --rate has no effect", format.word()));
    }
    let mut motions = Vec::new();
    for input in &inputs {
        match read_bytes(&input.path) {
            Ok(bytes) => motions.extend(read(format, input, bytes, options, &mut sink)),
            Err(mut finding) => {
                finding.hint.get_or_insert_with(|| "check the path".to_owned());
                sink.findings.push(finding);
            }
        }
    }
    finish(format, paths, motions, options, sink)
}

/// The motion of one robot in one scene, before the scenes are assembled.
#[derive(Clone, Debug)]
struct Motion {
    scene: String,
    robot: RobotMotion,
}

/// Groups the devices of a scene by robot, in the order in which the robots first occur.
fn by_robot(scene: &str, devices: impl IntoIterator<Item = (String, DeviceMotion)>) -> Vec<Motion> {
    let mut motions: Vec<Motion> = Vec::new();
    let mut places = std::collections::HashMap::new();
    for (robot, device) in devices {
        let place = *places.entry(robot.clone()).or_insert_with(|| {
            let robot = RobotMotion { robot, devices: Vec::new() };
            motions.push(Motion { scene: scene.to_owned(), robot });
            motions.len() - 1
        });
        motions[place].robot.devices.push(device);
    }
    motions
}

fn read(
    format: ImportFormat,
    input: &Input,
    bytes: Vec<u8>,
    options: &ImportOptions,
    sink: &mut Sink,
) -> Vec<Motion> {
    let name = input.path.display().to_string();
    let motions = match reader(format) {
        Reader::Bytes(read) => read(input, &name, &bytes, options, sink),
        Reader::Text(read) => match text::source(&name, bytes) {
            Ok(source) => read(input, &source, options, sink),
            Err(finding) => {
                sink.findings.push(finding);
                Vec::new()
            }
        },
    };
    sink.count(&motions, &name);
    motions
}

/// The function that reads the files of a format, as bytes or as text.
enum Reader {
    Bytes(fn(&Input, &str, &[u8], &ImportOptions, &mut Sink) -> Vec<Motion>),
    Text(fn(&Input, &Source, &ImportOptions, &mut Sink) -> Vec<Motion>),
}

fn reader(format: ImportFormat) -> Reader {
    use Reader::{Bytes, Text};
    match format {
        ImportFormat::Crazyswarm => Text(crazyswarm::read),
        ImportFormat::Waypoints => Text(|input, source, _, sink| waypoints::read(input, source, sink)),
        ImportFormat::JointTrajectory => Text(joint_trajectory::read),
        ImportFormat::PlayMotion2 => Text(|input, source, _, sink| play_motion2::read(input, source, sink)),
        ImportFormat::Bitbots => Text(|input, source, _, sink| bitbots::read(input, source, sink)),
        ImportFormat::Skybrush => Bytes(skybrush::read),
        ImportFormat::Webots => Text(|input, source, _, sink| webots::read(input, source, sink)),
        ImportFormat::Bvh => Text(|input, source, _, sink| bvh::read(input, source, sink)),
        ImportFormat::Midi => Bytes(|input, name, bytes, _, sink| midi::read(input, name, bytes, sink)),
        ImportFormat::Fseq => Bytes(fseq::read),
        ImportFormat::Mcap => {
            Bytes(|input, name, bytes, _, sink| joint_states::read(input, name, bytes, sink))
        }
        ImportFormat::Csv => Text(timed_csv::read),
    }
}

/// Imports the bytes of one file, as if it had been read from a path with the given name.
#[must_use]
pub fn import_bytes(
    format: ImportFormat,
    name: &str,
    bytes: &[u8],
    options: &ImportOptions,
) -> ImportOutcome {
    let mut sink = Sink::default();
    let path = PathBuf::from(name);
    let robot = options.kind.clone().unwrap_or_else(|| format.facts().kind.to_owned());
    let input = Input { path: path.clone(), robot, scene: String::new() };
    let motions = read(format, &input, bytes.to_vec(), options, &mut sink);
    finish(format, &[path], motions, options, sink)
}

/// Returns a hint for a file that is not in the expected format.
fn other_format(format: ImportFormat, file: &str) -> String {
    match format_of(file).filter(|other| *other != format) {
        Some(other) => {
            format!("the file name suggests another format: try `downbeat import {} {file}`", other.word())
        }
        None => format!(
            "check that the file is in the format {}: `downbeat import --help` lists all formats",
            format.word()
        ),
    }
}

fn finish(
    format: ImportFormat,
    paths: &[PathBuf],
    motions: Vec<Motion>,
    options: &ImportOptions,
    mut sink: Sink,
) -> ImportOutcome {
    let imported = assemble::assemble(format, paths, motions, options, &mut sink);
    let Sink { mut findings, notes, .. } = sink;
    for finding in &mut findings {
        if finding.hint.is_none()
            && format_of(&finding.file) != Some(format)
            && matches!(finding.code, Code::Unreadable | Code::Syntax | Code::ImportTable)
        {
            finding.hint = Some(other_format(format, &finding.file));
        }
    }
    ImportOutcome { imported: imported.filter(|_| findings.is_empty()), notes, findings }
}

#[cfg(test)]
mod tests;
