//! Acts that are planned after a stop. Once all robots rest, such an act moves their devices to their default positions, or to the first
//! positions of the act that follows a failure. The mission plans it from the positions that the robots report, and prepares, commits and
//! watches it like any other act.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use downbeat_plan::{Act as Written, Choreography, Positions, Way};
use serde::Serialize;
use urrcp::{DeviceId, RobotId, Server, Timestamp};

use super::act::Act;
use super::fates::ActCourse;
use super::poses::{FirstUses, first_uses};
use super::robot_state::{Rest, RobotState, Standing, Stop};
use super::script::Script;
use super::{ActIndex, Mission, Outcome, Progress, RobotIndex};

/// The destination of an act that is planned after a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Destination {
    /// The default positions of devices.
    Home,
    /// The first positions of the act with this index.
    Act(ActIndex),
}

/// Plans acts after a stop. A scheduler that has the fleet file uses the compiler for this.
pub trait PlanTransfer: fmt::Debug + Send + Sync {
    /// Plans an act that moves devices from these positions to their destination. Leases and tolerances are those of the act
    /// `like`. Returns `None` if nothing has to move.
    ///
    /// # Errors
    /// Fails with the reason, as text for users, if no such act can be planned.
    fn plan(
        &self,
        choreography: &Choreography,
        to: Destination,
        like: ActIndex,
        from: &Positions,
    ) -> Result<Option<Written>, String>;
}

/// The outcome of a transfer after a stop.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
#[serde(rename_all = "snake_case")]
pub enum TransferReport {
    /// An act was planned. The lists `course` and `acts` of the report contain it.
    Planned {
        /// The name of the act.
        act: String,
        /// Robots that stayed where they came to rest, because they have failed or do not report their positions.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        without: Vec<RobotId>,
    },
    /// All devices were already at their destinations.
    NothingToMove,
    /// All robots stayed where they came to rest.
    NotPlanned {
        /// The reason why no act was planned, as text for users.
        reason: String,
    },
}

/// The state of the act that is planned after a stop, from the request for it to the arrival of the robots.
#[derive(Debug, Default)]
pub(super) struct Transfer {
    stage: Stage,
    /// For each robot: the first use of each device, starting with the next act, and the device's largest speed in the act of that use.
    firsts: FirstUses,
    /// The positions that each robot reported last, by its index in the mission.
    poses: BTreeMap<RobotIndex, Pose>,
    /// Indices of the robots that have done all their steps of the move home.
    there: Vec<RobotIndex>,
    pub(super) home: Option<TransferReport>,
    pub(super) approach: Option<TransferReport>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stage {
    #[default]
    Unwanted,
    /// A transfer is requested, and the robots come to rest first. The planned act takes its settings from the act with the index `like`.
    Wanted { to: Destination, like: ActIndex },
    /// The move home is the act with this index.
    GoingHome { act: ActIndex },
}

/// The positions that a robot reported last.
#[derive(Debug, Default)]
struct Pose {
    stated: Option<BTreeMap<DeviceId, f64>>,
    /// Whether the robot reported the same positions twice.
    rests: bool,
}

impl Transfer {
    fn note(&mut self, to: Destination, report: TransferReport) {
        match to {
            Destination::Home => self.home = Some(report),
            Destination::Act(_) => self.approach = Some(report),
        }
    }
}

impl Mission {
    /// Notes whether a move home is requested, and returns how robots come to rest first: in place, if the mission can plan that move.
    pub(super) fn rest_first(&mut self, rest: Rest) -> Rest {
        let plans = self.options.transfer.is_some();
        let like = self.acts.first().map_or(self.options.first_act, Act::index);
        self.transfer.poses.clear();
        self.transfer.stage = match rest {
            Rest::Home if plans => Stage::Wanted { to: Destination::Home, like },
            Rest::Home | Rest::InPlace => Stage::Unwanted,
        };
        if plans { Rest::InPlace } else { rest }
    }

