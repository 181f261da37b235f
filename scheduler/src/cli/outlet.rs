//! An output thread, which writes to a terminal, a pipe or a file, so that no other thread waits for it.
//!
//! The output of a running mission waits in a bounded queue. A blocked reader, such as a terminal after Ctrl-S or a full pipe, delays
//! only this thread. If the queue is full, further lines are dropped. Once there is room again, the number of dropped lines is written
//! instead of them. On a terminal, the thread also draws the live display below the lines.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags};
use rustix::fd::BorrowedFd;
use rustix::io::Errno;

/// Maximum number of queued entries. If the queue is full, further lines may be dropped.
const WAITING_MAX: usize = 1_024;
/// Maximum number of bytes per write. A pipe that is ready for writing accepts this number without blocking.
const CHUNK: usize = 4_096;
/// Interval between two frames of the display.
const FRAME_INTERVAL: Duration = Duration::from_millis(100);

/// One of the two standard output streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stream {
    Stdout,
    Stderr,
}

impl Stream {
    fn fd(self) -> BorrowedFd<'static> {
        match self {
            Self::Stdout => rustix::stdio::stdout(),
            Self::Stderr => rustix::stdio::stderr(),
        }
    }

    /// Whether both streams go to one terminal, pipe or file, so that the order of their output matters.
    pub(super) fn are_one() -> bool {
        let place = |stream: Self| {
            rustix::fs::fstat(stream.fd()).ok().map(|stat| (stat.st_dev, stat.st_ino, stat.st_rdev))
        };
        place(Self::Stdout) == place(Self::Stderr)
    }

    /// Returns the text with its colours if this stream should be coloured, otherwise without them.
    pub(super) fn coloured(self, text: &str) -> Cow<'_, str> {
        let choice = match self {
            Self::Stdout => anstream::AutoStream::choice(&io::stdout()),
            Self::Stderr => anstream::AutoStream::choice(&io::stderr()),
        };
        match choice {
            anstream::ColorChoice::Never => Cow::Owned(anstream::adapter::strip_str(text).to_string()),
            _ => Cow::Borrowed(text),
        }
    }
}

/// A display below the printed lines. The caller must immediately write the bytes that a method returns.
pub(super) trait Display: Send {
    /// Returns the bytes that remove the last frame from the screen, so that lines can be printed there.
    fn lift(&mut self) -> Vec<u8>;
    /// Returns the bytes that draw the changes since the last frame.
    fn draw(&mut self) -> Vec<u8>;
}

enum Entry {
    Text(Stream, String),
    /// The number of lines that were dropped at this point.
    Dropped(usize),
    /// The display starts at this point, or ends if the value is `None`.
    Display(Option<Box<dyn Display>>),
}

#[derive(Default)]
struct Queue {
    entries: VecDeque<Entry>,
    /// Number of lines dropped since the last queued entry.
    dropped: usize,
    /// Whether the output thread is writing.
    busy: bool,
    /// Whether the output thread draws a display.
    drawing: bool,
    /// Number of successful writes, which shows whether the thread makes progress.
    progress: u64,
    /// The reason why writing to standard output failed. `None` if it has not failed, or if the reader has closed its pipe.
    failure: Option<String>,
    /// Streams to which a write has failed, for example because the reader has closed its pipe.
    closed: Vec<Stream>,
}

impl Queue {
    fn mark_dropped(&mut self) {
        if self.dropped > 0 {
            self.entries.push_back(Entry::Dropped(std::mem::take(&mut self.dropped)));
        }
    }

    fn note(&mut self, stream: Stream, written: io::Result<()>) {
        match written {
            Ok(()) => self.progress += 1,
            Err(error) => {
                self.closed.push(stream);
                if stream == Stream::Stdout && error.kind() != io::ErrorKind::BrokenPipe {
                    self.failure.get_or_insert(error.to_string());
                }
            }
        }
    }
}

#[derive(Default)]
struct Shared {
    queue: Mutex<Queue>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The queue to an output thread. The thread ends with the process.
#[derive(Clone)]
pub(super) struct Outlet(Arc<Shared>);

impl Outlet {
    /// Starts an output thread with this name, and returns its queue.
    ///
    /// # Errors
    /// Fails if the thread cannot be started.
    pub(super) fn start(name: &str) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let written = Arc::clone(&shared);
        std::thread::Builder::new().name(name.to_owned()).spawn(move || write_on(&written))?;
        Ok(Self(shared))
    }

    /// Queues text that consists of whole lines. Drops the text if the queue is full.
    pub(super) fn offer(&self, stream: Stream, text: String) {
        let mut queue = self.0.lock();
        if queue.entries.len() >= WAITING_MAX {
            queue.dropped += 1;
            return;
        }
        queue.mark_dropped();
        queue.entries.push_back(Entry::Text(stream, text));
        self.0.changed.notify_all();
    }

    /// Queues text that is never dropped, for example a report.
    pub(super) fn keep(&self, stream: Stream, text: String) {
        let mut queue = self.0.lock();
        queue.mark_dropped();
        queue.entries.push_back(Entry::Text(stream, text));
        self.0.changed.notify_all();
    }

