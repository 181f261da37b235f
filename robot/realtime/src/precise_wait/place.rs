//! Determines the core on which a thread under real-time scheduling waits, if more threads of this host wait for deadlines than the host
//! has cores.
//!
//! The kernel does not distribute waiting threads evenly: of six threads on two cores, five may share one core and move their robots one
//! after another. Each thread therefore reserves the lowest free number of this host, and stays on the corresponding core. Thus the
//! numbers of threads per core differ by at most one. A number is reserved by an abstract socket, which the kernel frees when the process
//! ends.

use std::io::ErrorKind;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// Maximum number of threads on a host that can reserve a number. Further threads get no number and choose no core.
const NUMBERS: usize = 256;
/// Time for which a thread remembers whether more threads wait than there are cores.
const REMEMBERED: Duration = Duration::from_secs(1);

/// The number that a thread has reserved on its host, and the cores on which the thread may run.
#[derive(Debug)]
pub(super) struct Place {
    /// The thread's number, and the socket that reserves it. `None` if the thread chooses no core.
    number: Option<(usize, UnixDatagram)>,
    /// The cores on which the thread may run.
    cores: Vec<usize>,
    is_kept: bool,
    /// Whether more threads wait than there are cores, and when this was checked. `None` before the first check.
    crowded: Option<(bool, Instant)>,
}

impl Place {
    /// Reserves a number for this thread. The number determines the thread's core.
    pub(super) fn of_this_thread() -> Self {
        let allowed = sched_getaffinity(None).unwrap_or_else(|_| CpuSet::new());
        let cores: Vec<_> = (0..CpuSet::MAX_CPU).filter(|core| allowed.is_set(*core)).collect();
        // On a single core, the thread has no choice.
        let number = if cores.len() > 1 { take_lowest() } else { None };
        Self { number, cores, is_kept: false, crowded: None }
    }

    /// Keeps the thread on its core while more threads wait than there are cores. Otherwise the thread may run on any permitted core.
    pub(super) fn choose(&mut self, now: Instant) {
        let Some((number, _)) = self.number else { return };
        let stays = self.is_crowded(now, number);
        if stays == self.is_kept {
            return;
        }
        let core = core_of(number, &self.cores).into_iter();
        let cores: Vec<_> = if stays { core.collect() } else { self.cores.clone() };
        let mut set = CpuSet::new();
        cores.iter().for_each(|core| set.set(*core));
        match sched_setaffinity(None, &set) {
            Ok(()) => self.is_kept = stays,
            // The permitted cores have changed, so the kernel chooses the core.
            Err(_) => self.number = None,
        }
    }

    fn is_crowded(&mut self, now: Instant, number: usize) -> bool {
        if number >= self.cores.len() {
            return true;
        }
        match self.crowded {
            Some((crowded, at)) if now.saturating_duration_since(at) < REMEMBERED => crowded,
            _ => {
                let crowded = is_taken(self.cores.len());
                self.crowded = Some((crowded, now));
                crowded
            }
        }
    }
}

fn core_of(number: usize, cores: &[usize]) -> Option<usize> {
    cores.get(number.checked_rem(cores.len())?).copied()
}

/// Reserves the lowest free number. `None` if the system does not support abstract sockets, or if all numbers are taken.
fn take_lowest() -> Option<(usize, UnixDatagram)> {
    for number in 0..NUMBERS {
        match take(number) {
            Ok(socket) => return Some((number, socket)),
            Err(error) if error.kind() == ErrorKind::AddrInUse => {}
            Err(_) => return None,
        }
    }
    None
}

fn is_taken(number: usize) -> bool {
    take(number).is_err_and(|error| error.kind() == ErrorKind::AddrInUse)
}

fn take(number: usize) -> std::io::Result<UnixDatagram> {
    UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(format!("downbeat-waits-{number}"))?)
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "an instant to count from; no time passes")]
mod tests {
    use super::*;

    #[test]
    fn consecutive_numbers_are_spread_evenly_over_the_allowed_cores() {
        let cores = [2, 5, 7];
        let chosen: Vec<_> = (0..7).filter_map(|number| core_of(number, &cores)).collect();
        assert_eq!(chosen, [2, 5, 7, 2, 5, 7, 2]);
        assert_eq!(core_of(3, &[]), None);
    }

    #[test]
    fn number_is_released_when_its_thread_has_ended() {
        // The number is far from those of robots in other tests, and unique to this process: the whole host shares the names of the
        // sockets.
        let number = 100_000 + std::process::id() as usize;
        let held = take(number).unwrap();
        assert!(is_taken(number));
        drop(held);
        assert!(!is_taken(number));
    }

    #[test]
    fn thread_is_pinned_to_its_core_while_threads_outnumber_cores() {
        std::thread::spawn(|| {
            let mut place = Place::of_this_thread();
            let Some((number, _)) = place.number else { return };
            let all = place.cores.clone();
            let allowed = || {
                let set = sched_getaffinity(None).unwrap();
                (0..CpuSet::MAX_CPU).filter(|core| set.is_set(*core)).collect::<Vec<_>>()
            };
            let now = Instant::now();
            place.crowded = Some((false, now));
            place.choose(now);
            if number < all.len() {
                assert_eq!(allowed(), all);
            }
            place.crowded = Some((true, now));
            place.choose(now);
            assert_eq!(allowed(), [all[number % all.len()]]);
            if number < all.len() {
                place.crowded = Some((false, now));
                place.choose(now);
                assert_eq!(allowed(), all);
            }
        })
        .join()
        .unwrap();
    }

    #[test]
    fn second_thread_takes_a_different_number() {
        let first = take_lowest().unwrap();
        let second = take_lowest().unwrap();
        assert_ne!(first.0, second.0);
    }
}
