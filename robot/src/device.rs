//! One device as a machine: its queue of commands, its steps on absolute deadlines, its default state.
//!
//! Order of events at one instant: leases that run out, then steps in the order of the queue, then (in `robot`) the
//! message that arrives. So a lease that ends at the very instant of a start wins, and nothing starts.

use std::collections::{BTreeMap, VecDeque};

use urrcp::{
    Command, ControlError, ControlType, Device, ErrorCode, Interpolation, RequestId, Robot, Script, Setpoint,
    Span, StopCondition, Timestamp,
};

use crate::lease::{self, LastHeard, Lease};
use crate::robot::LinkId;

/// What a driver does with a device.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// Set this now.
    Set(Setpoint),
    /// Move linearly so as to arrive at `until`; a `Set` of the same value follows then.
    Ramp {
        /// position, speed or acceleration.
        control_type: ControlType,
        /// Where it begins.
        from: f64,
        /// Where it ends.
        to: f64,
        /// When.
        until: Timestamp<Robot>,
    },
    /// Go to this value: part of the default state.
    Default {
        /// Which signal.
        control_type: ControlType,
        /// Its value.
        value: f64,
    },
}

/// What a device machine wants done or told.
#[derive(Clone, Debug)]
pub(crate) enum Effect {
    Move { motion: Motion, due: Timestamp<Robot>, request_id: Option<RequestId>, step: Option<u32> },
    Started { link: LinkId, request_id: Option<RequestId>, value: f64 },
    Ended { link: LinkId, request_id: Option<RequestId>, value: f64, steps_done: u32 },
    Failed { link: LinkId, request_id: Option<RequestId>, error: ControlError, steps_done: u32 },
}

/// A command that has been accepted and has not ended.
#[derive(Clone, Debug)]
struct Held {
    link: LinkId,
    request_id: Option<RequestId>,
    accepted: Timestamp<Robot>,
    start: Timestamp<Robot>,
    end: Timestamp<Robot>,
    steps: Steps,
    stop_condition: Option<StopCondition>,
    next_step: usize,
    began: bool,
}

#[derive(Clone, Debug)]
enum Steps {
    One(Setpoint),
    Script(Script),
}

impl Held {
    fn setpoint(&self, index: usize) -> Option<&Setpoint> {
        match &self.steps {
            Steps::One(setpoint) => (index == 0).then_some(setpoint),
            Steps::Script(script) => script.steps().get(index).map(|step| &step.setpoint),
        }
    }

    fn time_of(&self, index: usize) -> Option<Timestamp<Robot>> {
        match &self.steps {
            Steps::One(_) => (index == 0).then_some(self.start),
            Steps::Script(script) => script.steps().get(index).map(|step| self.start + step.offset.span()),
        }
    }

    fn step_condition(&self, index: usize) -> Option<StopCondition> {
        match &self.steps {
            Steps::One(_) => None,
            Steps::Script(script) => script.steps().get(index)?.stop_condition,
        }
    }

    fn lease(&self) -> Lease {
        let silence = match self.began {
            false => lease::pending(self.stop_condition),
            true => {
                let current = self.next_step.checked_sub(1).and_then(|step| self.step_condition(step));
                lease::running(self.stop_condition, current)
            }
        };
        Lease { link: self.link, granted: self.accepted, silence }
    }

    /// Its start, then each of its steps.
    fn next_event(&self) -> Option<Timestamp<Robot>> {
        match self.began {
            false => Some(self.start),
            true => self.time_of(self.next_step),
        }
    }

    fn steps_done(&self) -> u32 {
        u32::try_from(self.next_step).unwrap_or(u32::MAX)
    }
}

/// A rate that goes on after its command has ended, still under that command's lease.
#[derive(Clone, Debug)]
struct Guard {
    lease: Lease,
    request_id: Option<RequestId>,
    steps_done: u32,
}

