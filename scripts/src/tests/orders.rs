//! Checks the information about cues in a plan: the order in which a cue's keys change its movement, as documented in
//! `docs/scenario.md`, and the cue's note.

use std::path::Path;

use urrcp::Span;

use crate::{NoFiles, PlannedCue, Source, compile, read_fleet};

/// Returns the section of the documentation about the order in which keys change a movement.
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
fn documented_table_matches_plan_of_documented_scenario() {
    let section = section();
    let documented: Vec<&str> = section.lines().filter(|line| line.starts_with("| `")).collect();
    let rows: Vec<String> = planned(&section).iter().map(row).collect();
    assert_eq!(documented, rows);
}

#[test]
fn cue_note_is_included_in_plan() {
    let text = "scenario: s\ncues:\n  - {cue: lift, note: The light goes out., robots: arm, \
        tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 45}]}}\n  - {cue: mark}\n";
    let fleet = crate::Fleet { robots: vec![crate::tests::robot()], ..crate::Fleet::default() };
    let compiled = compile(&Source { name: "note.yaml".into(), text: text.to_owned() }, &fleet, &NoFiles);
    let cues = compiled.choreography.unwrap().acts.remove(0).cues;
    let notes: Vec<_> = cues.iter().map(|cue| cue.text.note.as_deref()).collect();
    assert_eq!(notes, [Some("The light goes out."), None]);
    assert_eq!(serde_json::to_value(&cues[0]).unwrap()["note"], "The light goes out.");
    assert!(serde_json::to_value(&cues[1]).unwrap().get("note").is_none());
}
