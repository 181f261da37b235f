//! The signals that end the program in an orderly way, and those that it ignores.
//!
//! Ctrl-C, SIGTERM, SIGQUIT, SIGHUP, SIGPWR and SIGXCPU ask the program to end. SIGRTMIN+1 asks a scheduler to send its robots home.
//! SIGUSR1, SIGUSR2, SIGXFSZ, SIGIO, SIGSTKFLT and the timer signals would kill the program by default; they are caught and have no
//! effect. A file that has reached its size limit then causes a write error. Rust itself ignores SIGPIPE.

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
pub enum EndSignal {
    /// SIGINT, for example from Ctrl-C.
    Interrupt,
    /// SIGTERM, for example from a supervisor. Also SIGPWR and SIGXCPU.
    Terminate,
    /// SIGQUIT, for example from Ctrl-\.
    Quit,
    /// SIGHUP: the terminal was closed, or the connection to it was lost.
    HangUp,
    /// SIGRTMIN+1: another process asks a scheduler to send its robots to their default state.
    Home,
}

/// Whether the program ends when its terminal closes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnHangUp {
    /// The program ends as for SIGTERM, unless the program was started with SIGHUP ignored, as `nohup` does.
    End,
    /// The program continues.
    Stay,
}

/// Catches signals that would kill the program by default, although they do not ask it to end. Child processes get the default effects.
pub fn take_harmless() {
    let timers = [SIGALRM, SIGVTALRM, SIGPROF];
    for harmless in [SIGUSR1, SIGUSR2, SIGXFSZ, SIGIO, uapi::c::SIGSTKFLT].into_iter().chain(timers) {
        take(harmless);
    }
}

fn take(number: i32) {
    if let Err(error) = signal_hook::flag::register(number, Arc::new(AtomicBool::new(false))) {
        tracing::warn!("cannot install a handler for signal {number}: {error}");
    }
}

/// The function that restores state, for example the settings of the terminal, before the process dies.
static BEFORE_DEATH: OnceLock<fn()> = OnceLock::new();
/// Maximum time to wait for the function in [`BEFORE_DEATH`].
const RESTORED_WITHIN: Duration = Duration::from_millis(500);

/// Sets the function that [`die_of`] calls before it ends the process. Only the first call has an effect.
pub fn restore_before_death(restore: fn()) {
    let _already_set = BEFORE_DEATH.set(restore);
}

/// Ends the process as the signal would have done if the program had not caught it. Waits at most half a second for the function set by
/// [`restore_before_death`].
pub fn die_of(asked: EndSignal) {
    if let Some(restore) = BEFORE_DEATH.get() {
        let (done, restored) = sync_channel(1);
        // The function runs on its own thread, because it may block for the same reason as the process.
        std::thread::spawn(move || {
            restore();
            let _given_up = done.send(());
        });
        let _too_late = restored.recv_timeout(RESTORED_WITHIN);
    }
    if let Err(error) = signal_hook::low_level::emulate_default_handler(asked.number()) {
        tracing::error!("cannot end the process by a signal: {error}");
    }
}

impl EndSignal {
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
    /// SIGPWR and SIGXCPU: the power supply fails, or the CPU time is used up. The system kills the process afterwards without another
    /// signal.
    last: [Signal; 2],
    home: Option<Signal>,
}

impl Signals {
    /// Starts to catch the signals, so that none of them kills the process by itself. Must be called within a runtime.
    ///
    /// # Errors
    /// Fails if the operating system refuses a signal handler.
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

    /// Like [`listen`](Self::listen), but for a scheduler: also catches the signal that asks it to send its robots home.
    ///
    /// # Errors
    /// Fails if the operating system refuses a signal handler.
    pub fn of_scheduler(on_hang_up: OnHangUp) -> io::Result<Self> {
        let home = Some(signal(SignalKind::from_raw(home_number()))?);
        Ok(Self { home, ..Self::listen(on_hang_up)? })
    }

    /// Waits for the next signal that asks the program to end.
    pub async fn next(&mut self) -> EndSignal {
        let [power, processor] = &mut self.last;
        tokio::select! {
            () = received(&mut self.home) => EndSignal::Home,
            _ = self.interrupt.recv() => EndSignal::Interrupt,
            _ = self.terminate.recv() => EndSignal::Terminate,
            _ = self.quit.recv() => EndSignal::Quit,
            () = received(&mut self.hang_up) => EndSignal::HangUp,
            _ = power.recv() => EndSignal::Terminate,
            _ = processor.recv() => EndSignal::Terminate,
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

/// Returns the number of the signal that asks a scheduler to send its robots home.
fn home_number() -> i32 {
    uapi::c::SIGRTMIN() + 1
}

/// Sends a scheduler the signal to stop its robots. A suspended scheduler stops them once it continues. Returns the signal's name; `None`
/// if the signal could not be sent.
pub fn stop(scheduler: Pid, rest: Rest) -> Option<&'static str> {
    let (name, sent) = match rest {
        Rest::InPlace => ("SIGTERM", kill_process(scheduler, rustix::process::Signal::TERM).is_ok()),
        Rest::Home => ("SIGRTMIN+1", uapi::kill(scheduler.as_raw_nonzero().get(), home_number()).is_ok()),
    };
    sent.then_some(name)
}

/// Whether the parent process started this program with the signal ignored.
fn is_ignored(number: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    ignored(&status) >> (number - 1) & 1 == 1
}

/// Returns the bit mask of ignored signals from the text of `/proc/self/status` (proc(5)).
fn ignored(status: &str) -> u64 {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ignored_signals_are_read_from_process_status() {
        assert_eq!(ignored("Name:\tx\nSigBlk:\t0000000000000000\nSigIgn:\t0000000000001001\n"), 0x1001);
        assert_eq!(ignored("no such line"), 0);
    }
}