/// A signal under way or at rest.
#[derive(Clone, Copy, Debug)]
struct Signal {
    from: f64,
    since: Timestamp<Robot>,
    to: f64,
    until: Timestamp<Robot>,
}

impl Signal {
    fn resting(value: f64, at: Timestamp<Robot>) -> Self {
        Self { from: value, since: at, to: value, until: at }
    }

    fn value(&self, now: Timestamp<Robot>) -> f64 {
        if now >= self.until {
            return self.to;
        }
        let part = (now - self.since).as_millis_f64() / (self.until - self.since).as_millis_f64();
        self.from + (self.to - self.from) * part.clamp(0.0, 1.0)
    }
}

/// The machine of one device.
#[derive(Clone, Debug)]
pub(crate) struct DeviceMachine {
    pub(crate) spec: Device,
    signals: BTreeMap<ControlType, Signal>,
    queue: VecDeque<Held>,
    guard: Option<Guard>,
}

impl DeviceMachine {
    pub(crate) fn new(spec: Device) -> Self {
        let begin = Timestamp::from_nanos(0);
        let signals = spec
            .available_control_types
            .iter()
            .filter(|(control_type, _)| !matches!(control_type, ControlType::Script | ControlType::Sensor))
            .map(|(control_type, _)| {
                (control_type, Signal::resting(resting_value(&spec, control_type), begin))
            })
            .collect();
        Self { spec, signals, queue: VecDeque::new(), guard: None }
    }

    pub(crate) fn value(&self, control_type: ControlType, now: Timestamp<Robot>) -> Option<f64> {
        self.signals.get(&control_type).map(|signal| signal.value(now))
    }

    pub(crate) fn is_idle(&self) -> bool {
        self.queue.is_empty() && self.guard.is_none()
    }

    pub(crate) fn held(&self) -> usize {
        self.queue.len()
    }

    /// When something is next due: a lease's end or a step.
    pub(crate) fn next_wakeup(&self, heard: &LastHeard) -> Option<Timestamp<Robot>> {
        let event = self.queue.front().and_then(Held::next_event);
        event.into_iter().chain(self.lease_end(heard)).min()
    }

    fn lease_end(&self, heard: &LastHeard) -> Option<Timestamp<Robot>> {
        let guard = self.guard.as_ref().map(|guard| guard.lease);
        self.queue.iter().map(Held::lease).chain(guard).filter_map(|lease| heard.ends(&lease)).min()
    }

    /// Does everything due at or before `now`, in the order of its time.
    pub(crate) fn advance(&mut self, now: Timestamp<Robot>, heard: &LastHeard, effects: &mut Vec<Effect>) {
        loop {
            let lease_end = self.lease_end(heard).filter(|end| *end <= now);
            let event = self.queue.front().and_then(Held::next_event).filter(|at| *at <= now);
            match (lease_end, event) {
                (Some(end), event) if event.is_none_or(|event| end <= event) => self.link_lost(end, effects),
                (_, Some(at)) => self.step(at, effects),
                (_, None) => return,
            }
        }
    }

    /// Begins the front command or does its next step.
    fn step(&mut self, at: Timestamp<Robot>, effects: &mut Vec<Effect>) {
        let Some(mut held) = self.queue.pop_front() else { return };
        if !held.began {
            held.began = true;
            self.guard = None;
            let value = held.setpoint(0).map_or(0.0, |setpoint| setpoint.value);
            if held.time_of(0) > Some(at) {
                self.ramp_to(&held, 0, at, effects);
                effects.push(Effect::Started { link: held.link, request_id: held.request_id.clone(), value });
                self.queue.push_front(held);
                return;
            }
            self.set_step(&mut held, at, effects);
            effects.push(Effect::Started { link: held.link, request_id: held.request_id.clone(), value });
        } else {
            self.set_step(&mut held, at, effects);
        }
        match held.time_of(held.next_step) {
            Some(_) => self.queue.push_front(held),
            None => self.finish(&held, effects),
        }
    }

