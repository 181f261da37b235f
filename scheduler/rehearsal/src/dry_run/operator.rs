//! The virtual operator of a dry run. It gives the go (the signal to start) when an act waits for it, and stops a mission that would wait
//! forever.

use std::collections::HashMap;

use downbeat_scripts::{Choreography, OperatorWorld, Wait};
use fastrand::Rng;
use urrcp::{Server, Span, Timestamp};

use super::Cut;
use crate::world::between;
use downbeat_mission::{Event, Progress, Rest};

/// Time that the operator takes to give the go (the signal to start) when an act waits and no other act is active. While the act waits,
/// the operator repeats the go at this interval.
const THINKS: Span = Span::from_millis(1_000);
/// Time for which the operator continues to wait after an act's timeout, once sensor readings no longer change. Then the operator stops
/// the mission.
const WAITS_MAX: Span = Span::from_millis(60_000);

/// Thinking time of an operator that never gives the go (the signal to start). The timeout of the waiting act expires first; without a
/// timeout, the mission is stopped.
const NEVER: Span = Span::from_millis(24 * 3_600_000);

#[derive(Debug)]
pub(super) struct VirtualOperator {
    /// Timeouts of the acts that wait for the operator or a sensor, by act name. Acts that wait for a time need no operator.
    attended: HashMap<String, Span>,
    /// The name of the act that waits, and the event that it waits for.
    waiting: Option<(String, String)>,
    /// Number of acts that have been sent but have not ended.
    under_way: u32,
    /// Time at which the waiting act became the only active act.
    alone_since: Timestamp<Server>,
    /// Time of the operator's next action; `None` if none is scheduled.
    speaks: Option<Timestamp<Server>>,
    /// The operator's thinking time before the first go (signal to start) for the waiting act.
    manner: Option<(OperatorWorld, Rng)>,
    /// The operator's thinking time before the first go for the waiting act.
    thought: Span,
    /// The time after which sensor readings no longer change.
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

    /// Sets the operator's behaviour as the world file specifies it. Sensor readings do not change after the time `still`.
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

    /// Schedules the go (the signal to start) if an act waits and no other act is active.
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

    /// Returns the operator's input at `now`: the go (the signal to start), or a request to stop. `None` without input.
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
