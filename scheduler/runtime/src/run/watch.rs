//! Those who watch a mission from outside, as metrics and traces do. They are told in the mission's own loop, so nothing that they do
//! there may wait: they write numbers, or hand what they hear to a thread of theirs.

use std::fmt::Debug;

use urrcp::{Server, Span, Timestamp};

use downbeat_mission::{Mission, Progress};

/// A watcher.
pub trait Watch: Debug + Send {
    /// What the operator is told as well.
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress);

    /// The loop turns once more.
    fn turned(&mut self, _now: Timestamp<Server>, _mission: &Mission) {}

    /// When the loop is to turn at the latest, also if nothing happens.
    fn turns_by(&self) -> Option<Timestamp<Server>> {
        None
    }

    /// The loop has woken so long after it was due.
    fn woke(&mut self, _late: Span) {}

    /// A durable record is handed to the journal.
    fn filed(&mut self, _at: Timestamp<Server>) {}

    /// So many durable records are on the disk.
    fn recorded(&mut self, _at: Timestamp<Server>, _count: u64) {}

    /// The mission is over.
    fn ended(&mut self, _now: Timestamp<Server>, _mission: &Mission) {}
}

/// All of them.
#[derive(Debug, Default)]
pub struct Watches(Vec<Box<dyn Watch>>);

impl Watches {
    /// Adds a watcher.
    pub fn add(&mut self, watch: impl Watch + 'static) {
        self.0.push(Box::new(watch));
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn each(&mut self, tell: impl FnMut(&mut Box<dyn Watch>)) {
        self.0.iter_mut().for_each(tell);
    }

    pub(super) fn turns_by(&self) -> Option<Timestamp<Server>> {
        self.0.iter().filter_map(|watch| watch.turns_by()).min()
    }
}
