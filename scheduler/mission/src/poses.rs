//! Start poses: the positions of devices before the first act that moves them, and the positions that the first steps of that act
//! expect.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use downbeat_plan::{Choreography, DeviceScript, DeviceUse, FirstUse};
use urrcp::{
    ControlType, DeviceId, DeviceReport, InitializationBlock, Inquiry, Interpolation, Message, RobotId,
    Server, Span, Timestamp,
};

use super::act::Act;
use super::failure_kind::FailureKind;
use super::prepare::answers_within;
use super::robot_state::{Reading, RobotState, Standing};
use super::{ActIndex, ActNumber, Greeting, IndexVec, Join, Mission, Phase, RobotIndex};

/// The position that the first step of a device expects, with a tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Expected {
    pub(super) position: f64,
    /// Largest permitted distance from `position`.
    pub(super) within: f64,
}

/// The maximum time for which the mission asks again for the position of a device that a stop has left adrift. Such a device may still
/// slow down, so the mission asks until its position no longer changes.
pub(super) const SLOWS_MAX: Span = Span::from_millis(4_000);
/// Minimum time between two requests for a device's position, from the second request on.
const ASK_AGAIN: Span = Span::from_millis(100);
/// Minimum time between two requests for a position that a sensor reads. Within a shorter time, a device that still moves may move by
/// less than the error of its sensor.
const READ_AGAIN: Span = Span::from_millis(1_000);

/// Maximum number of sensors per robot that are read only for display.
const SHOWN_MAX: usize = 64;

/// Maximum number of devices in one inquiry, so that small robots can accept it.
const NAMES_MAX: usize = 100;

/// The positions of a robot's devices before an act.
#[derive(Debug, Default)]
pub(crate) struct Pose {
    /// Whether the robot's devices may no longer be where the greeting found them, because the robot joined late or is on a new link.
    pub(crate) unplaced: bool,
    /// Devices that a stop has left at positions that the next act with these devices may not expect.
    pub(crate) adrift: BTreeSet<DeviceId>,
    /// The last request for positions before an act, on the current link.
    pub(crate) asked: Option<PositionsAsked>,
    /// The positions of devices before the first act, as their sensors read them.
    pub(crate) read: Vec<(DeviceId, f64)>,
    /// The commanded positions of devices before the first act, as reported by the robot.
    pub(crate) commanded: BTreeMap<DeviceId, f64>,
    /// Number of pending answers about commanded positions.
    pub(crate) owed: usize,
}

/// A request for the positions of a robot's devices before an act.
#[derive(Clone, Debug)]
pub(crate) struct PositionsAsked {
    pub(crate) act: ActNumber,
    pub(crate) at: Timestamp<Server>,
    /// The time of the first request for positions before this act.
    pub(crate) since: Timestamp<Server>,
    /// The positions of adrift devices in the previous answer.
    pub(crate) before: BTreeMap<DeviceId, f64>,
}

impl RobotState {
    /// Twice the error of a device's position. The error is the one that the device declares, or its granularity if that is larger.
    /// `None` if the device is not described.
    fn error_of(&self, device: &DeviceId) -> Option<f64> {
        let described = self.block.as_ref()?.device(device.as_str())?;
        let limits = described.available_control_types.limits(ControlType::Position)?;
        Some(2.0 * limits.granularity.max(limits.max_error.unwrap_or(0.0)))
    }

    /// Whether the robot has answered all requests for readings and positions of its devices.
    pub(super) fn has_shown_its_pose(&self) -> bool {
        self.requests.awaited_readings().next().is_none() && self.pose.owed == 0
    }

    /// Whether the robot still owes an answer about the positions of its devices.
    fn owes_positions(&self) -> bool {
        self.pose.owed > 0
            || self.requests.awaited_readings().any(|what| matches!(what, Reading::Position(_)))
    }

    /// Whether the robot can be asked for the position of a device: by an inquiry, or else by its sensor.
    fn can_tell_position(&self, device: &DeviceId) -> bool {
        let described = || self.block.as_ref()?.device(device.as_str())?.available_control_types.sensor();
        self.takes_inquiries() || described().is_some()
    }

    /// Whether two reported positions of a device may be the same position: they differ by no more than the error of its sensor.
    fn is_same_position(&self, device: &DeviceId, one: f64, other: f64) -> bool {
        let is_read = self.pose.read.iter().any(|(read, _)| read == device);
        let error = self.error_of(device).filter(|_| is_read).unwrap_or_default();
        (one - other).abs() <= error
    }

