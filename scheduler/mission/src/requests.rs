//! Sends messages to robots and records to the journal, and processes responses. Responses are assigned to requests by their ids or,
//! without ids, by the state of the scripts.

use std::cmp::Reverse;
use std::collections::VecDeque;

use urrcp::{
    ControlResponse, DeviceId, ErrorCode, Message, RequestId, Server, Span, Status, StatusValue, Timestamp,
};

use super::act::Act;
use super::failure_kind::FailureKind;
use super::open_requests::Answered;
use super::record::Record;
use super::robot_state::{Rest, SentStop, Stop};
use super::script::{Script, ScriptRef, ScriptState};
use super::{ActNumber, Action, ClockMode, Mission, Phase, RobotIndex, StoppedBy, ledger};

/// The minimum time that writing a durable record is assumed to take.
const RECORDING: Span = Span::from_millis(30);
/// The maximum time that is allowed for writing a durable record. With a slower disk, an act is committed too late.
const RECORDING_MAX: Span = Span::from_millis(2_000);

/// Durable records that are being written to disk.
#[derive(Debug, Default)]
pub(super) struct Recording {
    /// Number of durable records that were passed to the journal so far.
    pub(super) count: u64,
    /// The records for which an act waits, or by which the speed of the disk is measured. For each: its number, the act, and the time of
    /// the request.
    pub(super) awaited: VecDeque<(u64, Option<ActNumber>, Timestamp<Server>)>,
    /// Duration of the slowest of the last writes; `None` before the first write.
    pub(super) longest: Option<Span>,
    /// How often the journal was removed or replaced while this process was writing it.
    pub(super) written_again: u64,
}

/// The actions and messages that the mission has decided on.
#[derive(Debug)]
pub(super) struct Outbox {
    /// Arrival time of the message that is being handled.
    pub(super) arrived: Timestamp<Server>,
    pub(super) actions: Vec<Action>,
    /// Messages that must not be sent before an act is committed or withdrawn, each with the index of its robot.
    pub(super) deferred: Vec<(RobotIndex, Message)>,
}

impl Outbox {
    pub(super) const fn new(now: Timestamp<Server>) -> Self {
        Self { arrived: now, actions: Vec::new(), deferred: Vec::new() }
    }
}

impl Mission {
    pub(super) fn receive(&mut self, now: Timestamp<Server>, robot: RobotIndex, message: Message) {
        if !self.is_expected_robot(now, robot, &message) {
            return;
        }
        let named = self.robots[robot].named();
        if self.robots[robot].heard(now) {
            self.is_back(robot);
        }
        match message {
            Message::AvailabilityResponse(response) => self.availability(now, robot, &response),
            Message::InitializationBlock(block) => {
                self.introduced(now, robot, block);
                if named {
                    self.link_serves(now, robot);
                }
            }
            Message::ControlResponse(response) => self.control_response(now, robot, &response),
            Message::InquiryResponse(response) => self.inquiry_answered(now, robot, &response),
            _ => {
                let reason = "sent a message that only a server sends".to_owned();
                self.fail(now, robot, FailureKind::Garbled { reason });
            }
        }
    }

    fn control_response(&mut self, now: Timestamp<Server>, robot: RobotIndex, response: &ControlResponse) {
        match self.answered_request(now, robot, response) {
            Some(Answered::Stop(id)) => self.stop_answered(now, robot, &id, response),
            Some(Answered::Reading(purpose)) => {
                self.reading_taken(now, robot, response, purpose);
                self.goes_on(now);
            }
            Some(Answered::Script(script)) => self.script_answered(now, robot, script, response),
            None => {
                self.robots[robot].contact.exchanges.ignore();
                tracing::debug!(robot = %self.robots[robot].id, "ignored an answer that matches no open request: {response:?}");
            }
        }
    }

