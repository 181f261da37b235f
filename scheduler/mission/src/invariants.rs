//! Invariants that a mission satisfies between two events: the statements of `docs/mission.md`, as far as they are visible from inside.
//! Tests, the simulation and the fuzzer check them after every event; a released program does not.

use urrcp::{Command, ControlRequest, Message, Server, Timestamp};

use super::act::Act;
use super::robot_state::{RobotState, Standing, Stop};
use super::{Action, Mission, Phase, RobotIndex};

/// The maximum number of robots for which invariants are checked. In larger fleets, the checks would take most of the time.
const ROBOTS_MAX: usize = 64;

impl Mission {
    /// Panics if an invariant does not hold after an event at `now` has led to `self.actions`.
    pub(super) fn check(&self, now: Timestamp<Server>) {
        if !self.options.check_invariants || self.robots.len() > ROBOTS_MAX {
            return;
        }
        self.robots.iter().for_each(|robot| robot.check(now));
        self.acts.iter().for_each(|act| act.check(&self.robots));
        self.check_phase();
        self.check_acts();
        self.check_requests();
        for (place, action) in self.actions.iter().enumerate() {
            self.check_action(action, &self.actions[..place]);
        }
    }

    fn check_phase(&self) {
        match self.phase {
            Phase::Greeting { .. } => {
                assert!(
                    self.robots.iter().all(|robot| matches!(robot.stop, Stop::None)),
                    "no robot is stopped during the greeting"
                );
            }
            Phase::Performing => self.acts.iter().for_each(|act| self.check_left_out(act)),
            Phase::Stopping { deadline, resend, .. } => {
                assert!(
                    self.stopped_at <= Some(deadline) && self.stopped_at <= Some(resend),
                    "confirmations are awaited after the stop"
                );
            }
            Phase::Ended => {
                assert!(self.outcome.is_some(), "a mission that has ended has an outcome");
                assert!(self.next_wakeup().is_none(), "a mission that has ended waits for nothing");
            }
        }
        let acts = self.choreography.acts.len();
        assert!(
            self.detour.is_none_or(|act| act.get() < acts),
            "a policy leads to an act of the choreography"
        );
        assert!(
            self.then.is_none_or(|act| act.get() < acts),
            "the mission continues with an act of the choreography"
        );
        assert!(self.fates.len() <= acts, "each act of the scenario has a fate");
        assert!(self.acts_repeated <= self.acts_begun, "an act that is repeated has begun");
        assert!(
            self.recording.awaited.iter().is_sorted_by_key(|(count, ..)| *count),
            "records become durable in order"
        );
        assert!(
            self.recording.awaited.iter().all(|(count, ..)| *count <= self.recording.count),
            "only records that were written are awaited"
        );
        let indices = self.first_robots.iter().flatten();
        assert!(
            indices.into_iter().all(|robot| robot.get() < self.robots.len()),
            "the robots of the first act belong to the mission"
        );
    }

    fn check_acts(&self) {
        assert!(self.acts.len() <= self.acts_begun as usize, "only acts that have begun are under way");
        let mut numbers = self.acts.iter().map(Act::number);
        assert!(numbers.clone().is_sorted_by(|a, b| a < b), "acts are numbered in order");
        assert!(
            numbers.next_back().is_none_or(|last| last.get() < self.acts_begun),
            "acts are counted when they begin"
        );
        let waiting = self.acts.iter().rev().skip(1);
        assert!(waiting.into_iter().all(Act::was_sent), "only the last act may still wait");
        let starts = self.acts.iter().filter_map(|act| act.timing().map(|timing| timing.start));
        assert!(starts.is_sorted(), "acts are in order of their start");
        for act in &self.acts {
            for member in act.members() {
                let robot = &self.robots[member.robot];
                let out = member.scripts().iter().any(|script| script.is_out());
                assert!(!(out && robot.at_rest), "{} rests, so it has no script of {}", robot.id, act.name());
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
            assert!(
                count <= robot.queue_of(device),
                "{}/{device} was sent at most as many scripts as it can hold",
                robot.id
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
    fn check_action(&self, action: &Action, before: &[Action]) {
        match action {
            Action::Send { robot, message, .. } => self.check_message(*robot, message, before),
            Action::Reconnect { robot, .. } => {
                assert!(robot.get() < self.robots.len(), "links lead to robots of the mission");
            }
            _ => {}
        }
    }

    fn check_message(&self, robot: RobotIndex, message: &Message, before: &[Action]) {
        let state = &self.robots[robot];
        let id = &state.id;
        let Some(request) = script_in(message).filter(|request| !is_stop(request)) else { return };
        let stopped_now = |action: &Action| match action {
            Action::Send { robot: of, message, .. } => {
                *of == robot && script_in(message).is_some_and(is_stop)
            }
            _ => false,
        };
        let stopped_before = matches!(&state.stop, Stop::Sent(sent) if sent.at < self.arrived);
        assert!(
            !stopped_before && !before.iter().any(stopped_now),
            "{id} is sent no script before it has confirmed its stop"
        );
        let is_stopped = matches!(state.stop, Stop::Sent(_));
        assert!(is_stopped || state.standing == Standing::In, "{id} takes part, so it is sent scripts");
        assert!(state.touched.contains(&request.device_id), "{id}/{} was sent something", request.device_id);
        assert!(request.time_offset_to_start.is_some(), "{id}: scripts have a planned start");
        assert!(request.content_hash.is_some(), "{id}: scripts are bound to their contents");
        let name = request.request_id.as_ref();
        let act = name.and_then(|name| state.requests.script(name)).map(|script| script.act);
        let act = act.and_then(|number| self.acts.iter().find(|act| act.number() == number));
        let may = |act: &Act| act.is_open() || act.is_over() || act.is_lapsing();
        assert!(act.is_none_or(may), "{id} is sent scripts of acts that were promised");
    }
}

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
