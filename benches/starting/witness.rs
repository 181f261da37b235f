//! Detects whether the host of a virtual machine, or another program on it, took a core away around a start. A thread on each core, which
//! runs before all others, compares the elapsed time with the time that the kernel gave to threads and to idling. The difference was
//! taken by the host. Time of threads outside this program and its children was taken by other programs or by the kernel itself.
//!
//! The thread wakes once before and once after the start, so that it does not disturb the robots. A single wake-up takes 10 to 30 us of a
//! core on such a machine.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::epoch_nanos;

/// A smaller difference may be the kernel's own.
const TAKEN_BY_HOST: Duration = Duration::from_micros(50);
/// The kernel's own threads use less than this around a start.
const TAKEN_BY_OTHERS: Duration = Duration::from_micros(200);
/// The counters are read this long before the start and this long after it.
const BEFORE_NS: i64 = 3_000_000;
const AFTER_NS: i64 = 1_500_000;
/// Robots that start within this time of an instant belong to it.
const NEAR_NS: i64 = 20_000_000;

/// Where the kernel reports the CPU time of threads. If this controller also distributes the shares of the cores, our own group would
/// change the shares.
const GROUPS: &str = "/sys/fs/cgroup/cpuacct";

/// For how long a core was taken away around a start. With several cores, the maximum.
#[derive(Clone, Copy, Default)]
pub struct Taken {
    pub by_host: Duration,
    pub by_others: Duration,
}

impl Taken {
    /// Whether the time is long enough to matter.
    pub fn disturbs(self) -> bool {
        self.by_host > TAKEN_BY_HOST || self.by_others > TAKEN_BY_OTHERS
    }

    fn or_more(self, other: Self) -> Self {
        Self { by_host: self.by_host.max(other.by_host), by_others: self.by_others.max(other.by_others) }
    }
}

/// Sorted by the instant of the start, in nanoseconds.
type All = Arc<Mutex<BTreeMap<i64, Taken>>>;

/// A control group of this program and its children, which separates their time from that of others. Removed on drop.
pub struct Group(PathBuf);

impl Group {
    /// Creates the group; `None` if that is not permitted. Only children that are started later join it.
    pub fn of_this_program() -> Option<Self> {
        let group = Path::new(GROUPS).join(format!("downbeat-{}", std::process::id()));
        std::fs::create_dir(&group).ok()?;
        let group = Self(group);
        std::fs::write(group.0.join("cgroup.procs"), std::process::id().to_string()).ok()?;
        Some(group)
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        let _left = std::fs::write(Path::new(GROUPS).join("cgroup.procs"), std::process::id().to_string());
        let _removed = std::fs::remove_dir(&self.0);
    }
}

/// Threads that end on drop.
pub struct Witness {
    threads: Vec<Sender<i64>>,
    taken: All,
}

impl Witness {
    /// Starts the threads; `None` if they may not run before all others, or if the kernel does not report the time per core.
    pub fn start(group: &Group) -> Option<Self> {
        let cores = std::thread::available_parallelism().map_or(1, Into::into);
        let taken = All::default();
        let threads = (0..cores).map(|core| {
            let account = Account::of(core, group)?;
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

    /// Observes an instant, given in nanoseconds of the system's clock.
    pub fn attend(&self, start: i64) {
        self.threads.iter().for_each(|thread| thread.send(start).unwrap());
    }

    /// The time taken away around a start.
    pub fn taken_at(&self, start: i64) -> Taken {
        let taken = self.taken.lock().unwrap();
        taken
            .range(start - NEAR_NS..start + NEAR_NS)
            .fold(Taken::default(), |most, (_, taken)| most.or_more(*taken))
    }
}

fn watch(account: &Account, told: &Receiver<i64>, all: &All) {
    while let Ok(start) = told.recv() {
        sleep_until(start - BEFORE_NS);
        let before = account.look();
        sleep_until(start + AFTER_NS);
        let after = account.look();
        let taken = Taken {
            by_host: positive(after.missing - before.missing),
            by_others: positive(after.others - before.others),
        };
        let mut all = all.lock().unwrap();
        let known = all.entry(start).or_default();
        *known = known.or_more(taken);
    }
}

/// The counters are not read at the same instant, so a difference may be slightly negative.
fn positive(nanos: i64) -> Duration {
    Duration::from_nanos(u64::try_from(nanos).unwrap_or(0))
}

fn sleep_until(instant: i64) {
    std::thread::sleep(Duration::from_nanos(u64::try_from(instant - epoch_nanos()).unwrap_or(0)));
}

/// Counters of the time that the kernel gave to a core.
struct Account {
    core: usize,
    /// CPU time of threads per core, in nanoseconds: of all threads, and of this program and its children.
    used: File,
    own: File,
    /// Time in each idle state, in microseconds.
    idle: Vec<File>,
}

/// Nanoseconds since some instant.
struct Look {
    /// Time that is not accounted for.
    missing: i64,
    /// CPU time of threads that are not ours.
    others: i64,
}

impl Account {
    /// For the core of the calling thread. On other cores, the current time slice is not accounted for yet.
    fn of(core: usize, group: &Group) -> Option<Self> {
        let used = |group: &Path| File::open(group.join("cpuacct.usage_percpu")).ok();
        let state =
            |state| File::open(format!("/sys/devices/system/cpu/cpu{core}/cpuidle/state{state}/time"));
        let idle: Vec<_> = (0..).map_while(|number: usize| state(number).ok()).collect();
        let (used, own) = (used(Path::new(GROUPS))?, used(&group.0)?);
        (!idle.is_empty()).then_some(Self { core, used, own, idle })
    }

    fn look(&self) -> Look {
        let now = epoch_nanos();
        let of_this_core =
            |file| read(file).split(' ').nth(self.core).unwrap().trim().parse::<i64>().unwrap();
        let (used, own) = (of_this_core(&self.used), of_this_core(&self.own));
        let idle = self.idle.iter().map(|file| read(file).trim().parse::<i64>().unwrap() * 1_000);
        Look { missing: now - used - idle.sum::<i64>(), others: used - own }
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

/// Requests that this thread runs before all of lower priority. Returns whether that was granted.
pub fn become_first(priority: u32) -> bool {
    let mut attributes = uapi::sched_getattr(0, 0).unwrap();
    attributes.sched_policy = uapi::c::SCHED_FIFO.unsigned_abs();
    attributes.sched_priority = priority;
    attributes.sched_nice = 0;
    attributes.sched_runtime = 0;
    uapi::sched_setattr(0, &attributes, 0).is_ok()
}
