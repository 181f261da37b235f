//! The operator of a dry run: gives the go when an act waits for it, and stops a mission that would wait forever.

use std::collections::HashMap;

use downbeat_scripts::{Choreography, OperatorWorld, Wait};
use fastrand::Rng;
use urrcp::{Server, Span, Timestamp};

use super::Cut;
use crate::world::between;
use downbeat_mission::{Event, Progress, Rest};

/// Delay of the operator's go after an act starts to wait alone; also the interval of repetition while it waits.
const THINKS: Span = Span::from_millis(1_000);
/// An act that waits longer than its own timeout plus this is given up: readings do not change.
const WAITS_MAX: Span = Span::from_millis(60_000);

/// Thinking time of an operator that does not answer: the act's own timeout comes first, and without one the mission is cut off.
const NEVER: Span = Span::from_millis(24 * 3_600_000);

#[derive(Debug)]
pub(super) struct VirtualOperator {
    /// The acts that wait for the operator or a sensor, by name, with their timeouts. Times need no operator.
    attended: HashMap<String, Span>,
    /// The waiting act and the awaited event.
    waiting: Option<(String, String)>,
    /// Number of acts that have been sent and have not ended.
    under_way: u32,
    /// Since when the waiting act is alone.
    alone_since: Timestamp<Server>,
    /// When the operator acts next.
    speaks: Option<Timestamp<Server>>,
    /// The operator's behaviour, if the world specifies it.
    manner: Option<(OperatorWorld, Rng)>,
    /// The thinking time before the first go.
    thought: Span,
    /// When the last reading changes.
    readings_change_until: Timestamp<Server>,
    /// The reason for its stop.
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

    /// Sets the behaviour that a world specifies; sensor readings do not change after `still`.
    pub(super) fn behaves(&mut self, manner: Option<(OperatorWorld, Rng)>, still: Timestamp<Server>) {
        (self.manner, self.readings_change_until) = (manner, still);
    }

    pub(super) const fn speaks(&self) -> Option<Timestamp<Server>> {
        self.speaks
    }

    /// Processes a message of the mission.
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

    /// If an act waits alone, schedules the go.
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

    /// The operator's current input, if any.
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
