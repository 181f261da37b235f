//! Compares a robot's actions and messages with those that its accepted orders permit.

use std::collections::{HashMap, HashSet};

use downbeat_robot::{LinkId, Motion, Output, SetValue};
use urrcp::{
    ContentHash, ControlRequest, ControlResponse, ControlType, DeviceId, ErrorCode, InitializationBlock,
    Interpolation, Message, RequestId, SessionId, Status, StatusValue, Timestamp,
};

use crate::model::{DeviceModel, Heard, Order, Party, START_LATE_MAX, SignalMovement, cancels_from};
use crate::{Violation, hold};

type Now = Timestamp<urrcp::Robot>;

/// Judge of one robot: what the robot's devices must do, and the messages that the robot has sent and received.
#[derive(Debug)]
pub(crate) struct Judge {
    pub(crate) heard: Heard,
    pub(crate) devices: HashMap<DeviceId, DeviceModel>,
    pub(crate) answers: HashMap<RequestId, ControlResponse>,
    pub(crate) serials: usize,
    /// Serial numbers of the orders that the current event has cancelled.
    pub(crate) cancelled: HashSet<usize>,
    /// Earliest start of the orders that the current event cancels. `None`: it cancels all orders.
    cancels_from: Option<Now>,
    /// Content hash of each accepted request that contained one.
    pub(crate) hashes: HashMap<RequestId, ContentHash>,
    /// Actual start of each request that has started.
    pub(crate) starts: HashMap<RequestId, Now>,
    /// For each device, the orders that end because the current event has ended their leases.
    lost: HashMap<DeviceId, Lost>,
    /// Devices that the current event has brought to rest.
    rested: HashSet<DeviceId>,
    /// Whether the current event moves a device to its default state.
    sends_home: bool,
    /// Devices about which the robot has reported something other than the end of a lease during the current event.
    acted: HashSet<DeviceId>,
}

/// Which orders of a device end because leases have ended.
#[derive(Clone, Copy, Debug, Default)]
struct Lost {
    everything: bool,
    /// Earliest start of the orders that end without having started; all orders with a later start end too. `None`: no such order ends.
    from: Option<Now>,
}

impl Lost {
    fn takes(&self, order: &Order) -> bool {
        self.everything || !order.began && self.from.is_some_and(|from| order.start >= from)
    }
}

/// What may have brought a device to rest.
#[derive(Clone, Copy, PartialEq, Eq)]
enum RestCause {
    /// A request, or the end of a lease.
    Request,
    /// Only the end of a lease.
    Lease,
}

/// A request and its sender.
pub(crate) struct ReceivedRequest<'a> {
    link: LinkId,
    pub(crate) party: Party,
    pub(crate) request: &'a ControlRequest,
}

impl Judge {
    pub(crate) fn new(block: &InitializationBlock) -> Self {
        let devices =
            block.devices.iter().map(|spec| (spec.id.clone(), DeviceModel::new(spec.clone()))).collect();
        Self {
            heard: Heard::default(),
            devices,
            answers: HashMap::new(),
            serials: 0,
            cancelled: HashSet::new(),
            cancels_from: None,
            hashes: HashMap::new(),
            starts: HashMap::new(),
            lost: HashMap::new(),
            rested: HashSet::new(),
            sends_home: false,
            acted: HashSet::new(),
        }
    }

    /// Records a message on a link, and returns the party (a session or a link) that sent it.
    pub(crate) fn heard(&mut self, now: Now, link: LinkId, session: Option<&SessionId>) -> Party {
        self.heard.message(now, link, session)
    }

    /// Judges the outputs after time has passed without another event.
    pub(crate) fn passed(&mut self, now: Now, out: &[Output]) -> Result<(), Violation> {
        self.judge(now, out, None)?;
        hold(self.cancelled.is_empty(), || "a command was cancelled without a request".to_owned())
    }

