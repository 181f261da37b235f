//! Prints the output of all commands. Colours are used only on a terminal and without NO_COLOR. A reader that closes its pipe is not an
//! error, but a full disk is.
//!
//! While a mission runs, all output goes through a separate thread ([`super::outlet`]), so that a blocked terminal delays nothing else.
//! Commands that move nothing write directly and wait for their reader, as `less` requires.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

use anstyle::{AnsiColor, Style};
use downbeat_scripts::shown;
use serde::Serialize;

use super::Exit;
use super::outlet::{self, Display, Outlet, Stream};
use crate::show::table::wrapped;
use crate::show::{Detail, UNBOUNDED};

const BOLD: Style = Style::new().bold();
const RED: Style = AnsiColor::Red.on_default().bold();
const YELLOW: Style = AnsiColor::Yellow.on_default().bold();

/// If, at the end of a mission, nothing can be written for this long, the rest of the output is dropped.
const IDLE_MAX: Duration = Duration::from_secs(3);

/// The queues of the threads that write the output. Empty until the threads have started.
static OUTLETS: OnceLock<Outlets> = OnceLock::new();
/// Size, in bytes, of the parts in which a long JSON document is printed.
const DOCUMENT_PART: usize = 64 * 1_024;

/// Whether anything was printed to standard output.
static PRINTED: AtomicBool = AtomicBool::new(false);
/// The printed errors, at most [`ERRORS_MAX`], so that a JSON document that contains them stays readable.
static ERRORS: Mutex<Vec<String>> = Mutex::new(Vec::new());
const ERRORS_MAX: usize = 16;
/// The reason why writing to standard output failed. `None` if it has not failed.
static FAILURE: Mutex<Option<String>> = Mutex::new(None);

/// Whether `--verbose` was given.
static IS_VERBOSE: AtomicBool = AtomicBool::new(false);

/// Options for the output of a mission.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct OutputArgs {
    /// Also print the figures of clocks, leases and scripts, with a row per robot.
    #[arg(long, short)]
    verbose: bool,
}

impl OutputArgs {
    /// Applies the options to all further output of this process.
    pub(super) fn apply(self) {
        IS_VERBOSE.store(self.verbose, Ordering::Relaxed);
    }
}

/// Returns how much of a mission's report to print.
pub(super) fn detail() -> Detail {
    if IS_VERBOSE.load(Ordering::Relaxed) { Detail::Full } else { Detail::Brief }
}

