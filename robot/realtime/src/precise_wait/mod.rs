//! Waits for a message or a deadline with microsecond precision. This is the only module that uses the operating system's timer.
//!
//! The thread sleeps on its channel until shortly before the deadline and then spins. The reason is that the system wakes a sleeper tens
//! of microseconds late, even with the minimum timer slack. The timer wheel of an asynchronous runtime wakes a sleeper a millisecond
//! late. How the thread spins depends on the load of the machine ([`approach`]).
#![expect(clippy::disallowed_methods, reason = "spins on the monotonic clock")]

mod approach;
mod place;

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::time::{Duration, Instant};

use flume::{Receiver, RecvTimeoutError};

use self::approach::{Approach, Cores, Scheduled};
use self::place::Place;
use crate::scheduling::Scheduling;

/// Delay after which busy cores are checked again. Cores are considered busy only if both checks find them busy. The second check is
/// still well before the deadline.
const LOOK_AGAIN: Duration = Duration::from_millis(2);
/// Minimum time before a deadline at which a thread may still move to another core.
const STAY_FROM: Duration = Duration::from_millis(2);
/// Maximum time for which a thread yields to other threads after a movement, before it sleeps.
const TURNS: Duration = Duration::from_micros(60);

/// Reason why a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Woken<T> {
    /// A message arrived.
    Message(T),
    /// The deadline has been reached.
    Deadline,
    /// All senders are dropped.
    Closed,
}

/// Waits on behalf of one thread, and adapts to the thread's previous waits.
#[derive(Debug)]
pub struct PreciseWait {
    approach: Approach,
    machine: Machine,
    /// The thread's core; set only under real-time scheduling. An ordinary thread that stays on one core would have to wait for every
    /// other program on that core.
    place: Option<Place>,
}

impl PreciseWait {
    /// Creates the waiting state of the current thread. `scheduling` is the scheduling that the thread was granted.
    #[must_use]
    pub fn new(scheduling: &Scheduling) -> Self {
        let scheduled = if scheduling.is_realtime() { Scheduled::First } else { Scheduled::Fairly };
        let (approach, machine) = (Approach::new(scheduled), Machine::watched());
        Self { approach, machine, place: scheduling.is_realtime().then(Place::of_this_thread) }
    }

    /// Waits for the next message or, if there is a deadline, at most until the deadline.
    pub fn wait<T>(&mut self, messages: &Receiver<T>, deadline: Option<Instant>) -> Woken<T> {
        let Some(deadline) = deadline else {
            return messages.recv().map_or(Woken::Closed, Woken::Message);
        };
        let chance = fastrand::f64();
        if let Some(look_at) = self.approach.look_at(Instant::now(), deadline, chance) {
            let mut cores = Cores::Busy;
            // Because of the second check, a short load spike does not make the cores count as busy.
            for look_at in [look_at, look_at + LOOK_AGAIN] {
                match sleep(messages, look_at) {
                    Woken::Deadline => cores = self.machine.cores(),
                    woken => return woken,
                }
                if cores == Cores::Free {
                    break;
                }
            }
            self.approach.looked(Instant::now(), cores);
        }
        let now = Instant::now();
        if let Some(place) = &mut self.place
            && deadline.saturating_duration_since(now) >= STAY_FROM
        {
            place.choose(now);
        }
        let lead = self.approach.lead(Instant::now(), deadline);
        let wake_at = deadline.checked_sub(lead).unwrap_or(deadline);
        let sleeps = Instant::now() < wake_at;
        let woken = sleep(messages, wake_at);
        if matches!(woken, Woken::Deadline) {
            let now = Instant::now();
            if sleeps {
                self.approach.woke(now, now.saturating_duration_since(wake_at));
            }
            self.spin(deadline);
        }
        woken
    }

    /// Like [`PreciseWait::wait`], for a deadline at which nothing moves: sleeps without spinning, and thus wakes as late as the system
    /// wakes it.
    pub fn wait_roughly<T>(&self, messages: &Receiver<T>, deadline: Instant) -> Woken<T> {
        sleep(messages, deadline)
    }

    /// Spins until the deadline. Messages that arrive meanwhile must wait, because one that takes long to handle would delay the start.
    fn spin(&mut self, deadline: Instant) {
        let begun = Instant::now();
        loop {
            let now = Instant::now();
            if now >= deadline {
                return self.approach.spun(now, now - begun);
            }
            self.pause(now);
        }
    }

    /// Lets other processes move their robots at the same instant: first by yielding, then by sleeping. `next` is the next deadline; if
    /// it is near, the thread yields and sleeps for a shorter time. Under real-time scheduling, yielding is sufficient.
    pub fn let_others_move(&mut self, next: Option<Instant>) {
        let begun = Instant::now();
        let rest = self.approach.rest(begun, next);
        // The thread yields first, because falling asleep takes longer than other threads on this core need.
        let (mut now, turns) = (begun, begun + rest.min(TURNS));
        while self.approach.yields(now) {
            self.pause(now);
            now = Instant::now();
            if now >= turns {
                break;
            }
        }
        let rest = rest.saturating_sub(now - begun);
        if !self.approach.is_first() && !rest.is_zero() {
            std::thread::sleep(rest);
        }
    }

