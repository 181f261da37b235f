//! All requests of an act with one timestamp, and one decision: all have accepted, or none starts.
//!
//! The start lies a lease and a margin beyond the decision, so that robots that no message can reach any more drop their
//! scripts before it (`commit`).

use urrcp::{
    Command, ContentHash, ControlError, ControlRequest, ControlResponse, ErrorCode, Message, Millis,
    RequestId, Server, Span, Status, StopCondition, Timestamp, encode,
};

use super::act::{ActRun, Member, Stage, Timing};
use super::lead::LeadTime;
use super::record::{Promise, PromisedScript, Record};
use super::robot_state::{FailureKind, ScriptPhase, ScriptState};
use super::skew::SkewBudget;
use super::{ClockMode, Greeting, Mission, Phase, Progress};
use crate::report::Outcome;

/// An act that follows another is sent so long before it has to be, at most.
const AHEAD: Span = Span::from_millis(2_000);

/// What an act needs before it can start.
struct Need {
    lead: LeadTime,
    delay_max: Span,
}

impl Mission {
    /// Sends the act once its time has come and the devices have room for it.
    pub(super) fn prepare_if_it_fits(&mut self, now: Timestamp<Server>, index: usize) {
        let run = &self.runs[index];
        if run.present().next().is_none() {
            // All its robots have been left out: there is nothing to play.
            self.runs[index].stage = Stage::Over;
            return;
        }
        let waits = run.poll.is_some_and(|at| now < at) && self.unknown_clocks(run).is_empty();
        if waits && run.target.is_some() {
            return;
        }
        if !self.has_room(run) {
            // Looked at again whenever something ends.
            self.runs[index].poll = None;
            return;
        }
        let unknown = self.unknown_clocks(run);
        if !unknown.is_empty() {
            let (within, since) = (self.options.patience, run.since);
            self.runs[index].poll = Some(since + within).filter(|until| now < *until);
            if self.runs[index].poll.is_none() {
                let awaited = "availability response".to_owned();
                let silent = |robot| (robot, FailureKind::Silent { awaited: awaited.clone(), within });
                self.fail_all(now, unknown.into_iter().map(silent).collect());
            }
            return;
        }
        let need = match self.need(now, run) {
            Ok(need) => need,
            Err(outcome) => return self.cannot_prepare(now, outcome),
        };
        let from = self.runs[index].target.map(|target| target - need.lead.total() - AHEAD);
        self.runs[index].poll = from.filter(|from| now < *from);
        if self.runs[index].poll.is_some() {
            return;
        }
        let run = &self.runs[index];
        let tolerance = self.choreography.acts[run.act].plan.start_tolerance;
        let skew = SkewBudget::of(run.present(), &self.robots, tolerance, now);
        let offenders = skew.as_ref().map(SkewBudget::offenders).unwrap_or_default();
        if !offenders.is_empty() {
            let at = |id| self.robots.iter().position(|robot| robot.id == id);
            let failing = offenders.into_iter().filter_map(|(id, kind)| Some((at(id)?, kind))).collect();
            return self.fail_all(now, failing);
        }
        self.send_act(now, index, &need, skew);
    }

    /// Members whose clock has not been measured, as after a resumption, where it has to be.
    fn unknown_clocks(&self, run: &ActRun) -> Vec<usize> {
        let full = self.options.greeting == Greeting::Full;
        let unknown = |robot: &usize| {
            let robot = &self.robots[*robot];
            robot.clock.samples() == 0 && (full || robot.clock_mode == ClockMode::Measured)
        };
        run.present().map(|member| member.robot).filter(unknown).collect()
    }

    /// Every device has room for its first script beside what it holds of other acts. After those have ended there is room.
    fn has_room(&self, run: &ActRun) -> bool {
        let others = || self.runs.iter().filter(|other| other.number != run.number && other.is_sent());
        run.alone_since.is_some()
            || run.present().all(|member| {
                let robot = &self.robots[member.robot];
                let held = |device: &urrcp::DeviceId| {
                    others().map(|o| o.held(member.robot, device, run.number)).sum()
                };
                let sendable = member.sendable(robot, held);
                let scripts = &member.scripts;
                let first = |i: &usize| *i == 0 || scripts[i - 1].plan.device != scripts[*i].plan.device;
                (0..scripts.len()).filter(first).all(|i| sendable.contains(&i))
            })
    }

