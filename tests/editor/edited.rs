//! Texts that are being written: every file of the examples, cut off at every line and in the middle of lines.

use std::path::Path;

use serde_json::{Value, json};
use stage::editor::{Editor, uri};
use stage::session::root;

use crate::findings::{checked, places};
use crate::{SHOW, codes, desk, yaml_files};

/// Sends every request at the end of the text.
fn request_all(editor: &mut Editor, path: &Path, text: &str) {
    let line = text.matches('\n').count();
    let column = text.rsplit('\n').next().unwrap_or_default().encode_utf16().count();
    let document = json!({"uri": uri(path)});
    let position = json!({"line": line, "character": column});
    let range = json!({"start": {"line": 0, "character": 0}, "end": position});
    let at = json!({"textDocument": document, "position": position, "newName": "x", "context": {"includeDeclaration": true}});
    for method in ["completion", "hover", "definition", "references", "prepareRename", "rename"] {
        editor.try_request(&format!("textDocument/{method}"), at.clone()).ok();
    }
    for method in ["documentSymbol", "foldingRange", "inlayHint"] {
        editor.request(&format!("textDocument/{method}"), json!({"textDocument": document, "range": range}));
    }
}

#[test]
fn every_request_is_answered_in_half_typed_files() {
    let files = yaml_files(&root().join("scripts/examples"));
    assert!(files.len() > 10);
    let mut editor = Editor::new();
    for path in files {
        let whole = std::fs::read_to_string(&path).unwrap();
        editor.open_as(&path, "");
        for (number, line) in whole.split_inclusive('\n').enumerate() {
            let before: usize = whole.split_inclusive('\n').take(number).map(str::len).sum();
            let half = (0..=line.len() / 2).rev().find(|half| line.is_char_boundary(*half)).unwrap();
            for end in [before + half, before + line.trim_end().len()] {
                editor.change(&path, &whole[..end]);
                request_all(&mut editor, &path, &whole[..end]);
            }
        }
        editor.change(&path, &whole);
        let found = editor.diagnosed(&path);
        let errors: Vec<&Value> = found.iter().filter(|found| found["severity"] == 1).collect();
        assert_eq!(errors, Vec::<&Value>::new(), "{}", path.display());
        editor.notify("textDocument/didClose", json!({"textDocument": {"uri": uri(&path)}}));
    }
    editor.end();
}

/// Random edits, each as the editor sends it. After every few, the findings are those of `downbeat check` for the same text.
#[test]
fn findings_after_random_edits_are_those_of_check() {
    let rounds = std::env::var("DOWNBEAT_EDITS").map_or(30, |rounds| rounds.parse().unwrap());
    let mut rng = fastrand::Rng::new();
    let (mut edited, saved) = (desk(), desk());
    let mut editor = Editor::new();
    for round in 0..rounds {
        if round % 10 == 0 {
            edited = desk();
        }
        let seed = rng.u64(..);
        let mut random = fastrand::Rng::with_seed(seed);
        let show = edited.path(if random.bool() { "show.yaml" } else { "moves.yaml" });
        let mut text = std::fs::read_to_string(&show).unwrap();
        editor.open(&show);
        for _ in 0..random.usize(1..4) {
            let change = random_change(&mut random, &mut text);
            editor.edit(&show, change);
            request_all(&mut editor, &show, &text);
        }
        let found = editor.diagnosed(&show);
        let copy = saved.path(show.file_name().unwrap().to_str().unwrap());
        let before = std::fs::read_to_string(&copy).unwrap();
        std::fs::write(&copy, &text).unwrap();
        let expected = checked(&saved.path("show.yaml"), &copy);
        assert_eq!(places(&found), expected, "seed {seed}:\n{text}");
        std::fs::write(&copy, before).unwrap();
        editor.notify("textDocument/didClose", json!({"textDocument": {"uri": uri(&show)}}));
    }
    editor.end();
}

/// Applies a random edit to a text of ASCII characters: replaces a few of them, or copies some from elsewhere.
fn random_change(random: &mut fastrand::Rng, text: &mut String) -> Value {
    let start = random.usize(..=text.len());
    let end = (start + random.usize(..6)).min(text.len());
    let from = random.usize(..=text.len());
    let copied = text[from..(from + random.usize(..20)).min(text.len())].to_owned();
    let new = if random.bool() {
        copied
    } else {
        ["", " ", "\n", ": ", "- ", "{", "]", "$x", "\"", "9"][random.usize(..10)].to_owned()
    };
    let position = |byte: usize| {
        let line = text[..byte].matches('\n').count();
        json!({"line": line, "character": byte - text[..byte].rfind('\n').map_or(0, |end| end + 1)})
    };
    let change = json!({"range": {"start": position(start), "end": position(end)}, "text": new});
    text.replace_range(start..end, &new);
    change
}

/// Edits that arrive faster than checks end.
#[test]
fn last_of_many_edits_is_checked() {
    let desk = desk();
    let show = desk.path("show.yaml");
    let mut editor = Editor::new();
    editor.open(&show);
    for count in 0..200 {
        editor.change(&show, &SHOW.replace("to: 50", &format!("to: {count}")));
    }
    assert_eq!(codes(&editor.diagnosed(&show)), ["DB0011"]);
    editor.change(&show, SHOW);
    assert_eq!(editor.diagnosed(&show), Vec::<Value>::new());
    editor.end();
}