    /// Judges the outputs after an operator has seized the robot: all orders must have ended, and the robot may only bring devices to
    /// rest.
    pub(crate) fn seized(
        &mut self,
        now: Now,
        link: LinkId,
        session: Option<&SessionId>,
        out: &[Output],
    ) -> Result<(), Violation> {
        self.heard.message(now, link, session);
        self.judge_stopped(now, out)?;
        let held = self.devices.values().find(|device| !device.queue.is_empty() || !device.guards.is_empty());
        hold(held.is_none(), || format!("the robot was seized but still holds {held:?}"))
    }

    /// Judges the outputs of an event, such as a seizure, that stops all devices without a control request.
    fn judge_stopped(&mut self, now: Now, out: &[Output]) -> Result<(), Violation> {
        self.begin_untold(now);
        self.forget_the_last();
        self.cancels_from = None;
        self.sends_home = false;
        for output in out {
            match output {
                Output::Set(set) if set.step.is_none() => self.moved(now, set)?,
                Output::Send { message: Message::ControlResponse(report), .. }
                    if report.status == Status::Failed && report.event_timestamp.is_some() =>
                {
                    self.reported(now, report)?;
                }
                _ => {
                    return Err(Violation(format!(
                        "unexpected output of a robot that was seized: {output:?}"
                    )));
                }
            }
        }
        self.check_lost(RestCause::Request)?;
        self.devices.values_mut().for_each(|device| device.released.clear());
        Ok(())
    }

    /// Marks orders as begun if their start time has been reached and their first value is due later. Robots do not report such a start.
    fn begin_untold(&mut self, now: Now) {
        self.devices.values_mut().for_each(|device| device.begin_untold(now, &self.heard));
    }

    fn forget_the_last(&mut self) {
        self.cancelled.clear();
        self.lost.clear();
        self.rested.clear();
        self.acted.clear();
    }

    /// Judges the outputs after a request, once everything that was due before it has been judged.
    pub(crate) fn asked(
        &mut self,
        now: Now,
        link: LinkId,
        request: &ControlRequest,
        out: &[Output],
    ) -> Result<(), Violation> {
        let party = self.heard.message(now, link, request.session.as_ref());
        if let Some(answer) = request.request_id.as_ref().and_then(|id| self.answers.get(id)) {
            let again = ControlResponse { timestamp: now, ..answer.clone() };
            let repeated = matches!(out, [Output::Send { link: to, message: Message::ControlResponse(r) }]
                if *to == link && *r == again);
            let refused_as_busy = is_refused(answer, &ErrorCode::Busy);
            if repeated || !refused_as_busy {
                return hold(repeated, || {
                    format!("expected the same answer again, {again:?}, found {out:?}")
                });
            }
        }
        self.judge(now, out, Some(&ReceivedRequest { link, party, request }))
    }

    fn judge(
        &mut self,
        now: Now,
        out: &[Output],
        asked: Option<&ReceivedRequest<'_>>,
    ) -> Result<(), Violation> {
        self.begin_untold(now);
        self.forget_the_last();
        self.cancels_from = asked.and_then(|asked| cancels_from(now, asked.request));
        self.sends_home = asked.is_some_and(|asked| asked.request.home) || out.iter().any(is_unsupported);
        let mut answers = 0;
        for output in out {
            match (output, asked) {
                (Output::Set(set), _) => self.moved(now, set)?,
                (Output::Send { message: Message::ControlResponse(report), .. }, _)
                    if report.event_timestamp.is_some() =>
                {
                    self.reported(now, report)?;
                }
                (Output::Send { link, message: Message::ControlResponse(answer) }, Some(asked)) => {
                    answers += 1;
                    hold(*link == asked.link, || {
                        format!("an answer was sent on {link:?}, but its request arrived on {:?}", asked.link)
                    })?;
                    self.answered(now, asked, answer)?;
                }
                _ => return Err(Violation(format!("unexpected output that no request caused: {output:?}"))),
            }
        }
        hold(answers == usize::from(asked.is_some()), || {
            format!("wrong number of answers, {answers}, expected one for each request: {out:?}")
        })?;
        self.check_lost(asked.map_or(RestCause::Lease, |_| RestCause::Request))?;
        self.begin_untold(now);
        self.devices.values_mut().for_each(|device| device.released.clear());
        Ok(())
    }

