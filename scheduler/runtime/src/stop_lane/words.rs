//! The operator's commands, from signals or from the mission's socket. A stop sets off the stop lane's alarm, so that robots stop at
//! once. The mission receives every command.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, oneshot, watch};

use super::Alarm;
use crate::signals::{EndSignal, Signals, die_of};
use downbeat_mission::Rest;

/// Maximum time for final reports, once the operator has asked to leave at once or the mission is over. The process then ends.
const LEAVES_WITHIN: Duration = Duration::from_secs(10);

/// The operator's commands while a mission runs.
#[derive(Debug)]
#[non_exhaustive]
pub enum Operator {
    /// Begin the act that currently waits for the operator.
    Go {
        /// The name of the requested act. `None` for any act that waits.
        act: Option<String>,
        /// The operator who sends the command. `None` for the operator who began the mission.
        by: Option<String>,
        /// Receives the name of the act that begins, or the reason why none begins. The channel closes without a value if the mission
        /// ends first.
        answer: oneshot::Sender<Result<String, String>>,
    },
    /// Stop all robots and wait for their confirmation.
    Stop {
        /// How the robots come to rest.
        rest: Rest,
        /// The operator who sends the command. `None` for the operator who began the mission.
        by: Option<String>,
    },
    /// End the program at once, without waiting for confirmations.
    Leave,
}

/// Sends commands as the operator: the mission receives every command, and the robots receive a stop at once.
#[derive(Clone, Debug)]
pub struct OperatorHandle {
    mission: mpsc::Sender<Operator>,
    alarm: watch::Sender<Alarm>,
    /// Number of iterations of the mission's loop, or [`OVER`] once the loop has ended.
    turns: Arc<AtomicU64>,
}

const OVER: u64 = u64::MAX;

/// The error for a command to a mission that is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissionOver;

impl OperatorHandle {
    pub(super) fn new(mission: mpsc::Sender<Operator>, alarm: watch::Sender<Alarm>) -> Self {
        Self { mission, alarm, turns: Arc::default() }
    }

    /// Records that the mission's loop has completed an iteration, which shows that it is not blocked.
    pub(super) fn turned(&self) {
        self.turns.fetch_add(1, Ordering::Relaxed);
    }

    /// Records that the mission's loop has ended.
    pub(super) fn ended(&self) {
        self.turns.store(OVER, Ordering::Relaxed);
    }

    /// Returns the number of iterations of the mission's loop, or `None` once the loop has ended. While the loop is blocked, the number
    /// does not change.
    #[must_use]
    pub fn turns(&self) -> Option<u64> {
        Some(self.turns.load(Ordering::Relaxed)).filter(|turns| *turns != OVER)
    }

    /// Sends a command. Returns once it is in the mission's queue. A stop always sets off the alarm, which stops the robots, before this
    /// function returns. If the queue has room, the command is queued before the alarm, so that the mission knows why its robots end
    /// their scripts.
    ///
    /// # Errors
    /// Returns [`MissionOver`] if the mission takes no further commands.
    pub async fn say(&self, word: Operator) -> Result<(), MissionOver> {
        let rest = match word {
            Operator::Stop { rest, .. } => Some(rest),
            _ => None,
        };
        let tried = self.mission.try_send(word);
        if let Some(rest) = rest {
            self.alarm.send_if_modified(|alarm| {
                let known = rest == Rest::Home && *alarm == Alarm::GoingHome;
                !known && std::mem::replace(alarm, Alarm::Ringing(rest)) != Alarm::Ringing(rest)
            });
        }
        match tried {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(word)) => self.mission.send(word).await.map_err(|_| MissionOver),
            Err(TrySendError::Closed(_)) => Err(MissionOver),
        }
    }

    /// Whether the operator's latest stop brings the robots to the kind of rest `rest` (in place or at home).
    #[must_use]
    pub fn latest_is(&self, rest: Rest) -> bool {
        match *self.alarm.borrow() {
            Alarm::Quiet => false,
            Alarm::Ringing(latest) => latest == rest,
            Alarm::GoingHome => rest == Rest::Home,
        }
    }

    /// Permits the mission to move robots home, if the operator's latest stop command still sends them home.
    pub(super) fn goes_home(&self) {
        self.alarm.send_if_modified(|alarm| {
            let wanted = *alarm == Alarm::Ringing(Rest::Home);
            if wanted {
                *alarm = Alarm::GoingHome;
            }
            wanted
        });
    }

    /// Whether the mission has taken all commands from its queue, or is over.
    #[must_use]
    pub fn is_heard(&self) -> bool {
        self.mission.is_closed() || self.mission.capacity() == self.mission.max_capacity()
    }

    fn is_over(&self) -> bool {
        self.mission.is_closed()
    }
}