    /// Returns the request that a response answers; `None` if it answers none. A response without an id belongs to a stop, to a script or
    /// to a reading, whichever it can answer.
    fn answered_request(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        response: &ControlResponse,
    ) -> Option<Answered> {
        if let Some(id) = &response.request_id {
            return self.robots[robot].requests.answer_named(id);
        }
        let script = self.script_without_id(robot, response);
        let state = &mut self.robots[robot];
        let reported = script.filter(|_| state.reports());
        if let Some(id) = state.stop_confirmed_without_id(now, response, reported) {
            return Some(Answered::Stop(id));
        }
        match script {
            Some(script) => Some(Answered::Script(script)),
            // A refusal may belong to a reading or to a script.
            None => state.requests.answer_oldest_reading(response).map(Answered::Reading),
        }
    }

    /// Returns the script to which a response without an id may belong.
    fn script_without_id(&self, robot: RobotIndex, response: &ControlResponse) -> Option<ScriptRef> {
        let state = &self.robots[robot];
        // A stop also produces an `OK`. An `OK` is the end of a script only once the script can have ended.
        let meant = |script: &ScriptRef| {
            !state.stop_was_sent() || response.status != Status::Ok || {
                let act = self.acts.iter().find(|act| act.number() == script.act);
                act.is_some_and(|act| act.can_have_ended(*script, response.timestamp))
            }
        };
        let says = if state.reports() { Says::ByItself } else { Says::Answers };
        open_without_name(&self.acts, robot, says, &response.device_id, response).filter(meant)
    }

    fn stop_answered(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        id: &RequestId,
        response: &ControlResponse,
    ) {
        self.robots[robot].stop_answered(id, response);
        self.stop_confirmed(now, robot);
        self.stop_refused(robot);
        self.ask_how_far_it_came(now, robot);
        self.stop_progress(now);
    }

    fn script_answered(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        script: ScriptRef,
        response: &ControlResponse,
    ) {
        let stopped = self.robots[robot].stop_was_sent();
        let Some(act) = self.acts.iter_mut().find(|act| act.number() == script.act) else { return };
        if stopped && response.status == Status::Ok && names_nothing(response) {
            // It is unknown whether the script or the stop has ended.
            act.mark_unknown(script);
            return self.goes_on(now);
        }
        let was_barred = act.was_barred(script, response);
        let noted = act.answered(script, response, self.outbox.arrived, &self.robots);
        self.report_rest(now, robot);
        if noted.news != super::script::News::None {
            self.carry_out(now, script.act, noted.actions);
            self.goes_on(now);
        } else if matches!(self.phase, Phase::Stopping { .. }) {
            self.stop_progress(now);
        }
        if was_barred {
            self.rests_already(now, robot);
        }
    }

    /// Handles a robot that has ended all commands of this session by itself and rests: it needs no stop any more, and accepts none.
    fn rests_already(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &mut self.robots[robot];
        if !matches!(state.halt.stop, Stop::Sent(SentStop { rest: Rest::InPlace, .. })) {
            return;
        }
        state.set_stop(Stop::Confirmed(Rest::InPlace));
        self.stop_confirmed(now, robot);
        if matches!(self.phase, Phase::Stopping { .. }) {
            self.stop_progress(now);
        }
    }

    /// Handles a robot that refuses the stop because it now belongs to another session. The refusal is reported once. If the operator
    /// requested the stop, it is repeated, because the robot may become free. A mission that has failed leaves the robot to the other
    /// session, so that no later stop affects that session.
    fn stop_refused(&mut self, robot: RobotIndex) {
        let by_operator = matches!(self.phase, Phase::Stopping { by: StoppedBy::Operator, .. });
        if let Stop::Sent(sent) = &mut self.robots[robot].halt.stop {
            sent.given_up |= sent.taken_over.is_some() && !by_operator;
        }
        let state = &self.robots[robot];
        let told = |failure: &super::Failure| matches!(failure.kind, FailureKind::NotAvailable { .. });
        let Stop::Sent(SentStop { taken_over: Some(error), .. }) = &state.halt.stop else { return };
        if !state.failures.iter().any(told) {
            let error = error.clone();
            self.note_failure(robot, FailureKind::NotAvailable { error });
        }
    }

