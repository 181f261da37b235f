//! Handles the keys that the operator presses, including Ctrl-Z.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use downbeat_scripts::shown::shown;
use rustix::process::{Signal, getpid, kill_process};
use tokio::runtime::Handle;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::oneshot;

use super::frame::Help;
use super::{Scene, Shown, show, terminal};
use crate::cli::console;
use crate::mission::Rest;
use crate::stop_lane::{Operator, OperatorHandle, StopLane};

/// Maximum time that Ctrl-Z waits for the display to be removed from the screen.
const LIFT_MAX: Duration = Duration::from_millis(200);

/// The command that a key stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    Go,
    Stop,
    Home,
    Help,
}

impl Key {
    const fn of(byte: u8) -> Option<Self> {
        match byte {
            b'g' | b'G' | b'\n' | b'\r' => Some(Self::Go),
            b's' | b'S' => Some(Self::Stop),
            b'H' => Some(Self::Home),
            b'?' => Some(Self::Help),
            _ => None,
        }
    }
}

/// Sends key commands to the mission through the stop lane, which receives a stop even if everything else is blocked.
pub(in crate::cli) struct Speaker {
    voice: OperatorHandle,
    lane: Handle,
    /// The thread that waits for the mission's answer to the last `go`. `None` before the first one.
    asking: Option<JoinHandle<()>>,
}

impl Speaker {
    /// Creates a speaker that sends commands through this stop lane.
    pub(in crate::cli) fn of(lane: &StopLane) -> Self {
        Self { voice: lane.voice(), lane: lane.runtime().clone(), asking: None }
    }

    /// Sends `go`, and prints the reason if the mission refuses it. Another thread waits for the answer, because a blocked mission does
    /// not answer and the next key may be a stop.
    fn go(&mut self) {
        if self.asking.as_ref().is_some_and(|asking| !asking.is_finished()) {
            return;
        }
        let (voice, lane) = (self.voice.clone(), self.lane.clone());
        self.asking = Some(std::thread::spawn(move || {
            let (answer, answered) = oneshot::channel();
            let _over = lane.block_on(voice.say(Operator::Go { act: None, by: None, answer }));
            if let Ok(Err(reason)) = answered.blocking_recv() {
                console::note(&format!("no go: {reason}"));
            }
        }));
    }
}

impl Speaker {
    /// Stops all robots. The stop lane receives the command at once; a blocked mission receives it later.
    fn stop(&self, rest: Rest) {
        let (voice, lane) = (self.voice.clone(), self.lane.clone());
        let stop = Operator::Stop { rest, by: None };
        let _until_it_is_taken = std::thread::spawn(move || lane.block_on(voice.say(stop)));
    }
}

/// Starts a thread that handles single keys while the display is shown. The thread ends with the process.
pub(super) fn listen(scene: Arc<Mutex<Scene>>, mut speaker: Speaker) {
    if !terminal::has_keys() {
        return;
    }
    terminal::take_keys();
    std::thread::spawn(move || {
        let mut last = None;
        while let Some(bytes) = terminal::next_keys() {
            // Arrow keys and similar keys send sequences of bytes, which have no meaning here.
            if bytes.first() == Some(&0x1b) {
                continue;
            }
            for key in bytes.into_iter().filter_map(Key::of) {
                match key {
                    Key::Go => speaker.go(),
                    // A second Ctrl-C would leave at once, so repetitions of the same key are ignored.
                    Key::Stop | Key::Home if last == Some(key) => {}
                    Key::Stop if last.is_none() => stop(),
                    Key::Stop => speaker.stop(Rest::InPlace),
                    Key::Home => speaker.stop(Rest::Home),
                    Key::Help => toggle_help(&scene),
                }
                if matches!(key, Key::Stop | Key::Home) {
                    last = Some(key);
                }
            }
        }
    });
}

