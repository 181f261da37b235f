//! Acts, and for each the scripts of every robot.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::hash::{DefaultHasher, Hash, Hasher};

use downbeat_fleet::fleet::DeviceLatency;
use downbeat_fleet::sensor_range::SensorRange;
use downbeat_space::space::{Closest, InSpace};
use serde::Serialize;
use urrcp::{ControlType, DeviceId, Millis, RobotId, Script, Server, Span, StopCondition, Timestamp};

use crate::requirements::Requirements;

/// Positions of devices.
pub type Positions = BTreeMap<RobotId, BTreeMap<DeviceId, f64>>;

/// A whole scenario: acts with the ways between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choreography {
    /// The scenario's name.
    pub scenario: String,
    /// In the order of the file; the first one begins.
    pub acts: Vec<Act>,
    /// What the scenario requires of it. Nothing enforces this while it plays.
    pub requirements: Requirements,
}

/// What is prepared, decided and started together, and what leads to it and from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Act {
    /// Unique in the scenario; empty where the scenario has no acts of its own.
    pub name: String,
    /// What is sent. Starts are those of commands, ahead of their motions by the latency of the device.
    pub plan: Plan,
    /// How much later than its start the act's motions begin than they are written, so that devices with a latency can be
    /// commanded before they have to move. Every time below is that of motions, counted from the act's start: it is later by this.
    pub lead_in: Span,
    /// The latencies that are compensated: of devices that it moves and whose latency is known.
    pub latencies: BTreeMap<RobotId, BTreeMap<DeviceId, DeviceLatency>>,
    /// Its cues in the order of the file, with the times at which they take place.
    pub cues: Vec<PlannedCue>,
    /// How each device's steps came about.
    pub devices: Vec<DeviceUse>,
    /// What the robots do in space while it plays.
    pub in_space: InSpace,
    /// Sensors that are read while it plays.
    pub readings: Vec<PlannedReading>,
    /// What has to be so before it begins.
    pub wait: Wait,
    /// How long it waits at most.
    pub timeout: Option<Span>,
    /// Where the mission goes when the time is over.
    pub on_timeout: Way,
    /// Where it goes when the act has ended.
    pub next: Way,
    /// What happens when a robot fails.
    pub on_failure: FailurePolicy,
    /// What the others do when it cannot be known whether a robot will start.
    pub on_doubt: OnDoubt,
}

/// A way out of an act.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// To the act of that index.
    Act(usize),
    /// The mission ends well.
    End,
    /// The mission fails.
    Fail,
}

/// What happens when a robot fails.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FailurePolicy {
    /// For robots that are not listed.
    pub default: OnFailure,
    /// For some robots.
    pub robots: Vec<(RobotId, OnFailure)>,
    /// The act that follows a failure.
    pub then: Option<usize>,
}

impl FailurePolicy {
    /// The default policy, and those of single robots.
    pub fn policies(&self) -> impl Iterator<Item = OnFailure> {
        std::iter::once(self.default).chain(self.robots.iter().map(|(_, rule)| *rule))
    }

    /// Whether all robots go to their default state, whichever of them fails.
    #[must_use]
    pub fn sends_home(&self) -> bool {
        self.policies().all(|rule| rule == OnFailure::Home)
    }
}

/// What the fleet does when a robot fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OnFailure {
    /// All robots stop where they are.
    #[default]
    Stop,
    /// All robots go to their default state.
    Home,
    /// The others continue.
    Without,
}

/// What the others do when shortly before the start a robot's link is silent or broken, and it cannot be known whether it will
/// start. A known state is never treated as doubt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OnDoubt {
    /// They start. If the silent robot is gone, they begin without it.
    #[default]
    Start,
    /// They do not move. If the silent robot starts, it moves alone until its lease has ended.
    Withdraw,
}

/// What an act waits for before it begins.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Wait {
    /// The act before has ended everywhere.
    #[default]
    Done,
    /// The operator says go.
    Operator,
    /// A time of day of the server's clock, since midnight of its local time.
    TimeOfDay(Span),
    /// An instant.
    Instant(Timestamp<Server>),
    /// A reading within a range.
    Sensor {
        /// Robot, by its id.
        robot: String,
        /// Sensor, by its device id.
        sensor: String,
        /// Which readings will do.
        range: SensorRange,
    },
}

