//! A journal that is written on its own thread, so that the mission never waits for the disk.

use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use urrcp::{Server, Timestamp};

use super::{Disk, FileDisk, Journal, JournalBroken, Name};
use downbeat_mission::Record;

/// Maximum number of records that may wait for the disk. If one more record arrives, the journal is treated as lost.
pub const WAITING_MAX: usize = 4_096;
/// Maximum time to wait for the disk at the end of a mission.
const FINISH_MAX: Duration = Duration::from_secs(5);
/// Interval between checks that the journal can still be found under its name, while no record arrives.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// The progress of writing a mission's records.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Written {
    /// Number of durable records (those that must survive a power loss) on the disk.
    count: u64,
    /// Number of times that the journal was removed or replaced and written again.
    again: u32,
    /// The reason why the journal takes no further records. `None` while it takes records.
    lost: Option<String>,
}

/// A report from the thread that writes the journal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum News {
    /// More durable records are on the disk. Contains their total number.
    Recorded(u64),
    /// The journal was removed or replaced, and has been written again.
    WrittenAgain,
    /// The journal takes no further records, for the contained reason.
    Lost(String),
}

impl Written {
    /// Returns one change from `self`, which a reader already knows, to the newer state `now`, and adds it to `self`. `WrittenAgain`
    /// comes before `Recorded`, because only the rewritten file makes the records durable.
    fn learn(&mut self, now: &Self) -> Option<News> {
        if self.again != now.again {
            self.again = now.again;
            return Some(News::WrittenAgain);
        }
        if self.count != now.count {
            self.count = now.count;
            return Some(News::Recorded(now.count));
        }
        if self.lost != now.lost {
            self.lost.clone_from(&now.lost);
            return now.lost.clone().map(News::Lost);
        }
        None
    }
}

/// Why a record was not queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QueueError {
    /// Too many records wait for the disk.
    #[error("the journal's disk is too slow: {WAITING_MAX} records are waiting")]
    Full,
    /// The thread has failed.
    #[error("the thread that writes the journal has ended")]
    Ended,
}

/// Sends records to the thread that writes them.
#[derive(Debug)]
pub struct Writer<D = FileDisk> {
    queue: SyncSender<(Timestamp<Server>, Record)>,
    written: watch::Receiver<Written>,
    /// The state that [`Writer::next`] has already reported.
    known: Written,
    /// Receives the journal back from the thread once the thread has ended.
    back: oneshot::Receiver<Journal<D>>,
}

impl<D: Disk + Send + 'static> Writer<D> {
    /// Starts the thread that writes the journal. The thread ends once the writer is dropped and all records are on the disk.
    ///
    /// # Errors
    /// Fails if the operating system cannot start a thread.
    pub fn start(journal: Journal<D>) -> io::Result<Self> {
        let (queue, records) = sync_channel(WAITING_MAX);
        let (tell, written) = watch::channel(Written::default());
        let (give_back, back) = oneshot::channel();
        std::thread::Builder::new().name("journal".to_owned()).spawn(move || {
            let journal = write_all(journal, &records, &tell);
            let _nobody_waits = give_back.send(journal);
        })?;
        Ok(Self { queue, written, known: Written::default(), back })
    }

    /// Queues a record without waiting.
    ///
    /// # Errors
    /// Returns [`QueueError`], after which the journal takes no further records.
    pub fn write(&self, at: Timestamp<Server>, record: Record) -> Result<(), QueueError> {
        self.queue.try_send((at, record)).map_err(|error| match error {
            TrySendError::Full(_) => QueueError::Full,
            TrySendError::Disconnected(_) => QueueError::Ended,
        })
    }

    /// Waits for the next report from the thread: more records are on the disk, or the journal has been written again or lost.
    pub async fn next(&mut self) -> News {
        loop {
            if let Some(news) = self.known.learn(&self.written.borrow_and_update()) {
                return news;
            }
            if self.written.changed().await.is_err() {
                // The thread ends before this writer only if it fails.
                std::future::pending::<()>().await;
            }
        }
    }

    /// Waits at most 5 s until all records are on the disk, and returns the journal. Returns `None` if that takes longer.
    pub async fn finish(self) -> Option<Journal<D>> {
        drop(self.queue);
        tokio::time::timeout(FINISH_MAX, self.back).await.ok()?.ok()
    }
}

/// Writes all records from the queue. One sync covers all records that are waiting.
fn write_all<D: Disk>(
    mut journal: Journal<D>,
    records: &Receiver<(Timestamp<Server>, Record)>,
    tell: &watch::Sender<Written>,
) -> Journal<D> {
    loop {
        let first = match records.recv_timeout(LOOK_EVERY) {
            Ok(first) => Some(first),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return journal,
        };
        let appended = append_all(&mut journal, first.into_iter().chain(records.try_iter()));
        // Records in a file that cannot be found are not durable.
        let named = appended.and_then(|()| journal.keep_name());
        let synced = named.clone().and_then(|_| journal.sync());
        tell.send_if_modified(|written| {
            let before = written.clone();
            written.again += u32::from(named == Ok(Name::WrittenAgain));
            match synced {
                Ok(count) => written.count = count,
                Err(broken) => written.lost = Some(broken.to_string()),
            }
            *written != before
        });
    }
}

/// Writes all pending records, so that one sync covers them.
///
/// # Errors
/// Fails if the disk refuses a record.
pub fn append_all<D: Disk>(
    journal: &mut Journal<D>,
    mut waiting: impl Iterator<Item = (Timestamp<Server>, Record)>,
) -> Result<(), JournalBroken> {
    waiting.try_for_each(|(at, record)| journal.append(at, &record))
}
