//! Files of poses: moves that bring devices to positions that a person has found, for scenarios to include.

use std::fmt::Write;

use downbeat_import::scalar;
use urrcp::DeviceId;

use crate::node::{self, Node};
use crate::source::Source;

/// The first line of a file of poses. Without it, a file is not changed.
const HEAD: &str = "# Poses that `downbeat jog` saved. In a scenario: `include: poses.yaml`, and then `move: NAME` in a cue.";

/// The position of one device in a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseDevice {
    /// The device.
    pub device: DeviceId,
    /// The position, in the device's unit.
    pub position: f64,
    /// Whether the device moves linearly. Any other device is set to its position at once.
    pub moves_linearly: bool,
}

/// Why a pose cannot be added to a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PoseFileError {
    /// The name cannot be the name of a move.
    #[error("the name of a pose consists of letters, digits, spaces, `-` and `_`, and begins with a letter")]
    Name,
    /// The file contains more than poses.
    #[error(
        "the file exists and is not a file of poses; expected a new file, or one that `downbeat jog` wrote"
    )]
    NoPoseFile,
}

/// Returns the text of a file of poses with one more pose. `file` is the current text; `None` if there is no file. A pose of the same name
/// is replaced, and everything else stays as it is, comments included.
///
/// # Errors
/// Returns [`PoseFileError`] if the name is invalid, or if the file was not written by this function.
pub fn with_pose(file: Option<&str>, name: &str, pose: &[PoseDevice]) -> Result<String, PoseFileError> {
    let is_inner = |c: char| c.is_alphanumeric() || " -_".contains(c);
    if !name.starts_with(char::is_alphabetic) || name.ends_with(' ') || !name.chars().all(is_inner) {
        return Err(PoseFileError::Name);
    }
    let begin = || format!("{HEAD}\nmoves:\n");
    let mut text = file.map_or_else(begin, |file| without(file, name));
    if !text.ends_with('\n') {
        text.push('\n');
    }
    text += &move_text(name, pose);
    let before = file.map_or(Some(Vec::new()), moves_in).ok_or(PoseFileError::NoPoseFile)?;
    let after = moves_in(&text).ok_or(PoseFileError::NoPoseFile)?;
    let is_other = |(other, _): &&(String, Node)| other != name;
    // A file that a person has changed may be laid out differently.
    let is_kept = before.iter().filter(is_other).eq(after.iter().filter(is_other));
    let is_added = after.iter().filter(|(other, _)| other == name).count() == 1;
    if is_kept && is_added { Ok(text) } else { Err(PoseFileError::NoPoseFile) }
}

fn move_text(name: &str, pose: &[PoseDevice]) -> String {
    let mut text = format!("  {}:\n", scalar(name));
    if pose.iter().any(|device| device.moves_linearly) {
        text += "    parameters: {time: 2s}\n";
    }
    text += "    tracks:\n";
    for PoseDevice { device, position, moves_linearly } in pose {
        let at = if *moves_linearly { "$time" } else { "0s" };
        let _never_fails =
            writeln!(text, "      {}: [{{at: {at}, to: {position}}}]", scalar(device.as_str()));
    }
    text
}

/// Returns the text without the move of this name.
fn without(file: &str, name: &str) -> String {
    let head = format!("  {}:", scalar(name));
    let mut is_inside = false;
    let is_kept = |line: &&str| {
        let indent = line.len() - line.trim_start().len();
        if indent <= 2 && !line.trim().is_empty() {
            is_inside = line.trim_end() == head;
        }
        !is_inside
    };
    file.split_inclusive('\n').filter(is_kept).collect()
}

/// Returns the moves of a file of poses. `None` if the text is something else.
fn moves_in(text: &str) -> Option<Vec<(String, Node)>> {
    if text.lines().next() != Some(HEAD) {
        return None;
    }
    let source = Source { name: String::new(), text: text.to_owned() };
    match node::parse(&source).ok()? {
        Node::Map(mut keys) if keys.len() == 1 => match keys.pop() {
            Some((key, Node::Map(moves))) if key == "moves" => Some(moves),
            Some((key, Node::Null)) if key == "moves" => Some(Vec::new()),
            _ => None,
        },
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::{compile, poses};
    use crate::files::Folder;
    use crate::fleet::FleetRobot;
    use crate::{Address, Fleet};

    fn device(id: &str, position: f64) -> PoseDevice {
        PoseDevice { device: id.parse().unwrap(), position, moves_linearly: id == "joint" }
    }

    #[test]
    fn poses_are_added_and_replaced_and_comments_stay() {
        let ready = with_pose(None, "ready", &[device("joint", 12.5)]).unwrap();
        let commented = ready.replace("moves:", "moves:\n  # for the opening");
        let both = with_pose(Some(&commented), "low", &[device("lamp", 3.0)]).unwrap();
        assert_eq!(both, format!("{commented}  low:\n    tracks:\n      lamp: [{{at: 0s, to: 3}}]\n"));
        let replaced = with_pose(Some(&both), "ready", &[device("joint", -4.0)]).unwrap();
        assert_eq!(replaced.matches("ready:").count(), 1);
        assert!(replaced.contains("to: -4}") && replaced.contains("# for the opening"), "{replaced}");
        assert!(replaced.contains("  low:") && !replaced.contains("12.5"), "{replaced}");
    }

    #[test]
    fn scenario_plays_a_saved_pose() {
        let folder = tempfile::tempdir().unwrap();
        let text = with_pose(None, "ready now", &[device("joint", 12.5), device("lamp", 40.0)]).unwrap();
        std::fs::write(folder.path().join("poses.yaml"), text).unwrap();
        let block = serde_json::from_str(poses::ARM).unwrap();
        let robots = vec![FleetRobot::new("arm".parse().unwrap(), Address::Simulated, Some(block))];
        let fleet = Fleet { robots, ..Fleet::default() };
        let text = "scenario: show\ninclude: poses.yaml\ncues: [{at: 0s, robots: arm, move: ready now, parameters: {time: 3s}}]\n";
        let source = Source { name: "show.yaml".into(), text: text.into() };
        let compiled = compile(&source, &fleet, &Folder::new(folder.path().to_path_buf()));
        let show = compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings));
        let scripts = &show.acts[0].plan.robots[0].scripts;
        let last = |index: usize| {
            scripts[index].script.steps().iter().last().map(|step| (step.offset.get(), step.setpoint.value))
        };
        assert_eq!([last(0), last(1)], [Some((3_000.0, 12.5)), Some((0.0, 40.0))]);
    }

    #[test]
    fn other_files_and_names_are_refused() {
        let joint = [device("joint", 1.0)];
        for name in ["", " a", "a ", "1st", "a.b", "$a", "a:b", "a\nb"] {
            assert_eq!(with_pose(None, name, &joint), Err(PoseFileError::Name), "{name:?}");
        }
        let own = with_pose(None, "ready", &joint).unwrap();
        for file in [
            String::new(),
            "moves: {}\n".to_owned(),
            own.replace(HEAD, "# mine"),
            format!("{own}variables: {{a: 1}}\n"),
            own.replace("  ready:", "    ready:"),
            format!("{HEAD}\nmoves: {{ready: {{tracks: {{joint: [{{at: 0s, to: 1}}]}}}}}}\n"),
        ] {
            assert_eq!(with_pose(Some(&file), "ready", &joint), Err(PoseFileError::NoPoseFile), "{file}");
        }
        assert!(with_pose(Some(&format!("{HEAD}\nmoves:\n")), "ready", &joint).is_ok());
    }
}
