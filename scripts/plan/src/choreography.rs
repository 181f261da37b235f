//! The result types of compiling a scenario: acts, plans, and the scripts of each robot.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::hash::{DefaultHasher, Hash, Hasher};

use downbeat_fleet::fleet::DeviceLatency;
use downbeat_fleet::sensor_range::SensorRange;
use downbeat_space::space::{Closest, InSpace};
use serde::Serialize;
use urrcp::{ControlType, DeviceId, Millis, RobotId, Script, Server, Span, StopCondition, Timestamp};

use crate::requirements::Requirements;

/// Known position of each device of each robot, in the device's unit.
pub type Positions = BTreeMap<RobotId, BTreeMap<DeviceId, f64>>;

/// A compiled scenario: its acts and the transitions between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choreography {
    /// Name of the scenario.
    pub scenario: String,
    /// Acts in the order of the file; the mission begins with the first one.
    pub acts: Vec<Act>,
    /// Bounds that the scenario requires. They are not enforced during play.
    pub requirements: Requirements,
}

/// A group of scripts that are prepared together and, after one decision, started together, with the conditions before and the
/// transitions after it.
#[derive(Clone, Debug, PartialEq)]
pub struct Act {
    /// Name of the act, unique in the scenario; empty if the scenario has no acts of its own.
    pub name: String,
    /// The scripts to send. Each starts at its command time: earlier than its motion by the latency of the device.
    pub plan: Plan,
    /// Delay of the act's motions relative to the written times, so that devices with a latency can be commanded before they must move.
    /// All times in the fields below are motion times since the act's start and include this delay.
    pub lead_in: Span,
    /// Latencies that `plan` compensates: those of the moved devices whose latency is known.
    pub latencies: BTreeMap<RobotId, BTreeMap<DeviceId, DeviceLatency>>,
    /// Cues of the act in the order of the file, with their planned times.
    pub cues: Vec<PlannedCue>,
    /// For each device, how its steps were computed.
    pub devices: Vec<DeviceUse>,
    /// Movement of the robots in space during the act.
    pub in_space: InSpace,
    /// Sensor readings that are planned during the act.
    pub readings: Vec<PlannedReading>,
    /// Condition that must be met before the act begins.
    pub wait: Wait,
    /// Longest wait for the condition in `wait`; `None` for no limit.
    pub timeout: Option<Span>,
    /// Transition if the wait for the condition in `wait` times out.
    pub on_timeout: Way,
    /// Transition after the act has ended.
    pub next: Way,
    /// Reaction to a failed robot.
    pub on_failure: FailurePolicy,
    /// Reaction of the other robots while it is unknown whether a robot will start.
    pub on_doubt: OnDoubt,
}

/// A transition out of an act.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// Continue with the act at this index.
    Act(usize),
    /// End the mission successfully.
    End,
    /// End the mission as failed.
    Fail,
}

/// Reaction to a failed robot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FailurePolicy {
    /// Reaction to failures of robots without an entry in `robots`.
    pub default: OnFailure,
    /// Reactions to failures of single robots.
    pub robots: Vec<(RobotId, OnFailure)>,
    /// Index of the act that follows a failure; `None` if no act follows.
    pub then: Option<usize>,
}

impl FailurePolicy {
    /// Returns the default reaction, then the reactions for single robots.
    pub fn policies(&self) -> impl Iterator<Item = OnFailure> {
        std::iter::once(self.default).chain(self.robots.iter().map(|(_, rule)| *rule))
    }

    /// Whether the failure of any robot sends all robots to their default state.
    #[must_use]
    pub fn sends_home(&self) -> bool {
        self.policies().all(|rule| rule == OnFailure::Home)
    }
}

/// What the other robots do when a robot has failed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OnFailure {
    /// All robots stop where they are.
    #[default]
    Stop,
    /// All robots go to their default state.
    Home,
    /// The other robots continue.
    Without,
}

/// Reaction of the other robots when it is unknown whether a robot will start: its link is silent or broken shortly before the start. If
/// the robot's state is known, there is no doubt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OnDoubt {
    /// The other robots start. If the silent robot is gone, they begin without it.
    #[default]
    Start,
    /// The other robots do not move. If the silent robot starts, it moves alone until its lease (the longest permitted silence of the
    /// scheduler) has ended.
    Withdraw,
}

/// Condition for the start of an act.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Wait {
    /// The previous act has ended on all robots.
    #[default]
    Done,
    /// The operator gives the go.
    Operator,
    /// A time of day by the server's clock, since local midnight.
    TimeOfDay(Span),
    /// An instant by the server's clock.
    Instant(Timestamp<Server>),
    /// A sensor reading within a range.
    Sensor {
        /// Id of the robot that has the sensor.
        robot: String,
        /// Device id of the sensor.
        sensor: String,
        /// The accepted readings.
        range: SensorRange,
    },
}

