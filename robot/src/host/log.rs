//! Log of the values that the robots set. A separate thread writes it, so that the precise thread does not wait for a disk.

use std::fs::File;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::{Arc, mpsc as std_mpsc};
use std::thread::JoinHandle;

use serde::Serialize;
use tokio::sync::oneshot;
use urrcp::RobotId;

use super::HostError;
use crate::set_log::LogEntry;

type Batch = (usize, Vec<LogEntry>);

/// The precise thread's end of the channel to the thread that writes the log. Dropping it ends that thread.
pub(super) struct Log(std_mpsc::Sender<Batch>);

impl Log {
    /// Adds the values that were set at the robot with this index. They are discarded if the writer has ended.
    pub(super) fn add(&self, robot: usize, entries: Vec<LogEntry>) {
        let _writer_gone = self.0.send((robot, entries));
    }
}

/// The thread that writes the log, and a receiver for the error if the thread fails while the robots run.
pub(super) struct Writer {
    pub(super) thread: JoinHandle<()>,
    pub(super) lost: oneshot::Receiver<HostError>,
}

/// Creates the log file, and starts the thread that writes it.
pub(super) fn start(path: PathBuf, robots: Arc<[RobotId]>) -> Result<(Log, Writer), HostError> {
    let lost = |path, error| HostError::Log { path, error };
    let file = File::create(&path).map_err(|error| lost(path.clone(), error))?;
    let (log, entries) = std_mpsc::channel();
    let (tell, told) = oneshot::channel();
    let write = move || {
        if let Err(error) = write_log(file, &robots, &entries) {
            let _nobody_asked = tell.send(lost(path, error));
        }
    };
    let thread =
        std::thread::Builder::new().name("set-log".into()).spawn(write).map_err(HostError::Thread)?;
    Ok((Log(log), Writer { thread, lost: told }))
}

#[derive(Serialize)]
struct LogLine<'a> {
    robot: &'a RobotId,
    #[serde(flatten)]
    entry: &'a LogEntry,
}

/// Writes log entries until the precise thread has ended, or until writing fails. Whenever no further entry is waiting, the file is
/// flushed, so that a killed process loses few entries.
fn write_log(file: File, ids: &[RobotId], entries: &std_mpsc::Receiver<Batch>) -> io::Result<()> {
    let mut file = io::BufWriter::new(file);
    while let Ok(first) = entries.recv() {
        let mut batches = std::iter::once(first).chain(entries.try_iter());
        batches.try_for_each(|(robot, batch)| write_batch(&mut file, &ids[robot], &batch))?;
        file.flush()?;
    }
    Ok(())
}

fn write_batch(file: &mut impl Write, robot: &RobotId, batch: &[LogEntry]) -> io::Result<()> {
    for entry in batch {
        serde_json::to_writer(&mut *file, &LogLine { robot, entry })?;
        file.write_all(b"\n")?;
    }
    Ok(())
}
