//! Scripts that a driver receives ahead of time and times by itself, and the driver's reports about them.
//!
//! The state machine simulates these scripts in parallel, and decides on leases, overlaps and stops. The robot reports what the driver
//! reports.

use std::collections::BTreeMap;

use urrcp::{ControlError, DeviceId, Interpolation, RequestId, Robot, Setpoint, Span, Timestamp};

use crate::held::Held;
use crate::ids::CommandId;
use crate::late_steps::LateSteps;
use crate::tolerance::Tolerance;

/// Why a driver's report about a script cannot be true.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImpossibleReport {
    /// The reported time is later than the robot's clock, by this time.
    #[error("the reported time is {0} in the future")]
    InTheFuture(Span),
    /// The reported time is earlier than the acceptance of the script, by this time.
    #[error("the reported time is {0} before the script was accepted")]
    BeforeAcceptance(Span),
    /// The driver has reported a step or the end before it has reported the start.
    #[error("progress was reported, but no start")]
    NoStart,
    /// The driver has reported the end before it has received all steps.
    #[error("the end of the script was reported, but only {given} of its steps had been sent to the driver")]
    EarlyEnd {
        /// Number of steps that the driver has received.
        given: usize,
    },
    /// The driver has reported a step that it has not received.
    #[error("step {step} was reported, but only {given} of the script's steps had been sent to the driver")]
    EarlyStep {
        /// Index of the reported step.
        step: u32,
        /// Number of steps that the driver has received.
        given: usize,
    },
}

/// Identifies a script, or a single value, that a driver has received.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlanId(pub u64);

/// How far ahead a driver receives the steps of scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lookahead {
    /// The driver receives all steps as soon as the script is accepted.
    Script,
    /// The driver receives each step at least this long before the movement to the step starts, or as soon as the script is accepted.
    Horizon(Span),
}

/// Steps of a script that a driver receives together. `C` is the clock to which the times refer.
#[derive(Debug)]
#[non_exhaustive]
pub struct PlanPart<C> {
    /// Id of the script.
    pub plan: PlanId,
    /// Device of the script.
    pub device: DeviceId,
    /// Start of the script.
    pub start: Timestamp<C>,
    /// Latest instant at which the script may start.
    pub begin_by: Timestamp<C>,
    /// Behaviour of the device between two steps.
    pub interpolation: Interpolation,
    /// Index of the first of `steps` in the script. 0 starts a script; any other index continues it.
    pub first: usize,
    /// Steps in the order of their times; at least one.
    pub steps: Vec<PlanStep<C>>,
    /// Whether the script ends with these steps.
    pub is_last: bool,
}

/// A step of a script, with its absolute time.
#[derive(Debug)]
#[non_exhaustive]
pub struct PlanStep<C> {
    /// Time when the value is due. With linear interpolation, the device arrives at the value at this time.
    pub at: Timestamp<C>,
    /// The value to set.
    pub setpoint: Setpoint,
}

/// Order to a driver to cancel a script before its end.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct PlanCancel {
    /// Id of the script.
    pub plan: PlanId,
    /// Device of the script.
    pub device: DeviceId,
    /// Behaviour of the device after the cancellation.
    pub then: Then,
    /// Reason for the cancellation, for people.
    pub why: String,
}

/// Behaviour of a device after one of its scripts is cancelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Then {
    /// The device behaves as if the cancelled script had never existed: another script may run.
    Keep,
    /// The device stays where it is.
    Hold,
    /// The device comes to rest, or moves to its default state; the driver receives values for this movement.
    Rest,
    /// The device slows down within its limits; the driver receives values for this movement.
    Slow,
}

impl Then {
    /// Returns the keyword for this behaviour in the protocol between the robot and driver programs.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Keep => "keep",
            Self::Hold => "hold",
            Self::Rest => "rest",
            Self::Slow => "slow",
        }
    }
}

/// A driver's report about a script that it times by itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlanEvent {
    /// The device has set the first value or, with linear interpolation, has started to move to it.
    Began,
    /// The step with this index is done, and so are all steps before it.
    Step(u32),
    /// All steps are done.
    Done,
    /// According to the driver's clock, the script has started or continues. The hardware has not confirmed this.
    AssumedRunning,
    /// According to the driver's clock, all steps are done. The hardware has not confirmed this.
    AssumedDone,
    /// The script ended early, for the contained reason.
    Failed(String),
    /// The script was cancelled.
    Cancelled,
}

