//! The operator of a simulated mission, and the events that the mission waits for: the operator's go, or a sensor reading.

use downbeat_plan::Wait;

use super::{Item, World};
use crate::draw::BRIGHT;
use downbeat_mission::{Event, Progress};

impl World {
    /// When an act announces that it waits for an event, schedules that event, if it ever occurs.
    pub(super) fn hears(&mut self, progress: &Progress) {
        let Progress::Waiting { act, .. } = progress else { return };
        let acts = &self.drawn.choreography.acts;
        let Some(index) = acts.iter().position(|written| written.name == *act) else { return };
        if let Some(after) = self.drawn.comes_after[index] {
            self.kernel.put(self.kernel.now + after, Item::Comes(index));
        }
    }

    pub(super) fn comes(&mut self, act: usize) {
        match &self.drawn.choreography.acts[act].wait {
            Wait::Operator => self.tell(Event::Go { act: None, by: None }),
            Wait::Sensor { robot, .. } => {
                let robots = self.drawn.robots.iter();
                let read = robots.map(|drawn| drawn.block.id.as_str()).position(|id| id == robot);
                read.into_iter().for_each(|robot| self.reads(robot, BRIGHT + 1.0));
            }
            Wait::Done | Wait::TimeOfDay(_) | Wait::Instant(_) => {}
        }
    }
}
