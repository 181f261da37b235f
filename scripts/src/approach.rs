//! Acts that move devices to the positions that other acts expect, for the start of a choreography or after a stop.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, Interpolation, RobotId, Span};

use crate::compile::poses::{self, DeviceWay, settable, unused_name};
use crate::finding::Finding;
use crate::fleet::Fleet;
use crate::home::{largest_speeds, transfer};
use crate::plan::{Act, Choreography, Positions, Wait, Way};

/// Settings of the movement of devices to their first positions.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Approach {
    /// Duration of the movement to the first positions.
    #[serde(rename = "over_ms")]
    pub over: Span,
    /// Positions of devices before the movement. Devices without an entry are not moved.
    pub from: Positions,
}

impl Approach {
    /// Whether `act` may be the name of a generated approach (an act that moves devices to their first positions). A scenario may also
    /// contain an act of that name.
    #[must_use]
    pub fn may_be_named(act: &str) -> bool {
        let number = |rest: &str| rest.strip_prefix('-').is_some_and(|number| number.parse::<u32>().is_ok());
        act.strip_prefix(NAME).is_some_and(|rest| rest.is_empty() || number(rest))
    }
}

const NAME: &str = "approach";

/// Adds an act before `first` that moves devices to their first positions in `first` and the acts that follow it. Returns the
/// choreography and the index of its first act. The new act is compiled like any other: within the limits of the devices and, as far as
/// bodies are known, without collisions. Lamps, and devices already at their first position, are not moved. If no device has to move, no
/// act is added.
///
/// # Errors
/// Returns the errors in the new act, for example a movement that a device cannot make in [`Approach::over`].
pub fn add_approach(
    mut choreography: Choreography,
    first: usize,
    fleet: &Fleet,
    approach: &Approach,
) -> Result<(Choreography, usize), Vec<Finding>> {
    let Some(act) = choreography.acts.get(first) else { return Ok((choreography, first)) };
    let uses = choreography.first_uses(first);
    let firsts = uses.iter().filter_map(|first| choreography.first_position(*first));
    let ways = ways_to(&choreography, firsts, fleet, &approach.from);
    if ways.is_empty() {
        return Ok((choreography, first));
    }
    let standing = poses::standing(fleet, &approach.from);
    let mut ahead = poses::compiled("--approach", &ways, &standing, approach.over)?;
    let name = unused_name(NAME, &choreography.acts);
    poses::name_like(&mut ahead, name, &choreography.scenario, act);
    for act in &mut choreography.acts {
        for way in [&mut act.next, &mut act.on_timeout] {
            if let Way::Act(index) = way {
                *index += 1;
            }
        }
        act.on_failure.then = act.on_failure.then.map(|index| index + 1);
    }
    ahead.next = Way::Act(first + 1);
    choreography.acts.insert(0, ahead);
    Ok((choreography, 0))
}

/// Plans an act that moves devices from the positions `from` to their first positions in the act `to` or in the acts after it. The act is
/// planned in the same way as by [`plan_home`](crate::plan_home), with the settings of `to`. If `to` waits for the operator, the new act
/// waits, too.
///
/// Returns `None` if no device has to move.
///
/// # Errors
/// Returns the errors in the new act, for example a collision.
pub fn plan_approach(
    choreography: &Choreography,
    to: usize,
    fleet: &Fleet,
    from: &Positions,
) -> Result<Option<Act>, Vec<Finding>> {
    let Some(act) = choreography.acts.get(to) else { return Ok(None) };
    let uses = choreography.first_uses(to);
    let firsts = uses.iter().filter_map(|first| choreography.first_position(*first));
    let ways = ways_to(choreography, firsts, fleet, from);
    let mut ahead = transfer(choreography, NAME, to, ways, fleet, from)?;
    if let Some(ahead) = ahead.as_mut().filter(|_| act.wait == Wait::Operator) {
        ahead.wait = Wait::Operator;
    }
    Ok(ahead)
}

