//! A fleet file to begin with, from what answered.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use downbeat_import::scalar;
use downbeat_scripts::{Attempt, Refusal, init_text};

use super::{Found, FoundLights};

/// Writes the fleet file and a description for each robot. Returns the paths of the files. If one of them exists, none is written.
///
/// # Errors
/// Returns why the files cannot be written.
pub(super) fn write(path: &Path, found: &Found) -> Result<Vec<PathBuf>, String> {
    let files = files(path, found);
    if let Some((taken, _)) = files.iter().find(|(file, _)| file.symlink_metadata().is_ok()) {
        return Err(format!("nothing was written, because `{}` already exists", taken.display()));
    }
    for (file, text) in &files {
        let written = File::create_new(file).and_then(|mut open| open.write_all(text.as_bytes()));
        written.map_err(|error| {
            format!("cannot write `{}`: {}", file.display(), Refusal::of(Attempt::Write(file), &error))
        })?;
    }
    Ok(files.into_iter().map(|(file, _)| file).collect())
}

/// Returns the files and their texts: descriptions first, because the fleet file names them.
fn files(path: &Path, found: &Found) -> Vec<(PathBuf, String)> {
    let (mut files, mut names, mut file_names) = (Vec::new(), BTreeSet::new(), BTreeSet::new());
    let mut fleet =
        "# What `downbeat discover` found. Give each robot the name that scenarios use.\n".to_owned();
    let mut robots = String::new();
    for robot in &found.robots {
        let Some(block) = &robot.block else {
            let _never_fails = writeln!(
                robots,
                "  # Something at {} does not describe itself without a key. If it is a robot: `downbeat keys`.",
                robot.address
            );
            continue;
        };
        let name = unused(block.id.as_str(), &mut names);
        let init = format!("{}.yaml", unused(&file_name(&name), &mut file_names));
        let own_id = if name == block.id.as_str() {
            String::new()
        } else {
            format!(", robot_id: {}", scalar(block.id.as_str()))
        };
        let _never_fails = writeln!(
            robots,
            "  {}: {{init: {}, address: \"{}\"{own_id}}}",
            scalar(&name),
            scalar(&init),
            robot.address
        );
        files.push((path.with_file_name(init), init_text(block)));
    }
    for lights in &found.art_net {
        robots +=
            &fixture(lights, "an Art-Net node", |universe| format!("artnet:{universe}/1@{}", lights.address));
    }
    for lights in &found.sacn {
        robots += &fixture(lights, "an sACN source", |universe| format!("sacn:{universe}/1"));
    }
    fleet += if files.is_empty() { "robots: {}\n" } else { "robots:\n" };
    files.push((path.to_path_buf(), fleet + &robots));
    files
}

/// Returns comments that show the addresses of the fixtures in the universes of a node or a source.
fn fixture(lights: &FoundLights, kind: &str, address: impl Fn(u16) -> String) -> String {
    let name: String = lights.name.chars().filter(|c| !c.is_control()).collect();
    let mut text = format!("  # `{name}` at {} is {kind}.", lights.address);
    text += " A fixture in its universe, after `downbeat import fixture FILE`:\n";
    for universe in &lights.universes {
        let _never_fails = writeln!(
            text,
            "  #   fixture-{universe}: {{init: fixture.yaml, address: \"{}\"}}",
            address(*universe)
        );
    }
    text
}

/// Returns a name that is not in `names` yet, and adds it there: the robot's own id if possible.
fn unused(id: &str, names: &mut BTreeSet<String>) -> String {
    let all = std::iter::once(id.to_owned()).chain((2..).map(|number| format!("{id}-{number}")));
    let mut free = all.filter(|name| !names.contains(name));
    let name = free.next().unwrap_or_default();
    names.insert(name.clone());
    name
}

/// Returns the name of a file for a robot, without characters that mean something to a file system.
fn file_name(name: &str) -> String {
    let is_safe = |c: char| c.is_alphanumeric() || "-_".contains(c);
    name.chars().map(|c| if is_safe(c) { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use downbeat_scripts::read_fleet;

    use super::super::FoundRobot;
    use super::*;

    fn robot(id: &str, port: u16) -> FoundRobot {
        let block = format!(
            r#"{{"id": "{id}", "api_version": "1", "devices": [{{"id": "elbow", "available_control_types": {{"position": {{"min_value": 0, "max_value": 90, "granularity": 1}}}}}}]}}"#
        );
        let block = Some(serde_json::from_str(&block).unwrap());
        FoundRobot { address: format!("tcp://127.0.0.1:{port}"), block, problem: None }
    }

    fn found() -> Found {
        let lights = FoundLights {
            address: [10, 0, 0, 5].into(),
            name: "Front\n`x`".to_owned(),
            universes: vec![0, 3],
        };
        let silent = FoundRobot { block: None, ..robot("x", 3) };
        Found {
            robots: vec![robot("arm 1/2", 1), robot("arm 1/2", 2), silent],
            art_net: vec![lights],
            ..Found::default()
        }
    }

    #[test]
    fn fleet_of_what_answered_is_valid_even_if_ids_are_equal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet.yaml");
        let files = write(&path, &found()).unwrap();
        assert_eq!(files.len(), 3);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.contains("#   fixture-3: {init: fixture.yaml, address: \"artnet:3/1@10.0.0.5\"}"),
            "{text}"
        );
        let (fleet, findings) = read_fleet(&path);
        // Two robots with one id cannot be distinguished; that is for the user to decide.
        assert!(
            findings.iter().all(|finding| finding.message.contains("both have the id")),
            "{findings:?}\n{text}"
        );
        assert!(fleet.is_none() && findings.len() == 1, "{findings:?}");
        assert!(text.contains("robot_id: \"arm 1/2\"") || text.contains("robot_id: arm 1/2"), "{text}");
    }

    #[test]
    fn existing_files_are_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("arm_1_2.yaml");
        std::fs::write(&taken, "mine").unwrap();
        let path = folder.path().join("fleet.yaml");
        let refused = write(&path, &found()).unwrap_err();
        assert!(refused.contains("arm_1_2.yaml` already exists"), "{refused}");
        assert!(!path.exists() && std::fs::read_to_string(&taken).unwrap() == "mine");
    }
}
