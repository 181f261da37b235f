//! Tests that the documents describe the actual commands, options and exit codes.

use std::collections::BTreeSet;

use clap::CommandFactory;
use strum::VariantNames;

use super::withdraw::InsideWhat;
use super::{Cli, Exit};
use crate::report::SCHEMA;

fn document(name: &str) -> String {
    let path = format!("{}/../{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Returns the exit codes in the first column of the document's table of exit codes.
fn codes(document: &str) -> Vec<u8> {
    let lines = document.lines().skip_while(|line| !line.starts_with("| code | meaning |")).skip(2);
    lines.map_while(|line| line.strip_prefix("| ")?.split(' ').next()?.parse().ok()).collect()
}

#[test]
fn help_and_documents_list_every_exit_code() {
    assert_eq!(Exit::ALL.len(), Exit::VARIANTS.len());
    let all: Vec<u8> = Exit::ALL.iter().map(|exit| *exit as u8).collect();
    let help = Cli::command().render_long_help().to_string();
    let (_, lines) = help.split_once("Exit codes:\n").unwrap();
    let codes_of_help = lines.lines().map_while(|line| line.split_whitespace().next()?.parse().ok());
    assert_eq!(codes_of_help.collect::<Vec<u8>>(), all, "downbeat --help");
    for name in ["README.md", "docs/mission.md"] {
        assert_eq!(codes(&document(name)), all, "{name}");
    }
}

#[test]
fn readme_lists_exactly_the_existing_commands() {
    let readme = document("README.md");
    let rows = readme.lines().skip_while(|line| !line.starts_with("| command |")).skip(2);
    let cells = rows.map_while(|row| row.strip_prefix("| `")?.split('|').next());
    let names = cells.flat_map(|cell| cell.split('`').step_by(2)).map(str::trim);
    let mut listed: Vec<String> =
        names.filter(|name| !name.is_empty() && *name != ",").map(str::to_owned).collect();
    let mut commands = Vec::new();
    for command in Cli::command().get_subcommands() {
        match command.get_subcommands().count() {
            0 => commands.push(command.get_name().to_owned()),
            _ => commands.extend(
                command.get_subcommands().map(|inner| format!("{} {}", command.get_name(), inner.get_name())),
            ),
        }
    }
    listed.sort();
    commands.sort();
    assert_eq!(listed, commands);
}

/// Collects the options of a command and of its subcommands.
fn options(command: &clap::Command, found: &mut std::collections::BTreeSet<String>) {
    found.extend(command.get_arguments().filter_map(|argument| argument.get_long().map(str::to_owned)));
    command.get_subcommands().for_each(|inner| options(inner, found));
}

/// Options of other programs that the documents call: cargo, cargo-mutants, systemctl, zenohd, Blender, jq, `soak` and the experiments in
/// `lab/`.
const FOREIGN: [&str; 32] = [
    "version",
    "locked",
    "now",
    "config",
    "release",
    "features",
    "workspace",
    "path",
    "bin",
    "bench",
    "test",
    "nocapture",
    "python",
    "objects",
    "seeds",
    "step",
    "trace",
    "links",
    "minutes",
    "zenohd",
    "shard",
    "iterate",
    "in-diff",
    "re",
    "exit-status",
    "unshare-all",
    "die-with-parent",
    "ro-bind",
    "symlink",
    "chdir",
    "allow-missing-repository",
    "install-extension",
];

/// Returns the options of the drivers in Python.
fn options_of_drivers() -> Vec<String> {
    let folder = format!("{}/../robot/drivers/python/downbeat_driver", env!("CARGO_MANIFEST_DIR"));
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let texts: String = files.filter_map(|path| std::fs::read_to_string(path).ok()).collect();
    let options = texts.split("add_argument(\"--").skip(1);
    options.filter_map(|rest| Some(rest.split_once('"')?.0.to_owned())).collect()
}

/// A document that also calls package managers, systemd and containers.
const INSTALL: &str = "docs/install.md";

#[test]
fn every_documented_option_exists() {
    let mut known = std::collections::BTreeSet::new();
    options(&Cli::command(), &mut known);
    known.extend(FOREIGN.map(str::to_owned));
    known.extend(options_of_drivers());
    let docs = std::fs::read_dir(format!("{}/../docs", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let docs = docs.map(|entry| format!("docs/{}", entry.unwrap().file_name().display()));
    for name in docs.filter(|name| name.ends_with(".md") && name != INSTALL).chain(["README.md".to_owned()]) {
        for word in document(&name).split(|c: char| c.is_whitespace() || "`'\"(),;:|[]".contains(c)) {
            let Some(option) =
                word.strip_prefix("--").filter(|option| option.starts_with(char::is_alphabetic))
            else {
                continue;
            };
            let option = option.split(['=', '.']).next().unwrap();
            assert!(known.contains(option), "{name}: no command takes --{option}");
        }
    }
}

#[test]
fn report_schema_lists_everything_run_inside_the_scheduler_process() {
    let schema: serde_json::Value = serde_json::from_str(SCHEMA).unwrap();
    let listed = schema.pointer("/properties/inside/items/properties/what/enum").unwrap();
    let listed: BTreeSet<&str> = listed.as_array().unwrap().iter().filter_map(|word| word.as_str()).collect();
    assert_eq!(listed, InsideWhat::VARIANTS.iter().copied().collect());
}
