//! An accepted command that has not ended: its steps, their absolute times, and its lease.

use urrcp::{
    ControlType, Interpolation, Millis, RequestId, Robot, Script, Server, Setpoint, StopCondition, Timestamp,
};

use crate::ids::{CommandId, LinkId};
use crate::late_steps::LateSteps;
use crate::lease::{self, LastMessages, Lease};

/// A command that has been accepted and has not ended.
#[derive(Clone, Debug)]
pub(crate) struct Held {
    pub(crate) command: CommandId,
    pub(crate) link: LinkId,
    pub(crate) request_id: Option<RequestId>,
    pub(crate) accepted: Timestamp<Robot>,
    pub(crate) start: Timestamp<Robot>,
    pub(crate) end: Timestamp<Robot>,
    pub(crate) steps: Steps,
    pub(crate) stop_condition: Option<StopCondition>,
    pub(crate) next_step: usize,
    pub(crate) late: LateSteps,
    pub(crate) began: bool,
    /// Time at which the pending lease (the lease before the start) ends at the latest, whatever messages arrive. `None`: no such limit.
    pub(crate) pending_until: Option<Timestamp<Robot>>,
    /// Link and sending time of the inquiry that last limited the pending lease (the lease before the start).
    pub(crate) limited_by: Option<(LinkId, Timestamp<Server>)>,
}

/// Limit that an inquiry sets for the pending leases (the leases before the start) of the commands that it names.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limit {
    pub(crate) pending: Option<Millis>,
    pub(crate) until: Option<Timestamp<Robot>>,
    /// Link on which the inquiry arrived, and its sending time.
    pub(crate) asked: Option<(LinkId, Timestamp<Server>)>,
}

/// The steps of a command: a single value, or a script.
#[derive(Clone, Debug)]
pub(crate) enum Steps {
    One(Setpoint),
    Script(Script),
}

impl Held {
    pub(crate) fn setpoint(&self, index: usize) -> Option<&Setpoint> {
        match &self.steps {
            Steps::One(setpoint) => (index == 0).then_some(setpoint),
            Steps::Script(script) => script.steps().get(index).map(|step| &step.setpoint),
        }
    }

    pub(crate) fn time_of(&self, index: usize) -> Option<Timestamp<Robot>> {
        match &self.steps {
            Steps::One(_) => (index == 0).then_some(self.start),
            Steps::Script(script) => script.steps().get(index).map(|step| self.start + step.offset.span()),
        }
    }

    /// Returns the instant at which the command is reported as started. For a device that holds its value between steps, this is the time
    /// of the first value.
    pub(crate) fn starts(&self, interpolation: Interpolation) -> Timestamp<Robot> {
        match &self.steps {
            Steps::One(_) => self.start,
            Steps::Script(script) => self.start + script.until_started(interpolation),
        }
    }

    /// Returns the time of the command's start or, if it has started, of its next step.
    pub(crate) fn next_event(&self) -> Option<Timestamp<Robot>> {
        if !self.began { Some(self.start) } else { self.time_of(self.next_step) }
    }

    pub(crate) fn steps_done(&self) -> u32 {
        u32::try_from(self.next_step).unwrap_or(u32::MAX)
    }

    /// Whether one of the command's steps sets a value of this control type.
    pub(crate) fn drives(&self, control_type: ControlType) -> bool {
        match &self.steps {
            Steps::One(setpoint) => setpoint.control_type == control_type,
            Steps::Script(script) => {
                script.steps().iter().any(|step| step.setpoint.control_type == control_type)
            }
        }
    }

    /// Returns the lease that currently applies to the command: the pending one before the start, then a running one.
    pub(crate) fn lease(&self) -> Lease {
        if !self.began {
            self.lease_of(lease::pending(self.stop_condition))
        } else {
            self.running_lease(self.next_step)
        }
    }

    /// Returns when the command's lease ends. If the lease that would apply after the next event has ended by then, the event does not
    /// take place. The command's lease then ends at that instant.
    pub(crate) fn lease_end(&self, heard: &LastMessages) -> Option<Timestamp<Robot>> {
        let over_by_then = self.next_event().filter(|at| {
            let first_step_is_later = !self.began && self.time_of(0) > Some(*at);
            let steps_done = if first_step_is_later { 0 } else { self.next_step + 1 };
            heard.ends(&self.running_lease(steps_done)).is_some_and(|end| end <= *at)
        });
        let until = self.pending_until.filter(|_| !self.began);
        heard.ends(&self.lease()).into_iter().chain(over_by_then).chain(until).min()
    }

    /// Limits the command's pending lease. Ignores an inquiry that arrives after one that was sent later on the same link.
    pub(crate) fn limit(&mut self, limit: Limit) {
        if let (Some((link, asked)), Some((before_on, before))) = (limit.asked, self.limited_by)
            && link == before_on
            && asked < before
        {
            return;
        }
        limit.pending.into_iter().for_each(|pending| self.shorten_pending(pending));
        self.pending_until = limit.until.or(self.pending_until);
        self.limited_by = limit.asked.or(self.limited_by);
    }

    /// Shortens the silence after which the command's pending lease ends, if `silence` is shorter.
    fn shorten_pending(&mut self, silence: Millis) {
        let condition = self.stop_condition.get_or_insert_default();
        let shorter = condition.pending.is_none_or(|own| silence.get() < own.get());
        condition.pending = if shorter { Some(silence) } else { condition.pending };
    }

    fn running_lease(&self, steps_done: usize) -> Lease {
        let current = steps_done.checked_sub(1).and_then(|step| self.step_condition(step));
        self.lease_of(lease::running(self.stop_condition, current))
    }

    const fn lease_of(&self, silence: Option<Millis>) -> Lease {
        Lease { link: self.link, granted: self.accepted, silence }
    }

    fn step_condition(&self, index: usize) -> Option<StopCondition> {
        match &self.steps {
            Steps::One(_) => None,
            Steps::Script(script) => script.steps().get(index)?.stop_condition,
        }
    }
}
