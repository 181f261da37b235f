//! The first steps of a newcomer: the shows that `init` writes, and the tours of README and tutorial. They are played word for word on
//! real processes.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration;

use tempfile::TempDir;

use stage::free_port;
use stage::held_up::played;
use stage::session::{Ran, program, root};

fn downbeat(folder: &Path, args: &[&str]) -> Ran {
    let mut command = Command::new(program());
    command.args(args).current_dir(folder).env("DOWNBEAT_STATE", folder.join(".state")).stdin(Stdio::null());
    Ran(command.output().unwrap())
}

/// The templates of `downbeat init`, and for each whether its show waits for the operator.
const TEMPLATES: [(&str, bool); 4] = [("arms", false), ("drones", false), ("stage", true), ("edge", false)];

#[test]
fn every_template_runs_without_changes() {
    for (template, waits) in TEMPLATES {
        let folder = TempDir::new().unwrap();
        let folder = folder.path();
        let wrote = downbeat(folder, &["init", "--template", template, "--format", "json"]);
        assert_eq!(wrote.code(), 0, "{}", wrote.text());
        for file in wrote.json()["files"].as_array().unwrap() {
            assert!(folder.join(file.as_str().unwrap()).is_file(), "{template}: {file}");
        }
        let checked = downbeat(folder, &["check", "show.yaml", "--deny", "warnings"]);
        checked.says(0, &["no errors"]);
        let dry = downbeat(folder, &["dry-run", "show.yaml", "--format", "json"]);
        assert_eq!((dry.code(), dry.json()["outcome"].as_str()), (0, Some("done")), "{template}");
        if waits {
            let mut command = Command::new(program());
            command
                .args(["run", "show.yaml"])
                .current_dir(folder)
                .env("DOWNBEAT_STATE", folder.join(".state"));
            let run =
                command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
            // The mission may not exist yet, or not wait yet.
            while downbeat(folder, &["go"]).code() != 0 {
                std::thread::sleep(Duration::from_millis(200));
            }
            Ran(run.wait_with_output().unwrap()).says(0, &["show: done"]);
        } else {
            let played = played(|| downbeat(folder, &["run", "show.yaml"]), Ran::text);
            played.says(0, &["show: done"]);
        }
    }
}

/// A code block of a document, as a newcomer would use it.
enum Block {
    /// Shell commands, and whether the last one is expected to fail.
    Commands {
        text: String,
        fails: bool,
    },
    File {
        name: String,
        text: String,
    },
    /// Output of the preceding commands, and whether it contains measurements of a mission, which differ in each run.
    Output {
        text: String,
        measured: bool,
    },
}

fn tour(document: &str) -> Vec<Block> {
    let text = fs::read_to_string(root().join(document)).unwrap();
    let mut blocks = Vec::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let Some(opening) = line.strip_prefix("```").filter(|opening| !opening.is_empty()) else { continue };
        let inside = lines.by_ref().take_while(|line| *line != "```");
        let text = inside.fold(String::new(), |text, line| text + line + "\n");
        match opening {
            "sh tour" | "sh tour fails" => {
                blocks.push(Block::Commands { text, fails: opening.ends_with("fails") });
            }
            "text" | "text measured" => {
                blocks.push(Block::Output { text, measured: opening.ends_with("measured") });
            }
            _ => {
                let name = opening.strip_prefix("yaml file ").map(str::to_owned);
                blocks.extend(name.map(|name| Block::File { name, text }));
            }
        }
    }
    blocks
}

/// Returns a shell script that plays all blocks in one shell, as a newcomer would: it changes the folder, and robots run in the
/// background.
fn script(blocks: &[Block], out: &Path) -> String {
    let mut script = String::from("trap 'kill $(jobs -p) 2>/dev/null' EXIT\n");
    for (number, block) in blocks.iter().enumerate() {
        match block {
            Block::Commands { text, fails } => {
                writeln!(script, "exec >'{}' 2>&1", out.join(number.to_string()).display()).unwrap();
                let expected = u8::from(*fails);
                for line in text.lines() {
                    let last = text.lines().last() == Some(line);
                    writeln!(script, "{line}\ncode=$?").unwrap();
                    let expected = if last { expected } else { 0 };
                    writeln!(
                        script,
                        "[ $code = {expected} ] || {{ echo \"ended with code $code\"; exit 9; }}"
                    )
                    .unwrap();
                }
                if text.contains(" &\n") {
                    script += "sleep 2\n";
                }
            }
            Block::File { name, text } => {
                writeln!(script, "cat > '{name}' <<'END OF FILE'\n{text}END OF FILE").unwrap();
            }
            Block::Output { .. } => {}
        }
    }
    script
}

#[test]
fn readme_tour_works_verbatim_in_an_empty_folder() {
    works_word_for_word("README.md");
}

#[test]
fn tutorial_works_verbatim_in_an_empty_folder() {
    works_word_for_word("docs/tutorial.md");
}

/// Plays the commands of a document in an empty folder. Returns the exit status of the shell, and the output of each block.
fn play(blocks: &[Block]) -> (ExitStatus, Vec<String>) {
    let folder = TempDir::new().unwrap();
    let out = TempDir::new().unwrap();
    let mut script = script(blocks, out.path());
    for port in ["7401", "7402"] {
        script = script.replace(port, &free_port().to_string());
    }
    let paths = std::env::var("PATH").unwrap();
    let program = Path::new(program()).parent().unwrap().display().to_string();
    let mut shell = Command::new("bash");
    shell.arg("-c").arg(&script).current_dir(folder.path()).stdin(Stdio::null());
    shell.env("PATH", format!("{program}:{paths}")).env("DOWNBEAT_STATE", folder.path().join(".state"));
    let ended = shell.status().unwrap();
    let printed = |number: usize| fs::read_to_string(out.path().join(number.to_string())).unwrap_or_default();
    (ended, (0..blocks.len()).map(printed).collect())
}

/// Returns a line without the digits of measurements: times of day, decimal numbers, and uncertainties (`±`).
fn without_measurements(line: &str) -> String {
    let measured = |word: &str| word.contains('.') || word.starts_with('±');
    let without_digits = |word: &str| word.replace(|c: char| c.is_ascii_digit() || c == '.', "");
    let words = line.split(' ');
    let words = words.map(|word| if measured(word) { without_digits(word) } else { word.to_owned() });
    words.collect::<Vec<_>>().join(" ")
}

/// Plays every command of a document, and compares the output that the document quotes with the actual output.
#[track_caller]
fn works_word_for_word(document: &str) {
    let blocks = tour(document);
    assert!(blocks.iter().filter(|block| matches!(block, Block::Commands { .. })).count() >= 4);
    let (ended, printed) = played(|| play(&blocks), |(_, printed)| printed.concat());
    assert!(ended.success(), "{ended}\n{}", printed.concat());
    // Every quoted line occurs in the output of the preceding commands, in the same order.
    let mut before = String::new();
    for (number, block) in blocks.iter().enumerate() {
        match block {
            Block::Commands { .. } => before.clone_from(&printed[number]),
            Block::Output { text, measured } => {
                let same = |line: &str, quoted: &str| match measured {
                    true => without_measurements(line) == without_measurements(quoted),
                    false => line == quoted,
                };
                let mut lines = before.lines();
                for quoted in text.lines().filter(|line| *line != "...") {
                    assert!(
                        lines.any(|line| same(line, quoted)),
                        "`{quoted}` is not what was printed:\n{before}"
                    );
                }
            }
            Block::File { .. } => {}
        }
    }
}
