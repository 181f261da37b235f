//! Devices whose driver times scripts by itself: handing the scripts to the driver, and forwarding its reports.

use std::collections::BTreeMap;

use urrcp::{ControlError, ControlType, DeviceId, ErrorCode, Timestamp};

use super::{Now, Output, Robot, SetValue};
use crate::device::{Effect, Motion, Rest};
use crate::ids::CommandId;
use crate::plans::{ImpossibleReport, Lookahead, PlanCancel, PlanEvent, PlanId, Stage, Then};

/// The error for a driver's report about a script that the driver times by itself.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanReportError {
    /// The driver has never received a part of the script.
    #[error("plan {} was never sent to the driver", plan.0)]
    NeverSent {
        /// The plan that the report names.
        plan: PlanId,
    },
    /// The report cannot be true.
    #[error("plan {}: {report}", plan.0)]
    Impossible {
        /// The plan that the report names.
        plan: PlanId,
        /// Why the report cannot be true.
        report: ImpossibleReport,
    },
}

impl Robot {
    /// Sets the devices whose scripts the driver receives ahead of time and times by itself. Must be called each time the driver
    /// connects, before [`Robot::hardware_found`]. Such a driver starts scripts by its own clock. The robot therefore no longer declares
    /// that it acts on `pending_until`, the instant at which it drops a command that has not started.
    pub fn plans_ahead(&mut self, lookahead: &BTreeMap<DeviceId, Lookahead>) {
        for device in &mut self.devices {
            device.lookahead = lookahead.get(&device.spec.id).copied();
        }
        self.block.pending_until = lookahead.is_empty();
    }

    /// Adds an accepted command to the plans (the scripts that drivers time), if the device's driver times scripts by itself.
    pub(super) fn plan(&mut self, index: usize, command: CommandId) {
        let device = &self.devices[index];
        let (Some(lookahead), Some(held)) = (device.lookahead, device.command(command)) else { return };
        let held = held.clone();
        let told = (device.spec.id.clone(), device.spec.interpolation, lookahead);
        self.plans.add(index, told, command, held);
    }

    /// Outputs the steps that the driver must receive now. A script whose steps are too late does not start, or does not continue.
    pub(super) fn hand_over(&mut self, now: Now, out: &mut Vec<Output>) {
        for id in self.plans.to_hand_over(now) {
            let Some(plan) = self.plans.get_mut(id) else { continue };
            if let Some(late) = plan.handover_late(now) {
                let why =
                    format!("the edge was delayed: a step should have been sent to the driver {late} ago");
                self.fail_plan(now, id, ControlError::new(ErrorCode::Late, why), out);
            } else if let Some(part) = plan.hand_over(id, now) {
                self.moved = true;
                out.push(Output::Plan(part));
            }
        }
    }

    /// Ends the scripts for which the driver's report is overdue.
    pub(super) fn give_up_unreported(&mut self, now: Now, out: &mut Vec<Output>) {
        for id in self.plans.unreported(now) {
            let Some(plan) = self.plans.get(id) else { continue };
            let missing =
                if plan.has_begun() { "did not report its end" } else { "did not report its start" };
            let message = unknown_fate(plan.device(), missing);
            self.fail_plan(now, id, ControlError::new(ErrorCode::Internal, message), out);
        }
    }

    /// Handles a driver's report about a script that the driver times by itself.
    ///
    /// # Errors
    /// The reason why the report cannot be true. The report is then discarded.
    pub fn plan_reported(
        &mut self,
        now: Now,
        id: PlanId,
        at: Now,
        event: &PlanEvent,
        out: &mut Vec<Output>,
    ) -> Result<(), PlanReportError> {
        let Some(plan) = self.plans.get_mut(id).filter(|plan| plan.given > 0) else {
            // A late report about a script that is already over is permitted.
            return if self.plans.has_been(id) {
                Ok(())
            } else {
                Err(PlanReportError::NeverSent { plan: id })
            };
        };
        let (done_before, device) = (plan.steps_done, plan.device().clone());
        let at =
            plan.note(now, at, event).map_err(|report| PlanReportError::Impossible { plan: id, report })?;
        self.log_steps(id, at, done_before, out);
        let failed = match event {
            PlanEvent::Failed(reason) => Some(format!("the hardware failed {{place}}: {reason}")),
            PlanEvent::Cancelled => Some("the hardware stopped on its own {place}".to_owned()),
            PlanEvent::AssumedDone => Some(unknown_fate(&device, "did not observe its end")),
            PlanEvent::Began | PlanEvent::Step(_) | PlanEvent::Done | PlanEvent::AssumedRunning => None,
        };
        match (failed, self.plans.get(id)) {
            (Some(why), Some(plan)) if !matches!(plan.stage, Stage::Cancelling(_)) => {
                let error = ControlError::new(ErrorCode::Internal, why.replace("{place}", &plan.place()));
                self.fail_plan(now, id, error, out);
            }
            (_, Some(plan)) => self.tell_plans(plan.index),
            (_, None) => {}
        }
        self.send_reports(now, out);
        Ok(())
    }