    fn known_position(&self, device: &DeviceId) -> Option<f64> {
        self.known_positions().find_map(|(known, position)| (known == device).then_some(position))
    }

    /// The known positions of devices: the reading of the sensor, or else the commanded position.
    pub(super) fn known_positions(&self) -> impl Iterator<Item = (&DeviceId, f64)> {
        let is_read = |device: &DeviceId| self.pose.read.iter().any(|(read, _)| read == device);
        let commanded = self.pose.commanded.iter().filter(move |(device, _)| !is_read(device));
        let read = self.pose.read.iter().map(|(device, reading)| (device, *reading));
        read.chain(commanded.map(|(device, position)| (device, *position)))
    }

    /// Discards the known positions of the robot's devices, and stops awaiting the sensor readings of positions that the robot owes.
    pub(super) fn forget_positions(&mut self) {
        self.requests.forget_readings(|what| matches!(what, Reading::Position(_)));
        self.pose.read.clear();
        self.pose.commanded.clear();
    }
}

impl Mission {
    /// Asks for the positions of devices before the mission moves them: the readings of their sensors, and the commanded positions.
    pub(super) fn read_positions(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let mut devices = self.used_devices(robot);
        let state = &self.robots[robot];
        let Some(block) = &state.block else { return };
        devices.retain(|id| {
            let device = block.device(id.as_str());
            device.is_some_and(|device| device.available_control_types.sensor().is_some())
        });
        let shown =
            if self.options.preflight_only { others_that_read(state, block, &devices) } else { Vec::new() };
        for device in devices {
            self.read(now, robot, device.clone(), Reading::Position(device));
        }
        for device in shown {
            self.read(now, robot, device.clone(), Reading::Shown(device));
        }
    }

    /// Asks a robot for the commanded positions of its devices.
    pub(super) fn ask_positions(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &self.robots[robot];
        if self.options.greeting == Greeting::Skip || !state.takes_inquiries() || state.is_of_another() {
            return;
        }
        self.ask_positions_of(now, robot, &self.used_devices(robot));
    }

    pub(super) fn ask_positions_of(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        devices: &[DeviceId],
    ) {
        let parts: Vec<_> = devices.chunks(NAMES_MAX).map(<[DeviceId]>::to_vec).collect();
        self.robots[robot].pose.owed = parts.len();
        if parts.is_empty() {
            return;
        }
        self.robots[robot].contact.exchanges.asked(now, parts.len());
        let session = self.options.session_on_the_wire();
        for devices in parts {
            let inquiry =
                Inquiry { timestamp: Some(now), session: session.clone(), devices, ..Inquiry::default() };
            self.post(now, robot, Message::Inquiry(inquiry));
        }
    }

    /// Handles the answer to an inquiry, which may contain positions. Availability is checked separately.
    pub(super) fn positions_stated(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        devices: &[DeviceReport],
    ) {
        let state = &mut self.robots[robot];
        state.pose.owed = state.pose.owed.saturating_sub(1);
        let stated = devices.iter().filter_map(|device| Some((device.device_id.clone(), device.position?)));
        state.pose.commanded.extend(stated);
        match self.phase {
            Phase::Greeting { .. } => self.greeting_progress(now),
            Phase::Stopping { .. } => {
                self.pose_stated(robot);
                self.stop_progress(now);
            }
            _ => self.acts.iter_mut().for_each(|act| act.look_again_at(None)),
        }
    }