    /// Requests an approach (a move to the first positions of this act) after the stop, unless the robots go home first.
    pub(super) fn approaches(&mut self, act: ActIndex) {
        if self.transfer.stage == Stage::Unwanted && self.options.transfer.is_some() {
            self.transfer.stage = Stage::Wanted { to: Destination::Act(act), like: act };
            let index_of = self.robots.enumerated().map(|(index, robot)| (&robot.id, index)).collect();
            self.transfer.firsts = first_uses(&self.choreography, act, &index_of);
        }
    }

    /// Keeps the robots where they are, because the journal is lost and no further scripts can be promised.
    pub(super) fn stays(&mut self) {
        if self.wants_home() {
            let reason = "the journal can no longer be written".to_owned();
            self.not_planned(Destination::Home, reason);
        }
        self.transfer.stage = Stage::Unwanted;
    }

    fn not_planned(&mut self, to: Destination, reason: String) {
        self.tell(match to {
            Destination::Home => Progress::NotHome { reason: reason.clone() },
            Destination::Act(act) => {
                let act = self.choreography.acts[act.get()].called().to_owned();
                Progress::NotApproached { act, reason: reason.clone() }
            }
        });
        self.transfer.note(to, TransferReport::NotPlanned { reason });
    }

    pub(super) const fn is_on_its_way_home(&self) -> bool {
        matches!(self.transfer.stage, Stage::GoingHome { .. })
    }

    pub(super) const fn wants_home(&self) -> bool {
        matches!(self.transfer.stage, Stage::Wanted { to: Destination::Home, .. })
    }

    /// Returns the reason for a stop, and adds that the move home follows if it was requested.
    pub(super) fn with_home(&self, reason: String) -> String {
        if self.wants_home() { format!("{reason}; then home") } else { reason }
    }

    /// Whether a robot at rest reports its positions for the transfer.
    fn takes_part(&self, robot: RobotIndex) -> bool {
        let Stage::Wanted { to, .. } = self.transfer.stage else { return false };
        let state = &self.robots[robot];
        let can = state.standing == Standing::In && state.takes_inquiries();
        let devices = !state.halt.touched.is_empty() || !self.first_devices(to, robot).is_empty();
        can && state.is_up() && state.is_settled() && devices
    }

    /// The devices of a robot that the next act, or a later act that follows it, moves. Empty for the move home.
    fn first_devices(&self, to: Destination, robot: RobotIndex) -> BTreeSet<DeviceId> {
        match to {
            Destination::Home => BTreeSet::new(),
            Destination::Act(_) => self.transfer.firsts[robot].keys().cloned().collect(),
        }
    }

    /// The devices of a robot that will not rest at a known position after the transfer.
    fn left_adrift(&self, to: Destination, robot: RobotIndex) -> BTreeSet<DeviceId> {
        let state = &self.robots[robot];
        if !self.transfer.poses.get(&robot).is_some_and(|pose| pose.rests) {
            return &state.halt.touched | &self.first_devices(to, robot);
        }
        match to {
            Destination::Act(_) => &state.halt.touched - &self.first_devices(to, robot),
            Destination::Home => state.devices_without_home(),
        }
    }

    /// Asks robots at rest for the positions of their devices. Returns whether all of them have reported positions that no longer change.
    /// A device slows down for some time after its robot has confirmed the stop.
    pub(super) fn poses_are_known(&mut self, now: Timestamp<Server>) -> bool {
        let mut known = true;
        for robot in self.robots.indices() {
            match self.transfer.poses.get(&robot) {
                _ if !self.takes_part(robot) => {}
                Some(pose) => known &= pose.rests,
                None => {
                    known = false;
                    self.transfer.poses.insert(robot, Pose::default());
                    self.ask_pose(now, robot);
                }
            }
        }
        known
    }

    /// Asks robots again if their positions are unknown or still change.
    pub(super) fn ask_poses_again(&mut self, now: Timestamp<Server>) {
        let moving = |(robot, pose): (&RobotIndex, &Pose)| (!pose.rests).then_some(*robot);
        let moving: Vec<_> = self.transfer.poses.iter().filter_map(moving).collect();
        for robot in moving {
            if self.takes_part(robot) {
                self.ask_pose(now, robot);
            }
        }
    }

