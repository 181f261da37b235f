//! What the operator says, by signals or by the mission's socket: a stop rings the alarm, and the mission hears every word.

use std::time::Duration;

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, watch};

use super::Alarm;
use crate::run::Operator;
use crate::signals::{Asked, Signals, die_of};

/// Once told to leave at once, or when the mission is over, the process may take so long to say what it has to.
const LEAVES_WITHIN: Duration = Duration::from_secs(10);

/// Hears everything until the process ends.
pub(super) async fn hear(
    mut signals: Signals,
    mut heard: mpsc::Receiver<Operator>,
    mission: mpsc::Sender<Operator>,
    alarm: watch::Sender<Alarm>,
) {
    let mut before = None;
    loop {
        let word = tokio::select! {
            biased;
            asked = signals.next() => {
                let word = word_of(asked, before.replace(asked));
                if word == Operator::Leave || mission.is_closed() {
                    // Nothing that still keeps the process, as a terminal that takes no report, keeps the operator.
                    tokio::spawn(die_soon(asked));
                }
                word
            }
            Some(word) = heard.recv() => word,
        };
        pass_on(word, &mission, &alarm);
    }
}

async fn die_soon(asked: Asked) {
    tokio::time::sleep(LEAVES_WITHIN).await;
    die_of(asked);
}

/// Every signal stops, but a Ctrl-C after another signal leaves. Any other may come twice by itself, as when a terminal
/// closes.
const fn word_of(asked: Asked, before: Option<Asked>) -> Operator {
    match (before, asked) {
        (Some(_), Asked::Interrupt) => Operator::Leave,
        _ => Operator::Stop,
    }
}

/// The mission hears of a stop before the robots do, so that it knows why they end what they do.
fn pass_on(word: Operator, mission: &mpsc::Sender<Operator>, alarm: &watch::Sender<Alarm>) {
    let stops = word == Operator::Stop;
    match mission.try_send(word) {
        // A mission that stands still takes no second go; a stop waits for it.
        Err(TrySendError::Full(word @ (Operator::Stop | Operator::Leave))) => {
            let mission = mission.clone();
            tokio::spawn(async move {
                let _ended = mission.send(word).await;
            });
        }
        Ok(()) | Err(TrySendError::Full(_) | TrySendError::Closed(_)) => {}
    }
    if stops {
        alarm.send_replace(Alarm::Ringing);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_second_ctrl_c_leaves() {
        assert_eq!(word_of(Asked::Interrupt, None), Operator::Stop);
        assert_eq!(word_of(Asked::Interrupt, Some(Asked::Interrupt)), Operator::Leave);
        assert_eq!(word_of(Asked::HangUp, Some(Asked::HangUp)), Operator::Stop);
        assert_eq!(word_of(Asked::Terminate, Some(Asked::Interrupt)), Operator::Stop);
    }

    #[test]
    fn a_mission_that_takes_no_words_hears_of_the_stop_as_soon_as_it_does_and_the_alarm_rings_at_once() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let (mission, mut words) = mpsc::channel(1);
            let (alarm, ringing) = watch::channel(Alarm::Quiet);
            pass_on(Operator::Go, &mission, &alarm);
            pass_on(Operator::Go, &mission, &alarm);
            assert_eq!(*ringing.borrow(), Alarm::Quiet);
            pass_on(Operator::Stop, &mission, &alarm);
            assert_eq!(*ringing.borrow(), Alarm::Ringing);
            assert_eq!(words.recv().await, Some(Operator::Go));
            assert_eq!(words.recv().await, Some(Operator::Stop));
        });
    }
}
