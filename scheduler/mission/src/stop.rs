//! Stops robots: every device to which anything was sent gets an empty script and comes to rest.

use std::collections::BTreeSet;

use downbeat_plan::Way;
use urrcp::{Command, ControlRequest, DeviceId, Message, RequestId, Script, Server, Span, Timestamp};

use super::act::Act;
use super::failure_kind::FailureKind;
use super::record::Record;
use super::robot_state::{Link, Rest, RobotState, SentStop, Standing, Stop};
use super::{ActIndex, Greeting, Mission, Outcome, Phase, Progress, RobotIndex, StoppedBy};

/// Unconfirmed stops are repeated after this time or three round trips, whichever is longer.
const STOP_AGAIN: Span = Span::from_millis(200);

/// The devices of a robot that the mission has moved, and how they come to rest.
#[derive(Debug, Default)]
pub(crate) struct Halt {
    /// Devices to which this mission has sent anything that moves them.
    pub(crate) touched: BTreeSet<DeviceId>,
    pub(crate) stop: Stop,
    /// Whether the robot has confirmed its stop and has since been sent nothing that moves it.
    pub(crate) at_rest: bool,
    /// Whether the mission has reported that the robot has confirmed its stop.
    pub(crate) rest_reported: bool,
    /// Set once the robot's current process has lost a script that an earlier process may still run. Contains the end of the script's
    /// lease, or `Some(None)` if the script has no lease.
    pub(crate) elsewhere: Option<Option<Timestamp<Server>>>,
    /// The ends of the leases of the requests that the robot still held at the end of an act; `None` for a request without a lease.
    pub(crate) left: Vec<Option<Timestamp<Server>>>,
}

impl Mission {
    pub(super) fn request_stop(&mut self, now: Timestamp<Server>, rest: Rest, by: Option<String>) {
        if self.phase != Phase::Ended && by.is_some() {
            self.conclusion.because = by.as_ref().map(|by| format!("stopped by {by}"));
            self.conclusion.said_stop = by;
        }
        match self.phase {
            Phase::Greeting { .. } => self.refuse(Outcome::Stopped),
            Phase::Performing if rest == Rest::Home && self.is_on_its_way_home() => {}
            Phase::Performing => {
                let reason = self.conclusion.because.clone().unwrap_or_else(|| Outcome::Stopped.to_string());
                self.abort_because(now, Outcome::Stopped, reason, rest, None);
            }
            // The planned continuation after the stop is cancelled.
            Phase::Stopping { .. } => {
                self.course.then = None;
                self.conclusion.outcome = Some(Outcome::Stopped);
                let rest = self.rest_first(rest);
                self.stop_otherwise(now, rest);
            }
            Phase::Ended => {}
        }
    }

    /// Applies the operator's latest request: robots at rest are sent home, and robots that move home come to rest.
    fn stop_otherwise(&mut self, now: Timestamp<Server>, rest: Rest) {
        let other: Vec<_> =
            self.robots.indices().filter(|robot| self.robots[*robot].stops_otherwise(rest)).collect();
        if other.is_empty() && !self.wants_home() {
            return;
        }
        let reason = self.with_home(Outcome::Stopped.to_string());
        self.tell(Progress::Stopping { reason, rest });
        if other.is_empty() {
            return;
        }
        self.phase = self.stopping_from(now, StoppedBy::Operator);
        for robot in other {
            self.robots[robot].set_stop(Stop::None);
            self.stop_robot(now, robot, rest);
        }
        let by = self.conclusion.said_stop.clone();
        self.record(Record::Stopping { outcome: Outcome::Stopped, rest, by });
    }

    fn stopping_from(&self, now: Timestamp<Server>, by: StoppedBy) -> Phase {
        Phase::Stopping { deadline: now + self.options.patience, resend: now + self.stop_interval(), by }
    }

    /// If the outcome states that nothing was sent or started, replaces it with `Failed` and keeps its reason.
    pub(super) fn admit_that_it_moved(&mut self) {
        if let Some(denial) = self.conclusion.outcome.take_if(|outcome| outcome.denies_any_start()) {
            let reason = (denial != Outcome::NotStarted).then(|| denial.to_string());
            self.conclusion.because = denial.hold_up().or(reason).or_else(|| self.conclusion.because.take());
            self.conclusion.outcome = Some(Outcome::Failed);
        }
    }

    /// Stops the mission because the journal is lost, so that no further scripts can be promised to robots.
    pub(super) fn journal_lost(&mut self, now: Timestamp<Server>, reason: String) {
        self.tell(Progress::JournalLost { reason: reason.clone() });
        let outcome = Outcome::JournalLost { reason };
        match self.phase {
            Phase::Greeting { .. } => self.refuse(outcome),
            Phase::Performing => self.abort(now, outcome, Rest::InPlace, None),
            Phase::Stopping { .. } => {
                self.course.then = None;
                self.stays();
            }
            Phase::Ended => {}
        }
    }

