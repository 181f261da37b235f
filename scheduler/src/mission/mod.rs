//! The mission machine: connect, greet, check clocks, prepare all, decide once, watch, stop, report.
//!
//! It takes events with their time and returns actions; it reads no clock and does no I/O, so the same machine runs a
//! real fleet (`run/`) and a dry run (`dry_run/`). One file a phase: `greet`, `prepare`, `watch`, `stop`; the state
//! machine is drawn in `docs/mission.md`.
//!
//! Events of one instant are handled in the order in which the driver hands them over; timers of that instant come last,
//! so that an answer that arrives just in time counts.

mod greet;
mod lead;
mod prepare;
pub(crate) mod robot_state;
mod stop;
mod watch;

use downbeat_scripts::Plan;
use serde::Serialize;
use urrcp::{ControlResponse, InitializationBlock, Message, RobotId, Server, Span, Timestamp};

pub use lead::{LEAD_MARGIN_MIN, LeadTime};
pub use robot_state::{Failure, FailureKind};

use crate::report::{Outcome, Report};
use robot_state::RobotState;

/// A robot that takes part, by its index in the mission from here on.
#[derive(Clone, Debug)]
pub struct Participant {
    /// Its id in the fleet file.
    pub id: RobotId,
    /// Its static description, if the fleet file gives one.
    pub block: Option<InitializationBlock>,
}

/// Whether steps 1 to 4 of the protocol are played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Greeting {
    /// Ask every robot for its availability, clock and initialization block.
    Full,
    /// Trust the static blocks (a static system in a closed network).
    Skip,
}

/// What the operator chose.
#[derive(Clone, Debug)]
pub struct MissionOptions {
    /// Steps 1 to 4, or not.
    pub greeting: Greeting,
    /// Overrides the scenario's lead time.
    pub lead: Option<Span>,
    /// How long to wait for links, greetings and stop confirmations.
    pub patience: Span,
    /// Uncertainty of the server's own clock against NTP, added to that of every robot.
    pub server_uncertainty: Span,
}

impl Default for MissionOptions {
    fn default() -> Self {
        Self {
            greeting: Greeting::Full,
            lead: None,
            patience: Span::from_millis(5_000),
            server_uncertainty: Span::ZERO,
        }
    }
}

/// What happened outside.
#[derive(Clone, Debug)]
pub enum Event {
    /// A link stands.
    LinkUp {
        /// Whose.
        robot: usize,
    },
    /// A link broke or could not be made.
    LinkDown {
        /// Whose.
        robot: usize,
        /// Why, for people.
        reason: String,
    },
    /// A message arrived.
    Received {
        /// From whom.
        robot: usize,
        /// What.
        message: Message,
    },
    /// Bytes arrived that are no message.
    Garbled {
        /// From whom.
        robot: usize,
        /// What is wrong with them.
        reason: String,
    },
    /// The operator wants everything to stop.
    StopRequested,
}

/// What the driver has to do.
#[derive(Clone, Debug)]
pub enum Action {
    /// Send a message on the robot's link.
    Send {
        /// To whom.
        robot: usize,
        /// What.
        message: Message,
    },
    /// Tell the operator.
    Tell(Progress),
}

/// What an operator wants to know while the mission goes on.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "progress", rename_all = "snake_case")]
pub enum Progress {
    /// All links stand.
    Connected {
        /// How many robots.
        robots: usize,
    },
    /// All robots are greeted and their clocks known.
    Greeted {
        /// Largest measured offset of a robot's clock.
        #[serde(rename = "clock_offset_max_ms")]
        clock_offset_max: Option<Span>,
    },
    /// All requests are on their way.
    Preparing {
        /// The sending timestamp that all share.
        timestamp: Timestamp<Server>,
        /// When the first cue starts.
        start: Timestamp<Server>,
        /// Why the start is that far ahead.
        lead: LeadTime,
    },
    /// A robot has accepted all its scripts.
    Accepted {
        /// Which.
        robot: RobotId,
    },
    /// All have accepted: the mission starts. From here only stopping is possible.
    Decided {
        /// When the first cue starts.
        start: Timestamp<Server>,
    },
    /// A device's script has started.
    Started {
        /// On which robot.
        robot: RobotId,
        /// Actual minus planned start.
        #[serde(rename = "error_ms")]
        error: Option<Span>,
    },
    /// A robot has ended all its scripts.
    Finished {
        /// Which.
        robot: RobotId,
    },
    /// Something failed.
    Failed(Failure),
    /// Stop requests are on their way.
    Stopping {
        /// Why.
        reason: String,
    },
}