    fn ask_pose(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let Stage::Wanted { to, .. } = self.transfer.stage else { return };
        // The act also has to avoid collisions with devices that stay.
        let devices = self.devices_to_place(to, robot);
        self.robots[robot].forget_positions();
        self.ask_positions_of(now, robot, &Vec::from_iter(devices));
    }

    /// The devices of a robot whose positions the transfer needs.
    fn devices_to_place(&self, to: Destination, robot: RobotIndex) -> BTreeSet<DeviceId> {
        &self.robots[robot].halt.touched | &self.first_devices(to, robot)
    }

    /// Handles an answer of a robot. The robot's positions are valid once it has reported all of them. A robot may also report positions
    /// of devices about which it was not asked; the transfer must not move these devices.
    pub(super) fn pose_stated(&mut self, robot: RobotIndex) {
        let Stage::Wanted { to, .. } = self.transfer.stage else { return };
        let devices = self.devices_to_place(to, robot);
        let state = &self.robots[robot];
        let Some(pose) = self.transfer.poses.get_mut(&robot).filter(|_| state.pose.owed == 0) else {
            return;
        };
        let mut stated = state.pose.commanded.clone();
        stated.retain(|device, _| devices.contains(device));
        pose.rests = pose.stated.as_ref() == Some(&stated);
        pose.stated = Some(stated);
    }

    /// Begins the transfer at the end of a stop. Returns whether the mission continues with it.
    pub(super) fn begins_transfer(&mut self, now: Timestamp<Server>, rests: bool) -> bool {
        let stage = std::mem::take(&mut self.transfer.stage);
        let Stage::Wanted { to, like } = stage else {
            self.robots.iter_mut().for_each(RobotState::is_left_adrift);
            return false;
        };
        if to != Destination::Home && !rests {
            // A robot may still move, so no act follows.
            return false;
        }
        let planned = self.plan_transfer(now, to, like);
        for robot in self.robots.indices() {
            self.robots[robot].pose.adrift = self.left_adrift(to, robot);
        }
        match planned {
            Err(reason) => {
                // The next act expects devices where the transfer would have moved them.
                self.course.then = None;
                self.not_planned(to, reason);
                false
            }
            Ok(None) => {
                self.transfer.note(to, TransferReport::NothingToMove);
                if to == Destination::Home {
                    self.tell(Progress::AtHome);
                    self.transfer.there = self.transfer.poses.keys().copied().collect();
                    if self.course.then.is_none() {
                        self.arrive_home();
                    }
                }
                false
            }
            Ok(Some(act)) => {
                self.play_transfer(now, to, act);
                true
            }
        }
    }

    fn plan_transfer(
        &self,
        now: Timestamp<Server>,
        to: Destination,
        like: ActIndex,
    ) -> Result<Option<Written>, String> {
        let Some(planner) = &self.options.transfer else { return Ok(None) };
        let moves = |robot: &&RobotState| robot.may_move_at(now);
        if let Some(moving) = self.robots.iter().find(moves) {
            return Err(format!("`{}` has not confirmed its stop and may still move", moving.id));
        }
        let mut from = Positions::new();
        let states = self.transfer.poses.iter().map(|(robot, pose)| (&self.robots[*robot], pose));
        for (state, pose) in states.filter(|(state, _)| state.standing == Standing::In) {
            match pose.stated.as_ref().filter(|_| pose.rests) {
                Some(stated) => _ = from.insert(state.id.clone(), stated.clone()),
                None if state.is_up() && state.is_settled() => {
                    return Err(format!("`{}` has not reported where its devices came to rest", state.id));
                }
                None => {}
            }
        }
        let stays = self.robots.iter().find(|robot| !robot.halt.touched.is_empty());
        if let Some(stays) = stays.filter(|_| from.is_empty() && to == Destination::Home) {
            return Err(format!("`{}` has failed or does not report its positions", stays.id));
        }
        planner.plan(&self.choreography, to, like, &from)
    }

