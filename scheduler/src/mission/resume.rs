//! Taking up what another process promised before it died: to finish it, or to withdraw it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use downbeat_scripts::Choreography;
use urrcp::{Command, DeviceId, RobotId, Server, Span, Timestamp};

use super::act::{ActRun, Stage, Timing};
use super::lead::LeadTime;
use super::record::Promise;
use super::robot_state::{ScriptPhase, Standing};
use super::{Mission, MissionOptions, Participant, Phase, act};
use crate::journal::Kept;
use crate::report::Outcome;

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
            robot.echoes = !left.unnamed.contains(&robot.id);
        }
        for (promise, _) in left.promises.iter().filter(|(_, decided)| *decided) {
            mission.take_up(promise, now)?;
        }
        if mission.runs.is_empty() {
            return Err(Changed { what: "no act was decided and has not ended".to_owned() });
        }
        mission.phase = Phase::Performing;
        // The leases have been running out since the other process died.
        mission.next_renewal = Some(now);
        Ok(mission)
    }

    /// A mission that does nothing but stop these devices.
    #[must_use]
    pub fn withdraw(
        participants: Vec<Participant>,
        options: MissionOptions,
        touched: &BTreeMap<RobotId, BTreeSet<DeviceId>>,
        now: Timestamp<Server>,
    ) -> Self {
        let choreography = Choreography { scenario: "withdrawal".to_owned(), acts: Vec::new() };
        // No robot is asked for: there is none to miss.
        let mut mission = Self::with_robots(choreography.into(), participants, options, now);
        for robot in &mut mission.robots {
            robot.touched = touched.get(&robot.id).cloned().unwrap_or_default();
        }
        mission.abort(now, Outcome::Stopped, false, None);
        mission
    }

    fn take_up(&mut self, promise: &Promise, now: Timestamp<Server>) -> Result<(), Changed> {
        let changed = |what: String| Changed { what };
        let Some(act) = self.choreography.acts.get(promise.act) else {
            return Err(changed(format!("there is no act {} any more", promise.act + 1)));
        };
        let plan = &act.plan;
        let mut members = act::members(plan, &self.robots);
        for member in &mut members {
            let robot = &mut self.robots[member.robot];
            for script in &mut member.scripts {
                let hash = Command::Script(script.plan.script.clone()).content_hash();
                let promised = promise.scripts.iter().find(|promised| {
                    promised.robot == robot.id
                        && promised.device == script.plan.device
                        && promised.start == script.plan.start
                });
                let Some(promised) = promised.filter(|promised| promised.content_hash == hash) else {
                    return Err(changed(format!(
                        "`{}` device `{}` was promised another script",
                        robot.id, script.plan.device
                    )));
                };
                member.shift = promised.shift;
                robot.shift = promised.shift;
                script.request_id = Some(promised.request_id.clone());
                robot.touched.insert(script.plan.device.clone());
            }
        }
        // What was beyond a device's queue is sent once there is room; if it was sent already, its name tells.
        for member in &mut members {
            for script in member.sendable(&self.robots[member.robot], |_| 0) {
                member.scripts[script].phase = ScriptPhase::Sent;
            }
        }
        let number = promise.number;
        for (m, member) in members.iter().enumerate() {
            for (s, script) in member.scripts.iter().enumerate() {
                if let Some(id) = &script.request_id {
                    let open = &mut self.robots[member.robot].open;
                    open.open(script.plan.device.clone(), id.clone(), (number, m, s));
                }
            }
        }
        let lead = LeadTime {
            prepare: (promise.start - promise.timestamp - promise.lease).max(Span::ZERO),
            lease: promise.lease,
            margin: Span::ZERO,
        };
        let timing = Timing {
            timestamp: promise.timestamp,
            start: promise.start,
            lead,
            decision: promise.timestamp + lead.prepare,
            commit: promise.start - promise.lease / 2,
            no_return: promise.start,
            end: promise.start + plan.duration(),
            skew: None,
            accepted_at: None,
            round: None,
            gap: None,
            asked_again: true,
        };
        let stage = if now < timing.commit { Stage::Decided } else { Stage::Committed };
        self.acts_begun = self.acts_begun.max(number + 1);
        self.runs.push(ActRun {
            number,
            act: promise.act,
            stage,
            follow: act.next,
            since: now,
            alone_since: self.runs.is_empty().then_some(now),
            gone: false,
            poll: None,
            target: None,
            timing: Some(timing),
            members,
            awaited: 0,
            watch: None,
            recheck: false,
            readings_asked: 0,
            readings: Vec::new(),
        });
        Ok(())
    }
}