    /// Asks the robots of an act for the positions of devices that the greeting has not checked, and asks again while a device slows
    /// down. An act with a fixed start must be sent by `send_by`. Returns the time by which answers are due, if answers are still
    /// expected. A robot that joined late and does not answer by that time is marked as absent again.
    pub(super) fn await_positions(
        &mut self,
        now: Timestamp<Server>,
        index: usize,
        send_by: Option<Timestamp<Server>>,
    ) -> Option<Timestamp<Server>> {
        let number = self.acts[index].number();
        let (mut due, mut silent) = (None, Vec::new());
        for robot in self.unplaced(&self.acts[index]) {
            let asked = self.robots[robot].pose.asked.clone().filter(|asked| asked.act == number);
            let (mut at, next) = match asked {
                None => (
                    now,
                    Some((now, PositionsAsked { act: number, at: now, since: now, before: BTreeMap::new() })),
                ),
                Some(asked) => (asked.at, self.asked_again(now, index, robot, asked, send_by)),
            };
            due = due.max(next.as_ref().map(|(when, _)| *when).filter(|when| now < *when));
            if let Some((_, question)) = next.filter(|(when, _)| *when <= now) {
                let scripts = self.unplaced_of(&self.acts[index], robot);
                let devices: Vec<_> = scripts.map(|script| script.device.clone()).collect();
                self.robots[robot].forget_positions();
                at = question.at;
                self.robots[robot].pose.asked = Some(question);
                if self.robots[robot].takes_inquiries() {
                    self.ask_positions_of(now, robot, &devices);
                } else {
                    for device in devices {
                        self.read(now, robot, device.clone(), Reading::Position(device));
                    }
                }
            }
            let until = at + answers_within(&self.robots[robot]);
            if self.robots[robot].owes_positions() {
                if now < until { due = due.max(Some(until)) } else { silent.push(robot) }
            }
        }
        for robot in silent.into_iter().filter(|_| self.options.join == Join::NextAct) {
            let robot = &mut self.robots[robot];
            if robot.joined_late && robot.standing == Standing::In {
                robot.standing = Standing::Absent;
                // The act may have no robots left.
                due = Some(now);
            }
        }
        if due == Some(now) {
            self.acts.iter_mut().for_each(|act| act.gather(&self.robots));
        }
        due
    }

    /// The next request for positions to a robot that has answered, and when to send it. `None` once every adrift device has the same
    /// position as in the previous answer. If the next answer would come after `send_by`, it is enough that both answers show the device
    /// where the act expects it. Noise may be larger than the error that the device declares.
    fn asked_again(
        &self,
        now: Timestamp<Server>,
        index: usize,
        robot: RobotIndex,
        asked: PositionsAsked,
        send_by: Option<Timestamp<Server>>,
    ) -> Option<(Timestamp<Server>, PositionsAsked)> {
        let state = &self.robots[robot];
        if state.owes_positions() || now >= asked.since + SLOWS_MAX {
            return None;
        }
        let act = &self.acts[index];
        let scripts = || {
            let scripts = self.unplaced_of(act, robot);
            scripts.filter(|script| state.pose.adrift.contains(&script.device))
        };
        let stated = scripts().filter_map(|script| {
            let device = script.device.clone();
            Some((device, state.known_position(&script.device)?))
        });
        let stated: BTreeMap<DeviceId, f64> = stated.collect();
        let is_read = stated.keys().any(|device| state.pose.read.iter().any(|(read, _)| read == device));
        let at = match (is_read, asked.before.is_empty()) {
            (true, _) => now.max(asked.at + READ_AGAIN),
            (false, true) => now,
            (false, false) => now.max(asked.at + ASK_AGAIN),
        };
        let answered_at = at + answers_within(state);
        let is_last = send_by.is_some_and(|send_by| answered_at > send_by);
        let rests = |script: &DeviceScript| {
            let device = &script.device;
            let Some(position) = stated.get(device) else { return true };
            let Some(before) = asked.before.get(device) else { return false };
            let is_expected = |expected: Expected| {
                [before, position].iter().all(|at| (**at - expected.position).abs() <= expected.within)
            };
            state.is_same_position(device, *before, *position)
                || is_last && self.expected_in(act, robot, script).is_none_or(is_expected)
        };
        if scripts().all(rests) {
            return None;
        }
        Some((at, PositionsAsked { at, before: stated, ..asked }))
    }

    /// The robots of an act whose positions the mission has requested, and whose devices would have to jump at their first step. A robot
    /// that has not answered is included only if the positions of its devices are unchecked for this act.
    pub(super) fn unplaced_that_jump(&self, index: usize) -> Vec<(RobotIndex, FailureKind)> {
        let act = &self.acts[index];
        let jump = |robot: RobotIndex, script: &DeviceScript| {
            let reading = self.robots[robot].known_position(&script.device)?;
            let expected = self.expected_in(act, robot, script)?;
            let device = script.device.clone();
            // An approach moves devices before the first act, to the positions from which they first move by `next`.
            let is_first = act.number().get() == act.attempts();
            let approached = is_first && self.is_first_use(act, robot, &device);
            let act = (!approached).then(|| act.name());
            let kind = FailureKind::Position { device, reading, expected: expected.position, act };
            ((reading - expected.position).abs() > expected.within).then_some((robot, kind))
        };
        let unplaced = self.unplaced(act);
        let scripts =
            unplaced.iter().flat_map(|robot| self.unplaced_of(act, *robot).map(move |of| (*robot, of)));
        let jumping = scripts.filter_map(|(robot, script)| jump(robot, script));
        jumping.chain(unplaced.iter().filter_map(|robot| self.hides_its_pose(act, *robot))).collect()
    }