/// Tolerance for the time in a driver's report. The time may be at most this far in the future, or this long before the script was
/// accepted.
const GRAIN: Span = Span::from_millis(10);
/// Maximum delay with which the edge (the process that drives the hardware) checks for an overdue report. If the check is later than
/// that, the edge itself was delayed, and the report may still wait to be processed.
const HELD_UP: Span = Span::from_millis(100);

/// Progress of a script, as the robot's state machine sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    Waiting,
    Begun,
    /// The time of the last step has passed.
    Over,
    /// The driver has been told to end the script. This error is reported once it has done so.
    Cancelling(ControlError),
}

/// A script that a device's driver times by itself.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) index: usize,
    pub(crate) command: CommandId,
    /// The command as it was when it was accepted.
    held: Held,
    device: DeviceId,
    interpolation: Interpolation,
    lookahead: Lookahead,
    /// Number of steps that the driver has received.
    pub(crate) given: usize,
    pub(crate) stage: Stage,
    pub(crate) began: Option<Timestamp<Robot>>,
    pub(crate) began_told: bool,
    /// Whether the driver has reported that it assumes that the script has started.
    assumed: bool,
    pub(crate) done: Option<Timestamp<Robot>>,
    pub(crate) steps_done: u32,
    pub(crate) late: LateSteps,
    /// Whether the driver has ended the script, or never accepted it.
    pub(crate) is_over_there: bool,
    /// Later deadline for the driver's reports, which is set if the edge was delayed. `None`: no later deadline.
    extended: Option<Timestamp<Robot>>,
    tolerance: Tolerance,
}

impl Plan {
    pub(crate) const fn held(&self) -> &Held {
        &self.held
    }

    pub(crate) const fn device(&self) -> &DeviceId {
        &self.device
    }

    /// Returns when the device starts to move to the value of a step. `None` if the step does not exist.
    fn sets_out(&self, step: usize) -> Option<Timestamp<Robot>> {
        self.held.time_of(step)?;
        step.checked_sub(1).map_or(Some(self.held.start), |before| self.held.time_of(before))
    }

    const fn is_open(&self) -> bool {
        matches!(self.stage, Stage::Waiting | Stage::Begun)
    }

    /// Returns when the driver must receive the next steps. `None` if no steps remain to be handed over.
    fn next_handover(&self) -> Option<Timestamp<Robot>> {
        let sets_out = self.sets_out(self.given).filter(|_| self.is_open() && !self.is_over_there)?;
        Some(match self.lookahead {
            Lookahead::Script => self.held.accepted,
            Lookahead::Horizon(horizon) => sets_out - horizon,
        })
    }

    /// Returns by how much the handover of the next steps to the driver is late. `None` if the delay is within the tolerance.
    pub(crate) fn handover_late(&self, now: Timestamp<Robot>) -> Option<Span> {
        self.next_handover()?;
        let sets_out = self.sets_out(self.given)?;
        let most = if self.given == 0 { self.tolerance.start } else { self.tolerance.step };
        (now - sets_out > most).then(|| now - sets_out)
    }

    /// Returns the steps that the driver must receive now. With [`Lookahead::Horizon`], this includes the steps that would be due for
    /// handover within the next quarter of the horizon.
    pub(crate) fn hand_over(&mut self, id: PlanId, now: Timestamp<Robot>) -> Option<PlanPart<Robot>> {
        self.next_handover().filter(|at| *at <= now)?;
        let first = self.given;
        let within = |sets_out: Timestamp<Robot>| match self.lookahead {
            Lookahead::Script => true,
            Lookahead::Horizon(horizon) => sets_out - horizon <= now + horizon / 4,
        };
        let steps = (first..).map_while(|step| {
            self.sets_out(step).filter(|sets_out| within(*sets_out))?;
            Some(PlanStep { at: self.held.time_of(step)?, setpoint: self.held.setpoint(step)?.clone() })
        });
        let steps: Vec<_> = steps.collect();
        self.given += steps.len();
        Some(PlanPart {
            plan: id,
            device: self.device.clone(),
            start: self.held.start,
            begin_by: self.held.start + self.tolerance.start,
            interpolation: self.interpolation,
            first,
            steps,
            is_last: self.held.time_of(self.given).is_none(),
        })
    }

    /// Returns the deadline of the driver's next report. `None` if no report is expected.
    fn report_due(&self) -> Option<Timestamp<Robot>> {
        let due = match (&self.stage, self.began, self.done) {
            (Stage::Cancelling(_), ..) | (_, _, Some(_)) => return None,
            (_, None, None) if !self.assumed => self.held.starts(self.interpolation) + self.tolerance.report,
            (_, _, None) => self.held.end + self.tolerance.report,
        };
        Some(self.extended.map_or(due, |extended| due.max(extended)))
    }