/// Where the mission stands. Timers of each phase are in its file.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Links, availability, initialization blocks, clocks.
    Greeting { deadline: Timestamp<Server> },
    /// Requests are out; the decision is due.
    Preparing { decision: Timestamp<Server> },
    /// The mission starts or runs.
    Decided,
    /// Cancels are out; confirmations are awaited.
    Stopping { deadline: Timestamp<Server> },
    /// The report is ready.
    Ended,
}

/// The act's instants, once requests are on their way.
#[derive(Clone, Copy, Debug)]
struct Timing {
    timestamp: Timestamp<Server>,
    start: Timestamp<Server>,
    lead: LeadTime,
    next_renewal: Timestamp<Server>,
    /// When the last step is planned.
    end: Timestamp<Server>,
}

/// One mission, from connecting to its report.
#[derive(Debug)]
pub struct Mission {
    plan: Plan,
    options: MissionOptions,
    robots: Vec<RobotState>,
    phase: Phase,
    timing: Option<Timing>,
    outcome: Option<Outcome>,
    actions: Vec<Action>,
}

impl Mission {
    /// A mission of this plan, beginning now. Participants stand in the order of the plan's robots.
    ///
    /// # Errors
    /// The robots of the plan that have no participant.
    pub fn new(
        plan: Plan,
        participants: Vec<Participant>,
        options: MissionOptions,
        now: Timestamp<Server>,
    ) -> Result<Self, MissingParticipant> {
        let mut robots = Vec::with_capacity(plan.robots.len());
        let mut by_id: std::collections::HashMap<_, _> =
            participants.into_iter().map(|p| (p.id.clone(), p)).collect();
        for robot_plan in &plan.robots {
            let participant = by_id
                .remove(&robot_plan.robot)
                .ok_or_else(|| MissingParticipant { robot: robot_plan.robot.clone() })?;
            robots.push(RobotState::new(participant, robot_plan));
        }
        let deadline = now + options.patience;
        Ok(Self {
            plan,
            options,
            robots,
            phase: Phase::Greeting { deadline },
            timing: None,
            outcome: None,
            actions: Vec::new(),
        })
    }

    /// Takes an event that happened at `now`.
    #[must_use]
    pub fn handle(&mut self, now: Timestamp<Server>, event: Event) -> Vec<Action> {
        match event {
            Event::LinkUp { robot } => self.link_up(now, robot),
            Event::LinkDown { robot, reason } => self.link_down(now, robot, reason),
            Event::Received { robot, message } => self.receive(now, robot, message),
            Event::Garbled { robot, reason } => self.fail(now, robot, FailureKind::Garbled { reason }),
            Event::StopRequested => self.request_stop(now),
        }
        std::mem::take(&mut self.actions)
    }

    /// Does what is due at `now`.
    #[must_use]
    pub fn advance(&mut self, now: Timestamp<Server>) -> Vec<Action> {
        match self.phase {
            Phase::Greeting { deadline } if now >= deadline => self.greeting_overdue(now),
            Phase::Preparing { decision } => {
                self.renew_if_due(now);
                if now >= decision {
                    self.decide(now);
                }
            }
            Phase::Decided => {
                self.renew_if_due(now);
                self.watch(now);
            }
            Phase::Stopping { deadline } if now >= deadline => self.end(),
            _ => {}
        }
        std::mem::take(&mut self.actions)
    }

