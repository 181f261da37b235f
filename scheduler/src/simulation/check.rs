//! The invariants, held against what the robots really set.
//!
//! (a) An act starts on all of its robots or on none, but for the stated window: from one lease before the start on, when
//! the leases are being carried over it. (b) Nothing starts late, nothing twice. (c) After a confirmed stop, or when a lease
//! has run out, nothing moves. (d) No value outside the limits is set. (e) Every mission ends in a report that tells the
//! truth about every robot.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;

use downbeat_robot::LogEntry;
use urrcp::{ControlType, Server, Span, Timestamp};

use super::{Drawn, DrawnRobot, Fault, Happened, Lie, Ran};
use crate::mission::{ClockMode, Promise, Record};
use crate::report::{Outcome, RobotReport, StopState};

/// A clock that was set is seen at the next renewal, a second later where no lease asks for more.
const SEEN_AFTER: Span = Span::from_millis(1_100);
/// What a drifting clock may add to a lease or a start within a mission.
const DRIFT: Span = Span::from_millis(1);

/// Something that must not happen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Which invariant: a to e.
    pub invariant: char,
    /// What happened.
    pub what: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}) {}", self.invariant, self.what)
    }
}

/// How an act's starts came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Starts {
    /// Every robot started.
    All,
    /// None did.
    None,
    /// Some did, after a fault within the window.
    Mixed,
}

/// What is found of a run.
#[derive(Clone, Debug, Default)]
pub struct Verdict {
    /// What must not have happened.
    pub violations: Vec<Violation>,
    /// Each act that was sent.
    pub starts: Vec<Starts>,
}

impl Ran {
    /// Holds the invariants against what happened.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let mut verdict = Verdict::default();
        let mut check = Check { ran: self, verdict: &mut verdict };
        check.starts();
        check.once_and_in_time();
        check.stops_and_leases();
        check.limits();
        check.report();
        verdict
    }
}

struct Check<'a> {
    ran: &'a Ran,
    verdict: &'a mut Verdict,
}

impl<'a> Check<'a> {
    fn violated(&mut self, invariant: char, what: String) {
        self.verdict.violations.push(Violation { invariant, what });
    }

