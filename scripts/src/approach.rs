//! An act ahead of a choreography that moves devices to the positions that its first act expects.

use std::collections::{BTreeMap, HashSet};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use urrcp::{ControlType, Device, DeviceId, Interpolation, RobotId, Span};

use crate::compile::compile;
use crate::duration::written;
use crate::files::NoFiles;
use crate::finding::{Code, Finding, Severity};
use crate::fleet::Fleet;
use crate::plan::{Act, Choreography, Way};
use crate::source::Source;

/// How devices are moved to their first positions.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Approach {
    /// Duration of the movement.
    #[serde(rename = "over_ms")]
    pub over: Span,
    /// Positions of devices before the movement. Devices without an entry are not moved.
    pub from: BTreeMap<RobotId, BTreeMap<DeviceId, f64>>,
}

impl Approach {
    /// Whether an act of this name may be an approach. A scenario may have an act of this name, too.
    #[must_use]
    pub fn may_be_named(act: &str) -> bool {
        let number = |rest: &str| rest.strip_prefix('-').is_some_and(|number| number.parse::<u32>().is_ok());
        act.strip_prefix(NAME).is_some_and(|rest| rest.is_empty() || number(rest))
    }
}

const NAME: &str = "approach";

impl Choreography {
    /// Adds an act ahead of `first` that moves devices to their first positions. Returns the choreography and the index of its
    /// first act. The new act is compiled like any other: within the limits of the devices and, as far as bodies are known,
    /// without collisions. Lamps, and devices that are there already, are not moved. If no device has to move, no act is added.
    ///
    /// # Errors
    /// The errors in the new act, for example a movement that a device cannot make in that time.
    pub fn approached(
        mut self,
        first: usize,
        fleet: &Fleet,
        approach: &Approach,
    ) -> Result<(Self, usize), Vec<Finding>> {
        let Some(act) = self.acts.get(first) else { return Ok((self, first)) };
        let ways = ways(act, fleet, approach);
        if ways.is_empty() {
            return Ok((self, first));
        }
        let mut ahead = compiled(&ways, fleet, approach)?;
        ahead.name = self.unused_name();
        let plan = &act.plan;
        ahead.plan.scenario = format!("{}, {}", self.scenario, ahead.name);
        ahead.plan.start_tolerance = plan.start_tolerance;
        ahead.plan.lead = plan.lead;
        ahead.plan.stop_condition = plan.stop_condition;
        for script in ahead.plan.robots.iter_mut().flat_map(|robot| &mut robot.scripts) {
            script.stop_condition = plan.stop_condition;
        }
        for act in &mut self.acts {
            for way in [&mut act.next, &mut act.on_timeout] {
                if let Way::Act(index) = way {
                    *index += 1;
                }
            }
            act.on_failure.then = act.on_failure.then.map(|index| index + 1);
        }
        ahead.next = Way::Act(first + 1);
        self.acts.insert(0, ahead);
        Ok((self, 0))
    }

    fn unused_name(&self) -> String {
        let names = std::iter::once(NAME.to_owned()).chain((2..).map(|n| format!("{NAME}-{n}")));
        let mut unused = names.filter(|name| !self.acts.iter().any(|act| act.name == *name));
        unused.next().unwrap_or_default()
    }
}

/// A device, its position, and the position that it has to reach.
struct DeviceWay<'a> {
    robot: &'a RobotId,
    device: &'a DeviceId,
    from: f64,
    to: f64,
}

fn ways<'a>(act: &'a Act, fleet: &Fleet, approach: &Approach) -> Vec<DeviceWay<'a>> {
    let mut ways: Vec<DeviceWay<'_>> = Vec::new();
    let limited = act.devices.iter().filter(|used| used.speed_max.is_some());
    let limited: HashSet<_> = limited.map(|used| (&used.robot, &used.device)).collect();
    for planned in &act.plan.robots {
        let Some(from) = approach.from.get(&planned.robot) else { continue };
        let listed = fleet.robots.iter().find(|robot| robot.id == planned.robot);
        let robot = &planned.robot;
        for (device, to) in planned.first_positions() {
            let block = listed.and_then(|robot| robot.init.as_ref());
            let described = block.and_then(|block| block.device(device.as_str()));
            let (Some(described), Some(&from)) = (described, from.get(device)) else { continue };
            let moves =
                described.interpolation == Interpolation::Linear || limited.contains(&(robot, device));
            let from = settable(described, from);
            if moves && from != to {
                ways.push(DeviceWay { robot, device, from, to });
            }
        }
    }
    ways
}

/// The nearest position to which scripts can set a device: it may have come to rest between two of them.
fn settable(device: &Device, position: f64) -> f64 {
    let types = &device.available_control_types;
    let script = types.script().map(|script| &script.limits);
    types.limits(ControlType::Position).into_iter().chain(script).fold(position, |position, limits| {
        let within = position.clamp(limits.min_value, limits.max_value);
        let nearest = limits.nearest(within);
        match limits.contains(nearest) {
            true => nearest,
            false => nearest - limits.granularity.copysign(nearest - within),
        }
    })
}

