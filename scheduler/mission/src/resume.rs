//! Takes over the promises of a mission whose process has died, in order to finish or to withdraw them.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use downbeat_plan::{Choreography, Requirements};
use urrcp::{RobotId, Server, Timestamp};

use super::act::{Act, Reached};
use super::kept::{Kept, Left, Progressed};
use super::record::{ActOver, Promise};
use super::robot_state::{Rest, Standing, Stop};
use super::{
    ActIndex, ActReport, Cause, Failure, Join, Mission, MissionOptions, Outcome, Participant, Phase,
    RobotIndex, ledger,
};

/// Error: a promise does not match the current choreography.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{what}: the scenario or the fleet has changed; restore the files, or withdraw the mission with `downbeat stop`"
)]
pub struct Changed {
    /// The difference between the promise and the choreography, for users.
    pub what: String,
}

impl Mission {
    /// A mission that continues the acts that another process decided to start before it died. `ended` contains the reports of the acts
    /// that had ended before.
    ///
    /// # Errors
    /// [`Changed`] if a promise does not match the choreography.
    pub fn resume(
        choreography: impl Into<Arc<Choreography>>,
        participants: Vec<Participant>,
        options: MissionOptions,
        kept: &Kept,
        ended: impl Iterator<Item = ActReport>,
        now: Timestamp<Server>,
    ) -> Result<Self, Changed> {
        let lost = |error: super::MissingParticipant| Changed { what: error.to_string() };
        let mut mission = Self::new(choreography, participants, options, now).map_err(lost)?;
        for robot in &mut mission.robots {
            if kept.dropped.contains(&robot.id) {
                robot.standing = Standing::Out;
            }
            if let Some(devices) = kept.touched.get(&robot.id) {
                robot.halt.touched.clone_from(devices);
            }
        }
        kept.flaws.iter().for_each(|flaws| mission.is_flawed(flaws));
        mission.note_failures_of(&kept.failures);
        mission.list_ended(ended, kept.ended_acts);
        for ActOver { act, fate } in &kept.course {
            let course = mission.course.fates.get_mut(act.get());
            course.into_iter().for_each(|course| course.note(fate.clone()));
        }
        for (promise, progressed) in &kept.promises {
            match progressed {
                Progressed::Prepared => {}
                Progressed::Decided => mission.take_up(promise, Reached::Decision, now)?,
                Progressed::Committed => mission.take_up(promise, Reached::Commitment, now)?,
            }
            let act = mission.acts.last_mut().filter(|act| act.number() == promise.number);
            act.into_iter().for_each(|act| act.keep_doubt(kept.doubts.get(&promise.number).copied()));
        }
        mission.note_as_sent(now);
        if mission.acts.is_empty() {
            return Err(Changed { what: "no decided act is left to play".to_owned() });
        }
        mission.phase = Phase::Performing;
        mission.stop_those_left_out(kept, now);
        // The leases have been running out since the other process died.
        mission.timers.next_round = Some(now);
        Ok(mission)
    }

    /// Notes the failures that the previous process recorded.
    fn note_failures_of(&mut self, failures: &[Failure]) {
        for failure in failures {
            let robot = self.robots.iter_mut().find(|robot| robot.id == failure.robot);
            robot.into_iter().for_each(|robot| _ = robot.failures.note(failure.clone()));
        }
    }

    /// Adds the acts that ended before the resumption to the report and to the totals of their robots. `count` includes acts without a
    /// report.
    fn list_ended(&mut self, ended: impl Iterator<Item = ActReport>, count: u32) {
        let index_of = self.indices();
        let mut listed = 0;
        for report in ended {
            for robot in &report.robots {
                let index = index_of.get(&robot.robot);
                index.into_iter().for_each(|index| report.add_to(&mut self.robots[*index].totals, robot));
            }
            let act = self.choreography.acts.iter().position(|act| act.called() == report.act);
            let act = act.map(ActIndex::new);
            let members = report.robots.iter().filter_map(|robot| index_of.get(&robot.robot).copied());
            act.into_iter().for_each(|act| self.note_late_joiners(act, members.clone(), &index_of));
            self.note_begun(act);
            self.list(report);
            listed += 1;
        }
        self.course.reports_omitted += (count as usize).saturating_sub(listed);
        // One of the acts that are not listed may be the one with the fixed start.
        self.course.start_was_fixed |= self.course.reports_omitted > 0;
    }

    /// Notes that an act has begun. A start that the operator fixes applies only to the first start of that act.
    fn note_begun(&mut self, act: Option<ActIndex>) {
        self.course.start_was_fixed |=
            act.is_some() && self.options.fixed.operator.map(|fixed| fixed.act) == act;
    }

    fn indices(&self) -> HashMap<RobotId, RobotIndex> {
        self.robots.enumerated().map(|(index, robot)| (robot.id.clone(), index)).collect()
    }