    /// Stops the mission and withdraws everything that was sent. Leases are no longer renewed, so they end the scripts of robots that no
    /// message reaches.
    pub(super) fn abort(
        &mut self,
        now: Timestamp<Server>,
        outcome: Outcome,
        rest: Rest,
        then: Option<ActIndex>,
    ) {
        let reason = outcome.hold_up().unwrap_or_else(|| outcome.to_string());
        self.abort_because(now, outcome, reason, rest, then);
    }

    /// Like `abort`, but with a reason for users that contains more than the outcome.
    pub(super) fn abort_because(
        &mut self,
        now: Timestamp<Server>,
        outcome: Outcome,
        reason: String,
        rest: Rest,
        then: Option<ActIndex>,
    ) {
        let rest = self.rest_first(rest);
        let reason = self.with_home(reason);
        self.tell(Progress::Stopping { reason, rest });
        self.course.then = then;
        if let Some(act) = then.filter(|_| self.again.is_none()) {
            self.approaches(act);
        }
        self.timers.next_round = None;
        self.timers.next_silence = None;
        self.outbox.deferred.clear();
        let by = if outcome == Outcome::Stopped { StoppedBy::Operator } else { StoppedBy::Failure };
        self.phase = self.stopping_from(now, by);
        for robot in self.robots.indices() {
            self.stop_robot(now, robot, rest);
        }
        // A stop promises nothing. It is therefore sent first and recorded afterwards.
        let by = self.conclusion.said_stop.clone();
        self.record(Record::Stopping { outcome: outcome.clone(), rest, by });
        self.conclusion.outcome = Some(outcome);
        for robot in self.robots.indices() {
            if matches!(self.robots[robot].link, Link::Lost(_)) && self.robots[robot].awaits_stop() {
                self.reconnect(robot);
            }
        }
        self.stop_progress(now);
    }

    /// Stops all devices of a robot to which anything was sent, ahead of all waiting messages.
    pub(super) fn stop_robot(&mut self, now: Timestamp<Server>, robot: RobotIndex, rest: Rest) {
        let state = &mut self.robots[robot];
        // A robot at rest holds nothing that a stop would end, but it moves home if the operator requests it.
        let needless = if rest == Rest::Home { state.halt.touched.is_empty() } else { state.holds_nothing() };
        if needless || state.stop_was_sent() {
            return;
        }
        self.timers.stopped_at = self.timers.stopped_at.max(Some(now));
        let session = self.options.names_begin();
        let named = |(index, device): (usize, &DeviceId)| {
            // This program generates session names, far below the limit.
            let id = RequestId::new(format!("{session}stop/{}/{robot}/{index}", now.as_nanos() / 1_000));
            Some((id.ok()?, device.clone()))
        };
        let stops: Vec<_> = state.halt.touched.iter().enumerate().filter_map(named).collect();
        self.end_leases(now, robot);
        let state = &mut self.robots[robot];
        state.set_stop(Stop::Sent(SentStop { at: now, rest, taken_over: None, given_up: false }));
        stops.into_iter().for_each(|(id, device)| state.requests.add_stop(id, device));
        state.halt.at_rest = false;
        state.halt.rest_reported = false;
        self.send_stops(now, robot);
    }

    /// Ahead of the stops, sends questions that make the leases of all uncommitted scripts end before their start. The stop of one device
    /// renews the leases of the robot's other devices. If this process dies between two stops, those devices must not start uncommitted
    /// scripts.
    pub(super) fn end_leases(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &self.robots[robot];
        if !state.takes_inquiries() || state.stop_was_sent() || state.halt.touched.len() < 2 {
            return;
        }
        let ahead = state.clock_at(now).map(|reading| reading.offset);
        let named: Vec<_> = self.acts.iter().flat_map(|act| act.to_withdraw(robot, now, ahead)).collect();
        if !named.is_empty() {
            self.ask_about(now, robot, named);
        }
    }