    /// Refused for a lead or a lease that is too short. Before anything has moved nothing is sent at all.
    fn cannot_prepare(&mut self, now: Timestamp<Server>, outcome: Outcome) {
        match self.robots.iter().all(|robot| robot.touched.is_empty()) {
            true => self.refuse(outcome),
            false => self.abort(now, outcome, false, None),
        }
    }

    fn need(&self, now: Timestamp<Server>, run: &ActRun) -> Result<Need, Outcome> {
        let plan = &self.choreography.acts[run.act].plan;
        let delays = run.present().filter_map(|member| self.robots[member.robot].clock.reading());
        let delay_max = delays.map(|reading| reading.delay_max).max().unwrap_or(Span::ZERO);
        let prescribed = plan.stop_condition.pending.map(Millis::span);
        if let Some(lease) = prescribed.filter(|lease| *lease < LeadTime::lease_needed(delay_max)) {
            return Err(Outcome::LeaseTooShort { lease, needed: LeadTime::lease_needed(delay_max) });
        }
        let requests = run.present().map(|member| member.scripts.len()).sum();
        let needed = LeadTime::needed(delay_max, requests, request_bytes(run, now), prescribed);
        let wanted = self.options.lead.or(plan.lead).filter(|_| run.target.is_none());
        if let Some(lead) = wanted.filter(|lead| *lead < needed.total()) {
            let safe_start = now + needed.total();
            return Err(Outcome::LeadTooShort { lead, needed, safe_start });
        }
        // What the operator asked for is kept or refused, never silently played later.
        let asked = self.options.start_at.filter(|_| run.number == 0);
        if let Some(start) = asked.filter(|start| *start < now + needed.total()) {
            return Err(Outcome::StartTooSoon { start, safe_start: now + needed.total() });
        }
        let lead = needed.stretched_to(wanted.unwrap_or(needed.total()));
        Ok(Need { lead, delay_max })
    }

    fn send_act(&mut self, now: Timestamp<Server>, index: usize, need: &Need, skew: Option<SkewBudget>) {
        // Later than any stop: those take back what was sent before them.
        let now = self.stopped_at.map_or(now, |stopped| now.max(stopped + Span::from_nanos(1)));
        let run = &self.runs[index];
        let target = run.target.unwrap_or(now);
        let lead = need.lead.stretched_to(target + self.slip(run, now) - now);
        let start = now + lead.total();
        let plan = &self.choreography.acts[run.act].plan;
        let timing = Timing {
            timestamp: now,
            start,
            lead,
            decision: now + lead.prepare,
            commit: start - lead.lease / 2,
            no_return: start - need.delay_max,
            end: start + plan.duration(),
            skew: skew.clone(),
            accepted_at: None,
            round: None,
            gap: run.target.map(|target| start - target),
            asked_again: false,
        };
        let act = self.act_name(run.act);
        let run = &mut self.runs[index];
        run.stage = Stage::Preparing;
        run.awaited = run.present().count();
        run.timing = Some(timing);
        for member in &mut run.members {
            let robot = &mut self.robots[member.robot];
            let measured = robot.clock_at(now).filter(|_| robot.clock_mode == ClockMode::Measured);
            member.shift = measured.map_or(Span::ZERO, |reading| reading.offset);
            robot.shift = member.shift;
        }
        self.name_requests(index);
        self.record(Record::Prepared(self.promise(index)));
        self.tell(Progress::Preparing { act, timestamp: now, start, lead, skew });
        // Robots of an act that plays must not wait longer for their next renewal because its rhythm changes now.
        if self.runs.len() > 1 {
            self.renew_all(now);
        }
        self.next_renewal = Some(self.renewal_after(now));
        for member in 0..self.runs[index].members.len() {
            if !self.runs[index].members[member].out {
                self.send_scripts(now, index, member);
            }
        }
    }

