//! What a robot's failure does to the others, and robots whose link breaks in mid-mission.

use downbeat_scripts::OnFailure;
use urrcp::{InitializationRequest, Message, Server, Timestamp};

use super::act::{ActRun, Stage};
use super::commit::running_lease;
use super::record::Record;
use super::robot_state::{Failure, FailureKind, Link, ScriptPhase, Standing};
use super::{Action, Greeting, Join, Mission, Phase, Progress};
use crate::report::Outcome;

impl Mission {
    pub(super) fn link_down(&mut self, now: Timestamp<Server>, robot: usize, reason: String) {
        if self.phase == Phase::Ended {
            return;
        }
        self.robots[robot].link = Link::Down(reason.clone());
        self.robots[robot].reconnecting = false;
        self.robots[robot].broken = Some(reason.clone());
        match self.phase {
            Phase::Greeting { .. } if self.options.join == Join::NextAct => {
                self.robots[robot].standing = Standing::Absent;
                self.reconnect(robot);
                self.greeting_progress(now);
            }
            Phase::Greeting { .. } => self.fail(now, robot, FailureKind::LinkDown { reason }),
            Phase::Performing if self.robots[robot].standing == Standing::Absent => {
                self.reconnect(robot);
            }
            Phase::Performing => self.link_lost(now, robot, reason),
            Phase::Stopping { .. } => {
                if !self.robots[robot].stops.is_empty() {
                    self.reconnect(robot);
                }
                self.stop_progress(now);
            }
            Phase::Ended => {}
        }
    }

    /// Makes a link anew, one attempt at a time.
    pub(super) fn reconnect(&mut self, robot: usize) {
        if !std::mem::replace(&mut self.robots[robot].reconnecting, true) {
            let after = self.robots[robot].next_attempt();
            self.actions.push(Action::Reconnect { robot, after });
        }
    }

    /// The robot goes on by its script, as far as its lease lets it. Until that is surely over it may come back.
    fn link_lost(&mut self, now: Timestamp<Server>, robot: usize, reason: String) {
        self.reconnect(robot);
        let state = &self.robots[robot];
        if state.give_up.is_some() || state.standing == Standing::Out {
            return;
        }
        let playing = self.runs.iter().filter(|run| run.stage >= Stage::Committed);
        let ends = playing.filter_map(|run| self.gives_up(run, robot, now)).max();
        self.robots[robot].give_up = ends;
        self.give_up = self.give_up.into_iter().chain(ends).min();
        let robot = state_id(self, robot);
        self.tell(Progress::LinkLost { robot, reason, until: ends.unwrap_or(now + self.options.patience) });
    }

    /// When a robot that cannot be heard has surely ended what it has of an act: its leases have run out, or, without
    /// them, its scripts are over. Before the start decision and commitment see to it.
    fn gives_up(&self, run: &ActRun, robot: usize, now: Timestamp<Server>) -> Option<Timestamp<Server>> {
        let member = run.member(robot)?;
        let timing = run.timing.as_ref()?;
        let grace = self.report_grace(run);
        let out = member.scripts.iter().filter(|script| script.is_out());
        let ends = out.map(|script| {
            let begins = timing.start + script.plan.start.span();
            match running_lease(script) {
                Some(lease) => now.max(begins) + lease + grace,
                None => begins + script.plan.script.duration() + self.options.patience,
            }
        });
        ends.max()
    }

    pub(super) fn give_up_lost(&mut self, now: Timestamp<Server>) {
        if self.give_up.is_none_or(|at| now < at) {
            return;
        }
        let mut lost = Vec::new();
        for (index, robot) in self.robots.iter_mut().enumerate() {
            if robot.give_up.take_if(|at| now >= *at).is_some() {
                let reason = match &robot.link {
                    Link::Down(reason) => reason.clone(),
                    _ => "it did not come back in time".to_owned(),
                };
                lost.push((index, FailureKind::LinkDown { reason }));
            }
        }
        self.give_up = self.robots.iter().filter_map(|robot| robot.give_up).min();
        if !lost.is_empty() {
            self.fail_all(now, lost);
        }
    }

    /// A link stands again: renew the leases at once, then ask what was missed.
    pub(super) fn reattach(&mut self, now: Timestamp<Server>, robot: usize) {
        if self.robots[robot].standing == Standing::Absent {
            return match self.options.greeting {
                Greeting::Full => self.greet(now, robot),
                Greeting::Skip => self.joins(robot),
            };
        }
        self.robots[robot].totals.reconnects += 1;
        if self.robots[robot].stop_sent {
            return self.stop_anew(now, robot);
        }
        self.robots[robot].give_up = None;
        self.ask_availability(now, robot);
        if !self.robots[robot].introduced && self.options.greeting == Greeting::Full {
            let request = InitializationRequest { timestamp: Some(now) };
            self.send(now, robot, Message::InitializationRequest(request));
        }
        for index in 0..self.runs.len() {
            let Some(timing) = &self.runs[index].timing else { continue };
            // From here on nobody may join: an act starts on all or on none, and who has lost it must say so.
            let passed = now >= timing.commit;
            let Some(m) = self.runs[index].members.iter().position(|m| m.robot == robot && !m.out) else {
                continue;
            };
            for s in 0..self.runs[index].members[m].scripts.len() {
                let script = &self.runs[index].members[m].scripts[s];
                match script.phase {
                    ScriptPhase::Planned | ScriptPhase::Ended | ScriptPhase::Failed(_) => {}
                    _ if passed => self.probe(now, index, m, s),
                    _ => {
                        if let Some(request) = self.request(index, m, s) {
                            self.robots[robot].totals.retries += 1;
                            self.send(now, robot, Message::ControlRequest(request));
                        }
                    }
                }
            }
        }
        let robot = state_id(self, robot);
        self.tell(Progress::Reattached { robot });
    }

