//! Tests of `downbeat lsp` with an editor that speaks the protocol over standard input and output.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod edited;
mod features;
mod findings;
mod watch;

use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// A folder with a show.
struct Desk {
    folder: TempDir,
}

impl Desk {
    fn of(files: &[[&str; 2]]) -> Self {
        let desk = Self { folder: tempfile::tempdir().unwrap() };
        for [name, text] in files {
            std::fs::write(desk.path(name), text).unwrap();
        }
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().canonicalize().unwrap().join(name)
    }
}

const ROBOT: &str = r#"id: arm
api_version: "1"
devices:
  - id: joint
    unit: deg
    default_value: 0
    interpolation: linear
    available_control_types:
      position: {min_value: -90, max_value: 90, granularity: 0.5}
      script: {min_value: -90, max_value: 90, granularity: 0.5, max_number_of_steps: 200}
  - id: lamp
    unit: percent
    default_value: 0
    interpolation: hold
    available_control_types:
      position: {min_value: 0, max_value: 100, granularity: 1}
      script: {min_value: 0, max_value: 100, granularity: 1, max_number_of_steps: 20}
"#;

const FLEET: &str = "robots:
  left: {init: arm.yaml, address: sim}
  right: {init: arm.yaml, address: sim}
groups: {both: [left, right]}
";

const MOVES: &str = "variables: {height: 40}
moves:
  wave:
    doc: Lifts and drops the joint.
    parameters: {high: $height}
    tracks:
      joint: [{at: 0s, to: 0}, {at: 1s, to: $high}, {at: 2s, to: 0}]
";

const SHOW: &str = "scenario: hello
include: moves.yaml
zones: [table]
cues:
  - cue: raise
    at: 1s
    robots: both
    move: wave
    uses: table
  - cue: shine
    after: raise + 500ms
    robots: left
    tracks:
      lamp: [{at: 0s, to: 0}, {at: 1s, to: 50}]
";

/// A show with a fleet, a robot and an included file.
fn desk() -> Desk {
    Desk::of(&[["arm.yaml", ROBOT], ["fleet.yaml", FLEET], ["moves.yaml", MOVES], ["show.yaml", SHOW]])
}

/// Returns the codes of diagnostics.
fn codes(diagnostics: &[serde_json::Value]) -> Vec<&str> {
    diagnostics.iter().map(|diagnostic| diagnostic["code"].as_str().unwrap()).collect()
}

/// Returns all YAML files in a folder and its subfolders.
fn yaml_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(yaml_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "yaml") {
            files.push(path);
        }
    }
    files.sort();
    files
}
