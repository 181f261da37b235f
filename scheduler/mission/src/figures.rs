//! The current status and counts of a mission and of one of its robots, for external monitoring.

use urrcp::Span;

use super::robot_state::{Link, RobotState, Standing, Totals};
use super::{Mission, Phase, RobotIndex};
use crate::clock::ClockReading;

/// The phase of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhaseName {
    /// The mission queries and checks the robots.
    Greeting,
    /// Acts wait, are prepared, or play.
    Performing,
    /// The mission stops the robots.
    Stopping,
    /// The mission has ended, and its report is ready.
    Ended,
}

/// Status and counts of one robot over all acts, including those under way.
#[derive(Clone, Debug)]
pub struct RobotFigures {
    /// Whether the robot has a link.
    pub is_linked: bool,
    /// Whether the robot takes part in the mission.
    pub takes_part: bool,
    /// The estimate of the robot's clock, relative to the server's clock.
    pub clock: Option<ClockReading>,
    /// The round trip of the robot's link, without rare outliers.
    pub round_trip: Span,
    /// The counts of the robot's scripts and steps.
    pub totals: Totals,
    /// Whether a stop was sent to the robot and the robot has not confirmed that it is at rest.
    pub awaits_stop: bool,
}

impl Mission {
    /// Returns the status and the counts of the robot with this index.
    #[must_use]
    pub fn figures_of(&self, robot: RobotIndex) -> RobotFigures {
        let state: &RobotState = &self.robots[robot];
        let mut totals = state.totals;
        for act in self.acts.iter().filter(|act| act.was_sent()) {
            let Some(member) = act.member(robot) else { continue };
            member.scripts().iter().for_each(|script| totals.add(script, act.start_error(member, script)));
        }
        RobotFigures {
            is_linked: matches!(state.link, Link::Up { .. }),
            takes_part: state.standing == Standing::In,
            clock: state.clock.reading(),
            round_trip: state.round_trip(),
            totals,
            awaits_stop: state.stop_was_sent() && !state.is_settled(),
        }
    }

    /// Returns how many acts wait, how many approach their start, and how many play, in this order.
    #[must_use]
    pub fn act_stages(&self) -> [u64; 3] {
        let mut stages = [0; 3];
        for act in &self.acts {
            let stage = match (act.was_sent(), act.is_playing(), act.is_over()) {
                (false, ..) => 0,
                (true, false, false) => 1,
                (true, true, _) => 2,
                (true, false, true) => continue,
            };
            stages[stage] += 1;
        }
        stages
    }

    /// Returns the phase of the mission.
    #[must_use]
    pub const fn phase_name(&self) -> PhaseName {
        match self.phase {
            Phase::Greeting { .. } => PhaseName::Greeting,
            Phase::Performing => PhaseName::Performing,
            Phase::Stopping { .. } => PhaseName::Stopping,
            Phase::Ended => PhaseName::Ended,
        }
    }

    /// Returns the number of rounds of questions to the robots that were so late that this machine must have stalled.
    #[must_use]
    pub const fn rounds_held_up(&self) -> u64 {
        self.machine.rounds_held_up
    }
}
