//! The current link of each robot.

use crate::{Event, IndexVec, RobotIndex};

/// Identifies a link of a mission. Numbers are in the order in which the links were made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkNumber(pub u64);

/// The newest link of each robot, until it breaks.
#[derive(Debug)]
pub(super) struct Links {
    current: IndexVec<RobotIndex, Option<LinkNumber>>,
    made: u64,
}

impl Links {
    pub(super) fn new(robots: usize) -> Self {
        Self { current: vec![None; robots].into(), made: 0 }
    }

    /// Registers a new link to a robot in place of its current link, and returns the number of the new link.
    pub(super) fn connect(&mut self, robot: RobotIndex) -> LinkNumber {
        let link = LinkNumber(self.made);
        self.made += 1;
        self.current[robot] = Some(link);
        link
    }

    pub(super) fn of(&self, robot: RobotIndex) -> Option<LinkNumber> {
        self.current[robot]
    }

    pub(super) fn broke(&mut self, robot: RobotIndex) {
        self.current[robot] = None;
    }

    /// Whether to pass an event to the mission: only events of the robot's current link, and none after that link has broken.
    pub(super) fn takes(&mut self, robot: RobotIndex, link: LinkNumber, event: &Event) -> bool {
        let counts = self.current[robot] == Some(link);
        if counts && matches!(event, Event::LinkDown { .. }) {
            self.broke(robot);
        }
        counts
    }
}
