//! The way home after a stop: once all robots rest, an act moves their devices to their default positions. The mission plans it
//! from the positions that the robots state, and prepares, commits and watches it like any other act.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::sync::Arc;

use downbeat_scripts::{Act as Written, Choreography, Positions, Way};
use serde::Serialize;
use urrcp::{DeviceId, RobotId, Server, Timestamp};

use super::act::Act;
use super::fates::ActCourse;
use super::robot_state::{Rest, RobotState, Standing, Stop};
use super::script::Script;
use super::{Mission, Outcome, Progress};

/// Plans the way home. A scheduler that has the fleet file uses the compiler for this.
pub trait PlanHome: fmt::Debug + Send + Sync {
    /// Plans an act that moves devices from these positions to their default positions. Leases and tolerances are those of the act
    /// `like`. Returns `None` if nothing has to move.
    ///
    /// # Errors
    /// If there is no such act, the reason, for people.
    fn plan(
        &self,
        choreography: &Choreography,
        like: usize,
        from: &Positions,
    ) -> Result<Option<Written>, String>;
}

/// The outcome of the way home.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum HomeReport {
    /// An act was planned. `course` and `acts` contain it.
    Planned {
        /// The name of the act.
        act: String,
        /// Robots that stayed where they came to rest, because they have failed or do not state their positions.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        without: Vec<RobotId>,
    },
    /// No device was away from its default position.
    NothingToMove,
    /// All robots stayed where they came to rest.
    NotPlanned {
        /// The reason, for people.
        reason: String,
    },
}

/// The state of the way home.
#[derive(Debug, Default)]
pub(super) struct Home {
    stage: Stage,
    /// The positions that each robot stated last, by its index in the mission.
    poses: HashMap<usize, Pose>,
    /// Indices of the robots that have done all their steps on the way home.
    there: Vec<usize>,
    pub(super) report: Option<HomeReport>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stage {
    #[default]
    Unwanted,
    /// Robots come to rest first. The act takes its settings from the act with this index.
    Wanted { like: usize },
    /// The way home is the act with this index.
    Planned { act: usize },
}

/// The positions that a robot stated last.
#[derive(Debug, Default)]
struct Pose {
    stated: Option<BTreeMap<DeviceId, f64>>,
    /// Whether it stated the same positions twice.
    rests: bool,
}

impl Mission {
    /// Returns how robots are stopped first. If the mission can plan the way home, they come to rest where they are.
    pub(super) fn rest_first(&mut self, rest: Rest) -> Rest {
        let plans = self.options.home.is_some();
        let like = self.acts.first().map_or(self.options.first_act, Act::index);
        self.home.stage = match rest {
            Rest::Home if plans => Stage::Wanted { like },
            Rest::Home | Rest::InPlace => Stage::Unwanted,
        };
        if plans { Rest::InPlace } else { rest }
    }

    /// Nothing more may be promised, so the robots stay where they are.
    pub(super) fn stays(&mut self) {
        if self.wants_home() {
            self.home.stage = Stage::Unwanted;
            let reason = "the journal can no longer be written".to_owned();
            self.tell(Progress::NotHome { reason: reason.clone() });
            self.home.report = Some(HomeReport::NotPlanned { reason });
        }
    }

    pub(super) const fn is_on_its_way_home(&self) -> bool {
        matches!(self.home.stage, Stage::Planned { .. })
    }

    pub(super) const fn wants_home(&self) -> bool {
        matches!(self.home.stage, Stage::Wanted { .. })
    }

    /// Adds to the reason of a stop that the way home follows.
    pub(super) fn with_home(&self, reason: String) -> String {
        if self.wants_home() { format!("{reason}; then home") } else { reason }
    }

    /// Whether a robot takes part in the way home.
    fn goes_home(&self, robot: usize) -> bool {
        let state = &self.robots[robot];
        let takes_part = state.standing == Standing::In && state.takes_inquiries();
        takes_part && state.is_up() && state.is_settled() && !state.touched.is_empty()
    }

    /// Asks robots at rest for the positions of their devices. Returns whether all of them have stated positions that no longer
    /// change: a device slows down for some time after its robot has confirmed the stop.
    pub(super) fn poses_are_known(&mut self, now: Timestamp<Server>) -> bool {
        let mut known = true;
        for robot in 0..self.robots.len() {
            if !self.wants_home() || !self.goes_home(robot) {
                continue;
            }
            match self.home.poses.get(&robot) {
                Some(pose) => known &= pose.rests,
                None => {
                    known = false;
                    self.home.poses.insert(robot, Pose::default());
                    self.ask_pose(now, robot);
                }
            }
        }
        known
    }

    /// Asks robots again if their positions are unknown or still change.
    pub(super) fn ask_poses_again(&mut self, now: Timestamp<Server>) {
        let moving = |(robot, pose): (&usize, &Pose)| (!pose.rests).then_some(*robot);
        let moving: Vec<_> = self.home.poses.iter().filter_map(moving).collect();
        for robot in moving {
            if self.wants_home() && self.goes_home(robot) {
                self.ask_pose(now, robot);
            }
        }
    }

    fn ask_pose(&mut self, now: Timestamp<Server>, robot: usize) {
        let devices: Vec<_> = self.robots[robot].touched.iter().cloned().collect();
        self.robots[robot].forget_positions();
        self.ask_positions_of(now, robot, &devices);
    }