    /// Checks the effects of ended leases: no order that a lease ends is left, and devices come to rest when they must.
    fn check_lost(&self, cause: RestCause) -> Result<(), Violation> {
        for (id, lost) in &self.lost {
            let left = self.devices.get(id).and_then(|device| device.queue.iter().find(|o| lost.takes(o)));
            hold(left.is_none(), || {
                format!("`{id}` still holds {left:?}, which should have ended with its lease")
            })?;
        }
        for id in &self.rested {
            let lost = self.lost.get(id).copied().unwrap_or_default();
            let began = self.devices.get(id).is_some_and(|d| d.queue.iter().any(|order| order.began));
            let due = cause == RestCause::Request || lost.everything;
            hold(due && !began, || {
                format!(
                    "`{id}` was brought to rest without a reason: ended leases {lost:?}, command running {began}"
                )
            })?;
        }
        let over = self.lost.iter().filter(|(_, lost)| lost.everything).map(|(id, _)| id);
        let goes_on = |id: &&DeviceId| {
            let must = self.devices.get(*id).is_some_and(DeviceModel::must_rest);
            must && !self.rested.contains(*id) && !self.acted.contains(*id)
        };
        match over.into_iter().find(goes_on) {
            None => Ok(()),
            Some(id) => Err(Violation(format!("`{id}` holds no command but did not come to rest"))),
        }
    }

    fn moved(&mut self, now: Now, set: &SetValue) -> Result<(), Violation> {
        let Self { devices, heard, .. } = self;
        let Some(device) = devices.get_mut(&set.device) else {
            return Err(Violation(format!("a value was set on an unknown device: {set:?}")));
        };
        hold(set.due <= now, || format!("early by {}: {set:?}", set.due - now))?;
        let Some(step) = set.step else {
            self.rested.insert(set.device.clone());
            return rested(device, set, self.sends_home);
        };
        let step = step as usize;
        let found = device.queue.iter().position(|order| {
            order.id == set.request_id
                && order.done == step
                && step < order.steps.len()
                && is_due(order, step, set)
        });
        let Some(at) = found else {
            return Err(Violation(format!("{set:?} does not belong to any command in {:?}", device.queue)));
        };
        let order = &device.queue[at];
        let setpoint = &order.steps[step].setpoint;
        hold(device.can_take(setpoint), || format!("`{}` cannot take {set:?}", set.device))?;
        let fits = device.spec.available_control_types.script().is_none_or(|script| {
            let custom = matches!(setpoint.control_type, ControlType::Custom(_));
            let limits = script.limits.min_value..=script.limits.max_value;
            !order.is_script || custom || limits.contains(&setpoint.value)
        });
        hold(fits, || format!("a script of `{}` set a value outside its limits: {set:?}", set.device))?;
        let in_time = order.began || now - order.start <= START_LATE_MAX || set.due > order.start;
        hold(in_time, || format!("{} late: {set:?}", now - order.start))?;
        hold_lease(order, heard, set, step)?;
        let way = match &set.motion {
            Motion::Ramp { from, to, until, .. } => {
                SignalMovement { from: *from, since: set.due, to: *to, until: *until, is_slowing: false }
            }
            _ => SignalMovement::at(setpoint.value, set.due),
        };
        device.drive(setpoint.control_type, way);
        if matches!(set.motion, Motion::Set(_)) {
            device.queue[at].done += 1;
            if device.queue[at].is_done() {
                device.guard_what_goes_on(at);
            }
        }
        Ok(())
    }

    fn reported(&mut self, now: Now, report: &ControlResponse) -> Result<(), Violation> {
        let Self { devices, heard, .. } = self;
        let Some(device) = devices.get_mut(&report.device_id) else {
            return Err(Violation(format!("a report about an unknown device: {report:?}")));
        };
        if let Some(id) = &report.request_id {
            self.answers.insert(id.clone(), report.clone());
        }
        hold(report.event_timestamp == Some(now), || format!("it is {now}: {report:?}"))?;
        if report.error.as_ref().is_none_or(|error| error.code != ErrorCode::LinkLost) {
            self.acted.insert(report.device_id.clone());
        }
        if report.status == Status::Started {
            self.starts.extend(report.request_id.clone().map(|id| (id, now)));
        }
        let owed = match report.status {
            Status::Started => started(device, heard, now, report),
            Status::Ok => ended(device, report),
            Status::Failed => self.failed(now, report)?,
            _ => false,
        };
        hold(owed, || format!("a report about a command that the robot did not hold: {report:?}"))
    }