/// Handles the signals until the process ends.
pub(super) async fn hear(mut signals: Signals, voice: OperatorHandle) {
    let mut before = None;
    loop {
        let asked = signals.next().await;
        let word = word_of(asked, before.replace(asked), voice.latest_is(Rest::Home));
        if matches!(word, Operator::Leave) || voice.is_over() {
            // Nothing that blocks the process, such as a terminal that accepts no output, may keep the operator waiting.
            tokio::spawn(die_soon(asked));
        }
        let voice = voice.clone();
        tokio::spawn(async move { voice.say(word).await });
    }
}

async fn die_soon(asked: EndSignal) {
    tokio::time::sleep(LEAVES_WITHIN).await;
    die_of(asked);
}

/// Returns the command that a signal stands for. Every signal stops the robots, but a Ctrl-C after another signal ends the program. Other
/// second signals do not end it, because they may be sent unintentionally, for example when a terminal closes. While robots may be moving
/// home, a Ctrl-C stops them first.
const fn word_of(asked: EndSignal, before: Option<EndSignal>, goes_home: bool) -> Operator {
    match (before, asked) {
        (_, EndSignal::Home) => Operator::Stop { rest: Rest::Home, by: None },
        (Some(EndSignal::Home), _) => Operator::Stop { rest: Rest::InPlace, by: None },
        (Some(_), EndSignal::Interrupt) if !goes_home => Operator::Leave,
        _ => Operator::Stop { rest: Rest::InPlace, by: None },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_second_ctrl_c_exits() {
        let leaves = |asked, before| matches!(word_of(asked, before, false), Operator::Leave);
        assert!(!leaves(EndSignal::Interrupt, None));
        assert!(leaves(EndSignal::Interrupt, Some(EndSignal::Interrupt)));
        assert!(!leaves(EndSignal::HangUp, Some(EndSignal::HangUp)));
        assert!(!leaves(EndSignal::Terminate, Some(EndSignal::Interrupt)));
    }

    #[test]
    fn ctrl_c_stops_robots_going_home_before_the_next_one_exits() {
        let stops = |before, goes_home| {
            let word = word_of(EndSignal::Interrupt, before, goes_home);
            matches!(word, Operator::Stop { rest: Rest::InPlace, .. })
        };
        assert!(stops(Some(EndSignal::Interrupt), true), "Ctrl-C, then the key H");
        assert!(stops(Some(EndSignal::Home), false), "the signal for home has not reached the mission yet");
        assert!(!stops(Some(EndSignal::Interrupt), false));
    }

    #[test]
    fn alarm_rings_at_once_and_busy_mission_receives_stop_when_ready() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let (mission, mut words) = mpsc::channel(1);
            let (alarm, ringing) = watch::channel(Alarm::Quiet);
            let voice = OperatorHandle::new(mission, alarm);
            voice.say(Operator::Leave).await.unwrap();
            assert_eq!(*ringing.borrow(), Alarm::Quiet);
            let speaking =
                tokio::spawn(async move { voice.say(Operator::Stop { rest: Rest::Home, by: None }).await });
            tokio::task::yield_now().await;
            assert_eq!(*ringing.borrow(), Alarm::Ringing(Rest::Home));
            assert!(!speaking.is_finished());
            assert!(matches!(words.recv().await, Some(Operator::Leave)));
            assert!(matches!(words.recv().await, Some(Operator::Stop { rest: Rest::Home, .. })));
            assert_eq!(speaking.await.unwrap(), Ok(()));
        });
    }
}
