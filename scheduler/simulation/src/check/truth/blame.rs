//! Checks the failures in a report and their reasons: no robot is blamed for a fault outside of itself and its link.

use downbeat_plan::{RefillKind, refills_of_robots};
use downbeat_robot::set_log::{LogEntry, MotionKind};
use urrcp::{Command, ControlRequest, DeviceId, ErrorCode, RobotId, Span};

use super::Said;
use crate::check::movements::jumps_from_the_beginning;
use crate::draw::{BEGINS_AT, shows_within};
use crate::trajectory::JUMP;
use crate::{Fault, Happened, Network};
use downbeat_mission::{FailureKind, Progress, Standing};

impl Said<'_> {
    pub(super) fn blame(&self, wrong: &mut Vec<String>) {
        self.no_innocent(wrong);
        for robot in 0..self.facts.drawn().robots.len() {
            let Some(dropped) = self.facts.dropped[robot] else { continue };
            let why = self.facts.ran.history.iter().any(|(at, happened)| {
                *at <= dropped
                    && matches!(happened, Happened::Told(progress) if matches!(&**progress,
                        Progress::Failed(failure) if failure.robot == *self.facts.name(robot)))
            });
            if !why {
                wrong.push(format!("r{robot} was left out without a reason in the report"));
            }
        }
        for row in self.report.robots.iter().filter(|row| row.standing == Standing::Out) {
            let failed = self.report.failures.iter().any(|failure| failure.robot == row.robot);
            if !failed {
                wrong.push(format!("{} was left out, but the report does not give the reason", row.robot));
            }
        }
    }

    /// Checks that no robot is blamed that is honest and had no fault, if its link loses and delays nothing. Only its clock, or too
    /// little time to send scripts, can be a reason then. That the time is too short is measured or, if the link was unusually fast at
    /// first, shown by a script that arrives late.
    fn no_innocent(&self, wrong: &mut Vec<String>) {
        let drawn = self.facts.drawn();
        let steady = drawn.network == Network::Stream && drawn.tail == 0.0;
        let scheduler = self.facts.hits.iter().any(|hit| hit.robot.is_none());
        if !steady {
            return;
        }
        for failure in &self.report.failures {
            let measured =
                matches!(failure.kind, FailureKind::Clock { .. } | FailureKind::NoTimeToSend { .. });
            let Some(robot) = self.facts.index_of(&failure.robot).filter(|_| !measured) else { continue };
            let jumps =
                self.would_jump(robot, &failure.kind) || self.was_left_elsewhere(robot, &failure.kind);
            if jumps
                || self.had_no_time(robot, &failure.kind)
                || scheduler && blames_scheduler(&failure.kind)
                || self.followed_another_process(robot, &failure.kind)
            {
                continue;
            }
            let hit = self.facts.hits.iter().any(|hit| hit.is_of(robot));
            if self.facts.honest(robot) && !hit {
                wrong.push(format!("r{robot} is blamed, but nothing was wrong with it: {}", failure.kind));
            }
        }
    }

    /// Whether a failure may be due to an earlier process of the scheduler, if the mission was resumed. That process had stopped the
    /// robot, or never sent the script that the robot lacks, and the journal may not contain this.
    ///
    /// If the scheduler's clock was set in between, a script may seem older than a stop before it, and a report may seem too early.
    fn followed_another_process(&self, robot: usize, kind: &FailureKind) -> bool {
        let Some(resumed) = self.resumed_at else { return false };
        let mut faults = self.facts.drawn().faults.iter();
        let is_set = faults.any(|(_, fault)| matches!(fault, Fault::ServerClockStep { .. }));
        let is_stop = |request: &ControlRequest| matches!(&request.command, Command::Script(script) if script.is_empty());
        match kind {
            FailureKind::Claim { .. } => is_set,
            FailureKind::Script { error, .. } if error.code == ErrorCode::Cancelled => {
                is_set || self.facts.reached(robot, |at, request| at < resumed && is_stop(request))
            }
            FailureKind::Script { device, error } if error.code == ErrorCode::Internal => {
                let scripts = self.facts.acts.iter().flat_map(|act| act.of(robot));
                let mut scripts = scripts.filter(|script| script.promised.device == *device);
                scripts.any(|script| {
                    let name = Some(&script.promised.request_id);
                    !self.facts.reached(robot, |_, request| request.request_id.as_ref() == name)
                })
            }
            _ => false,
        }
    }

    /// Whether the failure rightly states that a device would jump. The robot states its positions, and a device that has never moved is
    /// not at the first position of an act.
    fn would_jump(&self, robot: usize, kind: &FailureKind) -> bool {
        let FailureKind::Position { device, reading, expected, .. } = kind else { return false };
        let drawn = &self.facts.drawn().robots[robot];
        let has_moved = self.facts.ran.logs[robot].iter().any(|entry| entry.device == *device);
        let shows = drawn.block.device(device.as_str()).and_then(shows_within).unwrap_or_default();
        (reading - BEGINS_AT).abs() <= shows
            && !has_moved
            && jumps_from_the_beginning(drawn, device, *expected)
    }

    /// Whether the failure is a wrong position, and a stop may have left the device there.
    fn was_left_elsewhere(&self, robot: usize, kind: &FailureKind) -> bool {
        let FailureKind::Position { device, reading, expected, .. } = kind else { return false };
        let mut log = self.facts.ran.logs[robot].iter().filter(|entry| entry.device == *device);
        let device = self.facts.drawn().robots[robot].block.device(device.as_str());
        let shows = device.and_then(shows_within).unwrap_or_default();
        let was_there = |entry: &LogEntry| {
            entry.motion == MotionKind::Slow || (entry.value - reading).abs() <= JUMP + shows
        };
        let was_there = (reading - BEGINS_AT).abs() <= shows || log.any(was_there);
        (reading - expected).abs() > JUMP && was_there && !self.facts.stopping.is_empty()
    }

    /// Whether a script arrived late because its device had free queue space for too short a time: shorter than an exchange on the link
    /// may take. The few exchanges of the greeting (at the start of the mission) may not show that.
    fn had_no_time(&self, robot: usize, kind: &FailureKind) -> bool {
        let FailureKind::Script { device, error } = kind else { return false };
        let drawn = &self.facts.drawn().robots[robot];
        if error.code != ErrorCode::Late || !drawn.block.reports {
            return false;
        }
        let longest = self.facts.drawn().delay.1 * 2 + drawn.slow;
        let queue = |id: &RobotId, device: &DeviceId| {
            let described = drawn.block.device(device.as_str()).filter(|_| *id == drawn.block.id);
            described.map(|device| device.script_queue)
        };
        let refills = refills_of_robots(self.facts.choreography(), queue, Span::ZERO);
        refills.iter().any(|refill| {
            refill.kind == RefillKind::Later && refill.device == *device && refill.time < longest
        })
    }
}

/// Whether the failure is the robot's own report that the scheduler was silent for too long or late. If the scheduler ended or stalled,
/// that report is true, and no other failure is permitted.
fn blames_scheduler(kind: &FailureKind) -> bool {
    match kind {
        FailureKind::Script { error, .. } => matches!(error.code, ErrorCode::LinkLost | ErrorCode::Late),
        _ => false,
    }
}