    /// A robot whose time is measured has the scripts of an act that plays by an older measurement: what follows at once
    /// must not overlap them by the difference.
    fn slip(&self, run: &ActRun, now: Timestamp<Server>) -> Span {
        let earlier = |member: &Member| {
            let robot = &self.robots[member.robot];
            let playing = self
                .runs
                .iter()
                .any(|other| other.number != run.number && other.member(member.robot).is_some());
            let offset =
                robot.clock_at(now).filter(|_| playing && robot.clock_mode == ClockMode::Measured)?.offset;
            Some(robot.shift - offset)
        };
        run.present().filter_map(earlier).max().unwrap_or(Span::ZERO).max(Span::ZERO)
    }

    /// Every request gets the name under which it is known for ever, also after a crash of this machine.
    fn name_requests(&mut self, index: usize) {
        let run = &mut self.runs[index];
        let timestamp = run.timing.as_ref().map_or(0, |timing| timing.timestamp.as_nanos() / 1_000);
        let session = self.options.session.as_ref().map(|session| format!("{session}/")).unwrap_or_default();
        for (m, member) in run.members.iter_mut().enumerate() {
            for (s, script) in member.scripts.iter_mut().enumerate() {
                let id = format!("{session}{timestamp}/{}/{}/{s}", run.number, member.robot);
                // Sessions are named by this program, far below the limit.
                script.request_id = RequestId::new(id).ok();
                if let Some(id) = &script.request_id {
                    let open = &mut self.robots[member.robot].open;
                    open.open(script.plan.device.clone(), id.clone(), (run.number, m, s));
                }
            }
        }
    }

    fn promise(&self, index: usize) -> Promise {
        let run = &self.runs[index];
        let script = |member: &Member, script: &ScriptState| {
            Some(PromisedScript {
                robot: self.robots[member.robot].id.clone(),
                device: script.plan.device.clone(),
                request_id: script.request_id.clone()?,
                content_hash: content_hash(script),
                shift: member.shift,
                start: script.plan.start,
                duration: script.plan.script.duration(),
                running: script.plan.stop_condition.running,
            })
        };
        let of_member =
            |member: &&Member| member.scripts.iter().filter_map(|s| script(member, s)).collect::<Vec<_>>();
        let timing = run.timing.as_ref();
        Promise {
            number: run.number,
            act: run.act,
            timestamp: timing.map_or(run.since, |timing| timing.timestamp),
            start: timing.map_or(run.since, |timing| timing.start),
            lease: timing.map_or(Span::ZERO, |timing| timing.lead.lease),
            scripts: run.present().collect::<Vec<_>>().iter().flat_map(of_member).collect(),
        }
    }

    /// Sends a member as many of its scripts as its devices have room for.
    pub(super) fn send_scripts(&mut self, now: Timestamp<Server>, index: usize, member: usize) {
        let run = &self.runs[index];
        let state = &run.members[member];
        let others = self.runs.iter().filter(|other| other.number != run.number);
        let held = |device: &urrcp::DeviceId| {
            others.clone().map(|other| other.held(state.robot, device, run.number)).sum::<usize>()
        };
        let sendable = state.sendable(&self.robots[state.robot], held);
        for script in sendable {
            let robot = self.runs[index].members[member].robot;
            let Some(request) = self.request(index, member, script) else { continue };
            self.runs[index].members[member].scripts[script].phase = ScriptPhase::Sent;
            self.robots[robot].touched.insert(request.device_id.clone());
            self.send(now, robot, Message::ControlRequest(request));
        }
    }

