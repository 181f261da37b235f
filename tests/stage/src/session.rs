//! Runs Downbeat in a temporary folder of its own.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use tempfile::TempDir;

use crate::held_up;

/// Returns the path of the Downbeat program. Before the tests of its package, Cargo builds it in the folder above that of the test
/// programs.
pub fn program() -> &'static str {
    static PROGRAM: LazyLock<String> = LazyLock::new(|| {
        let test = std::env::current_exe().unwrap();
        let program = test.ancestors().nth(2).unwrap().join("downbeat");
        assert!(program.exists(), "no {}: `cargo test -p downbeat` builds it", program.display());
        program.into_os_string().into_string().unwrap()
    });
    &PROGRAM
}

/// Returns the root folder of the project.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().to_path_buf()
}

/// Description of a small arm: one linear device with positions from 0 to 90 on a grid of 0.5, and scripts of up to 8 steps.
pub const ARM: &str = "id: arm
api_version: '1'
reports: true
devices:
  - id: shoulder
    name: shoulder servo
    unit: deg
    default_value: 0
    interpolation: linear
    available_control_types:
      position: {min_value: 0, max_value: 90, granularity: 0.5}
      script: {min_value: 0, max_value: 90, granularity: 0.5, max_number_of_steps: 8}
";

/// Returns the description of the arm with its shoulder at this position.
pub fn arm_at(position: u32) -> String {
    ARM.replace("default_value: 0", &format!("default_value: {position}"))
}

/// A folder with the description of an arm, a fleet, and the files that a test adds.
pub struct Session {
    folder: TempDir,
}

impl Session {
    /// Creates a session with a fleet of two simulated arms, `left` and `right`, in the group `arms`.
    pub fn new() -> Self {
        let session = Self { folder: TempDir::new().unwrap() };
        session.file("arm.yaml", ARM).file(
            "fleet.yaml",
            "robots:\n  left: {init: arm.yaml, address: sim}\n  right: {init: arm.yaml, address: sim}\ngroups:\n  arms: [left, right]\n",
        );
        session
    }

    pub fn file(&self, name: &str, content: impl AsRef<[u8]>) -> &Self {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
        self
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(program());
        command.args(args).args(figures(args)).current_dir(self.folder.path());
        command.env("DOWNBEAT_STATE", self.path("state")).env("DOWNBEAT_KEYS", "keys");
        command
    }

    /// Runs Downbeat to its end. If it plays a mission, plays the mission again if this machine was too slow to start it.
    #[track_caller]
    pub fn run(&self, args: &[&str]) -> Ran {
        let run = || Ran(self.command(args).output().unwrap());
        if args.first() == Some(&"run") {
            held_up::begun_in(&self.path("state"), run, Ran::text)
        } else {
            run()
        }
    }

    /// Plays a mission to its end. Plays the mission again if this machine was too slow for it.
    #[track_caller]
    pub fn play(&self, args: &[&str]) -> Ran {
        held_up::played_in(&self.path("state"), || Ran(self.command(args).output().unwrap()), Ran::text)
    }
}

/// Returns the option that makes a mission print the figures of each robot, which tests read. `None` if the command needs no such option.
pub(crate) fn figures(args: &[&str]) -> Option<&'static str> {
    let is_mission = matches!(args.first(), Some(&("run" | "resume")));
    (is_mission && !args.contains(&"--verbose")).then_some("--verbose")
}

/// Output and exit status of a run of Downbeat.
pub struct Ran(pub Output);

impl Ran {
    pub fn code(&self) -> i32 {
        self.0.status.code().unwrap_or_else(|| panic!("ended by a signal: {}", self.text()))
    }

    pub fn out(&self) -> String {
        String::from_utf8_lossy(&self.0.stdout).into_owned()
    }

    pub fn text(&self) -> String {
        format!("{}{}", self.out(), String::from_utf8_lossy(&self.0.stderr))
    }

    #[track_caller]
    pub fn says(&self, code: i32, parts: &[&str]) {
        let text = self.text();
        assert_eq!(self.code(), code, "{text}");
        for part in parts {
            assert!(text.contains(part), "`{part}` is missing in:\n{text}");
        }
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.0.stdout).unwrap_or_else(|e| panic!("{e}: {}", self.text()))
    }
}
