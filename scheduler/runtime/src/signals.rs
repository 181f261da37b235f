//! Which signals end the program in good order, and which it ignores.
//!
//! Ctrl-C, SIGTERM, SIGQUIT and SIGHUP ask it to end, as do SIGPWR and SIGXCPU; SIGRTMIN+1 asks a scheduler to send its robots home. SIGUSR1,
//! SIGUSR2, SIGXFSZ, SIGIO, SIGSTKFLT and those of timers would kill it by default and are taken without effect; a file that has
//! reached its limit then gives an error of writing. SIGPIPE is ignored by Rust itself.

use std::io;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use rustix::process::{Pid, kill_process};
use signal_hook::consts::{
    SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGTERM, SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU, SIGXFSZ,
};
use tokio::signal::unix::{Signal, SignalKind, signal};

use downbeat_mission::Rest;

/// A signal that asks the program to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// Ctrl-C.
    Interrupt,
    /// A supervisor's SIGTERM.
    Terminate,
    /// Ctrl-\.
    Quit,
    /// The terminal was closed, or the connection to it lost.
    HangUp,
    /// Another process asks a scheduler to send its robots to their default state.
    Home,
}

/// Whether the end of the terminal is the end of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnHangUp {
    /// As by SIGTERM, unless the program was started with SIGHUP ignored, as `nohup` does.
    End,
    /// It goes on.
    Stay,
}

/// Takes the signals that would kill the program for no good reason. Programs that it starts have them as usual.
pub fn take_harmless() {
    let timers = [SIGALRM, SIGVTALRM, SIGPROF];
    for harmless in [SIGUSR1, SIGUSR2, SIGXFSZ, SIGIO, uapi::c::SIGSTKFLT].into_iter().chain(timers) {
        take(harmless);
    }
}

fn take(number: i32) {
    if let Err(error) = signal_hook::flag::register(number, Arc::new(AtomicBool::new(false))) {
        tracing::warn!("signal {number} keeps its default effect: {error}");
    }
}

/// What a process that dies leaves behind as it found it.
static BEFORE_DEATH: OnceLock<fn()> = OnceLock::new();
/// How long that may take.
const RESTORED_WITHIN: Duration = Duration::from_millis(500);

/// Has this done before the process ends by [`die_of`]; the first call counts.
pub fn restore_before_death(restore: fn()) {
    let _already_set = BEFORE_DEATH.set(restore);
}

/// Ends the process as the signal would have, had the program not taken it. Half a second is waited at most, for what
/// [`restore_before_death`] has named.
pub fn die_of(asked: Asked) {
    if let Some(restore) = BEFORE_DEATH.get() {
        let (done, restored) = sync_channel(1);
        // On a thread of its own: what keeps the process may keep this, too.
        std::thread::spawn(move || {
            restore();
            let _given_up = done.send(());
        });
        let _too_late = restored.recv_timeout(RESTORED_WITHIN);
    }
    if let Err(error) = signal_hook::low_level::emulate_default_handler(asked.number()) {
        tracing::error!("cannot end by a signal: {error}");
    }
}

impl Asked {
    const fn number(self) -> i32 {
        match self {
            Self::Interrupt => SIGINT,
            Self::Terminate | Self::Home => SIGTERM,
            Self::Quit => SIGQUIT,
            Self::HangUp => SIGHUP,
        }
    }
}

/// Waits for the signals that ask the program to end.
#[derive(Debug)]
pub struct Signals {
    interrupt: Signal,
    terminate: Signal,
    quit: Signal,
    hang_up: Option<Signal>,
    /// The supply fails, or the time of the processor is used up: more will not be said before the process is killed.
    last: [Signal; 2],
    home: Option<Signal>,
}

impl Signals {
    /// From now on none of them kills the process by itself. Called within a runtime.
    ///
    /// # Errors
    /// The system gives no handler.
    pub fn listen(on_hang_up: OnHangUp) -> io::Result<Self> {
        let hang_up = match on_hang_up {
            OnHangUp::End if is_ignored(SIGHUP) => None,
            OnHangUp::End => Some(signal(SignalKind::hangup())?),
            OnHangUp::Stay => {
                take(SIGHUP);
                None
            }
        };
        let (interrupt, terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        let raw = |number| signal(SignalKind::from_raw(number));
        let last = [raw(uapi::c::SIGPWR)?, raw(SIGXCPU)?];
        Ok(Self { interrupt, terminate, quit: signal(SignalKind::quit())?, hang_up, last, home: None })
    }

    /// Those of a scheduler, which can be asked to send its robots home, too.
    ///
    /// # Errors
    /// The system gives no handler.
    pub fn of_scheduler(on_hang_up: OnHangUp) -> io::Result<Self> {
        let home = Some(signal(SignalKind::from_raw(home_number()))?);
        Ok(Self { home, ..Self::listen(on_hang_up)? })
    }

    /// The next one.
    pub async fn next(&mut self) -> Asked {
        let [power, processor] = &mut self.last;
        tokio::select! {
            () = received(&mut self.home) => Asked::Home,
            _ = self.interrupt.recv() => Asked::Interrupt,
            _ = self.terminate.recv() => Asked::Terminate,
            _ = self.quit.recv() => Asked::Quit,
            () = received(&mut self.hang_up) => Asked::HangUp,
            _ = power.recv() => Asked::Terminate,
            _ = processor.recv() => Asked::Terminate,
        }
    }
}

async fn received(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => {
            let _never_ends = signal.recv().await;
        }
        None => std::future::pending().await,
    }
}

/// The signal that asks a scheduler to send its robots home.
fn home_number() -> i32 {
    uapi::c::SIGRTMIN() + 1
}

/// Has a scheduler stop its robots once it goes on; returns the signal's name, if it could be sent.
pub fn stop(scheduler: Pid, rest: Rest) -> Option<&'static str> {
    let (name, sent) = match rest {
        Rest::InPlace => ("SIGTERM", kill_process(scheduler, rustix::process::Signal::TERM).is_ok()),
        Rest::Home => ("SIGRTMIN+1", uapi::kill(scheduler.as_raw_nonzero().get(), home_number()).is_ok()),
    };
    sent.then_some(name)
}

/// Whether a signal was ignored when the program began, as its parent wanted.
fn is_ignored(number: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    ignored(&status) >> (number - 1) & 1 == 1
}

/// The mask of ignored signals in `/proc/self/status` (proc(5)).
fn ignored(status: &str) -> u64 {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mask_of_ignored_signals_is_read_from_the_status_of_the_process() {
        assert_eq!(ignored("Name:\tx\nSigBlk:\t0000000000000000\nSigIgn:\t0000000000001001\n"), 0x1001);
        assert_eq!(ignored("no such line"), 0);
    }
}
