//! The virtual operator of a dry run. It gives the go when an act waits for one, and stops a mission that would wait forever.

use std::collections::HashMap;

use downbeat_scripts::{Choreography, OperatorWorld, Wait};
use fastrand::Rng;
use urrcp::{Server, Span, Timestamp};

use super::Cut;
use crate::world::between;
use downbeat_mission::{Event, Progress, Rest};

/// Time from when a waiting act is the only active one until the operator gives the go. The operator repeats the go at the same interval
/// while the act waits.
const THINKS: Span = Span::from_millis(1_000);
/// Time beyond the timeout of a waiting act after which the operator stops the mission, because readings no longer change.
const WAITS_MAX: Span = Span::from_millis(60_000);

/// Thinking time of an operator that does not react. The timeout of the waiting act expires first; without a timeout, the mission is
/// stopped.
const NEVER: Span = Span::from_millis(24 * 3_600_000);

#[derive(Debug)]
pub(super) struct VirtualOperator {
    /// Timeouts of the acts that wait for the operator or a sensor, by act name. Acts that wait for a time need no operator.
    attended: HashMap<String, Span>,
    /// The name of the act that waits, and the event that it waits for.
    waiting: Option<(String, String)>,
    /// Number of acts that have been sent and have not ended.
    under_way: u32,
    /// Time since which no other act has been active besides the waiting act.
    alone_since: Timestamp<Server>,
    /// Time of the operator's next action; `None` if none is scheduled.
    speaks: Option<Timestamp<Server>>,
    /// The operator's behaviour and random stream, if the world specifies them.
    manner: Option<(OperatorWorld, Rng)>,
    /// The operator's thinking time before the first go for the waiting act.
    thought: Span,
    /// The time of the last change of a sensor reading.
    readings_change_until: Timestamp<Server>,
    /// Why the operator stopped the mission; `None` if it did not.
    pub(super) cut: Option<Cut>,
}

impl VirtualOperator {
    pub(super) fn new(choreography: &Choreography) -> Self {
        let attended = choreography.acts.iter().filter(|act| match act.wait {
            Wait::Operator | Wait::Sensor { .. } => true,
            Wait::Done | Wait::TimeOfDay(_) | Wait::Instant(_) => false,
        });
        Self {
            attended: attended
                .map(|act| (act.called().to_owned(), act.timeout.unwrap_or_default()))
                .collect(),
            waiting: None,
            under_way: 0,
            alone_since: super::BEGIN,
            speaks: None,
            manner: None,
            thought: Span::ZERO,
            readings_change_until: super::BEGIN,
            cut: None,
        }
    }

    /// Sets the operator's behaviour as the world specifies it. Sensor readings do not change after `still`.
    pub(super) fn behaves(&mut self, manner: Option<(OperatorWorld, Rng)>, still: Timestamp<Server>) {
        (self.manner, self.readings_change_until) = (manner, still);
    }

    pub(super) const fn speaks(&self) -> Option<Timestamp<Server>> {
        self.speaks
    }

    /// Processes a progress message from the mission.
    pub(super) fn see(&mut self, now: Timestamp<Server>, progress: &Progress) {
        if self.cut.is_some() {
            return;
        }
        match progress {
            Progress::Waiting { act, awaits, .. } => {
                self.waiting = self.attended.contains_key(act).then(|| (act.clone(), awaits.clone()));
                self.attend(now);
            }
            Progress::Preparing { .. } => {
                self.under_way += 1;
                self.waiting = None;
                self.speaks = None;
            }
            Progress::ActEnded { .. } => {
                self.under_way = self.under_way.saturating_sub(1);
                self.attend(now);
            }
            _ => {}
        }
    }

    /// Schedules the go if an act waits and no other act is active.
    fn attend(&mut self, now: Timestamp<Server>) {
        if self.waiting.is_some() && self.under_way == 0 {
            self.alone_since = now;
            self.thought = self.thinks();
            self.speaks = Some(now + self.thought);
        }
    }

    fn thinks(&mut self) -> Span {
        let Some((says, rng)) = &mut self.manner else { return THINKS };
        let (never, after) = (rng.f64() < says.never, between(rng, says.go_after));
        if never { NEVER } else { after }
    }

    /// Returns the operator's input at `now`, if any.
    pub(super) fn word(&mut self, now: Timestamp<Server>) -> Option<Event> {
        self.speaks.take_if(|at| now >= *at)?;
        let (act, awaits) = self.waiting.as_ref()?;
        let timeout = self.attended.get(act).copied().unwrap_or_default();
        let thought = if self.manner.is_some() && self.thought < NEVER { self.thought } else { Span::ZERO };
        let still = (self.readings_change_until - self.alone_since).max(Span::ZERO);
        if self.thought == NEVER || now >= self.alone_since + timeout.max(thought).max(still) + WAITS_MAX {
            self.cut = Some(Cut { act: act.clone(), awaits: awaits.clone() });
            return Some(Event::StopRequested { rest: Rest::InPlace, by: None });
        }
        self.speaks = Some(now + THINKS);
        Some(Event::Go { act: None, by: None })
    }
}
