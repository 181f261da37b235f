//! The operator's keys, and Ctrl-Z.

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
use crate::stop_lane::{Operator, StopLane, Voice};

/// For so long Ctrl-Z waits for the display to leave the screen.
const LIFT_MAX: Duration = Duration::from_millis(200);

/// What a key means.
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

/// Says what keys mean to the mission, by the lane that hears a stop whatever else stands still.
pub(in crate::cli) struct Speaker {
    voice: Voice,
    lane: Handle,
    /// Waits for the answer to the last go.
    asking: Option<JoinHandle<()>>,
}

impl Speaker {
    /// Speaks by this lane.
    pub(in crate::cli) fn of(lane: &StopLane) -> Self {
        Self { voice: lane.voice(), lane: lane.runtime().clone(), asking: None }
    }

    /// Says go, and shows why it does not count, if so. The answer is awaited elsewhere: a mission that stands still gives none,
    /// and the next key may be a stop.
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
    /// Stops all robots. The lane has the first such word at once; a mission that stands still takes it later.
    fn stop(&self, rest: Rest) {
        let (voice, lane) = (self.voice.clone(), self.lane.clone());
        let stop = Operator::Stop { rest, by: None };
        let _until_it_is_taken = std::thread::spawn(move || lane.block_on(voice.say(stop)));
    }
}

/// Single keys under the display. The thread ends with the process.
pub(super) fn listen(scene: Arc<Mutex<Scene>>, mut speaker: Speaker) {
    if !terminal::has_keys() {
        return;
    }
    terminal::take_keys();
    std::thread::spawn(move || {
        let mut last = None;
        while let Some(bytes) = terminal::next_keys() {
            // Arrow keys and the like are sequences, which mean nothing here.
            if bytes.first() == Some(&0x1b) {
                continue;
            }
            for key in bytes.into_iter().filter_map(Key::of) {
                match key {
                    Key::Go => speaker.go(),
                    // A second Ctrl-C would leave at once, so only the first word is said as one.
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

/// Lines where there is no display: an empty one is the operator's go. The thread ends with the process.
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
                    other => console::note(&format!("`{}` is not a command; {LINES}", shown(other))),
                }
            }
        }
    });
}

const LINES: &str = "Enter or go begins the act that waits, stop stops all robots where they are, home stops them and then moves them to their default positions, Ctrl-C stops";

/// As Ctrl-C does, by the same way.
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

/// Ctrl-Z leaves the terminal as it was found, and `fg` brings the display back. The task ends with the process.
pub(super) fn watch_suspension(scene: Arc<Mutex<Scene>>) {
    let Ok(mut suspended) = signal(SignalKind::from_raw(Signal::TSTP.as_raw())) else { return };
    tokio::spawn(async move {
        while suspended.recv().await.is_some() {
            // From here on: an earlier continuation does not count.
            let Ok(mut continued) = signal(SignalKind::from_raw(Signal::CONT.as_raw())) else { return };
            let _ended = tokio::task::spawn_blocking(leave_terminal).await;
            let _own_process = kill_process(getpid(), Signal::STOP);
            // The thread that asks for it may run on for a moment before the process stands still.
            continued.recv().await;
            let scene = Arc::clone(&scene);
            let _ended = tokio::task::spawn_blocking(move || come_back(&scene)).await;
        }
    });
}

fn leave_terminal() {
    console::end_display();
    console::note(
        "suspended: robots go on by their scripts until their leases end; `fg` continues the mission",
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
    fn a_mission_that_answers_no_go_keeps_no_later_key_waiting() {
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
        // Pressed again: it waits for the same answer.
        speaker.go();
        assert!(operator.try_recv().is_err());
        answer.send(Ok("one".to_owned())).unwrap();
        speaker.asking.take().unwrap().join().unwrap();
        speaker.go();
        assert!(matches!(operator.blocking_recv(), Some(Operator::Go { .. })));
    }

    #[test]
    fn keys_that_mean_nothing_are_passed_over() {
        assert_eq!(
            [b'g', b'\r', b's', b'H', b'?'].map(Key::of),
            [Some(Key::Go), Some(Key::Go), Some(Key::Stop), Some(Key::Home), Some(Key::Help)]
        );
        assert_eq!([b'x', b'h', 0x1b, b' ', 0x13].map(Key::of), [None; 5]);
    }
}