/// A cue with its times since the act's start.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedCue {
    /// Name of the cue.
    pub name: String,
    /// Time at which the cue starts, since the act's start.
    pub start: Span,
    /// Time at which the last robot of the cue finishes, since the act's start.
    pub end: Span,
    /// Largest delay of the cue's start that keeps all its relations to other cues and does not delay the end of the act.
    pub slack: Span,
    /// Whether the cue is on the critical path: a chain of relations without slack from the cue to the end of the act. A cue fixed by
    /// `at` has no slack either, but is not critical if other cues end later.
    pub critical: bool,
    /// Repetition of the cue's movement; `None` if it plays once.
    #[serde(rename = "repeat", skip_serializing_if = "Option::is_none")]
    pub repetition: Option<Repetition>,
    /// Text for people; it does not affect any robot.
    #[serde(flatten)]
    pub text: CueText,
}

/// Text for people that is attached to a cue. It does not affect any robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CueText {
    /// The choreographer's remark on the cue.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// How often and at which interval a movement is repeated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Repetition {
    /// Number of times the movement is played, at least 2.
    pub times: u32,
    /// Length of a single repetition.
    #[serde(rename = "length_ms")]
    pub length: Span,
    /// Interval between the starts of successive repetitions.
    #[serde(rename = "every_ms")]
    pub every: Span,
}

/// The steps computed for one device in an act, and how they compare with its limits.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceUse {
    /// Id of the robot.
    pub robot: RobotId,
    /// Id of the device on this robot.
    pub device: DeviceId,
    /// Number of steps in all scripts of the device.
    pub steps: usize,
    /// Lower bound on `steps`: no other choice of steps needs fewer.
    pub at_least: usize,
    /// Number of scripts into which the steps are divided; they follow each other.
    pub scripts: usize,
    /// Number of steps that the device can hold: `max_number_of_steps` for each script of its queue.
    pub budget: u64,
    /// Largest deviation from the movement as written, in the device's unit.
    pub worst_error: f64,
    /// Time of the largest deviation, since the act's start.
    pub worst_at: Span,
    /// Largest factor for the speed of the show at which the device's movements stay within its limits of speed and acceleration;
    /// infinite without such limits.
    #[serde(skip)]
    pub factor_max: f64,
    /// Like `factor_max`, but for the moves to the device's first keyframe from the positions in which other acts leave the device.
    #[serde(skip)]
    pub entry_factor_max: f64,
    /// Largest speed under position control that the device's block and the fleet file allow, in the device's unit per second; `None` if
    /// it is unlimited.
    #[serde(skip)]
    pub speed_max: Option<f64>,
    /// Whether the device's speed between positions is unlimited, so that no movement is too fast for it.
    #[serde(skip)]
    pub is_unlimited: bool,
}

/// Indices of the first script of a device in a choreography.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirstUse {
    /// Index of the act.
    pub act: usize,
    /// Index of the robot in the act's plan.
    pub robot: usize,
    /// Index of the script in the robot's plan.
    pub script: usize,
}

impl Choreography {
    /// Returns the first script of each device in act `first` and the acts that follow it by `next`. Acts that follow only a failure or a
    /// timed-out wait are excluded.
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

    /// Returns the robot and the device of a first script, and the position at which the script begins. `None` if it does not begin with
    /// position control.
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
    /// Returns the first value of each device whose first step uses position control.
    pub fn first_positions(&self) -> impl Iterator<Item = (&DeviceId, f64)> {
        let mut known = HashSet::new();
        let firsts = self.scripts.iter().filter(move |script| known.insert(&script.device));
        firsts.filter_map(|script| {
            let first = &script.script.steps().first()?.setpoint;
            (first.control_type == ControlType::Position).then_some((&script.device, first.value))
        })
    }
}

/// A planned reading of a sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedReading {
    /// Id of the robot that has the sensor.
    pub robot: RobotId,
    /// Device id of the sensor.
    pub sensor: DeviceId,
    /// Time of the reading, since the act's start.
    pub at: Span,
}

/// The scripts of one act.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Name of the scenario and, if it has one, of the act.
    pub scenario: String,
    /// Largest allowed difference between the robots' start times.
    pub start_tolerance: Span,
    /// Time from sending the act to its start; `None` if the scenario does not prescribe it.
    pub lead: Option<Span>,
    /// Leases of the scripts: how long a robot keeps them without contact with the scheduler. If no lease before the start (`pending`) is
    /// set, the scheduler computes one.
    pub stop_condition: StopCondition,
    /// The robots that move, in the order of the fleet.
    pub robots: Vec<RobotPlan>,
}

