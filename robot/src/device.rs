//! State machine of one device: its queue of commands, its steps at absolute times, and how it comes to rest.
//!
//! Order of events at one instant:
//! 1. Leases end: those of running commands before those of pending ones. For a start or step that is due at that instant, the lease that
//!    would apply afterwards counts. If a lease ends exactly at a start, nothing starts.
//! 2. Starts and steps in the order of the queue: first a command that ends at that instant, then commands of zero length, then a script
//!    that starts at that instant.
//! 3. (In `robot`) the arrival of a message.

use std::collections::{BTreeMap, VecDeque};

use urrcp::{
    Command, ControlError, ControlType, Device, ErrorCode, Interpolation, RequestId, Robot, Script, Server,
    Setpoint, Span, Timestamp,
};

use crate::held::{Held, Limit, Steps};
use crate::ids::{CommandId, LinkId};
use crate::late_steps::LateSteps;
use crate::lease::{LastMessages, Lease};
use crate::plans::Lookahead;
use crate::reach::Reach;
use crate::signal::{Rates, Signal, default_of, first_value, rest_of, with_values};
use crate::tolerance::START_LATE_MAX;

/// Instruction to a driver to move or stop a device.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// Set this value now.
    Set(Setpoint),
    /// Move linearly so as to arrive at `until`. A [`Motion::Set`] with the value `to` follows.
    Ramp {
        /// Position, speed or acceleration.
        control_type: ControlType,
        /// Value at the start of the movement.
        from: f64,
        /// Value at the end of the movement.
        to: f64,
        /// Instant at which the device must arrive at `to`.
        until: Timestamp<Robot>,
    },
    /// Come to rest, or move to the default state, within the limits that the device declares.
    Slow {
        /// Control type that slows down: position or speed.
        control_type: ControlType,
        /// Value at the start of the movement.
        from: f64,
        /// Value at rest.
        to: f64,
        /// Instant at which the device must be at rest.
        until: Timestamp<Robot>,
    },
    /// Stay at this value, as part of a stop. For a position, the value is the device's position at that instant.
    Rest(Setpoint),
    /// Set this value now, to reach the default state.
    Default(Setpoint),
}

/// An operator's limits for movements to rest and to the default state, if they are lower than the limits that the device declares.
/// `None`: the device's declared limit applies.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionLimits {
    /// Maximum speed of a position, in the position's unit per second.
    pub speed: Option<f64>,
    /// Maximum acceleration: for a position, in its unit per second squared; for a speed, in the speed's unit per second.
    pub acceleration: Option<f64>,
}

/// Where a device goes after its command ends early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rest {
    /// The device slows down and stays where it is.
    InPlace,
    /// The device moves to its default state.
    Home,
}

/// An action or a report that a device's state machine requests.
#[derive(Clone, Debug)]
pub(crate) enum Effect {
    Move {
        motion: Motion,
        due: Timestamp<Robot>,
        request_id: Option<RequestId>,
        step: Option<u32>,
    },
    /// The device comes to rest, and none of its commands continues.
    Stopped,
    Started {
        command: CommandId,
        link: LinkId,
        request_id: Option<RequestId>,
        value: f64,
    },
    Ended {
        command: CommandId,
        link: LinkId,
        request_id: Option<RequestId>,
        value: f64,
        steps_done: u32,
        late: LateSteps,
    },
    Failed {
        command: CommandId,
        link: LinkId,
        request_id: Option<RequestId>,
        error: ControlError,
        /// Number of completed steps. `None` if it is unknown; it is then also unknown whether the command has started.
        steps_done: Option<u32>,
    },
}

/// Error message with code `link_lost` for a command whose `pending_until` has passed.
const NOT_CONFIRMED: &str = "`pending_until` passed before the command started";

/// Limit for a stop's timestamp that is ahead of the robot's clock. For commands of the stop's own sender, a timestamp further ahead
/// counts as this far ahead.
const TAKEN_BACK_AHEAD_MAX: Span = Span::from_millis(5_000);
/// Like `TAKEN_BACK_AHEAD_MAX`, for commands of other senders. It is the maximum difference between synchronized clocks. With a larger
/// value, a stop with a future timestamp could close the device to everyone.
const TAKEN_BACK_FROM_OTHERS_MAX: Span = Span::from_millis(250);