    /// Sends a robot as many scripts as its devices have room for, in order of start.
    pub(super) fn refill(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if !self.robots[robot].may_be_sent_scripts() {
            return;
        }
        for script in ledger::sendable(&self.acts, robot, &self.robots[robot]) {
            self.send_script(now, script);
        }
        // An act in the future may have waited for this room.
        self.acts.iter_mut().for_each(|act| act.look_again_at(None));
    }

    /// Whether a script may be sent to its robot now.
    pub(super) fn may_send(&self, script: ScriptRef) -> bool {
        let act = self.acts.iter().find(|act| act.number() == script.act);
        act.is_some_and(|act| self.robots[act.robot_of(script)].may_be_sent_scripts())
    }

    /// Sends the request of a script, for the first time or again.
    pub(super) fn send_script(&mut self, now: Timestamp<Server>, script: ScriptRef) {
        let Some(act) = self.acts.iter_mut().find(|act| act.number() == script.act) else { return };
        let robot = act.robot_of(script);
        let state = &self.robots[robot];
        let measured = state.settings.clock == ClockMode::Measured;
        let offset_at = |at| Some(state.clock_at(at).filter(|_| measured)?.offset);
        let translated = act.translate(script, state.clock.steps(), offset_at);
        let shift = act.members()[script.member].last_shift().filter(|_| translated.is_some());
        let Some(request) = act.request(script, self.options.session_on_the_wire().as_ref()) else { return };
        act.sent(now, script);
        let lease = act.shortest_lease_of(script);
        let keeps_limit = act.is_committed() && act.script(script).came_again();
        translated.into_iter().for_each(|record| self.record(record));
        let state = &mut self.robots[robot];
        state.shift = shift.unwrap_or(state.shift);
        state.halt.touched.insert(request.device_id.clone());
        state.halt.at_rest = false;
        if let Some(id) = &request.request_id {
            state.requests.add_script(id.clone(), script);
        }
        self.send(now, robot, Message::ControlRequest(request));
        if keeps_limit {
            // A robot that already has the script keeps the limit of the earlier request, and only an inquiry extends that limit.
            self.inquire(now, robot);
        }
        // The script's lease may require a round before the one for the earlier scripts.
        self.quicken_rounds(now, lease);
    }

    pub(super) fn count_retry(&mut self, script: ScriptRef) {
        if let Some(act) = self.acts.iter().find(|act| act.number() == script.act) {
            self.robots[act.robot_of(script)].totals.retries += 1;
        }
    }

    /// Sends a message. While an act of the robot approaches its start, a question that carries the lease is sent ahead of the message.
    /// Between the critical instant (when the scheduler stops sending before a start) and the commitment, the message is deferred.
    pub(super) fn send(&mut self, now: Timestamp<Server>, robot: RobotIndex, mut message: Message) {
        let waits = |act: &Act| act.holds_messages_to(robot, now) && !act.lets_through(robot, now);
        if self.acts.iter().any(waits) {
            return self.outbox.deferred.push((robot, message));
        }
        if self.acts.iter().any(|act| act.approaches(robot)) {
            self.inquire_now(now, robot);
        }
        // Set only here, because the act of a script that had to wait may have been committed meanwhile.
        self.limit(now, robot, &mut message);
        self.post(now, robot, message);
    }