/// A cue with its times, counted from the act's start.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedCue {
    /// Its name.
    pub name: String,
    /// When it starts.
    pub start: Span,
    /// When the last of its robots has ended.
    pub end: Span,
    /// How much later it could start, all its relations kept, without the act ending later.
    pub slack: Span,
    /// Whether it is on the critical path: a chain of relations without room leads from it to the end of the act. A cue that is
    /// fixed by `at` has no slack either, but decides nothing if others end later.
    pub critical: bool,
    /// How its movement is repeated, if it is.
    #[serde(rename = "repeat", skip_serializing_if = "Option::is_none")]
    pub repetition: Option<Repetition>,
    /// What is for people only.
    #[serde(flatten)]
    pub text: CueText,
}

/// What a cue says for people. No robot does anything because of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CueText {
    /// The remark of the choreographer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// A movement that is repeated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Repetition {
    /// How often it is played, more than once.
    pub times: u32,
    /// The length of one of them.
    #[serde(rename = "length_ms")]
    pub length: Span,
    /// How much later each begins than the one before it.
    #[serde(rename = "every_ms")]
    pub every: Span,
}

/// How the steps of a device came about.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceUse {
    /// Which robot.
    pub robot: RobotId,
    /// Which of its devices.
    pub device: DeviceId,
    /// Steps in all its scripts.
    pub steps: usize,
    /// No way of placing steps needs fewer.
    pub at_least: usize,
    /// Scripts, one after another.
    pub scripts: usize,
    /// Steps that the device can hold: max_number_of_steps for each script of its queue.
    pub budget: u64,
    /// Largest difference from the movement as written, in the device's unit.
    pub worst_error: f64,
    /// When that is, from the act's start.
    pub worst_at: Span,
    /// The largest factor of the speed of the show at which its movements stay within the limits of speed and acceleration; infinite
    /// without such limits.
    #[serde(skip)]
    pub factor_max: f64,
    /// The same factor for the ways to its first keyframe from the positions in which other acts leave the device.
    #[serde(skip)]
    pub entry_factor_max: f64,
    /// The largest speed that its block and the fleet file allow, driven by position, in its unit per second.
    #[serde(skip)]
    pub speed_max: Option<f64>,
    /// Whether it moves between positions without any limit of its speed, so that no movement is too fast for it.
    #[serde(skip)]
    pub is_unlimited: bool,
}

/// The place of the first script of a device in a choreography.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirstUse {
    /// Index of the act.
    pub act: usize,
    /// Index of the robot in the plan of the act.
    pub robot: usize,
    /// Index of the script among those of the robot.
    pub script: usize,
}

impl Choreography {
    /// The first script of each device in the act `first` and the acts that follow it by `next`. Acts that follow only a failure or a
    /// wait that has timed out are left out.
    #[must_use]
    pub fn first_uses(&self, first: usize) -> Vec<FirstUse> {
        let mut uses = Vec::new();
        let (mut known, mut visited) = (HashSet::new(), HashSet::new());
        let mut next = Some(first);
        while let Some(index) = next.filter(|index| visited.insert(*index)) {
            let Some(act) = self.acts.get(index) else { break };
            for (robot, planned) in act.plan.robots.iter().enumerate() {
                for (script, written) in planned.scripts.iter().enumerate() {
                    if known.insert((&planned.robot, &written.device)) {
                        uses.push(FirstUse { act: index, robot, script });
                    }
                }
            }
            next = match act.next {
                Way::Act(act) => Some(act),
                Way::End | Way::Fail => None,
            };
        }
        uses
    }

    /// The position that a first use expects. `None` if it does not drive the device by position.
    #[must_use]
    pub fn first_position(&self, first: FirstUse) -> Option<(&RobotId, &DeviceId, f64)> {
        let planned = self.acts.get(first.act)?.plan.robots.get(first.robot)?;
        let script = planned.scripts.get(first.script)?;
        let setpoint = &script.script.steps().first()?.setpoint;
        let is_position = setpoint.control_type == ControlType::Position;
        is_position.then_some((&planned.robot, &script.device, setpoint.value))
    }
}