/// Compiles the act from a scenario that is generated for it. Devices that take too few steps for a smooth movement get a linear one.
fn compiled(ways: &[DeviceWay<'_>], fleet: &Fleet, approach: &Approach) -> Result<Act, Vec<Finding>> {
    eased(ways, fleet, approach, "smooth").or_else(|findings| {
        let few = [Code::TooManySteps, Code::QueueTooShort];
        match findings.iter().all(|finding| few.contains(&finding.code)) {
            true => eased(ways, fleet, approach, "linear"),
            false => Err(findings),
        }
    })
}

fn eased(
    ways: &[DeviceWay<'_>],
    fleet: &Fleet,
    approach: &Approach,
    ease: &str,
) -> Result<Act, Vec<Finding>> {
    let mut tracks: BTreeMap<&RobotId, serde_json::Map<String, Value>> = BTreeMap::new();
    let over = written(approach.over);
    for DeviceWay { robot, device, from, to } in ways {
        let keyframes = json!([{"at": "0s", "to": from}, {"at": over, "to": to, "ease": ease}]);
        tracks.entry(robot).or_default().insert(device.to_string(), keyframes);
    }
    let cues: Vec<_> = tracks
        .into_iter()
        .map(|(robot, tracks)| json!({"at": "0s", "robots": robot, "tracks": tracks}))
        .collect();
    // Scenarios are YAML, and JSON is YAML.
    let text = json!({"scenario": NAME, "cues": cues}).to_string();
    let compiled = compile(&Source { name: "--approach".into(), text }, &moved(fleet, approach), &NoFiles);
    let acts = compiled.choreography.map(|choreography| choreography.acts).unwrap_or_default();
    let errors = || {
        let findings = compiled.findings.into_iter();
        findings.filter(|finding| finding.severity == Severity::Error).collect()
    };
    acts.into_iter().next().ok_or_else(errors)
}

/// The fleet, with the known positions of its devices as their default values.
fn moved(fleet: &Fleet, approach: &Approach) -> Fleet {
    let mut fleet = fleet.clone();
    for robot in &mut fleet.robots {
        let Some(from) = approach.from.get(&robot.id) else { continue };
        for device in robot.init.iter_mut().flat_map(|block| block.devices.iter_mut()) {
            if let Some(position) = from.get(&device.id) {
                device.default_value = Some(settable(device, *position));
            }
        }
    }
    fleet
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::address::Address;
    use crate::fleet::FleetRobot;

    const ARM: &str = r#"{"id": "arm", "api_version": "1", "devices": [
  {"id": "joint", "name": "joint", "interpolation": "linear", "default_value": 0, "available_control_types": {
     "position": {"min_value": -180, "max_value": 180, "granularity": 0.5},
     "speed": {"min_value": -60, "max_value": 60, "granularity": 1},
     "script": {"min_value": -180, "max_value": 180, "granularity": 0.5, "max_number_of_steps": 200}}},
  {"id": "lamp", "name": "lamp", "default_value": 0, "available_control_types": {
     "position": {"min_value": 0, "max_value": 100, "granularity": 1},
     "script": {"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 200}}}]}"#;

    fn show() -> (Choreography, Fleet) {
        let block = serde_json::from_str(ARM).unwrap();
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
    fn a_device_is_moved_from_where_it_is_to_its_first_position_and_a_lamp_is_not() {
        let (show, fleet) = show();
        let (show, first) = show.approached(0, &fleet, &approach(5, 80.0)).unwrap();
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
    fn an_approach_faster_than_a_device_is_refused_and_the_time_that_it_needs_is_named() {
        let (show, fleet) = show();
        let findings = show.approached(0, &fleet, &approach(1, 80.0)).unwrap_err();
        assert!(findings.iter().any(|finding| finding.message.contains("joint")), "{findings:?}");
    }

    #[test]
    fn a_device_that_came_to_rest_off_its_grid_or_beyond_its_limits_approaches_from_the_nearest_position() {
        for (rests_at, from) in [(63.2174, 63.0), (-180.2, -180.0)] {
            let (show, fleet) = show();
            let (show, _) = show.approached(0, &fleet, &approach(9, rests_at)).unwrap();
            let first = show.acts[0].plan.robots[0].first_positions().next().unwrap().1;
            assert!((first - from).abs() < 1e-9, "{rests_at}: {first}");
        }
    }

    #[test]
    fn without_a_way_to_go_there_is_no_approach() {
        let (show, fleet) = show();
        let (approached, first) = show.clone().approached(1, &fleet, &approach(5, 30.0)).unwrap();
        assert_eq!((approached, first), (show, 1));
    }
}
