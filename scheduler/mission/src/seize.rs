//! Robots of other sessions that the operator takes: once every other robot of the mission is there and fits it.

use urrcp::{ControlError, ErrorCode, Server, Timestamp};

use super::failure_kind::FailureKind;
use super::robot_state::RobotState;
use super::{Mission, Phase};

/// To whom a robot belongs, as far as the mission knows.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) enum Ownership {
    /// To this mission, once it has answered.
    #[default]
    Asked,
    /// To another session; it is taken as soon as the others are greeted. With its refusal.
    OfAnother(ControlError),
    /// It was asked to leave the other session.
    Seizing,
    /// It was taken from another session. Its devices may still be slowing down.
    Seized,
}

impl Mission {
    /// A robot refuses because it belongs to another session. `true` where it is to be taken: a robot that has proven who it is,
    /// as only such a one lets itself be taken, and that has not yet been this mission's.
    pub(super) fn is_to_be_seized(&mut self, robot: usize, error: &ControlError) -> bool {
        let greeting = matches!(self.phase, Phase::Greeting { .. });
        let state = &mut self.robots[robot];
        let is_to_be = self.options.seize
            && greeting
            && error.code == ErrorCode::Busy
            && state.proven
            && state.clock.samples() == 0
            && matches!(state.ownership, Ownership::Asked | Ownership::OfAnother(_));
        if is_to_be {
            state.ownership = Ownership::OfAnother(error.clone());
        }
        is_to_be
    }

    /// All robots have been heard: takes those of other sessions, unless the mission would not start anyway. `true` where some were
    /// asked, and their answers are awaited.
    pub(super) fn seize_others(&mut self, now: Timestamp<Server>) -> bool {
        if !self.robots.iter().any(RobotState::is_of_another) {
            return false;
        }
        if self.robots.iter().any(RobotState::has_failed) {
            self.leave_to_others();
            return false;
        }
        for robot in 0..self.robots.len() {
            if self.robots[robot].is_of_another() {
                let state = &mut self.robots[robot];
                state.ownership = Ownership::Seizing;
                // Where they stood while the other session had them.
                state.forget_positions();
                self.ask_availability(now, robot);
            }
        }
        true
    }

    /// The robots of other sessions are not available after all.
    pub(super) fn leave_to_others(&mut self) {
        for robot in 0..self.robots.len() {
            let ownership = &mut self.robots[robot].ownership;
            if let Ownership::OfAnother(error) = ownership {
                let error = error.clone();
                *ownership = Ownership::Asked;
                self.note_failure(robot, FailureKind::NotAvailable { error });
            }
        }
    }

    /// A robot answers that it belongs to this mission. What it was read before it was taken counts no more.
    pub(super) fn is_ours(&mut self, now: Timestamp<Server>, robot: usize) {
        let state = &mut self.robots[robot];
        match state.ownership {
            Ownership::Seizing => {
                state.ownership = Ownership::Seized;
                self.read_positions(now, robot);
                self.ask_positions(now, robot);
            }
            // It has become free meanwhile.
            Ownership::OfAnother(_) => {
                state.ownership = Ownership::Asked;
                self.ask_positions(now, robot);
            }
            Ownership::Asked | Ownership::Seized => {}
        }
    }

    /// Whether a robot that was taken is still on the way to where the first keyframe expects it.
    pub(super) fn is_on_its_way(&self, robot: usize) -> bool {
        self.robots[robot].ownership == Ownership::Seized && !self.misplaced(robot).is_empty()
    }

    /// Reads again where such a robot stands.
    pub(super) fn follow_on_its_way(&mut self, now: Timestamp<Server>, robot: usize) {
        if self.robots[robot].has_shown_its_pose() && self.is_on_its_way(robot) {
            self.robots[robot].forget_positions();
            self.read_positions(now, robot);
            self.ask_positions(now, robot);
        }
    }
}
