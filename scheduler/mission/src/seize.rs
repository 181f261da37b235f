//! Takes over robots of other sessions for the operator, once every other robot of the mission is available and fits it.

use urrcp::{ControlError, ErrorCode, Server, Timestamp};

use super::failure_kind::FailureKind;
use super::robot_state::RobotState;
use super::{Mission, Phase, RobotIndex};

/// The owner of a robot, as far as the mission knows.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) enum Ownership {
    /// The robot belongs to this mission once it has answered.
    #[default]
    Asked,
    /// The robot belongs to another session. Contains the robot's refusal. The mission takes the robot over as soon as the others are
    /// greeted.
    OfAnother(ControlError),
    /// The robot was asked to leave the other session.
    Seizing,
    /// The robot was taken over from another session. Its devices may still be slowing down.
    Seized,
}

impl Mission {
    /// Handles a refusal of a robot that belongs to another session. Returns whether the mission is to take the robot over: the robot
    /// must have proven its identity, and must not have belonged to this mission before.
    pub(super) fn is_to_be_seized(&mut self, robot: RobotIndex, error: &ControlError) -> bool {
        let greeting = matches!(self.phase, Phase::Greeting { .. });
        let state = &mut self.robots[robot];
        let is_to_be = self.options.seize
            && greeting
            && error.code == ErrorCode::Busy
            && state.identity.proven
            && state.clock.samples() == 0
            && matches!(state.identity.ownership, Ownership::Asked | Ownership::OfAnother(_));
        if is_to_be {
            state.identity.ownership = Ownership::OfAnother(error.clone());
        }
        is_to_be
    }

    /// Takes over the robots of other sessions once all robots have answered, unless the mission would not start anyway. Returns whether
    /// such robots were asked and their answers are pending.
    pub(super) fn seize_others(&mut self, now: Timestamp<Server>) -> bool {
        if !self.robots.iter().any(RobotState::is_of_another) {
            return false;
        }
        if self.robots.iter().any(RobotState::has_failed) {
            self.leave_to_others();
            return false;
        }
        for robot in self.robots.indices() {
            if self.robots[robot].is_of_another() {
                let state = &mut self.robots[robot];
                state.identity.ownership = Ownership::Seizing;
                // The known positions are from when the robot belonged to the other session.
                state.forget_positions();
                self.ask_availability(now, robot);
            }
        }
        true
    }

    /// Fails the robots that belong to other sessions, because the mission does not take them over.
    pub(super) fn leave_to_others(&mut self) {
        for robot in self.robots.indices() {
            let ownership = &mut self.robots[robot].identity.ownership;
            if let Ownership::OfAnother(error) = ownership {
                let error = error.clone();
                *ownership = Ownership::Asked;
                self.note_failure(robot, FailureKind::NotAvailable { error });
            }
        }
    }

    /// Notes that a robot belongs to this mission. Its readings from before the takeover are discarded.
    pub(super) fn is_ours(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &mut self.robots[robot];
        match state.identity.ownership {
            Ownership::Seizing => {
                state.identity.ownership = Ownership::Seized;
                self.read_positions(now, robot);
                self.ask_positions(now, robot);
            }
            // The robot has become free meanwhile.
            Ownership::OfAnother(_) => {
                state.identity.ownership = Ownership::Asked;
                self.ask_positions(now, robot);
            }
            Ownership::Asked | Ownership::Seized => {}
        }
    }

    /// Whether a robot that was taken over is still moving to where the first keyframe expects it.
    pub(super) fn is_on_its_way(&self, robot: RobotIndex) -> bool {
        self.robots[robot].identity.ownership == Ownership::Seized && !self.misplaced(robot).is_empty()
    }

    /// Reads the positions of a robot again that was taken over and is still moving.
    pub(super) fn follow_on_its_way(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if self.robots[robot].has_shown_its_pose() && self.is_on_its_way(robot) {
            self.robots[robot].forget_positions();
            self.read_positions(now, robot);
            self.ask_positions(now, robot);
        }
    }
}
