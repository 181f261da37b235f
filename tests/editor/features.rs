//! The features of the editor, each in a session.

use std::path::Path;

use serde_json::{Value, json};
use stage::editor::{Editor, position, uri};

use crate::{FLEET, MOVES, SHOW, desk};

/// Types a text in place of a part of the show, and returns the labels of the completions at its end.
#[track_caller]
fn completed(editor: &mut Editor, show: &Path, part: &str, typed: &str) -> Vec<String> {
    assert!(SHOW.contains(part), "{part}");
    let text = SHOW.replacen(part, typed, 1);
    editor.change(show, &text);
    let items = editor.request("textDocument/completion", position(show, &text, typed));
    items.as_array().unwrap().iter().map(|item| item["label"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn completion_offers_what_may_stand_at_the_cursor() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let mut editor = Editor::new();
    editor.open(&show);
    editor.diagnosed(&show);
    let mut offers = |part: &str, typed: &str| completed(&mut editor, &show, part, typed);
    assert_eq!(offers("robots: left", "robots: "), ["both", "left", "right"]);
    assert_eq!(offers("robots: both", "robots: [left, "), ["both", "left", "right"]);
    assert_eq!(offers("move: wave", "move: wa"), ["wave"]);
    assert_eq!(offers("after: raise + 500ms", "after: "), ["raise", "shine"]);
    assert_eq!(offers("uses: table", "uses: "), ["table"]);
    assert_eq!(offers("      lamp:", "      "), ["joint", "lamp"]);
    assert_eq!(offers("move: wave", "move: wave\n    parameters: {"), ["high"]);
    assert_eq!(offers("to: 50", "to: $"), ["$height"]);
    let keys = offers("    uses: table", "    ca");
    assert!(keys.contains(&"canon".to_owned()) && !keys.contains(&"robots".to_owned()), "{keys:?}");
    let keys = offers("zones: [table]", "ord");
    assert!(keys.contains(&"order".to_owned()) && !keys.contains(&"scenario".to_owned()), "{keys:?}");
    assert_eq!(offers("zones: [table]", "order: "), ["given", "auto"]);
    let eases = offers("{at: 1s, to: 50}", "{at: 1s, to: 50, ease: ");
    assert!(eases.contains(&"smooth".to_owned()), "{eases:?}");
    editor.end();
}

#[test]
fn completed_devices_have_ranges_and_keys_have_documentation() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let mut editor = Editor::new();
    editor.open(&show);
    editor.diagnosed(&show);
    let text = SHOW.replace("      lamp:", "      la");
    editor.change(&show, &text);
    let items = editor.request("textDocument/completion", position(&show, &text, "      la"));
    assert_eq!(items[1]["detail"], "position 0 to 100 percent");
    assert_eq!(items[1]["textEdit"]["newText"], "lamp: ");
    let text = SHOW.replace("    uses: table", "    us");
    editor.change(&show, &text);
    let items = editor.request("textDocument/completion", position(&show, &text, "    us"));
    let uses = items.as_array().unwrap().iter().find(|item| item["label"] == "uses").unwrap();
    assert_eq!(uses["documentation"]["value"], "Zones that it needs.");
}

/// Returns each place as `file:line` with lines from 1.
fn places(locations: &Value) -> Vec<String> {
    let place = |location: &Value| {
        let file = location["uri"].as_str().unwrap().rsplit('/').next().unwrap();
        format!("{file}:{}", location["range"]["start"]["line"].as_u64().unwrap() + 1)
    };
    locations.as_array().unwrap().iter().map(place).collect()
}

#[test]
fn definitions_and_references_cross_files() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let mut editor = Editor::new();
    editor.open(&show);
    let mut at = |before: &str| {
        let place = position(&show, SHOW, before);
        let found = editor.request("textDocument/definition", place.clone());
        let mut params = place;
        params["context"] = json!({"includeDeclaration": false});
        let references = editor.request("textDocument/references", params);
        [places(&found), places(&references)]
    };
    assert_eq!(at("move: wa"), [["moves.yaml:3"], ["show.yaml:8"]]);
    assert_eq!(at("robots: lef"), [vec!["fleet.yaml:2"], vec!["show.yaml:12", "fleet.yaml:4"]]);
    assert_eq!(at("after: rai"), [["show.yaml:5"], ["show.yaml:11"]]);
    assert_eq!(at("uses: ta"), [["show.yaml:3"], ["show.yaml:9"]]);
    let moves = desk.path("moves.yaml");
    let found = editor.request("textDocument/definition", position(&moves, MOVES, "to: $hi"));
    assert_eq!(places(&found), ["moves.yaml:5"]);
    let found = editor.request("textDocument/definition", position(&moves, MOVES, "high: $hei"));
    assert_eq!(places(&found), ["moves.yaml:1"]);
    let found = editor.request("textDocument/definition", position(&show, SHOW, "include: mov"));
    assert_eq!(places(&found), ["moves.yaml:1"]);
}

