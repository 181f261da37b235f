//! Checks the report's row for each robot over all acts, and the result of the robot's stop.

use downbeat_robot::set_log::MotionKind;
use urrcp::{Server, Timestamp};

use super::Said;
use crate::check::DRIFT;
use crate::check::cause::{Cause, Hit};
use crate::{Happened, Lie};
use downbeat_mission::report::{RobotReport, StopState};
use downbeat_mission::{DeviceReport, DeviceState, FailureKind, Join, Outcome, Progress, Record};

impl Said<'_> {
    pub(super) fn rows(&self, wrong: &mut Vec<String>) {
        for row in &self.report.robots {
            let Some(robot) = self.facts.index_of(&row.robot) else { continue };
            self.sums(row, wrong);
            self.claims(robot, row, wrong);
            self.links(row, wrong);
            if self.facts.rests_as_reported(robot) {
                self.stop(robot, row, wrong);
            }
        }
        self.totals(wrong);
    }

    /// Checks that a row is the sum of the robot's data in the acts.
    fn sums(&self, row: &RobotReport, wrong: &mut Vec<String>) {
        if self.report.acts_omitted > 0 {
            return;
        }
        let of_robot = |robot: &&downbeat_mission::ActRobot| robot.robot == row.robot;
        let robots = self.report.acts.iter().flat_map(|act| &act.robots).filter(of_robot);
        let scripts: Vec<&DeviceReport> = robots.flat_map(|robot| &robot.devices).collect();
        let sum = |what: fn(&DeviceReport) -> u64| scripts.iter().map(|script| what(script)).sum::<u64>();
        let open = |state| {
            use DeviceState::{Accepted, Sent, Started, Unknown};
            matches!(state, Sent | Accepted | Started | Unknown)
        };
        let unaccounted = scripts.iter().filter(|script| open(script.state)).count();
        let error = scripts.iter().filter_map(|script| script.start_error).map(|error| error.abs()).max();
        let said = [
            ("scripts", row.scripts as u64, scripts.len() as u64),
            ("steps planned", row.steps_planned, sum(|script| script.steps_planned as u64)),
            ("steps done", row.steps_done, sum(|script| u64::from(script.steps_done))),
            ("late steps", row.late_steps, sum(|script| u64::from(script.late_steps))),
            ("scripts unaccounted for", row.unaccounted as u64, unaccounted as u64),
        ];
        for (what, said, truth) in said.into_iter().filter(|(_, said, truth)| said != truth) {
            wrong.push(format!(
                "the total for {} is reported as {said} {what}, but its acts have {truth}",
                row.robot
            ));
        }
        if row.started == row.scripts && row.accepted != (row.scripts > 0) {
            wrong.push(format!(
                "{} is reported with {} started scripts, but accepted is {}",
                row.robot, row.started, row.accepted
            ));
        }
        if row.start_error.map(urrcp::Span::abs) != error {
            wrong.push(format!(
                "the largest start error of {} is reported as {:?}, but its acts report {error:?}",
                row.robot, row.start_error
            ));
        }
    }

    /// Checks that a robot is reported to have reconnected at least as often as the operator was informed that it is back.
    fn links(&self, row: &RobotReport, wrong: &mut Vec<String>) {
        let back = |(_, happened): &&(Timestamp<Server>, Happened)| match happened {
            Happened::Told(progress) => {
                matches!(&**progress, Progress::Reattached { robot } if *robot == row.robot)
            }
            _ => false,
        };
        let since =
            self.facts.ran.history.iter().filter(|(at, _)| self.resumed_at.is_none_or(|from| *at >= from));
        let told = since.filter(back).count();
        let joins = self.facts.drawn().join == Join::NextAct;
        if !joins && told > row.reconnects as usize {
            wrong.push(format!(
                "{} reconnected {told} times, but the report says {}",
                row.robot, row.reconnects
            ));
        }
    }

    /// Checks that a report of success credits no robot with more steps than its scripts have, and that the number of started scripts is
    /// true.
    fn claims(&self, robot: usize, row: &RobotReport, wrong: &mut Vec<String>) {
        let drawn = &self.facts.drawn().robots[robot];
        let lies = drawn.lie == Some(Lie::TooManySteps) && drawn.block.reports;
        if lies && row.scripts > 0 && self.report.outcome == Outcome::Done {
            wrong.push(format!(
                "reported as done, although {} claimed more steps than its scripts have",
                row.robot
            ));
        }
        if !self.facts.honest(robot) {
            return;
        }
        let began = |script: &&super::super::facts::SentScript<'_>| script.began();
        let truth = self.facts.acts.iter().flat_map(|act| act.of(robot)).filter(began).count();
        if row.started > truth {
            wrong.push(format!(
                "{} is reported to have started {} scripts, but it started {truth}",
                row.robot, row.started
            ));
        }
        let sure = !row.stop.is_unconfirmed() && row.unaccounted == 0;
        if sure && !self.is_withdrawn && !self.is_discredited(robot) && row.started != truth {
            wrong.push(format!(
                "{} started {truth} scripts, but the report states {} with certainty",
                row.robot, row.started
            ));
        }
    }

    /// Checks that the reported stop is consistent with the robot's subsequent behaviour.
    fn stop(&self, robot: usize, row: &RobotReport, wrong: &mut Vec<String>) {
        let ended = self.ended();
        let (rests_from, what) = match row.stop {
            StopState::Confirmed | StopState::Home => {
                let confirmed = self.facts.ran.records.iter().any(
                    |(_, record)| matches!(record, Record::StopConfirmed { robot } if *robot == row.robot),
                );
                if !confirmed {
                    wrong
                        .push(format!("{} is reported to have confirmed its stop, but never did", row.robot));
                }
                (ended, "the stop that it is reported to have confirmed")
            }
            StopState::TakenOver => (
                ended,
                "another mission took it over and the report said that no commands of this mission were left on it",
            ),
            // A process that stalled, or whose clock was set back, continues with a script that the report lists as unknown.
            StopState::NotSent if row.unaccounted > 0 => {
                let later = self.stood_still(robot) + self.set_back(robot) + DRIFT;
                let what = "the end of the mission plus the time for which its process stalled or its clock was set back";
                (ended.map(|ended| ended + later), what)
            }
            StopState::NotSent => {
                (ended, "the end of the mission, although the report says that it needed no stop")
            }
            StopState::Unconfirmed { lease_ends } => {
                let grace = DRIFT + self.slowest(robot);
                let ends = lease_ends.filter(|_| !self.facts.clock_was_set(robot));
                let ends = ends.map(|ends| ends - self.facts.ran.server_ahead);
                (ends.map(|ends| ends + grace), "the reported end of its lease")
            }
        };
        let Some(rests_from) = rests_from else { return };
        let beyond = self.facts.ran.logs[robot].iter().find(|entry| {
            let at = Timestamp::<Server>::from_nanos(entry.true_ns);
            matches!(entry.motion, MotionKind::Set | MotionKind::Ramp) && at > rests_from
        });
        if let Some(entry) = beyond {
            wrong.push(format!("{} moved after {what}, {rests_from}: {entry:?}", row.robot));
        }
    }

    /// Returns the maximum time from sending a message until a robot processes it. Includes the longest delay of a message or stall of
    /// the process, because a lease is measured from receipt of a message.
    pub(super) fn slowest(&self, robot: usize) -> urrcp::Span {
        let slow = |cause| matches!(cause, Cause::Slow | Cause::RobotPause | Cause::Partition);
        let hits = self.facts.hits.iter().filter(|hit| hit.is_of(robot) && slow(hit.cause));
        hits.map(|hit| hit.until - hit.from).max().unwrap_or_default() + self.facts.drawn().delay.1
    }

    /// The longest stall of the robot's process.
    fn stood_still(&self, robot: usize) -> urrcp::Span {
        let stood = |hit: &&Hit| hit.is_of(robot) && hit.cause == Cause::RobotPause;
        let hits = self.facts.hits.iter().filter(stood);
        hits.map(|hit| hit.until - hit.from).max().unwrap_or_default()
    }

    /// The total amount by which the robot's clock was set back.
    fn set_back(&self, robot: usize) -> urrcp::Span {
        let set = self.facts.hits.iter().filter(|hit| hit.is_of(robot) && hit.cause == Cause::ClockSet);
        set.map(|hit| urrcp::Span::ZERO - hit.by.min(urrcp::Span::ZERO))
            .fold(urrcp::Span::ZERO, |sum, by| sum + by)
    }

    /// Checks that the totals of the report are consistent with its acts.
    fn totals(&self, wrong: &mut Vec<String>) {
        let report = self.report;
        let first = report.acts.first();
        if report.start != first.map(|act| act.start) || report.lead != first.map(|act| act.lead) {
            wrong.push("the start and lead in the report differ from those of its first act".to_owned());
        }
        if report.spread != report.acts.iter().filter_map(|act| act.spread).max() {
            wrong.push(format!(
                "the largest spread is reported as {:?}, which does not match the acts",
                report.spread
            ));
        }
        let told = |from: Option<Timestamp<Server>>| {
            let told = self.facts.ran.history.iter().filter(|(at, happened)| match happened {
                Happened::Told(progress) => {
                    from.is_none_or(|from| *at >= from) && matches!(&**progress, Progress::Failed(_))
                }
                _ => false,
            });
            told.count()
        };
        let garbled = |kind: &FailureKind| matches!(kind, FailureKind::Garbled { .. });
        let failures = report.failures.iter().filter(|failure| !garbled(&failure.kind)).count();
        // The disk of a process that ended may have lost its last failures.
        let (least, most) = (told(self.resumed_at), told(None));
        if !(least..=most).contains(&failures) {
            wrong.push(format!("{failures} failures are reported, but {least} to {most} are expected"));
        }
    }
}
