//! A robot with hardware: handles the loss and return of the hardware, and readings that are answered later.

#[cfg(feature = "host")]
use std::collections::BTreeMap;
#[cfg(feature = "host")]
use std::time::Duration;

use urrcp::{
    ControlError, ControlRequest, ControlResponse, DeviceId, ErrorCode, InitializationBlock, Span, Status,
    StatusValue,
};

use super::control::Owner;
use super::{Now, Output, Robot, tell};
use crate::confirmation::{Said, Ticket, Unconfirmed};
use crate::device::{DeviceMachine, Effect, Rest};
use crate::hardware::{
    Asker, Hardware, OpenReading, ReadingId, START_NEAR, SensorReading, Standing, unanswered,
};
use crate::ids::LinkId;
#[cfg(feature = "host")]
use crate::signal::Signal;
#[cfg(feature = "host")]
use crate::tolerance::Tolerance;

/// Minimum time between acceptance and start of a command that must not start while the hardware is silent. This time is long enough to
/// ping the hardware.
const NOTICE: Span = Span::from_millis(200);

impl Robot {
    /// Creates a robot that drives hardware. The robot refuses all requests until [`Robot::hardware_found`] is called.
    #[must_use]
    pub fn driven(block: InitializationBlock) -> Self {
        let mut robot = Self { hardware: Hardware::awaited(), ..Self::new(block.and_answers_inquiries()) };
        robot.devices.iter_mut().for_each(DeviceMachine::forget_position);
        robot
    }

    /// Adds the latencies that the robot's driver declares to the initialization block. A spread of the latency in the block is kept.
    /// Devices that the driver does not list are unchanged.
    #[cfg(feature = "host")]
    pub(crate) fn declare_latencies(&mut self, declared: &BTreeMap<DeviceId, Duration>) {
        for (id, latency) in declared {
            let Some(index) = self.index_of.get(id) else { continue };
            let latency = Some(Span::from(*latency));
            if self.block.devices[*index].latency != latency {
                self.block.devices[*index].latency = latency;
            }
        }
    }

    /// Sets the maximum delays that the robot tolerates.
    #[cfg(feature = "host")]
    pub(crate) fn tolerating(mut self, tolerance: Tolerance) -> Self {
        self.tolerance = tolerance;
        self.plans.tolerance = tolerance;
        for device in &mut self.devices {
            device.start_late_max = tolerance.start;
        }
        self
    }

    /// Makes the robot report the end of a command, and confirm a stop, only after [`Robot::confirmed`] has been called for the last
    /// value.
    #[must_use]
    pub fn confirmed_by_its_driver(self) -> Self {
        Self { unconfirmed: Some(Unconfirmed::default()), ..self }
    }

    /// Records that the hardware has taken all values that preceded the [`Output::Confirm`] with this ticket.
    pub fn confirmed(&mut self, now: Now, ticket: Ticket, out: &mut Vec<Output>) {
        let Some((index, said)) = self.unconfirmed.as_mut().and_then(|all| all.take(ticket)) else { return };
        match said {
            Said::Report(happened, report) => self.report(now, index, happened, report, out),
            Said::Answer(link, answer) => self.answer(link, answer, out),
        }
    }

    /// Whether a confirmation by the hardware is pending.
    pub(crate) fn awaits_confirmation(&self) -> bool {
        self.unconfirmed.as_ref().is_some_and(|unconfirmed| !unconfirmed.is_empty())
    }

    /// Sends the response to a stop once the hardware has taken the stop's values.
    pub(super) fn answer_stop(
        &mut self,
        link: LinkId,
        index: usize,
        answer: ControlResponse,
        out: &mut Vec<Output>,
    ) {
        let Some(unconfirmed) = &mut self.unconfirmed else { return self.answer(link, answer, out) };
        let device = answer.device_id.clone();
        let ticket = unconfirmed.add(index, Said::Answer(link, answer));
        out.push(Output::Confirm { ticket, device });
    }

