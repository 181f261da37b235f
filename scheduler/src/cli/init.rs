//! `downbeat init`: writes a folder with a fleet, its robots and a scenario that can be played without changes.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use downbeat_scripts::{Attempt, Refusal, Schema, schema};

use super::{Exit, Format, console};

/// Write a small show to begin with: a fleet, its robots and a scenario that run at once.
#[derive(Debug, clap::Args)]
#[command(after_help = "Nothing is overwritten: if one of the files exists, no file is written.

Examples:
  downbeat init                            two arms, in this folder
  downbeat init flight --template drones   four drones, in `flight`")]
pub(super) struct InitArgs {
    /// The folder to write to. It is created if it does not exist.
    #[arg(default_value = ".")]
    folder: PathBuf,
    /// The kind of show to write.
    #[arg(long, value_enum, default_value_t = Template::Arms)]
    template: Template,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Template {
    /// Four drones that take off, fly a wave and land: acts, variables, canon.
    Drones,
    /// Two arms that rise, wave and bow: moves, groups, relations in time.
    Arms,
    /// Two moving heads and a turntable at 120 beats per minute, with a cue for the operator.
    Stage,
    /// Hardware behind a driver in Python.
    Edge,
}

/// The files of one template: their paths in the folder, and their contents.
type Files = &'static [(&'static str, &'static str)];

macro_rules! files {
    ($template:literal: $($file:literal),*) => {
        &[$(($file, include_str!(concat!("../../templates/", $template, "/", $file)))),*]
    };
}

impl Template {
    const fn files(self) -> Files {
        match self {
            Self::Drones => files!("drones": "fleet.yaml", "robots/drone.yaml", "show.yaml"),
            Self::Arms => files!("arms": "fleet.yaml", "robots/arm.yaml", "show.yaml"),
            Self::Stage => {
                files!("stage": "fleet.yaml", "robots/moving-head.yaml", "robots/turntable.yaml", "show.yaml")
            }
            Self::Edge => files!("edge": "driver.py", "fleet.yaml", "robots/rig.yaml", "show.yaml"),
        }
    }
}

/// Editor settings for completion and checks; see `docs/editors.md`.
const SETTINGS: &str = r#"{
  "yaml.schemas": {
    "./schemas/scenario.schema.json": ["show.yaml", "shows/*.yaml"],
    "./schemas/fleet.schema.json": ["fleet.yaml"]
  }
}
"#;

pub(super) fn init(args: &InitArgs, format: Format) -> Exit {
    let of_editor = [
        ("schemas/scenario.schema.json", schema(Schema::Scenario)),
        ("schemas/fleet.schema.json", schema(Schema::Fleet)),
        (".vscode/settings.json", SETTINGS),
    ];
    let files: Vec<(&str, &str)> = args.template.files().iter().copied().chain(of_editor).collect();
    let taken: Vec<String> = files
        .iter()
        .map(|(name, _)| args.folder.join(name))
        .filter(|path| path.symlink_metadata().is_ok())
        .map(|path| format!("`{}`", path.display()))
        .collect();
    if !taken.is_empty() {
        console::error(&format!(
            "nothing was written, because these files already exist: {}; choose another folder, for example `downbeat init show-2`",
            taken.join(", ")
        ));
        return Exit::Usage;
    }
    for (name, content) in &files {
        let path = args.folder.join(name);
        if let Err(error) = write(&path, content) {
            let refusal = Refusal::of(Attempt::Write(&path), &error);
            console::error(&format!("cannot write `{}`: {refusal}", path.display()));
            return Exit::Usage;
        }
    }
    match format {
        Format::Json => {
            let files: Vec<_> = files.iter().map(|(name, _)| name).collect();
            console::print_json(&serde_json::json!({"folder": args.folder, "files": files}));
        }
        Format::Text => console::print(&what_next(&args.folder, args.template, &files)),
    }
    Exit::Done
}

fn write(path: &Path, content: &str) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let mut file = File::create_new(path)?;
    file.write_all(content.as_bytes())?;
    if content.ends_with('\n') { Ok(()) } else { file.write_all(b"\n") }
}

fn what_next(folder: &Path, template: Template, files: &[(&str, &str)]) -> String {
    let mut text = String::from("Written:\n");
    for (name, _) in files {
        text += &format!("  {}\n", folder.join(name).display());
    }
    text += "\nNow try:\n";
    if folder != Path::new(".") {
        text += &format!("  cd {}\n", folder.display());
    }
    text += "  downbeat check show.yaml\n  downbeat dry-run show.yaml --picture show.svg\n  downbeat run show.yaml\n";
    if template == Template::Edge {
        text +=
            "\nThe driver needs `python3`. It records the values in `driven.txt` instead of setting them.\n";
    }
    text
}