    fn set_step(&mut self, held: &mut Held, at: Timestamp<Robot>, effects: &mut Vec<Effect>) {
        let index = held.next_step;
        let Some(setpoint) = held.setpoint(index).cloned() else { return };
        held.next_step += 1;
        self.signals.insert(setpoint.control_type, Signal::resting(setpoint.value, at));
        effects.push(Effect::Move {
            motion: Motion::Set(setpoint),
            due: at,
            request_id: held.request_id.clone(),
            step: u32::try_from(index).ok(),
        });
        self.ramp_to(held, index + 1, at, effects);
    }

    /// Begins the linear way to a step, where the device moves linearly and the control type stays the same.
    fn ramp_to(&mut self, held: &Held, index: usize, now: Timestamp<Robot>, effects: &mut Vec<Effect>) {
        let (Some(next), Some(until)) = (held.setpoint(index), held.time_of(index)) else { return };
        let before = index.checked_sub(1).and_then(|previous| held.setpoint(previous));
        let same_type = before.is_none_or(|before| before.control_type == next.control_type);
        if self.spec.interpolation != Interpolation::Linear || !same_type || until <= now {
            return;
        }
        let Some(from) = self.value(next.control_type, now) else { return };
        let signal = Signal { from, since: now, to: next.value, until };
        self.signals.insert(next.control_type, signal);
        effects.push(Effect::Move {
            motion: Motion::Ramp { control_type: next.control_type, from, to: next.value, until },
            due: now,
            request_id: held.request_id.clone(),
            step: u32::try_from(index).ok(),
        });
    }

    fn finish(&mut self, held: &Held, effects: &mut Vec<Effect>) {
        let last = held.next_step.saturating_sub(1);
        let value = held.setpoint(last).map_or(0.0, |setpoint| setpoint.value);
        let (link, request_id) = (held.link, held.request_id.clone());
        effects.push(Effect::Ended { link, request_id, value, steps_done: held.steps_done() });
        let moving = self.signals.iter().any(|(control_type, signal)| {
            is_rate(*control_type) && signal.to != resting_value(&self.spec, *control_type)
        });
        self.guard = (moving && held.lease().silence.is_some()).then(|| Guard {
            lease: held.lease(),
            request_id: held.request_id.clone(),
            steps_done: held.steps_done(),
        });
    }

    fn link_lost(&mut self, at: Timestamp<Robot>, effects: &mut Vec<Effect>) {
        let error =
            ControlError::new(ErrorCode::LinkLost, "the server was silent for longer than stop_condition");
        if let Some(guard) = self.guard.take() {
            let (link, request_id) = (guard.lease.link, guard.request_id);
            effects.push(Effect::Failed {
                link,
                request_id,
                error: error.clone(),
                steps_done: guard.steps_done,
            });
        }
        self.drop_all(&error, effects);
        self.go_to_default_state(at, effects);
    }

    /// Ends everything that is held or runs, and goes to the default state.
    pub(crate) fn stop(&mut self, now: Timestamp<Robot>, error: &ControlError, effects: &mut Vec<Effect>) {
        self.drop_all(error, effects);
        self.go_to_default_state(now, effects);
    }

    fn drop_all(&mut self, error: &ControlError, effects: &mut Vec<Effect>) {
        for held in self.queue.drain(..) {
            effects.push(failed(held, error));
        }
    }

    /// Drops what is scheduled to start at `from` or later.
    pub(crate) fn cancel_from(
        &mut self,
        from: Timestamp<Robot>,
        error: &ControlError,
        effects: &mut Vec<Effect>,
    ) {
        let (dropped, kept) = self.queue.drain(..).partition(|held| !held.began && held.start >= from);
        self.queue = kept;
        let dropped: VecDeque<Held> = dropped;
        effects.extend(dropped.into_iter().map(|held| failed(held, error)));
    }