    fn failed(&mut self, now: Now, report: &ControlResponse) -> Result<bool, Violation> {
        let Some(device) = self.devices.get_mut(&report.device_id) else { return Ok(false) };
        let code = report.error.as_ref().map(|error| &error.code);
        let of = |order: &Order| order.id == report.request_id && !order.is_done();
        match code {
            Some(ErrorCode::LinkLost) => {
                let lost = self.lost.entry(report.device_id.clone()).or_default();
                lost.everything |= device.running_lease_is_over(now, &self.heard);
                let earlier = lost.from.into_iter().chain(device.falls_from(now, &self.heard));
                lost.from = earlier.min();
                let over = lost.everything || lost.from.is_some();
                hold(over, || format!("a lease ended early: {report:?}, held commands {:?}", device.queue))?;
                if let Some(at) = device.released.iter().position(|guard| guard.id == report.request_id) {
                    device.released.remove(at);
                    return Ok(lost.everything);
                }
                let lost = *lost;
                Ok(take(device, |order| of(order) && lost.takes(order)).is_some())
            }
            Some(ErrorCode::Late) => {
                Ok(take(device, |order| of(order) && !order.began && now - order.start > START_LATE_MAX)
                    .is_some())
            }
            Some(ErrorCode::Cancelled) => {
                // Among commands without an id, the report must mean one that the request cancels.
                let from = self.cancels_from;
                let cancelled = take(device, |order| of(order) && order.falls(from));
                self.cancelled.extend(cancelled.as_ref().map(|order| order.serial));
                Ok(cancelled.is_some())
            }
            _ => Ok(false),
        }
    }
}

/// Removes and returns the first order for which `of` returns true.
fn take(device: &mut DeviceModel, of: impl Fn(&Order) -> bool) -> Option<Order> {
    let at = device.queue.iter().position(of)?;
    Some(device.queue.remove(at))
}

/// Judges a motion that brings a device to rest where it is, or moves it to its default state. The motion also ends the leases of rates
/// (such as speeds) that continued after their command.
fn rested(device: &mut DeviceModel, set: &SetValue, sends_home: bool) -> Result<(), Violation> {
    let (control_type, to) = match &set.motion {
        Motion::Rest(setpoint) | Motion::Default(setpoint) => (setpoint.control_type, setpoint.value),
        Motion::Slow { control_type, to, .. } => (*control_type, *to),
        Motion::Set(_) | Motion::Ramp { .. } => {
            return Err(Violation(format!("a movement that does not belong to any step: {set:?}")));
        }
    };
    let limits = device.spec.available_control_types.limits(control_type);
    let within = limits.is_none_or(|limits| (limits.min_value..=limits.max_value).contains(&to));
    hold(set.request_id.is_none() && within, || {
        format!("invalid movement to bring `{}` to rest: {set:?}", set.device)
    })?;
    let before = device.ways.get(&control_type).copied();
    hold(sends_home || stays(device, before, set), || {
        format!(
            "a stop started a new movement of `{}`, which was in the state {before:?}: {set:?}",
            set.device
        )
    })?;
    let way = match &set.motion {
        Motion::Slow { from, to, until, .. } => {
            SignalMovement { from: *from, since: set.due, to: *to, until: *until, is_slowing: true }
        }
        _ => SignalMovement::at(to, set.due),
    };
    device.ways.insert(control_type, way);
    device.released.append(&mut device.guards);
    Ok(())
}

