//! Handles the effects of a robot's failure on the other robots, and robots whose link breaks in mid-mission.

use downbeat_plan::OnFailure;
use downbeat_yaml::render::counted;
use urrcp::{Server, Span, Timestamp};

use super::failure_kind::{Failure, FailureKind};
use super::failures::Noted;
use super::record::Record;
use super::robot_state::{Link, Lost, Rest, Standing};
use super::script::{Script, ScriptRef, ScriptState};
use super::{ActIndex, Action, Greeting, Join, Loss, Mission, Outcome, Phase, Progress, RobotIndex};

/// How long, during the greeting, a robot that refuses connections may still be starting up.
const STARTS_WITHIN: Span = Span::from_millis(500);

impl Mission {
    pub(super) fn link_down(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        loss: Loss,
        reason: String,
    ) {
        if self.phase == Phase::Ended {
            return;
        }
        if let Loss::Flooding { messages, bytes } = loss {
            return self.flooded(now, robot, reason, messages, bytes);
        }
        let state = &mut self.robots[robot];
        let (since, give_up) = state.lost().map_or((now, None), |lost| (lost.since, lost.give_up));
        let lost = Lost { reason: reason.clone(), loss, since, failed: now, connecting: false, give_up };
        state.link = Link::Lost(lost);
        // An act may have waited for an attempt to reach the robot.
        self.acts.iter_mut().for_each(|act| act.look_again_at(None));
        match self.phase {
            Phase::Greeting { deadline } => self.link_down_in_greeting(now, deadline, robot, reason),
            Phase::Performing if self.robots[robot].standing == Standing::Absent => self.reconnect(robot),
            Phase::Performing => self.link_lost(now, robot, reason),
            Phase::Stopping { .. } => {
                if !self.robots[robot].is_settled() && !self.robots[robot].is_left_to_others() {
                    self.reconnect(robot);
                }
                self.stop_progress(now);
            }
            Phase::Ended => {}
        }
    }

    /// Handles a robot that sends far more messages than requested. The robot is considered lost, and the mission reconnects to it only
    /// to stop it.
    fn flooded(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        reason: String,
        messages: u64,
        bytes: u64,
    ) {
        let loss = Loss::Flooding { messages, bytes };
        let state = &mut self.robots[robot];
        let lost = Lost { reason, loss, since: now, failed: now, connecting: false, give_up: None };
        state.link = Link::Lost(lost);
        let floods = |failure: &Failure| matches!(failure.kind, FailureKind::Flooding { .. });
        let known = self.robots[robot].failures.iter().any(floods);
        let kind = FailureKind::Flooding { messages, bytes };
        match (self.phase, self.robots[robot].standing) {
            _ if known => {}
            (Phase::Greeting { .. } | Phase::Performing, Standing::In) => self.fail(now, robot, kind),
            (_, standing) => {
                self.note_failure(robot, kind);
                if standing == Standing::Absent {
                    self.robots[robot].standing = Standing::Out;
                }
            }
        }
        self.reconnect(robot);
        match self.phase {
            Phase::Greeting { .. } => self.greeting_progress(now),
            Phase::Stopping { .. } => self.stop_progress(now),
            Phase::Performing | Phase::Ended => {}
        }
    }

    /// During the greeting, reconnects to a robot that was reached before or may still be starting up. After the mission's patience has
    /// ended, the robot fails instead.
    fn link_down_in_greeting(
        &mut self,
        now: Timestamp<Server>,
        deadline: Timestamp<Server>,
        robot: RobotIndex,
        reason: String,
    ) {
        if self.options.join == Join::NextAct {
            self.robots[robot].standing = Standing::Absent;
            self.reconnect(robot);
            return self.greeting_progress(now);
        }
        let Link::Lost(lost) = &self.robots[robot].link else { return };
        let off = lost.loss == Loss::Refused && now >= lost.since + STARTS_WITHIN;
        if off || lost.loss == Loss::Denied || now >= deadline {
            self.fail(now, robot, FailureKind::LinkDown { reason })
        } else {
            self.reconnect(robot)
        }
    }

