//! Detects whether the host of a virtual machine, or another program on this machine, took a core away around a start. A thread of the
//! highest priority on each core compares the elapsed time with the time that the kernel gave to threads and to idling. The host took the
//! difference. Other programs or the kernel itself took the time of threads outside this program and its children.
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

/// Minimum unaccounted time of a core that counts as taken away by the host. The kernel itself may cause smaller differences.
const TAKEN_BY_HOST: Duration = Duration::from_micros(50);
/// Minimum CPU time of other programs that counts as a core taken away. The kernel's own threads use less around a start.
const TAKEN_BY_OTHERS: Duration = Duration::from_micros(200);
/// Times before and after the start at which the counters are read.
const BEFORE_NS: i64 = 3_000_000;
const AFTER_NS: i64 = 1_500_000;
/// Starts within this time before or after an observed instant belong to that instant.
const NEAR_NS: i64 = 20_000_000;

/// Directory of the control groups in which the kernel reports the CPU time of threads. If the kernel also distributes the cores by these
/// groups, our own group changes the shares.
const GROUPS: &str = "/sys/fs/cgroup/cpuacct";

/// Time for which a core was taken away around a start: the maximum over all cores.
#[derive(Clone, Copy, Default)]
pub struct Taken {
    pub by_host: Duration,
    pub by_others: Duration,
}

impl Taken {
    /// Whether a core was taken away for long enough to affect the start.
    pub fn disturbs(self) -> bool {
        self.by_host > TAKEN_BY_HOST || self.by_others > TAKEN_BY_OTHERS
    }

    fn or_more(self, other: Self) -> Self {
        Self { by_host: self.by_host.max(other.by_host), by_others: self.by_others.max(other.by_others) }
    }
}

/// The time taken away around each start. The key is the instant of the start in nanoseconds.
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

/// Threads, one per core, that detect whether their core is taken away. They end on drop.
pub struct Witness {
    threads: Vec<Sender<i64>>,
    taken: All,
}

impl Witness {
    /// Starts the threads; `None` if they may not have the highest priority, or if the kernel does not report the time per core.
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

    /// Makes the threads observe the time around `start`, in nanoseconds of the system clock.
    pub fn attend(&self, start: i64) {
        self.threads.iter().for_each(|thread| thread.send(start).unwrap());
    }

    /// Returns the time for which a core was taken away around `start`.
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

/// Converts a difference of counters to a duration. It may be slightly negative, because the counters are not read at the same instant;
/// the result is then zero.
fn positive(nanos: i64) -> Duration {
    Duration::from_nanos(u64::try_from(nanos).unwrap_or(0))
}

fn sleep_until(instant: i64) {
    std::thread::sleep(Duration::from_nanos(u64::try_from(instant - epoch_nanos()).unwrap_or(0)));
}

/// The kernel's counters of the time that a core spent in threads and in idling.
struct Account {
    core: usize,
    /// CPU time of threads per core, in nanoseconds: of all threads, and of this program and its children.
    used: File,
    own: File,
    /// Time in each idle state, in microseconds.
    idle: Vec<File>,
}

/// One reading of the counters, in nanoseconds since an arbitrary instant.
struct Look {
    /// Time that the core spent neither in threads nor in idling.
    missing: i64,
    /// CPU time of threads outside this program and its children.
    others: i64,
}

impl Account {
    /// Opens the counters of `core`; `None` if the kernel lacks one. Only a thread on `core` should read them: for other cores, the
    /// counters do not yet include the current time slice.
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

/// Makes the calling thread run only on `core`.
pub fn stay_on(core: usize) {
    let mut cores = rustix::thread::CpuSet::new();
    cores.set(core);
    rustix::thread::sched_setaffinity(None, &cores).unwrap();
}

/// Requests real-time scheduling, so that the calling thread runs before all threads of lower priority. Returns whether the kernel
/// granted the request.
pub fn become_first(priority: u32) -> bool {
    let mut attributes = uapi::sched_getattr(0, 0).unwrap();
    attributes.sched_policy = uapi::c::SCHED_FIFO.unsigned_abs();
    attributes.sched_priority = priority;
    attributes.sched_nice = 0;
    attributes.sched_runtime = 0;
    uapi::sched_setattr(0, &attributes, 0).is_ok()
}