    /// Notes the failure of a robot and does what the policy says.
    pub(super) fn fail(&mut self, now: Timestamp<Server>, robot: usize, kind: FailureKind) {
        self.fail_all(now, vec![(robot, kind)]);
    }

    /// All failures of one instant are noted before any of them has consequences.
    pub(super) fn fail_all(&mut self, now: Timestamp<Server>, failing: Vec<(usize, FailureKind)>) {
        let out = |mission: &Self, robot: usize| mission.robots[robot].standing == Standing::Out;
        let failing: Vec<_> = failing.into_iter().filter(|(robot, _)| !out(self, *robot)).collect();
        let robots: Vec<usize> = failing.iter().map(|(robot, _)| *robot).collect();
        for (robot, kind) in failing {
            self.note_failure(robot, kind);
        }
        match self.phase {
            // All robots get their chance to speak first, so that all findings come at once.
            Phase::Greeting { .. } => self.greeting_progress(now),
            Phase::Performing if !robots.is_empty() => self.apply_policy(now, &robots),
            _ => {}
        }
    }

    pub(super) fn note_failure(&mut self, robot: usize, kind: FailureKind) {
        let failure = Failure { robot: self.robots[robot].id.clone(), kind };
        tracing::warn!(robot = %failure.robot, "{}", failure.kind);
        self.robots[robot].failures.push(failure.clone());
        self.tell(Progress::Failed(failure));
    }

    /// The strictest policy of those that failed: abort, then hold, then going on without them.
    fn apply_policy(&mut self, now: Timestamp<Server>, robots: &[usize]) {
        let Some(current) = self.runs.first() else {
            return self.abort(now, Outcome::Failed, false, None);
        };
        let policies = robots.iter().map(|robot| {
            // That of the newest act that it takes part in.
            let run = self.runs.iter().rfind(|run| run.is_sent() && run.member(*robot).is_some());
            let policy = &self.choreography.acts[run.unwrap_or(current).act].on_failure;
            let id = &self.robots[*robot].id;
            let own = policy.robots.iter().find(|(robot, _)| robot == id).map(|(_, what)| *what);
            (own.unwrap_or(policy.default), policy.then)
        });
        let rank = |what: &OnFailure| match what {
            OnFailure::Abort => 2,
            OnFailure::Hold => 1,
            OnFailure::Without => 0,
        };
        let policies: Vec<_> = policies.collect();
        let Some((what, then)) = policies.into_iter().max_by_key(|(what, _)| rank(what)) else { return };
        match what {
            OnFailure::Abort | OnFailure::Hold => {
                let moved = self.runs.iter().any(|run| {
                    run.has_begun() || run.timing.as_ref().is_some_and(|timing| now >= timing.start)
                });
                let any_before = !self.acts.is_empty();
                let outcome = if moved || any_before { Outcome::Failed } else { Outcome::NotStarted };
                robots.iter().for_each(|robot| self.robots[*robot].standing = Standing::Out);
                self.abort(now, outcome, what == OnFailure::Hold, then);
            }
            OnFailure::Without => {
                self.detour = then.or(self.detour);
                robots.iter().for_each(|robot| self.drop_robot(now, *robot));
                let sent = self.runs.iter().any(ActRun::is_sent);
                let nobody = self.robots.iter().all(|robot| robot.standing == Standing::Out);
                if nobody && sent {
                    self.abort(now, Outcome::Failed, false, None);
                }
            }
        }
    }

    /// The others go on; it goes to its default state, if it can be reached.
    fn drop_robot(&mut self, now: Timestamp<Server>, robot: usize) {
        self.robots[robot].standing = Standing::Out;
        self.robots[robot].give_up = None;
        for member in self.runs.iter_mut().flat_map(|run| &mut run.members) {
            member.out |= member.robot == robot;
        }
        self.runs.iter_mut().for_each(|run| run.recheck = true);
        let id = state_id(self, robot);
        self.record(Record::Dropped { robot: id.clone() });
        self.tell(Progress::Dropped { robot: id });
        self.stop_robot(now, robot, false);
    }
}

fn state_id(mission: &Mission, robot: usize) -> urrcp::RobotId {
    mission.robots[robot].id.clone()
}