    /// Reconnects to a robot, unless an attempt is already under way.
    pub(super) fn reconnect(&mut self, robot: RobotIndex) {
        let state = &mut self.robots[robot];
        let to_be_stopped = state.awaits_stop();
        if let Link::Lost(lost) = &mut state.link
            && (to_be_stopped || !matches!(lost.loss, Loss::Flooding { .. }))
            && !std::mem::replace(&mut lost.connecting, true)
        {
            let after = state.next_attempt();
            self.outbox.actions.push(Action::Reconnect { robot, after });
        }
    }

    /// Replaces a pending attempt to reconnect, which may still wait for its pause to end, with an immediate attempt.
    pub(super) fn reconnect_at_once(&mut self, robot: RobotIndex) {
        if matches!(&self.robots[robot].link, Link::Lost(lost) if lost.connecting) {
            self.outbox.actions.push(Action::Reconnect { robot, after: Span::ZERO });
        }
    }

    /// Handles a broken link. The robot continues with its script as far as its lease permits. It may reconnect until its scripts have
    /// certainly ended. If it refuses connections, its process no longer runs, and its scripts have ended.
    fn link_lost(&mut self, now: Timestamp<Server>, robot: RobotIndex, reason: String) {
        self.reconnect(robot);
        let gone = self.robots[robot].is_gone();
        if self.robots[robot].standing == Standing::Out {
            return;
        }
        let is_denied = matches!(&self.robots[robot].link, Link::Lost(lost) if lost.loss == Loss::Denied);
        // A robot that plays is given up when its lease ends. For a robot that holds nothing, there is no such time, and another attempt
        // would be refused as well, for example because the operator's key was revoked.
        let holds = self.acts.iter().any(|act| act.has_something_on(robot));
        if (gone && holds) || (is_denied && !holds) {
            return self.fail(now, robot, FailureKind::LinkDown { reason });
        }
        let patience = self.options.patience;
        let ends = self.acts.iter().filter_map(|act| act.gives_up(robot, now, &self.robots, patience)).max();
        let Link::Lost(lost) = &mut self.robots[robot].link else { return };
        let first = lost.since == now;
        if lost.give_up.is_none() {
            lost.give_up = ends;
            self.timers.give_up = self.timers.give_up.into_iter().chain(ends).min();
        }
        if first {
            let robot = self.robots[robot].id.clone();
            self.tell(Progress::LinkLost { robot, reason, until: ends });
        }
    }

    pub(super) fn give_up_lost(&mut self, now: Timestamp<Server>) {
        if self.timers.give_up.is_none_or(|at| now < at) {
            return;
        }
        let mut failing = Vec::new();
        for index in self.robots.indices() {
            let Some(lost) = self.robots[index].lost_mut() else { continue };
            if lost.give_up.take_if(|at| now >= *at).is_some() {
                failing.push((index, FailureKind::LinkDown { reason: lost.reason.clone() }));
            }
        }
        self.timers.give_up = self.earliest_give_up();
        if !failing.is_empty() {
            self.fail_all(now, failing);
        }
    }

    fn earliest_give_up(&self) -> Option<Timestamp<Server>> {
        self.robots.iter().filter_map(|robot| robot.lost()?.give_up).min()
    }

    /// Handles a new link: asks the robot for the reports that this process has missed. The question also renews the leases.
    pub(super) fn reattach(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if self.robots[robot].standing == Standing::Absent {
            return match self.options.greeting {
                Greeting::Full => self.greet(now, robot),
                Greeting::Skip => self.joins(robot),
            };
        }
        self.robots[robot].totals.reconnects += 1;
        self.robots[robot].pose.unplaced = true;
        if self.robots[robot].stop_was_sent() {
            self.stop_on_new_link(now, robot);
            return self.ask_how_far_it_came(now, robot);
        }
        if self.robots[robot].takes_inquiries() {
            return self.inquire(now, robot);
        }
        self.ask(now, robot);
        if !self.robots[robot].owes_its_times() {
            self.send_held_again(now, robot);
        }
    }

