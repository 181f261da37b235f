//! Taking up what another process promised before it died: to finish it, or to withdraw it.

use std::sync::Arc;

use downbeat_scripts::{Choreography, Requirements};
use urrcp::{Server, Timestamp};

use super::act::{Act, Reached};
use super::record::{ActOver, Promise};
use super::robot_state::{Rest, Standing};
use super::{Mission, MissionOptions, Outcome, Participant, Phase, ledger};
use crate::journal::{Kept, Left, Progressed};

/// A promise does not fit the choreography as it is now.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}: the scenario or the fleet has changed since; `downbeat stop` withdraws what was promised")]
pub struct Changed {
    /// What does not fit.
    pub what: String,
}

impl Mission {
    /// A mission that goes on with the acts that another process has decided and left.
    ///
    /// # Errors
    /// [`Changed`] where what was promised is not what the choreography says.
    pub fn resume(
        choreography: impl Into<Arc<Choreography>>,
        participants: Vec<Participant>,
        options: MissionOptions,
        left: &Kept,
        now: Timestamp<Server>,
    ) -> Result<Self, Changed> {
        let lost = |error: super::MissingParticipant| Changed { what: error.to_string() };
        let mut mission = Self::new(choreography, participants, options, now).map_err(lost)?;
        for robot in &mut mission.robots {
            if left.dropped.contains(&robot.id) {
                robot.standing = Standing::Out;
            }
        }
        left.flaws.iter().for_each(|flaws| mission.is_flawed(flaws));
        for ActOver { act, fate } in &left.course {
            let course = mission.fates.get_mut(*act);
            course.into_iter().for_each(|course| course.note(fate.clone()));
        }
        for (promise, progressed) in &left.promises {
            match progressed {
                Progressed::Prepared => {}
                Progressed::Decided => mission.take_up(promise, Reached::Decision, now)?,
                Progressed::Committed => mission.take_up(promise, Reached::Commitment, now)?,
            }
        }
        mission.note_as_sent(now);
        if mission.acts.is_empty() {
            return Err(Changed { what: "no act was decided and has not ended".to_owned() });
        }
        mission.phase = Phase::Performing;
        mission.stop_those_left_out(left, now);
        // The leases have been running out since the other process died.
        mission.next_round = Some(now);
        Ok(mission)
    }

    /// Robots that were left out and have not confirmed their stop: the process before may have died before it was sent.
    fn stop_those_left_out(&mut self, kept: &Kept, now: Timestamp<Server>) {
        let left = kept.left();
        for robot in 0..self.robots.len() {
            let id = &self.robots[robot].id;
            if kept.dropped.contains(id) && !kept.stopped.contains(id) {
                self.holds_still(robot, &left, now);
                self.stop_robot(now, robot, Rest::InPlace);
            }
        }
    }

    /// What another process has left on a robot, if anything.
    fn holds_still(&mut self, robot: usize, left: &Left, now: Timestamp<Server>) {
        let renewed_until = left.renewed_until.map_or(now, |until| until.min(now));
        let robot = &mut self.robots[robot];
        let Some(left) = left.robots.get(&robot.id) else { return };
        robot.touched.clone_from(&left.devices);
        robot.shift = left.shift;
        robot.left =
            left.leases.iter().map(|lease| lease.map(|lease| renewed_until + lease.span())).collect();
        if robot.left.is_empty() {
            robot.left.push(Some(renewed_until));
        }
    }

    /// A mission that does nothing but take back what another process left on its robots. `scenario` is the name of what that
    /// played.
    #[must_use]
    pub fn withdraw(
        scenario: String,
        participants: Vec<Participant>,
        options: MissionOptions,
        left: &Left,
        rest: Rest,
        now: Timestamp<Server>,
    ) -> Self {
        let choreography = Choreography { scenario, acts: Vec::new(), requirements: Requirements::default() };
        // No robot is asked for: there is none to miss.
        let mut mission = Self::with_robots(choreography.into(), participants, options, now);
        for robot in 0..mission.robots.len() {
            if let Some(own_id) = left.own_ids.get(&mission.robots[robot].id) {
                mission.robots[robot].own_id.clone_from(own_id);
            }
            mission.holds_still(robot, left, now);
        }
        mission.abort(now, Outcome::Stopped, rest, None);
        mission
    }

    /// Sends nothing: what the robots have is asked once their links stand.
    fn note_as_sent(&mut self, now: Timestamp<Server>) {
        for robot in 0..self.robots.len() {
            // What was beyond a device's queue is sent once there is room; if it was sent already, its name tells.
            for script in ledger::sendable(&self.acts, robot, &self.robots[robot]) {
                let act = self.acts.iter_mut().find(|act| act.number() == script.act);
                act.into_iter().for_each(|act| act.sent(now, script));
            }
        }
    }

    fn take_up(
        &mut self,
        promise: &Promise,
        reached: Reached,
        now: Timestamp<Server>,
    ) -> Result<(), Changed> {
        let choreography = Arc::clone(&self.choreography);
        let mut act = Act::take_up(choreography, promise, reached, &self.robots, now)?;
        if self.acts.is_empty() {
            act.comes_next(now);
        }
        for (robot, id, script) in act.all_names() {
            let robot = &mut self.robots[robot];
            robot.requests.insert(id, script);
            robot.touched.insert(act.script(script).plan.device.clone());
        }
        for member in act.members() {
            self.robots[member.robot].shift = member.shift();
        }
        self.acts_begun = self.acts_begun.max(promise.number + 1);
        self.acts.push(act);
        Ok(())
    }
}
