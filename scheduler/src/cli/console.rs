//! Printing. Colour only on a terminal and without NO_COLOR; a reader that has gone is no error, a full disk is one.
//!
//! While a mission runs everything goes through a thread of its own ([`super::outlet`]), so that a terminal that stands still
//! holds up nothing else. Commands that move nothing write at once and wait for their reader, as `less` wants it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

use anstyle::{AnsiColor, Style};
use downbeat_scripts::shown;
use serde::Serialize;

use super::Exit;
use super::outlet::{self, Display, Outlet, Stream};
use crate::show::UNBOUNDED;
use crate::show::table::wrapped;

const BOLD: Style = Style::new().bold();
const RED: Style = AnsiColor::Red.on_default().bold();
const YELLOW: Style = AnsiColor::Yellow.on_default().bold();

/// At the end of a mission: if nothing can be written for this long, the rest of the output is given up.
const IDLE_MAX: Duration = Duration::from_secs(3);

/// The threads that write, once there are any.
static OUTLETS: OnceLock<Outlets> = OnceLock::new();
/// Bytes of a JSON document that are printed together.
const DOCUMENT_PART: usize = 64 * 1_024;

/// Something was printed to standard output.
static PRINTED: AtomicBool = AtomicBool::new(false);
/// What was printed as an error, as far as a document of it stays readable.
static ERRORS: Mutex<Vec<String>> = Mutex::new(Vec::new());
const ERRORS_MAX: usize = 16;
/// Why standard output could not be written.
static FAILURE: Mutex<Option<String>> = Mutex::new(None);

struct Outlets {
    stderr: Outlet,
    /// `None` where both streams are one, so that one thread keeps their order.
    stdout: Option<Outlet>,
}

impl Outlets {
    fn start() -> std::io::Result<Self> {
        let stderr = Outlet::start("stderr")?;
        let stdout = if Stream::are_one() { None } else { Some(Outlet::start("stdout")?) };
        Ok(Self { stderr, stdout })
    }

    fn of(&self, stream: Stream) -> &Outlet {
        match (stream, &self.stdout) {
            (Stream::Stdout, Some(outlet)) => outlet,
            _ => &self.stderr,
        }
    }
}

/// From here on nothing that is printed makes its caller wait.
pub(super) fn never_wait() {
    if OUTLETS.get().is_none()
        && let Ok(outlets) = Outlets::start()
    {
        let _started_meanwhile = OUTLETS.set(outlets);
    }
}

/// Waits for what has not been written yet, within bounds if a mission ran. Returns the exit code of the process: output
/// that could not be written spoils a success.
pub(super) fn finish(exit: Exit) -> Exit {
    if let Some(outlets) = OUTLETS.get() {
        for outlet in [Some(&outlets.stderr), outlets.stdout.as_ref()].into_iter().flatten() {
            outlet.drain(IDLE_MAX).into_iter().for_each(fail);
        }
    }
    let failure = FAILURE.lock().unwrap_or_else(PoisonError::into_inner).take();
    let Some(failure) = failure else { return exit };
    error(&format!("cannot write to standard output: {failure}"));
    drain(IDLE_MAX);
    match exit {
        Exit::Done => Exit::Unwritten,
        other => other,
    }
}

fn fail(reason: String) {
    FAILURE.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(reason);
}

/// Waits for standard error, while something can be written within this time.
pub(super) fn drain(idle: Duration) {
    if let Some(outlets) = OUTLETS.get() {
        outlets.stderr.drain(idle);
    }
}

/// Draws this below the lines on standard error until [`end_display`].
pub(super) fn begin_display(display: Box<dyn Display>) {
    if let Some(outlets) = OUTLETS.get() {
        outlets.stderr.display(Some(display));
    }
}

/// Takes the display off the screen.
pub(super) fn end_display() {
    if let Some(outlets) = OUTLETS.get() {
        outlets.stderr.display(None);
    }
}

/// Prints to standard output: text of lines whose pieces from outside went through [`shown::shown`].
pub(super) fn print(text: &str) {
    let _failed = print_while_read(text);
}

/// Prints a part of an output. If it fails, nobody reads on, and the caller need not make the rest.
fn print_while_read(text: &str) -> std::io::Result<()> {
    PRINTED.store(true, Ordering::Relaxed);
    let text = Stream::Stdout.coloured(&shown::block(text)).into_owned();
    if let Some(outlets) = OUTLETS.get() {
        outlets.of(Stream::Stdout).keep(Stream::Stdout, text);
        return Ok(());
    }
    outlet::write_all(Stream::Stdout, text.as_bytes()).inspect_err(|error| {
        if error.kind() != std::io::ErrorKind::BrokenPipe {
            fail(error.to_string());
        }
    })
}