    /// Sets `pending_until`, the limit after which a robot drops a script that is not decided. Only an inquiry extends the limit, so a
    /// robot without inquiries gets none.
    fn limit(&self, now: Timestamp<Server>, robot: RobotIndex, message: &mut Message) {
        let Message::ControlRequest(request) = message else { return };
        let state = &self.robots[robot];
        let script = request.request_id.as_ref().and_then(|id| state.requests.script(id));
        let Some(script) = script.filter(|_| state.takes_inquiries()) else { return };
        let act = self.acts.iter().find(|act| act.number() == script.act);
        let ahead = state.clock_at(now).map(|reading| reading.offset);
        request.pending_until = act.and_then(|act| act.pending_until(script, ahead));
    }

    /// Sends the messages that were deferred until an act was committed or withdrawn.
    pub(super) fn send_deferred(&mut self, now: Timestamp<Server>) {
        for (robot, message) in std::mem::take(&mut self.outbox.deferred) {
            let is_script =
                matches!(&message, Message::ControlRequest(it) if it.time_offset_to_start.is_some());
            if !is_script || self.robots[robot].may_be_sent_scripts() {
                self.send(now, robot, message);
            }
        }
    }

    pub(super) fn post(&mut self, now: Timestamp<Server>, robot: RobotIndex, message: Message) {
        self.post_by(now, robot, message, false);
    }

    pub(super) fn post_urgently(&mut self, now: Timestamp<Server>, robot: RobotIndex, message: Message) {
        self.post_by(now, robot, message, true);
    }

    fn post_by(&mut self, now: Timestamp<Server>, robot: RobotIndex, message: Message, urgent: bool) {
        if self.robots[robot].is_up() || urgent && self.takes_stops(now, robot) {
            self.robots[robot].is_sent(now, &message);
            self.outbox.actions.push(Action::Send { robot, message, urgent });
        }
    }

    pub(super) fn record(&mut self, record: Record) {
        self.recording.count += u64::from(record.is_durable());
        self.outbox.actions.push(Action::Record(record));
    }

    /// Writes a record that an act waits for.
    pub(super) fn record_for(&mut self, now: Timestamp<Server>, act: ActNumber, record: Record) {
        let durable = record.is_durable();
        self.record(record);
        if durable {
            self.recording.awaited.push_back((self.recording.count, Some(act), now));
        }
    }

    /// Writes the first record, to measure the disk before anything depends on it.
    pub(super) fn measure_disk(&mut self, now: Timestamp<Server>) {
        if self.recording.count == 0 && matches!(self.phase, Phase::Greeting { .. } | Phase::Performing) {
            self.record(Record::Begun);
            self.recording.awaited.push_back((self.recording.count, None, now));
        }
    }

    /// Whether it is known how long a record takes to reach the disk.
    pub(super) const fn disk_is_known(&self) -> bool {
        self.recording.longest.is_some()
    }

    /// Handles the report that the first `count` durable records are on disk.
    pub(super) fn recorded(&mut self, now: Timestamp<Server>, count: u64) {
        while let Some(&(_, number, asked)) =
            self.recording.awaited.front().filter(|(record, ..)| *record <= count)
        {
            self.recording.awaited.pop_front();
            // The maximum decays slowly, so that one slow moment does not delay the rest of the show.
            let before = self.recording.longest.unwrap_or_default() * 3 / 4;
            // Delays on this machine are not delays of the disk.
            self.recording.longest = Some((self.outbox.arrived - asked).max(before));
            let Some(number) = number else {
                self.acts.iter_mut().for_each(|act| act.look_again_at(None));
                continue;
            };
            let act = self.acts.iter_mut().find(|act| act.number() == number);
            let actions = act.map(Act::recorded).unwrap_or_default();
            self.carry_out(now, number, actions);
        }
        self.goes_on(now);
    }

    /// The time allowed for a durable record to reach the disk.
    pub(super) fn recording_time(&self) -> Span {
        (self.recording.longest.unwrap_or_default() * 2).max(RECORDING).min(RECORDING_MAX)
    }
}

/// Whether a robot reports the fates of its scripts, or only answers requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Says {
    ByItself,
    Answers,
}

