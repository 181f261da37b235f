//! Questions to robots. They renew leases, measure clocks and detect robots that have gone silent.
//!
//! All robots are asked at least once per second, and three times per lease. While an act approaches its start, it asks its robots itself
//! (`act/approaching.rs`). A question that carries the lease is then sent ahead of any other message to these robots. Between the
//! critical instant (when the scheduler stops sending before a start) and the commitment, only stops are sent.

use urrcp::{
    AvailabilityRequest, Inquiry, InquiryResponse, Message, Millis, Robot, Server, Span, Status, Timestamp,
};

use super::act::{Act, NamedScripts, ReportTimes};
use super::exchanges::Times;
use super::failure_kind::FailureKind;
use super::lead::LeadTime;
use super::robot_state::Standing;
use super::seize::Ownership;
use super::{Greeting, Mission, Phase, Progress, RobotIndex, error_of_status};
use crate::clock::ClockSample;

/// Interval between two rounds of questions if no lease requires a shorter one.
pub(super) const KEEP_ALIVE: Span = Span::from_millis(1_000);
/// The maximum time for which a robot may owe an answer, if it has no lease that limits it.
pub(super) const SILENCE_MAX: Span = Span::from_millis(3_000);
/// The minimum interval between two reports to the operator about a robot's own status.
const TOLD_INTERVAL: Span = Span::from_millis(900);
/// A round that is late by more than this was delayed on this machine, and indicates nothing about the robots.
pub(super) const HELD_UP: Span = Span::from_millis(100);
/// The minimum interval between two checks for silent robots.
const LOOK_AGAIN: Span = Span::from_millis(1);
/// The minimum interval between two checks for silent robots, per robot of the fleet: 10 ms for 10,000 robots.
const LOOK_A_ROBOT: Span = Span::from_micros(1);

/// The times of the next checks of a mission; `None` for a check that is not scheduled.
#[derive(Debug, Default)]
pub(super) struct Timers {
    pub(super) next_round: Option<Timestamp<Server>>,
    /// The time of the next check whether a robot has been silent for too long.
    pub(super) next_silence: Option<Timestamp<Server>>,
    /// The time of the next check whether a robot has not identified itself.
    pub(super) next_name: Option<Timestamp<Server>>,
    /// The earliest time at which the mission gives up a robot whose link is lost.
    pub(super) give_up: Option<Timestamp<Server>>,
    /// The time at which stops were last sent; `None` if none was.
    pub(super) stopped_at: Option<Timestamp<Server>>,
}

impl Mission {
    /// Asks all robots when the next round is due. The round is slightly delayed if it would disturb robots that start.
    pub(super) fn renew_if_due(&mut self, now: Timestamp<Server>) {
        if now < *self.timers.next_round.get_or_insert(now + KEEP_ALIVE) {
            return;
        }
        let may_be_sent = self.acts.iter().map(|act| act.out_of_quiet(now)).max();
        if let Some(at) = may_be_sent.filter(|at| *at > now && *at - now <= self.round_interval() / 4) {
            self.timers.next_round = Some(at);
            return;
        }
        self.renew_all(now);
        self.timers.next_round = Some(now + self.round_interval());
        self.timers.next_silence = self.silence_due(now);
    }

    fn renew_all(&mut self, now: Timestamp<Server>) {
        let lately = now - self.round_interval() / 2;
        for robot in self.robots.indices() {
            match (self.robots[robot].stop_was_sent(), self.robots[robot].awaits_stop()) {
                (false, _) if self.is_asked_anyway(lately, robot) => {}
                (false, _) if self.robots[robot].standing == Standing::Absent => self.ask_absent(now, robot),
                (false, _) => self.ask(now, robot),
                // A robot that was left out has not confirmed its stop yet.
                (true, true) => self.repeat_stop(now, robot),
                (true, false) => {}
            }
        }
    }

    /// Requests the availability of a robot that is to join, until it is available.
    fn ask_absent(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if self.robots[robot].is_up() && self.options.greeting == Greeting::Full {
            self.ask_availability(now, robot);
        }
    }

    /// Whether an act that approaches its start asks the robot itself. To save bandwidth, the robot is not asked twice.
    fn is_asked_anyway(&self, lately: Timestamp<Server>, robot: RobotIndex) -> bool {
        let asked = self.robots[robot].contact.questions.last_asked().is_some_and(|at| at > lately);
        asked && self.acts.iter().any(|act| act.approaches(robot))
    }

    /// Interval between two rounds: a third of the shortest lease, within limits.
    fn round_interval(&self) -> Span {
        interval_for(self.acts.iter().filter_map(Act::shortest_lease).min())
    }

    /// Schedules the next round early enough for a message that is sent under this lease.
    pub(super) fn quicken_rounds(&mut self, now: Timestamp<Server>, lease: Option<Span>) {
        let next = now + interval_for(lease);
        self.timers.next_round = Some(self.timers.next_round.map_or(next, |at| at.min(next)));
    }

