//! What goes wrong, and somebody who takes up what was left.

use super::{Item, World, options, participants};
use crate::journal::Fate;
use crate::mission::{Event, Loss, Mission};
use crate::simulation::{Fault, Happened};

impl World {
    pub(super) fn go_wrong(&mut self, fault: Fault) {
        self.note(Happened::Fault(fault));
        let now = self.now;
        match fault {
            Fault::RobotCrash { robot, back_after, told } => {
                let side = &mut self.robots[robot];
                side.collect();
                if side.machine.take().is_none() {
                    return;
                }
                let link = side.link.take();
                if let Some(link) = link.filter(|_| told) {
                    let reason = "the robot closed the connection".to_owned();
                    self.send_event(robot, link, Event::LinkDown { robot, loss: Loss::Closed, reason });
                }
                if let Some(after) = back_after {
                    self.put(now + after, Item::RobotBack(robot));
                }
            }
            Fault::RobotPause { robot, lasts } => self.robots[robot].paused_until = now + lasts,
            Fault::Partition { robot, lasts, breaks } => {
                let side = &mut self.robots[robot];
                side.partitioned_until = side.partitioned_until.max(now + lasts);
                if let Some(link) = side.link.filter(|_| breaks) {
                    let end = side.partitioned_until;
                    self.put(end, Item::RobotLinkDown { robot, link });
                    let (loss, reason) = (Loss::Unreachable, "connection timed out".to_owned());
                    let event = Box::new(Event::LinkDown { robot, loss, reason });
                    self.put(end, Item::ToScheduler { robot, link, event, session: self.life });
                }
            }
            Fault::ClockStep { robot, by } => {
                let side = &mut self.robots[robot];
                side.clock_steps += by;
                if let Some(machine) = &mut side.machine {
                    machine.step_clock(by);
                }
            }
            Fault::SchedulerCrash { resumed_after } => {
                if self.mission.take().is_none() {
                    return;
                }
                self.life += 1;
                self.waiting.clear();
                for robot in 0..self.robots.len() {
                    if let Some(link) = self.links[robot].take() {
                        let at = now + self.drawn.delay.1;
                        self.put(at, Item::RobotLinkDown { robot, link });
                    }
                }
                if let Some(after) = resumed_after {
                    self.put(now + after, Item::Resume);
                }
            }
            Fault::SchedulerPause { lasts } => self.paused_until = now + lasts,
            Fault::Stop => self.tell(Event::StopRequested),
        }
    }

    /// What `downbeat resume` does.
    pub(super) fn resume(&mut self) {
        if self.mission.is_some() || self.kept.outcome.is_some() {
            return;
        }
        let participants = participants(&self.drawn);
        self.recorded = 0;
        let fate = self.kept.fate();
        let resumed = match &fate {
            Fate::Resume => Mission::resume(
                self.drawn.choreography.clone(),
                participants.clone(),
                options(),
                &self.kept,
                self.now,
            )
            .ok(),
            Fate::Withdraw(_) => None,
        };
        let how = if resumed.is_some() { "resumed" } else { "withdrawn" };
        self.note(Happened::TakenUp(how));
        self.mission = Some(
            resumed
                .unwrap_or_else(|| Mission::withdraw(participants, options(), &self.kept.touched, self.now)),
        );
        for robot in 0..self.robots.len() {
            self.put(self.now, Item::Connect { robot, session: self.life });
        }
    }
}
