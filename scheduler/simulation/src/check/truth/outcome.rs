//! Checks the reported outcome of a mission and the reported fates of its acts.

use urrcp::{RobotId, Server, Span, Timestamp};

use super::Said;
use super::acts::error_by_its_clock;
use crate::Happened;
use crate::check::facts::{SentAct, SentScript};
use crate::check::situation::off_its_plan;
use downbeat_mission::report::RobotReport;
use downbeat_mission::{ActFate, Outcome, Progress, Record, Standing};

/// Maximum error of a measured clock, in addition to the round trip: the maximum drift in one minute.
const CLOCK_ERROR: Span = Span::from_millis(6);

impl Said<'_> {
    pub(super) fn outcome(&self, wrong: &mut Vec<String>) {
        match self.report.outcome {
            Outcome::Done => self.all_done(wrong),
            Outcome::DoneWithout => self.done_but_for_those_left_out(wrong),
            Outcome::NotStarted => self.nothing_moved(wrong),
            Outcome::Failed => self.has_a_reason(wrong),
            _ => {}
        }
        self.bound(wrong);
        self.course(wrong);
    }

    /// Checks that robots performed every step of every script of every act on time. By the robot's own clock, the start is within the
    /// tolerance, and later steps are on time or counted as late. Another invariant ensures that nothing happens twice.
    fn all_done(&self, wrong: &mut Vec<String>) {
        for act in self.facts.acts.iter().filter(|act| act.counts()) {
            for script in act.scripts.iter().filter(|script| self.facts.honest(script.robot)) {
                self.script_done(act, script, wrong);
            }
        }
        self.none_drifted(wrong);
        let ill = |row: &&RobotReport| row.standing != Standing::In || row.unaccounted > 0;
        if let Some(row) = self.report.robots.iter().find(ill) {
            wrong.push(format!(
                "reported as done, but {} is {:?} with {} scripts unaccounted for",
                row.robot, row.standing, row.unaccounted
            ));
        }
    }

    /// Checks that no robot with a measured clock deviated from the plan too much at the end of an act. The limit is the tolerance plus
    /// the clock's uncertainty.
    fn none_drifted(&self, wrong: &mut Vec<String>) {
        // In an act that was resumed, the mission compares robots only with each other.
        for act in self.facts.acts.iter().filter(|act| act.counts() && !self.facts.was_resumed(act)) {
            for robot in act.robots() {
                let Some(off) = off_its_plan(self.facts, act, robot) else { continue };
                let drawn = self.facts.drawn();
                let unknown =
                    drawn.delay.1 * 2 + drawn.robots[robot].slow + self.slowest(robot) * 2 + CLOCK_ERROR;
                if off > act.written.plan.start_tolerance + unknown {
                    wrong.push(format!(
                        "reported as done, but r{robot} was {off} off the plan at the end of act {}",
                        act.promise.number
                    ));
                }
            }
        }
    }

    fn script_done(&self, act: &SentAct<'_>, script: &SentScript<'_>, wrong: &mut Vec<String>) {
        let (robot, name) = (script.robot, script.promised.request_id.as_str());
        let (set, written) = (script.steps_set(), script.steps_written());
        if set != written {
            wrong.push(format!("reported as done, but r{robot} executed {set} of {written} steps of {name}"));
        }
        let Some(first) = script.log.first() else { return };
        let tolerance = act.written.plan.start_tolerance;
        let error = error_by_its_clock(act, script, first);
        if error.abs() > tolerance {
            wrong.push(format!("reported as done, but r{robot} started {name} {error} off its plan"));
        }
        let late = script.steps().map(|step| step.set_at - step.due).max();
        if let Some(late) = late.filter(|late| *late > tolerance && self.facts.counts_steps(script.robot)) {
            wrong.push(format!("reported as done, but r{robot} executed a step of {name} {late} late"));
        }
    }

    fn done_but_for_those_left_out(&self, wrong: &mut Vec<String>) {
        for act in self.facts.acts.iter().filter(|act| act.counts()) {
            for script in act.scripts.iter().filter(|script| self.facts.honest(script.robot)) {
                let knows = self.facts.drawn().robots[script.robot].block.reports;
                if self.facts.dropped[script.robot].is_none() && knows {
                    self.script_done(act, script, wrong);
                }
            }
        }
        if self.facts.dropped.iter().all(Option::is_none) && self.report.failures.is_empty() {
            wrong.push(
                "reported as done without the robots that failed, but no robot was left out".to_owned(),
            );
        }
    }

    /// Checks that no robot moved, except robots whose actions the report states to be unknown.
    fn nothing_moved(&self, wrong: &mut Vec<String>) {
        for row in &self.report.robots {
            let Some(robot) = self.facts.index_of(&row.robot).filter(|robot| self.facts.honest(*robot))
            else {
                continue;
            };
            let sure = !row.stop.is_unconfirmed() && row.unaccounted == 0;
            let moved = self.facts.ran.logs[robot].iter().any(|entry| entry.request_id.is_some());
            // A process that only withdraws the mission cannot know that such a robot started an undecided script.
            let is_known = !self.is_withdrawn || self.facts.drawn().robots[robot].block.pending_until;
            if moved && sure && is_known {
                wrong.push(format!("reported as not started, but {} moved, and the report does not list its actions as unknown", row.robot));
            }
        }
    }

    /// Checks that the report of a failed mission states the reason: a failure of a robot, an act that waited for too long, or a text.
    fn has_a_reason(&self, wrong: &mut Vec<String>) {
        let waited = self.report.course.iter().any(|act| matches!(act.fate, ActFate::TimedOut { .. }));
        if self.report.failures.is_empty() && self.report.because.is_none() && !waited {
            wrong.push("reported as failed, but without a reason".to_owned());
        }
    }

    /// Checks that no act begins beyond the maximum number of acts, even after another process has resumed the mission.
    fn bound(&self, wrong: &mut Vec<String>) {
        let drawn = self.facts.drawn();
        let written =
            |act: &&SentAct<'_>| act.counts() && act.promise.act.get() < drawn.choreography.acts.len();
        let begun = self.facts.acts.iter().filter(written).count();
        if let Some(most) = drawn.acts_max.filter(|most| begun > *most as usize) {
            wrong.push(format!("{begun} acts started, but at most {most} were allowed"));
        }
    }

    fn course(&self, wrong: &mut Vec<String>) {
        for (index, course) in self.report.course.iter().enumerate() {
            let sent: Vec<&SentAct<'_>> = self
                .facts
                .acts
                .iter()
                .filter(|act| act.promise.act.get() == index && !act.repeated)
                .collect();
            // The mission ended before it had sent the next attempt.
            let before_attempt = self.facts.acts.iter().rfind(|act| act.promise.act.get() == index);
            let before_attempt = before_attempt.is_some_and(|act| act.repeated);
            // If an act was played several times, the last time is relevant.
            let last = sent.last();
            let began = last.into_iter().flat_map(|act| &act.scripts).any(|script| {
                self.facts.honest(script.robot) && !self.facts.clock_was_set(script.robot) && script.began()
            });
            let after = last.map_or(Timestamp::from_nanos(0), |act| act.at);
            let skipped = self.told().rev().find_map(|(at, progress)| match progress {
                Progress::ActSkipped { act, fate } => {
                    (at >= after && *act == course.act && *fate == course.fate).then_some(at)
                }
                _ => None,
            });
            let ended = self.acts_ended(&course.act);
            // A process that resumes the mission does not know of an act that was prepared, but neither recorded nor sent.
            let arrived = sent.iter().filter(|act| self.has_arrived(act)).count();
            // The records of robots that were left out may be lost with a process that died; in that case, their actions are relevant.
            let was_played = |act: &SentAct<'_>| {
                self.has_one_left(act)
                    || self.has_lost_drops(act) && act.robots().iter().any(|robot| act.is_whole_on(*robot))
            };
            // A process that died may have sent the act, and the promise may have been lost with that process.
            let is_lost = last.is_some_and(|act| !self.facts.was_kept(act.at));
            let truth = match &course.fate {
                ActFate::NotReached => sent.is_empty() || is_lost && !began,
                ActFate::StillWaiting => sent.len() == ended || is_lost && !began,
                ActFate::NobodyLeft => {
                    let all = sent.len() == ended || is_lost && arrived <= ended;
                    all && skipped.is_some_and(|at| self.nobody_left(index, at))
                }
                ActFate::TimedOut { .. } => sent.len() == ended && skipped.is_some(),
                ActFate::Withdrawn => before_attempt || last.is_some() && !began,
                ActFate::Stopped => last.is_some(),
                ActFate::Unknown => {
                    let known = last.copied().into_iter().chain(self.last_reported(index));
                    ended > 0 && known.into_iter().any(|act| self.has_one_unknown(act))
                }
                ActFate::Played => ended > 0 && last.is_some_and(|act| was_played(act)),
            };
            let with_robots = sent.iter().filter(|act| was_played(act)).count();
            if !truth || course.played as usize > ended.min(with_robots) {
                let sent = sent.len();
                wrong.push(format!(
                    "`{}` is reported as {:?} (sent {sent} times, started: {began})",
                    course.act, course.fate
                ));
            }
        }
    }

    fn told(&self) -> impl DoubleEndedIterator<Item = (Timestamp<Server>, &Progress)> {
        self.facts.ran.history.iter().filter_map(|(at, happened)| match happened {
            Happened::Told(progress) => Some((*at, progress.as_ref())),
            _ => None,
        })
    }

    /// Whether, when an act was skipped, each of its robots had been left out or was absent. Robots may be absent from the start or
    /// because of their own faults.
    fn nobody_left(&self, act: usize, skipped: Timestamp<Server>) -> bool {
        let came_later = |robot: usize| {
            let name = self.facts.name(robot);
            let came = self.told().any(|(at, progress)| match progress {
                Progress::Reattached { robot } => at > skipped && robot == name,
                _ => false,
            });
            came && self.facts.hits.iter().any(|hit| hit.is_of(robot) && hit.from <= skipped)
        };
        let plays = |robot: &RobotId| {
            let row = self.report.robots.iter().find(|row| row.robot == *robot);
            let there = |robot: usize| {
                self.facts.drawn().robots[robot].there_from == Span::ZERO && !came_later(robot)
            };
            row.is_none_or(|row| row.standing == Standing::In)
                && self.facts.index_of(robot).is_some_and(there)
        };
        !self.facts.drawn().choreography.acts[act].plan.robots.iter().any(|robot| plays(&robot.robot))
    }

    /// Whether at least one robot of an act had not been left out when the act ended. If both happened at the same instant, the order of
    /// the records decides.
    fn has_one_left(&self, act: &SentAct<'_>) -> bool {
        let records = &self.facts.ran.records;
        let ended = records.iter().position(|(_, record)| match record {
            Record::ActEnded { report, .. } => report.number == act.promise.number,
            _ => false,
        });
        let dropped = |robot: usize| {
            let name = self.facts.name(robot);
            records
                .iter()
                .position(|(_, record)| matches!(record, Record::Dropped { robot } if robot == name))
        };
        let left = |robot: &usize| match (dropped(*robot), ended) {
            (Some(dropped), Some(ended)) => dropped > ended,
            (dropped, _) => dropped.is_none(),
        };
        act.robots().iter().any(left)
    }

    /// Whether a process that resumed the mission may not have known that a robot of an act had been left out.
    fn has_lost_drops(&self, act: &SentAct<'_>) -> bool {
        let dropped = act.robots().into_iter().filter_map(|robot| self.facts.dropped[robot]);
        dropped.into_iter().any(|at| !self.facts.was_kept(at))
    }

    /// Returns the last attempt to play an act that the report contains. The disk may have lost the records of a later attempt that was
    /// withdrawn.
    fn last_reported(&self, index: usize) -> Option<&SentAct<'_>> {
        let states =
            |act: &SentAct<'_>| self.report.acts.iter().any(|said| said.number == act.promise.number);
        self.facts.acts.iter().rfind(|act| act.promise.act.get() == index && states(act))
    }

    /// Whether, when an act ended, at least one robot had scripts whose outcome is not known.
    fn has_one_unknown(&self, act: &SentAct<'_>) -> bool {
        self.facts.ran.records.iter().any(|(_, record)| match record {
            Record::ActEnded { report, flaws, .. } => {
                report.number == act.promise.number && !flaws.unaccounted.is_empty()
            }
            _ => false,
        })
    }

    /// Whether a script of an act has reached a robot.
    fn has_arrived(&self, act: &SentAct<'_>) -> bool {
        self.facts.ran.history.iter().any(|(_, happened)| match happened {
            Happened::AtRobot(_, urrcp::Message::ControlRequest(request)) => act
                .scripts
                .iter()
                .any(|script| request.request_id.as_ref() == Some(&script.promised.request_id)),
            _ => false,
        })
    }

    /// How often the end of an act was reported.
    fn acts_ended(&self, name: &str) -> usize {
        let ended = self.facts.ran.history.iter().filter(|(_, happened)| match happened {
            Happened::Told(progress) => {
                matches!(&**progress, Progress::ActEnded { act } if *act == name)
            }
            _ => false,
        });
        ended.count()
    }
}