    /// Sends failures instead of those reports about the device that await the hardware's confirmation, because it is unknown whether the
    /// hardware has taken the last value.
    fn fail_unconfirmed(&mut self, now: Now, index: usize, error: &ControlError, out: &mut Vec<Output>) {
        let given_up = self.unconfirmed.as_mut().map(|unconfirmed| unconfirmed.give_up(index));
        let message = format!("the hardware may not have accepted the last value: {}", error.message);
        let error = ControlError::new(error.code.clone(), message);
        for said in given_up.into_iter().flatten() {
            match said {
                Said::Report(_, Effect::Ended { command, link, request_id, steps_done, .. }) => {
                    let error = error.clone();
                    let steps_done = Some(steps_done);
                    let failed = Effect::Failed { command, link, request_id, error, steps_done };
                    self.report(now, index, now, failed, out);
                }
                Said::Report(happened, report) => self.report(now, index, happened, report, out),
                // The response is not remembered: the same stop may succeed when it is sent again.
                Said::Answer(link, answer) => {
                    let error = Some(error.clone());
                    tell(link, ControlResponse { status: Status::Failed, error, ..answer }, out);
                }
            }
        }
    }

    /// Records that the hardware is connected. Sets all speeds that were driven before to zero, because it is unknown whether the
    /// hardware took their last values. No movement starts.
    pub fn hardware_found(&mut self, now: Now, out: &mut Vec<Output>) {
        self.hardware.found();
        for index in 0..self.devices.len() {
            self.devices[index].rest_rates(now, &mut self.effects);
            self.move_device(now, index, out);
        }
    }

    /// Records the loss of the hardware. All waiting and running commands end, and all pending readings fail, as `Failed` with code
    /// `internal`.
    pub fn hardware_lost(&mut self, now: Now, reason: &str, out: &mut Vec<Output>) {
        self.hardware_failed(now, &format!("the hardware is not available: {reason}"), out);
    }

    /// Like [`Robot::hardware_lost`], but `why` is a complete sentence: the hardware may be connected and refuse a value.
    pub(crate) fn hardware_failed(&mut self, now: Now, why: &str, out: &mut Vec<Output>) {
        self.hardware.lost(why);
        let error = ControlError::new(ErrorCode::Internal, why);
        for index in 0..self.devices.len() {
            self.fail_unconfirmed(now, index, &error, out);
            self.devices[index].fail(now, &error, &mut self.effects);
            self.move_device(now, index, out);
            self.abandon_plans(now, index, &error);
            self.settle(now, index, out);
        }
        for open in self.hardware.abandon() {
            tell(open.link, ControlResponse::refusal(now, &open.request, error.clone()), out);
        }
    }

    /// Checks, before any other work, whether the robot was delayed and, if a start is near, whether the hardware answers. `silence`
    /// returns how long the hardware has been silent, or `None` if that is still acceptable.
    pub(crate) fn check_hardware(
        &mut self,
        now: Now,
        silence: impl FnOnce() -> Option<Span>,
        out: &mut Vec<Output>,
    ) {
        let near = now + START_NEAR.into();
        let start = self.next_start(NOTICE).filter(|start| *start <= near);
        self.give_up_overdue(now, self.tolerance.step, out);
        self.hardware_silent(now, start.and_then(|_| silence()), NOTICE, out);
    }

    /// Returns the earliest start of those pending commands that were accepted at least `notice` before their start.
    #[must_use]
    pub fn next_start(&self, notice: Span) -> Option<Now> {
        self.devices.iter().filter_map(|device| device.next_start(notice)).min()
    }

    /// Records that the hardware has been silent for so long that no start can be promised (`Some`), or that it answers again (`None`).
    /// Commands that are due to start during the silence end as `Failed` with code `internal`, if they were accepted at least `notice`
    /// before their start.
    pub fn hardware_silent(&mut self, now: Now, silence: Option<Span>, notice: Span, out: &mut Vec<Output>) {
        self.hardware.silent(silence);
        let Some(silence) = silence else { return };
        let error = unanswered(silence);
        for index in 0..self.devices.len() {
            if self.devices[index].next_start(notice).is_some_and(|start| start <= now) {
                self.devices[index].stop(now, &error, Rest::InPlace, &mut self.effects);
                self.settle(now, index, out);
            }
        }
    }