/// Prints lines to standard error whose pieces from outside went through [`shown::shown`].
pub(super) fn note_block(text: &str) {
    let text = format!("{}\n", text.trim_end_matches('\n'));
    let text = Stream::Stderr.coloured(&shown::block(&text)).into_owned();
    match OUTLETS.get() {
        Some(outlets) => outlets.stderr.offer(Stream::Stderr, text),
        None => {
            let _closed = outlet::write_all(Stream::Stderr, text.as_bytes());
        }
    }
}

/// Prints one sentence to standard error, whatever stands in it; on a terminal in lines that end between words.
pub(super) fn note(sentence: &str) {
    note_block(&fitted(sentence));
}

/// A text that says that something is wrong.
pub(super) fn red(text: &str) -> String {
    format!("{RED}{text}{RED:#}")
}

fn fitted(sentence: &str) -> String {
    let size = rustix::termios::tcgetwinsize(rustix::stdio::stderr());
    let columns = size.ok().map(|size| usize::from(size.ws_col)).filter(|columns| *columns > 0);
    wrapped(&shown::shown(sentence), columns.unwrap_or(UNBOUNDED))
}

/// Prints a document for a command that failed without one, so that machines read one whatever happens.
pub(super) fn document_failure(exit: Exit) {
    if exit == Exit::Done || PRINTED.load(Ordering::Relaxed) {
        return;
    }
    let errors = ERRORS.lock().unwrap_or_else(PoisonError::into_inner).join("; ");
    print_json(&serde_json::json!({ "error": errors }));
}

/// Keeps an error for [`document_failure`].
pub(super) fn remember_error(line: &str) {
    let mut errors = ERRORS.lock().unwrap_or_else(PoisonError::into_inner);
    if errors.len() < ERRORS_MAX {
        errors.push(line.to_owned());
    }
}

/// Prints something that went wrong, in one line.
pub(super) fn error(line: &str) {
    remember_error(line);
    note_block(&format!("{RED}error{RED:#}{BOLD}: {}{BOLD:#}", shown::shown(line)));
}

/// Prints something to look at, in one line.
pub(super) fn warn(line: &str) {
    note_block(&format!("{YELLOW}warning{YELLOW:#}{BOLD}: {}{BOLD:#}", shown::shown(line)));
}

/// Prints one JSON document, indented. A long one is printed while it is made.
pub(super) fn print_json(value: &impl Serialize) {
    let mut document = Document::default();
    match serde_json::to_writer_pretty(&mut document, value) {
        Ok(()) => document.end(),
        // The reason is kept already.
        Err(cause) if cause.is_io() => {}
        Err(cause) => error(&format!("cannot write JSON: {cause}")),
    }
}

/// A JSON document that is being made. What of it is not printed yet ends within a line.
#[derive(Default)]
struct Document(Vec<u8>);

impl Document {
    fn end(mut self) {
        self.0.push(b'\n');
        let _failed = self.print(self.0.len());
    }

    /// Prints its first bytes, which end with a line.
    fn print(&mut self, length: usize) -> std::io::Result<()> {
        let lines: Vec<u8> = self.0.drain(..length).collect();
        let lines = String::from_utf8(lines).map_err(std::io::Error::other)?;
        print_while_read(&shown::json(&lines))
    }
}

impl std::io::Write for Document {
    fn write(&mut self, part: &[u8]) -> std::io::Result<usize> {
        self.0.extend_from_slice(part);
        // Lines of other threads stay out of the document of a mission.
        if self.0.len() >= DOCUMENT_PART && OUTLETS.get().is_none() {
            // Within a string a line end is written out, so this one lies between two values.
            let length = self.0.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
            self.print(length)?;
        }
        Ok(part.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// The width of the terminal on standard output; elsewhere lines may be of any length.
pub(super) fn columns() -> usize {
    let size = rustix::termios::tcgetwinsize(rustix::stdio::stdout());
    size.ok().map(|size| usize::from(size.ws_col)).filter(|columns| *columns > 0).unwrap_or(UNBOUNDED)
}

/// Whether findings on standard error may be coloured.
pub(super) fn stderr_has_colour() -> bool {
    anstream::AutoStream::choice(&std::io::stderr()) != anstream::ColorChoice::Never
}

/// The log of `--log`: an event is a line on standard error, without colours.
pub(super) struct Log;

impl std::io::Write for Log {
    fn write(&mut self, event: &[u8]) -> std::io::Result<usize> {
        note(String::from_utf8_lossy(event).trim_end_matches('\n'));
        Ok(event.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