/// Rates (such as speeds) that continue after the end of their command, and the command's lease, which still covers them.
#[derive(Clone, Debug)]
struct Guard {
    rates: Vec<ControlType>,
    lease: Lease,
    command: CommandId,
    request_id: Option<RequestId>,
    steps_done: u32,
}

/// State machine of one device.
#[derive(Clone, Debug)]
pub(crate) struct DeviceMachine {
    pub(crate) spec: Device,
    signals: BTreeMap<ControlType, Signal>,
    /// Last target value of each control type that a command has set.
    driven: BTreeMap<ControlType, Setpoint>,
    queue: VecDeque<Held>,
    /// Leases that still cover the rates of ended commands, at most one per control type. A new command that sets the rate replaces its
    /// guard.
    guards: Vec<Guard>,
    /// Sending time of a message: stops have cancelled all messages that were sent up to this time, even those that arrive later.
    taken_back: Option<Timestamp<Server>>,
    /// Sender of the last stop, and the sending time up to which the stop has cancelled this sender's messages. The sender's clock may be
    /// ahead.
    taken_back_by: Option<(LinkId, Timestamp<Server>)>,
    /// Whether the signal of the control type `position` holds the device's actual position.
    ///
    /// The position of hardware is unknown before its first report and after a disconnection. It also becomes unknown when a driver that
    /// times scripts by itself interrupts a script, and when a speed or an acceleration drives the device. A device without hardware
    /// starts in its default state, if it has one.
    is_placed: bool,
    /// How far ahead the driver receives scripts. `None` if the driver does not time scripts by itself. If it does, a delay of this state
    /// machine does not delay the hardware.
    pub(crate) lookahead: Option<Lookahead>,
    /// Maximum delay of a command's start. A command that would start with a longer delay is dropped.
    pub(crate) start_late_max: Span,
    /// An operator's limits for movements to rest and to the default state, in addition to those that the device declares.
    pub(crate) limits: MotionLimits,
    accepted: CommandId,
}

impl DeviceMachine {
    pub(crate) fn new(spec: Device) -> Self {
        let begin = Timestamp::from_nanos(0);
        let signals = spec
            .available_control_types
            .iter()
            .filter(|(control_type, _)| !matches!(control_type, ControlType::Script | ControlType::Sensor))
            .map(|(control_type, _)| (control_type, Signal::resting(first_value(&spec, control_type), begin)))
            .collect();
        let is_placed = default_of(&spec, ControlType::Position).is_some();
        let (driven, queue, guards) = (BTreeMap::new(), VecDeque::new(), Vec::new());
        let (taken_back, taken_back_by, lookahead) = (None, None, None);
        Self {
            spec,
            signals,
            driven,
            queue,
            guards,
            taken_back,
            taken_back_by,
            is_placed,
            lookahead,
            start_late_max: START_LATE_MAX,
            limits: MotionLimits::default(),
            accepted: CommandId::default(),
        }
    }

    pub(crate) fn value(&self, control_type: ControlType, now: Timestamp<Robot>) -> Option<f64> {
        self.signals.get(&control_type).map(|signal| signal.value(now))
    }

    /// Returns the commanded position; `None` if it is unknown.
    pub(crate) fn position(&self, now: Timestamp<Robot>) -> Option<f64> {
        self.value(ControlType::Position, now).filter(|_| self.is_placed)
    }

    /// Marks the device's position as unknown.
    pub(crate) const fn forget_position(&mut self) {
        self.is_placed = false;
    }

    /// Records that the device is at this position, which no command has set.
    pub(crate) fn place(&mut self, position: f64) {
        if let Some(signal) = self.signals.get_mut(&ControlType::Position) {
            *signal = Signal::resting(position, Timestamp::from_nanos(0));
            self.is_placed = true;
        }
    }

    pub(crate) fn is_idle(&self) -> bool {
        self.queue.is_empty() && self.guards.is_empty()
    }