    const fn drawn(&self) -> &'a Drawn {
        &self.ran.drawn
    }

    fn honest(&self, robot: usize) -> bool {
        self.drawn().robots[robot].lie.is_none()
    }

    fn index_of(&self, id: &urrcp::RobotId) -> Option<usize> {
        self.drawn().robots.iter().position(|robot| robot.block.id == *id)
    }

    /// Its clock was set within the run: what it does by its clock says nothing of true time.
    fn clock_was_set(&self, robot: usize) -> bool {
        self.drawn()
            .faults
            .iter()
            .any(|(_, fault)| matches!(fault, Fault::ClockStep { robot: r, .. } if *r == robot))
    }

    /// How much earlier and how much later than planned the robot starts at most, as its clock was drawn: off by its offset,
    /// or where the offset is measured by what the paths there and back may differ.
    fn early_and_late(&self, robot: usize) -> (Span, Span) {
        let DrawnRobot { clock, settings, slow, .. } = &self.drawn().robots[robot];
        let paths = (self.drawn().delay.1 + *slow) / 2;
        let (early, late) = match clock {
            ClockMode::Measured => (paths, paths),
            ClockMode::Ntp => {
                (settings.clock_offset.max(Span::ZERO), (Span::ZERO - settings.clock_offset).max(Span::ZERO))
            }
        };
        (early + DRIFT, late + DRIFT)
    }

    fn promises(&self) -> Vec<(Timestamp<Server>, &'a Promise)> {
        let promise = |(at, record): &'a (Timestamp<Server>, Record)| match record {
            Record::Prepared(promise) => Some((*at, promise)),
            _ => None,
        };
        self.ran.records.iter().filter_map(promise).collect()
    }

    fn starts(&mut self) {
        let dropped: HashSet<_> = self
            .ran
            .records
            .iter()
            .filter_map(|(_, record)| match record {
                Record::Dropped { robot } => Some(robot.clone()),
                _ => None,
            })
            .collect();
        for (_, promise) in self.promises() {
            let mut members: BTreeMap<usize, Vec<&str>> = BTreeMap::new();
            for script in promise.scripts.iter().filter(|script| !dropped.contains(&script.robot)) {
                if let Some(robot) = self.index_of(&script.robot).filter(|robot| self.honest(*robot)) {
                    members.entry(robot).or_default().push(script.request_id.as_str());
                }
            }
            let stopped = self.ran.records.iter().find_map(|(at, record)| match record {
                Record::Stopping { .. } if *at > promise.timestamp => Some(*at),
                _ => None,
            });
            let begun = |(robot, ids): (&usize, &Vec<&str>)| {
                let of_act =
                    |entry: &LogEntry| entry.request_id.as_deref().is_some_and(|id| ids.contains(&id));
                self.ran.logs[*robot].iter().any(of_act)
            };
            // Whoever comes later in an act that was stopped on the way has not missed its start.
            let comes_later = |robot: usize| {
                let id = &self.drawn().robots[robot].block.id;
                let of_robot = promise.scripts.iter().filter(|script| script.robot == *id);
                let first = of_robot.map(|script| promise.start + script.start.span()).min();
                stopped.is_some_and(|at| at >= promise.start && first.is_some_and(|first| first >= at))
            };
            let started = members.iter().filter(|(robot, ids)| begun((robot, ids))).count();
            let missed = members.iter().filter(|(robot, ids)| !begun((robot, ids)) && !comes_later(**robot));
            let starts = match (started, missed.count()) {
                (0, _) => Starts::None,
                (_, 0) => Starts::All,
                _ => Starts::Mixed,
            };
            self.verdict.starts.push(starts);
            if starts == Starts::Mixed && !self.fault_in_window(promise) {
                let what = format!("act {} started on {started} of {} robots", promise.number, members.len());
                self.violated('a', what);
            }
        }
    }

    /// A fault from the instant on from which, as was stated at the decision, silence may be noticed too late, up to the
    /// start, or one that lasts into that time.
    fn fault_in_window(&self, promise: &Promise) -> bool {
        let doubt = self.ran.records.iter().find_map(|(_, record)| match record {
            Record::Decided { number, doubt, .. } if *number == promise.number => Some(*doubt),
            _ => None,
        });
        let from = promise.start - doubt.unwrap_or(promise.lease);
        let last = promise.scripts.iter().map(|script| promise.start + script.start.span()).max();
        let until = last.unwrap_or(promise.start) + Span::from_millis(150);
        let within = |at: Timestamp<Server>| at >= from && at <= until;
        // After the point of no return a stop, whatever it is for, may reach some before their start and others after it.
        let members = promise.scripts.iter().filter_map(|script| self.index_of(&script.robot));
        let (early, late) = members.fold((Span::ZERO, Span::ZERO), |(early, late), robot| {
            let (of_robot_early, of_robot_late) = self.early_and_late(robot);
            (early.max(of_robot_early), late.max(of_robot_late))
        });
        let returns = promise.start - self.drawn().delay.1 * 4 - early;
        let begun = promise.start + late;
        let late_stop =
            self.ran.records.iter().any(|(at, record)| {
                matches!(record, Record::Stopping { .. }) && *at >= returns && *at <= begun
            });
        late_stop
            || self.ran.history.iter().any(|(at, happened)| match happened {
                Happened::Lost(_) => within(*at),
                Happened::Slow(_, lasts) => *at <= until && *at + *lasts >= from,
                // A clock that is set after it was told when to start starts at another time.
                Happened::Fault(Fault::ClockStep { .. }) => {
                    *at >= promise.timestamp - SEEN_AFTER && *at <= until
                }
                Happened::Fault(fault) => {
                    let lasts = match fault {
                        Fault::Partition { lasts, .. }
                        | Fault::RobotPause { lasts, .. }
                        | Fault::SchedulerPause { lasts } => *lasts,
                        _ => Span::ZERO,
                    };
                    within(*at) || (*at < from && *at + lasts >= from)
                }
                _ => false,
            })
    }

    fn once_and_in_time(&mut self) {
        let mut found = Vec::new();
        for (robot, log) in self.ran.logs.iter().enumerate().filter(|(robot, _)| self.honest(*robot)) {
            let mut done: HashMap<(&str, u32), i64> = HashMap::new();
            for entry in log.iter().filter(|entry| entry.motion == "set") {
                let (Some(id), Some(step)) = (entry.request_id.as_deref(), entry.step) else { continue };
                if done.insert((id, step), entry.true_ns).is_some() {
                    found.push(format!("r{robot} did step {step} of {id} twice"));
                }
                let late = entry.set_at - entry.due;
                if step == 0 && late > Span::from_millis(51) && !self.clock_was_set(robot) {
                    found.push(format!("r{robot} started {id} {late} late"));
                }
            }
        }
        found.into_iter().for_each(|what| self.violated('b', what));
    }

    fn stops_and_leases(&mut self) {
        let mut found = Vec::new();
        let confirmed: Vec<_> = self
            .ran
            .records
            .iter()
            .filter_map(|(at, record)| match record {
                Record::StopConfirmed { robot } => Some((*at, self.index_of(robot)?)),
                _ => None,
            })
            .collect();
        let prepared: Vec<_> = self.promises().iter().map(|(at, _)| *at).collect();
        for (at, robot) in confirmed.into_iter().filter(|(_, robot)| self.honest(*robot)) {
            let next = prepared.iter().copied().filter(|next| *next >= at).min();
            let moved = self.ran.logs[robot].iter().find(|entry| {
                let moves = matches!(entry.motion, "set" | "ramp");
                let when = Timestamp::<Server>::from_nanos(entry.true_ns);
                moves && when > at && next.is_none_or(|next| when < next)
            });
            if let Some(entry) = moved {
                found.push(format!("r{robot} moved after its stop was confirmed: {entry:?}"));
            }
        }
        for robot in (0..self.drawn().robots.len()).filter(|robot| self.honest(*robot)) {
            found.extend(self.beyond_lease(robot));
        }
        found.into_iter().for_each(|what| self.violated('c', what));
    }

    /// A movement at which the robot had heard nothing for longer than the lease that held then.
    fn beyond_lease(&self, robot: usize) -> Option<String> {
        if self.clock_was_set(robot) {
            return None;
        }
        let heard: Vec<Timestamp<Server>> = self
            .ran
            .history
            .iter()
            .filter_map(|(at, happened)| match happened {
                Happened::AtRobot(r, _) if *r == robot => Some(*at),
                _ => None,
            })
            .collect();
        let leases: HashMap<&str, (Span, Option<Span>)> = self
            .promises()
            .iter()
            .flat_map(|(_, promise)| {
                promise.scripts.iter().map(|script| {
                    let leases = (promise.lease, script.running.map(urrcp::Millis::span));
                    (script.request_id.as_str(), leases)
                })
            })
            .collect();
        // A process that stood still may have been due for its lease's end meanwhile; it acts on it first when it goes on.
        let entries = self.ran.logs[robot].iter().filter(|entry| entry.motion == "set");
        for entry in entries {
            let Some((pending, running)) = entry.request_id.as_deref().and_then(|id| leases.get(id)) else {
                continue;
            };
            let due = entry.true_ns - (entry.set_at - entry.due).as_nanos();
            let at = Timestamp::<Server>::from_nanos(due);
            let lease = if entry.step == Some(0) { Some(*pending) } else { *running };
            // Of a script whose first step comes at its start either lease may hold at it.
            let lease = match (lease, running) {
                (Some(lease), Some(running)) if entry.step == Some(0) => Some(lease.max(*running)),
                (_, None) if entry.step == Some(0) => None,
                (lease, _) => lease,
            };
            let last = heard.iter().rev().find(|heard| **heard <= at);
            if let (Some(lease), Some(last)) = (lease, last)
                && at - *last > lease + DRIFT
            {
                return Some(format!(
                    "r{robot} moved {} after it was last heard of, its lease was {lease}",
                    at - *last
                ));
            }
        }
        None
    }

    fn limits(&mut self) {
        let mut found = Vec::new();
        for (robot, log) in self.ran.logs.iter().enumerate() {
            let block = &self.drawn().robots[robot].block;
            for entry in log.iter().filter(|entry| entry.control_type == "position") {
                let device = block.device(entry.device.as_str());
                let limits =
                    device.and_then(|device| device.available_control_types.limits(ControlType::Position));
                if limits.is_none_or(|l| entry.value < l.min_value || entry.value > l.max_value) {
                    found.push(format!("r{robot} set {} on `{}`", entry.value, entry.device));
                }
            }
        }
        found.into_iter().for_each(|what| self.violated('d', what));
    }

    fn report(&mut self) {
        if self.ran.hung {
            return self.violated('e', "the mission never ended".to_owned());
        }
        let Some(report) = &self.ran.report else { return };
        let mut found = Vec::new();
        let claims = |robot: &DrawnRobot| robot.lie == Some(Lie::TooManySteps) && robot.block.reports;
        for row in report.robots.iter().filter(|row| row.scripts > 0) {
            let claims = self.index_of(&row.robot).is_some_and(|robot| claims(&self.drawn().robots[robot]));
            if claims && report.outcome == Outcome::Done {
                found.push(format!("done, by the word of {} for more steps than there are", row.robot));
            }
        }
        for row in &report.robots {
            let Some(robot) = self.index_of(&row.robot).filter(|robot| self.honest(*robot)) else { continue };
            found.extend(self.row(robot, row, &report.outcome));
        }
        found.into_iter().for_each(|what| self.violated('e', what));
    }

    /// What a row of the report claims, held against what the robot did.
    fn row(&self, robot: usize, row: &RobotReport, outcome: &Outcome) -> Vec<String> {
        let mut found = Vec::new();
        // A scheduler that took the mission up tells of what it took up.
        let resumed = self.ran.history.iter().any(|(_, happened)| matches!(happened, Happened::TakenUp(_)));
        let crashed = self
            .drawn()
            .faults
            .iter()
            .any(|(_, fault)| matches!(fault, Fault::RobotCrash { robot: r, .. } if *r == robot));
        let reports = self.drawn().robots[robot].block.reports;
        let sets: HashSet<(&str, u32)> = self.ran.logs[robot]
            .iter()
            .filter(|entry| entry.motion == "set")
            .filter_map(|entry| Some((entry.request_id.as_deref()?, entry.step?)))
            .collect();
        let steps = sets.len() as u64;
        let moved = self.ran.logs[robot].iter().any(|entry| entry.request_id.is_some());
        if row.started > 0 && !moved {
            found.push(format!("{} is said to have started, and did not", row.robot));
        }
        if row.steps_done > steps {
            found.push(format!(
                "{} is said to have done {} steps, and did {steps}",
                row.robot, row.steps_done
            ));
        }
        let sure = !row.stop.is_unconfirmed() && row.unaccounted == 0;
        if !resumed && reports && *outcome == Outcome::Done && row.steps_done != row.steps_planned {
            found.push(format!("done, and {} did {} of {}", row.robot, row.steps_done, row.steps_planned));
        }
        if reports && !crashed && !resumed && moved && row.started == 0 && sure {
            found.push(format!("{} moved, and the report is sure that it did not", row.robot));
        }
        if *outcome == Outcome::NotStarted && moved && sure && reports && !crashed && !resumed {
            found.push(format!("not started, it says, and {} moved and is accounted for", row.robot));
        }
        if let StopState::Unconfirmed { lease_ends: Some(ends) } = row.stop
            && !self.clock_was_set(robot)
        {
            let grace = DRIFT + self.slowest(robot);
            let beyond = self.ran.logs[robot].iter().find(|entry| {
                matches!(entry.motion, "set" | "ramp") && entry.true_ns > (ends + grace).as_nanos()
            });
            if let Some(entry) = beyond {
                found.push(format!(
                    "{} moved after the end of its lease as reported, {ends}: {entry:?}",
                    row.robot
                ));
            }
        }
        found
    }

    /// The longest that a message to this robot was under way, or that it stood still: a lease counts from what it heard.
    fn slowest(&self, robot: usize) -> Span {
        let slow = self.ran.history.iter().filter_map(|(_, happened)| match happened {
            Happened::Slow(r, lasts) if *r == robot => Some(*lasts),
            Happened::Fault(Fault::RobotPause { robot: r, lasts }) if *r == robot => Some(*lasts),
            _ => None,
        });
        slow.max().unwrap_or_default() + self.drawn().delay.1
    }
}