    /// Whether the driver has missed the deadline of a report. If this check itself runs too late, it extends the deadline instead.
    fn is_unreported(&mut self, now: Timestamp<Robot>) -> bool {
        let Some(due) = self.report_due().filter(|due| *due <= now) else { return false };
        if now - due > HELD_UP {
            self.extended = Some(now + self.tolerance.report);
            return false;
        }
        true
    }

    /// Records a driver's report about the script. Returns the time of the event, but at most `now`.
    ///
    /// # Errors
    /// The reason why the report cannot be true.
    pub(crate) fn note(
        &mut self,
        now: Timestamp<Robot>,
        at: Timestamp<Robot>,
        event: &PlanEvent,
    ) -> Result<Timestamp<Robot>, ImpossibleReport> {
        if at > now + GRAIN {
            return Err(ImpossibleReport::InTheFuture(at - now));
        }
        if at < self.held.accepted - GRAIN {
            return Err(ImpossibleReport::BeforeAcceptance(self.held.accepted - at));
        }
        let at = at.min(now);
        match event {
            PlanEvent::Began => self.began = self.began.or(Some(at)),
            PlanEvent::Step(_) | PlanEvent::Done if !self.has_begun() => {
                return Err(ImpossibleReport::NoStart);
            }
            PlanEvent::Step(step) => self.note_step(at, *step)?,
            PlanEvent::Done if self.held.time_of(self.given).is_some() => {
                return Err(ImpossibleReport::EarlyEnd { given: self.given });
            }
            PlanEvent::Done => {
                self.done = self.done.or(Some(at));
                self.steps_done = u32::try_from(self.given).unwrap_or(u32::MAX);
                self.is_over_there = true;
            }
            PlanEvent::AssumedRunning => self.assumed = true,
            PlanEvent::AssumedDone => {
                self.assumed = true;
                self.is_over_there = true;
            }
            PlanEvent::Failed(_) | PlanEvent::Cancelled => self.is_over_there = true,
        }
        Ok(at)
    }

    fn note_step(&mut self, at: Timestamp<Robot>, step: u32) -> Result<(), ImpossibleReport> {
        let due = self.held.time_of(step as usize).filter(|_| (step as usize) < self.given);
        let Some(due) = due else {
            return Err(ImpossibleReport::EarlyStep { step, given: self.given });
        };
        if step >= self.steps_done {
            self.steps_done = step + 1;
            self.late.note(at - due);
        }
        Ok(())
    }

    /// Records that the driver has cancelled the script. If the driver could still have reported a start in time, the script counts as
    /// not started.
    pub(crate) fn is_withdrawn(&mut self, now: Timestamp<Robot>) {
        self.is_over_there |= now < self.held.starts(self.interpolation) + self.tolerance.report;
    }

    /// Whether the script may have started, although the driver has reported no start. This is so if the driver had the script at its
    /// start time, or assumes that the script has started.
    pub(crate) fn may_have_begun(&self, now: Timestamp<Robot>) -> bool {
        let had_it = self.given > 0 && !self.is_over_there && now >= self.held.starts(self.interpolation);
        self.began.is_none() && (self.assumed || had_it)
    }

    /// Whether the driver has reported that the script started, either observed or assumed.
    pub(crate) const fn has_begun(&self) -> bool {
        self.began.is_some() || self.assumed
    }

    /// Returns the script's progress as a text for people.
    pub(crate) fn place(&self) -> String {
        match self.began {
            None if !self.assumed => "before its start".to_owned(),
            _ => format!("in step {}", self.steps_done + 1),
        }
    }
}

/// The scripts of one robot that drivers time by themselves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Plans {
    plans: BTreeMap<PlanId, Plan>,
    last: u64,
    /// Scripts that the state machine has ended, with their errors. They must be cancelled at the driver when their device changes next.
    failing: Vec<(PlanId, ControlError)>,
    /// Maximum delays that apply to each script that is added.
    pub(crate) tolerance: Tolerance,
}

impl Plans {
    pub(crate) fn is_empty(&self) -> bool {
        self.plans.is_empty()
    }

    /// Adds an accepted command whose steps the driver times by itself.
    pub(crate) fn add(
        &mut self,
        index: usize,
        device: (DeviceId, Interpolation, Lookahead),
        command: CommandId,
        held: Held,
    ) {
        self.last += 1;
        let (device, interpolation, lookahead) = device;
        let plan = Plan {
            index,
            command,
            held,
            device,
            interpolation,
            lookahead,
            given: 0,
            stage: Stage::Waiting,
            began: None,
            began_told: false,
            assumed: false,
            done: None,
            steps_done: 0,
            late: LateSteps::default(),
            is_over_there: false,
            extended: None,
            tolerance: self.tolerance,
        };
        self.plans.insert(PlanId(self.last), plan);
    }

