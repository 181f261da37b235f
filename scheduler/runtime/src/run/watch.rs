//! Watchers of a mission, for example for metrics and traces. They are called in the mission's own loop, so they must not block: they
//! write numbers, or send data to a thread of their own.

use std::fmt::Debug;

use urrcp::{Server, Span, Timestamp};

use downbeat_mission::{Mission, Progress};

/// A watcher of a mission. Every method is called in the mission's loop and must not block.
pub trait Watch: Debug + Send {
    /// Called for each progress report that the mission sends to the operator.
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress);

    /// Called for each iteration of the mission's loop.
    fn turned(&mut self, _now: Timestamp<Server>, _mission: &Mission) {}

    /// Returns the time by which the loop must make another iteration even if nothing happens. `None` for no limit.
    fn turns_by(&self) -> Option<Timestamp<Server>> {
        None
    }

    /// Called when the loop has woken up from a timer. `_late` is the delay after the due time.
    fn woke(&mut self, _late: Span) {}

    /// Called when a durable record (one that must survive a power loss) is sent to the journal.
    fn filed(&mut self, _at: Timestamp<Server>) {}

    /// Called when durable records (those that must survive a power loss) have reached the disk. `_count` is their total number on the
    /// disk.
    fn recorded(&mut self, _at: Timestamp<Server>, _count: u64) {}

    /// Called when the mission is over.
    fn ended(&mut self, _now: Timestamp<Server>, _mission: &Mission) {}
}

/// All watchers of a mission.
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