    /// Sends the scripts that were deferred until the robot has answered on its new link. The robot's clock is now known to be the one by
    /// which its scripts were converted.
    pub(super) fn catch_up(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &self.robots[robot];
        if self.phase != Phase::Performing || state.standing != Standing::In || state.stop_was_sent() {
            return;
        }
        if !state.takes_inquiries() {
            self.send_held_again(now, robot);
        }
        self.refill(now, robot);
    }

    /// Notes the first message from a robot on a new link, and reports that the robot is back. For a robot that was absent so far, this
    /// is reported when it joins.
    pub(super) fn is_back(&mut self, robot: RobotIndex) {
        self.timers.give_up = self.earliest_give_up();
        if self.phase == Phase::Performing && self.robots[robot].standing != Standing::Absent {
            let robot = self.robots[robot].id.clone();
            self.tell(Progress::Reattached { robot });
        }
    }

    /// Sends scripts again that a robot without inquiries may not have received. The robot recognizes duplicates by their ids. Scripts
    /// that have begun are not repeated.
    fn send_held_again(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let mut again = Vec::new();
        for act in self.acts.iter().filter(|act| act.is_open()) {
            let (Some(place), Some(timing)) = (act.place_of(robot), act.timing()) else { continue };
            let waits = |script: &Script| {
                let ahead = timing.start + script.plan.start.span() > now;
                ahead && matches!(script.state(), ScriptState::Sent | ScriptState::Held)
            };
            let scripts = act.members()[place].scripts().iter().enumerate();
            let scripts = scripts.filter(|(_, script)| waits(script));
            again.extend(scripts.map(|(script, _)| ScriptRef { act: act.number(), member: place, script }));
        }
        for script in again {
            self.robots[robot].totals.retries += 1;
            self.send_script(now, script);
        }
    }

    /// Notes the failure of a robot, and applies the scenario's policy for failures.
    pub(super) fn fail(&mut self, now: Timestamp<Server>, robot: RobotIndex, kind: FailureKind) {
        self.fail_all(now, vec![(robot, kind)]);
    }

    /// Notes all failures of one instant, and only then applies the scenario's policy for failures.
    pub(super) fn fail_all(&mut self, now: Timestamp<Server>, failing: Vec<(RobotIndex, FailureKind)>) {
        let out = |mission: &Self, robot: RobotIndex| mission.robots[robot].standing == Standing::Out;
        let failing: Vec<_> = failing.into_iter().filter(|(robot, _)| !out(self, *robot)).collect();
        let performing = self.phase == Phase::Performing;
        let is_absent = |robot: RobotIndex| performing && self.robots[robot].standing == Standing::Absent;
        let (absent, failing): (Vec<_>, Vec<_>) =
            failing.into_iter().partition(|(robot, _)| is_absent(*robot));
        // The other robots play without an absent robot anyway, so it does not join.
        for (robot, kind) in absent {
            self.note_failure(robot, kind);
            self.robots[robot].standing = Standing::Out;
        }
        let robots: Vec<RobotIndex> = failing.iter().map(|(robot, _)| *robot).collect();
        // Scripts that a stop ends are not failures.
        let stopping = matches!(self.phase, Phase::Stopping { .. } | Phase::Ended);
        for (robot, kind) in failing {
            if !stopping || (matches!(kind, FailureKind::Garbled { .. }) && !self.robots[robot].is_garbled())
            {
                self.note_failure(robot, kind);
            }
        }
        match self.phase {
            // All robots can answer first, so that all findings are reported together.
            Phase::Greeting { .. } => self.greeting_progress(now),
            Phase::Performing if !robots.is_empty() => self.apply_policy(now, &robots),
            _ => {}
        }
    }

    pub(super) fn note_failure(&mut self, robot: RobotIndex, kind: FailureKind) {
        let failure = Failure { robot: self.robots[robot].id.clone(), kind };
        if self.robots[robot].failures.note(failure.clone()) == Noted::Kept {
            tracing::warn!(robot = %failure.robot, "{}", failure.kind);
            self.record(Record::Failed(failure.clone()));
            self.tell(Progress::Failed(failure));
        }
    }