/// Starts a thread that handles lines of input if there is no display: an empty line means `go`. The thread ends with the process.
pub(super) fn listen_to_lines(mut speaker: Speaker) {
    if !terminal::has_keys() {
        return;
    }
    std::thread::spawn(move || {
        while let Some(typed) = terminal::next_keys() {
            let typed = String::from_utf8_lossy(&typed);
            for line in typed.lines() {
                match line.trim() {
                    "" | "g" | "go" => speaker.go(),
                    "s" | "stop" => speaker.stop(Rest::InPlace),
                    "home" => speaker.stop(Rest::Home),
                    "?" | "help" => console::note(LINES),
                    other => console::note(&format!("unknown command `{}`; {LINES}", shown(other))),
                }
            }
        }
    });
}

const LINES: &str = "Enter or `go` starts the waiting act; `stop` or Ctrl-C stops all robots where they are; `home` stops them, then moves them to their default positions";

/// Stops the mission by sending this process the signal that Ctrl-C sends.
fn stop() {
    let _own_process = kill_process(getpid(), Signal::INT);
}

fn toggle_help(scene: &Mutex<Scene>) {
    let mut scene = scene.lock().unwrap_or_else(PoisonError::into_inner);
    scene.help = match scene.help {
        Help::Hidden => Help::Shown,
        Help::Shown => Help::Hidden,
    };
}

/// Starts a task that restores the terminal on Ctrl-Z, and brings the display back after `fg`. The task ends with the process.
pub(super) fn watch_suspension(scene: Arc<Mutex<Scene>>) {
    let Ok(mut suspended) = signal(SignalKind::from_raw(Signal::TSTP.as_raw())) else { return };
    tokio::spawn(async move {
        while suspended.recv().await.is_some() {
            // The handler is registered only now, so that an earlier SIGCONT is ignored.
            let Ok(mut continued) = signal(SignalKind::from_raw(Signal::CONT.as_raw())) else { return };
            let _ended = tokio::task::spawn_blocking(leave_terminal).await;
            let _own_process = kill_process(getpid(), Signal::STOP);
            // This task may run for a moment before the process is suspended.
            continued.recv().await;
            let scene = Arc::clone(&scene);
            let _ended = tokio::task::spawn_blocking(move || come_back(&scene)).await;
        }
    });
}

fn leave_terminal() {
    console::end_display();
    console::note(
        "suspended: robots continue their scripts until their leases expire; `fg` continues the mission",
    );
    console::drain(LIFT_MAX);
    terminal::restore();
}

fn come_back(scene: &Arc<Mutex<Scene>>) {
    let shown = scene.lock().unwrap_or_else(PoisonError::into_inner).shown;
    if shown == Shown::Yes {
        terminal::take_keys();
        show(scene);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signals::OnHangUp;

    #[test]
    fn unanswered_go_does_not_delay_later_keys() {
        let (lane, mut operator) = StopLane::start(OnHangUp::End).unwrap();
        let mut speaker = Speaker::of(&lane);
        let (done, is_done) = std::sync::mpsc::sync_channel(1);
        std::thread::spawn(move || {
            speaker.go();
            done.send(speaker)
        });
        let mut speaker = is_done.recv_timeout(Duration::from_secs(30)).unwrap();
        let said = operator.blocking_recv();
        let Some(Operator::Go { answer, .. }) = said else { panic!("{said:?}") };
        // If the key is pressed again, no second `go` is sent while the first one awaits its answer.
        speaker.go();
        assert!(operator.try_recv().is_err());
        answer.send(Ok("one".to_owned())).unwrap();
        speaker.asking.take().unwrap().join().unwrap();
        speaker.go();
        assert!(matches!(operator.blocking_recv(), Some(Operator::Go { .. })));
    }

    #[test]
    fn unknown_keys_are_ignored() {
        assert_eq!(
            [b'g', b'\r', b's', b'H', b'?'].map(Key::of),
            [Some(Key::Go), Some(Key::Go), Some(Key::Stop), Some(Key::Home), Some(Key::Help)]
        );
        assert_eq!([b'x', b'h', 0x1b, b' ', 0x13].map(Key::of), [None; 5]);
    }
}
