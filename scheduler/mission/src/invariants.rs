//! Invariants that a mission satisfies between two events: the statements of `docs/mission.md`, as far as they are visible from inside.
//! Tests, the simulation and the fuzzer check them after every event; a released program does not.
//!
//! `holds!` quotes a statement from that page; `tests/documents/promises.rs` compares the quotations.

use urrcp::{Command, ControlRequest, Inquiry, Message, Millis, Server, Span, Timestamp};

use super::act::{Act, Progressed};
use super::failure_kind::FailureKind;
use super::ledger;
use super::poses::SLOWS_MAX;
use super::robot_state::{Rest, RobotState, Standing, Stop};
use super::rounds::KEEP_ALIVE;
use super::script::promised_name;
use super::{Action, Greeting, Join, Mission, Phase, RobotIndex};

/// Panics unless a condition holds. The message names a robot, a script or an act, and quotes the statement of `docs/mission.md`.
macro_rules! holds {
    ($condition:expr, $of:expr, $statement:literal $(,)?) => {
        assert!($condition, "{}: {}", $of, $statement)
    };
}
pub(crate) use holds;

/// The longest pause before an attempt to reconnect.
const PAUSE_MAX: Span = Span::from_millis(1_000);

/// The maximum number of robots for which invariants are checked. In larger fleets, the checks would take most of the time.
const ROBOTS_MAX: usize = 64;

impl Mission {
    /// Panics if an invariant does not hold after an event at `now` has led to `self.outbox.actions`.
    pub(super) fn check(&self, now: Timestamp<Server>) {
        if !self.options.check_invariants || self.robots.len() > ROBOTS_MAX {
            return;
        }
        self.robots.iter().for_each(|robot| robot.check(now));
        self.acts.iter().for_each(|act| act.check(&self.robots));
        self.check_phase();
        self.check_acts();
        self.check_requests();
        self.robots.iter().for_each(|robot| self.check_robot(robot));
        for (place, action) in self.outbox.actions.iter().enumerate() {
            self.check_action(now, action, &self.outbox.actions[..place]);
        }
    }

    /// Panics if an invariant does not hold once everything that is due at `now` has been performed.
    pub(super) fn check_timers(&self, now: Timestamp<Server>) {
        if !self.options.check_invariants || self.robots.len() > ROBOTS_MAX || self.phase != Phase::Performing
        {
            return;
        }
        holds!(
            self.timers.next_round.is_some_and(|next| next <= now + KEEP_ALIVE),
            "the next round",
            "The mission asks all robots at least once a second, and three times within the shortest lease."
        );
        for (robot, state) in self.robots.enumerated() {
            let id = &state.id;
            let bound = self.silence_bound(now, robot);
            let silent_at = bound.and_then(|bound| state.silent_at(bound));
            holds!(
                silent_at.is_none_or(|at| now < at + KEEP_ALIVE * 2),
                id,
                "has failed if it stays silent for its shortest running lease (3 s if it has none) plus a round trip"
            );
            holds!(
                state.lost().and_then(|lost| lost.give_up).is_none_or(|at| now < at),
                id,
                "the mission gives up the robot when its leases have certainly ended"
            );
            let sendable = if state.may_be_sent_scripts() {
                ledger::sendable(&self.acts, robot, state)
            } else {
                Vec::new()
            };
            let is_refused = |script: &super::script::ScriptRef| {
                let act = self.acts.iter().find(|act| act.number() == script.act);
                act.is_none_or(|act| act.script(*script).was_ever_sent())
            };
            holds!(
                sendable.iter().all(is_refused),
                id,
                "Whenever a place becomes free, the mission sends the next script in order of start, from any act"
            );
        }
        for (robot, _) in &self.outbox.deferred {
            holds!(
                self.acts.iter().any(|act| act.holds_messages_to(*robot, now)),
                self.robots[*robot].id,
                "While there is time, readings and refills follow a question with a shorter lease; otherwise they wait."
            );
        }
    }

