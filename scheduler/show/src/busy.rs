//! When a robot moves: the times between steps whose values differ.

use downbeat_scripts::{Act, DeviceScript, FleetRobot};
use urrcp::{ControlType, DeviceId, Interpolation, RobotId, Step};

/// The intervals in which a robot moves during an act.
#[derive(Debug)]
pub(super) struct Busy<'a> {
    pub(super) robot: &'a RobotId,
    /// Start and end of each motion in milliseconds from the act's start. The motions are in any order. The start and the end of a jump
    /// are equal.
    pub(super) moves: Vec<(f64, f64)>,
}

/// Returns when each robot of an act moves, in the order of the act's plan. `robots` are the corresponding robots of the fleet, in the
/// same order.
pub(super) fn busy<'a>(act: &'a Act, robots: &[&FleetRobot]) -> Vec<Busy<'a>> {
    let moves = |(index, plan): (usize, &'a downbeat_scripts::RobotPlan)| {
        let robot = robots.get(index).copied();
        let scripts = plan.scripts.iter();
        let moves = scripts.flat_map(|script| {
            let begin = act.moves_at(&plan.robot, script).as_millis_f64();
            moves_of(script, begin, interpolation(robot, &script.device))
        });
        Busy { robot: &plan.robot, moves: moves.collect() }
    };
    act.plan.robots.iter().enumerate().map(moves).collect()
}

/// Returns how a device interpolates between steps, according to its robot's description. `None` if no description contains the device.
pub(super) fn interpolation(robot: Option<&FleetRobot>, device: &DeviceId) -> Option<Interpolation> {
    let block = robot.and_then(|robot| robot.init.as_ref())?;
    Some(block.device(device.as_str())?.interpolation)
}

/// Returns the start and end of each motion of a script, in milliseconds. `begin` is the start of the script's motion, in milliseconds.
fn moves_of(script: &DeviceScript, begin: f64, interpolation: Option<Interpolation>) -> Vec<(f64, f64)> {
    let steps = script.script.steps();
    let first = steps.first().map(|step| step.offset.get()).map(|at| (begin + at, begin + at));
    let between = steps.windows(2).filter_map(|pair| {
        let (from, to) = (begin + pair[0].offset.get(), begin + pair[1].offset.get());
        let holds = interpolation == Some(Interpolation::Hold);
        match (keeps_moving(&pair[0]), pair[0].setpoint == pair[1].setpoint) {
            (true, _) => Some((from, to)),
            (false, true) => None,
            (false, false) => Some(if holds { (to, to) } else { (from, to) }),
        }
    });
    first.into_iter().chain(between).collect()
}

/// Whether the device keeps moving after this step even if no step follows, because the step sets a speed or acceleration other than
/// zero.
fn keeps_moving(step: &Step) -> bool {
    let is_rate = matches!(step.setpoint.control_type, ControlType::Speed | ControlType::Acceleration);
    is_rate && step.setpoint.values().any(|value| value != 0.0)
}

#[cfg(test)]
mod tests {
    use urrcp::{Millis, Script, Setpoint, Span, StopCondition};

    use super::*;

    /// Checks the motions of a script that starts at 1 s and has a step every second.
    #[track_caller]
    fn check(
        control_type: ControlType,
        values: &[f64],
        interpolation: Interpolation,
        expected: &[(f64, f64)],
    ) {
        let millis = |second: usize| Millis::new(second as f64 * 1_000.0).unwrap();
        let step =
            |(second, value): (usize, &f64)| Step::new(millis(second), Setpoint::new(control_type, *value));
        let script = DeviceScript {
            device: "d".parse().unwrap(),
            start: millis(1),
            stop_condition: StopCondition::default(),
            script: Script::new(values.iter().enumerate().map(step).collect()).unwrap(),
            rest: Span::ZERO,
        };
        let found: Vec<_> = moves_of(&script, script.start.get(), Some(interpolation)).into_iter().collect();
        let seconds: Vec<_> = found.iter().map(|(from, to)| (from / 1_000.0, to / 1_000.0)).collect();
        assert_eq!(seconds, expected);
    }

    #[test]
    fn device_moves_linearly_or_jumps_between_different_values() {
        let values = [0.0, 5.0, 5.0, 1.0];
        check(ControlType::Position, &values, Interpolation::Linear, &[(1.0, 1.0), (1.0, 2.0), (3.0, 4.0)]);
        check(ControlType::Position, &values, Interpolation::Hold, &[(1.0, 1.0), (2.0, 2.0), (4.0, 4.0)]);
        check(ControlType::Position, &[], Interpolation::Linear, &[]);
    }

    #[test]
    fn constant_speed_is_movement_and_zero_speed_is_not() {
        let values = [0.0, 0.0, 2.0, 2.0, 0.0];
        let expected = [(1.0, 1.0), (2.0, 3.0), (3.0, 4.0), (4.0, 5.0)];
        check(ControlType::Speed, &values, Interpolation::Linear, &expected);
    }
}
