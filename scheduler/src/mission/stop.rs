//! Stopping: every device that was sent anything gets an empty script and comes to rest.

use urrcp::{Command, ControlRequest, Message, RequestId, Script, Server, Span, Timestamp};

use super::record::Record;
use super::robot_state::RobotState;
use super::{Mission, Phase, Progress};
use crate::report::Outcome;

/// Stops that are not confirmed are sent again after this or after three of the longest delays.
const STOP_AGAIN: Span = Span::from_millis(200);

impl Mission {
    pub(super) fn request_stop(&mut self, now: Timestamp<Server>) {
        match self.phase {
            Phase::Greeting { .. } => self.refuse(Outcome::Stopped),
            Phase::Performing => self.abort(now, Outcome::Stopped, false, None),
            // Whatever was to follow the stop does not.
            Phase::Stopping { .. } => {
                self.then = None;
                self.outcome = Some(Outcome::Stopped);
            }
            Phase::Ended => {}
        }
    }

    /// Withdraws everything that was sent. Renewals end here, so leases end what no message reaches.
    pub(super) fn abort(
        &mut self,
        now: Timestamp<Server>,
        outcome: Outcome,
        hold: bool,
        then: Option<usize>,
    ) {
        self.tell(Progress::Stopping { reason: outcome.to_string() });
        self.record(Record::Stopping { outcome: outcome.clone() });
        self.outcome = Some(outcome);
        self.then = then;
        self.next_renewal = None;
        self.phase =
            Phase::Stopping { deadline: now + self.options.patience, resend: now + self.stop_interval() };
        for robot in 0..self.robots.len() {
            self.stop_robot(now, robot, hold);
            if matches!(self.robots[robot].link, super::robot_state::Link::Down(_))
                && !self.robots[robot].stops.is_empty()
            {
                self.reconnect(robot);
            }
        }
        self.stop_progress(now);
    }

    /// Stops all devices of a robot that were sent anything. Ahead of everything that waits to be sent.
    pub(super) fn stop_robot(&mut self, now: Timestamp<Server>, robot: usize, hold: bool) {
        let state = &mut self.robots[robot];
        if state.touched.is_empty() || state.stop_sent {
            return;
        }
        state.stop_sent = true;
        self.stopped_at = self.stopped_at.max(Some(now));
        state.hold = hold;
        let session = self.options.session.as_ref().map(|session| format!("{session}/")).unwrap_or_default();
        for (index, device) in state.touched.iter().enumerate() {
            let id = format!("{session}stop/{}/{robot}/{index}", now.as_nanos() / 1_000);
            // Sessions are named by this program, far below the limit.
            if let Ok(id) = RequestId::new(id) {
                state.stops.insert(id, device.clone());
            }
        }
        self.send_stops(now, robot);
    }

    fn send_stops(&mut self, now: Timestamp<Server>, robot: usize) {
        let state = &self.robots[robot];
        let stopped_at = self.stopped_at.unwrap_or(now);
        let request = |(id, device): (&RequestId, &urrcp::DeviceId)| {
            let mut request = ControlRequest::immediate(device.clone(), Command::Script(Script::cancel()));
            request.request_id = Some(id.clone());
            // What was sent before it and arrives after it is taken back as well.
            request.timestamp = Some(stopped_at + state.shift);
            request.session.clone_from(&self.options.session);
            request.hold = state.hold;
            Message::ControlRequest(request)
        };
        let mut requests: Vec<_> = state.stops.iter().map(|stop| (stop.0.as_str(), request(stop))).collect();
        requests.sort_by(|a, b| a.0.cmp(b.0));
        let requests: Vec<_> = requests.into_iter().map(|(_, request)| request).collect();
        requests.into_iter().for_each(|request| self.send_by(now, robot, request, true));
    }

