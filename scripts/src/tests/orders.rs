//! The order in which the keys of a cue change its movement, as `docs/scenario.md` documents it.

use std::path::Path;

use urrcp::Span;

use crate::{NoFiles, PlannedCue, Source, compile, read_fleet};

/// The section of the documentation.
fn section() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let document = std::fs::read_to_string(root.join("docs/scenario.md")).unwrap();
    let (_, section) = document.split_once("\n#### The order of changes\n").unwrap();
    section.split("\n#### ").next().unwrap().to_owned()
}

fn planned(section: &str) -> Vec<PlannedCue> {
    let (_, text) = section.split_once("```yaml scenario\n").unwrap();
    let text = text.split("```").next().unwrap().to_owned();
    let (fleet, _) = read_fleet(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../fleet.yaml"));
    let compiled = compile(&Source { name: "order.yaml".into(), text }, &fleet.unwrap(), &NoFiles);
    compiled.choreography.unwrap().acts.remove(0).cues
}

fn row(cue: &PlannedCue) -> String {
    let time = |span: Span| span.to_string();
    let turns = cue.repetition.map_or_else(
        || "| | |".to_owned(),
        |repeated| format!("{} | {} | {} |", repeated.times, time(repeated.length), time(repeated.every)),
    );
    format!("| `{}` | {} | {} | {turns}", cue.name, time(cue.start), time(cue.end))
}

#[test]
fn the_documented_table_is_the_plan_of_the_documented_scenario() {
    let section = section();
    let documented: Vec<&str> = section.lines().filter(|line| line.starts_with("| `")).collect();
    let rows: Vec<String> = planned(&section).iter().map(row).collect();
    assert_eq!(documented, rows);
}