/// Whether a motion only ends movements: a moving position stays where it is or continues in its direction, and a rate (such as a speed)
/// changes to its value at rest.
fn stays(device: &DeviceModel, before: Option<SignalMovement>, set: &SetValue) -> bool {
    const ROUNDING: f64 = 1e-6;
    match &set.motion {
        Motion::Rest(rest) if rest.control_type == ControlType::Position => before.is_some_and(|way| {
            let value = way.value(set.due);
            way.moves(set.due)
                && value.is_none_or(|value| (value - rest.value).abs() <= ROUNDING * (1.0 + value.abs()))
        }),
        Motion::Slow { control_type: ControlType::Position, from, to, .. } => before.is_some_and(|way| {
            way.moves(set.due) && (way.is_slowing || (to - from) * (way.to - way.from) >= 0.0)
        }),
        Motion::Rest(rest) => device.rest(rest.control_type) == Some(rest.value),
        Motion::Slow { control_type, to, .. } => device.rest(*control_type) == Some(*to),
        Motion::Set(_) | Motion::Ramp { .. } | Motion::Default(_) => false,
    }
}

/// Whether an output refuses a request because the device lacks the control type. The device then moves to its default state.
fn is_unsupported(output: &Output) -> bool {
    matches!(output, Output::Send { message: Message::ControlResponse(answer), .. }
        if is_refused(answer, &ErrorCode::UnsupportedControlType))
}

/// Whether `set` executes the order's step `step` at its due time, or starts the movement towards this step in time.
fn is_due(order: &Order, step: usize, set: &SetValue) -> bool {
    let setpoint = &order.steps[step].setpoint;
    let before = step.checked_sub(1).map_or(Some(order.start), |before| order.time_of(before));
    match &set.motion {
        Motion::Set(found) => found == setpoint && order.time_of(step) == Some(set.due),
        Motion::Ramp { control_type, to, until, .. } => {
            *control_type == setpoint.control_type
                && *to == setpoint.value
                && order.time_of(step) == Some(*until)
                && before == Some(set.due)
        }
        Motion::Slow { .. } | Motion::Rest(_) | Motion::Default(_) => false,
    }
}

/// Checks that, at the instant of a movement, both the lease that applies before it and the lease that applies after it are in force.
fn hold_lease(order: &Order, heard: &Heard, set: &SetValue, step: usize) -> Result<(), Violation> {
    let done = step + usize::from(matches!(set.motion, Motion::Set(_)));
    // The movement to a step starts with the previous step, which has already been judged.
    let until_then = match step {
        0 if set.due == order.start => order.pending_ends(heard),
        _ => order.running_ends(heard, step),
    };
    let from_then = order.running_ends(heard, done);
    let in_force = until_then.into_iter().chain(from_then).all(|end| end > set.due);
    hold(in_force, || {
        format!("a device moved after its lease had ended at {until_then:?} or {from_then:?}: {set:?}")
    })
}

/// Finds the order whose start is reported, and marks it as started. Returns whether there is such an order, and the report is correct. A
/// device that holds its value between steps reports the start with the first value.
fn started(device: &mut DeviceModel, heard: &Heard, now: Now, report: &ControlResponse) -> bool {
    let starts = |order: &Order| match device.spec.interpolation {
        Interpolation::Linear => order.start,
        Interpolation::Hold => order.time_of(0).unwrap_or(order.start),
    };
    let of = |order: &Order| order.id == report.request_id && !order.started && starts(order) <= now;
    let Some(at) = device.queue.iter().position(of) else { return false };
    let order = &mut device.queue[at];
    let begun = order.began || order.begins_by(now, heard);
    let value = order.steps.first().map(|step| StatusValue::Number(step.setpoint.value));
    (order.began, order.started) = (true, true);
    begun && value.as_ref() == Some(&report.status_value)
}

/// Finds the order whose end is reported, and removes it. Returns whether there is such an order, and the report is correct.
fn ended(device: &mut DeviceModel, report: &ControlResponse) -> bool {
    let Some(order) = take(device, |order| order.id == report.request_id && order.started && order.is_done())
    else {
        return false;
    };
    let value = order.steps.last().map(|step| StatusValue::Number(step.setpoint.value));
    let all = u32::try_from(order.steps.len()).ok();
    report.steps_done == all && value.as_ref() == Some(&report.status_value)
}

/// Whether a response is a refusal with this error code.
pub(crate) fn is_refused(answer: &ControlResponse, code: &ErrorCode) -> bool {
    answer.error.as_ref().is_some_and(|error| error.code == *code)
}