    /// Detects a delay of this machine. Robots that could not answer during the delay are not treated as silent.
    pub(super) fn notice_hold_up(&mut self, now: Timestamp<Server>) {
        if self.timers.next_round.is_some_and(|due| now > due + HELD_UP) {
            self.machine.rounds_held_up += 1;
            self.robots.iter_mut().for_each(|robot| robot.contact.questions.forgive());
            self.timers.next_silence = None;
        }
    }

    /// Asks a robot for its times, which renews all leases. While an act approaches its start, also asks about its scripts.
    pub(super) fn ask(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if self.acts.iter().any(|act| act.approaches(robot)) {
            return self.inquire(now, robot);
        }
        if !self.acts.iter().any(|act| act.holds_messages_to(robot, now)) {
            self.ask_about(now, robot, Vec::new());
        }
    }

    /// Asks a robot about all its scripts, and makes it shorten the leases of acts that approach their start.
    pub(super) fn inquire(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if !self.acts.iter().any(|act| act.holds_messages_to(robot, now)) {
            self.inquire_now(now, robot);
        }
    }

    /// Like `inquire`, but also asks while messages to the robot are held back. Used before an urgent message.
    pub(super) fn inquire_now(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let ahead = self.robots[robot].clock_at(now).map(|reading| reading.offset);
        let named = self.acts.iter().flat_map(|act| {
            let named = act.names_of(robot, now, ahead);
            named.into_iter().chain(act.owed_by(robot))
        });
        let named = named.collect();
        self.ask_about(now, robot, named);
    }

    pub(super) fn ask_about(&mut self, now: Timestamp<Server>, robot: RobotIndex, named: Vec<NamedScripts>) {
        let state = &mut self.robots[robot];
        if !state.is_up() {
            return;
        }
        let named = in_parts(named);
        state.contact.questions.asked(now);
        state.contact.exchanges.asked(now, named.len().max(1));
        let session = self.options.session_on_the_wire();
        if !state.takes_inquiries() {
            let request =
                AvailabilityRequest { timestamp: Some(now), session, seize: false, revocation_list: None };
            return self.post(now, robot, Message::AvailabilityRequest(request));
        }
        let plain = Inquiry { timestamp: Some(now), session, ..Inquiry::default() };
        if named.is_empty() {
            return self.post(now, robot, Message::Inquiry(plain));
        }
        for group in named {
            let pending_lease = group.lease.map(Millis::from_span);
            let (requests, pending_until) = (group.requests, group.until);
            let inquiry = Inquiry { requests, pending_lease, pending_until, ..plain.clone() };
            self.post(now, robot, Message::Inquiry(inquiry));
        }
    }

    /// Asks a robot for its times and claims it for the session. This also renews all leases. If requested, takes the robot over from
    /// another session.
    pub(super) fn ask_availability(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        self.robots[robot].contact.questions.asked(now);
        self.robots[robot].contact.exchanges.asked(now, 1);
        let session = self.options.session_on_the_wire();
        let seize = self.robots[robot].identity.ownership == Ownership::Seizing;
        let request = AvailabilityRequest { timestamp: Some(now), session, seize, revocation_list: None };
        self.post(now, robot, Message::AvailabilityRequest(request));
    }

    /// Processes the times in a robot's answer.
    pub(super) fn take_times(&mut self, now: Timestamp<Server>, robot: RobotIndex, sample: ClockSample) {
        let state = &mut self.robots[robot];
        let (steps, known) = (state.clock.steps(), state.clock.tells_outliers());
        let owed = state.owes_its_times();
        let known = known && state.unmeasured_since().is_none();
        state.clock.add(sample);
        state.contact.questions.answer(sample.sent);
        let answered = owed && !state.owes_its_times();
        // A process that takes over a mission does not know by which clock the robot's scripts were sent.
        if state.clock.steps() > steps || state.clock.samples() == 1 {
            self.clock_is_new(now, robot);
        }
        if !known {
            // An act may have waited for the robot's times.
            self.acts.iter_mut().for_each(|act| act.look_again_at(None));
        }
        if let Some(kind) = self.acts.iter().find_map(|act| act.clock_was_set(now, robot, &self.robots)) {
            self.fail(now, robot, kind);
        }
        if answered {
            self.catch_up(now, robot);
        }
    }