/// The scripts of one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotPlan {
    /// Id of the robot.
    pub robot: RobotId,
    /// Scripts in the order of the robot's devices; those of one device are in order of time.
    pub scripts: Vec<DeviceScript>,
}

/// One script for one device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceScript {
    /// Id of the device that plays the script.
    pub device: DeviceId,
    /// Command time at which the script starts, since the act's start.
    pub start: Millis,
    /// Leases of the script: how long the robot keeps it without contact with the scheduler, before and after its start.
    pub stop_condition: StopCondition,
    /// Steps of the script.
    pub script: Script,
    /// Time from the script's last step to the end of its movement, during which the device holds the value.
    pub rest: Span,
}

impl DeviceScript {
    /// Returns the time from the script's start to the end of its movement.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.script.duration() + self.rest
    }
}

impl Act {
    /// Returns the name for reports: the act's own or, if it is empty, the scenario's.
    #[must_use]
    pub fn called(&self) -> &str {
        if self.name.is_empty() { &self.plan.scenario } else { &self.name }
    }

    /// Returns the time from a command to the device to its visible motion; zero if the latency is unknown.
    #[must_use]
    pub fn latency_of(&self, robot: &RobotId, device: &DeviceId) -> Span {
        let known = self.latencies.get(robot).and_then(|devices| devices.get(device));
        known.map_or(Span::ZERO, |known| known.latency.median)
    }

    /// Returns the time at which the motion of `script` begins, since the act's start.
    #[must_use]
    pub fn moves_at(&self, robot: &RobotId, script: &DeviceScript) -> Span {
        script.start.span() + self.latency_of(robot, &script.device)
    }

    /// Returns the time from the start of the act to the end of its last motion.
    #[must_use]
    pub fn duration(&self) -> Span {
        let ends = self.plan.robots.iter().flat_map(|robot| {
            robot.scripts.iter().map(|script| self.moves_at(&robot.robot, script) + script.duration())
        });
        ends.max().unwrap_or_default()
    }

    /// Whether `name` refers to this act. An act without a name is referred to by the scenario's name.
    #[must_use]
    pub fn is_named(&self, name: &str) -> bool {
        if self.name.is_empty() { self.plan.scenario == name } else { self.name == name }
    }
}

impl Plan {
    /// Returns the time from the start of the act to the end of its last script, in command time (without the latencies of devices).
    #[must_use]
    pub fn duration(&self) -> Span {
        let scripts = self.robots.iter().flat_map(|robot| &robot.scripts);
        scripts.map(|script| script.start.span() + script.duration()).max().unwrap_or_default()
    }
}

/// Returns a number that is equal for scripts with equal steps and usually different for others.
fn fingerprint(script: &Script) -> u64 {
    let mut hasher = DefaultHasher::new();
    for step in script.steps() {
        // `0.0` and `-0.0` are equal; adding zero makes their bits equal, too.
        (step.offset.get() + 0.0).to_bits().hash(&mut hasher);
        (step.setpoint.value + 0.0).to_bits().hash(&mut hasher);
    }
    hasher.finish()
}

impl Choreography {
    /// Builds a choreography with a single act, which begins immediately and ends the mission.
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

    /// Makes scripts with equal steps share their memory. Robots that play in unison then need no more memory than one robot. Values
    /// derived from a script, such as its hash and text, are computed only once.
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

    /// Returns the closest approach of two bodies in any act, with that act. `None` if no act has two bodies with known positions.
    #[must_use]
    pub fn closest(&self) -> Option<(&Act, &Closest)> {
        let known = self.acts.iter().filter_map(|act| Some((act, act.in_space.closest.as_ref()?)));
        known.min_by(|(_, a), (_, b)| a.distance.total_cmp(&b.distance))
    }

    /// Returns the indices of the acts on the main line: the first act, then the acts that follow by `next`. Stops at an act that is
    /// already listed.
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

/// Whether a control type sets a speed or acceleration, which remains in effect until the next change.
#[must_use]
pub const fn is_rate(control_type: ControlType) -> bool {
    matches!(control_type, ControlType::Speed | ControlType::Acceleration)
}

#[cfg(test)]
mod tests {
    use urrcp::{Setpoint, Step};

    use super::*;

    #[test]
    fn scripts_with_equal_steps_are_shared_and_others_unchanged() {
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
