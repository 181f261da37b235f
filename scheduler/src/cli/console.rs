//! Printing: colour only on a terminal, a closed pipe is no error.

use std::io::Write;

use anstyle::{AnsiColor, Style};
use serde::Serialize;

const BOLD: Style = Style::new().bold();
const RED: Style = AnsiColor::Red.on_default().bold();
const YELLOW: Style = AnsiColor::Yellow.on_default().bold();

/// Prints to standard output. Whoever reads it may have gone.
pub(super) fn print(text: &str) {
    let _closed = anstream::stdout().lock().write_all(text.as_bytes());
}

/// Prints a line to standard error.
pub(super) fn note(text: &str) {
    let _closed = writeln!(anstream::stderr().lock(), "{text}");
}

/// Prints something that went wrong.
pub(super) fn error(text: &str) {
    note(&format!("{RED}error{RED:#}{BOLD}: {text}{BOLD:#}"));
}

/// A text that says that something is wrong.
pub(super) fn red(text: &str) -> String {
    format!("{RED}{text}{RED:#}")
}

/// Prints something to look at.
pub(super) fn warn(text: &str) {
    note(&format!("{YELLOW}warning{YELLOW:#}{BOLD}: {text}{BOLD:#}"));
}

/// Prints one JSON document, indented.
pub(super) fn print_json(value: &impl Serialize) {
    match serde_json::to_string_pretty(value) {
        Ok(text) => print(&format!("{text}\n")),
        Err(cause) => error(&format!("no JSON: {cause}")),
    }
}

/// Whether findings on standard error may be coloured.
pub(super) fn stderr_has_colour() -> bool {
    anstream::AutoStream::choice(&std::io::stderr()) != anstream::ColorChoice::Never
}
