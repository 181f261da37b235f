//! Verifies the identity of the robot on each new link, before anything else is sent on it.
//!
//! An address may lead to the wrong robot: two addresses were swapped in the fleet file, or another robot has taken over the address
//! since. A robot states its identity in its initialization block. Stops wait only briefly for the identity. A robot that does not
//! identify itself is sent stops nevertheless, but only the right robot can confirm them. A robot that identifies itself as another one
//! is sent no stops.

use urrcp::{AvailabilityResponse, InitializationRequest, Message, RobotId, Server, Span, Status, Timestamp};

use super::failure_kind::{Failure, FailureKind};
use super::robot_state::{Link, Lost, RobotState, Standing};
use super::rounds::SILENCE_MAX;
use super::seize::Ownership;
use super::{Action, Greeting, Loss, Mission, Phase, Progress, RobotIndex, error_of_status};

/// How long a robot may take to identify itself. After this time, the robot is asked again, and its stops are sent without further delay.
const ASK_AGAIN: Span = Span::from_millis(250);

/// Who a robot is, and to whom it belongs.
#[derive(Debug)]
pub(crate) struct Identity {
    /// The id with which the robot must identify itself.
    pub(crate) own_id: RobotId,
    /// Whether the robot and this mission have proven their identities to each other.
    pub(crate) proven: bool,
    /// The expiry of the robot's certificate, if it has presented one.
    pub(crate) certified_until: Option<Timestamp<Server>>,
    /// Whether another authority replaces the one that issued the robot's certificate.
    pub(crate) is_of_replaced_authority: bool,
    /// The session to which the robot belongs, as known during the greeting.
    pub(crate) ownership: Ownership,
}

impl Identity {
    pub(super) fn new(own_id: RobotId) -> Self {
        let ownership = Ownership::default();
        Self { own_id, proven: false, certified_until: None, is_of_replaced_authority: false, ownership }
    }
}

impl Mission {
    pub(super) fn link_up(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        if self.phase == Phase::Ended {
            return;
        }
        self.robots[robot].connected(now);
        if !self.asks_names() {
            self.robots[robot].named();
            return self.link_serves(now, robot);
        }
        self.ask_name(now, robot);
    }

    /// Whether stops may be sent on a robot's link: the right robot has answered on it, or no robot has identified itself for a while.
    pub(super) fn takes_stops(&self, now: Timestamp<Server>, robot: RobotIndex) -> bool {
        let state = &self.robots[robot];
        let another = |failure: &Failure| matches!(failure.kind, FailureKind::AnotherRobot { .. });
        let said_nothing = state.unnamed_since().is_some_and(|since| now >= since + ASK_AGAIN);
        state.is_up() || said_nothing && !state.failures.iter().any(another)
    }

    fn asks_names(&self) -> bool {
        self.options.greeting == Greeting::Full
    }

    fn ask_name(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let message = Message::InitializationRequest(InitializationRequest { timestamp: Some(now) });
        // The question is sent before the stops, because its answer must precede theirs.
        let urgent = self.robots[robot].awaits_stop();
        self.outbox.actions.push(Action::Send { robot, message, urgent });
        let again = now + ASK_AGAIN;
        self.timers.next_name = Some(self.timers.next_name.map_or(again, |next| next.min(again)));
    }

    /// Asks robots again that have not identified themselves. A robot that still does not answer is treated like one that was not
    /// reached.
    pub(super) fn ask_names_again(&mut self, now: Timestamp<Server>) {
        if self.timers.next_name.is_none_or(|next| now < next) {
            return;
        }
        self.timers.next_name = None;
        let greets = matches!(self.phase, Phase::Greeting { .. });
        for robot in self.robots.indices() {
            let Some(since) = self.robots[robot].unnamed_since() else { continue };
            if greets && self.robots[robot].has_failed() {
                continue;
            }
            if !greets && now >= since + SILENCE_MAX {
                let reason = "it does not say which robot it is".to_owned();
                self.link_down(now, robot, Loss::Unreachable, reason);
            } else {
                self.ask_name(now, robot);
                if self.robots[robot].awaits_stop() && self.takes_stops(now, robot) {
                    self.repeat_stop(now, robot);
                }
            }
        }
    }

    /// Whether a message comes from the right robot. Messages of another robot, or of one that has not identified itself yet, are
    /// ignored.
    pub(super) fn is_expected_robot(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        message: &Message,
    ) -> bool {
        match message {
            _ if !self.asks_names() => true,
            Message::InitializationBlock(block) if block.id == self.robots[robot].identity.own_id => true,
            Message::InitializationBlock(block) => {
                self.met_another(now, robot, block.id.clone());
                false
            }
            // A robot that cannot be commanded need not identify itself: step 2 of the paper ends the exchange with the robot's reason.
            Message::AvailabilityResponse(AvailabilityResponse { status: Status::Failed, error, .. })
                if matches!(self.phase, Phase::Greeting { .. })
                    && self.robots[robot].standing == Standing::In
                    && !self.robots[robot].is_up() =>
            {
                let error = error_of_status(error.as_ref());
                self.fail(now, robot, FailureKind::NotAvailable { error });
                false
            }
            _ => self.robots[robot].is_up(),
        }
    }

    /// Continues with a link once the right robot has answered on it.
    pub(super) fn link_serves(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        match self.phase {
            Phase::Greeting { .. } if self.asks_names() => self.greet(now, robot),
            Phase::Greeting { .. } => {}
            Phase::Performing => return self.reattach(now, robot),
            Phase::Stopping { .. } => return self.stop_on_new_link(now, robot),
            Phase::Ended => return,
        }
        if self.robots.iter().all(RobotState::is_up) {
            self.tell(Progress::Connected { robots: self.robots.len() });
        }
        self.greeting_progress(now);
    }

    /// Stops using a link that does not lead to the right robot.
    fn met_another(&mut self, now: Timestamp<Server>, robot: RobotIndex, told: RobotId) {
        let state = &mut self.robots[robot];
        let kind = FailureKind::AnotherRobot { expected: state.identity.own_id.clone(), told };
        let known = state.failures.iter().any(|failure| failure.kind == kind);
        if self.phase == Phase::Ended || known && matches!(self.phase, Phase::Greeting { .. }) {
            return;
        }
        if matches!(self.phase, Phase::Greeting { .. }) {
            // The link is kept, so that the table shows that it works.
            return self.fail(now, robot, kind);
        }
        let (since, give_up) = state.lost().map_or((now, None), |lost| (lost.since, lost.give_up));
        let (reason, loss) = ("another robot answers".to_owned(), Loss::Unreachable);
        state.link = Link::Lost(Lost { reason, loss, since, failed: now, connecting: false, give_up });
        self.reconnect(robot);
        match self.robots[robot].standing {
            Standing::In if self.phase == Phase::Performing => self.fail(now, robot, kind),
            _ if known => {}
            standing => {
                self.note_failure(robot, kind);
                if standing == Standing::Absent {
                    self.robots[robot].standing = Standing::Out;
                }
            }
        }
    }
}
