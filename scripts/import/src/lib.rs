//! Imports choreography files of other tools. Each format has a reader, every reader returns an [`Imported`], and one writer turns
//! it into a readable scenario with its fleet. `docs/import.md` describes the rules of each format. The caller writes the files.

mod archive;
mod assemble;
mod bernstein;
mod bitbots;
mod bvh;
mod columns;
mod crazyswarm;
pub mod dialect;
mod fleet_part;
mod fseq;
mod grid;
mod hermite;
mod input;
mod joint_states;
mod joint_trajectory;
mod keyframes;
mod light_program;
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

pub use dialect::Decimal;
pub use downbeat_yaml::formats::{FormatFacts, ImportFormat};
pub use fleet_part::{FilePart, files_of};
pub use moments::TimeUnit;
pub use position::Clearance;
pub use urdf::{UrdfOutcome, urdf};
#[doc(hidden)]
pub use yaml::scalar;
pub use yaml::{Scenes, scenario_text, steps_written};

/// Most keyframes of one import: two million, far beyond what any device takes.
const KEYFRAMES_MAX: usize = 2_000_000;

/// What the user wishes.
#[derive(Clone, Debug, Default)]
pub struct ImportOptions {
    /// Samples a second for curves, from 0.001 to 1000; piece boundaries or points where absent. Frames a second for a CSV whose
    /// times are numbers of frames or timecodes.
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
    /// What the times of a CSV mean; otherwise its header has to say it.
    pub time_unit: Option<TimeUnit>,
    /// Lines of a CSV before its header.
    pub skip: usize,
    /// The decimal mark of a CSV; otherwise the one on which its numbers agree.
    pub decimal: Option<Decimal>,
    /// `robot/device`, or `device` where each file is a robot; and its column, several with commas between. A `*` in both
    /// stands for what differs.
    pub columns: Vec<(String, String)>,
    /// Devices of a CSV that stay at each value until the next: `device` or `robot/device`.
    pub holds: Vec<String>,
    /// The values at which devices begin again, such as 360: `device` or `robot/device`.
    pub unwraps: Vec<(String, f64)>,
    /// When the first value of each scene is set; otherwise when the file sets it.
    pub start: Option<Span>,
    /// The block of the robots that shall play it.
    pub init: Option<InitializationBlock>,
}

/// Choreography, whatever it came from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Imported {
    /// Name of the scenario.
    pub name: String,
    /// From where, for the comment at the top.
    pub origin: String,
    /// The kind of robot.
    pub kind: String,
    /// One after the other.
    pub scenes: Vec<Scene>,
    /// Values that repeat the one before, because the file pauses or leaves a device out.
    pub held: usize,
    /// How near to each other robots with a position in space may come.
    pub clearance: Clearance,
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
    /// Unit of the values; empty if unknown.
    pub unit: String,
    /// In order of time, each later than the one before. Of pieces: where they meet.
    pub keyframes: Vec<Keyframe>,
    /// How it moves from one to the next.
    pub course: Course,
}

/// What a device does between its keyframes.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Course {
    /// It goes straight from each to the next.
    #[default]
    Straight,
    /// It stays at each until the next.
    Held,
    /// It stays too, and each keyframe has several values, of which its own is the first.
    Several(Vec<Vec<f64>>),
    /// It follows these, one after the other from the beginning of the scene.
    Pieces(Vec<Piece>),
}

/// A polynomial: p(t) = sum of c_i t^i, with t in seconds from the beginning of the piece.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// How long it lasts.
    pub length: Span,
    /// In the device's unit, the constant first.
    pub coefficients: Vec<f64>,
}

/// A value and when it is reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// Since the scene began.
    pub at: Span,
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

    /// The length of all scenes one after the other.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.scenes.iter().map(Scene::duration).fold(Span::ZERO, Add::add)
    }
}

impl Scene {
    /// The time of the last keyframe.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.robots.iter().map(RobotMotion::duration).max().unwrap_or_default()
    }
}

impl RobotMotion {
    /// The time of the last keyframe.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.devices.iter().map(DeviceMotion::duration).max().unwrap_or_default()
    }
}

impl DeviceMotion {
    /// When it has ended.
    #[must_use]
    pub fn duration(&self) -> Span {
        match &self.course {
            Course::Pieces(pieces) => pieces.iter().map(|piece| piece.length).fold(Span::ZERO, Add::add),
            _ => self.keyframes.last().map_or(Span::ZERO, |keyframe| keyframe.at),
        }
    }

    /// Multiplies all values.
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

    /// Takes out keyframes that change nothing where values stay until the next, but for the last one; says how many.
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

    /// Every value that is in it; of pieces bounds that hold all of them.
    fn values(&self) -> Vec<f64> {
        match &self.course {
            Course::Pieces(pieces) => pieces.iter().flat_map(bernstein::bounds).collect(),
            Course::Several(values) => values.concat(),
            Course::Straight | Course::Held => self.keyframes.iter().map(|keyframe| keyframe.value).collect(),
        }
    }

    /// How many keyframes or pieces are written.
    fn written(&self) -> usize {
        match &self.course {
            Course::Pieces(pieces) => pieces.len(),
            _ => self.keyframes.len(),
        }
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
    if options.rate_hz.is_some() && !format.facts().has_curves && format != ImportFormat::Csv {
        sink.note(format!("{} has no curves: --rate samples nothing", format.word()));
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

/// One robot's part of one scene.
#[derive(Clone, Debug)]
struct Motion {
    scene: String,
    robot: RobotMotion,
}

/// Devices put together by robot, in the order in which the robots come.
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

/// How a file of a format is read.
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

/// Reads the bytes of one file, as if it had been read from a place of that name.
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

/// What to do about a file that is not of this format.
fn other_format(format: ImportFormat, file: &str) -> String {
    match format_of(file).filter(|other| *other != format) {
        Some(other) => {
            format!("the name of the file suggests another format: `downbeat import {} {file}`", other.word())
        }
        None => format!("is it of the format {}? `downbeat import --help` lists the formats", format.word()),
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