    /// The request of a script: the same bytes however often it is sent.
    pub(super) fn request(&self, index: usize, member: usize, script: usize) -> Option<ControlRequest> {
        let run = &self.runs[index];
        let timing = run.timing.as_ref()?;
        let member = &run.members[member];
        let script = &member.scripts[script];
        let command = Command::Script(script.plan.script.clone());
        let offset = timing.start - timing.timestamp + script.plan.start.span();
        Some(ControlRequest {
            timestamp: Some(timing.timestamp + member.shift),
            time_offset_to_start: Some(Millis::from_span(offset)),
            device_id: script.plan.device.clone(),
            stop_condition: Some(StopCondition {
                pending: Some(Millis::from_span(timing.lead.lease)),
                running: script.plan.stop_condition.running,
            }),
            request_id: script.request_id.clone(),
            content_hash: Some(command.content_hash()),
            session: self.options.session.clone(),
            hold: false,
            command,
        })
    }

    pub(super) fn script_response(
        &mut self,
        now: Timestamp<Server>,
        robot: usize,
        response: &ControlResponse,
    ) {
        let Some((_, &(number, member, script))) = self.robots[robot].open.find(response) else {
            tracing::debug!(robot = %self.robots[robot].id, "answer to no open request: {response:?}");
            return;
        };
        let Some(index) = self.runs.iter().position(|run| run.number == number) else { return };
        // By the robot's own time of sending: an answer that was overtaken says nothing of now.
        let offset = self.robots[robot].clock_at(now).map_or(Span::ZERO, |reading| reading.offset);
        let said_at = (response.timestamp - offset).assume_clock::<Server>().min(now);
        self.robots[robot].echoes |= response.request_id.is_some();
        let state = &mut self.runs[index].members[member].scripts[script];
        if matches!(response.status, Status::Accepted | Status::Started) {
            state.held_at = state.held_at.max(Some(said_at));
        }
        if let Some(error) = foreign_content(state, response) {
            let device = response.device_id.clone();
            return self.fail(now, robot, FailureKind::Script { device, error });
        }
        if !state.note(response) {
            return;
        }
        if matches!(self.phase, Phase::Stopping { .. } | Phase::Ended) {
            return;
        }
        match response.status {
            Status::Accepted => self.accepted(now, robot, index, member),
            Status::Started => self.started(robot, index, member, script),
            Status::Ok if self.runs[index].members[member].scripts[script].phase == ScriptPhase::Ended => {
                self.ended(now, robot, index, member);
            }
            Status::Failed | Status::Ok => {
                let error = match &self.runs[index].members[member].scripts[script].phase {
                    ScriptPhase::Failed(error) => error.clone(),
                    _ => super::robot_state::error_of(response),
                };
                let device = response.device_id.clone();
                self.fail(now, robot, FailureKind::Script { device, error });
            }
            Status::Provide | Status::Other(_) => {}
        }
    }

    fn accepted(&mut self, now: Timestamp<Server>, robot: usize, index: usize, member: usize) {
        let run = &mut self.runs[index];
        if run.stage == Stage::Preparing && run.members[member].has_accepted() {
            if let Some(timing) = &mut run.timing {
                timing.accepted_at = Some(now);
            }
            run.awaited = run.awaited.saturating_sub(1);
            let all = run.awaited == 0;
            let robot = self.robots[robot].id.clone();
            self.tell(Progress::Accepted { robot });
            if all {
                self.decide_if_due(now, index);
            }
        }
    }