    /// What has not been confirmed is asked for again: the stop, or what became of a script.
    pub(super) fn stop_again(&mut self, now: Timestamp<Server>) {
        let interval = self.stop_interval();
        if let Phase::Stopping { resend, .. } = &mut self.phase {
            *resend = now + interval;
        }
        for robot in 0..self.robots.len() {
            if self.robots[robot].is_up() {
                self.stop_anew(now, robot);
            }
        }
    }

    pub(super) fn stop_anew(&mut self, now: Timestamp<Server>, robot: usize) {
        if !self.robots[robot].stops.is_empty() {
            self.robots[robot].totals.retries += 1;
            return self.send_stops(now, robot);
        }
        for (index, member, script) in self.unknown_fates() {
            if self.runs[index].members[member].robot == robot {
                self.probe(now, index, member, script);
            }
        }
    }

    /// Scripts of which a robot has not said what became of them, and will if it is asked: act, member and script.
    fn unknown_fates(&self) -> Vec<(usize, usize, usize)> {
        let mut unknown = Vec::new();
        for (index, run) in self.runs.iter().enumerate() {
            let answers = |member: &super::act::Member| {
                let robot = &self.robots[member.robot];
                let garbled =
                    |failure: &super::Failure| matches!(failure.kind, super::FailureKind::Garbled { .. });
                robot.reports() && !robot.failures.iter().any(garbled)
            };
            for (m, member) in run.members.iter().enumerate().filter(|(_, member)| answers(member)) {
                let scripts = member.scripts.iter().enumerate().filter(|(_, script)| script.is_out());
                unknown.extend(scripts.map(|(s, _)| (index, m, s)));
            }
        }
        unknown
    }

    fn stop_interval(&self) -> Span {
        let delays = self.robots.iter().filter_map(|robot| robot.clock.reading());
        STOP_AGAIN.max(delays.map(|reading| reading.delay_max).max().unwrap_or(Span::ZERO) * 3)
    }

    /// Goes on once every robot has confirmed, and has said what became of its scripts.
    pub(super) fn stop_progress(&mut self, now: Timestamp<Server>) {
        for robot in 0..self.robots.len() {
            let state = &mut self.robots[robot];
            if state.stop_confirmed() && !state.stop_recorded {
                state.stop_recorded = true;
                let robot = state.id.clone();
                self.record(Record::StopConfirmed { robot });
            }
        }
        let settled =
            |robot: &RobotState| robot.touched.is_empty() || (robot.stop_sent && robot.stops.is_empty());
        let all = self.robots.iter().all(settled);
        let known = all && self.unknown_fates().is_empty();
        if matches!(self.phase, Phase::Stopping { .. }) && known {
            self.stopped(now);
        }
    }

    /// The stop is over, confirmed or not: the end, or the act that a failure policy wants.
    pub(super) fn stopped(&mut self, now: Timestamp<Server>) {
        // Whatever was planned: what the robots say they did is what happened.
        let begun = self.runs.iter().any(super::act::ActRun::has_begun);
        if begun && matches!(self.outcome, Some(Outcome::NotStarted | Outcome::DecisionLate { .. })) {
            self.outcome = Some(Outcome::Failed);
        }
        self.phase = Phase::Ended;
        while !self.runs.is_empty() {
            self.close_run(now, 0);
        }
        let confirmed = self.robots.iter().all(|robot| robot.touched.is_empty() || robot.stop_confirmed());
        match self.then.take().filter(|_| confirmed) {
            Some(act) => {
                let stopped = self.outcome.take().filter(|outcome| *outcome == Outcome::Stopped);
                self.flawed = Some(stopped.unwrap_or(Outcome::Failed));
                for robot in &mut self.robots {
                    robot.stop_sent = false;
                    robot.stop_recorded = false;
                    robot.touched.clear();
                    robot.left.clear();
                }
                self.phase = Phase::Performing;
                self.line_up_act(now, act);
                self.perform(now);
            }
            None => self.end(),
        }
    }
}