    /// Returns the parties (the senders whose messages renew leases) of the device's commands and continuing rates.
    pub(crate) fn parties(&self) -> impl Iterator<Item = LinkId> + '_ {
        self.queue.iter().map(|held| held.link).chain(self.guards.iter().map(|guard| guard.lease.link))
    }

    /// Returns the number of commands in the queue, whether they wait or run.
    pub(crate) fn held(&self) -> usize {
        self.queue.len()
    }

    /// Returns the time of the next event: the end of a lease, a start or a step.
    pub(crate) fn next_wakeup(&self, heard: &LastMessages) -> Option<Timestamp<Robot>> {
        let event = self.queue.front().and_then(Held::next_event);
        event.into_iter().chain(self.lease_end(heard)).min()
    }

    /// Returns the earliest start of those pending commands that were accepted at least `notice` before their start.
    pub(crate) fn next_start(&self, notice: Span) -> Option<Timestamp<Robot>> {
        let pending = self.queue.iter().filter(|held| !held.began && held.start - held.accepted >= notice);
        pending.map(|held| held.start).min()
    }

    /// Returns the delay of the running command's next step. `None` if it is not late, or if the driver times scripts by itself.
    pub(crate) fn overdue(&self, now: Timestamp<Robot>) -> Option<Span> {
        let at = self.queue.front().filter(|held| held.began && self.lookahead.is_none())?.next_event()?;
        (at < now).then(|| now - at)
    }

    fn lease_end(&self, heard: &LastMessages) -> Option<Timestamp<Robot>> {
        self.pending_lease_end(heard).into_iter().chain(self.running_lease_end(heard)).min()
    }

    /// Returns when the first lease of a pending command ends. `None` if no such lease ends.
    fn pending_lease_end(&self, heard: &LastMessages) -> Option<Timestamp<Robot>> {
        let pending = self.queue.iter().filter(|held| !held.began);
        pending.filter_map(|held| held.lease_end(heard)).min()
    }

    /// Returns when the first lease of a running command or a continuing rate ends. `None` if no such lease ends.
    fn running_lease_end(&self, heard: &LastMessages) -> Option<Timestamp<Robot>> {
        let guards = self.guards.iter().filter_map(|guard| heard.ends(&guard.lease));
        let running = self.queue.iter().filter(|held| held.began);
        running.filter_map(|held| held.lease_end(heard)).chain(guards).min()
    }

    /// Executes everything due at or before `now`, in the order of the due times. The end of a running command's lease comes first.
    /// Otherwise a delayed robot would now execute steps that were due before the lease ended.
    pub(crate) fn advance(&mut self, now: Timestamp<Robot>, heard: &LastMessages, effects: &mut Vec<Effect>) {
        loop {
            if let Some(end) = self.running_lease_end(heard).filter(|end| *end <= now) {
                self.lease_ended(end, now, heard, effects);
                continue;
            }
            let pending_end = self.pending_lease_end(heard).filter(|end| *end <= now);
            let event = self.queue.front().and_then(Held::next_event).filter(|at| *at <= now);
            match (pending_end, event) {
                (Some(end), event) if event.is_none_or(|event| end <= event) => {
                    self.lease_ended(end, now, heard, effects);
                }
                (_, Some(at)) => self.step(at, now, effects),
                (_, None) => return,
            }
        }
    }

    /// Starts the first command of the queue, or executes its next step.
    fn step(&mut self, at: Timestamp<Robot>, now: Timestamp<Robot>, effects: &mut Vec<Effect>) {
        let Some(mut held) = self.queue.pop_front() else { return };
        if !held.began && now - at > self.start_late_max && self.lookahead.is_none() {
            let message =
                format!("the robot woke up {} after the start; a late command is never started", now - at);
            return effects.push(failed(held, &ControlError::new(ErrorCode::Late, message)));
        }
        held.began = true;
        if held.time_of(held.next_step) == Some(at) {
            held.late.note(now - at);
            self.set_step(&mut held, at, effects);
        } else {
            self.ramp_to(&held, 0, at, effects);
        }
        // A second step that is due at the same instant does not report the start again.
        if held.next_step <= 1 && at == held.starts(self.spec.interpolation) {
            effects.push(started(&held));
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
        self.take_over(&setpoint);
        self.is_placed |= setpoint.control_type == ControlType::Position;
        self.signals.insert(setpoint.control_type, Signal::resting(setpoint.value, at));
        effects.push(Effect::Move {
            motion: Motion::Set(setpoint),
            due: at,
            request_id: held.request_id.clone(),
            step: u32::try_from(index).ok(),
        });
        self.ramp_to(held, index + 1, at, effects);
    }

    /// Records that a new command drives the setpoint's control type. The lease of an ended command no longer covers this control type.
    fn take_over(&mut self, setpoint: &Setpoint) {
        let driven = setpoint.control_type;
        self.is_placed &= !matches!(driven, ControlType::Speed | ControlType::Acceleration);
        self.driven.insert(driven, setpoint.clone());
        for guard in &mut self.guards {
            guard.rates.retain(|guarded| *guarded != driven);
        }
        self.guards.retain(|guard| !guard.rates.is_empty());
    }

    /// Starts the linear movement to the step `index`, if the device moves linearly and the previous step has the same control type.
    fn ramp_to(&mut self, held: &Held, index: usize, now: Timestamp<Robot>, effects: &mut Vec<Effect>) {
        let (Some(next), Some(until)) = (held.setpoint(index), held.time_of(index)) else { return };
        let before = index.checked_sub(1).and_then(|previous| held.setpoint(previous));
        let same_type = before.is_none_or(|before| before.control_type == next.control_type);
        if self.spec.interpolation != Interpolation::Linear || !same_type || until <= now {
            return;
        }
        let Some(from) = self.value(next.control_type, now) else { return };
        self.take_over(next);
        self.signals.insert(next.control_type, Signal::ramp(from, now, next.value, until));
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
        let (steps_done, late) = (held.steps_done(), held.late);
        let command = held.command;
        effects.push(Effect::Ended { command, link, request_id, value, steps_done, late });
        let lease = held.lease();
        let rates: Vec<_> = self.rates_left_on().filter(|rate| held.drives(*rate)).collect();
        if lease.silence.is_some() && !rates.is_empty() {
            let (request_id, steps_done) = (held.request_id.clone(), held.steps_done());
            self.guards.push(Guard { rates, lease, command, request_id, steps_done });
        }
    }

    /// Returns the speeds, accelerations and custom values that are not at rest, by control type.
    fn rates_left_on(&self) -> impl Iterator<Item = ControlType> + '_ {
        let left_on = |(control_type, last): &(&ControlType, &Setpoint)| {
            rest_of(&self.spec, **control_type, Some(last)).is_some_and(|rest| rest != **last)
        };
        self.driven.iter().filter(left_on).map(|(control_type, _)| *control_type)
    }

    /// Handles the end of a lease at `at`. If it is a running command's lease, all commands end; if it is a pending command's, only
    /// pending commands end.
    fn lease_ended(
        &mut self,
        at: Timestamp<Robot>,
        now: Timestamp<Robot>,
        heard: &LastMessages,
        effects: &mut Vec<Effect>,
    ) {
        let lost = |held: &&Held| !held.began && held.lease_end(heard) == Some(at);
        let passed = |held: &Held| {
            if held.pending_until == Some(at) {
                NOT_CONFIRMED.to_owned()
            } else {
                lease_message("pending", now - at)
            }
        };
        let waiting = self.queue.iter().find(lost).map(|held| (held.start, passed(held)));
        match waiting.filter(|_| self.running_lease_end(heard) != Some(at)) {
            None => {
                let why = lease_message("running", now - at);
                self.link_lost(at, &ControlError::new(ErrorCode::LinkLost, why), effects);
            }
            // A command that has not started has moved nothing, so its end moves nothing.
            Some((from, why)) => {
                self.cancel_from(from, &ControlError::new(ErrorCode::LinkLost, why), effects)
            }
        }
    }

    fn link_lost(&mut self, at: Timestamp<Robot>, error: &ControlError, effects: &mut Vec<Effect>) {
        for Guard { lease, command, request_id, steps_done, .. } in self.guards.drain(..) {
            let (link, error) = (lease.link, error.clone());
            let steps_done = Some(steps_done);
            effects.push(Effect::Failed { command, link, request_id, error, steps_done });
        }
        self.drop_all(error, effects);
        self.come_to_rest(at, Rest::InPlace, effects);
    }

    /// Ends all pending and running commands and brings the device to rest.
    pub(crate) fn stop(
        &mut self,
        now: Timestamp<Robot>,
        error: &ControlError,
        rest: Rest,
        effects: &mut Vec<Effect>,
    ) {
        self.drop_all(error, effects);
        self.come_to_rest(now, rest, effects);
    }

    /// Ends all pending and running commands after the loss of the hardware. No value can be set any longer.
    pub(crate) fn fail(&mut self, now: Timestamp<Robot>, error: &ControlError, effects: &mut Vec<Effect>) {
        self.drop_all(error, effects);
        self.guards.clear();
        self.is_placed = false;
        for signal in self.signals.values_mut() {
            *signal = Signal::resting(signal.value(now), now);
        }
    }

    /// Immediately brings to rest every speed, acceleration and custom value that was ever driven. Positions stay as they are. Called
    /// when the hardware is connected again, because it may not have received the last values.
    pub(crate) fn rest_rates(&mut self, now: Timestamp<Robot>, effects: &mut Vec<Effect>) {
        for (control_type, last) in &mut self.driven {
            let Some(rest) = rest_of(&self.spec, *control_type, Some(last)) else { continue };
            self.signals.insert(*control_type, Signal::resting(rest.value, now));
            last.clone_from(&rest);
            let motion = Motion::Rest(rest);
            effects.push(Effect::Move { motion, due: now, request_id: None, step: None });
        }
    }

    /// Returns the current movement or constant value of a control type. `None` if the device lacks this control type.
    #[cfg(feature = "host")]
    pub(crate) fn signal(&self, control_type: ControlType) -> Option<Signal> {
        self.signals.get(&control_type).copied()
    }

    fn drop_all(&mut self, error: &ControlError, effects: &mut Vec<Effect>) {
        for held in self.queue.drain(..) {
            effects.push(failed(held, error));
        }
    }

    /// Returns how many more commands the queue can take.
    pub(crate) fn room(&self) -> u32 {
        let held = u32::try_from(self.queue.len()).unwrap_or(u32::MAX);
        self.spec.script_queue.saturating_sub(held)
    }

    pub(crate) fn command(&self, id: CommandId) -> Option<&Held> {
        self.queue.iter().find(|held| held.command == id)
    }

    pub(crate) fn running(&self) -> Option<&Held> {
        self.queue.front().filter(|held| held.began)
    }

    /// Limits the lease of a command that has not started. The command is identified by its request id, its start, and the party that
    /// sent it.
    pub(crate) fn limit(&mut self, id: &RequestId, start: Timestamp<Robot>, party: LinkId, limit: Limit) {
        let first = self.queue.partition_point(|held| held.start < start);
        let same_start = self.queue.iter_mut().skip(first).take_while(|held| held.start == start);
        let named = |held: &&mut Held| held.request_id.as_ref() == Some(id);
        if let Some(held) = same_start.filter(|held| !held.began && held.link == party).find(named) {
            held.limit(limit);
        }
    }

    /// Drops the commands that have not started and whose start is `from` or later.
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

    /// Brings the device to rest as fast as it can, either where it is or in its default state.
    fn come_to_rest(&mut self, now: Timestamp<Robot>, rest: Rest, effects: &mut Vec<Effect>) {
        self.guards.clear();
        let moves = self.signals.get(&ControlType::Position).is_some_and(|signal| signal.moves(now));
        self.is_placed &= self.lookahead.is_none() || !moves;
        effects.push(Effect::Stopped);
        for control_type in self.signals.keys().copied().collect::<Vec<_>>() {
            if let Some(motion) = self.motion_to_rest(control_type, now, rest) {
                self.is_placed |=
                    control_type == ControlType::Position && matches!(motion, Motion::Default(_));
                effects.push(Effect::Move { motion, due: now, request_id: None, step: None });
            }
        }
    }

    /// Returns the motion that brings a signal (one control type) to rest, or `None` if the signal stays as it is.
    fn motion_to_rest(
        &mut self,
        control_type: ControlType,
        now: Timestamp<Robot>,
        rest: Rest,
    ) -> Option<Motion> {
        let signal = *self.signals.get(&control_type)?;
        let home = default_of(&self.spec, control_type).filter(|_| rest == Rest::Home);
        let driven = self.driven.get(&control_type);
        let target = match home {
            Some(home) => Some(with_values(Setpoint::new(control_type, home), driven)),
            // A signal that no command has driven stays as it is. The exception is the main rate: a wheel may still turn because of an
            // earlier process.
            None if driven.is_none() && !is_main_rate(&self.spec, control_type) => None,
            None => rest_of(&self.spec, control_type, driven),
        };
        let slowed = match (control_type, &target) {
            (ControlType::Position, None) if !signal.moves(now) => return None,
            (ControlType::Position, _) => {
                let limits = self.spec.available_control_types.limits(control_type);
                let rates = self.rates().filter(|_| home.is_some() || signal.moves(now));
                rates.and_then(|rates| signal.brought_to_rest(now, home, rates, limits))
            }
            (ControlType::Speed, Some(target)) => {
                self.acceleration().and_then(|acceleration| signal.slowed_to(now, target.value, acceleration))
            }
            (_, _) => None,
        };
        if let Some(slowed) = slowed {
            self.signals.insert(control_type, slowed);
            let (from, to, until) = (signal.value(now), slowed.target(), slowed.rests_at());
            return Some(Motion::Slow { control_type, from, to, until });
        }
        let target = match control_type {
            ControlType::Position => target.unwrap_or_else(|| Setpoint::new(control_type, signal.value(now))),
            _ => target?,
        };
        self.signals.insert(control_type, Signal::resting(target.value, now));
        if let Some(driven) = self.driven.get_mut(&control_type) {
            driven.clone_from(&target);
        }
        Some(if home.is_some() { Motion::Default(target) } else { Motion::Rest(target) })
    }

    /// Returns the limits of movements to rest and to the default state. `None` if neither the speed nor the acceleration has a limit.
    fn rates(&self) -> Option<Rates> {
        let speed = tighter(largest(&self.spec, ControlType::Speed), self.limits.speed);
        let rates = Rates { speed, acceleration: self.acceleration() };
        (rates.speed.is_some() || rates.acceleration.is_some()).then_some(rates)
    }

    fn acceleration(&self) -> Option<f64> {
        tighter(largest(&self.spec, ControlType::Acceleration), self.limits.acceleration)
    }

    /// Records a stop that `party` sent at `sent`. Commands that were sent before the stop but arrive after it must not start. A stop
    /// with a future timestamp blocks the device only briefly: for other parties at most 250 ms, for its own party at most 5 s.
    pub(crate) fn take_back(&mut self, now: Timestamp<Robot>, sent: Timestamp<Server>, party: LinkId) {
        let at_most = |ahead: Span| sent.min((now + ahead).assume_clock());
        self.taken_back = self.taken_back.max(Some(at_most(TAKEN_BACK_FROM_OTHERS_MAX)));
        let before = self.taken_back_by.filter(|(by, _)| *by == party).map(|(_, until)| until);
        let own = before.into_iter().chain([at_most(TAKEN_BACK_AHEAD_MAX)]).max();
        self.taken_back_by = own.map(|until| (party, until));
    }

    /// Records that a session has claimed the free robot. Earlier stops do not cancel messages that this session sends from now on,
    /// because strangers may have stopped the free robot with future timestamps.
    pub(crate) fn claimed(&mut self, now: Timestamp<Robot>) {
        self.taken_back = self.taken_back.map(|until| until.min(now.assume_clock()));
    }

    /// Whether an earlier stop cancelled a message that `party` sent at `sent`.
    fn was_taken_back(&self, party: LinkId, sent: Option<Timestamp<Server>>) -> bool {
        let own = self.taken_back_by.filter(|(by, _)| *by == party).map(|(_, until)| until);
        sent.is_some() && sent <= self.taken_back.max(own)
    }

    /// Checks a command that starts at `start`, and adds it to the queue.
    pub(crate) fn accept(
        &mut self,
        now: Timestamp<Robot>,
        start: Timestamp<Robot>,
        link: LinkId,
        request: &urrcp::ControlRequest,
    ) -> Result<CommandId, ControlError> {
        let (steps, duration) = self.checked_steps(&request.command)?;
        if start < now {
            let message = format!("the start passed {} ago; a late command is never started", now - start);
            return Err(ControlError::new(ErrorCode::Late, message));
        }
        if let Some(until) = request.pending_until.filter(|until| *until <= now) {
            let message = format!("the command's `pending_until` passed {} ago", now - until);
            return Err(ControlError::new(ErrorCode::Late, message));
        }
        let end = start + duration;
        let (stop_condition, is_first) = (request.stop_condition, self.queue.is_empty());
        Reach { start, end, stop_condition, steps: &steps, is_first }.check(now)?;
        if self.was_taken_back(link, request.timestamp) {
            let message = "the command was cancelled by a stop that arrived before it";
            return Err(ControlError::new(ErrorCode::Cancelled, message));
        }
        // At the same instant, a zero-length command precedes a command that has not started, but never enters a running one.
        let overlaps = |held: &&Held| {
            let into_running = held.began && (start, end) < (held.start, held.end);
            into_running || start < held.end && held.start < end
        };
        if let Some(held) = self.queue.iter().find(overlaps) {
            let message = format!("`{}` is reserved from {} to {}", self.spec.id, held.start, held.end);
            return Err(ControlError::new(ErrorCode::Overlap, message));
        }
        if self.queue.len() >= self.spec.script_queue as usize {
            let message = format!(
                "`{}` already holds {} of at most {} commands",
                self.spec.id,
                self.queue.len(),
                self.spec.script_queue
            );
            return Err(ControlError::new(ErrorCode::Busy, message));
        }
        let place = self.queue.partition_point(|held| (held.start, held.end) <= (start, end));
        self.accepted.0 += 1;
        let command = self.accepted;
        let held = Held {
            command,
            link,
            request_id: request.request_id.clone(),
            accepted: now,
            start,
            end,
            steps,
            stop_condition: request.stop_condition,
            next_step: 0,
            late: LateSteps::default(),
            began: false,
            pending_until: request.pending_until,
            limited_by: None,
        };
        self.queue.insert(place, held);
        Ok(command)
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
            Command::Unknown(name) => {
                let message = format!("`{}` does not support control type `{name}`", self.spec.id);
                Err(ControlError::new(ErrorCode::UnsupportedControlType, message))
            }
            Command::ReadSensor => {
                Err(ControlError::new(ErrorCode::Internal, "a request for a reading cannot be queued"))
            }
        }
    }

    fn check_script(&self, script: &Script) -> Result<(), ControlError> {
        let Some(parameters) = self.spec.available_control_types.script() else {
            let message = format!("`{}` does not support scripts", self.spec.id);
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
                .map_err(|e| ControlError::new(e.code, format!("step {}: {}", index + 1, e.message)))?;
        }
        Ok(())
    }
}

