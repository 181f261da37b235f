//! The sensor readings that verify the motions of an act.

use urrcp::{Server, Timestamp};

use super::{Act, ActAction, Promised, PromisedStage, Stage};
use crate::RobotIndex;
use crate::motion::{MotionReport, Watched};
use crate::robot_state::{Reading, Robots};

impl Act {
    /// Starts to watch the first movement of each device whose position a sensor shows.
    pub(crate) fn verify_motions(&mut self, robots: &Robots) {
        self.watched = Watched::of(self, robots);
    }

    /// Requests the sensor readings that are due to verify motions.
    pub(super) fn watch_motions(&mut self, now: Timestamp<Server>) -> Vec<ActAction> {
        use PromisedStage::{Committed, Playing};
        let Stage::Promised(Promised { timing, stage: Committed(_) | Playing(_) }) = &self.stage else {
            return Vec::new();
        };
        let (number, start, members, place) = (self.number, timing.start, &self.members, &self.place);
        let takes_part = |robot: RobotIndex| {
            place.get(robot.get()).copied().flatten().is_some_and(|place| members[place].takes_part())
        };
        let mut actions = Vec::new();
        for (index, watched) in self.watched.iter_mut().enumerate() {
            if takes_part(watched.robot()) && watched.due(start).is_some_and(|due| now >= due) {
                watched.ask(now);
                let what = Reading::Motion(number, index);
                let (robot, sensor) = (watched.robot(), watched.sensor().clone());
                actions.push(ActAction::Read { robot, sensor, what });
            }
        }
        actions
    }

    pub(super) fn motion_due(&self) -> Option<Timestamp<Server>> {
        let start = self.timing()?.start;
        let here = |watched: &&Watched| {
            self.place_of(watched.robot()).is_some_and(|place| self.members[place].takes_part())
        };
        self.watched.iter().filter(here).filter_map(|watched| watched.due(start)).min()
    }

    pub(crate) fn motion_read(&mut self, index: usize, arrived: Timestamp<Server>, value: Option<f64>) {
        if let Some(watched) = self.watched.get_mut(index) {
            watched.answered(arrived, value);
        }
    }

    /// Returns the reports on the motions that sensors have verified.
    pub(crate) fn motions(&self, robots: &Robots) -> Vec<MotionReport> {
        let Some(timing) = self.timing() else { return Vec::new() };
        let watched = self.watched.iter();
        watched.map(|watched| watched.report(timing.start, &robots[watched.robot()])).collect()
    }
}