    /// The failure of a robot that still owes the positions of devices that are unchecked for this act, because one of them may jump.
    /// `None` for any other robot.
    fn hides_its_pose(&self, act: &Act, robot: RobotIndex) -> Option<(RobotIndex, FailureKind)> {
        let state = &self.robots[robot];
        let hides = state.owes_positions()
            && self.unplaced_of(act, robot).any(|script| !self.is_checked(act, robot, &script.device));
        let within = answers_within(state);
        let kind = || FailureKind::Silent { awaited: "positions of its devices".to_owned(), within };
        hides.then(|| (robot, kind()))
    }

    /// The robots of an act that the mission asks for the positions of their devices.
    fn unplaced(&self, act: &Act) -> Vec<RobotIndex> {
        let members = act.present().map(|member| member.robot);
        members.filter(|robot| self.unplaced_of(act, *robot).next().is_some()).collect()
    }

    /// The first scripts of the devices whose positions the mission asks for before an act. These are devices that a stop has left
    /// adrift, and devices that may have to jump. A device of the second kind is included only if its position is unchecked for this act
    /// and the mission has not moved it yet. With `handshake: skip`, the second kind is excluded. A device whose position the robot
    /// cannot report is always excluded.
    fn unplaced_of<'a>(&'a self, act: &'a Act, robot: RobotIndex) -> impl Iterator<Item = &'a DeviceScript> {
        let state = &self.robots[robot];
        let asks = self.options.greeting == Greeting::Full;
        let is_unplaced = move |script: &&DeviceScript| {
            let device = &script.device;
            let is_unchecked = || state.pose.unplaced || !self.is_checked(act, robot, device);
            let is_untouched = asks && !state.halt.touched.contains(device) && is_unchecked();
            let may_jump = || self.expected_in(act, robot, script).is_some();
            state.can_tell_position(device)
                && (state.pose.adrift.contains(device) || is_untouched && may_jump())
        };
        let member = act.member(robot).into_iter();
        member.flat_map(|member| member.firsts()).map(|script| &script.plan).filter(is_unplaced)
    }

    /// Whether the greeting has checked the position of a device for this act, and no stop has left the device adrift since.
    fn is_checked(&self, act: &Act, robot: RobotIndex, device: &DeviceId) -> bool {
        self.is_first_use(act, robot, device) && !self.robots[robot].pose.adrift.contains(device)
    }

    /// Whether this act is the first one that moves a device, in the order in which acts follow each other by `next`.
    fn is_first_use(&self, act: &Act, robot: RobotIndex, device: &DeviceId) -> bool {
        self.greeting.first_uses[robot].get(device).is_some_and(|(first, _)| first.act == act.index().get())
    }

    /// Whether a device would have to jump at its first step in this act, as far as its position is known. The mission has not moved the
    /// device yet.
    pub(super) fn would_jump(&self, act: &Act, robot: RobotIndex, script: &DeviceScript) -> bool {
        let state = &self.robots[robot];
        let known =
            state.known_position(&script.device).filter(|_| !state.halt.touched.contains(&script.device));
        let expected = self.expected_in(act, robot, script);
        known.zip(expected).is_some_and(|(at, expected)| (at - expected.position).abs() > expected.within)
    }

    /// The failures of a robot's devices that would have to jump at their first step.
    pub(super) fn misplaced(&self, index: RobotIndex) -> Vec<FailureKind> {
        let failure = |(device, reading): (&DeviceId, f64)| {
            let expected = self.expected_position(index, device)?;
            let jumps = (reading - expected.position).abs() > expected.within;
            let (device, expected) = (device.clone(), expected.position);
            jumps.then_some(FailureKind::Position { device, reading, expected, act: None })
        };
        self.robots[index].known_positions().filter_map(failure).collect()
    }

    /// Devices that may have to jump at their first step, because their positions are unknown.
    pub(super) fn unknown_positions(&self, index: RobotIndex) -> Vec<DeviceId> {
        let robot = &self.robots[index];
        let devices = self.used_devices(index).into_iter();
        devices
            .filter(|id| robot.known_position(id).is_none() && self.expected_position(index, id).is_some())
            .collect()
    }