    fn pause(&mut self, now: Instant) {
        if self.approach.yields(now) {
            std::thread::yield_now();
            self.approach.yielded(Instant::now(), now.elapsed());
        } else {
            std::hint::spin_loop();
        }
    }
}

fn sleep<T>(messages: &Receiver<T>, until: Instant) -> Woken<T> {
    let sleep = until.saturating_duration_since(Instant::now());
    if sleep.is_zero() {
        return Woken::Deadline;
    }
    match messages.recv_timeout(sleep) {
        Ok(message) => Woken::Message(message),
        Err(RecvTimeoutError::Disconnected) => Woken::Closed,
        Err(RecvTimeoutError::Timeout) => Woken::Deadline,
    }
}

/// Load of the machine, as the kernel reports it.
#[derive(Debug)]
struct Machine {
    /// The file `/proc/loadavg`. It is kept open, so that a check needs only one read.
    loads: Option<File>,
    cores: usize,
}

impl Machine {
    fn watched() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, Into::into);
        Self { loads: File::open("/proc/loadavg").ok(), cores }
    }

    /// Returns the load of the cores. If the load is unknown, the cores are considered free until a yield shows otherwise.
    fn cores(&self) -> Cores {
        let mut text = [0; 64];
        let read = self.loads.as_ref().and_then(|loads| loads.read_at(&mut text, 0).ok()).unwrap_or(0);
        match std::str::from_utf8(&text[..read]).ok().and_then(runnable) {
            Some(runnable) if runnable > self.cores => Cores::Busy,
            _ => Cores::Free,
        }
    }
}

/// Parses the number of runnable threads, including this one. It precedes the slash in `/proc/loadavg`, for example 1 in the line
/// `0.20 0.18 0.12 1/80 11206`.
fn runnable(loads: &str) -> Option<usize> {
    loads.split(' ').nth(3)?.split_once('/')?.0.parse().ok()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use flume::unbounded as channel;

    use super::*;
    use crate::scheduling::{Realtime, Scheduling};

    fn waits() -> PreciseWait {
        PreciseWait::new(&Scheduling::of_this_thread(Realtime::Off))
    }

    #[test]
    fn wait_never_ends_before_the_deadline() {
        let (_sender, receiver) = channel::<()>();
        let mut waits = waits();
        for micros in [0, 1, 150, 1_000, 5_000, 20_000] {
            let deadline = Instant::now() + Duration::from_micros(micros);
            assert!(matches!(waits.wait(&receiver, Some(deadline)), Woken::Deadline));
            assert!(Instant::now() >= deadline);
        }
    }

    #[test]
    fn other_processes_get_half_a_millisecond_to_move_their_robots() {
        let (mut waits, began) = (waits(), Instant::now());
        waits.let_others_move(None);
        assert!(began.elapsed() >= Duration::from_micros(500), "{:?}", began.elapsed());
    }

    #[test]
    fn message_ends_a_wait_but_a_reached_deadline_comes_first() {
        let (sender, receiver) = channel();
        sender.send(1).unwrap();
        sender.send(2).unwrap();
        let (mut waits, now) = (waits(), Instant::now());
        assert!(matches!(waits.wait(&receiver, Some(now + Duration::from_secs(3_600))), Woken::Message(1)));
        assert!(matches!(waits.wait(&receiver, Some(now)), Woken::Deadline));
        assert!(matches!(waits.wait(&receiver, None), Woken::Message(2)));
    }

    #[test]
    fn message_just_before_a_deadline_is_delivered_after_it() {
        let (sender, receiver) = channel();
        let mut waits = waits();
        waits.approach.looked(Instant::now(), Cores::Free);
        // The message is sent during the spinning time.
        let deadline = Instant::now() + Duration::from_micros(150);
        sender.send(1).unwrap();
        assert!(matches!(waits.wait(&receiver, Some(deadline)), Woken::Deadline));
        assert!(matches!(waits.wait(&receiver, None), Woken::Message(1)));
    }

    #[test]
    fn wait_ends_when_all_senders_are_dropped() {
        let (sender, receiver) = channel::<()>();
        let mut waits = waits();
        drop(sender);
        assert!(matches!(waits.wait(&receiver, None), Woken::Closed));
        let far = Instant::now() + Duration::from_secs(3_600);
        assert!(matches!(waits.wait(&receiver, Some(far)), Woken::Closed));
    }

    #[test]
    fn machine_with_more_runnable_threads_than_cores_is_busy() {
        assert_eq!(runnable("0.20 0.18 0.12 3/80 11206\n"), Some(3));
        assert_eq!(runnable("0.20 0.18"), None);
        let folder = std::env::temp_dir().join(format!("downbeat-loads-{}", std::process::id()));
        for (runnable, expected) in [(1, Cores::Free), (2, Cores::Free), (3, Cores::Busy)] {
            std::fs::write(&folder, format!("9.00 9.00 9.00 {runnable}/80 11206\n")).unwrap();
            let machine = Machine { loads: File::open(&folder).ok(), cores: 2 };
            assert_eq!(machine.cores(), expected, "{runnable}");
        }
        std::fs::remove_file(&folder).unwrap();
        assert_eq!(Machine { loads: None, cores: 2 }.cores(), Cores::Free);
    }
}