impl RobotPlan {
    /// The first value of each device that is driven by position.
    pub fn first_positions(&self) -> impl Iterator<Item = (&DeviceId, f64)> {
        let mut known = HashSet::new();
        let firsts = self.scripts.iter().filter(move |script| known.insert(&script.device));
        firsts.filter_map(|script| {
            let first = &script.script.steps().first()?.setpoint;
            (first.control_type == ControlType::Position).then_some((&script.device, first.value))
        })
    }
}

/// A sensor is read at a time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedReading {
    /// Id of the robot that reads.
    pub robot: RobotId,
    /// The device of that robot that is a sensor.
    pub sensor: DeviceId,
    /// From the act's start.
    pub at: Span,
}

/// What has to be sent for one act.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The scenario's name, and the act's.
    pub scenario: String,
    /// Largest allowed spread of starts.
    pub start_tolerance: Span,
    /// Lead time that the scenario prescribes.
    pub lead: Option<Span>,
    /// The leases; without a pending one the scheduler computes it.
    pub stop_condition: StopCondition,
    /// The robots that move, in the order of the fleet.
    pub robots: Vec<RobotPlan>,
}

/// The scripts of one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotPlan {
    /// Id of the robot.
    pub robot: RobotId,
    /// In the order of the robot's devices, those of one device in order of time.
    pub scripts: Vec<DeviceScript>,
}

/// One script for one device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceScript {
    /// Id of the device that plays it.
    pub device: DeviceId,
    /// When it starts, from the start of the act.
    pub start: Millis,
    /// Its leases.
    pub stop_condition: StopCondition,
    /// What it does.
    pub script: Script,
    /// How much later than its last step the movement ends that it plays: until then the value stays.
    pub rest: Span,
}

impl DeviceScript {
    /// From its start to the end of the movement that it plays.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.script.duration() + self.rest
    }
}

impl Act {
    /// What it is called in reports: its name, or that of the scenario where it has none.
    #[must_use]
    pub fn called(&self) -> &str {
        if self.name.is_empty() { &self.plan.scenario } else { &self.name }
    }

    /// How long a device takes from a command to visible motion, as far as that is known.
    #[must_use]
    pub fn latency_of(&self, robot: &RobotId, device: &DeviceId) -> Span {
        let known = self.latencies.get(robot).and_then(|devices| devices.get(device));
        known.map_or(Span::ZERO, |known| known.latency.median)
    }

    /// When the motion of one of its scripts begins, from the act's start.
    #[must_use]
    pub fn moves_at(&self, robot: &RobotId, script: &DeviceScript) -> Span {
        script.start.span() + self.latency_of(robot, &script.device)
    }

    /// From the start of the act to the end of its last motion.
    #[must_use]
    pub fn duration(&self) -> Span {
        let ends = self.plan.robots.iter().flat_map(|robot| {
            robot.scripts.iter().map(|script| self.moves_at(&robot.robot, script) + script.duration())
        });
        ends.max().unwrap_or_default()
    }

    /// Whether people know it by this name; a scenario without acts of its own is known by the scenario's.
    #[must_use]
    pub fn is_named(&self, name: &str) -> bool {
        if self.name.is_empty() { self.plan.scenario == name } else { self.name == name }
    }
}

impl Plan {
    /// From the start of the act to its end by the time of commands.
    #[must_use]
    pub fn duration(&self) -> Span {
        let scripts = self.robots.iter().flat_map(|robot| &robot.scripts);
        scripts.map(|script| script.start.span() + script.duration()).max().unwrap_or_default()
    }
}

/// The same for equal scripts, and mostly another one for others.
fn fingerprint(script: &Script) -> u64 {
    let mut hasher = DefaultHasher::new();
    for step in script.steps() {
        // Adding zero makes one of the two zeros, which are equal.
        (step.offset.get() + 0.0).to_bits().hash(&mut hasher);
        (step.setpoint.value + 0.0).to_bits().hash(&mut hasher);
    }
    hasher.finish()
}