    /// Handles a clock that was set or that this process sees for the first time. A robot whose clock was set since an act was sent to it
    /// may start long before the others.
    fn clock_is_new(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        self.robots[robot].clock_was_set();
        // An act may have waited for the new clock.
        self.acts.iter_mut().for_each(Act::look_again);
        let plays = |act: &&Act| act.place_of(robot).is_some();
        let mut failing: Vec<(RobotIndex, FailureKind)> = Vec::new();
        for (robot, kind) in self.acts.iter().filter(plays).flat_map(|act| act.strayed(now, &self.robots)) {
            if !failing.iter().any(|(other, _)| *other == robot) {
                failing.push((robot, kind));
            }
        }
        if !failing.is_empty() {
            return self.fail_all(now, failing);
        }
        for act in 0..self.acts.len() {
            let (number, actions) = (self.acts[act].number(), self.acts[act].allow_for(now, &self.robots));
            self.carry_out(now, number, actions);
        }
    }

    /// Notes that a question reached a robot at `at` by the robot's clock. A robot that takes no inquiries fails if it received nothing
    /// for longer than its lease: it has then dropped its scripts, and does not report that when asked.
    pub(super) fn question_reached(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        at: Timestamp<Robot>,
    ) {
        let Some(before) = self.robots[robot].reached(at) else { return };
        if self.robots[robot].takes_inquiries() {
            return;
        }
        let ran_out = self.acts.iter().find_map(|act| act.ran_out(now, robot, before, at));
        let state = &self.robots[robot];
        let spoken = state.contact.questions.passed_over() || state.was_spoken_to(now, before, at);
        let broke_off = || self.acts.iter().find_map(|act| act.broke_off(robot, before, at));
        if let Some(kind) = ran_out.or_else(|| broke_off().filter(|_| !spoken)) {
            self.fail(now, robot, kind);
        }
    }

    /// Processes a robot's answer to an inquiry about its scripts.
    pub(super) fn inquiry_answered(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        response: &InquiryResponse,
    ) {
        let times = Times {
            originate: response.originate_timestamp,
            received: response.receive_timestamp,
            answered: response.timestamp,
            arrived: self.outbox.arrived,
        };
        let Some(sample) = self.robots[robot].contact.exchanges.answered(times) else { return };
        let asked_at = sample.sent;
        // The times are not used as a clock sample: the robot may belong to another session, and a robot with many devices sends several
        // answers at once.
        if matches!(self.phase, Phase::Greeting { .. }) {
            return self.positions_stated(now, robot, &response.devices);
        }
        if !response.devices.is_empty() {
            self.positions_stated(now, robot, &response.devices);
        }
        self.take_times(now, robot, sample);
        for report in &response.requests {
            let Some(script) = self.robots[robot].requests.script(&report.request_id) else { continue };
            let Some(act) = self.acts.iter_mut().find(|act| act.number() == script.act) else { continue };
            let was_lost = act.script(script).is_lost();
            let times = ReportTimes { asked_at, said_at: response.timestamp, arrived: self.outbox.arrived };
            let noted = act.reported(script, report, times, &self.robots);
            let elsewhere = act.runs_elsewhere(script, &self.robots[robot], now);
            elsewhere
                .filter(|_| !was_lost)
                .into_iter()
                .for_each(|until| self.robots[robot].runs_elsewhere(until));
            self.carry_out(now, script.act, noted.actions);
        }
        self.report_rest(now, robot);
        self.tell_heard(now, robot);
        if response.status == Status::Failed && !matches!(self.phase, Phase::Stopping { .. }) {
            let error = error_of_status(response.error.as_ref());
            self.fail(now, robot, FailureKind::NotAvailable { error });
        }
        self.measure_further(now, robot);
        self.goes_on(now);
    }

    /// Asks a robot again after each answer, until enough round trips are known to distinguish outliers. A process that took over the
    /// mission initially knows a robot's link by a single exchange, which may have been unusually slow.
    pub(super) fn measure_further(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &self.robots[robot];
        let known = state.clock.tells_outliers() || state.stop_was_sent();
        if self.phase == Phase::Performing && !known && state.contact.questions.last_unanswered().is_none() {
            self.ask(now, robot);
        }
    }

    /// Reports a robot's own status to the operator from time to time.
    fn tell_heard(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &mut self.robots[robot];
        if state.contact.told_at.is_some_and(|told| now < told + TOLD_INTERVAL) {
            return;
        }
        state.contact.told_at = Some(now);
        self.tell_steps(robot);
    }

    /// Reports a robot's steps and clock to the operator.
    pub(super) fn tell_steps(&mut self, robot: RobotIndex) {
        let state = &self.robots[robot];
        let (id, clock_offset) = (state.id.clone(), state.clock.reading().map(|reading| reading.offset));
        let member = self.acts.first().and_then(|act| act.member(robot));
        let scripts = member.into_iter().flat_map(|member| member.scripts());
        let steps_done = scripts.map(|script| u64::from(script.steps_done())).sum();
        self.tell(Progress::Heard { robot: id, steps_done, clock_offset });
    }