/// Whether this control type is the device's primary one and is a speed or an acceleration.
fn is_main_rate(spec: &Device, control_type: ControlType) -> bool {
    matches!(control_type, ControlType::Speed | ControlType::Acceleration)
        && spec.primary_control_type() == Some(control_type)
}

/// Returns the largest absolute value that a device declares for a speed or an acceleration. `None` if it declares no limits.
fn largest(spec: &Device, rate: ControlType) -> Option<f64> {
    let limits = spec.available_control_types.limits(rate)?;
    Some(limits.min_value.abs().max(limits.max_value.abs())).filter(|rate| *rate > 0.0)
}

/// Returns the smaller of two limits, either of which may be missing. A `limit` of zero or less is ignored.
fn tighter(declared: Option<f64>, limit: Option<f64>) -> Option<f64> {
    declared.into_iter().chain(limit.filter(|limit| *limit > 0.0)).reduce(f64::min)
}

/// Returns the message for the end of a lease. If the robot woke up late, the message says so, because messages that arrived in time may
/// not have been read.
fn lease_message(lease: &str, late: Span) -> String {
    if late > START_LATE_MAX {
        format!("the {lease} lease ended while the robot was delayed: the robot woke up {late} after that")
    } else {
        format!("the {lease} lease ended: the server was silent for longer than `stop_condition` allows")
    }
}

fn started(held: &Held) -> Effect {
    let value = held.setpoint(0).map_or(0.0, |setpoint| setpoint.value);
    let (command, link, request_id) = (held.command, held.link, held.request_id.clone());
    Effect::Started { command, link, request_id, value }
}

fn failed(held: Held, error: &ControlError) -> Effect {
    let steps_done = Some(held.steps_done());
    let (command, link, request_id) = (held.command, held.link, held.request_id);
    Effect::Failed { command, link, request_id, error: error.clone(), steps_done }
}