/// Returns the movements of devices from `from` to `positions`. Lamps, and devices whose current position is unknown, are not moved.
fn ways_to<'a>(
    choreography: &'a Choreography,
    positions: impl Iterator<Item = (&'a RobotId, &'a DeviceId, f64)>,
    fleet: &Fleet,
    from: &Positions,
) -> Vec<DeviceWay<'a>> {
    let speeds = largest_speeds(choreography);
    let listed: HashMap<_, _> = fleet.robots.iter().map(|robot| (&robot.id, robot)).collect();
    let mut ways = Vec::new();
    for (robot, device, to) in positions {
        let block = listed.get(robot).and_then(|listed| listed.init.as_ref());
        let described = block.and_then(|block| block.device(device.as_str()));
        let from = from.get(robot).and_then(|devices| devices.get(device));
        let (Some(described), Some(&from)) = (described, from) else { continue };
        let moves = described.interpolation == Interpolation::Linear || speeds.contains_key(&(robot, device));
        let from = settable(described, from);
        if moves && from != to {
            ways.push(DeviceWay { robot, device, from, to });
        }
    }
    ways
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Address;
    use crate::compile::compile;
    use crate::files::NoFiles;
    use crate::finding::Code;
    use crate::fleet::FleetRobot;
    use crate::source::Source;

    fn show() -> (Choreography, Fleet) {
        let block = serde_json::from_str(poses::ARM).unwrap();
        let robots = vec![FleetRobot::new("arm".parse().unwrap(), Address::Simulated, Some(block))];
        let fleet = Fleet { robots, ..Fleet::default() };
        let text = "scenario: show
acts:
  - {act: one, next: two, cues: [{at: 0s, robots: arm, tracks: {joint: [{at: 0s, to: 0}, {at: 2s, to: 30, ease: smooth}], lamp: [{at: 0s, to: 50}]}}]}
  - {act: two, cues: [{at: 0s, robots: arm, tracks: {joint: [{at: 0s, to: 30}, {at: 2s, to: 0}]}}]}
";
        let compiled = compile(&Source { name: "show.yaml".into(), text: text.into() }, &fleet, &NoFiles);
        (compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings)), fleet)
    }

    fn approach(seconds: i64, joint: f64) -> Approach {
        let devices = [("joint", joint), ("lamp", 10.0)];
        let devices = devices.map(|(device, position)| (device.parse().unwrap(), position));
        let from = [("arm".parse().unwrap(), devices.into_iter().collect())];
        Approach { over: Span::from_millis(seconds * 1_000), from: from.into_iter().collect() }
    }

    #[test]
    fn approach_moves_devices_to_their_first_positions_but_not_lamps() {
        let (show, fleet) = show();
        let (show, first) = add_approach(show, 0, &fleet, &approach(5, 80.0)).unwrap();
        let names: Vec<_> = show.acts.iter().map(|act| act.name.as_str()).collect();
        assert_eq!((first, names), (0, vec!["approach", "one", "two"]));
        let ways: Vec<_> = show.acts.iter().map(|act| act.next).collect();
        assert_eq!(ways, [Way::Act(1), Way::Act(2), Way::End]);
        let [script] = show.acts[0].plan.robots[0].scripts.as_slice() else { panic!("only the joint moves") };
        let steps = script.script.steps();
        let ends = [steps[0].setpoint.value, steps[steps.len() - 1].setpoint.value];
        assert_eq!((ends, script.script.duration()), ([80.0, 0.0], Span::from_millis(5_000)));
    }

    #[test]
    fn device_first_moved_in_later_act_approaches_its_expected_position() {
        let (mut show, fleet) = show();
        let cue = &mut show.acts[1].plan.robots[0].scripts[0];
        cue.device = "still".parse().unwrap();
        let mut approach = approach(5, 0.0);
        let devices = approach.from.values_mut().next().unwrap();
        devices.insert("still".parse().unwrap(), 10.0);
        let mut linear = fleet.clone();
        let block = linear.robots[0].init.as_mut().unwrap();
        block.devices.iter_mut().for_each(|device| device.interpolation = Interpolation::Linear);
        let (show, _) = add_approach(show, 0, &linear, &approach).unwrap();
        let ends = |device: &str| {
            let mut scripts = show.acts[0].plan.robots[0].scripts.iter();
            let script = scripts.rfind(|script| script.device.as_str() == device).unwrap();
            script.script.steps().last().unwrap().setpoint.value
        };
        assert_eq!((show.acts[0].name.as_str(), ends("still"), ends("lamp")), ("approach", 30.0, 50.0));
    }

    #[test]
    fn too_fast_approach_is_refused_and_names_device() {
        let (show, fleet) = show();
        let findings = add_approach(show, 0, &fleet, &approach(1, 80.0)).unwrap_err();
        assert!(findings.iter().any(|finding| finding.message.contains("joint")), "{findings:?}");
    }

    #[test]
    fn approach_begins_at_the_valid_position_nearest_to_the_resting_place() {
        for (rests_at, from) in [(63.2174, 63.0), (-180.2, -180.0)] {
            let (show, fleet) = show();
            let (show, _) = add_approach(show, 0, &fleet, &approach(9, rests_at)).unwrap();
            let first = show.acts[0].plan.robots[0].first_positions().next().unwrap().1;
            assert!((first - from).abs() < 1e-9, "{rests_at}: {first}");
        }
    }

    #[test]
    fn after_stop_devices_move_to_starts_of_another_act_as_fast_as_allowed() {
        let (mut show, fleet) = show();
        show.acts[1].wait = Wait::Operator;
        // The act returns from `one` to `two`; only its first position matters.
        show.acts[1].next = Way::Act(0);
        let ahead = plan_approach(&show, 1, &fleet, &approach(0, 80.0).from).unwrap().unwrap();
        assert_eq!((ahead.name.as_str(), &ahead.wait, ahead.next), ("approach", &Wait::Operator, Way::End));
        let [script] = ahead.plan.robots[0].scripts.as_slice() else { panic!("only the joint moves") };
        let steps = script.script.steps();
        assert_eq!([steps[0].setpoint.value, steps[steps.len() - 1].setpoint.value], [80.0, 30.0]);
        // 1.875 * 50 / 60 = 1.5625 s, plus 2 %.
        assert_eq!(script.script.duration().as_millis_f64().round(), 1_594.0);
        assert_eq!(plan_approach(&show, 1, &fleet, &approach(0, 30.0).from).unwrap(), None);
    }

    /// Plans two acts for the arm, whose joint is at 80 degrees: one before the show, one after a stop. Another robot has stopped at 40
    /// degrees, on a rail `y` metres away from that of the arm.
    fn past_another(y: f64) -> [Result<Act, Vec<Finding>>; 2] {
        let (show, mut fleet) = show();
        let mut other = fleet.robots[0].clone();
        other.id = "other".parse().unwrap();
        let block = other.init.as_mut().unwrap();
        (block.id, block.devices[0].default_value) = (other.id.clone(), Some(-100.0));
        fleet.robots.push(other);
        poses::on_rails(&mut fleet, &[0.0, y]);
        let mut approach = approach(5, 80.0);
        approach.from.insert("other".parse().unwrap(), [("joint".parse().unwrap(), 40.0)].into());
        let ahead = add_approach(show.clone(), 0, &fleet, &approach);
        let after = plan_approach(&show, 0, &fleet, &approach.from);
        [ahead.map(|(show, _)| show.acts[0].clone()), after.map(Option::unwrap)]
    }

    #[test]
    fn approach_colliding_with_stationary_robot_is_refused() {
        for act in past_another(0.0) {
            let findings = act.unwrap_err();
            let collides = |finding: &Finding| finding.code == Code::TooClose;
            assert!(findings.iter().any(collides), "{findings:?}");
        }
        for act in past_another(0.5) {
            assert_eq!(act.unwrap().plan.robots.len(), 1);
        }
    }

    #[test]
    fn no_approach_is_added_if_devices_are_already_in_position() {
        let (show, fleet) = show();
        let (approached, first) = add_approach(show.clone(), 1, &fleet, &approach(5, 30.0)).unwrap();
        assert_eq!((approached, first), (show, 1));
    }
}