    /// How long a robot may owe an answer while it has scripts of a committed act; `None` if no limit applies.
    pub(super) fn silence_bound(&self, now: Timestamp<Server>, robot: RobotIndex) -> Option<Span> {
        let state = &self.robots[robot];
        let plays = |act: &&Act| act.is_committed() && act.has_something_on(robot);
        let linked = state.is_up() || state.owes_its_name_since().is_some();
        if state.stop_was_sent() || !linked || !self.acts.iter().any(|act| plays(&act)) {
            return None;
        }
        let lease = self.acts.iter().filter_map(|act| act.running_lease(robot, now)).min();
        Some(lease.unwrap_or(SILENCE_MAX) + state.round_trip())
    }

    /// The time of the next check for silent robots: when a robot will have been silent for too long, or when another lease begins to
    /// apply with its next script.
    fn silence_due(&self, now: Timestamp<Server>) -> Option<Timestamp<Server>> {
        let due = |robot: RobotIndex| {
            let silent = self.robots[robot].silent_at(self.silence_bound(now, robot)?)?;
            let begins =
                self.acts.iter().filter_map(|act| Some(act.out_of_quiet(act.next_begin(robot, now)?)));
            begins.chain([silent]).min()
        };
        self.robots.indices().filter_map(due).min()
    }

    /// Fails robots that owe an answer for longer than their running lease, whatever the state of their link.
    pub(super) fn notice_silence(&mut self, now: Timestamp<Server>) {
        if self.timers.next_silence.is_none_or(|due| now < due) {
            return;
        }
        let silent = |robot: RobotIndex| {
            let within = self.silence_bound(now, robot)?;
            self.robots[robot].silent_at(within).filter(|due| now >= *due)?;
            let awaited = "answer".to_owned();
            Some((robot, FailureKind::Silent { awaited, within }))
        };
        let silent: Vec<_> = self.robots.indices().filter_map(silent).collect();
        if !silent.is_empty() {
            self.fail_all(now, silent);
        }
        // Each check inspects every robot. A large fleet whose scripts begin one after another is checked less often.
        let robots = i64::try_from(self.robots.len()).unwrap_or(i64::MAX);
        let pause = LOOK_AGAIN.max(LOOK_A_ROBOT * robots);
        self.timers.next_silence = self.silence_due(now).map(|due| due.max(now + pause));
    }
}

/// Maximum length of the request ids in one question, in bytes. A robot accepts at most 64 KiB from a connection that has not named its
/// session yet, such as a new one after an interruption.
const NAMES_BYTES: usize = 32 * 1024;

/// Splits the ids of a question into as many groups as the limit `NAMES_BYTES` requires.
fn in_parts(named: Vec<NamedScripts>) -> Vec<NamedScripts> {
    let mut parts = Vec::with_capacity(named.len());
    for NamedScripts { lease, until, requests } in named {
        let mut bytes = 0;
        let (mut part, empty) = (Vec::new(), requests.is_empty());
        for id in requests {
            bytes += id.as_str().len();
            if bytes > NAMES_BYTES && !part.is_empty() {
                bytes = id.as_str().len();
                parts.push(NamedScripts { lease, until, requests: std::mem::take(&mut part) });
            }
            part.push(id);
        }
        if empty || !part.is_empty() {
            parts.push(NamedScripts { lease, until, requests: part });
        }
    }
    parts
}

/// Interval between two rounds under a lease: a third of the lease, from 1 ms to `KEEP_ALIVE`.
fn interval_for(lease: Option<Span>) -> Span {
    let interval = lease.map(|lease| lease / LeadTime::RENEWALS_A_LEASE);
    interval.unwrap_or(KEEP_ALIVE).min(KEEP_ALIVE).max(Span::from_millis(1))
}

#[cfg(test)]
mod tests {
    use urrcp::RequestId;

    use super::*;

    #[test]
    fn inquiry_about_many_scripts_is_split_to_fit_a_new_connection() {
        let id = |n: usize| RequestId::new(format!("{:0>70}", n)).unwrap();
        let group = |count: usize, lease: i64| NamedScripts {
            lease: Some(Span::from_millis(lease)),
            until: None,
            requests: (0..count).map(id).collect(),
        };
        let parts = in_parts(vec![group(2_000, 1), group(0, 2), group(3, 3)]);
        let leases: Vec<_> =
            parts.iter().filter_map(|part| part.lease).map(|lease| lease.as_nanos() / 1_000_000).collect();
        assert_eq!(leases, [1, 1, 1, 1, 1, 2, 3]);
        let named: Vec<_> = parts.iter().flat_map(|part| part.requests.clone()).collect();
        assert_eq!(named.len(), 2_003);
        for NamedScripts { requests, .. } in parts {
            let mut line = Vec::new();
            urrcp::encode(&Message::Inquiry(Inquiry { requests, ..Inquiry::default() }), &mut line);
            assert!(line.len() < 64 * 1024, "{}", line.len());
        }
    }
}
