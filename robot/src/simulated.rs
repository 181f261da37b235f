//! A simulated robot: the real machine behind a clock, a link and faults of its own. Pure like the machine itself.

use std::collections::{BTreeMap, HashMap};

use urrcp::{
    Command, ControlError, ControlResponse, ErrorCode, InitializationBlock, Message, Robot as RobotClock,
    Span, Status, StatusValue, Timestamp,
};

use crate::robot::{Input, LinkId, Output, Robot};
use crate::set_log::LogEntry;

/// The one true clock of a host or of a virtual world.
#[derive(Clone, Copy, Debug)]
pub enum True {}

/// How a simulated robot differs from a perfect one.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Its raw clock minus the true one.
    pub clock_offset: Span,
    /// How much faster than true time its raw clock runs, in parts per million.
    pub drift_ppm: f64,
    /// Largest random error of the times that it states in availability responses.
    pub jitter: Span,
    /// Its NTP discipline knows the raw clock's error up to this; `None`: no NTP, the raw clock shows.
    pub ntp_error: Option<Span>,
    /// Least and largest delay of every message, each way.
    pub delay: Option<(Span, Span)>,
    /// What it does wrong.
    pub fault: Option<Fault>,
    /// Of its random draws.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            clock_offset: Span::ZERO,
            drift_ppm: 0.0,
            jitter: Span::ZERO,
            ntp_error: Some(Span::ZERO),
            delay: None,
            fault: None,
            seed: 0,
        }
    }
}

/// What a simulated robot does wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Refuses every script with `busy`.
    Refuse,
    /// Never answers a control request, and does not execute it.
    Silent,
    /// Closes the link right after it has accepted a script.
    Disconnect,
}

/// What leaves a simulated robot.
#[derive(Clone, Debug)]
pub enum Outgoing {
    /// A message on a link.
    Message {
        /// Which link.
        link: LinkId,
        /// The message.
        message: Message,
    },
    /// The robot closes a link.
    Close {
        /// Which.
        link: LinkId,
    },
}

#[derive(Clone, Debug)]
enum InFlight {
    In(LinkId, Input),
    Out(Outgoing),
}

/// A robot machine with a clock, a delayed link and faults. Everything is keyed on the true time.
#[derive(Clone, Debug)]
pub struct SimulatedRobot {
    robot: Robot,
    settings: Settings,
    ntp_residue: Span,
    rng: fastrand::Rng,
    epoch: Option<Timestamp<True>>,
    in_flight: BTreeMap<(Timestamp<True>, u64), InFlight>,
    sequence: u64,
    /// Messages of one link and direction keep their order, as on TCP.
    last_in: HashMap<LinkId, Timestamp<True>>,
    last_out: HashMap<LinkId, Timestamp<True>>,
    log: Vec<LogEntry>,
}

impl SimulatedRobot {
    /// A robot at rest.
    #[must_use]
    pub fn new(block: InitializationBlock, settings: Settings) -> Self {
        let mut rng = fastrand::Rng::with_seed(settings.seed);
        let ntp_residue = draw_symmetric(&mut rng, settings.ntp_error.unwrap_or_default());
        Self {
            robot: Robot::new(block),
            settings,
            ntp_residue,
            rng,
            epoch: None,
            in_flight: BTreeMap::new(),
            sequence: 0,
            last_in: HashMap::new(),
            last_out: HashMap::new(),
            log: Vec::new(),
        }
    }