    fn check_robot(&self, robot: &RobotState) {
        let id = &robot.id;
        holds!(
            robot.standing != Standing::Absent || self.options.join == Join::NextAct,
            id,
            "A robot that is missing at first is refused"
        );
        holds!(
            robot.pose.asked.as_ref().is_none_or(|asked| asked.at <= asked.since + SLOWS_MAX),
            id,
            "the mission asks its robot for the position, and again until it no longer changes, for at most 4 s"
        );
        if self.options.greeting == Greeting::Skip && matches!(self.phase, Phase::Greeting { .. }) {
            holds!(
                robot.pose.commanded.is_empty() && robot.pose.asked.is_none(),
                id,
                "With `handshake: skip`, the mission does not ask, so all positions are unknown."
            );
        }
    }

    fn check_phase(&self) {
        match self.phase {
            Phase::Greeting { .. } => {
                holds!(
                    self.robots.iter().all(|robot| matches!(robot.halt.stop, Stop::None)),
                    "the greeting",
                    "It gives up only once all robots have answered or failed"
                );
                holds!(self.acts.is_empty(), "the greeting", "`downbeat preflight` runs this phase alone.");
            }
            Phase::Performing => self.acts.iter().for_each(|act| self.check_left_out(act)),
            Phase::Stopping { deadline, resend, .. } => {
                assert!(
                    self.timers.stopped_at <= Some(deadline) && self.timers.stopped_at <= Some(resend),
                    "confirmations are awaited after the stop"
                );
            }
            Phase::Ended => {
                assert!(self.conclusion.outcome.is_some(), "a mission that has ended has an outcome");
                assert!(self.next_wakeup().is_none(), "a mission that has ended waits for nothing");
            }
        }
        let acts = self.choreography.acts.len();
        assert!(
            self.course.detour.is_none_or(|act| act.get() < acts),
            "a policy leads to an act of the choreography"
        );
        assert!(
            self.course.then.is_none_or(|act| act.get() < acts),
            "the mission continues with an act of the choreography"
        );
        assert!(self.course.fates.len() <= acts, "each act of the scenario has a fate");
        assert!(self.course.repeated <= self.course.begun, "an act that is repeated has begun");
        assert!(
            self.recording.awaited.iter().is_sorted_by_key(|(count, ..)| *count),
            "records become durable in order"
        );
        assert!(
            self.recording.awaited.iter().all(|(count, ..)| *count <= self.recording.count),
            "only records that were written are awaited"
        );
        let indices = self.greeting.first_robots.iter().flatten();
        assert!(
            indices.into_iter().all(|robot| robot.get() < self.robots.len()),
            "the robots of the first act belong to the mission"
        );
    }

    fn check_acts(&self) {
        assert!(self.acts.len() <= self.course.begun as usize, "only acts that have begun are under way");
        holds!(
            self.acts.len() <= 2,
            "acts",
            "An act may be sent up to 2 s early, while the previous act plays"
        );
        let mut numbers = self.acts.iter().map(Act::number);
        assert!(numbers.clone().is_sorted_by(|a, b| a < b), "acts are numbered in order");
        assert!(
            numbers.next_back().is_none_or(|last| last.get() < self.course.begun),
            "acts are counted when they begin"
        );
        let waiting = self.acts.iter().rev().skip(1);
        assert!(waiting.into_iter().all(Act::was_sent), "only the last act may still wait");
        let starts = self.acts.iter().filter_map(|act| act.timing().map(|timing| timing.start));
        assert!(starts.is_sorted(), "acts are in order of their start");
        for act in &self.acts {
            if act.progress() == Progressed::Promised {
                self.check_poses(act);
            }
            for member in act.members() {
                let robot = &self.robots[member.robot];
                let out = member.scripts().iter().any(|script| script.is_out());
                assert!(
                    !(out && robot.halt.at_rest),
                    "{} rests, so it has no script of {}",
                    robot.id,
                    act.name()
                );
                assert!(
                    !(out && robot.standing == Standing::Absent),
                    "{} is absent, so it has no script of {}",
                    robot.id,
                    act.name()
                );
            }
        }
        for (index, robot) in self.robots.enumerated() {
            self.check_queues(index, robot);
        }
    }

    fn check_poses(&self, act: &Act) {
        for member in act.present() {
            let jumps = |script: &super::script::Script| self.would_jump(act, member.robot, &script.plan);
            holds!(
                !member.firsts().any(jumps),
                self.robots[member.robot].id,
                "A start that jumps is refused."
            );
        }
    }

