//! Generated acts that move devices from known positions to other positions.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use urrcp::{ControlType, Device, DeviceId, RobotId, Span};

use super::compile;
use crate::duration::written;
use crate::files::NoFiles;
use crate::finding::{Code, Finding, Severity};
use crate::fleet::Fleet;
use crate::plan::{Act, FailurePolicy, Positions};
use crate::source::Source;

/// A device with its current and its target position.
pub(crate) struct DeviceWay<'a> {
    pub(crate) robot: &'a RobotId,
    pub(crate) device: &'a DeviceId,
    pub(crate) from: f64,
    pub(crate) to: f64,
}

/// Returns the position that scripts can set and that is nearest to `position`. The device may have stopped between two such positions.
pub(crate) fn settable(device: &Device, position: f64) -> f64 {
    let types = &device.available_control_types;
    let script = types.script().map(|script| &script.limits);
    types
        .limits(ControlType::Position)
        .into_iter()
        .chain(script)
        .fold(position, |position, limits| limits.nearest_settable(position))
}

/// Compiles an act that makes the movements `ways`. Findings name the generated scenario `source`. The default values in `fleet` are the
/// current positions. If a device accepts too few steps for a smooth movement, all devices move linearly.
pub(crate) fn compiled(
    source: &str,
    ways: &[DeviceWay<'_>],
    fleet: &Fleet,
    over: Span,
) -> Result<Act, Vec<Finding>> {
    eased(source, ways, fleet, over, "smooth").or_else(|findings| {
        let few = [Code::TooManySteps, Code::QueueTooShort];
        if findings.iter().all(|finding| few.contains(&finding.code)) {
            eased(source, ways, fleet, over, "linear")
        } else {
            Err(findings)
        }
    })
}

fn eased(
    source: &str,
    ways: &[DeviceWay<'_>],
    fleet: &Fleet,
    over: Span,
    ease: &str,
) -> Result<Act, Vec<Finding>> {
    let mut tracks: BTreeMap<&RobotId, serde_json::Map<String, Value>> = BTreeMap::new();
    let over = written(over);
    for DeviceWay { robot, device, from, to } in ways {
        let keyframes = json!([{"at": "0s", "to": from}, {"at": over, "to": to, "ease": ease}]);
        tracks.entry(robot).or_default().insert(device.to_string(), keyframes);
    }
    // Robots that move in unison share one cue.
    let mut alike: BTreeMap<String, (Vec<&RobotId>, serde_json::Map<String, Value>)> = BTreeMap::new();
    for (robot, tracks) in tracks {
        let text = Value::Object(tracks.clone()).to_string();
        alike.entry(text).or_insert_with(|| (Vec::new(), tracks)).0.push(robot);
    }
    let cue = |(robots, tracks)| json!({"at": "0s", "robots": robots, "tracks": tracks});
    let cues: Vec<_> = alike.into_values().map(cue).collect();
    // JSON is valid YAML.
    let text = json!({"scenario": source, "cues": cues}).to_string();
    let compiled = compile(&Source { name: source.into(), text }, fleet, &NoFiles);
    let acts = compiled.choreography.map(|choreography| choreography.acts).unwrap_or_default();
    let errors = || {
        let findings = compiled.findings.into_iter();
        findings.filter(|finding| finding.severity == Severity::Error).collect()
    };
    acts.into_iter().next().ok_or_else(errors)
}

/// Returns the fleet with the given positions as the default values of its devices.
pub(crate) fn standing(fleet: &Fleet, from: &Positions) -> Fleet {
    let mut fleet = fleet.clone();
    for robot in &mut fleet.robots {
        let Some(from) = from.get(&robot.id) else { continue };
        for device in robot.init.iter_mut().flat_map(|block| block.devices.iter_mut()) {
            if let Some(position) = from.get(&device.id) {
                device.default_value = Some(settable(device, *position));
            }
        }
    }
    fleet
}

/// Names a generated act. Copies the settings for starts, leases and failures from the act `other`, but not the act that follows a
/// failure.
pub(crate) fn name_like(act: &mut Act, name: String, scenario: &str, other: &Act) {
    act.plan.scenario = format!("{scenario}, {name}");
    act.name = name;
    act.on_failure = FailurePolicy { then: None, ..other.on_failure.clone() };
    act.on_doubt = other.on_doubt;
    let plan = &other.plan;
    act.plan.start_tolerance = plan.start_tolerance;
    act.plan.lead = plan.lead;
    act.plan.stop_condition = plan.stop_condition;
    for script in act.plan.robots.iter_mut().flat_map(|robot| &mut robot.scripts) {
        script.stop_condition = plan.stop_condition;
    }
}

/// Returns `name`, or the first unused one of `NAME-2`, `NAME-3` and so on.
pub(crate) fn unused_name(name: &str, acts: &[Act]) -> String {
    let names = std::iter::once(name.to_owned()).chain((2..).map(|n| format!("{name}-{n}")));
    let mut unused = names.filter(|name| !acts.iter().any(|act| act.name == *name));
    unused.next().unwrap_or_default()
}

/// Description of an arm for the tests of generated acts.
#[cfg(test)]
pub(crate) const ARM: &str = r#"{"id": "arm", "api_version": "1", "devices": [
  {"id": "joint", "name": "joint", "interpolation": "linear", "default_value": 0, "available_control_types": {
     "position": {"min_value": -180, "max_value": 180, "granularity": 0.5},
     "speed": {"min_value": -60, "max_value": 60, "granularity": 1},
     "script": {"min_value": -180, "max_value": 180, "granularity": 0.5, "max_number_of_steps": 200}}},
  {"id": "lamp", "name": "lamp", "default_value": 0, "available_control_types": {
     "position": {"min_value": 0, "max_value": 100, "granularity": 1},
     "script": {"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 200}}},
  {"id": "still", "name": "still", "default_value": 0, "available_control_types": {
     "position": {"min_value": 0, "max_value": 100, "granularity": 1},
     "script": {"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 200}}}]}"#;

/// Puts the robots of the fleet on rails along x, each at its value of `y`, in metres. Each robot's joint moves it by a centimetre per
/// degree.
#[cfg(test)]
pub(crate) fn on_rails(fleet: &mut Fleet, y: &[f64]) {
    use crate::space::{Body, Coordinate, Shape, Space};
    fleet.space = Space { distance: Some(0.1), ..Space::default() };
    for (robot, y) in fleet.robots.iter_mut().zip(y) {
        let x = Coordinate::Device { device: "joint".parse().unwrap(), scale: 0.01, offset: 0.0 };
        let coordinates = [x, Coordinate::Fixed(*y), Coordinate::Fixed(0.0), Coordinate::Fixed(0.0)];
        robot.body = Some(Body { coordinates, shape: Shape::Ball { radius: 0.05 }, ..Body::default() });
    }
}