    fn send_stops(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &self.robots[robot];
        let Stop::Sent(sent) = &state.halt.stop else { return };
        let stopped_at = self.timers.stopped_at.unwrap_or(now);
        let request = |(id, device): (&RequestId, &DeviceId)| {
            let mut request = ControlRequest::immediate(device.clone(), Command::Script(Script::cancel()));
            request.request_id = Some(id.clone());
            // Messages that were sent before the stop and arrive after it are taken back as well.
            request.timestamp = Some(stopped_at + state.shift);
            request.session = self.options.session_on_the_wire();
            request.home = sent.rest == Rest::Home;
            Message::ControlRequest(request)
        };
        let mut requests: Vec<_> =
            state.requests.stops().map(|stop| (stop.0.as_str(), request(stop))).collect();
        requests.sort_by(|a, b| a.0.cmp(b.0));
        let requests: Vec<_> = requests.into_iter().map(|(_, request)| request).collect();
        requests.into_iter().for_each(|request| self.post_urgently(now, robot, request));
    }

    /// Asks again for missing confirmations: of the stop, or of the fate of a script.
    pub(super) fn stop_again(&mut self, now: Timestamp<Server>) {
        let interval = self.stop_interval();
        if let Phase::Stopping { resend, .. } = &mut self.phase {
            *resend = now + interval;
        }
        for robot in self.robots.indices() {
            if self.takes_stops(now, robot) {
                self.repeat_stop(now, robot);
            }
        }
        // Two answers from the same instant would not show that a device moves.
        self.ask_poses_again(now);
        // Robots that rest do not wait for the confirmations of others, which may never come.
        let _all = self.poses_are_known(now);
        self.stop_progress(now);
    }

    /// Repeats the stop on a new link to a robot. If a new process of the robot has confirmed the stop in place of an earlier one, the
    /// earlier process may answer now.
    pub(super) fn stop_on_new_link(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &mut self.robots[robot];
        let doubted = matches!(state.halt.stop, Stop::Confirmed(_)) && state.halt.elsewhere.is_some();
        match state.halt.stop {
            Stop::Confirmed(rest) if doubted => {
                state.set_stop(Stop::None);
                self.stop_robot(now, robot, rest);
            }
            _ => self.repeat_stop(now, robot),
        }
    }

    pub(super) fn repeat_stop(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if self.robots[robot].awaits_stop() {
            self.robots[robot].totals.retries += 1;
            self.send_stops(now, robot);
        } else if self.owes_a_fate(robot) {
            // The robot has confirmed its stop, so it has no lease that a question could extend beyond a start.
            self.inquire_now(now, robot);
        }
    }

    /// Whether a robot has not reported the fate of one of its scripts, and will report it if asked.
    pub(super) fn owes_a_fate(&self, robot: RobotIndex) -> bool {
        let state = &self.robots[robot];
        let out = |act: &Act| {
            let scripts = act.member(robot).into_iter().flat_map(|member| member.scripts());
            scripts.into_iter().any(|script| script.is_out())
        };
        // A robot that takes no inquiries sends its report before its next answer after its stop. Otherwise the report is lost.
        let answered = |at| self.timers.stopped_at.is_some_and(|stopped| at > stopped);
        let lost = !state.takes_inquiries() && state.contact.questions.answered().is_some_and(answered);
        let can = !state.is_garbled() && !state.is_left_to_others();
        state.tells_fates() && can && !lost && !state.is_gone() && self.acts.iter().any(out)
    }

    fn stop_interval(&self) -> Span {
        let longest = self.robots.iter().map(RobotState::round_trip).max().unwrap_or_default();
        STOP_AGAIN.max(super::lead::counted(longest) * 3)
    }

    /// Continues once every robot has confirmed its stop, and has reported the fates of its scripts.
    pub(super) fn stop_progress(&mut self, now: Timestamp<Server>) {
        if !matches!(self.phase, Phase::Stopping { .. }) {
            return;
        }
        let all = self.robots.iter().all(|robot| robot.is_settled() || robot.is_left_to_others());
        let known = all && !self.robots.indices().any(|robot| self.owes_a_fate(robot));
        if known {
            if self.poses_are_known(now) {
                self.stopped(now);
            }
        } else if all {
            // A robot that still does not know the fate of a script is asked again after an interval, not at each answer.
            let lately = now - self.stop_interval();
            for robot in self.robots.indices() {
                let asked = self.robots[robot].contact.questions.last_asked().is_some_and(|at| at > lately);
                if self.owes_a_fate(robot) && !asked {
                    self.inquire_now(now, robot);
                }
            }
        }
    }

