//! The virtual driver of a mission: the same mission machine and the same robot machines, time jumps from event to event.
//!
//! At one instant robots go first, in the order of the plan, then what they sent reaches the mission, then the mission's
//! own timers: the order of the real driver.

use std::collections::HashMap;

use downbeat_robot::simulated::{Outgoing, SimulatedRobot, True};
use downbeat_robot::{Input, LinkId, LogEntry};
use downbeat_scripts::Plan;
use urrcp::{DeviceId, Server, Span, Timestamp};

use crate::mission::{Action, Event, Mission, Progress};
use crate::report::Report;

/// When virtual time begins: 2026-01-01T00:00:00Z.
pub const BEGIN: Timestamp<Server> = Timestamp::from_nanos(1_767_225_600_000_000_000);

/// Every robot has one link.
const LINK: LinkId = LinkId(0);

/// What a mission did in virtual time.
#[derive(Debug)]
pub struct Played {
    /// As after a real mission.
    pub report: Report,
    /// What each robot set, in the order of the plan.
    pub logs: Vec<Vec<LogEntry>>,
    /// What the operator would have seen.
    pub progress: Vec<(Timestamp<Server>, Progress)>,
}

/// Plays a mission to its end with simulated robots in the order of the plan. The server's clock is the true one.
#[must_use]
pub fn play(mission: Mission, robots: Vec<SimulatedRobot>) -> Played {
    let mut world = World { open: vec![true; robots.len()], mission, robots, progress: Vec::new() };
    for robot in 0..world.robots.len() {
        world.tell_mission(BEGIN, Event::LinkUp { robot });
    }
    let mut now = BEGIN;
    let mut report = loop {
        world.advance_robots(now);
        let due = world.mission.advance(now);
        world.perform(now, due);
        if let Some(report) = world.mission.report() {
            break report;
        }
        match world.next_wakeup() {
            Some(next) => now = now.max(next),
            // Nothing will ever happen again: no robot and no timer is due.
            None => break world.mission.report_as_left(),
        }
    };
    let logs: Vec<_> = world.robots.iter_mut().map(SimulatedRobot::take_log).collect();
    report.true_spread = report.start.and_then(|start| true_spread(world.mission.plan(), start, &logs));
    Played { report, logs, progress: world.progress }
}

/// Largest minus smallest error of the scripts' first steps, by true time instead of the robots' own.
fn true_spread(plan: &Plan, start: Timestamp<Server>, logs: &[Vec<LogEntry>]) -> Option<Span> {
    let mut errors = Vec::new();
    for (robot, log) in plan.robots.iter().zip(logs) {
        // A device's scripts begin in the order of the plan.
        let mut begun: HashMap<&DeviceId, usize> = HashMap::new();
        for script in &robot.scripts {
            let nth = begun.entry(&script.device).or_default();
            let mut firsts = log.iter().filter(|entry| {
                entry.device == script.device && entry.motion == "set" && entry.step == Some(0)
            });
            let (first, offset) = (firsts.nth(*nth)?, script.script.steps().first()?.offset);
            let planned = start + script.start.span() + offset.span();
            errors.push(Span::from_nanos(first.true_ns - planned.as_nanos()));
            *nth += 1;
        }
    }
    Some(*errors.iter().max()? - *errors.iter().min()?)
}

struct World {
    mission: Mission,
    robots: Vec<SimulatedRobot>,
    /// Links that the robots have not closed.
    open: Vec<bool>,
    progress: Vec<(Timestamp<Server>, Progress)>,
}

impl World {
    fn next_wakeup(&self) -> Option<Timestamp<Server>> {
        let robots = self.robots.iter().filter_map(SimulatedRobot::next_wakeup);
        let robots = robots.map(Timestamp::assume_clock::<Server>);
        robots.chain(self.mission.next_wakeup()).min()
    }

    fn advance_robots(&mut self, now: Timestamp<Server>) {
        let mut out = Vec::new();
        for robot in 0..self.robots.len() {
            self.robots[robot].advance(now.assume_clock::<True>(), &mut out);
            for outgoing in out.drain(..) {
                let event = match outgoing {
                    Outgoing::Message { message, .. } => Event::Received { robot, message },
                    Outgoing::Close { .. } => {
                        Event::LinkDown { robot, reason: "the robot closed the link".to_owned() }
                    }
                };
                if self.open[robot] {
                    self.open[robot] = !matches!(event, Event::LinkDown { .. });
                    self.tell_mission(now, event);
                }
            }
        }
    }

    fn tell_mission(&mut self, now: Timestamp<Server>, event: Event) {
        let actions = self.mission.handle(now, event);
        self.perform(now, actions);
    }

    fn perform(&mut self, now: Timestamp<Server>, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Send { robot, message } if self.open[robot] => {
                    self.robots[robot].receive(now.assume_clock(), LINK, Input::Message(message));
                }
                Action::Send { .. } => {}
                Action::Tell(progress) => self.progress.push((now, progress)),
            }
        }
    }
}

#[cfg(test)]
mod tests;