    /// The positions of a robot's devices from which a future act starts: where the last command has left a device, unless its sensor
    /// shows that it is elsewhere.
    pub(super) fn positions_to_leave(&self, index: RobotIndex) -> BTreeMap<DeviceId, f64> {
        let robot = &self.robots[index];
        let mut positions = robot.pose.commanded.clone();
        for (device, reading) in &robot.pose.read {
            let error = robot.error_of(device).unwrap_or_default();
            if positions.get(device).is_none_or(|commanded| (commanded - reading).abs() > error) {
                positions.insert(device.clone(), *reading);
            }
        }
        positions
    }

    /// The devices that a robot uses in the first act and in the acts that follow it by `next`.
    fn used_devices(&self, robot: RobotIndex) -> Vec<DeviceId> {
        self.greeting.first_uses[robot].keys().cloned().collect()
    }

    /// The position that the first step expects of a device that moves linearly or has a largest speed. `None` if the device may be
    /// anywhere: a lamp, or a device that has enough time to reach that position from any other.
    ///
    /// The tolerance is twice the granularity or `max_error`, whichever is larger, plus the distance that the device can cover
    /// before its first step.
    pub(super) fn expected_position(&self, index: RobotIndex, device: &DeviceId) -> Option<Expected> {
        let (first, speed) = self.greeting.first_uses[index].get(device)?;
        let script = &self.choreography.acts[first.act].plan.robots[first.robot].scripts[first.script];
        self.expected_of(index, script, || *speed)
    }

    /// Like `expected_position`, but for the first script of a device in this act.
    fn expected_in(&self, act: &Act, robot: RobotIndex, script: &DeviceScript) -> Option<Expected> {
        let id = &self.robots[robot].id;
        let is_used = |used: &&DeviceUse| used.robot == *id && used.device == script.device;
        self.expected_of(robot, script, || act.written().devices.iter().find(is_used)?.speed_max)
    }

    /// Like `expected_position`, but for a given first script of a device, in an act in which the largest speed of the device is `speed`.
    fn expected_of(
        &self,
        index: RobotIndex,
        script: &DeviceScript,
        speed: impl FnOnce() -> Option<f64>,
    ) -> Option<Expected> {
        let (robot, device) = (&self.robots[index], &script.device);
        let step = script.script.steps().first()?;
        if step.setpoint.control_type != ControlType::Position {
            return None;
        }
        let block = robot.block.as_ref()?.device(device.as_str())?;
        let error = robot.error_of(device)?;
        let way = match block.interpolation {
            Interpolation::Linear if step.offset.span() == Span::ZERO => 0.0,
            Interpolation::Linear => speed()? * step.offset.get() / 1_000.0,
            Interpolation::Hold => speed().map(|_| 0.0)?,
        };
        Some(Expected { position: step.setpoint.value, within: error + way })
    }
}

/// For each robot: the first script of each device, and the largest speed of the device in the act of that script.
pub(super) type FirstUses = IndexVec<RobotIndex, BTreeMap<DeviceId, (FirstUse, Option<f64>)>>;

/// For each robot: the first use of each device, and the largest speed of the device in that act. `index_of` maps ids of robots to
/// their indices in the mission.
pub(super) fn first_uses(
    choreography: &Choreography,
    first_act: ActIndex,
    index_of: &HashMap<&RobotId, RobotIndex>,
) -> FirstUses {
    let mut uses = FirstUses::from(vec![BTreeMap::new(); index_of.len()]);
    let mut speeds = HashMap::new();
    for (act, written) in choreography.acts.iter().enumerate() {
        for used in &written.devices {
            speeds.insert((act, &used.robot, &used.device), used.speed_max);
        }
    }
    for first in choreography.first_uses(first_act.get()) {
        let planned = &choreography.acts[first.act].plan.robots[first.robot];
        let Some(robot) = index_of.get(&planned.robot) else { continue };
        let device = &planned.scripts[first.script].device;
        let speed = speeds.get(&(first.act, &planned.robot, device)).copied().flatten();
        uses[*robot].insert(device.clone(), (first, speed));
    }
    uses
}

/// Devices with sensors whose readings are only displayed.
fn others_that_read(robot: &RobotState, block: &InitializationBlock, read: &[DeviceId]) -> Vec<DeviceId> {
    let sensors = block.devices.iter().filter(|device| device.available_control_types.sensor().is_some());
    let others = sensors.map(|device| &device.id).filter(|id| {
        !read.contains(id) && !robot.settings.require.iter().any(|required| required.sensor == **id)
    });
    others.take(SHOWN_MAX).cloned().collect()
}
