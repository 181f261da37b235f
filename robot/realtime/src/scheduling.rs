//! Requests scheduling from the system for the thread that wakes robots: real-time scheduling, locked memory, and a short time slice.
//!
//! Real-time scheduling and locked memory require permission; the short slice and the minimum timer slack do not. The result is reported
//! in one sentence, with the settings that would permit the refused requests.

use std::fmt;
use std::num::NonZeroU64;

use rustix::mm::MlockAllFlags;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::CapabilitySet;
use uapi::c;

/// Priority under SCHED_FIFO: above ordinary programs, but not above the interrupt threads of real-time kernels.
const PRIORITY: u32 = 50;
/// Time slice in nanoseconds. When a thread with a short slice wakes, it runs before threads that are in the middle of a long slice. The
/// kernel accepts no shorter slice.
const SLICE_NANOS: u64 = 100_000;

/// Whether to request real-time scheduling (SCHED_FIFO) and locked memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Realtime {
    /// Request neither.
    #[default]
    Off,
    /// Request both, and continue without those that are not permitted.
    Auto,
    /// Request both, and do not start unless both are granted.
    Required,
}

/// The scheduling that a thread was granted. `Display` prints it as one sentence without a full stop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scheduling {
    realtime: Granted,
    locked: Granted,
}

/// The system's answer to a request for scheduling or locked memory.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Granted {
    /// No request was made.
    Unasked,
    /// The request was granted. Contains a description of what was granted.
    Yes(String),
    /// The request was refused, for the contained reason.
    No(String),
}

impl Scheduling {
    /// Requests real-time scheduling for the current thread and locked memory for its process, as `realtime` demands. Returns what was
    /// granted.
    #[must_use]
    pub fn of_this_thread(realtime: Realtime) -> Self {
        if let Err(error) = rustix::thread::set_current_timer_slack(NonZeroU64::new(1)) {
            tracing::warn!("cannot set the timer slack: {error}");
        }
        let asked = realtime != Realtime::Off;
        let granted = Self {
            realtime: if asked { ask_first_in_first_out() } else { Granted::as_found() },
            locked: if asked { lock_memory() } else { Granted::Unasked },
        };
        if !granted.is_realtime()
            && let Err(error) = shorten_slice()
        {
            tracing::warn!("cannot set the time slice: {error}");
        }
        granted
    }

    /// Whether the thread runs before all ordinary threads.
    #[must_use]
    pub const fn is_realtime(&self) -> bool {
        matches!(self.realtime, Granted::Yes(_))
    }

    /// Whether the system refused any request.
    #[must_use]
    pub const fn lacks_something(&self) -> bool {
        matches!(self.realtime, Granted::No(_)) || matches!(self.locked, Granted::No(_))
    }

    /// Returns the settings that would permit the refused requests. `None` if no request was refused.
    fn remedy(&self) -> Option<String> {
        let (systemd, limits) = match (&self.realtime, &self.locked) {
            (Granted::No(_), Granted::No(_)) => {
                ("LimitRTPRIO=50 and LimitMEMLOCK=infinity", "`rtprio 50` and `memlock unlimited`")
            }
            (Granted::No(_), _) => ("LimitRTPRIO=50", "`rtprio 50`"),
            (_, Granted::No(_)) => ("LimitMEMLOCK=infinity", "`memlock unlimited`"),
            _ => return None,
        };
        Some(format!(
            "to allow it, set {systemd} in the systemd unit, run `setcap cap_sys_nice,cap_ipc_lock+ep` on the program, or add {limits} to \
             /etc/security/limits.conf"
        ))
    }
}

impl fmt::Display for Scheduling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.realtime {
            Granted::Unasked => f.write_str("ordinary scheduling")?,
            Granted::Yes(policy) => write!(f, "real-time scheduling ({policy})")?,
            Granted::No(why) => {
                write!(
                    f,
                    "no real-time scheduling ({why}), so starts may be milliseconds late while the cores are busy"
                )?;
            }
        }
        match &self.locked {
            Granted::Unasked => {}
            Granted::Yes(what) => write!(f, ", {what}")?,
            Granted::No(why) => write!(f, ", memory not locked ({why})")?,
        }
        self.remedy().map_or(Ok(()), |remedy| write!(f, "; {remedy}"))
    }
}

