//! Findings while the user writes, and their fixes.

use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};
use stage::editor::{Editor, uri};
use stage::session::{program, root};

use crate::{SHOW, codes, desk, yaml_files};

#[test]
fn findings_follow_the_text_and_vanish_with_their_fix() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let mut editor = Editor::new();
    editor.open(&show);
    assert_eq!(editor.diagnosed(&show), Vec::<Value>::new());
    let wrong = SHOW.replace("robots: left", "robots: lift");
    editor.change(&show, &wrong);
    let found = editor.diagnosed(&show);
    assert_eq!(codes(&found), ["DB0008"]);
    let range = json!({"start": {"line": 11, "character": 12}, "end": {"line": 11, "character": 16}});
    assert_eq!(found[0]["range"], range);
    let params =
        json!({"textDocument": {"uri": uri(&show)}, "range": range, "context": {"diagnostics": found}});
    let actions = editor.request("textDocument/codeAction", params);
    assert_eq!(actions[0]["title"], "write `left` (DB0008)");
    let edit = &actions[0]["edit"]["changes"][uri(&show)][0];
    editor.edit(&show, json!({"range": edit["range"], "text": edit["newText"]}));
    assert_eq!(editor.diagnosed(&show), Vec::<Value>::new());
    editor.end();
}

#[test]
fn contradiction_shows_its_links_as_related_places() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let mut editor = Editor::new();
    editor.open_as(&show, &SHOW.replace("after: raise + 500ms", "after: raise\n    end_by: 2s"));
    let found = editor.diagnosed(&show);
    assert_eq!(codes(&found), ["DB0026"]);
    let related = found[0]["relatedInformation"].as_array().unwrap();
    assert!(related.len() > 2, "{related:#?}");
    assert!(related.iter().all(|place| place["location"]["uri"] == uri(&show)), "{related:#?}");
}

#[test]
fn unsaved_changes_of_other_files_count() {
    let desk = desk();
    let (show, fleet, moves) = (desk.path("show.yaml"), desk.path("fleet.yaml"), desk.path("moves.yaml"));
    let mut editor = Editor::new();
    editor.open(&show);
    editor.open(&moves);
    assert_eq!(editor.diagnosed(&show), Vec::<Value>::new());
    let text = std::fs::read_to_string(&moves).unwrap();
    editor.change(&moves, &text.replace("height: 40", "height: 400"));
    assert_eq!(codes(&editor.diagnosed(&moves)), ["DB0011"]);
    editor.change(&moves, &text);
    assert_eq!(editor.diagnosed(&moves), Vec::<Value>::new());
    let text = std::fs::read_to_string(&fleet).unwrap();
    editor.open_as(&fleet, &text.replace("right", "write"));
    let found = editor.diagnosed(&fleet);
    assert_eq!(found, Vec::<Value>::new());
    editor.change(&fleet, &text.replace("address: sim}\ng", "adress: sim}\ng"));
    assert_eq!(codes(&editor.diagnosed(&fleet)), ["DB0004"]);
}

/// Returns the code and the line of each finding of `downbeat check` for a scenario that is in the given file.
pub fn checked(scenario: &Path, path: &Path) -> Vec<[String; 2]> {
    let folder = scenario.parent().unwrap();
    let output = Command::new(program())
        .args(["check", "--format", "json"])
        .arg(scenario)
        .current_dir(folder)
        .output()
        .unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let own = |finding: &&Value| {
        finding["file"].as_str().unwrap().ends_with(path.file_name().unwrap().to_str().unwrap())
    };
    let findings = report["findings"].as_array().unwrap().iter().filter(own);
    let of = |finding: &Value| {
        let line = finding["line"].as_u64().unwrap().max(1);
        [finding["code"].as_str().unwrap().to_owned(), line.to_string()]
    };
    sorted(findings.map(of).collect())
}

/// Returns the code and the line of each diagnostic.
pub fn places(diagnostics: &[Value]) -> Vec<[String; 2]> {
    let place = |diagnostic: &Value| {
        let line = diagnostic["range"]["start"]["line"].as_u64().unwrap() + 1;
        [diagnostic["code"].as_str().unwrap().to_owned(), line.to_string()]
    };
    sorted(diagnostics.iter().map(place).collect())
}

fn sorted(mut all: Vec<[String; 2]>) -> Vec<[String; 2]> {
    all.sort();
    all.dedup();
    all
}

/// Scenarios with every kind of mistake, whose findings a person has approved.
#[test]
fn findings_are_those_of_check() {
    let folder = root().join("tests/sessions/findings/folder");
    let mut editor = Editor::new();
    let mut compared = 0;
    for path in yaml_files(&folder) {
        let text = std::fs::read_to_string(&path).unwrap();
        if path.parent() != Some(&folder) || !text.contains("cues:") {
            continue;
        }
        let expected = checked(&path, &path);
        editor.open_as(&path, &text);
        let found = editor.diagnosed(&path);
        assert_eq!(places(&found), expected, "{}", path.display());
        editor.notify("textDocument/didClose", json!({"textDocument": {"uri": uri(&path)}}));
        compared += 1;
    }
    assert!(compared > 50, "only {compared} scenarios");
    editor.end();
}