    /// Starts a display below the printed lines. `None` ends the current display.
    pub(super) fn display(&self, display: Option<Box<dyn Display>>) {
        let mut queue = self.0.lock();
        queue.mark_dropped();
        queue.entries.push_back(Entry::Display(display));
        self.0.changed.notify_all();
    }

    /// Waits until everything is written, or until no write has succeeded for `idle`. If writing to standard output has failed, returns
    /// the reason.
    pub(super) fn drain(&self, idle: Duration) -> Option<String> {
        let mut queue = self.0.lock();
        queue.mark_dropped();
        self.0.changed.notify_all();
        while queue.busy || !queue.entries.is_empty() {
            let before = queue.progress;
            let stands =
                |queue: &mut Queue| queue.progress == before && (queue.busy || !queue.entries.is_empty());
            let (next, waited) = self
                .0
                .changed
                .wait_timeout_while(queue, idle, stands)
                .unwrap_or_else(PoisonError::into_inner);
            queue = next;
            if waited.timed_out() {
                break;
            }
        }
        queue.failure.clone()
    }
}

/// The loop of the output thread: writes the queued entries, and draws the display in between.
fn write_on(shared: &Shared) {
    let mut display: Option<Box<dyn Display>> = None;
    loop {
        let entries = next_entries(shared);
        if entries.is_empty() {
            if let Some(display) = &mut display {
                write(shared, Stream::Stderr, &display.draw());
            }
        } else {
            if let Some(display) = &mut display {
                write(shared, Stream::Stderr, &display.lift());
            }
            entries.into_iter().for_each(|entry| write_entry(shared, entry, &mut display));
            if let Some(display) = &mut display {
                write(shared, Stream::Stderr, &display.draw());
            }
        }
        let mut queue = shared.lock();
        queue.busy = false;
        queue.drawing = display.is_some();
        shared.changed.notify_all();
    }
}

/// Waits for entries and returns them. If there is a display, returns no entries when the next frame is due.
fn next_entries(shared: &Shared) -> VecDeque<Entry> {
    let mut queue = shared.lock();
    while queue.entries.is_empty() {
        queue = if queue.drawing {
            let waited = shared.changed.wait_timeout(queue, FRAME_INTERVAL);
            let (queue, waited) = waited.unwrap_or_else(PoisonError::into_inner);
            if waited.timed_out() {
                return VecDeque::new();
            }
            queue
        } else {
            shared.changed.wait(queue).unwrap_or_else(PoisonError::into_inner)
        };
    }
    queue.busy = true;
    // The note about dropped lines belongs after these entries, even if no other line follows.
    queue.mark_dropped();
    std::mem::take(&mut queue.entries)
}

fn write_entry(shared: &Shared, entry: Entry, display: &mut Option<Box<dyn Display>>) {
    match entry {
        Entry::Text(stream, text) => write(shared, stream, text.as_bytes()),
        Entry::Dropped(lines) => {
            let lines = downbeat_scripts::counted(lines, "line");
            let text = format!("({lines} omitted here, because this output was not read)\n");
            write(shared, Stream::Stderr, text.as_bytes());
        }
        Entry::Display(next) => *display = next,
    }
}

fn write(shared: &Shared, stream: Stream, bytes: &[u8]) {
    for chunk in bytes.chunks(CHUNK) {
        if shared.lock().closed.contains(&stream) {
            return;
        }
        let written = write_all(stream, chunk);
        shared.lock().note(stream, written);
        shared.changed.notify_all();
    }
}

/// Writes bytes without Rust's own buffers, because their locks would block other threads. Waits for the reader without a time limit.
///
/// # Errors
/// Returns the operating system's error. For a closed pipe, that is [`io::ErrorKind::BrokenPipe`].
pub(super) fn write_all(stream: Stream, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match rustix::io::write(stream.fd(), bytes) {
            Ok(written) => bytes = bytes.get(written..).unwrap_or_default(),
            Err(Errno::INTR) => {}
            // Another process may have made the shared terminal non-blocking.
            Err(Errno::AGAIN) => {
                let mut room = [PollFd::from_borrowed_fd(stream.fd(), PollFlags::OUT)];
                let _interrupted = rustix::event::poll(&mut room, None);
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_without_room_are_counted_at_their_position() {
        // The outlet has no output thread, so that no entry is taken from the queue.
        let outlet = Outlet(Arc::default());
        let offer = |lines| (0..lines).for_each(|_| outlet.offer(Stream::Stderr, "line\n".to_owned()));
        offer(WAITING_MAX + 7);
        assert_eq!(std::mem::take(&mut outlet.0.lock().entries).len(), WAITING_MAX);
        offer(2);
        let queue = outlet.0.lock();
        let entries: Vec<_> = queue.entries.iter().collect();
        assert!(matches!(entries[..], [Entry::Dropped(7), Entry::Text(..), Entry::Text(..)]));
    }

    #[test]
    fn dropped_lines_are_reported_to_new_reader_without_further_lines() {
        let outlet = Outlet(Arc::default());
        (0..WAITING_MAX + 7).for_each(|_| outlet.offer(Stream::Stderr, "line\n".to_owned()));
        let entries = next_entries(&outlet.0);
        assert!(matches!(entries.back(), Some(Entry::Dropped(7))));
        assert_eq!(outlet.0.lock().dropped, 0);
    }
}
