//! Steps 1 to 4 of the protocol with all robots at once: links, availability and clocks, initialization blocks.

use urrcp::{
    AvailabilityRequest, AvailabilityResponse, ControlError, ErrorCode, InitializationBlock,
    InitializationRequest, Message, Server, Status, Timestamp,
};

use super::robot_state::{FailureKind, Link, RobotState};
use super::{Greeting, Mission, Phase, Progress};
use crate::clock::ClockSample;
use crate::report::Outcome;

/// Exchanges of timestamps with each robot before the decision.
const CLOCK_SAMPLES: u32 = 8;

impl Mission {
    pub(super) fn link_up(&mut self, now: Timestamp<Server>, robot: usize) {
        self.robots[robot].link = Link::Up;
        if !matches!(self.phase, Phase::Greeting { .. }) {
            return;
        }
        if self.options.greeting == Greeting::Full {
            self.ask_availability(now, robot);
            let request = InitializationRequest { timestamp: Some(now) };
            self.send(now, robot, Message::InitializationRequest(request));
        }
        if self.robots.iter().all(|r| r.link == Link::Up) {
            self.tell(Progress::Connected { robots: self.robots.len() });
        }
        self.greeting_progress(now);
    }

    /// Asks for the robot's times; also renews all leases on its link.
    pub(super) fn ask_availability(&mut self, now: Timestamp<Server>, robot: usize) {
        self.robots[robot].asked_at = Some(now);
        self.send(
            now,
            robot,
            Message::AvailabilityRequest(AvailabilityRequest { timestamp: Some(now), session: None }),
        );
    }

    pub(super) fn availability(
        &mut self,
        now: Timestamp<Server>,
        robot: usize,
        response: &AvailabilityResponse,
    ) {
        if response.status == Status::Failed {
            let without = || ControlError::new(ErrorCode::Internal, "the robot gave no reason");
            let error = response.error.clone().unwrap_or_else(without);
            return self.fail(now, robot, FailureKind::NotAvailable { error });
        }
        if let Some(sent) = response.originate_timestamp {
            let sample =
                ClockSample::from_exchange(sent, response.receive_timestamp, response.timestamp, now);
            self.robots[robot].clock.add(sample);
        }
        self.robots[robot].asked_at = None;
        if matches!(self.phase, Phase::Greeting { .. }) {
            match self.robots[robot].clock.samples() < CLOCK_SAMPLES {
                true => self.ask_availability(now, robot),
                false => self.greeting_progress(now),
            }
        }
    }

    pub(super) fn introduced(&mut self, now: Timestamp<Server>, robot: usize, block: InitializationBlock) {
        if !matches!(self.phase, Phase::Greeting { .. }) || self.robots[robot].introduced {
            return;
        }
        self.robots[robot].introduced = true;
        let unfit = unfit(&self.robots[robot], &block);
        self.robots[robot].block = Some(block);
        for reason in unfit {
            self.fail(now, robot, FailureKind::Unfit { reason });
        }
        self.greeting_progress(now);
    }

    /// Goes on to prepare once every robot has been heard or has failed.
    pub(super) fn greeting_progress(&mut self, now: Timestamp<Server>) {
        let full = self.options.greeting == Greeting::Full;
        let heard = |robot: &RobotState| {
            let greeted = robot.introduced && robot.clock.samples() >= CLOCK_SAMPLES;
            robot.has_failed() || (robot.link == Link::Up && (!full || greeted))
        };
        if !matches!(self.phase, Phase::Greeting { .. }) || !self.robots.iter().all(heard) {
            return;
        }
        self.check_clocks();
        match self.robots.iter().any(RobotState::has_failed) {
            true => self.refuse(Outcome::NotStarted),
            false => {
                let offsets = self.robots.iter().filter_map(|r| r.clock.reading());
                let clock_offset_max = offsets.map(|reading| reading.offset.abs()).max();
                self.tell(Progress::Greeted { clock_offset_max });
                self.prepare(now);
            }
        }
    }

    /// Refuses robots whose clock is surely further off than the scenario tolerates.
    fn check_clocks(&mut self) {
        let tolerance = self.plan.start_tolerance;
        for index in 0..self.robots.len() {
            let Some(reading) = self.robots[index].clock.reading() else { continue };
            let uncertainty = reading.uncertainty + self.options.server_uncertainty;
            if reading.offset.abs() - uncertainty > tolerance {
                let kind = FailureKind::Clock { offset: reading.offset, uncertainty, tolerance };
                self.note_failure(index, kind);
            }
        }
    }

    pub(super) fn greeting_overdue(&mut self, now: Timestamp<Server>) {
        let within = self.options.patience;
        let full = self.options.greeting == Greeting::Full;
        for index in 0..self.robots.len() {
            let robot = &self.robots[index];
            let awaited = match robot.link {
                _ if robot.has_failed() => continue,
                Link::Connecting | Link::Down => "connection",
                Link::Up if full && robot.clock.samples() == 0 => "availability response",
                Link::Up if full && !robot.introduced => "initialization block",
                Link::Up if full && robot.clock.samples() < CLOCK_SAMPLES => "further availability responses",
                Link::Up => continue,
            };
            self.fail(now, index, FailureKind::Silent { awaited: awaited.to_owned(), within });
        }
    }

    /// Ends before anything has been sent that could move a robot.
    pub(super) fn refuse(&mut self, outcome: Outcome) {
        self.outcome = Some(outcome);
        self.end();
    }
}

/// Where a robot's own description does not allow what the plan asks of it.
fn unfit(robot: &RobotState, block: &InitializationBlock) -> Vec<String> {
    let mut reasons = Vec::new();
    if block.api_version.as_str().split('.').next() != Some("1") {
        reasons.push(format!("it speaks URRCP `{}`, expected version 1", block.api_version));
    }
    if let Some(listed) = robot.block.as_ref().filter(|listed| listed.id != block.id) {
        tracing::warn!(robot = %robot.id, "calls itself `{}`, the fleet file `{}`", block.id, listed.id);
    }
    for script in &robot.scripts {
        let id = &script.plan.device;
        let Some(device) = block.device(id.as_str()) else {
            reasons.push(format!("it has no device `{id}`"));
            continue;
        };
        let steps = script.plan.script.steps();
        let room = device.available_control_types.script().map_or(0, |s| s.max_number_of_steps as usize);
        if steps.len() > room {
            reasons.push(format!("device `{id}` takes {room} steps a script, the plan has {}", steps.len()));
        }
        let faults = steps.iter().enumerate().filter_map(|(i, step)| {
            let error = device.check_in_script(&step.setpoint).err()?;
            Some(format!("device `{id}` step {i}: {}", error.message))
        });
        // One robot with another unit would bury the others under its steps.
        reasons.extend(faults.take(3));
    }
    reasons
}
