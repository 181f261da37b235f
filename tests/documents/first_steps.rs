//! Tests the folders that `downbeat init` writes, the shell completions and the man pages.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;
use stage::schema::validator;
use stage::session::{Ran, program};
use tempfile::TempDir;

fn downbeat(folder: &Path, args: &[&str]) -> Ran {
    let mut command = Command::new(program());
    command.args(args).current_dir(folder).env("DOWNBEAT_STATE", folder.join(".state")).stdin(Stdio::null());
    Ran(command.output().unwrap())
}

const TEMPLATES: [&str; 4] = ["arms", "drones", "stage", "edge"];

#[test]
fn files_from_init_match_schemas_named_in_editor_settings() {
    for template in TEMPLATES {
        let folder = TempDir::new().unwrap();
        downbeat(folder.path(), &["init", "--template", template]).says(0, &["downbeat run show.yaml"]);
        let settings = fs::read_to_string(folder.path().join(".vscode/settings.json")).unwrap();
        let settings: Value = serde_json::from_str(&settings).unwrap();
        for schema in settings["yaml.schemas"].as_object().unwrap().keys() {
            assert!(folder.path().join(schema).is_file(), "{schema}");
        }
        for (file, schema) in [("show.yaml", "scenario"), ("fleet.yaml", "fleet")] {
            let text = fs::read_to_string(folder.path().join(file)).unwrap();
            assert!(
                text.starts_with(&format!("# yaml-language-server: $schema=schemas/{schema}.schema.json\n"))
            );
            let document: Value = serde_yaml::from_str(&text).unwrap();
            assert!(validator(schema).is_valid(&document), "{template}: {file}");
        }
    }
}

#[test]
fn init_never_overwrites_files() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("show.yaml"), "mine").unwrap();
    let refused = downbeat(folder.path(), &["init"]);
    refused.says(2, &["nothing was written", "`./show.yaml`"]);
    assert_eq!(fs::read_to_string(folder.path().join("show.yaml")).unwrap(), "mine");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    downbeat(folder.path(), &["init", "show-2"]).says(0, &["cd show-2"]);
    downbeat(folder.path(), &["init", "show-2"]).says(2, &["`show-2/fleet.yaml`"]);
    fs::write(folder.path().join("file"), "").unwrap();
    downbeat(folder.path(), &["init", "file/show"]).says(2, &["cannot write `file/show/fleet.yaml`"]);
}

#[test]
fn missing_fleet_error_explains_how_to_create_one() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("show.yaml"), "scenario: show\ncues: [{cue: a}]\n").unwrap();
    let checked = downbeat(folder.path(), &["check", "show.yaml"]);
    checked.says(2, &["fleet.yaml", "run `downbeat init` to create one", "or name one with `--fleet FILE`"]);
}

#[test]
fn completions_and_man_pages_cover_every_command() {
    let folder = TempDir::new().unwrap();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        downbeat(folder.path(), &["completions", shell]).says(0, &["preflight", "conformance", "patience"]);
    }
    let script = downbeat(folder.path(), &["completions", "bash"]).out();
    let checked = Command::new("bash").args(["-n", "-c", &script]).status().unwrap();
    assert!(checked.success());
    downbeat(folder.path(), &["man", "pages"]).says(0, &[]);
    let help = downbeat(folder.path(), &["--help"]).out();
    let commands =
        help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let mut count = 0;
    for command in commands
        .filter_map(|line| line.strip_prefix("  ")?.split(' ').next())
        .filter(|name| !["", "help"].contains(name))
    {
        let page = folder.path().join(format!("pages/downbeat-{command}.1"));
        assert!(page.is_file(), "{}", page.display());
        count += 1;
    }
    assert!(count > 15, "{help}");
    let page = fs::read_to_string(folder.path().join("pages/downbeat.1")).unwrap();
    assert!(page.contains("Exit codes"), "{page}");
}