impl Granted {
    /// Returns the real-time scheduling under which the process was started, if any.
    fn as_found() -> Self {
        policy_found().map_or(Self::Unasked, Self::Yes)
    }
}

fn policy_found() -> Option<String> {
    let attributes = uapi::sched_getattr(0, 0).ok()?;
    let name = match c::c_int::try_from(attributes.sched_policy).ok()? {
        c::SCHED_FIFO => "SCHED_FIFO",
        c::SCHED_RR => "SCHED_RR",
        _ => return None,
    };
    Some(format!("{name}, priority {}", attributes.sched_priority))
}

/// Requests SCHED_FIFO. Threads and programs that this thread starts do not inherit it.
fn ask_first_in_first_out() -> Granted {
    if let Some(found) = policy_found() {
        return Granted::Yes(found);
    }
    // With the capability `CAP_SYS_NICE`, no limit applies, so the full priority is requested first.
    let full = set_first_in_first_out(PRIORITY);
    let granted = full.or_else(|error| match within(raise_limit(Resource::Rtprio)) {
        Some(priority) => set_first_in_first_out(priority),
        None => Err(error),
    });
    match granted {
        Ok(()) => Granted::Yes(policy_found().unwrap_or_default()),
        Err(error) => Granted::No(std::io::Error::from(error).to_string()),
    }
}

/// Returns the highest priority that a limit permits. `None` if it is zero, or not below [`PRIORITY`].
fn within(limit: Rlimit) -> Option<u32> {
    let allowed = u32::try_from(limit.maximum?).ok();
    allowed.filter(|allowed| *allowed > 0 && *allowed < PRIORITY)
}

fn set_first_in_first_out(priority: u32) -> Result<(), uapi::Errno> {
    let mut attributes = uapi::sched_getattr(0, 0)?;
    attributes.sched_policy = c::SCHED_FIFO.unsigned_abs();
    attributes.sched_flags = c::SCHED_FLAG_RESET_ON_FORK;
    attributes.sched_nice = 0;
    attributes.sched_priority = priority;
    attributes.sched_runtime = 0;
    uapi::sched_setattr(0, &attributes, 0)
}

/// Requests a time slice of [`SLICE_NANOS`]. Kernels before 6.12 accept the request, but it has no effect.
fn shorten_slice() -> Result<(), uapi::Errno> {
    let mut attributes = uapi::sched_getattr(0, 0)?;
    if c::c_int::try_from(attributes.sched_policy) != Ok(c::SCHED_OTHER) {
        return Ok(());
    }
    attributes.sched_flags = 0;
    attributes.sched_runtime = SLICE_NANOS;
    uapi::sched_setattr(0, &attributes, 0)
}

/// Locks the memory of the process. Each page is locked when it is first used, so that locking does not increase memory usage.
fn lock_memory() -> Granted {
    let limit = raise_limit(Resource::Memlock).maximum;
    let capable = rustix::thread::capabilities(None)
        .is_ok_and(|capabilities| capabilities.effective.contains(CapabilitySet::IPC_LOCK));
    // Under a limit, memory that is needed later could not be allocated at all.
    if let (Some(limit), false) = (limit, capable) {
        return Granted::No(format!("the limit for locked memory is {} KiB", limit / 1024));
    }
    let all = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
    match rustix::mm::mlockall(all) {
        Ok(()) => Granted::Yes("memory locked".to_owned()),
        Err(error) => Granted::No(std::io::Error::from(error).to_string()),
    }
}

/// Raises a limit to its maximum, and returns the previous limit.
fn raise_limit(resource: Resource) -> Rlimit {
    let limit = getrlimit(resource);
    let _always_allowed = setrlimit(resource, Rlimit { current: limit.maximum, ..limit });
    limit
}