/// Whether a response contains neither the id of its request nor a result.
const fn names_nothing(response: &ControlResponse) -> bool {
    response.request_id.is_none() && may_be_for_a_stop(response)
}

/// Whether an `OK` response may answer a stop. The response at the end of a script contains the last value of the script, but a stop sets
/// no value.
#[must_use]
pub const fn may_be_for_a_stop(response: &ControlResponse) -> bool {
    matches!((&response.status_value, response.steps_done), (StatusValue::Null, None | Some(0)))
}

/// The script to which a response without an id belongs; `None` if the response has an id or fits no script. The responses of a device
/// arrive in the order of its scripts.
pub(super) fn open_without_name(
    acts: &[Act],
    robot: RobotIndex,
    says: Says,
    device: &DeviceId,
    response: &ControlResponse,
) -> Option<ScriptRef> {
    if response.request_id.is_some() {
        return None;
    }
    let is_start = response.status == Status::Started;
    let all = || acts.iter().flat_map(|act| of_device(act, robot, device));
    let fits = |script: &Script, state: &ScriptState| match response.status {
        Status::Accepted => script.awaits_answer(),
        // A script that is known to run may not have started yet. Another process may have sent one that this process has not.
        Status::Started => {
            matches!(state, ScriptState::Sent | ScriptState::Held)
                || *state == ScriptState::Planned && script.is_unaccounted()
                || *state == ScriptState::Running && !script.has_started()
        }
        Status::Ok => matches!(state, ScriptState::Held | ScriptState::Running),
        Status::Provide => false,
        // A robot that only answers requests does not report the failure of a script that it has accepted.
        _ if says == Says::Answers => script.awaits_answer(),
        _ => matches!(state, ScriptState::Sent | ScriptState::Held | ScriptState::Running),
    };
    // A robot repeats its last response to a repeated request.
    let repeats =
        |script: &Script| is_start && *script.state() == ScriptState::Running && script.came_again();
    let mut open = all().filter(|(.., script)| fits(script, script.state()) || repeats(script));
    // Earlier scripts may be lost, as after a restart. A script that begins or ends now is the one that is due now.
    let off = |(act, at, script): &(&Act, ScriptRef, &Script)| {
        (*script.state() != ScriptState::Running && !is_start, act.off_its_time(*at, response))
    };
    // A script under a short lease is lost before an earlier one under a longer lease. Of two under equal leases, the earlier one may
    // have begun.
    let lease = |(act, script, _): &(&Act, ScriptRef, &Script)| {
        let lease = act.shortest_lease_of(*script);
        (lease.is_none(), lease, Reverse((script.act, script.script)))
    };
    let ran_out = response.error.as_ref().is_some_and(|error| error.code == ErrorCode::LinkLost);
    let late = response.error.as_ref().is_some_and(|error| error.code == ErrorCode::Late);
    let found = match response.status {
        Status::Started => open.min_by_key(off),
        // Of two that would end at the same instant, the one that has begun last: the other has ended before it, without a received
        // report.
        Status::Ok => open.reduce(|found, other| if off(&other) <= off(&found) { other } else { found }),
        Status::Failed if ran_out => open.min_by_key(lease),
        // A script that came too late is refused in the answer to its request.
        Status::Failed if late => open.min_by_key(|(.., script)| !script.awaits_answer()),
        _ => open.next(),
    };
    found.map(|(_, script, _)| script)
}

/// The scripts of an act on a robot's device, in order of time, with their references.
fn of_device<'a>(
    act: &'a Act,
    robot: RobotIndex,
    device: &'a DeviceId,
) -> impl Iterator<Item = (&'a Act, ScriptRef, &'a Script)> {
    let places = act.place_of(robot).into_iter();
    places.flat_map(move |member| {
        let scripts = act.members()[member].on(device);
        scripts
            .map(move |(index, script)| (act, ScriptRef { act: act.number(), member, script: index }, script))
    })
}