    fn play_transfer(&mut self, now: Timestamp<Server>, to: Destination, mut act: Written) {
        let index = ActIndex::new(self.choreography.acts.len());
        act.next = self.course.then.take().map_or(Way::End, |act| Way::Act(act.get()));
        let states = |robot: RobotIndex| self.transfer.poses.get(&robot).is_some_and(|pose| pose.rests);
        let has_part = |robot: RobotIndex| match to {
            Destination::Home => !self.robots[robot].halt.touched.is_empty(),
            Destination::Act(_) => !self.first_devices(to, robot).is_empty(),
        };
        let stay = self.robots.indices().filter(|robot| has_part(*robot) && !states(*robot));
        let without = stay.map(|robot| self.robots[robot].id.clone()).collect();
        // If no act follows, the confirmed stop of a robot that has nothing to move remains valid.
        let goes = |robot: &RobotState| act.plan.robots.iter().any(|planned| planned.robot == robot.id);
        let rests = |robot: &RobotState| matches!(robot.halt.stop, Stop::Confirmed(_)) && !goes(robot);
        let ends = act.next == Way::End;
        let rest: Vec<_> =
            self.robots.indices().filter(|robot| ends && rests(&self.robots[*robot])).collect();
        let name = act.name.clone();
        self.transfer.note(to, TransferReport::Planned { act: name.clone(), without });
        self.course.fates.push(ActCourse { act: name.clone(), ..ActCourse::default() });
        Arc::make_mut(&mut self.choreography).acts.push(act);
        let choreography = Arc::clone(&self.choreography);
        let told = match to {
            Destination::Home => {
                self.transfer.stage = Stage::GoingHome { act: index };
                Progress::GoingHome { act: name, choreography }
            }
            Destination::Act(to) => {
                let to = choreography.acts[to.get()].called().to_owned();
                Progress::Approaching { act: name, to, choreography }
            }
        };
        self.tell(told);
        self.continue_after_stop();
        for robot in rest {
            self.robots[robot].set_stop(Stop::Confirmed(Rest::InPlace));
        }
        self.line_up_act(now, index);
        self.goes_on(now);
    }

    /// Continues the mission after a stop. Its outcome can no longer be `done`.
    pub(super) fn continue_after_stop(&mut self) {
        let stopped = self.conclusion.outcome.take().filter(|outcome| *outcome == Outcome::Stopped);
        self.conclusion.flawed = Some(stopped.unwrap_or(Outcome::Failed));
        self.perform_again();
    }

    /// If this act was the move home, notes the robots that have done all their steps.
    pub(super) fn note_arrivals(&mut self, act: &Act) {
        if self.transfer.stage == (Stage::GoingHome { act: act.index() }) {
            let arrived = act.members().iter().filter(|member| {
                let mut scripts = member.scripts().iter();
                scripts.len() > 0 && scripts.all(Script::has_completed)
            });
            self.transfer.there = arrived.map(|member| member.robot).collect();
            self.transfer.stage = Stage::Unwanted;
        }
    }

    /// Notes which robots are in their default state at the end of a mission that ends with the move home: those that have done all their
    /// steps.
    pub(super) fn arrive_home(&mut self) {
        for robot in std::mem::take(&mut self.transfer.there) {
            let state = &mut self.robots[robot];
            if matches!(state.halt.stop, Stop::None | Stop::Confirmed(_)) {
                state.set_stop(Stop::Confirmed(Rest::Home));
                state.halt.rest_reported = true;
            }
        }
    }
}

impl RobotState {
    /// Notes the devices that a stop without a transfer has left at positions that the next act may not expect.
    fn is_left_adrift(&mut self) {
        self.pose.adrift = match self.halt.stop {
            Stop::Confirmed(Rest::Home) => self.devices_without_home(),
            Stop::Confirmed(Rest::InPlace) | Stop::Sent(_) | Stop::None => self.halt.touched.clone(),
        };
    }

    /// The devices that the mission has moved and that have no default position.
    fn devices_without_home(&self) -> BTreeSet<DeviceId> {
        let described = |device: &DeviceId| self.block.as_ref()?.device(device.as_str());
        let has_home = |device: &DeviceId| described(device)?.default_value;
        self.halt.touched.iter().filter(|device| has_home(device).is_none()).cloned().collect()
    }
}
