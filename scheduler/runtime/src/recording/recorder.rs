//! A recording that is written on its own thread, so that the mission never waits for the disk. A failed recording does not affect the
//! mission.

use std::io;
use std::path::PathBuf;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

use tokio::sync::oneshot;

use super::Recording;
use downbeat_mission::report::Recorded;

/// Maximum number of entries that may wait for the disk. Further entries are missing in the file.
const WAITING_MAX: usize = 65_536;
/// Maximum time to wait for the disk at the end of a mission.
const FINISH_MAX: Duration = Duration::from_secs(5);

/// A function that writes one entry to the recording.
type Note = Box<dyn FnOnce(&mut Recording) + Send>;

/// Sends entries of a recording to the thread that writes them.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    notes: SyncSender<Note>,
    /// Number of entries that were dropped because the queue was full.
    missing: u64,
    /// Receives the reason for a failure once the thread has ended, or `None` if nothing failed.
    ended: oneshot::Receiver<Option<String>>,
}

impl Recorder {
    /// Starts the thread that writes the recording. The thread ends once the recorder is dropped and all entries are in the file.
    ///
    /// # Errors
    /// Fails if the operating system cannot start a thread.
    pub fn start(recording: Recording) -> io::Result<Self> {
        let path = recording.path.clone();
        let (notes, taken) = sync_channel::<Note>(WAITING_MAX);
        let (tell, ended) = oneshot::channel();
        std::thread::Builder::new().name("recording".to_owned()).spawn(move || {
            let mut recording = recording;
            while let Ok(note) = taken.recv() {
                note(&mut recording);
            }
            let _nobody_waits = tell.send(recording.finish().err().map(|error| error.reason()));
        })?;
        Ok(Self { path, notes, missing: 0, ended })
    }

    /// Queues an entry without waiting. Drops it if the queue is full.
    pub fn note(&mut self, note: impl FnOnce(&mut Recording) + Send + 'static) {
        if self.notes.try_send(Box::new(note)).is_err() {
            self.missing += 1;
        }
    }

    /// Waits at most 5 s until all entries are in the file, and returns the result.
    pub async fn finish(self) -> Recorded {
        drop(self.notes);
        let failure = match tokio::time::timeout(FINISH_MAX, self.ended).await {
            Ok(Ok(None)) if self.missing > 0 => {
                Some(format!("the disk is too slow: {} messages are missing", self.missing))
            }
            Ok(Ok(failure)) => failure,
            Ok(Err(_)) => Some("the thread that writes it has failed".to_owned()),
            Err(_) => Some(format!("the disk is too slow: the rest was not written within {FINISH_MAX:?}")),
        };
        Recorded { path: self.path, failure }
    }
}
