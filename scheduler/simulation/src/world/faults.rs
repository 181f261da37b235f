//! Applies faults to the simulated world.

use super::scheduler::SchedulerFault;
use super::{Item, Machine, World};
use crate::draw::stranger;
use crate::{Direction, Fault, Happened};
use downbeat_mission::{Event, Loss, Rest};

impl World {
    pub(super) fn go_wrong(&mut self, fault: Fault) {
        // Faults that wait for a number of actions are recorded when they take effect.
        if !matches!(fault, Fault::SchedulerCrashAmid { .. } | Fault::SchedulerPauseAmid { .. }) {
            self.note(Happened::Fault(fault));
        }
        let now = self.kernel.now;
        match fault {
            Fault::RobotCrash { robot, back_after, told } => {
                if self.robot_dies(robot, if told { Machine::Up } else { Machine::Down })
                    && let Some(after) = back_after
                {
                    self.kernel.put(now + after, Item::RobotBack(robot));
                }
            }
            Fault::RobotPause { robot, lasts } => self.kernel.robots.stall(robot, now + lasts),
            Fault::AnotherRobot { robot, lasts } => {
                self.robot_dies(robot, Machine::Up);
                let block = stranger(&self.drawn.robots[robot].block);
                self.robot_begins(robot, block);
                self.kernel.put(now + lasts, Item::RobotBack(robot));
            }
            Fault::Twin { robot, lasts } => {
                self.twin_begins(robot);
                self.kernel.put(now + lasts, Item::RobotBack(robot));
            }
            Fault::HardwareDies { robot, back_after, told } => self.hardware_dies(robot, back_after, told),
            Fault::ForeignSession { robot, lasts } => self.foreign_session(robot, lasts),
            Fault::Seize { robot, lasts } => self.seize(robot, lasts),
            Fault::ClockStep { robot, by } => {
                self.robots[robot].clock_steps += by;
                self.kernel.robots.change(robot, |machine| machine.step_clock(by));
            }
            Fault::ServerClockStep { by } => self.scheduler.clock_of_machine += by,
            Fault::SchedulerCrash { resumed_after } => self.crash_scheduler(fault, resumed_after),
            Fault::SchedulerCrashAmid { actions, resumed_after } => {
                self.scheduler.light_fuse(actions, SchedulerFault::Dies { resumed_after });
            }
            Fault::SchedulerPauseAmid { actions, lasts } => {
                self.scheduler.light_fuse(actions, SchedulerFault::Stalls { lasts });
            }
            Fault::SchedulerPause { lasts } => {
                self.scheduler.paused_until = now + lasts;
                // On a real machine, either order is possible.
                self.scheduler.timers_first = self.drawn.seed.is_multiple_of(2);
            }
            Fault::DiskStalls { lasts } => self.scheduler.disk_stands_still_until = now + lasts,
            Fault::Stop => self.tell(Event::StopRequested { rest: Rest::InPlace, by: None }),
            Fault::Home => self.tell(Event::StopRequested { rest: Rest::Home, by: None }),
            Fault::StopByJournal => self.stop_by_journal(),
            Fault::Partition { .. }
            | Fault::OneWay { .. }
            | Fault::DeadLink { .. }
            | Fault::HalfOpen { .. }
            | Fault::SlowLink { .. }
            | Fault::Lag { .. } => self.link_goes_wrong(fault),
        }
    }

    fn link_goes_wrong(&mut self, fault: Fault) {
        let now = self.kernel.now;
        match fault {
            Fault::Partition { robot, lasts, breaks } => {
                let side = &mut self.robots[robot];
                let there = side.path.block(Direction::ToRobot, now + lasts);
                let end = there.max(side.path.block(Direction::FromRobot, now + lasts));
                if let Some(link) = side.link.filter(|_| breaks) {
                    self.kernel.put(end, Item::RobotLinkDown { robot, link });
                    self.link_breaks(robot, link, end, Loss::Unreachable, "connection timed out");
                }
            }
            Fault::OneWay { robot, way, lasts } => {
                self.robots[robot].path.block(way, now + lasts);
            }
            Fault::DeadLink { robot, lasts } => {
                let side = &mut self.robots[robot];
                side.dead_until = side.dead_until.max(now + lasts);
                side.dead.extend(side.link);
                self.kernel.put(now + lasts, Item::DeadLinksEnd(robot));
            }
            Fault::HalfOpen { robot } => {
                let side = &mut self.robots[robot];
                side.dead.extend(side.link);
                if let Some(link) = side.link {
                    self.robot_link_down(robot, link);
                }
            }
            Fault::SlowLink { robot, bandwidth, lasts } => {
                self.robots[robot].path.slow = Some((bandwidth, now + lasts));
            }
            Fault::Lag { robot, by, lasts } => self.robots[robot].path.lag = Some((by, now + lasts)),
            _ => {}
        }
    }
}