#[cfg(test)]
mod tests {
    use super::*;

    fn granted(realtime: Granted, locked: Granted) -> String {
        Scheduling { realtime, locked }.to_string()
    }

    #[test]
    fn thread_is_real_time_only_if_that_was_granted() {
        let scheduling = |realtime| Scheduling { realtime, locked: no() }.is_realtime();
        assert!(scheduling(yes("SCHED_FIFO")) && !scheduling(no()));
    }

    #[test]
    fn thread_lacks_a_requested_resource_that_was_not_granted() {
        for (realtime, locked, lacks) in [
            (yes("SCHED_FIFO"), yes("memory locked"), false),
            (Granted::Unasked, Granted::Unasked, false),
            (no(), yes("memory locked"), true),
            (yes("SCHED_FIFO"), no(), true),
        ] {
            assert_eq!(Scheduling { realtime, locked }.lacks_something(), lacks);
        }
    }

    fn yes(what: &str) -> Granted {
        Granted::Yes(what.to_owned())
    }

    fn no() -> Granted {
        Granted::No("Operation not permitted".to_owned())
    }

    #[test]
    fn grants_are_shown_in_one_line_and_denials_with_a_remedy() {
        let all = granted(yes("SCHED_FIFO, priority 50"), yes("memory locked"));
        assert_eq!(all, "real-time scheduling (SCHED_FIFO, priority 50), memory locked");
        let nothing = granted(no(), no());
        for part in [
            "LimitRTPRIO=50",
            "LimitMEMLOCK=infinity",
            "setcap cap_sys_nice,cap_ipc_lock+ep",
            "`rtprio 50`",
            "limits.conf",
        ] {
            assert!(nothing.contains(part), "{nothing}");
        }
        assert!(!nothing.contains('\n'));
        let pageable = granted(yes("SCHED_FIFO, priority 50"), no());
        assert!(pageable.contains("LimitMEMLOCK") && !pageable.contains("LimitRTPRIO"), "{pageable}");
        let ordinary = granted(no(), yes("memory locked"));
        assert!(ordinary.contains("LimitRTPRIO") && !ordinary.contains("LimitMEMLOCK"), "{ordinary}");
    }

    #[test]
    fn priority_limit_below_the_full_priority_is_used() {
        let within = |maximum| within(Rlimit { current: Some(0), maximum });
        let limits = [Some(0), Some(20), Some(49), Some(50), Some(99), None];
        assert_eq!(limits.map(within), [None, Some(20), Some(49), None, None, None]);
    }

    #[test]
    fn thread_without_real_time_request_gets_only_a_short_slice() {
        let (scheduling, attributes) = std::thread::spawn(|| {
            (Scheduling::of_this_thread(Realtime::Off), uapi::sched_getattr(0, 0).unwrap())
        })
        .join()
        .unwrap();
        assert!(!scheduling.lacks_something());
        if !scheduling.is_realtime() {
            assert_eq!(attributes.sched_policy, c::SCHED_OTHER.unsigned_abs());
            // Kernels before 6.12 report a slice of 0.
            assert!([0, SLICE_NANOS].contains(&attributes.sched_runtime), "{}", attributes.sched_runtime);
        }
    }

    #[test]
    fn thread_reports_its_actual_scheduling() {
        let (scheduling, attributes, child) = std::thread::spawn(|| {
            let scheduling = Scheduling::of_this_thread(Realtime::Auto);
            let child = std::thread::spawn(|| uapi::sched_getattr(0, 0).unwrap()).join().unwrap();
            (scheduling, uapi::sched_getattr(0, 0).unwrap(), child)
        })
        .join()
        .unwrap();
        let is_realtime = attributes.sched_policy == c::SCHED_FIFO.unsigned_abs();
        assert_eq!(scheduling.is_realtime(), is_realtime, "{scheduling}");
        assert_eq!(
            child.sched_policy,
            c::SCHED_OTHER.unsigned_abs(),
            "a thread that it starts inherits nothing"
        );
    }
}
