//! Sees whether the host of a virtual machine took a core away around a start: a thread on each core, which runs before all
//! others, compares how much time has passed with how much time the kernel gave to its threads and to being idle. What is
//! missing was the host's.
//!
//! It wakes once before and once after the start, so that robots do not notice it. A single wake-up takes 10 to 30 us of a
//! core on such a machine.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::epoch_nanos;

/// Less than that may be the kernel's own.
pub const TAKEN: Duration = Duration::from_micros(50);
/// When it looks: so long before the start, and so long after it.
const BEFORE_NS: i64 = 3_000_000;
const AFTER_NS: i64 = 1_500_000;
/// Robots that start within this time of an instant were meant for it.
const NEAR_NS: i64 = 20_000_000;

/// What was taken around each start, in nanoseconds.
type Taken = Arc<Mutex<BTreeMap<i64, i64>>>;

/// Threads that end when it is dropped.
pub struct Witness {
    threads: Vec<Sender<i64>>,
    taken: Taken,
}

impl Witness {
    /// `None` where nothing may run before all others, or the kernel does not tell what it did with each core.
    pub fn start() -> Option<Self> {
        let cores = std::thread::available_parallelism().map_or(1, Into::into);
        let taken = Taken::default();
        let threads = (0..cores).map(|core| {
            let account = Account::of(core)?;
            let (starts, told) = channel();
            let (ready, granted) = channel();
            let taken = Arc::clone(&taken);
            std::thread::spawn(move || {
                stay_on(core);
                ready.send(become_first(99)).unwrap();
                watch(&account, &told, &taken);
            });
            granted.recv().unwrap().then_some(starts)
        });
        let threads = threads.collect::<Option<_>>()?;
        Some(Self { threads, taken })
    }

    /// Looks around an instant, by the system's clock in nanoseconds.
    pub fn attend(&self, start: i64) {
        self.threads.iter().for_each(|thread| thread.send(start).unwrap());
    }

    /// For how long a core was taken away around a start.
    pub fn taken_at(&self, start: i64) -> Duration {
        let taken = self.taken.lock().unwrap();
        let near = taken.range(start - NEAR_NS..start + NEAR_NS).map(|(_, taken)| *taken).max();
        Duration::from_nanos(u64::try_from(near.unwrap_or(0)).unwrap_or(0))
    }
}

fn watch(account: &Account, told: &Receiver<i64>, all: &Taken) {
    while let Ok(start) = told.recv() {
        sleep_until(start - BEFORE_NS);
        let before = account.missing();
        sleep_until(start + AFTER_NS);
        let taken = account.missing() - before;
        let mut all = all.lock().unwrap();
        let known = all.entry(start).or_default();
        *known = taken.max(*known);
    }
}

fn sleep_until(instant: i64) {
    std::thread::sleep(Duration::from_nanos(u64::try_from(instant - epoch_nanos()).unwrap_or(0)));
}

/// What the kernel did with a core.
struct Account {
    core: usize,
    /// The time that threads had, in nanoseconds for each core.
    used: File,
    /// The time in each idle state, in microseconds.
    idle: Vec<File>,
}

impl Account {
    /// For the core on which the calling thread stays: what another core does at this moment is not yet accounted for.
    fn of(core: usize) -> Option<Self> {
        let groups = ["cpuacct", "cpu,cpuacct"];
        let used = groups
            .iter()
            .find_map(|group| File::open(format!("/sys/fs/cgroup/{group}/cpuacct.usage_percpu")).ok())?;
        let state =
            |state| File::open(format!("/sys/devices/system/cpu/cpu{core}/cpuidle/state{state}/time"));
        let idle: Vec<_> = (0..).map_while(|number: usize| state(number).ok()).collect();
        (!idle.is_empty()).then_some(Self { core, used, idle })
    }

    /// The time that is accounted for nowhere, from some instant on.
    fn missing(&self) -> i64 {
        let now = epoch_nanos();
        let used: i64 = read(&self.used).split(' ').nth(self.core).unwrap().trim().parse().unwrap();
        let idle = self.idle.iter().map(|file| read(file).trim().parse::<i64>().unwrap() * 1_000);
        now - used - idle.sum::<i64>()
    }
}

fn read(file: &File) -> String {
    let mut text = [0; 4096];
    let length = file.read_at(&mut text, 0).unwrap();
    String::from_utf8_lossy(&text[..length]).into_owned()
}

/// Keeps this thread on one core.
pub fn stay_on(core: usize) {
    let mut cores = rustix::thread::CpuSet::new();
    cores.set(core);
    rustix::thread::sched_setaffinity(None, &cores).unwrap();
}

/// Asks for this thread to run before all of lower priority; returns whether that was granted.
pub fn become_first(priority: u32) -> bool {
    let mut attributes = uapi::sched_getattr(0, 0).unwrap();
    attributes.sched_policy = uapi::c::SCHED_FIFO.unsigned_abs();
    attributes.sched_priority = priority;
    attributes.sched_nice = 0;
    attributes.sched_runtime = 0;
    uapi::sched_setattr(0, &attributes, 0).is_ok()
}
