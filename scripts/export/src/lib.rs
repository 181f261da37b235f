//! What a scenario compiles to, as files that other tools read: the steps that are sent, not what is written.

mod drone_csv;
mod joint_trajectory;
mod track;

use downbeat_fleet::fleet::Fleet;
use downbeat_import::FilePart;
use downbeat_plan::Choreography;

/// Most lines of all files.
const LINES_MAX: usize = 5_000_000;

/// Which tool's files to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ExportFormat {
    /// A CSV a drone, as Skybrush Studio reads them in a zip.
    DroneCsv,
    /// The fields of the ROS message `trajectory_msgs/JointTrajectory`, as YAML, a file a robot.
    JointTrajectory,
}

impl ExportFormat {
    /// All of them with the names that people type.
    pub const WORDS: [(&'static str, Self); 2] =
        [("drone-csv", Self::DroneCsv), ("joint-trajectory", Self::JointTrajectory)];
}

/// What became of an export.
#[derive(Clone, Debug, Default)]
pub struct Exported {
    /// A file a robot.
    pub files: Vec<FilePart>,
    /// What was left out or changed.
    pub notes: Vec<String>,
    /// Why there are no files.
    pub problem: Option<String>,
}

/// Writes the acts of the main line one after the other. `rate_hz` is for formats that are sampled, from 0.001 to 1000.
#[must_use]
pub fn export(
    format: ExportFormat,
    choreography: &Choreography,
    fleet: &Fleet,
    rate_hz: Option<f64>,
) -> Exported {
    let (robots, mut notes) = track::robots(choreography, fleet);
    let made = match format {
        ExportFormat::DroneCsv => drone_csv::files(&robots, rate_hz, &mut notes),
        ExportFormat::JointTrajectory => joint_trajectory::files(&robots, &mut notes),
    };
    match made {
        Ok(files) => Exported { files, notes, problem: None },
        Err(problem) => Exported { notes, problem: Some(problem), ..Exported::default() },
    }
}

/// A robot's name as that of a file.
fn file_name(robot: &str, extension: &str) -> String {
    let safe = |c: char| if c.is_alphanumeric() || "-_ ".contains(c) { c } else { '-' };
    format!("{}.{extension}", robot.chars().take(200).map(safe).collect::<String>())
}