impl Choreography {
    /// One act, which begins at once and after which the mission ends.
    #[must_use]
    pub fn of_plan(plan: Plan) -> Self {
        let act = Act {
            name: String::new(),
            lead_in: Span::ZERO,
            latencies: BTreeMap::new(),
            cues: Vec::new(),
            devices: Vec::new(),
            in_space: InSpace::default(),
            readings: Vec::new(),
            wait: Wait::Done,
            timeout: None,
            on_timeout: Way::Fail,
            next: Way::End,
            on_failure: FailurePolicy::default(),
            on_doubt: OnDoubt::default(),
            plan,
        };
        Self { scenario: act.plan.scenario.clone(), acts: vec![act], requirements: Requirements::default() }
            .with_shared_scripts()
    }

    /// The same choreography, in which scripts with equal steps are one: groups in unison take no more memory than one robot,
    /// and what is computed of a script, as its hash and its text, is computed once.
    #[must_use]
    pub fn with_shared_scripts(mut self) -> Self {
        let mut known: HashMap<u64, Vec<Script>> = HashMap::new();
        let robots = self.acts.iter_mut().flat_map(|act| &mut act.plan.robots);
        for device in robots.flat_map(|robot| &mut robot.scripts) {
            let alike = known.entry(fingerprint(&device.script)).or_default();
            match alike.iter().find(|script| **script == device.script) {
                Some(script) => device.script = script.clone(),
                None => alike.push(device.script.clone()),
            }
        }
        self
    }

    /// The closest that two bodies come in any act, with that act. `None` where no two bodies are known.
    #[must_use]
    pub fn closest(&self) -> Option<(&Act, &Closest)> {
        let known = self.acts.iter().filter_map(|act| Some((act, act.in_space.closest.as_ref()?)));
        known.min_by(|(_, a), (_, b)| a.distance.total_cmp(&b.distance))
    }

    /// The acts one after another from the first, each followed by its `next`; ends before an act that was there already.
    #[must_use]
    pub fn main_line(&self) -> Vec<usize> {
        let mut line = Vec::new();
        let mut next = (!self.acts.is_empty()).then_some(0);
        while let Some(act) = next.filter(|act| !line.contains(act)) {
            line.push(act);
            next = match self.acts[act].next {
                Way::Act(act) => Some(act),
                Way::End | Way::Fail => None,
            };
        }
        line
    }
}

/// Whether a control type drives a rate, which continues until something changes it.
#[must_use]
pub const fn is_rate(control_type: ControlType) -> bool {
    matches!(control_type, ControlType::Speed | ControlType::Acceleration)
}

#[cfg(test)]
mod tests {
    use urrcp::{Setpoint, Step};

    use super::*;

    #[test]
    fn scripts_with_equal_steps_are_one_and_others_stay_as_they_are() {
        let script = |value: f64, running: Option<f64>| {
            let step = Step {
                stop_condition: running.map(|millis| StopCondition::both(Millis::new(millis).unwrap())),
                ..Step::new(Millis::new(5.0).unwrap(), Setpoint::new(ControlType::Position, value))
            };
            DeviceScript {
                device: DeviceId::new("d").unwrap(),
                start: Millis::new(0.0).unwrap(),
                stop_condition: StopCondition::default(),
                script: Script::new(vec![step]).unwrap(),
                rest: Span::ZERO,
            }
        };
        let variants = [(1.0, None), (2.0, None), (1.0, Some(9.0)), (0.0, None), (-0.0, None), (1.0, None)];
        let robot = |id: &str| RobotPlan {
            robot: RobotId::new(id).unwrap(),
            scripts: variants.map(|(value, running)| script(value, running)).into(),
        };
        let plan = Plan {
            scenario: "s".into(),
            start_tolerance: Span::ZERO,
            lead: None,
            stop_condition: StopCondition::default(),
            robots: vec![robot("a"), robot("b")],
        };
        let shared = Choreography::of_plan(plan.clone());
        assert_eq!(shared.acts[0].plan, plan);
        let steps = |robot: usize, script: usize| {
            shared.acts[0].plan.robots[robot].scripts[script].script.steps().as_ptr()
        };
        let first: Vec<_> = (0..variants.len()).map(|script| steps(0, script)).collect();
        assert_eq!((0..variants.len()).map(|script| steps(1, script)).collect::<Vec<_>>(), first);
        let one = |a: usize, b: usize| first[a] == first[b];
        let are_one = [one(0, 5), one(3, 4), one(0, 1), one(0, 2), one(1, 3)];
        assert_eq!(are_one, [true, true, false, false, false]);
    }
}
