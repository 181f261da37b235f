//! Measures the time until an editor has the findings of a show of 5,000 lines: after opening it, and after each of 50 edits. Completion and
//! hover are measured too. The baseline is the compiler alone, without the language server.
//!
//! `cargo bench -p downbeat-lsp --bench editor`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]
#![expect(clippy::disallowed_methods, reason = "a benchmark measures time")]

use std::fmt::Write;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use downbeat_scripts::{Folder, Source, compile, read_fleet};
use serde_json::json;
use stage::editor::{Editor, position};

const ROBOTS: usize = 24;
const LINES: usize = 5_000;
const EDITS: usize = 50;

const ROBOT: &str = r#"id: arm
api_version: "1"
devices:
  - id: joint
    interpolation: linear
    script_queue: 4
    available_control_types:
      position: {min_value: -90, max_value: 90, granularity: 0.01}
      script: {min_value: -90, max_value: 90, granularity: 0.01, max_number_of_steps: 10000}
  - id: lamp
    interpolation: hold
    script_queue: 4
    available_control_types:
      position: {min_value: 0, max_value: 100, granularity: 1}
      script: {min_value: 0, max_value: 100, granularity: 1, max_number_of_steps: 10000}
"#;

/// Writes a show in which each robot moves in turn, each cue after one before it.
fn show(folder: &Path) -> String {
    std::fs::write(folder.join("arm.yaml"), ROBOT).unwrap();
    let mut fleet = "robots:\n".to_owned();
    (0..ROBOTS).for_each(|robot| writeln!(fleet, "  r{robot}: {{init: arm.yaml, address: sim}}").unwrap());
    std::fs::write(folder.join("fleet.yaml"), fleet).unwrap();
    let mut show = "scenario: long\nmoves:\n  wave:\n    parameters: {high: 30}\n    tracks:\n".to_owned();
    show.push_str(
        "      joint: [{at: 0s, to: 0}, {at: 1s, to: $high, ease: smooth}, {at: 2s, to: 0}]\ncues:\n",
    );
    let mut lines = show.lines().count();
    let mut cue = 0;
    while lines < LINES {
        let robot = cue % ROBOTS;
        let begin =
            if cue < ROBOTS { "at: 1s".to_owned() } else { format!("after: c{} + 100ms", cue - ROBOTS) };
        writeln!(show, "  - cue: c{cue}\n    {begin}\n    robots: r{robot}").unwrap();
        if cue % 2 == 0 {
            writeln!(show, "    move: wave\n    parameters: {{high: {}}}", cue % 60).unwrap();
        } else {
            let level = cue % 100;
            writeln!(
                show,
                "    tracks:\n      lamp:\n        - {{at: 0s, to: 0}}\n        - {{at: 1s, to: {level}}}"
            )
            .unwrap();
        }
        cue += 1;
        lines = show.lines().count();
    }
    std::fs::write(folder.join("show.yaml"), &show).unwrap();
    show
}

fn compiled(folder: &Path, text: &str) -> Duration {
    let source = Source { name: "show.yaml".to_owned(), text: text.to_owned() };
    let begin = Instant::now();
    let (fleet, _) = read_fleet(&folder.join("fleet.yaml"));
    let compiled = compile(&source, &fleet.unwrap(), &Folder::new(folder.to_path_buf()));
    assert!(compiled.choreography.is_some(), "{:#?}", compiled.findings);
    begin.elapsed()
}

/// The argument with which this program starts itself as the server.
const SERVER: &str = "--server";

fn main() {
    if std::env::args().any(|argument| argument == SERVER) {
        downbeat_lsp::serve().unwrap();
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let text = show(folder.path());
    let path = folder.path().join("show.yaml");
    let alone = median((0..9).map(|_| compiled(folder.path(), &text)).collect());
    println!("{} lines; the compiler alone takes {} ms", text.lines().count(), millis(alone));

    let begin = Instant::now();
    let mut editor = Editor::with(Command::new(std::env::current_exe().unwrap()).arg(SERVER));
    let started = begin.elapsed();
    let begin = Instant::now();
    editor.open_as(&path, &text);
    assert!(editor.diagnosed(&path).is_empty());
    report("first findings after opening", begin.elapsed(), alone);
    println!("the server starts in {} ms", millis(started));

    let line = text.lines().position(|line| line.contains("high: 30}")).unwrap();
    let mut edits = Vec::new();
    for edit in 0..EDITS {
        // An invalid value and a valid one in turn, each with its diagnostics.
        let value = if edit % 2 == 0 { "99" } else { "30" };
        let range = json!({"start": {"line": line, "character": 23}, "end": {"line": line, "character": 25}});
        let begin = Instant::now();
        editor.edit(&path, json!({"range": range, "text": value}));
        editor.diagnosed(&path);
        edits.push(begin.elapsed());
        // The editor pauses before the next edit, during which the server places the cues.
        editor.request(
            "textDocument/foldingRange",
            json!({"textDocument": {"uri": stage::editor::uri(&path)}}),
        );
    }
    edits.sort_unstable();
    report("findings after an edit, median", edits[EDITS / 2], alone);
    report("findings after an edit, largest", edits[EDITS - 1], alone);
    for method in ["completion", "hover", "definition", "references"] {
        let mut params = position(&path, &text, "after: c1");
        params["context"] = json!({"includeDeclaration": true});
        let begin = Instant::now();
        editor.request(&format!("textDocument/{method}"), params);
        report(method, begin.elapsed(), alone);
    }
    editor.end();
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times[times.len() / 2]
}

fn millis(time: Duration) -> String {
    format!("{:.1}", time.as_secs_f64() * 1e3)
}

fn report(what: &str, time: Duration, alone: Duration) {
    println!(
        "{what}: {} ms, {:.1} times the compiler alone",
        millis(time),
        time.as_secs_f64() / alone.as_secs_f64()
    );
}
