//! The operator of a dry run: says go when an act waits for it, and stops what waits forever.

use std::collections::HashMap;

use downbeat_scripts::{Choreography, OperatorWorld, Wait};
use fastrand::Rng;
use urrcp::{Server, Span, Timestamp};

use super::Cut;
use crate::world::between;
use downbeat_mission::{Event, Progress, Rest};

/// So long after an act has begun to wait, with nothing else playing, the operator says go; and again, as long as it waits.
const THINKS: Span = Span::from_millis(1_000);
/// An act that waits for longer than its own timeout and this waits for what does not come: readings do not change.
const WAITS_MAX: Span = Span::from_millis(60_000);

/// An operator who thinks for so long says nothing: the act's own timeout comes first, and without one the mission is cut off.
const NEVER: Span = Span::from_millis(24 * 3_600_000);

#[derive(Debug)]
pub(super) struct VirtualOperator {
    /// The acts that wait for the operator or a sensor, by name, with their timeouts. A time comes by itself.
    attended: HashMap<String, Span>,
    /// The act that waits, and for what.
    waiting: Option<(String, String)>,
    /// Acts that have been sent and have not ended.
    under_way: u32,
    /// When the act that waits began to be alone.
    alone_since: Timestamp<Server>,
    /// When it speaks next.
    speaks: Option<Timestamp<Server>>,
    /// How it behaves where that is said.
    manner: Option<(OperatorWorld, Rng)>,
    /// How long it thought before it spoke first.
    thought: Span,
    /// Sensors read the same from then on.
    readings_change_until: Timestamp<Server>,
    /// Why it has said stop.
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

    /// Behaves as a world says, in which sensors read the same from `still` on.
    pub(super) fn behaves(&mut self, manner: Option<(OperatorWorld, Rng)>, still: Timestamp<Server>) {
        (self.manner, self.readings_change_until) = (manner, still);
    }

    pub(super) const fn speaks(&self) -> Option<Timestamp<Server>> {
        self.speaks
    }

    /// Sees what the mission tells.
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

    /// An act that waits alone is let go after a moment.
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

    /// What it says now, if anything.
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
