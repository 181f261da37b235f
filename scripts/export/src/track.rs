//! The values of every device over the acts of the main line (the first act, and those that follow it by `next`), one after another.

use std::collections::BTreeMap;

use downbeat_fleet::fleet::Fleet;
use downbeat_plan::{Choreography, DeviceScript};
use downbeat_yaml::finding::names;
use downbeat_yaml::render::counted;
use urrcp::{ControlType, Interpolation};

pub(crate) struct Robot<'a> {
    pub(crate) name: &'a str,
    /// Tracks of the robot's devices, in the order in which the devices first occur in the plan.
    pub(crate) tracks: Vec<Track<'a>>,
}

pub(crate) struct Track<'a> {
    pub(crate) device: &'a str,
    pub(crate) interpolation: Interpolation,
    /// Value of the device before its first step; `None` if it is unknown.
    pub(crate) home: Option<f64>,
    /// Steps of the device as (milliseconds, values), in order of time.
    pub(crate) points: Vec<(f64, Vec<f64>)>,
}

impl Track<'_> {
    /// Returns the device's values at `at_ms`. Before the first step, they come from `home` or, if that is unknown, from the first step.
    pub(crate) fn values(&self, at_ms: f64) -> Vec<f64> {
        let next = self.points.partition_point(|(at, _)| *at <= at_ms);
        let Some((from_ms, from)) = next.checked_sub(1).map(|index| &self.points[index]) else {
            return self.before(at_ms);
        };
        match self.points.get(next).filter(|_| self.interpolation == Interpolation::Linear) {
            Some((to_ms, to)) => mixed(from, to, (at_ms - from_ms) / (to_ms - from_ms)),
            None => from.clone(),
        }
    }

    fn before(&self, at_ms: f64) -> Vec<f64> {
        let Some((first_ms, first)) = self.points.first() else { return Vec::new() };
        let home = self.home.map_or_else(|| first.clone(), |home| vec![home; first.len()]);
        match self.interpolation {
            Interpolation::Linear if *first_ms > 0.0 => mixed(&home, first, at_ms / first_ms),
            _ => home,
        }
    }

    /// Returns the first value at `at_ms`, for devices with a single value.
    pub(crate) fn value(&self, at_ms: f64) -> f64 {
        self.values(at_ms).first().copied().unwrap_or(0.0)
    }
}

fn mixed(from: &[f64], to: &[f64], share: f64) -> Vec<f64> {
    from.iter().zip(to).map(|(from, to)| from + (to - from) * share).collect()
}

/// Returns the tracks of all robots' devices, and messages about omitted data.
pub(crate) fn robots<'a>(choreography: &'a Choreography, fleet: &'a Fleet) -> (Vec<Robot<'a>>, Vec<String>) {
    let mut robots: Vec<Robot<'a>> = Vec::new();
    let mut rates: BTreeMap<String, ()> = BTreeMap::new();
    let mut begin_ms = 0.0;
    let line = choreography.main_line();
    for act in line.iter().map(|index| &choreography.acts[*index]) {
        for plan in &act.plan.robots {
            let name = plan.robot.as_str();
            let place = robots.iter().position(|robot| robot.name == name).unwrap_or_else(|| {
                robots.push(Robot { name, tracks: Vec::new() });
                robots.len() - 1
            });
            for script in &plan.scripts {
                // An exported file contains the visible motion, not the earlier commands.
                let moves_ms = (act.moves_at(&plan.robot, script) - act.lead_in).as_millis_f64();
                if !add(&mut robots[place], script, begin_ms + moves_ms, fleet) {
                    rates.insert(format!("{name}/{}", script.device), ());
                }
            }
        }
        begin_ms += (act.duration() - act.lead_in).as_millis_f64();
    }
    robots.retain(|robot| !robot.tracks.is_empty());
    let mut notes = Vec::new();
    if line.len() > 1 {
        notes.push(format!(
            "{} acts follow each other without a pause: their wait conditions are left out",
            line.len()
        ));
    }
    if line.len() < choreography.acts.len() {
        let left = counted(choreography.acts.len() - line.len(), "act");
        notes.push(format!("left out {left} that can be reached only after a failure or a timeout"));
    }
    if !rates.is_empty() {
        let devices = names(rates.keys().take(20).map(String::as_str));
        notes.push(format!("left out speeds and accelerations, which are not positions: {devices}"));
    }
    (robots, notes)
}

/// Adds the steps of a script to the robot's tracks. If the script sets speeds or accelerations, adds nothing and returns `false`.
fn add<'a>(robot: &mut Robot<'a>, script: &'a DeviceScript, begin_ms: f64, fleet: &Fleet) -> bool {
    let steps = script.script.steps();
    let rate = |control: ControlType| matches!(control, ControlType::Speed | ControlType::Acceleration);
    if steps.iter().any(|step| rate(step.setpoint.control_type)) {
        return false;
    }
    let device = script.device.as_str();
    let place = robot.tracks.iter().position(|track| track.device == device).unwrap_or_else(|| {
        let init =
            fleet.robots.iter().find(|known| known.id.as_str() == robot.name).and_then(|r| r.init.as_ref());
        let block = init.and_then(|init| init.device(device));
        robot.tracks.push(Track {
            device,
            interpolation: block.map(|block| block.interpolation).unwrap_or_default(),
            home: block.and_then(|block| block.default_value),
            points: Vec::new(),
        });
        robot.tracks.len() - 1
    });
    let track = &mut robot.tracks[place];
    for step in steps {
        let at_ms = begin_ms + step.offset.get();
        let values: Vec<f64> = step.setpoint.values().collect();
        match track.points.last_mut().filter(|last| last.0 >= at_ms) {
            Some(last) => last.1 = values,
            None => track.points.push((at_ms, values)),
        }
    }
    true
}