#[test]
fn renaming_changes_all_files() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let mut editor = Editor::new();
    editor.open(&show);
    let mut params = position(&show, SHOW, "robots: lef");
    params["newName"] = json!("first");
    let edit = editor.request("textDocument/rename", params);
    assert_eq!(
        applied(FLEET, &edit["changes"][uri(&desk.path("fleet.yaml"))]),
        FLEET.replace("left", "first")
    );
    assert_eq!(applied(SHOW, &edit["changes"][uri(&show)]), SHOW.replace("left", "first"));
    for (before, new, refusal) in [
        ("robots: lef", "both", "`both` is already in use"),
        ("robots: lef", "a b", "`a b` is not a name"),
        ("      la", "light", "`lamp` is defined by the robot itself"),
        ("scenario: hel", "x", "there is no name here"),
    ] {
        let mut params = position(&show, SHOW, before);
        params["newName"] = json!(new);
        let refused = editor.try_request("textDocument/rename", params).unwrap_err();
        assert!(refused.contains(refusal), "{refused}");
    }
}

/// Applies edits that do not overlap, each within a line.
fn applied(text: &str, edits: &Value) -> String {
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let mut edits: Vec<&Value> = edits.as_array().unwrap().iter().collect();
    let number = |value: &Value| usize::try_from(value.as_u64().unwrap()).unwrap();
    let start = |edit: &&Value| {
        (number(&edit["range"]["start"]["line"]), number(&edit["range"]["start"]["character"]))
    };
    edits.sort_by_key(start);
    for edit in edits.iter().rev() {
        let (line, from) = start(edit);
        let to = number(&edit["range"]["end"]["character"]);
        lines[line].replace_range(from..to, edit["newText"].as_str().unwrap());
    }
    lines.join("\n") + "\n"
}

#[test]
fn hover_and_hints_show_the_solved_times() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let mut editor = Editor::new();
    editor.open(&show);
    editor.refreshed();
    let range = json!({"start": {"line": 0, "character": 0}, "end": {"line": 99, "character": 0}});
    let hints = editor
        .request("textDocument/inlayHint", json!({"textDocument": {"uri": uri(&show)}, "range": range}));
    let labels: Vec<&str> =
        hints.as_array().unwrap().iter().map(|hint| hint["label"].as_str().unwrap()).collect();
    assert_eq!(labels, ["1 s for 2 s", "3.5 s for 1 s"]);
    assert_eq!(hints[0]["position"], json!({"line": 4, "character": 14}));
    let mut hover = |before: &str| {
        let hover = editor.request("textDocument/hover", position(&show, SHOW, before));
        hover["contents"]["value"].as_str().unwrap_or_default().to_owned()
    };
    let text = hover("cue: rai");
    assert!(text.starts_with("cue `raise`: from 1 s to 3 s (2 s), on the critical path"), "{text}");
    assert!(text.contains("| left/joint | ▁") && text.contains("█") && text.contains(" of 200 |"), "{text}");
    assert!(hover("after: rai").starts_with("cue `raise`: from 1 s"));
    assert_eq!(hover("move: wa"), "move `wave`: Lifts and drops the joint.");
    assert_eq!(hover("robots: bo"), "robot `both`: group of left, right");
    assert_eq!(hover("      la"), "device `lamp`: position 0 to 100 percent");
    assert!(hover("    us").starts_with("`uses`: Zones that it needs."));
}

#[test]
fn symbols_and_folds_follow_the_structure() {
    let desk = desk();
    let (show, moves) = (desk.path("show.yaml"), desk.path("moves.yaml"));
    let text = "scenario: s\nacts:\n  - act: one\n    cues:\n      - cue: a\n        at: 0s\n      - {cue: b}\n  - act: two\n    cues: [{cue: c}]\n";
    let mut editor = Editor::new();
    editor.open_as(&show, text);
    editor.open(&moves);
    let mut symbols = |path: &Path| {
        let symbols =
            editor.request("textDocument/documentSymbol", json!({"textDocument": {"uri": uri(path)}}));
        let named = |symbol: &Value| {
            let children = symbol["children"].as_array().cloned().unwrap_or_default();
            let children: Vec<&str> = children.iter().map(|child| child["name"].as_str().unwrap()).collect();
            format!("{}: {}", symbol["name"].as_str().unwrap(), children.join(" "))
        };
        symbols.as_array().unwrap().iter().map(named).collect::<Vec<_>>()
    };
    assert_eq!(symbols(&show), ["one: a b", "two: c"]);
    assert_eq!(symbols(&moves), ["height: ", "wave: "]);
    let folds = editor.request("textDocument/foldingRange", json!({"textDocument": {"uri": uri(&show)}}));
    let lines = |fold: &Value| format!("{}-{}", fold["startLine"], fold["endLine"]);
    let folds: Vec<String> = folds.as_array().unwrap().iter().map(lines).collect();
    assert_eq!(folds, ["1-8", "2-6", "3-6", "4-5", "7-8"]);
}

#[test]
fn formatting_changes_spaces_and_keeps_comments() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let text = SHOW
        .replace("to: 0}, {at", "to:   0},{at")
        .replace("zones: [table]", "zones: [ table ] # one at a time");
    let mut editor = Editor::new();
    editor.open_as(&show, &text);
    let params =
        json!({"textDocument": {"uri": uri(&show)}, "options": {"tabSize": 2, "insertSpaces": true}});
    let edits = editor.request("textDocument/formatting", params.clone());
    let expected = SHOW.replace("zones: [table]", "zones: [table] # one at a time");
    assert_eq!(edits[0]["newText"].as_str(), Some(expected.as_str()));
    editor.change(&show, &expected);
    assert_eq!(editor.request("textDocument/formatting", params), json!([]));
}