    /// Whether a plan (a script that a driver times) with this id exists or has existed.
    pub(crate) const fn has_been(&self, id: PlanId) -> bool {
        id.0 >= 1 && id.0 <= self.last
    }

    pub(crate) fn get(&self, id: PlanId) -> Option<&Plan> {
        self.plans.get(&id)
    }

    pub(crate) fn get_mut(&mut self, id: PlanId) -> Option<&mut Plan> {
        self.plans.get_mut(&id)
    }

    pub(crate) fn remove(&mut self, id: PlanId) -> Option<Plan> {
        self.plans.remove(&id)
    }

    pub(crate) fn find(&self, index: usize, command: CommandId) -> Option<PlanId> {
        let is_it = |plan: &Plan| plan.index == index && plan.command == command;
        self.plans.iter().find(|(_, plan)| is_it(plan)).map(|(id, _)| *id)
    }

    /// Returns the plan (the script that the driver times) of a request, if it has not ended.
    pub(crate) fn of_request(&self, id: &RequestId) -> Option<&Plan> {
        self.plans.values().find(|plan| plan.held.request_id.as_ref() == Some(id))
    }

    /// Returns the plans (the scripts that drivers time) of a device, oldest first.
    pub(crate) fn of_device(&self, index: usize) -> Vec<PlanId> {
        self.plans.iter().filter(|(_, plan)| plan.index == index).map(|(id, _)| *id).collect()
    }

    /// Records that the state machine has reached a stage of a command, such as its start or end.
    pub(crate) fn come_to(&mut self, index: usize, command: CommandId, stage: Stage) {
        let Some(plan) = self.find(index, command).and_then(|id| self.plans.get_mut(&id)) else { return };
        plan.stage = stage;
    }

    pub(crate) fn next_wakeup(&self) -> Option<Timestamp<Robot>> {
        let at = |plan: &Plan| plan.next_handover().into_iter().chain(plan.report_due()).min();
        self.plans.values().filter_map(at).min()
    }

    /// Returns the plans (the scripts that drivers time) of which drivers must receive further steps now.
    pub(crate) fn to_hand_over(&self, now: Timestamp<Robot>) -> Vec<PlanId> {
        let due = |plan: &Plan| plan.next_handover().is_some_and(|at| at <= now);
        self.plans.iter().filter(|(_, plan)| due(plan)).map(|(id, _)| *id).collect()
    }

    /// Returns the plans (the scripts that drivers time) for which the driver has missed the deadline of a report.
    pub(crate) fn unreported(&mut self, now: Timestamp<Robot>) -> Vec<PlanId> {
        self.plans.iter_mut().filter_map(|(id, plan)| plan.is_unreported(now).then_some(*id)).collect()
    }

    /// Marks a plan (a script that a driver times) as failed. It is cancelled when its device changes next.
    pub(crate) fn will_fail(&mut self, id: PlanId, error: ControlError) {
        self.failing.push((id, error));
    }

    pub(crate) fn take_failing(&mut self) -> Vec<(PlanId, ControlError)> {
        std::mem::take(&mut self.failing)
    }
}

impl<C> PlanPart<C> {
    /// Converts the times of the part to a clock that is ahead of their present clock by `ahead`.
    #[cfg(feature = "host")]
    pub(crate) fn on_clock<D>(self, ahead: Span) -> PlanPart<D> {
        let there = |at: Timestamp<C>| (at + ahead).assume_clock();
        PlanPart {
            start: there(self.start),
            begin_by: there(self.begin_by),
            steps: self
                .steps
                .into_iter()
                .map(|step| PlanStep { at: there(step.at), setpoint: step.setpoint })
                .collect(),
            plan: self.plan,
            device: self.device,
            interpolation: self.interpolation,
            first: self.first,
            is_last: self.is_last,
        }
    }
}

// Implemented by hand: a derived implementation would require the clock type to be `Clone`.
impl<C> Clone for PlanPart<C> {
    fn clone(&self) -> Self {
        Self { device: self.device.clone(), steps: self.steps.clone(), ..*self }
    }
}

impl<C> Clone for PlanStep<C> {
    fn clone(&self) -> Self {
        Self { at: self.at, setpoint: self.setpoint.clone() }
    }
}
