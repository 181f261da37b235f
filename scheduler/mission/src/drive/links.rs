//! The current link of each robot.

use crate::Event;

/// Identifies a link of a mission. Numbers are in the order in which the links were made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkNumber(pub u64);

/// The newest link of each robot, until it breaks.
#[derive(Debug)]
pub(super) struct Links {
    current: Vec<Option<LinkNumber>>,
    made: u64,
}

impl Links {
    pub(super) fn new(robots: usize) -> Self {
        Self { current: vec![None; robots], made: 0 }
    }

    /// Registers a new link to a robot in place of its current link, and returns the number of the new link.
    pub(super) fn connect(&mut self, robot: usize) -> LinkNumber {
        let link = LinkNumber(self.made);
        self.made += 1;
        self.current[robot] = Some(link);
        link
    }

    pub(super) fn of(&self, robot: usize) -> Option<LinkNumber> {
        self.current[robot]
    }

    pub(super) fn broke(&mut self, robot: usize) {
        self.current[robot] = None;
    }

    /// Whether to pass an event to the mission: only events of the robot's current link, and none after that link has broken.
    pub(super) fn takes(&mut self, robot: usize, link: LinkNumber, event: &Event) -> bool {
        let counts = self.current[robot] == Some(link);
        if counts && matches!(event, Event::LinkDown { .. }) {
            self.broke(robot);
        }
        counts
    }
}