    /// Ends running commands with a step that is overdue by more than `late_max`, as `Failed` with code `late`. Such a delay means that
    /// the edge (the process that drives the hardware) was delayed, and the remaining steps would be out of sync. The affected devices
    /// come to rest.
    pub fn give_up_overdue(&mut self, now: Now, late_max: Span, out: &mut Vec<Output>) {
        for index in 0..self.devices.len() {
            let late = self.devices[index].overdue(now).filter(|late| *late > late_max);
            if let Some(late) = late {
                self.fail_late(now, index, &format!("the edge was delayed: a step is {late} late"), out);
            }
        }
    }

    /// Records that a value reached the hardware too late and was not set. Because the device is then not where it should be, its running
    /// command ends as `Failed` with code `late`, and the device comes to rest.
    pub fn value_stale(&mut self, now: Now, device: &DeviceId, late: Span, out: &mut Vec<Output>) {
        if let Some(&index) = self.index_of.get(device) {
            let why = format!("a value reached the hardware {late} late and was not set");
            self.fail_unconfirmed(now, index, &ControlError::new(ErrorCode::Late, why.clone()), out);
            self.fail_late(now, index, &why, out);
            self.devices[index].forget_position();
        }
    }

    fn fail_late(&mut self, now: Now, index: usize, why: &str, out: &mut Vec<Output>) {
        let error = ControlError::new(ErrorCode::Late, why);
        self.devices[index].stop(now, &error, Rest::InPlace, &mut self.effects);
        self.settle(now, index, out);
    }

    /// Records the result of a reading that was requested from the hardware. Ignores the result if the reading has already expired.
    pub fn reading_came(
        &mut self,
        now: Now,
        id: ReadingId,
        reading: Result<SensorReading, String>,
        out: &mut Vec<Output>,
    ) {
        let Some(OpenReading { link, request, .. }) = self.hardware.close(id) else { return };
        let reading = reading.and_then(|reading| {
            if reading.value.is_finite() {
                Ok(reading)
            } else {
                let value = reading.value;
                Err(format!("the hardware returned the reading {value}, expected a finite number"))
            }
        });
        match reading {
            Ok(SensorReading { value, taken }) => {
                let answer = ControlResponse {
                    status_value: StatusValue::Number(value),
                    request_id: request.request_id.clone(),
                    event_timestamp: taken,
                    ..ControlResponse::new(now, request.device_id, Status::Provide)
                };
                tell(link, answer, out);
            }
            Err(reason) => {
                let error = ControlError::new(ErrorCode::Internal, reason);
                tell(link, ControlResponse::refusal(now, &request, error), out);
            }
        }
    }

    /// Ends all commands and brings every device to rest, because the robot shuts down. Does nothing if no value was ever set, or if the
    /// hardware is away.
    pub fn shut_down(&mut self, now: Now, out: &mut Vec<Output>) {
        if !self.moved || self.hardware.away().is_some() {
            return;
        }
        for index in 0..self.devices.len() {
            self.stop(now, index, "the edge was shut down", Rest::InPlace, out);
        }
    }

    pub(super) fn ask_hardware(
        &mut self,
        now: Now,
        link: LinkId,
        request: &ControlRequest,
        max_delay: Option<f64>,
        out: &mut Vec<Output>,
    ) {
        // A request without a session belongs to the session that was last named on its link.
        let party = self.parties.party(link);
        let standing = match self.owner(now, link, request.session.as_ref()) {
            Owner::Nobody => Standing::Free,
            _ if self.parties.last_owner() == Some(party) => Standing::Owner,
            Owner::Asker | Owner::Another(_) => Standing::Stranger,
        };
        let asker = Asker { link, party, standing };
        match self.hardware.ask(now, asker, request, max_delay) {
            Ok(reading) => out.push(Output::Read { reading, sensor: request.device_id.clone() }),
            Err(error) => tell(link, ControlResponse::refusal(now, request, error), out),
        }
    }

    pub(super) fn give_up_readings(&mut self, now: Now, out: &mut Vec<Output>) {
        if self.hardware.next_wakeup().is_none_or(|at| at > now) {
            return;
        }
        for (open, error) in self.hardware.overdue(now) {
            tell(open.link, ControlResponse::refusal(now, &open.request, error), out);
        }
    }

    /// Returns the current signal of a device for a control type. `None` if there is no such device or signal.
    #[cfg(feature = "host")]
    pub(crate) fn signal(&self, device: &str, control_type: urrcp::ControlType) -> Option<Signal> {
        self.devices[*self.index_of.get(device)?].signal(control_type)
    }
}
