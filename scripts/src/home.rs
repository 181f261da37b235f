//! Plans acts that move devices from the positions at which they stopped to their default positions or to other positions.

use std::collections::HashMap;

use urrcp::{DeviceId, Interpolation, RobotId, Span};

use crate::compile::poses::{self, DeviceWay, settable, unused_name};
use crate::finding::Finding;
use crate::fleet::Fleet;
use crate::motion::Easing;
use crate::plan::{Act, Choreography, FailurePolicy, OnFailure, Positions};

const NAME: &str = "home";
/// The shortest duration of a planned act.
const SHORTEST: Span = Span::from_millis(1_000);
/// The shortest duration of a planned act that linearly moves a device whose largest speed is unknown.
const WITHOUT_LIMIT: Span = Span::from_millis(5_000);
/// Largest fraction by which steps can be faster than the movement that they represent, because they are on a grid.
const SLACK: f64 = 0.02;
/// Maximum number of times that the duration is doubled because a device cannot move fast enough.
const DOUBLED_MAX: u32 = 4;

/// Plans an act that moves devices from the positions `from` to their default positions. The act is compiled like any other: within the
/// limits of the devices and, as far as bodies are known, without collisions. Its duration follows from the largest speeds. It is at
/// least 1 s, and at least 5 s if a device moves linearly and its largest speed is unknown. Devices without a default position do not
/// move. Leases and tolerances are those of the act `like`.
///
/// Returns `None` if every device is already at its default position.
///
/// # Errors
/// Returns the errors in the planned act, for example a collision.
pub fn plan_home(
    choreography: &Choreography,
    like: usize,
    fleet: &Fleet,
    from: &Positions,
) -> Result<Option<Act>, Vec<Finding>> {
    let mut act = transfer(choreography, NAME, like, ways(fleet, from), fleet, from)?;
    if let Some(act) = &mut act {
        act.on_failure = FailurePolicy { default: OnFailure::Stop, ..FailurePolicy::default() };
    }
    Ok(act)
}

/// Plans an act that makes the movements `ways`, with the settings of the act `like`.
pub(crate) fn transfer(
    choreography: &Choreography,
    name: &str,
    like: usize,
    ways: Vec<DeviceWay<'_>>,
    fleet: &Fleet,
    from: &Positions,
) -> Result<Option<Act>, Vec<Finding>> {
    let Some(like) = choreography.acts.get(like).filter(|_| !ways.is_empty()) else { return Ok(None) };
    let mut over = shortest(choreography, &ways, fleet);
    let standing = poses::standing(fleet, from);
    let mut act = poses::compiled(name, &ways, &standing, over);
    for _ in 0..DOUBLED_MAX {
        if act.is_ok() {
            break;
        }
        over = over * 2;
        act = poses::compiled(name, &ways, &standing, over);
    }
    let mut act = act?;
    let name = unused_name(name, &choreography.acts);
    poses::name_like(&mut act, name, &choreography.scenario, like);
    Ok(Some(act))
}

