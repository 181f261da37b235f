//! The operator of a dry run: says go when an act waits for it, and stops what waits forever.

use std::collections::HashMap;

use downbeat_scripts::{Choreography, Wait};
use urrcp::{Server, Span, Timestamp};

use super::Cut;
use crate::mission::{Event, Progress, Rest};

/// So long after an act has begun to wait, with nothing else playing, the operator says go; and again, as long as it waits.
const THINKS: Span = Span::from_millis(1_000);
/// An act that waits for longer than its own timeout and this waits for what does not come: readings do not change.
const WAITS_MAX: Span = Span::from_millis(60_000);

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
    /// Why it has said stop.
    pub(super) cut: Option<Cut>,
}

impl VirtualOperator {
    pub(super) fn new(choreography: &Choreography) -> Self {
        let name = |act: &downbeat_scripts::Act| match act.name.is_empty() {
            true => act.plan.scenario.clone(),
            false => act.name.clone(),
        };
        let attended = choreography.acts.iter().filter(|act| match act.wait {
            Wait::Operator | Wait::Sensor { .. } => true,
            Wait::Done | Wait::TimeOfDay(_) | Wait::Instant(_) => false,
        });
        Self {
            attended: attended.map(|act| (name(act), act.timeout.unwrap_or_default())).collect(),
            waiting: None,
            under_way: 0,
            alone_since: super::BEGIN,
            speaks: None,
            cut: None,
        }
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
            self.speaks = Some(now + THINKS);
        }
    }

    /// What it says now, if anything.
    pub(super) fn word(&mut self, now: Timestamp<Server>) -> Option<Event> {
        self.speaks.take_if(|at| now >= *at)?;
        let (act, awaits) = self.waiting.as_ref()?;
        let timeout = self.attended.get(act).copied().unwrap_or_default();
        if now >= self.alone_since + timeout + WAITS_MAX {
            self.cut = Some(Cut { act: act.clone(), awaits: awaits.clone() });
            return Some(Event::StopRequested { rest: Rest::Default });
        }
        self.speaks = Some(now + THINKS);
        Some(Event::Go { act: None })
    }
}
