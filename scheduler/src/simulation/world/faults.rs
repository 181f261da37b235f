//! What goes wrong.

use super::{Item, Machine, World};
use crate::mission::{Event, Loss};
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
                side.runs_on = if told { Machine::Up } else { Machine::Down };
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
                    self.put(end, Item::ToScheduler { robot, link, event });
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
                if !self.scheduler.is_running() {
                    return;
                }
                self.kill_scheduler();
                if let Some(after) = resumed_after {
                    self.put(now + after, Item::Resume);
                }
            }
            Fault::SchedulerPause { lasts } => self.scheduler.paused_until = now + lasts,
            Fault::Stop => self.tell(Event::StopRequested),
        }
    }
}
