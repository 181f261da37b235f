//! The differences between the scripts of a device in two plans.

use std::collections::HashMap;

use downbeat_scripts::{Act, DeviceScript, DeviceUse, Fleet};
use serde::Serialize;
use urrcp::{DeviceId, Interpolation, Millis, RobotId, Span, StopCondition};

use super::steps::{Movement, StepDifferences, TimedStep, compare};
use super::{Change, Presence};

/// A device whose scripts differ between two plans.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct DeviceDifferences {
    pub(crate) robot: RobotId,
    pub(crate) device: DeviceId,
    pub(crate) presence: Presence,
    /// The unit of the device, if the fleet file states one.
    pub(crate) unit: Option<String>,
    /// Time from the act's start to the start of the device's first script in each plan, if these times differ.
    pub(crate) start_ms: Option<Change<Millis>>,
    /// The number of scripts of the device in each plan; `None` if the numbers are equal.
    pub(crate) scripts: Option<Change<usize>>,
    /// Whether the plans divide the same steps into scripts differently.
    pub(crate) divided: bool,
    /// The leases of the device's scripts in each plan; `None` if they are equal.
    pub(crate) leases: Option<Change<Vec<StopCondition>>>,
    #[serde(flatten)]
    pub(crate) steps: StepDifferences,
    /// How the device's steps were computed and compare with its limits, in each plan. `None` if both plans agree.
    #[serde(rename = "use")]
    pub(crate) used: Option<Change<Option<DeviceUse>>>,
}

/// The scripts of an act, and the data about their computation, by device.
pub(super) struct Devices<'a> {
    act: &'a Act,
    scripts: HashMap<(&'a RobotId, &'a DeviceId), Vec<&'a DeviceScript>>,
    uses: HashMap<(&'a RobotId, &'a DeviceId), &'a DeviceUse>,
    fleet: &'a Fleet,
}

impl<'a> Devices<'a> {
    pub(super) fn of(act: &'a Act, fleet: &'a Fleet) -> Self {
        let mut scripts: HashMap<_, Vec<_>> = HashMap::new();
        for robot in &act.plan.robots {
            for script in &robot.scripts {
                scripts.entry((&robot.robot, &script.device)).or_default().push(script);
            }
        }
        let uses = act.devices.iter().map(|used| ((&used.robot, &used.device), used)).collect();
        Self { act, scripts, uses, fleet }
    }

    fn described(&self, robot: &RobotId, device: &DeviceId) -> Option<&'a urrcp::Device> {
        let robot = self.fleet.robots.iter().find(|known| known.id == *robot)?;
        robot.init.iter().flat_map(|init| &init.devices).find(|known| known.id == *device)
    }

    fn movement(&self, robot: &RobotId, device: &DeviceId) -> Movement {
        let linear =
            self.described(robot, device).is_some_and(|device| device.interpolation == Interpolation::Linear);
        let mut steps = Vec::new();
        for script in self.scripts.get(&(robot, device)).into_iter().flatten() {
            let of_script = script.script.steps();
            steps.extend(of_script.iter().enumerate().map(|(index, step)| TimedStep {
                at: self.act.moves_at(robot, script) + step.offset.span(),
                setpoint: step.setpoint.clone(),
                lease: step.stop_condition,
                ends: index + 1 == of_script.len(),
            }));
        }
        Movement { steps, linear }
    }
}

/// Returns the devices that differ, ordered by the time of their first difference.
pub(super) fn devices(a: &Devices<'_>, b: &Devices<'_>) -> Vec<DeviceDifferences> {
    let keys = [a, b].into_iter().flat_map(|of| of.scripts.keys().chain(of.uses.keys()));
    let mut keys: Vec<(&RobotId, &DeviceId)> = keys.copied().collect();
    keys.sort();
    keys.dedup();
    let mut all: Vec<DeviceDifferences> = keys.into_iter().filter_map(|key| device(key, a, b)).collect();
    all.sort_by_key(DeviceDifferences::at);
    all
}

fn device(key: (&RobotId, &DeviceId), of_a: &Devices<'_>, of_b: &Devices<'_>) -> Option<DeviceDifferences> {
    let (robot, device) = key;
    let (a, b) = (of_a.scripts.get(&key), of_b.scripts.get(&key));
    let used = Change::of(of_a.uses.get(&key).copied().cloned(), of_b.uses.get(&key).copied().cloned());
    if a == b && used.is_none() {
        return None;
    }
    let steps = if a == b {
        StepDifferences::default()
    } else {
        compare(&of_a.movement(robot, device), &of_b.movement(robot, device))
    };
    let start = |scripts: Option<&Vec<&DeviceScript>>| Some(scripts?.first()?.start);
    let count = |scripts: Option<&Vec<&DeviceScript>>| scripts.map_or(0, Vec::len);
    let leases = |scripts: Option<&Vec<&DeviceScript>>| {
        scripts.into_iter().flatten().map(|script| script.stop_condition).collect::<Vec<_>>()
    };
    let (starts, leases) = (start(a).zip(start(b)), Change::of(leases(a), leases(b)));
    let described = of_b.described(robot, device).or_else(|| of_a.described(robot, device));
    let scripts = Change::of(count(a), count(b));
    let start_ms = starts.and_then(|(a, b)| Change::of(a, b));
    Some(DeviceDifferences {
        robot: robot.clone(),
        device: device.clone(),
        presence: Presence::of(a, b),
        unit: described.and_then(|device| device.unit.as_ref()).map(ToString::to_string),
        divided: a != b
            && steps.steps.is_empty()
            && (leases.is_none() || scripts.is_some() || start_ms.is_some()),
        start_ms,
        leases: leases.filter(|leases| leases.a.len() == leases.b.len()),
        scripts,
        steps,
        used,
    })
}

impl DeviceDifferences {
    /// Time from the act's start to the first step that differs; zero if no step differs.
    pub(crate) fn at(&self) -> Span {
        let step = self.steps.first().and_then(|step| step.b.as_ref().or(step.a.as_ref()));
        step.map_or(Span::ZERO, |step| step.at_ms)
    }
}