    /// The one decision, as soon as all have accepted or when it is due: the act starts if every robot has accepted
    /// everything, else none starts.
    pub(super) fn decide_if_due(&mut self, now: Timestamp<Server>, index: usize) {
        let Some(timing) = &self.runs[index].timing else { return };
        let (decision, ask_again, asked) = (timing.decision, timing.ask_again(), timing.asked_again);
        let (start, lease, no_return) = (timing.start, timing.lead.lease, timing.no_return);
        let within = timing.lead.prepare;
        if now >= ask_again && !asked && self.runs[index].awaited > 0 {
            self.ask_again(now, index);
        }
        let all = self.runs[index].awaited == 0;
        if now < decision && !all {
            return;
        }
        let slow: Vec<_> = self.runs[index]
            .present()
            .filter(|member| !member.has_accepted())
            .map(|member| (member.robot, self.unaccepted(member, within)))
            .collect();
        if !slow.is_empty() {
            self.fail_all(now, slow);
        }
        let Some(run) = self.runs.get(index).filter(|_| self.phase == Phase::Performing) else { return };
        if run.present().next().is_none() {
            self.runs[index].stage = Stage::Over;
            return;
        }
        // A decision that comes late would shorten what the leases need to run out before the start.
        if now > start - lease {
            return self.abort(now, Outcome::DecisionLate { by: now - decision }, false, None);
        }
        tracing::info!(%start, "decided");
        let run = &mut self.runs[index];
        run.stage = Stage::Decided;
        let (number, act) = (run.number, run.act);
        let duration = self.choreography.acts[act].plan.duration();
        let act = self.act_name(act);
        let unnamed = self.runs[index].present().map(|member| &self.robots[member.robot]);
        let unnamed = unnamed.filter(|robot| !robot.echoes).map(|robot| robot.id.clone()).collect();
        self.record(Record::Decided { number, unnamed });
        self.tell(Progress::Decided { act, start, duration, no_return });
    }

    /// Sends what has not been answered once more, in case it was lost.
    fn ask_again(&mut self, now: Timestamp<Server>, index: usize) {
        if let Some(timing) = &mut self.runs[index].timing {
            timing.asked_again = true;
        }
        for member in 0..self.runs[index].members.len() {
            let state = &self.runs[index].members[member];
            let robot = state.robot;
            if state.out || state.has_accepted() || !self.robots[robot].is_up() {
                continue;
            }
            for script in 0..state.scripts.len() {
                if self.runs[index].members[member].scripts[script].phase == ScriptPhase::Sent
                    && let Some(request) = self.request(index, member, script)
                {
                    self.robots[robot].totals.retries += 1;
                    self.send(now, robot, Message::ControlRequest(request));
                }
            }
        }
    }

    fn unaccepted(&self, member: &Member, within: Span) -> FailureKind {
        match &self.robots[member.robot].broken {
            Some(reason) => FailureKind::LinkDown { reason: reason.clone() },
            None => FailureKind::Silent { awaited: awaited_acceptance(member), within },
        }
    }
}

fn content_hash(script: &ScriptState) -> ContentHash {
    Command::Script(script.plan.script.clone()).content_hash()
}

/// What starts is what was checked: the robot's own hash of what it accepted has to be ours.
fn foreign_content(script: &ScriptState, response: &ControlResponse) -> Option<ControlError> {
    let echoed = response.content_hash.filter(|_| response.status == Status::Accepted)?;
    (echoed != content_hash(script)).then(|| {
        let message = "the robot accepted another script than the one sent (content_hash differs)";
        ControlError::new(ErrorCode::Malformed, message)
    })
}

/// How much has to travel, measured on the real encoding of the largest script.
fn request_bytes(run: &ActRun, now: Timestamp<Server>) -> usize {
    let scripts = || run.present().flat_map(|member| &member.scripts);
    let Some(largest) = scripts().max_by_key(|script| script.plan.script.steps().len()) else { return 0 };
    let mut line = Vec::new();
    let command = Command::Script(largest.plan.script.clone());
    let mut request = ControlRequest::immediate(largest.plan.device.clone(), command);
    request.timestamp = Some(now);
    encode(&Message::ControlRequest(request), &mut line);
    let steps: usize = scripts().map(|script| script.plan.script.steps().len()).sum();
    let step_bytes = line.len() / largest.plan.script.steps().len().max(1);
    steps * step_bytes + scripts().count() * 256
}

fn awaited_acceptance(member: &Member) -> String {
    let open: Vec<_> =
        member.scripts.iter().filter(|s| !s.accepted).map(|s| format!("`{}`", s.plan.device)).collect();
    match open.len() {
        0..=4 => format!("acceptance by {}", open.join(", ")),
        n => format!("acceptance by {} and {} more devices", open[..3].join(", "), n - 3),
    }
}
