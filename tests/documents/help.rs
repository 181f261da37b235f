//! Tests help texts at any terminal width: no line is longer than the terminal is wide, and no line breaks before it is full.

use std::process::Command;

use stage::play::SOON;
use stage::session::program;
use stage::terminal::Terminal;

/// Returns all commands and subcommands of the program, as listed in its own help.
pub fn commands() -> Vec<String> {
    let mut commands = vec![String::new()];
    let mut next = 0;
    while let Some(command) = commands.get(next).cloned() {
        let help = Command::new(program()).args(command.split_whitespace()).arg("-h").output().unwrap();
        let help = String::from_utf8(help.stdout).unwrap();
        let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1);
        // Further lines of a long description are indented more than the names.
        let listed = listed.take_while(|line| !line.is_empty()).filter(|line| indentation(line) == 2);
        let names = listed.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help");
        commands.extend(names.map(|name| format!("{command} {name}").trim().to_owned()));
        next += 1;
    }
    commands
}

/// Maximum width of help lines in characters, even in wider terminals, because longer lines are hard to read.
const WIDEST: usize = 100;

/// Returns the help text of a command in a terminal of the given width. `option` is the option that requests it.
fn help(command: &str, option: &str, columns: u16) -> String {
    let terminal = Terminal::new(columns, 50);
    let watched = terminal.watch();
    let mut program = Command::new(program());
    program.args(command.split_whitespace()).arg(option);
    terminal.attach(&mut program);
    // Marks the end of the output with a line that no help text contains.
    assert!(program.env("NO_COLOR", "1").status().unwrap().success(), "{command}");
    Command::new("echo").arg("THE END").stdout(terminal.end()).status().unwrap();
    watched.shows("THE END", SOON);
    let text = watched.raw().replace('\r', "");
    text.split("THE END").next().unwrap().to_owned()
}

fn indentation(line: &str) -> usize {
    line.len() - line.trim_start().len()
}

/// Whether a line is not part of a paragraph, such as a heading, a list item, an example or a default.
fn stands_alone(line: &str) -> bool {
    let text = line.trim_start();
    let listed = ["- ", "[", "downbeat ", "Usage: ", "-"].iter().any(|start| text.starts_with(start));
    listed || text.ends_with(':') || text.split("  ").count() > 1
}

#[track_caller]
fn check_that_it_fills(command: &str, option: &str, columns: u16) {
    let text = help(command, option, columns);
    let width = usize::from(columns);
    assert!(text.contains("Usage: downbeat"), "{command}: {text}");
    for line in text.lines() {
        // A usage line is never wrapped, so it may exceed the width.
        let words = if line.starts_with("Usage: ") { 1 } else { line.split_whitespace().count() };
        assert!(line.chars().count() <= width || words <= 1, "{command} at {columns}: `{line}`\n{text}");
    }
    let lines: Vec<&str> = text.lines().collect();
    for pair in lines.windows(2) {
        let (line, next) = (pair[0], pair[1]);
        let together = !line.trim().is_empty() && !next.trim().is_empty();
        // Examples and lists are indented by two; there, each line is an entry.
        let paragraph = indentation(line) == indentation(next) && indentation(line) != 2;
        if !together || !paragraph || stands_alone(line) || stands_alone(next) {
            continue;
        }
        let word = next.split_whitespace().next().unwrap_or_default();
        let full = line.chars().count() + 1 + word.chars().count() > width.min(WIDEST);
        assert!(full, "{command} {option} at {columns}: `{word}` would fit behind `{line}`\n{text}");
    }
}

#[test]
fn help_fills_terminal_width_without_exceeding_it() {
    let commands = commands();
    let left = std::sync::Mutex::new(commands.iter());
    let work = || {
        while let Some(command) = { left.lock().unwrap().next() } {
            for columns in [40, 60, 80, 100, 200] {
                check_that_it_fills(command, "--help", columns);
                check_that_it_fills(command, "-h", columns);
            }
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..4).map(|_| scope.spawn(work)).collect();
        workers.into_iter().for_each(|worker| worker.join().unwrap());
    });
}