    /// Outputs the steps that the driver has just reported as done, for the log.
    fn log_steps(&self, id: PlanId, at: Now, done_before: u32, out: &mut Vec<Output>) {
        let Some(plan) = self.plans.get(id) else { return };
        let sets = (done_before..plan.steps_done).filter_map(|step| {
            let (due, setpoint) = (plan.held().time_of(step as usize)?, plan.held().setpoint(step as usize)?);
            let motion = Motion::Set(setpoint.clone());
            let (device, request_id) = (plan.device().clone(), plan.held().request_id.clone());
            let set = SetValue { device, motion, due, request_id, step: Some(step) };
            Some(Output::Played { set, at })
        });
        out.extend(sets);
    }

    /// Records that the driver refused a part of a script, or received it too late. The part starts with the step `first`. The command
    /// ends with `error`.
    pub fn plan_refused(
        &mut self,
        now: Now,
        id: PlanId,
        first: usize,
        error: ControlError,
        out: &mut Vec<Output>,
    ) {
        let Some(plan) = self.plans.get_mut(id) else { return };
        // If the part is not the first one, the driver still has the earlier parts.
        plan.is_over_there |= first == 0;
        self.fail_plan(now, id, error, out);
    }

    /// Records that the driver has ended a script because the robot requested this.
    pub fn plan_cancelled(&mut self, now: Now, id: PlanId, out: &mut Vec<Output>) {
        if let Some(Stage::Cancelling(error)) = self.plans.get(id).map(|plan| plan.stage.clone()) {
            if let Some(plan) = self.plans.get_mut(id) {
                plan.is_withdrawn(now);
            }
            self.tell_failed(now, id, error);
            self.send_reports(now, out);
        }
    }

    /// Ends all commands of the device and brings it to rest, because the device cannot continue with this script.
    fn fail_plan(&mut self, now: Now, id: PlanId, error: ControlError, out: &mut Vec<Output>) {
        let Some(plan) = self.plans.get(id) else { return };
        let (index, is_over) = (plan.index, plan.stage == Stage::Over);
        if is_over {
            self.plans.will_fail(id, error.clone());
        }
        self.devices[index].stop(now, &error, Rest::InPlace, &mut self.effects);
        self.devices[index].forget_position();
        self.settle(now, index, out);
    }

    /// Handles what the state machine has decided for a device whose driver times scripts by itself. The driver moves the device and ends
    /// the scripts. The robot sends its reports only once the driver has reported.
    pub(super) fn plan_effects(&mut self, now: Now, index: usize, out: &mut Vec<Output>) {
        let mut failed = self.plans.take_failing();
        let (mut rest, mut stopped) = (Vec::new(), false);
        let device = self.devices[index].spec.id.clone();
        for effect in self.effects.drain(..) {
            match effect {
                Effect::Move { motion, due, request_id, step } if is_rest(&motion) => {
                    rest.push(SetValue { device: device.clone(), motion, due, request_id, step });
                }
                Effect::Move { .. } => {}
                Effect::Stopped => stopped = true,
                Effect::Started { command, .. } => self.plans.come_to(index, command, Stage::Begun),
                Effect::Ended { command, .. } => self.plans.come_to(index, command, Stage::Over),
                Effect::Failed { command, ref error, .. } => match self.plans.find(index, command) {
                    Some(id) => failed.push((id, error.clone())),
                    None => self.reports.push((index, now, effect)),
                },
            }
        }
        if stopped {
            failed.extend(self.left_over(index, &failed));
        }
        let any = !failed.is_empty();
        rest.retain(|set| !any || !stays(set));
        let then = match rest.is_empty() {
            _ if rest.iter().any(|set| matches!(set.motion, Motion::Slow { .. })) => Then::Slow,
            false => Then::Rest,
            true if stopped => Then::Hold,
            true => Then::Keep,
        };
        for (id, error) in failed {
            self.end_plan(now, id, error, then, out);
        }
        self.moved |= !rest.is_empty();
        out.extend(rest.into_iter().map(Output::Set));
        self.tell_plans(index);
    }