    /// Checks that a robot that was left out takes no part while the others continue.
    fn check_left_out(&self, act: &Act) {
        for member in act.present().filter(|_| act.was_sent() && !act.is_over()) {
            let robot = &self.robots[member.robot];
            assert_ne!(
                robot.standing,
                Standing::Out,
                "{} was left out, so it takes no part in {}",
                robot.id,
                act.name()
            );
        }
    }

    /// Checks that devices hold at most as many scripts as their queues have room for. Scripts that another process sent may have ended.
    fn check_queues(&self, index: RobotIndex, robot: &RobotState) {
        let mut held = std::collections::BTreeMap::new();
        for member in self.acts.iter().filter_map(|act| act.member(index)) {
            for script in
                member.scripts().iter().filter(|script| script.is_out() && script.is_of_this_process())
            {
                *held.entry(&script.plan.device).or_insert(0_usize) += 1;
            }
        }
        for (device, count) in held {
            holds!(
                count <= robot.queue_of(device),
                format_args!("{}/{device}", robot.id),
                "Each device has one ledger of its `script_queue` places across all acts."
            );
        }
    }

    fn check_requests(&self) {
        for (index, robot) in self.robots.enumerated() {
            for (name, script) in robot.requests.scripts() {
                let Some(act) = self.acts.iter().find(|act| act.number() == script.act) else { continue };
                assert_eq!(act.robot_of(script), index, "{}: `{name}` is a request to this robot", robot.id);
            }
        }
    }

    /// Checks an action. `before` contains the actions that precede it.
    fn check_action(&self, now: Timestamp<Server>, action: &Action, before: &[Action]) {
        match action {
            Action::Send { robot, message, urgent } => {
                self.check_link(now, *robot, message);
                match message {
                    Message::Inquiry(inquiry) => self.check_inquiry(now, *robot, inquiry),
                    Message::ControlRequest(request) if is_stop(request) => {
                        self.check_stop(*robot, request);
                        holds!(*urgent, self.robots[*robot].id, "This script precedes all waiting messages");
                    }
                    Message::ControlRequest(request) if matches!(request.command, Command::Script(_)) => {
                        self.check_may_be_sent(*robot, request, before);
                        self.check_script(*robot, request);
                    }
                    _ => {}
                }
            }
            Action::Reconnect { robot, after } => holds!(
                *after <= PAUSE_MAX,
                self.robots[*robot].id,
                "The mission reconnects at once, then after 10 ms, and doubles the interval up to 1 s."
            ),
            _ => {}
        }
    }

    fn check_link(&self, now: Timestamp<Server>, robot: RobotIndex, message: &Message) {
        let state = &self.robots[robot];
        let is_stop = script_in(message).is_some_and(is_stop);
        if is_stop || matches!(message, Message::InitializationRequest(_)) {
            return;
        }
        holds!(state.is_up(), state.id, "sends nothing more until the robot has answered");
        let shortens = matches!(message, Message::Inquiry(Inquiry { pending_lease: Some(_), .. }));
        let waits = |act: &Act| act.holds_messages_to(robot, now) && !act.lets_through(robot, now);
        holds!(
            shortens || self.phase != Phase::Performing || !self.acts.iter().any(waits),
            state.id,
            "which precedes the brink by the length of the last lease, the scheduler falls silent"
        );
    }

    fn check_inquiry(&self, now: Timestamp<Server>, robot: RobotIndex, inquiry: &Inquiry) {
        let state = &self.robots[robot];
        holds!(
            state.takes_inquiries(),
            state.id,
            "The mission sends availability requests to a robot without inquiries."
        );
        let Some(lease) = inquiry.pending_lease else { return };
        for script in inquiry.requests.iter().filter_map(|name| state.requests.script(name)) {
            let Some(act) = self.acts.iter().find(|act| act.number() == script.act) else { continue };
            let Some(timing) = act.timing().filter(|_| !act.is_committed()) else { continue };
            // The lease of a script that begins later than the act is longer by that time.
            let lease = lease.span() - act.script(script).plan.start.span();
            holds!(
                lease <= GRAIN || now + lease <= timing.brink() + GRAIN,
                state.id,
                "Each inquiry carries a pending lease that ends at one common instant, the brink"
            );
        }
    }