    /// Handles an answer of a robot. Its positions count once it has stated all of them.
    pub(super) fn pose_stated(&mut self, robot: usize) {
        let state = &self.robots[robot];
        let Some(pose) = self.home.poses.get_mut(&robot).filter(|_| state.positions_owed == 0) else {
            return;
        };
        pose.rests = pose.stated.as_ref() == Some(&state.commanded);
        pose.stated = Some(state.commanded.clone());
    }

    /// Begins the way home at the end of a stop. Returns whether the mission continues.
    pub(super) fn sets_out_for_home(&mut self, now: Timestamp<Server>) -> bool {
        let Stage::Wanted { like } = self.home.stage else { return false };
        self.home.stage = Stage::Unwanted;
        match self.plan_home(now, like) {
            Err(reason) => {
                // The next act expects devices at their default positions.
                self.then = None;
                self.tell(Progress::NotHome { reason: reason.clone() });
                self.home.report = Some(HomeReport::NotPlanned { reason });
                false
            }
            Ok(None) => {
                self.home.report = Some(HomeReport::NothingToMove);
                self.home.there = self.home.poses.keys().copied().collect();
                if self.then.is_none() {
                    self.arrive_home();
                }
                false
            }
            Ok(Some(act)) => {
                self.play_home(now, act);
                true
            }
        }
    }

    fn plan_home(&self, now: Timestamp<Server>, like: usize) -> Result<Option<Written>, String> {
        let Some(planner) = &self.options.home else { return Ok(None) };
        let moves = |robot: &&RobotState| robot.may_move_at(now);
        if let Some(moving) = self.robots.iter().find(moves) {
            return Err(format!("`{}` has not confirmed its stop and may still move", moving.id));
        }
        let mut from = Positions::new();
        for (robot, pose) in &self.home.poses {
            let id = &self.robots[*robot].id;
            match pose.stated.as_ref().filter(|_| pose.rests) {
                Some(stated) => _ = from.insert(id.clone(), stated.clone()),
                None if self.goes_home(*robot) => {
                    return Err(format!("`{id}` has not stated where its devices came to rest"));
                }
                None => {}
            }
        }
        if from.is_empty()
            && let Some(stays) = self.robots.iter().find(|robot| !robot.touched.is_empty())
        {
            return Err(format!("`{}` has failed or does not state its positions", stays.id));
        }
        planner.plan(&self.choreography, like, &from)
    }

    fn play_home(&mut self, now: Timestamp<Server>, mut act: Written) {
        let index = self.choreography.acts.len();
        act.next = self.then.take().map_or(Way::End, Way::Act);
        let states = |robot: usize| self.home.poses.get(&robot).is_some_and(|pose| pose.rests);
        let stays = |robot: &usize| !self.robots[*robot].touched.is_empty() && !states(*robot);
        let stay = (0..self.robots.len()).filter(stays);
        let without = stay.map(|robot| self.robots[robot].id.clone()).collect();
        // If no act follows, the confirmed stop of a robot that has nothing to move remains valid.
        let goes = |robot: &RobotState| act.plan.robots.iter().any(|planned| planned.robot == robot.id);
        let rests = |robot: &RobotState| matches!(robot.stop, Stop::Confirmed(_)) && !goes(robot);
        let ends = act.next == Way::End;
        let rest: Vec<_> =
            (0..self.robots.len()).filter(|robot| ends && rests(&self.robots[*robot])).collect();
        self.home.report = Some(HomeReport::Planned { act: act.name.clone(), without });
        self.home.stage = Stage::Planned { act: index };
        self.fates.push(ActCourse { act: act.name.clone(), ..ActCourse::default() });
        let name = act.name.clone();
        Arc::make_mut(&mut self.choreography).acts.push(act);
        self.tell(Progress::GoingHome { act: name, choreography: Arc::clone(&self.choreography) });
        let stopped = self.outcome.take().filter(|outcome| *outcome == Outcome::Stopped);
        self.flawed = Some(stopped.unwrap_or(Outcome::Failed));
        self.perform_again();
        for robot in rest {
            self.robots[robot].stop = Stop::Confirmed(Rest::InPlace);
        }
        self.line_up_act(now, index);
        self.goes_on(now);
    }

    /// If this act was the way home, notes the robots that have done all their steps.
    pub(super) fn note_arrivals(&mut self, act: &Act) {
        if self.home.stage == (Stage::Planned { act: act.index() }) {
            let arrived = act.members().iter().filter(|member| {
                let mut scripts = member.scripts().iter();
                scripts.len() > 0 && scripts.all(Script::has_completed)
            });
            self.home.there = arrived.map(|member| member.robot).collect();
            self.home.stage = Stage::Unwanted;
        }
    }

    /// If the mission ends with the way home, the robots that have done all their steps are in their default state.
    pub(super) fn arrive_home(&mut self) {
        for robot in std::mem::take(&mut self.home.there) {
            let state = &mut self.robots[robot];
            if matches!(state.stop, Stop::None | Stop::Confirmed(_)) {
                (state.stop, state.rest_reported) = (Stop::Confirmed(Rest::Home), true);
            }
        }
    }
}
