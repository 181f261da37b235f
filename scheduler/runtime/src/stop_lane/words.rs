//! What the operator says, by signals or by the mission's socket: a stop rings the alarm, and the mission hears every word.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, oneshot, watch};

use super::Alarm;
use crate::signals::{Asked, Signals, die_of};
use downbeat_mission::Rest;

/// Once told to leave at once, or when the mission is over, the process may take this long to say what it has to.
const LEAVES_WITHIN: Duration = Duration::from_secs(10);

/// What the operator asks for while a mission runs.
#[derive(Debug)]
#[non_exhaustive]
pub enum Operator {
    /// Begin the act that waits for the operator.
    Go {
        /// The act that is meant; `None` for any act that waits.
        act: Option<String>,
        /// Who says so, if it is not the operator who began the mission.
        by: Option<String>,
        /// Receives the act that begins, or the reason why none does; receives nothing if the mission ends before.
        answer: oneshot::Sender<Result<String, String>>,
    },
    /// Stop all robots and wait for their confirmation.
    Stop {
        /// How they come to rest.
        rest: Rest,
        /// Who says so, if it is not the operator who began the mission.
        by: Option<String>,
    },
    /// Leave at once.
    Leave,
}

/// Speaks for the operator: the mission hears every word, and the robots hear of a stop at once.
#[derive(Clone, Debug)]
pub struct Voice {
    mission: mpsc::Sender<Operator>,
    alarm: watch::Sender<Alarm>,
    /// How often the mission's loop has turned; [`OVER`] once it has ended.
    turns: Arc<AtomicU64>,
}

const OVER: u64 = u64::MAX;

/// The mission is over: it takes no more words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissionOver;

impl Voice {
    pub(super) fn new(mission: mpsc::Sender<Operator>, alarm: watch::Sender<Alarm>) -> Self {
        Self { mission, alarm, turns: Arc::default() }
    }

    /// The mission's loop continues.
    pub(super) fn turned(&self) {
        self.turns.fetch_add(1, Ordering::Relaxed);
    }

    /// The mission's loop has ended.
    pub(super) fn ended(&self) {
        self.turns.store(OVER, Ordering::Relaxed);
    }

    /// How often the mission's loop has turned; `None` once it has ended. One that stands still does not turn.
    #[must_use]
    pub fn turns(&self) -> Option<u64> {
        Some(self.turns.load(Ordering::Relaxed)).filter(|turns| *turns != OVER)
    }

    /// Says a word; returns once the mission has it among those that it takes next. A stop rings the alarm before that, but
    /// where the mission has room it has the word first, so that it knows why its robots end what they do.
    ///
    /// # Errors
    /// [`MissionOver`].
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

    /// Whether the operator's latest stop brings robots to rest in this way.
    #[must_use]
    pub fn latest_is(&self, rest: Rest) -> bool {
        match *self.alarm.borrow() {
            Alarm::Quiet => false,
            Alarm::Ringing(latest) => latest == rest,
            Alarm::GoingHome => rest == Rest::Home,
        }
    }

    /// Lets the way home pass if home is still the operator's latest command.
    pub(super) fn goes_home(&self) {
        self.alarm.send_if_modified(|alarm| {
            let wanted = *alarm == Alarm::Ringing(Rest::Home);
            if wanted {
                *alarm = Alarm::GoingHome;
            }
            wanted
        });
    }

    /// Whether the mission has taken all that was said, or is over.
    #[must_use]
    pub fn is_heard(&self) -> bool {
        self.mission.is_closed() || self.mission.capacity() == self.mission.max_capacity()
    }

    fn is_over(&self) -> bool {
        self.mission.is_closed()
    }
}

/// Hears the signals until the process ends.
pub(super) async fn hear(mut signals: Signals, voice: Voice) {
    let mut before = None;
    loop {
        let asked = signals.next().await;
        let word = word_of(asked, before.replace(asked), voice.latest_is(Rest::Home));
        if matches!(word, Operator::Leave) || voice.is_over() {
            // Nothing that still keeps the process, as a terminal that takes no report, keeps the operator.
            tokio::spawn(die_soon(asked));
        }
        let voice = voice.clone();
        tokio::spawn(async move { voice.say(word).await });
    }
}

async fn die_soon(asked: Asked) {
    tokio::time::sleep(LEAVES_WITHIN).await;
    die_of(asked);
}

/// Every signal stops, but a Ctrl-C after another signal leaves. Any other may come twice by itself, as when a terminal
/// closes. While robots may be on their way home, a Ctrl-C stops them first.
const fn word_of(asked: Asked, before: Option<Asked>, goes_home: bool) -> Operator {
    match (before, asked) {
        (_, Asked::Home) => Operator::Stop { rest: Rest::Home, by: None },
        (Some(Asked::Home), _) => Operator::Stop { rest: Rest::InPlace, by: None },
        (Some(_), Asked::Interrupt) if !goes_home => Operator::Leave,
        _ => Operator::Stop { rest: Rest::InPlace, by: None },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_second_ctrl_c_leaves() {
        let leaves = |asked, before| matches!(word_of(asked, before, false), Operator::Leave);
        assert!(!leaves(Asked::Interrupt, None));
        assert!(leaves(Asked::Interrupt, Some(Asked::Interrupt)));
        assert!(!leaves(Asked::HangUp, Some(Asked::HangUp)));
        assert!(!leaves(Asked::Terminate, Some(Asked::Interrupt)));
    }

    #[test]
    fn a_ctrl_c_stops_robots_on_their_way_home_before_another_one_leaves() {
        let stops = |before, goes_home| {
            let word = word_of(Asked::Interrupt, before, goes_home);
            matches!(word, Operator::Stop { rest: Rest::InPlace, .. })
        };
        assert!(stops(Some(Asked::Interrupt), true), "Ctrl-C, then the key H");
        assert!(stops(Some(Asked::Home), false), "the signal for home has not reached the mission yet");
        assert!(!stops(Some(Asked::Interrupt), false));
    }

    #[test]
    fn the_alarm_rings_at_once_and_a_mission_that_takes_no_words_hears_of_the_stop_as_soon_as_it_does() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let (mission, mut words) = mpsc::channel(1);
            let (alarm, ringing) = watch::channel(Alarm::Quiet);
            let voice = Voice::new(mission, alarm);
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