    /// default_value, or hold the last position; every other rate to zero.
    fn go_to_default_state(&mut self, now: Timestamp<Robot>, effects: &mut Vec<Effect>) {
        self.guard = None;
        let primary = self.spec.primary_control_type();
        let default = self.spec.default_value;
        for (control_type, signal) in &mut self.signals {
            let value = match control_type {
                _ if Some(*control_type) == primary && default.is_some() => default.unwrap_or_default(),
                ControlType::Position => signal.value(now),
                _ => 0.0,
            };
            *signal = Signal::resting(value, now);
            effects.push(Effect::Move {
                motion: Motion::Default { control_type: *control_type, value },
                due: now,
                request_id: None,
                step: None,
            });
        }
    }

    /// Takes a command that starts at `start`, after every check.
    pub(crate) fn accept(
        &mut self,
        now: Timestamp<Robot>,
        start: Timestamp<Robot>,
        link: LinkId,
        request: &urrcp::ControlRequest,
    ) -> Result<(), ControlError> {
        let (steps, duration) = self.checked_steps(&request.command)?;
        if start < now {
            let message = format!("the start passed {} ago; a late command is never started", now - start);
            return Err(ControlError::new(ErrorCode::Late, message));
        }
        let end = start + duration;
        let overlaps = |held: &&Held| start < held.end && held.start < end;
        if let Some(held) = self.queue.iter().find(overlaps) {
            let message = format!("`{}` is taken from {} to {}", self.spec.id, held.start, held.end);
            return Err(ControlError::new(ErrorCode::Overlap, message));
        }
        if self.queue.len() >= self.spec.script_queue as usize {
            let message = format!(
                "`{}` already holds {} of {} commands",
                self.spec.id,
                self.queue.len(),
                self.spec.script_queue
            );
            return Err(ControlError::new(ErrorCode::Busy, message));
        }
        let place = self.queue.partition_point(|held| held.start <= start);
        let held = Held {
            link,
            request_id: request.request_id.clone(),
            accepted: now,
            start,
            end,
            steps,
            stop_condition: request.stop_condition,
            next_step: 0,
            began: false,
        };
        self.queue.insert(place, held);
        Ok(())
    }

    fn checked_steps(&self, command: &Command) -> Result<(Steps, Span), ControlError> {
        match command {
            Command::Set(setpoint) => {
                self.spec.check(setpoint)?;
                Ok((Steps::One(setpoint.clone()), Span::ZERO))
            }
            Command::Script(script) => {
                self.check_script(script)?;
                Ok((Steps::Script(script.clone()), script.duration()))
            }
            Command::ReadSensor => Err(ControlError::new(ErrorCode::Internal, "a reading is not held")),
        }
    }

    fn check_script(&self, script: &Script) -> Result<(), ControlError> {
        let Some(parameters) = self.spec.available_control_types.script() else {
            let message = format!("`{}` takes no scripts", self.spec.id);
            return Err(ControlError::new(ErrorCode::UnsupportedControlType, message));
        };
        let steps = script.steps();
        if steps.len() > parameters.max_number_of_steps as usize {
            let message =
                format!("{} steps, `{}` takes {}", steps.len(), self.spec.id, parameters.max_number_of_steps);
            return Err(ControlError::new(ErrorCode::TooManySteps, message));
        }
        for (index, step) in steps.iter().enumerate() {
            self.spec
                .check_in_script(&step.setpoint)
                .map_err(|e| ControlError::new(e.code, format!("step {index}: {}", e.message)))?;
        }
        Ok(())
    }
}

fn failed(held: Held, error: &ControlError) -> Effect {
    let steps_done = held.steps_done();
    Effect::Failed { link: held.link, request_id: held.request_id, error: error.clone(), steps_done }
}

const fn is_rate(control_type: ControlType) -> bool {
    !matches!(control_type, ControlType::Position)
}

/// The value of a signal in the default state, as far as it does not depend on the past.
fn resting_value(spec: &Device, control_type: ControlType) -> f64 {
    match spec.primary_control_type() == Some(control_type) {
        true => spec.default_value.unwrap_or(0.0),
        false => 0.0,
    }
}
