//! The result of converting a robot's description from another format.

use downbeat_yaml::finding::{Code, Finding};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;
use urrcp::RobotId;

use super::fleet_part::FilePart;
use super::sink::Sink;

/// The result of converting a robot's description, such as a URDF, to an initialization block.
#[derive(Clone, Debug, Default)]
pub struct DescriptionOutcome {
    /// The initialization block, and a fleet with one robot that has this block. Empty if there are errors.
    pub files: Vec<FilePart>,
    /// The number of devices in the block.
    pub devices: usize,
    /// Notes about parts of the description that are left out, and about values that are assumed.
    pub notes: Vec<String>,
    /// The errors in the description; empty if it was converted.
    pub findings: Vec<Finding>,
}

impl DescriptionOutcome {
    /// The outcome of a description with errors, or that cannot be read.
    pub(super) fn refused(sink: Sink) -> Self {
        Self { findings: sink.findings, notes: sink.notes, ..Self::default() }
    }
}

/// Returns the path of the initialization block of the robot `id`.
pub(super) fn block_path(id: &str) -> String {
    let safe = |c: char| if c.is_alphanumeric() || "-_".contains(c) { c } else { '-' };
    format!("robots/{}.yaml", id.chars().take(48).map(safe).collect::<String>())
}

/// Checks the name of a robot that `--kind` sets. Adds a finding if it is not valid.
pub(super) fn check_kind(id: &str, source: &Source, sink: &mut Sink) {
    if let Err(error) = RobotId::new(id) {
        let message = format!("robot `{}`: {error}", shortened(id));
        let hint = Some("set the name with `--kind NAME`");
        sink.about(&source.name, Code::ImportNames, message, "a name of 1 to 256 characters", hint);
    }
}
