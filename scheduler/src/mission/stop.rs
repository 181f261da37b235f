//! Stopping: every device that was sent a script gets an empty one and goes to its default state.

use urrcp::{Command, ControlRequest, Message, RequestId, Script, Server, Timestamp};

use super::robot_state::{Link, ScriptPhase};
use super::{Mission, Phase, Progress};
use crate::report::Outcome;

impl Mission {
    pub(super) fn request_stop(&mut self, now: Timestamp<Server>) {
        match self.phase {
            Phase::Greeting { .. } => self.refuse(Outcome::Stopped),
            Phase::Preparing { .. } | Phase::Decided => self.abort(now, Outcome::Stopped),
            Phase::Stopping { .. } | Phase::Ended => {}
        }
    }

    /// A failure after the decision: before the start none has moved yet, later some have.
    pub(super) fn abort_decided(&mut self, now: Timestamp<Server>) {
        let moved = self.timing.is_some_and(|timing| now >= timing.start);
        self.abort(now, if moved { Outcome::Failed } else { Outcome::NotStarted });
    }

    /// Withdraws everything that was sent. Renewals end here, so leases end what no message reaches.
    pub(super) fn abort(&mut self, now: Timestamp<Server>, outcome: Outcome) {
        self.tell(Progress::Stopping { reason: outcome.to_string() });
        self.outcome = Some(outcome);
        self.phase = Phase::Stopping { deadline: now + self.options.patience };
        for robot in 0..self.robots.len() {
            self.stop_robot(now, robot);
        }
        self.stop_progress();
    }

    fn stop_robot(&mut self, now: Timestamp<Server>, robot: usize) {
        let state = &mut self.robots[robot];
        state.stop_sent = true;
        let mut requests = Vec::new();
        for (index, script) in state.scripts.iter().enumerate() {
            if script.phase == ScriptPhase::Planned {
                continue;
            }
            // Digits and slashes, far below the limit.
            let id = RequestId::new(format!("stop/{}/{robot}/{index}", now.as_nanos() / 1_000));
            let device = script.plan.device.clone();
            let mut request = ControlRequest::immediate(device.clone(), Command::Script(Script::cancel()));
            request.request_id = id.ok();
            if let Some(id) = &request.request_id {
                state.stops.insert(id.clone(), device);
            }
            requests.push(request);
        }
        requests.into_iter().for_each(|request| self.send(now, robot, Message::ControlRequest(request)));
    }

    /// Ends the mission once every robot that can be reached has confirmed.
    pub(super) fn stop_progress(&mut self) {
        let confirmed = self.robots.iter().all(|r| r.link != Link::Up || r.stops.is_empty());
        if matches!(self.phase, Phase::Stopping { .. }) && confirmed {
            self.end();
        }
    }
}