    /// Ends the stop, whether it was confirmed or not. The mission then ends, or continues with the act that a failure policy requests.
    pub(super) fn stopped(&mut self, now: Timestamp<Server>) {
        self.tell_unreached();
        self.report_all_at_rest();
        // Whatever the plan, the robots' reports decide what happened.
        let begun = self.has_moved() || self.acts.iter().any(Act::has_begun);
        if begun {
            self.admit_that_it_moved();
        }
        let scripts = self.acts.iter().flat_map(Act::members).flat_map(|member| member.scripts());
        let unknown = scripts.into_iter().any(|script| script.is_unaccounted());
        if !begun && !unknown && self.conclusion.outcome == Some(Outcome::Failed) {
            self.conclusion.outcome = Some(Outcome::NotStarted);
        }
        self.phase = Phase::Ended;
        let confirmed = self.robots.iter().all(RobotState::is_settled);
        if self.goes_again(now, confirmed) {
            self.course.then = None;
            self.perform_again();
            return self.line_up_again(now);
        }
        self.close_all(now);
        // If a robot is gone and can no longer move, the next act follows without its confirmation.
        let rests = !self.robots.iter().any(|robot| robot.may_move_at(now));
        if self.begins_transfer(now, rests) {
            return;
        }
        match self.course.then.take().filter(|_| rests) {
            Some(act) => {
                self.continue_after_stop();
                self.go_way(now, Way::Act(act.get()));
                self.goes_on(now);
            }
            None => self.end(),
        }
    }

    pub(super) fn perform_again(&mut self) {
        for robot in self.robots.iter_mut().filter(|robot| robot.is_settled()) {
            robot.plays_again();
        }
        self.phase = Phase::Performing;
        // While the mission stops, it does not reconnect to a robot that has confirmed its stop.
        for robot in self.robots.indices() {
            let state = &self.robots[robot];
            match state.standing {
                Standing::Out => {}
                _ if state.lost().is_some() => self.reconnect(robot),
                Standing::Absent if state.is_up() && self.options.greeting == Greeting::Skip => {
                    self.joins(robot)
                }
                Standing::Absent | Standing::In => {}
            }
        }
    }

    /// Reports why robots that have not confirmed their stop could not be reached, if that has not been reported.
    fn tell_unreached(&mut self) {
        for robot in self.robots.indices() {
            let state = &self.robots[robot];
            let told = state.failures.iter().any(|failure| {
                matches!(
                    failure.kind,
                    FailureKind::LinkDown { .. }
                        | FailureKind::Flooding { .. }
                        | FailureKind::AnotherRobot { .. }
                )
            });
            let Link::Lost(lost) = &state.link else { continue };
            if state.awaits_stop() && !told {
                let reason = lost.reason.clone();
                self.note_failure(robot, FailureKind::LinkDown { reason });
            }
        }
    }

    /// Confirms the stops of robots that have lost scripts. Other processes may run these scripts, so this waits until the scripts'
    /// leases have ended.
    pub(super) fn other_processes_rest(&mut self, now: Timestamp<Server>) {
        for robot in self.robots.indices() {
            if self.phase == Phase::Ended {
                return;
            }
            let over = |until: &mut Option<Timestamp<Server>>| until.is_some_and(|until| now >= until);
            if self.robots[robot].halt.elsewhere.take_if(over).is_some() {
                self.report_rest(now, robot);
                self.stop_progress(now);
            }
        }
    }

    /// Reports the stop of a robot if all devices have confirmed it. If the robot has not reported the fate of a script, the
    /// mission asks first, because another process may have confirmed the stop.
    pub(super) fn stop_confirmed(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if matches!(self.robots[robot].halt.stop, Stop::Confirmed(_))
            && self.owes_a_fate(robot)
            && self.robots[robot].contact.questions.last_unanswered().is_none()
        {
            self.inquire_now(now, robot);
        }
        self.report_rest(now, robot);
    }

    /// Reports that a robot has confirmed its stop, unless it still has to report the fate of a script.
    pub(super) fn report_rest(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if self.may_report_rest(robot) && !self.owes_a_fate(robot) {
            self.tell_at_rest(robot);
            // The next act may have waited for the confirmation.
            self.refill(now, robot);
        }
    }

    fn may_report_rest(&self, robot: RobotIndex) -> bool {
        let state = &self.robots[robot];
        matches!(state.halt.stop, Stop::Confirmed(_)) && state.is_settled() && !state.halt.rest_reported
    }

    /// Reports the robots that have confirmed their stop, even if they have not reported the fate of their scripts.
    pub(super) fn report_all_at_rest(&mut self) {
        for robot in self.robots.indices() {
            if self.may_report_rest(robot) {
                self.tell_at_rest(robot);
            }
        }
    }

    fn tell_at_rest(&mut self, index: RobotIndex) {
        self.robots[index].halt.rest_reported = true;
        self.tell_steps(index);
        let robot = self.robots[index].id.clone();
        self.tell(Progress::AtRest { robot: robot.clone() });
        self.record(Record::StopConfirmed { robot });
        // The mission has continued without this confirmation, and the next act may need the robot.
        if matches!(self.phase, Phase::Performing) {
            self.robots[index].plays_again();
        }
    }
}