    /// Marks robots as absent that have a part in an act, but were missing when it was sent. They may join later.
    fn note_late_joiners(
        &mut self,
        act: ActIndex,
        members: impl Iterator<Item = RobotIndex>,
        index_of: &HashMap<RobotId, RobotIndex>,
    ) {
        let members: HashSet<RobotIndex> = members.collect();
        let planned = self.choreography.acts[act.get()].plan.robots.iter();
        for index in planned.filter_map(|planned| index_of.get(&planned.robot)) {
            let robot = &mut self.robots[*index];
            let is_member = members.contains(index);
            match robot.standing {
                Standing::In if !is_member => {
                    // Otherwise the mission would not have begun without the robot.
                    self.options.join = Join::NextAct;
                    (robot.standing, robot.joined_late, robot.pose.unplaced) = (Standing::Absent, true, true);
                }
                Standing::Absent if is_member => {
                    (robot.standing, robot.joined_late, robot.pose.unplaced) = (Standing::In, false, false);
                }
                _ => {}
            }
        }
    }

    /// Stops robots that were left out and have not confirmed their stop, because the previous process may have died before it sent one.
    fn stop_those_left_out(&mut self, kept: &Kept, now: Timestamp<Server>) {
        let left = kept.left();
        for robot in self.robots.indices() {
            let id = &self.robots[robot].id;
            if !kept.dropped.contains(id) {
                continue;
            }
            if kept.stopped.contains(id) {
                self.robots[robot].set_stop(Stop::Confirmed(Rest::InPlace));
                continue;
            }
            self.holds_still(robot, &left, now);
            self.stop_robot(now, robot, Rest::InPlace);
        }
    }

    /// Asks a robot that the previous process left out, and that has confirmed its stop, which steps it played.
    pub(super) fn ask_how_far_it_came(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &self.robots[robot];
        let is_out = state.standing == Standing::Out && matches!(state.halt.stop, Stop::Confirmed(_));
        if is_out && state.takes_inquiries() {
            let named: Vec<_> = self.acts.iter().filter_map(|act| act.unheard_of(robot)).collect();
            if !named.is_empty() {
                self.ask_about(now, robot, named);
            }
        }
    }

    /// Notes the moved devices and the leases that another process has left on a robot, if any.
    fn holds_still(&mut self, robot: RobotIndex, left: &Left, now: Timestamp<Server>) {
        let renewed_until = left.renewed_until.map_or(now, |until| until.min(now));
        let robot = &mut self.robots[robot];
        let Some(left) = left.robots.get(&robot.id) else { return };
        robot.halt.touched.clone_from(&left.devices);
        robot.shift = left.shift;
        robot.halt.left =
            left.leases.iter().map(|lease| lease.map(|lease| renewed_until + lease.span())).collect();
        if robot.halt.left.is_empty() {
            robot.halt.left.push(Some(renewed_until));
        }
    }

    /// A mission that only withdraws what another process has left on its robots. `scenario` is the name of the scenario that the other
    /// process played. An outcome of `cause` that contradicts `left.moved` is corrected.
    #[must_use]
    pub fn withdraw(
        scenario: String,
        participants: Vec<Participant>,
        options: MissionOptions,
        left: &Left,
        cause: Cause,
        rest: Rest,
        now: Timestamp<Server>,
    ) -> Self {
        let choreography = Choreography { scenario, acts: Vec::new(), requirements: Requirements::default() };
        // The way home cannot be planned without the acts, so each robot goes home on its own.
        let options = MissionOptions { transfer: None, ..options };
        // The choreography requires no robot, so none can be missing.
        let mut mission = Self::with_robots(choreography.into(), participants, options, now);
        for robot in mission.robots.indices() {
            if let Some(own_id) = left.own_ids.get(&mission.robots[robot].id) {
                mission.robots[robot].identity.own_id.clone_from(own_id);
            }
            mission.holds_still(robot, left, now);
        }
        let Cause { outcome, reason } = cause;
        mission.note_failures_of(&left.failures);
        mission.course.moved_before = left.moved;
        mission.conclusion.because = Some(reason.clone()).filter(|_| outcome != Outcome::Stopped);
        mission.abort_because(now, outcome, reason, rest, None);
        mission
    }

    /// Marks scripts as sent without sending them. The robots are asked about them once they are connected.
    fn note_as_sent(&mut self, now: Timestamp<Server>) {
        for act in &mut self.acts {
            act.note_as_sent_until(now);
        }
        for robot in self.robots.indices() {
            // Scripts beyond a device's queue are sent once there is room. If one was already sent, its id shows that.
            for script in ledger::sendable(&self.acts, robot, &self.robots[robot]) {
                let act = self.acts.iter_mut().find(|act| act.number() == script.act);
                act.into_iter().for_each(|act| act.assume_sent(now, script));
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
            robot.requests.add_script(id, script);
            robot.halt.touched.insert(act.script(script).plan.device.clone());
        }
        for member in act.members() {
            let robot = &mut self.robots[member.robot];
            robot.shift = member.last_shift().unwrap_or(robot.shift);
        }
        let members = act.members().iter().map(|member| member.robot);
        self.note_late_joiners(promise.act, members, &self.indices());
        self.note_begun(Some(promise.act));
        // This process does not know the round trips of the links, so its instants differ from those of the other process.
        if !act.is_committed() {
            act.decided().into_iter().for_each(|decided| self.tell(decided));
        }
        self.course.begun = self.course.begun.max(promise.number.get() + 1);
        self.acts.push(act);
        Ok(())
    }
}