/// Returns the shortest duration within which all movements are possible at the largest speeds of their devices.
fn shortest(choreography: &Choreography, ways: &[DeviceWay<'_>], fleet: &Fleet) -> Span {
    let speeds = largest_speeds(choreography);
    let shortest = ways.iter().map(|DeviceWay { robot, device, from, to }| {
        let seconds = |speed| Easing::Smooth.slope_max() * (to - from).abs() / speed * (1.0 + SLACK);
        let is_linear = || {
            let listed = fleet.robots.iter().find(|listed| listed.id == **robot);
            let block = listed.and_then(|listed| listed.init.as_ref());
            let described = block.and_then(|block| block.device(device.as_str()));
            described.is_some_and(|described| described.interpolation == Interpolation::Linear)
        };
        match speeds.get(&(*robot, *device)) {
            Some(speed) => Span::from_millis_f64(seconds(speed) * 1_000.0),
            None if is_linear() => WITHOUT_LIMIT,
            None => SHORTEST,
        }
    });
    shortest.max().unwrap_or_default().max(SHORTEST)
}

/// Returns the largest known speed of each device that the acts of the choreography use.
pub(crate) fn largest_speeds(choreography: &Choreography) -> HashMap<(&RobotId, &DeviceId), f64> {
    let used = choreography.acts.iter().flat_map(|act| &act.devices);
    used.filter_map(|used| Some(((&used.robot, &used.device), used.speed_max?))).collect()
}

fn ways<'a>(fleet: &Fleet, from: &'a Positions) -> Vec<DeviceWay<'a>> {
    let mut ways = Vec::new();
    for (robot, devices) in from {
        let listed = fleet.robots.iter().find(|listed| listed.id == *robot);
        let Some(block) = listed.and_then(|listed| listed.init.as_ref()) else { continue };
        for (device, position) in devices {
            let Some(described) = block.device(device.as_str()) else { continue };
            let Some(to) = described.default_value else { continue };
            let from = settable(described, *position);
            if from != to {
                ways.push(DeviceWay { robot, device, from, to });
            }
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
on_failure: without
acts:
  - {act: home, cues: [{at: 0s, robots: arm, tracks: {joint: [{at: 0s, to: 0}, {at: 9s, to: 170, ease: smooth}], lamp: [{at: 0s, to: 50}]}}]}
";
        let compiled = compile(&Source { name: "show.yaml".into(), text: text.into() }, &fleet, &NoFiles);
        (compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings)), fleet)
    }

    fn from(devices: &[(&str, f64)]) -> Positions {
        let devices = devices.iter().map(|(device, position)| (device.parse().unwrap(), *position));
        [("arm".parse().unwrap(), devices.collect())].into()
    }

    #[test]
    fn devices_move_to_default_positions_within_their_limits() {
        let (show, fleet) = show();
        let home = plan_home(&show, 0, &fleet, &from(&[("joint", 150.0), ("lamp", 40.0)])).unwrap().unwrap();
        assert_eq!((home.name.as_str(), home.next), ("home-2", crate::Way::End));
        assert_eq!(home.on_failure.default, OnFailure::Stop);
        let scripts = &home.plan.robots[0].scripts;
        let of = |device: &str| {
            let script = scripts.iter().find(|script| script.device == device.parse().unwrap()).unwrap();
            let values: Vec<_> = script.script.steps().iter().map(|step| step.setpoint.value).collect();
            (values[0], values[values.len() - 1], values.len())
        };
        let (first, last, steps) = of("joint");
        assert_eq!((first, last), (150.0, 0.0));
        assert!(steps > 2, "{steps}");
        let (first, last, _) = of("lamp");
        assert_eq!((first, last), (40.0, 0.0));
        // 1.875 * 150 / 60 = 4.6875 s, plus 2 %.
        let lasts = scripts.iter().map(|script| script.script.duration()).max().unwrap();
        assert_eq!(lasts.as_millis_f64().round(), 4_781.0);
    }

    /// Plans the act that moves the arm home from 80 degrees. Another robot, whose joint has no default position, has stopped at 40
    /// degrees, on a rail `y` metres away from the arm's.
    fn home_past_another(y: f64) -> Result<Act, Vec<Finding>> {
        let (show, mut fleet) = show();
        let mut other = fleet.robots[0].clone();
        other.id = "other".parse().unwrap();
        let block = other.init.as_mut().unwrap();
        block.id = other.id.clone();
        block.devices.iter_mut().for_each(|device| device.default_value = None);
        fleet.robots.push(other);
        poses::on_rails(&mut fleet, &[0.0, y]);
        let mut from = from(&[("joint", 80.0)]);
        from.insert("other".parse().unwrap(), [("joint".parse().unwrap(), 40.0)].into());
        plan_home(&show, 0, &fleet, &from).map(Option::unwrap)
    }

    #[test]
    fn home_act_colliding_with_stationary_robot_is_refused() {
        let findings = home_past_another(0.0).unwrap_err();
        assert!(findings.iter().any(|finding| finding.code == Code::TooClose), "{findings:?}");
    }

    #[test]
    fn device_without_default_position_does_not_move_home() {
        let home = home_past_another(0.5).unwrap();
        let moved: Vec<_> = home.plan.robots.iter().map(|planned| planned.robot.as_str()).collect();
        assert_eq!(moved, ["arm"]);
    }

    #[test]
    fn no_home_act_is_planned_if_devices_are_at_default_positions() {
        let (show, fleet) = show();
        assert_eq!(plan_home(&show, 0, &fleet, &from(&[("joint", 0.1), ("lamp", 0.0)])).unwrap(), None);
    }
}
