//! Draws missions with twins: another process uses the id of a robot and answers in its place, while the robot continues to play. One
//! seed in a hundred is such a mission. The seed determines the stage at which the twin appears.

use fastrand::Rng;

use super::staged::{ATTEMPTS, with_fault};
use super::{Drawn, DrawnRobot, Fault, FaultKind, Names, draw_mission, millis, one_in};
use crate::Stage;

/// Replaces the faults of a mission by a twin, and in most missions adds a stop soon afterwards. `index` is the number of this mission
/// within its family.
pub(super) fn answer_by_twins(rng: &mut Rng, mut drawn: Drawn, index: u64) -> Drawn {
    let stage = Stage::ALL[usize::try_from(index).unwrap_or(0) % Stage::ALL.len()];
    for _ in 0..ATTEMPTS {
        if let Some(mut met) = with_fault(rng, drawn.clone(), FaultKind::Twin, stage) {
            let twin = met.faults.iter().find(|(_, fault)| matches!(fault, Fault::Twin { .. })).copied();
            if let Some((at, _)) = twin.filter(|_| !one_in(rng, 3)) {
                met.faults.push((at + millis(rng, 1, 1_000), Fault::Stop));
                met.faults.sort_by_key(|(at, _)| *at);
            }
            return met;
        }
        drawn = draw_mission(rng, drawn.seed);
    }
    drawn
}

/// Makes a robot and its twin answer inquiries, so that the mission can learn which scripts the answering process has.
pub(super) fn tell_what_they_know(robot: &mut DrawnRobot) {
    (robot.names, robot.lie) = (Names::Echoed, None);
    (robot.block.inquiry, robot.block.pending_until) = (true, true);
}

#[cfg(test)]
mod tests {
    use super::super::{TWINS, TWINS_EVERY, reached};
    use crate::Situation::MovesBehindTwin;

    #[test]
    fn robots_with_stopped_twins_still_move() {
        let reached = reached((TWINS, 20_000), TWINS_EVERY);
        assert!(reached.get(&MovesBehindTwin).is_some_and(|count| *count > 3), "{reached:?}");
    }
}