struct Outlets {
    stderr: Outlet,
    /// The queue for standard output. `None` if both streams go to the same terminal, pipe or file: one thread then preserves their
    /// order.
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

/// Starts the threads that write the output, so that printing no longer blocks the caller.
pub(super) fn never_wait() {
    if OUTLETS.get().is_none()
        && let Ok(outlets) = Outlets::start()
    {
        let _started_meanwhile = OUTLETS.set(outlets);
    }
}

/// Waits until the remaining output is written, with a time limit if a mission ran. Returns the exit code of the process, which is a
/// failure if output could not be written.
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

/// Waits until all queued output is written to standard error, or until no write succeeds within `idle`.
pub(super) fn drain(idle: Duration) {
    if let Some(outlets) = OUTLETS.get() {
        outlets.stderr.drain(idle);
    }
}

/// Draws a display below the lines on standard error until [`end_display`].
pub(super) fn begin_display(display: Box<dyn Display>) {
    if let Some(outlets) = OUTLETS.get() {
        outlets.stderr.display(Some(display));
    }
}

/// Removes the display that [`begin_display`] started.
pub(super) fn end_display() {
    if let Some(outlets) = OUTLETS.get() {
        outlets.stderr.display(None);
    }
}

/// Prints lines to standard output. Text from outside must have been escaped by [`shown::shown`].
pub(super) fn print(text: &str) {
    let _failed = print_while_read(text);
}

/// Prints a part of an output. Returns an error if nothing can be printed any longer; the caller then need not produce the rest.
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

/// Prints lines to standard error. Text from outside must have been escaped by [`shown::shown`].
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

/// Escapes one sentence and prints it to standard error. On a terminal, lines break between words.
pub(super) fn note(sentence: &str) {
    note_block(&fitted(sentence));
}

/// Colours text that reports a fault red.
pub(super) fn red(text: &str) -> String {
    format!("{RED}{text}{RED:#}")
}

fn fitted(sentence: &str) -> String {
    let size = rustix::termios::tcgetwinsize(rustix::stdio::stderr());
    let columns = size.ok().map(|size| usize::from(size.ws_col)).filter(|columns| *columns > 0);
    wrapped(&shown::shown(sentence), columns.unwrap_or(UNBOUNDED))
}

/// Prints a JSON document with the errors if a command failed without printing a document, so that machines can always read one.
pub(super) fn document_failure(exit: Exit) {
    if exit == Exit::Done || PRINTED.load(Ordering::Relaxed) {
        return;
    }
    let errors = ERRORS.lock().unwrap_or_else(PoisonError::into_inner).join("; ");
    print_json(&serde_json::json!({ "error": errors }));
}

/// Stores an error for [`document_failure`].
pub(super) fn remember_error(line: &str) {
    let mut errors = ERRORS.lock().unwrap_or_else(PoisonError::into_inner);
    if errors.len() < ERRORS_MAX {
        errors.push(line.to_owned());
    }
}

/// Prints an error in one line.
pub(super) fn error(line: &str) {
    remember_error(line);
    note_block(&format!("{RED}error{RED:#}{BOLD}: {}{BOLD:#}", shown::shown(line)));
}

/// Prints a warning in one line.
pub(super) fn warn(line: &str) {
    note_block(&format!("{YELLOW}warning{YELLOW:#}{BOLD}: {}{BOLD:#}", shown::shown(line)));
}

/// Prints one indented JSON document. A long document is printed in parts while it is produced.
pub(super) fn print_json(value: &impl Serialize) {
    let mut document = Document::default();
    match serde_json::to_writer_pretty(&mut document, value) {
        Ok(()) => document.end(),
        // The reason is already stored.
        Err(cause) if cause.is_io() => {}
        Err(cause) => error(&format!("cannot write JSON: {cause}")),
    }
}

/// The unprinted part of a JSON document that is being produced. It may end within a line.
#[derive(Default)]
struct Document(Vec<u8>);

impl Document {
    fn end(mut self) {
        self.0.push(b'\n');
        let _failed = self.print(self.0.len());
    }

    /// Prints the first `length` bytes, which must end at the end of a line.
    fn print(&mut self, length: usize) -> std::io::Result<()> {
        let lines: Vec<u8> = self.0.drain(..length).collect();
        let lines = String::from_utf8(lines).map_err(std::io::Error::other)?;
        print_while_read(&shown::json(&lines))
    }
}

impl std::io::Write for Document {
    fn write(&mut self, part: &[u8]) -> std::io::Result<usize> {
        self.0.extend_from_slice(part);
        // The document of a mission must not be mixed with lines of other threads.
        if self.0.len() >= DOCUMENT_PART && OUTLETS.get().is_none() {
            // Line ends within strings are escaped, so this line end is between two values.
            let length = self.0.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
            self.print(length)?;
        }
        Ok(part.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Returns the width of the terminal on standard output. Without a terminal, the width is unlimited.
pub(super) fn columns() -> usize {
    let size = rustix::termios::tcgetwinsize(rustix::stdio::stdout());
    size.ok().map(|size| usize::from(size.ws_col)).filter(|columns| *columns > 0).unwrap_or(UNBOUNDED)
}

/// Whether findings on standard error may be coloured.
pub(super) fn stderr_has_colour() -> bool {
    anstream::AutoStream::choice(&std::io::stderr()) != anstream::ColorChoice::Never
}

/// The writer for the events of `--log`: each event is a line on standard error, without colours.
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
