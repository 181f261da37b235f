//! Metamorphic tests. They change a scenario in a way that determines how its findings and its plan change, so that no test needs to know
//! either of them. The module `ways` draws the shows.

mod grid;
mod order;
mod time;
mod unrolled;

use std::collections::{BTreeMap, BTreeSet};

use super::ways::{Show, compiled, fleet_of, observed};
use crate::{Act, Compiled, Fleet};

/// Steps of each device: nanoseconds since the act's start, and values.
type Steps = BTreeMap<(String, String), Vec<(i64, f64)>>;

/// Returns the steps of the devices in an act, regardless of how they are divided into scripts.
fn steps(act: &Act) -> Steps {
    let mut steps = Steps::new();
    for robot in &act.plan.robots {
        for script in &robot.scripts {
            let device = steps.entry((robot.robot.to_string(), script.device.to_string())).or_default();
            for step in script.script.steps() {
                let step = ((script.start.span() + step.offset.span()).as_nanos(), step.setpoint.value);
                // A script begins with the last step of the previous one.
                if device.last() != Some(&step) {
                    device.push(step);
                }
            }
        }
    }
    steps
}

/// Returns the steps of all acts.
fn all_steps(compiled: &Compiled) -> Option<Vec<Steps>> {
    Some(compiled.choreography.as_ref()?.acts.iter().map(steps).collect())
}

/// Returns the facts that findings report, with each line number replaced by the result of `line`.
fn facts(compiled: &Compiled, line: impl Fn(usize) -> usize) -> BTreeSet<String> {
    let mut findings = compiled.findings.clone();
    for finding in &mut findings {
        finding.line = line(finding.line);
        finding.related.iter_mut().for_each(|place| place.line = line(place.line));
    }
    observed::facts(&findings).unwrap_or_else(|error| panic!("{error}\n{findings:#?}"))
}

fn of(show: &Show, fleet: &Fleet) -> Compiled {
    compiled(&show.yaml(), fleet)
}

fn three() -> Fleet {
    fleet_of(&super::ways::ROBOTS)
}