    /// When [`Mission::advance`] is next due; `None` once the mission has ended.
    #[must_use]
    pub fn next_wakeup(&self) -> Option<Timestamp<Server>> {
        match (self.phase, &self.timing) {
            (Phase::Greeting { deadline } | Phase::Stopping { deadline }, _) => Some(deadline),
            (Phase::Preparing { decision }, Some(timing)) => Some(decision.min(timing.next_renewal)),
            (Phase::Preparing { decision }, None) => Some(decision),
            (Phase::Decided, Some(timing)) => Some(self.next_watch(timing).min(timing.next_renewal)),
            (Phase::Decided, None) | (Phase::Ended, _) => None,
        }
    }

    /// What it plays.
    #[must_use]
    pub const fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What really happened, once the mission has ended.
    #[must_use]
    pub fn report(&self) -> Option<Report> {
        let outcome = self.outcome.clone().filter(|_| self.phase == Phase::Ended)?;
        Some(Report::new(&self.plan, &self.robots, self.timing.as_ref().map(|t| (t.start, t.lead)), outcome))
    }

    /// What is known if the operator leaves now, without waiting for anything.
    #[must_use]
    pub fn report_as_left(&self) -> Report {
        let timing = self.timing.as_ref().map(|t| (t.start, t.lead));
        Report::new(&self.plan, &self.robots, timing, Outcome::Abandoned)
    }

    fn receive(&mut self, now: Timestamp<Server>, robot: usize, message: Message) {
        match message {
            Message::AvailabilityResponse(response) => self.availability(now, robot, &response),
            Message::InitializationBlock(block) => self.introduced(now, robot, block),
            Message::ControlResponse(response) => self.control_response(now, robot, response),
            Message::AvailabilityRequest(_)
            | Message::InitializationRequest(_)
            | Message::ControlRequest(_) => {
                let reason = "sent a message that only a server sends".to_owned();
                self.fail(now, robot, FailureKind::Garbled { reason });
            }
        }
    }

    fn control_response(&mut self, now: Timestamp<Server>, robot: usize, response: ControlResponse) {
        if self.robots[robot].stop_answered(&response) {
            return self.stop_progress();
        }
        match self.phase {
            Phase::Preparing { .. } | Phase::Decided => self.script_response(now, robot, response),
            Phase::Greeting { .. } | Phase::Stopping { .. } | Phase::Ended => {
                self.robots[robot].note_late_response(&response);
            }
        }
    }

    fn link_down(&mut self, now: Timestamp<Server>, robot: usize, reason: String) {
        if self.phase == Phase::Ended {
            return;
        }
        self.robots[robot].link = robot_state::Link::Down;
        match self.phase {
            Phase::Stopping { .. } => self.stop_progress(),
            _ if self.robots[robot].is_done() => {}
            _ => self.fail(now, robot, FailureKind::LinkDown { reason }),
        }
    }

    /// Notes the failure of a robot and does what the policy says: abort all.
    fn fail(&mut self, now: Timestamp<Server>, robot: usize, kind: FailureKind) {
        self.note_failure(robot, kind);
        match self.phase {
            // All robots get their chance to speak first, so that all findings come at once.
            Phase::Greeting { .. } => self.greeting_progress(now),
            Phase::Preparing { .. } => self.abort(now, Outcome::NotStarted),
            Phase::Decided => self.abort_decided(now),
            Phase::Stopping { .. } | Phase::Ended => {}
        }
    }

    fn note_failure(&mut self, robot: usize, kind: FailureKind) {
        let failure = Failure { robot: self.robots[robot].id.clone(), kind };
        tracing::warn!(robot = %failure.robot, "{}", failure.kind);
        self.robots[robot].failures.push(failure.clone());
        self.tell(Progress::Failed(failure));
    }

    fn send(&mut self, now: Timestamp<Server>, robot: usize, message: Message) {
        if self.robots[robot].link == robot_state::Link::Up {
            self.robots[robot].last_sent = Some(now);
            self.actions.push(Action::Send { robot, message });
        }
    }

    fn tell(&mut self, progress: Progress) {
        self.actions.push(Action::Tell(progress));
    }

    fn end(&mut self) {
        self.phase = Phase::Ended;
    }
}

/// A robot of the plan has no participant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("robot `{robot}` of the plan takes no part in the mission")]
pub struct MissingParticipant {
    /// Which.
    pub robot: RobotId,
}
