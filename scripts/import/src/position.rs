//! Detects robots whose devices are the coordinates of their position in space: `x`, `y` and `z` in a unit of length.

use std::collections::{BTreeMap, BTreeSet};

use super::sink::Sink;
use super::{Course, DeviceMotion, Imported, units};

const AXES: [&str; 3] = ["x", "y", "z"];

/// The minimum distance between the centres of two robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance {
    /// The distance in metres.
    pub metres: f64,
    /// What the distance is based on, as a text for readers of the fleet file.
    pub origin: &'static str,
}

impl Default for Clearance {
    /// Returns the default distance for Crazyflies, which are 0.14 m wide with their propellers.
    fn default() -> Self {
        Self { metres: 0.24, origin: "the distance between Crazyflies whose propellers are 0.1 m apart" }
    }
}

/// Returns the robots that have all three axes `x`, `y` and `z`, each in a unit of length.
pub(super) fn robots(imported: &Imported) -> BTreeSet<&str> {
    let units = axes(imported);
    let is_length =
        |units: &BTreeMap<&str, &str>| units.values().all(|unit| units::factor(unit, "m").is_some());
    units.into_iter().filter(|(_, units)| is_length(units)).map(|(robot, _)| robot).collect()
}

/// Adds a note about robots whose distances to others are not checked, because the units of their axes are unknown.
pub(super) fn note_unknown(imported: &Imported, sink: &mut Sink) {
    let unknown: Vec<_> =
        axes(imported).into_iter().filter(|(_, units)| units.values().any(|unit| unit.is_empty())).collect();
    if let [(robot, _), others @ ..] = unknown.as_slice() {
        let more = if others.is_empty() { String::new() } else { format!(" and {} more", others.len()) };
        sink.note(format!(
            "the unit of `x`, `y` and `z` of `{robot}`{more} is unknown, so distances between robots are not checked: \
             add the unit to the column names, as in `x [m]`, or add a `body` in the fleet file"
        ));
    }
}

/// Returns the units of the axes `x`, `y` and `z`, by robot and axis, for all robots that have all three axes.
fn axes(imported: &Imported) -> BTreeMap<&str, BTreeMap<&str, &str>> {
    let mut units: BTreeMap<&str, BTreeMap<&str, &str>> = BTreeMap::new();
    let is_axis = |device: &DeviceMotion| {
        AXES.contains(&device.device.as_str()) && !matches!(device.course, Course::Several(_))
    };
    for (robot, device) in imported.devices().filter(|(_, device)| is_axis(device)) {
        units.entry(&robot.robot).or_default().insert(&device.device, &device.unit);
    }
    units.retain(|_, units| units.len() == AXES.len());
    units
}