    fn check_stop(&self, robot: RobotIndex, request: &ControlRequest) {
        let state = &self.robots[robot];
        let id = &state.id;
        holds!(
            matches!(state.halt.stop, Stop::Sent(_)),
            id,
            "A robot gets an empty script only while it is being stopped."
        );
        let Stop::Sent(sent) = &state.halt.stop else { return };
        holds!(
            state.halt.touched.contains(&request.device_id),
            format_args!("{id}/{}", request.device_id),
            "Every device that was sent anything gets an empty script."
        );
        holds!(
            request.home == (sent.rest == Rest::Home),
            id,
            "A mission moves robots to their default positions only on request"
        );
        let is_another = |failure: &super::Failure| matches!(failure.kind, FailureKind::AnotherRobot { .. });
        holds!(
            state.is_up() || !state.failures.iter().any(is_another),
            id,
            "A robot that identifies itself as a different one is sent no stop."
        );
    }

    /// Checks that the mission may send a script to a robot. `before` contains the actions that precede it.
    fn check_may_be_sent(&self, robot: RobotIndex, request: &ControlRequest, before: &[Action]) {
        let state = &self.robots[robot];
        let id = &state.id;
        let stopped_now = |action: &Action| match action {
            Action::Send { robot: of, message, .. } => {
                *of == robot && script_in(message).is_some_and(is_stop)
            }
            _ => false,
        };
        let stopped_before = matches!(&state.halt.stop, Stop::Sent(sent) if sent.at < self.outbox.arrived);
        holds!(
            !stopped_before && !before.iter().any(stopped_now),
            id,
            "Once every robot has confirmed its stop, the mission prepares the act again"
        );
        let is_stopped = matches!(state.halt.stop, Stop::Sent(_));
        assert!(is_stopped || state.standing == Standing::In, "{id} takes part, so it is sent scripts");
        assert!(
            state.halt.touched.contains(&request.device_id),
            "{id}/{} was sent something",
            request.device_id
        );
    }

    fn check_script(&self, robot: RobotIndex, request: &ControlRequest) {
        let state = &self.robots[robot];
        let of = format_args!("{}/{}", state.id, request.device_id);
        holds!(request.content_hash.is_some(), of, "each bound to its content hash");
        assert!(request.time_offset_to_start.is_some(), "{of}: scripts have a planned start");
        let reference = request.request_id.as_ref().and_then(|name| state.requests.script(name));
        let Some((reference, act)) = reference.and_then(|reference| {
            Some((reference, self.acts.iter().find(|act| act.number() == reference.act)?))
        }) else {
            return;
        };
        let may = act.is_open() || act.is_over() || act.is_lapsing();
        holds!(may, of, "what is promised to which robot");
        let (Some(timing), Some(member)) = (act.timing(), act.member(robot)) else { return };
        let script = act.script(reference);
        holds!(
            !script.is_of_this_process()
                || request.timestamp == Some(timing.timestamp + member.shift_of(script)),
            of,
            "All requests carry the same `timestamp`; for a robot with `clock: measured`, it is converted to the robot's own time."
        );
        holds!(
            request.pending_until.is_some() == state.takes_inquiries(),
            of,
            "The control requests contain it as well"
        );
        let before = member.scripts()[..reference.script].last();
        let before = before.filter(|before| before.plan.device == request.device_id);
        let running = before.map(|before| before.longest_lease());
        let pending = request.stop_condition.and_then(|leases| leases.pending).map(Millis::span);
        holds!(
            running.is_none_or(|running| pending.is_none() || running.is_some() && pending >= running),
            of,
            "A script that follows another one of its device waits under that script's running lease."
        );
        let names = (request.request_id.as_ref(), script.promised_id());
        holds!(
            names.0.map(|name| promised_name(name.as_str())) == names.1.map(|name| name.as_str()),
            of,
            "the promised `request_id`, `+`, and the number of refusals"
        );
    }
}

/// Leases are sent in milliseconds.
const GRAIN: Span = Span::from_millis(1);

/// Returns the request in a message, if it contains a script or a stop.
const fn script_in(message: &Message) -> Option<&ControlRequest> {
    match message {
        Message::ControlRequest(request) if matches!(request.command, Command::Script(_)) => Some(request),
        _ => None,
    }
}

/// Whether a request is a stop: a script without steps stops its device.
fn is_stop(request: &ControlRequest) -> bool {
    matches!(&request.command, Command::Script(script) if script.is_empty())
}