    /// The machine inside.
    #[must_use]
    pub const fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Whether nothing is held, runs or travels.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.in_flight.is_empty() && self.robot.is_idle()
    }

    /// What was set since the last call.
    pub fn take_log(&mut self) -> Vec<LogEntry> {
        std::mem::take(&mut self.log)
    }

    /// Something was sent to the robot at `now`; it arrives after the link's delay.
    pub fn receive(&mut self, now: Timestamp<True>, link: LinkId, input: Input) {
        let at = self.delivery(now, link, Way::In);
        self.put(at, InFlight::In(link, input));
    }

    /// Does everything due at or before `now`: first what the machine does by itself, then deliveries.
    pub fn advance(&mut self, now: Timestamp<True>, out: &mut Vec<Outgoing>) {
        self.epoch.get_or_insert(now);
        let mut outputs = Vec::new();
        loop {
            let mine = self.robot.next_wakeup().map(|at| self.true_from_robot(at));
            let travelling = self.in_flight.first_key_value().map(|((at, _), _)| *at);
            match (mine.filter(|at| *at <= now), travelling.filter(|at| *at <= now)) {
                (Some(mine), travelling) if travelling.is_none_or(|at| mine <= at) => {
                    self.robot.advance(self.robot_from_true(now), &mut outputs);
                    self.perform(now, &mut outputs);
                }
                (_, Some(_)) => {
                    if let Some((_, in_flight)) = self.in_flight.pop_first() {
                        self.deliver(now, in_flight, &mut outputs, out);
                    }
                }
                (_, None) => return,
            }
        }
    }

    /// When [`SimulatedRobot::advance`] is next due.
    #[must_use]
    pub fn next_wakeup(&self) -> Option<Timestamp<True>> {
        let mine = self.robot.next_wakeup().map(|at| self.true_from_robot(at));
        let travelling = self.in_flight.first_key_value().map(|((at, _), _)| *at);
        mine.into_iter().chain(travelling).min()
    }

    fn deliver(
        &mut self,
        now: Timestamp<True>,
        in_flight: InFlight,
        outputs: &mut Vec<Output>,
        out: &mut Vec<Outgoing>,
    ) {
        match in_flight {
            InFlight::Out(outgoing) => out.push(outgoing),
            InFlight::In(link, input) => {
                if let Some(input) = self.through_fault(now, link, input) {
                    let at = self.robot_from_true(now);
                    self.robot.handle(at, link, input, outputs);
                    self.perform(now, outputs);
                }
            }
        }
    }

    /// What is left of an input after the robot's own fault.
    fn through_fault(&mut self, now: Timestamp<True>, link: LinkId, input: Input) -> Option<Input> {
        let Input::Message(Message::ControlRequest(request)) = &input else { return Some(input) };
        match self.settings.fault {
            Some(Fault::Silent) => None,
            Some(Fault::Refuse) if is_movement(&request.command) => {
                let at = self.robot_from_true(now);
                let refusal = ControlResponse {
                    timestamp: at,
                    device_id: request.device_id.clone(),
                    status: Status::Failed,
                    status_value: StatusValue::Null,
                    request_id: request.request_id.clone(),
                    content_hash: None,
                    event_timestamp: None,
                    steps_done: None,
                    error: Some(ControlError::new(ErrorCode::Busy, "simulated refusal")),
                };
                self.send(now, link, Message::ControlResponse(refusal));
                None
            }
            _ => Some(input),
        }
    }

    fn perform(&mut self, now: Timestamp<True>, outputs: &mut Vec<Output>) {
        for output in outputs.drain(..) {
            match output {
                Output::Set(set) => {
                    let at = self.robot_from_true(now);
                    self.log.push(LogEntry::new(now, at, set));
                }
                Output::Send { link, message } => {
                    let hangs_up = self.settings.fault == Some(Fault::Disconnect) && is_acceptance(&message);
                    self.send(now, link, message);
                    if hangs_up {
                        let at = self.delivery(now, link, Way::Out);
                        self.put(at, InFlight::Out(Outgoing::Close { link }));
                    }
                }
            }
        }
    }

    fn send(&mut self, now: Timestamp<True>, link: LinkId, mut message: Message) {
        if let Message::AvailabilityResponse(response) = &mut message {
            let error = draw_symmetric(&mut self.rng, self.settings.jitter);
            response.receive_timestamp = response.receive_timestamp + error;
            response.timestamp = response.timestamp + error;
        }
        let at = self.delivery(now, link, Way::Out);
        self.put(at, InFlight::Out(Outgoing::Message { link, message }));
    }

    fn put(&mut self, at: Timestamp<True>, in_flight: InFlight) {
        self.sequence += 1;
        self.in_flight.insert((at, self.sequence), in_flight);
    }

    fn delivery(&mut self, now: Timestamp<True>, link: LinkId, way: Way) -> Timestamp<True> {
        let delay = match self.settings.delay {
            None => Span::ZERO,
            Some((least, largest)) => {
                let width = (largest - least).as_nanos().max(0);
                least + Span::from_nanos(self.rng.i64(0..=width))
            }
        };
        let last = match way {
            Way::In => &mut self.last_in,
            Way::Out => &mut self.last_out,
        };
        let at = last.get(&link).map_or(now + delay, |last| (now + delay).max(*last));
        last.insert(link, at);
        at
    }

    /// What the robot believes the time to be: its raw clock, less what its NTP discipline knows of it.
    #[must_use]
    pub fn robot_from_true(&self, now: Timestamp<True>) -> Timestamp<RobotClock> {
        let error = match self.settings.ntp_error {
            Some(_) => self.ntp_residue,
            None => self.settings.clock_offset + self.drifted(now),
        };
        now.assume_clock() + error
    }

    fn drifted(&self, now: Timestamp<True>) -> Span {
        let since = self.epoch.map_or(Span::ZERO, |epoch| now - epoch);
        Span::from_millis_f64(since.as_millis_f64() * self.settings.drift_ppm * 1e-6)
    }

    /// The first instant at which the robot's clock shows `at`.
    fn true_from_robot(&self, at: Timestamp<RobotClock>) -> Timestamp<True> {
        let mut guess: Timestamp<True> = at.assume_clock();
        // The clock error changes by parts per million, so a few rounds settle it to the nanosecond.
        for _ in 0..4 {
            guess = guess + (at - self.robot_from_true(guess));
        }
        while self.robot_from_true(guess) < at {
            guess = guess + Span::from_nanos(1);
        }
        guess
    }
}

enum Way {
    In,
    Out,
}

fn draw_symmetric(rng: &mut fastrand::Rng, largest: Span) -> Span {
    let largest = largest.abs().as_nanos();
    Span::from_nanos(rng.i64(-largest..=largest))
}

fn is_movement(command: &Command) -> bool {
    match command {
        Command::Script(script) => !script.is_empty(),
        Command::Set(_) => true,
        Command::ReadSensor => false,
    }
}

fn is_acceptance(message: &Message) -> bool {
    matches!(message, Message::ControlResponse(response) if response.status == Status::Accepted)
}