    /// Returns the scripts of a stopped device whose end was due, but has not been reported by the driver. Each script has an error,
    /// which says that it ends because the device is stopped.
    fn left_over(&self, index: usize, failed: &[(PlanId, ControlError)]) -> Vec<(PlanId, ControlError)> {
        let error = || {
            let message = "the device was stopped before its driver reported the end of the script";
            ControlError::new(ErrorCode::Cancelled, message)
        };
        let is_left = |id: &PlanId| {
            let over =
                self.plans.get(*id).is_some_and(|plan| plan.stage == Stage::Over && plan.done.is_none());
            over && !failed.iter().any(|(failed, _)| failed == id)
        };
        self.plans.of_device(index).into_iter().filter(is_left).map(|id| (id, error())).collect()
    }

    /// Reports a script as failed that the state machine has ended. If the driver has the script, the driver must end it before that.
    fn end_plan(&mut self, now: Now, id: PlanId, error: ControlError, then: Then, out: &mut Vec<Output>) {
        let is_away = self.hardware.away().is_some();
        let Some(plan) = self.plans.get_mut(id) else { return };
        if plan.given == 0 || plan.is_over_there || is_away {
            return self.tell_failed(now, id, error);
        }
        if !matches!(plan.stage, Stage::Cancelling(_)) {
            let (device, why) = (plan.device().clone(), error.message.to_string());
            plan.stage = Stage::Cancelling(error);
            out.push(Output::Cancel(PlanCancel { plan: id, device, then, why }));
        }
    }

    /// Ends a device's scripts because the hardware that was playing them is lost.
    pub(super) fn abandon_plans(&mut self, now: Now, index: usize, error: &ControlError) {
        for id in self.plans.of_device(index) {
            let Some(plan) = self.plans.get(id) else { continue };
            let error = match &plan.stage {
                Stage::Cancelling(why) => {
                    let message =
                        format!("{}; the hardware may not have stopped: {}", why.message, error.message);
                    ControlError::new(why.code.clone(), message)
                }
                _ => {
                    let message =
                        format!("the hardware may not have played the script to its end: {}", error.message);
                    ControlError::new(error.code.clone(), message)
                }
            };
            self.tell_failed(now, id, error);
        }
    }

    /// Reports those starts and ends of scripts that the driver has reported and the state machine has reached.
    fn tell_plans(&mut self, index: usize) {
        for id in self.plans.of_device(index) {
            let Some(plan) = self.plans.get(id) else { continue };
            if plan.stage != Stage::Waiting {
                self.tell_began(id);
            }
            let Some(plan) = self.plans.get(id).filter(|plan| plan.stage == Stage::Over) else { continue };
            let Some(done) = plan.done else { continue };
            let (held, last) = (plan.held(), plan.steps_done.saturating_sub(1));
            let ended = Effect::Ended {
                command: plan.command,
                link: held.link,
                request_id: held.request_id.clone(),
                value: held.setpoint(last as usize).map_or(0.0, |setpoint| setpoint.value),
                steps_done: plan.steps_done,
                late: plan.late,
            };
            self.reports.push((index, done, ended));
            self.plans.remove(id);
        }
    }

    fn tell_began(&mut self, id: PlanId) {
        let Some(plan) = self.plans.get_mut(id).filter(|plan| !plan.began_told) else { return };
        let Some(began) = plan.began else { return };
        plan.began_told = true;
        let held = plan.held();
        let value = held.setpoint(0).map_or(0.0, |setpoint| setpoint.value);
        let (link, request_id) = (held.link, held.request_id.clone());
        let started = Effect::Started { command: plan.command, link, request_id, value };
        self.reports.push((plan.index, began, started));
    }

    /// Reports a script as failed. If the driver has reported the start of the script, the start is reported first.
    fn tell_failed(&mut self, now: Timestamp<urrcp::Robot>, id: PlanId, error: ControlError) {
        self.tell_began(id);
        let Some(plan) = self.plans.remove(id) else { return };
        let (link, request_id) = (plan.held().link, plan.held().request_id.clone());
        let command = plan.command;
        let steps_done = (!plan.may_have_begun(now)).then_some(plan.steps_done);
        let failed = Effect::Failed { command, link, request_id, error, steps_done };
        self.reports.push((plan.index, now, failed));
    }
}

fn unknown_fate(device: &DeviceId, missing: &str) -> String {
    format!("the result of the script of `{device}` is unknown: its driver {missing}")
}

/// Whether the motion brings a device to rest or to its default state. False for the movements of a script.
const fn is_rest(motion: &Motion) -> bool {
    matches!(motion, Motion::Rest(_) | Motion::Default(_) | Motion::Slow { .. })
}

/// Whether the motion only holds the position at which the state machine assumes the device to be. The driver knows the actual position
/// better.
fn stays(set: &SetValue) -> bool {
    matches!(&set.motion, Motion::Rest(rest) if rest.control_type == ControlType::Position)
}
