//! All requests of the act with one timestamp; then one decision: all have accepted, or none starts.
//!
//! The start lies a lease and a margin beyond the decision, so that robots that no message can reach any more drop their
//! scripts before it. Renewals are placed so that the instant one lease before the start falls into the middle between
//! two of them: a scheduler that dies between renewals leaves either all leases short of the start or all beyond it.
//! What remains is the time that one round of renewals takes to reach everyone.

use urrcp::{
    Command, ControlError, ControlRequest, ControlResponse, ErrorCode, Message, Millis, RequestId, Server,
    Span, Status, StopCondition, Timestamp, encode,
};

use super::lead::LeadTime;
use super::robot_state::{FailureKind, RobotState, ScriptPhase, error_of};
use super::{Mission, Phase, Progress, Timing};
use crate::report::Outcome;

impl Mission {
    pub(super) fn prepare(&mut self, now: Timestamp<Server>) {
        let delays = self.robots.iter().filter_map(|robot| robot.clock.reading());
        let delay_max = delays.map(|reading| reading.delay_max).max().unwrap_or(Span::ZERO);
        let prescribed = self.plan.stop_condition.pending.map(Millis::span);
        if let Some(lease) = prescribed.filter(|lease| *lease < LeadTime::lease_needed(delay_max)) {
            let needed = LeadTime::lease_needed(delay_max);
            return self.refuse(Outcome::LeaseTooShort { lease, needed });
        }
        let needed = LeadTime::needed(delay_max, self.request_count(), self.request_bytes(now), prescribed);
        let wanted = self.options.lead.or(self.plan.lead);
        if let Some(lead) = wanted.filter(|lead| *lead < needed.total()) {
            return self.refuse(Outcome::LeadTooShort { lead, needed });
        }
        let lead = needed.stretched_to(wanted.unwrap_or(needed.total()));
        self.send_act(now, lead);
    }

    fn send_act(&mut self, timestamp: Timestamp<Server>, lead: LeadTime) {
        let start = timestamp + lead.total();
        let interval = lead.renewal_interval();
        let timing = Timing {
            timestamp,
            start,
            lead,
            next_renewal: first_renewal(timestamp, start - lead.lease, interval),
            end: start + self.plan.duration(),
        };
        self.timing = Some(timing);
        self.phase = Phase::Preparing { decision: timestamp + lead.prepare };
        self.tell(Progress::Preparing { timestamp, start, lead });
        for robot in 0..self.robots.len() {
            for script in 0..self.robots[robot].scripts.len() {
                let request = self.request(&timing, robot, script);
                self.send(timestamp, robot, Message::ControlRequest(request));
            }
        }
    }

    fn request(&mut self, timing: &Timing, robot: usize, index: usize) -> ControlRequest {
        let state = &mut self.robots[robot];
        let script = &mut state.scripts[index];
        script.phase = ScriptPhase::Sent;
        let id = format!("{}/{robot}/{index}", timing.timestamp.as_nanos() / 1_000);
        // Digits and slashes, far below the limit.
        let request_id = RequestId::new(id).ok();
        let command = Command::Script(script.plan.script.clone());
        if let Some(id) = &request_id {
            state.open.open(script.plan.device.clone(), id.clone(), index);
        }
        ControlRequest {
            timestamp: Some(timing.timestamp),
            time_offset_to_start: Some(Millis::from_span(timing.lead.total() + script.plan.start.span())),
            device_id: script.plan.device.clone(),
            stop_condition: Some(StopCondition {
                pending: Some(Millis::from_span(timing.lead.lease)),
                running: script.plan.stop_condition.running,
            }),
            request_id,
            content_hash: Some(command.content_hash()),
            session: None,
            hold: false,
            command,
        }
    }

    fn request_count(&self) -> usize {
        self.robots.iter().map(|robot| robot.scripts.len()).sum()
    }

    /// How much has to travel, measured on the real encoding of the largest script.
    fn request_bytes(&self, now: Timestamp<Server>) -> usize {
        let scripts = || self.robots.iter().flat_map(|robot| &robot.scripts);
        let Some(largest) = scripts().max_by_key(|script| script.plan.script.steps().len()) else { return 0 };
        let mut line = Vec::new();
        let command = Command::Script(largest.plan.script.clone());
        let mut request = ControlRequest::immediate(largest.plan.device.clone(), command);
        request.timestamp = Some(now);
        encode(&Message::ControlRequest(request), &mut line);
        let steps: usize = scripts().map(|script| script.plan.script.steps().len()).sum();
        let step_bytes = line.len() / largest.plan.script.steps().len().max(1);
        steps * step_bytes + self.request_count() * 256
    }

