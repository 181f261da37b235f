//! What `downbeat check` prints, whole, for each scenario in `tests/diagnostics/`: the text beside it in a file of the same
//! name. The fleet is `fleet.yaml`, or the file of the same name in `fleets/`. With `DOWNBEAT_BLESS=1` the texts are written
//! again; then read every change as a user would.

use std::path::PathBuf;
use std::process::Command;

use stage::session::{Ran, program, root};

fn folder() -> PathBuf {
    root().join("tests/diagnostics")
}

/// Files that others include.
const PARTS: [&str; 3] = ["fleet", "hand", "shared"];

fn names() -> Vec<String> {
    let entries = std::fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path());
    let scenarios = entries.filter(|path| path.extension().is_some_and(|extension| extension == "yaml"));
    let names = scenarios.map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned());
    let mut names: Vec<_> = names.filter(|name| !PARTS.contains(&name.as_str())).collect();
    names.sort();
    names
}

fn shown(name: &str) -> String {
    let mut command = Command::new(program());
    let own = format!("fleets/{name}.yaml");
    let fleet = if folder().join(&own).exists() { &own } else { "fleet.yaml" };
    command.args(["check", &format!("{name}.yaml"), "--fleet", fleet]).current_dir(folder());
    let ran = Ran(command.output().unwrap());
    let text =
        String::from_utf8(ran.0.stderr.clone()).unwrap() + &String::from_utf8(ran.0.stdout.clone()).unwrap();
    format!("{text}exit code {}\n", ran.code())
}

#[test]
fn every_diagnostic_is_printed_as_it_was_approved() {
    let names = names();
    assert!(names.len() >= 40, "{} diagnostics", names.len());
    let bless = std::env::var_os("DOWNBEAT_BLESS").is_some();
    let mut changed = Vec::new();
    for name in &names {
        let path = folder().join(format!("{name}.txt"));
        let now = shown(name);
        if bless {
            std::fs::write(&path, &now).unwrap();
        }
        let approved = std::fs::read_to_string(&path).unwrap_or_default();
        if now != approved {
            changed.push(format!("{name}\n--- approved\n{approved}\n--- now\n{now}"));
        }
    }
    assert!(changed.is_empty(), "{}", changed.join("\n"));
}

#[test]
fn a_diagnostic_that_bears_a_code_shows_it() {
    for name in names().iter().filter(|name| name.starts_with("DB")) {
        let code = &name[..6];
        assert!(shown(name).contains(&format!("[{code}]")), "{name}: {}", shown(name));
    }
}

#[test]
fn every_code_has_a_test_that_triggers_it() {
    let mut tests: String =
        ["language/findings.rs", "files/host.rs", "files/import.rs", "files/import_real.rs"]
            .map(|file| std::fs::read_to_string(root().join("tests").join(file)).unwrap())
            .concat();
    tests.push_str(&names().join(" "));
    for code in downbeat_scripts::Code::ALL {
        assert!(tests.contains(code.as_str()), "no test triggers {}", code.as_str());
        let explained = Ran(Command::new(program()).args(["explain", code.as_str()]).output().unwrap());
        explained.says(0, &[code.as_str(), code.title(), "Fix it"]);
    }
}