    /// Applies the strictest policy among the failed robots. From strict to lenient: stop, go home, continue without them.
    fn apply_policy(&mut self, now: Timestamp<Server>, robots: &[RobotIndex]) {
        if self.acts.is_empty() {
            let reason = self.reason_of(robots);
            return self.abort_because(now, Outcome::Failed, reason, Rest::InPlace, None);
        }
        let policies = robots.iter().filter_map(|robot| self.policy_of(*robot));
        let rank = |what: &OnFailure| match what {
            OnFailure::Stop => 2,
            OnFailure::Home => 1,
            OnFailure::Without => 0,
        };
        let Some((what, then)) = policies.max_by_key(|(what, _)| rank(what)) else { return };
        match what {
            OnFailure::Stop => self.abort_for(now, robots, Rest::InPlace, then),
            OnFailure::Home => self.abort_for(now, robots, Rest::Home, then),
            OnFailure::Without => {
                if let Some(then) = then {
                    self.lead_elsewhere(then);
                }
                robots.iter().for_each(|robot| self.drop_robot(now, *robot));
                let sent = self.acts.iter().any(super::act::Act::was_sent);
                let nobody = self.robots.iter().all(|robot| robot.standing == Standing::Out);
                if nobody && sent {
                    let reason = self.reason_of(robots);
                    self.abort_because(now, Outcome::Failed, reason, Rest::InPlace, None);
                }
            }
        }
    }

    /// Returns the scenario's policy for a failure of this robot, and the act that follows the failure, if any. The policy is that of the
    /// newest act in which the robot takes part.
    pub(super) fn policy_of(&self, robot: RobotIndex) -> Option<(OnFailure, Option<ActIndex>)> {
        let takes_part =
            |act: &&super::act::Act| act.was_sent() && !act.is_lapsing() && act.member(robot).is_some();
        let act = self.acts.iter().rfind(takes_part).or(self.acts.first())?;
        let policy = &act.written().on_failure;
        let id = &self.robots[robot].id;
        let own = policy.robots.iter().find(|(robot, _)| robot == id).map(|(_, what)| *what);
        Some((own.unwrap_or(policy.default), policy.then.map(ActIndex::new)))
    }

    fn abort_for(
        &mut self,
        now: Timestamp<Server>,
        robots: &[RobotIndex],
        rest: Rest,
        then: Option<ActIndex>,
    ) {
        let moved = self.acts.iter().any(|act| self.may_have_begun(now, act)) || self.has_moved();
        let outcome = if moved { Outcome::Failed } else { Outcome::NotStarted };
        robots.iter().for_each(|robot| self.robots[*robot].standing = Standing::Out);
        let reason = self.reason_of(robots);
        self.abort_because(now, outcome, reason, rest, then);
    }

    /// Describes a failure for users: the latest failure of the first of these robots, and the number of the other robots.
    fn reason_of(&self, robots: &[RobotIndex]) -> String {
        let failed = |robot: &RobotIndex| self.robots[*robot].failures.last();
        match robots.iter().find_map(failed) {
            None => Outcome::Failed.to_string(),
            Some(Failure { robot, kind }) if robots.len() == 1 => format!("{robot}: {kind}"),
            Some(Failure { robot, kind }) => {
                format!("{robot}: {kind}; {} more failed", counted(robots.len() - 1, "robot"))
            }
        }
    }

    /// Leaves a robot out. The other robots continue. The robot that is left out comes to rest, if it can be reached.
    pub(super) fn drop_robot(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        self.robots[robot].standing = Standing::Out;
        if let Some(lost) = self.robots[robot].lost_mut() {
            lost.give_up = None;
        }
        self.end_leases(now, robot);
        self.acts.iter_mut().for_each(|act| act.drop_robot(robot));
        let id = self.robots[robot].id.clone();
        self.record(Record::Dropped { robot: id.clone() });
        self.tell(Progress::Dropped { robot: id });
        self.stop_robot(now, robot, Rest::InPlace);
    }
}