    pub(super) fn script_response(
        &mut self,
        now: Timestamp<Server>,
        robot: usize,
        response: ControlResponse,
    ) {
        let Some((_, &index)) = self.robots[robot].open.find(&response) else {
            tracing::debug!(robot = %self.robots[robot].id, "answer to no open request: {response:?}");
            return;
        };
        match response.status {
            Status::Accepted => self.accepted(now, robot, index, &response),
            Status::Started => self.started(robot, index, &response),
            Status::Ok => self.ended(now, robot, index, &response),
            Status::Failed => {
                let error = error_of(&response);
                let script = &mut self.robots[robot].scripts[index];
                script.phase = ScriptPhase::Failed(error.clone());
                script.steps_done = response.steps_done.unwrap_or(script.steps_done);
                let device = response.device_id;
                self.fail(now, robot, FailureKind::Script { device, error });
            }
            Status::Provide | Status::Other(_) => {}
        }
    }

    fn accepted(&mut self, now: Timestamp<Server>, robot: usize, index: usize, response: &ControlResponse) {
        let state = &mut self.robots[robot];
        let script = &mut state.scripts[index];
        let expected = Command::Script(script.plan.script.clone()).content_hash();
        if response.content_hash.is_some_and(|hash| hash != expected) {
            let message = "the robot accepted another script than the one sent (content_hash differs)";
            let error = ControlError::new(ErrorCode::Malformed, message);
            let device = response.device_id.clone();
            return self.fail(now, robot, FailureKind::Script { device, error });
        }
        script.accepted = true;
        if script.phase == ScriptPhase::Sent {
            script.phase = ScriptPhase::Accepted;
        }
        if state.has_accepted() {
            let robot = state.id.clone();
            self.tell(Progress::Accepted { robot });
        }
    }

    /// Renews all leases when the next round is due.
    pub(super) fn renew_if_due(&mut self, now: Timestamp<Server>) {
        let Some(timing) = self.timing.as_mut() else { return };
        if now < timing.next_renewal {
            return;
        }
        // Rounds keep their places relative to the start, also after one that came late.
        let interval = timing.lead.renewal_interval().max(Span::from_millis(1));
        let missed = (now - timing.next_renewal).as_nanos() / interval.as_nanos();
        timing.next_renewal = timing.next_renewal + interval * (missed + 1);
        for robot in 0..self.robots.len() {
            self.ask_availability(now, robot);
        }
    }

    /// The one decision: the mission starts if every robot has accepted everything, else none starts.
    pub(super) fn decide(&mut self, now: Timestamp<Server>) {
        let Some(timing) = self.timing else { return };
        let within = timing.lead.prepare;
        let slow: Vec<_> =
            (0..self.robots.len()).filter(|robot| !self.robots[*robot].has_accepted()).collect();
        for robot in &slow {
            let awaited = awaited_acceptance(&self.robots[*robot]);
            self.fail(now, *robot, FailureKind::Silent { awaited, within });
        }
        // A decision that comes late would shorten what the leases need to run out before the start.
        let too_late = now > timing.start - timing.lead.lease;
        if slow.is_empty() && too_late {
            return self.abort(now, Outcome::DecisionLate { by: now - (timing.timestamp + within) });
        }
        if slow.is_empty() {
            tracing::info!(start = %timing.start, "decided");
            self.phase = Phase::Decided;
            self.tell(Progress::Decided { start: timing.start });
        }
    }
}

fn awaited_acceptance(robot: &RobotState) -> String {
    let open: Vec<_> =
        robot.scripts.iter().filter(|s| !s.accepted).map(|s| format!("`{}`", s.plan.device)).collect();
    match open.len() {
        0..=4 => format!("acceptance by {}", open.join(", ")),
        n => format!("acceptance by {} and {} more devices", open[..3].join(", "), n - 3),
    }
}

/// The earliest instant after `from` of the grid of renewals that leaves `critical` in the middle of a gap.
fn first_renewal(from: Timestamp<Server>, critical: Timestamp<Server>, interval: Span) -> Timestamp<Server> {
    let on_grid = critical + interval / 2;
    let whole = (on_grid - from).as_nanos() / interval.as_nanos().max(1);
    on_grid - interval * (whole - i64::from(on_grid - interval * whole <= from))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn renewals_leave_the_instant_one_lease_before_the_start_in_mid_gap() {
        let from = Timestamp::from_nanos(0);
        let interval = Span::from_millis(80);
        for millis in 300..400 {
            let critical = from + Span::from_millis(millis);
            let first = first_renewal(from, critical, interval);
            assert!(first > from && first <= from + interval, "{first}");
            let gap = (critical - first).as_nanos().rem_euclid(interval.as_nanos());
            assert_eq!(gap, interval.as_nanos() / 2);
        }
    }
}
