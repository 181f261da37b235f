//! Exports a compiled scenario to file formats of other tools. The files contain the steps that robots receive, not the movements as
//! written in the scenario.

mod drone_csv;
mod joint_trajectory;
mod track;

use downbeat_fleet::fleet::Fleet;
use downbeat_import::FilePart;
use downbeat_plan::Choreography;

/// Maximum total number of lines in the files of an export; for joint trajectories, maximum number of positions.
const LINES_MAX: usize = 5_000_000;

/// The file format of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ExportFormat {
    /// One CSV file per drone; Skybrush Studio reads these files from a ZIP archive.
    DroneCsv,
    /// The fields of the ROS message `trajectory_msgs/JointTrajectory` as YAML, one file per robot.
    JointTrajectory,
}

impl ExportFormat {
    /// All formats, each with its name on the command line.
    pub const WORDS: [(&'static str, Self); 2] =
        [("drone-csv", Self::DroneCsv), ("joint-trajectory", Self::JointTrajectory)];
}

/// Result of an export.
#[derive(Clone, Debug, Default)]
pub struct Exported {
    /// One file per robot.
    pub files: Vec<FilePart>,
    /// Messages about data that the export omits or changes.
    pub notes: Vec<String>,
    /// The reason why there are no files; `None` after a successful export.
    pub problem: Option<String>,
}

/// Exports the acts of the main line (the first act, and those that follow it by `next`) one after another. `rate_hz`, from 0.001 to
/// 1000, is the sampling rate of formats that are sampled; `None` for the format's default.
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

/// Turns a robot's name into a file name.
fn file_name(robot: &str, extension: &str) -> String {
    let safe = |c: char| if c.is_alphanumeric() || "-_ ".contains(c) { c } else { '-' };
    format!("{}.{extension}", robot.chars().take(200).map(safe).collect::<String>())
}
